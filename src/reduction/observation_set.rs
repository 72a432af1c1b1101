//! Levels of the poses → observations with what their errors share, in units of the white reference.

use std::collections::BTreeMap;

use super::FrameSource;
use super::calibration;
use super::detector;
use super::measured_series::MeasuredSeries;
use super::merge::{self, Merged, PoseLevels};
use super::reduction_log::ReductionLog;
use super::refusals::ReductionError;
use super::region::Region;
use super::series_context::SeriesContext;
use super::viewing::Part;
use crate::frame::FrameKind;
use crate::observation::{Observation, ObservationSet, Prior, SharedErrors, View};
use crate::series::{FrameRow, RigFacts};
use crate::units::Angle;
use crate::wording::counted;

/// Standard uncertainty of a stage's zero, and of its error at the ends of the tilts or over one turn, if the manifest states
/// none: the value of good rotation stages.
const ANGLE_STD_DEFAULT_DEG: f64 = 0.02;
/// Relative drift of the lamp between white reference and sample, if the manifest states none and the frames show no more.
const LAMP_DRIFT_DEFAULT: f64 = 1e-3;
/// Prior standard uncertainty of the stray light as a share of the largest signal: the value of a blackened mount.
const STRAY_SHARE: f64 = 0.02;

/// Levels of the poses, with what turns them into observations.
pub(super) struct PoseMeans<'a> {
    pub(super) source: &'a dyn FrameSource,
    pub(super) series: &'a SeriesContext,
    pub(super) measured: &'a MeasuredSeries,
    /// The region that was asked for, by its name and as it is in the layout.
    pub(super) region: Option<&'a str>,
    pub(super) chosen: Option<Region>,
    /// Poses with their levels.
    pub(super) levels: Vec<(&'a PoseLevels, Merged)>,
    /// Relative scatter of the lamp that repeated poses show.
    pub(super) lamp_scatter: f64,
}

impl PoseMeans<'_> {
    /// Returns the observations, with all that a fit needs to know of the series.
    ///
    /// # Errors
    /// [`ReductionError::NoObservations`] if no pose has a level.
    pub(super) fn observation_set(
        &self,
        mut log: ReductionLog,
    ) -> Result<ObservationSet, ReductionError> {
        let rows = self.source.rows();
        let manifest = self.source.manifest();
        let scale = &self.measured.scale;
        let rates = self.levels.iter().map(|(_, level)| level.rate_dn_s);
        let largest_dn_s = rates.fold(0.0_f64, f64::max);
        // Without a white reference the brightest level is 1.
        let unit_dn_s = scale.unit_dn_s.unwrap_or(largest_dn_s);
        if self.levels.is_empty() || !(unit_dn_s.is_finite() && unit_dn_s > 0.0) {
            return Err(without_observation(rows, log));
        }
        let began_s = zero_of_time(rows, &self.levels);
        let observations = self.observations(unit_dn_s, began_s, &mut log);
        let used: u32 = observations.iter().map(|o| o.n_frames).sum();
        let dark = self
            .levels
            .iter()
            .map(|(_, level)| level.dark_std_dn_s / unit_dn_s);
        let dark_std = dark.sum::<f64>() / self.levels.len() as f64;
        let (rejected_frames, warnings) = log.close(rows);
        let angle = |deg: Option<f64>| deg.map(Angle::from_deg);
        Ok(ObservationSet {
            rig: manifest.rig_geometry(),
            field: self.series.viewing.whole_field(&self.measured.segments),
            views: self.views(),
            material: manifest.material(),
            flats: calibration::flat_observations(
                &scale.levels,
                scale.unit_dn_s,
                &flat_times(rows, began_s),
            ),
            white_reference: scale.reference,
            background: Prior {
                mean: 0.0,
                std: STRAY_SHARE * largest_dn_s / unit_dn_s,
            },
            wedge_std: angle(manifest.rig.sample_wedge_std_deg),
            azimuth_zero_std: angle(manifest.rig.azimuth_zero_std_deg),
            theta_l_std: angle(manifest.rig.theta_l_std_deg),
            dark_std,
            translucency: manifest
                .translucency()
                .map(|(mean, std)| Prior { mean, std }),
            lamp: None,
            detector: scale.detector.bent,
            power_law: scale.detector.power_law(),
            region: self.region.map(str::to_owned),
            region_azimuth: match (self.chosen, &manifest.sample.layout) {
                (Some(chosen), Some(layout)) => layout.lean_azimuth(chosen.is_odd()),
                _ => Angle::ZERO,
            },
            n_frames_used: used + self.measured.calibration.sums.n_darks + scale.n_flats,
            observations,
            rejected_frames,
            warnings,
        })
    }

    /// Returns one observation per pose. The signal is in units of the white reference.
    fn observations(
        &self,
        unit_dn_s: f64,
        began_s: Option<f64>,
        log: &mut ReductionLog,
    ) -> Vec<Observation> {
        let rows = self.source.rows();
        let scale = &self.measured.scale;
        let rig = &self.source.manifest().rig;
        let seen = scale.lamp_scatter.unwrap_or(0.0).max(self.lamp_scatter);
        warn_of_defaults(rig, seen, log);
        let drift = rig.lamp_drift_std.unwrap_or(LAMP_DRIFT_DEFAULT).max(seen);
        let zero = |stated: Option<f64>| Angle::from_deg(stated.unwrap_or(ANGLE_STD_DEFAULT_DEG));
        let (tilts_zero, turns_zero) = (zero(rig.theta_c_std_deg), zero(rig.phi_s_std_deg));
        let reference_std = scale
            .reference
            .map_or(0.0, |white| white.reflectance_std / white.reflectance);
        let detector_stds = detector::shares(rows, scale, &self.levels);
        self.levels
            .iter()
            .zip(detector_stds)
            .map(|((pose, level), detector_std)| {
                let signal = level.rate_dn_s / unit_dn_s;
                Observation {
                    pose: pose.pose,
                    signal,
                    sigma: level.variance.sqrt() / unit_dn_s,
                    shared: SharedErrors {
                        white_reference: signal * reference_std,
                        led_drift: signal * drift,
                        detector: signal * detector_std,
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
            .collect()
    }

    /// Returns the directions of each pose at a near rig, by the pixels that its level is the mean of. A far rig has the same
    /// directions in all of them and needs none.
    fn views(&self) -> Vec<Vec<View>> {
        let viewing = &self.series.viewing;
        if viewing.is_far() {
            return Vec::new();
        }
        let segments = &self.measured.segments;
        let poses = self.levels.iter().map(|(pose, _)| pose);
        poses
            .map(|pose| {
                let parts = pose.segments.iter().map(|segment| Part {
                    pixels: segment.n,
                    middle_px: segment.middle_px,
                });
                viewing.views(segments, pose.pose, &parts.collect::<Vec<_>>())
            })
            .collect()
    }
}

/// Returns why no observation is left: by the first frame that was left out.
fn without_observation(rows: &[FrameRow], log: ReductionLog) -> ReductionError {
    let (rejected, _) = log.close(rows);
    ReductionError::NoObservations {
        why: match rejected.first() {
            Some(first) => format!(
                "left out: {}, the first being {} ({})",
                counted(rejected.len(), "frame"),
                first.file,
                first.cause()
            ),
            None => "the list has no sample frame with light".to_owned(),
        },
    }
}

/// Warns of unreadable times: without the times of all frames a drift of the lamp cannot be detected.
pub(super) fn warn_of_unread_times(rows: &[FrameRow], log: &mut ReductionLog) {
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

/// Returns the mean time of the white reference (s since 1970), or of the sample if a flat has no time.
fn zero_of_time(rows: &[FrameRow], levels: &[(&PoseLevels, Merged)]) -> Option<f64> {
    let flats = rows.iter().filter(|row| row.kind == FrameKind::Flat);
    merge::mean_time(flats).or_else(|| {
        let taken: Vec<f64> = levels.iter().filter_map(|(pose, _)| pose.taken_s).collect();
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
