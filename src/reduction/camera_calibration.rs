//! The camera's calibration for a per-pixel map: [`calibrate`].

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::cache::ReductionCache;
use super::calibration::{
    Preparation, Prepared, flat_observations, prepare, warn_of_missing_darks, warn_of_reference,
};
use super::darks::Dark;
use super::load::{Calls, HeldFrames, load_once};
use super::outcomes::{self, Wanted};
use super::reduction_log::ReductionLog;
use super::scale::log_calibration;
use super::series_context::SeriesContext;
use super::{FrameSource, ReductionError, reduce};
use crate::frame::Frame;
use crate::observation::{FlatObservation, RejectedFrame, WhiteReference};

/// The dark level of one exposure time, and the correction of its counts for the camera's curve.
pub struct DarkLevel(Dark);

impl DarkLevel {
    /// Returns the mean dark counts per pixel.
    #[must_use]
    pub fn level_dn(&self) -> &[f32] {
        &self.0.level_dn
    }

    /// Returns the variance of the mean dark counts.
    #[must_use]
    pub fn variance_dn2(&self) -> f64 {
        self.0.variance_dn2
    }

    /// Returns the count of a linear camera in a pixel, dark level included.
    #[must_use]
    pub fn linear_dn(&self, pixel: usize, dn: u16) -> f64 {
        self.0.linear_dn(pixel, dn)
    }
}

/// The camera's calibration, pixel by pixel.
pub struct CameraCalibration {
    prepared: Arc<Prepared>,
    /// Dark and flat frames that were left out.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Warnings.
    pub warnings: Vec<String>,
}

/// Calibrates the camera from a series' darks and flats and from the exposures that determine its curve. Works for boards of
/// patches too. The pattern of a near lamp is divided out: the response is the camera's, and the white reference's signals are
/// those at the centre of tilt.
///
/// # Errors
/// [`ReductionError::FieldUnknown`] where a near lamp or camera is stated without its distance or the field's size,
/// [`ReductionError::ImpossibleCounts`] where most darks or most flats count more than the stated bits allow,
/// [`ReductionError::Cancelled`] when `cancel` is raised, [`ReductionError::Vanished`] when frames disappear meanwhile.
pub fn calibrate(
    source: &dyn FrameSource,
    cancel: &AtomicBool,
) -> Result<CameraCalibration, ReductionError> {
    let calls = Calls {
        source,
        cancel,
        held: &HeldFrames::default(),
    };
    if source.reductions().is_some() {
        // The map's mean is reduced from the same frames: they are read once for both.
        let region = source.manifest().sample.layout.as_ref().map(|_| "even");
        if let Err(ReductionError::Cancelled) = reduce(source, region, cancel) {
            return Err(ReductionError::Cancelled);
        }
    }
    let series = SeriesContext::new(source)?;
    let own = ReductionCache::default();
    let mut kept = source.reductions().unwrap_or(&own).lock();
    let base = outcomes::calibration(&calls, &series, &mut kept, None)?;
    let wanted = Wanted::default();
    let seen = outcomes::outcomes(&calls, &series, &mut kept, (&base, &base), wanted)?;
    let detector = outcomes::detector(source, &base, &seen);
    let mut log = ReductionLog::default();
    log_calibration(source, &series, &base, &detector, &mut log);
    let prepared = match detector.is_straight() {
        true => outcomes::planes(&calls, &series, &mut kept, &base)?,
        false => {
            let how = Preparation {
                uniform: series.uniform,
                detector: Some(detector),
                judged: None,
            };
            let prepared = prepare(&calls, &series.viewing, &how)?;
            // Flats may be left out for another level than the one they have as they are.
            log = ReductionLog::default();
            log.extend(&prepared.logs[0]);
            if let (true, Some(detector)) = (prepared.darks.n_frames > 0, &how.detector) {
                warn_of_missing_darks(source.rows(), &prepared.darks.noises(), &mut log);
                if let Some(words) = detector.words() {
                    log.warn(words);
                }
            }
            log.extend(&prepared.logs[1]);
            warn_of_reference(
                source.manifest(),
                prepared.flats.levels.is_empty(),
                &mut log,
            );
            Arc::new(prepared)
        }
    };
    let (rejected_frames, warnings) = log.close(source.rows());
    Ok(CameraCalibration {
        prepared,
        rejected_frames,
        warnings,
    })
}

impl CameraCalibration {
    /// Returns the relative response per pixel, row by row; its mean over the good pixels is 1.
    #[must_use]
    pub fn response(&self) -> &[f32] {
        &self.prepared.flats.response.pixels
    }

    /// Returns the relative variance of the response of one pixel, from the noise of the flats.
    #[must_use]
    pub fn response_variance(&self) -> f64 {
        self.prepared.flats.response.variance
    }

    /// Returns the pixels without defect.
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

    /// Returns the dark level of an exposure time.
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

    /// Returns whether a count is saturated.
    #[must_use]
    pub fn is_full(&self, dn: u16) -> bool {
        self.prepared.sensor.is_full(dn)
    }

    /// The white reference over its tilts; empty without one.
    #[must_use]
    pub fn flats(&self) -> Vec<FlatObservation> {
        flat_observations(
            &self.prepared.flats.levels,
            self.prepared.unit_dn_s,
            &BTreeMap::new(),
        )
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
    pub fn load(
        &self,
        source: &dyn FrameSource,
        index: usize,
    ) -> Result<Arc<Frame>, RejectedFrame> {
        let calls = Calls {
            source,
            cancel: &AtomicBool::new(false),
            held: &HeldFrames::default(),
        };
        load_once(&calls, index, &self.prepared.sensor).map_err(|rejection| RejectedFrame {
            file: source.rows()[index].file.clone(),
            reason: rejection.reason.into_owned(),
            detail: rejection.detail,
        })
    }
}
