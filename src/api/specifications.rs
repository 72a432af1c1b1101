//! `/specifications`: limits of parts, by name and in versions.

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
use crate::judge::Specification;
use crate::lab::LabError;
use crate::lab::definitions::read;
use crate::store::definitions::{Definition, DefinitionKind};

/// One version of a specification.
#[derive(Debug, Serialize, ToSchema)]
pub struct SpecificationBody {
    /// Number of the specification.
    id: i64,
    /// Its name.
    name: String,
    /// This version, from 1.
    version: i64,
    /// The newest version.
    newest_version: i64,
    /// Whether it is archived: no scan can be judged against it.
    archived: bool,
    /// Who saved this version: the name of a token, or `local`.
    who: String,
    /// When this version was saved, RFC 3339 in UTC.
    saved_at: String,
    /// The specification.
    specification: Specification,
}

impl DefinitionBody for SpecificationBody {
    const KIND: DefinitionKind = DefinitionKind::Specification;

    fn of(stored: Definition) -> Result<Self, LabError> {
        Ok(SpecificationBody {
            specification: read(&stored.content)?,
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

/// Specifications in their newest versions, newest specification first.
#[utoipa::path(get, path = "/api/v1/specifications", tag = "specifications", params(DefinitionParams), responses(
    (status = 200, description = "A page of specifications", body = List<SpecificationBody>),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<DefinitionParams>,
) -> Result<Json<List<SpecificationBody>>, ApiError> {
    definitions::list(&app, params).await
}

/// Add a specification.
#[utoipa::path(post, path = "/api/v1/specifications", tag = "specifications", request_body = Specification, responses(
    (status = 201, description = "The specification in version 1", body = SpecificationBody, headers(("Location" = String, description = "The specification"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 409, description = "Another specification has this name (`name-taken`)", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn add(
    Caller(app): Caller,
    Body(specification): Body<Specification>,
) -> Result<Response, ApiError> {
    let added = app.lab.add_definition(&specification).await?;
    let location = format!("/api/v1/specifications/{}", added.id);
    Ok(status::created(location, SpecificationBody::of(added)?))
}

/// One specification.
#[utoipa::path(get, path = "/api/v1/specifications/{id}", tag = "specifications",
    params(("id" = i64, Path, description = "Number of the specification"), VersionParams), responses(
    (status = 200, description = "The specification", body = SpecificationBody),
    (status = 404, description = "There is no such specification or version", body = Problem),
))]
pub(super) async fn get(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<VersionParams>,
) -> Result<Json<SpecificationBody>, ApiError> {
    definitions::one(&app, id, params).await
}

/// Versions of a specification, newest first. Scans stay linked to the version that they are judged against.
#[utoipa::path(get, path = "/api/v1/specifications/{id}/versions", tag = "specifications",
    params(("id" = i64, Path, description = "Number of the specification"), PageParams), responses(
    (status = 200, description = "A page of versions", body = List<SpecificationBody>),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn versions(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<PageParams>,
) -> Result<Json<List<SpecificationBody>>, ApiError> {
    definitions::versions(&app, id, params).await
}

/// A change of a specification.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SpecificationChange {
    /// The version that it replaces, which has to be the newest one, so that no change of another caller is lost.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    replaces: i64,
    /// The whole specification. Its name stays.
    specification: Specification,
}

/// Change a specification: add a version. Content that equals the newest version is no change.
#[utoipa::path(post, path = "/api/v1/specifications/{id}/versions", tag = "specifications",
    params(("id" = i64, Path, description = "Number of the specification")), request_body = SpecificationChange, responses(
    (status = 200, description = "The specification in its newest version", body = SpecificationBody),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "There is a newer version than `replaces` (`version-conflict`)", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn change(
    Caller(app): Caller,
    Id(id): Id,
    Body(change): Body<SpecificationChange>,
) -> Result<Json<SpecificationBody>, ApiError> {
    let lab = &app.lab;
    let stored = lab
        .add_version(id, change.replaces, &change.specification)
        .await?;
    Ok(Json(SpecificationBody::of(stored)?))
}

/// Archive a specification: it is kept with its versions, and no scan can be judged against it.
#[utoipa::path(post, path = "/api/v1/specifications/{id}/archive", tag = "specifications",
    params(("id" = i64, Path, description = "Number of the specification")), responses(
    (status = 200, description = "The specification", body = SpecificationBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn archive(
    Caller(app): Caller,
    Id(id): Id,
) -> Result<Json<SpecificationBody>, ApiError> {
    definitions::archive(&app, id, true).await
}

/// Restore an archived specification.
#[utoipa::path(post, path = "/api/v1/specifications/{id}/restore", tag = "specifications",
    params(("id" = i64, Path, description = "Number of the specification")), responses(
    (status = 200, description = "The specification", body = SpecificationBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn restore(
    Caller(app): Caller,
    Id(id): Id,
) -> Result<Json<SpecificationBody>, ApiError> {
    definitions::archive(&app, id, false).await
}
