//! Frames → observations: what the fit reads, with honest uncertainties and every frame that was
//! left out by name.
//!
//! Call [`reduce`]. The steps, one file each: dark frames and their hot pixels; the camera's curve by exposures of one pose
//! (`detector`), which all counts are corrected for; flats, the pixels'
//! response and defects; the region's pixels at each pose; each sample frame's level; frames of a
//! pose merged. Frames are read, measured and dropped one by one on all cores, so memory does not
//! grow with the series and time grows in proportion to it.
//!
//! The signal is in units of radiance for a lamp irradiance of 1 on a surface facing it, under the
//! provisional assumption that the flats hold no stray light: signal = gain · (L + s), flat = gain ·
//! (ρ/π cos θi + s) with gain near 1. What the stray light s, the gain and the tilt's zero are is for
//! the fit to settle from flats and samples together; nothing here knows a reflectance model.

mod calibration;
mod darks;
mod detector;
mod flats;
mod journal;
mod load;
mod measure;
mod merge;
mod pattern;
mod region;
mod register;
mod sensor;
mod shading;
mod sloping;
mod viewing;
mod wild;

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

pub use self::calibration::{CameraCalibration, DarkLevel, calibrate};
pub use crate::series::FrameReadError;

use self::journal::{Journal, Rejection};
use self::load::Calls;
use self::measure::{Ground, Measured};
use self::merge::{Merged, PoseLevels};
use self::region::{Board, Region, Segments};
use self::sensor::median;
use self::viewing::{Part, Viewing};
use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;
use crate::observation::{Observation, ObservationSet, Prior, SharedErrors};
use crate::series::{FrameRow, Manifest, RigFacts, Series};
use crate::units::Angle;
use crate::wording::counted;

/// Standard uncertainty of a stage beyond what a fit solves for: of its zero, and of its error at the ends of the range of
/// tilts or once round, as good rotation stages have it. Where the manifest states none.
const ANGLE_STD_DEFAULT_DEG: f64 = 0.02;
/// Relative drift of the lamp between white reference and sample, where the manifest states none and nothing measured says
/// more.
const LAMP_DRIFT_DEFAULT: f64 = 1e-3;
/// Standard uncertainty of the stray light before the flats are looked at, as a share of the
/// largest signal: what a blackened mount leaves.
const STRAY_SHARE: f64 = 0.02;

/// Where frames come from: a recorded series, or a scan in the store.
///
/// [`read`](FrameSource::read) is called from several threads at once, and may be called more than
/// once for a frame.
pub trait FrameSource: Sync {
    /// Rig, camera, references and nominal material.
    fn manifest(&self) -> &Manifest;
    /// The list of frames.
    fn rows(&self) -> &[FrameRow];
    /// Frame `index` of the list.
    ///
    /// # Errors
    /// [`FrameReadError`] if it cannot be had; the reduction then goes on without it.
    fn read(&self, index: usize) -> Result<Frame, FrameReadError>;

    /// Where the list says that the sample was seen, a pose per frame.
    fn sample_poses(&self) -> Vec<Pose> {
        let samples = self
            .rows()
            .iter()
            .filter(|row| row.kind == FrameKind::Sample);
        samples.map(FrameRow::pose).collect()
    }
}

impl FrameSource for Series {
    fn manifest(&self) -> &Manifest {
        Series::manifest(self)
    }

    fn rows(&self) -> &[FrameRow] {
        Series::rows(self)
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        Series::read(self, index)
    }
}

/// Why a series gives no observations.
#[derive(Debug, thiserror::Error)]
pub enum ReductionError {
    /// The sample has patches and none was chosen.
    #[error("this sample has regions with lean directions of their own; choose one: {}", available.join(", "))]
    RegionNeeded {
        /// Names of the regions.
        available: Vec<String>,
    },
    /// There is no such region.
    #[error("there is no region `{name}`; {}", if available.is_empty() { "this sample has none".to_owned() } else { format!("this sample has {}", available.join(", ")) })]
    UnknownRegion {
        /// Name that was given.
        name: String,
        /// Names of the regions there are.
        available: Vec<String>,
    },
    /// Lamp or camera are near and the size of the field is not stated.
    #[error(
        "{what}: every pixel has its own directions, which takes camera.field_width_mm and the distances in the manifest"
    )]
    FieldUnknown {
        /// What the manifest says.
        what: String,
    },
    /// No sample frame could be used.
    #[error("no observation is left: {why}")]
    NoObservations {
        /// What became of the frames.
        why: String,
    },
    /// Most frames of a kind hold counts that the stated converter cannot give.
    #[error(
        "{frames} of {of} {kind} frames hold counts that the camera cannot give; of {first} {detail}"
    )]
    ImpossibleCounts {
        /// Kind of the frames.
        kind: &'static str,
        /// How many of them.
        frames: usize,
        /// How many there are.
        of: usize,
        /// File of the first.
        first: String,
        /// Its counts, and the remedy.
        detail: String,
    },
    /// Frames that could be read a moment ago cannot be read any more.
    #[error("{what} went away while they were read; is the folder being changed?")]
    Vanished {
        /// Which frames.
        what: &'static str,
    },
    /// The cancel flag was raised.
    #[error("the reduction was cancelled")]
    Cancelled,
}

/// The rig as its pixels see it.
fn viewing(manifest: &Manifest) -> Result<Viewing, ReductionError> {
    Viewing::new(manifest)
        .filter(|viewing| manifest.is_telecentric() || !viewing.is_far())
        .ok_or_else(|| {
            let rig = &manifest.rig;
            let told = |word: &Option<String>, mm: Option<f64>| match (word.as_deref(), mm) {
                (Some("infinity"), _) | (None, None) => "infinity".to_owned(),
                (_, Some(mm)) => format!("{mm} mm"),
                (Some(word), None) => word.to_owned(),
            };
            ReductionError::FieldUnknown {
                what: format!(
                    "projection \"{}\", light at {}, camera at {}",
                    manifest.camera.projection,
                    told(&rig.light_distance, rig.light_distance_mm),
                    told(&rig.camera_distance, manifest.camera_distance_mm()),
                ),
            }
        })
}

/// What [`reduce`] refuses before it reads a frame.
///
/// # Errors
/// [`ReductionError`].
pub fn check(source: &dyn FrameSource) -> Result<(), ReductionError> {
    viewing(source.manifest())?;
    let of = |kind: FrameKind| source.rows().iter().filter(|row| row.kind == kind).count();
    if of(FrameKind::Sample) > 0 {
        return Ok(());
    }
    let why = match of(FrameKind::Dark) + of(FrameKind::Flat) {
        0 => "the list holds no sample frame".to_owned(),
        calibration => format!(
            "the list holds no sample frame, only {} (dark or white reference), which scans of a sample use: fit one of those",
            counted(calibration, "calibration frame")
        ),
    };
    Err(ReductionError::NoObservations { why })
}

/// Without the times of all frames nothing tells of a lamp that drifts.
fn warn_of_unread_times(rows: &[FrameRow], journal: &mut Journal) {
    let unread = |row: &&FrameRow| !row.timestamp.trim().is_empty() && row.taken_s().is_none();
    if let Some(first) = rows.iter().find(unread) {
        journal.warn(format!(
            "the timestamp of {} cannot be read ({:?} on {} is no time like 2026-01-31T12:00:00Z): a lamp that drifts may not be noticed",
            counted(rows.iter().filter(unread).count(), "frame"),
            first.timestamp,
            first.file,
        ));
    }
}

/// Reduces the frames of a series to observations of the sample, or of one `region` of it.
/// `cancel` is looked at between frames.
///
/// # Errors
/// [`ReductionError`]. Frames that cannot be used are no error: they are in `rejected_frames`.
pub fn reduce(
    source: &dyn FrameSource,
    region: Option<&str>,
    cancel: &AtomicBool,
) -> Result<ObservationSet, ReductionError> {
    check(source)?;
    let manifest = source.manifest();
    let calls = Calls { source, cancel };
    let mut journal = Journal::default();
    warn_of_unread_times(source.rows(), &mut journal);
    let (mut segments, chosen) = segments(manifest, region)?;
    let viewing = viewing(manifest)?;
    let rig = manifest.rig_geometry();
    let uniform = matches!(segments, Segments::Whole) && viewing.is_far();
    let mut camera = calibration::prepare(&calls, uniform, &mut journal)?;
    viewing.take_out_lamp(&mut camera);
    let (sensor, darks, flats) = (camera.sensor, &camera.darks, &camera.flats);
    if let Segments::Patches { board, .. } = &mut segments {
        register::register(&calls, &sensor, darks, &flats.response, board, &mut journal)?;
    }
    let ground = Ground {
        calls,
        sensor: &sensor,
        darks,
        response: &flats.response,
        segments: &segments,
        far: viewing.is_far(),
    };
    let measured = measure_all(&ground, &mut journal)?;
    load::refuse_impossible(&calls, FrameKind::Sample, &journal)?;
    if uniform {
        let clean = measured.iter().filter(|m| m.is_clean());
        let slopes = clean.filter_map(|m| m.levels.first().map(|level| level.slope));
        sloping::warn(slopes, &mut journal);
    }
    let (mut poses, lamp_scatter) = merge::merge(&ground, measured, &mut journal);
    // Patches of a near rig differ by where they lie: neither worn nor uncertain for that.
    if viewing.is_far() {
        leave_out_worn_patches(&segments, chosen, &mut poses, &mut journal);
    }
    warn_of_lost_poses(&calls, &poses, &mut journal);

    let reference = camera.reference;
    // A pose of which no pixel is left (all of them full or wild), or whose numbers left the range of doubles, is
    // none: an observation of 0 ± 0 would outweigh all others.
    let levels: Vec<(&PoseLevels, Merged)> = poses
        .iter()
        .map(|p| (p, over_segments(p, viewing.is_far())))
        .filter(|(_, level)| is_level(level))
        .collect();
    if levels.len() < poses.len() {
        journal.warn(format!(
            "{} left out: no usable pixel, or no finite level",
            counted(poses.len() - levels.len(), "pose")
        ));
        leave_out_levelless(source.rows(), &poses, viewing.is_far(), &mut journal);
    }
    let largest = levels
        .iter()
        .map(|(_, l)| l.rate_dn_s)
        .fold(0.0_f64, f64::max);
    // Without a white reference the brightest level is 1.
    let unit = camera.unit_dn_s.unwrap_or(largest);
    if levels.is_empty() || !(unit.is_finite() && unit > 0.0) {
        let (rejected, _) = journal.close(source.rows());
        return Err(ReductionError::NoObservations {
            why: match rejected.first() {
                Some(first) => format!(
                    "left out: {}, the first being {} ({})",
                    counted(rejected.len(), "frame"),
                    first.file,
                    match first.detail.as_str() {
                        "" => first.reason.clone(),
                        detail => format!("{}: {detail}", first.reason),
                    }
                ),
                None => "the list holds no sample frame with light".to_owned(),
            },
        });
    }
    let seen = flats.lamp_scatter.unwrap_or(0.0).max(lamp_scatter);
    let facts = &manifest.rig;
    tell_what_is_assumed(facts, seen, &mut journal);
    let drift = facts.lamp_drift_std.unwrap_or(LAMP_DRIFT_DEFAULT).max(seen);
    let zero = |stated: Option<f64>| Angle::from_deg(stated.unwrap_or(ANGLE_STD_DEFAULT_DEG));
    let (tilts_zero, turns_zero) = (zero(facts.theta_c_std_deg), zero(facts.phi_s_std_deg));
    let began_s = zero_of_time(source.rows(), &poses);
    let of_detector = detector::shares(source.rows(), &camera, &levels);
    let observations: Vec<Observation> = levels
        .iter()
        .zip(of_detector)
        .map(|((pose, level), of_detector)| {
            let signal = level.rate_dn_s / unit;
            Observation {
                pose: pose.pose,
                signal,
                sigma: level.variance.sqrt() / unit,
                shared: SharedErrors {
                    white_reference: reference
                        .map_or(0.0, |w| signal * w.reflectance_std / w.reflectance),
                    led_drift: signal * drift,
                    detector: signal * of_detector,
                    theta_c_zero: tilts_zero,
                    phi_s_zero: turns_zero,
                },
                n_frames: pose.frames.len() as u32,
                taken_s: pose
                    .taken_s
                    .zip(began_s)
                    .map(|(taken, began)| taken - began),
            }
        })
        .collect();
    let dark = levels.iter().map(|(_, level)| level.dark_std_dn_s / unit);
    let dark_std = dark.sum::<f64>() / levels.len() as f64;
    let used: u32 = observations.iter().map(|o| o.n_frames).sum();
    let (rejected_frames, warnings) = journal.close(source.rows());
    let views = if viewing.is_far() {
        Vec::new()
    } else {
        levels
            .iter()
            .map(|(pose, _)| {
                let parts: Vec<Part> = pose
                    .segments
                    .iter()
                    .map(|s| Part {
                        pixels: s.n,
                        middle_px: s.middle_px,
                    })
                    .collect();
                viewing.views(&segments, pose.pose, &parts)
            })
            .collect()
    };
    Ok(ObservationSet {
        rig,
        views,
        material: manifest.material(),
        flats: camera.flat_observations(),
        white_reference: reference,
        background: Prior {
            mean: 0.0,
            std: STRAY_SHARE * largest / unit,
        },
        wedge_std: manifest.rig.sample_wedge_std_deg.map(Angle::from_deg),
        azimuth_zero_std: manifest.rig.azimuth_zero_std_deg.map(Angle::from_deg),
        theta_l_std: manifest.rig.theta_l_std_deg.map(Angle::from_deg),
        dark_std,
        translucency: manifest
            .translucency()
            .map(|(mean, std)| Prior { mean, std }),
        flat_times_s: flat_times(source.rows(), began_s),
        lamp: None,
        detector: darks.detector.as_ref().and_then(|detector| detector.told),
        region: region.map(str::to_owned),
        region_azimuth: match (chosen, &manifest.sample.layout) {
            (Some(chosen), Some(layout)) => layout.lean_azimuth(chosen.is_odd()),
            _ => Angle::ZERO,
        },
        n_frames_used: used + darks.n_frames + flats.n_frames,
        observations,
        rejected_frames,
        warnings,
    })
}

/// Says in one sentence which parts of the budget rest on no statement and no measurement; `seen` is the lamp's relative
/// scatter as the frames show it.
fn tell_what_is_assumed(rig: &RigFacts, seen: f64, journal: &mut Journal) {
    let stages = [
        ("theta_c_std_deg", rig.theta_c_std_deg),
        ("phi_s_std_deg", rig.phi_s_std_deg),
    ];
    let unstated = stages.iter().filter(|(_, std)| std.is_none());
    let mut keys: Vec<&str> = unstated.map(|(key, _)| *key).collect();
    let mut assumed: Vec<String> = Vec::new();
    if !keys.is_empty() {
        assumed.push(format!(
            "{ANGLE_STD_DEFAULT_DEG}° for a stage's angle, its zero as well as its error over the range"
        ));
    }
    if rig.lamp_drift_std.is_none() && seen < LAMP_DRIFT_DEFAULT {
        keys.push("lamp_drift_std");
        assumed.push(format!("{LAMP_DRIFT_DEFAULT} for the lamp"));
    }
    if !keys.is_empty() {
        journal.warn(format!(
            "the manifest states no [rig] {}: standard uncertainties of {} are assumed",
            keys.join(", "),
            assumed.join(", and of ")
        ));
    }
}

/// Names the frames of the poses that give no level.
fn leave_out_levelless(rows: &[FrameRow], poses: &[PoseLevels], far: bool, journal: &mut Journal) {
    let without = |pose: &&PoseLevels| !is_level(&over_segments(pose, far));
    for index in poses.iter().filter(without).flat_map(|pose| &pose.frames) {
        let exposure_s = rows[*index].exposure_s;
        let detail = format!(
            "all pixels of its pose are full, wild or left out, or {exposure_s:?} s of exposure give no finite level"
        );
        journal.reject(*index, Rejection::new("no level", detail));
    }
}

/// Whether a level is one: its pose has a usable pixel, and numbers within the range of doubles.
fn is_level(level: &Merged) -> bool {
    level.n > 0.0
        && level.rate_dn_s.is_finite()
        && level.variance > 0.0
        && level.variance.is_finite()
}

/// When the white reference was seen (s since 1970), or the sample where no flat bears a time.
fn zero_of_time(rows: &[FrameRow], poses: &[PoseLevels]) -> Option<f64> {
    let flats = rows.iter().filter(|row| row.kind == FrameKind::Flat);
    merge::mean_time(flats).or_else(|| {
        let taken: Vec<f64> = poses.iter().filter_map(|p| p.taken_s).collect();
        (!taken.is_empty()).then(|| taken.iter().sum::<f64>() / taken.len() as f64)
    })
}

/// Times of the white reference's frames after the zero of time; none where one bears none.
fn flat_times(rows: &[FrameRow], began_s: Option<f64>) -> Vec<f64> {
    let flats = rows.iter().filter(|row| row.kind == FrameKind::Flat);
    let times: Option<Vec<f64>> = flats.map(|row| Some(row.taken_s()? - began_s?)).collect();
    times.unwrap_or_default()
}

fn segments(
    manifest: &Manifest,
    region: Option<&str>,
) -> Result<(Segments, Option<Region>), ReductionError> {
    match (&manifest.sample.layout, region) {
        (None, None) => Ok((Segments::Whole, None)),
        (None, Some(name)) => Err(ReductionError::UnknownRegion {
            name: name.to_owned(),
            available: Vec::new(),
        }),
        (Some(layout), None) => Err(ReductionError::RegionNeeded {
            available: Region::names(layout),
        }),
        (Some(layout), Some(name)) => match Region::parse(name, layout) {
            Some(chosen) => Ok((
                Segments::of_region(Board::new(manifest, layout), chosen),
                Some(chosen),
            )),
            None => Err(ReductionError::UnknownRegion {
                name: name.to_owned(),
                available: Region::names(layout),
            }),
        },
    }
}

fn measure_all(
    ground: &Ground<'_>,
    journal: &mut Journal,
) -> Result<Vec<Measured>, ReductionError> {
    let results: Vec<(usize, Result<Measured, Rejection>)> = ground
        .calls
        .rows_of(FrameKind::Sample)
        .into_iter()
        .filter(|index| !journal.has_rejected(*index))
        .collect::<Vec<_>>()
        .par_iter()
        .map(|index| {
            ground.calls.check_cancel()?;
            Ok((*index, ground.measure(*index)))
        })
        .collect::<Result<_, ReductionError>>()?;
    let mut measured = Vec::with_capacity(results.len());
    for (index, result) in results {
        match result {
            Ok(m) => measured.push(m),
            Err(rejection) => journal.reject(index, rejection),
        }
    }
    Ok(measured)
}

fn warn_of_lost_poses(calls: &Calls<'_>, poses: &[PoseLevels], journal: &mut Journal) {
    let mut lost: Vec<String> = Vec::new();
    for index in calls.rows_of(FrameKind::Sample) {
        let pose = calls.source.rows()[index].pose();
        let near = |p: &PoseLevels| {
            let limit = 2.0 * flats::SAME_ANGLE_DEG;
            (p.pose.theta_c - pose.theta_c).deg().abs() <= limit
                && (p.pose.phi_s - pose.phi_s).deg().abs() <= limit
        };
        if !poses.iter().any(near) {
            let words = format!("(θc {:.1}, φs {:.1})", pose.theta_c, pose.phi_s);
            if !lost.contains(&words) {
                lost.push(words);
            }
        }
    }
    if !lost.is_empty() {
        let shown = lost.iter().take(8).cloned().collect::<Vec<_>>().join(", ");
        let more = if lost.len() > 8 { ", …" } else { "" };
        journal.warn(format!(
            "{} without a usable frame, so no observation: {shown}{more}",
            counted(lost.len(), "pose")
        ));
    }
}

/// Patches that disagree with the rest of their kind (worn, dirty, damaged) leave `even` and `odd`.
fn leave_out_worn_patches(
    segments: &Segments,
    chosen: Option<Region>,
    poses: &mut [PoseLevels],
    journal: &mut Journal,
) {
    /// A patch is worn beyond this many times the usual deviation …
    const TIMES: f64 = 4.0;
    /// … and this share of the brightest level.
    const SHARE: f64 = 0.01;
    let Segments::Patches { patches, .. } = segments else {
        return;
    };
    if patches.len() < 3 {
        return;
    }
    let mut squares = vec![0.0; patches.len()];
    let mut brightest = 0.0_f64;
    for pose in poses.iter() {
        let middle = median(
            &mut pose
                .segments
                .iter()
                .map(|s| s.rate_dn_s)
                .collect::<Vec<_>>(),
        );
        brightest = brightest.max(middle);
        for (square, s) in squares.iter_mut().zip(&pose.segments) {
            *square += (s.rate_dn_s - middle).powi(2);
        }
    }
    let rms: Vec<f64> = squares
        .iter()
        .map(|s| (s / poses.len().max(1) as f64).sqrt() / brightest)
        .collect();
    let usual = median(&mut rms.clone());
    let kind = if chosen.is_some_and(Region::is_odd) {
        "odd"
    } else {
        "even"
    };
    for (label, rms) in rms.iter().enumerate() {
        if *rms > (TIMES * usual).max(SHARE) {
            let (i, j) = patches[label];
            journal.warn(format!(
                "patch-{i}-{j} disagrees with the other {kind} patches ({:.1} % of the brightest level, rms over the poses) and is left out of `{kind}`; look whether it is worn or dirty",
                rms * 100.0
            ));
            for pose in poses.iter_mut() {
                pose.segments[label].n = 0.0;
            }
        }
    }
}

/// Pixel-weighted mean of the segments of a pose. Patches that scatter more than their own
/// uncertainties say make the mean as uncertain as they show, if they should be `alike`.
fn over_segments(pose: &PoseLevels, alike: bool) -> Merged {
    let used: Vec<&Merged> = pose.segments.iter().filter(|s| s.n > 0.0).collect();
    let n: f64 = used.iter().map(|s| s.n).sum();
    if n <= 0.0 {
        return Merged::default();
    }
    let rate = used.iter().map(|s| s.n * s.rate_dn_s).sum::<f64>() / n;
    let own = used
        .iter()
        .map(|s| (s.n / n).powi(2) * s.variance)
        .sum::<f64>();
    let between = if alike && used.len() >= 3 {
        let k = used.len() as f64;
        used.iter()
            .map(|s| (s.rate_dn_s - rate).powi(2))
            .sum::<f64>()
            / ((k - 1.0) * k)
    } else {
        0.0
    };
    Merged {
        n,
        rate_dn_s: rate,
        variance: own.max(between),
        dark_std_dn_s: used
            .iter()
            .map(|s| (s.n / n * s.dark_std_dn_s).powi(2))
            .sum::<f64>()
            .sqrt(),
        ..Merged::default()
    }
}

#[cfg(test)]
mod extreme_tests;
#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;
