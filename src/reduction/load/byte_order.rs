//! Detects files whose counts have their two bytes swapped.
//!
//! Neighbouring pixels of an image differ by their noise and a little light. With swapped bytes, differences in the last
//! digits become multiples of 256. Counts that are far more alike after a swap of their bytes were therefore swapped before.

use crate::frame::Frame;

/// Approximate number of pixels and of pairs of neighbours that are compared.
const LOOKED_AT: usize = 4096;
/// Smallest ratio of the differences before and after the swap, and smallest difference, counts.
const TIMES: f64 = 4.0;
const LEAST_DN: f64 = 16.0;
/// A byte that is equal in more than this share of the pixels is uninformative: 8 bits look alike in either byte.
const ALIKE: f64 = 0.95;

/// The order of the bytes of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ByteOrder {
    /// Correct.
    Right,
    /// Swapped. Neighbours differ by these means, counts, before and after the swap.
    Swapped { stands: f64, swapped: f64 },
    /// Undetermined: a dark frame of less than 256 counts, a full one, counts of 8 bits.
    Unknown,
}

impl ByteOrder {
    pub(super) fn of(frame: &Frame) -> ByteOrder {
        let pixels = frame.pixels_dn();
        let step = (pixels.len() / LOOKED_AT).max(1);
        let looked_at = pixels.len().div_ceil(step);
        for byte in [0, 1] {
            let mut counts = [0_usize; 256];
            for dn in pixels.iter().step_by(step) {
                counts[usize::from(dn.to_be_bytes()[byte])] += 1;
            }
            let most = counts.iter().copied().max().unwrap_or(0);
            if most as f64 > ALIKE * looked_at as f64 {
                return ByteOrder::Unknown;
            }
        }
        let (mut stands, mut swapped, mut pairs) = (0.0, 0.0, 0.0);
        let rows = pixels.chunks_exact(frame.width_px() as usize);
        for pair in rows.flat_map(|row| row.windows(2)).step_by(step) {
            let [a, b] = [pair[0], pair[1]];
            stands += f64::from(a.abs_diff(b));
            swapped += f64::from(a.swap_bytes().abs_diff(b.swap_bytes()));
            pairs += 1.0;
        }
        let (stands, swapped) = (stands / pairs, swapped / pairs);
        if stands > (TIMES * swapped).max(LEAST_DN) {
            ByteOrder::Swapped { stands, swapped }
        } else if swapped > (TIMES * stands).max(LEAST_DN) {
            ByteOrder::Right
        } else {
            ByteOrder::Unknown
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// A frame of 24 × 24 counts of a level with a slope and noise, and its copy with swapped bytes.
    fn frames(level: f64, slope: f64, noise: f64, step: u16) -> [Frame; 2] {
        let mut rng = Pcg64Mcg::seed_from_u64(7);
        let counts: Vec<u16> = (0..24 * 24)
            .map(|i| {
                let u: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                let dn = level + slope * f64::from(i % 24) + noise * u;
                (dn.clamp(0.0, 65_535.0) as u16) / step * step
            })
            .collect();
        let swapped = counts.iter().map(|dn| dn.swap_bytes()).collect();
        [counts, swapped].map(|counts| Frame::new(24, 24, counts).unwrap())
    }

    #[test]
    fn the_order_is_found_where_both_bytes_vary() {
        for (level, slope, noise, step) in [
            // Around three times 256.
            (750.0, 0.0, 40.0, 1),
            (3060.0, 2.0, 20.0, 1),
            (30_000.0, 100.0, 150.0, 1),
            // 12 bits to the left of 16.
            (30_000.0, 100.0, 300.0, 16),
        ] {
            let [right, swapped] = frames(level, slope, noise, step);
            assert_eq!(ByteOrder::of(&right), ByteOrder::Right, "{level}");
            let found = ByteOrder::of(&swapped);
            assert!(
                matches!(found, ByteOrder::Swapped { .. }),
                "{level}: {found:?}"
            );
        }
    }

    #[test]
    fn the_order_is_unknown_where_one_byte_is_constant() {
        for (level, noise, step) in [
            (100.0, 3.0, 1),
            (65_535.0, 0.0, 1),
            (40_000.0, 2_000.0, 256),
        ] {
            for frame in frames(level, 0.0, noise, step) {
                assert_eq!(ByteOrder::of(&frame), ByteOrder::Unknown, "{level}");
            }
        }
        // The mean of two frames of 8 bits.
        let [right, _] = frames(40_000.0, 0.0, 2_000.0, 128);
        assert_eq!(ByteOrder::of(&right), ByteOrder::Right);
        assert_eq!(
            ByteOrder::of(&Frame::new(1, 2, vec![1, 256]).unwrap()),
            ByteOrder::Unknown
        );
    }
}
