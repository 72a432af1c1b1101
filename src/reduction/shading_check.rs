//! Detects a field that is not even: brightness that slopes over it, differently from pose to pose, and parts that differ.
//!
//! With a telecentric camera and a far lamp all pixels of an even sample have the same directions. With a near camera or lamp
//! one side of the field is brighter on the flank of a lobe, and the mean over the field makes lobes look too wide (8 % at 3°
//! to either side and α = 0.12). A pattern of the camera is the same at every pose and is divided out with the flats; only a
//! slope that changes with the pose is reported.

use super::reduction_log::ReductionLog;
use crate::wording::percent;

/// Smallest slope that is reported: from the middle of the field to its edge, as a share of the level.
const REPORTED: f64 = 0.05;
/// Smallest difference between parts of the field that is reported, root mean square.
const UNEVEN: f64 = 0.1;
/// Largest standard uncertainty of the slope of a frame that counts.
const STD_MAX: f64 = 0.02;
/// Smallest number of such frames.
const FRAMES: usize = 6;

/// Slope of a level over the field, as a share of it: from the middle to the right and to the lower edge.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Slope {
    pub(super) across: f64,
    pub(super) down: f64,
    /// Standard uncertainty of either, from the pixels' noise; 0 where no slope was determined.
    pub(super) std: f64,
}

/// Warns where parts of the field differ at a quarter of the poses or more: by `shares` of the level, root mean square.
pub(super) fn warn_of_parts(shares: impl Iterator<Item = f64>, log: &mut ReductionLog) {
    let mut shares: Vec<f64> = shares.collect();
    if shares.len() < FRAMES {
        return;
    }
    shares.sort_by(f64::total_cmp);
    let usual = shares[shares.len() * 3 / 4];
    if usual > UNEVEN {
        log.warn(format!(
            "parts of the field differ in brightness by {} (root mean square) at a quarter of the poses or more: the sample \
             does not fill the field, or is uneven. The fit is that of the mean: crop the frames to an even part, or read the \
             map",
            percent(usual)
        ));
    }
}

/// Warns where slopes change from pose to pose.
pub(super) fn warn(slopes: impl Iterator<Item = Slope>, log: &mut ReductionLog) {
    let slopes: Vec<Slope> = slopes
        .filter(|slope| slope.std > 0.0 && slope.std < STD_MAX)
        .collect();
    if slopes.len() < FRAMES {
        return;
    }
    let n = slopes.len() as f64;
    let changes = |part: fn(&Slope) -> f64| {
        let mean = slopes.iter().map(part).sum::<f64>() / n;
        let seen: f64 = slopes.iter().map(|s| (part(s) - mean).powi(2)).sum();
        let noise: f64 = slopes.iter().map(|s| s.std * s.std).sum();
        ((seen - noise).max(0.0) / n).sqrt()
    };
    let slope = changes(|s| s.across).hypot(changes(|s| s.down));
    if slope > REPORTED {
        log.warn(format!(
            "the brightness slopes over the field, by {} from its middle to its edge and differently from pose to pose: camera \
             or lamp is near, or the sample is uneven (check the map). A near camera or lamp makes α too large: state \
             projection = \"perspective\" and the distances in the manifest, or use a smaller part of the field",
            percent(slope)
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn warning(slopes: &[(f64, f64)], std: f64) -> Option<String> {
        let slopes = slopes.iter().map(|(across, down)| Slope {
            across: *across,
            down: *down,
            std,
        });
        let mut log = ReductionLog::default();
        warn(slopes, &mut log);
        log.close(&[]).1.first().cloned()
    }

    #[test]
    fn slopes_that_change_with_the_pose_are_reported_and_those_of_the_camera_are_not() {
        let near: Vec<(f64, f64)> = (0..12)
            .map(|n| (0.2 * f64::from(n - 6) / 6.0, 0.1))
            .collect();
        let words = warning(&near, 1e-3).expect("a near camera is reported");
        assert!(
            words.contains("12 %") && words.contains("perspective"),
            "{words}"
        );
        assert!(!words.contains("  "), "{words}");
        // The same at each pose: vignetting without flats.
        assert_eq!(warning(&[(0.3, -0.2); 12], 1e-3), None);
        // Noise: too uncertain, or within the uncertainty.
        assert_eq!(warning(&near, 0.1), None);
        let noise: Vec<(f64, f64)> = (0..12)
            .map(|n| (0.015 * f64::from(n % 3 - 1), 0.0))
            .collect();
        assert_eq!(warning(&noise, 0.015), None);
        assert_eq!(warning(&near[..4], 1e-3), None);
    }

    #[test]
    fn parts_that_differ_at_a_quarter_of_the_poses_are_reported() {
        let warned = |shares: &[f64]| {
            let mut log = ReductionLog::default();
            warn_of_parts(shares.iter().copied(), &mut log);
            log.close(&[]).1.join("")
        };
        let text = warned(&[0.0, 0.01, 0.02, 0.0, 0.01, 0.3, 0.25, 0.4]);
        assert!(text.contains("does not fill the field"), "{text}");
        // A texture, and a single frame of another kind, are none.
        assert_eq!(warned(&[0.05; 8]), "");
        assert_eq!(warned(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.9]), "");
        assert_eq!(warned(&[0.5; 3]), "");
    }
}
