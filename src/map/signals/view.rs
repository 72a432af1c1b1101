//! The projection of a point of the sample into a frame, and its directions to lamp and camera.
//!
//! The map uses the sample's frame: x, y from the rotation axis at φs = 0 (the model's φs is the recorded one plus
//! the azimuth zero), in the frames' own pixel grid at θc = 0, with row 0 at the greatest y. At a pose the sample has
//! turned by φs about the rotation axis. [`Imaging`] returns where a point then appears, and its directions.

use nalgebra::Vector3;

use crate::geometry::{Directions, Imaging, Pose, RigGeometry};
use crate::map::solve::kernel::Geometry;
use crate::material::Material;
use crate::model::fresnel;
use crate::series::Manifest;
use crate::units::Angle;

/// Returns the geometry in the sample's frame at a true pose, with camera and lamp far away; `fresnel` is the
/// reflectance at half the angle between them.
pub(in crate::map) fn telecentric(rig: &RigGeometry, pose: Pose, fresnel: f64) -> Geometry {
    in_sample(rig, pose, &rig.rig_directions(pose.theta_c), fresnel)
}

/// Rotates directions of the rig into the sample's frame at a pose.
fn in_sample(rig: &RigGeometry, pose: Pose, d: &Directions, fresnel: f64) -> Geometry {
    let (s, c) = (pose.phi_s + rig.azimuth_zero).sin_cos();
    let turned = |w: Vector3<f64>| [w.x * c + w.y * s, w.y * c - w.x * s, w.z];
    Geometry::new(turned(d.incident), turned(d.outgoing), fresnel)
}

/// The arrangement of sample, camera and lamp.
#[derive(Debug, Clone)]
pub(in crate::map) struct View {
    /// Positions in the rig; a pixel counts as 1 mm if the manifest states no field size.
    pub(in crate::map) imaging: Imaging,
    pub(in crate::map) width: usize,
    pub(in crate::map) height: usize,
    /// Whether the field's size is known.
    pub(in crate::map) has_scale: bool,
    /// Whether a near camera or lamp gives each pixel its own directions.
    own_directions: bool,
    index: (f64, f64),
    /// Fresnel reflectance at the half angle if camera and lamp are far.
    fresnel: f64,
}

impl View {
    pub(in crate::map) fn new(manifest: &Manifest) -> Self {
        let camera = &manifest.camera;
        // The calibration refuses a near rig without a field size.
        let imaging = manifest.imaging();
        let imaging = imaging.unwrap_or_else(|| Imaging::far(manifest.rig_geometry()));
        View {
            imaging,
            width: camera.width_px as usize,
            height: camera.height_px as usize,
            has_scale: camera.field_width_mm.is_some() || camera.field_height_mm.is_some(),
            ..View::far(imaging.rig, &manifest.material())
        }
    }

    /// A far camera and a far lamp, without a frame.
    pub(in crate::map) fn far(rig: RigGeometry, material: &Material) -> Self {
        let index = material.index();
        View {
            imaging: Imaging::far(rig),
            width: 1,
            height: 1,
            has_scale: false,
            own_directions: true,
            index,
            fresnel: fresnel::reflectance((0.5 * rig.theta_l.rad()).cos(), index.0, index.1),
        }
    }

    /// Whether camera and lamp are far.
    pub(in crate::map) fn is_telecentric(&self) -> bool {
        self.imaging.is_far()
    }

    /// Sets whether pixels use their own directions; if not, all use those of the field's centre.
    pub(in crate::map) fn with_own_directions(self, own: bool) -> View {
        View {
            own_directions: own,
            ..self
        }
    }

    /// Whether all pixels use the same directions: theirs are equal, or those of the centre are used.
    pub(in crate::map) fn shares_directions(&self) -> bool {
        self.is_telecentric() || !self.own_directions
    }

    /// Moves camera and lamp to a distance from a square field, mm.
    #[cfg(test)]
    pub(in crate::map) fn brought_to(self, distance_mm: f64, field_mm: f64) -> View {
        View {
            imaging: Imaging {
                camera_mm: Some(distance_mm),
                light_mm: Some(distance_mm),
                pixel_mm: [field_mm / self.width as f64, field_mm / self.height as f64],
                ..self.imaging
            },
            ..self
        }
    }

    pub(in crate::map) fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Returns the sample coordinates of a map pixel's centre, mm from the rotation axis.
    pub(in crate::map) fn place_mm(&self, pixel: usize) -> [f64; 2] {
        let column = (pixel % self.width) as f64 + 0.5;
        let row = (pixel / self.width) as f64 + 0.5;
        let place = self.imaging.place(column, row, Angle::ZERO);
        let axis = self.imaging.axis_mm();
        [place[0] - axis[0], place[1] - axis[1]]
    }

    /// Converts a point of the sample to the rig's frame.
    fn turned(&self, pose: Pose, place_mm: [f64; 2]) -> [f64; 2] {
        let azimuth = pose.phi_s + self.imaging.rig.azimuth_zero;
        self.imaging.on_rig(place_mm, azimuth)
    }

    /// Returns column and row (0, 0 at the outer corner of the first pixel) at which a point of the sample appears at a
    /// recorded pose.
    pub(in crate::map) fn project(&self, pose: Pose, place_mm: [f64; 2]) -> [f64; 2] {
        self.imaging
            .pixel(self.turned(pose, place_mm), pose.theta_c)
    }

    /// Returns directions in the rig's frame and relative irradiance at a pose and a point of the sample.
    pub(in crate::map) fn seen(&self, pose: Pose, place_mm: [f64; 2]) -> (Directions, f64) {
        let place = self.turned(pose, place_mm);
        self.imaging.at(place, pose.theta_c)
    }

    /// Returns the geometry in the sample's frame at a true pose, at the centre of tilt.
    pub(in crate::map) fn central(&self, pose: Pose) -> Geometry {
        telecentric(&self.imaging.rig, pose, self.fresnel)
    }

    /// Returns the geometry in the sample's frame at a true pose for a point of the sample; it depends on the point
    /// only if camera or lamp are near.
    pub(in crate::map) fn geometry(&self, pose: Pose, place_mm: [f64; 2]) -> Geometry {
        if self.is_telecentric() {
            return self.central(pose);
        }
        let (d, _) = self.seen(pose, place_mm);
        let cos_half = 0.5 * (d.incident + d.outgoing).norm();
        let fresnel = fresnel::reflectance(cos_half, self.index.0, self.index.1);
        in_sample(&self.imaging.rig, pose, &d, fresnel)
    }

    /// Returns the irradiance on a surface that faces the lamp at a point of the sample, relative to the centre of
    /// tilt; 1 if the lamp is far.
    pub(in crate::map) fn irradiance(&self, pose: Pose, place_mm: [f64; 2]) -> f64 {
        if !self.is_unevenly_lit() {
            return 1.0;
        }
        self.seen(pose, place_mm).1
    }

    /// Whether the irradiance varies over the field.
    pub(in crate::map) fn is_unevenly_lit(&self) -> bool {
        self.imaging.light_mm.is_some()
    }

    /// Whether the fifth parameter of a pixel is an amplitude: metal has no diffuse light.
    pub(in crate::map) fn fits_amplitude(material: &Material) -> bool {
        matches!(material, Material::Conductor { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn checker() -> Manifest {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/checker");
        crate::series::Series::open(&folder)
            .unwrap()
            .manifest()
            .clone()
    }

    fn near() -> View {
        let view = View::new(&checker());
        View {
            imaging: Imaging {
                camera_mm: Some(300.0),
                light_mm: Some(250.0),
                ..view.imaging
            },
            ..view
        }
    }

    #[test]
    fn at_pose_zero_every_map_pixel_is_its_own_frame_pixel() {
        for view in [View::new(&checker()), near(), off_axis()] {
            for pixel in [0, 77, 256 * 100 + 31, 256 * 256 - 1] {
                let [column, row] = view.project(Pose::from_deg(0.0, 0.0), view.place_mm(pixel));
                assert!((column - (pixel % 256) as f64 - 0.5).abs() < 1e-9);
                assert!((row - (pixel / 256) as f64 - 0.5).abs() < 1e-9);
            }
        }
    }

    /// The near view, with the rotation axis beside the centre of tilt.
    fn off_axis() -> View {
        let view = near();
        View {
            imaging: Imaging {
                rotation_axis_px: [110.0, 140.0],
                ..view.imaging
            },
            ..view
        }
    }

    #[test]
    fn places_turn_about_the_axis_and_irradiance_is_relative_to_the_centre_of_tilt() {
        let view = off_axis();
        let place = view.place_mm(256 * 100 + 31);
        // Half a turn carries a pixel to the other side of the axis.
        let [column, row] = view.project(Pose::from_deg(0.0, 180.0), place);
        assert!((column - (220.0 - 31.5)).abs() < 1e-9 && (row - (280.0 - 100.5)).abs() < 1e-9);
        // The centre of tilt is 3.6 mm right of the axis and 2.4 mm above it. There the near view equals the far one.
        let pose = Pose::from_deg(12.0, 0.0);
        let centre = [3.6, 2.4];
        assert!((view.irradiance(pose, centre) - 1.0).abs() < 1e-12);
        assert!((view.irradiance(pose, [0.0; 2]) - 1.0).abs() > 1e-3);
        let (here, far) = (view.geometry(pose, centre), view.central(pose));
        for (a, b) in here.0.iter().zip(far.0) {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
    }

    #[test]
    fn turning_maps_x_to_y_and_tilting_foreshortens_x() {
        let view = View::new(&checker());
        // 10 mm along x are 50 pixels; rows count downwards.
        let [column, row] = view.project(Pose::from_deg(0.0, 90.0), [10.0, 0.0]);
        assert!((column - 128.0).abs() < 1e-9 && (row - 78.0).abs() < 1e-9);
        let [column, _] = view.project(Pose::from_deg(60.0, 0.0), [10.0, 0.0]);
        assert!((column - 153.0).abs() < 1e-9);
    }

    #[test]
    fn a_far_camera_is_the_limit_of_a_near_one() {
        let far = View::new(&checker());
        let pose = Pose::from_deg(15.0, 40.0);
        let at = |distance: f64| {
            let field_mm = 51.2;
            let view = far.clone().brought_to(distance, field_mm);
            view.geometry(pose, [12.0, -7.0])
        };
        let limit = far.geometry(pose, [12.0, -7.0]);
        for (distance, tolerance) in [(1e3, 0.03), (1e6, 3e-5)] {
            for (a, b) in at(distance).0.iter().zip(limit.0) {
                assert!((a - b).abs() < tolerance, "{distance}: {a} {b}");
            }
        }
        assert!((at(1e3).0[0] - limit.0[0]).abs() > 1e-4);
    }

    #[test]
    fn irradiance_is_inversely_proportional_to_the_square_of_the_distance_to_the_lamp() {
        // With the lamp perpendicular to the sample, a place at distance r from the centre is √(d² + r²) from the lamp;
        // with the lamp inclined by θ, √(d² + r² − 2 d r sin θ).
        let view = near();
        let theta_l = view.imaging.rig.theta_l;
        for (tilt_deg, phi_deg) in [(0.0, 0.0), (15.0, 0.0), (20.0, 180.0)] {
            let pose = Pose::from_deg(tilt_deg, phi_deg);
            let towards = (pose.theta_c + theta_l).sin_cos().0 * phi_deg.to_radians().cos();
            let (d, r) = (250.0, 12.0);
            let expected = d * d / (d * d + r * r - 2.0 * d * r * towards);
            let found = view.irradiance(pose, [r, 0.0]);
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        let at_centre = view.irradiance(Pose::from_deg(20.0, 70.0), [0.0; 2]);
        assert!((at_centre - 1.0).abs() < 1e-14, "{at_centre}");
    }
}
