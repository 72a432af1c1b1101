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
        api::openapi() == now,
        "the interface has changed; look at the change, then renew src/api/openapi.json with \
         `RIDGED_RENEW=1 cargo test --test it the_document`"
    );
}

#[test]
fn every_response_of_the_document_says_what_it_is() {
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
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
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
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
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
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
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
    let properties = &document["components"]["schemas"][name]["properties"];
    let mut names: Vec<String> = properties.as_object().unwrap().keys().cloned().collect();
    names.sort();
    names
}

#[test]
fn the_results_of_jobs_have_no_other_fields_than_the_described_ones() {
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
    for (path, name) in [
        ("/fits/{id}", "Fit"),
        ("/maps/{id}", "Map"),
        ("/contrasts/{id}", "Contrast"),
        ("/verdicts/{id}", "Verdict"),
        ("/traces/{id}", "Trace"),
    ] {
        let content = &operation(&document, "get", path)["responses"]["200"]["content"];
        let answer = content["application/json"]["example"].as_object().unwrap();
        assert!(answer.contains_key("seconds"), "{path}");
        let known = described(name);
        for field in answer.keys() {
            assert!(known.contains(field), "{path}: {field}");
        }
    }
    // Only with `compare`.
    assert!(described("Trace").contains(&"comparison".to_owned()));
}

#[test]
fn requests_have_no_other_fields_than_the_described_ones() {
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
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

/// Calls `look` with each schema within a schema, and with its path.
fn each_schema<'d>(
    document: &'d Value,
    schema: &'d Value,
    path: &str,
    seen: &mut Vec<&'d str>,
    look: &mut impl FnMut(&'d Value, &str),
) {
    if let Some(reference) = schema["$ref"].as_str() {
        let name = reference.rsplit('/').next().unwrap();
        if !seen.contains(&name) {
            seen.push(name);
            let named = &document["components"]["schemas"][name];
            each_schema(document, named, name, seen, look);
        }
        return;
    }
    look(schema, path);
    for kind in ["oneOf", "anyOf", "allOf"] {
        for part in schema[kind].as_array().into_iter().flatten() {
            each_schema(document, part, path, seen, look);
        }
    }
    for (name, field) in schema["properties"].as_object().into_iter().flatten() {
        each_schema(document, field, &format!("{path}.{name}"), seen, look);
    }
    for inner in ["items", "additionalProperties"] {
        if schema[inner].is_object() {
            let path = format!("{path}[]");
            each_schema(document, &schema[inner], &path, seen, look);
        }
    }
}

/// Bodies and successful answers that are JSON: method and path, the content, and whether it is a body.
fn contents(document: &Value) -> Vec<(String, &Value, bool)> {
    let mut found = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let route = format!("{method} {path}");
            let body = &operation["requestBody"]["content"]["application/json"];
            if body.is_object() {
                found.push((route.clone(), body, true));
            }
            for (status, response) in operation["responses"].as_object().into_iter().flatten() {
                let answer = &response["content"]["application/json"];
                if status.starts_with('2') && answer.is_object() {
                    found.push((route.clone(), answer, false));
                }
            }
        }
    }
    found
}

/// Whether a schema is of this type, or of this type or null.
fn is_of(schema: &Value, kind: &str) -> bool {
    let kinds = &schema["type"];
    kinds == kind
        || kinds
            .as_array()
            .is_some_and(|all| all.contains(&kind.into()))
}

#[test]
fn no_body_and_no_answer_is_a_bare_object() {
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
    let mut bare = Vec::new();
    let mut seen = Vec::new();
    for (route, content, _) in contents(&document) {
        each_schema(
            &document,
            &content["schema"],
            &route,
            &mut seen,
            &mut |schema, path| {
                let says = [
                    "properties",
                    "additionalProperties",
                    "oneOf",
                    "anyOf",
                    "allOf",
                ];
                if is_of(schema, "object") && says.iter().all(|key| schema[*key].is_null()) {
                    bare.push(path.to_owned());
                }
            },
        );
    }
    assert!(seen.len() > 100, "{}", seen.len());
    assert!(bare.is_empty(), "describe these objects: {bare:?}");
}

#[test]
fn the_fields_of_bodies_have_bounds() {
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
    let mut open = Vec::new();
    let mut seen = Vec::new();
    for (route, content, _) in contents(&document).into_iter().filter(|c| c.2) {
        each_schema(
            &document,
            &content["schema"],
            &route,
            &mut seen,
            &mut |schema, path| {
                let has = |keys: &[&str]| keys.iter().any(|key| !schema[*key].is_null());
                let is_bounded = match schema {
                    // Elements of lists and maps: the list has the bound, and the names of parameters their ranges.
                    _ if !path.contains('.') || path.ends_with("[]") => true,
                    _ if is_of(schema, "number") || is_of(schema, "integer") => {
                        has(&["minimum", "exclusiveMinimum"])
                            && has(&["maximum", "exclusiveMaximum"])
                    }
                    _ if is_of(schema, "string") => has(&["enum", "maxLength", "format", "const"]),
                    _ if is_of(schema, "array") => has(&["maxItems"]),
                    _ => true,
                };
                if !is_bounded {
                    open.push(path.to_owned());
                }
            },
        );
    }
    assert!(
        open.is_empty(),
        "state the bounds of these fields: {open:?}"
    );
}

#[test]
fn every_body_and_every_answer_has_an_example_with_the_fields_of_its_schema() {
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
    let mut lacking = Vec::new();
    for (route, content, is_body) in contents(&document) {
        let example = &content["example"];
        if example.is_null() {
            lacking.push(route);
            continue;
        }
        let Some(name) = content["schema"]["$ref"].as_str() else {
            continue;
        };
        let schema = &document["components"]["schemas"][name.rsplit('/').next().unwrap()];
        for needed in schema["required"].as_array().into_iter().flatten() {
            let needed = needed.as_str().unwrap();
            assert!(
                !example[needed].is_null() || example.get(needed).is_some(),
                "{route}: {needed}"
            );
        }
        if is_body && schema["additionalProperties"] == false {
            for field in example.as_object().into_iter().flatten() {
                assert!(
                    !schema["properties"][field.0].is_null(),
                    "{route}: {}",
                    field.0
                );
            }
        }
    }
    assert!(
        lacking.is_empty(),
        "add examples of these to src/api/examples.json: {lacking:?}"
    );
}

#[test]
fn a_problem_lists_its_codes() {
    let document: Value = serde_json::from_str(api::openapi()).unwrap();
    let codes = &document["components"]["schemas"]["Problem"]["properties"]["code"]["enum"];
    let codes = codes.as_array().unwrap();
    for code in [
        "not-found",
        "name-taken",
        "wrong-content-encoding",
        "invalid-value",
    ] {
        assert!(codes.contains(&code.into()), "{code}");
    }
}
