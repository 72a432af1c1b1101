//! What merging needs of a calibration, in a form that is stored: sums of darks and flats whose counts are taken as they are.

use std::collections::HashMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::FrameSource;
use super::calibration::Prepared;
use super::darks::DarkNoises;
use super::detector::Exposures;
use super::flats::{self, FlatFrame, Judged, LevelSums};
use super::levels::Moments;
use super::reduction_log::{ReductionLog, Rejection};
use super::sensor::Sensor;
use super::series_context::SeriesContext;
use crate::geometry::RigGeometry;

/// A log whose frames are named by their ids.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct StoredLog {
    rejected: Vec<(i64, Rejection)>,
    warnings: Vec<String>,
}

impl StoredLog {
    fn of(log: &ReductionLog, ids: &[i64]) -> StoredLog {
        let (rejected, warnings) = log.parts();
        let rejected = rejected.iter();
        StoredLog {
            rejected: rejected.map(|(at, why)| (ids[*at], why.clone())).collect(),
            warnings: warnings.to_vec(),
        }
    }

    pub(super) fn add_to(&self, log: &mut ReductionLog, places: &HashMap<i64, usize>) {
        for (id, why) in &self.rejected {
            if let Some(place) = places.get(id) {
                log.reject(*place, why.clone());
            }
        }
        for sentence in &self.warnings {
            log.warn(sentence.clone());
        }
    }
}

/// A flat as it is stored.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct StoredFlat {
    frame_id: i64,
    theta_c_deg: f64,
    exposure_s: f64,
    mean_dn: f64,
    noise_share: f64,
    cells: Vec<Moments>,
    level: Option<LevelSums>,
}

/// What merging needs of a calibration: sums of darks and flats whose counts are taken as they are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct CalibrationSums {
    read_dn: f64,
    pub(super) darks: DarkNoises,
    pub(super) n_darks: u32,
    /// Of the darks, then of the flats.
    pub(super) logs: [StoredLog; 2],
    flats: Vec<StoredFlat>,
    /// Flats that are left out for their level.
    pub(super) judged: Vec<i64>,
    /// Exposure times and mean counts of the frames that make the response.
    pub(super) lights: Vec<(f64, f64)>,
    /// Number of good pixels, sum and sum of squares of the flats' relative brightness, by cell.
    pub(super) response: Vec<[f64; 3]>,
    pub(super) response_variance: f64,
    pub(super) response_noise_dn2: f64,
    /// By tilt: the share of the field's mean that is the lamp's pattern, of near lamps.
    pub(super) lamp_shares: Vec<f64>,
    /// Visits of the white reference, with their frames.
    pub(super) exposures: Vec<(Vec<i64>, Exposures)>,
}

impl CalibrationSums {
    pub(super) fn of(
        prepared: &Prepared,
        series: &SeriesContext,
        rig: &RigGeometry,
        judged: Option<&Judged>,
        exposures: Vec<(Vec<i64>, Exposures)>,
    ) -> CalibrationSums {
        let (flats, far) = (&prepared.flats, series.viewing.is_far());
        let ids = &series.ids;
        let stored = |flat: &FlatFrame| StoredFlat {
            frame_id: ids[flat.index],
            theta_c_deg: flat.theta_c_deg,
            exposure_s: flat.exposure_s,
            mean_dn: flat.mean_dn,
            noise_share: flat.noise_share,
            cells: flat.cells.clone(),
            level: flat.level,
        };
        let judged = judged.cloned();
        let judged = judged.unwrap_or_else(|| flats::judge(&flats.frames, rig, far));
        let logs = prepared.logs.each_ref();
        CalibrationSums {
            read_dn: prepared.sensor.read_dn,
            darks: prepared.darks.noises(),
            n_darks: prepared.darks.n_frames,
            logs: logs.map(|log| StoredLog::of(log, ids)),
            flats: flats.frames.iter().map(stored).collect(),
            judged: judged.keys().map(|place| ids[*place]).collect(),
            lights: flats.lights.clone(),
            response: flats.response.cells(&prepared.sensor),
            response_variance: flats.response.variance,
            response_noise_dn2: flats.response.noise_dn2,
            lamp_shares: flats.lamp_shares.clone(),
            exposures,
        }
    }

    /// Whether no flat counts.
    pub(super) fn no_flats(&self) -> bool {
        self.flats.iter().all(|flat| flat.level.is_none())
    }

    /// Whether merging can do with it: what was stored may be of anything.
    pub(super) fn is_usable(&self) -> bool {
        self.darks.is_usable()
    }

    /// The camera with the noise that the darks show.
    pub(super) fn sensor(&self, source: &dyn FrameSource) -> Sensor {
        Sensor {
            read_dn: self.read_dn,
            ..Sensor::new(source.manifest())
        }
    }

    pub(super) fn flats(&self, places: &HashMap<i64, usize>) -> Vec<FlatFrame> {
        let flat = |flat: &StoredFlat| {
            Some(FlatFrame {
                index: *places.get(&flat.frame_id)?,
                theta_c_deg: flat.theta_c_deg,
                exposure_s: flat.exposure_s,
                mean_dn: flat.mean_dn,
                noise_share: flat.noise_share,
                cells: flat.cells.clone(),
                level: flat.level,
            })
        };
        self.flats.iter().filter_map(flat).collect()
    }
}

/// A calibration's sums and the key that they are kept by.
#[derive(Clone)]
pub(super) struct Calibration {
    pub(super) key: String,
    pub(super) sums: Arc<CalibrationSums>,
    /// Flats that are left out for their level, where the camera's curve decides that.
    pub(super) judged: Option<Judged>,
}
