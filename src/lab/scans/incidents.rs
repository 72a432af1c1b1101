//! The incidents of a scan, for what has to know all of them.

use crate::lab::LabError;
use crate::scan::Incident;
use crate::store::{PageRequest, Store, StoreError, utc_text};

/// Returns all alarms and recoveries of a scan, oldest first.
///
/// # Errors
/// An event that cannot be read, or a database error.
pub(in crate::lab) async fn incidents(
    store: &Store,
    scan_id: i64,
) -> Result<Vec<Incident>, LabError> {
    let mut all = Vec::new();
    let mut page = PageRequest {
        limit: 1000,
        cursor: None,
    };
    loop {
        let found = store.scan_events(scan_id, &Incident::KINDS, page).await?;
        if let Some(damaged) = found.damaged.first() {
            let detail = format!("event {}", damaged.id);
            return Err(StoreError::bad_row("events", detail).into());
        }
        all.extend(found.items.into_iter().filter_map(|recorded| {
            let at = utc_text(recorded.at);
            Incident::of(recorded, at)
        }));
        page.cursor = found.next_cursor;
        if page.cursor.is_none() {
            return Ok(all);
        }
    }
}
