//! Orders of a CSV file: a header line with the names of the columns, then one order a line.

use std::path::Path;

use serde_json::{Map, Value};

use super::wrong_file;
use crate::cli::CliError;

/// Columns of the file, and the fields of an order.
const COLUMNS: [(&str, &str); 7] = [
    ("part", "part"),
    ("recipe", "recipe"),
    ("specification", "specification"),
    ("lot", "lot"),
    ("external_id", "external_id"),
    ("operator", "operator_name"),
    ("note", "note"),
];
/// Largest file.
const BYTES_MAX: u64 = 4 << 20;

/// Makes the body of an order from values by column.
pub(super) fn order<'a>(values: impl Iterator<Item = (&'a str, String)>) -> Value {
    let mut body = Map::new();
    for (column, value) in values {
        let field = COLUMNS.iter().find(|(name, _)| *name == column);
        let field = field.map_or(column, |(_, field)| *field);
        body.insert(field.to_owned(), Value::String(value));
    }
    Value::Object(body)
}

/// Reads the orders of a file. `defaults` fill the columns that a line leaves empty.
///
/// # Errors
/// Bad input for a file that cannot be read, an unknown column, or a line with other columns than the header.
pub(super) fn orders(file: &Path, defaults: &[(&str, String)]) -> Result<Vec<Value>, CliError> {
    let size = std::fs::metadata(file)
        .map_err(|error| wrong_file(file, error))?
        .len();
    if size > BYTES_MAX {
        return Err(wrong_file(
            file,
            "it has more than 4 MB; add its orders in parts",
        ));
    }
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(file)
        .map_err(|error| wrong_file(file, error))?;
    let header = reader
        .headers()
        .map_err(|error| wrong_file(file, error))?
        .clone();
    let names: Vec<String> = header
        .iter()
        .map(|name| name.trim_start_matches('\u{feff}').to_lowercase())
        .collect();
    let known: Vec<&str> = COLUMNS.iter().map(|(name, _)| *name).collect();
    if let Some(unknown) = names.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(wrong_file(
            file,
            format!(
                "line 1: there is no column `{unknown}`; expected {}",
                known.join(", ")
            ),
        ));
    }
    if !names.iter().any(|name| name == "part") {
        return Err(wrong_file(file, "line 1: the column `part` is missing"));
    }
    let mut orders = Vec::new();
    for row in reader.records() {
        let row = row.map_err(|error| wrong_file(file, error))?;
        let line = row.position().map_or(0, csv::Position::line);
        let mut values: Vec<(&str, String)> = names
            .iter()
            .zip(row.iter())
            .filter(|(_, value)| !value.is_empty())
            .map(|(name, value)| (name.as_str(), value.to_owned()))
            .collect();
        for (name, default) in defaults {
            if !values.iter().any(|(given, _)| given == name) {
                values.push((name, default.clone()));
            }
        }
        for needed in ["part", "recipe"] {
            if !values.iter().any(|(name, _)| *name == needed) {
                let why = format!(
                    "line {line}: `{needed}` is empty; fill it in, or give --recipe for all lines"
                );
                return Err(wrong_file(file, why));
            }
        }
        orders.push(order(values.into_iter()));
    }
    match orders.is_empty() {
        true => Err(wrong_file(file, "there is no order below the header line")),
        false => Ok(orders),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(text: &str, defaults: &[(&str, String)]) -> Result<Vec<Value>, String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("parts.csv");
        std::fs::write(&file, text).unwrap();
        orders(&file, defaults).map_err(|error| match error {
            CliError::BadInput(error) => error.to_string(),
            other => panic!("{other:?}"),
        })
    }

    #[test]
    fn lines_are_orders_and_options_fill_what_they_leave_empty() {
        let text = "\u{feff}part, recipe, lot, operator\nB-17, PX, 4, Anna\n\"B, 18\",, 5,\n";
        let defaults = [("recipe", "QX".to_owned()), ("lot", "9".to_owned())];
        let found = read(text, &defaults).unwrap();
        assert_eq!(
            found,
            [
                json!({"part": "B-17", "recipe": "PX", "lot": "4", "operator_name": "Anna"}),
                json!({"part": "B, 18", "recipe": "QX", "lot": "5"}),
            ]
        );
    }

    #[test]
    fn a_wrong_file_is_refused_by_its_line() {
        for (text, words) in [
            ("part,recip\nB,PX\n", "there is no column `recip`"),
            ("recipe\nPX\n", "the column `part` is missing"),
            ("part,recipe\nB-17,\n", "line 2: `recipe` is empty"),
            ("part,recipe\n", "no order"),
            ("part,recipe\nB-17\n", "line"),
        ] {
            let refused = read(text, &[]).unwrap_err();
            assert!(refused.contains(words), "{text:?}: {refused}");
        }
    }
}
