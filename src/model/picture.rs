//! A board of patches with ridges in two directions, imaged by a camera at a finite distance.
//!
//! [`Board::render`] returns the radiance of every pixel (Luongo et al. 2017, Fig. 2). Each pixel has its own
//! directions to lamp and camera, and its own irradiance, which is 1 at the board's centre for a surface that faces
//! the lamp and decreases with the square of the distance.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::geometry::{Directions, RigGeometry};
use crate::units::Angle;

use super::prepared::{OpticsTable, Prepared};
use super::{Optics, Surface, Variant};

/// A square board of n × n patches; if i + j is odd, the ridges are turned by −90°. With an odd n a quarter turn
/// (+90°) moves the odd patches to the places of the even ones, so bright and dark are exchanged. With an even n the
/// patches change places too, which cancels the exchange.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    /// Side of the board, mm.
    pub size_mm: f64,
    /// Patches along a side.
    pub patches: u32,
    /// Distance of camera and lamp from the board's centre, mm.
    pub distance_mm: f64,
    /// Width of the camera's field in the plane through the centre, perpendicular to its axis, mm.
    pub field_mm: f64,
}

/// A grey picture in linear radiance, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels along a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Radiance, `width × height`.
    pub radiance: Vec<f32>,
}

impl Board {
    /// Renders the board at a camera tilt and a recorded azimuth, `pixels` square; pixels beside the board are dark.
    #[must_use]
    pub fn render(
        &self,
        rig: &RigGeometry,
        theta_c: Angle,
        phi_s: Angle,
        surface: &Surface,
        optics: &Optics,
        pixels: usize,
    ) -> Picture {
        let prepared = Prepared::new(Variant::Sawtooth, surface, &OpticsTable::new(optics));
        let centre = rig.rig_directions(theta_c);
        let camera = centre.outgoing * self.distance_mm;
        let lamp = centre.incident * self.distance_mm;
        // Image axes: columns along the tilt direction, rows downwards along −y.
        let (sin, cos) = theta_c.sin_cos();
        let column = Vector3::new(cos, 0.0, -sin);
        let row = Vector3::new(0.0, -1.0, 0.0);
        let (sin_s, cos_s) = phi_s.sin_cos();
        let step = self.field_mm / pixels as f64;
        let at = |index: usize| (index as f64 + 0.5) * step - 0.5 * self.field_mm;
        let radiance = (0..pixels * pixels)
            .into_par_iter()
            .map(|index| {
                let target = column * at(index % pixels) + row * at(index / pixels);
                let ray = target - camera;
                if ray.z >= 0.0 {
                    return 0.0;
                }
                let point = camera - ray * (camera.z / ray.z);
                // The board's own axes turn with the sample.
                let x = point.x * cos_s + point.y * sin_s;
                let y = point.y * cos_s - point.x * sin_s;
                let patch = |c: f64| {
                    let share = c / self.size_mm + 0.5;
                    (0.0..1.0)
                        .contains(&share)
                        .then(|| (share * f64::from(self.patches)) as u32)
                };
                let (Some(i), Some(j)) = (patch(x), patch(y)) else {
                    return 0.0;
                };
                let quarter = if (i + j) % 2 == 0 { 0.0 } else { -90.0 };
                let azimuth = phi_s + rig.azimuth_zero + Angle::from_deg(quarter);
                let (s, c) = azimuth.sin_cos();
                let turn =
                    |w: Vector3<f64>| Vector3::new(w.x * s - w.y * c, w.x * c + w.y * s, w.z);
                let to_lamp = lamp - point;
                let directions = Directions {
                    incident: turn(to_lamp.normalize()),
                    outgoing: turn((camera - point).normalize()),
                };
                let irradiance = self.distance_mm * self.distance_mm / to_lamp.norm_squared();
                (prepared.partials(&directions).value * irradiance) as f32
            })
            .collect();
        Picture {
            width: pixels,
            height: pixels,
            radiance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOARD: Board = Board {
        size_mm: 40.0,
        patches: 5,
        distance_mm: 400.0,
        field_mm: 50.0,
    };

    fn picture(phi_s_deg: f64) -> Picture {
        let rig = RigGeometry::BESIDE;
        let surface = Surface {
            theta_r: 5f64.to_radians(),
            alpha_u: 0.05,
            alpha_v: 0.05,
            rho_d: 0.35,
            amplitude: 1.0,
        };
        let optics = Optics {
            eta: 1.54,
            k: 0.0,
            theta_l: rig.theta_l.rad(),
            cones: crate::geometry::Cones::NONE,
        };
        BOARD.render(
            &rig,
            Angle::ZERO,
            Angle::from_deg(phi_s_deg),
            &surface,
            &optics,
            100,
        )
    }

    #[test]
    fn a_quarter_turn_exchanges_bright_and_dark_patches() {
        let (before, after) = (picture(0.0), picture(90.0));
        // The central patch (even) and its neighbours (odd), 16 pixels away.
        let at = |p: &Picture, x: usize, y: usize| p.radiance[y * p.width + x];
        for (x, y) in [(50, 50), (34, 50), (66, 50), (50, 34), (50, 66)] {
            let (a, b) = (at(&before, x, y), at(&after, x, y));
            let brighter = a.max(b) / a.min(b);
            assert!(brighter > 2.0, "{x} {y}: {a} {b}");
        }
        assert!(at(&before, 50, 50) > 2.0 * at(&before, 66, 50));
        assert!(at(&after, 50, 50) < 0.5 * at(&after, 34, 50));
        assert_eq!(at(&before, 2, 2), 0.0);
    }

    #[test]
    fn the_centre_of_the_board_agrees_with_a_far_camera() {
        let far = Board {
            distance_mm: 1e7,
            ..BOARD
        };
        let rig = RigGeometry::IN_PLANE;
        let surface = Surface {
            theta_r: 0.1,
            alpha_u: 0.1,
            alpha_v: 0.1,
            rho_d: 0.35,
            amplitude: 1.0,
        };
        let optics = Optics {
            eta: 1.54,
            k: 0.0,
            theta_l: rig.theta_l.rad(),
            cones: crate::geometry::Cones::NONE,
        };
        let tilt = Angle::from_deg(12.0);
        let p = far.render(&rig, tilt, Angle::ZERO, &surface, &optics, 50);
        let d = rig.directions(crate::geometry::Pose {
            theta_c: tilt,
            phi_s: Angle::ZERO,
        });
        let expected = super::super::radiance(Variant::Sawtooth, &d, &surface, &optics);
        // The central patch is even, so it is not turned.
        let value = f64::from(p.radiance[25 * p.width + 25]);
        assert!((value / expected - 1.0).abs() < 1e-4, "{value} {expected}");
    }
}
