//! The rules that an accepted frame satisfies by itself: its size and its light.

use super::recorder::{BLACK, Rejected, TakenFrame};
use crate::bench::Captured;
use crate::frame::{Frame, FrameKind};

/// Rules that an accepted frame satisfies.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameRules {
    /// Width and height of the camera's images.
    pub size_px: (u32, u32),
    /// Counts without light.
    pub black_level_dn: f64,
    /// Read noise in counts.
    pub read_noise_dn: f64,
    /// Smallest mean above the black level, in standard deviations of the read noise, that counts as light.
    pub dark_sigmas: f64,
    /// Counts per electron.
    pub gain_dn_per_electron: f64,
    /// Largest share of a picture without light; 1 for any.
    pub unlit_share_max: f64,
    /// Count at which a pixel is full.
    pub saturation_dn: u16,
    /// Faults that the operator has confirmed to be as intended.
    pub confirmed: Confirmed,
    /// Largest mean of a capped frame above the black level.
    pub capped: CappedLimit,
}

/// Largest mean of a capped frame above the black level. Dark current grows with the exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CappedLimit {
    /// Counts at any exposure.
    pub mean_dn_max: f64,
    /// Counts of dark current per second.
    pub dark_dn_per_s: f64,
}

impl CappedLimit {
    /// Counts above the black level at an exposure.
    pub(super) fn at(&self, exposure_s: f64) -> f64 {
        self.mean_dn_max + self.dark_dn_per_s * exposure_s
    }
}

/// Observations that may be a fault or intended. The scan pauses once; by resuming, the operator confirms that they are
/// intended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Confirmed {
    /// A sample without light: a metal may show none, and neither does a sample under a lens cap.
    pub black_sample: bool,
    /// A sample that saturates the camera at every pose.
    pub full_sample: bool,
    /// A sample of which a large part shows no light.
    pub unlit_sample: bool,
}

impl Confirmed {
    /// Notes that the operator has confirmed this.
    pub(super) fn note(&mut self, rejected: &Rejected) {
        match rejected {
            Rejected::BlackSample => self.black_sample = true,
            Rejected::FullSample { .. } => self.full_sample = true,
            Rejected::UnlitSample { .. } => self.unlit_sample = true,
            // Confirming does not repair these.
            Rejected::SameFrame | Rejected::Disturbed(_) | Rejected::Otherwise(_) => {}
        }
    }
}

/// Returns what is wrong with the frames of a point; `None` if they are accepted.
pub(super) fn fault(
    frames: &[TakenFrame],
    kind: FrameKind,
    rules: &FrameRules,
) -> Option<Rejected> {
    for taken in frames {
        let frame = &taken.captured.frame;
        let size = (frame.width_px(), frame.height_px());
        if size != rules.size_px {
            return Some(Rejected::Otherwise(format!(
                "wrong size: the frame has {} × {} pixels, the camera is set to {} × {}",
                size.0, size.1, rules.size_px.0, rules.size_px.1
            )));
        }
    }
    match kind {
        FrameKind::Sample if rules.confirmed.black_sample => None,
        FrameKind::Dark => frames
            .iter()
            .map(|taken| {
                let above = mean_dn(&taken.captured.frame) - rules.black_level_dn;
                (above, taken.exposure_s)
            })
            .find(|(above, exposure_s)| *above > rules.capped.at(*exposure_s))
            .map(|(above, exposure_s)| {
                Rejected::Otherwise(format!(
                    "not dark: {above:.0} DN above the black level in {exposure_s} s, and at most {:.0} DN are allowed \
                     (scan.capped_mean_dn_max, {} DN, and what camera.dark_current_electrons_per_s makes in that time, \
                     {:.0} DN); check the lens cap; if it is on, this is dark current: state \
                     camera.dark_current_electrons_per_s, or plan shorter exposures",
                    rules.capped.at(exposure_s),
                    rules.capped.mean_dn_max,
                    rules.capped.dark_dn_per_s * exposure_s,
                ))
            }),
        FrameKind::Flat | FrameKind::Sample => {
            let longest = frames
                .iter()
                .max_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s))?;
            shows_no_light(&longest.captured.frame, rules).then(|| match kind {
                FrameKind::Sample => Rejected::BlackSample,
                FrameKind::Dark | FrameKind::Flat => Rejected::Otherwise(BLACK.into()),
            })
        }
    }
}

/// Returns what is wrong with a frame that is taken to check the camera; `None` if a scan would accept it.
#[must_use]
pub fn frame_fault(
    captured: Captured,
    exposure_s: f64,
    kind: FrameKind,
    rules: &FrameRules,
) -> Option<String> {
    let taken = TakenFrame {
        captured,
        exposure_s,
        exposure_index: 0,
        repeat: 0,
    };
    fault(&[taken], kind, rules).map(|why| why.to_string())
}

fn shows_no_light(frame: &Frame, rules: &FrameRules) -> bool {
    let above = mean_dn(frame) - rules.black_level_dn;
    let sigma = rules.read_noise_dn.max(0.3) / (frame.pixels_dn().len() as f64).sqrt();
    above < rules.dark_sigmas * sigma
}

fn mean_dn(frame: &Frame) -> f64 {
    let sum: u64 = frame.pixels_dn().iter().map(|dn| u64::from(*dn)).sum();
    sum as f64 / frame.pixels_dn().len() as f64
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::bench::Captured;
    use std::time::Duration;

    pub fn rules() -> FrameRules {
        FrameRules {
            size_px: (16, 16),
            black_level_dn: 200.0,
            read_noise_dn: 4.0,
            gain_dn_per_electron: 1.0,
            unlit_share_max: 0.4,
            dark_sigmas: 10.0,
            saturation_dn: 4000,
            confirmed: Confirmed::default(),
            capped: CappedLimit {
                mean_dn_max: 50.0,
                dark_dn_per_s: 0.0,
            },
        }
    }

    /// An even frame with noise seeded by its count.
    pub fn taken(dn: u16, exposure_s: f64) -> TakenFrame {
        let mut state = u32::from(dn);
        let noise = std::iter::repeat_with(|| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 30) as u16
        });
        let pixels: Vec<u16> = noise.take(256).map(|noise| dn - 1 + noise).collect();
        let at_the_ends = [vec![200; 256], vec![4095; 256]];
        let pixels = match dn {
            200 => &at_the_ends[0],
            4095 => &at_the_ends[1],
            _ => &pixels,
        };
        shown(pixels, exposure_s)
    }

    pub fn shown(dn: &[u16], exposure_s: f64) -> TakenFrame {
        TakenFrame {
            captured: Captured {
                frame: Frame::new(16, 16, dn.to_vec()).unwrap(),
                started_at: Duration::ZERO,
                started_utc: time::macros::datetime!(2026-01-01 00:00 UTC),
                tag: Default::default(),
            },
            exposure_s,
            exposure_index: 0,
            repeat: 0,
        }
    }

    #[test]
    fn light_under_the_cap_and_a_black_sample_are_named() {
        let fault = |dn, kind| fault(&[taken(dn, 0.1)], kind, &rules());
        assert_eq!(fault(201, FrameKind::Dark), None);
        let words = |dn, kind| fault(dn, kind).unwrap().to_string();
        assert!(words(900, FrameKind::Dark).starts_with("not dark"));
        assert_eq!(fault(900, FrameKind::Sample), None);
        assert_eq!(fault(200, FrameKind::Sample), Some(Rejected::BlackSample));
        assert!(words(200, FrameKind::Sample).starts_with("black"));
        // A confirmed black sample does not make a black white reference acceptable.
        assert!(words(200, FrameKind::Flat).starts_with("black"));
        assert_ne!(fault(200, FrameKind::Flat), Some(Rejected::BlackSample));
    }

    #[test]
    fn dark_current_grows_with_the_exposure_and_more_is_light() {
        let mut rules = rules();
        rules.capped.dark_dn_per_s = 100.0;
        let fault = |dn, exposure_s| fault(&[taken(dn, exposure_s)], FrameKind::Dark, &rules);
        assert_eq!(fault(200 + 440, 4.0), None);
        assert_eq!(fault(200 + 40, 0.01), None);
        // The same count in less time is light.
        let words = fault(200 + 440, 0.5).unwrap().to_string();
        for part in [
            "in 0.5 s",
            "at most 100 DN",
            "dark_current_electrons_per_s",
            "50 DN)",
        ] {
            assert!(words.contains(part), "{part}: {words}");
        }
    }

    #[test]
    fn a_short_exposure_may_be_black_if_the_long_one_is_not() {
        let frames = [taken(200, 0.001), taken(900, 0.1)];
        assert_eq!(fault(&frames, FrameKind::Sample, &rules()), None);
    }

    #[test]
    fn a_frame_of_another_size_is_named() {
        let mut small = rules();
        small.size_px = (8, 8);
        let reason = fault(&[taken(900, 0.1)], FrameKind::Sample, &small).unwrap();
        assert!(reason.to_string().starts_with("wrong size"), "{reason}");
    }
}
