//! Finds the board: its turn against the recorded azimuth, its displacement from the stated axis, and the frames in which it
//! was moved.
//!
//! A placement is good if its patches and mount explain the image: the sum of squares within them is smallest. The turn is
//! searched in a few frames together, the displacement in each frame. A displacement that all frames share is the board's; one
//! of a single frame is a fault.

use std::sync::Arc;

use base64::Engine;
use base64::prelude::BASE64_STANDARD as BASE64;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::darks::Dark;
use super::flats::Response;
use super::reduction_log::{ReductionLog, Rejection};
use super::region::{Board, Spot};
use super::sensor::{Sensor, median};
use crate::frame::Frame;
use crate::geometry::Pose;
use crate::series::FrameRow;
use crate::units::Angle;

/// Approximate number of points of a picture.
const POINTS: usize = 6000;
/// Frames in which the turn is searched.
const FRAMES_FOR_TURN: usize = 8;
/// The turn is searched this far to both sides.
const TURN_DEG: f64 = 20.0;
/// Smaller corrections are not applied: the margin at the borders covers them.
const TURN_DEG_MIN: f64 = 0.3;
const SHIFT_PX_MIN: f64 = 1.0;
/// Displacement from the other frames' board beyond which a frame is shifted.
const SHIFTED_PX: f64 = 2.5;

/// A frame in a few thousand points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "StoredPicture", into = "StoredPicture")]
pub(super) struct Picture {
    /// Columns and rows from point to point.
    stride: usize,
    /// Points in a row.
    across: usize,
    /// By point, row by row: 0 for one that is a defect, else 1 more than the level's steps.
    levels: Vec<u16>,
}

/// A picture as text: two bytes a point, base64.
#[derive(Serialize, Deserialize)]
struct StoredPicture {
    stride: usize,
    across: usize,
    levels: String,
}

impl From<StoredPicture> for Picture {
    fn from(stored: StoredPicture) -> Picture {
        let bytes = BASE64.decode(stored.levels).unwrap_or_default();
        let levels = bytes
            .chunks_exact(2)
            .map(|b| u16::from_le_bytes([b[0], b[1]]));
        Picture {
            stride: stored.stride.max(1),
            across: stored.across.max(1),
            levels: levels.collect(),
        }
    }
}

impl From<Picture> for StoredPicture {
    fn from(picture: Picture) -> StoredPicture {
        let bytes: Vec<u8> = picture
            .levels
            .iter()
            .flat_map(|l| l.to_le_bytes())
            .collect();
        StoredPicture {
            stride: picture.stride,
            across: picture.across,
            levels: BASE64.encode(bytes),
        }
    }
}

impl Picture {
    /// Column, row and level of the points. Only differences of levels count, so their unit is any.
    fn points(&self) -> Vec<[f64; 3]> {
        let point = |(at, level): (usize, &u16)| {
            let place = |k: usize| (k * self.stride) as f64 + 0.5;
            let steps = level.checked_sub(1)?;
            Some([
                place(at % self.across),
                place(at / self.across),
                f64::from(steps),
            ])
        };
        self.levels.iter().enumerate().filter_map(point).collect()
    }
}

/// The points of a frame at its pose.
struct Points {
    index: usize,
    pose: Pose,
    points: Vec<[f64; 3]>,
}

/// Finds the board's placement and names the frames in which it is displaced; `pictures` are those of the sample frames.
pub(super) fn register(
    rows: &[FrameRow],
    pictures: &[(usize, Arc<Option<Picture>>)],
    board: &mut Board,
    log: &mut ReductionLog,
) {
    let points = |(index, picture): &(usize, Arc<Option<Picture>>)| {
        let picture = (**picture).as_ref()?;
        Some(Points {
            index: *index,
            pose: rows[*index].pose(),
            points: picture.points(),
        })
    };
    let pictures: Vec<Points> = pictures.iter().filter_map(points).collect();
    if pictures.len() < 3 {
        return;
    }
    let turn = find_turn(&pictures, board);
    if turn.deg().abs() > TURN_DEG_MIN {
        board.placement.turn = turn;
        log.warn(format!(
            "the board is turned by {:+.1}° against the recorded azimuth; its patches are taken where the frames show them",
            turn.deg()
        ));
    }
    let shifts: Vec<[f64; 2]> = pictures
        .par_iter()
        .map(|picture| find_shift(picture, board))
        .collect();
    let common = common_shift(&pictures, &shifts, board);
    for (picture, shift) in pictures.iter().zip(&shifts) {
        let due = common.at(picture.pose, board);
        let off = [shift[0] - due[0], shift[1] - due[1]];
        if off[0].hypot(off[1]) > SHIFTED_PX {
            log.reject(
                picture.index,
                Rejection::new(
                    "shifted",
                    format!(
                        "the board is displaced by {:+.1} columns, {:+.1} rows from its place in the other frames",
                        off[0], off[1]
                    ),
                ),
            );
        }
    }
    let size = common.axis_px[0].hypot(common.axis_px[1]);
    let centre_px = common.centre_mm[0].hypot(common.centre_mm[1]) / board.pixel_mm[0];
    if size > SHIFT_PX_MIN || centre_px > SHIFT_PX_MIN {
        board.placement.axis_px = common.axis_px;
        board.placement.centre_mm = common.centre_mm;
        log.warn(format!(
            "the rotation axis is displaced by {:+.1} columns, {:+.1} rows from its place in the manifest and the board by {:+.2}, {:+.2} mm from its stated centre; both are corrected",
            common.axis_px[0], common.axis_px[1], common.centre_mm[0], common.centre_mm[1]
        ));
    }
}

/// A frame in a few thousand points; none if it shows nothing.
pub(super) fn picture(
    frame: &Frame,
    dark: &Dark,
    sensor: &Sensor,
    response: &Response,
) -> Option<Picture> {
    let stride = ((sensor.pixels() as f64 / POINTS as f64).sqrt().ceil() as usize).max(1);
    let mut points = Vec::with_capacity(POINTS);
    let mut full = 0;
    for r in (0..sensor.height).step_by(stride) {
        for c in (0..sensor.width).step_by(stride) {
            let pixel = r * sensor.width + c;
            points.push(response.good[pixel].then(|| {
                let dn = frame.pixels_dn()[pixel];
                full += usize::from(sensor.is_full(dn));
                (f64::from(dn) - f64::from(dark.level_dn[pixel]))
                    / f64::from(response.pixels[pixel])
            }));
        }
    }
    let levels = || points.iter().flatten().copied();
    let n = levels().count();
    let mean = levels().sum::<f64>() / n as f64;
    let spread = (levels().map(|l| (l - mean).powi(2)).sum::<f64>() / n as f64).sqrt();
    let noise = sensor.variance_dn2(mean).sqrt();
    if !(n > 500 && full * 2 < n && spread > 3.0 * noise) {
        return None;
    }
    let (low, high) = levels().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), level| {
        (low.min(level), high.max(level))
    });
    let steps = |level: f64| 1 + ((level - low) / (high - low) * STEPS).round() as u16;
    Some(Picture {
        stride,
        across: sensor.width.div_ceil(stride),
        levels: points.iter().map(|level| level.map_or(0, steps)).collect(),
    })
}

/// Steps from the darkest to the brightest point.
const STEPS: f64 = 65_000.0;

/// Returns the share of the picture's sum of squares that the board, displaced by `shift`, does not explain.
fn unexplained(picture: &Points, board: &Board, shift: [f64; 2]) -> f64 {
    let drawing = board.at(picture.pose, 0.5 * board.pixel_mm[0]);
    let ny = board.layout.patches_y as usize;
    // The last place is the mount's: count, sum, sum of squares.
    let mut sums = vec![[0.0_f64; 3]; board.layout.patches_x as usize * ny + 1];
    let mount = sums.len() - 1;
    for [column, row, level] in &picture.points {
        let place = match drawing.spot(column - shift[0], row - shift[1]) {
            Spot::Patch(i, j) => i as usize * ny + j as usize,
            Spot::Mount => mount,
            Spot::Border => continue,
        };
        let sum = &mut sums[place];
        sum[0] += 1.0;
        sum[1] += level;
        sum[2] += level * level;
    }
    let about = |n: f64, s: f64, ss: f64| if n > 0.0 { ss - s * s / n } else { 0.0 };
    let within: f64 = sums.iter().map(|[n, s, ss]| about(*n, *s, *ss)).sum();
    let all = sums
        .iter()
        .fold([0.0; 3], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
    let total = about(all[0], all[1], all[2]);
    if total > 0.0 { within / total } else { 1.0 }
}

fn find_turn(pictures: &[Points], board: &Board) -> Angle {
    let step = pictures.len().div_ceil(FRAMES_FOR_TURN);
    let some: Vec<&Points> = pictures.iter().step_by(step).collect();
    let misfit = |deg: f64| {
        let mut turned = board.clone();
        turned.placement.turn = Angle::from_deg(deg);
        some.iter()
            .map(|p| unexplained(p, &turned, [0.0, 0.0]))
            .sum::<f64>()
    };
    let coarse: Vec<f64> = (-20..=20).map(|i| f64::from(i) * TURN_DEG / 20.0).collect();
    let best = coarse
        .par_iter()
        .map(|deg| (misfit(*deg), *deg))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(0.0, |(_, deg)| deg);
    let mut at = best;
    for step in [0.5, 0.25, 0.12, 0.06] {
        at = [at - step, at, at + step]
            .into_iter()
            .min_by(|a, b| misfit(*a).total_cmp(&misfit(*b)))
            .expect("three candidates");
    }
    Angle::from_deg(at)
}

/// Returns the displacement of the board in one frame, in columns and rows.
fn find_shift(picture: &Points, board: &Board) -> [f64; 2] {
    let mut at = [0.0, 0.0];
    let mut best = unexplained(picture, board, at);
    let mut step = 8.0;
    while step > 0.2 {
        let mut moved = false;
        for (dx, dy) in [
            (1.0, 0.0),
            (-1.0, 0.0),
            (0.0, 1.0),
            (0.0, -1.0),
            (1.0, 1.0),
            (1.0, -1.0),
            (-1.0, 1.0),
            (-1.0, -1.0),
        ] {
            let there = [at[0] + dx * step, at[1] + dy * step];
            if there[0].abs().max(there[1].abs()) > 48.0 {
                continue;
            }
            let misfit = unexplained(picture, board, there);
            if misfit < best {
                best = misfit;
                at = there;
                moved = true;
            }
        }
        if !moved {
            step *= 0.5;
        }
    }
    at
}

/// What the displacements of all frames have in common.
#[derive(Debug, Clone, Copy, Default)]
struct Common {
    axis_px: [f64; 2],
    centre_mm: [f64; 2],
}

impl Common {
    fn at(&self, pose: Pose, board: &Board) -> [f64; 2] {
        let rows = design(pose, board);
        let x = [
            self.axis_px[0],
            self.axis_px[1],
            self.centre_mm[0],
            self.centre_mm[1],
        ];
        rows.map(|row| row.iter().zip(x).map(|(a, b)| a * b).sum())
    }
}

/// ∂(column, row)/∂(axis column, axis row, centre x, centre y).
fn design(pose: Pose, board: &Board) -> [[f64; 4]; 2] {
    let (sin, cos) = board.azimuth(pose).sin_cos();
    // The axis is a point of the sample's plane, foreshortened as all of it.
    let tilt = pose.theta_c.rad().cos();
    let columns = tilt / board.pixel_mm[0];
    let rows = 1.0 / board.pixel_mm[1];
    [
        [tilt, 0.0, cos * columns, -sin * columns],
        [0.0, 1.0, -sin * rows, -cos * rows],
    ]
}

/// Least squares, repeated without the frames that lie far off.
fn common_shift(pictures: &[Points], shifts: &[[f64; 2]], board: &Board) -> Common {
    let mut keep: Vec<usize> = (0..pictures.len()).collect();
    let mut common = Common {
        axis_px: [0, 1].map(|k| median(&mut shifts.iter().map(|s| s[k]).collect::<Vec<_>>())),
        centre_mm: [0.0, 0.0],
    };
    for _ in 0..5 {
        let off = |at: &usize| {
            let due = common.at(pictures[*at].pose, board);
            (shifts[*at][0] - due[0]).hypot(shifts[*at][1] - due[1])
        };
        let usual = median(&mut (0..pictures.len()).map(|at| off(&at)).collect::<Vec<_>>());
        let reach = (3.0 * usual).max(SHIFT_PX_MIN);
        keep = (0..pictures.len()).filter(|at| off(at) <= reach).collect();
        if keep.len() < 4 {
            return common;
        }
        let matrix = DMatrix::from_fn(2 * keep.len(), 4, |i, j| {
            design(pictures[keep[i / 2]].pose, board)[i % 2][j]
        });
        let seen = DVector::from_fn(2 * keep.len(), |i, _| shifts[keep[i / 2]][i % 2]);
        let svd = matrix.svd(true, true);
        // Frames at one azimuth cannot tell axis from centre: the pseudo-inverse shares it out.
        let Ok(x) = svd.solve(&seen, 1e-6 * svd.singular_values.max()) else {
            return common;
        };
        common = Common {
            axis_px: [x[0], x[1]],
            centre_mm: [x[2], x[3]],
        };
    }
    if keep.len() * 2 < pictures.len() {
        return Common::default();
    }
    common
}
