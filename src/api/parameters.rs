//! Refuses parameters after the question mark on routes that have none. A route that has some refuses others itself, and
//! names the one that was probably meant.

use std::collections::{HashMap, HashSet};
use std::sync::LazyLock;

use axum::extract::{MatchedPath, Query, Request};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;

use super::document::openapi;
use super::extract::parameters;
use super::guard::is_stop;
use super::status::ApiError;

/// Refuses a request with a parameter if its route has none. Nothing refuses the stop.
pub(super) async fn refuse_unknown(request: Request, next: Next) -> Response {
    let route = request.extensions().get::<MatchedPath>();
    let is_checked = match route {
        Some(route) => request.uri().query().is_some() && takes_none(request.method(), route),
        None => false,
    };
    if is_checked
        && !is_stop(&request)
        && let Err(problem) = none_of(&request)
    {
        return problem.into_response();
    }
    next.run(request).await
}

/// No parameters.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nothing {}

fn none_of(request: &Request) -> Result<(), ApiError> {
    let query = Query::<Vec<(String, String)>>::try_from_uri(request.uri());
    let Query(all) = query.map_err(|refusal| ApiError::bad_request(refusal.body_text()))?;
    parameters::<Nothing>(&all).map(|_| ())
}

/// The document, as far as it says which routes have parameters after the question mark.
#[derive(Deserialize)]
struct Routes {
    paths: HashMap<String, HashMap<String, Operation>>,
}

#[derive(Deserialize)]
struct Operation {
    #[serde(default)]
    parameters: Vec<Parameter>,
}

#[derive(Deserialize)]
struct Parameter {
    #[serde(rename = "in")]
    place: String,
}

/// Returns whether the document describes the route, and describes no parameters of it.
fn takes_none(method: &Method, route: &MatchedPath) -> bool {
    static WITHOUT: LazyLock<HashSet<(String, String)>> = LazyLock::new(|| {
        let document: Routes = serde_json::from_str(openapi()).expect("the document is JSON");
        let operations = document.paths.into_iter().flat_map(|(path, item)| {
            item.into_iter()
                .map(move |(method, operation)| (method, path.clone(), operation))
        });
        operations
            .filter(|(.., operation)| operation.parameters.iter().all(|p| p.place != "query"))
            .map(|(method, path, _)| (method.to_uppercase(), path))
            .collect()
    });
    // A route that is read answers HEAD, too.
    let method = match *method {
        Method::HEAD => Method::GET.as_str(),
        _ => method.as_str(),
    };
    WITHOUT.contains(&(method.to_owned(), route.as_str().to_owned()))
}
