//! Fits of difficult or hopeless observations: a fit must cover the known truth, or give no value.

use std::sync::atomic::{AtomicBool, Ordering};

use rand::{RngExt, SeedableRng};

use super::criterion::{covered, digits, limit, one_of};
use super::{CheckEffort, CheckRow};
use crate::cases::{
    MIRROR, POLYMER, PaintedError, PaintedScan, PaintedSigma, SampleCase, pose_grid,
};
use crate::fit::least_squares::levenberg_marquardt::Settings;
use crate::fit::loss::Loss;
use crate::fit::model_selection::fit_without_higher_order;
use crate::fit::one_variant::estimate;
use crate::fit::problem::{Problem, Quantity, Values};
use crate::fit::report::build::report_of;
use crate::fit::report::{FitReport, Status, VariantName};
use crate::fit::search_setup::free_quantities;
use crate::fit::{FitOptions, VariantChoice};
use crate::geometry::{Pose, RigGeometry};
use crate::model::{Surface, Variant};
use crate::observation::ObservationSet;

const AREA: &str = "fit";
const TRUTH: &str = "known truth";
const NONE: &str = "no value is possible";

/// Relative noise of every observation.
const NOISE: f64 = 1e-3;

/// Observations of a sample with noise, on an absolute scale.
fn noisy(sample: SampleCase, poses: &[Pose]) -> ObservationSet {
    painted(sample, poses, PaintedError::Noise(NOISE, 5))
}

fn painted(sample: SampleCase, poses: &[Pose], error: PaintedError) -> ObservationSet {
    let scan = PaintedScan {
        rig: RigGeometry::IN_PLANE,
        sample,
        poses,
        error,
        sigma: PaintedSigma::Relative(NOISE),
    };
    scan.observations()
}

/// Fits without the integrated second bounce, because the closed form made the observations.
fn fitted(set: &ObservationSet, cancel: &AtomicBool) -> FitReport {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    fit_without_higher_order(set, &options, cancel)
}

/// Fits in the same way, but skips the printed variant where possible; it takes half of the time and is not checked here.
pub(super) fn fitted_in_full(set: &ObservationSet, loss: Loss, cancel: &AtomicBool) -> FitReport {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        loss,
        ..FitOptions::default()
    };
    match estimate(set, Variant::Sawtooth, &options, None, cancel) {
        Some(found) => report_of(&found, VariantName::Sawtooth),
        None => fit_without_higher_order(set, &options, cancel),
    }
}

fn word(status: Status) -> String {
    serde_json::to_value(status)
        .ok()
        .and_then(|v| v.as_str().map(str::to_owned))
        .unwrap_or_default()
}

/// Which parameters a set determines.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Determines {
    /// All of them: a fit that gives no value has failed.
    All,
    /// Possibly only some; the values that a fit gives must be right.
    Some,
}

/// Every value of the report must cover its truth.
fn coverage(
    rows: &mut Vec<CheckRow>,
    name: &str,
    surface: &Surface,
    report: &FitReport,
    determines: Determines,
) {
    let metal = surface.rho_d == 0.0;
    let known = [
        ("theta_r_deg", surface.theta_r.to_degrees()),
        ("alpha_u", surface.alpha_u),
        ("alpha_v", surface.alpha_v),
        ("rho_d", surface.rho_d),
        ("azimuth_offset_deg", 0.0),
        ("tilt_offset_deg", 0.0),
    ];
    for (parameter, p) in report.parameters.named() {
        let Some((_, truth)) = known.iter().find(|(n, _)| *n == parameter) else {
            continue;
        };
        let judged = match (p.value, p.std) {
            (Some(value), Some(std)) => covered(*truth, std, value),
            // A metal has no diffuse reflectance.
            _ if determines == Determines::All && !(metal && parameter == "rho_d") => {
                one_of(&["a number"], "null")
            }
            _ => one_of(&["null"], "null"),
        };
        rows.push(CheckRow::new(AREA, name, parameter, TRUTH, judged));
    }
}

/// The ridge angle that a report claims, or its status.
pub(super) fn claim(report: &FitReport) -> String {
    if report.status == Status::Converged && report.parameters.theta_r_deg.value.is_some() {
        "a ridge angle".to_owned()
    } else {
        word(report.status)
    }
}

/// Statuses in which a fit without information may end.
pub(super) const HOPELESS: [&str; 5] = [
    "at-bound",
    "rank-deficient",
    "stalled",
    "not-finite",
    "too-few-observations",
];

pub(super) fn rows(effort: CheckEffort, cancel: &AtomicBool) -> Vec<CheckRow> {
    let mut rows = Vec::new();
    let narrow = POLYMER.with_alpha(0.012, 0.01);
    let (all, some) = (Determines::All, Determines::Some);
    let mut scans = vec![
        ("9 tilts, 12 azimuths", POLYMER, (9, 12), all),
        ("one azimuth only", POLYMER, (9, 1), some),
        ("one tilt only", POLYMER, (1, 36), some),
        (
            "lobes of alpha 0.01 on a coarse grid",
            narrow,
            (17, 36),
            all,
        ),
        ("k = 30", MIRROR, (9, 12), all),
        ("k = 30, one azimuth only", MIRROR, (9, 1), some),
    ];
    if effort == CheckEffort::Full {
        scans.push(("a million observations", POLYMER, (1000, 1000), all));
    }
    for (name, sample, (tilts, azimuths), determines) in scans {
        if cancel.load(Ordering::Relaxed) {
            return rows;
        }
        let set = noisy(sample, &pose_grid(tilts, azimuths));
        let report = fitted_in_full(&set, Loss::Linear, cancel);
        coverage(&mut rows, name, &sample.surface, &report, determines);
    }
    hopeless(&mut rows, cancel);
    units(&mut rows, cancel);
    outliers(&mut rows, cancel);
    far_starts(&mut rows, cancel);
    rows
}

fn hopeless(rows: &mut Vec<CheckRow>, cancel: &AtomicBool) {
    let grid = pose_grid(9, 12);
    let two = fitted(&noisy(POLYMER, &pose_grid(2, 1)), cancel);
    let judged = one_of(&["too-few-observations"], &word(two.status));
    rows.push(CheckRow::new(
        AREA,
        "two observations",
        "status",
        NONE,
        judged,
    ));

    let mut flat = painted(POLYMER, &grid, PaintedError::None);
    for o in &mut flat.observations {
        (o.signal, o.sigma) = (0.1, 1e-4);
    }
    let judged = one_of(
        &HOPELESS,
        &claim(&fitted_in_full(&flat, Loss::Linear, cancel)),
    );
    rows.push(CheckRow::new(
        AREA,
        "all observations equal",
        "claim",
        NONE,
        judged,
    ));

    for o in &mut flat.observations {
        o.signal = 0.0;
    }
    let judged = one_of(
        &HOPELESS,
        &claim(&fitted_in_full(&flat, Loss::Linear, cancel)),
    );
    rows.push(CheckRow::new(
        AREA,
        "all observations zero",
        "claim",
        NONE,
        judged,
    ));

    let mut broken = noisy(POLYMER, &grid);
    broken.observations[7].signal = f64::INFINITY;
    let judged = one_of(&["not-finite"], &word(fitted(&broken, cancel).status));
    rows.push(CheckRow::new(
        AREA,
        "an infinite observation",
        "status",
        NONE,
        judged,
    ));
}

/// A change of unit by 1e12 in either direction changes only the scale. With a white reference, whose unit
/// is absolute, it is a contradiction that the fit must report.
fn units(rows: &mut Vec<CheckRow>, cancel: &AtomicBool) {
    let plain = ObservationSet {
        white_reference: None,
        ..noisy(POLYMER, &pose_grid(9, 12))
    };
    let scaled = |set: &ObservationSet, unit: f64| {
        let mut other = set.clone();
        for o in &mut other.observations {
            o.signal *= unit;
            o.sigma *= unit;
        }
        other.background.mean *= unit;
        other.background.std *= unit;
        other
    };
    let reference = fitted_in_full(&plain, Loss::Linear, cancel);
    for unit in [1e12, 1e-12] {
        let name = format!("unit off by {unit:e}, no white reference");
        let found = fitted_in_full(&scaled(&plain, unit), Loss::Linear, cancel);
        for ((parameter, a), (_, b)) in reference
            .parameters
            .named()
            .iter()
            .zip(found.parameters.named())
        {
            let factor = if ["scale", "background"].contains(parameter) {
                unit
            } else {
                1.0
            };
            let judged = match (a.value, a.std, b.value) {
                // Both fits reach the minimum to far less than its uncertainty.
                (Some(x), Some(std), Some(y)) => limit(0.0, 1e-3, (y / factor - x) / std),
                (None, _, None) => one_of(&["null"], "null"),
                (x, _, y) => one_of(&[&format!("{x:?}")], &format!("{y:?}")),
            };
            let quantity = format!("{parameter}, change over its uncertainty");
            rows.push(CheckRow::new(
                AREA,
                name.clone(),
                quantity,
                "a change of units",
                judged,
            ));
        }
    }
    let absolute = noisy(POLYMER, &pose_grid(9, 12));
    for unit in [1e12, 1e-12] {
        let report = fitted_in_full(&scaled(&absolute, unit), Loss::Linear, cancel);
        let judged = one_of(&HOPELESS, &claim(&report));
        let name = format!("unit off by {unit:e}, with a white reference");
        rows.push(CheckRow::new(AREA, name, "claim", NONE, judged));
    }
}

/// Tukey's loss where a third of the observations is random.
fn outliers(rows: &mut Vec<CheckRow>, cancel: &AtomicBool) {
    for (what, sample) in [("a plastic's", POLYMER), ("a metal's", MIRROR)] {
        let mut spoilt = noisy(sample, &pose_grid(9, 12));
        let peak = spoilt
            .observations
            .iter()
            .map(|o| o.signal)
            .fold(0.0, f64::max);
        let mut random = rand_pcg::Pcg64::seed_from_u64(9);
        for o in &mut spoilt.observations {
            if random.random::<f64>() < 0.3 {
                o.signal = 2.0 * peak * random.random::<f64>();
            }
        }
        let report = fitted_in_full(&spoilt, Loss::Tukey, cancel);
        let name = format!(
            "30 % of {what} observations are random numbers up to twice the peak, Tukey's loss"
        );
        coverage(rows, &name, &sample.surface, &report, Determines::All);
    }
}

/// Descents that start ten lobe widths from the truth, with lobes broadened to reach it, as the starts of a search.
fn far_starts(rows: &mut Vec<CheckRow>, cancel: &AtomicBool) {
    for (what, sample) in [("", POLYMER), (", k = 30", MIRROR)] {
        for (alpha, side) in [(0.01, 10.0), (0.01, -10.0), (0.02, 10.0), (0.04, 10.0)] {
            let sample = sample.with_alpha(alpha, alpha);
            let surface = sample.surface;
            let set = painted(sample, &pose_grid(33, 36), PaintedError::None);
            let found = descent_from_afar(&set, &surface, side, cancel);
            let way = if side > 0.0 { "above" } else { "below" };
            let name = format!("start ten lobe widths {way}, alpha {alpha}{what}");
            // The residual is zero there, so the minimum is exact to rounding times its condition (the
            // descent stops at a step of 1e-12).
            let judged = digits(surface.theta_r, 1e5, found.theta_r);
            rows.push(CheckRow::new(
                AREA,
                name.clone(),
                "theta_r, rad",
                TRUTH,
                judged,
            ));
            let judged = digits(alpha, 1e5, found.alpha_v);
            rows.push(CheckRow::new(AREA, name, "alpha_v", TRUTH, judged));
        }
    }
}

/// The end of a single descent that starts `widths` lobe widths from the truth in θr.
fn descent_from_afar(
    set: &ObservationSet,
    surface: &Surface,
    widths: f64,
    cancel: &AtomicBool,
) -> Values {
    let (free, fixed) = free_quantities(set, Variant::Sawtooth);
    let free: Vec<Quantity> = free
        .into_iter()
        .filter(|q| *q != Quantity::TiltOffset)
        .collect();
    let problem = Problem::new(set, Variant::Sawtooth, free, fixed);
    // With weights from counting noise the dim poses would determine the lobe.
    let peak = set
        .observations
        .iter()
        .map(|o| o.signal)
        .fold(0.0, f64::max);
    let problem = problem.with_sigma(vec![NOISE * peak; set.observations.len()]);
    let mut start = fixed;
    // A slope of α on the surface is an angle of α.
    let away = widths * surface.alpha_u;
    start.theta_r = surface.theta_r + away;
    let broad = Surface {
        theta_r: start.theta_r,
        ..*surface
    }
    .broadened(away.abs());
    (start.alpha_u, start.alpha_v) = (broad.alpha_u, broad.alpha_v);
    start.rho_d = if surface.rho_d > 0.0 { 0.1 } else { 0.0 };
    let minimum = problem.descend(&problem.pack(&start), &Settings::DEFAULT, cancel);
    problem.unpack(&minimum.parameters).folded()
}
