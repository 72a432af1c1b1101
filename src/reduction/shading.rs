//! Counts at response 1 over a frame of a near rig, by block and segment.
//!
//! Blocks are large enough for the sensor's pattern to average out. Segments that meet in a block differ in brightness, so each
//! has its own means.

use super::region::NOWHERE;

/// Blocks along the frame's shorter edge, and the least edge of one in pixels.
const BLOCKS: usize = 16;
const BLOCK_PX_MIN: usize = 8;

pub(super) struct Shading {
    width: usize,
    edge: usize,
    across: usize,
    down: usize,
    /// By segment, then row of blocks, then column: counts and responses.
    sums: Vec<(f64, f64)>,
}

impl Shading {
    /// Sums a frame of `width` × `height` pixels with `segments` segments. `pixels` gives each pixel's segment, counts above
    /// dark and response in the frame's order, or none for a pixel that is left out.
    pub(super) fn new(
        [width, height]: [usize; 2],
        segments: usize,
        pixels: impl Iterator<Item = Option<(u16, f64, f64)>>,
    ) -> Self {
        let edge = (width.min(height) / BLOCKS).max(BLOCK_PX_MIN);
        let (across, down) = (width.div_ceil(edge), height.div_ceil(edge));
        let mut sums = vec![(0.0, 0.0); segments * across * down];
        for (pixel, seen) in pixels.enumerate() {
            let Some((segment, counts, response)) = seen.filter(|(s, ..)| *s != NOWHERE) else {
                continue;
            };
            let block = pixel / width / edge * across + pixel % width / edge;
            let sum: &mut (f64, f64) = &mut sums[segment as usize * across * down + block];
            sum.0 += counts;
            sum.1 += response;
        }
        Shading {
            width,
            edge,
            across,
            down,
            sums,
        }
    }

    /// Interpolates the level at a pixel of a segment between the blocks around it that contain the segment; none without
    /// such a block.
    pub(super) fn at(&self, pixel: usize, segment: u16) -> Option<f32> {
        let place = |at: usize, count: usize| {
            let along = ((at as f64 + 0.5) / self.edge as f64 - 0.5).clamp(0.0, (count - 1) as f64);
            let before = along as usize;
            (before, (before + 1).min(count - 1), along - before as f64)
        };
        let (left, right, x) = place(pixel % self.width, self.across);
        let (above, below, y) = place(pixel / self.width, self.down);
        let first = segment as usize * self.across * self.down;
        let (mut weights, mut level) = (0.0, 0.0);
        for (row, wy) in [(above, 1.0 - y), (below, y)] {
            for (column, wx) in [(left, 1.0 - x), (right, x)] {
                let sum = self.sums.get(first + row * self.across + column);
                if let Some((counts, response)) = sum.filter(|(_, response)| *response > 0.0) {
                    weights += wx * wy;
                    level += wx * wy * (counts / response.max(1.0)).max(0.0);
                }
            }
        }
        (weights > 1e-6).then(|| (level / weights) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_followed_between_the_middles_of_the_blocks() {
        let ramp = |x: f64, y: f64| 100.0 + 2.0 * x - 3.0 * y;
        let middle = |pixel: usize| ((pixel % 40) as f64 + 0.5, (pixel / 40) as f64 + 0.5);
        let pixels = (0..40 * 24).map(|pixel| {
            let (x, y) = middle(pixel);
            Some((0, ramp(x, y), 1.0))
        });
        let shading = Shading::new([40, 24], 1, pixels);
        for pixel in 0..40 * 24 {
            let (x, y) = middle(pixel);
            // Beyond the outermost centres the level is constant.
            let expected = ramp(x.clamp(4.0, 36.0), y.clamp(4.0, 20.0));
            let found = f64::from(shading.at(pixel, 0).unwrap());
            assert!(
                (found - expected).abs() < 1e-3,
                "{pixel} {found} {expected}"
            );
        }
    }

    #[test]
    fn segments_that_meet_in_a_block_keep_their_levels_and_slopes_are_followed() {
        let (width, height) = (64, 64);
        // Odd columns of patches ten times as bright; the border lies within a block.
        let segment = |pixel: usize| u16::from(pixel % width >= 30);
        let level = |pixel: usize| {
            let slope = 1.0 + 0.01 * (pixel / width) as f64;
            slope * if segment(pixel) == 1 { 1000.0 } else { 100.0 }
        };
        let pixels = (0..width * height).map(|p| Some((segment(p), 2.0 * level(p), 2.0)));
        let shading = Shading::new([width, height], 3, pixels);
        for pixel in (0..width * height).filter(|p| (8..56).contains(&(p / width))) {
            let found = f64::from(shading.at(pixel, segment(pixel)).unwrap());
            assert!((found / level(pixel) - 1.0).abs() < 0.01, "{pixel} {found}");
        }
        assert_eq!(shading.at(0, 2), None);
        assert_eq!(shading.at(0, 1), None);
    }
}
