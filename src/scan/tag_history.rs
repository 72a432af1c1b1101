//! What the camera's program states about the frames of a scan, checked: stale and lost frames, settings that drifted, another
//! camera.

use std::time::Duration;

use time::OffsetDateTime;

use super::recorder::Rejected;
use crate::frame::FrameTag;

/// Deviation of an exposure time read back from the one requested: share, and least seconds.
const EXPOSURE_SHARE: f64 = 0.01;
const EXPOSURE_LEAST_S: f64 = 2e-5;
/// Relative deviation of a gain from that of the scan's first frame.
const GAIN_SHARE: f64 = 1e-3;

/// What the settings say about the camera's statements.
#[derive(Debug, Clone, PartialEq)]
pub struct TagRules {
    /// Serial number of the rig's camera, if the settings name it.
    pub serial: Option<String>,
    /// Largest deviation of the camera's clock.
    pub clock_tolerance: Duration,
    /// Set point of the sensor's temperature, °C, if the settings state one.
    pub temperature_c: Option<f64>,
    /// Largest deviation from it, K.
    pub temperature_tolerance_k: f64,
}

/// What the frames of a scan stated so far.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct TagHistory {
    serial: Option<String>,
    gain: Option<f64>,
    /// Counter of the last frame; unknown after a failed capture.
    counter: Option<u64>,
}

/// When a frame may have been exposed.
#[derive(Debug, Clone, Copy)]
pub(super) struct ExposureWindow {
    /// The stage was at rest from here on.
    pub from: OffsetDateTime,
    /// The frame had arrived.
    pub until: OffsetDateTime,
    /// Seconds of these times in a second of exposure (see [`crate::clock::Clock::machine_s_per_s`]).
    pub machine_s_per_s: f64,
}

/// What a tag says about its frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum TagVerdict {
    /// Nothing is wrong with it.
    Fresh,
    /// It is an older frame: another one has to be taken.
    Stale(String),
    /// The point has to be taken again.
    Wrong(String),
    /// Another camera took it.
    OtherCamera {
        /// The scan's camera.
        expected: String,
        /// Its camera.
        found: String,
    },
}

impl TagHistory {
    /// Makes the history of a scan whose earlier frames stated this.
    pub fn after(rules: &TagRules, earlier: &FrameTag) -> TagHistory {
        TagHistory {
            serial: rules.serial.clone().or_else(|| earlier.serial.clone()),
            gain: earlier.gain,
            counter: None,
        }
    }

    /// Forgets the counter: frames were lost and that is known.
    pub fn interrupted(&mut self) {
        self.counter = None;
    }

    /// Checks a frame of the requested exposure against the earlier ones, and remembers it.
    pub fn check(
        &mut self,
        tag: &FrameTag,
        exposure_s: f64,
        window: ExposureWindow,
        rules: &TagRules,
    ) -> TagVerdict {
        if let Some(found) = &tag.serial {
            let expected = self.serial.get_or_insert_with(|| found.clone());
            if expected != found {
                let (expected, found) = (expected.clone(), found.clone());
                return TagVerdict::OtherCamera { expected, found };
            }
        }
        let before = match tag.counter {
            Some(counter) => self.counter.replace(counter),
            None => None,
        };
        if let Some(stale) = stale(tag, before, window, rules) {
            return TagVerdict::Stale(stale);
        }
        match self.wrong(tag, exposure_s, before, window, rules) {
            Some(wrong) => TagVerdict::Wrong(wrong),
            None => {
                self.gain = self.gain.or(tag.gain);
                TagVerdict::Fresh
            }
        }
    }

    fn wrong(
        &self,
        tag: &FrameTag,
        exposure_s: f64,
        before: Option<u64>,
        window: ExposureWindow,
        rules: &TagRules,
    ) -> Option<String> {
        if let Some(found_s) = tag.exposure_s
            && (found_s - exposure_s).abs() > EXPOSURE_LEAST_S.max(EXPOSURE_SHARE * exposure_s)
        {
            return Some(format!(
                "the camera exposed for {found_s} s, {exposure_s} s were requested; check that its program sets the exposure"
            ));
        }
        if let (Some(found), Some(expected)) = (tag.gain, self.gain)
            && (found - expected).abs() > GAIN_SHARE * expected.abs()
        {
            return Some(format!(
                "the camera's gain is {found}, the scan's earlier frames have {expected}; set it back"
            ));
        }
        if let Some(start) = tag.exposure_start {
            let length_s = tag.exposure_s.unwrap_or(exposure_s) * window.machine_s_per_s;
            let length = time::Duration::seconds_f64(length_s);
            let ahead = start + length - window.until;
            if ahead > rules.clock_tolerance {
                let ahead_s = ahead.as_seconds_f64();
                return Some(format!(
                    "the exposure ends {ahead_s:.2} s after the frame arrived: the camera's clock is ahead; synchronise the \
                     clocks, or set camera.clock_tolerance_s"
                ));
            }
        }
        if let (Some(counter), Some(before)) = (tag.counter, before)
            && counter > before.saturating_add(1)
        {
            return Some(format!(
                "the camera's counter went from {before} to {counter}: frames were lost"
            ));
        }
        None
    }
}

/// Returns why a frame is an older one.
fn stale(
    tag: &FrameTag,
    before: Option<u64>,
    window: ExposureWindow,
    rules: &TagRules,
) -> Option<String> {
    if let Some(start) = tag.exposure_start {
        let early = window.from - start;
        if early > rules.clock_tolerance {
            let early_s = early.as_seconds_f64();
            return Some(format!(
                "the exposure started {early_s:.2} s before the stage was at rest: the camera returned an older frame; if \
                 its clock is behind, synchronise the clocks or set camera.clock_tolerance_s"
            ));
        }
    }
    match (tag.counter, before) {
        (Some(counter), Some(before)) if counter == before => Some(format!(
            "the camera's counter is still {counter}: the camera returned the same frame again"
        )),
        // A camera that restarted counts from the beginning; its start of exposure says that the frame is new.
        (Some(counter), Some(before)) if counter < before && tag.exposure_start.is_none() => {
            Some(format!(
                "the camera's counter went back from {before} to {counter}: the camera returned an older frame"
            ))
        }
        _ => None,
    }
}

/// Returns a temperature that is off its set point by more than `share` of the tolerance.
pub(super) fn off_temperature(tag: &FrameTag, rules: &TagRules, share: f64) -> Option<f64> {
    let (found, wanted) = (tag.temperature_c?, rules.temperature_c?);
    let off = (found - wanted).abs() > share * rules.temperature_tolerance_k;
    off.then_some(found)
}

/// A frame that is still stale after several were discarded.
pub(super) fn still_stale(why: &str, discarded: u32) -> Rejected {
    Rejected::Otherwise(format!(
        "{why} ({discarded} frames were discarded in a row)"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use time::macros::datetime;

    fn rules() -> TagRules {
        TagRules {
            serial: None,
            clock_tolerance: Duration::from_millis(50),
            temperature_c: Some(-5.0),
            temperature_tolerance_k: 1.0,
        }
    }

    fn window() -> ExposureWindow {
        ExposureWindow {
            from: datetime!(2026-01-01 00:00:10 UTC),
            until: datetime!(2026-01-01 00:00:11 UTC),
            machine_s_per_s: 1.0,
        }
    }

    fn tag(counter: u64, start: OffsetDateTime) -> FrameTag {
        FrameTag {
            counter: Some(counter),
            exposure_start: Some(start),
            exposure_s: Some(0.02),
            gain: Some(1.0),
            serial: Some("A".into()),
            temperature_c: Some(-5.2),
        }
    }

    #[test]
    fn frames_from_before_the_pose_and_repeated_ones_are_stale_and_gaps_are_wrong() {
        let mut seen = TagHistory::default();
        let mut check = |tag: &FrameTag| seen.check(tag, 0.02, window(), &rules());
        let fresh = datetime!(2026-01-01 00:00:10.5 UTC);
        assert_eq!(check(&tag(7, fresh)), TagVerdict::Fresh);
        let early = tag(8, datetime!(2026-01-01 00:00:09.9 UTC));
        assert!(matches!(check(&early), TagVerdict::Stale(_)));
        assert_eq!(check(&tag(9, fresh)), TagVerdict::Fresh);
        assert!(matches!(check(&tag(9, fresh)), TagVerdict::Stale(_)));
        let TagVerdict::Wrong(why) = check(&tag(12, fresh)) else {
            panic!("a gap is accepted");
        };
        assert!(why.contains("from 9 to 12"), "{why}");
        assert_eq!(check(&tag(13, fresh)), TagVerdict::Fresh);
        // A restarted camera; without the start of its exposure the frame may be an old one.
        assert_eq!(check(&tag(1, fresh)), TagVerdict::Fresh);
        let untimed = FrameTag {
            exposure_start: None,
            ..tag(0, fresh)
        };
        assert!(matches!(check(&untimed), TagVerdict::Stale(_)));
        // A clock that is 40 ms off is within its tolerance, one that is ahead is not.
        let near = datetime!(2026-01-01 00:00:09.96 UTC);
        assert_eq!(check(&tag(1, near)), TagVerdict::Fresh);
        let ahead = tag(2, datetime!(2026-01-01 00:00:12 UTC));
        assert!(matches!(check(&ahead), TagVerdict::Wrong(_)));
    }

    #[test]
    fn an_exposure_of_a_fast_rig_takes_less_time_of_the_machine() {
        let long = FrameTag {
            exposure_s: Some(4.0),
            ..tag(1, datetime!(2026-01-01 00:00:10.5 UTC))
        };
        let check = |machine_s_per_s: f64| {
            let window = ExposureWindow {
                machine_s_per_s,
                ..window()
            };
            TagHistory::default().check(&long, 4.0, window, &rules())
        };
        assert_eq!(check(0.05), TagVerdict::Fresh);
        assert!(matches!(check(1.0), TagVerdict::Wrong(_)));
    }

    #[test]
    fn settings_that_drifted_and_another_camera_are_named() {
        let start = datetime!(2026-01-01 00:00:10.5 UTC);
        let mut seen = TagHistory::after(&rules(), &tag(3, start));
        let mut check = |tag: &FrameTag| seen.check(tag, 0.02, window(), &rules());
        let changed = |change: fn(&mut FrameTag)| {
            let mut other = tag(1, start);
            other.counter = None;
            change(&mut other);
            other
        };
        assert_eq!(check(&changed(|_| {})), TagVerdict::Fresh);
        for wrong in [
            changed(|tag| tag.exposure_s = Some(0.04)),
            changed(|tag| tag.gain = Some(2.0)),
        ] {
            assert!(matches!(check(&wrong), TagVerdict::Wrong(_)), "{wrong:?}");
        }
        let other = changed(|tag| tag.serial = Some("B".into()));
        let TagVerdict::OtherCamera { expected, found } = check(&other) else {
            panic!("another camera is accepted");
        };
        assert_eq!((expected.as_str(), found.as_str()), ("A", "B"));
    }

    #[test]
    fn a_temperature_has_a_smaller_tolerance_on_its_way_back() {
        let mut warm = tag(1, datetime!(2026-01-01 00:00:10 UTC));
        warm.temperature_c = Some(-4.3);
        assert_eq!(off_temperature(&warm, &rules(), 1.0), None);
        assert_eq!(off_temperature(&warm, &rules(), 0.5), Some(-4.3));
        warm.temperature_c = Some(-3.9);
        assert_eq!(off_temperature(&warm, &rules(), 1.0), Some(-3.9));
    }
}
