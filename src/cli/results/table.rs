//! The table of results: columns that fit the terminal.

use crate::store::results::{Cell, Column, ResultRow, column};
use crate::wording::{decimals, factor, stated};

/// Space between columns.
const GAP: &str = "  ";
/// Shortest width of a shortened text.
const TEXT_MIN: usize = 8;

/// A column as it is printed.
struct Printed {
    heading: String,
    cells: Vec<String>,
    is_number: bool,
    /// A text that may be shortened.
    is_text: bool,
    /// Columns with the largest rank are left out first.
    rank: usize,
}

/// Returns the table of these rows: of the columns that were asked for, or of those that a person needs most, at most
/// `width` characters wide.
pub(super) fn of(
    rows: &[ResultRow],
    asked: Option<&[&'static Column]>,
    width: Option<usize>,
) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut columns = match asked {
        Some(fields) => fields.iter().map(|field| plain(rows, field)).collect(),
        None => usual(rows),
    };
    if let Some(width) = width {
        fit(&mut columns, width, asked.is_none());
    }
    let widths: Vec<usize> = columns.iter().map(Printed::width).collect();
    if width.is_some_and(|width| total(&columns) > width) {
        return listed(&columns, rows.len());
    }
    let mut text = line(
        columns.iter().map(|c| c.heading.as_str()),
        &columns,
        &widths,
    );
    for row in 0..rows.len() {
        text += &line(
            columns.iter().map(|c| c.cells[row].as_str()),
            &columns,
            &widths,
        );
    }
    text
}

impl Printed {
    fn width(&self) -> usize {
        let cells = self.cells.iter().map(|cell| cell.chars().count());
        cells.max().unwrap_or(0).max(self.heading.chars().count())
    }

    fn is_empty(&self) -> bool {
        self.cells.iter().all(String::is_empty)
    }
}

fn line<'a>(cells: impl Iterator<Item = &'a str>, columns: &[Printed], widths: &[usize]) -> String {
    let padded = cells
        .zip(columns)
        .zip(widths)
        .map(|((cell, column), width)| match column.is_number {
            true => format!("{cell:>width$}"),
            false => format!("{cell:width$}"),
        });
    let padded: Vec<String> = padded.collect();
    format!("{}\n", padded.join(GAP).trim_end())
}

/// A column of the store under its own name.
fn plain(rows: &[ResultRow], field: &'static Column) -> Printed {
    let shown = |row: &ResultRow| match row.shown(field) {
        Cell::Null => String::new(),
        Cell::Id(id) => id.to_string(),
        Cell::Real(value) => value.to_string(),
        Cell::Text(text) => text,
        Cell::Flag(flag) => flag.to_string(),
        Cell::Tags(tags) => tags.join(", "),
    };
    let is_text = rows
        .iter()
        .any(|row| matches!(row.cell(field), Cell::Text(_) | Cell::Tags(_)));
    Printed {
        heading: field.name.to_owned(),
        cells: rows.iter().map(shown).collect(),
        is_number: !is_text,
        is_text,
        rank: 0,
    }
}

/// The columns for a person.
fn usual(rows: &[ResultRow]) -> Vec<Printed> {
    let named = |name: &str, heading: &str, rank: usize| {
        let field = column(name).expect("it is a column");
        Printed {
            heading: heading.to_owned(),
            rank,
            is_text: ["part", "lot", "recipe", "specification"].contains(&name),
            ..plain(rows, field)
        }
    };
    let mut started = named("created_at", "started (UTC)", 4);
    for cell in &mut started.cells {
        // To the minute.
        *cell = cell.chars().take(16).collect::<String>().replace('T', " ");
    }
    let mut columns = vec![
        named("scan_id", "scan", 0),
        named("part", "part", 1),
        named("region", "region", 2),
        named("lot", "lot", 3),
        named("recipe", "recipe", 5),
        angle(rows),
        Printed {
            cells: rows.iter().map(verdict).collect(),
            ..named("verdict", "verdict", 1)
        },
        named("specification", "specification", 7),
        started,
        named("status", "fit", 6),
        named("state", "state", 8),
    ];
    columns.retain(|column| !column.is_empty());
    columns
}

/// The verdict, and whether it judged other values than those of the row.
fn verdict(row: &ResultRow) -> String {
    match row.cell(column("verdict").expect("it is a column")) {
        Cell::Text(verdict) if row.judged_other_values() => format!("{verdict} (other values)"),
        Cell::Text(verdict) => verdict.clone(),
        _ => String::new(),
    }
}

/// θr with its expanded uncertainty.
fn angle(rows: &[ResultRow]) -> Printed {
    let value = |row: &ResultRow, name: &str| match row.cell(column(name).expect("it is a column"))
    {
        Cell::Real(value) => Some(*value),
        _ => None,
    };
    let mut factors: Vec<f64> = rows
        .iter()
        .filter_map(|row| value(row, "coverage_factor"))
        .collect();
    factors.dedup();
    let common = match factors[..] {
        [k] => Some(k),
        _ => None,
    };
    let cell = |row: &ResultRow| {
        let Some(angle) = value(row, "theta_r_deg") else {
            return String::new();
        };
        let (expanded, k) = (
            value(row, "theta_r_deg_expanded"),
            value(row, "coverage_factor"),
        );
        match (expanded, k) {
            (Some(expanded), Some(k)) => {
                let digits = decimals(expanded);
                let each = match common {
                    Some(_) => String::new(),
                    None => format!(" (k = {})", factor(k)),
                };
                format!("{angle:.digits$} ± {expanded:.digits$}°{each}")
            }
            _ => format!("{}° (fixed)", stated(angle)),
        }
    };
    Printed {
        heading: match common {
            Some(k) => format!("θr ± U (k = {})", factor(k)),
            None => "θr ± U".to_owned(),
        },
        cells: rows.iter().map(cell).collect(),
        is_number: true,
        is_text: false,
        rank: 0,
    }
}

/// Characters of a line.
fn total(columns: &[Printed]) -> usize {
    let widths: usize = columns.iter().map(Printed::width).sum();
    widths + GAP.len() * columns.len().saturating_sub(1)
}

/// The rows of a table that is wider than the terminal: a field per line, without empty ones.
fn listed(columns: &[Printed], rows: usize) -> String {
    let mut text = String::new();
    for row in 0..rows {
        let mut indent = "";
        for column in columns {
            let cell = &column.cells[row];
            if !cell.is_empty() {
                text += &format!("{indent}{}: {cell}\n", column.heading);
                indent = GAP;
            }
        }
    }
    text
}

/// Leaves out columns and shortens texts until the table fits.
fn fit(columns: &mut Vec<Printed>, width: usize, may_leave_out: bool) {
    loop {
        let over = total(columns).saturating_sub(width);
        if over == 0 {
            return;
        }
        // The widest text gives way first, as far as it stays readable.
        let widest = columns
            .iter_mut()
            .filter(|c| c.is_text && c.width() > TEXT_MIN);
        if let Some(column) = widest.max_by_key(|c| c.width()) {
            let heading = column.heading.chars().count();
            let least = TEXT_MIN.max(heading);
            if column.width() > least {
                let to = column.width().saturating_sub(over).max(least);
                for cell in &mut column.cells {
                    shorten(cell, to);
                }
                continue;
            }
            column.is_text = false;
            continue;
        }
        let last = columns.iter().map(|c| c.rank).max().unwrap_or(0);
        if !may_leave_out || last == 0 {
            return;
        }
        columns.retain(|c| c.rank != last);
    }
}

fn shorten(cell: &mut String, to: usize) {
    if cell.chars().count() > to {
        *cell = cell.chars().take(to.saturating_sub(1)).collect();
        cell.push('…');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(scan: i64, part: &str, angle: Option<(f64, f64, f64)>, verdict: &str) -> ResultRow {
        let mut cells = vec![
            ("scan_id", Cell::Id(scan)),
            ("part", Cell::Text(part.to_owned())),
            ("state", Cell::Text("completed".to_owned())),
            (
                "created_at",
                Cell::Text("2026-03-02T09:00:00.123Z".to_owned()),
            ),
        ];
        if let Some((value, expanded, k)) = angle {
            cells.push(("theta_r_deg", Cell::Real(value)));
            cells.push(("theta_r_deg_expanded", Cell::Real(expanded)));
            cells.push(("coverage_factor", Cell::Real(k)));
        }
        if !verdict.is_empty() {
            cells.push(("verdict", Cell::Text(verdict.to_owned())));
            cells.push(("specification", Cell::Text("PX-1204".to_owned())));
        }
        ResultRow::of(cells)
    }

    fn rows() -> Vec<ResultRow> {
        vec![
            row(
                12,
                "Panel B-17 of the left side",
                Some((10.001_23, 0.024, 2.0)),
                "pass",
            ),
            row(7, "die", None, ""),
        ]
    }

    #[test]
    fn the_table_has_names_and_units_and_no_empty_columns() {
        let text = of(&rows(), None, None);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            lines[0]
                .split("  ")
                .filter(|w| !w.is_empty())
                .map(str::trim)
                .collect::<Vec<_>>(),
            [
                "scan",
                "part",
                "θr ± U (k = 2)",
                "verdict",
                "specification",
                "started (UTC)",
                "state"
            ]
        );
        assert!(
            lines[1].contains("Panel B-17 of the left side  10.001 ± 0.024°  pass"),
            "{text}"
        );
        assert!(lines[1].contains("2026-03-02 09:00"), "{text}");
        assert!(!text.contains("region"));
    }

    #[test]
    fn the_table_is_as_wide_as_the_terminal_at_most() {
        for width in [50, 60, 70, 80, 120] {
            let text = of(&rows(), None, Some(width));
            let widest = text.lines().map(|line| line.chars().count()).max();
            assert!(widest <= Some(width), "{width}:\n{text}");
            assert!(text.contains("10.001 ± 0.024°"), "{width}:\n{text}");
        }
        assert!(of(&rows(), None, Some(60)).contains('…'));
    }

    #[test]
    fn different_coverage_factors_are_stated_in_their_rows() {
        let rows = [
            row(1, "a", Some((10.0, 0.02, 2.0)), ""),
            row(2, "b", Some((9.0, 0.05, 2.43)), ""),
        ];
        let text = of(&rows, None, None);
        assert!(
            text.contains("10.000 ± 0.020° (k = 2)") && text.contains("(k = 2.43)"),
            "{text}"
        );
    }

    #[test]
    fn columns_that_were_asked_for_keep_their_names() {
        let fields = ["scan_id", "theta_r_deg"].map(|name| column(name).unwrap());
        let text = of(&rows(), Some(&fields), Some(80));
        assert_eq!(
            text,
            "scan_id  theta_r_deg\n     12      10.0012\n      7\n"
        );
    }
}
