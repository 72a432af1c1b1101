//! Surfaces that the first round of a search misses: broad lobes that resemble steep ridges, and scans that equal their
//! own mirror images.

use std::sync::atomic::AtomicBool;

use super::FitOptions;
use super::one_variant::estimate;
use super::painted::{TRUTH, painted};
use super::problem::{Quantity, Values};
use super::uncertainty::budget::uncertainty;
use crate::geometry::Pose;
use crate::material::Material;
use crate::model::Variant;
use crate::units::Angle;

fn poses(tilts: i32, step_deg: f64, azimuths_deg: &[f64]) -> impl Iterator<Item = Pose> {
    let first = -0.5 * step_deg * f64::from(tilts - 1);
    (0..tilts).flat_map(move |t| {
        let tilt = first + step_deg * f64::from(t);
        azimuths_deg.iter().map(move |a| Pose::from_deg(tilt, *a))
    })
}

#[test]
fn steep_ridges_without_a_white_reference_are_not_fitted_as_a_broad_lobe() {
    let azimuths: Vec<f64> = (0..12).map(|k| 30.0 * f64::from(k)).collect();
    for (theta_r_deg, alpha_u, alpha_v) in [
        (35.0f64, 0.15, 0.1),
        (40.0, 0.08, 0.144),
        (44.0, 0.25, 0.066),
    ] {
        let truth = Values {
            theta_r: theta_r_deg.to_radians(),
            alpha_u,
            alpha_v,
            azimuth_offset: 0.05,
            tilt_offset: -0.01,
            ..TRUTH
        };
        let mut set = painted(poses(9, 5.0, &azimuths), &truth, 5e-4, 3);
        set.white_reference = None;
        let cancel = AtomicBool::new(false);
        let options = FitOptions::default();
        let e = estimate(&set, Variant::Sawtooth, &options, None, &cancel).unwrap();
        let found = e.values.folded();
        assert!((found.theta_r - truth.theta_r).abs() < 0.01, "{found:?}");
        assert!((found.alpha_v / alpha_v).ln().abs() < 0.1, "{found:?}");
    }
}

#[test]
fn a_scan_along_one_line_of_azimuths_reports_its_mirror_image() {
    for line_deg in [30.0, 60.0, 135.0] {
        let truth = Values {
            theta_r: 0.2,
            azimuth_offset: 0.07,
            ..TRUTH
        };
        let set = painted(
            poses(9, 5.0, &[line_deg, line_deg + 180.0]),
            &truth,
            2e-3,
            5,
        );
        let cancel = AtomicBool::new(false);
        let options = FitOptions::default();
        let e = estimate(&set, Variant::Sawtooth, &options, None, &cancel).unwrap();
        let found = e.values.folded().azimuth_offset;
        let image = -found - 2.0 * line_deg.to_radians();
        let found_image = e.rivals.iter().any(|rival| {
            let there = e.problem.unpack(&rival.parameters).folded().azimuth_offset;
            Angle::from_rad(there - image).wrapped().rad().abs() < 0.02
        });
        assert!(
            found_image,
            "{line_deg}: {found}, {} others",
            e.rivals.len()
        );
    }
}

#[test]
fn the_expanded_uncertainty_covers_another_surface_and_its_uncertainty() {
    let azimuths: Vec<f64> = (0..12).map(|k| 30.0 * f64::from(k)).collect();
    let set = painted(poses(9, 5.0, &azimuths), &TRUTH, 1e-3, 7);
    let cancel = AtomicBool::new(false);
    let options = FitOptions::default();
    let mut e = estimate(&set, Variant::Sawtooth, &options, None, &cancel).unwrap();
    let lean = e.problem.column(Quantity::ThetaR).unwrap();
    assert!(e.rivals.is_empty());
    let mut rougher = e.clone();
    let surface = e.values.folded();
    let mut rival = e.minimum.clone();
    rival.parameters = e.problem.pack(&Values {
        alpha_v: 2.0 * surface.alpha_v,
        ..surface
    });
    rougher.rivals.push(rival);
    let rough = e.problem.column(Quantity::AlphaV);
    // In units of ln α, which are shares of α: α ± U reaches 2 α.
    assert!(2.0 * uncertainty(&rougher).budgets[rough.unwrap()].combined() >= 1.0);
    let own = uncertainty(&e).budgets[lean].combined();
    let away = 0.02;
    let mut rival = e.minimum.clone();
    let here = e.values.folded();
    rival.parameters = e.problem.pack(&Values {
        theta_r: here.theta_r - away,
        ..here
    });
    e.rivals.push(rival);
    let k = 2.0;
    let expanded = k * uncertainty(&e).budgets[lean].combined();
    assert!(
        (expanded - (away + k * own)).abs() < 1e-3 * away,
        "{expanded} {own}"
    );
}

#[test]
fn where_the_data_contradict_the_certificate_the_expanded_uncertainty_reaches_the_values_without_it()
 {
    let azimuths: Vec<f64> = (0..12).map(|k| 30.0 * f64::from(k)).collect();
    let mut set = painted(poses(5, 8.0, &azimuths), &TRUTH, 5e-4, 3);
    set.material = Material::Dielectric {
        eta: 1.5,
        eta_std: 0.004,
    };
    let options = FitOptions {
        misfit: false,
        ..FitOptions::default()
    };
    let never = AtomicBool::new(false);
    let e = estimate(&set, Variant::Sawtooth, &options, None, &never).unwrap();
    let denied = super::causes::contradicted_values::denials(&e);
    assert!(
        denied.iter().any(|d| d.quantity == Quantity::Eta),
        "{denied:?}"
    );
    let j = e.problem.column(Quantity::RhoD).unwrap();
    let budget = uncertainty(&e).budgets[j];
    let off = (e.values.rho_d - TRUTH.rho_d).abs();
    assert!(
        budget.shape > 0.0 && off < 2.0 * budget.combined(),
        "{off} {budget:?}"
    );
}
