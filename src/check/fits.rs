//! Fits of sets that are hard or hopeless: a truth that was put in must be covered, or nothing claimed.

use std::sync::atomic::{AtomicBool, Ordering};

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::criterion::{covered, digits, limit, one_of};
use super::{Effort, Row};
use crate::fit::estimate::{estimate, free_quantities};
use crate::fit::loss::Loss;
use crate::fit::problem::{Problem, Quantity, Values};
use crate::fit::report::{FitReport, Status, VariantName};
use crate::fit::reporting::report_of;
use crate::fit::solver::{Settings, minimise};
use crate::fit::variants::fit_with_tier;
use crate::fit::{FitOptions, VariantChoice};
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::model::{Optics, Surface, Variant, radiance};
use crate::observation::{Observation, ObservationSet, Prior, WhiteReference};

const AREA: &str = "fit";
const TRUTH: &str = "truth that was put in";
const NONE: &str = "nothing may be claimed";

/// A polymer's truth; the rows vary it.
fn truth() -> Surface {
    Surface {
        theta_r: 11f64.to_radians(),
        alpha_u: 0.09,
        alpha_v: 0.12,
        rho_d: 0.3,
        amplitude: 1.0,
    }
}

fn material() -> Material {
    Material::Dielectric {
        eta: 1.5,
        eta_std: 0.0,
    }
}

/// A metal that reflects all but a hundredth, and what a lab's ridges of it may be like.
fn metal() -> (Material, Surface) {
    let material = Material::Conductor {
        eta: 1.5,
        k: 30.0,
        eta_std: 0.0,
        k_std: 0.0,
    };
    let surface = Surface {
        rho_d: 0.0,
        ..truth()
    };
    (material, surface)
}

fn poses(tilts: u32, turns: u32) -> Vec<(f64, f64)> {
    (0..tilts)
        .flat_map(|t| {
            let tilt = -20.0 + 40.0 * f64::from(t) / f64::from((tilts - 1).max(1));
            (0..turns).map(move |p| (tilt, 360.0 / f64::from(turns) * f64::from(p)))
        })
        .collect()
}

/// Relative noise of every observation.
const NOISE: f64 = 1e-3;

/// Observations of a polymer with noise, in an absolute unit; `noise` 0 leaves the closed form's own values.
fn set(surface: &Surface, poses: &[(f64, f64)], noise: f64) -> ObservationSet {
    set_of(material(), surface, poses, noise)
}

/// The same of any matter.
fn set_of(
    material: Material,
    surface: &Surface,
    poses: &[(f64, f64)],
    noise: f64,
) -> ObservationSet {
    let rig = RigGeometry::IN_PLANE;
    let optics = Optics::new(&rig, &material);
    let mut random = rand_pcg::Pcg64::seed_from_u64(5);
    let observations: Vec<Observation> = poses
        .iter()
        .map(|(t, p)| {
            let pose = Pose::from_deg(*t, *p);
            let clean = radiance(Variant::Sawtooth, &rig.directions(pose), surface, &optics);
            let draw: f64 = random.sample(StandardNormal);
            Observation::new(pose, clean * (1.0 + noise * draw), NOISE * clean)
        })
        .collect();
    let peak = observations.iter().map(|o| o.signal).fold(0.0, f64::max);
    ObservationSet {
        white_reference: Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.005,
        }),
        ..ObservationSet::bare(
            rig,
            material,
            observations,
            Prior {
                mean: 0.0,
                std: 1e-4 * peak,
            },
        )
    }
}

/// A fit without the integrated second bounce, since the truth here is the closed form itself.
fn fitted(set: &ObservationSet, cancel: &AtomicBool) -> FitReport {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    fit_with_tier(set, &options, None, cancel)
}

/// The same where nothing can be refused beforehand: without the printed variant, which these sets do not ask about
/// and which takes half of the time.
pub(super) fn fitted_in_full(set: &ObservationSet, loss: Loss, cancel: &AtomicBool) -> FitReport {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        loss,
        ..FitOptions::default()
    };
    match estimate(set, Variant::Sawtooth, &options, None, cancel) {
        Some(found) => report_of(&found, VariantName::Sawtooth),
        None => fit_with_tier(set, &options, None, cancel),
    }
}

fn word(status: Status) -> String {
    serde_json::to_value(status)
        .ok()
        .and_then(|v| v.as_str().map(str::to_owned))
        .unwrap_or_default()
}

/// Whether a set tells every parameter.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Tells {
    /// It does: a fit that claims nothing has failed.
    All,
    /// It need not: what is claimed must hold.
    Perhaps,
}

/// Every parameter that the report gives a number for must cover its truth.
fn coverage(rows: &mut Vec<Row>, name: &str, surface: &Surface, report: &FitReport, tells: Tells) {
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
            // A metal has no diffuse part to be told.
            _ if tells == Tells::All && !(metal && parameter == "rho_d") => {
                one_of(&["a number"], "null")
            }
            _ => one_of(&["null"], "null"),
        };
        rows.push(Row::new(AREA, name, parameter, TRUTH, judged));
    }
}

/// Whether a report claims a ridge angle.
pub(super) fn claim(report: &FitReport) -> String {
    if report.status == Status::Converged && report.parameters.theta_r_deg.value.is_some() {
        "a ridge angle".to_owned()
    } else {
        word(report.status)
    }
}

/// How a fit of nothing may end.
pub(super) const HOPELESS: [&str; 5] = [
    "at-bound",
    "rank-deficient",
    "stalled",
    "not-finite",
    "too-few-observations",
];

pub(super) fn rows(effort: Effort, cancel: &AtomicBool) -> Vec<Row> {
    let mut rows = Vec::new();
    let surface = truth();
    let mut narrow = surface;
    (narrow.alpha_u, narrow.alpha_v) = (0.012, 0.01);
    let (mirror, steel) = metal();
    let mut ways = vec![
        (
            "9 tilts, 12 azimuths",
            material(),
            surface,
            poses(9, 12),
            Tells::All,
        ),
        (
            "one azimuth only",
            material(),
            surface,
            poses(9, 1),
            Tells::Perhaps,
        ),
        (
            "one tilt only",
            material(),
            surface,
            poses(1, 36),
            Tells::Perhaps,
        ),
        (
            "lobes of alpha 0.01 on a coarse grid",
            material(),
            narrow,
            poses(17, 36),
            Tells::All,
        ),
        ("k = 30", mirror, steel, poses(9, 12), Tells::All),
        (
            "k = 30, one azimuth only",
            mirror,
            steel,
            poses(9, 1),
            Tells::Perhaps,
        ),
    ];
    if effort == Effort::Full {
        ways.push((
            "a million observations",
            material(),
            surface,
            poses(1000, 1000),
            Tells::All,
        ));
    }
    for (name, material, surface, poses, tells) in ways {
        if cancel.load(Ordering::Relaxed) {
            return rows;
        }
        let set = set_of(material, &surface, &poses, NOISE);
        let report = fitted_in_full(&set, Loss::Linear, cancel);
        coverage(&mut rows, name, &surface, &report, tells);
    }
    hopeless(&mut rows, cancel);
    units(&mut rows, cancel);
    outliers(&mut rows, cancel);
    far_starts(&mut rows, cancel);
    rows
}

fn hopeless(rows: &mut Vec<Row>, cancel: &AtomicBool) {
    let surface = truth();
    let two = fitted(&set(&surface, &poses(2, 1), NOISE), cancel);
    let judged = one_of(&["too-few-observations"], &word(two.status));
    rows.push(Row::new(AREA, "two observations", "status", NONE, judged));

    let mut flat = set(&surface, &poses(9, 12), 0.0);
    for o in &mut flat.observations {
        (o.signal, o.sigma) = (0.1, 1e-4);
    }
    let judged = one_of(
        &HOPELESS,
        &claim(&fitted_in_full(&flat, Loss::Linear, cancel)),
    );
    rows.push(Row::new(
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
    rows.push(Row::new(
        AREA,
        "all observations zero",
        "claim",
        NONE,
        judged,
    ));

    let mut broken = set(&surface, &poses(9, 12), NOISE);
    broken.observations[7].signal = f64::INFINITY;
    let judged = one_of(&["not-finite"], &word(fitted(&broken, cancel).status));
    rows.push(Row::new(
        AREA,
        "an infinite observation",
        "status",
        NONE,
        judged,
    ));
}

/// A change of unit by 1e12 either way changes nothing but the scale; with a white reference, whose unit
/// is absolute, it is a contradiction that must be told.
fn units(rows: &mut Vec<Row>, cancel: &AtomicBool) {
    let plain = ObservationSet {
        white_reference: None,
        ..set(&truth(), &poses(9, 12), NOISE)
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
                // Both end at the minimum to well below what it means.
                (Some(x), Some(std), Some(y)) => limit(0.0, 1e-3, (y / factor - x) / std),
                (None, _, None) => one_of(&["null"], "null"),
                (x, _, y) => one_of(&[&format!("{x:?}")], &format!("{y:?}")),
            };
            let quantity = format!("{parameter}, change over its uncertainty");
            rows.push(Row::new(
                AREA,
                name.clone(),
                quantity,
                "a change of units",
                judged,
            ));
        }
    }
    let absolute = set(&truth(), &poses(9, 12), NOISE);
    for unit in [1e12, 1e-12] {
        let report = fitted_in_full(&scaled(&absolute, unit), Loss::Linear, cancel);
        let judged = one_of(&HOPELESS, &claim(&report));
        let name = format!("unit off by {unit:e}, with a white reference");
        rows.push(Row::new(AREA, name, "claim", NONE, judged));
    }
}

/// Tukey's loss where a third of the observations is anything.
fn outliers(rows: &mut Vec<Row>, cancel: &AtomicBool) {
    let (mirror, steel) = metal();
    for (what, material, surface) in [
        ("a plastic's", material(), truth()),
        ("a metal's", mirror, steel),
    ] {
        let mut spoilt = set_of(material, &surface, &poses(9, 12), NOISE);
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
            "30 % of {what} observations are any number up to twice the peak, Tukey's loss"
        );
        coverage(rows, &name, &surface, &report, Tells::All);
    }
}

/// Descents that start ten lobe widths from the truth, with lobes broadened to reach it, as starts are.
fn far_starts(rows: &mut Vec<Row>, cancel: &AtomicBool) {
    let (mirror, steel) = metal();
    for (what, material, surface) in [("", material(), truth()), (", k = 30", mirror, steel)] {
        for (alpha, side) in [(0.01, 10.0), (0.01, -10.0), (0.02, 10.0), (0.04, 10.0)] {
            let mut surface = surface;
            (surface.alpha_u, surface.alpha_v) = (alpha, alpha);
            let set = set_of(material, &surface, &poses(33, 36), 0.0);
            let found = from_afar(&set, &surface, side, cancel);
            let way = if side > 0.0 { "above" } else { "below" };
            let name = format!("start ten lobe widths {way}, alpha {alpha}{what}");
            // The residual is zero there, so the minimum is known to rounding times its condition (the
            // descent stops at a step of 1e-12).
            let judged = digits(surface.theta_r, 1e5, found.theta_r);
            rows.push(Row::new(AREA, name.clone(), "theta_r, rad", TRUTH, judged));
            let judged = digits(alpha, 1e5, found.alpha_v);
            rows.push(Row::new(AREA, name, "alpha_v", TRUTH, judged));
        }
    }
}

/// Where a single descent ends that starts `widths` lobe widths from the truth in θr.
fn from_afar(set: &ObservationSet, surface: &Surface, widths: f64, cancel: &AtomicBool) -> Values {
    let (free, fixed) = free_quantities(set, Variant::Sawtooth);
    let free: Vec<Quantity> = free
        .into_iter()
        .filter(|q| *q != Quantity::TiltOffset)
        .collect();
    let problem = Problem::new(set, Variant::Sawtooth, free, fixed);
    // Weights by counting noise would make the dim poses decide where the lobe goes.
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
    let minimum = minimise(
        &problem,
        &problem.pack(&start),
        &problem.bounds(),
        &Settings::default(),
        cancel,
    );
    problem.unpack(&minimum.parameters).folded()
}
