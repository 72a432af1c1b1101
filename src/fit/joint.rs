//! Fits several scans of one part together: one surface and one index, while each scan has its own gain, stray light
//! and zeros of the stages.
//!
//! Every scan is first fitted alone. From each of these surfaces the other scans search for their own zeros again (a
//! scan of few azimuths may have found a mirror image alone), all are descended together, and the best result is kept.
//! The model error is estimated scan by scan.
//!
//! Call [`fit_joint`]. A white reference with the same certificate has the same error in all scans, and so have the
//! stages of the same rig. If scans disagree by more than their own uncertainties, the line `model` includes that
//! scatter.

mod reporting;
mod stacked;

use std::f64::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::causes::suspects::agreed;
use super::estimate::Estimate;
use super::higher_order::HigherOrder;
use super::least_squares::levenberg_marquardt::{Minimum, Settings, minimise};
use super::model_discrepancy::{
    ROUNDS, discrepancy_of, explained, freedom, lightened, loss_weights, misfit_scale,
};
use super::multistart::Late;
use super::one_variant::estimate_until;
use super::problem::{Problem, Quantity, Values};
use super::report::FitReport;
use super::reweighting::sigma_at;
use super::{FitOptions, Loss, VariantChoice};
use crate::model::Variant;
use crate::observation::ObservationSet;
use stacked::{Stacked, bounds};

/// Quantities that all scans of one sample share.
const SHARED: [Quantity; 10] = [
    Quantity::ThetaR,
    Quantity::AlphaU,
    Quantity::AlphaV,
    Quantity::RhoD,
    Quantity::Eta,
    Quantity::K,
    Quantity::Translucency,
    Quantity::Tail,
    Quantity::CrestRadius,
    Quantity::Land,
];
/// The reason why the common report has no gain, stray light or offsets.
pub(crate) const EACH_ITS_OWN: &str = "each scan has its own value; see scans";
/// Passes of higher order and refit.
const JOINT_PASSES: usize = 4;

/// One scan with a name for the report.
#[derive(Debug, Clone, Copy)]
pub struct Scan<'a> {
    /// Folder or number.
    pub name: &'a str,
    /// Its observations.
    pub set: &'a ObservationSet,
}

/// The reason why scans cannot be fitted together.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum JointError {
    /// One scan, or none.
    #[error("a joint fit needs at least two scans; fit a single scan by itself")]
    TooFew,
    /// The manifests state different materials.
    #[error("{first} and {other} state different materials; join only scans of one part")]
    Materials {
        /// A scan.
        first: String,
        /// Another scan.
        other: String,
    },
    /// An option for single scans.
    #[error("{0} is only for single scans; leave it out, or fit the scans one by one")]
    OneScanOnly(&'static str),
    /// A scan cannot be fitted.
    #[error("{0} cannot be fitted by itself: {1}")]
    NoFit(String, String),
    /// The cancel flag was set.
    #[error("the fit was cancelled")]
    Cancelled,
}

/// The common result and that of each scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointReport {
    /// The surface; the values that each scan has for itself are null here.
    #[serde(flatten)]
    pub report: FitReport,
    /// The scans in the order given.
    pub scans: Vec<ScanReport>,
}

/// One scan in a joint fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanReport {
    /// Its name.
    pub name: String,
    /// Ridge angle of this scan fitted alone.
    pub theta_r_alone_deg: Option<f64>,
    /// Its standard uncertainty in that fit.
    pub theta_r_alone_std: Option<f64>,
    /// The joint result for this scan: the common surface, its own offsets, residuals, warnings.
    #[serde(flatten)]
    pub report: FitReport,
}

/// Fits scans of one sample together. `auto` selects the variant `sawtooth`. Priors and held values of quantities that
/// each scan has for itself apply to every scan.
///
/// # Errors
/// [`JointError`]: too few scans, different materials, options for single scans, a scan that cannot be fitted,
/// cancelled. A fit that fails is not an error; the status of the report shows it.
pub fn fit_joint(
    scans: &[Scan<'_>],
    options: &FitOptions,
    higher_order: HigherOrder<'_>,
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Result<JointReport, JointError> {
    check(scans, options)?;
    let variant = match options.variant {
        VariantChoice::Paper => Variant::Paper,
        _ => Variant::Sawtooth,
    };
    let integrated = Some(higher_order).filter(|_| variant == Variant::Sawtooth);
    let alone: Vec<Estimate<'_>> = scans
        .par_iter()
        .map(|scan| {
            let refusal = super::report::refusals::refused(scan.set, options);
            let fitted = match &refusal {
                Some(_) => None,
                None => estimate_until(scan.set, variant, options, integrated, late, cancel),
            };
            let reason = || refusal.unwrap_or_else(|| "No start has a finite cost.".to_owned());
            fitted.ok_or_else(|| JointError::NoFit(scan.name.to_owned(), reason()))
        })
        .collect::<Result<_, _>>()?;
    let finer: Vec<Option<ObservationSet>> = alone.iter().map(Estimate::with_finer_views).collect();
    if finer.iter().any(Option::is_some) && !cancel.load(Ordering::Relaxed) {
        let scans: Vec<Scan<'_>> = scans
            .iter()
            .zip(&finer)
            .map(|(scan, finer)| Scan {
                name: scan.name,
                set: finer.as_ref().unwrap_or(scan.set),
            })
            .collect();
        return fit_joint(&scans, options, higher_order, late, cancel);
    }
    let alone = agreed(alone, options, integrated, cancel);
    let mut joint = Joint::new(&alone, options, cancel);
    joint.settle_near();
    if let Some(higher_order) = integrated {
        joint.correct(higher_order);
    }
    joint.refit(&Settings::default());
    if cancel.load(Ordering::Relaxed) {
        return Err(JointError::Cancelled);
    }
    Ok(joint.report(scans))
}

fn check(scans: &[Scan<'_>], options: &FitOptions) -> Result<(), JointError> {
    let [first, others @ ..] = scans else {
        return Err(JointError::TooFew);
    };
    if others.is_empty() {
        return Err(JointError::TooFew);
    }
    if let Some(other) = others.iter().find(|o| o.set.material != first.set.material) {
        return Err(JointError::Materials {
            first: first.name.to_owned(),
            other: other.name.to_owned(),
        });
    }
    let single = [
        (
            "the variant traced",
            options.variant == VariantChoice::Traced,
        ),
        ("the check by the ray tracer", options.judge),
        ("a profile", options.profile),
        ("a bootstrap", options.bootstrap > 0),
    ];
    match single.into_iter().find(|(_, asked)| *asked) {
        Some((what, _)) => Err(JointError::OneScanOnly(what)),
        None => Ok(()),
    }
}

/// A joint fit in progress.
struct Joint<'e, 'a> {
    alone: &'e [Estimate<'a>],
    options: &'e FitOptions,
    cancel: &'e AtomicBool,
    problems: Vec<Problem<'a>>,
    discrepancies: Vec<f64>,
    /// For the free quantities of each scan, the columns of the joint parameters.
    columns: Vec<Vec<usize>>,
    n: usize,
    minimum: Minimum,
}

impl<'e, 'a> Joint<'e, 'a> {
    /// Starts from the best of the descents from each scan's own surface.
    fn new(alone: &'e [Estimate<'a>], options: &'e FitOptions, cancel: &'e AtomicBool) -> Self {
        let mut common: Vec<Quantity> = Vec::new();
        for q in alone.iter().flat_map(|e| e.problem.free()) {
            if SHARED.contains(q) && !common.contains(q) {
                common.push(*q);
            }
        }
        let mut n = common.len();
        let columns: Vec<Vec<usize>> = alone
            .iter()
            .map(|e| {
                let free = e.problem.free().iter();
                free.map(|q| {
                    common.iter().position(|c| c == q).unwrap_or_else(|| {
                        n += 1;
                        n - 1
                    })
                })
                .collect()
            })
            .collect();
        let problems: Vec<Problem<'a>> = alone
            .iter()
            .enumerate()
            .map(|(scan, e)| {
                let sigma = sigma_at(&e.problem.set().sigma(), &e.misfit, 1.0);
                let problem = e.problem.clone().with_loss(options.loss).with_sigma(sigma);
                // Priors on the common surface count once.
                match scan {
                    0 => problem,
                    _ => problem.without_priors(&SHARED),
                }
            })
            .collect();
        let stacked = Stacked {
            problems: &problems,
            columns: &columns,
            n,
        };
        let bounds = bounds(&stacked);
        let minima: Vec<Minimum> = alone
            .par_iter()
            .map(|e| {
                let surface = e.values.folded();
                let mut start = vec![0.0; n];
                for ((problem, columns), own) in problems.iter().zip(&columns).zip(alone) {
                    let values = zeros_for(problem, &surface, own, cancel);
                    for (c, x) in columns.iter().zip(problem.pack(&values)) {
                        start[*c] = x;
                    }
                }
                minimise(&stacked, &start, &bounds, &Settings::NEAR, cancel)
            })
            .collect();
        let best = minima
            .into_iter()
            .min_by(|a, b| a.cost.total_cmp(&b.cost))
            .expect("two scans or more were asked for");
        Joint {
            alone,
            options,
            cancel,
            problems,
            discrepancies: alone.iter().map(|e| e.discrepancy).collect(),
            columns,
            n,
            minimum: best,
        }
    }

    fn stacked(&self) -> Stacked<'_, 'a> {
        Stacked {
            problems: &self.problems,
            columns: &self.columns,
            n: self.n,
        }
    }

    fn values(&self, scan: usize) -> Values {
        let own: Vec<f64> = self.columns[scan]
            .iter()
            .map(|c| self.minimum.parameters[*c])
            .collect();
        self.problems[scan].unpack(&own)
    }

    fn refit(&mut self, settings: &Settings) {
        let stacked = self.stacked();
        let start = &self.minimum.parameters;
        let bounds = bounds(&stacked);
        self.minimum = minimise(&stacked, start, &bounds, settings, self.cancel);
    }

    /// Runs rounds of discrepancies, weights and refit, whose descents only come near (see [`Settings::NEAR`]).
    fn settle_near(&mut self) {
        for _ in 0..ROUNDS {
            let mut still = true;
            for scan in 0..self.alone.len() {
                let set = self.problems[scan].set();
                let own = set.sigma();
                let scale = misfit_scale(set);
                let next = if self.options.misfit {
                    let residuals = self.residuals(scan);
                    discrepancy_of(
                        &residuals,
                        &own,
                        &scale,
                        self.fitted(scan),
                        self.options.loss,
                    )
                } else {
                    0.0
                };
                still &= (next - self.discrepancies[scan]).abs() <= 1e-3 * next;
                self.discrepancies[scan] = next;
                let sigma = sigma_at(&own, &scale, next);
                self.problems[scan] = self.problems[scan].clone().with_sigma(sigma);
            }
            self.refit(&Settings::NEAR);
            if still || self.cancel.load(Ordering::Relaxed) {
                break;
            }
        }
    }

    /// Number of fitted parameters attributed to a scan.
    fn fitted(&self, scan: usize) -> usize {
        let alone = self.alone[scan].fitted;
        let free = self.problems[scan].free();
        let common = free.iter().filter(|q| SHARED[..4].contains(q)).count();
        alone - common + common.div_ceil(self.alone.len())
    }

    fn residuals(&self, scan: usize) -> Vec<f64> {
        self.problems[scan].signal_residuals(&self.values(scan))
    }

    /// Applies the corrections of the higher order at the common surface. One surface has one model, so all scans use them if
    /// one does.
    fn correct(&mut self, higher_order: HigherOrder<'_>) {
        if !self.alone.iter().any(Estimate::takes_higher_order) {
            return;
        }
        for _ in 0..JOINT_PASSES {
            for scan in 0..self.alone.len() {
                if let Some(correction) = higher_order(&self.problems[scan], &self.values(scan)) {
                    let problem = self.problems[scan].clone();
                    self.problems[scan] = problem.with_correction(correction);
                }
            }
            self.settle_near();
        }
    }

    /// Returns the scans at the joint minimum, each as a separate estimate.
    fn parts(&mut self) -> Vec<Estimate<'a>> {
        let loss = self.options.loss;
        let mut weights = Vec::new();
        for scan in 0..self.alone.len() {
            let problem = &self.problems[scan];
            let w = loss_weights(problem, &self.values(scan), loss);
            if loss != Loss::Linear {
                // The same point as the minimum of least squares, which is the form that the budget uses.
                let sigma = lightened(problem.sigma(), &w);
                self.problems[scan] = problem.clone().with_loss(Loss::Linear).with_sigma(sigma);
            }
            weights.push(w);
        }
        if loss != Loss::Linear {
            self.refit(&Settings::default());
        }
        let m = self.minimum.residuals.len();
        let mut first = 0;
        let mut parts = Vec::new();
        for (scan, loss_weights) in weights.into_iter().enumerate() {
            let (problem, alone) = (self.problems[scan].clone(), &self.alone[scan]);
            let rows = problem.residual_count();
            let columns = &self.columns[scan];
            let set = problem.set();
            let residuals = self.minimum.residuals[first..first + rows].to_vec();
            let column = |c: &usize| {
                let at = c * m + first;
                self.minimum.jacobian[at..at + rows].iter().copied()
            };
            let minimum = Minimum {
                parameters: columns
                    .iter()
                    .map(|c| self.minimum.parameters[*c])
                    .collect(),
                jacobian: columns.iter().flat_map(column).collect(),
                cost: residuals.iter().map(|r| r * r).sum(),
                residuals,
                at_bound: (0..columns.len())
                    .filter(|k| self.minimum.at_bound.contains(&columns[*k]))
                    .collect(),
                ending: self.minimum.ending,
                evaluations: self.minimum.evaluations,
            };
            let fitted = self.fitted(scan);
            let discrepancy = self.discrepancies[scan];
            let estimate = Estimate {
                values: self.values(scan),
                explained: explained(
                    problem.variant(),
                    self.options,
                    discrepancy,
                    minimum.cost,
                    freedom(set.observations.len(), fitted),
                ),
                discrepancy,
                fitted,
                minimum,
                problem,
                loss_weights,
                rivals: Vec::new(),
                no_lobe: None,
                ..alone.clone()
            };
            parts.push(estimate.with_statistics(&set.sigma()));
            first += rows;
        }
        parts
    }
}

/// Finds the values that a scan has for itself on a given surface: the best gain, stray light and zeros. The search
/// starts from those of the scan alone, its near minima and their mirror images.
fn zeros_for(
    problem: &Problem<'_>,
    surface: &Values,
    alone: &Estimate<'_>,
    cancel: &AtomicBool,
) -> Values {
    let set = problem.set();
    let zero = (set.rig.azimuth_zero + set.region_azimuth).rad();
    let own: Vec<Quantity> = problem
        .free()
        .iter()
        .copied()
        .filter(|q| !SHARED.contains(q))
        .collect();
    let rivals = alone
        .rivals
        .iter()
        .map(|m| alone.problem.unpack(&m.parameters));
    let mut starts = Vec::new();
    for found in std::iter::once(alone.values).chain(rivals) {
        let found = found.folded();
        for image in 0..8u8 {
            let mut v = found;
            for q in problem.free().iter().filter(|q| SHARED.contains(q)) {
                v.set_inner(*q, surface.inner(*q));
            }
            if image & 1 == 1 {
                v.azimuth_offset = -v.azimuth_offset - 2.0 * zero;
            }
            v.azimuth_offset += f64::from(image >> 1) * 0.5 * PI;
            starts.push(v);
        }
    }
    let unpolished = Settings {
        polish_steps: 0,
        ..Settings::DEFAULT
    };
    let unpolished = unpolished.within(60);
    let ends = starts.into_iter().map(|v| {
        let alone = problem.clone().with_fixed(v).with_free(own.clone());
        let m = minimise(
            &alone,
            &alone.pack(&v),
            &alone.bounds(),
            &unpolished,
            cancel,
        );
        (m.cost, alone.unpack(&m.parameters))
    });
    let best = ends.min_by(|a, b| a.0.total_cmp(&b.0));
    best.expect("the scan's own values are among the starts").1
}

#[cfg(test)]
#[path = "joint_tests.rs"]
mod tests;
