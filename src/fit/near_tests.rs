//! Fits of a near camera and lamp, on series computed from the closed form over the pixels' directions.

use std::sync::atomic::AtomicBool;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::model_selection::fit_without_higher_order;
use super::problem::{Problem, Quantity, Values};
use super::report::FitReport;
use super::{FitOptions, VariantChoice};
use crate::geometry::{Cones, Field, Imaging, Pose, RigGeometry};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::{
    FlatObservation, Observation, ObservationSet, Prior, View, WhiteReference, WholeField,
};
use crate::units::Angle;

/// Lobe that the views of a reduction are made for.
const TYPICAL: f64 = 0.08;
const NOISE: f64 = 1e-3;

/// A camera at 250 mm and a lamp at 200 mm over a field of 40 mm, four tilts at six azimuths.
fn series(truth: &Values, seed: u64) -> ObservationSet {
    let rig = RigGeometry {
        cones: Cones::of_lamp(Angle::from_deg(1.0)),
        ..RigGeometry::IN_PLANE
    };
    let field = Field {
        imaging: Imaging {
            rig,
            pixel_mm: [0.4, 0.4],
            tilt_centre_px: [50.0, 50.0],
            principal_point_px: [50.0, 50.0],
            rotation_axis_px: [47.0, 54.0],
            camera_mm: Some(250.0),
            light_mm: Some(200.0),
        },
        width: 100,
        height: 100,
    };
    let pose = |k: u32| {
        Pose::from_deg(
            f64::from(k % 4) * 10.0 - 15.0,
            f64::from(k / 4) * 60.0 + 7.0,
        )
    };
    let observations = (0..24).map(|k| Observation::new(pose(k), 0.0, 1.0));
    let stray_light = Prior {
        mean: 0.0,
        std: 1e-4,
    };
    let plastic = Material::exactly(1.54, 0.0);
    let mut set = ObservationSet {
        field: Some(WholeField {
            field,
            narrowest: TYPICAL,
        }),
        flats: Vec::<FlatObservation>::new(),
        white_reference: Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.005,
        }),
        ..ObservationSet::bare(rig, plastic, observations.collect(), stray_light)
    };
    let views = |set: &ObservationSet, alpha: f64| -> Vec<Vec<View>> {
        let of = |o: &Observation| field.views(o.pose.theta_c, alpha);
        let all = set.observations.iter().map(of);
        all.map(|views| views.into_iter().map(View::from).collect())
            .collect()
    };
    set.views = views(&set, 0.005);
    let free = Quantity::ALL.to_vec();
    let clean = Problem::new(&set, Variant::Sawtooth, free, *truth).predicted(truth);
    let peak = clean.iter().copied().fold(0.0, f64::max);
    let mut draw = rand_pcg::Pcg64::seed_from_u64(seed);
    for (o, clean) in set.observations.iter_mut().zip(clean) {
        o.sigma = NOISE * peak;
        o.signal = clean + o.sigma * draw.sample::<f64, _>(StandardNormal);
    }
    set.views = views(&set, TYPICAL);
    set
}

fn truth(alpha: f64) -> Values {
    Values {
        theta_r: 0.16,
        alpha_u: alpha,
        alpha_v: 1.2 * alpha,
        azimuth_offset: 0.02,
        ..super::painted::TRUTH
    }
}

fn fitted(set: &ObservationSet) -> FitReport {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    fit_without_higher_order(set, &options, &AtomicBool::new(false))
}

/// The largest error of θr, αu and αv as a share of its expanded uncertainty, and the residual as a share of the peak.
fn off(report: &FitReport, truth: &Values) -> [f64; 2] {
    let p = &report.parameters;
    let of = [
        (&p.theta_r_deg, truth.theta_r.to_degrees()),
        (&p.alpha_u, truth.alpha_u),
        (&p.alpha_v, truth.alpha_v),
    ];
    let shares = of.map(|(found, truth)| {
        let (value, expanded) = (
            found.value.expect("determined"),
            found.expanded.expect("determined"),
        );
        (value - truth).abs() / expanded
    });
    let largest = shares.into_iter().fold(0.0, f64::max);
    [largest, report.rms_residual.expect("it has a minimum")]
}

#[test]
fn a_lobe_narrower_than_the_views_of_the_reduction_allow_gets_finer_ones() {
    let truth = truth(0.018);
    let set = series(&truth, 1);
    let [error, residual] = off(&fitted(&set), &truth);
    assert!(error < 1.0 && residual < 1.2 * NOISE, "{error} {residual}");
    // The views of the reduction are no sum of this lobe.
    let free = Quantity::ALL.to_vec();
    let coarse = Problem::new(&set, Variant::Sawtooth, free, truth).predicted(&truth);
    let peak = set
        .observations
        .iter()
        .map(|o| o.signal)
        .fold(0.0, f64::max);
    let pairs = coarse.iter().zip(&set.observations);
    let most = pairs
        .map(|(c, o)| (c - o.signal).abs() / peak)
        .fold(0.0, f64::max);
    assert!(most > 0.1, "{most}");
}

#[test]
fn a_wide_lobe_keeps_the_few_views_that_it_needs() {
    let truth = truth(0.12);
    let set = series(&truth, 2);
    let most = set.views.iter().map(Vec::len).max();
    assert_eq!(most, Some(25));
    assert_eq!(set.with_finer_views(0.12), None);
    let report = fitted(&set);
    let what = "directions of all but 25 of 10000 points of the field";
    assert!(report.left_out.iter().any(|left| left.what == what));
    let [error, residual] = off(&report, &truth);
    assert!(error < 1.0 && residual < 1.2 * NOISE, "{error} {residual}");
}

#[test]
fn finer_views_end_at_the_most_that_a_fit_takes() {
    let set = series(&truth(0.1), 3);
    let finer = set.with_finer_views(1e-4).expect("finer ones");
    assert!(finer.views.iter().all(|views| views.len() == 36 * 36));
    assert_eq!(finer.with_finer_views(1e-5), None);
}
