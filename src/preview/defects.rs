//! Defect pixels: those of a dark frame, or those that their frame gives away where there is no dark frame.

use super::CountScale;
use crate::frame::Frame;
use crate::robust;

/// A pixel of a dark frame further than this many robust standard deviations from the median is a defect.
const DEFECT_SIGMAS: f64 = 8.0;
/// A full pixel is a defect if at most one neighbour reaches this share of a full pixel.
const NEARLY_FULL_SHARE: f64 = 0.9;
/// Columns and rows to the neighbours.
const AROUND: [(isize, isize); 8] = [
    (-1, -1),
    (0, -1),
    (1, -1),
    (-1, 0),
    (1, 0),
    (-1, 1),
    (0, 1),
    (1, 1),
];

/// Returns the hot and dead pixels of a dark frame.
#[must_use]
pub fn of_dark(dark: &Frame, scale: &CountScale) -> Vec<bool> {
    let mut values: Vec<f64> = dark.pixels_dn().iter().map(|dn| f64::from(*dn)).collect();
    let Some((centre, spread)) = robust::spread(&mut values) else {
        return Vec::new();
    };
    let reach = DEFECT_SIGMAS * spread.max(scale.variance_dn2(centre).sqrt());
    let is_defect = |dn: &u16| (f64::from(*dn) - centre).abs() > reach;
    dark.pixels_dn().iter().map(is_defect).collect()
}

/// Returns the full pixels with at most one nearly full neighbour, and the pixels below black. A small highlight can look like the
/// former, so a dark frame decides better.
#[must_use]
pub fn isolated(frame: &Frame, scale: &CountScale) -> Vec<bool> {
    let (width, height) = (frame.width_px() as isize, frame.height_px() as isize);
    let counts = frame.pixels_dn();
    let limit = NEARLY_FULL_SHARE * f64::from(scale.full_dn);
    let dead = scale.black_dn - DEFECT_SIGMAS * scale.variance_dn2(scale.black_dn).sqrt();
    let mut masked = vec![false; counts.len()];
    for (pixel, dn) in counts.iter().enumerate() {
        masked[pixel] = f64::from(*dn) < dead;
        if *dn < scale.full_dn {
            continue;
        }
        let (x, y) = (pixel as isize % width, pixel as isize / width);
        let nearly_full = AROUND
            .iter()
            .map(|(dx, dy)| (x + dx, y + dy))
            .filter(|(x, y)| (0..width).contains(x) && (0..height).contains(y))
            .filter(|(x, y)| f64::from(counts[(y * width + x) as usize]) >= limit)
            .count();
        masked[pixel] = nearly_full <= 1;
    }
    masked
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preview::figures::tests::{SCALE, noisy};

    #[test]
    fn a_dark_frame_shows_hot_and_dead_pixels_only() {
        let mut pixels = noisy(64, 64, |_, _| 200.0);
        pixels[100] = 65_535;
        pixels[200] = 0;
        pixels[300] = 900;
        let masked = of_dark(&Frame::new(64, 64, pixels).unwrap(), &SCALE);
        let found: Vec<usize> = (0..64 * 64).filter(|pixel| masked[*pixel]).collect();
        assert_eq!(found, [100, 200, 300]);
    }

    #[test]
    fn a_lone_full_pixel_is_a_defect_and_a_full_highlight_is_not() {
        let lit = |x: usize, y: usize| match (30..34).contains(&x) && (30..34).contains(&y) {
            true => 65_535.0,
            false => 9000.0,
        };
        let mut pixels = noisy(64, 64, lit);
        pixels[0] = 65_535;
        pixels[10 * 64 + 63] = 65_535;
        pixels[20 * 64] = 0;
        let masked = isolated(&Frame::new(64, 64, pixels).unwrap(), &SCALE);
        assert!(masked[0] && masked[10 * 64 + 63] && masked[20 * 64]);
        assert_eq!(masked.iter().filter(|masked| **masked).count(), 3);
        assert!(!masked[31 * 64 + 31] && !masked[30 * 64 + 31]);
    }
}
