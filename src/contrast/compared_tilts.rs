//! The observations that are compared: tilts at which all three azimuths of the paper were observed.
//!
//! Other tilts enter neither tables nor means. A mean over whichever pairs exist would be a different quantity in
//! each scan.

use crate::geometry::{Pose, group_angles};
use crate::model::contrast::PAPER_AZIMUTHS_DEG;
use crate::units::Angle;

/// Largest difference between a recorded azimuth and the azimuth of the paper that it represents.
const SNAP: Angle = Angle::from_deg(0.5);
/// Recorded angles this close are equal, within the accuracy of a stage.
pub(super) const SAME_ANGLE: Angle = Angle::from_deg(0.02);
/// Tilts this close are equal.
pub(super) const SAME_TILT: Angle = Angle::from_deg(0.1);

/// A tilt with all three azimuths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CompleteTilt {
    /// Mean of the three recorded tilts, to a hundredth of a degree.
    pub theta_c: Angle,
    /// Indices of the three poses, in the order of [`PAPER_AZIMUTHS_DEG`].
    pub three: [usize; 3],
}

/// The tilts of a list of poses, rising.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ComparedTilts {
    /// Those with all three azimuths.
    pub complete: Vec<CompleteTilt>,
    /// Descriptions of those that lack some of them.
    pub incomplete: Vec<String>,
}

impl ComparedTilts {
    /// Finds the tilts of these poses. Where several poses can represent one azimuth, the nearest does.
    #[must_use]
    pub fn of(poses: &[Pose]) -> Self {
        let tilts: Vec<Angle> = poses.iter().map(|p| p.theta_c).collect();
        let tilts = group_angles(&tilts, SAME_TILT);
        let groups = tilts.iter().max().map_or(0, |last| last + 1);
        let mut turns = ComparedTilts::default();
        for group in 0..groups {
            let here = || (0..poses.len()).filter(|n| tilts[*n] == group);
            let nearest = |azimuth_deg: f64| {
                let off = |n: &usize| off(poses[*n].phi_s, azimuth_deg).abs();
                here()
                    .filter(|n| off(n) <= SNAP)
                    .min_by(|a, b| off(a).rad().total_cmp(&off(b).rad()))
            };
            let found = PAPER_AZIMUTHS_DEG.map(nearest);
            if let [Some(a), Some(b), Some(c)] = found {
                let three = [a, b, c];
                let mean = three.map(|n| poses[n].theta_c.deg() / 3.0).iter().sum();
                turns.complete.push(CompleteTilt {
                    theta_c: hundredths(mean),
                    three,
                });
            } else if found.iter().any(Option::is_some)
                && let Some(first) = here().next()
            {
                let missing: Vec<String> = found
                    .iter()
                    .zip(PAPER_AZIMUTHS_DEG)
                    .filter(|(n, _)| n.is_none())
                    .map(|(_, deg)| format!("{deg}°"))
                    .collect();
                turns.incomplete.push(format!(
                    "θc {} (no observation at φs {})",
                    poses[first].theta_c,
                    missing.join(", ")
                ));
            }
        }
        turns
    }

    /// The tilts that are compared, degrees.
    #[must_use]
    pub fn theta_c_deg(&self) -> Vec<f64> {
        let tilts = self.complete.iter().map(|c| c.theta_c);
        tilts.map(super::rounded_deg).collect()
    }

    /// A warning about the tilts that no mean includes; `None` where every tilt is complete.
    #[must_use]
    pub fn left_out(&self) -> Option<String> {
        (!self.incomplete.is_empty()).then(|| {
            format!(
                "omitted from the contrasts and their means: {}",
                self.incomplete.join("; ")
            )
        })
    }

    /// Warnings about recorded azimuths that represent a different azimuth of the paper.
    #[must_use]
    pub fn substitutions(&self, poses: &[Pose]) -> Vec<String> {
        let three = |c: &CompleteTilt| c.three.into_iter().zip(PAPER_AZIMUTHS_DEG);
        let far: Vec<String> = self
            .complete
            .iter()
            .flat_map(three)
            .filter(|(n, deg)| off(poses[*n].phi_s, *deg).abs() > SAME_ANGLE)
            .map(|(n, deg)| {
                let Pose { theta_c, phi_s } = poses[n];
                format!("φs {phi_s} in place of {deg}° (θc {theta_c})")
            })
            .collect();
        match far.is_empty() {
            true => Vec::new(),
            false => vec![format!(
                "recorded azimuths differ from those of the paper; the uncertainties include the effect: {}",
                far.join(", ")
            )],
        }
    }
}

/// Descriptions of planned poses that a contrast needs and that have no observation. A tilt for which not all three
/// azimuths were planned needs none.
#[must_use]
pub fn missing_poses(planned: &[Pose], observed: &[Pose]) -> Vec<String> {
    let seen = |pose: Pose, azimuth_deg: f64| {
        observed.iter().any(|o| {
            (o.theta_c - pose.theta_c).abs() <= SAME_TILT && off(o.phi_s, azimuth_deg).abs() <= SNAP
        })
    };
    let turns = ComparedTilts::of(planned);
    let three = |c: &CompleteTilt| c.three.into_iter().zip(PAPER_AZIMUTHS_DEG);
    turns
        .complete
        .iter()
        .flat_map(three)
        .filter(|(n, deg)| !seen(planned[*n], *deg))
        .map(|(n, _)| format!("θc {}, φs {}", planned[n].theta_c, planned[n].phi_s))
        .collect()
}

/// Recorded minus nominal azimuth.
pub(super) fn off(phi_s: Angle, azimuth_deg: f64) -> Angle {
    (phi_s - Angle::from_deg(azimuth_deg)).wrapped()
}

fn hundredths(deg: f64) -> Angle {
    Angle::from_deg((deg * 100.0).round() / 100.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn poses(list: &[(f64, f64)]) -> Vec<Pose> {
        let of = |(tilt, azimuth): &(f64, f64)| Pose::from_deg(*tilt, *azimuth);
        list.iter().map(of).collect()
    }

    #[test]
    fn only_tilts_with_all_three_azimuths_are_compared() {
        let poses = poses(&[
            (5.02, 359.98),
            (4.99, 0.3),
            (5.0, 90.0),
            (5.01, 180.0),
            (-10.0, 0.0),
            (-10.0, 90.0),
            (20.0, 45.0),
        ]);
        let turns = ComparedTilts::of(&poses);
        assert_eq!(turns.theta_c_deg(), [5.01]);
        // The nearest to 0°, not the first.
        assert_eq!(turns.complete[0].three, [0, 2, 3]);
        let said = turns.left_out().unwrap();
        assert!(
            said.contains("θc -10.000° (no observation at φs 180°)"),
            "{said}"
        );
        assert!(!said.contains("20"), "{said}");
        assert!(turns.substitutions(&poses).is_empty());
    }

    #[test]
    fn a_substituted_azimuth_is_named() {
        let poses = poses(&[(0.0, -0.45), (0.0, 90.021), (0.0, 180.019)]);
        let said = ComparedTilts::of(&poses).substitutions(&poses);
        assert_eq!(said.len(), 1);
        assert!(
            said[0].contains("φs -0.450° in place of 0° (θc 0.000°)"),
            "{said:?}"
        );
        assert!(said[0].contains("φs 90.021° in place of 90°"), "{said:?}");
        assert!(!said[0].contains("180"), "{said:?}");
    }

    #[test]
    fn only_a_planned_pose_of_a_complete_tilt_can_be_missing() {
        let planned = poses(&[
            (0.0, 0.0),
            (0.0, 30.0),
            (0.0, 90.0),
            (0.0, 180.0),
            (10.0, 0.0),
            (10.0, 180.0),
        ]);
        let without = |gone: &[usize]| -> Vec<Pose> {
            let kept = (0..planned.len()).filter(|n| !gone.contains(n));
            kept.map(|n| planned[n]).collect()
        };
        assert!(missing_poses(&planned, &without(&[])).is_empty());
        assert!(missing_poses(&planned, &without(&[1, 4])).is_empty());
        assert_eq!(
            missing_poses(&planned, &without(&[2])),
            ["θc 0.000°, φs 90.000°"]
        );
        assert_eq!(missing_poses(&planned, &without(&[0, 1, 2, 3])).len(), 3);
    }
}
