//! The one drawing of the axes: where camera and lamp stand for a pose, seen from the sample.
//!
//! ```text
//!            z = n (macro-surface normal)
//!            |   camera ω_o = (sin θc, 0, cos θc), tilts in the xz-plane
//!            |  /
//!            | /     lamp ω_i: fixed to the camera, θl away from it, at azimuth φl about ω_o
//!            |/      (φl = 0: in the tilt plane; φl = 90°: beside it)
//!   ---------+--------- x
//!           /   sample turns by φs about z, counter-clockwise seen from +z:
//!          y    v = (cos φs, sin φs, 0), u = v × n; the pitch facets lean towards v
//! ```
//!
//! All directions are unit vectors that point away from the surface. In the sample frame their
//! components are (u, v, n). Source: Luongo et al. 2017, Figs. 3, 6 and 7; the figure does not fix
//! φl nor the zero of φs, so both belong to the rig ([`RigGeometry`]).
//!
//! *Conditioning.* Components are rounded to 1e-16 of 1, whatever the angle. Of two opposite directions ε above the
//! horizon the half vector has the length 2ε, and its slopes are known to 1e-16/ε: enough for lobes of α = 1e-6 down to
//! ε = 1e-8, not below, whatever is computed from these vectors later. Where angles are at hand at such ends,
//! `model::brdf::evaluate` takes them instead. cos θi = cos θl cos θc − sin θl cos φl sin θc cancels towards grazing in
//! the same way: to 1e-16/cos θi.

mod alike;
mod cones;
mod imaging;

use nalgebra::Vector3;

use crate::units::Angle;
pub use alike::{alike, alike_around};
pub use cones::Cones;
pub use imaging::{AIM_MAX, Imaging};

/// Where the two stages stand: camera tilt θc and sample azimuth φs, as read from the stages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Tilt of the camera in the rig's xz-plane; positive towards +x.
    pub theta_c: Angle,
    /// Rotation of the sample about its normal, counter-clockwise seen from +z.
    pub phi_s: Angle,
}

impl Pose {
    /// A pose from the degrees that stages, files and requests speak.
    #[must_use]
    pub const fn from_deg(theta_c_deg: f64, phi_s_deg: f64) -> Self {
        Pose {
            theta_c: Angle::from_deg(theta_c_deg),
            phi_s: Angle::from_deg(phi_s_deg),
        }
    }
}

/// The facts of a rig that turn a recorded pose into directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigGeometry {
    /// Angle θl between lamp and camera.
    pub theta_l: Angle,
    /// Azimuth φl of the lamp about the camera's axis; 0 in the tilt plane, 90° beside it.
    pub light_azimuth: Angle,
    /// Added to the recorded φs it gives the azimuth of v.
    pub azimuth_zero: Angle,
    /// The cones in which light comes and goes.
    pub cones: Cones,
}

impl RigGeometry {
    /// The rig of the recorded series: lamp in the tilt plane, 10° from the camera, 1° in radius.
    pub const IN_PLANE: RigGeometry = RigGeometry {
        theta_l: Angle::from_deg(10.0),
        light_azimuth: Angle::ZERO,
        azimuth_zero: Angle::ZERO,
        cones: Cones::of_lamp(Angle::from_deg(1.0)),
    };
    /// The rig of the first paper's experiment: the same lamp beside the tilt plane, v at azimuth 90°.
    pub const BESIDE: RigGeometry = RigGeometry {
        light_azimuth: Angle::from_deg(90.0),
        azimuth_zero: Angle::from_deg(90.0),
        ..RigGeometry::IN_PLANE
    };

    /// Directions in the rig's frame (x, y, z) for a camera tilt.
    #[must_use]
    pub fn rig_directions(&self, theta_c: Angle) -> Directions {
        let (sc, cc) = theta_c.sin_cos();
        let (sl, cl) = self.theta_l.sin_cos();
        let (sa, ca) = self.light_azimuth.sin_cos();
        let outgoing = Vector3::new(sc, 0.0, cc);
        let in_plane = Vector3::new(cc, 0.0, -sc);
        let beside = Vector3::new(0.0, 1.0, 0.0);
        let incident = outgoing * cl + (in_plane * ca + beside * sa) * sl;
        Directions { incident, outgoing }
    }

    /// Directions in the sample frame (u, v, n) for a true pose. The rig's azimuth zero is added
    /// here; mounting offsets are the caller's to add to `pose` first.
    #[must_use]
    pub fn directions(&self, pose: Pose) -> Directions {
        let rig = self.rig_directions(pose.theta_c);
        let (s, c) = (pose.phi_s + self.azimuth_zero).sin_cos();
        // u = v × n = (sin φ, −cos φ, 0)
        let turn = |w: Vector3<f64>| Vector3::new(w.x * s - w.y * c, w.x * c + w.y * s, w.z);
        Directions {
            incident: turn(rig.incident),
            outgoing: turn(rig.outgoing),
        }
    }

    /// Cosine of the lamp's angle of incidence on the macro-surface at a true camera tilt.
    #[must_use]
    pub fn cos_incidence(&self, theta_c: Angle) -> f64 {
        self.rig_directions(theta_c).incident.z
    }

    /// The same with its derivative with respect to the tilt: tilting turns a direction (x, y, z) of the rig about +y at
    /// the rate (z, 0, −x).
    #[must_use]
    pub fn cos_incidence_and_slope(&self, theta_c: Angle) -> (f64, f64) {
        let incident = self.rig_directions(theta_c).incident;
        (incident.z, -incident.x)
    }
}

/// Unit vectors towards lamp and camera, both pointing away from the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Directions {
    /// ω_i, towards the lamp.
    pub incident: Vector3<f64>,
    /// ω_o, towards the camera.
    pub outgoing: Vector3<f64>,
}

impl Directions {
    /// The same in the rig's frame once its stage has tilted both by an angle, about +y towards +x.
    #[must_use]
    pub fn tilted(&self, by: Angle) -> Directions {
        let (sin, cos) = by.sin_cos();
        let tilted =
            |w: Vector3<f64>| Vector3::new(w.x * cos + w.z * sin, w.y, w.z * cos - w.x * sin);
        Directions {
            incident: tilted(self.incident),
            outgoing: tilted(self.outgoing),
        }
    }
}

/// By how much a wedge of the sample along u turns the lean direction of ridges of an angle. It turns with the turntable as
/// they do, so along v it is ridge angle, one to one. Half a turn at most: flat ridges lean wherever the wedge does.
#[must_use]
pub fn turn_by_wedge(wedge: Angle, theta_r: Angle) -> Angle {
    if wedge == Angle::ZERO {
        return Angle::ZERO;
    }
    let turn = (wedge.rad() / theta_r.rad().tan()).abs();
    Angle::from_rad(turn.min(std::f64::consts::PI))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lamp_in_the_tilt_plane_stands_at_theta_c_plus_theta_l() {
        let d = RigGeometry::IN_PLANE.rig_directions(Angle::from_deg(-17.0));
        let expected = Angle::from_deg(-7.0);
        assert!(
            (d.incident - Vector3::new(expected.rad().sin(), 0.0, expected.rad().cos())).norm()
                < 1e-15
        );
    }

    #[test]
    fn a_wedge_turns_flat_ridges_farther_and_none_turns_nothing() {
        let turn =
            |wedge, theta_r| turn_by_wedge(Angle::from_deg(wedge), Angle::from_deg(theta_r)).deg();
        // 0.5° along u looks like 2.8° of azimuth where ridges have 10°.
        assert!((turn(0.5, 10.0) - 2.836).abs() < 1e-3);
        assert_eq!(turn(0.5, -10.0), turn(0.5, 10.0));
        assert_eq!((turn(0.0, 0.0), turn(0.1, 0.0)), (0.0, 180.0));
    }

    #[test]
    fn turning_the_sample_by_ninety_degrees_carries_v_to_y() {
        let rig = RigGeometry {
            theta_l: Angle::ZERO,
            ..RigGeometry::IN_PLANE
        };
        let d = rig.directions(Pose::from_deg(30.0, 90.0));
        // The camera stands at +x; v points to +y, so the camera is at −u × ... = +u (u = v × n = +x).
        assert!((d.outgoing - Vector3::new(0.5, 0.0, 0.75f64.sqrt())).norm() < 1e-15);
    }

    #[test]
    fn the_sample_frame_is_right_handed() {
        let (u, v, n) = (Vector3::x(), Vector3::y(), Vector3::<f64>::z());
        assert_eq!(v.cross(&n), u);
    }
}
