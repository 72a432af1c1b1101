//! Recipes and specifications: definitions by name, in versions. The store knows their names, not what they contain.

use serde::{Deserialize, Serialize};
use sqlx::FromRow;
use sqlx::sqlite::SqliteConnection;

use super::{Page, PageRequest, Store, StoreError};

/// Kind of a definition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DefinitionKind {
    /// How a part is measured.
    Recipe,
    /// Limits of a part.
    Specification,
}

impl DefinitionKind {
    /// The word used in messages and the database.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            DefinitionKind::Recipe => "recipe",
            DefinitionKind::Specification => "specification",
        }
    }
}

/// One version of a definition.
#[derive(Debug, Clone, PartialEq)]
pub struct Definition {
    /// Number within the kind.
    pub id: i64,
    /// Name; unique within the kind.
    pub name: String,
    /// This version, from 1.
    pub version: i64,
    /// Row of this version.
    pub version_id: i64,
    /// Number of the newest version.
    pub newest: i64,
    /// JSON of the content.
    pub content: serde_json::Value,
    /// Whether it is archived.
    pub archived: bool,
    /// Who saved this version.
    pub who: String,
    /// When this version was saved, RFC 3339 UTC.
    pub at: String,
}

/// The version of a definition that a scan used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DefinitionRef {
    /// Number of the recipe or specification.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// The version that was used, from 1.
    pub version: i64,
}

/// SQL for the [`DefinitionRef`] whose version row is `column`, as JSON; NULL where there is none.
pub(super) fn reference(column: &str) -> String {
    format!(
        "(SELECT json_object('id', d.number, 'name', d.name, 'version', v.version) FROM definition_versions v
          JOIN definitions d ON d.id = v.definition_id WHERE v.id = {column})"
    )
}

/// Reads what [`reference`] selects.
pub(super) fn referenced(
    json: Option<&str>,
    table: &'static str,
) -> Result<Option<DefinitionRef>, StoreError> {
    let read = json.map(serde_json::from_str).transpose();
    read.map_err(|e| StoreError::bad_row(table, e))
}

#[derive(FromRow)]
struct DefinitionRow {
    id: i64,
    name: String,
    version: i64,
    version_id: i64,
    newest: i64,
    content: String,
    archived: bool,
    who: String,
    at: String,
}

impl TryFrom<DefinitionRow> for Definition {
    type Error = StoreError;

    fn try_from(row: DefinitionRow) -> Result<Definition, StoreError> {
        let content = serde_json::from_str(&row.content);
        Ok(Definition {
            id: row.id,
            name: row.name,
            version: row.version,
            version_id: row.version_id,
            newest: row.newest,
            content: content.map_err(|e| StoreError::bad_row("definition_versions", e))?,
            archived: row.archived,
            who: row.who,
            at: row.at,
        })
    }
}

/// Every version; `v.version = n.newest` selects the newest ones.
const SELECT: &str =
    "SELECT d.number AS id, d.name, v.version, v.id AS version_id, n.newest, v.content, v.who, v.at,
       COALESCE((SELECT a.archived FROM definition_archivals a WHERE a.definition_id = d.id ORDER BY a.id DESC LIMIT 1), 0) AS archived
     FROM definitions d
     JOIN (SELECT definition_id, MAX(version) AS newest FROM definition_versions GROUP BY definition_id) n ON n.definition_id = d.id
     JOIN definition_versions v ON v.definition_id = d.id";

/// Which version of a definition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// The newest one.
    Newest,
    /// The one with this number.
    Version(i64),
}

impl Store {
    /// Adds a definition in version 1.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`], or a database error.
    pub async fn add_definition(
        &self,
        kind: DefinitionKind,
        name: &str,
        content: &serde_json::Value,
        who: &str,
    ) -> Result<Definition, StoreError> {
        let mut transaction = self.writing().await?;
        let taken: Option<i64> =
            sqlx::query_scalar("SELECT number FROM definitions WHERE kind = ? AND name = ?")
                .bind(kind.as_str())
                .bind(name)
                .fetch_optional(&mut *transaction)
                .await?;
        if let Some(id) = taken {
            drop(transaction);
            let taken = self.definition(kind, id, Wanted::Newest).await?;
            return Err(StoreError::NameTaken {
                noun: kind.as_str(),
                name: taken.name,
                id,
                version: taken.version,
                archived: taken.archived,
            });
        }
        // Rows are never deleted, so no number is used twice.
        let (row, id): (i64, i64) = sqlx::query_as(
            "INSERT INTO definitions (kind, number, name, created_at)
             VALUES (?1, (SELECT COALESCE(MAX(number), 0) + 1 FROM definitions WHERE kind = ?1), ?2, ?3) RETURNING id, number",
        )
        .bind(kind.as_str())
        .bind(name)
        .bind(self.now_text())
        .fetch_one(&mut *transaction)
        .await?;
        self.insert_version(&mut transaction, row, 1, content, who)
            .await?;
        transaction.commit().await?;
        self.definition(kind, id, Wanted::Newest).await
    }

    /// Adds a version of a definition. It replaces version `replaces`, which has to be the newest one, so that no change of
    /// another caller is lost; content that equals the newest version is no change.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::VersionConflict`], or a database error.
    pub async fn add_version(
        &self,
        kind: DefinitionKind,
        id: i64,
        replaces: i64,
        content: &serde_json::Value,
        who: &str,
    ) -> Result<Definition, StoreError> {
        let mut transaction = self.writing().await?;
        let sql = format!("{SELECT} WHERE d.kind = ? AND d.number = ? AND v.version = n.newest");
        let newest: Definition = sqlx::query_as::<_, DefinitionRow>(sqlx::AssertSqlSafe(sql))
            .bind(kind.as_str())
            .bind(id)
            .fetch_optional(&mut *transaction)
            .await?
            .ok_or(not_found(kind, id))?
            .try_into()?;
        if newest.content == *content {
            return Ok(newest);
        }
        if newest.version != replaces {
            return Err(StoreError::VersionConflict {
                noun: kind.as_str(),
                name: newest.name,
                replaces,
                newest: newest.version,
                who: newest.who,
            });
        }
        let row = self.definition_row(&mut transaction, kind, id).await?;
        self.insert_version(&mut transaction, row, newest.version + 1, content, who)
            .await?;
        transaction.commit().await?;
        self.definition(kind, id, Wanted::Newest).await
    }

    async fn definition_row(
        &self,
        transaction: &mut SqliteConnection,
        kind: DefinitionKind,
        id: i64,
    ) -> Result<i64, StoreError> {
        sqlx::query_scalar("SELECT id FROM definitions WHERE kind = ? AND number = ?")
            .bind(kind.as_str())
            .bind(id)
            .fetch_optional(transaction)
            .await?
            .ok_or(not_found(kind, id))
    }

    async fn insert_version(
        &self,
        transaction: &mut SqliteConnection,
        row: i64,
        version: i64,
        content: &serde_json::Value,
        who: &str,
    ) -> Result<(), StoreError> {
        sqlx::query(
            "INSERT INTO definition_versions (definition_id, version, content, who, at) VALUES (?, ?, ?, ?, ?)",
        )
        .bind(row)
        .bind(version)
        .bind(content.to_string())
        .bind(who)
        .bind(self.now_text())
        .execute(transaction)
        .await?;
        Ok(())
    }

    /// Archives a definition, or restores it. Its versions stay.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn archive_definition(
        &self,
        kind: DefinitionKind,
        id: i64,
        archived: bool,
        who: &str,
    ) -> Result<Definition, StoreError> {
        if self.definition(kind, id, Wanted::Newest).await?.archived != archived {
            let mut transaction = self.writing().await?;
            let row = self.definition_row(&mut transaction, kind, id).await?;
            sqlx::query("INSERT INTO definition_archivals (definition_id, archived, who, at) VALUES (?, ?, ?, ?)")
                .bind(row)
                .bind(archived)
                .bind(who)
                .bind(self.now_text())
                .execute(&mut *transaction)
                .await?;
            transaction.commit().await?;
        }
        self.definition(kind, id, Wanted::Newest).await
    }

    /// Returns one version of a definition.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn definition(
        &self,
        kind: DefinitionKind,
        id: i64,
        wanted: Wanted,
    ) -> Result<Definition, StoreError> {
        let version = match wanted {
            Wanted::Newest => None,
            Wanted::Version(version) => Some(version),
        };
        let sql = format!(
            "{SELECT} WHERE d.kind = ?1 AND d.number = ?2 AND v.version = COALESCE(?3, n.newest)"
        );
        let found = sqlx::query_as::<_, DefinitionRow>(sqlx::AssertSqlSafe(sql))
            .bind(kind.as_str())
            .bind(id)
            .bind(version)
            .fetch_optional(self.readers())
            .await?;
        match (found, version) {
            (Some(row), _) => row.try_into(),
            (None, None) => Err(not_found(kind, id)),
            (None, Some(version)) => {
                let newest = Box::pin(self.definition(kind, id, Wanted::Newest)).await?;
                Err(StoreError::NoVersion {
                    noun: kind.as_str(),
                    name: newest.name,
                    version,
                    newest: newest.version,
                })
            }
        }
    }

    /// Returns the newest version of the definition with this name; archived ones, too.
    ///
    /// # Errors
    /// A database error.
    pub async fn definition_named(
        &self,
        kind: DefinitionKind,
        name: &str,
    ) -> Result<Option<Definition>, StoreError> {
        let id = sqlx::query_scalar("SELECT number FROM definitions WHERE kind = ? AND name = ?")
            .bind(kind.as_str())
            .bind(name)
            .fetch_optional(self.readers())
            .await?;
        match id {
            Some(id) => Ok(Some(self.definition(kind, id, Wanted::Newest).await?)),
            None => Ok(None),
        }
    }

    /// Returns the newest versions of the definitions that are archived or not, newest definition first; with `name`, only
    /// of this name.
    ///
    /// # Errors
    /// A database error; a row that cannot be read is listed beside the others.
    pub async fn definitions(
        &self,
        kind: DefinitionKind,
        name: Option<&str>,
        archived: bool,
        page: PageRequest,
    ) -> Result<Page<Definition>, StoreError> {
        let sql = format!(
            "SELECT * FROM ({SELECT} WHERE d.kind = ?1 AND v.version = n.newest)
             WHERE archived = ?2 AND (?3 IS NULL OR id < ?3) AND (?4 IS NULL OR name = ?4) ORDER BY id DESC LIMIT ?5"
        );
        let rows = sqlx::query_as::<_, DefinitionRow>(sqlx::AssertSqlSafe(sql))
            .bind(kind.as_str())
            .bind(archived)
            .bind(page.cursor)
            .bind(name)
            .bind(page.limit + 1)
            .fetch_all(self.readers())
            .await?;
        Ok(Page::read(rows, page.limit, |row: &DefinitionRow| row.id))
    }

    /// Returns the versions of a definition, newest first.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn definition_versions(
        &self,
        kind: DefinitionKind,
        id: i64,
        page: PageRequest,
    ) -> Result<Page<Definition>, StoreError> {
        self.definition(kind, id, Wanted::Newest).await?;
        let sql = format!(
            "{SELECT} WHERE d.kind = ?1 AND d.number = ?2 AND (?3 IS NULL OR v.version < ?3) ORDER BY v.version DESC LIMIT ?4"
        );
        let rows = sqlx::query_as::<_, DefinitionRow>(sqlx::AssertSqlSafe(sql))
            .bind(kind.as_str())
            .bind(id)
            .bind(page.cursor)
            .bind(page.limit + 1)
            .fetch_all(self.readers())
            .await?;
        Ok(Page::read(rows, page.limit, |row: &DefinitionRow| {
            row.version
        }))
    }
}

const fn not_found(kind: DefinitionKind, id: i64) -> StoreError {
    StoreError::NotFound {
        noun: kind.as_str(),
        id,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::open;
    use serde_json::json;

    const KIND: DefinitionKind = DefinitionKind::Recipe;

    #[tokio::test]
    async fn a_change_is_a_new_version_and_no_change_of_another_caller_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let [one, two, three] = [1, 2, 3].map(|a| json!({ "a": a }));
        // Numbers count within the kind.
        let limits = DefinitionKind::Specification;
        let other = store.add_definition(limits, "PX-1", &one, "bert").await;
        assert_eq!(other.unwrap().id, 1);
        let first = store.add_definition(KIND, "PX-1", &one, "anna").await;
        let first = first.unwrap();
        assert_eq!((first.id, first.version, first.newest), (1, 1, 1));
        let taken = store.add_definition(KIND, "PX-1", &two, "bert").await;
        let (id, version) = match taken {
            Err(StoreError::NameTaken { id, version, .. }) => (id, version),
            other => panic!("{other:?}"),
        };
        assert_eq!((id, version), (1, 1));
        let second = store.add_version(KIND, 1, 1, &two, "bert").await.unwrap();
        assert_eq!((second.version, second.who.as_str()), (2, "bert"));
        // The same content again, as after a lost answer, is no change.
        let again = store.add_version(KIND, 1, 1, &two, "bert").await;
        assert_eq!(again.unwrap(), second);
        let lost = store.add_version(KIND, 1, 1, &three, "anna").await;
        let says = lost.unwrap_err().to_string();
        assert!(says.contains("version 2 by bert"), "{says}");
        let earlier = store.definition(KIND, 1, Wanted::Version(1)).await;
        let earlier = earlier.unwrap();
        assert_eq!((earlier.content, earlier.newest), (one, 2));
        let none = store.definition(KIND, 1, Wanted::Version(9)).await;
        assert!(matches!(none, Err(StoreError::NoVersion { newest: 2, .. })));
        let unknown = store.add_version(KIND, 7, 1, &two, "anna").await;
        assert!(matches!(unknown, Err(StoreError::NotFound { id: 7, .. })));
        let all = store.definition_versions(KIND, 1, PageRequest::default());
        let all: Vec<i64> = all.await.unwrap().items.iter().map(|d| d.version).collect();
        assert_eq!(all, [2, 1]);
    }

    #[tokio::test]
    async fn an_archived_definition_is_not_listed_and_keeps_its_name_and_versions() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        for name in ["one", "two"] {
            store
                .add_definition(KIND, name, &json!({}), "anna")
                .await
                .unwrap();
        }
        let listed = async |archived| -> Vec<String> {
            let page = store.definitions(KIND, None, archived, PageRequest::default());
            page.await
                .unwrap()
                .items
                .into_iter()
                .map(|d| d.name)
                .collect()
        };
        assert!(
            store
                .archive_definition(KIND, 1, true, "bert")
                .await
                .unwrap()
                .archived
        );
        assert_eq!(
            (listed(false).await, listed(true).await),
            (vec!["two".to_owned()], vec!["one".to_owned()])
        );
        let taken = store.add_definition(KIND, "one", &json!({}), "anna").await;
        assert!(matches!(
            taken,
            Err(StoreError::NameTaken { archived: true, .. })
        ));
        let named = store.definition_named(KIND, "one").await.unwrap().unwrap();
        assert!(named.archived);
        assert!(
            !store
                .archive_definition(KIND, 1, false, "bert")
                .await
                .unwrap()
                .archived
        );
        assert_eq!(listed(false).await, ["two", "one"]);
    }
}
