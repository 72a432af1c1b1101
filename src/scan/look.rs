//! How a frame looks, in a few numbers: medians over a grid of blocks. Two frames of one pose agree, frames of poses that differ
//! in brightness do not; hot pixels and texts in a few pixels have no effect.

use super::frame_rules::FrameRules;
use crate::frame::Frame;

/// Blocks along each edge.
const GRID: usize = 8;
/// Standard errors of a median over those of a mean.
const MEDIAN_ERROR: f64 = 1.2533;
/// Factor on the expected noise of a difference of two frames: the mean square over all blocks exceeds it once in 10⁸.
const NOISE_FACTOR: f64 = 1.5;
/// Share of full pixels from which a block says nothing.
const FULL_SHARE_MAX: f64 = 0.25;

/// A block in both frames: level and its standard error, each.
type Pair = ((f64, f64), (f64, f64));

/// How a frame looks.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    exposure_s: f64,
    /// Median count of each block above the black level, and its standard error; `None` where the block is full.
    blocks: Vec<Option<(f64, f64)>>,
}

/// How two frames of one exposure differ, as shares of the brighter one's level.
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
        Look { exposure_s, blocks }
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

    /// Compares with a later frame; `None` where exposure or size differ, or there is too little light.
    pub(super) fn difference(&self, later: &Look) -> Option<Difference> {
        let alike = self.exposure_s.to_bits() == later.exposure_s.to_bits()
            && self.blocks.len() == later.blocks.len();
        if !(alike && self.is_comparable() && later.is_comparable()) {
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
