//! The axes of the rig: directions of camera and lamp for a pose, seen from the sample.
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
//! components are (u, v, n). Source: Luongo et al. 2017, Figs. 3, 6 and 7. The figure fixes neither
//! φl nor the zero of φs, so both belong to the rig ([`RigGeometry`]).
//!
//! *Conditioning.* Components are rounded to 1e-16 of 1 at any angle. For two opposite directions ε
//! above the horizon, the half vector has the length 2ε, and its slopes are known to 1e-16/ε:
//! enough for lobes of α = 1e-6 down to ε = 1e-8, but not below, however these vectors are used.
//! Where the angles themselves are available, `model::brdf::evaluate` uses them instead. cos θi =
//! cos θl cos θc − sin θl cos φl sin θc has the same cancellation towards grazing: an error of
//! 1e-16/cos θi.

mod angle_groups;
mod cones;
pub mod field;
mod imaging;

use nalgebra::Vector3;

use crate::units::Angle;
pub use angle_groups::{group_angles, group_directions};
pub use cones::Cones;
pub use field::Field;
pub use imaging::{AIM_MAX, Imaging};

/// Positions of the two stages: camera tilt θc and sample azimuth φs, as read from the stages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Tilt of the camera in the rig's xz-plane; positive towards +x.
    pub theta_c: Angle,
    /// Rotation of the sample about its normal, counter-clockwise seen from +z.
    pub phi_s: Angle,
}

impl Pose {
    /// Makes a pose from degrees, the unit of stages, files and requests.
    #[must_use]
    pub const fn from_deg(theta_c_deg: f64, phi_s_deg: f64) -> Self {
        Pose {
            theta_c: Angle::from_deg(theta_c_deg),
            phi_s: Angle::from_deg(phi_s_deg),
        }
    }
}

/// Properties of a rig that convert a recorded pose to directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigGeometry {
    /// Angle θl between lamp and camera.
    pub theta_l: Angle,
    /// Azimuth φl of the lamp about the camera's axis; 0 in the tilt plane, 90° perpendicular to
    /// it.
    pub light_azimuth: Angle,
    /// Offset to add to the recorded φs to get the azimuth of v.
    pub azimuth_zero: Angle,
    /// Cones of the incident and the detected light.
    pub cones: Cones,
}

impl RigGeometry {
    /// The rig of the recorded series: lamp in the tilt plane, 10° from the camera, angular radius
    /// 1°.
    pub const IN_PLANE: RigGeometry = RigGeometry {
        theta_l: Angle::from_deg(10.0),
        light_azimuth: Angle::ZERO,
        azimuth_zero: Angle::ZERO,
        cones: Cones::of_lamp(Angle::from_deg(1.0)),
    };
    /// The rig of the first paper's experiment: the same lamp, perpendicular to the tilt plane, and
    /// v at azimuth 90°.
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
    /// here; the caller adds mounting offsets to `pose` first.
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

    /// The same with its derivative with respect to the tilt: tilting rotates a direction (x, y, z)
    /// of the rig about +y at the rate (z, 0, −x).
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
    /// Returns both directions in the rig's frame after a tilt by an angle, about +y towards +x.
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

/// Rotation of the ridges' apparent lean direction by a wedge of the sample along u. The wedge
/// turns with the turntable as the ridges do, so a wedge along v adds to the ridge angle one to
/// one. At most half a turn: flat ridges lean in the wedge's direction.
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
    fn a_lamp_in_the_tilt_plane_is_at_theta_c_plus_theta_l() {
        let d = RigGeometry::IN_PLANE.rig_directions(Angle::from_deg(-17.0));
        let expected = Angle::from_deg(-7.0);
        assert!(
            (d.incident - Vector3::new(expected.rad().sin(), 0.0, expected.rad().cos())).norm()
                < 1e-15
        );
    }

    #[test]
    fn a_wedge_turns_flat_ridges_farther_and_a_zero_wedge_turns_nothing() {
        let turn =
            |wedge, theta_r| turn_by_wedge(Angle::from_deg(wedge), Angle::from_deg(theta_r)).deg();
        // 0.5° along u appears as 2.8° of azimuth on ridges of 10°.
        assert!((turn(0.5, 10.0) - 2.836).abs() < 1e-3);
        assert_eq!(turn(0.5, -10.0), turn(0.5, 10.0));
        assert_eq!((turn(0.0, 0.0), turn(0.1, 0.0)), (0.0, 180.0));
    }

    #[test]
    fn rotating_the_sample_by_ninety_degrees_takes_v_to_y() {
        let rig = RigGeometry {
            theta_l: Angle::ZERO,
            ..RigGeometry::IN_PLANE
        };
        let d = rig.directions(Pose::from_deg(30.0, 90.0));
        // The camera is at +x and v points to +y; u = v × n = +x, so the camera is on the +u side.
        assert!((d.outgoing - Vector3::new(0.5, 0.0, 0.75f64.sqrt())).norm() < 1e-15);
    }

    #[test]
    fn the_sample_frame_is_right_handed() {
        let (u, v, n) = (Vector3::x(), Vector3::y(), Vector3::<f64>::z());
        assert_eq!(v.cross(&n), u);
    }
}
