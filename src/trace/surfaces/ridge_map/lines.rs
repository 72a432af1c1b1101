//! The mean along ridges: levelled, cropped to whole periods, oriented towards the facets' lean.

use super::{RIDGES_MIN, RidgeFacts, RidgeMap, RidgeMapError, SAMPLES_MIN};
use crate::trace::surfaces::surface_profile::{ProfileError, SurfaceProfile};

/// Least difference from one half of the fraction of a ridge that leans to its facets' side.
const LEAN_MIN: f64 = 0.05;

/// Standard errors by which a line may deviate from a straight facet.
const NOISE: f64 = 3.0;
/// Deviations below this fraction of the ridges' height are not part of their shape.
const LEAST: f64 = 2e-4;

/// Means along the ridges, by their position across.
#[derive(Debug, Clone)]
pub(super) struct RidgeLines {
    /// Width of a line, µm.
    pub width: f64,
    /// Width of a sample across the ridges, µm.
    pub sample: f64,
    /// Fraction of the variance that the lines explain.
    pub explained: f64,
    /// Root mean square of the residuals along the median line, µm.
    pub unevenness: f64,
    /// Positions of lines with too few measured heights for a mean.
    pub holes: Vec<f64>,
    /// Sorted by position.
    pub lines: Vec<RidgeLine>,
}

/// The mean of the heights along a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct RidgeLine {
    /// Position across, µm.
    pub v: f64,
    /// Mean height, µm.
    pub z: f64,
    /// Number of heights averaged.
    pub count: f64,
}

/// How far flanks are extended into a gap beside them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum FlankExtension {
    /// Until half of it is left.
    Half,
    /// Until only a vertical wall is left.
    Whole,
}

impl RidgeLines {
    /// The profile: whole periods, levelled, straight where deviations are within the noise, +v
    /// towards the facets' lean. `wide` are lines one sample wide, used for the residuals along
    /// them.
    pub fn profile(
        mut self,
        wide: &RidgeLines,
        period: f64,
        across: f64,
    ) -> Result<RidgeMap, RidgeMapError> {
        let samples = period / wide.width;
        if samples < SAMPLES_MIN {
            return Err(RidgeMapError::Coarse {
                period_um: period,
                samples,
            });
        }
        let length = self.length();
        // A wave may be an overtone of ridges that alternate: the shortest period that repeats as
        // well as any is used.
        let (times, _) = (1..=4)
            .filter(|times| f64::from(*times) * period * RIDGES_MIN <= length)
            .map(|times| (times, self.repeats(f64::from(times) * period)))
            .fold((1, f64::NEG_INFINITY), |best, (times, found)| {
                if found > best.1 + 0.05 {
                    (times, found)
                } else {
                    best
                }
            });
        let period = f64::from(times) * period;
        let ridges = length / period;
        if ridges < RIDGES_MIN {
            return Err(RidgeMapError::FewRidges {
                ridges,
                period_um: period,
            });
        }
        let period = self.sharpened(period);
        self.level(period);
        let share = self.straight().leaning();
        let turned = share < 0.5;
        if turned {
            for line in &mut self.lines {
                line.v = -line.v;
            }
            self.lines.reverse();
            for hole in &mut self.holes {
                *hole = -*hole;
            }
        }
        let share = share.max(1.0 - share);
        if share < 0.5 + LEAN_MIN {
            return Err(RidgeMapError::BothSides { share });
        }
        let profile = self.straightened(period, FlankExtension::Half)?;
        let theta_r = profile
            .effective_ridge_angle()
            .ok_or(ProfileError::LeansNowhere)?;
        let lobe_error = self.lobe_error(&profile, period);
        let unseen_share = self.unseen();
        let mut profile = profile.with_lobe_error(lobe_error);
        if unseen_share > 0.0 {
            profile = profile.with_alternative(self.straightened(period, FlankExtension::Whole)?);
        }
        let (low, high) = profile.range();
        let lean = across.to_degrees() + if turned { 180.0 } else { 0.0 };
        Ok(RidgeMap {
            facts: RidgeFacts {
                lean_azimuth_deg: lean.rem_euclid(360.0),
                period_um: period,
                sample_um: wide.width,
                ridges: (profile.period() / period).round() as usize,
                height_um: high - low,
                unevenness_um: wide.unevenness,
                explained: wide.explained,
                theta_r_deg: theta_r.to_degrees(),
                lobe_error_deg: lobe_error.to_degrees(),
                filled_share: 0.0,
                unseen_share,
            },
            profile,
        })
    }

    /// Length from the first line to the last.
    pub fn length(&self) -> f64 {
        match (self.lines.first(), self.lines.last()) {
            (Some(first), Some(last)) => last.v - first.v,
            _ => 0.0,
        }
    }

    /// Height at a position, interpolated between the adjacent lines.
    fn at(&self, v: f64) -> f64 {
        let n = self.lines.partition_point(|l| l.v < v);
        let (a, b) = (
            self.lines[n.saturating_sub(1)],
            self.lines[n.min(self.lines.len() - 1)],
        );
        if b.v > a.v {
            a.z + (b.z - a.z) * (v - a.v) / (b.v - a.v)
        } else {
            a.z
        }
    }

    /// Pairs of heights at this distance.
    fn pairs(&self, distance: f64) -> impl Iterator<Item = (f64, f64)> {
        let end = self.lines.last().map_or(0.0, |l| l.v);
        self.lines
            .iter()
            .filter(move |l| l.v + distance <= end)
            .map(move |l| (l.z, self.at(l.v + distance)))
    }

    /// Correlation of the profile with itself, shifted by a distance.
    fn repeats(&self, distance: f64) -> f64 {
        let (mut n, mut a, mut b, mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for (x, y) in self.pairs(distance) {
            n += 1.0;
            (a, b) = (a + x, b + y);
            (aa, bb, ab) = (aa + x * x, bb + y * y, ab + x * y);
        }
        let spread = (aa - a * a / n) * (bb - b * b / n);
        if spread > 0.0 {
            (ab - a * b / n) / spread.sqrt()
        } else {
            -1.0
        }
    }

    /// Refines the period with ridges up to half the map apart.
    fn sharpened(&self, period: f64) -> f64 {
        let times = (0.5 * self.length() / period).floor().max(1.0);
        let (mut at, mut step) = (period, 0.02 * period);
        let mut best = self.repeats(times * at);
        while step > 1e-5 * period {
            let (left, right) = (
                self.repeats(times * (at - step)),
                self.repeats(times * (at + step)),
            );
            if left.max(right) > best {
                at += if left > right { -step } else { step };
                best = left.max(right);
            } else {
                step *= 0.5;
            }
        }
        at
    }

    /// Subtracts the tilt that makes one ridge higher than another. A least-squares plane would
    /// follow the ridges that are cut off at the map's ends.
    fn level(&mut self, period: f64) {
        let apart = (0.5 * self.length() / period).floor().max(1.0) * period;
        let (mut rise, mut n) = (0.0, 0.0);
        for (a, b) in self.pairs(apart) {
            rise += b - a;
            n += 1.0;
        }
        let slope = if n > 0.0 { rise / (n * apart) } else { 0.0 };
        for line in &mut self.lines {
            line.z -= slope * line.v;
        }
    }

    /// The lines with straight facets.
    fn straight(&self) -> RidgeLines {
        let mut lines = self.clone();
        lines.settle(&self.corners());
        lines
    }

    /// Whole periods of the straight lines, with gaps bridged.
    fn straightened(
        &self,
        period: f64,
        reach: FlankExtension,
    ) -> Result<SurfaceProfile, ProfileError> {
        let straight = self.bridged_by(&self.straight(), reach);
        SurfaceProfile::measured(&straight.whole_periods(period))
    }

    /// The ends of straight pieces that contain all lines within their noise (Ramer 1972, Douglas
    /// and Peucker 1973).
    fn corners(&self) -> Vec<usize> {
        let heights = self.lines.iter().map(|l| l.z);
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| {
            (l.min(z), h.max(z))
        });
        let least = LEAST * (high - low);
        let last = self.lines.len().saturating_sub(1);
        let mut kept = vec![false; self.lines.len()];
        let mut pieces = vec![(0, last)];
        while let Some((from, to)) = pieces.pop() {
            (kept[from], kept[to]) = (true, true);
            let (a, b) = (self.lines[from], self.lines[to]);
            let (dx, dz) = (b.v - a.v, b.z - a.z);
            // In units of the allowed deviation of each line.
            let off = |n: usize| {
                let line = self.lines[n];
                let noise = NOISE * self.unevenness / line.count.sqrt();
                let far = ((line.v - a.v) * dz - (line.z - a.z) * dx).abs() / dx.hypot(dz);
                far / noise.max(least)
            };
            let worst = (from + 1..to).map(|n| (n, off(n)));
            if let Some((n, far)) = worst.max_by(|x, y| x.1.total_cmp(&y.1))
                && far > 1.0
            {
                pieces.extend([(from, n), (n, to)]);
            }
        }
        (0..=last).filter(|n| kept[*n]).collect()
    }

    /// Removes all lines but these, whose heights become those of the best-fitting straight pieces
    /// between them: a corner is chosen because it deviates most, so its own height is biased.
    fn settle(&mut self, kept: &[usize]) {
        // Heights at the corners by least squares: each line is between two of them.
        let count = kept.len();
        let (mut diagonal, mut beside, mut right) =
            (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
        for (n, ends) in kept.windows(2).enumerate() {
            let (a, b) = (self.lines[ends[0]].v, self.lines[ends[1]].v);
            // The last line belongs to the last piece.
            let until = ends[1] + usize::from(n + 2 == count);
            for line in &self.lines[ends[0]..until] {
                let t = (line.v - a) / (b - a);
                let (w, s) = (line.count, 1.0 - t);
                diagonal[n] += w * s * s;
                diagonal[n + 1] += w * t * t;
                beside[n] += w * s * t;
                right[n] += w * s * line.z;
                right[n + 1] += w * t * line.z;
            }
        }
        // Positive definite and tridiagonal: elimination without pivoting.
        for n in 1..count {
            let factor = beside[n - 1] / diagonal[n - 1];
            diagonal[n] -= factor * beside[n - 1];
            right[n] -= factor * right[n - 1];
        }
        for n in (0..count).rev() {
            let next = right.get(n + 1).map_or(0.0, |z| beside[n] * z);
            right[n] = (right[n] - next) / diagonal[n];
        }
        self.lines = kept
            .iter()
            .zip(right)
            .map(|(n, z)| RidgeLine {
                z,
                ..self.lines[*n]
            })
            .collect();
    }

    /// Standard uncertainty (rad) of the lobe's angle at the profile's effective ridge angle.
    /// Profiles from only every second or fourth line have wider samples and fewer heights: their
    /// common change is the effect of the samples' width, their differences are noise.
    fn lobe_error(&self, profile: &SurfaceProfile, period: f64) -> f64 {
        let Some(whole) = profile.lobe_offsets() else {
            return 0.0;
        };
        let thinned = |first: usize, step: usize| {
            let lines = self.lines.iter().skip(first).step_by(step);
            let part = RidgeLines {
                lines: lines.copied().collect(),
                holes: self.holes.clone(),
                ..*self
            };
            part.straightened(period, FlankExtension::Half)
                .ok()?
                .lobe_offsets()
        };
        let mut most = 0.0f64;
        for step in [2, 4] {
            let parts: Option<Vec<_>> = (0..step).map(|first| thinned(first, step)).collect();
            // Too few lines to leave some out: the comparison uses those that exist.
            let Some(parts) = parts else { continue };
            let (count, further) = (step as f64, step as f64 - 1.0);
            for (n, whole) in whole.iter().enumerate() {
                let mean = parts.iter().map(|part| part[n]).sum::<f64>() / count;
                let squares = parts.iter().map(|part| (part[n] - mean).powi(2));
                let noise = (squares.sum::<f64>() / count / further).sqrt();
                // The width's contribution grows with it.
                most = most.max(noise.hypot((mean - whole) / further));
            }
        }
        most
    }

    /// Fraction of the length that leans to +v.
    fn leaning(&self) -> f64 {
        let pairs = self.lines.windows(2);
        let down: f64 = pairs
            .filter(|pair| pair[1].z < pair[0].z)
            .map(|pair| pair[1].v - pair[0].v)
            .sum();
        down / self.length()
    }

    /// As many whole periods as possible, from the middle of the flank at which both ends match
    /// best; the last row closes them.
    fn whole_periods(&self, period: f64) -> Vec<(f64, f64)> {
        let length = (self.length() / period).floor() * period;
        let end = self.lines.last().map_or(0.0, |l| l.v);
        let flanks = self.lines.windows(2);
        let middles = flanks.map(|l| (l[1].v - l[0].v, 0.5 * (l[0].v + l[1].v)));
        let within: Vec<(f64, f64)> = middles.filter(|(_, v)| v + length <= end).collect();
        let longest = within.iter().fold(0.0f64, |a, b| a.max(b.0));
        let v0 = within
            .iter()
            .filter(|(flank, _)| *flank >= 0.5 * longest)
            .map(|(_, v)| (*v, (self.at(*v) - self.at(v + length)).abs()))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .or(self.lines.first().map(|l| (l.v, 0.0)))
            .map_or(0.0, |(v, _)| v);
        // A row beside the ends may almost coincide with them.
        let near = 0.25 * self.width;
        let between = |v: f64| v > v0 + near && v < v0 + length - near;
        let mut rows = vec![(v0, self.at(v0))];
        let inner = self.lines.iter().filter(|l| between(l.v));
        rows.extend(inner.map(|l| (l.v, l.z)));
        rows.push((v0 + length, self.at(v0)));
        rows
    }
}
