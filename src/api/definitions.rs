//! What `/recipes` and `/specifications` share: definitions by name, in versions.

use axum::Json;
use serde::Deserialize;

use super::extract::{PageParams, page};
use super::status::ApiError;
use super::{App, List};
use crate::lab::LabError;
use crate::store::definitions::{Definition, DefinitionKind, Wanted};

/// One version of a definition, as it is sent.
pub(super) trait DefinitionBody: Sized {
    /// Kind of the definition.
    const KIND: DefinitionKind;

    /// Returns the body of a stored version.
    ///
    /// # Errors
    /// A content that this program cannot read.
    fn of(stored: Definition) -> Result<Self, LabError>;
}

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct DefinitionParams {
    /// The one of exactly this name.
    name: Option<String>,
    /// The archived ones instead of the others.
    archived: Option<bool>,
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Which version.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct VersionParams {
    /// The version; the newest one if omitted.
    version: Option<i64>,
}

pub(super) async fn list<B: DefinitionBody>(
    app: &App,
    params: DefinitionParams,
) -> Result<Json<List<B>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let (name, archived) = (params.name.as_deref(), params.archived.unwrap_or(false));
    let store = app.lab.store();
    let found = store.definitions(B::KIND, name, archived, page).await?;
    let mut list = List::after(&found);
    for stored in found.items {
        list.take(stored.id, B::of(stored))?;
    }
    Ok(Json(list))
}

pub(super) async fn one<B: DefinitionBody>(
    app: &App,
    id: i64,
    params: VersionParams,
) -> Result<Json<B>, ApiError> {
    let wanted = params.version.map_or(Wanted::Newest, Wanted::Version);
    let stored = app.lab.store().definition(B::KIND, id, wanted).await?;
    Ok(Json(B::of(stored)?))
}

pub(super) async fn versions<B: DefinitionBody>(
    app: &App,
    id: i64,
    params: PageParams,
) -> Result<Json<List<B>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let store = app.lab.store();
    let found = store.definition_versions(B::KIND, id, page).await?;
    let mut list = List::after(&found);
    for stored in found.items {
        list.take(stored.version, B::of(stored))?;
    }
    Ok(Json(list))
}

/// Archives a definition, or restores it.
pub(super) async fn archive<B: DefinitionBody>(
    app: &App,
    id: i64,
    archived: bool,
) -> Result<Json<B>, ApiError> {
    let lab = &app.lab;
    let stored = lab.archive_definition(B::KIND, id, archived).await?;
    Ok(Json(B::of(stored)?))
}
