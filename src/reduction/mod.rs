//! Frames → observations with uncertainties, and a list of all frames that were left out.
//!
//! [`reduce`] reads every frame once. Dark frames give dark levels and hot pixels (`darks`), flats the response of the pixels
//! and their defects (`flats`). Each sample frame becomes sums over the pixels of each segment (`measure`, `levels`), which a
//! [`ReductionCache`] keeps: the next reduction of the same frames merges the sums and reads nothing. Exposures of one pose
//! determine the camera's curve (`detector`), which is applied to the sums (`scale`); then the frames of each pose are merged
//! (`merge`). Frames are read and dropped one by one on all cores, and the sums of a long series stay in the store, so memory
//! hardly grows with the series; only the dark and flat frames of one calibration are held, up to 256 MB.
//!
//! The signal is in units of radiance for a lamp irradiance of 1 on a surface facing it, under the
//! provisional assumption that the flats contain no stray light: signal = gain · (L + s), flat = gain ·
//! (ρ/π cos θi + s) with gain near 1. The fit determines the stray light s, the gain and the tilt's zero from
//! flats and samples together. This module knows no reflectance model.

mod cache;
mod calibration;
mod calibration_sums;
mod camera_calibration;
mod counted_reads;
mod darks;
mod detector;
mod flats;
mod levels;
mod load;
mod measure;
mod merge;
mod outcomes;
mod outlier_pixels;
mod pattern;
mod reduction_log;
mod region;
mod register;
mod remembering;
mod scale;
mod sensor;
mod series_context;
mod shading;
mod shading_check;
mod viewing;

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

pub use self::cache::{CalibrationText, FrameText, ReductionCache, ReductionTexts, TextStore};
pub use self::camera_calibration::{CameraCalibration, DarkLevel, calibrate};
pub(crate) use self::counted_reads::CountedReads;
pub use self::remembering::Remembering;
pub use self::series_context::calibration_keys;
pub use crate::series::FrameReadError;

use self::cache::Kept;
use self::calibration_sums::Calibration;
use self::load::{Calls, HeldFrames};
use self::merge::{MergeContext, Merged, PoseLevels};
use self::outcomes::{Outcomes, Wanted};
use self::reduction_log::{ReductionLog, Rejection};
use self::region::{Board, Placement, Region, Segments};
use self::scale::Scale;
use self::sensor::median;
use self::series_context::SeriesContext;
use self::viewing::{Part, Viewing};
use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;
use crate::observation::{Observation, ObservationSet, Prior, SharedErrors};
use crate::series::{FrameRow, Manifest, RigFacts, Series};
use crate::units::Angle;
use crate::wording::counted;

/// Standard uncertainty of a stage's zero, and of its error at the ends of the tilts or over one turn, if the manifest states
/// none: the value of good rotation stages.
const ANGLE_STD_DEFAULT_DEG: f64 = 0.02;
/// Relative drift of the lamp between white reference and sample, if the manifest states none and the frames show no more.
const LAMP_DRIFT_DEFAULT: f64 = 1e-3;
/// Prior standard uncertainty of the stray light as a share of the largest signal: the value of a blackened mount.
const STRAY_SHARE: f64 = 0.02;

/// A source of frames: a recorded series, or a scan in the store.
///
/// [`read`](FrameSource::read) is called from several threads at once.
pub trait FrameSource: Sync {
    /// Rig, camera, references and nominal material.
    fn manifest(&self) -> &Manifest;
    /// The list of frames.
    fn rows(&self) -> &[FrameRow];
    /// Frame `index` of the list.
    ///
    /// # Errors
    /// [`FrameReadError`] if it cannot be read; the reduction then leaves it out.
    fn read(&self, index: usize) -> Result<Frame, FrameReadError>;

    /// Returns the number of a frame, which stays the same while frames are added to the list.
    fn frame_id(&self, index: usize) -> i64 {
        index as i64
    }

    /// Returns what earlier reductions computed of these frames. Without a cache every reduction reads all frames.
    fn reductions(&self) -> Option<&ReductionCache> {
        None
    }

    /// Returns whether more frames will come. Then the sample does not replace missing flats: each new frame would change
    /// the response that all others were measured with.
    fn is_growing(&self) -> bool {
        false
    }

    /// Returns the poses of the sample frames in the list.
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

/// Why a series has no observations.
#[derive(Debug, thiserror::Error)]
pub enum ReductionError {
    /// The sample has patches and no region was chosen.
    #[error("this part has regions, each with its own lean direction; choose one with --region (`region` of a request): {}", available.join(", "))]
    RegionNeeded {
        /// Names of the regions.
        available: Vec<String>,
    },
    /// There is no such region.
    #[error("there is no region `{name}`; {}", if available.is_empty() { "this part has none".to_owned() } else { format!("this part has {}", available.join(", ")) })]
    UnknownRegion {
        /// Name that was given.
        name: String,
        /// Names of the regions there are.
        available: Vec<String>,
    },
    /// Lamp or camera is near and the size of the field is not stated.
    #[error(
        "{what}: every pixel has its own directions; state camera.field_width_mm and the distances in the manifest"
    )]
    FieldUnknown {
        /// What the manifest says.
        what: String,
    },
    /// No sample frame could be used.
    #[error("no observation is left: {why}")]
    NoObservations {
        /// Why the frames were left out.
        why: String,
    },
    /// Most frames of a kind contain counts that the stated converter cannot give.
    #[error(
        "{frames} of {of} {kind} frames contain counts that the camera cannot give; of {first} {detail}"
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
    /// Frames that could be read before cannot be read now.
    #[error("{what} disappeared while they were read; check whether the folder is being changed")]
    Vanished {
        /// Which frames.
        what: &'static str,
    },
    /// The cancel flag was raised.
    #[error("the reduction was cancelled")]
    Cancelled,
}

/// Returns the rig's geometry by pixel.
fn viewing(manifest: &Manifest) -> Result<Viewing, ReductionError> {
    Viewing::new(manifest)
        .filter(|viewing| manifest.is_telecentric() || !viewing.is_far())
        .ok_or_else(|| {
            let rig = &manifest.rig;
            let distance = |word: &Option<String>, mm: Option<f64>| match (word.as_deref(), mm) {
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

/// Checks what [`reduce`] refuses before it reads a frame.
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
        0 => "the list has no sample frame".to_owned(),
        calibration => format!(
            "the list has no sample frame, only {} (dark or white reference) for scans of a sample; fit one of those",
            counted(calibration, "calibration frame")
        ),
    };
    Err(ReductionError::NoObservations { why })
}

/// Warns of unreadable times: without the times of all frames a drift of the lamp cannot be detected.
fn warn_of_unread_times(rows: &[FrameRow], log: &mut ReductionLog) {
    let unread = |row: &&FrameRow| !row.timestamp.trim().is_empty() && row.taken_s().is_none();
    if let Some(first) = rows.iter().find(unread) {
        log.warn(format!(
            "the timestamp of {} cannot be read ({:?} on {}; expected a time like 2026-01-31T12:00:00Z): a drift of the lamp may go undetected",
            counted(rows.iter().filter(unread).count(), "frame"),
            first.timestamp,
            first.file,
        ));
    }
}

/// Reduces the frames of a series to observations of the sample, or of one `region` of it.
/// `cancel` is checked between frames.
///
/// # Errors
/// [`ReductionError`]. Frames that cannot be used are listed in `rejected_frames`.
pub fn reduce(
    source: &dyn FrameSource,
    region: Option<&str>,
    cancel: &AtomicBool,
) -> Result<ObservationSet, ReductionError> {
    check(source)?;
    let manifest = source.manifest();
    let calls = Calls {
        source,
        cancel,
        held: &HeldFrames::default(),
    };
    let (segments, chosen) = segments(manifest, region)?;
    let series = SeriesContext::new(source)?;
    let far = series.viewing.is_far();
    let own = ReductionCache::default();
    let mut kept = source.reductions().unwrap_or(&own).lock();
    let Look {
        segments,
        calibration,
        outcomes,
        scale,
        log: of_board,
    } = look(&calls, &series, &mut kept, region, segments)?;

    let mut log = ReductionLog::default();
    warn_of_unread_times(source.rows(), &mut log);
    scale::log_calibration(source, &series, &calibration, &scale.detector, &mut log);
    log.extend(&of_board);
    let mut measured = Vec::new();
    outcomes.each(&calls, &series, &kept, |index, outcome| {
        if log.has_rejected(index) {
            return;
        }
        match scale.measured(source.rows(), index, outcome) {
            Ok(frame) => measured.push(frame),
            Err(rejection) => log.reject(index, rejection),
        }
    })?;
    drop(kept);
    load::refuse_impossible(&calls, FrameKind::Sample, &log)?;
    if far && matches!(segments, Segments::Whole) {
        let clean = measured.iter().filter(|m| m.is_clean());
        let of_frames = clean.filter_map(|m| m.levels.first());
        shading_check::warn(of_frames.clone().map(|level| level.slope), &mut log);
        shading_check::warn_of_parts(of_frames.map(levels::Level::unevenness), &mut log);
    }
    let context = MergeContext {
        rows: source.rows(),
        material: manifest.material(),
        scale: &scale,
    };
    let (mut poses, lamp_scatter) = merge::merge(&context, measured, &mut log);
    // Patches of a near rig differ by their place, which makes them neither worn nor uncertain.
    if far {
        leave_out_worn_patches(&segments, chosen, &mut poses, &mut log);
    }
    warn_of_lost_poses(&calls, &poses, &mut log);

    let reference = scale.reference;
    // A pose without a usable pixel, or with numbers beyond the range of doubles, is left out: an observation of 0 ± 0
    // would outweigh all others.
    let levels: Vec<(&PoseLevels, Merged)> = poses
        .iter()
        .map(|p| (p, over_segments(p, far)))
        .filter(|(_, level)| is_level(level))
        .collect();
    if levels.len() < poses.len() {
        log.warn(format!(
            "{} left out: no usable pixel, or no finite level",
            counted(poses.len() - levels.len(), "pose")
        ));
        leave_out_levelless(source.rows(), &poses, far, &mut log);
    }
    let largest = levels
        .iter()
        .map(|(_, l)| l.rate_dn_s)
        .fold(0.0_f64, f64::max);
    // Without a white reference the brightest level is 1.
    let unit = scale.unit_dn_s.unwrap_or(largest);
    if levels.is_empty() || !(unit.is_finite() && unit > 0.0) {
        let (rejected, _) = log.close(source.rows());
        return Err(ReductionError::NoObservations {
            why: match rejected.first() {
                Some(first) => format!(
                    "left out: {}, the first being {} ({})",
                    counted(rejected.len(), "frame"),
                    first.file,
                    first.cause()
                ),
                None => "the list has no sample frame with light".to_owned(),
            },
        });
    }
    let seen = scale.lamp_scatter.unwrap_or(0.0).max(lamp_scatter);
    let facts = &manifest.rig;
    warn_of_defaults(facts, seen, &mut log);
    let drift = facts.lamp_drift_std.unwrap_or(LAMP_DRIFT_DEFAULT).max(seen);
    let zero = |stated: Option<f64>| Angle::from_deg(stated.unwrap_or(ANGLE_STD_DEFAULT_DEG));
    let (tilts_zero, turns_zero) = (zero(facts.theta_c_std_deg), zero(facts.phi_s_std_deg));
    let began_s = zero_of_time(source.rows(), &poses);
    let of_detector = detector::shares(source.rows(), &scale, &levels);
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
                row: None,
            }
        })
        .collect();
    let dark = levels.iter().map(|(_, level)| level.dark_std_dn_s / unit);
    let dark_std = dark.sum::<f64>() / levels.len() as f64;
    let used: u32 = observations.iter().map(|o| o.n_frames).sum();
    let (rejected_frames, warnings) = log.close(source.rows());
    let views = if far {
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
                series.viewing.views(&segments, pose.pose, &parts)
            })
            .collect()
    };
    Ok(ObservationSet {
        rig: manifest.rig_geometry(),
        field: series.viewing.whole_field(&segments),
        views,
        material: manifest.material(),
        flats: calibration::flat_observations(
            &scale.levels,
            scale.unit_dn_s,
            &flat_times(source.rows(), began_s),
        ),
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
        lamp: None,
        detector: scale.detector.bent,
        power_law: scale.detector.power_law(),
        region: region.map(str::to_owned),
        region_azimuth: match (chosen, &manifest.sample.layout) {
            (Some(chosen), Some(layout)) => layout.lean_azimuth(chosen.is_odd()),
            _ => Angle::ZERO,
        },
        n_frames_used: used + calibration.sums.n_darks + scale.n_flats,
        observations,
        rejected_frames,
        warnings,
    })
}

/// Warns of the parts of the budget that rest on defaults; `seen` is the lamp's relative scatter in the frames.
fn warn_of_defaults(rig: &RigFacts, seen: f64, log: &mut ReductionLog) {
    let stages = [
        ("theta_c_std_deg", rig.theta_c_std_deg),
        ("phi_s_std_deg", rig.phi_s_std_deg),
    ];
    let unstated = stages.iter().filter(|(_, std)| std.is_none());
    let mut keys: Vec<&str> = unstated.map(|(key, _)| *key).collect();
    let mut assumed: Vec<String> = Vec::new();
    if !keys.is_empty() {
        assumed.push(format!(
            "{ANGLE_STD_DEFAULT_DEG}° for a stage's angle (its zero and its error over the range)"
        ));
    }
    if rig.lamp_drift_std.is_none() && seen < LAMP_DRIFT_DEFAULT {
        keys.push("lamp_drift_std");
        assumed.push(format!("{LAMP_DRIFT_DEFAULT} for the lamp"));
    }
    if !keys.is_empty() {
        log.warn(format!(
            "the manifest states no [rig] {}: standard uncertainties of {} are assumed",
            keys.join(", "),
            assumed.join(", and of ")
        ));
    }
}

/// Leaves out the frames of the poses that give no level.
fn leave_out_levelless(rows: &[FrameRow], poses: &[PoseLevels], far: bool, log: &mut ReductionLog) {
    let without = |pose: &&PoseLevels| !is_level(&over_segments(pose, far));
    for index in poses.iter().filter(without).flat_map(|pose| &pose.frames) {
        let exposure_s = rows[*index].exposure_s;
        let detail = format!(
            "all pixels of its pose are full, outliers or left out, or {exposure_s:?} s of exposure give no finite level"
        );
        log.reject(*index, Rejection::new("no level", detail));
    }
}

/// Returns whether a level is valid: its pose has a usable pixel, and its numbers are within the range of doubles.
fn is_level(level: &Merged) -> bool {
    level.n > 0.0
        && level.rate_dn_s.is_finite()
        && level.variance > 0.0
        && level.variance.is_finite()
}

/// Returns the mean time of the white reference (s since 1970), or of the sample if a flat has no time.
fn zero_of_time(rows: &[FrameRow], poses: &[PoseLevels]) -> Option<f64> {
    let flats = rows.iter().filter(|row| row.kind == FrameKind::Flat);
    merge::mean_time(flats).or_else(|| {
        let taken: Vec<f64> = poses.iter().filter_map(|p| p.taken_s).collect();
        (!taken.is_empty()).then(|| taken.iter().sum::<f64>() / taken.len() as f64)
    })
}

/// Returns the times of the flats after the zero of time, by their rows; empty if one has no time.
fn flat_times(rows: &[FrameRow], began_s: Option<f64>) -> BTreeMap<usize, f64> {
    let flats = rows
        .iter()
        .enumerate()
        .filter(|(_, row)| row.kind == FrameKind::Flat);
    let times: Option<BTreeMap<usize, f64>> = flats
        .map(|(index, row)| Some((index, row.taken_s()? - began_s?)))
        .collect();
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

/// The measured frames of a series, before poses are merged.
struct Look {
    segments: Segments,
    calibration: Calibration,
    outcomes: Outcomes,
    scale: Scale,
    /// Frames left out and warnings about the board.
    log: ReductionLog,
}

/// Measures the frames that the cache lacks, finds the board, and compares exposures for the camera's curve.
fn look(
    calls: &Calls<'_>,
    series: &SeriesContext,
    kept: &mut Kept,
    region: Option<&str>,
    mut segments: Segments,
) -> Result<Look, ReductionError> {
    let source = calls.source;
    let base = outcomes::calibration(calls, series, kept, None)?;
    let measure = |segments: &Segments, calibration: &Calibration, kept: &mut Kept| {
        let part = cache::part_of(region, &segments.placement());
        let wanted = Wanted {
            sums: Some((segments, &part)),
            pictures: matches!(segments, Segments::Patches { .. }),
        };
        outcomes::outcomes(calls, series, kept, (&base, calibration), wanted)
    };
    // The board is expected where it was last, so that its frames are read once unless it moved.
    segments.place(kept.placement);
    let mut seen = measure(&segments, &base, kept)?;
    let mut log = ReductionLog::default();
    if let Segments::Patches { board, .. } = &mut segments {
        let before = board.placement;
        board.placement = Placement::default();
        register::register(source.rows(), &seen.pictures, board, &mut log);
        if source.is_growing() && board.placement.is_near(&before, board) {
            board.placement = before;
        }
        kept.placement = board.placement;
        if board.placement != before {
            seen = measure(&segments, &base, kept)?;
        }
    }
    let detector = outcomes::detector(source, &base, &seen);
    let mut calibration = base.clone();
    if let Some(judged) = scale::judged_otherwise(source, series, &base, &detector) {
        calibration = outcomes::calibration(calls, series, kept, Some(judged))?;
        seen = measure(&segments, &calibration, kept)?;
    }
    let scale = Scale::of(source, series, &calibration, &detector);
    Ok(Look {
        segments,
        calibration,
        outcomes: seen,
        scale,
        log,
    })
}

fn warn_of_lost_poses(calls: &Calls<'_>, poses: &[PoseLevels], log: &mut ReductionLog) {
    let mut lost: Vec<String> = Vec::new();
    for index in calls.rows_of(FrameKind::Sample) {
        let pose = calls.source.rows()[index].pose();
        let near = |p: &PoseLevels| {
            let limit = 2.0 * flats::SAME_ANGLE_DEG;
            (p.pose.theta_c - pose.theta_c).deg().abs() <= limit
                && (p.pose.phi_s - pose.phi_s).wrapped().deg().abs() <= limit
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
        log.warn(format!(
            "{} without a usable frame give no observation: {shown}{more}",
            counted(lost.len(), "pose")
        ));
    }
}

/// Leaves out of `even` and `odd` the patches that disagree with the others: worn, dirty or damaged.
fn leave_out_worn_patches(
    segments: &Segments,
    chosen: Option<Region>,
    poses: &mut [PoseLevels],
    log: &mut ReductionLog,
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
            log.warn(format!(
                "patch-{i}-{j} disagrees with the other {kind} patches ({:.1} % of the brightest level, rms over the poses) and is left out of `{kind}`; check whether it is worn or dirty",
                rms * 100.0
            ));
            for pose in poses.iter_mut() {
                pose.segments[label].n = 0.0;
            }
        }
    }
}

/// Returns the pixel-weighted mean of the segments of a pose. If they should be `alike`, patches that scatter more than their
/// uncertainties raise the uncertainty of the mean to their scatter.
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
