//! Forbidden regions of (θc, φs), and how a move gets past them.
//!
//! Both axes may move at any relative speed, so a move is free only if the whole rectangle that its two ways span is
//! free. If it is not, one axis moves after the other, in the order whose way is free. φs is compared in every turn.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::geometry::Pose;

/// Most regions of a rig.
pub(super) const REGIONS_MAX: usize = 100;
/// Longest name or reason, in characters.
const TEXT_MAX: usize = 200;

/// A rectangle of poses that the stages must not enter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForbiddenRegion {
    /// Its name, for messages.
    pub name: String,
    /// Why it is forbidden.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// Least and greatest camera tilt, degrees.
    pub theta_c_deg: [f64; 2],
    /// Least and greatest sample azimuth, degrees; every full turn further is forbidden too.
    pub phi_s_deg: [f64; 2],
}

impl fmt::Display for ForbiddenRegion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([theta_min, theta_max], [phi_min, phi_max]) = (self.theta_c_deg, self.phi_s_deg);
        write!(
            f,
            "{:?} (theta_c {theta_min}° … {theta_max}°, phi_s {phi_min}° … {phi_max}°",
            self.name
        )?;
        match self.reason.as_str() {
            "" => f.write_str(")"),
            reason => write!(f, "; {reason})"),
        }
    }
}

/// The angles that an axis passes on a way, in degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Span {
    pub min: f64,
    pub max: f64,
}

impl Span {
    /// The span between two angles, with a margin on both sides.
    pub fn between(a: f64, b: f64, margin: f64) -> Span {
        Span {
            min: a.min(b) - margin,
            max: a.max(b) + margin,
        }
    }
}

/// The ways of both axes, and where each rests before and after its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Way {
    pub theta_c: Span,
    pub phi_s: Span,
    /// Where θc rests before and after its way.
    pub theta_c_ends: [Span; 2],
    /// Where φs rests before and after its way.
    pub phi_s_ends: [Span; 2],
}

/// Which axis moves when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MoveOrder {
    Together,
    ThetaCFirst,
    PhiSFirst,
}

/// A move that enters a forbidden region whichever axis moves first.
#[derive(Debug, Clone, PartialEq)]
pub struct Forbidden {
    /// The region.
    pub region: ForbiddenRegion,
    /// Where the move would begin; `None` if an axis has no reference, so that its position is unknown.
    pub from: Option<Pose>,
    /// Its target.
    pub to: Pose,
    /// Whether the target itself is in the region.
    pub ends_inside: bool,
}

impl fmt::Display for Forbidden {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Forbidden {
            region, from, to, ..
        } = self;
        let pose = |pose: &Pose| format!("theta_c = {}, phi_s = {}", pose.theta_c, pose.phi_s);
        match (self.ends_inside, from) {
            (true, _) => write!(
                f,
                "{} is in the forbidden region {region}: choose another target",
                pose(to)
            ),
            (false, Some(from)) => write!(
                f,
                "every way from {} to {} enters the forbidden region {region}: move past it in steps",
                pose(from),
                pose(to)
            ),
            (false, None) => write!(
                f,
                "the way to {} may enter the forbidden region {region}, because an axis has no reference position: home \
                 both axes first",
                pose(to)
            ),
        }?;
        f.write_str(", or change [[stage.forbidden]] in the settings")
    }
}

impl ForbiddenRegion {
    /// Returns the first invalid key, its value and the allowed values.
    pub(super) fn check(&self) -> Result<(), (&'static str, String, &'static str)> {
        let length = self.name.trim().chars().count();
        if !(1..=TEXT_MAX).contains(&length) {
            return Err(("name", format!("{:?}", self.name), "1 to 200 characters"));
        }
        if self.reason.chars().count() > TEXT_MAX {
            let found = format!("{} characters", self.reason.chars().count());
            return Err(("reason", found, "at most 200 characters"));
        }
        for (key, [min, max]) in [
            ("theta_c_deg", self.theta_c_deg),
            ("phi_s_deg", self.phi_s_deg),
        ] {
            let fine = min < max && min.abs() <= 36_000.0 && max.abs() <= 36_000.0;
            if !fine {
                let allowed = "the least and the greatest angle in degrees, each at most 36 000";
                return Err((key, format!("[{min}, {max}]"), allowed));
            }
        }
        Ok(())
    }

    pub(super) fn meets_theta_c(&self, span: Span) -> bool {
        let [min, max] = self.theta_c_deg;
        span.max >= min && span.min <= max
    }

    pub(super) fn meets_phi_s(&self, span: Span) -> bool {
        let [min, max] = self.phi_s_deg;
        // The first turn of the region that ends after the span begins.
        let turn = 360.0 * ((span.min - max) / 360.0).ceil();
        span.max >= min + turn
    }

    fn meets(&self, theta_c: Span, phi_s: Span) -> bool {
        self.meets_theta_c(theta_c) && self.meets_phi_s(phi_s)
    }
}

/// Returns the order in which the axes may move, or the region that blocks all orders.
pub(super) fn order_of(
    regions: &[ForbiddenRegion],
    way: &Way,
) -> Result<MoveOrder, ForbiddenRegion> {
    let [theta_from, theta_to] = way.theta_c_ends;
    let [phi_from, phi_to] = way.phi_s_ends;
    let blocked = |boxes: &[(Span, Span)]| {
        regions
            .iter()
            .find(|region| boxes.iter().any(|(theta, phi)| region.meets(*theta, *phi)))
    };
    let Some(first) = blocked(&[(way.theta_c, way.phi_s)]) else {
        return Ok(MoveOrder::Together);
    };
    if blocked(&[(way.theta_c, phi_from), (theta_to, way.phi_s)]).is_none() {
        return Ok(MoveOrder::ThetaCFirst);
    }
    if blocked(&[(theta_from, way.phi_s), (way.theta_c, phi_to)]).is_none() {
        return Ok(MoveOrder::PhiSFirst);
    }
    Err(first.clone())
}

/// Returns the region that a pose is in.
pub(super) fn region_at(
    regions: &[ForbiddenRegion],
    theta_c: Span,
    phi_s: Span,
) -> Option<&ForbiddenRegion> {
    regions.iter().find(|region| region.meets(theta_c, phi_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn region() -> ForbiddenRegion {
        ForbiddenRegion {
            name: "lamp arm".into(),
            reason: "the lens hits it".into(),
            theta_c_deg: [30.0, 60.0],
            phi_s_deg: [80.0, 100.0],
        }
    }

    fn way(from: (f64, f64), to: (f64, f64)) -> Way {
        let at = |deg: f64| Span::between(deg, deg, 0.005);
        Way {
            theta_c: Span::between(from.0, to.0, 0.005),
            phi_s: Span::between(from.1, to.1, 0.005),
            theta_c_ends: [at(from.0), at(to.0)],
            phi_s_ends: [at(from.1), at(to.1)],
        }
    }

    #[test]
    fn a_free_rectangle_is_crossed_at_once_and_a_corner_one_axis_first() {
        let regions = [region()];
        let order = |from, to| order_of(&regions, &way(from, to));
        assert_eq!(order((0.0, 0.0), (20.0, 90.0)), Ok(MoveOrder::Together));
        assert_eq!(order((0.0, 0.0), (50.0, 70.0)), Ok(MoveOrder::Together));
        // Past the corner: φs must leave the region's azimuths before θc enters its tilts.
        assert_eq!(order((0.0, 90.0), (50.0, 120.0)), Ok(MoveOrder::PhiSFirst));
        assert_eq!(
            order((50.0, 120.0), (0.0, 90.0)),
            Ok(MoveOrder::ThetaCFirst)
        );
        // Across it there is no way with one turn of each axis.
        assert_eq!(order((50.0, 70.0), (50.0, 110.0)), Err(region()));
        assert_eq!(order((0.0, 0.0), (40.0, 90.0)), Err(region()));
    }

    #[test]
    fn every_turn_of_the_azimuth_is_forbidden() {
        let theta = Span::between(45.0, 45.0, 0.0);
        for (phi, expected) in [
            (90.0, true),
            (450.0, true),
            (-270.0, true),
            (79.0, false),
            (101.0, false),
            (440.0, true),
            (461.0, false),
            (-281.0, false),
        ] {
            let at = Span::between(phi, phi, 0.0);
            let found = region_at(&[region()], theta, at).is_some();
            assert_eq!(found, expected, "{phi}");
        }
        let all = ForbiddenRegion {
            phi_s_deg: [0.0, 360.0],
            ..region()
        };
        for phi in [-1000.0, -0.5, 0.0, 359.9, 725.3] {
            let at = Span::between(phi, phi, 0.0);
            assert!(region_at(std::slice::from_ref(&all), theta, at).is_some());
        }
    }

    proptest::proptest! {
        /// The oracle: both axes move along straight lines in time, with any relative timing.
        #[test]
        fn no_timing_of_an_allowed_move_enters_a_region(
            from in (-60.0..60.0f64, -20.0..390.0f64),
            to in (-60.0..60.0f64, -20.0..390.0f64),
            a in 0.0..1.0f64,
            b in 0.0..1.0f64,
        ) {
            let regions = [region()];
            let Ok(order) = order_of(&regions, &way(from, to)) else { return Ok(()) };
            let mix = |from: f64, to: f64, share: f64| from + (to - from) * share;
            let poses = match order {
                MoveOrder::Together => vec![(mix(from.0, to.0, a), mix(from.1, to.1, b))],
                MoveOrder::ThetaCFirst => {
                    vec![(mix(from.0, to.0, a), from.1), (to.0, mix(from.1, to.1, b))]
                }
                MoveOrder::PhiSFirst => {
                    vec![(from.0, mix(from.1, to.1, b)), (mix(from.0, to.0, a), to.1)]
                }
            };
            for (theta, phi) in poses {
                let turn = phi.rem_euclid(360.0);
                let inside = (30.0..=60.0).contains(&theta) && (80.0..=100.0).contains(&turn);
                proptest::prop_assert!(!inside, "{theta} {phi}");
            }
        }
    }
}
