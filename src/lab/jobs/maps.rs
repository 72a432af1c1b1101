//! Maps: the model fitted to every pixel of a scan.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::progress::ProgressMeter;
use super::work::{Finished, Work};
use crate::accuracy::map_forecast::of_map;
use crate::forecast::Forecast;
use crate::lab::failure::Failure;
use crate::lab::request_checks::{positive, share};
use crate::lab::{LabError, StoredSeries};
use crate::map::folder::map_into;
use crate::map::{self, MapOptions};
use crate::store::Store;

/// A request for a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MapRequest {
    /// Scan to map.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub scan_id: i64,
    /// Start no further pixels after this time, s; pixels that were not reached have no value.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub max_seconds: Option<f64>,
    /// Largest share of the brightest radiance that a pixel's model may neglect.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, exclusive_maximum = 1)]
    pub target_error: Option<f64>,
}

impl MapRequest {
    pub(in crate::lab) async fn prepare(&self, store: &Store) -> Result<MapWork, LabError> {
        positive([
            ("max_seconds", self.max_seconds),
            ("target_error", self.target_error),
        ])?;
        share("target_error", self.target_error)?;
        Ok(MapWork {
            series: StoredSeries::open(store, self.scan_id).await?,
            options: MapOptions {
                max_seconds: self.max_seconds,
                target_error: self.target_error,
                ..MapOptions::default()
            },
        })
    }
}

/// A checked map.
pub(in crate::lab) struct MapWork {
    series: StoredSeries,
    options: MapOptions,
}

impl Work for MapWork {
    fn forecast(&self, cancel: &AtomicBool) -> Option<Forecast> {
        of_map(&self.series, &self.options, cancel)
    }

    fn run(
        &self,
        folder: &Path,
        progress: &ProgressMeter,
        cancel: &AtomicBool,
    ) -> Result<Finished, Failure> {
        let options = MapOptions {
            scratch: folder.to_owned(),
            ..self.options.clone()
        };
        let report =
            |p: map::Progress| progress.report(p.stage.words(), p.done as u64, p.total as u64);
        Finished::new(&map_into(&self.series, &options, folder, &report, cancel)?)
    }
}
