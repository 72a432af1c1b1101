//! The mapping between pixels and places of the sample, and the directions of light at each place.
//!
//! ```text
//!    camera's pupil P = C + Dc ω_o          lamp Λ = C + Dl ω_i
//!                   \                       /        both turn about the tilt axis, which runs through C along y
//!            optical \ ray of a pixel      /
//!               axis  \                   /
//!   -----------c0------C-----x-----------Q-----------  sample (z = 0)
//!      principal point   centre of tilt   rotation axis (along z)
//! ```
//!
//! Rig frame, in millimetres from the centre of tilt C. Camera and lamp are aimed at C and tilt
//! about it; distances, directions and irradiance depend on C only. Q is where the rotation axis
//! meets the sample; positions *on the sample* (patches, maps) rotate about Q. The principal point
//! c0 is the foot of the optical axis. It equals C if the camera is aimed at C. It matters only for
//! a near camera, whose scale is defined in the plane through C perpendicular to the optical axis.
//! A lens shifted against its sensor needs no parameter: the image plane stays perpendicular to P −
//! C.
//!
//! A distant camera looks along (sin θc, 0, cos θc). Its columns run along a = (cos θc, 0, −sin
//! θc), its rows along −y. Columns and rows count from corners: (0, 0) is the outer corner of the
//! first pixel.
//!
//! *Conditioning.* One division by the depth of a ray; [`Imaging::is_aimed`] and the tilt limits
//! keep it away from 0.

use nalgebra::Vector3;

use super::{Directions, RigGeometry};
use crate::units::Angle;

/// Largest sine of the angle by which the camera may be aimed past the centre of tilt.
pub const AIM_MAX: f64 = 0.9;

/// Positions of camera, lamp and turntable relative to each other, and their images in the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imaging {
    /// Directions at the centre of tilt.
    pub rig: RigGeometry,
    /// Millimetres per column and per row in the plane through the centre of tilt perpendicular to
    /// the optical axis.
    pub pixel_mm: [f64; 2],
    /// Column and row of the centre of tilt.
    pub tilt_centre_px: [f64; 2],
    /// Column and row of the foot of the optical axis.
    pub principal_point_px: [f64; 2],
    /// Column and row of the foot of the rotation axis at θc = 0.
    pub rotation_axis_px: [f64; 2],
    /// Distance from the centre of tilt to the entrance pupil; `None` for a telecentric lens.
    pub camera_mm: Option<f64>,
    /// Distance from the centre of tilt to the lamp; `None` for collimated light.
    pub light_mm: Option<f64>,
}

/// Directions of the columns, of the upward rows and of the camera at a tilt.
struct Axes([Vector3<f64>; 3]);

impl Axes {
    fn at(theta_c: Angle) -> Axes {
        let (sin, cos) = theta_c.sin_cos();
        Axes([
            Vector3::new(cos, 0.0, -sin),
            Vector3::new(0.0, 1.0, 0.0),
            Vector3::new(sin, 0.0, cos),
        ])
    }

    fn to_rig(&self, w: Vector3<f64>) -> Vector3<f64> {
        let Axes([a, b, c]) = self;
        a * w.x + b * w.y + c * w.z
    }

    fn of_rig(&self, w: Vector3<f64>) -> Vector3<f64> {
        let Axes([a, b, c]) = self;
        Vector3::new(w.dot(a), w.dot(b), w.dot(c))
    }
}

impl Imaging {
    /// Makes a distant camera and a distant lamp centred on one pixel.
    #[must_use]
    pub fn far(rig: RigGeometry) -> Imaging {
        Imaging {
            rig,
            pixel_mm: [1.0; 2],
            tilt_centre_px: [0.5; 2],
            principal_point_px: [0.5; 2],
            rotation_axis_px: [0.5; 2],
            camera_mm: None,
            light_mm: None,
        }
    }

    /// Whether all pixels share directions and irradiance.
    #[must_use]
    pub fn is_far(&self) -> bool {
        self.camera_mm.is_none() && self.light_mm.is_none()
    }

    /// Whether a near camera can be aimed as the points state: past the centre of tilt by less than
    /// [`AIM_MAX`] of its distance.
    #[must_use]
    pub fn is_aimed(&self) -> bool {
        let [x, y] = self.centre_from_principal();
        self.camera_mm
            .is_none_or(|distance| x.hypot(y) < AIM_MAX * distance)
    }

    /// The centre of tilt relative to the principal point, in mm along columns and upwards.
    fn centre_from_principal(&self) -> [f64; 2] {
        self.millimetres(self.tilt_centre_px, self.principal_point_px)
    }

    fn millimetres(&self, at: [f64; 2], from: [f64; 2]) -> [f64; 2] {
        [
            (at[0] - from[0]) * self.pixel_mm[0],
            (from[1] - at[1]) * self.pixel_mm[1],
        ]
    }

    /// Distance along the optical axis from the plane through the centre of tilt to the pupil.
    fn depth(&self, distance: f64) -> f64 {
        let [x, y] = self.centre_from_principal();
        (distance * distance - x * x - y * y).sqrt()
    }

    /// Converts from the axes of an aimed camera (columns, up, optical axis) to those of one aimed
    /// at the centre of tilt, by the shortest rotation; `back` converts the other way.
    fn turned(&self, distance: f64, w: Vector3<f64>, back: bool) -> Vector3<f64> {
        let [x, y] = self.centre_from_principal();
        if x == 0.0 && y == 0.0 {
            return w;
        }
        // The pupil relative to the centre of tilt, in the aimed camera's axes.
        let pupil = Vector3::new(-x, -y, self.depth(distance)) / distance;
        let straight = Vector3::z();
        let (from, to) = match back {
            false => (pupil, straight),
            true => (straight, pupil),
        };
        let axis = from.cross(&to);
        w + axis.cross(&w) + axis.cross(&axis.cross(&w)) / (1.0 + from.dot(&to))
    }

    /// The ray of a pixel at a true tilt: a point on it and its downward direction.
    #[must_use]
    pub fn ray(&self, column: f64, row: f64, theta_c: Angle) -> (Vector3<f64>, Vector3<f64>) {
        let axes = Axes::at(theta_c);
        match self.camera_mm {
            None => {
                let [x, y] = self.millimetres([column, row], self.tilt_centre_px);
                let place = axes.to_rig(Vector3::new(x, y, 0.0));
                (place, -axes.to_rig(Vector3::z()))
            }
            Some(distance) => {
                let [x, y] = self.millimetres([column, row], self.principal_point_px);
                let ray = Vector3::new(x, y, -self.depth(distance));
                let ray = axes.to_rig(self.turned(distance, ray, false));
                (axes.to_rig(Vector3::z()) * distance, ray)
            }
        }
    }

    /// The place of the sample's plane imaged at a column and row, in mm from the centre of tilt.
    #[must_use]
    pub fn place(&self, column: f64, row: f64, theta_c: Angle) -> [f64; 2] {
        let (from, ray) = self.ray(column, row, theta_c);
        let along = -from.z / ray.z;
        [from.x + along * ray.x, from.y + along * ray.y]
    }

    /// The column and row at which a place of the sample's plane is imaged.
    #[must_use]
    pub fn pixel(&self, place: [f64; 2], theta_c: Angle) -> [f64; 2] {
        let axes = Axes::at(theta_c);
        let place = Vector3::new(place[0], place[1], 0.0);
        let (from, [x, y]) = match self.camera_mm {
            None => {
                let w = axes.of_rig(place);
                (self.tilt_centre_px, [w.x, w.y])
            }
            Some(distance) => {
                let w = axes.of_rig(place) - Vector3::z() * distance;
                let w = self.turned(distance, w, true);
                let scale = -self.depth(distance) / w.z;
                (self.principal_point_px, [w.x * scale, w.y * scale])
            }
        };
        [
            from[0] + x / self.pixel_mm[0],
            from[1] - y / self.pixel_mm[1],
        ]
    }

    /// How far the half vector turns to either side along both axes of a piece of the sample's plane, whose places are given
    /// from −1 to 1, in rad.
    #[must_use]
    pub fn half_vector_turns(
        &self,
        theta_c: Angle,
        place: &dyn Fn([f64; 2]) -> [f64; 2],
    ) -> [f64; 2] {
        let half_vector = |at| {
            let (directions, _) = self.at(place(at), theta_c);
            (directions.incident + directions.outgoing).normalize()
        };
        let turn = |one, other| 0.5 * half_vector(one).angle(&half_vector(other));
        [turn([-1.0, 0.0], [1.0, 0.0]), turn([0.0, -1.0], [0.0, 1.0])]
    }

    /// The foot of the rotation axis, in mm from the centre of tilt.
    #[must_use]
    pub fn axis_mm(&self) -> [f64; 2] {
        let [column, row] = self.rotation_axis_px;
        self.place(column, row, Angle::ZERO)
    }

    /// Converts a place of the sample, in mm from the rotation axis along the sample's own axes, to
    /// the rig's frame at `azimuth`.
    #[must_use]
    pub fn on_rig(&self, [x, y]: [f64; 2], azimuth: Angle) -> [f64; 2] {
        let (sin, cos) = azimuth.sin_cos();
        let [ax, ay] = self.axis_mm();
        [ax + x * cos - y * sin, ay + x * sin + y * cos]
    }

    /// Directions towards lamp and camera in the rig's frame at a place, and the irradiance there
    /// on a surface facing the lamp, relative to the centre of tilt.
    #[must_use]
    pub fn at(&self, place: [f64; 2], theta_c: Angle) -> (Directions, f64) {
        self.at_point(Vector3::new(place[0], place[1], 0.0), theta_c)
    }

    /// As [`Imaging::at`], for a place that need not be in the sample's plane.
    #[must_use]
    pub fn at_point(&self, place: Vector3<f64>, theta_c: Angle) -> (Directions, f64) {
        let far = self.rig.rig_directions(theta_c);
        let towards = |direction: Vector3<f64>, distance: Option<f64>| match distance {
            None => (direction, 1.0),
            Some(distance) => {
                let ray = direction * distance - place;
                let length = ray.norm();
                (ray / length, (distance / length).powi(2))
            }
        };
        let (incident, irradiance) = towards(far.incident, self.light_mm);
        let (outgoing, _) = towards(far.outgoing, self.camera_mm);
        (Directions { incident, outgoing }, irradiance)
    }

    /// Pixels per area of the sample at a place, relative to other places: the solid angle of the
    /// area times the stretch of a plane sensor away from its principal point.
    #[must_use]
    pub fn pixels_per_area(&self, place: [f64; 2], theta_c: Angle) -> f64 {
        let Some(distance) = self.camera_mm else {
            return 1.0;
        };
        let axes = Axes::at(theta_c);
        let optical = axes.to_rig(self.turned(distance, Vector3::z(), false));
        let pupil = axes.to_rig(Vector3::z()) * distance;
        let ray = pupil - Vector3::new(place[0], place[1], 0.0);
        let length = ray.norm();
        ray.z / length.powi(3) / (optical.dot(&ray) / length).powi(3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 128 × 100 pixels of 0.4 mm; the centre of tilt and the rotation axis are off centre.
    fn imaging(camera_mm: Option<f64>, principal: [f64; 2]) -> Imaging {
        Imaging {
            rig: RigGeometry::IN_PLANE,
            pixel_mm: [0.4, 0.5],
            tilt_centre_px: [60.0, 55.0],
            principal_point_px: principal,
            rotation_axis_px: [70.0, 45.0],
            camera_mm,
            light_mm: Some(250.0),
        }
    }

    fn all() -> [Imaging; 3] {
        [
            imaging(None, [60.0, 55.0]),
            imaging(Some(300.0), [60.0, 55.0]),
            imaging(Some(300.0), [85.0, 20.0]),
        ]
    }

    #[test]
    fn a_place_is_imaged_at_the_pixel_whose_ray_meets_it() {
        for imaging in all() {
            for tilt in [-40.0, 0.0, 25.0] {
                let theta_c = Angle::from_deg(tilt);
                for (column, row) in [(3.5, 90.0), (64.0, 50.0), (120.0, 10.5)] {
                    let place = imaging.place(column, row, theta_c);
                    let [c, r] = imaging.pixel(place, theta_c);
                    assert!((c - column).abs() < 1e-9 && (r - row).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn the_centre_of_tilt_is_imaged_at_its_pixel_at_every_tilt_and_the_axis_at_its_pixel_at_tilt_0()
    {
        for imaging in all() {
            for tilt in [-30.0, 0.0, 30.0] {
                let [x, y] = imaging.place(60.0, 55.0, Angle::from_deg(tilt));
                assert!(x.hypot(y) < 1e-12, "{x} {y}");
            }
            let axis = imaging.axis_mm();
            let at = |tilt: f64| imaging.pixel(axis, Angle::from_deg(tilt));
            assert!((at(0.0)[0] - 70.0).abs() < 1e-9 && (at(0.0)[1] - 45.0).abs() < 1e-9);
            assert!((at(30.0)[0] - 70.0).abs() > 1.0);
        }
    }

    #[test]
    fn an_aimed_camera_keeps_its_pupil_and_looks_along_its_own_axis() {
        let [_, straight, aimed] = all();
        let theta_c = Angle::from_deg(20.0);
        let ((pupil, along), (other, _)) = (
            aimed.ray(85.0, 20.0, theta_c),
            straight.ray(85.0, 20.0, theta_c),
        );
        assert!((pupil - other).norm() < 1e-12);
        // The scale is defined in the plane through C perpendicular to the optical axis: one column
        // there is 0.4 mm.
        let depth = -pupil.dot(&along.normalize());
        let there = |column: f64, row: f64| {
            let (_, ray) = aimed.ray(column, row, theta_c);
            pupil + ray * (depth / ray.dot(&along.normalize()))
        };
        let step = (there(86.0, 20.0) - there(85.0, 20.0)).norm();
        let down = (there(85.0, 21.0) - there(85.0, 20.0)).norm();
        assert!((step - 0.4).abs() < 1e-9 && (down - 0.5).abs() < 1e-9);
        let centre = there(60.0, 55.0);
        assert!(centre.norm() < 1e-9, "{centre}");
        // A pixel far from the centre images another place than with a camera aimed at C.
        let far = |imaging: &Imaging| imaging.place(5.0, 95.0, theta_c);
        let (a, b) = (far(&straight), far(&aimed));
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) > 0.2, "{a:?} {b:?}");
    }

    #[test]
    fn pixels_per_area_agrees_with_the_area_of_a_pixel() {
        let theta_c = Angle::from_deg(20.0);
        for near in all() {
            let share = |column: f64, row: f64| {
                let step = 1e-3;
                let at = |c: f64, r: f64| near.place(column + c, row + r, theta_c);
                let ([ax, ay], [bx, by]) = (at(-step, 0.0), at(step, 0.0));
                let ([cx, cy], [dx, dy]) = (at(0.0, -step), at(0.0, step));
                let area = ((bx - ax) * (dy - cy) - (by - ay) * (dx - cx)).abs();
                area * near.pixels_per_area(near.place(column, row, theta_c), theta_c)
            };
            let middle = share(64.0, 50.0);
            for (column, row) in [(0.0, 0.0), (128.0, 0.0), (10.0, 90.0), (128.0, 100.0)] {
                let there = share(column, row);
                assert!((there / middle - 1.0).abs() < 1e-6, "{column} {row}");
            }
        }
        // The density is not constant.
        let density = |at: [f64; 2]| all()[1].pixels_per_area(at, theta_c);
        assert!((density([20.0, 0.0]) / density([-20.0, 0.0]) - 1.0).abs() > 0.05);
    }

    #[test]
    fn a_distant_camera_is_the_limit_of_a_near_one() {
        let theta = Angle::from_deg(-12.0);
        let far = Imaging {
            light_mm: None,
            ..imaging(None, [60.0, 55.0])
        };
        let near = Imaging {
            camera_mm: Some(1e7),
            light_mm: Some(1e7),
            ..far
        };
        for (column, row) in [(0.0, 0.0), (100.0, 80.0)] {
            let (a, b) = (
                far.place(column, row, theta),
                near.place(column, row, theta),
            );
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-3);
            let ((da, ea), (db, eb)) = (far.at(a, theta), near.at(b, theta));
            assert!((da.incident - db.incident).norm() < 1e-5 && (ea - eb).abs() < 1e-5);
            assert!((da.outgoing - db.outgoing).norm() < 1e-5);
        }
    }

    #[test]
    fn the_sample_turns_about_its_axis_and_not_about_the_centre_of_tilt() {
        for imaging in all() {
            let axis = imaging.axis_mm();
            let there = imaging.on_rig([3.0, -2.0], Angle::from_deg(90.0));
            assert!((there[0] - axis[0] - 2.0).abs() < 1e-12);
            assert!((there[1] - axis[1] - 3.0).abs() < 1e-12);
        }
    }
}
