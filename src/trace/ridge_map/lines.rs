//! The mean along ridges: made level, cut to whole periods, turned to where its facets lean.

use super::super::profile::{Profile, ProfileError};
use super::{RIDGES_MIN, RidgeFacts, RidgeMap, RidgeMapError, SAMPLES_MIN};

/// The share of a ridge that leans to its facets' side differs from a half by this at least.
const LEAN_MIN: f64 = 0.05;

/// Standard errors by which a line may be off a straight facet.
const NOISE: f64 = 3.0;
/// Share of the ridges' height below which a deviation does not count as their shape.
const LEAST: f64 = 1e-3;

/// Means along the ridges, by their place across.
pub(super) struct Lines {
    /// How wide a line is, µm.
    pub width: f64,
    /// Share of the variance that the lines explain.
    pub explained: f64,
    /// Root mean square of what is left along a line, of the median line, µm.
    pub unevenness: f64,
    /// Standard error of the mean of the median line, µm.
    pub noise: f64,
    /// Place across and mean height, µm, by rising place.
    pub lines: Vec<(f64, f64)>,
}

impl Lines {
    /// Whole periods, levelled, straight where they are within their noise, +v where the facets lean. `wide` are the
    /// lines a sample wide, which tell what is left along them.
    pub fn profile(
        mut self,
        wide: &Lines,
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
        // A wave may be an overtone of ridges that differ by turns: the shortest that repeats as well as any.
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
        self.straighten();
        let share = self.leaning();
        let turned = share < 0.5;
        if turned {
            self.lines = self.lines.iter().rev().map(|(v, z)| (-v, *z)).collect();
        }
        let share = share.max(1.0 - share);
        if share < 0.5 + LEAN_MIN {
            return Err(RidgeMapError::BothSides { share });
        }
        let rows = self.whole_periods(period);
        let profile = Profile::measured(&rows)?;
        let theta_r = profile
            .effective_ridge_angle()
            .ok_or(ProfileError::LeansNowhere)?;
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
                filled_share: 0.0,
            },
            profile,
        })
    }

    fn length(&self) -> f64 {
        match (self.lines.first(), self.lines.last()) {
            (Some(first), Some(last)) => last.0 - first.0,
            _ => 0.0,
        }
    }

    /// Height at a place, between the lines beside it.
    fn at(&self, v: f64) -> f64 {
        let n = self.lines.partition_point(|l| l.0 < v);
        let (a, b) = (
            self.lines[n.saturating_sub(1)],
            self.lines[n.min(self.lines.len() - 1)],
        );
        if b.0 > a.0 {
            a.1 + (b.1 - a.1) * (v - a.0) / (b.0 - a.0)
        } else {
            a.1
        }
    }

    /// Pairs of heights that are so far apart.
    fn pairs(&self, distance: f64) -> impl Iterator<Item = (f64, f64)> {
        let end = self.lines.last().map_or(0.0, |l| l.0);
        self.lines
            .iter()
            .filter(move |(v, _)| v + distance <= end)
            .map(move |(v, z)| (*z, self.at(v + distance)))
    }

    /// Correlation of the profile with itself a distance on.
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

    /// The same period as far as ridges half the map apart tell it.
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

    /// Takes the tilt off by which a ridge is higher than another: a plane of least squares follows the ridges that are
    /// cut off at the map's ends.
    fn level(&mut self, period: f64) {
        let apart = (0.5 * self.length() / period).floor().max(1.0) * period;
        let (mut rise, mut n) = (0.0, 0.0);
        for (a, b) in self.pairs(apart) {
            rise += b - a;
            n += 1.0;
        }
        let slope = if n > 0.0 { rise / (n * apart) } else { 0.0 };
        for (v, z) in &mut self.lines {
            *z -= slope * *v;
        }
    }

    /// Leaves out lines that lie on the straight way between others within their noise (Ramer 1972, Douglas and Peucker
    /// 1973): facets become straight, corners stay where they are.
    fn straighten(&mut self) {
        let heights = self.lines.iter().map(|l| l.1);
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| {
            (l.min(z), h.max(z))
        });
        let within = (NOISE * self.noise).max(LEAST * (high - low));
        let last = self.lines.len().saturating_sub(1);
        let mut kept = vec![false; self.lines.len()];
        let mut pieces = vec![(0, last)];
        while let Some((from, to)) = pieces.pop() {
            (kept[from], kept[to]) = (true, true);
            let (a, b) = (self.lines[from], self.lines[to]);
            let (dx, dz) = (b.0 - a.0, b.1 - a.1);
            let off = |n: usize| {
                let (v, z) = self.lines[n];
                ((v - a.0) * dz - (z - a.1) * dx).abs() / dx.hypot(dz)
            };
            let worst = (from + 1..to).map(|n| (n, off(n)));
            if let Some((n, far)) = worst.max_by(|x, y| x.1.total_cmp(&y.1))
                && far > within
            {
                pieces.extend([(from, n), (n, to)]);
            }
        }
        let mut number = 0;
        self.lines.retain(|_| {
            number += 1;
            kept[number - 1]
        });
    }

    /// Share of the length that leans to +v.
    fn leaning(&self) -> f64 {
        let pairs = self.lines.windows(2);
        let down: f64 = pairs
            .filter(|pair| pair[1].1 < pair[0].1)
            .map(|pair| pair[1].0 - pair[0].0)
            .sum();
        down / self.length()
    }

    /// As many whole periods as there are, from the middle of a flank where both ends meet best; the last row closes them.
    fn whole_periods(&self, period: f64) -> Vec<(f64, f64)> {
        let length = (self.length() / period).floor() * period;
        let end = self.lines.last().map_or(0.0, |l| l.0);
        let flanks = self.lines.windows(2);
        let middles = flanks.map(|l| (l[1].0 - l[0].0, 0.5 * (l[0].0 + l[1].0)));
        let within: Vec<(f64, f64)> = middles.filter(|(_, v)| v + length <= end).collect();
        let longest = within.iter().fold(0.0f64, |a, b| a.max(b.0));
        let v0 = within
            .iter()
            .filter(|(flank, _)| *flank >= 0.5 * longest)
            .map(|(_, v)| (*v, (self.at(*v) - self.at(v + length)).abs()))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .or(self.lines.first().map(|l| (l.0, 0.0)))
            .map_or(0.0, |(v, _)| v);
        // A row beside the ends may all but touch them.
        let near = 0.25 * self.width;
        let between = |v: f64| v > v0 + near && v < v0 + length - near;
        let mut rows = vec![(v0, self.at(v0))];
        rows.extend(self.lines.iter().filter(|(v, _)| between(*v)));
        rows.push((v0 + length, self.at(v0)));
        rows
    }
}
