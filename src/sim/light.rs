//! The radiance at each pixel of the simulated camera. With a near camera or lamp, every pixel has
//! its own directions and irradiance, and the sample may be inclined to the turntable.
//!
//! Call [`SimulatedScene::radiance`]. With a distant camera and lamp the whole field has one radiance.

use nalgebra::{Rotation3, Vector3};

use super::sample::SimulatedSample;
use super::world::{Mounting, OnTable};
use crate::geometry::{Directions, Imaging, Pose};

/// Radiance in front of the lens.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum PixelLight {
    /// The same in all pixels.
    Even(f64),
    /// One value per pixel, row by row.
    Uneven(Vec<f64>),
}

impl PixelLight {
    pub(super) fn at(&self, pixel: usize) -> f64 {
        match self {
            PixelLight::Even(radiance) => *radiance,
            PixelLight::Uneven(pixels) => pixels[pixel],
        }
    }

    /// Adds `stray` to every pixel.
    pub(super) fn and(self, stray: f64) -> PixelLight {
        match self {
            PixelLight::Even(radiance) => PixelLight::Even(radiance + stray),
            PixelLight::Uneven(mut pixels) => {
                pixels.iter_mut().for_each(|pixel| *pixel += stray);
                PixelLight::Uneven(pixels)
            }
        }
    }

    /// The mean of several moments.
    pub(super) fn mean(moments: &[PixelLight]) -> PixelLight {
        let share = 1.0 / moments.len().max(1) as f64;
        let at = |pixel| moments.iter().map(|l| l.at(pixel)).sum::<f64>() * share;
        // With the cap on, the field is uniform.
        let pixels = moments.iter().find_map(|light| match light {
            PixelLight::Even(_) => None,
            PixelLight::Uneven(pixels) => Some(pixels.len()),
        });
        match pixels {
            Some(pixels) => PixelLight::Uneven((0..pixels).map(at).collect()),
            None => PixelLight::Even(at(0)),
        }
    }
}

/// The sample, the white reference and the rig in front of the camera.
pub(super) struct SimulatedScene<'a> {
    pub(super) imaging: Imaging,
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) mounting: Mounting,
    pub(super) sample: &'a SimulatedSample,
    /// Diffuse reflectance of the white reference.
    pub(super) reflectance: f64,
}

impl SimulatedScene<'_> {
    /// Radiance at a true pose, for an irradiance of 1 on a surface facing the lamp at the centre of tilt.
    pub(super) fn radiance(&self, on_table: OnTable, pose: Pose) -> PixelLight {
        match on_table {
            OnTable::WhiteReference => {
                let white = self.reflectance / std::f64::consts::PI;
                // The white reference lies flat.
                self.over_the_field(pose, Vector3::z(), &|d| white * d.incident.z.max(0.0))
            }
            OnTable::Sample => {
                let inclined = self.inclined(pose);
                let [u, v, n] = self.axes(&inclined, pose);
                let turned = |w: Vector3<f64>| Vector3::new(w.dot(&u), w.dot(&v), w.dot(&n));
                let radiance = self.sample.radiance_towards(&self.imaging.rig, pose);
                self.over_the_field(pose, n, &|d| {
                    radiance(&Directions {
                        incident: turned(d.incident),
                        outgoing: turned(d.outgoing),
                    })
                })
            }
        }
    }

    /// The rotation from the turntable's plane to the sample's, by the shortest way.
    fn inclined(&self, pose: Pose) -> Rotation3<f64> {
        let towards = pose.phi_s + self.imaging.rig.azimuth_zero + self.mounting.wedge_azimuth;
        let (sin, cos) = towards.sin_cos();
        Rotation3::new(Vector3::new(-sin, cos, 0.0) * self.mounting.wedge.rad())
    }

    /// Returns u, v and n of the sample in the rig's frame.
    fn axes(&self, inclined: &Rotation3<f64>, pose: Pose) -> [Vector3<f64>; 3] {
        let (s, c) = (pose.phi_s + self.imaging.rig.azimuth_zero).sin_cos();
        let flat = [
            Vector3::new(s, -c, 0.0),
            Vector3::new(c, s, 0.0),
            Vector3::z(),
        ];
        flat.map(|axis| inclined * axis)
    }

    /// Radiance of a plane through the foot of the rotation axis, a point that no rotation moves.
    fn over_the_field(
        &self,
        pose: Pose,
        normal: Vector3<f64>,
        radiance: &dyn Fn(&Directions) -> f64,
    ) -> PixelLight {
        if self.imaging.is_far() {
            return PixelLight::Even(radiance(&self.imaging.rig.rig_directions(pose.theta_c)));
        }
        let [x, y] = self.imaging.axis_mm();
        let foot = Vector3::new(x, y, 0.0);
        let seen = |pixel: usize| {
            let column = (pixel % self.width) as f64 + 0.5;
            let row = (pixel / self.width) as f64 + 0.5;
            let (from, ray) = self.imaging.ray(column, row, pose.theta_c);
            let place = from + ray * ((foot - from).dot(&normal) / ray.dot(&normal));
            let (directions, irradiance) = self.imaging.at_point(place, pose.theta_c);
            irradiance * radiance(&directions)
        };
        PixelLight::Uneven((0..self.width * self.height).map(seen).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::RigGeometry;
    use crate::units::Angle;

    fn scene(
        sample: &SimulatedSample,
        near_mm: Option<f64>,
        mounting: Mounting,
    ) -> SimulatedScene<'_> {
        SimulatedScene {
            imaging: Imaging {
                rig: RigGeometry::IN_PLANE,
                pixel_mm: [3.2; 2],
                tilt_centre_px: [8.0; 2],
                principal_point_px: [8.0; 2],
                rotation_axis_px: [5.0, 9.0],
                camera_mm: near_mm,
                light_mm: near_mm,
            },
            width: 16,
            height: 16,
            mounting,
            sample,
            reflectance: 0.99,
        }
    }

    #[test]
    fn a_distant_lamp_is_the_limit_of_a_near_one_whose_field_is_not_uniform() {
        let sample = SimulatedSample::by_name("polymer-20").unwrap();
        let pose = Pose::from_deg(8.0, 30.0);
        for on_table in [OnTable::Sample, OnTable::WhiteReference] {
            let of = |near| scene(&sample, near, Mounting::default()).radiance(on_table, pose);
            let far = of(None);
            assert_eq!(far, PixelLight::Even(far.at(0)));
            let (limit, near) = (of(Some(1e8)), of(Some(300.0)));
            assert!((limit.at(0) / far.at(0) - 1.0).abs() < 1e-5);
            assert!((near.at(0) / near.at(255) - 1.0).abs() > 0.05);
        }
        let rig = RigGeometry::IN_PLANE;
        let given = scene(&sample, None, Mounting::default()).radiance(OnTable::Sample, pose);
        assert!((given.at(0) / sample.radiance(&rig, pose) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_wedge_along_v_adds_to_the_ridge_angle_and_turns_with_the_sample() {
        let model = |theta_r: f64| {
            let sample = SimulatedSample::by_name("polymer-20").unwrap();
            match sample {
                SimulatedSample::Model {
                    variant,
                    surface,
                    material,
                } => SimulatedSample::Model {
                    variant,
                    surface: crate::model::Surface {
                        theta_r: theta_r.to_radians(),
                        rho_d: 0.0,
                        ..surface
                    },
                    material,
                },
                other => other,
            }
        };
        let wedge = Mounting {
            wedge: Angle::from_deg(0.2),
            ..Mounting::default()
        };
        let (plain, steeper) = (model(20.0), model(20.2));
        for phi in [0.0, 180.0] {
            let pose = Pose::from_deg(if phi == 0.0 { 11.0 } else { -21.0 }, phi);
            let at = |sample: &SimulatedSample, mounting| {
                scene(sample, None, mounting)
                    .radiance(OnTable::Sample, pose)
                    .at(0)
            };
            let (flat, tilted, due) = (
                at(&plain, Mounting::default()),
                at(&plain, wedge),
                at(&steeper, Mounting::default()),
            );
            let (moved, expected) = (tilted / flat - 1.0, due / flat - 1.0);
            // To first order; the fractions of facets and risers are the sample's own.
            assert!(expected.abs() > 0.005, "{expected}");
            assert!(
                (moved - expected).abs() < 0.25 * expected.abs(),
                "{moved} {expected}"
            );
        }
    }
}
