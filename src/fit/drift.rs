//! Whether the lamp drifted while the poses were taken, as far as the frames' times and the residuals tell.
//!
//! A lamp that gains or loses light in proportion to time changes every signal by rate · time · signal. That column
//! joins the derivatives at the minimum, with the gain's beside it, and one linear step gives the rate. Misfit of the
//! model has an order in time too, since poses are visited in an order: so the rate counts only where
//! whole tilts and azimuths that are left out in turn leave it as it is ([`jackknife::by_groups`]), at odds of one in a thousand,
//! and where it is more than the budget has for the lamp anyway. What it then shifts, every parameter by as much as the
//! straight line through the poses' times makes, is in the budget's line `drift`; nothing is corrected, since
//! lamps that warm up do not drift along straight lines.

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::covariance::{Scaling, covariance};
use super::estimate::Estimate;
use super::known::drift_std;
use super::problem::Quantity;
use crate::jackknife;

const SECONDS_PER_HOUR: f64 = 3600.0;
/// Odds, both ways, at which chance makes a rate that counts.
const ODDS: f64 = 1e-3;
/// Degrees of freedom of the residuals that a rate is not told from less of.
const FREEDOM_MIN: usize = 5;

/// A lamp that drifts.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drift {
    /// Relative change of the signals per hour.
    pub per_hour: f64,
    /// Its standard uncertainty.
    pub per_hour_std: f64,
    /// From the first to the last observation.
    pub hours: f64,
    /// By how much it changed the weighted residuals of the observations, against those of the lamp that the white
    /// reference saw.
    pub change: Vec<f64>,
}

/// The lamp's drift over an estimate's observations; `None` where they bear no times, or no drift stands out.
pub(super) fn drift(estimate: &Estimate<'_>) -> Option<Drift> {
    let problem = &estimate.problem;
    let set = problem.set();
    let hours: Vec<f64> = (set.observations.iter())
        .map(|o| o.taken_s.map(|s| s / SECONDS_PER_HOUR))
        .collect::<Option<_>>()?;
    let (first, last) = (hours.iter()).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| {
        (a.min(*t), b.max(*t))
    });
    let span = last - first;
    let minimum = &estimate.minimum;
    let m = problem.residual_count();
    if !(span > 0.0 && span.is_finite()) || minimum.residuals.len() != m {
        return None;
    }
    let mean = hours.iter().sum::<f64>() / hours.len() as f64;
    let predicted = problem.predicted(&estimate.values);
    let over = |hours_from: &dyn Fn(f64) -> f64| -> Vec<f64> {
        let rows = predicted.iter().zip(problem.sigma()).zip(&hours);
        let mut column: Vec<f64> = rows.map(|((p, s), t)| p / s * hours_from(*t)).collect();
        column.resize(m, 0.0);
        column
    };
    let mut columns = minimum.jacobian.clone();
    if !problem.free().contains(&Quantity::Scale) {
        columns.extend(over(&|_| 1.0));
    }
    columns.extend(over(&|t| (t - mean) / span));
    let n = columns.len() / m;
    let known = covariance(&columns, m, &minimum.residuals, Scaling::Absolute);
    let rate = n - 1;
    if !known.identifiable[rate] || m < n + FREEDOM_MIN {
        return None;
    }
    let gradient = |j: usize| -> f64 {
        let column = &columns[j * m..(j + 1) * m];
        column
            .iter()
            .zip(&minimum.residuals)
            .map(|(c, r)| c * r)
            .sum()
    };
    let gradients: Vec<f64> = (0..n).map(gradient).collect();
    let step: Vec<f64> = (0..n)
        .map(|i| {
            -(0..n)
                .map(|j| known.matrix[(i, j)] * gradients[j])
                .sum::<f64>()
        })
        .collect();
    let left: Vec<f64> = (0..m)
        .map(|row| {
            let gone = (0..n).map(|j| columns[j * m + row] * step[j]);
            minimum.residuals[row] + gone.sum::<f64>()
        })
        .collect();
    let freedom = (m - n) as f64;
    let birge2 = left.iter().map(|r| r * r).sum::<f64>() / freedom;
    // A misfit that the drift made is gone with it; counting noise stays what it is.
    let least = if estimate.discrepancy > 0.0 { 0.0 } else { 1.0 };
    let by_scatter = (known.matrix[(rate, rate)] * birge2.max(least)).sqrt();
    let mut groups = jackknife::axes(set.observations.iter().map(|o| o.pose));
    for labels in &mut groups {
        labels.resize(m, None);
    }
    let (by_groups, groups_freedom) = jackknife::by_groups(&groups, &columns, &left);
    let std = by_scatter.hypot(by_groups[rate]);
    // The fewer groups, the less their scatter says.
    let freedom = freedom.min(groups_freedom);
    let student = StudentsT::new(0.0, 1.0, freedom).ok()?;
    let stands_out = step[rate].abs() > student.inverse_cdf(1.0 - 0.5 * ODDS) * std;
    // Over all poses, against what the lamp is taken to do in any case, both ways.
    if !stands_out || step[rate].abs() < 2.0 * drift_std(set) {
        return None;
    }
    let per_hour = step[rate] / span;
    // A white reference of another day says nothing of a straight line in between.
    let since = mean.clamp(-span, span);
    Some(Drift {
        per_hour,
        per_hour_std: std / span,
        hours: span,
        change: over(&|t| per_hour * (t - mean + since)),
    })
}

impl Drift {
    /// For the user.
    pub fn told(&self) -> String {
        let percent = 100.0 * self.per_hour.abs() * self.hours;
        let std = 100.0 * self.per_hour_std * self.hours;
        let decimals = crate::wording::decimals(std);
        let minutes = 60.0 * self.hours;
        let way = if self.per_hour > 0.0 { "rose" } else { "fell" };
        format!(
            "the signals {way} by {percent:.decimals$} ± {std:.decimals$} % (standard uncertainty) over the {minutes:.0} min of the \
             series, as those of a lamp do that drifts: the budget's line drift has what that shifts; let the lamp warm up, or \
             take white frames before and after"
        )
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::budget::uncertainty;
    use crate::fit::estimate::estimate;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::problem::Values;
    use crate::fit::{FitOptions, VariantChoice};
    use crate::geometry::Pose;
    use crate::model::Variant;
    use crate::observation::ObservationSet;

    /// Five tilts at eight azimuths, a pose a minute, the lamp changing by `per_hour`.
    fn series(per_hour: f64, seed: u64) -> ObservationSet {
        let poses = (0..40)
            .map(|k| Pose::from_deg(f64::from(k % 5) * 10.0 - 20.0, f64::from(k / 5) * 45.0));
        let truth = Values {
            azimuth_offset: 0.05,
            ..TRUTH
        };
        let mut set = painted(poses, &truth, 1e-3, seed);
        for (k, o) in set.observations.iter_mut().enumerate() {
            let taken_s = 60.0 * (k as f64 + 1.0);
            o.taken_s = Some(taken_s);
            o.signal *= 1.0 + per_hour * taken_s / SECONDS_PER_HOUR;
            o.shared.led_drift = 0.0005 * o.signal;
        }
        set
    }

    fn fitted(set: &ObservationSet) -> Estimate<'_> {
        let options = FitOptions {
            variant: VariantChoice::Sawtooth,
            starts: 3,
            ..FitOptions::default()
        };
        estimate(
            set,
            Variant::Sawtooth,
            &options,
            None,
            &AtomicBool::new(false),
        )
        .expect("it has a minimum")
    }

    #[test]
    fn a_lamp_that_fades_is_told_with_its_rate_and_what_it_shifts_is_in_the_budget() {
        let set = series(-0.1, 7);
        let estimate = fitted(&set);
        let found = drift(&estimate).expect("6 % over the series");
        assert!(
            (found.per_hour + 0.1).abs() < 4.0 * found.per_hour_std,
            "{found:?}"
        );
        assert!(found.told().contains("fell by"), "{}", found.told());
        let u = uncertainty(&estimate);
        for (k, q) in estimate.problem.free().iter().enumerate() {
            let truth = match q {
                Quantity::ThetaR => TRUTH.theta_r,
                Quantity::AzimuthOffset => 0.05,
                Quantity::TiltOffset => 0.0,
                Quantity::RhoD => TRUTH.rho_d,
                _ => continue,
            };
            let off = estimate.values.folded().inner(*q) - truth;
            let std = u.budgets[k].combined();
            assert!(off.abs() < 2.0 * std, "{q:?} {off} {:?}", u.budgets[k]);
        }
    }

    #[test]
    fn a_steady_lamp_and_frames_without_times_are_not_told_to_drift() {
        // One in a thousand by chance, each.
        for seed in 0..20 {
            let set = series(0.0, seed);
            assert_eq!(drift(&fitted(&set)), None, "seed {seed}");
        }
        let mut set = series(-0.1, 7);
        set.observations[3].taken_s = None;
        assert_eq!(drift(&fitted(&set)), None);
    }
}
