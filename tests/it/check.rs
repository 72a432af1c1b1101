//! The table of stiff and extreme cases, as `ridged check --quick` computes it.

use std::sync::atomic::AtomicBool;

use ridged::check::{CheckEffort, run};

#[test]
fn every_stiff_and_extreme_case_is_as_expected() {
    let rows = run(
        CheckEffort::Quick,
        &AtomicBool::new(false),
        &mut |_, _, _| {},
    );
    let off: Vec<_> = rows.iter().filter(|r| !r.judged.as_expected).collect();
    assert!(off.is_empty(), "{off:#?}");
    // All five parts were there.
    assert!(rows.len() > 1000, "{} rows", rows.len());
}
