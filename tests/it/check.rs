//! The table of stiff and extreme cases, as `ridged check --quick` computes it: a test for each part, so that they run
//! beside each other.

use std::sync::atomic::AtomicBool;

use ridged::check::{CheckEffort, PARTS};

/// Computes a part, which has at least `rows_min` rows, and compares all rows with their expected values.
fn is_as_expected(name: &str, rows_min: usize) {
    let (_, part) = PARTS.into_iter().find(|(n, _)| *n == name).unwrap();
    let rows = part(CheckEffort::Quick, &AtomicBool::new(false));
    let off: Vec<_> = rows.iter().filter(|r| !r.judged.as_expected).collect();
    assert!(off.is_empty(), "{off:#?}");
    assert!(rows.len() >= rows_min, "{} rows", rows.len());
}

#[test]
fn every_extreme_case_of_the_closed_forms_is_as_expected() {
    is_as_expected("closed forms", 800);
}

#[test]
fn every_extreme_case_of_the_tracer_is_as_expected() {
    is_as_expected("tracer", 90);
}

#[test]
fn every_spoilt_frame_is_as_expected() {
    is_as_expected("frames", 6);
}

#[test]
fn every_stiff_fit_is_as_expected() {
    is_as_expected("fits", 80);
}

#[test]
fn every_extreme_map_is_as_expected() {
    is_as_expected("maps", 40);
}

#[test]
fn each_part_of_the_table_has_a_test() {
    let names = PARTS.map(|(name, _)| name);
    assert_eq!(names, ["closed forms", "tracer", "frames", "fits", "maps"]);
}
