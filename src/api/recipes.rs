//! `/recipes`: how parts are measured, by name and in versions.

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{Body, Id, PageParams, Params, page};
use super::status::{self, ApiError, Problem};
use super::{App, List};
use crate::lab::{LabError, Recipe};
use crate::store::definitions::{Definition, DefinitionKind, Wanted};

const KIND: DefinitionKind = DefinitionKind::Recipe;

/// One version of a recipe.
#[derive(Debug, Serialize, ToSchema)]
pub struct RecipeBody {
    /// Number of the recipe.
    id: i64,
    /// Its name.
    name: String,
    /// This version, from 1.
    version: i64,
    /// The newest version.
    newest_version: i64,
    /// Whether it is archived: no scan can be started with it.
    archived: bool,
    /// Who saved this version: the name of a token, or `local`.
    who: String,
    /// When this version was saved, RFC 3339 in UTC.
    saved_at: String,
    /// The recipe.
    recipe: Recipe,
}

impl RecipeBody {
    fn of(stored: Definition) -> Result<Self, LabError> {
        Ok(RecipeBody {
            recipe: Recipe::of_content(&stored.content)?,
            id: stored.id,
            name: stored.name,
            version: stored.version,
            newest_version: stored.newest,
            archived: stored.archived,
            who: stored.who,
            saved_at: stored.at,
        })
    }
}

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct RecipeParams {
    /// The recipe of exactly this name.
    name: Option<String>,
    /// The archived ones instead of the others.
    archived: Option<bool>,
    /// Rows at most, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Recipes in their newest versions, newest recipe first.
#[utoipa::path(get, path = "/api/v1/recipes", tag = "recipes", params(RecipeParams), responses(
    (status = 200, description = "A page of recipes", body = List<RecipeBody>),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<RecipeParams>,
) -> Result<Json<List<RecipeBody>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let (name, archived) = (params.name.as_deref(), params.archived.unwrap_or(false));
    let found = app.lab.store().definitions(KIND, name, archived, page);
    let found = found.await?;
    let mut list = List::after(&found);
    for stored in found.items {
        list.take(stored.id, RecipeBody::of(stored))?;
    }
    Ok(Json(list))
}

/// Add a recipe. Its plan is checked against this rig.
#[utoipa::path(post, path = "/api/v1/recipes", tag = "recipes", request_body = Recipe, responses(
    (status = 201, description = "The recipe in version 1", body = RecipeBody, headers(("Location" = String, description = "The recipe"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 409, description = "Another recipe has this name (`name-taken`)", body = Problem),
    (status = 422, description = "A value is not valid, or the plan cannot run", body = Problem),
))]
pub(super) async fn add(
    Caller(app): Caller,
    Body(recipe): Body<Recipe>,
) -> Result<Response, ApiError> {
    let added = app.lab.add_definition(&recipe).await?;
    let location = format!("/api/v1/recipes/{}", added.id);
    Ok(status::created(location, RecipeBody::of(added)?))
}

/// Which version.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct RecipeVersionParams {
    /// The version; the newest one if omitted.
    version: Option<i64>,
}

/// One recipe.
#[utoipa::path(get, path = "/api/v1/recipes/{id}", tag = "recipes",
    params(("id" = i64, Path, description = "Number of the recipe"), RecipeVersionParams), responses(
    (status = 200, description = "The recipe", body = RecipeBody),
    (status = 404, description = "There is no such recipe or version", body = Problem),
))]
pub(super) async fn get(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<RecipeVersionParams>,
) -> Result<Json<RecipeBody>, ApiError> {
    let wanted = params.version.map_or(Wanted::Newest, Wanted::Version);
    let stored = app.lab.store().definition(KIND, id, wanted).await?;
    Ok(Json(RecipeBody::of(stored)?))
}

/// Versions of a recipe, newest first. Scans stay linked to the version that they were started with.
#[utoipa::path(get, path = "/api/v1/recipes/{id}/versions", tag = "recipes",
    params(("id" = i64, Path, description = "Number of the recipe"), PageParams), responses(
    (status = 200, description = "A page of versions", body = List<RecipeBody>),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn versions(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<PageParams>,
) -> Result<Json<List<RecipeBody>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = app.lab.store().definition_versions(KIND, id, page).await?;
    let mut list = List::after(&found);
    for stored in found.items {
        list.take(stored.version, RecipeBody::of(stored))?;
    }
    Ok(Json(list))
}

/// A change of a recipe.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RecipeChange {
    /// The version that it replaces, which has to be the newest one, so that no change of another caller is lost.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    replaces: i64,
    /// The whole recipe. Its name stays.
    recipe: Recipe,
}

/// Change a recipe: add a version. Content that equals the newest version is no change.
#[utoipa::path(post, path = "/api/v1/recipes/{id}/versions", tag = "recipes",
    params(("id" = i64, Path, description = "Number of the recipe")), request_body = RecipeChange, responses(
    (status = 200, description = "The recipe in its newest version", body = RecipeBody),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "There is a newer version than `replaces` (`version-conflict`)", body = Problem),
    (status = 422, description = "A value is not valid, or the plan cannot run", body = Problem),
))]
pub(super) async fn change(
    Caller(app): Caller,
    Id(id): Id,
    Body(change): Body<RecipeChange>,
) -> Result<Json<RecipeBody>, ApiError> {
    let lab = &app.lab;
    let stored = lab.add_version(id, change.replaces, &change.recipe).await?;
    Ok(Json(RecipeBody::of(stored)?))
}

/// Archive a recipe: it is kept with its versions, and no scan can be started with it.
#[utoipa::path(post, path = "/api/v1/recipes/{id}/archive", tag = "recipes",
    params(("id" = i64, Path, description = "Number of the recipe")), responses(
    (status = 200, description = "The recipe", body = RecipeBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn archive(Caller(app): Caller, Id(id): Id) -> Result<Json<RecipeBody>, ApiError> {
    let stored = app.lab.archive_definition(KIND, id, true).await?;
    Ok(Json(RecipeBody::of(stored)?))
}

/// Restore an archived recipe.
#[utoipa::path(post, path = "/api/v1/recipes/{id}/restore", tag = "recipes",
    params(("id" = i64, Path, description = "Number of the recipe")), responses(
    (status = 200, description = "The recipe", body = RecipeBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn restore(Caller(app): Caller, Id(id): Id) -> Result<Json<RecipeBody>, ApiError> {
    let stored = app.lab.archive_definition(KIND, id, false).await?;
    Ok(Json(RecipeBody::of(stored)?))
}
