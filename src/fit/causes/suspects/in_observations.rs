//! Causes that are in the observations and not in the surface: single poses, a run of them, a lamp that drifts.
//!
//! They are tried beside the suspects of the surface, from the same minimum and by the same measure: χ² per degree of freedom
//! after one more descent. Each pose that is left out takes a degree of freedom with it, a run three (begin, end, size). A cause that leaves least
//! changes the observations, and everything is fitted again to them. Otherwise the surface would be bent to a wrong pose, or the
//! pose blamed for the surface. Where the poses were visited in an order, a run of whole tilts or a drift may stand for a property of
//! the surface at these angles: then a suspect of the surface that explains the residual comes first.
//!
//! Among few poses a wrong one bends the fit so much that its residual does not stand out. There each is left out in turn.

use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::{Inquiry, Trial};
use crate::fit::causes::bad_poses::{BadBlock, BadPoses, bad_block, bad_poses};
use crate::fit::causes::findings::{Code, ObservationCause};
use crate::fit::causes::lamp_drift::{Drift, drift, without};
use crate::fit::estimate::Estimate;
use crate::fit::least_squares::levenberg_marquardt::Settings;
use crate::fit::model_discrepancy::{few, freedom, peak};
use crate::fit::multistart::usable;
use crate::fit::report::build::causes;
use crate::observation::ObservationSet;

/// The codes of these causes.
pub(in crate::fit) const OBSERVATION_CAUSES: [Code; 3] =
    [Code::BadPose, Code::BadBlock, Code::LampDrift];

/// Standard uncertainty, relative to the peak, of an observation that has no weight.
const WEIGHTLESS: f64 = 1e3;
/// Probability by chance, over all poses, below which the best of few poses to leave out is wrong.
const CHANCE: f64 = 1e-3;

impl<'a> Inquiry<'_, 'a> {
    /// Returns the cause in the observations that leaves least of a fit with `joined` terms.
    pub(super) fn observation_cause(
        &self,
        on: &Trial<'a>,
        joined: usize,
    ) -> Option<ObservationCause> {
        let e = Estimate {
            values: on.values(),
            problem: on.problem.clone(),
            minimum: on.minimum.clone(),
            ..self.e.clone()
        };
        let may = |code: Code| !self.excluded.contains(&code);
        let count = e.problem.set().observations.len();
        // Without a term, the drift of the fit as it is, with its own weights.
        let of_lamp = if joined == 0 {
            drift(self.e)
        } else {
            drift(&e)
        };
        let of_lamp = of_lamp.filter(|_| may(Code::LampDrift));
        let steady = of_lamp.and_then(|drift| self.steady(&e, &drift, joined));
        // The many views of a near rig take too long for a descent per pose.
        let in_turn =
            few(freedom(count, self.e.fitted + joined)) && !e.problem.set().is_of_near_rig();
        let poses = match in_turn {
            _ if !may(Code::BadPose) => None,
            true => self.one_of_few(&e, joined),
            false => bad_poses(&e).and_then(|found| {
                let (cost, set) = self.without_poses(&e, &found.observations)?;
                let left = self.left(cost, joined + found.observations.len());
                let finding = Some(causes::of_poses(&e, &found));
                Some(ObservationCause {
                    set,
                    finding,
                    left,
                    is_open: false,
                })
            }),
        };
        let block = bad_block(&e).filter(|_| may(Code::BadBlock));
        let block = block.and_then(|found| {
            let (_, set) = self.without_poses(&e, &found.observations)?;
            // Begin, end and size.
            let left = self.left(self.cost_of_run(&e, &found)?, joined + 3);
            let finding = Some(causes::of_block(&e, &found));
            Some(ObservationCause {
                set,
                finding,
                left,
                is_open: found.is_of_angles,
            })
        });
        let all = steady.into_iter().chain(poses).chain(block);
        // Beside a term of the surface, its own error follows the angles.
        let likely = all.filter(|cause| !(cause.is_open && joined > 0));
        likely.min_by(|a, b| a.left.total_cmp(&b.left))
    }

    /// χ² per degree of freedom of a fit with `terms` more terms.
    pub(super) fn left(&self, cost: f64, terms: usize) -> f64 {
        let count = self.e.problem.set().observations.len();
        cost / freedom(count, self.e.fitted + terms)
    }

    /// Returns what remains under a steady lamp.
    fn steady(&self, e: &Estimate<'a>, drift: &Drift, joined: usize) -> Option<ObservationCause> {
        let mut lamp = drift.lamp;
        lamp.theta_r_before = self.e.values.folded().theta_r;
        let degrees = lamp.coefficients.iter().filter(|d| **d != 0.0).count();
        let set = without(e.problem.set(), lamp)?;
        let problem = e.problem.with_signals_of(&set);
        let minimum = problem.descend(&e.minimum.parameters, &Settings::NEAR, self.cancel);
        if !usable(&minimum) {
            return None;
        }
        Some(ObservationCause {
            left: self.left(minimum.cost, joined + degrees),
            set,
            finding: None,
            is_open: !drift.is_decided(),
        })
    }

    /// Returns the pose without which least remains, if chance does not make so large a difference.
    fn one_of_few(&self, e: &Estimate<'a>, joined: usize) -> Option<ObservationCause> {
        let observations = &e.problem.set().observations;
        let count = observations.len();
        let tried = (0..count).into_par_iter().filter_map(|pose| {
            let (cost, set) = self.without_poses(e, &[pose])?;
            Some((pose, cost, set))
        });
        let tried: Vec<(usize, f64, ObservationSet)> = tried.collect();
        let (pose, cost, set) = tried.into_iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
        let freedom = freedom(count, self.e.fitted + joined + 1);
        let f = (e.minimum.cost - cost) / (cost / freedom);
        let chance = FisherSnedecor::new(1.0, freedom).ok()?.sf(f.max(0.0));
        if count as f64 * chance > CHANCE {
            return None;
        }
        let found = BadPoses {
            observations: vec![pose],
            deviations: f.sqrt(),
            shares: Vec::new(),
            explains: 1.0 - cost / e.minimum.cost,
        };
        Some(ObservationCause {
            finding: Some(causes::of_poses(e, &found)),
            left: cost / freedom,
            set,
            is_open: false,
        })
    }

    /// χ² if all poses of a run deviate by one share.
    fn cost_of_run(&self, e: &Estimate<'a>, run: &BadBlock) -> Option<f64> {
        let mut set = e.problem.set().clone();
        for i in &run.observations {
            set.observations[*i].signal /= (1.0 + run.share).max(0.1);
        }
        let problem = e.problem.with_signals_of(&set);
        let minimum = problem.descend(&e.minimum.parameters, &Settings::NEAR, self.cancel);
        usable(&minimum).then_some(minimum.cost)
    }

    /// Fits without some observations: χ², and the set in which each of them has its deviation from the others as standard
    /// uncertainty.
    fn without_poses(&self, e: &Estimate<'a>, wrong: &[usize]) -> Option<(f64, ObservationSet)> {
        let mut set = e.problem.set().clone();
        let mut sigma = e.problem.sigma().to_vec();
        let weightless = WEIGHTLESS * peak(&set);
        wrong.iter().for_each(|i| sigma[*i] = weightless);
        let problem = e.problem.clone().with_sigma(sigma);
        let minimum = problem.descend(&e.minimum.parameters, &Settings::NEAR, self.cancel);
        if !usable(&minimum) {
            return None;
        }
        let off = problem.signal_residuals(&problem.unpack(&minimum.parameters));
        for i in wrong {
            let o = &mut set.observations[*i];
            o.sigma = o.sigma.hypot(off[*i]);
        }
        Some((minimum.cost, set))
    }
}
