//! Which place of the sample a pixel sees, and from where that place is lit and seen.
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
//! Rig frame, millimetres from the centre of tilt C: the point of the sample on which camera and lamp are centred while they
//! tilt. Distances, directions and irradiance hang on C alone. Q is where the rotation axis meets the sample: what is known
//! of a place *on the sample* (patches, maps) turns about Q. The principal point c0 is the foot of the optical axis: it is C
//! where the camera is aimed at C, and matters to a near camera alone, whose scale is that of the plane through C across the
//! optical axis. A lens shifted against its sensor needs nothing: the image plane stays across P − C.
//!
//! A far camera sees along (sin θc, 0, cos θc), its columns follow a = (cos θc, 0, −sin θc), its rows −y. Columns and rows are
//! those of corners: (0, 0) is the outer corner of the first pixel.
//!
//! *Conditioning.* One division by the depth of a ray, which [`Imaging::is_aimed`] and the limits of tilts keep away from 0.

use nalgebra::Vector3;

use super::{Directions, RigGeometry};
use crate::units::Angle;

/// The camera is aimed past the centre of tilt by less than the arc sine of this.
pub const AIM_MAX: f64 = 0.9;

/// Where camera, lamp and turntable stand to one another, and where in the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imaging {
    /// Directions at the centre of tilt.
    pub rig: RigGeometry,
    /// Millimetres per column and per row in the plane through the centre of tilt, across the optical axis.
    pub pixel_mm: [f64; 2],
    /// Column and row of the centre of tilt.
    pub tilt_centre_px: [f64; 2],
    /// Column and row of the foot of the optical axis.
    pub principal_point_px: [f64; 2],
    /// Column and row at which the rotation axis meets the sample at θc = 0.
    pub rotation_axis_px: [f64; 2],
    /// From the centre of tilt to the camera's pupil; `None` for a telecentric lens.
    pub camera_mm: Option<f64>,
    /// From the centre of tilt to the lamp; `None` for a collimated one.
    pub light_mm: Option<f64>,
}

/// Columns' direction, rows' upward direction and the camera's at a tilt.
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
    /// A far camera and a far lamp centred on one pixel.
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

    /// Whether a near camera can be aimed as the points say: past the centre of tilt by less than [`AIM_MAX`] of its
    /// distance.
    #[must_use]
    pub fn is_aimed(&self) -> bool {
        let [x, y] = self.centre_from_principal();
        self.camera_mm
            .is_none_or(|distance| x.hypot(y) < AIM_MAX * distance)
    }

    /// The centre of tilt from the principal point, mm along columns and up.
    fn centre_from_principal(&self) -> [f64; 2] {
        self.millimetres(self.tilt_centre_px, self.principal_point_px)
    }

    fn millimetres(&self, at: [f64; 2], from: [f64; 2]) -> [f64; 2] {
        [
            (at[0] - from[0]) * self.pixel_mm[0],
            (from[1] - at[1]) * self.pixel_mm[1],
        ]
    }

    /// Along the optical axis from the plane through the centre of tilt to the pupil.
    fn depth(&self, distance: f64) -> f64 {
        let [x, y] = self.centre_from_principal();
        (distance * distance - x * x - y * y).sqrt()
    }

    /// From the axes of an aimed camera (columns, up, optical axis) to those of one that looks at the centre of tilt, by the
    /// shortest turn; `back` turns the other way.
    fn turned(&self, distance: f64, w: Vector3<f64>, back: bool) -> Vector3<f64> {
        let [x, y] = self.centre_from_principal();
        if x == 0.0 && y == 0.0 {
            return w;
        }
        // The pupil from the centre of tilt, in the aimed camera's axes.
        let pupil = Vector3::new(-x, -y, self.depth(distance)) / distance;
        let straight = Vector3::z();
        let (from, to) = match back {
            false => (pupil, straight),
            true => (straight, pupil),
        };
        let axis = from.cross(&to);
        w + axis.cross(&w) + axis.cross(&axis.cross(&w)) / (1.0 + from.dot(&to))
    }

    /// The ray on which a pixel looks at a true tilt: a point of it and its direction, downwards.
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

    /// The place of the sample's plane that shows at a column and row, mm from the centre of tilt.
    #[must_use]
    pub fn place(&self, column: f64, row: f64, theta_c: Angle) -> [f64; 2] {
        let (from, ray) = self.ray(column, row, theta_c);
        let along = -from.z / ray.z;
        [from.x + along * ray.x, from.y + along * ray.y]
    }

    /// Column and row at which a place of the sample's plane shows.
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

    /// Where the rotation axis meets the sample, mm from the centre of tilt.
    #[must_use]
    pub fn axis_mm(&self) -> [f64; 2] {
        let [column, row] = self.rotation_axis_px;
        self.place(column, row, Angle::ZERO)
    }

    /// A place of the sample, mm from the rotation axis along its own axes, in the rig's frame once it is turned to `azimuth`.
    #[must_use]
    pub fn on_rig(&self, [x, y]: [f64; 2], azimuth: Angle) -> [f64; 2] {
        let (sin, cos) = azimuth.sin_cos();
        let [ax, ay] = self.axis_mm();
        [ax + x * cos - y * sin, ay + x * sin + y * cos]
    }

    /// Directions towards lamp and camera in the rig's frame at a place, and the irradiance there on a surface facing the
    /// lamp, relative to the centre of tilt's.
    #[must_use]
    pub fn at(&self, place: [f64; 2], theta_c: Angle) -> (Directions, f64) {
        self.at_point(Vector3::new(place[0], place[1], 0.0), theta_c)
    }

    /// The same at a place that need not lie in the sample's plane.
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

    /// Pixels per area of the sample at a place, relative to other places: the solid angle of the area, and the stretch of a
    /// plane sensor away from its principal point.
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

    /// 128 × 100 pixels of 0.4 mm; centre of tilt, principal point and axis where given.
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
    fn a_place_shows_at_the_pixel_that_sees_it() {
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
    fn the_centre_of_tilt_shows_at_its_own_pixel_at_every_tilt_and_the_axis_at_its_own_at_none() {
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
        // The scale is that of the plane through C across the optical axis: one column there is 0.4 mm.
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
        // And a pixel far off sees another place than through a camera aimed at C.
        let far = |imaging: &Imaging| imaging.place(5.0, 95.0, theta_c);
        let (a, b) = (far(&straight), far(&aimed));
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) > 0.2, "{a:?} {b:?}");
    }

    #[test]
    fn pixels_lie_as_densely_on_the_sample_as_their_corners_say() {
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
        // And not because it is even.
        let density = |at: [f64; 2]| all()[1].pixels_per_area(at, theta_c);
        assert!((density([20.0, 0.0]) / density([-20.0, 0.0]) - 1.0).abs() > 0.05);
    }

    #[test]
    fn far_is_the_limit_of_near() {
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
