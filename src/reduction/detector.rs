//! The camera's nonlinearity, determined from exposures of one pose that disagree.
//!
//! A pixel that should count e above its dark level counts s = e (1 − c e/S), with the full scale S above the black level.
//! The forward form is used because a series in s with one term is wrong by 1 % at c = 6 %. The inverse
//! e = S [1 − √(1 − 4 c s/S)]/(2c) applies to the counts of a pixel above its own dark level, of samples and flats alike
//! ([`Curve`]). A reduction applies it to the sums of each cell (see [`super::levels`]), a map to each pixel.
//!
//! Two exposures of one pose receive the same light. Their ratio determines c together with the errors of the exposure times.
//! The two are strongly correlated (0.98) unless the signals differ widely. The exposure times therefore have a prior
//! (`camera.exposure_rel_std`, with Cauchy's loss to allow for a clock that is clearly wrong), and both are fitted ([`fit`]).
//! The light of each visit to a pose is free. The flicker of the lamp from frame to frame is fitted, too; visits with a bad
//! frame are left out. The error of the dark level is an unknown as well, since it bends small signals. A curve that all
//! exposures share cannot be detected. A power law makes the ratio the same at every level, as errors of the exposure times do;
//! [`power`] states it beside them.
//!
//! *Conditioning.* The curve is evaluated as 2 s/(1 + √(1 − 4 c s/S)), which has no cancelling difference as c → 0. The
//! normal equations have a prior on every unknown but c, whose information is at least a millionth of the largest.

mod exposures;
mod power;
mod shares;

use nalgebra::{DMatrix, DVector};

pub(super) use self::exposures::{Exposures, compare, groups, read_exposures, shown};
pub(super) use self::shares::shares;
use crate::observation::{DetectorCurve, PowerLaw};
use crate::wording::counted;

/// Standard uncertainty of an exposure time where the manifest states none.
const EXPOSURE_REL_STD_DEFAULT: f64 = 1e-3;
/// Smallest standard uncertainty of an exposure time, and of a dark level in counts: 0 would have infinite weight.
const NEARLY_NONE: f64 = 1e-6;
/// Information that holds c at 0: a standard uncertainty of 1e-12.
const HELD: f64 = 1e24;
/// The curve and the errors of exposure times are corrected from this size on …
const SIGNIFICANT_SIZE: f64 = 1e-3;
/// … if they exceed this many standard uncertainties.
const SIGNIFICANT_SIGMAS: f64 = 5.0;
/// Largest c of the search: at 1/4 a full pixel would be at the vertex.
const CURVE_MAX: f64 = 0.2;
/// Flicker of the lamp to expect from frame to frame, and how many pairs that expectation counts as.
const FLICKER: f64 = 5e-4;
const FLICKER_PAIRS: f64 = 4.0;
/// Visits further off than this many robust deviations hold a bad frame.
const BAD_SIGMAS: f64 = 6.0;
/// Fewer visits cannot distinguish a curve from a bad frame.
const VISITS_MIN: usize = 3;

/// The camera's curve s = e (1 − c e/S).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Curve {
    pub(super) c: f64,
    /// Full scale S, counts.
    pub(super) full_dn: f64,
}

impl Curve {
    /// Returns the count of a linear camera for a count above dark.
    pub(super) fn linear(self, counted: f64) -> f64 {
        let root = (1.0 - 4.0 * self.c * counted / self.full_dn)
            .max(0.0)
            .sqrt();
        2.0 * counted / (1.0 + root)
    }

    /// Returns the count above dark for the count of a linear camera.
    #[cfg(test)]
    pub(super) fn counted(self, linear: f64) -> f64 {
        // Beyond its vertex the parabola would fall again.
        let linear = match self.c > 0.0 {
            true => linear.min(0.5 * self.full_dn / self.c),
            false => linear,
        };
        linear * (1.0 - self.c * linear / self.full_dn)
    }

    /// Change of the logarithm of a linear count per unit of c, the count itself being what it is.
    fn per_c(self, linear: f64) -> f64 {
        let x = linear / self.full_dn;
        x / (1.0 - 2.0 * self.c * x).max(0.1)
    }
}

/// Converts counts of one exposure time into those of a linear camera with a correct clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Correction {
    pub(super) curve: Curve,
    /// True exposure time over the stated one.
    pub(super) time: f64,
}

impl Correction {
    /// The corrected count above dark and its first three derivatives with respect to the count.
    pub(super) fn expansion(self, counted: f64) -> [f64; 4] {
        let per_full = self.curve.c / self.curve.full_dn;
        // Near the vertex of the parabola the curve has no derivative.
        let root = (1.0 - 4.0 * per_full * counted).max(0.01).sqrt();
        let of_curve = [
            self.curve.linear(counted),
            root.recip(),
            2.0 * per_full / root.powi(3),
            12.0 * per_full * per_full / root.powi(5),
        ];
        of_curve.map(|value| value / self.time)
    }

    /// Change of a corrected count per count.
    pub(super) fn slope(self, counted: f64) -> f64 {
        self.expansion(counted)[1]
    }
}

/// Counts above dark of one frame, by how high they are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FrameLevels {
    /// Which of the exposure times.
    time: usize,
    /// Pixels and their counts, by level.
    bins: Vec<[f64; 2]>,
    /// Relative variance of the sum by counting and read noise.
    variance: f64,
}

/// Frames of one pose, taken one after the other at different exposure times.
type Visit = Vec<FrameLevels>;

/// Prior knowledge of the comparison of exposures.
#[derive(Debug, Clone)]
struct CurvePrior {
    /// Full scale over the black level, counts.
    full_dn: f64,
    /// Exposure times that visits have.
    times_s: Vec<f64>,
    /// Relative standard uncertainty of each.
    time_std: f64,
    /// Standard uncertainty of the dark level, counts.
    dark_std_dn: f64,
}

/// Unknowns: c, the dark level's error, and the relative error of each exposure time.
#[derive(Debug, Clone)]
struct CurveFit {
    x: DVector<f64>,
    covariance: DMatrix<f64>,
    chi2: f64,
    flicker: f64,
    kept: Vec<bool>,
    pairs: usize,
}

const C: usize = 0;
const DARK: usize = 1;
const TIMES: usize = 2;

/// Logarithm of the light that a frame shows per stated second, and its derivatives with respect to c and the dark level.
fn light(seen: &FrameLevels, known: &CurvePrior, x: &DVector<f64>) -> [f64; 3] {
    let curve = Curve {
        c: x[C],
        full_dn: known.full_dn,
    };
    let (mut sum, mut by_c, mut by_dark) = (0.0, 0.0, 0.0);
    for [n, counts] in &seen.bins {
        let linear = curve.linear(counts / n - x[DARK]);
        sum += n * linear;
        by_c += n * linear * curve.per_c(linear);
        by_dark -= n * (1.0 + 2.0 * curve.c * curve.per_c(linear));
    }
    [
        (sum / known.times_s[seen.time]).ln(),
        by_c / sum,
        by_dark / sum,
    ]
}

/// A visit's residuals, and their derivatives, about its own free light.
fn residuals(
    visit: &Visit,
    known: &CurvePrior,
    x: &DVector<f64>,
    flicker: f64,
) -> Vec<(f64, f64, DVector<f64>)> {
    let rows = visit.iter().map(|seen| {
        let [level, by_c, by_dark] = light(seen, known, x);
        let mut slope = DVector::zeros(x.len());
        slope[C] = by_c;
        slope[DARK] = by_dark;
        slope[TIMES + seen.time] = -1.0;
        let weight = 1.0 / (seen.variance + flicker * flicker);
        (weight, level - x[TIMES + seen.time], slope)
    });
    let mut rows: Vec<(f64, f64, DVector<f64>)> = rows.collect();
    let total: f64 = rows.iter().map(|(weight, ..)| weight).sum();
    let mean = rows.iter().map(|(w, r, _)| w * r).sum::<f64>() / total;
    let mut slope = DVector::zeros(x.len());
    for (weight, _, own) in &rows {
        slope.axpy(weight / total, own, 1.0);
    }
    for (_, residual, own) in &mut rows {
        *residual -= mean;
        *own -= &slope;
    }
    rows
}

/// χ² of one visit per degree of freedom, as a number of standard deviations.
fn off(visit: &Visit, known: &CurvePrior, x: &DVector<f64>, flicker: f64) -> f64 {
    let rows = residuals(visit, known, x, flicker);
    let chi2: f64 = rows.iter().map(|(w, r, _)| w * r * r).sum();
    match chi2.is_finite() {
        true => (chi2 / (rows.len() - 1).max(1) as f64).sqrt(),
        false => f64::INFINITY,
    }
}

/// Least squares by Gauss and Newton: c is free, or held at 0. Errors of exposure times have Cauchy's loss, so that a clock that is
/// plainly wrong is not forced upon the curve.
fn solved(
    visits: &[&Visit],
    known: &CurvePrior,
    from: &DVector<f64>,
    flicker: f64,
    bent: bool,
) -> Option<(DVector<f64>, DMatrix<f64>)> {
    const STEPS: usize = 40;
    let size = from.len();
    let least = |std: f64| std.max(NEARLY_NONE);
    let mut x = from.clone();
    if !bent {
        x[C] = 0.0;
    }
    let mut covariance = None;
    for _ in 0..STEPS {
        let square = least(known.time_std).powi(2);
        let mut prior = x.map(|error| 1.0 / (square + error * error));
        prior[C] = if bent { 0.0 } else { HELD };
        prior[DARK] = least(known.dark_std_dn).powi(-2);
        let mut normal = DMatrix::from_diagonal(&prior);
        let mut gradient = -prior.component_mul(&x);
        for (weight, residual, slope) in
            (visits.iter()).flat_map(|visit| residuals(visit, known, &x, flicker))
        {
            normal.ger(weight, &slope, &slope, 1.0);
            gradient.axpy(-weight * residual, &slope, 1.0);
        }
        let cholesky = normal.cholesky()?;
        let step = cholesky.solve(&gradient);
        x += &step;
        x[C] = x[C].clamp(-CURVE_MAX, CURVE_MAX);
        covariance = Some(cholesky.inverse());
        if step[C].abs() < 1e-8 && step.rows(TIMES, size - TIMES).amax() < 1e-8 {
            break;
        }
    }
    let finite = |x: &DVector<f64>| x.iter().all(|v| v.is_finite());
    covariance.filter(|_| finite(&x)).map(|c| (x, c))
}

/// The curve (`bent`) or none, the errors of the exposure times, the flicker and the visits that hold no bad frame. `None` of
/// too few visits.
///
/// With a curve there are three ways to begin: from the curve that most visits want with a right clock, from the clock that they want
/// without a curve, and from the curve of all visits. Few bright visits among many dark ones would pass for bad frames otherwise, if
/// the camera's curve has another form. The end that is likelier is the answer.
fn fit(visits: &[Visit], known: &CurvePrior, bent: bool) -> Option<CurveFit> {
    let none = DVector::zeros(TIMES + known.times_s.len());
    if visits.len() < VISITS_MIN {
        return None;
    }
    let straight = fit_from(visits, known, &none, false);
    if !bent {
        return straight;
    }
    let of = |k: i32| {
        let mut x = none.clone();
        x[C] = f64::from(k) * CURVE_MAX / 40.0;
        (median_off(visits, known, &x, FLICKER), x)
    };
    let curve = (-40..=40).map(of).min_by(|a, b| a.0.total_cmp(&b.0))?.1;
    let every: Vec<&Visit> = visits.iter().collect();
    let of_all = solved(&every, known, &none, FLICKER, true).map(|(x, _)| x);
    let starts = [Some(curve), straight.map(|f| f.x), of_all];
    let ends = starts.into_iter().flatten();
    let ends = ends.filter_map(|start| fit_from(visits, known, &start, true));
    ends.min_by(|a, b| a.unlikely(known).total_cmp(&b.unlikely(known)))
}

/// Median over the visits of how far each is off.
fn median_off(visits: &[Visit], known: &CurvePrior, x: &DVector<f64>, flicker: f64) -> f64 {
    let mut all: Vec<f64> = visits.iter().map(|v| off(v, known, x, flicker)).collect();
    super::sensor::median(&mut all)
}

fn fit_from(
    visits: &[Visit],
    known: &CurvePrior,
    start: &DVector<f64>,
    bent: bool,
) -> Option<CurveFit> {
    const ROUNDS: usize = 30;
    let good = |x: &DVector<f64>, flicker: f64| -> Vec<bool> {
        let usual = median_off(visits, known, x, flicker) / crate::robust::MEDIAN_OF_ABS;
        let limit = BAD_SIGMAS * usual.max(1.0);
        (visits.iter())
            .map(|v| off(v, known, x, flicker) <= limit)
            .collect()
    };
    let mut x = start.clone();
    let mut flicker = FLICKER;
    let mut kept = good(&x, flicker);
    let mut fitted = None;
    for _ in 0..ROUNDS {
        let chosen: Vec<&Visit> = (visits.iter().zip(&kept))
            .filter_map(|(visit, kept)| kept.then_some(visit))
            .collect();
        if chosen.len() < VISITS_MIN || 2 * chosen.len() < visits.len() {
            return None;
        }
        let (now, covariance) = solved(&chosen, known, &x, flicker, bent)?;
        x = now;
        let rows = chosen.iter().flat_map(|v| residuals(v, known, &x, flicker));
        let chi2: f64 = rows.map(|(w, r, _)| w * r * r).sum();
        let pairs: usize = chosen.iter().map(|v| v.len() - 1).sum();
        let keep = good(&x, flicker);
        // Its prior's sum of squares and that of the residuals, over the degrees of freedom of both.
        let squares = FLICKER_PAIRS * FLICKER * FLICKER + flicker * flicker * chi2;
        let next = (squares / (FLICKER_PAIRS + pairs as f64)).sqrt();
        let settled = keep == kept && (next / flicker - 1.0).abs() < 1e-3;
        fitted = Some(CurveFit {
            x: x.clone(),
            covariance,
            chi2,
            flicker,
            kept: std::mem::replace(&mut kept, keep),
            pairs,
        });
        if settled {
            break;
        }
        flicker = next;
    }
    fitted
}

/// Returns how much c changes if only the darker half of the visits determines it; 0 within twice its own standard uncertainty.
/// Over a curve of another form than this one c depends on the level, and the correction is wrong by about that much.
fn by_level(visits: &[Visit], of: &CurveFit, known: &CurvePrior) -> f64 {
    let level = |visit: &Visit| {
        let means = visit.iter().map(|seen| {
            let sums = seen
                .bins
                .iter()
                .fold([0.0, 0.0], |a, b| [a[0] + b[0], a[1] + b[1]]);
            sums[1] / sums[0]
        });
        means.fold(0.0, f64::max)
    };
    let kept = visits.iter().zip(&of.kept).filter(|(_, kept)| **kept);
    let mut kept: Vec<&Visit> = kept.map(|(visit, _)| visit).collect();
    kept.sort_by(|a, b| level(a).total_cmp(&level(b)));
    let dark = &kept[..kept.len() / 2];
    if dark.len() < VISITS_MIN {
        return 0.0;
    }
    let Some((x, covariance)) = solved(dark, known, &of.x, of.flicker, true) else {
        return 0.0;
    };
    let change = (x[C] - of.x[C]).abs();
    match change > 2.0 * covariance[(C, C)].sqrt() {
        true => change,
        false => 0.0,
    }
}

impl CurveFit {
    /// Twice the negative logarithm of how likely it is, up to a constant: the scatter that is left, visits left out, and
    /// what the clock is said to be off by.
    fn unlikely(&self, known: &CurvePrior) -> f64 {
        let std = known.time_std.max(NEARLY_NONE);
        let clock = self.x.as_slice()[TIMES..].iter();
        let clock: f64 = clock.map(|error| (1.0 + (error / std).powi(2)).ln()).sum();
        let out = self.kept.iter().filter(|kept| !**kept).count();
        let scatter = self.pairs as f64 * (self.flicker / FLICKER).powi(2).ln();
        scatter + BAD_SIGMAS * BAD_SIGMAS * out as f64 + clock
    }
}

/// The result of comparing exposures.
#[derive(Debug, Clone)]
pub(super) struct Detector {
    /// The curve, if it is significant.
    pub(super) bent: Option<DetectorCurve>,
    full_dn: f64,
    /// Exposure times of samples and flats, each with its relative error.
    times: Vec<(f64, f64)>,
    /// Whether the errors of the exposure times are to be corrected.
    times_differ: bool,
    /// A power law that explains the errors of the exposure times as well.
    power_law: Option<PowerLaw>,
    /// Covariance of c (if it is significant) and of the errors of the exposure times.
    covariance: DMatrix<f64>,
}

/// A share of −0.5 % or the like.
fn percent(share: f64) -> String {
    format!("{:+.2} %", 100.0 * share)
}

impl Detector {
    /// From visits to poses. `all_times_s` are the exposure times of the whole series, `stated` their standard uncertainty
    /// as the manifest states it.
    fn of(
        visits: &[Visit],
        known: &CurvePrior,
        all_times_s: &[f64],
        stated: Option<f64>,
    ) -> Detector {
        let bent = fit(visits, known, true).filter(|f| {
            let (c, std) = (f.x[C], f.covariance[(C, C)].sqrt());
            c.abs() > SIGNIFICANT_SIZE && c.abs() > SIGNIFICANT_SIGMAS * std && c.abs() < CURVE_MAX
        });
        let by_level = bent.as_ref().map_or(0.0, |f| by_level(visits, f, known));
        let curve = bent.as_ref().map(|f| {
            let chosen: Vec<&Visit> = (visits.iter().zip(&f.kept))
                .filter_map(|(visit, kept)| kept.then_some(visit))
                .collect();
            let straight = solved(&chosen, known, &DVector::zeros(f.x.len()), f.flicker, false);
            let chi2_without = straight.map_or(f64::INFINITY, |(x, _)| {
                let rows = chosen
                    .iter()
                    .flat_map(|v| residuals(v, known, &x, f.flicker));
                rows.map(|(w, r, _)| w * r * r).sum()
            });
            DetectorCurve {
                c: f.x[C],
                exponent: 1.0,
                std: f.covariance[(C, C)].sqrt().hypot(by_level),
                pairs: f.pairs,
                full_scale_dn: known.full_dn,
                explains: (1.0 - f.chi2 / chi2_without).clamp(0.0, 1.0),
            }
        });
        let fitted = bent.or_else(|| fit(visits, known, false));
        let size = 1 + all_times_s.len();
        let std = stated.unwrap_or(0.0);
        let mut covariance = DMatrix::from_diagonal_element(size, size, std * std);
        covariance[(C, C)] = 0.0;
        let mut times: Vec<(f64, f64)> = all_times_s.iter().map(|s| (*s, 0.0)).collect();
        let mut times_differ = false;
        if let Some(f) = &fitted {
            let n = known.times_s.len();
            let between = |i: usize, j: usize| {
                let (a, b) = (TIMES + i, TIMES + j);
                let v = &f.covariance;
                (
                    f.x[a] - f.x[b],
                    (v[(a, a)] + v[(b, b)] - 2.0 * v[(a, b)]).max(0.0).sqrt(),
                )
            };
            let large =
                |(off, std): (f64, f64)| off.abs() > SIGNIFICANT_SIZE.max(SIGNIFICANT_SIGMAS * std);
            times_differ = (0..n).any(|i| (0..i).any(|j| large(between(i, j))));
            let at = |s: f64| all_times_s.iter().position(|t| *t == s);
            let places: Vec<Option<usize>> = known.times_s.iter().map(|s| at(*s)).collect();
            for (i, place) in places.iter().enumerate() {
                if let Some(place) = place {
                    times[*place].1 = f.x[TIMES + i];
                }
            }
            // Without a statement, the small clock errors of a linear camera are part of the lamp's drift.
            if curve.is_some() || times_differ || stated.is_some() {
                let of = |k: usize| {
                    if k == C {
                        Some(C)
                    } else {
                        places[k - 1].map(|p| 1 + p)
                    }
                };
                let row = |k: usize| if k == C { C } else { TIMES + k - 1 };
                for i in 0..=n {
                    for j in 0..=n {
                        if let (Some(a), Some(b)) = (of(i), of(j)) {
                            covariance[(a, b)] = f.covariance[(row(i), row(j))];
                        }
                    }
                }
            }
        }
        covariance[(C, C)] += by_level * by_level;
        if curve.is_none() {
            for k in 0..size {
                covariance[(C, k)] = 0.0;
                covariance[(k, C)] = 0.0;
            }
        }
        let law = fitted.filter(|_| times_differ && curve.is_none());
        Detector {
            power_law: law.and_then(|f| power::power_law(visits, &f, known, stated)),
            bent: curve,
            full_dn: known.full_dn,
            times,
            times_differ,
            covariance,
        }
    }

    fn curve(&self) -> Option<Curve> {
        self.bent.map(|bent| Curve {
            c: bent.c,
            full_dn: self.full_dn,
        })
    }

    /// Returns the correction of an exposure time; `None` for a linear camera with a correct clock.
    pub(super) fn correction(&self, exposure_s: f64) -> Option<Correction> {
        if self.is_straight() {
            return None;
        }
        let straight = Curve {
            c: 0.0,
            full_dn: self.full_dn,
        };
        let time = self.times.iter().find(|(s, _)| *s == exposure_s);
        Some(Correction {
            curve: self.curve().unwrap_or(straight),
            time: 1.0 + time.map_or(0.0, |(_, error)| *error),
        })
    }

    /// Returns whether counts need no correction.
    pub(super) fn is_straight(&self) -> bool {
        self.bent.is_none() && !self.times_differ
    }

    /// Returns the warning about the curve or the exposure times.
    pub(super) fn words(&self) -> Option<String> {
        let spread = || {
            let errors = self.times.iter().map(|(_, error)| *error);
            let (low, high) = errors.fold((0.0_f64, 0.0_f64), |(a, b), e| (a.min(e), b.max(e)));
            high - low
        };
        match &self.bent {
            Some(bent) => Some(format!(
                "the camera is not linear: at full scale ({:.0} DN above black) it counts {} of what a linear one would \
                 (c = {:.4} ± {:.4}, k = 2, in counts = light · (1 − c · light / full scale), from {} of exposures of one \
                 pose); all counts are corrected, and the uncertainty of the correction is the budget's line detector. Check the \
                 camera's gain and gamma settings, or expose to half of full scale",
                bent.full_scale_dn,
                percent(-bent.c),
                bent.c,
                2.0 * bent.std,
                counted(bent.pairs, "pair"),
            )),
            None if self.times_differ => Some(format!(
                "exposure times deviate by {} from each other, equally at every level: they are corrected relative to each \
                 other; check the shutter's timing",
                percent(spread()).trim_start_matches('+'),
            )),
            None => None,
        }
    }
}

#[cfg(test)]
mod tests;
