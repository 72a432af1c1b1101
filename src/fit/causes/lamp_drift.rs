//! Tests for a drift of the lamp during the poses, from the times of the frames and the residuals.
//!
//! Every signal, those of the white reference included, is modelled as that of a steady lamp times 1 + Σ d_k [P_k(x) −
//! P̄_k]. P_k are the Legendre polynomials, x is the time from −1 at the first frame to 1 at the last, and P̄_k is the mean
//! over the frames of the white reference. This is linear: its columns join the derivatives at the minimum, and only the
//! part that no parameter explains counts ([`Leftover`]). Two degrees are always fitted, a third if it is significant by
//! itself. The noise is everything that remains, model error included. [`drift`] returns the drift to report. [`without`]
//! returns the observations of a steady lamp, which are then fitted again.
//!
//! A drift is reported if chance gives so large an F, for one degree or for all, less than once in 10,000 series, and if it
//! has one direction (|t| > 3.2). The model error also depends on time if the poses are visited in an order. Leaving out
//! whole tilts and azimuths in turn must therefore not change the drift ([`jackknife::by_groups`]), and as many polynomials
//! of the tilt or of the azimuth must not explain the residuals as well: where they explain more, nothing is reported, and
//! where the data do not decide, nothing is corrected. A curve in time also explains a part of any large misfit: where the
//! model error is [`LOUD`], a drift has to explain most of it.
//!
//! A lamp that warms up does not follow polynomials. Half of the correction and the covariance of the coefficients are
//! therefore in the budget line `drift`.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use crate::fit::estimate::Estimate;
use crate::fit::model_discrepancy::LOUD;
use crate::fit::uncertainty::unexplained::Leftover;
use crate::geometry::Pose;
use crate::jackknife;
use crate::observation::{LampDrift, ObservationSet};

const SECONDS_PER_HOUR: f64 = 3600.0;
/// Probability of an F by chance below which a drift is reported: at a hundred degrees of freedom F is then above 10, at
/// eight above 36.
const CHANCE: f64 = 1e-4;
/// F above which a third degree is fitted.
const ANOTHER_F: f64 = 10.0;
/// Standard deviations of the line, or of the change from end to end, above which a drift is reported. A curve without
/// one direction is what a model error looks like if the poses are visited in an order.
const REPORTED_T: f64 = 3.2;
/// Degrees that are always fitted, and their maximum.
const DEGREES: usize = 2;
const DEGREES_MAX: usize = 3;
/// Standard deviations, by the jackknife over whole tilts and azimuths, that a reported drift differs from zero.
const GROUPS: f64 = 1.5;
/// Reduced χ² that decides between two explanations with as many coefficients: odds of e⁵.
const DECIDES: f64 = 10.0;
/// Smallest number of degrees of freedom for which a drift is reported.
const FREEDOM_MIN: f64 = 5.0;
/// Share of the time column that other parameters explain, above which time is hardly separable from them.
const ALIKE: f64 = 0.95;
/// Largest relative change over a series that counts as lamp drift.
const PLAUSIBLE: f64 = 0.5;
/// Share of a loud residual that a drift explains at least. A wrong scale explains less of it where the poses are visited
/// in an order.
const EXPLAINS_LOUD: f64 = 0.7;
/// Standard uncertainty of the correction, as a share of it.
const SHARE_OF_CORRECTION: f64 = 0.5;

/// A drift of the lamp.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::fit) struct Drift {
    /// The values to report.
    pub lamp: LampDrift,
    /// Whether the signals are corrected.
    pub is_corrected: bool,
    /// Changes of the weighted residuals of the observations, one vector per independent standard uncertainty.
    pub changes: Vec<Vec<f64>>,
}

/// Times of the observations and of the frames of each flat, on the scale from −1 to 1. Without times, all flats are one.
struct Times {
    observations: Vec<f64>,
    flats: Vec<Vec<f64>>,
    hours: f64,
    ends: [usize; 2],
}

impl Times {
    /// Returns `None` if an observation has no time or all were simultaneous.
    fn of(set: &ObservationSet) -> Option<Times> {
        let taken: Option<Vec<f64>> = set.observations.iter().map(|o| o.taken_s).collect();
        let taken = taken?;
        let by_time = |a: &usize, b: &usize| taken[*a].total_cmp(&taken[*b]);
        let ends = [
            (0..taken.len()).min_by(by_time)?,
            (0..taken.len()).max_by(by_time)?,
        ];
        let (first, last) = (taken[ends[0]], taken[ends[1]]);
        let span = last - first;
        if !(span > 0.0 && span.is_finite()) {
            return None;
        }
        // The mean time of the white reference is 0. A reference of another day says nothing about a smooth curve in
        // between.
        let near = |t: f64| match t > first - span && t < last + span {
            true => t,
            false => t.clamp(first, last),
        };
        let all = || set.flats.iter().map(|flat| &flat.times_s);
        let are_known = all().len() > 0 && all().all(|times| !times.is_empty());
        let flats: Vec<Vec<f64>> = match are_known {
            true => all()
                .map(|times| times.iter().map(|t| near(*t)).collect())
                .collect(),
            false => vec![vec![near(0.0)]],
        };
        let from = flats.iter().flatten().copied().fold(first, f64::min);
        let to = flats.iter().flatten().copied().fold(last, f64::max);
        let place = |t: &f64| 2.0 * (t - from) / (to - from) - 1.0;
        Some(Times {
            observations: taken.iter().map(place).collect(),
            flats: flats
                .iter()
                .map(|times| times.iter().map(place).collect())
                .collect(),
            hours: span / SECONDS_PER_HOUR,
            ends,
        })
    }

    /// P_k at each observation, and then its mean over each flat, minus its mean over the white reference.
    fn polynomial(&self, degree: usize) -> Vec<f64> {
        let mean_of = |times: &[f64]| {
            times.iter().map(|x| legendre(degree, *x)).sum::<f64>() / times.len() as f64
        };
        let white = mean_of(&self.flats.concat());
        let observations = self.observations.iter().map(|x| legendre(degree, *x));
        let flats = self.flats.iter().map(|times| mean_of(times));
        observations.chain(flats).map(|p| p - white).collect()
    }

    /// Relative change of the signal of each observation, and then of each flat, against the light during the white reference.
    fn shares(&self, coefficients: &[f64]) -> Vec<f64> {
        let mut shares = vec![0.0; self.observations.len() + self.flats.len()];
        for (k, d) in coefficients.iter().enumerate().filter(|(_, d)| **d != 0.0) {
            for (share, p) in shares.iter_mut().zip(self.polynomial(k + 1)) {
                *share += d * p;
            }
        }
        shares
    }
}

fn legendre(degree: usize, x: f64) -> f64 {
    match degree {
        1 => x,
        2 => 0.5 * (3.0 * x * x - 1.0),
        _ => 0.5 * (5.0 * x * x - 3.0) * x,
    }
}

/// Returns χ² with the best curve of `degrees` in the tilt or the azimuth; infinite if no pose differs from the others.
fn best_over_poses(set: &ObservationSet, left: &Leftover, degrees: usize) -> f64 {
    let places = [
        |pose: &Pose| pose.theta_c.deg(),
        |pose: &Pose| pose.phi_s.deg(),
    ];
    let curves = places.into_iter().filter_map(|place| {
        let at: Vec<f64> = set.observations.iter().map(|o| place(&o.pose)).collect();
        let low = at.iter().copied().fold(f64::INFINITY, f64::min);
        let high = at.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let columns: Vec<DVector<f64>> = (1..=degrees)
            .map(|k| left.column(|i| legendre(k, 2.0 * (at[i] - low) / (high - low) - 1.0)))
            .map(|column| left.without(&column))
            .collect();
        Curve::of(left, &columns)
    });
    curves.map(|curve| curve.chi2).fold(f64::INFINITY, f64::min)
}

/// Fitted coefficients.
struct Curve {
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
    chi2: f64,
    /// Remaining degrees of freedom.
    freedom: f64,
}

impl Curve {
    fn of(left: &Leftover, columns: &[DVector<f64>]) -> Option<Curve> {
        let freedom = left.freedom() - columns.len() as f64;
        if freedom < FREEDOM_MIN {
            return None;
        }
        let a = DMatrix::from_columns(columns);
        let inverse = a.tr_mul(&a).try_inverse()?;
        let coefficients = &inverse * a.tr_mul(&left.residuals);
        let chi2 = (&left.residuals - a * &coefficients).norm_squared();
        let usable = chi2 > 0.0 && coefficients.iter().all(|d| d.is_finite());
        usable.then(|| Curve {
            coefficients,
            covariance: inverse * (chi2 / freedom),
            chi2,
            freedom,
        })
    }

    /// F of `degrees` more coefficients, given χ² without them.
    fn f(&self, before: f64, degrees: usize) -> f64 {
        (before - self.chi2) / degrees as f64 / (self.chi2 / self.freedom)
    }

    /// The same F, and the probability of a larger one by chance.
    fn f_and_chance(&self, before: f64, degrees: usize) -> (f64, f64) {
        let f = self.f(before, degrees);
        let by_chance = FisherSnedecor::new(degrees as f64, self.freedom);
        (f, by_chance.map_or(1.0, |d| d.sf(f.max(0.0))))
    }
}

/// Fits the drift of the lamp over the observations of an estimate, significant or not; `None` if they have no times or
/// are too few.
#[must_use]
pub fn fitted(estimate: &Estimate<'_>) -> Option<LampDrift> {
    let set = estimate.problem.set();
    let times = Times::of(set)?;
    let left = Leftover::of(estimate)?;
    let raw: Vec<DVector<f64>> = (1..=DEGREES_MAX)
        .map(|k| left.column_of(&times.polynomial(k)))
        .collect();
    let columns: Vec<DVector<f64>> = raw.iter().map(|column| left.without(column)).collect();
    let before = left.chi2();
    let straight = Curve::of(&left, &columns[..1])?;
    let mut curve = Curve::of(&left, &columns[..DEGREES])?;
    let [of_line, of_curve] = [
        straight.f_and_chance(before, 1),
        curve.f_and_chance(before, DEGREES),
    ];
    let (f, chance) = match of_line.1 < of_curve.1 {
        true => of_line,
        false => of_curve,
    };
    if let Some(more) = Curve::of(&left, &columns)
        && more.f(curve.chi2, 1) > ANOTHER_F
    {
        curve = more;
    }
    let degrees = curve.coefficients.len();
    let [first, last] = times.ends;
    let span = DVector::from_fn(degrees, |k, _| {
        let polynomial = times.polynomial(k + 1);
        polynomial[last] - polynomial[first]
    });
    let mut jacobian = left.jacobian.clone();
    jacobian.extend(raw[..degrees].iter().flat_map(|column| column.iter()));
    let rest = DMatrix::from_columns(&columns[..degrees]) * &curve.coefficients - &left.residuals;
    let mut groups = jackknife::axes(set.observations.iter().map(|o| o.pose));
    for labels in &mut groups {
        labels.resize(rest.len(), None);
    }
    let by_groups = jackknife::by_groups(&groups, &jacobian, rest.as_slice()).std;
    let by_groups = &by_groups[by_groups.len() - degrees..];
    let (square, open) = (raw[0].norm_squared(), columns[0].norm_squared());
    let mut lamp = LampDrift {
        coefficients: [0.0; DEGREES_MAX],
        covariance: [[0.0; DEGREES_MAX]; DEGREES_MAX],
        change_over_series: span.dot(&curve.coefficients),
        change_std: span.dot(&(&curve.covariance * &span)).max(0.0).sqrt(),
        hours: times.hours,
        t: straight.coefficients[0] / straight.covariance[(0, 0)].sqrt(),
        f,
        chance,
        explains: 1.0 - curve.chi2 / before,
        alike: 1.0 - open / square,
        over_pose: ((best_over_poses(set, &left, degrees) - curve.chi2) * curve.freedom
            / curve.chi2)
            .min(f64::MAX),
        theta_r_before: estimate.values.folded().theta_r,
        steady_over_groups: (0..degrees)
            .map(|k| (curve.coefficients[k] / by_groups[k]).abs())
            .fold(0.0, f64::max),
    };
    for i in 0..degrees {
        lamp.coefficients[i] = curve.coefficients[i];
        for j in 0..degrees {
            lamp.covariance[i][j] = curve.covariance[(i, j)];
        }
    }
    let numbers = [
        lamp.change_over_series,
        lamp.change_std,
        lamp.t,
        lamp.f,
        lamp.alike,
    ];
    numbers.iter().all(|v| v.is_finite()).then_some(lamp)
}

/// Returns the drift to report: the one that the observations were corrected for, or the one that their residuals show.
pub(in crate::fit) fn drift(estimate: &Estimate<'_>) -> Option<Drift> {
    let set = estimate.problem.set();
    let (lamp, remaining) = match set.lamp {
        Some(lamp) => (lamp, SHARE_OF_CORRECTION),
        None => {
            let lamp = fitted(estimate)?;
            // No usable lamp changes more; a larger change has another cause.
            let plausible = lamp.change_over_series.abs() < PLAUSIBLE;
            let counts = estimate.discrepancy <= LOUD || lamp.explains > EXPLAINS_LOUD;
            let one_way = lamp
                .t
                .abs()
                .max((lamp.change_over_series / lamp.change_std).abs());
            let stands_out = lamp.chance < CHANCE
                && one_way > REPORTED_T
                && lamp.steady_over_groups > GROUPS
                && lamp.over_pose > -DECIDES;
            ((plausible && counts && stands_out).then_some(lamp)?, 1.0)
        }
    };
    let times = Times::of(set)?;
    let left = Leftover::of(estimate)?;
    let weighted = |coefficients: &[f64]| -> Vec<f64> {
        left.column_of(&times.shares(coefficients))
            .as_slice()
            .to_vec()
    };
    let correction: Vec<f64> = lamp.coefficients.iter().map(|d| remaining * d).collect();
    let mut changes = vec![weighted(&correction)];
    let covariance = DMatrix::from_fn(DEGREES_MAX, DEGREES_MAX, |i, j| lamp.covariance[i][j]);
    let modes = SymmetricEigen::new(covariance);
    for (value, mode) in modes
        .eigenvalues
        .iter()
        .zip(modes.eigenvectors.column_iter())
    {
        let std = value.max(0.0).sqrt();
        changes.push(weighted((mode * std).as_slice()));
    }
    Some(Drift {
        lamp,
        is_corrected: set.lamp.is_some(),
        changes,
    })
}

/// Returns the drift by which the observations are to be corrected.
pub(in crate::fit) fn to_correct(estimate: &Estimate<'_>) -> Option<LampDrift> {
    let lamp = drift(estimate)?.lamp;
    (lamp.over_pose > DECIDES).then_some(lamp)
}

/// Returns observations and flats as under a steady lamp, marked as corrected; none if they have no times.
pub(in crate::fit) fn without(set: &ObservationSet, lamp: LampDrift) -> Option<ObservationSet> {
    let shares = Times::of(set)?.shares(&lamp.coefficients);
    let mut steady = set.clone();
    let observations = steady
        .observations
        .iter_mut()
        .map(|o| [&mut o.signal, &mut o.sigma]);
    let flats = steady
        .flats
        .iter_mut()
        .map(|f| [&mut f.signal, &mut f.sigma]);
    for (values, share) in observations.chain(flats).zip(shares) {
        let factor = (1.0 + share).max(0.1);
        values.into_iter().for_each(|value| *value /= factor);
    }
    steady.lamp = Some(lamp);
    Some(steady)
}

impl Drift {
    /// Describes the drift for the user.
    pub fn message(&self) -> String {
        let lamp = &self.lamp;
        let change = 100.0 * lamp.change_over_series.abs();
        let expanded = 200.0 * lamp.change_std;
        let decimals = crate::wording::decimals(expanded);
        let minutes = 60.0 * lamp.hours;
        let way = if lamp.change_over_series > 0.0 {
            "rose"
        } else {
            "fell"
        };
        let what = match self.is_decided() {
            true => "The lamp drifts",
            false => "The lamp drifts, or something follows the order of the poses",
        };
        let effect = match self.is_corrected {
            true => {
                "The signals are corrected by a smooth curve in time; the budget line `drift` has its uncertainty."
            }
            false => "The budget line `drift` contains the effect.",
        };
        format!(
            "{what}: the signals {way} by {change:.decimals$} ± {expanded:.decimals$} % (k = 2) over the {minutes:.0} min of \
             the series (F = {:.0}). {effect} {}",
            lamp.f,
            self.advice()
        )
    }

    /// What the user should do.
    pub fn advice(&self) -> &'static str {
        match (self.is_decided(), self.lamp.alike > ALIKE) {
            (false, _) => {
                "The poses were visited in an order, so that time imitates their angles: visit them in random order, or \
                 repeat the first pose at the end."
            }
            (true, true) => {
                "These poses hardly separate time from the parameters: repeat the first pose at the end, and measure the \
                 white reference before and after the series."
            }
            (true, false) => {
                "Let the lamp warm up, or measure the white reference before and after the series."
            }
        }
    }

    /// Whether the data decide between the lamp and a cause that follows the poses.
    pub(in crate::fit) fn is_decided(&self) -> bool {
        self.lamp.over_pose > DECIDES
    }
}

#[cfg(test)]
#[path = "lamp_drift_tests.rs"]
mod tests;
