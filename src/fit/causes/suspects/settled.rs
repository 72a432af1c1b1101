//! The fit with the terms that joined.

use rayon::prelude::*;

use super::{ALIKE, BRIEF, Inquiry, OTHERS, TERM_PASSES, TERM_STILL, Trial};
use crate::fit::causes::missing_lobe::no_lobe;
use crate::fit::estimate::Estimate;
use crate::fit::least_squares::levenberg_marquardt::{Minimum, Settings};
use crate::fit::model_discrepancy::{lightened, misfit_scale};
use crate::fit::multistart::starts::{ONE_SURFACE, distance};
use crate::fit::multistart::{AMBIGUOUS_RISE, usable};
use crate::fit::problem::{Problem, Values};
use crate::fit::reweighting::{Weighing, WeightedFit};
use crate::fit::{FitOptions, Loss};

impl<'a> Inquiry<'_, 'a> {
    /// Fits with all terms that joined; weights, walls and higher order are those of its own values.
    pub(super) fn settled(&self, trial: Trial<'a>, joined: usize) -> Option<Estimate<'a>> {
        let e = self.e;
        let set = e.problem.set();
        let fitted = e.fitted + joined;
        let own = lightened(&set.sigma(), &e.loss_weights);
        let scale = misfit_scale(set);
        let linear = FitOptions {
            loss: Loss::Linear,
            ..self.options.clone()
        };
        let weighing = Weighing {
            own: &own,
            scale: &scale,
            kept: None,
            fitted,
            options: &linear,
            cancel: self.cancel,
        };
        let mut settled = WeightedFit {
            problem: trial.problem,
            minimum: trial.minimum,
            discrepancy: e.discrepancy,
        };
        for _ in 0..TERM_PASSES {
            let before = settled.values();
            let problem = settled.problem.clone().with_walls_of(&before);
            settled.problem = self.corrected(problem, &before)?;
            settled.settle_near(&weighing);
            let now = settled.values();
            if (now.theta_r - before.theta_r).abs() < TERM_STILL {
                break;
            }
        }
        settled.minimum = settled.again(&settled.minimum.parameters, self.cancel);
        if !usable(&settled.minimum) {
            return None;
        }
        Some(self.estimate(settled, &weighing))
    }

    fn estimate(&self, settled: WeightedFit<'a>, weighing: &Weighing<'_>) -> Estimate<'a> {
        let e = self.e;
        let WeightedFit {
            problem,
            minimum,
            discrepancy,
        } = settled;
        let set = problem.set();
        let values = problem.unpack(&minimum.parameters);
        let count = set.observations.len();
        let descend = |problem: &Problem<'a>, start: &[f64]| {
            problem.descend(start, &Settings::DEFAULT, self.cancel)
        };
        // Change of each parameter by the higher order.
        let closed = problem.clone().with_correction(vec![0.0; count]);
        let closed = descend(&closed, &minimum.parameters);
        let shift = minimum.parameters.iter().zip(&closed.parameters);
        let higher_order_shift = match usable(&closed) {
            true => shift.map(|(a, b)| a - b).collect(),
            false => vec![0.0; minimum.parameters.len()],
        };
        // Other surfaces are compared with the form that is reported.
        let here = values.folded();
        let others = e.elsewhere.iter().take(OTHERS);
        let ends = e.rivals.iter().chain(others).chain([&e.minimum]);
        let mut starts: Vec<Values> = Vec::new();
        for end in ends {
            let there = self.with_terms_of(&values, &end.parameters);
            let is_new = |known: &Values| distance(&there.folded(), &known.folded()) > ONE_SURFACE;
            if is_new(&values) && starts.iter().all(is_new) {
                starts.push(there);
            }
        }
        let rivals = starts.par_iter().filter_map(|there| {
            let near = self.descended_by(&BRIEF, problem.clone(), &problem.pack(there))?;
            let hopeless = near.minimum.cost > ALIKE * minimum.cost + AMBIGUOUS_RISE;
            (!hopeless).then(|| descend(&problem, &near.minimum.parameters))
        });
        let rivals: Vec<Minimum> = rivals.collect();
        let rivals = rivals.into_iter().filter(|m| {
            let there = problem.unpack(&m.parameters).folded();
            let near = m.cost - minimum.cost < AMBIGUOUS_RISE;
            usable(m) && near && distance(&there, &here) > ONE_SURFACE
        });
        let estimate = Estimate {
            rivals: rivals.collect(),
            no_lobe: no_lobe(&problem, &minimum, self.cancel),
            discrepancy,
            fitted: weighing.fitted,
            values,
            higher_order_shift,
            higher_order_undecided: false,
            explained: true,
            minimum,
            problem,
            ..e.clone()
        };
        estimate.with_statistics(&set.sigma())
    }
}
