//! What the fits are judged by, none of it taken from the fit: derivatives by differences of the
//! plain closed form at the truth, and a crowd of starts.

use std::sync::atomic::AtomicBool;

use nalgebra::DMatrix;
use ridged::fit::least_squares::LeastSquares;
use ridged::fit::least_squares::levenberg_marquardt::{Minimum, Settings};
use ridged::fit::problem::{Problem, Quantity, Values};
use ridged::fit::search_setup::free_quantities;
use ridged::model::Variant;

use crate::draw::{Case, Draw, Stratum, Truth, painted};

/// Whether a χ² counts as the deepest, given its excess over the crowd's best.
pub fn is_deepest(chi2: f64, excess: f64) -> bool {
    excess <= 1e-6 * chi2.max(1.0)
}

/// What of the model can be moved, in natural units with logarithms of the roughnesses.
pub fn moved(truth: &Truth, quantity: Quantity, step: f64) -> Truth {
    let mut t = *truth;
    match quantity {
        Quantity::ThetaR => t.surface.theta_r += step,
        Quantity::AlphaU => t.surface.alpha_u *= step.exp(),
        Quantity::AlphaV => t.surface.alpha_v *= step.exp(),
        Quantity::RhoD => t.surface.rho_d += step,
        Quantity::Scale => t.scale *= 1.0 + step,
        Quantity::Background => t.background += step,
        Quantity::AzimuthOffset => t.azimuth_offset += step,
        Quantity::TiltOffset => t.tilt_offset += step,
        _ => {}
    }
    t
}

/// The truth's value of a quantity, in the unit of the solver.
pub fn true_value(truth: &Truth, quantity: Quantity) -> f64 {
    values(truth).inner(quantity)
}

/// The truth in the fit's form.
pub fn values(truth: &Truth) -> Values {
    Values {
        theta_r: truth.surface.theta_r,
        alpha_u: truth.surface.alpha_u,
        alpha_v: truth.surface.alpha_v,
        rho_d: truth.surface.rho_d,
        scale: truth.scale,
        background: truth.background,
        azimuth_offset: truth.azimuth_offset,
        tilt_offset: truth.tilt_offset,
        ..Values::IDEAL
    }
}

/// Linear standard uncertainties at the truth, and whether the case counts as identifiable.
pub struct Linear {
    pub std: Vec<f64>,
    pub identifiable: bool,
}

/// Derivatives by fourth-order differences, information by singular values.
pub fn linear(case: &Case, free: &[Quantity]) -> Linear {
    let (set, truth) = (&case.set, &case.truth);
    let m = set.observations.len();
    let n = free.len();
    let width = |a: f64| (a * a + set.rig.cones.widening()).sqrt();
    let narrow = width(truth.surface.alpha_u).min(width(truth.surface.alpha_v));
    let mut j = DMatrix::<f64>::zeros(m + 1, n);
    for (k, q) in free.iter().enumerate() {
        let h = match q {
            Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset => 1e-3 * narrow,
            Quantity::Background => 1e-3 * set.background.std,
            Quantity::RhoD => 1e-4,
            _ => 1e-3,
        };
        for (i, o) in set.observations.iter().enumerate() {
            let at = |s: f64| painted(case.variant, set, o.pose, &moved(truth, *q, s * h));
            let slope = (at(-2.0) - 8.0 * at(-1.0) + 8.0 * at(1.0) - at(2.0)) / (12.0 * h);
            j[(i, k)] = slope / o.sigma;
        }
        if *q == Quantity::Background {
            j[(m, k)] = 1.0 / set.background.std;
        }
    }
    let lengths: Vec<f64> = (0..n).map(|k| j.column(k).norm()).collect();
    for (k, l) in lengths.iter().enumerate() {
        if *l > 0.0 {
            j.column_mut(k).scale_mut(1.0 / l);
        }
    }
    let svd = j.svd(false, true);
    let v_t = svd.v_t.expect("asked for");
    let std: Vec<f64> = (0..n)
        .map(|k| {
            let sum: f64 = (0..n)
                .map(|s| (v_t[(s, k)] / svd.singular_values[s].max(1e-300)).powi(2))
                .sum();
            sum.sqrt() / lengths[k]
        })
        .collect();
    let of = |q: Quantity| {
        let k = free.iter().position(|f| *f == q);
        k.map_or(f64::INFINITY, |k| std[k])
    };
    let identifiable = of(Quantity::ThetaR) < 2f64.to_radians()
        && of(Quantity::AlphaU) < 0.3
        && of(Quantity::AlphaV) < 0.3
        && in_lobe(case) >= 3;
    Linear { std, identifiable }
}

/// Observations whose half vector lies where the facets' lobe is above 5 % of its top.
fn in_lobe(case: &Case) -> usize {
    let (set, t) = (&case.set, &case.truth);
    let (s, c) = t.surface.theta_r.sin_cos();
    let lamp = set.rig.cones.widening();
    let inside = |o: &&ridged::observation::Observation| {
        let pose = ridged::geometry::Pose {
            theta_c: o.pose.theta_c + ridged::units::Angle::from_rad(t.tilt_offset),
            phi_s: o.pose.phi_s + ridged::units::Angle::from_rad(t.azimuth_offset),
        };
        let d = set.rig.directions(pose);
        let h = d.incident + d.outgoing;
        let m = h.y * s + h.z * c;
        let (x, y) = (h.x / m, (h.y * c - h.z * s) / m);
        let (au, av) = (t.surface.alpha_u, t.surface.alpha_v);
        m > 0.0 && x * x / (au * au + lamp) + y * y / (av * av + lamp) < 3.0
    };
    set.observations.iter().filter(inside).count()
}

/// χ² of the best of `count` polished starts drawn from the stratum, the truth among them.
pub fn best_of(case: &Case, stratum: Stratum, count: usize, seed: u64) -> (f64, Values) {
    let (free, fixed) = free_quantities(&case.set, case.variant);
    let problem = Problem::new(&case.set, case.variant, free, fixed);
    let mut draw = Draw::new(seed ^ 0x5eed);
    let rough = Settings::ROUGH.within(200);
    let mut ends: Vec<Minimum> = Vec::new();
    let metal = case.truth.surface.rho_d == 0.0;
    let cancel = AtomicBool::new(false);
    for k in 0..count {
        let mut start = values(&case.truth);
        start.eta = fixed.eta;
        start.k = fixed.k;
        if k > 0 {
            let (surface, azimuth, tilt) = stratum.surface(&mut draw, metal);
            start.theta_r = surface.theta_r;
            start.alpha_u = surface.alpha_u;
            start.alpha_v = surface.alpha_v;
            start.rho_d = surface.rho_d;
            start.azimuth_offset = azimuth;
            start.tilt_offset = tilt;
        }
        if !problem.free().contains(&Quantity::RhoD) {
            start.rho_d = fixed.rho_d;
        }
        if !problem.free().contains(&Quantity::Scale) {
            start.scale = fixed.scale;
        } else if case.variant == Variant::Paper && k == 0 && !metal {
            // The printed lobe's ρd is part of the scale then.
            start.scale *= amplitude(case);
        }
        // The truth is polished in any case.
        let settings = if k == 0 { Settings::default() } else { rough };
        let start = problem.pack(&start);
        ends.push(problem.descend(&start, &settings, &cancel));
    }
    ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    // A rough end is within a hundredth of its minimum, or still far up a slope; of those that could
    // still win the different ones are polished.
    let least = ends.first().map_or(f64::INFINITY, |m| m.cost);
    let mut best = (f64::INFINITY, fixed);
    let mut polished: Vec<f64> = Vec::new();
    for m in &ends {
        let near = |cost: &f64| (m.cost - cost).abs() <= 1e-4 * cost.max(1e-3);
        let hopeless = m.cost > 1.1 * least + 10.0;
        if hopeless || polished.len() >= POLISHED || polished.iter().any(near) {
            continue;
        }
        polished.push(m.cost);
        let m = problem.descend(&m.parameters, &Settings::DEFAULT, &cancel);
        if m.cost < best.0 {
            best = (m.cost, problem.unpack(&m.parameters));
        }
    }
    best
}

/// Different ends of a crowd that are polished.
const POLISHED: usize = 12;

/// [F + (ρd/π)(1 − F)²]/F at the rig's difference angle.
fn amplitude(case: &Case) -> f64 {
    let optics = ridged::model::Optics::new(&case.set.rig, &case.set.material);
    let d = case.set.rig.rig_directions(ridged::units::Angle::ZERO);
    let bare = ridged::model::Surface {
        theta_r: 0.0,
        alpha_u: 0.5,
        alpha_v: 0.5,
        rho_d: 0.0,
        amplitude: 1.0,
    };
    let full = ridged::model::Surface {
        rho_d: case.truth.surface.rho_d,
        ..bare
    };
    let at = |s| ridged::model::radiance(Variant::Paper, &d, s, &optics);
    at(&full) / at(&bare)
}

/// χ² of given values with the observations' own uncertainties, by the plain closed form.
pub fn chi2(case: &Case, v: &Values) -> f64 {
    let truth = Truth {
        surface: v.surface(),
        scale: v.scale,
        background: v.background,
        azimuth_offset: v.azimuth_offset,
        tilt_offset: v.tilt_offset,
    };
    let b = &case.set.background;
    let prior = ((v.background - b.mean) / b.std).powi(2);
    let terms =
        case.set.observations.iter().map(|o| {
            ((painted(case.variant, &case.set, o.pose, &truth) - o.signal) / o.sigma).powi(2)
        });
    prior + terms.sum::<f64>()
}

/// Whether a quantity has part in a direction along which nothing at all changes at `v`, judged by
/// singular values of the fit's own problem, built again.
pub fn null_parts(case: &Case, v: &Values) -> Vec<Quantity> {
    let (free, mut fixed) = free_quantities(&case.set, case.variant);
    fixed.rho_d = v.rho_d;
    let problem = Problem::new(&case.set, case.variant, free.clone(), fixed);
    let (m, n) = ((&problem).n_residuals(), free.len());
    let (mut r, mut j) = (vec![0.0; m], vec![0.0; m * n]);
    (&problem).evaluate(&problem.pack(v), &mut r, &mut j);
    let mut j = DMatrix::from_column_slice(m, n, &j);
    let mut parts = Vec::new();
    for (k, q) in free.iter().enumerate() {
        let l = j.column(k).norm();
        if l > 0.0 {
            j.column_mut(k).scale_mut(1.0 / l);
        } else {
            parts.push(*q);
        }
    }
    if m < n {
        return free;
    }
    let svd = j.svd(false, true);
    let v_t = svd.v_t.expect("asked for");
    let top = svd.singular_values.max();
    for s in 0..n {
        if svd.singular_values[s] < 1e-11 * top {
            for (k, q) in free.iter().enumerate() {
                if v_t[(s, k)].abs() > 0.1 && !parts.contains(q) {
                    parts.push(*q);
                }
            }
        }
    }
    parts
}
