//! Rows, sections and columns of the report as text.

use std::sync::atomic::AtomicBool;

use super::*;
use crate::fit::painted::{TRUTH, painted};
use crate::fit::{FitOptions, fit};
use crate::geometry::Pose;

#[test]
fn notes_follow_the_warnings() {
    let one = painted(std::iter::once(Pose::from_deg(0.0, 0.0)), &TRUTH, 1e-3, 1);
    let mut report = fit(&one, &FitOptions::default(), &AtomicBool::new(false));
    assert!(!table(&report, &Form::PLAIN).contains("notes"));
    report.notes.push("No action is needed.".to_owned());
    let text = table(&report, &Form::PLAIN);
    let place = |section: &str| text.find(section).unwrap_or_else(|| panic!("{text}"));
    assert!(place("\nwarnings\n  · ") < place("\nnotes\n  · No action is needed.\n"));
}

#[test]
fn a_row_shows_two_digits_of_the_uncertainty_and_its_largest_parts() {
    let budget = Budget {
        material: 0.017,
        model: 0.011,
        counting: 0.0001,
        ..Budget::default()
    };
    let angle = Parameter::known(10.01732, budget, None);
    let name = names::quantity("theta_r_deg");
    let text = row(name, &angle, 100);
    assert!(text.contains("10.017 ± 0.040° "), "{text}");
    assert!(text.contains("material 0.017, model 0.011"), "{text}");
    assert!(!text.contains("counting"), "{text}");
    // In a narrow terminal the largest part is shown.
    let text = row(name, &angle, 60);
    assert!(text.ends_with("material 0.017"), "{text}");
}

#[test]
fn a_row_states_its_own_coverage_factor_where_it_is_not_two() {
    let budget = Budget {
        model: 0.02,
        ..Budget::default()
    };
    let text = |freedom| {
        let angle = Parameter::known(10.0, budget, freedom);
        row(names::quantity("theta_r_deg"), &angle, 100)
    };
    assert!(text(Some(2.0)).contains("± 0.091°"), "{}", text(Some(2.0)));
    assert!(
        text(Some(2.0)).contains("k = 4.53; model 0.020"),
        "{}",
        text(Some(2.0))
    );
    assert!(!text(Some(60.0)).contains("k = "), "{}", text(Some(60.0)));
}

#[test]
fn a_row_in_a_narrow_terminal_is_two_lines_that_fit() {
    let budget = Budget {
        model: 0.02,
        ..Budget::default()
    };
    let angle = Parameter::known(-0.0001, budget, Some(2.0));
    let text = row(names::quantity("azimuth_offset_deg"), &angle, 40);
    assert_eq!(
        text,
        "  Δφs azimuth offset\n      0.000 ± 0.091° (k = 4.53)"
    );
    assert!(text.lines().all(|line| width(line) <= 40), "{text}");
}

#[test]
fn an_undetermined_parameter_shows_no_number() {
    let text = row(
        names::quantity("rho_d"),
        &Parameter::unknown("no reference"),
        100,
    );
    assert!(!text.chars().any(|c| c.is_ascii_digit()), "{text}");
}

#[test]
fn the_answer_is_the_last_line_and_a_brief_result_has_only_the_parameters() {
    let poses = [-20.0, 0.0, 20.0].into_iter().flat_map(|tilt| {
        let azimuths = [0.0, 60.0, 120.0, 180.0, 300.0];
        azimuths.map(|azimuth| Pose::from_deg(tilt, azimuth))
    });
    let set = painted(poses, &TRUTH, 1e-3, 1);
    let report = fit(&set, &FitOptions::default(), &AtomicBool::new(false));
    let narrow = Form {
        columns: 80,
        ..Form::PLAIN
    };
    let text = table(&report, &narrow);
    let last = text.lines().last().unwrap();
    assert!(
        last.starts_with("θr = ") && last.contains("(k = "),
        "{last}"
    );
    for line in text.lines().skip(2) {
        assert!(width(line) <= 80, "{line}");
    }
    let brief = Form {
        brief: true,
        ..narrow
    };
    let parameters = report.parameters.named().len();
    assert_eq!(table(&report, &brief).lines().count(), 3 + parameters);
}
