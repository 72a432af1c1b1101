//! `/recipes`: how parts are measured, by name and in versions.

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::Caller;
use super::definitions::{self, DefinitionBody, DefinitionParams, VersionParams};
use super::extract::{Body, Id, PageParams, Params};
use super::status::{self, ApiError, Problem};
use super::{App, List};
use crate::lab::{LabError, Recipe};
use crate::store::definitions::{Definition, DefinitionKind};

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

impl DefinitionBody for RecipeBody {
    const KIND: DefinitionKind = DefinitionKind::Recipe;

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

/// Recipes in their newest versions, newest recipe first.
#[utoipa::path(get, path = "/api/v1/recipes", tag = "recipes", params(DefinitionParams), responses(
    (status = 200, description = "A page of recipes", body = List<RecipeBody>),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<DefinitionParams>,
) -> Result<Json<List<RecipeBody>>, ApiError> {
    definitions::list(&app, params).await
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

/// One recipe.
#[utoipa::path(get, path = "/api/v1/recipes/{id}", tag = "recipes",
    params(("id" = i64, Path, description = "Number of the recipe"), VersionParams), responses(
    (status = 200, description = "The recipe", body = RecipeBody),
    (status = 404, description = "There is no such recipe or version", body = Problem),
))]
pub(super) async fn get(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<VersionParams>,
) -> Result<Json<RecipeBody>, ApiError> {
    definitions::one(&app, id, params).await
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
    definitions::versions(&app, id, params).await
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
    definitions::archive(&app, id, true).await
}

/// Restore an archived recipe.
#[utoipa::path(post, path = "/api/v1/recipes/{id}/restore", tag = "recipes",
    params(("id" = i64, Path, description = "Number of the recipe")), responses(
    (status = 200, description = "The recipe", body = RecipeBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn restore(Caller(app): Caller, Id(id): Id) -> Result<Json<RecipeBody>, ApiError> {
    definitions::archive(&app, id, false).await
}
