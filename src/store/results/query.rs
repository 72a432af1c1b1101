//! Reads what a query of results asks for from names and texts: the parameters of a request, or options of the command
//! line.
//!
//! Every column is a filter: `NAME=VALUE` for texts and words (words separated by commas; an empty value finds rows
//! without one), `NAME_min` and `NAME_max` for numbers and times.

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use serde::{Deserialize, Serialize};

use super::columns::{COLUMNS, Column, Kind, column, usual};
use crate::store::records::tag_fault;
use crate::store::{utc_of, utc_text};
use crate::wording::meant;

/// Most rows of a page.
pub const LIMIT_MAX: u32 = 1000;
/// Rows of a page that states no limit.
pub const LIMIT_USUAL: u32 = 100;
/// Longest text to search for, in characters.
const SEARCH_MAX: usize = 200;

/// Parameters that are not named after a column, each with its meaning.
#[rustfmt::skip]
pub const GENERAL: &[(&str, &str)] = &[
    ("latest", "true: only the newest fitted scan of each part. Filters on scans (part, lot, recipe, material, times, search) select the scans among which it is the newest; filters on results and verdicts apply to it afterwards"),
    ("search", "Text in the name of part, lot, recipe, operator or specification, in the external id, in a tag or in the note, in upper or lower case"),
    ("tag", "Rows with this tag, as the filter `tags`"),
    ("since", "Started or imported at or after this time, RFC 3339; a date is its midnight UTC"),
    ("until", "Started or imported before this time"),
    ("sort", "Column to sort by, with `-` in front for descending; `-scan_id` (newest first) if omitted. Rows without a value come last"),
    (
        "fields",
        "Columns of the rows, separated by commas, or `all`, or `usual`; without it, the usual ones with long texts shortened",
    ),
    ("limit", "Largest number of rows, 1 to 1000; 100 if omitted, and all rows of a CSV"),
    ("cursor", "`next_cursor` of the previous page, with the same sort"),
    ("count", "true: the answer counts all rows that the filters select"),
    ("format", "json or csv; by default as the header Accept asks, otherwise json"),
];

/// Those of them that are about the page of an answer, and not about which rows it has.
pub const OF_THE_PAGE: [&str; 6] = ["sort", "fields", "limit", "cursor", "count", "format"];

/// The form of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResultFormat {
    /// A page of objects.
    Json,
    /// A table.
    Csv,
}

/// Why a query is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum QueryError {
    /// There is no such parameter.
    #[error("{0}")]
    Unknown(String),
    /// A value is wrong.
    #[error("{name}: {problem}")]
    Invalid {
        /// The parameter.
        name: String,
        /// What was expected and what was given.
        problem: String,
    },
}

/// A query of the results: conditions, text to search for, and order.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultQuery {
    pub(super) conditions: Vec<Condition>,
    pub(super) search: Option<String>,
    pub(super) latest: bool,
    pub(super) sort: Sort,
    pub(super) cursor: Option<Cursor>,
    /// Columns of the rows.
    pub fields: Vec<&'static Column>,
    /// Whether the columns were left open, so that a row of JSON has at most [`super::ROW_BYTES_MAX`] bytes.
    pub brief: bool,
    /// Largest number of rows, if stated.
    pub limit: Option<u32>,
    /// Whether to count all rows.
    pub count: bool,
    /// Form of the answer, if stated.
    pub format: Option<ResultFormat>,
}

/// A filter on one column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Condition {
    pub column: &'static Column,
    pub test: Test,
}

/// What a value has to be.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Test {
    /// One of these; `None` is no value.
    OneOf(Vec<Option<Cell>>),
    AtLeast(Cell),
    AtMost(Cell),
    Below(Cell),
    /// With this tag.
    Has(String),
}

/// A value of a column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Cell {
    /// No value.
    Null,
    /// True or false.
    Flag(bool),
    /// Number of a row.
    Id(i64),
    /// A measured or stated value.
    Real(f64),
    /// Text, word or time.
    Text(String),
    /// Tags.
    Tags(Vec<String>),
}

/// Order of the rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sort {
    pub column: &'static Column,
    pub descending: bool,
}

impl Sort {
    fn text(self) -> String {
        let sign = if self.descending { "-" } else { "" };
        format!("{sign}{}", self.column.name)
    }
}

/// The place after the last row of a page.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Cursor {
    sort: String,
    pub value: Cell,
    pub scan_id: i64,
    pub region: String,
}

impl Cursor {
    pub fn after(sort: Sort, value: Cell, scan_id: i64, region: String) -> Self {
        Cursor {
            sort: sort.text(),
            value,
            scan_id,
            region,
        }
    }

    /// The cursor as clients hand it back.
    pub fn text(&self) -> String {
        URL_SAFE_NO_PAD.encode(serde_json::to_string(self).expect("a cursor is JSON"))
    }

    fn read(text: &str) -> Option<Cursor> {
        serde_json::from_slice(&URL_SAFE_NO_PAD.decode(text).ok()?).ok()
    }
}

impl Default for ResultQuery {
    fn default() -> Self {
        ResultQuery {
            conditions: Vec::new(),
            search: None,
            latest: false,
            sort: Sort {
                column: &COLUMNS[0],
                descending: true,
            },
            cursor: None,
            fields: usual(),
            brief: true,
            limit: None,
            count: false,
            format: None,
        }
    }
}

impl ResultQuery {
    /// Reads parameters, by name and text.
    ///
    /// # Errors
    /// A name that is not known or is given twice, or a value that does not suit it.
    pub fn read<'a>(
        parameters: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<ResultQuery, QueryError> {
        let mut query = ResultQuery::default();
        let mut seen = Vec::new();
        for (name, text) in parameters {
            if seen.contains(&name) {
                return Err(invalid(name, "is given twice"));
            }
            seen.push(name);
            query.take(name, text)?;
        }
        let sort = query.sort.text();
        if query.cursor.as_ref().is_some_and(|c| c.sort != sort) {
            let problem = "belongs to another order; send the `sort` of the page that it came with";
            return Err(invalid("cursor", problem));
        }
        Ok(query)
    }

    /// Reads filters only, by name and text.
    ///
    /// # Errors
    /// As [`ResultQuery::read`], also for a parameter of the page.
    pub fn read_filters<'a>(
        parameters: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<ResultQuery, QueryError> {
        let parameters: Vec<_> = parameters.into_iter().collect();
        if let Some((name, _)) = parameters
            .iter()
            .find(|(name, _)| OF_THE_PAGE.contains(name))
        {
            let detail = format!("there is no parameter {name:?} here; expected filters only");
            return Err(QueryError::Unknown(detail));
        }
        ResultQuery::read(parameters)
    }

    /// Asks for the rows that were started or imported last, newest first, at most `limit` of them.
    #[must_use]
    pub fn newest(mut self, limit: u32) -> Self {
        let column = column("created_at").expect("it is a column");
        let descending = true;
        self.sort = Sort { column, descending };
        self.limit = Some(limit);
        self
    }

    /// Returns the one text that a filter demands of a column.
    #[must_use]
    pub fn only_text(&self, name: &str) -> Option<&str> {
        let condition = self.conditions.iter().find(|c| c.column.name == name)?;
        match &condition.test {
            Test::OneOf(values) => match values.as_slice() {
                [Some(Cell::Text(text))] => Some(text),
                _ => None,
            },
            _ => None,
        }
    }

    /// Asks for the page at a cursor of this query.
    pub(super) fn continue_at(&mut self, cursor: Option<&str>) {
        self.cursor = cursor.and_then(Cursor::read);
    }

    fn take(&mut self, name: &str, text: &str) -> Result<(), QueryError> {
        match name {
            "latest" => self.latest = yes_or_no(name, text)?,
            "count" => self.count = yes_or_no(name, text)?,
            "search" => match text.chars().count() {
                1..=SEARCH_MAX => self.search = Some(text.to_owned()),
                _ => {
                    let problem = format!("expected 1 to {SEARCH_MAX} characters");
                    return Err(invalid(name, problem));
                }
            },
            "since" => self.of_time(name, text, Test::AtLeast)?,
            "until" => self.of_time(name, text, Test::Below)?,
            "tag" => {
                let condition = filter("tags", text)?;
                self.conditions.push(condition);
            }
            "sort" => self.sort = sort_of(text)?,
            "fields" => {
                self.fields = fields_of(text)?;
                self.brief = false;
            }
            "limit" => match text.parse() {
                Ok(limit @ 1..=LIMIT_MAX) => self.limit = Some(limit),
                _ => {
                    let problem = format!("expected 1 to {LIMIT_MAX}, got {}", quoted(text));
                    return Err(invalid(name, problem));
                }
            },
            "cursor" => match Cursor::read(text) {
                Some(cursor) => self.cursor = Some(cursor),
                None => return Err(invalid(name, "is not the next_cursor of a page")),
            },
            "format" => {
                self.format = Some(match text {
                    "json" => ResultFormat::Json,
                    "csv" => ResultFormat::Csv,
                    _ => {
                        let problem = format!("expected json or csv, got {}", quoted(text));
                        return Err(invalid(name, problem));
                    }
                });
            }
            _ => {
                let condition = filter(name, text)?;
                self.conditions.push(condition);
            }
        }
        Ok(())
    }

    fn of_time(
        &mut self,
        name: &str,
        text: &str,
        test: impl FnOnce(Cell) -> Test,
    ) -> Result<(), QueryError> {
        let column = column("created_at").expect("it is a column");
        let test = test(bound(name, column, text)?);
        self.conditions.push(Condition { column, test });
        Ok(())
    }
}

fn invalid(name: &str, problem: impl Into<String>) -> QueryError {
    QueryError::Invalid {
        name: name.to_owned(),
        problem: problem.into(),
    }
}

/// A text that was sent, shortened: it may be of any length.
fn quoted(text: &str) -> String {
    let start: String = text.chars().take(60).collect();
    let more = if start.len() < text.len() { "…" } else { "" };
    format!("{start:?}{more}")
}

fn yes_or_no(name: &str, text: &str) -> Result<bool, QueryError> {
    match text {
        "true" => Ok(true),
        "false" => Ok(false),
        _ => {
            let problem = format!("expected true or false, got {}", quoted(text));
            Err(invalid(name, problem))
        }
    }
}

fn sort_of(text: &str) -> Result<Sort, QueryError> {
    let (name, descending) = match text.strip_prefix('-') {
        Some(name) => (name, true),
        None => (text, false),
    };
    let column = column(name).ok_or_else(|| invalid("sort", no_column(name)))?;
    Ok(Sort { column, descending })
}

fn fields_of(text: &str) -> Result<Vec<&'static Column>, QueryError> {
    match text {
        "all" => return Ok(COLUMNS.iter().collect()),
        "usual" => return Ok(usual()),
        _ => {}
    }
    let mut fields: Vec<&'static Column> = Vec::new();
    for name in text.split(',').map(str::trim) {
        let column = column(name).ok_or_else(|| invalid("fields", no_column(name)))?;
        if !fields.contains(&column) {
            fields.push(column);
        }
    }
    Ok(fields)
}

fn no_column(name: &str) -> String {
    let known: Vec<&str> = COLUMNS.iter().map(|column| column.name).collect();
    let hint = match meant(name, &known) {
        Some(right) => format!("did you mean `{right}`?"),
        None => format!("expected one of {}", known.join(", ")),
    };
    format!("there is no column {}; {hint}", quoted(name))
}

/// Returns all names of parameters.
pub fn parameters() -> Vec<(&'static str, Option<&'static Column>)> {
    let general = GENERAL.iter().map(|(name, _)| (*name, None));
    let columns = COLUMNS.iter().map(|column| (column.name, Some(column)));
    general.chain(columns).collect()
}

fn unknown(name: &str) -> QueryError {
    let known: Vec<&str> = parameters().into_iter().map(|(name, _)| name).collect();
    let end = ["_min", "_max"].into_iter().find(|end| name.ends_with(end));
    let stem = end.map_or(name, |end| &name[..name.len() - end.len()]);
    let hint = match meant(stem, &known) {
        Some(right) => format!("did you mean `{right}{}`?", end.unwrap_or_default()),
        None => format!(
            "expected one of {}, or a number or time of them with _min or _max",
            known.join(", ")
        ),
    };
    QueryError::Unknown(format!("there is no parameter {}; {hint}", quoted(name)))
}

/// Reads a filter on a column.
fn filter(name: &str, text: &str) -> Result<Condition, QueryError> {
    if let Some(column) = column(name) {
        let test = match column.kind {
            Kind::Tags if !text.is_empty() => match tag_fault(text) {
                Some(problem) => return Err(invalid(name, problem)),
                None => Test::Has(text.to_owned()),
            },
            _ => Test::OneOf(wanted(column, text)?),
        };
        return Ok(Condition { column, test });
    }
    for (end, test) in [
        ("_min", Test::AtLeast as fn(Cell) -> Test),
        ("_max", Test::AtMost),
    ] {
        let Some(column) = name.strip_suffix(end).and_then(column) else {
            continue;
        };
        if !column.kind.has_range() {
            break;
        }
        let test = test(bound(name, column, text)?);
        return Ok(Condition { column, test });
    }
    Err(unknown(name))
}

/// Reads the values that a column may have.
fn wanted(column: &'static Column, text: &str) -> Result<Vec<Option<Cell>>, QueryError> {
    let name = column.name;
    match column.kind {
        Kind::Text | Kind::Tags if text.is_empty() => Ok(vec![None]),
        Kind::Tags => unreachable!("a tag is another test"),
        Kind::Flag => match text {
            "true" => Ok(vec![Some(Cell::Flag(true))]),
            "false" => Ok(vec![Some(Cell::Flag(false))]),
            "all" => Ok(vec![Some(Cell::Flag(false)), Some(Cell::Flag(true))]),
            _ => {
                let problem = format!("expected true, false or all, got {}", quoted(text));
                Err(invalid(name, problem))
            }
        },
        Kind::Text => Ok(vec![Some(Cell::Text(text.to_owned()))]),
        Kind::Word(words) => text
            .split(',')
            .map(|word| match word.trim() {
                "" => Ok(None),
                word if words.contains(&word) => Ok(Some(Cell::Text(word.to_owned()))),
                word => {
                    let known = words.join(", ");
                    let problem = format!("expected {known} or nothing, got {}", quoted(word));
                    Err(invalid(name, problem))
                }
            })
            .collect(),
        Kind::Id => Ok(vec![Some(bound(name, column, text)?)]),
        Kind::Real { .. } | Kind::Time => {
            let problem = format!("expected a range; use {name}_min and {name}_max");
            Err(invalid(name, problem))
        }
    }
}

/// Reads the end of a range.
fn bound(name: &str, column: &'static Column, text: &str) -> Result<Cell, QueryError> {
    let expected = |what: &str| invalid(name, format!("expected {what}, got {}", quoted(text)));
    match column.kind {
        Kind::Id => match text.parse() {
            Ok(id) => Ok(Cell::Id(id)),
            Err(_) => Err(expected("a whole number")),
        },
        Kind::Time => {
            let midnight = format!("{text}T00:00:00Z");
            let time = utc_of(text).or_else(|| utc_of(&midnight));
            let time = time.ok_or_else(|| expected("a time like 2026-03-02T09:00:00Z"))?;
            Ok(Cell::Text(utc_text(time)))
        }
        _ => match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Cell::Real(value)),
            _ => Err(expected("a number")),
        },
    }
}

#[cfg(test)]
mod tests;
