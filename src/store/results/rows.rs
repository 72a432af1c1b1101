//! Rows of results as objects and as lines of a CSV.

use serde::ser::{Serialize, SerializeMap, Serializer};

use super::columns::{COLUMNS, Column, Kind, column, place};
use super::query::Cell;

/// Digits of an uncertainty in a row; a value ends at the same decimal.
const DIGITS_STD: i32 = 3;
/// Significant digits of a value without an uncertainty.
const DIGITS_ALONE: usize = 6;

/// Bytes of a brief row at most.
pub const ROW_BYTES_MAX: usize = 600;

/// A row with the values of all columns.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultRow {
    cells: Vec<Cell>,
}

impl ResultRow {
    pub(super) fn new(cells: Vec<Cell>) -> Self {
        ResultRow { cells }
    }

    /// Makes a row of some columns; the others have no value.
    #[cfg(test)]
    pub(crate) fn of(cells: Vec<(&str, Cell)>) -> Self {
        let mut row = ResultRow::new(vec![Cell::Null; COLUMNS.len()]);
        for (name, cell) in cells {
            row.cells[place(column(name).expect("it is a column"))] = cell;
        }
        row
    }

    /// Returns the value of a column with all its digits.
    #[must_use]
    pub fn cell(&self, column: &Column) -> &Cell {
        &self.cells[place(column)]
    }

    /// Number of the scan.
    #[must_use]
    pub fn scan_id(&self) -> i64 {
        match self.cells.first() {
            Some(Cell::Id(id)) => *id,
            _ => 0,
        }
    }

    /// Whether a later fit gave other values than the newest verdict judged.
    #[must_use]
    pub fn judged_other_values(&self) -> bool {
        let matches = column("verdict_matches").expect("it is a column");
        *self.cell(matches) == Cell::Flag(false)
    }

    /// Region; empty for the whole sample.
    #[must_use]
    pub fn region(&self) -> &str {
        match &self.cells[1] {
            Cell::Text(region) => region,
            _ => "",
        }
    }

    /// Returns the value of a column as it is shown: an uncertainty with three significant digits, a value to the same
    /// decimal.
    #[must_use]
    pub fn shown(&self, of: &Column) -> Cell {
        match (self.cell(of), of.kind) {
            (Cell::Real(value), Kind::Real { std }) => {
                let std = std.and_then(column).map(|std| self.cell(std));
                Cell::Real(match std {
                    Some(Cell::Real(std)) => to_decimal_of(*value, *std),
                    _ => to_digits(*value),
                })
            }
            (cell, _) => cell.clone(),
        }
    }

    /// Returns the row as a JSON object of these columns.
    #[must_use]
    pub fn object<'a>(&'a self, fields: &'a [&'static Column]) -> RowObject<'a> {
        RowObject {
            row: self,
            fields,
            width: None,
        }
    }

    /// Returns the row as a JSON object of at most [`ROW_BYTES_MAX`] bytes: texts that are too long for it end with `…`, and
    /// `shortened` says so.
    #[must_use]
    pub fn brief<'a>(&'a self, fields: &'a [&'static Column]) -> RowObject<'a> {
        let of_width = |width| RowObject {
            row: self,
            fields,
            width,
        };
        let fits = |width: Option<usize>| {
            serde_json::to_vec(&of_width(width)).is_ok_and(|text| text.len() <= ROW_BYTES_MAX)
        };
        if fits(None) {
            return of_width(None);
        }
        let (mut width, mut too_wide) = (0, ROW_BYTES_MAX);
        while too_wide - width > 1 {
            let middle = usize::midpoint(width, too_wide);
            *if fits(Some(middle)) {
                &mut width
            } else {
                &mut too_wide
            } = middle;
        }
        of_width(Some(width))
    }

    /// Returns the row as a line of a CSV.
    #[must_use]
    pub fn csv_line(&self, fields: &[&'static Column]) -> String {
        line(fields.iter().map(|column| match self.shown(column) {
            Cell::Null => String::new(),
            Cell::Id(id) => id.to_string(),
            // The shortest digits that read back as the same number.
            Cell::Real(value) => value.to_string(),
            Cell::Text(text) => text,
            Cell::Flag(flag) => flag.to_string(),
            Cell::Tags(tags) => tags.join(", "),
        }))
    }
}

/// Returns the first line of a CSV.
#[must_use]
pub fn csv_header(fields: &[&'static Column]) -> String {
    line(fields.iter().map(|column| column.name.to_owned()))
}

fn line(values: impl Iterator<Item = String>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer
        .write_record(values)
        .and_then(|()| Ok(writer.flush()?))
        .expect("memory takes everything");
    let bytes = writer.into_inner().expect("it was flushed");
    String::from_utf8(bytes).expect("text in, text out")
}

/// Rounds a value to the last shown decimal of its standard uncertainty.
fn to_decimal_of(value: f64, std: f64) -> f64 {
    if !(std > 0.0 && std.is_finite() && value.is_finite()) {
        return to_digits(value);
    }
    let decimals = DIGITS_STD - 1 - std.log10().floor() as i32;
    match usize::try_from(decimals) {
        Ok(decimals @ 0..=300) => parsed(to_decimals(value, decimals), value),
        _ => to_digits(value),
    }
}

/// Writes a value with some decimals. A reader that rounds once more, to fewer decimals, gets the same as from all digits:
/// where rounding would make a 5 at the end, whose rounding has lost its direction, the neighbour on the value's side is
/// written. Otherwise one uncertainty in twenty would have another second digit in a list than in its fit.
fn to_decimals(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let ends_in_5 = text.trim_end_matches('0').ends_with('5');
    match text.parse::<f64>() {
        Ok(rounded) if ends_in_5 && rounded != value => {
            let step = 0.1_f64.powi(decimals as i32);
            format!("{:.decimals$}", rounded + step.copysign(value - rounded))
        }
        _ => text,
    }
}

fn to_digits(value: f64) -> f64 {
    parsed(format!("{value:.*e}", DIGITS_ALONE - 1), value)
}

fn parsed(text: String, value: f64) -> f64 {
    // Rounding makes −0 of a small negative value.
    text.parse::<f64>().map_or(value, |rounded| rounded + 0.0)
}

/// A row as a JSON object.
#[derive(Debug, Clone, Copy)]
pub struct RowObject<'a> {
    row: &'a ResultRow,
    fields: &'a [&'static Column],
    /// Characters of a text at most, where the row is brief.
    width: Option<usize>,
}

/// Cuts a text to a number of characters, `…` included.
fn cut(text: String, width: usize) -> String {
    match text.char_indices().nth(width) {
        None => text,
        Some(_) => text
            .chars()
            .take(width.saturating_sub(1))
            .chain(['…'])
            .collect(),
    }
}

impl Serialize for RowObject<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut object = serializer.serialize_map(None)?;
        for column in self.fields {
            let shown = self.row.shown(column);
            // Few samples have regions, and the rows of all others are shorter without it.
            if column.name == COLUMNS[1].name && shown == Cell::Null {
                continue;
            }
            let shown = match (shown, self.width, column.kind) {
                (Cell::Text(text), Some(width), Kind::Text) => Cell::Text(cut(text, width)),
                (shown, ..) => shown,
            };
            object.serialize_entry(column.name, &shown)?;
        }
        if self.width.is_some() {
            object.serialize_entry("shortened", &true)?;
        }
        object.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_rounded_by_their_uncertainty() {
        for (value, std, shown) in [
            (10.001_234_567, 0.012_345, 10.001_2),
            (0.012_345, 0.012_345, 0.0123),
            (-0.000_001, 0.012_345, 0.0),
            // Two digits of these are 0.025, 0.026 and −0.025.
            (0.025_47, 0.025_47, 0.025_4),
            (0.025_53, 0.025_53, 0.025_6),
            (-0.025_47, 0.012_345, -0.025_4),
            (0.025_499_7, 0.001_234_5, 0.025_49),
            (0.025_5, 0.025_5, 0.025_5),
            (12_345.678_9, 250.0, 12_346.0),
            (12_345.678_9, 0.0, 12_345.7),
            (1.0, f64::NAN, 1.0),
            (1e-300, 1e-302, 1e-300),
            (1e300, 1e299, 1e300),
        ] {
            let rounded = to_decimal_of(value, std);
            assert_eq!(rounded, shown, "{value} ± {std}");
            assert!(rounded.is_sign_positive() || rounded < 0.0);
        }
    }

    #[test]
    fn names_with_commas_and_quotes_are_quoted_in_a_csv() {
        let name = Cell::Text("B-17, \"left\"".into());
        let row = ResultRow::of(vec![("scan_id", Cell::Id(3)), ("part", name)]);
        let fields = ["scan_id", "part"].map(|name| column(name).unwrap());
        assert_eq!(csv_header(&fields), "scan_id,part\n");
        assert_eq!(row.csv_line(&fields), "3,\"B-17, \"\"left\"\"\"\n");
    }
}
