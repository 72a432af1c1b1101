//! Darks and flats → what the camera makes of light: the part of a reduction that a per-pixel map
//! needs as well. [`calibrate`] is the door for those; [`super::reduce`] goes through it too.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::darks::{Dark, Darks};
use super::detector;
use super::flats::{Flats, Scene};
use super::journal::Journal;
use super::load::{Calls, load, refuse_impossible};
use super::sensor::Sensor;
use super::{FrameSource, ReductionError};
use crate::frame::{Frame, FrameKind};
use crate::geometry::RigGeometry;
use crate::observation::{FlatObservation, RejectedFrame, WhiteReference};
use crate::series::Manifest;

/// Standard uncertainty of the white reference whose certificate is not stated.
const REFLECTANCE_STD_DEFAULT: f64 = 0.01;

/// Darks, flats and the provisional unit of one series.
pub(super) struct Prepared {
    pub(super) sensor: Sensor,
    pub(super) darks: Darks,
    pub(super) flats: Flats,
    pub(super) reference: Option<WhiteReference>,
    /// Counts per second and unit radiance at response 1, stray light in the flats taken as none;
    /// `None` without a white reference.
    pub(super) unit_dn_s: Option<f64>,
}

/// Reads darks and flats. `uniform`: the sample fills the field evenly, so that it can stand in
/// for missing flats.
pub(super) fn prepare(
    calls: &Calls<'_>,
    uniform: bool,
    journal: &mut Journal,
) -> Result<Prepared, ReductionError> {
    let manifest = calls.source.manifest();
    let rig = manifest.rig_geometry();
    let mut sensor = Sensor::new(manifest);
    let mut darks = Darks::read(calls, &mut sensor, journal)?;
    refuse_impossible(calls, FrameKind::Dark, journal)?;
    warn_of_missing_darks(calls, &darks, journal);
    // Before flats and samples, which are all corrected for it.
    let detector = detector::read(calls, &sensor, &darks)?;
    if let Some(words) = detector.words() {
        journal.warn(words);
    }
    darks.detector = Some(Arc::new(detector));
    let far = super::viewing(manifest)?.is_far();
    let scene = Scene { uniform, far };
    let flats = Flats::read(calls, &sensor, &darks, &rig, scene, journal)?;
    refuse_impossible(calls, FrameKind::Flat, journal)?;
    let reference = white_reference(manifest, &flats, journal);
    let unit_dn_s = reference.map(|white| unit(&white, &flats, &rig));
    Ok(Prepared {
        sensor,
        darks,
        flats,
        reference,
        unit_dn_s,
    })
}

fn unit(white: &WhiteReference, flats: &Flats, rig: &RigGeometry) -> f64 {
    let (mut weight, mut sum) = (0.0, 0.0);
    for flat in &flats.levels {
        let due = white.reflectance / std::f64::consts::PI * rig.cos_incidence(flat.theta_c);
        let w = (due / flat.sigma_dn_s).powi(2);
        weight += w;
        sum += w * flat.rate_dn_s / due;
    }
    sum / weight
}

impl Prepared {
    /// Works the unit out anew after the flats' levels were changed.
    pub(super) fn settle_unit(&mut self, rig: &RigGeometry) {
        self.unit_dn_s = self.reference.map(|white| unit(&white, &self.flats, rig));
    }

    /// The white reference over its tilts in the observations' unit; empty without one.
    pub(super) fn flat_observations(&self) -> Vec<FlatObservation> {
        let Some(unit) = self.unit_dn_s else {
            return Vec::new();
        };
        let levels = self.flats.levels.iter();
        levels
            .map(|flat| FlatObservation {
                theta_c: flat.theta_c,
                signal: flat.rate_dn_s / unit,
                sigma: flat.sigma_dn_s / unit,
            })
            .collect()
    }
}

/// The dark level of one exposure time, and what makes its counts those of a linear camera.
pub struct DarkLevel(Dark);

impl DarkLevel {
    /// Mean dark counts per pixel.
    #[must_use]
    pub fn level_dn(&self) -> &[f32] {
        &self.0.level_dn
    }

    /// Variance that the mean dark counts have left.
    #[must_use]
    pub fn variance_dn2(&self) -> f64 {
        self.0.variance_dn2
    }

    /// What a linear camera would count in a pixel, dark level included; the count itself of one that is linear.
    #[must_use]
    pub fn linear_dn(&self, pixel: usize, dn: u16) -> f64 {
        self.0.linear_dn(pixel, dn)
    }
}

/// What the camera makes of light, pixel by pixel.
pub struct CameraCalibration {
    prepared: Prepared,
    /// Dark and flat frames that were left out.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Sentences for the user.
    pub warnings: Vec<String>,
}

/// Reads a series' darks and flats. Works for boards of patches too. A near lamp's own pattern is taken out: what is
/// left is the camera's, and the white reference's signals are those at the centre of tilt.
///
/// # Errors
/// [`ReductionError::FieldUnknown`] where a near lamp or camera is stated without its distance or the field's size,
/// [`ReductionError::ImpossibleCounts`] where most darks or most flats count more than the stated bits allow,
/// [`ReductionError::Cancelled`] when `cancel` is raised, [`ReductionError::Vanished`] when frames
/// go away meanwhile.
pub fn calibrate(
    source: &dyn FrameSource,
    cancel: &AtomicBool,
) -> Result<CameraCalibration, ReductionError> {
    let calls = Calls { source, cancel };
    let mut journal = Journal::default();
    let uniform = source.manifest().sample.layout.is_none();
    let viewing = super::viewing(source.manifest())?;
    let mut prepared = prepare(&calls, uniform && viewing.is_far(), &mut journal)?;
    viewing.take_out_lamp(&mut prepared);
    let (rejected_frames, warnings) = journal.close(source.rows());
    Ok(CameraCalibration {
        prepared,
        rejected_frames,
        warnings,
    })
}

impl CameraCalibration {
    /// Relative response per pixel, row by row; its mean over the good pixels is 1.
    #[must_use]
    pub fn response(&self) -> &[f32] {
        &self.prepared.flats.response.pixels
    }

    /// Relative variance that the response of one pixel has left from the flats.
    #[must_use]
    pub fn response_variance(&self) -> f64 {
        self.prepared.flats.response.variance
    }

    /// Pixels that are no defects.
    #[must_use]
    pub fn good(&self) -> &[bool] {
        &self.prepared.flats.response.good
    }

    /// Radiance per (count per second at response 1), the unit of `Observation::signal`: signal =
    /// (linear count − dark) / (exposure · response) · this. `None` without a white reference.
    #[must_use]
    pub fn radiance_per_dn_s(&self) -> Option<f64> {
        self.prepared.unit_dn_s.map(f64::recip)
    }

    /// What frames of an exposure time are read with.
    #[must_use]
    pub fn dark(&self, exposure_s: f64) -> DarkLevel {
        DarkLevel(self.prepared.darks.at(exposure_s))
    }

    /// Variance of one count whose expectation is `above_black_dn` above the black level.
    #[must_use]
    pub fn variance_dn2(&self, above_black_dn: f64) -> f64 {
        self.prepared.sensor.variance_dn2(above_black_dn)
    }

    /// Count without light and dark current, as the manifest states it.
    #[must_use]
    pub fn black_dn(&self) -> f64 {
        self.prepared.sensor.black_dn
    }

    /// Whether a count tells no more than "at least this".
    #[must_use]
    pub fn is_full(&self, dn: u16) -> bool {
        self.prepared.sensor.is_full(dn)
    }

    /// The white reference over its tilts; empty without one.
    #[must_use]
    pub fn flats(&self) -> Vec<FlatObservation> {
        self.prepared.flat_observations()
    }

    /// Certificate of the white reference.
    #[must_use]
    pub fn white_reference(&self) -> Option<WhiteReference> {
        self.prepared.reference
    }

    /// Frame `index`, if it can be read and has the right size.
    ///
    /// # Errors
    /// The frame's name with the reason, as a reduction lists it.
    pub fn load(&self, source: &dyn FrameSource, index: usize) -> Result<Frame, RejectedFrame> {
        let never = AtomicBool::new(false);
        let calls = Calls {
            source,
            cancel: &never,
        };
        load(&calls, index, &self.prepared.sensor).map_err(|rejection| RejectedFrame {
            file: source.rows()[index].file.clone(),
            reason: rejection.reason.to_owned(),
            detail: rejection.detail,
        })
    }
}

fn warn_of_missing_darks(calls: &Calls<'_>, darks: &Darks, journal: &mut Journal) {
    if darks.n_frames == 0 {
        return;
    }
    let mut exposures: Vec<f64> = calls
        .source
        .rows()
        .iter()
        .filter(|r| r.kind != FrameKind::Dark)
        .map(|r| r.exposure_s)
        .collect();
    exposures.sort_unstable_by(f64::total_cmp);
    exposures.dedup();
    for exposure_s in exposures {
        if !darks.covers(exposure_s) {
            journal.warn(format!(
                "no dark frame for {exposure_s} s: the nearest exposure time's stands in"
            ));
        }
    }
}

/// The white reference, if the series has both its certificate and usable flats.
fn white_reference(
    manifest: &Manifest,
    flats: &Flats,
    journal: &mut Journal,
) -> Option<WhiteReference> {
    if flats.levels.is_empty() {
        return None;
    }
    let Some(reflectance) = manifest.flat.as_ref().and_then(|f| f.reflectance) else {
        journal.warn(
            "there are flats, but the manifest states no [flat] reflectance: the scale is relative"
                .to_owned(),
        );
        return None;
    };
    let stated = manifest.flat.as_ref().and_then(|f| f.reflectance_std);
    if stated.is_none() {
        journal.warn(format!(
            "the manifest states no [flat] reflectance_std: {REFLECTANCE_STD_DEFAULT} is assumed"
        ));
    }
    Some(WhiteReference {
        reflectance,
        reflectance_std: stated.unwrap_or(REFLECTANCE_STD_DEFAULT),
    })
}
