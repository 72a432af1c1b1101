//! How a frame looks, in a few numbers: medians over a grid of blocks. Two frames of one pose agree, frames of poses that differ
//! in brightness do not; hot pixels and texts in a few pixels have no effect.

use super::frame_rules::FrameRules;
use crate::frame::{Frame, FrameKind};

/// Blocks along each edge.
const GRID: usize = 8;
/// Standard errors of a median over those of a mean.
const MEDIAN_ERROR: f64 = 1.2533;
/// Factor on the expected noise of a difference of two frames: the mean square over all blocks exceeds it once in 10⁸.
const NOISE_FACTOR: f64 = 1.5;
/// Share of full pixels from which the median of a block is not known.
const FULL_SHARE_MAX: f64 = 0.25;
/// Difference of two frames that always counts as none, counts: medians are whole numbers, and the black level drifts.
const SAME_DN: f64 = 1.0;
/// The same for frames without light, as a share of the counts that a frame under the cap may have.
const SAME_DARK_SHARE: f64 = 0.1;
/// Counts may follow the exposure to this power more or less: cameras are not linear.
const SCALE_POWER: f64 = 2.0 / 3.0;
/// Least factor by which counts may deviate from the exposure: lamps flicker.
const SCALE_FACTOR_MIN: f64 = 1.5;

/// A block in both frames: level and its standard error, each.
type Pair = ((f64, f64), (f64, f64));

/// How a frame looks.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    exposure_s: f64,
    /// Counts of a full pixel above the black level.
    full_dn: f64,
    /// Median count of each block above the black level, and its standard error; `None` where the block is full.
    blocks: Vec<Option<(f64, f64)>>,
}

/// How two frames differ, as shares of the brighter one's level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Difference {
    /// Change of the level.
    pub level: f64,
    /// Change of the pattern when the levels are made equal, root mean square.
    pub pattern: f64,
    /// Root mean square of all changes.
    pub total: f64,
    /// The same that noise alone makes.
    pub noise: f64,
}

impl Difference {
    /// Whether the frames differ by no more than `share` beyond noise.
    pub fn is_within(&self, share: f64) -> bool {
        self.total <= share + self.noise
    }
}

impl Look {
    /// Returns how a frame looks.
    #[must_use]
    pub fn of(frame: &Frame, exposure_s: f64, rules: &FrameRules) -> Look {
        let (width, height) = (frame.width_px() as usize, frame.height_px() as usize);
        let edges = |length: usize| -> Vec<(usize, usize)> {
            let n = GRID.min(length);
            (0..n)
                .map(|i| (i * length / n, (i + 1) * length / n))
                .collect()
        };
        let (columns, rows) = (edges(width), edges(height));
        let mut blocks = Vec::with_capacity(columns.len() * rows.len());
        let mut pixels = Vec::new();
        for (top, bottom) in &rows {
            for (left, right) in &columns {
                pixels.clear();
                for row in *top..*bottom {
                    let start = row * width;
                    pixels.extend_from_slice(&frame.pixels_dn()[start + left..start + right]);
                }
                blocks.push(block(&mut pixels, rules));
            }
        }
        Look {
            exposure_s,
            full_dn: f64::from(rules.saturation_dn) - rules.black_level_dn,
            blocks,
        }
    }

    /// Exposure of the frame.
    #[must_use]
    pub fn exposure_s(&self) -> f64 {
        self.exposure_s
    }

    /// Returns the share of blocks without light.
    #[must_use]
    pub fn unlit_share(&self, rules: &FrameRules) -> f64 {
        let unlit = |block: &&Option<(f64, f64)>| {
            block.is_some_and(|(median, error)| median <= 1.0_f64.max(rules.dark_sigmas * error))
        };
        self.blocks.iter().filter(unlit).count() as f64 / self.blocks.len() as f64
    }

    /// Whether the frame has light that can be compared.
    pub(super) fn is_comparable(&self) -> bool {
        let known = self.blocks.iter().flatten();
        let (sum, error) = known.fold((0.0, 0.0), |(sum, error), block| {
            (sum + block.0, error + block.1)
        });
        sum > 10.0 * error && 2 * self.blocks.iter().flatten().count() > self.blocks.len()
    }

    /// Whether another frame has the same exposure.
    pub(super) fn has_exposure_of(&self, other: &Look) -> bool {
        self.exposure_s.to_bits() == other.exposure_s.to_bits()
    }

    /// Mean count above the black level; a full block counts as full.
    pub(super) fn level_dn(&self) -> f64 {
        let levels = self.blocks.iter();
        let sum: f64 = levels
            .map(|block| block.map_or(self.full_dn, |(dn, _)| dn))
            .sum();
        sum / self.blocks.len() as f64
    }

    /// Whether two frames of a kind show the same within `share` beyond noise, also where they show no light. A block that is
    /// full in both is the same; one that is full in one of them must be half full in the other.
    pub(super) fn agrees_with(
        &self,
        other: &Look,
        kind: FrameKind,
        share: f64,
        rules: &FrameRules,
    ) -> bool {
        if self.blocks.len() != other.blocks.len() {
            return false;
        }
        let mut pairs: Vec<Pair> = Vec::new();
        for blocks in std::iter::zip(&self.blocks, &other.blocks) {
            match blocks {
                (Some(a), Some(b)) => pairs.push((*a, *b)),
                (None, None) => {}
                (None, Some((dn, _))) | (Some((dn, _)), None) if 2.0 * dn > self.full_dn => {}
                _ => return false,
            }
        }
        if pairs.is_empty() {
            return true;
        }
        let n = pairs.len() as f64;
        let mean = |of: &dyn Fn(&Pair) -> f64| pairs.iter().map(of).sum::<f64>() / n;
        let scale = mean(&|p| p.0.0).abs().max(mean(&|p| p.1.0).abs());
        let total = mean(&|p| (p.1.0 - p.0.0).powi(2)).sqrt();
        let noise = NOISE_FACTOR * mean(&|p| p.0.1.powi(2) + p.1.1.powi(2)).sqrt();
        // What a frame under the cap shows may exceed the stated noise by far, and is no light.
        let is_lit = kind != FrameKind::Dark && self.is_comparable() && other.is_comparable();
        let always_dn = match is_lit {
            true => SAME_DN,
            false => SAME_DN.max(SAME_DARK_SHARE * rules.capped.at(self.exposure_s)),
        };
        total <= share * scale + noise + always_dn
    }

    /// Whether the counts of two frames of one place have the ratio of their exposures, within a generous factor and the counts
    /// that a frame under the cap may have. Full blocks may be any brighter.
    pub(super) fn scales_with(&self, other: &Look, rules: &FrameRules) -> bool {
        let (short, long) = match self.exposure_s <= other.exposure_s {
            true => (self, other),
            false => (other, self),
        };
        let ratio = long.exposure_s / short.exposure_s;
        let factor = ratio.powf(SCALE_POWER).max(SCALE_FACTOR_MIN);
        // Mean of the frame that may be too dark, and least mean of the other one, over the blocks where the first is known.
        let means = |dark: &Look, bright: &Look| -> Option<(f64, f64)> {
            let least_dn = FULL_SHARE_MAX * bright.full_dn;
            let pairs: Vec<(f64, f64)> = std::iter::zip(&dark.blocks, &bright.blocks)
                .filter_map(|(a, b)| Some(((*a)?.0, b.map_or(least_dn, |(dn, _)| dn))))
                .collect();
            let n = pairs.len() as f64;
            let sum = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>();
            (2 * pairs.len() > dark.blocks.len())
                .then(|| (sum(|pair| pair.0) / n, sum(|pair| pair.1) / n))
        };
        let (short_dn, long_dn) = (
            rules.capped.at(short.exposure_s),
            rules.capped.at(long.exposure_s),
        );
        let long_is_too_dark = means(long, short)
            .is_some_and(|(long, short)| long + long_dn < ratio / factor * (short - short_dn));
        let long_is_too_bright = means(short, long)
            .is_some_and(|(short, long)| long - long_dn > ratio * factor * (short + short_dn));
        !(long_is_too_dark || long_is_too_bright)
    }

    /// Returns the same look in light that is brighter by this share.
    pub(super) fn brighter_by(&self, share: f64) -> Look {
        let brighter = |(dn, error): (f64, f64)| (dn * (1.0 + share), error);
        Look {
            blocks: self
                .blocks
                .iter()
                .map(|block| block.map(brighter))
                .collect(),
            ..*self
        }
    }

    /// Compares with a later frame of the same exposure; `None` where exposure or size differ, or there is too little light.
    pub(super) fn difference(&self, later: &Look) -> Option<Difference> {
        match self.has_exposure_of(later) {
            true => self.compare(later),
            false => None,
        }
    }

    /// Compares with another frame, whatever its exposure; `None` where the sizes differ, or there is too little light.
    pub(super) fn compare(&self, later: &Look) -> Option<Difference> {
        let same_size = self.blocks.len() == later.blocks.len();
        if !(same_size && self.is_comparable() && later.is_comparable()) {
            return None;
        }
        let pairs: Vec<Pair> = std::iter::zip(&self.blocks, &later.blocks)
            .filter_map(|(a, b)| Some(((*a)?, (*b)?)))
            .collect();
        let n = pairs.len() as f64;
        if pairs.is_empty() {
            return None;
        }
        let mean = |of: &dyn Fn(&Pair) -> f64| pairs.iter().map(of).sum::<f64>() / n;
        let (first, second) = (mean(&|p| p.0.0), mean(&|p| p.1.0));
        let scale = first.abs().max(second.abs());
        if scale <= 0.0 {
            return None;
        }
        let total = mean(&|p| (p.1.0 - p.0.0).powi(2)).sqrt() / scale;
        let noise = NOISE_FACTOR * mean(&|p| p.0.1.powi(2) + p.1.1.powi(2)).sqrt() / scale;
        let ratio = match first.abs() > 0.0 {
            true => second / first,
            false => 1.0,
        };
        let pattern = mean(&|p| (p.1.0 - ratio * p.0.0).powi(2)).sqrt() / scale;
        Some(Difference {
            level: (second - first) / scale,
            pattern,
            total,
            noise,
        })
    }
}

/// Median above the black level with its standard error; `None` for a block with many full pixels.
fn block(pixels: &mut [u16], rules: &FrameRules) -> Option<(f64, f64)> {
    let n = pixels.len();
    let full = pixels
        .iter()
        .filter(|dn| **dn >= rules.saturation_dn)
        .count();
    if n == 0 || full as f64 > FULL_SHARE_MAX * n as f64 {
        return None;
    }
    let (_, median, _) = pixels.select_nth_unstable(n / 2);
    let median = f64::from(*median) - rules.black_level_dn;
    let shot = rules.gain_dn_per_electron * median.max(0.0);
    // Counts are whole numbers.
    let variance = rules.read_noise_dn.powi(2) + shot + 1.0 / 12.0;
    Some((median, MEDIAN_ERROR * (variance / n as f64).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::frame_rules::tests::rules;

    /// A frame of 64 × 64 with noise; `level` by column and row.
    fn frame(seed: u32, level: impl Fn(usize, usize) -> f64) -> Frame {
        let mut state = seed;
        let mut noise = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 16) / 65536.0 - 0.5
        };
        let pixels = (0..64 * 64)
            .map(|i| (200.0 + level(i % 64, i / 64) + 20.0 * noise()).round() as u16)
            .collect();
        Frame::new(64, 64, pixels).unwrap()
    }

    fn look(seed: u32, level: impl Fn(usize, usize) -> f64) -> Look {
        Look::of(&frame(seed, level), 0.02, &rules())
    }

    #[test]
    fn two_frames_of_one_pose_agree_and_another_level_or_pattern_does_not() {
        let slope = |x: usize, _: usize| 1000.0 + 5.0 * x as f64;
        let first = look(1, slope);
        let again = first.difference(&look(2, slope)).unwrap();
        assert!(again.is_within(0.0), "{again:?}");
        let brighter = first
            .difference(&look(2, |x, y| 1.05 * slope(x, y)))
            .unwrap();
        assert!((brighter.level - 0.0476).abs() < 2e-3, "{brighter:?}");
        assert!(brighter.pattern < 3e-3 && !brighter.is_within(0.02));
        let shifted = first
            .difference(&look(2, |x, y| slope((x + 20) % 64, y)))
            .unwrap();
        assert!(shifted.pattern > 0.05, "{shifted:?}");
        // Hot pixels and a text in the first row have no effect.
        let marked = look(2, |x, y| {
            if y == 0 && x < 11 {
                40_000.0
            } else {
                slope(x, y)
            }
        });
        assert!(first.difference(&marked).unwrap().is_within(0.0));
    }

    #[test]
    fn frames_agree_also_where_they_show_no_light_or_are_full() {
        let even = |seed, dn: f64| look(seed, move |_, _| dn);
        let of_kind = |kind, a, b| even(1, a).agrees_with(&even(2, b), kind, 0.01, &rules());
        let agree = |a, b| of_kind(FrameKind::Sample, a, b);
        for dn in [0.0, 30.0, 1000.0, 60_000.0] {
            assert!(agree(dn, dn) && !agree(dn, 500.0), "{dn}");
        }
        // A block at the edge of saturation.
        assert!(agree(3795.0, 60_000.0));
        assert!(!agree(0.0, 20.0));
        // Dark frames have a tolerance of their own, also where the black level is stated too low.
        let in_the_dark = |a, b| of_kind(FrameKind::Dark, a, b);
        assert!(in_the_dark(40.0, 44.0) && !agree(40.0, 44.0));
        assert!(!in_the_dark(40.0, 70.0));
    }

    #[test]
    fn counts_follow_the_exposure_within_a_generous_factor() {
        let taken = |exposure_s: f64, dn: f64| Look::of(&frame(1, |_, _| dn), exposure_s, &rules());
        for (short_dn, long_dn, follows) in [
            (1000.0, 2000.0, true),
            // A camera that is not linear, and a lamp that flickers.
            (1000.0, 1300.0, true),
            (1000.0, 2900.0, true),
            // The frames of the two exposures exchanged.
            (2000.0, 1000.0, false),
            (500.0, 2000.0, false),
            // Little light: the black level is not known as well.
            (0.0, 0.0, true),
            (60.0, 20.0, true),
            // A full frame may have had any light.
            (3000.0, 60_000.0, true),
            (60_000.0, 60_000.0, true),
            (60_000.0, 300.0, false),
            (0.0, 60_000.0, false),
        ] {
            let (short, long) = (taken(0.01, short_dn), taken(0.02, long_dn));
            assert_eq!(
                short.scales_with(&long, &rules()),
                follows,
                "{short_dn}, {long_dn}"
            );
            assert_eq!(
                long.scales_with(&short, &rules()),
                follows,
                "{short_dn}, {long_dn}"
            );
        }
        // Two frames of one exposure.
        assert!(taken(0.01, 1000.0).scales_with(&taken(0.01, 800.0), &rules()));
        assert!(!taken(0.01, 1000.0).scales_with(&taken(0.01, 300.0), &rules()));
    }

    #[test]
    fn dark_and_full_frames_are_not_compared() {
        let lit = look(1, |_, _| 1000.0);
        let dark = look(2, |_, _| 0.0);
        let full = look(3, |_, _| 60_000.0);
        assert_eq!(lit.difference(&dark), None);
        assert_eq!(lit.difference(&full), None);
        assert!(dark.unlit_share(&rules()) > 0.9);
        assert_eq!(lit.unlit_share(&rules()), 0.0);
        let half = look(4, |_, y| if y < 32 { 1000.0 } else { 0.0 });
        assert_eq!(half.unlit_share(&rules()), 0.5);
    }
}
