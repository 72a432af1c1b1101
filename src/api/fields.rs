//! `fields=` of a list whose rows are long: only the named fields are sent.

use serde_json::{Map, Value};

use super::status::ApiError;
use crate::wording::meant;

/// The fields of a row that a client asks for, e.g. `id` or `parameters.theta_r_deg`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fields(Vec<Vec<String>>);

impl Fields {
    /// Reads names separated by commas.
    ///
    /// # Errors
    /// A name that is not one of `known`.
    pub fn read(text: &str, known: &[String]) -> Result<Fields, ApiError> {
        let names: Vec<&str> = text.split(',').map(str::trim).collect();
        for name in &names {
            if !known.iter().any(|k| k == name) {
                return Err(ApiError::invalid("fields", refusal(name, known)));
            }
        }
        let steps = |name: &&str| name.split('.').map(str::to_owned).collect();
        Ok(Fields(names.iter().map(steps).collect()))
    }

    /// Returns the row with these fields only. A field that the row does not have is omitted.
    pub fn of(&self, row: &Value) -> Value {
        let mut short = Map::new();
        for path in &self.0 {
            let found = path.iter().try_fold(row, |value, step| value.get(step));
            if let Some(value) = found {
                put(&mut short, path, value.clone());
            }
        }
        Value::Object(short)
    }
}

fn refusal(name: &str, known: &[String]) -> String {
    let short: String = name.chars().take(60).collect();
    // The names are made at run time; the nearest one is looked up among those with the same number of steps.
    let depth = name.matches('.').count();
    let near = known.iter().filter(|k| k.matches('.').count() == depth);
    let near: Vec<&str> = near.map(String::as_str).collect();
    match meant(name, &near) {
        Some(right) => format!("there is no field {short:?}; did you mean `{right}`?"),
        None => format!(
            "there is no field {short:?}; expected some of {}",
            known.join(", ")
        ),
    }
}

fn put(into: &mut Map<String, Value>, path: &[String], value: Value) {
    match path {
        [] => {}
        [name] => {
            into.insert(name.clone(), value);
        }
        [name, rest @ ..] => {
            let inner = into
                .entry(name.clone())
                .or_insert_with(|| Map::new().into());
            if let Value::Object(inner) = inner {
                put(inner, rest, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_row_keeps_the_named_fields_only() {
        let known = [
            "id",
            "state",
            "parameters",
            "parameters.theta_r_deg",
            "parameters.rho_d",
        ];
        let known = known.map(String::from);
        let row = json!({"id": 1, "state": "completed", "parameters": {"theta_r_deg": {"value": 10.0}, "alpha_u": {}}});
        let of = |text| Fields::read(text, &known).unwrap().of(&row);
        assert_eq!(of("id, state"), json!({"id": 1, "state": "completed"}));
        let angle = json!({"id": 1, "parameters": {"theta_r_deg": {"value": 10.0}}});
        assert_eq!(of("id,parameters.theta_r_deg,parameters.rho_d"), angle);
        // The whole after a part of it.
        assert_eq!(
            of("parameters.theta_r_deg,parameters")["parameters"],
            row["parameters"]
        );
        assert_eq!(
            of("parameters,parameters.theta_r_deg")["parameters"],
            row["parameters"]
        );
    }

    #[test]
    fn a_name_that_is_not_known_is_refused_with_the_nearest_one() {
        let known = ["id", "state", "parameters.theta_r_deg"].map(String::from);
        let refused = |text: &str| refusal(text, &known);
        assert!(refused("stat").contains("did you mean `state`?"));
        assert!(refused("parameters.theta_deg").contains("`parameters.theta_r_deg`"));
        assert!(refused("").contains("expected some of id, state"));
        Fields::read("id,", &known).unwrap_err();
    }
}
