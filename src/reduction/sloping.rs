//! Brightness that slopes over a field which should be even, and differently from pose to pose.
//!
//! With a telecentric camera and a far lamp every pixel of an even sample has the same directions. Near ones do not:
//! on the flank of a lobe one side of the field is brighter then, and the mean over the field makes lobes look wider than
//! they are (8 % at 3° to either side and α = 0.12). A pattern of the camera is the same at every pose and comes off
//! with the flats; what changes with the pose tells.

use super::journal::Journal;
use crate::wording::percent;

/// Slope from the middle of the field to its edge, as a share of the level, from which on it is told.
const TOLD: f64 = 0.05;
/// Frames whose slope is known worse than this say nothing.
const KNOWN: f64 = 0.02;
/// Frames at least, for a slope that changes.
const FRAMES: usize = 6;

/// Slope of a level over the field, as a share of it: from the middle to the right and to the lower edge.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Slope {
    pub(super) across: f64,
    pub(super) down: f64,
    /// Standard uncertainty of either, by the pixels' noise; 0 where there is no slope to tell.
    pub(super) std: f64,
}

/// Says so where slopes change from pose to pose.
pub(super) fn warn(slopes: impl Iterator<Item = Slope>, journal: &mut Journal) {
    let slopes: Vec<Slope> = slopes
        .filter(|slope| slope.std > 0.0 && slope.std < KNOWN)
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
    if slope > TOLD {
        journal.warn(format!(
            "the brightness slopes over the field, by {} from its middle to its edge and differently from pose to pose, as it \
             does where camera or lamp are near: then α comes out too large; state projection = \"perspective\" and the \
             distances in the manifest, or take a smaller part of the field (an uneven sample does the same: look at the \
             map)",
            percent(slope)
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(slopes: &[(f64, f64)], std: f64) -> Option<String> {
        let slopes = slopes.iter().map(|(across, down)| Slope {
            across: *across,
            down: *down,
            std,
        });
        let mut journal = Journal::default();
        warn(slopes, &mut journal);
        journal.close(&[]).1.first().cloned()
    }

    #[test]
    fn slopes_that_change_with_the_pose_are_told_and_those_of_the_camera_are_not() {
        let near: Vec<(f64, f64)> = (0..12)
            .map(|n| (0.2 * f64::from(n - 6) / 6.0, 0.1))
            .collect();
        let words = told(&near, 1e-3).expect("a near camera is told");
        assert!(
            words.contains("12 %") && words.contains("perspective"),
            "{words}"
        );
        assert!(!words.contains("  "), "{words}");
        // The same at each pose: vignetting that no flat took off.
        assert_eq!(told(&[(0.3, -0.2); 12], 1e-3), None);
        // Noise, however large: known too badly, or no more than is known.
        assert_eq!(told(&near, 0.1), None);
        let noise: Vec<(f64, f64)> = (0..12)
            .map(|n| (0.015 * f64::from(n % 3 - 1), 0.0))
            .collect();
        assert_eq!(told(&noise, 0.015), None);
        assert_eq!(told(&near[..4], 1e-3), None);
    }
}
