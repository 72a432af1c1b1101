//! Passes of the tracer on steel computed from the closed form.

use super::*;
use crate::fit::one_variant::estimate;
use crate::fit::{VariantChoice, fit};
use crate::geometry::{Pose, RigGeometry};
use crate::model::{self, Surface, Variant};
use crate::observation::{Observation, Prior};
use crate::trace::scene::MapUnits;
use crate::trace::surfaces::ridge_map::{RidgeMap, height_map_of};

/// Steel at 24 poses, computed from the closed form.
fn set() -> ObservationSet {
    let material = Material::exactly(2.9, 3.1);
    let rig = RigGeometry::IN_PLANE;
    let surface = Surface {
        theta_r: 0.2,
        alpha_u: 0.1,
        alpha_v: 0.12,
        rho_d: 0.0,
        amplitude: 1.0,
    };
    let optics = model::Optics::new(&rig, &material);
    let poses = (0..24).map(|n| {
        let n = f64::from(n);
        Pose::from_deg(10.0 * (n % 4.0) - 15.0, 60.0 * (n / 4.0).floor())
    });
    let observations = poses.map(|pose| {
        Observation::new(
            pose,
            model::radiance(Variant::Sawtooth, &rig.directions(pose), &surface, &optics),
            1e-3,
        )
    });
    ObservationSet::bare(
        rig,
        material,
        observations.collect(),
        Prior {
            mean: 0.0,
            std: 1e-3,
        },
    )
}

#[test]
fn a_watcher_may_stop_the_tracing_and_the_results_until_then_count() {
    let (set, go) = (set(), AtomicBool::new(false));
    let options = FitOptions {
        starts: 2,
        tracer: TracingOptions {
            paths: 64,
            paths_max: 64,
            target_error: None,
        },
        ..FitOptions::default()
    };
    let sawtooth = estimate(&set, Variant::Sawtooth, &options, None, &go).unwrap();
    let traced = |watch: Watch<'_>, profile, cancel: &AtomicBool| {
        estimate_traced(&sawtooth, &options, profile, watch, cancel)
    };
    assert!(traced(&|_| false, None, &go).is_none());
    assert!(traced(&|_| true, None, &AtomicBool::new(true)).is_none());
    let one = traced(&|p| p.pass < 2, None, &go).unwrap().traced.unwrap();
    assert_eq!((one.passes, one.end), (1, TracingEnd::Stopped));
    assert!(one.sigma.iter().all(|s| s.is_finite()) && one.error > 0.0);
    // Rounded edges reflect light elsewhere: the shape of the sample changes the result.
    let sharp = traced(&|_| true, None, &go).unwrap();
    let round = SurfaceProfile::sawtooth(0.25, 1.0, 0.05).unwrap();
    let rounded = traced(&|_| true, Some(&round), &go).unwrap();
    assert!((sharp.values.alpha_v - rounded.values.alpha_v).abs() > 1e-4);
    assert!((rounded.values.theta_r.abs() - 0.2).abs() < 0.02);
    // A height map of that sample, rotated and noisy, gives the same result as its profile.
    let large = SurfaceProfile::sawtooth(0.25, 40.0, 2.0).unwrap();
    let map = height_map_of(&large, 67.0, [300, 260], [1.0, 1.0], 0.05);
    let units = MapUnits {
        pitch_um: [1.0, 1.0],
        height_unit_um: 1.0,
    };
    let measured = RidgeMap::of(&map, units).unwrap().profile;
    // Enough paths to make the noise of the tracer small compared with the differences.
    let well = FitOptions {
        tracer: TracingOptions {
            paths: 2048,
            paths_max: 2048,
            target_error: None,
        },
        ..options
    };
    let [a, b] = [&large, &measured]
        .map(|profile| estimate_traced(&sawtooth, &well, Some(profile), &|_| true, &go).unwrap());
    // The error of the angle by the samples and noise of the map is in its budget, and no other error is.
    let stated =
        |e: &Estimate<'_>| e.traced.as_ref().unwrap().apart.iter().sum::<f64>() / 3f64.sqrt();
    assert_eq!(stated(&a), 0.0);
    assert!((stated(&b) / measured.lobe_error() - 1.0).abs() < 1e-12 && stated(&b) > 1e-5);
    let (a, b) = (a.values, b.values);
    assert!(
        (a.theta_r - b.theta_r).abs().to_degrees() < 0.1,
        "{a:?} {b:?}"
    );
    assert!((a.alpha_u / b.alpha_u - 1.0).abs() < 0.03, "{a:?} {b:?}");
    assert!((a.alpha_v / b.alpha_v - 1.0).abs() < 0.03, "{a:?} {b:?}");
}

#[test]
fn where_the_noise_of_few_paths_makes_it_less_certain_the_report_says_so() {
    let options = FitOptions {
        starts: 2,
        variant: VariantChoice::Traced,
        tracer: TracingOptions {
            paths: 64,
            paths_max: 64,
            target_error: None,
        },
        ..FitOptions::default()
    };
    let report = fit(&set(), &options, &AtomicBool::new(false));
    let said =
        |note: &String| note.contains("less certain about θr") && note.contains("--tracer-error");
    assert!(report.notes.iter().any(said), "{:?}", report.notes);
}
