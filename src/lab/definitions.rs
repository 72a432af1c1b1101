//! Recipes and specifications: checked, stored in versions, and found by name or number.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::request_checks::invalid;
use super::{Lab, LabError};
use crate::store::definitions::{Definition, DefinitionKind, Wanted};
use crate::store::{Store, StoreError};
use crate::wording::{is_blank, json};

/// Longest name of a definition, in characters.
const NAME_LENGTH_MAX: usize = 200;

/// A recipe or specification by its number, or by its name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged, expecting = "a name or a number is expected")]
pub enum NameOrId {
    /// Number.
    Id(i64),
    /// Name; digits that are no name count as the number.
    Name(String),
}

/// What a definition contains.
pub trait Content: Serialize + DeserializeOwned {
    /// Kind of the definition.
    const KIND: DefinitionKind;

    /// Its name.
    fn name(&self) -> &str;

    /// Refuses content that cannot be used.
    ///
    /// # Errors
    /// The field that is wrong, and what is allowed.
    fn check(&self, lab: &Lab) -> Result<(), LabError>;
}

/// Reads stored content.
///
/// # Errors
/// A content that this program cannot read.
pub fn read<C: DeserializeOwned>(content: &Value) -> Result<C, LabError> {
    json::from_value(content).map_err(|refusal| {
        let detail = format!("{}: {}", refusal.path(), refusal.message("field"));
        StoreError::bad_row("definition_versions", detail).into()
    })
}

/// Returns the newest version of a definition that is not archived; `field` names the reference in errors.
pub(super) async fn find(
    store: &Store,
    kind: DefinitionKind,
    wanted: &NameOrId,
    field: &str,
) -> Result<Definition, LabError> {
    let noun = kind.as_str();
    let by_id = async |id| match store.definition(kind, id, Wanted::Newest).await {
        Ok(found) => Ok(Some(found)),
        Err(StoreError::NotFound { .. }) => Ok(None),
        Err(error) => Err(error),
    };
    let (found, words) = match wanted {
        NameOrId::Id(id) => (by_id(*id).await?, id.to_string()),
        NameOrId::Name(name) => {
            let named = store.definition_named(kind, name).await?;
            let found = match (named, name.parse()) {
                (None, Ok(id)) => by_id(id).await?,
                (named, _) => named,
            };
            let short: String = name.chars().take(NAME_LENGTH_MAX).collect();
            (found, format!("`{short}`"))
        }
    };
    match found {
        Some(found) if found.archived => Err(invalid(
            field,
            format!("{noun} {words} is archived; restore it, or name another one"),
        )),
        Some(found) => Ok(found),
        None => Err(invalid(
            field,
            format!(
                "there is no {noun} {words}; `ridged {noun} list` or GET /api/v1/{noun}s lists them"
            ),
        )),
    }
}

impl Lab {
    /// Adds a recipe or specification in version 1.
    ///
    /// # Errors
    /// [`LabError::Invalid`] or [`LabError::Plan`] for content that cannot be used, [`StoreError::NameTaken`], or a store
    /// error.
    pub async fn add_definition<C: Content>(&self, content: &C) -> Result<Definition, LabError> {
        let json = self.checked(content)?;
        let added = self
            .store()
            .add_definition(C::KIND, content.name(), &json, &self.who)
            .await?;
        self.record_change("added", C::KIND, &added).await;
        Ok(added)
    }

    /// Adds a version that replaces version `replaces`, which has to be the newest one. Content that equals the newest
    /// version is no change.
    ///
    /// # Errors
    /// As [`Lab::add_definition`], and [`StoreError::VersionConflict`].
    pub async fn add_version<C: Content>(
        &self,
        id: i64,
        replaces: i64,
        content: &C,
    ) -> Result<Definition, LabError> {
        let before = self.store().definition(C::KIND, id, Wanted::Newest).await?;
        if content.name() != before.name {
            return Err(invalid(
                "name",
                format!(
                    "{} {id} keeps its name `{}`; add another one to have another name",
                    C::KIND.as_str(),
                    before.name
                ),
            ));
        }
        let json = self.checked(content)?;
        let saved = self
            .store()
            .add_version(C::KIND, id, replaces, &json, &self.who)
            .await?;
        if saved.version != before.version {
            self.record_change("changed", C::KIND, &saved).await;
        }
        Ok(saved)
    }

    /// Archives a recipe or specification, or restores it.
    ///
    /// # Errors
    /// An unknown number, or a store error.
    pub async fn archive_definition(
        &self,
        kind: DefinitionKind,
        id: i64,
        archived: bool,
    ) -> Result<Definition, LabError> {
        let store = self.store();
        let definition = store
            .archive_definition(kind, id, archived, &self.who)
            .await?;
        let done = if archived { "archived" } else { "restored" };
        self.record_change(done, kind, &definition).await;
        Ok(definition)
    }

    fn checked<C: Content>(&self, content: &C) -> Result<Value, LabError> {
        let name = content.name();
        let length = name.chars().count();
        let fits = (1..=NAME_LENGTH_MAX).contains(&length);
        if name.trim() != name || is_blank(name) || !fits || name.contains(char::is_control) {
            let problem = format!(
                "must have 1 to {NAME_LENGTH_MAX} characters, one of them visible, without line breaks and blanks at its ends"
            );
            return Err(invalid("name", problem));
        }
        content.check(self)?;
        serde_json::to_value(content)
            .map_err(|e| StoreError::bad_row("definition_versions", e).into())
    }

    async fn record_change(&self, done: &str, kind: DefinitionKind, changed: &Definition) {
        let noun = kind.as_str();
        let (name, version) = (&changed.name, changed.version);
        self.record_order(format!("{noun} {name} {done}, version {version}"), None)
            .await;
    }
}
