//! Uncertainty of a fit, source by source.
//!
//! Around the minimum the estimate is linear in the data: δx = −K δr, where K is the pseudo-inverse of the weighted
//! derivatives. Every source of error is a change of the residuals and is propagated through K. A certificate is a
//! residual of its own (a prior) and is propagated in the same way:
//!
//! - *counting*: the uncertainties of the observations, independent.
//! - *reference*: the certificate of the white reference, one number for all observations.
//! - *angles*: errors of the stages that the fitted offsets do not absorb, and the angle between lamp and camera if its
//!   uncertainty is stated. The stage errors are: the zeros, as far as a prior on the offset leaves them open; a tilt
//!   error that grows over the range (one standard uncertainty at the ends), which no zero absorbs and θr follows; an
//!   axis of rotation beside the centre of its scale, whose error has one period per turn of φs.
//! - *material*: the nominal index. For broad lobes also whether the light from the body leaves where it entered or
//!   evenly over the ridges, as far as neither a statement nor the data determine it.
//! - *wedge*: tilt of the sample's mean plane to the turntable, if its uncertainty is stated.
//! - *drift*: change of the lamp between white reference and sample, and during the poses where the residuals show it
//!   (see `drift`).
//! - *detector*: non-linearity of the camera and errors of its exposure times, if the exposures of a pose show them or
//!   the manifest states them.
//! - *background*: what the prior leaves open of the stray light. The stray light itself also contains the noise of the
//!   dark frames, which all observations share.
//! - *model*: the model error of the closed form. It is smooth over the poses, so treating the scatter of the residuals
//!   as independent would understate it. Whole tilts and whole azimuths are therefore left out in turn (a grouped
//!   jackknife, which keeps the correlation within a group; a group that alone determines a parameter is split in
//!   halves, and so on). This part, the independent part and a share of the change by the costlier tier combine in
//!   quadrature.
//! - *tracer*: the standard errors of traced radiances, independent. With the tracer, no light path of the geometry is
//!   left out. Instead of a share of the tier's shift, `model` then contains the last step of the passes and the
//!   distance from the `sawtooth` estimate, because the two descriptions of light under rough facets agree only at low
//!   roughness.
//!
//! Several scans fitted together are one such problem with their rows stacked ([`of_parts`]).
//!
//! The zeros of the stages equal the fitted offsets, so no data can determine them, and a model cannot revise the
//! certificate of the reference. Neither is fitted.
//!
//! *Conditioning.* K is the covariance times Jᵀ. In the weakest direction that counts (1e-10 of the strongest) it is
//! accurate to 1e-6, like the covariance itself; null directions are not part of it. The lines of the budget are added
//! as squares of standard uncertainties in the units of the solver (radians, logarithms, shares), far from either end
//! of the range of doubles.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use nalgebra::{DMatrix, DVector};

use super::covariance::{Covariance, Scaling, covariance};
use super::coverage::COVERAGE_FACTOR;
use super::drift::{Drift, drift};
use super::estimate::Estimate;
use super::known::{drift_std, reference_std};
use super::problem::{Problem, Quantity, Values};
use super::profile::profile;
use super::solver::Minimum;
use crate::geometry::turn_by_wedge;
use crate::jackknife::{self, Labels};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Standard uncertainties by source, in the unit of the parameter. They combine in quadrature.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Budget {
    /// Counting noise of samples and flats.
    pub counting: f64,
    /// Certificate of the white reference.
    pub reference: f64,
    /// Zero, scale and eccentricity of the stages, and angle between lamp and camera.
    pub angles: f64,
    /// Refractive index.
    pub material: f64,
    /// Tilt of the sample on the turntable.
    #[serde(default)]
    pub wedge: f64,
    /// Lamp drift.
    pub drift: f64,
    /// Non-linearity and exposure times of the camera.
    #[serde(default)]
    pub detector: f64,
    /// Prior on the stray light.
    pub background: f64,
    /// Model error.
    pub model: f64,
    /// Departure from the linear approximation: half of the excess of the profile interval over the linear one, and
    /// half the distance to another minimum that the data do not exclude.
    #[serde(default)]
    pub shape: f64,
    /// Priors stated by the user.
    #[serde(default)]
    pub prior: f64,
    /// Standard errors of traced radiances; 0 without the ray tracer.
    #[serde(default)]
    pub tracer: f64,
}

impl Budget {
    /// Combined standard uncertainty.
    #[must_use]
    pub fn combined(&self) -> f64 {
        let squares = self.named().into_iter().map(|(_, part)| part * part);
        squares.sum::<f64>().sqrt()
    }

    /// Converts the budget to another unit.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Budget {
        let f = factor.abs();
        Budget {
            counting: self.counting * f,
            reference: self.reference * f,
            angles: self.angles * f,
            material: self.material * f,
            wedge: self.wedge * f,
            drift: self.drift * f,
            detector: self.detector * f,
            background: self.background * f,
            model: self.model * f,
            shape: self.shape * f,
            prior: self.prior * f,
            tracer: self.tracer * f,
        }
    }

    /// Returns the lines with their names, in the order of the documentation.
    #[must_use]
    pub fn named(&self) -> [(&'static str, f64); 12] {
        [
            ("counting", self.counting),
            ("reference", self.reference),
            ("angles", self.angles),
            ("material", self.material),
            ("wedge", self.wedge),
            ("drift", self.drift),
            ("detector", self.detector),
            ("background", self.background),
            ("model", self.model),
            ("shape", self.shape),
            ("prior", self.prior),
            ("tracer", self.tracer),
        ]
    }
}

/// Uncertainty of the free parameters of a fit.
#[derive(Debug, Clone)]
pub struct Uncertainty {
    /// One budget per free parameter, in the units of the solver.
    pub budgets: Vec<Budget>,
    /// Rank test and statistical covariance, with the weights of the fit.
    pub covariance: Covariance,
    /// Covariance by the sources that are propagated through the derivatives, in the units of the solver: all but wedge,
    /// shape, and the error of the closed form itself, which each parameter has on its own. Its diagonal is at most the
    /// squares of the budgets.
    pub propagated: DMatrix<f64>,
    /// Degrees of freedom of the model part (groups minus one).
    pub model_freedom: f64,
}

/// Share of the tier's shift that counts as standard uncertainty: what the quadrature omits (a third specular bounce,
/// the tail of the diffuse exchange) is a fifth of what it adds.
const SHARE_OF_TIER_SHIFT: f64 = 0.2;

/// Standard uncertainty if two complete models differ by 1 and the data prefer neither: the true value lies anywhere
/// between them (rectangular distribution, 1/√3).
const SHARE_OF_DISAGREEMENT: f64 = 0.577;

/// Lower limit of the model part in the units of the solver: the error of the corrected closed form on path-traced
/// samples of known truth (at most 0.01° and 0.4 %).
fn floor(quantity: Quantity, values: &Values) -> f64 {
    match quantity {
        // A crest is modelled to first order, and the data do not determine the draft of its riser.
        Quantity::ThetaR if values.real.crest > 0.0 => 0.055f64.to_radians(),
        Quantity::AlphaU | Quantity::AlphaV if values.real.crest > 0.0 => 0.005,
        Quantity::RhoD if values.real.crest > 0.0 => 0.004 * values.rho_d,
        Quantity::ThetaR => 0.005f64.to_radians(),
        Quantity::AlphaU | Quantity::AlphaV => 0.002,
        Quantity::RhoD => 0.002 * values.rho_d,
        // Errors of the terms themselves: a body between the two limits, the second order of a crest.
        Quantity::Translucency => 0.02,
        Quantity::Tail => 0.01,
        Quantity::CrestRadius => 0.01,
        _ => 0.0,
    }
}

/// Computes the uncertainty of a fit, source by source.
#[must_use]
pub fn uncertainty(estimate: &Estimate<'_>) -> Uncertainty {
    let columns: Vec<usize> = (0..estimate.problem.free().len()).collect();
    let Minimum {
        jacobian,
        residuals,
        ..
    } = &estimate.minimum;
    let mut of = of_parts(&[Part { estimate, columns }], jacobian, residuals);
    for j in 0..of.budgets.len() {
        let own = of.budgets[j].combined();
        of.budgets[j].shape = to_rivals(estimate, j, own).hypot(bent(estimate, &of.covariance, j));
    }
    of
}

/// The part of one scan in a joint fit.
#[derive(Debug, Clone)]
pub(super) struct Part<'e, 'a> {
    /// The scan at the joint minimum.
    pub estimate: &'e Estimate<'a>,
    /// For each free quantity of the scan, its column of the joint derivatives.
    pub columns: Vec<usize>,
}

/// Parts of one source over all scans. A common error adds up with its sign; independent errors add in quadrature.
#[derive(Debug, Clone, Copy, Default)]
struct Common {
    sum: f64,
    squares: f64,
}

impl Common {
    fn add(&mut self, part: f64) {
        self.sum += part;
        self.squares += part * part;
    }

    fn size(self, same: bool) -> f64 {
        if same {
            self.sum.abs()
        } else {
            self.squares.sqrt()
        }
    }
}

/// Computes the uncertainty without the line `shape`, for residual rows stacked part by part; derivatives column-major.
pub(super) fn of_parts(parts: &[Part<'_, '_>], jacobian: &[f64], residuals: &[f64]) -> Uncertainty {
    let m = residuals.len();
    let n = jacobian.len() / m.max(1);
    let covariance = covariance(jacobian, m, residuals, Scaling::Absolute);
    let k = pseudo_inverse(jacobian, &covariance, m, n);
    let drifts: Vec<Option<Drift>> = parts.iter().map(|p| drift(p.estimate)).collect();
    let shared: Vec<Shared> = parts.iter().map(|p| Shared::new(p.estimate)).collect();
    let bodies: Vec<Option<Vec<f64>>> = parts.iter().map(|p| by_body(p.estimate)).collect();
    let body = stacked(parts, &bodies, m).map(|change| {
        // What the data determine of τ if it is free beside the others, given that it is between 0 and 1.
        let taken_up = &k * DVector::from_column_slice(&change);
        let fitted = DMatrix::from_column_slice(m, n, jacobian) * &taken_up;
        let left: f64 = change
            .iter()
            .zip(fitted.iter())
            .map(|(a, b)| (a - b).powi(2))
            .sum();
        let std = 1.0 / (left + 12.0).sqrt();
        taken_up * std
    });
    let (by_group, model_freedom) = jackknife::by_groups(&groups(parts), jacobian, residuals);
    let sets = || parts.iter().map(|p| p.estimate.problem.set());
    let alike = |same: &dyn Fn(&ObservationSet, &ObservationSet) -> bool| -> bool {
        sets().zip(sets().skip(1)).all(|(a, b)| same(a, b))
    };
    // Equal certificates mean the same reference; equal rigs mean the same stages.
    let same_reference = alike(&|a, b| a.white_reference == b.white_reference);
    let same_rig = alike(&|a, b| a.rig == b.rig);
    let budgets = (0..n)
        .map(|j| {
            let mut squares = Budget::default();
            let mut reference = Common::default();
            let mut angles = [Common::default(); ANGLE_ERRORS];
            let (mut tier, mut floored, mut wedge) = (0.0_f64, 0.0_f64, 0.0_f64);
            let mut first = 0;
            for ((part, shared), drift) in parts.iter().zip(&shared).zip(&drifts) {
                let estimate = part.estimate;
                let (problem, set) = (&estimate.problem, estimate.problem.set());
                let rows = problem.residual_count();
                let (samples, priors) = (set.observations.len(), problem.priors());
                let first_prior = first + rows - priors.len();
                for i in 0..rows - priors.len() {
                    let k = k[(j, first + i)];
                    let Some(o) = set.observations.get(i) else {
                        squares.counting += k * k;
                        continue;
                    };
                    let per_sigma = k / problem.sigma()[i];
                    squares.counting += (per_sigma * o.sigma).powi(2);
                    squares.model += (per_sigma * estimate.misfit[i]).powi(2);
                }
                for (i, s) in estimate.traced.iter().flat_map(|t| &t.sigma).enumerate() {
                    squares.tracer += (k[(j, first + i)] * s / problem.sigma()[i]).powi(2);
                }
                for (row, (q, _)) in priors.iter().enumerate() {
                    let line = match q {
                        Quantity::Eta | Quantity::K => &mut squares.material,
                        Quantity::Background => &mut squares.background,
                        _ => &mut squares.prior,
                    };
                    *line += k[(j, first_prior + row)].powi(2);
                }
                let through = |change: &[f64]| -> f64 {
                    let rows = change.iter().enumerate();
                    rows.map(|(i, c)| k[(j, first + i)] * c).sum()
                };
                let gain = through(&shared.gain);
                let own = part.columns.iter().position(|c| *c == j);
                let own = own.map(|local| (local, problem.free()[local]));
                reference.add(gain * reference_std(set));
                squares.drift += (gain * drift_std(set)).powi(2);
                squares.detector += through(&shared.detector).powi(2);
                if let Some(drift) = drift {
                    squares.drift += drift
                        .changes
                        .iter()
                        .map(|c| through(c).powi(2))
                        .sum::<f64>();
                }
                for (all, change) in angles.iter_mut().zip(&shared.angles) {
                    all.add(through(change));
                }
                if let Some((local, quantity)) = own {
                    wedge = wedge.max(through_wedge(set, quantity, &estimate.values));
                    if quantity == Quantity::Background {
                        // For the fit, an offset common to all signals is stray light and nothing else.
                        squares.background += set.dark_std.powi(2);
                        if set.white_reference.is_some() {
                            // It is stated as a radiance on the scale of the reference.
                            let scale = estimate.values.background;
                            squares.reference += (scale * reference_std(set)).powi(2);
                            squares.drift += (scale * drift_std(set)).powi(2);
                        }
                    }
                    tier = tier.max(match &estimate.traced {
                        Some(traced) => traced.last_step[local]
                            .hypot(SHARE_OF_DISAGREEMENT * traced.apart[local]),
                        None if estimate.tier_undecided => {
                            (SHARE_OF_DISAGREEMENT * estimate.tier_shift[local]).abs()
                        }
                        None => (SHARE_OF_TIER_SHIFT * estimate.tier_shift[local]).abs(),
                    });
                    // If counting noise explains the scatter, so does the scatter of groups. The error of the tier
                    // remains.
                    if estimate.discrepancy > 0.0 && samples > 0 {
                        floored = by_group[j].hypot(floor(quantity, &estimate.values));
                    } else if estimate.takes_tier() {
                        floored = floor(quantity, &estimate.values);
                    }
                }
                first += rows;
            }
            if let Some(body) = &body {
                squares.material += body[j].powi(2);
            }
            Budget {
                counting: squares.counting.sqrt(),
                reference: reference
                    .size(same_reference)
                    .hypot(squares.reference.sqrt()),
                angles: angles
                    .iter()
                    .fold(0.0, |all: f64, one| all.hypot(one.size(same_rig))),
                material: squares.material.sqrt(),
                wedge,
                drift: squares.drift.sqrt(),
                detector: squares.detector.sqrt(),
                background: squares.background.sqrt(),
                model: (squares.model + floored * floored + tier * tier).sqrt(),
                shape: 0.0,
                prior: squares.prior.sqrt(),
                tracer: squares.tracer.sqrt(),
            }
        })
        .collect();
    let mut propagated = rows_through(&k, parts);
    for (change, first) in common_changes(parts, &shared, &drifts, same_reference, same_rig) {
        let rows = k.columns(first, change.len());
        let moved = rows * DVector::from_vec(change);
        propagated += &moved * moved.transpose();
    }
    if let Some(body) = &body {
        propagated += body * body.transpose();
    }
    Uncertainty {
        budgets,
        covariance,
        propagated,
        model_freedom,
    }
}

/// Covariance by the errors that are independent from row to row: counting, residual model error, traced radiances, priors.
fn rows_through(k: &DMatrix<f64>, parts: &[Part<'_, '_>]) -> DMatrix<f64> {
    let mut variances = DVector::zeros(k.ncols());
    let mut first = 0;
    for part in parts {
        let estimate = part.estimate;
        let (problem, set) = (&estimate.problem, estimate.problem.set());
        let rows = problem.residual_count();
        for i in 0..rows {
            variances[first + i] = match set.observations.get(i) {
                Some(o) => {
                    (o.sigma.powi(2) + estimate.misfit[i].powi(2)) / problem.sigma()[i].powi(2)
                }
                None => 1.0,
            };
        }
        for (i, s) in estimate.traced.iter().flat_map(|t| &t.sigma).enumerate() {
            variances[first + i] += (s / problem.sigma()[i]).powi(2);
        }
        first += rows;
    }
    let mut weighted = k.clone();
    for (mut column, variance) in weighted.column_iter_mut().zip(variances.iter()) {
        column *= *variance;
    }
    weighted * k.transpose()
}

/// Changes of the residuals, each from its first row on, by one standard uncertainty of each error that rows share.
fn common_changes(
    parts: &[Part<'_, '_>],
    shared: &[Shared],
    drifts: &[Option<Drift>],
    same_reference: bool,
    same_rig: bool,
) -> Vec<(Vec<f64>, usize)> {
    let times = |change: &[f64], std: f64| change.iter().map(|c| c * std).collect();
    let (mut of_reference, mut changes) = (Vec::new(), Vec::new());
    let mut of_angles: [Vec<(Vec<f64>, usize)>; ANGLE_ERRORS] = Default::default();
    let mut first = 0;
    for ((part, shared), drift) in parts.iter().zip(shared).zip(drifts) {
        let set = part.estimate.problem.set();
        of_reference.push((times(&shared.gain, reference_std(set)), first));
        changes.push((times(&shared.gain, drift_std(set)), first));
        changes.push((shared.detector.clone(), first));
        let drifted = drift.iter().flat_map(|drift| &drift.changes);
        changes.extend(drifted.map(|change| (change.clone(), first)));
        for (all, change) in of_angles.iter_mut().zip(&shared.angles) {
            all.push((change.clone(), first));
        }
        first += part.estimate.problem.residual_count();
    }
    let of_angles = of_angles.into_iter().map(|parts| (parts, same_rig));
    for (parts, is_one_error) in std::iter::once((of_reference, same_reference)).chain(of_angles) {
        match is_one_error {
            // The parts follow each other, so one change has them all.
            true => changes.push((
                parts.into_iter().flat_map(|(change, _)| change).collect(),
                0,
            )),
            false => changes.extend(parts),
        }
    }
    changes
}

/// Roughness above which the ridge angle depends on where the body's light leaves. Below it the lobes are so narrow
/// that diffuse light does not move them.
const BODY_MATTERS: f64 = 0.14;

/// Change of the weighted residuals of the samples for a translucent instead of an opaque body; none if it does not
/// matter or is fitted.
fn by_body(estimate: &Estimate<'_>) -> Option<Vec<f64>> {
    let (problem, values) = (&estimate.problem, &estimate.values);
    let dielectric = matches!(problem.set().material, Material::Dielectric { .. });
    let fitted = problem.is_extended() && problem.free().contains(&Quantity::Translucency);
    let rough = values.alpha_u.max(values.alpha_v) >= BODY_MATTERS;
    if !dielectric || fitted || !rough || problem.variant() != Variant::Sawtooth {
        return None;
    }
    let extended = match problem.is_extended() {
        true => problem.clone(),
        false => problem.clone().with_walls_of(values),
    };
    let ready = extended.ready(values);
    let each = problem.sigma().iter().enumerate();
    Some(
        each.map(|(i, sigma)| values.scale * extended.corrected(i, &ready).translucency / sigma)
            .collect(),
    )
}

/// Places the changes of the sample rows among all rows; none if no part has any.
fn stacked(parts: &[Part<'_, '_>], changes: &[Option<Vec<f64>>], m: usize) -> Option<Vec<f64>> {
    changes.iter().any(Option::is_some).then(|| {
        let mut all = vec![0.0; m];
        let mut first = 0;
        for (part, change) in parts.iter().zip(changes) {
            for (to, from) in all[first..].iter_mut().zip(change.iter().flatten()) {
                *to = *from;
            }
            first += part.estimate.problem.residual_count();
        }
        all
    })
}

/// Error of a parameter caused by a wedge of the sample, which leaves no trace in the residuals, for one standard
/// uncertainty of the wedge.
fn through_wedge(set: &ObservationSet, quantity: Quantity, values: &Values) -> f64 {
    let Some(wedge) = set.wedge_std else {
        return 0.0;
    };
    match quantity {
        Quantity::ThetaR => wedge.rad(),
        Quantity::AzimuthOffset => turn_by_wedge(wedge, Angle::from_rad(values.theta_r)).rad(),
        _ => 0.0,
    }
}

/// Uncertainty of a fit that the ray tracer checks. The line `model` is the distance of each parameter from that of
/// `traced`, combined with the model error of `traced`. A parameter that the two do not share (ρd of the printed lobe)
/// keeps its own line.
#[must_use]
pub fn judged(estimate: &Estimate<'_>, traced: &Estimate<'_>) -> Uncertainty {
    let mut of = uncertainty(estimate);
    let judge = uncertainty(traced);
    let (mine, theirs) = (estimate.values.folded(), traced.values.folded());
    let paper = estimate.problem.variant() == Variant::Paper;
    for (j, q) in estimate.problem.free().iter().enumerate() {
        let Some(other) = traced.problem.free().iter().position(|f| f == q) else {
            continue;
        };
        if paper && *q == Quantity::RhoD {
            continue;
        }
        let mut apart = mine.inner(*q) - theirs.inner(*q);
        if *q == Quantity::AzimuthOffset {
            apart = Angle::from_rad(apart).wrapped().rad();
        }
        let budget = &judge.budgets[other];
        of.budgets[j].model = apart.hypot(budget.model);
        of.budgets[j].tracer = budget.tracer;
    }
    of.model_freedom = f64::INFINITY;
    of
}

/// Addition that extends the expanded uncertainty to the farthest minimum that the data do not exclude and to that
/// minimum's own standard uncertainty, taken as `own`: U = d + k u, so (U/k)² − u² is added.
fn to_rivals(estimate: &Estimate<'_>, j: usize, own: f64) -> f64 {
    let quantity = estimate.problem.free()[j];
    let here = estimate.values.folded().inner(quantity);
    let distance = |m: &Minimum| {
        let there = estimate
            .problem
            .unpack(&m.parameters)
            .folded()
            .inner(quantity);
        if quantity == Quantity::AzimuthOffset {
            Angle::from_rad(there - here).wrapped().rad().abs()
        } else {
            (there - here).abs()
        }
    };
    let farthest = estimate.rivals.iter().map(distance).fold(0.0, f64::max);
    let way = farthest / COVERAGE_FACTOR;
    match own.is_finite() {
        true => (way * (way + 2.0 * own)).sqrt(),
        false => way,
    }
}

/// Excess of the profile interval of a poorly determined parameter over the linear interval.
fn bent(estimate: &Estimate<'_>, covariance: &Covariance, j: usize) -> f64 {
    let quantity = estimate.problem.free()[j];
    let std = covariance.matrix[(j, j)].sqrt();
    let straight = match quantity {
        Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset => STRAIGHT_ANGLE,
        Quantity::AlphaU | Quantity::AlphaV => STRAIGHT_LOG_ALPHA,
        Quantity::RhoD => STRAIGHT_RHO_D,
        _ => return 0.0,
    };
    let known =
        covariance.identifiable[j] && std.is_finite() && estimate.minimum.ending.is_success();
    if !known || std < straight {
        return 0.0;
    }
    let never = AtomicBool::new(false);
    let rise = COVERAGE_FACTOR * COVERAGE_FACTOR;
    let guess = COVERAGE_FACTOR * std;
    let p = profile(&estimate.problem, &estimate.minimum, j, guess, rise, &never);
    let here = estimate.minimum.parameters[j];
    let reach = |end: Option<f64>| end.map_or(f64::INFINITY, |x| (x - here).abs());
    let half = reach(p.lower).max(reach(p.upper)) / COVERAGE_FACTOR;
    (half * half - std * std).max(0.0).sqrt()
}

/// Standard uncertainty above which a linear interval is not trusted.
const STRAIGHT_ANGLE: f64 = 0.2 * PI / 180.0;
/// The same for the logarithm of a roughness.
const STRAIGHT_LOG_ALPHA: f64 = 0.05;
/// The same for the diffuse reflectance.
const STRAIGHT_RHO_D: f64 = 0.02;

/// Changes of the weighted residuals by sources that all observations share.
struct Shared {
    /// Per unit of the gain of the samples relative to the flats.
    gain: Vec<f64>,
    /// Per standard uncertainty of the camera's non-linearity.
    detector: Vec<f64>,
    /// Per standard uncertainty of an angle: zero of the tilt, its scale, zero of the rotation, its eccentricity along
    /// two directions, and the angle of the lamp to the camera.
    angles: [Vec<f64>; ANGLE_ERRORS],
}

/// Number of angle errors of the rig.
const ANGLE_ERRORS: usize = 6;

/// Step of the numerical derivative with respect to the lamp's angle (rad): small compared with any lobe width, large
/// compared with rounding.
const LAMP_STEP: f64 = 1e-6;

impl Shared {
    fn new(estimate: &Estimate<'_>) -> Self {
        let (problem, values) = (&estimate.problem, &estimate.values);
        let set = problem.set();
        // A prior on an offset limits the error of that stage's zero.
        let (tilt_zero, turn_zero) = (
            known_within(estimate, Quantity::TiltOffset),
            known_within(estimate, Quantity::AzimuthOffset),
        );
        let samples = set.observations.len();
        let none = vec![0.0; problem.residual_count()];
        let mut gain = none.clone();
        let mut detector = none.clone();
        let mut angles: [Vec<f64>; ANGLE_ERRORS] = std::array::from_fn(|_| none.clone());
        let ready = problem.ready(values);
        let tilts = || set.observations.iter().map(|o| o.pose.theta_c.rad());
        let (low, high) = tilts().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), tilt| {
            (low.min(tilt), high.max(tilt))
        });
        // From −1 at one end of the range of tilts to 1 at the other; a single tilt has no range.
        let along = |tilt: Angle| match high > low {
            true => (2.0 * tilt.rad() - low - high) / (high - low),
            false => 0.0,
        };
        for (i, o) in set.observations.iter().enumerate() {
            let g = problem.corrected(i, &ready);
            let weight = values.scale / problem.sigma()[i];
            gain[i] = weight * g.value;
            detector[i] = o.shared.detector / problem.sigma()[i];
            let by_tilt = |std: f64| weight * g.theta_c * std;
            let by_turn = |std: f64| weight * g.phi_s * std;
            let (tilt, turn) = (o.shared.theta_c_zero.rad(), o.shared.phi_s_zero.rad());
            let (sin, cos) = o.pose.phi_s.sin_cos();
            let changes = [
                by_tilt(tilt.min(tilt_zero)),
                by_tilt(tilt) * along(o.pose.theta_c),
                by_turn(turn.min(turn_zero)),
                by_turn(turn) * sin,
                by_turn(turn) * cos,
            ];
            for (angle, change) in angles.iter_mut().zip(changes) {
                angle[i] = change;
            }
        }
        let zero = set.observations.first();
        let zero = zero.map_or(0.0, |o| o.shared.theta_c_zero.rad());
        let albedo = set.white_reference.map_or(0.0, |w| w.reflectance / PI);
        for (index, flat) in set.flats.iter().enumerate() {
            let slope = problem.flat_cosine(index, values).1;
            let weight = values.scale * albedo / problem.flat_sigma()[index];
            let change = weight * slope;
            angles[0][samples + index] = change * zero.min(tilt_zero);
            angles[1][samples + index] = change * zero * along(flat.theta_c);
        }
        if let Some(std) = set.theta_l_std {
            angles[5] = by_lamp(problem, values, std);
        }
        Shared {
            gain,
            detector,
            angles,
        }
    }
}

/// Standard uncertainty of an offset as the user states it (rad): 0 if it is held, infinite without a statement.
fn known_within(estimate: &Estimate<'_>, offset: Quantity) -> f64 {
    if estimate.held.contains(&offset) {
        return 0.0;
    }
    let priors = estimate.problem.priors().iter();
    let of_offset = priors.filter(|(quantity, _)| *quantity == offset);
    of_offset
        .map(|(_, prior)| prior.std)
        .fold(f64::INFINITY, f64::min)
}

/// Change of the weighted residuals by one standard uncertainty of the lamp's angle to the camera.
fn by_lamp(problem: &Problem<'_>, values: &Values, std: Angle) -> Vec<f64> {
    let set = problem.set();
    let expected = |by: f64| -> Vec<f64> {
        let moved = set.with_lamp_moved(Angle::from_rad(by));
        let seen = problem.seen_by(&moved);
        let flats = (0..set.flats.len()).map(|index| seen.flat_signal(index, values));
        seen.predicted(values).into_iter().chain(flats).collect()
    };
    let sigma = problem.sigma().iter().chain(problem.flat_sigma());
    let pairs = expected(LAMP_STEP).into_iter().zip(expected(-LAMP_STEP));
    let mut change: Vec<f64> = pairs
        .zip(sigma)
        .map(|((after, before), sigma)| (after - before) / (2.0 * LAMP_STEP) * std.rad() / sigma)
        .collect();
    change.resize(problem.residual_count(), 0.0);
    change
}

/// Returns the n × m pseudo-inverse of the derivatives without null directions.
fn pseudo_inverse(jacobian: &[f64], covariance: &Covariance, m: usize, n: usize) -> DMatrix<f64> {
    let j = DMatrix::from_column_slice(m, n, jacobian);
    &covariance.matrix * j.transpose()
}

/// Labels the rows by tilt, azimuth and scan. Rows that are not sample observations have no group.
fn groups(parts: &[Part<'_, '_>]) -> [Labels; 3] {
    let mut labels: [Labels; 3] = Default::default();
    for (scan, part) in parts.iter().enumerate() {
        let set = part.estimate.problem.set();
        let [tilts, turns] = jackknife::axes(set.observations.iter().map(|o| o.pose));
        let scans = vec![Some(scan as i64); tilts.len()];
        let rows = labels[0].len() + part.estimate.problem.residual_count();
        for (all, own) in labels.iter_mut().zip([tilts, turns, scans]) {
            all.extend(own);
            all.resize(rows, None);
        }
    }
    labels
}

/// Lists the free parameters that a null direction couples, largest component first.
#[must_use]
pub fn tied(free: &[Quantity], direction: &[f64]) -> Vec<Quantity> {
    let mut parts: Vec<(f64, Quantity)> = direction
        .iter()
        .map(|p| p.abs())
        .zip(free.iter().copied())
        .filter(|(p, _)| *p >= 0.05)
        .collect();
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    parts.into_iter().map(|(_, q)| q).collect()
}
