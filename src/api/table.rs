//! Who may use which route: what each entry of the list in `routes` needs. A path without an entry needs the role admin.

use std::sync::LazyLock;

use axum::http::Method;

use super::need::{ADMIN, Need, OPERATE, READ, Route};
use super::{DOCUMENT, routes};

/// Every route: those of `routes.rs`, and the document, which describes itself nowhere.
static ROUTES: LazyLock<Vec<Route>> = LazyLock::new(|| {
    let document = (Method::GET, DOCUMENT.to_owned(), READ);
    [vec![document], routes::needs()].concat()
});

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
    let method = if reads { &Method::GET } else { method };
    let of_path = || ROUTES.iter().filter(|(_, route, _)| route == path);
    match of_path().find(|(of_route, ..)| of_route == method) {
        Some((.., need)) => *need,
        // The route has no such method, and says so to every caller that may read.
        None if of_path().next().is_some() => READ,
        None => ADMIN,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use utoipa::OpenApi;

    use super::*;
    use crate::access::Role;
    use crate::api::routes::Document;

    /// The routes of the document.
    fn documented() -> BTreeSet<(String, String)> {
        let document = Document::openapi();
        let mut routes = BTreeSet::from([("GET".to_owned(), DOCUMENT.to_owned())]);
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
            rows.map(|(method, path, _)| (method.to_string(), path.clone()))
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
        for (method, path, need) in ROUTES.iter() {
            let writes = *method != Method::GET;
            match need {
                Need::Nothing => assert!(
                    path == "/healthz" || (writes && path == "/api/v1/session"),
                    "{method} {path}"
                ),
                Need::Stop => assert_eq!(path, super::super::rig::STOP),
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
