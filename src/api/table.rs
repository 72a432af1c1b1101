//! Who may use which route: one table. A route that is not in it is refused to everyone, and a test compares the table
//! with the OpenAPI document.

use axum::http::Method;

use crate::access::Role;

/// What a request needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Need {
    /// Nothing: the status alone, the page without data, and the login.
    Nothing,
    /// Any token; on this machine none.
    Stop,
    /// At least this role.
    Role(Role),
    /// The role operator, and that no other caller holds the rig.
    Rig,
}

impl Need {
    /// Returns the least role; none where a request without a token is answered.
    pub const fn role(self) -> Option<Role> {
        match self {
            Need::Nothing => None,
            Need::Stop => Some(Role::Viewer),
            Need::Role(role) => Some(role),
            Need::Rig => Some(Role::Operator),
        }
    }
}

const READ: Need = Need::Role(Role::Viewer);
const COMPUTE: Need = Need::Role(Role::Analyst);
const OPERATE: Need = Need::Role(Role::Operator);

/// Every route: method, path, need.
#[rustfmt::skip]
const ROUTES: &[(&str, &str, Need)] = &[
    ("GET", "/healthz", Need::Nothing),
    ("GET", "/readyz", READ),
    ("GET", "/metrics", READ),
    ("GET", "/openapi.json", READ),
    ("GET", "/api/v1/session", READ),
    ("POST", "/api/v1/session", Need::Nothing),
    ("DELETE", "/api/v1/session", Need::Nothing),
    ("GET", "/api/v1/lease", READ),
    ("POST", "/api/v1/lease", OPERATE),
    ("DELETE", "/api/v1/lease", OPERATE),
    ("GET", "/api/v1/rig", READ),
    ("POST", "/api/v1/rig/stop", Need::Stop),
    ("POST", "/api/v1/rig/move", Need::Rig),
    ("GET", "/api/v1/rig/moves/{id}", READ),
    ("POST", "/api/v1/rig/axes/{axis}/move", Need::Rig),
    ("POST", "/api/v1/rig/axes/{axis}/home", Need::Rig),
    ("POST", "/api/v1/rig/axes/{axis}/unpark", Need::Rig),
    ("POST", "/api/v1/rig/home", Need::Rig),
    ("POST", "/api/v1/rig/jog", Need::Rig),
    ("POST", "/api/v1/rig/preview", Need::Rig),
    ("GET", "/api/v1/rig/preview/{id}/image.png", READ),
    ("GET", "/api/v1/rig/preview/{id}/pixels", READ),
    // Nothing moves; a scan of another caller may wait for it.
    ("POST", "/api/v1/rig/accept-stages", Need::Role(Role::Admin)),
    ("GET", "/api/v1/samples", READ),
    ("POST", "/api/v1/samples", COMPUTE),
    ("GET", "/api/v1/samples/{id}", READ),
    ("PATCH", "/api/v1/samples/{id}", OPERATE),
    ("GET", "/api/v1/recipes", READ),
    ("POST", "/api/v1/recipes", OPERATE),
    ("GET", "/api/v1/recipes/{id}", READ),
    ("GET", "/api/v1/recipes/{id}/versions", READ),
    ("POST", "/api/v1/recipes/{id}/versions", OPERATE),
    ("POST", "/api/v1/recipes/{id}/archive", OPERATE),
    ("POST", "/api/v1/recipes/{id}/restore", OPERATE),
    ("GET", "/api/v1/specifications", READ),
    ("POST", "/api/v1/specifications", OPERATE),
    ("GET", "/api/v1/specifications/{id}", READ),
    ("GET", "/api/v1/specifications/{id}/versions", READ),
    ("POST", "/api/v1/specifications/{id}/versions", OPERATE),
    ("POST", "/api/v1/specifications/{id}/archive", OPERATE),
    ("POST", "/api/v1/specifications/{id}/restore", OPERATE),
    ("GET", "/api/v1/queue", READ),
    ("POST", "/api/v1/queue/start", Need::Rig),
    ("POST", "/api/v1/queue/stop", OPERATE),
    ("POST", "/api/v1/queue/pause", Need::Rig),
    ("POST", "/api/v1/queue/resume", Need::Rig),
    ("POST", "/api/v1/queue/continue", OPERATE),
    ("GET", "/api/v1/queue/orders", READ),
    ("POST", "/api/v1/queue/orders", OPERATE),
    ("GET", "/api/v1/queue/orders/{id}", READ),
    ("DELETE", "/api/v1/queue/orders/{id}", OPERATE),
    ("POST", "/api/v1/queue/orders/{id}/move", OPERATE),
    ("POST", "/api/v1/queue/orders/{id}/retry", OPERATE),
    ("GET", "/api/v1/scans", READ),
    ("POST", "/api/v1/scans", Need::Rig),
    ("POST", "/api/v1/scans/estimate", OPERATE),
    ("GET", "/api/v1/scans/{id}", READ),
    ("PATCH", "/api/v1/scans/{id}", OPERATE),
    ("GET", "/api/v1/scans/{id}/changes", READ),
    ("POST", "/api/v1/scans/{id}/{order}", Need::Rig),
    ("GET", "/api/v1/scans/{id}/uncertainty", READ),
    ("GET", "/api/v1/scans/{id}/incidents", READ),
    ("GET", "/api/v1/scans/{id}/report", READ),
    ("GET", "/api/v1/scans/{id}/frames", READ),
    ("GET", "/api/v1/scans/{id}/observations", READ),
    ("GET", "/api/v1/scans/{id}/brdf.json", READ),
    ("GET", "/api/v1/scans/{id}/frames.tif", READ),
    ("GET", "/api/v1/scans/{id}/surface.bsdf", READ),
    ("GET", "/api/v1/scans/{id}/scan.nxs", READ),
    ("GET", "/api/v1/calibrations", READ),
    ("POST", "/api/v1/calibrations", Need::Rig),
    ("GET", "/api/v1/calibrations/{id}", READ),
    ("POST", "/api/v1/imports", COMPUTE),
    ("POST", "/api/v1/imports/upload", COMPUTE),
    ("GET", "/api/v1/frames/{id}", READ),
    ("GET", "/api/v1/frames/{id}/image.png", READ),
    ("GET", "/api/v1/frames/{id}/pixels", READ),
    ("GET", "/api/v1/frames/{id}/preview.png", READ),
    ("GET", "/api/v1/results", READ),
    ("GET", "/api/v1/charts", READ),
    ("GET", "/api/v1/due", READ),
    ("GET", "/api/v1/comparisons", READ),
    ("GET", "/api/v1/repeatability", READ),
    ("GET", "/api/v1/fits", READ),
    ("POST", "/api/v1/fits", COMPUTE),
    ("GET", "/api/v1/fits/{id}", READ),
    ("POST", "/api/v1/fits/{id}/cancel", COMPUTE),
    ("GET", "/api/v1/fits/{id}/curve", READ),
    ("GET", "/api/v1/maps", READ),
    ("POST", "/api/v1/maps", COMPUTE),
    ("GET", "/api/v1/maps/{id}", READ),
    ("POST", "/api/v1/maps/{id}/cancel", COMPUTE),
    ("GET", "/api/v1/maps/{id}/files/{name}", READ),
    ("GET", "/api/v1/contrasts", READ),
    ("POST", "/api/v1/contrasts", COMPUTE),
    ("GET", "/api/v1/contrasts/{id}", READ),
    ("POST", "/api/v1/contrasts/{id}/cancel", COMPUTE),
    ("GET", "/api/v1/verdicts", READ),
    ("POST", "/api/v1/verdicts", COMPUTE),
    ("GET", "/api/v1/verdicts/{id}", READ),
    ("POST", "/api/v1/verdicts/{id}/cancel", COMPUTE),
    ("GET", "/api/v1/traces", READ),
    ("POST", "/api/v1/traces", COMPUTE),
    ("GET", "/api/v1/traces/{id}", READ),
    ("POST", "/api/v1/traces/{id}/cancel", COMPUTE),
    ("GET", "/api/v1/traces/{id}/files/{name}", READ),
    ("GET", "/api/v1/accuracy", READ),
    ("GET", "/api/v1/events", READ),
];

/// The order of a scan that needs no lease: a person or robot that does an operator step at the rig confirms it, and
/// often another caller started the scan.
const CONFIRMATION: (&str, &str) = ("/api/v1/scans/{id}/{order}", "/continue");

/// Returns what a request to this path needs; see [`need`] for its route.
pub(super) fn need_of(method: &Method, route: Option<&str>, path: &str) -> Need {
    let (scan_order, confirms) = CONFIRMATION;
    match need(method, route) {
        Need::Rig if route == Some(scan_order) && path.ends_with(confirms) => OPERATE,
        need => need,
    }
}

/// Returns what a request needs. `path` is the path of the route with its parameters; a request without a route may read a
/// file of the page.
pub(super) fn need(method: &Method, path: Option<&str>) -> Need {
    let reads = matches!(*method, Method::GET | Method::HEAD);
    let Some(path) = path else {
        return if reads { Need::Nothing } else { READ };
    };
    let name = if reads { "GET" } else { method.as_str() };
    let of_path = || ROUTES.iter().filter(|(_, route, _)| *route == path);
    match of_path().find(|(route, ..)| *route == name) {
        Some((.., need)) => *need,
        // The route has no such method, and says so to every caller that may read.
        None if of_path().next().is_some() => READ,
        None => Need::Role(Role::Admin),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use utoipa::OpenApi;

    use super::*;
    use crate::api::UNDESCRIBED;
    use crate::api::routes::Document;

    /// The routes of the document.
    fn documented() -> BTreeSet<(String, String)> {
        let document = Document::openapi();
        let mut routes: BTreeSet<_> = UNDESCRIBED
            .iter()
            .map(|path| ("GET".to_owned(), (*path).to_owned()))
            .collect();
        for (path, item) in &document.paths.paths {
            for (method, operation) in [
                ("GET", &item.get),
                ("POST", &item.post),
                ("PUT", &item.put),
                ("PATCH", &item.patch),
                ("DELETE", &item.delete),
            ] {
                if operation.is_some() {
                    routes.insert((method.to_owned(), path.clone()));
                }
            }
        }
        routes
    }

    #[test]
    fn every_route_has_one_row_in_the_table() {
        let rows = || {
            let rows = ROUTES.iter();
            rows.map(|(method, path, _)| ((*method).to_owned(), (*path).to_owned()))
        };
        let table: BTreeSet<_> = rows().collect();
        assert_eq!(table.len(), rows().count(), "a route has two rows");
        let documented = documented();
        let missing: Vec<_> = documented.difference(&table).collect();
        assert!(missing.is_empty(), "add a row for each of {missing:?}");
        let gone: Vec<_> = table.difference(&documented).collect();
        assert!(gone.is_empty(), "remove the rows of {gone:?}");
    }

    #[test]
    fn a_viewer_writes_nothing_and_only_status_page_and_login_need_no_token() {
        for (method, path, need) in ROUTES {
            let writes = *method != "GET";
            match need {
                Need::Nothing => assert!(
                    *path == "/healthz" || (writes && *path == "/api/v1/session"),
                    "{method} {path}"
                ),
                Need::Stop => assert_eq!(*path, super::super::rig::STOP),
                Need::Role(Role::Viewer) => assert!(!writes, "{method} {path}"),
                Need::Role(_) | Need::Rig => assert!(writes, "{method} {path}"),
            }
        }
    }

    #[test]
    fn the_confirmation_of_a_step_needs_no_lease_and_every_other_order_does() {
        let route = Some(CONFIRMATION.0);
        let need = |order: &str| {
            let path = format!("/api/v1/scans/1/{order}");
            need_of(&Method::POST, route, &path)
        };
        assert_eq!(need("continue"), OPERATE);
        for order in ["pause", "resume", "abort"] {
            assert_eq!(need(order), Need::Rig);
        }
    }

    #[test]
    fn whatever_has_no_row_is_not_open() {
        assert_eq!(need(&Method::GET, None), Need::Nothing);
        assert_eq!(need(&Method::HEAD, Some("/api/v1/scans")), READ);
        assert_eq!(need(&Method::POST, None), READ);
        assert_eq!(need(&Method::DELETE, Some("/api/v1/scans")), READ);
        let new = need(&Method::GET, Some("/api/v1/new"));
        assert_eq!(new, Need::Role(Role::Admin));
    }
}
