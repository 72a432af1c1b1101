//! Differences between two settings or manifests, value by value.
//!
//! [`between`] is the one function to call. It compares values by their paths and does not know their meaning.

use std::collections::BTreeMap;
use std::fmt;

use serde_json::Value;

/// A value that has changed.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Path of its key: `camera.width_px`.
    pub key: String,
    /// Earlier value; `None` if it was not stated.
    pub before: Option<Value>,
    /// Present value; `None` if it is not stated.
    pub now: Option<Value>,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let said = |value: &Option<Value>| match value {
            None => "not stated".to_owned(),
            Some(value) => value.to_string(),
        };
        let (before, now) = (said(&self.before), said(&self.now));
        write!(f, "{} was {before} and is {now}", self.key)
    }
}

/// Returns all values that differ, in the order of their paths. A list is one value; null counts as not stated.
#[must_use]
pub fn between(before: &Value, now: &Value) -> Vec<Difference> {
    let (mut was, mut is) = (BTreeMap::new(), BTreeMap::new());
    flatten("", before, &mut was);
    flatten("", now, &mut is);
    let mut keys: Vec<&String> = was.keys().chain(is.keys()).collect();
    keys.sort();
    keys.dedup();
    keys.into_iter()
        .filter(|key| was.get(*key) != is.get(*key))
        .map(|key| Difference {
            key: key.clone(),
            before: was.get(key).map(|value| (*value).clone()),
            now: is.get(key).map(|value| (*value).clone()),
        })
        .collect()
}

fn flatten<'a>(path: &str, value: &'a Value, into: &mut BTreeMap<String, &'a Value>) {
    match value {
        Value::Null => {}
        Value::Object(fields) => {
            for (name, value) in fields {
                let path = match path {
                    "" => name.clone(),
                    path => format!("{path}.{name}"),
                };
                flatten(&path, value, into);
            }
        }
        value => drop(into.insert(path.to_owned(), value)),
    }
}

/// Returns the first few differences in words, and the number of the others.
#[must_use]
pub fn in_words<T: fmt::Display>(differences: &[T]) -> String {
    const SHOWN: usize = 5;
    let shown = differences.iter().take(SHOWN).map(ToString::to_string);
    let mut words = shown.collect::<Vec<_>>().join("; ");
    if differences.len() > SHOWN {
        words.push_str(&format!("; and {} more", differences.len() - SHOWN));
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn only_what_differs_is_named_with_both_values() {
        let before = json!({"rig": {"theta_l_deg": 10.0, "axis": [1, 2]}, "label": "", "gone": null, "old": true});
        let now = json!({"rig": {"theta_l_deg": 12.5, "axis": [1, 2]}, "label": "", "new": "x"});
        let said = between(&before, &now);
        let words: Vec<String> = said.iter().map(ToString::to_string).collect();
        assert_eq!(
            words,
            [
                "new was not stated and is \"x\"",
                "old was true and is not stated",
                "rig.theta_l_deg was 10.0 and is 12.5",
            ]
        );
        assert_eq!(between(&now, &now), []);
        assert_eq!(in_words(&["a"; 7]), "a; a; a; a; a; and 2 more");
    }
}
