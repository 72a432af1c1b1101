//! Files of BiRD: what is accepted is valid by the schema of BiRD, and what the schema refuses is refused.

use std::path::Path;

use serde_json::{Value as Json, json};

use super::{MANIFEST, observed, refused};

/// A BiRD file with angles in radians.
pub(super) fn bird(angles: [Vec<f64>; 4], values: &[f64], u_brdf: &Json) -> Json {
    let [theta_i, phi_i, theta_r, phi_r] = angles;
    let angle = |values: Vec<f64>| json!({"unit": "rad", "values": values});
    json!({
        "metadata": {
            "schema": "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json",
            "id": "urn:uuid:5f0c2b8e-43d8-4f07-9a6c-30f6b0b8b5a1",
            "type": "BRDF",
            "timestamp": "2026-03-02T09:00:00+00",
            "provenance": {
                "organization": "lab", "email": "lab@lab.example", "contact_person": "Anna",
                "location": {"country": "A", "city": "B", "street": "C", "building_nr": "1", "postal_code": "2"},
            },
            "description": "made for a test",
            "method": "simulation",
            "instrumentation": "NA",
            "software": "NA",
            "sample": {"name": "s", "type": "t", "shape": "flat", "dimensions": {}, "zero_azimuth_location": "mark"},
            "environment": "NA",
        },
        "data": {
            "theta_i": angle(theta_i),
            "phi_i": angle(phi_i),
            "theta_r": angle(theta_r),
            "phi_r": angle(phi_r),
            "BRDF": {"unit": "1/sr", "values": values},
            "uBRDF": u_brdf,
            "polarization_i": {"notation": "sp", "values": vec!["u"; values.len()]},
        },
    })
}

/// The faults that a schema of BiRD finds, for the keywords of its schemas of `brdf`, `metadata`
/// and `data`. Other schemas (provenance, sample, instruments, which are not read) are skipped.
pub(crate) fn against(schema: &Json, value: &Json, at: &str) -> Vec<String> {
    let mut wrong = Vec::new();
    if let Some(link) = schema["$ref"].as_str() {
        let name = link.rsplit('/').next().unwrap();
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/data/bird")
            .join(name);
        if let Ok(text) = std::fs::read_to_string(path) {
            wrong.extend(against(&serde_json::from_str(&text).unwrap(), value, at));
        }
    }
    let is_a = match schema["type"].as_str() {
        None => true,
        Some("object") => value.is_object(),
        Some("array") => value.is_array(),
        Some("string") => value.is_string(),
        Some("number") => value.is_number(),
        Some(other) => panic!("{other}"),
    };
    if !is_a {
        wrong.push(format!("{at} is not of type {}", schema["type"]));
    }
    if schema.get("const").is_some_and(|c| c != value) {
        wrong.push(format!("{at} is not {}", schema["const"]));
    }
    if schema["enum"]
        .as_array()
        .is_some_and(|e| !e.contains(value))
    {
        wrong.push(format!("{at} is not one of {}", schema["enum"]));
    }
    let number = |key: &str| Some((value.as_f64()?, schema[key].as_f64()?));
    if number("minimum").is_some_and(|(x, least)| x < least)
        || number("maximum").is_some_and(|(x, most)| x > most)
        || number("exclusiveMaximum").is_some_and(|(x, most)| x >= most)
    {
        wrong.push(format!("{at} is out of range"));
    }
    for key in schema["required"].as_array().into_iter().flatten() {
        if value.get(key.as_str().unwrap()).is_none() {
            wrong.push(format!("{at} lacks {key}"));
        }
    }
    for (key, inner) in value.as_object().into_iter().flatten() {
        match schema["properties"].get(key) {
            Some(schema) => wrong.extend(against(schema, inner, &format!("{at}.{key}"))),
            None if schema["additionalProperties"] == json!(false) => {
                wrong.push(format!("{at}.{key} is unknown"));
            }
            None => {}
        }
    }
    if schema["items"].is_object() {
        for (i, inner) in value.as_array().into_iter().flatten().enumerate() {
            wrong.extend(against(&schema["items"], inner, &format!("{at}[{i}]")));
        }
    }
    if let Some(choices) = schema["oneOf"].as_array() {
        let met = choices
            .iter()
            .filter(|c| against(c, value, at).is_empty())
            .count();
        if met != 1 {
            wrong.push(format!("{at} meets {met} of the choices"));
        }
    }
    if schema.get("if").is_some() {
        let branch = match against(&schema["if"], value, at).is_empty() {
            true => "then",
            false => "else",
        };
        wrong.extend(against(&schema[branch], value, at));
    }
    wrong
}

#[test]
fn accepted_bird_files_are_valid_by_the_schema_of_bird() {
    let text = include_str!("../../data/bird/brdf_json_schema_v1.0.json");
    let schema: Json = serde_json::from_str(text).unwrap();
    let file = |u: Json| {
        bird(
            [
                vec![0.2, 0.3],
                vec![0.0, 1.0],
                vec![0.5, 0.1],
                vec![3.0, 2.0],
            ],
            &[0.4, 0.5],
            &u,
        )
    };
    let good = file(json!({"unit": "1/sr", "values": [0.01, 0.02]}));
    assert_eq!(against(&schema, &good, "file"), Vec::<String>::new());
    let read = observed(
        &MANIFEST.replace("table.csv", "table.json"),
        &good.to_string(),
    );
    assert_eq!(read.observations.len(), 2);
    // The schema check is effective: files that it refuses are refused here too.
    for (path, bad, words) in [
        ("/data/BRDF/unit", json!("sr"), "got `sr`"),
        ("/data/theta_i/unit", json!("grad"), "got `grad`"),
        (
            "/data/theta_i/values",
            json!(["a", 0.1]),
            "data.theta_i.values",
        ),
        ("/data/theta_r", json!(7), "data.theta_r"),
    ] {
        let mut file = good.clone();
        *file.pointer_mut(path).unwrap() = bad;
        assert_ne!(
            against(&schema, &file, "file"),
            Vec::<String>::new(),
            "{path}"
        );
        let said = refused(
            &MANIFEST.replace("table.csv", "table.json"),
            &file.to_string(),
        );
        assert!(said.contains(words), "{path}: {said}");
    }
    let mut short = good.clone();
    short["data"]["phi_r"]["values"] = json!([1.0]);
    let said = refused(
        &MANIFEST.replace("table.csv", "table.json"),
        &short.to_string(),
    );
    assert!(
        said.contains("data.phi_r has 1 value but data.BRDF has 2"),
        "{said}"
    );
    let mut polarised = good;
    polarised["data"]["polarization_i"]["values"] = json!(["s", "p"]);
    let said = refused(
        &MANIFEST.replace("table.csv", "table.json"),
        &polarised.to_string(),
    );
    assert!(said.contains("average those of s and p"), "{said}");
}
