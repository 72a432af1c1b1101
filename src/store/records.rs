//! Records of scans that people keep: tags, a note, and whether a scan is archived. Each change is a row with who made it;
//! nothing stored before changes, so a change is undone by another one.

use serde::{Deserialize, Serialize};
use sqlx::FromRow;

use super::samples::NOTE_LENGTH_MAX;
use super::{Page, PageRequest, Store, StoreError};

/// Longest tag, in characters.
pub const TAG_LENGTH_MAX: usize = 40;
/// Most tags of a scan.
pub const TAGS_MAX: usize = 20;

/// The record of a scan.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ScanRecord {
    /// Tags, in the order in which they were given.
    pub tags: Vec<String>,
    /// Free text.
    pub note: Option<String>,
    /// Whether lists leave the scan out unless they are asked for archived scans.
    pub archived: bool,
}

/// A record as it was after a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct RecordChange {
    /// Number of the change.
    pub id: i64,
    /// Who made it: the name of a token, or `local`.
    pub who: String,
    /// When, RFC 3339 in UTC.
    pub at: String,
    /// The record after it.
    #[serde(flatten)]
    pub record: ScanRecord,
}

/// A change of a record; what is not stated stays.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecordPatch {
    /// All tags from now on.
    pub tags: Option<Vec<String>>,
    /// The note from now on; `Some(None)` removes it.
    pub note: Option<Option<String>>,
    /// Whether the scan is archived from now on.
    pub archived: Option<bool>,
}

impl RecordPatch {
    /// Whether nothing is stated.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == RecordPatch::default()
    }

    /// Returns the field of the first invalid value, and what is wrong with it.
    #[must_use]
    pub fn fault(&self) -> Option<(&'static str, String)> {
        let tags = self.tags.as_deref().unwrap_or_default();
        if tags.len() > TAGS_MAX {
            let problem = format!("expected at most {TAGS_MAX} tags, got {}", tags.len());
            return Some(("tags", problem));
        }
        if let Some(problem) = tags.iter().find_map(|tag| tag_fault(tag)) {
            return Some(("tags", problem));
        }
        let note = self.note.as_ref().and_then(Option::as_deref);
        let length = note.unwrap_or_default().chars().count();
        (length > NOTE_LENGTH_MAX).then(|| {
            let problem = format!("expected at most {NOTE_LENGTH_MAX} characters, got {length}");
            ("note", problem)
        })
    }

    /// Returns the record after this change: tags without blanks around them, each once; an empty note is none.
    fn applied(&self, before: &ScanRecord) -> ScanRecord {
        let tags = self.tags.as_ref().map(|tags| {
            let mut each: Vec<String> = Vec::new();
            for tag in tags.iter().map(|tag| tag.trim()) {
                if !each.iter().any(|known| known == tag) {
                    each.push(tag.to_owned());
                }
            }
            each
        });
        let note = self.note.clone().unwrap_or_else(|| before.note.clone());
        ScanRecord {
            tags: tags.unwrap_or_else(|| before.tags.clone()),
            note: note.filter(|note| !note.trim().is_empty()),
            archived: self.archived.unwrap_or(before.archived),
        }
    }
}

/// Returns what is wrong with a tag. Commas separate tags, and quotes and backslashes would need escapes in queries.
#[must_use]
pub fn tag_fault(tag: &str) -> Option<String> {
    let length = tag.trim().chars().count();
    if !(1..=TAG_LENGTH_MAX).contains(&length) {
        return Some(format!(
            "expected tags of 1 to {TAG_LENGTH_MAX} characters, got {length}"
        ));
    }
    let wrong = |c: char| c.is_control() || [',', '"', '\\'].contains(&c);
    tag.chars().find(|c| wrong(*c)).map(|c| {
        format!("a tag has no comma, quote, backslash or control character, got {c:?}; use separate tags")
    })
}

/// The text that the JSON list of tags contains where it has this tag.
pub(super) fn tag_in_list(tag: &str) -> String {
    format!("\"{}\"", tag.trim())
}

#[derive(FromRow)]
struct RecordRow {
    id: i64,
    tags: String,
    note: Option<String>,
    archived: bool,
    who: String,
    at: String,
}

impl TryFrom<RecordRow> for RecordChange {
    type Error = StoreError;

    fn try_from(row: RecordRow) -> Result<RecordChange, StoreError> {
        Ok(RecordChange {
            id: row.id,
            who: row.who,
            at: row.at,
            record: record_of(Some(&row.tags), row.note, row.archived)?,
        })
    }
}

/// Reads a stored record.
pub(super) fn record_of(
    tags: Option<&str>,
    note: Option<String>,
    archived: bool,
) -> Result<ScanRecord, StoreError> {
    let tags = tags.map(serde_json::from_str).transpose();
    Ok(ScanRecord {
        tags: tags
            .map_err(|e| StoreError::bad_row("scan_records", e))?
            .unwrap_or_default(),
        note,
        archived,
    })
}

impl Store {
    /// Changes the record of a scan and returns it. A change to the same values is none.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn change_record(
        &self,
        id: i64,
        patch: &RecordPatch,
        who: &str,
    ) -> Result<ScanRecord, StoreError> {
        let mut transaction = self.writing().await?;
        let before: (Option<String>, Option<String>, bool) = sqlx::query_as(
            "SELECT k.tags, k.note, COALESCE(k.archived, 0) FROM scans s
             LEFT JOIN scan_records k ON k.id = (SELECT MAX(id) FROM scan_records WHERE scan_id = s.id) WHERE s.id = ?",
        )
        .bind(id)
        .fetch_optional(&mut *transaction)
        .await?
        .ok_or(StoreError::NotFound { noun: "scan", id })?;
        let before = record_of(before.0.as_deref(), before.1, before.2)?;
        let after = patch.applied(&before);
        if after == before {
            return Ok(after);
        }
        let tags = serde_json::to_string(&after.tags)
            .map_err(|e| StoreError::bad_row("scan_records", e))?;
        sqlx::query(
            "INSERT INTO scan_records (scan_id, tags, note, archived, who, at) VALUES (?, ?, ?, ?, ?, ?)",
        )
        .bind(id)
        .bind(tags)
        .bind(&after.note)
        .bind(after.archived)
        .bind(who)
        .bind(self.now_text())
        .execute(&mut *transaction)
        .await?;
        transaction.commit().await?;
        Ok(after)
    }

    /// Returns the changes of the record of a scan, oldest first.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn record_changes(
        &self,
        scan_id: i64,
        page: PageRequest,
    ) -> Result<Page<RecordChange>, StoreError> {
        self.scan(scan_id).await?;
        let rows: Vec<RecordRow> = sqlx::query_as(
            "SELECT id, tags, note, archived, who, at FROM scan_records WHERE scan_id = ? AND id > ? ORDER BY id LIMIT ?",
        )
        .bind(scan_id)
        .bind(page.cursor.unwrap_or(0))
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::read(rows, page.limit, |row: &RecordRow| row.id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::results::ResultQuery;
    use crate::store::scans::ScanFilter;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    fn tags(words: &[&str]) -> RecordPatch {
        RecordPatch {
            tags: Some(words.iter().map(|word| (*word).to_owned()).collect()),
            ..RecordPatch::default()
        }
    }

    fn note(text: Option<&str>) -> RecordPatch {
        RecordPatch {
            note: Some(text.map(str::to_owned)),
            ..RecordPatch::default()
        }
    }

    fn archived(archived: bool) -> RecordPatch {
        RecordPatch {
            archived: Some(archived),
            ..RecordPatch::default()
        }
    }

    #[tokio::test]
    async fn each_change_stays_with_who_made_it() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let id = planned(&store).await.id;
        let change = async |patch: RecordPatch, who: &str| {
            store.change_record(id, &patch, who).await.unwrap()
        };
        change(tags(&[" study 1 ", "first", "first"]), "anna").await;
        change(note(Some("scratch at the edge")), "ben").await;
        change(archived(true), "ben").await;
        // Nothing new is no change.
        change(archived(true), "carl").await;
        let now = change(note(Some("  ")), "anna").await;
        assert_eq!(
            (now.tags, now.note, now.archived),
            (vec!["study 1".to_owned(), "first".into()], None, true)
        );
        let undone = change(archived(false), "anna").await;
        assert!(!undone.archived);
        let all = store.record_changes(id, PageRequest::default()).await;
        let all = all.unwrap().items;
        let who: Vec<&str> = all.iter().map(|change| &*change.who).collect();
        assert_eq!(who, ["anna", "ben", "ben", "anna", "anna"]);
        assert_eq!(all[1].record.note.as_deref(), Some("scratch at the edge"));
        let after = PageRequest {
            cursor: Some(all[2].id),
            limit: 1,
        };
        let page = store.record_changes(id, after).await.unwrap();
        assert_eq!(page.items, [all[3].clone()]);
        assert_eq!(page.next_cursor, Some(all[3].id));
        let unknown = store.change_record(99, &archived(true), "anna").await;
        assert!(matches!(unknown, Err(StoreError::NotFound { .. })));
    }

    #[tokio::test]
    async fn lists_find_scans_by_tag_and_leave_archived_ones_out() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        for words in [&["study 1"][..], &["study 10", "b"], &["study 1", "b"]] {
            let id = planned(&store).await.id;
            store.change_record(id, &tags(words), "anna").await.unwrap();
        }
        store
            .change_record(3, &archived(true), "anna")
            .await
            .unwrap();
        let scans = async |tag: Option<&str>, archived| {
            let filter = ScanFilter {
                tag: tag.map(str::to_owned),
                archived,
                ..ScanFilter::default()
            };
            let found = store.scans(filter, PageRequest::default()).await.unwrap();
            found.items.iter().map(|scan| scan.id).collect::<Vec<_>>()
        };
        assert_eq!(scans(Some("study 1"), Some(false)).await, [1]);
        assert_eq!(scans(Some("study 1"), None).await, [3, 1]);
        assert_eq!(scans(None, Some(true)).await, [3]);
        assert_eq!(scans(Some("study"), None).await, Vec::<i64>::new());
        let results = async |parameters: &[(&str, &str)]| {
            let query = ResultQuery::read(parameters.iter().copied()).unwrap();
            let count = store.count_results(&query).await.unwrap();
            let rows = store.results(&query).await.unwrap().rows;
            assert_eq!(count, rows.len() as i64);
            rows.iter().map(|row| row.scan_id()).collect::<Vec<_>>()
        };
        assert_eq!(results(&[]).await, [2, 1]);
        assert_eq!(results(&[("tag", "study 1")]).await, [1]);
        assert_eq!(results(&[("tags", "b"), ("archived", "all")]).await, [3, 2]);
        assert_eq!(results(&[("archived", "true")]).await, [3]);
        assert_eq!(results(&[("search", "tudy 10")]).await, [2]);
        // A row that is made again keeps the record.
        let query = ResultQuery::read([("archived", "true"), ("fields", "archived,tags,note")]);
        let query = query.unwrap();
        store
            .change_record(3, &note(Some("later")), "anna")
            .await
            .unwrap();
        let sample = store.scan(2).await.unwrap().sample_id;
        store.assign_scan(3, sample, "other").await.unwrap();
        let rows = store.results(&query).await.unwrap().rows;
        let row = serde_json::to_value(rows[0].object(&query.fields)).unwrap();
        let expected =
            serde_json::json!({ "archived": true, "tags": ["study 1", "b"], "note": "later" });
        assert_eq!(row, expected);
        assert_eq!(
            rows[0].csv_line(&query.fields),
            "true,\"study 1, b\",later\n"
        );
    }

    #[test]
    fn what_is_too_long_or_not_a_tag_is_refused_with_the_limit() {
        let long = "x".repeat(TAG_LENGTH_MAX + 1);
        let many = vec!["a"; TAGS_MAX + 1];
        for (patch, field, part) in [
            (tags(&[&long]), "tags", "1 to 40 characters, got 41"),
            (tags(&["a", " "]), "tags", "got 0"),
            (tags(&["a,b"]), "tags", "no comma"),
            (tags(&["a\nb"]), "tags", "control character"),
            (tags(&many), "tags", "at most 20 tags, got 21"),
            (
                note(Some(&"é".repeat(4001))),
                "note",
                "at most 4000 characters, got 4001",
            ),
        ] {
            let (of, problem) = patch.fault().unwrap();
            assert_eq!(of, field);
            assert!(problem.contains(part), "{problem}");
        }
        assert_eq!(tags(&["größe 3.5/µm #1"]).fault(), None);
        assert!(RecordPatch::default().is_empty() && !note(None).is_empty());
    }
}
