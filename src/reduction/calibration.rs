//! Darks and flats → what the camera makes of light, pixel by pixel.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::ReductionError;
use super::darks::{DarkNoises, Darks};
use super::detector::Detector;
use super::flats::{Field, FlatContext, FlatLevel, Flats, Judged};
use super::load::{Calls, refuse_impossible};
use super::reduction_log::ReductionLog;
use super::sensor::Sensor;
use super::viewing::Viewing;
use crate::frame::FrameKind;
use crate::geometry::RigGeometry;
use crate::observation::{FlatObservation, WhiteReference};
use crate::series::{FrameRow, Manifest};

/// Standard uncertainty of the white reference whose certificate is not stated.
const REFLECTANCE_STD_DEFAULT: f64 = 0.01;

/// Darks, flats and the provisional unit of one series, pixel by pixel.
#[derive(Debug)]
pub(super) struct Prepared {
    pub(super) sensor: Sensor,
    pub(super) darks: Darks,
    pub(super) flats: Flats,
    pub(super) reference: Option<WhiteReference>,
    /// Counts per second and unit radiance at response 1, stray light in the flats taken as zero;
    /// `None` without a white reference.
    pub(super) unit_dn_s: Option<f64>,
    /// Frames left out and warnings: of the dark frames, then of the flats.
    pub(super) logs: [ReductionLog; 2],
}

/// How flats are prepared.
#[derive(Clone, Default)]
pub(super) struct Preparation {
    /// The sample fills the field evenly, so that it can stand in for missing flats.
    pub(super) uniform: bool,
    /// What corrects the counts of flats and samples; nothing where they are taken as they are.
    pub(super) detector: Option<Arc<Detector>>,
    /// Flats that are left out for their level, where that was judged already.
    pub(super) judged: Option<Judged>,
}

/// Reads darks and flats.
pub(super) fn prepare(
    calls: &Calls<'_>,
    viewing: &Viewing,
    how: &Preparation,
) -> Result<Prepared, ReductionError> {
    let manifest = calls.source.manifest();
    let rig = manifest.rig_geometry();
    let mut sensor = Sensor::new(manifest);
    let mut logs = [ReductionLog::default(), ReductionLog::default()];
    let mut darks = Darks::read(calls, &mut sensor, &mut logs[0])?;
    refuse_impossible(calls, FrameKind::Dark, &logs[0])?;
    calls.held.clear();
    darks.detector.clone_from(&how.detector);
    let context = FlatContext {
        calls,
        sensor: &sensor,
        darks: &darks,
        rig: &rig,
        field: Field {
            uniform: how.uniform,
            far: viewing.is_far(),
        },
        judged: how.judged.as_ref(),
    };
    let mut flats = Flats::read(&context, &mut logs[1])?;
    refuse_impossible(calls, FrameKind::Flat, &logs[1])?;
    viewing.take_out_lamp(&mut flats);
    let reference = certificate(manifest).filter(|_| !flats.levels.is_empty());
    Ok(Prepared {
        unit_dn_s: reference.map(|white| unit(&white, &flats.levels, &rig)),
        sensor,
        darks,
        flats,
        reference,
        logs,
    })
}

/// Counts per second and unit radiance at response 1.
pub(super) fn unit(white: &WhiteReference, levels: &[FlatLevel], rig: &RigGeometry) -> f64 {
    let (mut weight, mut sum) = (0.0, 0.0);
    for flat in levels {
        let due = white.reflectance / std::f64::consts::PI * rig.cos_incidence(flat.theta_c);
        let w = (due / flat.sigma_dn_s).powi(2);
        weight += w;
        sum += w * flat.rate_dn_s / due;
    }
    sum / weight
}

/// The white reference over its tilts in the observations' unit; empty without one. `times_s` has the times of its frames by
/// their rows.
pub(super) fn flat_observations(
    levels: &[FlatLevel],
    unit_dn_s: Option<f64>,
    times_s: &BTreeMap<usize, f64>,
) -> Vec<FlatObservation> {
    let Some(unit) = unit_dn_s else {
        return Vec::new();
    };
    levels
        .iter()
        .map(|flat| FlatObservation {
            theta_c: flat.theta_c,
            signal: flat.rate_dn_s / unit,
            sigma: flat.sigma_dn_s / unit,
            times_s: flat
                .frames
                .iter()
                .filter_map(|index| times_s.get(index).copied())
                .collect(),
        })
        .collect()
}

/// Warns of exposure times without dark frames.
pub(super) fn warn_of_missing_darks(rows: &[FrameRow], darks: &DarkNoises, log: &mut ReductionLog) {
    let mut exposures: Vec<f64> = rows
        .iter()
        .filter(|r| r.kind != FrameKind::Dark)
        .map(|r| r.exposure_s)
        .collect();
    exposures.sort_unstable_by(f64::total_cmp);
    exposures.dedup();
    for exposure_s in exposures {
        if !darks.covers(exposure_s) {
            log.warn(format!(
                "no dark frame for {exposure_s} s: the nearest exposure time's stands in"
            ));
        }
    }
}

/// The certificate of the white reference, if the manifest states one.
pub(super) fn certificate(manifest: &Manifest) -> Option<WhiteReference> {
    let flat = manifest.flat.as_ref()?;
    Some(WhiteReference {
        reflectance: flat.reflectance?,
        reflectance_std: flat.reflectance_std.unwrap_or(REFLECTANCE_STD_DEFAULT),
    })
}

/// Warns of what a certificate does not state, where there are flats.
pub(super) fn warn_of_reference(manifest: &Manifest, no_flats: bool, log: &mut ReductionLog) {
    if no_flats {
        return;
    }
    let stated = manifest.flat.as_ref();
    if stated.and_then(|f| f.reflectance).is_none() {
        log.warn(
            "there are flats, but the manifest states no [flat] reflectance: the scale is relative"
                .to_owned(),
        );
    } else if stated.and_then(|f| f.reflectance_std).is_none() {
        log.warn(format!(
            "the manifest states no [flat] reflectance_std: {REFLECTANCE_STD_DEFAULT} is assumed"
        ));
    }
}
