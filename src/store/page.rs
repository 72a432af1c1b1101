//! Lists page by page, the newest first, with the rows that cannot be read told beside the others.

use super::StoreError;

/// One page of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct Page<T> {
    /// The rows.
    pub items: Vec<T>,
    /// Hand it back to get the rows after these; `None` at the end.
    pub next_cursor: Option<i64>,
    /// Rows between these that cannot be read.
    pub damaged: Vec<DamagedRow>,
}

/// A row that does not hold what this program wrote into it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DamagedRow {
    /// Its number.
    pub id: i64,
    /// What is wrong with it.
    pub detail: String,
}

impl<T> Page<T> {
    /// Cuts `rows`, which were asked for with one more than `limit`, to a page.
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

    /// The same of rows as the database has them: one that is damaged hides no other.
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

/// Which part of a list is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageRequest {
    /// Rows at most.
    pub limit: u32,
    /// From the page before.
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
