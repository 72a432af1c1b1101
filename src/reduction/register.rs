//! Where the board really lies: turned against the recorded azimuth, beside the stated axis, and in
//! which frames it lies elsewhere than in the others.
//!
//! A placement is good if the patches and the mount that it draws explain the picture: the sum of
//! squares left within them is smallest. The turn is searched in a few frames together; the
//! displacement in each frame alone, and what all frames share is told from what one has alone.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::ReductionError;
use super::darks::Darks;
use super::flats::Response;
use super::journal::{Journal, Rejection};
use super::load::{Calls, load};
use super::region::{Board, Spot};
use super::sensor::{Sensor, median};
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::units::Angle;

/// A picture is looked at in about so many points.
const POINTS: usize = 6000;
/// Frames in which the turn is searched.
const FRAMES_FOR_TURN: usize = 8;
/// The turn is searched this far to both sides.
const TURN_DEG: f64 = 20.0;
/// Smaller corrections are left alone: the margin at the borders covers them.
const TURN_DEG_MIN: f64 = 0.3;
const SHIFT_PX_MIN: f64 = 1.0;
/// A frame whose board lies this far from the others' is shifted.
const SHIFTED_PX: f64 = 2.5;

struct Picture {
    index: usize,
    pose: Pose,
    /// Column, row and level of the points.
    points: Vec<[f64; 3]>,
}

/// Finds the board's placement and names the frames in which it is displaced.
pub(super) fn register(
    calls: &Calls<'_>,
    sensor: &Sensor,
    darks: &Darks,
    response: &Response,
    board: &mut Board,
    journal: &mut Journal,
) -> Result<(), ReductionError> {
    let pictures: Vec<Picture> = calls
        .rows_of(FrameKind::Sample)
        .into_par_iter()
        .map(|index| {
            calls.check_cancel()?;
            Ok(picture(calls, index, sensor, darks, response))
        })
        .collect::<Result<Vec<_>, ReductionError>>()?
        .into_iter()
        .flatten()
        .collect();
    if pictures.len() < 3 {
        return Ok(());
    }
    let turn = find_turn(&pictures, board);
    if turn.deg().abs() > TURN_DEG_MIN {
        board.placement.turn = turn;
        journal.warn(format!(
            "the board lies {:+.1}° turned against the recorded azimuth; its patches are taken where they are seen",
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
            journal.reject(
                picture.index,
                Rejection::new(
                    "shifted",
                    format!(
                        "the board lies {:+.1} columns, {:+.1} rows from where the other frames have it",
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
        journal.warn(format!(
            "the rotation axis lies {:+.1} columns, {:+.1} rows from where the manifest has it and the board {:+.2}, {:+.2} mm from its stated centre; both are corrected",
            common.axis_px[0], common.axis_px[1], common.centre_mm[0], common.centre_mm[1]
        ));
    }
    Ok(())
}

/// A frame in a few thousand points; none if it is unusable or shows nothing.
fn picture(
    calls: &Calls<'_>,
    index: usize,
    sensor: &Sensor,
    darks: &Darks,
    response: &Response,
) -> Option<Picture> {
    let row = &calls.source.rows()[index];
    let frame = load(calls, index, sensor).ok()?;
    let dark = darks.at(row.exposure_s);
    let stride = ((sensor.pixels() as f64 / POINTS as f64).sqrt().ceil() as usize).max(1);
    let mut points = Vec::with_capacity(POINTS);
    let mut full = 0;
    for r in (0..sensor.height).step_by(stride) {
        for c in (0..sensor.width).step_by(stride) {
            let pixel = r * sensor.width + c;
            if response.good[pixel] {
                let dn = frame.pixels_dn()[pixel];
                full += usize::from(sensor.is_full(dn));
                let level = (dark.linear_dn(pixel, dn) - f64::from(dark.level_dn[pixel]))
                    / f64::from(response.pixels[pixel]);
                points.push([c as f64 + 0.5, r as f64 + 0.5, level]);
            }
        }
    }
    let n = points.len() as f64;
    let mean = points.iter().map(|p| p[2]).sum::<f64>() / n;
    let spread = (points.iter().map(|p| (p[2] - mean).powi(2)).sum::<f64>() / n).sqrt();
    let noise = sensor.variance_dn2(mean).sqrt();
    let tells = n > 500.0 && full * 2 < points.len() && spread > 3.0 * noise;
    tells.then_some(Picture {
        index,
        pose: row.pose(),
        points,
    })
}

/// Share of the picture's sum of squares that the board, displaced by `shift`, leaves unexplained.
fn unexplained(picture: &Picture, board: &Board, shift: [f64; 2]) -> f64 {
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

fn find_turn(pictures: &[Picture], board: &Board) -> Angle {
    let step = pictures.len().div_ceil(FRAMES_FOR_TURN);
    let some: Vec<&Picture> = pictures.iter().step_by(step).collect();
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

/// Displacement of one frame's board in columns and rows.
fn find_shift(picture: &Picture, board: &Board) -> [f64; 2] {
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
fn common_shift(pictures: &[Picture], shifts: &[[f64; 2]], board: &Board) -> Common {
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
