//! Recognises frames that the camera clips below the full count that the manifest allows.
//!
//! A 14-bit camera whose frames are 16-bit files is full at 16383. Without `bit_depth` nothing marks such pixels as full,
//! and their mean is too low. Noise spreads the brightest pixels over several counts, so that few have the largest one; a
//! limit collects everything beyond it there.

use std::cmp::Ordering;

use crate::frame::Frame;
use crate::reduction::reduction_log::Rejection;
use crate::reduction::sensor::Sensor;

/// Standard deviation of a count, in counts, from which noise spreads the brightest pixels over several counts.
const SPREAD_DN: f64 = 3.0;
/// Smallest share of the pixels, and number of them, that a limit has to collect.
const SHARE: usize = 50;
const FEWEST: usize = 16;
/// Factor by which the largest count is more frequent than the next one.
const PILE: usize = 4;

/// Refuses a frame in which the largest count collects pixels although the sensor is not full there. Frames with one count
/// only are left to the check for noise.
pub(super) fn clipped(frame: &Frame, sensor: &Sensor) -> Result<(), Rejection> {
    let pixels = frame.pixels_dn();
    let (largest, many) = most(pixels.iter().copied());
    let light = f64::from(largest) - sensor.black_dn;
    if many < FEWEST.max(pixels.len() / SHARE)
        || sensor.is_full(largest)
        || sensor.variance_dn2(light) < SPREAD_DN * SPREAD_DN
    {
        return Ok(());
    }
    let (_, next) = most(pixels.iter().copied().filter(|dn| *dn < largest));
    if next == 0 || many < PILE * next {
        return Ok(());
    }
    Err(Rejection::new(
        "saturated",
        format!(
            "{many} of {} pixels count {largest}, and none more, although the manifest allows {}: the camera is full there. \
             Set camera.bit_depth, or camera.saturation_dn = {largest}",
            pixels.len(),
            sensor.saturation_dn
        ),
    ))
}

/// The largest count and how many pixels have it.
fn most(counts: impl Iterator<Item = u16>) -> (u16, usize) {
    counts.fold((0, 0), |(largest, many), count| match count.cmp(&largest) {
        Ordering::Greater => (count, 1),
        Ordering::Equal => (largest, many + 1),
        Ordering::Less => (largest, many),
    })
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;

    fn sensor(saturation_dn: f64) -> Sensor {
        Sensor {
            width: 32,
            height: 32,
            gain_dn: 2.0,
            read_dn: 4.0,
            black_dn: 200.0,
            saturation_dn,
            bit_depth: None,
            count_max: u16::MAX,
        }
    }

    /// Pixels of this mean with the noise of the sensor, cut off at a count.
    fn frame(mean: f64, limit: f64, step: f64) -> Frame {
        let mut draw = rand_pcg::Pcg64::seed_from_u64(3);
        let noise = sensor(65535.0).variance_dn2(mean - 200.0).sqrt();
        let counts = (0..32 * 32).map(|_| {
            let count = mean + noise * draw.sample::<f64, _>(StandardNormal);
            ((count / step).round() * step).min(limit) as u16
        });
        Frame::new(32, 32, counts.collect()).unwrap()
    }

    #[test]
    fn a_limit_below_the_stated_one_is_found_at_any_level_that_reaches_it() {
        let all = sensor(65535.0);
        for mean in [16_050.0, 16_383.0, 16_600.0] {
            let refused = clipped(&frame(mean, 16_383.0, 1.0), &all).unwrap_err();
            assert!(
                refused.detail.contains("saturation_dn = 16383"),
                "{}",
                refused.detail
            );
        }
        // A stated limit is for the other checks.
        assert!(clipped(&frame(16_383.0, 16_383.0, 1.0), &sensor(16_383.0)).is_ok());
    }

    #[test]
    fn noise_a_coarse_converter_and_frames_of_one_count_are_no_limit() {
        let all = sensor(65535.0);
        assert!(clipped(&frame(16_000.0, 65_535.0, 1.0), &all).is_ok());
        // An 8-bit camera in 16-bit files has steps of 257 counts.
        assert!(clipped(&frame(30_000.0, 65_535.0, 257.0), &all).is_ok());
        let one = Frame::new(32, 32, vec![5000; 32 * 32]).unwrap();
        assert!(clipped(&one, &all).is_ok());
        // Two halves without noise, as a painted board has.
        let halves = (0..32 * 32).map(|n| if n % 2 == 0 { 9000 } else { 4000 });
        assert!(clipped(&Frame::new(32, 32, halves.collect()).unwrap(), &all).is_ok());
    }
}
