//! Pages of lists, newest first; rows that cannot be read are listed beside the others.

use super::StoreError;

/// One page of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct Page<T> {
    /// The rows.
    pub items: Vec<T>,
    /// Cursor of the next page; `None` at the end.
    pub next_cursor: Option<i64>,
    /// Rows of this page that cannot be read.
    pub damaged: Vec<DamagedRow>,
}

/// A row that the store cannot read.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, utoipa::ToSchema)]
#[schema(as = DamagedBody)]
pub struct DamagedRow {
    /// Number of the row.
    pub id: i64,
    /// What is wrong with it.
    pub detail: String,
}

impl<T> Page<T> {
    /// Cuts `rows`, which were queried with `limit` + 1, to a page.
    pub(super) fn cut(mut rows: Vec<T>, limit: u32, id_of: impl Fn(&T) -> i64) -> Self {
        let more = rows.len() > limit as usize;
        rows.truncate(limit as usize);
        let next_cursor = if more { rows.last().map(id_of) } else { None };
        Page {
            items: rows,
            next_cursor,
            damaged: Vec::new(),
        }
    }

    /// Does the same with raw rows: a damaged row does not hide the others.
    pub(super) fn read<R>(rows: Vec<R>, limit: u32, id_of: impl Fn(&R) -> i64) -> Self
    where
        T: TryFrom<R, Error = StoreError>,
    {
        let cut = Page::cut(rows, limit, &id_of);
        let mut page = Page {
            items: Vec::with_capacity(cut.items.len()),
            next_cursor: cut.next_cursor,
            damaged: Vec::new(),
        };
        for row in cut.items {
            let id = id_of(&row);
            match T::try_from(row) {
                Ok(item) => page.items.push(item),
                Err(error) => page.damaged.push(DamagedRow {
                    id,
                    detail: error.to_string(),
                }),
            }
        }
        page
    }
}

/// Selects a page of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageRequest {
    /// Largest number of rows.
    pub limit: u32,
    /// Cursor of the previous page.
    pub cursor: Option<i64>,
}

impl Default for PageRequest {
    fn default() -> Self {
        PageRequest {
            limit: 100,
            cursor: None,
        }
    }
}
