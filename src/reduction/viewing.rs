//! Where a pixel looks and from where that point is lit, for cameras and lamps near and far.
//!
//! Rig frame, millimetres from the centre of tilt, which is where the rotation axis meets the
//! sample (z = 0). A far camera sees along (sin θc, 0, cos θc), its columns along (cos θc, 0,
//! −sin θc), its rows along −y. A near one sees through a pupil at its distance in that direction;
//! the field's size is that in the plane through the centre of tilt, across the view.

use nalgebra::Vector3;

use super::calibration::Prepared;
use super::region::{Board, Segments};
use crate::geometry::{Directions, Pose, RigGeometry};
use crate::observation::View;
use crate::series::Manifest;
use crate::units::Angle;

/// Gauss–Legendre nodes and weights on (−1, 1).
const SIX: [(f64, f64); 6] = [
    (-0.932_469_514_203_152, 0.171_324_492_379_170_35),
    (-0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (-0.238_619_186_083_196_9, 0.467_913_934_572_691),
    (0.238_619_186_083_196_9, 0.467_913_934_572_691),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (0.932_469_514_203_152, 0.171_324_492_379_170_35),
];
const TWO: [(f64, f64); 2] = [
    (-0.577_350_269_189_625_8, 1.0),
    (0.577_350_269_189_625_8, 1.0),
];

/// Half of what the half vector turns (rad) over a piece of the field that six nodes along it, or two, stand for: a lobe of
/// α = 0.05 is summed within some 3e-4 of its top then.
const SIX_REACH: f64 = 0.09;
const TWO_REACH: f64 = 0.03;
/// Pieces along one axis at most.
const PIECES_MAX: usize = 6;

/// The pixels of a segment that an observation is the mean of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Part {
    /// How many; none where the segment is left out.
    pub(super) pixels: f64,
    /// Their mean column and row; whole numbers are corners.
    pub(super) middle_px: [f64; 2],
}

/// The rig as the pixels see it.
#[derive(Debug, Clone)]
pub(super) struct Viewing {
    rig: RigGeometry,
    width: usize,
    height: usize,
    pixel_mm: [f64; 2],
    axis_px: [f64; 2],
    camera_mm: Option<f64>,
    light_mm: Option<f64>,
}

impl Viewing {
    /// `None` where a near camera or lamp is stated without the field's size.
    pub(super) fn new(manifest: &Manifest) -> Option<Viewing> {
        let camera = &manifest.camera;
        let (width, height) = (f64::from(camera.width_px), f64::from(camera.height_px));
        let far = manifest.is_telecentric();
        let near = |distance: Option<f64>| distance.filter(|_| !far);
        let camera_mm = near(manifest.camera_distance_mm());
        let light_mm = near(manifest.rig.light_distance_mm);
        let column_mm = match camera.field_width_mm {
            Some(field) => field / width,
            None if camera_mm.is_none() && light_mm.is_none() => 1.0,
            None => return None,
        };
        Some(Viewing {
            rig: manifest.rig_geometry(),
            width: camera.width_px as usize,
            height: camera.height_px as usize,
            pixel_mm: [
                column_mm,
                camera.field_height_mm.map_or(column_mm, |h| h / height),
            ],
            axis_px: manifest
                .rig
                .rotation_axis_px
                .unwrap_or([0.5 * width, 0.5 * height]),
            camera_mm,
            light_mm,
        })
    }

    /// Whether all pixels share directions and irradiance.
    pub(super) fn is_far(&self) -> bool {
        self.camera_mm.is_none() && self.light_mm.is_none()
    }

    /// The point of the sample's plane that shows at a column and row; whole numbers are corners.
    pub(super) fn point(&self, column: f64, row: f64, theta_c: Angle) -> [f64; 2] {
        let across = (column - self.axis_px[0]) * self.pixel_mm[0];
        let down = (row - self.axis_px[1]) * self.pixel_mm[1];
        let (sin, cos) = theta_c.sin_cos();
        match self.camera_mm {
            None => [across / cos, -down],
            Some(distance) => {
                // From the pupil through (across · a − down · y) to z = 0.
                let depth = distance * cos;
                let along = depth / (depth + across * sin);
                let x = distance * sin + along * (across * cos - distance * sin);
                [x, -along * down]
            }
        }
    }

    /// Directions at a point of the sample's plane and the irradiance on a surface facing the lamp,
    /// relative to the centre's.
    pub(super) fn at(&self, point: [f64; 2], theta_c: Angle) -> (Directions, f64) {
        let far = self.rig.rig_directions(theta_c);
        let place = Vector3::new(point[0], point[1], 0.0);
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

    /// Brightness of a white plane at a pixel, relative to the centre.
    fn white(&self, pixel: usize, theta_c: Angle) -> f64 {
        let column = (pixel % self.width) as f64 + 0.5;
        let row = (pixel / self.width) as f64 + 0.5;
        let (directions, irradiance) = self.at(self.point(column, row, theta_c), theta_c);
        irradiance * directions.incident.z.max(0.0) / self.rig.cos_incidence(theta_c)
    }

    /// Takes the lamp's pattern out of the response, which then is the camera's alone, and brings
    /// the flats' levels to the centre of tilt.
    pub(super) fn take_out_lamp(&self, camera: &mut Prepared) {
        if self.light_mm.is_none() || camera.flats.levels.is_empty() {
            return;
        }
        let flats = &mut camera.flats;
        let whole: f64 = flats.levels.iter().map(|l| l.rate_dn_s).sum();
        let response = &mut flats.response;
        for (pixel, r) in response.pixels.iter_mut().enumerate() {
            let pattern: f64 = flats
                .levels
                .iter()
                .map(|l| l.rate_dn_s / whole * self.white(pixel, l.theta_c))
                .sum();
            *r = (f64::from(*r) / pattern.max(1e-6)) as f32;
        }
        let good = || (0..response.good.len()).filter(|p| response.good[*p]);
        let n = good().count().max(1) as f64;
        let mean = good().map(|p| f64::from(response.pixels[p])).sum::<f64>() / n;
        let levels: Vec<f64> = flats
            .levels
            .iter()
            .map(|l| {
                good()
                    .map(|p| f64::from(response.pixels[p]) / mean * self.white(p, l.theta_c))
                    .sum::<f64>()
                    / n
            })
            .collect();
        for r in &mut response.pixels {
            *r = (f64::from(*r) / mean) as f32;
        }
        for (level, share) in flats.levels.iter_mut().zip(levels) {
            level.rate_dn_s /= share;
            level.sigma_dn_s /= share;
        }
        camera.settle_unit(&self.rig);
    }

    /// The directions over which an observation at a recorded pose averages; `parts` are its segments.
    pub(super) fn views(&self, segments: &Segments, pose: Pose, parts: &[Part]) -> Vec<View> {
        let theta_c = pose.theta_c;
        let mut places = Vec::new();
        match segments {
            Segments::Whole => {
                let place = |[a, b]: [f64; 2]| {
                    let column = 0.5 * (1.0 + a) * self.width as f64;
                    let row = 0.5 * (1.0 + b) * self.height as f64;
                    self.point(column, row, theta_c)
                };
                let pieces = self.pieces(&place, theta_c, SIX_REACH);
                let nodes = nodes(&SIX, pieces);
                places.extend(nodes.map(|(at, share)| (place(at), share)));
            }
            Segments::Patches { board, patches } => {
                for ((i, j), part) in patches.iter().zip(parts).filter(|(_, p)| p.pixels > 0.0) {
                    let place = |at| Self::on_board(board, pose, (*i, *j), at);
                    let pieces = self.pieces(&place, theta_c, TWO_REACH);
                    // Levels are means over pixels, and what is nearer has more of them.
                    let mut patch: Vec<([f64; 2], f64)> = nodes(&TWO, pieces)
                        .map(|(at, share)| {
                            let point = place(at);
                            (point, share * self.pixels_per_area(point, theta_c))
                        })
                        .collect();
                    let shift = board.placement.axis_px;
                    let [column, row] = [0, 1].map(|k| part.middle_px[k] - shift[k]);
                    weigh(&mut patch, part.pixels, self.point(column, row, theta_c));
                    places.extend(patch);
                }
            }
        }
        let all: f64 = places.iter().map(|(_, share)| share).sum();
        let view = |(point, share): &([f64; 2], f64)| {
            let (directions, irradiance) = self.at(*point, theta_c);
            View {
                directions,
                weight: share / all * irradiance,
            }
        };
        places.iter().map(view).collect()
    }

    /// Pixels per area of the sample at a point, relative to other points: the solid angle of the area, and the
    /// stretch of a plane sensor away from its middle.
    fn pixels_per_area(&self, point: [f64; 2], theta_c: Angle) -> f64 {
        let Some(distance) = self.camera_mm else {
            return 1.0;
        };
        let axis = self.rig.rig_directions(theta_c).outgoing;
        let ray = axis * distance - Vector3::new(point[0], point[1], 0.0);
        let length = ray.norm();
        ray.z / length.powi(3) / (axis.dot(&ray) / length).powi(3)
    }

    /// Pieces along both axes of a part of the field, its places given from −1 to 1, none of which turns the half vector
    /// by more than `reach` to either side.
    fn pieces(
        &self,
        place: &dyn Fn([f64; 2]) -> [f64; 2],
        theta_c: Angle,
        reach: f64,
    ) -> [usize; 2] {
        let half_vector = |at| {
            let (directions, _) = self.at(place(at), theta_c);
            (directions.incident + directions.outgoing).normalize()
        };
        let across = |one, other| {
            let turned = 0.5 * half_vector(one).angle(&half_vector(other));
            ((turned / reach).ceil() as usize).clamp(1, PIECES_MAX)
        };
        [
            across([-1.0, 0.0], [1.0, 0.0]),
            across([0.0, -1.0], [0.0, 1.0]),
        ]
    }

    /// A point of a patch, `at` from −1 to 1 across its inner part, in the rig's frame.
    fn on_board(board: &Board, pose: Pose, (i, j): (u32, u32), at: [f64; 2]) -> [f64; 2] {
        let size = board.layout.patch_size_mm;
        let inner = 0.5 * size - board.margin_mm();
        let counts = [board.layout.patches_x, board.layout.patches_y];
        let index = [i, j];
        let [x, y] = [0, 1].map(|k| {
            board.layout.centre_mm[k]
                + board.placement.centre_mm[k]
                + size * (f64::from(index[k]) + 0.5 - 0.5 * f64::from(counts[k]))
                + inner * at[k]
        });
        let (sin, cos) = board.azimuth(pose).sin_cos();
        [x * cos - y * sin, x * sin + y * cos]
    }
}

/// Gives a patch's nodes the weight of its pixels and moves them to where those have their middle: a row of pixels more or
/// less along an edge moves that by half a pixel, in many patches alike.
fn weigh(patch: &mut [([f64; 2], f64)], pixels: f64, middle: [f64; 2]) {
    let all: f64 = patch.iter().map(|(_, share)| share).sum();
    let mean = [0, 1].map(|k| patch.iter().map(|(p, share)| share * p[k]).sum::<f64>() / all);
    for (point, share) in patch {
        for k in 0..2 {
            point[k] += middle[k] - mean[k];
        }
        *share *= pixels / all;
    }
}

/// Places from −1 to 1 along both axes, cut into pieces with nodes each, and their shares.
fn nodes(rule: &[(f64, f64)], pieces: [usize; 2]) -> impl Iterator<Item = ([f64; 2], f64)> {
    let along = |pieces: usize| -> Vec<(f64, f64)> {
        let width = 1.0 / pieces as f64;
        let middle = move |piece: usize| (2 * piece + 1) as f64 * width - 1.0;
        let of = |piece| {
            rule.iter()
                .map(move |(x, w)| (middle(piece) + width * x, 0.5 * width * w))
        };
        (0..pieces).flat_map(of).collect()
    };
    let (first, second) = (along(pieces[0]), along(pieces[1]));
    first.into_iter().flat_map(move |(a, wa)| {
        let row: Vec<_> = second.iter().map(|(b, wb)| ([a, *b], wa * wb)).collect();
        row
    })
}

#[cfg(test)]
mod tests {
    use super::super::region::Region;
    use super::*;

    fn viewing(camera_mm: Option<f64>, light_mm: Option<f64>) -> Viewing {
        Viewing {
            rig: RigGeometry::IN_PLANE,
            width: 128,
            height: 100,
            pixel_mm: [0.4, 0.4],
            axis_px: [64.0, 50.0],
            camera_mm,
            light_mm,
        }
    }

    #[test]
    fn pixels_lie_as_densely_on_the_sample_as_their_corners_say() {
        let near = viewing(Some(250.0), None);
        let theta_c = Angle::from_deg(20.0);
        let share = |column: f64, row: f64| {
            let step = 1e-3;
            let at = |c: f64, r: f64| near.point(column + c, row + r, theta_c);
            let ([ax, ay], [bx, by]) = (at(-step, 0.0), at(step, 0.0));
            let ([cx, cy], [dx, dy]) = (at(0.0, -step), at(0.0, step));
            let area = ((bx - ax) * (dy - cy) - (by - ay) * (dx - cx)).abs();
            area * near.pixels_per_area(near.point(column, row, theta_c), theta_c)
        };
        let middle = share(64.0, 50.0);
        for (column, row) in [(0.0, 0.0), (128.0, 0.0), (10.0, 90.0), (128.0, 100.0)] {
            let there = share(column, row);
            assert!(
                (there / middle - 1.0).abs() < 1e-6,
                "{column} {row} {there} {middle}"
            );
        }
        // And not because it is even.
        let density = |at: [f64; 2]| near.pixels_per_area(at, theta_c);
        assert!((density([20.0, 0.0]) / density([-20.0, 0.0]) - 1.0).abs() > 0.05);
    }

    #[test]
    fn the_views_of_a_very_near_rig_sum_a_narrow_lobe_as_its_pixels_do() {
        let near = viewing(Some(150.0), Some(150.0));
        let theta_c = Angle::from_deg(10.0);
        // A lobe of α = 0.05 about a direction a third of the way to the field's edge.
        let seen = |d: &Directions| {
            let h = (d.incident + d.outgoing).normalize();
            let (x, y) = (h.x / h.z - 0.3, h.y / h.z + 0.05);
            (-(x * x + y * y) / (0.05 * 0.05)).exp()
        };
        let pose = Pose {
            theta_c,
            phi_s: Angle::ZERO,
        };
        let views = near.views(&Segments::Whole, pose, &[]);
        let by_views: f64 = views.iter().map(|v| v.weight * seen(&v.directions)).sum();
        let per_pixel = 4;
        let (columns, rows) = (near.width * per_pixel, near.height * per_pixel);
        let at = |k: usize| (k as f64 + 0.5) / per_pixel as f64;
        let places =
            (0..columns * rows).map(|k| near.point(at(k % columns), at(k / columns), theta_c));
        let by_pixels = places
            .map(|place| {
                let (directions, irradiance) = near.at(place, theta_c);
                irradiance * seen(&directions)
            })
            .sum::<f64>()
            / (columns * rows) as f64;
        assert!(by_pixels > 0.01, "{by_pixels}");
        assert!(
            (by_views - by_pixels).abs() < 3e-4,
            "{by_views} {by_pixels}"
        );
        let far = viewing(Some(1000.0), Some(1000.0));
        assert_eq!(far.views(&Segments::Whole, pose, &[]).len(), 36);
    }

    #[test]
    fn what_no_reduction_can_use_is_refused_before_a_frame_is_read() {
        use super::super::{FrameSource, ReductionError, check, synthetic::Memory};
        use crate::frame::FrameKind;
        use crate::series::FrameRow;
        let manifest = include_str!("../../tests/data/series/polymer-10/manifest.toml");
        let row = |kind| FrameRow {
            file: "frames/1.png".to_owned(),
            kind,
            theta_c_deg: 0.0,
            phi_s_deg: 0.0,
            exposure_s: 0.1,
            repeat: 0,
            timestamp: String::new(),
        };
        let of = |kind, near: bool| {
            let mut manifest = Manifest::from_toml(manifest, "manifest.toml").unwrap();
            if near {
                manifest.camera.projection = "perspective".to_owned();
                manifest.camera.field_width_mm = None;
            }
            let series = Memory {
                manifest,
                rows: vec![row(kind)],
                frames: vec![None],
            };
            check(&series as &dyn FrameSource)
        };
        assert!(of(FrameKind::Sample, false).is_ok());
        assert!(matches!(
            of(FrameKind::Sample, true),
            Err(ReductionError::FieldUnknown { .. })
        ));
        assert!(matches!(
            of(FrameKind::Flat, false),
            Err(ReductionError::NoObservations { .. })
        ));
    }

    #[test]
    fn a_ray_through_a_pixel_meets_the_sample_where_it_should() {
        let near = viewing(Some(300.0), Some(250.0));
        let theta = Angle::from_deg(25.0);
        let (sin, cos) = theta.sin_cos();
        for (column, row) in [(3.5, 90.0), (64.0, 50.0), (120.0, 10.5)] {
            let [x, y] = near.point(column, row, theta);
            // Seen from the pupil, the point lies where the pixel lies in the plane across the view.
            let pupil = Vector3::new(300.0 * sin, 0.0, 300.0 * cos);
            let ray = Vector3::new(x, y, 0.0) - pupil;
            let scale = 300.0 / -ray.dot(&pupil) * 300.0;
            let plane = pupil + ray * scale;
            let across = plane.dot(&Vector3::new(cos, 0.0, -sin));
            assert!((across - (column - 64.0) * 0.4).abs() < 1e-9);
            assert!((plane.y + (row - 50.0) * 0.4).abs() < 1e-9);
            assert!(plane.dot(&pupil).abs() < 1e-6);
        }
    }

    #[test]
    fn far_is_the_limit_of_near() {
        let theta = Angle::from_deg(-12.0);
        let far = viewing(None, None);
        let near = viewing(Some(1e7), Some(1e7));
        for (column, row) in [(0.0, 0.0), (100.0, 80.0)] {
            let (a, b) = (
                far.point(column, row, theta),
                near.point(column, row, theta),
            );
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-3);
            let ((da, ea), (db, eb)) = (far.at(a, theta), near.at(b, theta));
            assert!((da.incident - db.incident).norm() < 1e-5 && (ea - eb).abs() < 1e-5);
            assert!((da.outgoing - db.outgoing).norm() < 1e-5);
        }
    }

    #[test]
    fn views_average_a_smooth_light_over_the_field() {
        let near = viewing(Some(300.0), Some(250.0));
        let pose = Pose::from_deg(10.0, 0.0);
        let light = |d: &Directions| (-((d.incident.x - 0.3) / 0.08).powi(2)).exp() + d.outgoing.y;
        let views = near.views(&Segments::Whole, pose, &[]);
        let seen: f64 = views.iter().map(|v| v.weight * light(&v.directions)).sum();
        let mut sum = 0.0;
        for pixel in 0..128 * 100 {
            let (c, r) = (f64::from(pixel % 128) + 0.5, f64::from(pixel / 128) + 0.5);
            let (d, e) = near.at(near.point(c, r, pose.theta_c), pose.theta_c);
            sum += e * light(&d) / 12_800.0;
        }
        assert!((seen / sum - 1.0).abs() < 2e-4, "{seen} {sum}");
    }

    #[test]
    fn views_of_a_coarse_board_are_those_of_the_pixels_that_its_patches_have() {
        use super::super::region::NOWHERE;
        let text = include_str!("../../tests/data/series/checker/manifest.toml")
            .replace("\"infinity\"", "\"finite\"")
            .replace(
                "[rig]",
                "[rig]\nlight_distance_mm = 250.0\nlight_radius_mm = 5.0\ncamera_distance_mm = 300.0",
            )
            .replace("light_angular_radius_deg = 1.0", "")
            .replace("orthographic", "perspective")
            .replace("_px = 256", "_px = 120")
            .replace("[128.0, 128.0]", "[60.0, 60.0]");
        let manifest = Manifest::from_toml(&text, "").unwrap();
        let near = Viewing::new(&manifest).unwrap();
        let board = Board::new(&manifest, manifest.sample.layout.as_ref().unwrap());
        let segments = Segments::of_region(board, Region::Even);
        for pose in [Pose::from_deg(-10.0, 180.0), Pose::from_deg(20.0, 0.0)] {
            let light = |d: &Directions| {
                let h = (d.incident + d.outgoing).normalize();
                (-((h.x / h.z - pose.theta_c.rad() - 0.1) / 0.12).powi(2)).exp()
            };
            let labels = segments.labels(pose, &[true; 120 * 120]);
            let mut parts = vec![
                Part {
                    pixels: 0.0,
                    middle_px: [0.0; 2],
                };
                segments.len()
            ];
            let mut sum = 0.0;
            for (pixel, label) in labels.iter().enumerate().filter(|(_, l)| **l != NOWHERE) {
                let at = [(pixel % 120) as f64 + 0.5, (pixel / 120) as f64 + 0.5];
                let (d, e) = near.at(near.point(at[0], at[1], pose.theta_c), pose.theta_c);
                sum += e * light(&d);
                let part = &mut parts[*label as usize];
                part.pixels += 1.0;
                part.middle_px = [part.middle_px[0] + at[0], part.middle_px[1] + at[1]];
            }
            for part in &mut parts {
                part.middle_px = part.middle_px.map(|sum| sum / part.pixels);
            }
            let of_views = |parts: &[Part]| -> f64 {
                let views = near.views(&segments, pose, parts);
                views.iter().map(|v| v.weight * light(&v.directions)).sum()
            };
            let seen = sum / parts.iter().map(|p| p.pixels).sum::<f64>();
            let off = of_views(&parts) / seen - 1.0;
            assert!(off.abs() < 5e-4, "{off}");
        }
    }
}
