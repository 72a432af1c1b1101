//! Orders of a CSV file: a header line with the names of the columns, then one order a line.

use std::path::Path;

use serde_json::{Map, Value};

use super::wrong_file;
use crate::cli::CliError;
use crate::wording::sheet::{Sheet, decoded};

/// Columns of the file, and the fields of an order.
const COLUMNS: [(&str, &str); 8] = [
    ("part", "part"),
    ("part_id", "sample_id"),
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
        let value = match (field, value.parse::<i64>()) {
            ("sample_id", Ok(id)) => Value::from(id),
            _ => Value::String(value),
        };
        body.insert(field.to_owned(), value);
    }
    Value::Object(body)
}

/// An order of a file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FileOrder {
    /// Line of the file, from 1.
    pub line: usize,
    /// The body of the order.
    pub body: Value,
}

/// Reads the orders of a file as spreadsheets save it: columns separated by commas, semicolons or tabs. `defaults` fill the
/// columns that a line leaves empty.
///
/// # Errors
/// Bad input for a file that cannot be read, an unknown column, or a line with other columns than the header.
pub(super) fn orders(file: &Path, defaults: &[(&str, String)]) -> Result<Vec<FileOrder>, CliError> {
    let size = std::fs::metadata(file)
        .map_err(|error| wrong_file(file, error))?
        .len();
    if size > BYTES_MAX {
        return Err(wrong_file(
            file,
            "it has more than 4 MB; add its orders in parts",
        ));
    }
    let bytes = std::fs::read(file).map_err(|error| wrong_file(file, error))?;
    let text = decoded(bytes).map_err(|(line, byte)| {
        let why =
            format!("line {line}: the byte 0x{byte:02x} is not UTF-8; save the file as UTF-8");
        wrong_file(file, why)
    })?;
    let mut sheet = Sheet::open(&text);
    let header = sheet.headers().map_err(|error| wrong_file(file, error))?;
    let names: Vec<String> = header.iter().map(str::to_lowercase).collect();
    let known: Vec<&str> = COLUMNS.iter().map(|(name, _)| *name).collect();
    let of_header = |why: String| wrong_file(file, format!("line {}: {why}", sheet.header_line()));
    if let Some(unknown) = names.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(of_header(format!(
            "there is no column `{unknown}`; expected {}",
            known.join(", ")
        )));
    }
    if !names.iter().any(|name| name == "part" || name == "part_id") {
        return Err(of_header(
            "the column `part` (or `part_id`) is missing".to_owned(),
        ));
    }
    let mut orders = Vec::new();
    while let Some(row) = sheet.read() {
        let row = row.map_err(|error| wrong_file(file, error))?;
        let line = sheet.line(row.position()).unwrap_or_default();
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
        let has = |wanted: &str| values.iter().any(|(name, _)| *name == wanted);
        let needed = [
            (has("part") || has("part_id"), "part"),
            (has("recipe"), "recipe"),
        ];
        if let Some((_, missing)) = needed.iter().find(|(is_given, _)| !is_given) {
            let way_out = match *missing {
                "recipe" => "fill it in, or give --recipe for all lines",
                _ => "fill it in",
            };
            let why = format!("line {line}: `{missing}` is empty; {way_out}");
            return Err(wrong_file(file, why));
        }
        let body = order(values.into_iter());
        orders.push(FileOrder { line, body });
    }
    match orders.is_empty() {
        true => Err(wrong_file(file, "there is no order below the header line")),
        false => Ok(orders),
    }
}

/// Replaces the places of orders in a message of the daemon, such as `orders[2]`, by the lines of the file.
pub(super) fn by_lines(message: &str, lines: &[usize]) -> String {
    let mut text = String::new();
    let mut rest = message;
    while let Some((before, after)) = rest.split_once("orders[") {
        let placed = after.split_once(']').and_then(|(place, beyond)| {
            let line = lines.get(place.parse::<usize>().ok()?)?;
            Some((line, beyond))
        });
        text.push_str(before);
        rest = match placed {
            Some((line, beyond)) => {
                text.push_str(&format!("line {line}"));
                match beyond.strip_prefix('.') {
                    Some(field) => {
                        text.push_str(", ");
                        field
                    }
                    None => beyond,
                }
            }
            None => {
                text.push_str("orders[");
                after
            }
        };
    }
    text + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(text: &str, defaults: &[(&str, String)]) -> Result<Vec<Value>, String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("parts.csv");
        std::fs::write(&file, text).unwrap();
        let bodies = |found: Vec<FileOrder>| found.into_iter().map(|order| order.body).collect();
        orders(&file, defaults)
            .map(bodies)
            .map_err(|error| match error {
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
    fn a_file_of_a_spreadsheet_is_read_with_its_own_separator() {
        for text in [
            "part;recipe;note\r\nB-17;PX;a, b\r\n",
            "sep=;\npart;recipe;note\nB-17;PX;a, b\n",
            "part\trecipe\tnote\nB-17\tPX\ta, b\n",
        ] {
            let found = read(text, &[]).unwrap();
            let order = json!({"part": "B-17", "recipe": "PX", "note": "a, b"});
            assert_eq!(found, [order], "{text:?}");
        }
        let found = read("part_id,recipe\n12,PX\n", &[]).unwrap();
        assert_eq!(found, [json!({"sample_id": 12, "recipe": "PX"})]);
    }

    #[test]
    fn a_message_of_the_daemon_names_the_lines_of_the_file() {
        let lines = [2, 4];
        let message = "orders[1].external_id: `A` is the external id of orders[0], too (orders[7])";
        assert_eq!(
            by_lines(message, &lines),
            "line 4, external_id: `A` is the external id of line 2, too (orders[7])"
        );
        assert_eq!(by_lines("the queue is full", &lines), "the queue is full");
    }

    #[test]
    fn a_wrong_file_is_refused_by_its_line() {
        for (text, words) in [
            ("part,recip\nB,PX\n", "there is no column `recip`"),
            (
                "recipe\nPX\n",
                "the column `part` (or `part_id`) is missing",
            ),
            ("part,recipe\nB-17,\n", "line 2: `recipe` is empty"),
            ("part,recipe\n", "no order"),
            ("part,recipe\nB-17\n", "line"),
        ] {
            let refused = read(text, &[]).unwrap_err();
            assert!(refused.contains(words), "{text:?}: {refused}");
        }
    }
}
