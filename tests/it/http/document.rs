//! The document that describes the interface.

use std::path::Path;

use ridged::api;
use serde_json::Value;

#[test]
fn the_document_is_the_one_in_the_repository() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/openapi.json");
    let now = api::openapi_json() + "\n";
    if std::env::var_os("RIDGED_RENEW").is_some() {
        std::fs::write(&path, &now).unwrap();
    }
    let kept = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        kept == now,
        "the interface has changed; look at the change, then renew tests/data/openapi.json with \
         `RIDGED_RENEW=1 cargo test --test it the_document`"
    );
}

#[test]
fn every_response_of_the_document_says_what_it_is() {
    let document: Value = serde_json::from_str(&api::openapi_json()).unwrap();
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
