//! The polish after a descent: undamped steps until they vanish, otherwise a return to the best point.

use argmin::core::{Error, Problem};

use super::{Ending, LevenbergMarquardt, Phase};
use crate::fit::least_squares::{LeastSquares, solve_upper};

impl LevenbergMarquardt<'_> {
    pub(super) fn polish<P: LeastSquares>(
        &mut self,
        problem: &mut Problem<P>,
        done: u32,
        misses: u32,
        last: f64,
    ) -> Result<(), Error> {
        // Current column lengths, not the running maxima, because the polish needs the best conditioning.
        let running = self.scale.clone();
        self.scale.iter_mut().for_each(|d| *d = 0.0);
        self.take_scales();
        let free = self.within_bounds();
        let mut step = vec![0.0; self.n];
        let packed = self.factorise(&free, &step, true);
        let solved = solve_upper(
            &self.work[..packed * self.m],
            self.m,
            packed,
            &mut self.rhs[..packed],
        );
        let mut solution = self.rhs[..packed].iter();
        for (j, p) in step.iter_mut().enumerate().filter(|(j, _)| free[*j]) {
            *p = solution.next().expect("one entry per free column") / self.scale[j];
        }
        // Relative step of the worst parameter, in units of its own size or of the total size.
        let size = self.size();
        let relative = (0..self.n)
            .map(|j| {
                let own = step[j].abs() / self.x[j].abs().max(f64::MIN_POSITIVE);
                own.min(step[j].abs() * self.scale[j] / size * 1e3)
            })
            .fold(0.0, f64::max);
        self.scale = running;
        if !solved || !relative.is_finite() {
            return self.give_up_polish();
        }
        let vanished = self.settings.vanished_step;
        // Far below the limit of a vanished step there is nothing left to gain.
        if relative <= 0.1 * vanished && last.is_finite() {
            return self.finish();
        }
        let missed = relative >= last;
        if missed && last < vanished {
            return self.finish();
        }
        let misses = misses + u32::from(missed);
        if done >= self.settings.polish_steps || misses > 3 || relative > 100.0 * last.min(1.0) {
            if last < 1e3 * vanished {
                return self.finish();
            }
            return self.give_up_polish();
        }
        self.place_trial(&step);
        let cost = self.evaluate(problem)?;
        let floor = self.anchor.as_ref().map_or(self.cost, |a| a.cost);
        // Change of the cost by rounding of the residuals.
        let noise = 16.0 * f64::EPSILON * size;
        let ceiling = floor * (1.0 + 1e-6) + noise * (2.0 * floor.sqrt() + noise);
        if !cost.is_finite() || cost > ceiling {
            return self.give_up_polish();
        }
        self.accept(cost);
        if relative == 0.0 {
            return self.finish();
        }
        self.phase = Phase::Polish {
            done: done + 1,
            misses,
            last: relative.min(last),
        };
        Ok(())
    }

    /// The step has vanished.
    fn finish(&mut self) -> Result<(), Error> {
        self.phase = Phase::Over(Ending::ConvergedByStep);
        Ok(())
    }

    /// Undamped steps do not converge here: returns to the best point and continues with tight tolerances.
    pub(super) fn give_up_polish(&mut self) -> Result<(), Error> {
        if let Some(point) = self.anchor.take()
            && point.cost <= self.cost
        {
            self.x = point.x;
            self.r = point.r;
            self.j = point.j;
            self.cost = point.cost;
        }
        self.may_polish = false;
        self.damping = 0.0;
        self.radius = self.settings.initial_radius * self.size();
        self.phase = Phase::Descent;
        Ok(())
    }
}
