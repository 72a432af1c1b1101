//! The README states what its commands print.

use std::path::Path;

use serde_json::Value;

use super::commands::ridged;

/// Asserts that a number of the README is `value`, to one unit of its last digit: where a value is between two of them,
/// another processor may print the other one.
fn is_printed(written: &str, value: &Value, what: &str) {
    let decimals = written.split_once('.').map_or(0, |(_, d)| d.len());
    let number: f64 = written.parse().unwrap();
    let value = value.as_f64().unwrap();
    let unit = 0.1_f64.powi(decimals as i32);
    assert!(
        (number - value).abs() <= unit,
        "{what}: {written} is {value}"
    );
}

#[test]
fn the_table_of_the_readme_has_what_a_fit_prints() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let rows = include_str!("../../README.md")
        .lines()
        .skip_while(|line| !line.starts_with("| series |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let mut series = 0;
    for row in rows {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let name = cells[1].split('`').nth(1).unwrap();
        let output = ridged(
            root,
            &["fit", &format!("tests/data/series/{name}"), "--json"],
        );
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        let written = [cells[2], cells[4], cells[6]].map(|cell| cell.split(", "));
        let written = written.into_iter().flatten();
        for (key, written) in ["theta_r_deg", "alpha_u", "alpha_v", "rho_d"]
            .into_iter()
            .zip(written)
        {
            let (what, parameter) = (format!("{name}, {key}"), &report["parameters"][key]);
            let Some((value, expanded)) = written.trim_end_matches('°').split_once(" ± ") else {
                assert_eq!(
                    (written, &parameter["value"]),
                    ("–", &Value::Null),
                    "{what}"
                );
                continue;
            };
            is_printed(value, &parameter["value"], &what);
            is_printed(expanded, &parameter["expanded"], &what);
            let k = parameter["coverage_factor"].as_f64().unwrap();
            assert!((2.0..=2.5).contains(&k), "{what}: k = {k}");
        }
        series += 1;
    }
    assert_eq!(series, 3);
}
