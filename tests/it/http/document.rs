//! The document that describes the interface.

use std::path::Path;

use ridged::api;
use serde_json::Value;

#[test]
fn the_document_is_the_one_in_the_repository() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/api/openapi.json");
    let now = api::openapi_of_handlers();
    if std::env::var_os("RIDGED_RENEW").is_some() {
        std::fs::write(&path, &now).unwrap();
        return;
    }
    assert!(
        api::OPENAPI == now,
        "the interface has changed; look at the change, then renew src/api/openapi.json with \
         `RIDGED_RENEW=1 cargo test --test it the_document`"
    );
}

#[test]
fn every_response_of_the_document_says_what_it_is() {
    let document: Value = serde_json::from_str(api::OPENAPI).unwrap();
    let mut responses = 0;
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let Some(all) = operation["responses"].as_object() else {
                continue;
            };
            for (status, response) in all {
                let description = response["description"].as_str().unwrap_or_default();
                assert!(!description.is_empty(), "{method} {path} {status}");
                responses += 1;
            }
        }
    }
    assert!(responses > 60, "{responses}");
}

/// What a route of the document says of itself.
fn operation<'a>(document: &'a Value, method: &str, path: &str) -> &'a Value {
    &document["paths"][format!("/api/v1{path}")][method]
}

#[test]
fn answers_that_every_route_of_a_kind_gives_are_described() {
    let document: Value = serde_json::from_str(api::OPENAPI).unwrap();
    for (method, path, status) in [
        ("get", "/scans", "422"),
        ("get", "/scans", "400"),
        ("get", "/samples", "422"),
        ("get", "/scans/{id}", "400"),
        ("get", "/scans/{id}/frames", "422"),
        ("get", "/events", "422"),
        ("post", "/scans", "415"),
        ("post", "/rig/axes/{axis}/home", "422"),
        ("post", "/rig/axes/{axis}/home", "415"),
    ] {
        let responses = &operation(&document, method, path)["responses"];
        assert!(responses[status].is_object(), "{method} {path} {status}");
    }
    let has_key = |path: &str| {
        let all = operation(&document, "post", path)["parameters"].as_array();
        all.is_some_and(|all| all.iter().any(|p| p["name"] == "Idempotency-Key"))
    };
    assert!(has_key("/scans") && has_key("/imports") && has_key("/scans/{id}/{order}"));
    assert!(!has_key("/rig/stop"));
}

#[test]
fn answers_are_announced_as_what_they_are_sent_as() {
    let document: Value = serde_json::from_str(api::OPENAPI).unwrap();
    let mut problems = 0;
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            for (status, response) in operation["responses"].as_object().unwrap() {
                for (kind, content) in response["content"].as_object().into_iter().flatten() {
                    let is_problem = content["schema"]["$ref"] == "#/components/schemas/Problem";
                    let announced = kind == "application/problem+json";
                    assert_eq!(is_problem, announced, "{method} {path} {status}");
                    problems += usize::from(is_problem);
                }
            }
            assert!(operation["responses"]["403"].is_object(), "{method} {path}");
            if operation["requestBody"].is_object() {
                assert!(operation["responses"]["400"].is_object(), "{path}");
            }
            for limit in operation["parameters"].as_array().into_iter().flatten() {
                if limit["name"] == "limit" {
                    let bounds = (&limit["schema"]["minimum"], &limit["schema"]["maximum"]);
                    assert_eq!(bounds, (&1.into(), &1000.into()), "{method} {path}");
                }
            }
        }
    }
    assert!(problems > 100, "{problems}");
    let kinds = |path: &str| -> Vec<String> {
        let content = &operation(&document, "get", path)["responses"]["200"]["content"];
        content.as_object().unwrap().keys().cloned().collect()
    };
    assert!(kinds("/scans/{id}/observations").contains(&"text/csv".into()));
    assert!(kinds("/maps/{id}/files/{name}").contains(&"image/png".into()));
    assert!(kinds("/traces/{id}/files/{name}").contains(&"text/csv".into()));
}

/// Names of the fields of a schema.
pub(crate) fn described(name: &str) -> Vec<String> {
    let document: Value = serde_json::from_str(api::OPENAPI).unwrap();
    let properties = &document["components"]["schemas"][name]["properties"];
    let mut names: Vec<String> = properties.as_object().unwrap().keys().cloned().collect();
    names.sort();
    names
}

#[test]
fn requests_have_no_other_fields_than_the_described_ones() {
    let document: Value = serde_json::from_str(api::OPENAPI).unwrap();
    let schema = |name: &str| &document["components"]["schemas"][name];
    for (path, name) in [
        ("/scans", "ScanRequest"),
        ("/fits", "FitRequest"),
        ("/maps", "MapRequest"),
        ("/contrasts", "ContrastRequest"),
        ("/verdicts", "VerdictRequest"),
        ("/traces", "TraceRequest"),
    ] {
        let body = &operation(&document, "post", path)["requestBody"]["content"];
        assert_eq!(
            body["application/json"]["schema"]["$ref"],
            format!("#/components/schemas/{name}")
        );
        assert_eq!(schema(name)["additionalProperties"], false, "{name}");
    }
    for name in ["PlanRequest", "DarkRequest", "FlatRequest", "Grid"] {
        assert_eq!(schema(name)["additionalProperties"], false, "{name}");
    }
    for kind in schema("MaterialBody")["oneOf"].as_array().unwrap() {
        assert_eq!(kind["additionalProperties"], false, "{kind}");
    }
    assert_eq!(
        schema("FitRequest")["required"],
        serde_json::json!(["scan_id"])
    );
    assert_eq!(
        schema("Preset")["enum"],
        serde_json::json!(["paper", "full"])
    );
}
