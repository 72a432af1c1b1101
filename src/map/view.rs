//! Where a point of the sample appears in a frame, and from where it is lit and seen.
//!
//! The map's frame is the sample's: x, y at φs = 0 (φs of the model: recorded + azimuth zero), in
//! the frames' own pixel grid at θc = 0, row 0 at the greatest y. At a pose the sample has turned
//! by φs about the rotation axis; the camera's columns follow (cos θc, 0, −sin θc), its rows −y, so
//! a telecentric camera sees x foreshortened by cos θc. A near camera sees the point where the ray
//! through its pupil meets the plane through the centre of tilt, across the view.

use nalgebra::Vector3;

use super::kernel::Geometry;
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::model::fresnel;
use crate::series::Manifest;

/// Geometry in the sample's frame at a true pose, camera and lamp far away; `fresnel` is the
/// reflectance at half the angle between them.
pub(super) fn telecentric(rig: &RigGeometry, pose: Pose, fresnel: f64) -> Geometry {
    let d = rig.rig_directions(pose.theta_c);
    let (s, c) = (pose.phi_s + rig.azimuth_zero).sin_cos();
    let to_sample = |w: Vector3<f64>| [w.x * c + w.y * s, w.y * c - w.x * s, w.z];
    Geometry::new(to_sample(d.incident), to_sample(d.outgoing), fresnel)
}

/// The drawing of sample, camera and lamp.
#[derive(Debug, Clone)]
pub(super) struct View {
    pub(super) rig: RigGeometry,
    pub(super) width: usize,
    pub(super) height: usize,
    /// Millimetres per pixel along columns and rows; 1 where the manifest states no field.
    pub(super) pixel_mm: [f64; 2],
    /// Whether `pixel_mm` is known.
    pub(super) has_scale: bool,
    axis_px: [f64; 2],
    camera_distance_mm: Option<f64>,
    light_distance_mm: Option<f64>,
    /// Whether a near camera or lamp gives each pixel its own directions.
    own_directions: bool,
    index: (f64, f64),
    /// Fresnel reflectance at the half angle where camera and lamp are far.
    fresnel: f64,
}

impl View {
    pub(super) fn new(manifest: &Manifest) -> Self {
        let (rig, camera) = (&manifest.rig, &manifest.camera);
        let (width, height) = (f64::from(camera.width_px), f64::from(camera.height_px));
        let column_mm = camera.field_width_mm.map(|w| w / width);
        let row_mm = camera.field_height_mm.map(|h| h / height);
        let far = manifest.is_telecentric();
        let geometry = manifest.rig_geometry();
        let index = manifest.material().index();
        View {
            rig: geometry,
            width: camera.width_px as usize,
            height: camera.height_px as usize,
            pixel_mm: [
                column_mm.or(row_mm).unwrap_or(1.0),
                row_mm.or(column_mm).unwrap_or(1.0),
            ],
            has_scale: column_mm.is_some() || row_mm.is_some(),
            axis_px: rig.rotation_axis_px.unwrap_or([0.5 * width, 0.5 * height]),
            camera_distance_mm: rig
                .camera_distance_mm
                .or(camera.camera_distance_mm)
                .filter(|_| !far),
            light_distance_mm: rig.light_distance_mm.filter(|_| !far),
            own_directions: true,
            index,
            fresnel: fresnel::reflectance((0.5 * geometry.theta_l.rad()).cos(), index.0, index.1),
        }
    }

    /// A far camera and a far lamp, without any frame.
    pub(super) fn far(rig: RigGeometry, material: &Material) -> Self {
        let index = material.index();
        View {
            rig,
            width: 1,
            height: 1,
            pixel_mm: [1.0; 2],
            has_scale: false,
            axis_px: [0.5; 2],
            camera_distance_mm: None,
            light_distance_mm: None,
            own_directions: true,
            index,
            fresnel: fresnel::reflectance((0.5 * rig.theta_l.rad()).cos(), index.0, index.1),
        }
    }

    /// Whether camera and lamp are far.
    pub(super) fn is_telecentric(&self) -> bool {
        self.camera_distance_mm.is_none() && self.light_distance_mm.is_none()
    }

    /// The same with the directions of the field's centre for all pixels, where `own` says so.
    pub(super) fn with_own_directions(self, own: bool) -> View {
        View {
            own_directions: own,
            ..self
        }
    }

    /// Whether all pixels share their directions: they have the same, or the centre's stand for all.
    pub(super) fn shares_directions(&self) -> bool {
        self.is_telecentric() || !self.own_directions
    }

    /// n and k of the sample's surface.
    pub(super) fn index(&self) -> (f64, f64) {
        self.index
    }

    /// The same with camera and lamp at a distance from a square field, mm.
    #[cfg(test)]
    pub(super) fn brought_to(self, distance_mm: f64, field_mm: f64) -> View {
        View {
            camera_distance_mm: Some(distance_mm),
            light_distance_mm: Some(distance_mm),
            pixel_mm: [field_mm / self.width as f64, field_mm / self.height as f64],
            ..self
        }
    }

    /// Column and row of the rotation axis.
    pub(super) fn axis_px(&self) -> [f64; 2] {
        self.axis_px
    }

    pub(super) fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Sample coordinates of a map pixel's centre, mm from the rotation axis.
    pub(super) fn place_mm(&self, pixel: usize) -> [f64; 2] {
        let column = (pixel % self.width) as f64 + 0.5;
        let row = (pixel / self.width) as f64 + 0.5;
        [
            (column - self.axis_px[0]) * self.pixel_mm[0],
            -(row - self.axis_px[1]) * self.pixel_mm[1],
        ]
    }

    /// A point of the sample in the rig's frame, before the tilt.
    fn turned(&self, pose: Pose, place_mm: [f64; 2]) -> Vector3<f64> {
        let (s, c) = (pose.phi_s + self.rig.azimuth_zero).sin_cos();
        let [x, y] = place_mm;
        Vector3::new(x * c - y * s, x * s + y * c, 0.0)
    }

    /// Column and row (0, 0 at the outer corner of the first pixel) at which a point of the sample
    /// appears at a recorded pose.
    pub(super) fn project(&self, pose: Pose, place_mm: [f64; 2]) -> [f64; 2] {
        let place = self.turned(pose, place_mm);
        let (x, y) = (place.x, place.y);
        let (st, ct) = pose.theta_c.sin_cos();
        // Depth x sin θc towards the camera makes the near side look larger.
        let near = self.camera_distance_mm.map_or(1.0, |d| d / (d - x * st));
        [
            self.axis_px[0] + x * ct * near / self.pixel_mm[0],
            self.axis_px[1] - y * near / self.pixel_mm[1],
        ]
    }

    /// Geometry in the sample's frame at a true pose for a point of the sample; the point only
    /// matters to a near camera or lamp.
    pub(super) fn geometry(&self, pose: Pose, place_mm: [f64; 2]) -> Geometry {
        if self.is_telecentric() {
            return telecentric(&self.rig, pose, self.fresnel);
        }
        let d = self.rig.rig_directions(pose.theta_c);
        let (s, c) = (pose.phi_s + self.rig.azimuth_zero).sin_cos();
        let to_sample = |w: Vector3<f64>| [w.x * c + w.y * s, w.y * c - w.x * s, w.z];
        let place = self.turned(pose, place_mm);
        let towards = |far: Vector3<f64>, distance: Option<f64>| match distance {
            Some(distance) => (far * distance - place).normalize(),
            None => far,
        };
        let o = towards(d.outgoing, self.camera_distance_mm);
        let i = towards(d.incident, self.light_distance_mm);
        let cos_half = 0.5 * (i + o).norm();
        Geometry::new(
            to_sample(i),
            to_sample(o),
            fresnel::reflectance(cos_half, self.index.0, self.index.1),
        )
    }

    /// Irradiance on a surface facing the lamp at a point of the sample, relative to the field's centre; 1 where the
    /// lamp is far.
    pub(super) fn irradiance(&self, pose: Pose, place_mm: [f64; 2]) -> f64 {
        let Some(distance) = self.light_distance_mm else {
            return 1.0;
        };
        let place = self.turned(pose, place_mm);
        let ray = self.rig.rig_directions(pose.theta_c).incident * distance - place;
        distance * distance / ray.norm_squared()
    }

    /// Whether pixels have more or less light than the field's centre.
    pub(super) fn is_unevenly_lit(&self) -> bool {
        self.light_distance_mm.is_some()
    }

    /// Whether the fifth parameter of a pixel is an amplitude: nothing diffuse comes out of metal.
    pub(super) fn fits_amplitude(material: &Material) -> bool {
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
        View {
            camera_distance_mm: Some(300.0),
            light_distance_mm: Some(250.0),
            ..View::new(&checker())
        }
    }

    #[test]
    fn at_pose_zero_every_map_pixel_is_the_frames_own() {
        for view in [View::new(&checker()), near()] {
            for pixel in [0, 77, 256 * 100 + 31, 256 * 256 - 1] {
                let [column, row] = view.project(Pose::from_deg(0.0, 0.0), view.place_mm(pixel));
                assert!((column - (pixel % 256) as f64 - 0.5).abs() < 1e-9);
                assert!((row - (pixel / 256) as f64 - 0.5).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn turning_carries_x_to_y_and_tilting_foreshortens_x() {
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
            let view = View {
                camera_distance_mm: Some(distance),
                light_distance_mm: Some(distance),
                ..far.clone()
            };
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
    fn a_place_nearer_to_the_lamp_has_more_light_by_the_square_of_the_distance() {
        // With the camera 10° from the lamp and the sample tilted to face the lamp, a place r off the centre is √(d² + r²)
        // from it; where the lamp stands to a side by θ, √(d² + r² − 2 d r sin θ).
        let view = near();
        let theta_l = view.rig.theta_l;
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
