//! The calibration under the camera's curve: what turns the sums of samples into levels.

use std::sync::Arc;

use super::FrameSource;
use super::calibration;
use super::calibration_sums::Calibration;
use super::darks::DarkNoises;
use super::detector::Detector;
use super::flats::{self, FlatFrame, FlatLevel, FlatRate, Judged};
use super::levels::{CellCorrection, ResponseCorrection};
use super::measure::{FrameOutcome, Measured};
use super::reduction_log::{ReductionLog, Rejection};
use super::sensor::Sensor;
use super::series_context::SeriesContext;
use crate::observation::WhiteReference;
use crate::series::FrameRow;

/// Flats that the corrected counts leave out for their level, where these are others than those that the counts as they are
/// leave out.
pub(super) fn judged_otherwise(
    source: &dyn FrameSource,
    series: &SeriesContext,
    calibration: &Calibration,
    detector: &Detector,
) -> Option<Judged> {
    let sums = &calibration.sums;
    let mut flats = sums.flats(&series.places);
    for flat in &mut flats {
        let by = detector.correction(flat.exposure_s)?;
        let n: f64 = flat.cells.iter().map(|cell| cell.0[0]).sum();
        let corrected: f64 = flat.cells.iter().map(|cell| cell.corrected(by)).sum();
        flat.mean_dn = corrected / n.max(1.0);
    }
    let rig = source.manifest().rig_geometry();
    let judged = flats::judge(&flats, &rig, series.viewing.is_far());
    let ids: Vec<i64> = judged.keys().map(|place| series.ids[*place]).collect();
    (ids != sums.judged).then_some(judged)
}

/// What turns the sums of samples into observations: the calibration under the camera's curve.
pub(super) struct Scale {
    pub(super) sensor: Sensor,
    pub(super) darks: DarkNoises,
    pub(super) detector: Arc<Detector>,
    pub(super) levels: Vec<FlatLevel>,
    pub(super) lamp_scatter: Option<f64>,
    pub(super) n_flats: u32,
    pub(super) response_variance: f64,
    pub(super) reference: Option<WhiteReference>,
    pub(super) unit_dn_s: Option<f64>,
    response: ResponseCorrection,
    far: bool,
}

impl Scale {
    pub(super) fn of(
        source: &dyn FrameSource,
        series: &SeriesContext,
        calibration: &Calibration,
        detector: &Arc<Detector>,
    ) -> Scale {
        let (sums, manifest) = (&calibration.sums, source.manifest());
        let sensor = sums.sensor(source);
        let rate = |flat: &FlatFrame| -> Option<FlatRate> {
            let mut level = flat.level?;
            if let Some(by) = detector.correction(flat.exposure_s) {
                level.total = flat.cells.iter().map(|cell| cell.corrected(by)).sum();
            }
            Some(level.rate(flat, &sensor, &sums.darks.at(flat.exposure_s)))
        };
        let rates: Vec<FlatRate> = sums.flats(&series.places).iter().filter_map(rate).collect();
        let rig = manifest.rig_geometry();
        let lamp_scatter = flats::lamp_scatter(&rates, &rig);
        let n_flats = rates.len() as u32;
        let mut levels = flats::by_tilt(rates, lamp_scatter);
        for (level, share) in levels.iter_mut().zip(&sums.lamp_shares) {
            level.rate_dn_s /= share;
            level.sigma_dn_s /= share;
        }
        let lights = sums.lights.iter();
        let lights = lights.filter_map(|(exposure_s, mean_dn)| {
            Some((detector.correction(*exposure_s)?, *mean_dn))
        });
        let mut response = ResponseCorrection {
            lights: lights.collect(),
            mean: 0.0,
        };
        let good: f64 = sums.response.iter().map(|cell| cell[0]).sum();
        let light: f64 = sums.response.iter().map(|cell| response.sum(*cell)).sum();
        response.mean = light / good.max(1.0);
        let response_variance = match response.mean > 0.0 {
            true => {
                let noise = sensor.gain_dn * response.mean + sums.response_noise_dn2;
                noise / (response.mean * response.mean)
            }
            false => sums.response_variance,
        };
        let reference = calibration::certificate(manifest).filter(|_| !levels.is_empty());
        Scale {
            unit_dn_s: reference.map(|white| calibration::unit(&white, &levels, &rig)),
            darks: sums.darks.clone(),
            detector: Arc::clone(detector),
            far: series.viewing.is_far(),
            sensor,
            levels,
            lamp_scatter,
            n_flats,
            response_variance,
            reference,
            response,
        }
    }

    /// The levels of a frame.
    pub(super) fn measured(
        &self,
        rows: &[FrameRow],
        index: usize,
        outcome: &FrameOutcome,
    ) -> Result<Measured, Rejection> {
        let exposure_s = rows[index].exposure_s;
        match outcome {
            FrameOutcome::LeftOut(why) => Err(why.clone()),
            FrameOutcome::Reduced(sums) => {
                let correction = self.detector.correction(exposure_s);
                let correction = correction.map(|camera| CellCorrection {
                    camera,
                    response: &self.response,
                });
                Ok(sums.measured(index, exposure_s, self.far, correction))
            }
        }
    }
}

/// Writes down what is to be said of the calibration: first of darks and camera, then of the flats.
pub(super) fn log_calibration(
    source: &dyn FrameSource,
    series: &SeriesContext,
    calibration: &Calibration,
    detector: &Detector,
    log: &mut ReductionLog,
) {
    let [darks, flats] = &calibration.sums.logs;
    darks.add_to(log, &series.places);
    if calibration.sums.n_darks > 0 {
        calibration::warn_of_missing_darks(source.rows(), &calibration.sums.darks, log);
    }
    if let Some(words) = detector.words() {
        log.warn(words);
    }
    flats.add_to(log, &series.places);
    calibration::warn_of_reference(source.manifest(), calibration.sums.no_flats(), log);
}
