//! Adds profile-likelihood and bootstrap intervals to a report, in its units.

use std::sync::atomic::AtomicBool;

use super::budget::Uncertainty;
use super::coverage::{COVERAGE, COVERAGE_FACTOR};
use super::profile::{bootstrap, central, profile};
use crate::fit::FitOptions;
use crate::fit::estimate::Estimate;
use crate::fit::problem::{Quantity, Values};
use crate::fit::report::{FitReport, Interval, Parameter};
use crate::units::Angle;

/// Adds the requested intervals. A profile covers the other minima that the data do not exclude. No further bootstrap
/// series is drawn once `enough` returns true. If a profile finds a better minimum, a warning is added and the report
/// stays unchanged.
pub fn add(
    report: &mut FitReport,
    e: &Estimate<'_>,
    u: &Uncertainty,
    options: &FitOptions,
    enough: &(dyn Fn() -> bool + Sync),
    cancel: &AtomicBool,
) {
    let drawn = if options.bootstrap > 0 {
        bootstrap(
            &e.problem,
            &e.minimum,
            options.bootstrap,
            options.seed,
            enough,
            cancel,
        )
    } else {
        Vec::new()
    };
    if options.bootstrap > 0 && drawn.len() < options.bootstrap as usize {
        report.warnings.push(format!(
            "{} of {} bootstrap series reached no minimum{} and were omitted. Check the interval against the budget.",
            options.bootstrap as usize - drawn.len(),
            options.bootstrap,
            if enough() { " within the time limit" } else { "" }
        ));
    }
    let mut better = false;
    for (j, q) in e.problem.free().iter().enumerate() {
        let Some(parameter) = parameter(report, *q) else {
            continue;
        };
        let read = Reading::new(e, &e.values, *q);
        if options.profile {
            let guess = COVERAGE_FACTOR * u.covariance.matrix[(j, j)].sqrt();
            let rise = COVERAGE_FACTOR * COVERAGE_FACTOR;
            let found = profile(&e.problem, &e.minimum, j, guess, rise, cancel);
            better |= found.better.is_some();
            let mut interval = read.interval(found.lower, found.upper);
            for rival in &e.rivals {
                let left = rise - (rival.cost - e.minimum.cost);
                if left > 0.0 {
                    let found = profile(&e.problem, rival, j, guess, left, cancel);
                    let there = e.problem.unpack(&rival.parameters);
                    let near = Reading::new(e, &there, *q);
                    interval = interval.with(near.interval(found.lower, found.upper));
                }
            }
            parameter.profile = Some(interval);
        }
        let sample: Vec<f64> = drawn.iter().map(|x| x[j]).collect();
        parameter.bootstrap =
            central(sample, COVERAGE).map(|(lower, upper)| read.interval(Some(lower), Some(upper)));
    }
    if better {
        report.warnings.push(
            "A profile found a better minimum than the reported one. Fit again with more starts."
                .to_owned(),
        );
    }
}

fn parameter(report: &mut FitReport, quantity: Quantity) -> Option<&mut Parameter> {
    let p = &mut report.parameters;
    Some(match quantity {
        Quantity::ThetaR => &mut p.theta_r_deg,
        Quantity::AlphaU => &mut p.alpha_u,
        Quantity::AlphaV => &mut p.alpha_v,
        // Without an absolute scale these depend on the model, and the report has no numbers for them.
        Quantity::RhoD => Some(&mut p.rho_d).filter(|p| p.value.is_some())?,
        Quantity::Background => &mut p.background,
        Quantity::AzimuthOffset => &mut p.azimuth_offset_deg,
        Quantity::TiltOffset => &mut p.tilt_offset_deg,
        Quantity::Translucency => p.translucency.as_mut()?,
        Quantity::CrestRadius => p.crest_radius.as_mut()?,
        Quantity::Land => p.land_share.as_mut()?,
        Quantity::Scale
        | Quantity::Eta
        | Quantity::K
        | Quantity::Tail
        | Quantity::Wedge
        | Quantity::LampTurn => {
            return None;
        }
    })
}

/// Conversion from the units of the solver to those of the report.
struct Reading {
    quantity: Quantity,
    /// Whether θr is negative in the solver.
    mirrored: bool,
    /// Added to the azimuth to reach the branch of the report.
    shift: f64,
    /// Divisor of the stray light, for the unit of radiance.
    gain: f64,
}

impl Reading {
    /// For intervals around `values`. Azimuths are on the branch of the estimate.
    fn new(e: &Estimate<'_>, values: &Values, quantity: Quantity) -> Self {
        let absolute = e.problem.set().white_reference.is_some();
        let home = e.values.folded().azimuth_offset;
        let away = Angle::from_rad(values.folded().azimuth_offset - home).wrapped();
        Reading {
            quantity,
            mirrored: values.theta_r < 0.0,
            shift: home + away.rad() - values.azimuth_offset,
            gain: if absolute { values.scale } else { 1.0 },
        }
    }

    fn one(&self, x: f64) -> f64 {
        match self.quantity {
            Quantity::ThetaR if self.mirrored => -x.to_degrees(),
            Quantity::ThetaR | Quantity::TiltOffset => x.to_degrees(),
            Quantity::AzimuthOffset => (x + self.shift).to_degrees(),
            Quantity::AlphaU | Quantity::AlphaV => x.exp(),
            Quantity::Background => x / self.gain,
            _ => x,
        }
    }

    fn interval(&self, lower: Option<f64>, upper: Option<f64>) -> Interval {
        let (mut lower, mut upper) = (lower.map(|x| self.one(x)), upper.map(|x| self.one(x)));
        if self.quantity == Quantity::ThetaR {
            if self.mirrored {
                std::mem::swap(&mut lower, &mut upper);
            }
            // Values below 0 are the same surface, rotated by 180°.
            lower = lower.map(|l| l.max(0.0));
        }
        Interval { lower, upper }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_combined_interval_is_open_where_either_is_open() {
        let narrow = Interval {
            lower: Some(1.0),
            upper: Some(2.0),
        };
        let open = Interval {
            lower: Some(0.5),
            upper: None,
        };
        let both = narrow.with(open);
        assert_eq!((both.lower, both.upper), (Some(0.5), None));
        assert_eq!(both, open.with(narrow));
    }
}
