//! What the pixels of an observation see: the directions over which it averages, and the lamp's pattern on the white
//! reference. Where a pixel looks is [`Imaging`]'s.

use super::flats::Flats;
use super::refusals::ReductionError;
use super::region::{Board, Segments};
use crate::geometry::field::{NODES_MAX, nodes};
use crate::geometry::{Directions, Field, Pose};
use crate::observation::{View, WholeField};
use crate::series::Manifest;
use crate::units::Angle;

/// Nodes along a patch over which the half vector turns by [`PATCH_TURN`] (rad) to either side, and at least. Other patches are
/// beside it, so that a lobe is summed over all of them.
const PATCH_NODES: usize = 2;
const PATCH_TURN: f64 = 0.03;
/// Width of the narrowest lobe that the views of a whole frame sum right, until a fit knows the lobe.
const TYPICAL_LOBE: f64 = 0.08;

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
pub(super) struct Viewing(Field);

impl Viewing {
    /// Returns the geometry by pixel of the rig of a manifest.
    ///
    /// # Errors
    /// [`ReductionError::FieldUnknown`] where a near camera or lamp is stated without the field's size.
    pub(super) fn of(manifest: &Manifest) -> Result<Viewing, ReductionError> {
        let field = |imaging| Field {
            imaging,
            width: manifest.camera.width_px as usize,
            height: manifest.camera.height_px as usize,
        };
        let viewing = manifest.imaging().map(|imaging| Viewing(field(imaging)));
        viewing
            .filter(|viewing| manifest.is_telecentric() || !viewing.is_far())
            .ok_or_else(|| {
                let rig = &manifest.rig;
                let distance = |word: &Option<String>, mm: Option<f64>| match (word.as_deref(), mm)
                {
                    (Some("infinity"), _) | (None, None) => "infinity".to_owned(),
                    (_, Some(mm)) => format!("{mm} mm"),
                    (Some(word), None) => word.to_owned(),
                };
                ReductionError::FieldUnknown {
                    what: format!(
                        "projection \"{}\", light at {}, camera at {}",
                        manifest.camera.projection,
                        distance(&rig.light_distance, rig.light_distance_mm),
                        distance(&rig.camera_distance, manifest.camera_distance_mm()),
                    ),
                }
            })
    }

    /// Whether all pixels share directions and irradiance.
    pub(super) fn is_far(&self) -> bool {
        self.0.imaging.is_far()
    }

    /// The point of the sample's plane that shows at a column and row; whole numbers are corners.
    pub(super) fn point(&self, column: f64, row: f64, theta_c: Angle) -> [f64; 2] {
        self.0.imaging.place(column, row, theta_c)
    }

    /// Directions at a point of the sample's plane and the irradiance on a surface facing the lamp,
    /// relative to the centre's.
    pub(super) fn at(&self, point: [f64; 2], theta_c: Angle) -> (Directions, f64) {
        self.0.imaging.at(point, theta_c)
    }

    /// Brightness of a white plane at a pixel, relative to the centre.
    fn white(&self, pixel: usize, theta_c: Angle) -> f64 {
        let column = (pixel % self.0.width) as f64 + 0.5;
        let row = (pixel / self.0.width) as f64 + 0.5;
        let (directions, irradiance) = self.at(self.point(column, row, theta_c), theta_c);
        irradiance * directions.incident.z.max(0.0) / self.0.imaging.rig.cos_incidence(theta_c)
    }

    /// Takes the lamp's pattern out of the response, which then is the camera's alone, and brings
    /// the flats' levels to the centre of tilt.
    pub(super) fn take_out_lamp(&self, flats: &mut Flats) {
        if self.0.imaging.light_mm.is_none() || flats.levels.is_empty() {
            return;
        }
        let whole: f64 = flats.levels.iter().map(|l| l.rate_dn_s).sum();
        let response = &mut flats.response;
        response.flat = Some(response.pixels.clone());
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
        for (level, share) in flats.levels.iter_mut().zip(&levels) {
            level.rate_dn_s /= share;
            level.sigma_dn_s /= share;
        }
        flats.lamp_shares = levels;
    }

    /// The frame whose pixels an observation averages over, all of them, and the narrowest lobe that its views sum right.
    pub(super) fn whole_field(&self, segments: &Segments) -> Option<WholeField> {
        let whole = matches!(segments, Segments::Whole) && !self.is_far();
        whole.then_some(WholeField {
            field: self.0,
            narrowest: TYPICAL_LOBE,
        })
    }

    /// The directions over which an observation at a recorded pose averages; `parts` are its segments.
    pub(super) fn views(&self, segments: &Segments, pose: Pose, parts: &[Part]) -> Vec<View> {
        match segments {
            Segments::Whole => {
                let views = self.0.views(pose.theta_c, TYPICAL_LOBE);
                views.into_iter().map(View::from).collect()
            }
            Segments::Patches { board, patches } => self.of_patches(board, patches, pose, parts),
        }
    }

    fn of_patches(
        &self,
        board: &Board,
        patches: &[(u32, u32)],
        pose: Pose,
        parts: &[Part],
    ) -> Vec<View> {
        let theta_c = pose.theta_c;
        let mut places = Vec::new();
        for ((i, j), part) in patches.iter().zip(parts).filter(|(_, p)| p.pixels > 0.0) {
            let place = |at| Self::on_board(board, pose, (*i, *j), at);
            let turns = self.0.imaging.half_vector_turns(theta_c, &place);
            let [columns, rows] = turns.map(|turn| {
                let due = (turn / PATCH_TURN * PATCH_NODES as f64).ceil() as usize;
                due.clamp(PATCH_NODES, NODES_MAX)
            });
            // Levels are means over pixels, and what is nearer has more of them.
            let mut patch: Vec<([f64; 2], f64)> = nodes(columns, rows)
                .map(|(at, share)| {
                    let point = place(at);
                    (
                        point,
                        share * self.0.imaging.pixels_per_area(point, theta_c),
                    )
                })
                .collect();
            let [column, row] = part.middle_px;
            weigh(&mut patch, part.pixels, self.point(column, row, theta_c));
            places.extend(patch);
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
        board.imaging().on_rig([x, y], board.azimuth(pose))
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

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::geometry::{Imaging, RigGeometry};

    fn viewing(camera_mm: Option<f64>, light_mm: Option<f64>) -> Viewing {
        Viewing(Field {
            imaging: Imaging {
                rig: RigGeometry::IN_PLANE,
                pixel_mm: [0.4, 0.4],
                tilt_centre_px: [64.0, 50.0],
                principal_point_px: [64.0, 50.0],
                rotation_axis_px: [58.0, 54.0],
                camera_mm,
                light_mm,
            },
            width: 128,
            height: 100,
        })
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
    fn views_of_a_coarse_board_are_those_of_the_pixels_that_its_patches_have() {
        use super::super::region::{NOWHERE, Region};
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
        let near = Viewing::of(&manifest).unwrap();
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
