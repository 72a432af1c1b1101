//! From the brightest pixel of a few frames to exposures for a scan.
//!
//! A linear camera is assumed: counts above black grow with the exposure. A full pixel only gives a bound, and one within the
//! noise gives nothing, so the search names a further exposure to take until one frame is bright and not full.

use super::CountScale;

/// Brightest count of the suggested exposure, as a share of a full pixel.
pub const BRIGHTEST_SHARE: f64 = 0.7;
/// Second exposure over the first.
pub const SECOND_OVER_FIRST: f64 = 3.0;
/// Shortest exposure that is tried or suggested, s.
pub const EXPOSURE_S_MIN: f64 = 1e-5;
/// Longest exposure that is tried or suggested, s.
pub const EXPOSURE_S_MAX: f64 = 10.0;
/// Frames that the search asks for at most.
pub const PROBES_MAX: usize = 6;
/// A frame is bright enough to scale from at this share of a full pixel.
const BRIGHT_SHARE: f64 = 0.2;
/// Least share of a full pixel that a suggested exposure reaches; dark current alone comes to less.
const SHARE_MIN: f64 = 0.03;
/// Factor to a shorter or longer exposure where a frame gives no value.
const STEP: f64 = 8.0;
/// Exposures of a smaller ratio count as the same.
const CLOSE: f64 = 1.2;
/// The brightest pixel of a dark frame is this many standard deviations above the others.
const DARK_SIGMAS: f64 = 8.0;

/// The brightest pixel of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tried {
    /// Exposure.
    pub exposure_s: f64,
    /// Greatest count of a pixel that is no defect.
    pub max_dn: u16,
}

/// Exposures for a scan.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
#[schema(as = SuggestionBody)]
pub struct Suggestion {
    /// Exposures, s, shortest first; empty if there is no suggestion. At the first one the brightest pixel of this pose reaches
    /// about 70 % of full scale; the second one is three times as long.
    pub exposures_s: Vec<f64>,
    /// Why there is none, or why the brightest pixel does not reach 70 %; null otherwise.
    pub reason: Option<String>,
}

/// What to do next.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// Take a frame of this exposure, s.
    Take(f64),
    /// The search is over.
    Done(Suggestion),
}

/// A search for exposures.
#[derive(Debug, Clone)]
pub struct ExposureSearch {
    scale: CountScale,
    /// Exposures to suggest.
    wanted: usize,
    tried: Vec<Tried>,
    probes: usize,
}

impl ExposureSearch {
    /// Begins with the frames that were taken anyway, at least one. `wanted` is the number of exposures to suggest, 1 or 2.
    #[must_use]
    pub fn new(scale: CountScale, tried: Vec<Tried>, wanted: usize) -> Self {
        ExposureSearch {
            scale,
            wanted,
            tried,
            probes: 0,
        }
    }

    /// Adds the frame that [`ExposureSearch::next`] asked for.
    pub fn add(&mut self, tried: Tried) {
        self.probes += 1;
        self.tried.push(tried);
    }

    /// Returns the exposure to try next, or the suggestion.
    #[must_use]
    pub fn next(&self) -> Next {
        let full = f64::from(self.scale.full_dn);
        let not_full = self.tried.iter().filter(|t| t.max_dn < self.scale.full_dn);
        let Some(best) = not_full.max_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s)) else {
            let shortest = self.tried.iter().map(|t| t.exposure_s);
            let shortest = shortest.fold(f64::INFINITY, f64::min);
            return match shortest > EXPOSURE_S_MIN && self.probes < PROBES_MAX {
                true => Next::Take((shortest / STEP).max(EXPOSURE_S_MIN)),
                false => none(format!(
                    "pixels are still saturated at {}: reduce the light or close the iris",
                    in_ms(shortest)
                )),
            };
        };
        let signal = f64::from(best.max_dn) - self.scale.black_dn;
        let noise = self.scale.variance_dn2(self.scale.black_dn).sqrt();
        let at_the_end = best.exposure_s >= EXPOSURE_S_MAX || self.probes >= PROBES_MAX;
        if signal <= DARK_SIGMAS * noise {
            return match at_the_end {
                false => Next::Take((best.exposure_s * STEP).min(EXPOSURE_S_MAX)),
                true => none(format!(
                    "there is no light at {}: check the lamp, the lens cap and the sample",
                    in_ms(best.exposure_s)
                )),
            };
        }
        let target = BRIGHTEST_SHARE * full - self.scale.black_dn;
        let mut ideal = best.exposure_s * target / signal;
        // A camera that is not linear may be full earlier.
        let full_at = self.tried.iter().filter(|t| t.max_dn >= self.scale.full_dn);
        let full_at = full_at.map(|t| t.exposure_s).fold(f64::INFINITY, f64::min);
        let full_early = ideal >= full_at;
        if full_early {
            if !at_the_end && full_at > CLOSE * best.exposure_s {
                return Next::Take((best.exposure_s * full_at).sqrt());
            }
            ideal = best.exposure_s;
        }
        let first = ideal.clamp(EXPOSURE_S_MIN, EXPOSURE_S_MAX);
        let is_bright = f64::from(best.max_dn) >= BRIGHT_SHARE * full;
        if !is_bright && !at_the_end && first > CLOSE * best.exposure_s {
            return Next::Take(first);
        }
        let share = (self.scale.black_dn + signal * first / best.exposure_s) / full;
        let reached = format!(
            "the brightest pixel reaches only {:.1} % of full scale at {}",
            100.0 * share,
            in_ms(first)
        );
        if share < SHARE_MIN {
            return none(format!(
                "{reached}: check the lamp, the lens cap and the sample"
            ));
        }
        let reason = match full_early {
            true => Some(format!(
                "{reached}, and pixels are full at {}: check camera.saturation_dn and the linearity of the camera",
                in_ms(full_at)
            )),
            false => (ideal > EXPOSURE_S_MAX)
                .then(|| format!("{reached}: use more light or open the iris")),
        };
        let second = rounded_down(SECOND_OVER_FIRST * first).min(EXPOSURE_S_MAX);
        let mut exposures_s = vec![rounded_down(first)];
        if self.wanted > 1 && second > exposures_s[0] {
            exposures_s.push(second);
        }
        Next::Done(Suggestion {
            exposures_s,
            reason,
        })
    }
}

fn none(reason: String) -> Next {
    Next::Done(Suggestion {
        exposures_s: Vec::new(),
        reason: Some(reason),
    })
}

/// Rounds down to two significant digits: an exposure that people read, and never a longer one.
fn rounded_down(exposure_s: f64) -> f64 {
    let digits = 1 - exposure_s.log10().floor() as i32;
    let unit = 10_f64.powi(-digits);
    let rounded = (exposure_s / unit * (1.0 + 1e-12)).floor() * unit;
    // Removes the error of the product: 0.023 instead of 0.023000000000000003.
    format!("{rounded:.*}", digits.max(0) as usize)
        .parse()
        .unwrap_or(rounded)
}

fn in_ms(exposure_s: f64) -> String {
    format!("{} ms", (exposure_s * 1e6).round() / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preview::figures::tests::SCALE;

    /// The frames of a linear camera whose brightest pixel gains `dn_per_s`; returns the suggestion and the probes.
    fn searched(dn_per_s: f64, exposures_s: &[f64], wanted: usize) -> (Suggestion, usize) {
        let take = |exposure_s: f64| Tried {
            exposure_s,
            max_dn: (SCALE.black_dn + dn_per_s * exposure_s + 10.0).min(65_535.0) as u16,
        };
        let tried = exposures_s.iter().copied().map(take).collect();
        let mut search = ExposureSearch::new(SCALE, tried, wanted);
        loop {
            match search.next() {
                Next::Take(exposure_s) => {
                    assert!((EXPOSURE_S_MIN..=EXPOSURE_S_MAX).contains(&exposure_s));
                    search.add(take(exposure_s));
                }
                Next::Done(suggestion) => return (suggestion, search.probes),
            }
        }
    }

    #[test]
    fn the_brightest_pixel_comes_to_seventy_per_cent_from_any_exposure() {
        let ideal = (BRIGHTEST_SHARE * 65_535.0 - 200.0) / 1e6;
        for exposure_s in [2e-5, 1e-3, 0.03, 0.06, 0.5, 20.0] {
            let (found, probes) = searched(1e6, &[exposure_s], 1);
            assert_eq!(found.reason, None);
            let ratio = found.exposures_s[0] / ideal;
            assert!((0.9..=1.0).contains(&ratio), "{exposure_s} s: {found:?}");
            assert!(probes <= PROBES_MAX, "{exposure_s} s: {probes} probes");
        }
        // A frame that is bright already needs no further one.
        assert_eq!(searched(1e6, &[0.03], 1).1, 0);
        assert_eq!(searched(1e6, &[0.03, 0.5], 1).1, 0);
    }

    #[test]
    fn a_second_exposure_is_three_times_the_first() {
        let (found, _) = searched(1e6, &[0.02, 0.06], 2);
        let [first, second] = found.exposures_s[..] else {
            panic!("{found:?}")
        };
        assert_eq!((first, second), (0.045, 0.13));
    }

    #[test]
    fn no_light_too_little_and_too_much_have_a_reason() {
        let (dark, _) = searched(0.0, &[0.02], 2);
        assert!(dark.exposures_s.is_empty());
        assert!(dark.reason.unwrap().contains("no light at 10000 ms"));
        let (dim, _) = searched(1000.0, &[0.02], 2);
        assert_eq!(dim.exposures_s, [10.0]);
        assert!(dim.reason.unwrap().contains("only 15.6 % of full scale"));
        // Dark current under the cap.
        let (capped, _) = searched(60.0, &[0.02], 2);
        assert!(capped.exposures_s.is_empty());
        assert!(
            capped
                .reason
                .unwrap()
                .contains("check the lamp, the lens cap")
        );
        let (bright, _) = searched(1e12, &[0.02], 2);
        assert!(bright.exposures_s.is_empty());
        assert!(bright.reason.unwrap().contains("saturated at 0.01 ms"));
    }

    #[test]
    fn a_camera_that_is_full_early_gets_an_exposure_that_is_not_full() {
        // Full at 20 000 DN of light, for a rig whose stated full count is higher than the real one.
        let take = |exposure_s: f64| {
            let light = 1e6 * exposure_s;
            let max_dn = if light > 20_000.0 {
                65_535
            } else {
                200 + light as u16
            };
            Tried { exposure_s, max_dn }
        };
        let mut search = ExposureSearch::new(SCALE, vec![take(1e-3)], 1);
        let found = loop {
            match search.next() {
                Next::Take(exposure_s) => search.add(take(exposure_s)),
                Next::Done(found) => break found,
            }
        };
        let at = found.exposures_s[0];
        assert!((0.01..=0.02).contains(&at), "{found:?}");
        assert!(found.reason.unwrap().contains("camera.saturation_dn"));
    }

    #[test]
    fn exposures_are_rounded_down_to_what_people_read() {
        for (exact, rounded) in [
            (0.023_99, 0.023),
            (0.045, 0.045),
            (1.0, 1.0),
            (9.99, 9.9),
            (10.0, 10.0),
            (1.234e-5, 1.2e-5),
        ] {
            assert_eq!(rounded_down(exact), rounded);
        }
    }
}
