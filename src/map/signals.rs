//! Frames → signals of every map pixel: dark subtracted, divided by the response, exposures of a pose merged pixel by
//! pixel, saturated and defective pixels masked, and the frame resampled into the sample's frame.
//!
//! Frames of one pose are summed before the division, Σ counts / Σ seconds, over the exposures in which the pixel is
//! not saturated: the unbiased estimate of least variance for photon noise. Resampling is bilinear; a map pixel is
//! masked if one of its four source pixels is.

pub(super) mod planes;
pub(super) mod view;

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon::prelude::*;

use super::{MapError, Progress, Stage};
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::observation::RejectedFrame;
use crate::reduction::{CameraCalibration, FrameSource};
use crate::units::Angle;
use planes::Planes;
use view::View;

/// Poses closer than this, in degrees, are the same pose.
const SAME_ANGLE_DEG: f64 = 0.02;

/// The sample frames of one pose.
#[derive(Debug, Clone)]
pub(super) struct PoseFrames {
    pub(super) pose: Pose,
    rows: Vec<usize>,
}

/// Groups the sample frames by pose, in the order of tilt and azimuth.
pub(super) fn poses(source: &dyn FrameSource) -> Vec<PoseFrames> {
    let mut poses: Vec<PoseFrames> = Vec::new();
    let apart = |a: Angle, b: Angle| (a - b).wrapped().abs().deg();
    for (index, row) in source.rows().iter().enumerate() {
        if row.kind != FrameKind::Sample {
            continue;
        }
        let pose = row.pose();
        let same = poses.iter_mut().find(|p| {
            apart(p.pose.theta_c, pose.theta_c) < SAME_ANGLE_DEG
                && apart(p.pose.phi_s, pose.phi_s) < SAME_ANGLE_DEG
        });
        match same {
            Some(group) => group.rows.push(index),
            None => poses.push(PoseFrames {
                pose,
                rows: vec![index],
            }),
        }
    }
    poses.sort_by(|a, b| {
        let key = |p: &PoseFrames| (p.pose.theta_c.rad(), p.pose.phi_s.rad());
        key(a)
            .partial_cmp(&key(b))
            .expect("poses of a series are finite")
    });
    poses
}

/// The camera's calibration per pixel, in the form that the map uses.
pub(super) struct Light<'a> {
    pub(super) calibration: &'a CameraCalibration,
    /// Response per pixel; 0 for defective ones.
    pub(super) response: Vec<f32>,
    /// Radiance per (count per second at response 1).
    pub(super) unit: f64,
}

impl<'a> Light<'a> {
    pub(super) fn new(calibration: &'a CameraCalibration, unit: f64) -> Self {
        let pixels = calibration.response().iter().zip(calibration.good());
        let response = pixels
            .map(|(response, good)| if *good { response.max(0.0) } else { 0.0 })
            .collect();
        Light {
            calibration,
            response,
            unit,
        }
    }
}

/// Reads all sample frames and stores their resampled planes. Returns the rejected frames.
pub(super) fn observe(
    source: &dyn FrameSource,
    light: &Light<'_>,
    view: &View,
    poses: &[PoseFrames],
    planes: &Planes,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Vec<RejectedFrame>, MapError> {
    let rejected = Mutex::new(Vec::new());
    let done = AtomicUsize::new(0);
    poses
        .par_iter()
        .enumerate()
        .try_for_each(|(index, frames)| {
            if cancel.load(Ordering::Relaxed) {
                return Err(MapError::Cancelled);
            }
            let merged = merge(source, light, frames, &rejected);
            for tile in 0..planes.tiles() {
                let plane: Vec<f32> = planes
                    .range(tile)
                    .flat_map(|pixel| {
                        let [column, row] = view.project(frames.pose, view.place_mm(pixel));
                        bilinear(&merged, view, column, row)
                    })
                    .collect();
                planes.put(index, tile, &plane).map_err(MapError::Scratch)?;
            }
            progress(Progress {
                stage: Stage::Resampling,
                done: done.fetch_add(1, Ordering::Relaxed) + 1,
                total: poses.len(),
            });
            Ok(())
        })?;
    let mut rejected = rejected
        .into_inner()
        .expect("no holder of this lock panics");
    rejected.sort_by(|a: &RejectedFrame, b| a.file.cmp(&b.file));
    Ok(rejected)
}

/// Returns signal and variance of every sensor pixel; the variance is 0 if there is no signal.
fn merge(
    source: &dyn FrameSource,
    light: &Light<'_>,
    frames: &PoseFrames,
    rejected: &Mutex<Vec<RejectedFrame>>,
) -> Vec<[f32; 2]> {
    let pixels = light.response.len();
    let calibration = light.calibration;
    let (mut counts, mut seconds, mut variance) = (
        vec![0.0_f32; pixels],
        vec![0.0_f32; pixels],
        vec![0.0_f32; pixels],
    );
    let black = calibration.black_dn();
    for index in &frames.rows {
        let frame = match calibration.load(source, *index) {
            Ok(frame) => frame,
            Err(reason) => {
                let mut list = rejected.lock().expect("no holder of this lock panics");
                list.push(reason);
                continue;
            }
        };
        let exposure_s = source.rows()[*index].exposure_s;
        let dark = calibration.dark(exposure_s);
        let (level, dark_variance) = (dark.level_dn(), dark.variance_dn2());
        for (pixel, dn) in frame.pixels_dn().iter().enumerate() {
            if light.response[pixel] > 0.0 && !calibration.is_full(*dn) {
                let dn = dark.linear_dn(pixel, *dn);
                counts[pixel] += (dn - f64::from(level[pixel])) as f32;
                seconds[pixel] += exposure_s as f32;
                variance[pixel] += (calibration.variance_dn2(dn - black) + dark_variance) as f32;
            }
        }
    }
    let from_response = calibration.response_variance();
    (0..pixels)
        .map(|pixel| {
            if seconds[pixel] <= 0.0 {
                return [0.0, 0.0];
            }
            let scale = light.unit / (f64::from(seconds[pixel]) * f64::from(light.response[pixel]));
            let signal = f64::from(counts[pixel]) * scale;
            let variance =
                f64::from(variance[pixel]) * scale * scale + signal * signal * from_response;
            [signal as f32, variance as f32]
        })
        .collect()
}

/// Interpolates signal and σ between four sensor pixels; returns zeros if one of them has no signal.
fn bilinear(merged: &[[f32; 2]], view: &View, column: f64, row: f64) -> [f32; 2] {
    // A pixel's value belongs to its centre. Within half a pixel of the edge, the edge pixel's value is used.
    let (u, v) = (column - 0.5, row - 0.5);
    let (w, h) = (view.width as f64, view.height as f64);
    if !(u > -0.5 && v > -0.5 && u < w - 0.5 && v < h - 0.5) {
        return [0.0, 0.0];
    }
    let (u, v) = (u.clamp(0.0, w - 1.0), v.clamp(0.0, h - 1.0));
    let (c, r) = (
        (u as usize).min(view.width.saturating_sub(2)),
        (v as usize).min(view.height.saturating_sub(2)),
    );
    let (fu, fv) = (u - c as f64, v - r as f64);
    let (mut signal, mut variance) = (0.0, 0.0);
    for (dr, wr) in [(0, 1.0 - fv), (1, fv)] {
        for (dc, wc) in [(0, 1.0 - fu), (1, fu)] {
            let weight = wr * wc;
            if weight <= 1e-9 {
                continue;
            }
            let [s, var] = merged[(r + dr) * view.width + c + dc];
            if var <= 0.0 {
                return [0.0, 0.0];
            }
            signal += weight * f64::from(s);
            variance += weight * weight * f64::from(var);
        }
    }
    [signal as f32, variance.sqrt() as f32]
}
