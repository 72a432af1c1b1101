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
//!   (see `lamp_drift`).
//! - *detector*: non-linearity of the camera and errors of its exposure times, if the exposures of a pose show them or
//!   the manifest states them.
//! - *background*: what the prior leaves open of the stray light. The stray light itself also contains the noise of the
//!   dark frames, which all observations share.
//! - *model*: the model error of the closed form. It is smooth over the poses, so treating the scatter of the residuals
//!   as independent would understate it. Whole tilts and whole azimuths are therefore left out in turn (a grouped
//!   jackknife, which keeps the correlation within a group; a group that alone determines a parameter is split in
//!   halves, and so on). Independent errors, which have lines of their own, change the estimate as well when rows are left
//!   out, so only what exceeds their expected change counts. This part, the independent part and a share of the change
//!   by the higher order combine in quadrature.
//! - *tracer*: the standard errors of traced radiances, independent. With the tracer, no light path of the geometry is
//!   left out. Instead of a share of the higher order's shift, `model` then contains the steps that lie ahead of the passes and the
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

mod lines;
mod shape;
mod shared;

use nalgebra::{DMatrix, DVector};

use super::covariance::{Covariance, covariance};
use crate::fit::causes::contradicted_values::{denials, determines_the_material};
use crate::fit::causes::lamp_drift::{Drift, drift};
use crate::fit::estimate::Estimate;
use crate::fit::known::{drift_std, reference_std};
use crate::fit::least_squares::levenberg_marquardt::Minimum;
use crate::fit::problem::{Quantity, Values};
use crate::jackknife::{self, ByGroups, Labels};
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::units::Angle;
pub use lines::Budget;
use shape::{bent, to_rivals};
use shared::{ANGLE_ERRORS, Common, Shared, by_body, common_changes, stacked, through_wedge};

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

/// Share of the higher order's shift that counts as standard uncertainty: what the quadrature omits (a third specular bounce,
/// the tail of the diffuse exchange) is a fifth of what it adds.
const SHARE_OF_TIER_SHIFT: f64 = 0.2;

/// Standard uncertainty if two complete models differ by 1 and the data prefer neither: the true value lies anywhere
/// between them (rectangular distribution, 1/√3).
const SHARE_OF_DISAGREEMENT: f64 = 0.577;

/// Lower limit of the model part in the units of the solver: below the usual error of the corrected closed form on path-traced
/// samples, which `cargo bench --bench fit_strata -- --stratum traced` prints. Where the error is larger, the data show it, and
/// the jackknife and the share of the higher order's shift cover it.
fn floor(quantity: Quantity, values: &Values) -> f64 {
    // On traced white bodies the closed form is off where lobes are broad: at α = 0.25 and ρd = 0.7 by a tenth of a degree and
    // 1 % of α, at 0.15 by an eighth of it.
    let alpha = values.alpha_u.max(values.alpha_v);
    let broad = (alpha / 0.25).powi(4) * (values.rho_d / 0.7).clamp(0.0, 1.5);
    match quantity {
        // A crest is modelled to first order, and the data do not determine the draft of its riser.
        Quantity::ThetaR if values.real.crest > 0.0 => 0.055f64.to_radians(),
        Quantity::AlphaU | Quantity::AlphaV if values.real.crest > 0.0 => 0.005,
        // On traced crests of a fifth of the facet ρd is low by 3 %.
        Quantity::RhoD if values.real.crest > 0.0 => {
            0.1 * values.real.crest.max(0.1) * values.rho_d
        }
        Quantity::ThetaR => 0.0025f64.hypot(0.04 * broad).to_radians(),
        Quantity::AlphaU | Quantity::AlphaV => 0.001f64.hypot(0.005 * broad),
        // The error of the light of the body over the tilts is one or two thousandths of it. Where tilts end at 20°,
        // ρd and stray light together take up such an error five times as large, with opposite signs.
        Quantity::RhoD => 0.005 * values.rho_d,
        // Errors of the terms themselves: a body between the two limits, the second order of a crest, lands at
        // another height than the crests.
        Quantity::Translucency => 0.02,
        Quantity::Tail => 0.01,
        Quantity::CrestRadius | Quantity::Land => 0.01,
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
    // Where the data contradict the certificate of the material, U reaches the values without it.
    let mut denials = denials(estimate);
    denials.retain(|denial| denial.is_of_material() && determines_the_material(estimate));
    for j in 0..of.budgets.len() {
        let own = of.budgets[j].combined();
        let shifts = denials.iter().map(|denial| denial.shift[j].abs());
        let away = to_rivals(estimate, j, own, shifts.fold(0.0, f64::max));
        of.budgets[j].shape = away.hypot(bent(estimate, &of.covariance, j));
    }
    of
}

/// The part of one scan in a joint fit.
#[derive(Debug, Clone)]
pub(in crate::fit) struct Part<'e, 'a> {
    /// The scan at the joint minimum.
    pub estimate: &'e Estimate<'a>,
    /// For each free quantity of the scan, its column of the joint derivatives.
    pub columns: Vec<usize>,
}

/// Computes the uncertainty without the line `shape`, for residual rows stacked part by part; derivatives column-major.
pub(in crate::fit) fn of_parts(
    parts: &[Part<'_, '_>],
    jacobian: &[f64],
    residuals: &[f64],
) -> Uncertainty {
    let m = residuals.len();
    let n = jacobian.len() / m.max(1);
    let covariance = covariance(jacobian, m, residuals);
    let sources = Sources::new(parts, jacobian, residuals, &covariance);
    Uncertainty {
        budgets: (0..n).map(|j| sources.budget(j)).collect(),
        covariance,
        propagated: sources.propagated(),
        model_freedom: sources.by_group.freedom,
    }
}

/// Sources of error in the form that the budgets of all parameters use.
struct Sources<'s, 'e, 'a> {
    parts: &'s [Part<'e, 'a>],
    /// Pseudo-inverse K of the derivatives, n × m.
    k: DMatrix<f64>,
    shared: Vec<Shared>,
    drifts: Vec<Option<Drift>>,
    /// Uncertain share of what the higher order changes in the rows of each part.
    higher_order: Vec<Vec<f64>>,
    /// Change of each parameter by a translucent body, per standard uncertainty of τ.
    body: Option<DVector<f64>>,
    by_group: ByGroups,
    /// Whether all parts have the same white reference, or the same stages.
    same_reference: bool,
    same_rig: bool,
}

impl<'s, 'e, 'a> Sources<'s, 'e, 'a> {
    fn new(
        parts: &'s [Part<'e, 'a>],
        jacobian: &[f64],
        residuals: &[f64],
        covariance: &Covariance,
    ) -> Self {
        let m = residuals.len();
        let n = jacobian.len() / m.max(1);
        let k = pseudo_inverse(jacobian, covariance, m, n);
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
        let sets = || parts.iter().map(|p| p.estimate.problem.set());
        let alike = |same: &dyn Fn(&ObservationSet, &ObservationSet) -> bool| -> bool {
            sets().zip(sets().skip(1)).all(|(a, b)| same(a, b))
        };
        Sources {
            k,
            shared: parts.iter().map(|p| Shared::new(p.estimate)).collect(),
            drifts: parts.iter().map(|p| drift(p.estimate)).collect(),
            higher_order: by_higher_order(parts, jacobian, m),
            body,
            by_group: jackknife::by_groups(&groups(parts), jacobian, residuals),
            // Equal certificates mean the same reference; equal rigs mean the same stages.
            same_reference: alike(&|a, b| a.white_reference == b.white_reference),
            same_rig: alike(&|a, b| a.rig == b.rig),
            parts,
        }
    }

    /// Computes the budget of parameter `j`.
    fn budget(&self, j: usize) -> Budget {
        let mut squares = Budget::default();
        let mut reference = Common::default();
        let mut angles = [Common::default(); ANGLE_ERRORS];
        let (mut higher_order, mut by_tracer) = (0.0_f64, 0.0_f64);
        let (mut by_groups, mut floored, mut wedge) = (0.0_f64, 0.0_f64, 0.0_f64);
        let mut first = 0;
        let parts = self.parts.iter().zip(&self.shared);
        for (((part, shared), drift), of_higher_order) in
            parts.zip(&self.drifts).zip(&self.higher_order)
        {
            let estimate = part.estimate;
            let (problem, set) = (&estimate.problem, estimate.problem.set());
            self.add_rows(j, estimate, first, &mut squares);
            let through = |change: &[f64]| -> f64 {
                let rows = change.iter().enumerate();
                rows.map(|(i, c)| self.k[(j, first + i)] * c).sum()
            };
            let gain = through(&shared.gain);
            reference.add(gain * reference_std(set));
            squares.drift += (gain * drift_std(set)).powi(2);
            squares.detector += through(&shared.detector).powi(2);
            if let Some(drift) = drift {
                let changes = drift.changes.iter();
                squares.drift += changes.map(|c| through(c).powi(2)).sum::<f64>();
            }
            for (all, change) in angles.iter_mut().zip(&shared.angles) {
                all.add(through(change));
            }
            higher_order += through(of_higher_order);
            if let Some(local) = part.columns.iter().position(|c| *c == j) {
                let quantity = problem.free()[local];
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
                if let Some(traced) = &estimate.traced {
                    let apart = SHARE_OF_DISAGREEMENT * traced.apart[local];
                    by_tracer = by_tracer.max(traced.ahead[local].hypot(apart));
                }
                // If counting noise explains the scatter, so does the scatter of groups. The error of the higher order remains.
                let doubted = estimate.discrepancy > 0.0 && !set.observations.is_empty();
                if doubted {
                    by_groups = self.by_group.beyond_chance(j);
                }
                if doubted || estimate.takes_higher_order() {
                    floored = floored.max(floor(quantity, &estimate.values));
                }
            }
            first += problem.residual_count();
        }
        if let Some(body) = &self.body {
            squares.material += body[j].powi(2);
        }
        let sources = squares.with_each(f64::sqrt);
        Budget {
            reference: reference.size(self.same_reference).hypot(sources.reference),
            angles: angles
                .iter()
                .fold(0.0, |all: f64, one| all.hypot(one.size(self.same_rig))),
            wedge,
            model: [by_groups, floored, higher_order, by_tracer]
                .iter()
                .fold(sources.model, |all, one| all.hypot(*one)),
            ..sources
        }
    }

    /// Adds the squares of the errors that are independent from row to row, for the part whose rows begin at `first`.
    fn add_rows(&self, j: usize, estimate: &Estimate<'_>, first: usize, squares: &mut Budget) {
        let (problem, set) = (&estimate.problem, estimate.problem.set());
        let (rows, priors) = (problem.residual_count(), problem.priors());
        let first_prior = first + rows - priors.len();
        for i in 0..rows - priors.len() {
            let k = self.k[(j, first + i)];
            let Some(o) = set.observations.get(i) else {
                squares.counting += k * k;
                continue;
            };
            let per_sigma = k / problem.sigma()[i];
            squares.counting += (per_sigma * o.sigma).powi(2);
            squares.model += (per_sigma * estimate.misfit[i]).powi(2);
        }
        for (i, s) in estimate.traced.iter().flat_map(|t| &t.sigma).enumerate() {
            squares.tracer += (self.k[(j, first + i)] * s / problem.sigma()[i]).powi(2);
        }
        for (row, (q, _)) in priors.iter().enumerate() {
            let line = match q {
                Quantity::Eta | Quantity::K => &mut squares.material,
                Quantity::Background => &mut squares.background,
                _ => &mut squares.prior,
            };
            *line += self.k[(j, first_prior + row)].powi(2);
        }
    }

    /// Computes the covariance by all sources that are propagated through K.
    fn propagated(&self) -> DMatrix<f64> {
        let mut propagated = rows_through(&self.k, self.parts);
        let (same_reference, same_rig) = (self.same_reference, self.same_rig);
        let common = common_changes(
            self.parts,
            &self.shared,
            &self.drifts,
            same_reference,
            same_rig,
        );
        for (change, first) in common {
            let rows = self.k.columns(first, change.len());
            let moved = rows * DVector::from_vec(change);
            propagated += &moved * moved.transpose();
        }
        if let Some(body) = &self.body {
            propagated += body * body.transpose();
        }
        propagated
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
        let Some(other) = traced.problem.column(*q) else {
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

/// The uncertain share of what the higher order changes in the rows of each scan, by its shift of that scan alone. What it changes
/// in a joint value follows from the rows: a scan that determines little has a large shift and a small share.
fn by_higher_order(parts: &[Part<'_, '_>], jacobian: &[f64], m: usize) -> Vec<Vec<f64>> {
    let mut first = 0;
    let of = |part: &Part<'_, '_>| {
        let estimate = part.estimate;
        let share = match (&estimate.traced, estimate.higher_order_undecided) {
            (Some(_), _) => 0.0,
            (None, true) => SHARE_OF_DISAGREEMENT,
            (None, false) => SHARE_OF_TIER_SHIFT,
        };
        let rows = first..first + estimate.problem.residual_count();
        first = rows.end;
        let shifts = part.columns.iter().zip(&estimate.higher_order_shift);
        rows.map(|i| {
            let change = shifts.clone().map(|(c, shift)| jacobian[i + c * m] * shift);
            share * change.sum::<f64>()
        })
        .collect()
    };
    parts.iter().map(of).collect()
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
