//! The figures of one frame: counts, histogram, saturation and focus.

use super::{Area, CountScale};
use crate::frame::Frame;

/// Bins of the histogram.
pub const BINS: usize = 64;

/// Least mean above black that has a focus, in read noises.
const LIGHT_SIGMAS: f64 = 10.0;

/// Figures of the pixels of an area; defect pixels take no part, unless it is stated.
#[derive(Debug, Clone, PartialEq)]
pub struct Figures {
    /// Least count.
    pub min_dn: u16,
    /// Median count.
    pub median_dn: u16,
    /// Mean count.
    pub mean_dn: f64,
    /// Greatest count.
    pub max_dn: u16,
    /// Pixels per bin; [`BINS`] bins of [`Figures::bin_dn`] counts from 0.
    pub histogram: Vec<u32>,
    /// Counts per bin.
    pub bin_dn: u32,
    /// Pixels at or above the full count.
    pub saturated_px: u32,
    /// Defect pixels of the area.
    pub defect_px: u32,
    /// Root mean square of the relative change of brightness from pixel to pixel, without the part of the noise (see
    /// [`focus`]); `None` without light.
    pub focus: Option<f64>,
}

impl Figures {
    /// Returns the figures of an area that lies inside the frame; `None` if it has only defect pixels.
    #[must_use]
    pub fn of(frame: &Frame, area: Area, masked: &[bool], scale: &CountScale) -> Option<Figures> {
        let width = frame.width_px() as usize;
        let mut counts = vec![0_u32; 1 << 16];
        let (mut defect_px, mut n, mut sum) = (0, 0_u32, 0_u64);
        for y in area.rows() {
            for x in area.columns() {
                let pixel = y * width + x;
                if masked[pixel] {
                    defect_px += 1;
                    continue;
                }
                let dn = frame.pixels_dn()[pixel];
                counts[usize::from(dn)] += 1;
                n += 1;
                sum += u64::from(dn);
            }
        }
        let min = counts.iter().position(|n| *n > 0)?;
        let max = counts.iter().rposition(|n| *n > 0)?;
        let mut below = 0;
        let median = counts.iter().position(|here| {
            below += here;
            2 * u64::from(below) >= u64::from(n)
        })?;
        // A converter of fewer bits fills the lower part of the 16 bits.
        let bin_dn = (u32::from(scale.full_dn) + 1).div_ceil(BINS as u32);
        let mut histogram = vec![0; BINS];
        for (dn, here) in counts.iter().enumerate().take(max + 1).skip(min) {
            histogram[(dn / bin_dn as usize).min(BINS - 1)] += here;
        }
        let mean_dn = sum as f64 / f64::from(n);
        Some(Figures {
            min_dn: min as u16,
            median_dn: median as u16,
            mean_dn,
            max_dn: max as u16,
            histogram,
            bin_dn,
            saturated_px: counts[usize::from(scale.full_dn)..].iter().sum(),
            defect_px,
            focus: focus(frame, area, masked, scale, mean_dn),
        })
    }
}

impl Area {
    fn columns(&self) -> std::ops::Range<usize> {
        self.left_px as usize..(self.left_px + self.width_px) as usize
    }

    fn rows(&self) -> std::ops::Range<usize> {
        self.top_px as usize..(self.top_px + self.height_px) as usize
    }
}

/// Returns the figure of focus: the gradient after Sobel (Tenengrad, Krotkov 1988) as a change per pixel, root mean square,
/// without the share of shot and read noise, over the mean level above black. It does not depend on the exposure of a linear
/// camera. Compare it only for one pose and one area.
///
/// An even field gives about 0. `None` where the mean is within [`LIGHT_SIGMAS`] read noises of black, since the fixed pattern
/// of the sensor would look like focus there, or no pixel has all its neighbours.
fn focus(
    frame: &Frame,
    area: Area,
    masked: &[bool],
    scale: &CountScale,
    mean_dn: f64,
) -> Option<f64> {
    let level = mean_dn - scale.black_dn;
    if level <= LIGHT_SIGMAS * scale.read_noise_dn.max(1.0) {
        return None;
    }
    let width = frame.width_px() as usize;
    let counts = frame.pixels_dn();
    let (mut sum, mut n) = (0.0, 0_u64);
    let inner = |range: std::ops::Range<usize>| range.start + 1..range.end.saturating_sub(1);
    for y in inner(area.rows()) {
        for x in inner(area.columns()) {
            let pixel = y * width + x;
            let rows = [pixel - width, pixel, pixel + width];
            if rows
                .iter()
                .any(|at| masked[at - 1] || masked[*at] || masked[at + 1])
            {
                continue;
            }
            let [above, here, below] =
                rows.map(|at| [at - 1, at, at + 1].map(|at| f64::from(counts[at])));
            let along = above[2] + 2.0 * here[2] + below[2] - above[0] - 2.0 * here[0] - below[0];
            let across =
                below[0] + 2.0 * below[1] + below[2] - above[0] - 2.0 * above[1] - above[2];
            // Sobel's weights sum to 8 per pixel of distance, their squares to 12.
            let noise = 2.0 * 12.0 * scale.variance_dn2(here[1]);
            sum += (along * along + across * across - noise) / 64.0;
            n += 1;
        }
    }
    (n > 0).then(|| (sum / n as f64).max(0.0).sqrt() / level)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub const SCALE: CountScale = CountScale {
        full_dn: 65_535,
        black_dn: 200.0,
        gain_dn_per_electron: 2.0,
        read_noise_dn: 4.0,
    };

    /// Counts about a level, with the noise of [`SCALE`].
    pub fn noisy(width: usize, height: usize, level: impl Fn(usize, usize) -> f64) -> Vec<u16> {
        let mut state = 1_u32;
        let mut uniform = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24)
        };
        (0..width * height)
            .map(|pixel| {
                let level = level(pixel % width, pixel / width);
                // The sum of twelve uniform numbers has the variance 1.
                let normal: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                let noise = SCALE.variance_dn2(level).sqrt() * normal;
                (level + noise).round().clamp(0.0, 65_535.0) as u16
            })
            .collect()
    }

    fn whole(width_px: u32, height_px: u32) -> Area {
        Area {
            left_px: 0,
            top_px: 0,
            width_px,
            height_px,
        }
    }

    fn figures(pixels: Vec<u16>) -> Figures {
        let frame = Frame::new(64, 64, pixels).unwrap();
        Figures::of(&frame, whole(64, 64), &[false; 64 * 64], &SCALE).unwrap()
    }

    #[test]
    fn counts_are_those_of_the_area_without_defects() {
        let mut pixels = vec![1000; 64 * 64];
        pixels[0] = 65_535;
        pixels[1] = 65_535;
        pixels[63 * 64] = 7;
        let frame = Frame::new(64, 64, pixels).unwrap();
        let mut masked = vec![false; 64 * 64];
        masked[0] = true;
        let all = Figures::of(&frame, whole(64, 64), &masked, &SCALE).unwrap();
        assert_eq!((all.min_dn, all.median_dn, all.max_dn), (7, 1000, 65_535));
        assert_eq!((all.saturated_px, all.defect_px), (1, 1));
        assert_eq!(all.histogram.iter().sum::<u32>(), 64 * 64 - 1);
        assert_eq!((all.histogram[0], all.histogram[63]), (64 * 64 - 2, 1));
        let middle = Area {
            left_px: 10,
            top_px: 10,
            width_px: 5,
            height_px: 4,
        };
        let part = Figures::of(&frame, middle, &masked, &SCALE).unwrap();
        assert_eq!(
            (part.min_dn, part.max_dn, part.mean_dn),
            (1000, 1000, 1000.0)
        );
        assert_eq!((part.saturated_px, part.histogram[0]), (0, 20));
        assert_eq!(Figures::of(&frame, middle, &[true; 64 * 64], &SCALE), None);
    }

    #[test]
    fn the_histogram_of_few_bits_uses_all_bins() {
        let scale = CountScale {
            full_dn: 4095,
            ..SCALE
        };
        let frame = Frame::new(64, 64, (0..4096).collect()).unwrap();
        let figures = Figures::of(&frame, whole(64, 64), &[false; 4096], &scale).unwrap();
        assert_eq!(figures.bin_dn, 64);
        assert!(figures.histogram.iter().all(|n| *n == 64));
    }

    #[test]
    fn a_blurred_pattern_has_less_focus_and_noise_and_exposure_have_none() {
        let stripes = |period: f64, depth: f64, level: f64| {
            figures(noisy(64, 64, |x, _| {
                200.0 + level * (1.0 + depth * (x as f64 * std::f64::consts::TAU / period).sin())
            }))
        };
        let sharp = stripes(8.0, 0.3, 20_000.0).focus.unwrap();
        let blurred = stripes(8.0, 0.1, 20_000.0).focus.unwrap();
        assert!((sharp / blurred - 3.0).abs() < 0.2, "{sharp} {blurred}");
        let shorter = stripes(8.0, 0.3, 5000.0).focus.unwrap();
        assert!((shorter / sharp - 1.0).abs() < 0.05, "{shorter} {sharp}");
        let even = figures(noisy(64, 64, |_, _| 20_200.0)).focus.unwrap();
        assert!(even < 0.05 * sharp, "{even} {sharp}");
        for dark in [200.0, 230.0] {
            assert_eq!(figures(noisy(64, 64, |_, _| dark)).focus, None);
        }
    }
}
