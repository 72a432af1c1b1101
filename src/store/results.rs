//! Results: one short row per scan (per region where the sample has several), with filters on every column.
//!
//! Triggers of the database keep the table (`migrations/0019_results.sql` and later ones), so that no query reads a report. A page follows
//! its cursor by value, scan and region: rows that are added meanwhile move no other row to another page.

mod columns;
mod query;
mod rows;

use sqlx::sqlite::{Sqlite, SqliteRow};
use sqlx::{QueryBuilder, Row as _};

use super::records::tag_in_list;
use super::{Store, StoreError};
use columns::place;
use query::{Condition, Cursor, Test};

pub use columns::{ARCHIVED, COLUMNS, Column, Kind, column};
pub use query::{
    Cell, GENERAL, LIMIT_MAX, LIMIT_USUAL, OF_THE_PAGE, QueryError, ResultFormat, ResultQuery,
    parameters,
};
pub use rows::{ROW_BYTES_MAX, ResultRow, RowObject, csv_header};

/// A page of results.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultPage {
    /// At most as many as the query limits, in its order.
    pub rows: Vec<ResultRow>,
    /// Cursor of the next page; `None` at the end.
    pub next_cursor: Option<String>,
}

/// All rows of a query, or as many as it limits, page by page.
#[derive(Debug)]
pub struct ResultPages {
    store: Store,
    query: ResultQuery,
    /// Rows that may still be read.
    rest: u32,
}

impl ResultPages {
    /// Begins with the first page.
    #[must_use]
    pub fn new(store: Store, query: ResultQuery) -> Self {
        let rest = query.limit.unwrap_or(u32::MAX);
        ResultPages { store, query, rest }
    }

    /// Returns the next rows; none after the last one.
    ///
    /// # Errors
    /// A database error.
    pub async fn next(&mut self) -> Result<Option<Vec<ResultRow>>, StoreError> {
        if self.rest == 0 {
            return Ok(None);
        }
        let limit = self.rest.min(LIMIT_MAX);
        self.query.limit = Some(limit);
        let page = self.store.results(&self.query).await?;
        self.rest = match page.next_cursor {
            Some(_) => self.rest - limit,
            None => 0,
        };
        self.query.continue_at(page.next_cursor.as_deref());
        Ok(Some(page.rows))
    }

    /// Returns the next rows as lines of a CSV, with the pages after them.
    ///
    /// # Errors
    /// A database error.
    pub async fn next_lines(mut self) -> Result<Option<(String, ResultPages)>, StoreError> {
        let rows = self.next().await?;
        Ok(rows.map(|rows| {
            let fields = &self.query.fields;
            let lines = rows.iter().map(|row| row.csv_line(fields)).collect();
            (lines, self)
        }))
    }
}

impl Store {
    /// Returns a page of results.
    ///
    /// # Errors
    /// A database error.
    pub async fn results(&self, query: &ResultQuery) -> Result<ResultPage, StoreError> {
        let limit = query.limit.unwrap_or(LIMIT_USUAL) as usize;
        let mut rows = Vec::new();
        let is_among_nulls = |cursor: &Cursor| cursor.value == Cell::Null;
        // Rows with a value, then rows without one, in either order.
        if !query.cursor.as_ref().is_some_and(is_among_nulls) {
            rows = self.result_rows(query, true, limit + 1).await?;
        }
        if rows.len() <= limit {
            let rest = limit + 1 - rows.len();
            rows.extend(self.result_rows(query, false, rest).await?);
        }
        let is_more = rows.len() > limit;
        rows.truncate(limit);
        let last = rows.last().filter(|_| is_more);
        let next_cursor = last.map(|row| {
            let value = row.cell(query.sort.column).clone();
            Cursor::after(query.sort, value, row.scan_id(), row.region().to_owned()).text()
        });
        Ok(ResultPage { rows, next_cursor })
    }

    /// Counts the results that the filters select.
    ///
    /// # Errors
    /// A database error.
    pub async fn count_results(&self, query: &ResultQuery) -> Result<i64, StoreError> {
        let mut sql = QueryBuilder::new("SELECT COUNT(*) FROM results WHERE 1");
        select(&mut sql, query);
        let count = sql.build_query_scalar().fetch_one(self.readers()).await?;
        Ok(count)
    }

    /// Returns when the newest scan with a converged fit of a part of this name was started or imported, at or before
    /// `until` (both RFC 3339 UTC). Archived scans do not count.
    ///
    /// # Errors
    /// A database error.
    pub async fn last_measured(
        &self,
        part: &str,
        until: &str,
    ) -> Result<Option<String>, StoreError> {
        let last = sqlx::query_scalar(
            "SELECT MAX(created_at) FROM results
             WHERE part = ? AND status = 'converged' AND archived = 0 AND created_at <= ?",
        )
        .bind(part)
        .bind(until)
        .fetch_one(self.readers())
        .await?;
        Ok(last)
    }

    /// Returns rows with or without a value in the column of the order.
    async fn result_rows(
        &self,
        query: &ResultQuery,
        has_value: bool,
        limit: usize,
    ) -> Result<Vec<ResultRow>, StoreError> {
        let by = expression(query.sort.column);
        let (than, order) = match query.sort.descending {
            true => ("<", "DESC"),
            false => (">", "ASC"),
        };
        let mut sql = QueryBuilder::new("SELECT ");
        let mut values = sql.separated(", ");
        for column in COLUMNS {
            values.push(expression(column));
        }
        let is = if has_value { "IS NOT NULL" } else { "IS NULL" };
        sql.push(format!(" FROM results WHERE {by} {is}"));
        let is_here = |cursor: &&Cursor| has_value != (cursor.value == Cell::Null);
        if let Some(cursor) = query.cursor.as_ref().filter(is_here) {
            if has_value {
                sql.push(format!(" AND ({by}, scan_id, region) {than} ("));
                push(&mut sql, &cursor.value);
                sql.push(", ");
            } else {
                sql.push(format!(" AND (scan_id, region) {than} ("));
            }
            sql.push_bind(cursor.scan_id).push(", ");
            sql.push_bind(cursor.region.clone()).push(")");
        }
        select(&mut sql, query);
        sql.push(format!(
            " ORDER BY {by} {order}, scan_id {order}, region {order} LIMIT "
        ));
        sql.push_bind(limit as i64);
        let found = sql.build().fetch_all(self.readers()).await?;
        found
            .iter()
            .map(|row| {
                let cells = COLUMNS.iter().map(|column| cell(row, column));
                cells.collect::<Result<_, _>>().map(ResultRow::new)
            })
            .collect()
    }
}

/// SQL of the value of a column: a part of the key cannot be NULL.
fn expression(column: &Column) -> &'static str {
    match column.name {
        "region" => "NULLIF(region, '')",
        _ => COLUMNS[place(column)].name,
    }
}

/// Adds all filters of a query.
fn select(sql: &mut QueryBuilder<Sqlite>, query: &ResultQuery) {
    for condition in &query.conditions {
        restrict(sql, condition);
    }
    leave_archived_out(sql, query);
    search(sql, query);
    if query.latest {
        // Grouping by an expression reads the table in its order, which takes a fifth of the time of single look-ups.
        sql.push(
            " AND fit_id IS NOT NULL
              AND scan_id IN (SELECT MAX(scan_id) FROM results WHERE fit_id IS NOT NULL",
        );
        for condition in query.conditions.iter().filter(|c| c.column.is_of_scan) {
            restrict(sql, condition);
        }
        leave_archived_out(sql, query);
        search(sql, query);
        sql.push(" GROUP BY +sample_id)");
    }
}

fn leave_archived_out(sql: &mut QueryBuilder<Sqlite>, query: &ResultQuery) {
    if !query.conditions.iter().any(|c| c.column.name == ARCHIVED) {
        sql.push(" AND archived = 0");
    }
}

/// Columns in which `search` looks.
const SEARCHED: [&str; 8] = [
    "part",
    "lot",
    "recipe",
    "external_id",
    "operator_name",
    "specification",
    "tags",
    "note",
];

fn search(sql: &mut QueryBuilder<Sqlite>, query: &ResultQuery) {
    let Some(text) = &query.search else { return };
    let mut pattern = String::from("%");
    for c in text.chars() {
        if matches!(c, '%' | '_' | '\\') {
            pattern.push('\\');
        }
        pattern.push(c);
    }
    pattern.push('%');
    sql.push(" AND (0");
    for name in SEARCHED {
        sql.push(format!(" OR {name} LIKE "));
        sql.push_bind(pattern.clone()).push(" ESCAPE '\\'");
    }
    sql.push(")");
}

fn restrict(sql: &mut QueryBuilder<Sqlite>, condition: &Condition) {
    let name = expression(condition.column);
    sql.push(format!(" AND ({name}"));
    match &condition.test {
        Test::AtLeast(bound) => push(sql.push(" >= "), bound),
        Test::AtMost(bound) => push(sql.push(" <= "), bound),
        Test::Below(bound) => push(sql.push(" < "), bound),
        Test::Has(tag) => {
            // Cheaper than reading the list: a tag has no quotes.
            sql.push(" IS NOT NULL AND instr(tags, ");
            sql.push_bind(tag_in_list(tag)).push(")");
        }
        Test::OneOf(values) => {
            sql.push(" IN (");
            let mut first = true;
            for value in values.iter().flatten() {
                sql.push(if first { "" } else { ", " });
                push(sql, value);
                first = false;
            }
            sql.push(")");
            if values.contains(&None) {
                sql.push(format!(" OR {name} IS NULL"));
            }
        }
    }
    sql.push(")");
}

fn push(sql: &mut QueryBuilder<Sqlite>, value: &Cell) {
    match value {
        Cell::Null => sql.push("NULL"),
        Cell::Id(id) => sql.push_bind(*id),
        Cell::Real(value) => sql.push_bind(*value),
        Cell::Text(text) => sql.push_bind(text.clone()),
        Cell::Flag(flag) => sql.push_bind(*flag),
        Cell::Tags(tags) => sql.push_bind(serde_json::to_string(tags).expect("texts are JSON")),
    };
}

fn cell(row: &SqliteRow, column: &'static Column) -> Result<Cell, StoreError> {
    let at = place(column);
    let cell = match column.kind {
        Kind::Id => row.try_get::<Option<i64>, _>(at)?.map(Cell::Id),
        Kind::Real { .. } => row.try_get::<Option<f64>, _>(at)?.map(Cell::Real),
        Kind::Text | Kind::Word(_) | Kind::Time => {
            row.try_get::<Option<String>, _>(at)?.map(Cell::Text)
        }
        Kind::Flag => row.try_get::<Option<bool>, _>(at)?.map(Cell::Flag),
        Kind::Tags => {
            let list = row.try_get::<Option<String>, _>(at)?;
            let tags = list.as_deref().map(serde_json::from_str).transpose();
            let tags = tags.map_err(|e| StoreError::bad_row("results", e))?;
            tags.map(Cell::Tags)
        }
    };
    Ok(cell.unwrap_or(Cell::Null))
}

#[cfg(test)]
mod tests;
