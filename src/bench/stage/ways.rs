//! Judges the ways of the axes against the forbidden regions, without hardware.

use super::error::StageError;
use super::regions::{self, Forbidden, ForbiddenRegion, MoveOrder, Span, Way};
use super::settings::StageSettings;
use crate::bench::AxisName;
use crate::geometry::Pose;
use crate::units::Angle;

/// How far an axis may go in one direction, and the region that ends its way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Room {
    pub end: Angle,
    pub region: Option<ForbiddenRegion>,
}

impl StageSettings {
    /// The angles that an axis passes: from one to the other, or by way of a point below the target.
    fn span(&self, axis: AxisName, from: Angle, to: Angle, engaged: bool) -> Span {
        let settings = self.axis(axis);
        let rests = engaged && (to - from).abs() <= settings.tolerance * 0.5;
        let below = match settings.needs_detour(from, to, engaged) && !rests {
            true => to - settings.backlash,
            false => to,
        };
        let margin = settings.tolerance.deg();
        let (from, to, below) = (from.deg(), to.deg(), below.deg());
        Span::between(from.min(below), from.max(to), margin)
    }

    fn at(&self, axis: AxisName, angle: Angle) -> Span {
        let (deg, margin) = (angle.deg(), self.axis(axis).tolerance.deg());
        Span::between(deg, deg, margin)
    }

    /// Returns the order in which the axes may move. `engaged`: whether the play of the gear of each
    /// axis is taken up.
    ///
    /// # Errors
    /// [`StageError::Forbidden`] if every order enters a forbidden region.
    pub(super) fn move_order(
        &self,
        from: Pose,
        to: Pose,
        engaged: [bool; 2],
    ) -> Result<MoveOrder, StageError> {
        if self.forbidden.is_empty() {
            return Ok(MoveOrder::Together);
        }
        let (tilt, turn) = (AxisName::ThetaC, AxisName::PhiS);
        let way = Way {
            theta_c: self.span(tilt, from.theta_c, to.theta_c, engaged[0]),
            phi_s: self.span(turn, from.phi_s, to.phi_s, engaged[1]),
            theta_c_ends: [self.at(tilt, from.theta_c), self.at(tilt, to.theta_c)],
            phi_s_ends: [self.at(turn, from.phi_s), self.at(turn, to.phi_s)],
        };
        regions::order_of(&self.forbidden, &way).map_err(|region| {
            let inside = self.region_at(to).cloned();
            let ends_inside = inside.is_some();
            StageError::Forbidden(Box::new(Forbidden {
                region: inside.unwrap_or(region),
                from: Some(from),
                to,
                ends_inside,
            }))
        })
    }

    /// Checks that a move from one pose to another has a way past the forbidden regions.
    ///
    /// # Errors
    /// [`StageError::Forbidden`].
    pub fn check_way(&self, from: Pose, to: Pose) -> Result<(), StageError> {
        self.move_order(from, to, [true, true]).map(|_| ())
    }

    /// Returns the forbidden region that a pose is in.
    #[must_use]
    pub fn region_at(&self, pose: Pose) -> Option<&ForbiddenRegion> {
        regions::region_at(
            &self.forbidden,
            self.at(AxisName::ThetaC, pose.theta_c),
            self.at(AxisName::PhiS, pose.phi_s),
        )
    }

    fn meets(&self, region: &ForbiddenRegion, axis: AxisName, span: Span) -> bool {
        match axis {
            AxisName::ThetaC => region.meets_theta_c(span),
            AxisName::PhiS => region.meets_phi_s(span),
        }
    }

    /// Returns a region that includes an angle of one axis, wherever the other axis is.
    pub(super) fn region_across(&self, axis: AxisName, angle: Angle) -> Option<&ForbiddenRegion> {
        let at = self.at(axis, angle);
        let mut regions = self.forbidden.iter();
        regions.find(|region| self.meets(region, axis, at))
    }

    /// Checks the way of an axis while the position of the other axis is unknown: it may leave the
    /// angles of a region, but enter none.
    ///
    /// # Errors
    /// [`StageError::Forbidden`].
    pub(super) fn check_lone_way(
        &self,
        axis: AxisName,
        from: Angle,
        to: Angle,
    ) -> Result<(), StageError> {
        let (start, way) = (self.at(axis, from), self.span(axis, from, to, false));
        let entered = self
            .forbidden
            .iter()
            .find(|region| !self.meets(region, axis, start) && self.meets(region, axis, way));
        let Some(region) = entered else {
            return Ok(());
        };
        let mut target = Pose {
            theta_c: Angle::ZERO,
            phi_s: Angle::ZERO,
        };
        match axis {
            AxisName::ThetaC => target.theta_c = to,
            AxisName::PhiS => target.phi_s = to,
        }
        Err(StageError::Forbidden(Box::new(Forbidden {
            region: region.clone(),
            from: None,
            to: target,
            ends_inside: false,
        })))
    }

    /// Returns how far an axis may be jogged from a pose: to its limit, or to just before a
    /// forbidden region. Inside a region, only the way to its nearer edge is free.
    pub(super) fn jog_room(&self, axis: AxisName, from: Pose, upwards: bool) -> Room {
        let settings = self.axis(axis);
        let (here, other) = match axis {
            AxisName::ThetaC => (from.theta_c, AxisName::PhiS),
            AxisName::PhiS => (from.phi_s, AxisName::ThetaC),
        };
        let other_at = self.at(other, axis_of(from, other));
        // Two tolerances: one on this side of the edge, one for where the axis stops.
        let margin = settings.tolerance.deg() * 2.0;
        let mut room = Room {
            end: match upwards {
                true => settings.limit_max,
                false => settings.limit_min,
            },
            region: None,
        };
        for region in &self.forbidden {
            if !self.meets(region, other, other_at) {
                continue;
            }
            for (min, max) in edges(region, axis, here.deg()) {
                let inside = here.deg() > min - margin && here.deg() < max + margin;
                let end = if inside {
                    let is_way_out = (max - here.deg() < here.deg() - min) == upwards;
                    match is_way_out {
                        true => continue,
                        false => here,
                    }
                } else if upwards && min > here.deg() {
                    Angle::from_deg(min - margin)
                } else if !upwards && max < here.deg() {
                    Angle::from_deg(max + margin)
                } else {
                    continue;
                };
                let is_nearer = match upwards {
                    true => end < room.end,
                    false => end > room.end,
                };
                if is_nearer {
                    room = Room {
                        end,
                        region: Some(region.clone()),
                    };
                }
            }
        }
        room
    }
}

/// The angle of one axis of a pose.
pub(super) fn axis_of(pose: Pose, axis: AxisName) -> Angle {
    match axis {
        AxisName::ThetaC => pose.theta_c,
        AxisName::PhiS => pose.phi_s,
    }
}

/// The edges of a region along an axis, in degrees: of φs, those of the turns about `here`.
fn edges(region: &ForbiddenRegion, axis: AxisName, here: f64) -> Vec<(f64, f64)> {
    match axis {
        AxisName::ThetaC => vec![(region.theta_c_deg[0], region.theta_c_deg[1])],
        AxisName::PhiS => {
            let [min, max] = region.phi_s_deg;
            let nearest = ((here - min) / 360.0).floor();
            [-1.0, 0.0, 1.0]
                .map(|turn| 360.0 * (nearest + turn))
                .map(|turn| (min + turn, max + turn))
                .into()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> StageSettings {
        let mut settings = StageSettings::simulated();
        settings.forbidden = vec![ForbiddenRegion {
            name: "lamp arm".into(),
            reason: String::new(),
            theta_c_deg: [30.0, 60.0],
            phi_s_deg: [80.0, 100.0],
        }];
        settings
    }

    #[test]
    fn the_approach_from_below_counts_as_part_of_the_way() {
        let settings = settings();
        let from = Pose::from_deg(45.0, 150.0);
        // Downwards to just above the region: the approach begins 0.2° below the target.
        assert!(
            settings
                .check_way(from, Pose::from_deg(45.0, 100.3))
                .is_ok()
        );
        assert!(
            settings
                .check_way(from, Pose::from_deg(45.0, 100.1))
                .is_err()
        );
        // An axis that rests there is not moved.
        let beside = Pose::from_deg(45.0, 100.1);
        assert!(
            settings
                .check_way(beside, Pose::from_deg(50.0, 100.1))
                .is_ok()
        );
    }

    #[test]
    fn a_target_inside_is_named_as_such() {
        let inside = settings().check_way(Pose::from_deg(0.0, 0.0), Pose::from_deg(45.0, 450.0));
        let words = inside.unwrap_err().to_string();
        assert!(words.contains("is in the forbidden region"), "{words}");
        assert!(words.contains("lamp arm"), "{words}");
    }

    #[test]
    fn a_jog_ends_before_a_region_and_leads_out_of_it_by_the_nearer_edge() {
        let settings = settings();
        let room = |theta: f64, phi: f64, upwards| {
            let from = Pose::from_deg(theta, phi);
            let room = settings.jog_room(AxisName::PhiS, from, upwards);
            (room.end.deg(), room.region.is_some())
        };
        let near = |found: (f64, bool), deg: f64, region: bool| {
            assert!(
                (found.0 - deg).abs() < 1e-6 && found.1 == region,
                "{found:?} {deg}"
            );
        };
        near(room(45.0, 50.0, true), 79.99, true);
        near(room(45.0, 50.0, false), -20.0, false);
        near(room(0.0, 50.0, true), 390.0, false);
        near(room(45.0, 150.0, false), 100.01, true);
        near(room(45.0, 150.0, true), 390.0, false);
        // Inside: 85° is nearer to 80°.
        near(room(45.0, 85.0, true), 85.0, true);
        near(room(45.0, 85.0, false), -20.0, false);
        near(room(45.0, 98.0, true), 390.0, false);
    }

    #[test]
    fn while_the_other_axis_is_unknown_a_region_may_be_left_and_not_entered() {
        let settings = settings();
        let check = |from: f64, to: f64| {
            settings.check_lone_way(AxisName::ThetaC, Angle::from_deg(from), Angle::from_deg(to))
        };
        assert!(check(0.0, 20.0).is_ok());
        assert!(check(40.0, 0.0).is_ok());
        let words = check(0.0, 40.0).unwrap_err().to_string();
        assert!(words.contains("home both axes first"), "{words}");
    }
}
