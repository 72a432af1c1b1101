//! The camera's curve: exposures of one pose that disagree tell how its counts bend.
//!
//! A pixel that should count e above its dark level counts s = e (1 − c e/S), S being the full scale over the black level.
//! The form is the forward one: a series in s with one term is wrong by 1 % at c = 6 %. Its inverse
//! e = S [1 − √(1 − 4 c s/S)]/(2c) is applied to the counts of each pixel above its own dark level, before responses and
//! means, of samples and flats alike ([`Curve`]).
//!
//! Two exposures of one pose saw the same light. Their ratio tells c, together with what the exposure times are off by:
//! the two are nearly one number (correlation 0.98) unless signals differ widely, so the exposure times have a prior
//! (`camera.exposure_rel_std`; with Cauchy's loss, so that a clock that is plainly wrong may be) and both are fitted ([`fit`]). The light of each visit to a pose is free. How much a lamp flickers
//! from frame to frame is fitted, too; visits with a bad frame are left out. What a dark level that is slightly off does is among
//! the unknowns, since it bends small signals. A curve that all exposures share is not seen.
//!
//! *Conditioning.* The curve is evaluated as 2 s/(1 + √(1 − 4 c s/S)), which has no difference that cancels as c → 0. The
//! normal equations have a prior on every unknown but c, whose information is at least a millionth of the largest.

mod pairs;
mod shares;

use nalgebra::{DMatrix, DVector};

pub(super) use self::pairs::read;
pub(super) use self::shares::shares;
use crate::observation::DetectorCurve;
use crate::wording::counted;

/// Standard uncertainty of an exposure time where the manifest states none.
const EXPOSURE_REL_STD_DEFAULT: f64 = 1e-3;
/// Least standard uncertainty of an exposure time, and of a dark level in counts: certainty has no weight.
const NEARLY_NONE: f64 = 1e-6;
/// Information that holds c at 0: a standard uncertainty of 1e-12.
const HELD: f64 = 1e24;
/// The curve and errors of exposure times are told from this size on …
const TOLD_SIZE: f64 = 1e-3;
/// … where they are this many standard uncertainties.
const TOLD_SIGMAS: f64 = 5.0;
/// Largest curve that is looked for: at 1/4 a full pixel would be at the vertex.
const CURVE_MAX: f64 = 0.2;
/// Flicker of the lamp to expect from frame to frame, and how many pairs that expectation counts as.
const FLICKER: f64 = 5e-4;
const FLICKER_PAIRS: f64 = 4.0;
/// Visits further off than this many robust deviations hold a bad frame.
const BAD_SIGMAS: f64 = 6.0;
/// Fewer visits do not tell a curve from a bad frame.
const VISITS_MIN: usize = 3;

/// What a camera counts of light: s = e (1 − c e/S).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Curve {
    pub(super) c: f64,
    /// Full scale S, counts.
    pub(super) full_dn: f64,
}

impl Curve {
    /// What a linear camera would count, of a count above dark.
    pub(super) fn linear(self, counted: f64) -> f64 {
        let root = (1.0 - 4.0 * self.c * counted / self.full_dn)
            .max(0.0)
            .sqrt();
        2.0 * counted / (1.0 + root)
    }

    /// The count above dark where a linear camera would count so much.
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

/// What turns counts of one exposure time into those of a linear camera with a right clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Correction {
    pub(super) curve: Curve,
    /// True over stated exposure time.
    pub(super) time: f64,
}

/// Counts above dark of one frame, by how high they are.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Seen {
    /// Which of the exposure times.
    time: usize,
    /// Pixels and their counts, by level.
    bins: Vec<[f64; 2]>,
    /// Relative variance of the sum by counting and read noise.
    variance: f64,
}

/// Frames of one pose, taken one after the other at different exposure times.
type Visit = Vec<Seen>;

/// What is known before exposures are compared.
#[derive(Debug, Clone)]
struct Known {
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
struct Fitted {
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
fn light(seen: &Seen, known: &Known, x: &DVector<f64>) -> [f64; 3] {
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
    known: &Known,
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
fn off(visit: &Visit, known: &Known, x: &DVector<f64>, flicker: f64) -> f64 {
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
    known: &Known,
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
/// With a curve there are two ways to begin: from the curve that most visits want with a right clock, and from the clock
/// that they want without a curve. The end that is likelier is the answer.
fn fit(visits: &[Visit], known: &Known, bent: bool) -> Option<Fitted> {
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
    let starts = [Some(curve), straight.map(|f| f.x)];
    let ends = starts.into_iter().flatten();
    let ends = ends.filter_map(|start| fit_from(visits, known, &start, true));
    ends.min_by(|a, b| a.unlikely(known).total_cmp(&b.unlikely(known)))
}

/// Median over the visits of how far each is off.
fn median_off(visits: &[Visit], known: &Known, x: &DVector<f64>, flicker: f64) -> f64 {
    let mut all: Vec<f64> = visits.iter().map(|v| off(v, known, x, flicker)).collect();
    super::sensor::median(&mut all)
}

fn fit_from(visits: &[Visit], known: &Known, start: &DVector<f64>, bent: bool) -> Option<Fitted> {
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
        fitted = Some(Fitted {
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

impl Fitted {
    /// Twice the negative logarithm of how likely it is, up to a constant: the scatter that is left, visits left out, and
    /// what the clock is said to be off by.
    fn unlikely(&self, known: &Known) -> f64 {
        let std = known.time_std.max(NEARLY_NONE);
        let clock = self.x.as_slice()[TIMES..].iter();
        let clock: f64 = clock.map(|error| (1.0 + (error / std).powi(2)).ln()).sum();
        let out = self.kept.iter().filter(|kept| !**kept).count();
        let scatter = self.pairs as f64 * (self.flicker / FLICKER).powi(2).ln();
        scatter + BAD_SIGMAS * BAD_SIGMAS * out as f64 + clock
    }
}

/// What exposures of one pose say about the camera.
#[derive(Debug, Clone)]
pub(super) struct Detector {
    /// The curve, where the data tell one.
    pub(super) told: Option<DetectorCurve>,
    full_dn: f64,
    /// Exposure times of samples and flats, and by what share each is longer than stated.
    times: Vec<(f64, f64)>,
    /// Whether the errors of the exposure times are to be corrected.
    times_told: bool,
    /// Of c (if it is told) and of the errors of the exposure times, as far as they count.
    covariance: DMatrix<f64>,
}

/// A share of −0.5 % or the like.
fn percent(share: f64) -> String {
    format!("{:+.2} %", 100.0 * share)
}

impl Detector {
    /// From visits to poses; `all_times_s` are the exposure times of the whole series, `stated` the manifest's word on
    /// their standard uncertainty.
    fn of(visits: &[Visit], known: &Known, all_times_s: &[f64], stated: Option<f64>) -> Detector {
        let bent = fit(visits, known, true).filter(|f| {
            let (c, std) = (f.x[C], f.covariance[(C, C)].sqrt());
            c.abs() > TOLD_SIZE && c.abs() > TOLD_SIGMAS * std && c.abs() < CURVE_MAX
        });
        let told = bent.as_ref().map(|f| {
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
                std: f.covariance[(C, C)].sqrt(),
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
        let mut times_told = false;
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
            let large = |(off, std): (f64, f64)| off.abs() > TOLD_SIZE.max(TOLD_SIGMAS * std);
            times_told = (0..n).any(|i| (0..i).any(|j| large(between(i, j))));
            let at = |s: f64| all_times_s.iter().position(|t| *t == s);
            let places: Vec<Option<usize>> = known.times_s.iter().map(|s| at(*s)).collect();
            for (i, place) in places.iter().enumerate() {
                if let Some(place) = place {
                    times[*place].1 = f.x[TIMES + i];
                }
            }
            // What nobody states of a linear camera's clock is left to the lamp's drift, as small as it is.
            if told.is_some() || times_told || stated.is_some() {
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
        if told.is_none() {
            for k in 0..size {
                covariance[(C, k)] = 0.0;
                covariance[(k, C)] = 0.0;
            }
        }
        Detector {
            told,
            full_dn: known.full_dn,
            times,
            times_told,
            covariance,
        }
    }

    fn curve(&self) -> Option<Curve> {
        self.told.map(|told| Curve {
            c: told.c,
            full_dn: self.full_dn,
        })
    }

    /// What to do to counts of an exposure time; `None` where they are right as they are.
    pub(super) fn correction(&self, exposure_s: f64) -> Option<Correction> {
        if self.told.is_none() && !self.times_told {
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

    /// What the user is told.
    pub(super) fn words(&self) -> Option<String> {
        let spread = || {
            let errors = self.times.iter().map(|(_, error)| *error);
            let (low, high) = errors.fold((0.0_f64, 0.0_f64), |(a, b), e| (a.min(e), b.max(e)));
            high - low
        };
        match &self.told {
            Some(told) => Some(format!(
                "the camera is not linear: at full scale ({:.0} DN above black) it counts {} of what a linear one would \
                 (c = {:.4} ± {:.4} in counts = light · (1 − c · light / full scale), from {} of exposures of one \
                 pose); all counts are corrected for it, and what is uncertain of it is in the budget's line detector. Check the \
                 camera's gain and gamma settings, or expose to half of full scale",
                told.full_scale_dn,
                percent(-told.c),
                told.c,
                told.std,
                counted(told.pairs, "pair"),
            )),
            None if self.times_told => Some(format!(
                "exposure times are off by {} against each other, the same at every level: they are corrected among \
                 themselves; check the shutter's timing",
                percent(spread()).trim_start_matches('+'),
            )),
            None => None,
        }
    }
}

#[cfg(test)]
mod tests;
