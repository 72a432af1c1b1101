//! Contrasts: the contrast table of a scan, measured in its observations.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::progress::ProgressMeter;
use super::work::{Finished, Work};
use crate::accuracy::forecast::of_reduction;
use crate::contrast;
use crate::forecast::Forecast;
use crate::lab::failure::Failure;
use crate::lab::request_checks::check_region;
use crate::lab::{LabError, StoredSeries};
use crate::reduction;
use crate::store::Store;

/// A request for a contrast table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ContrastRequest {
    /// Scan to read.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub scan_id: i64,
    /// Region of a part that has several.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub region: Option<String>,
}

impl ContrastRequest {
    pub(in crate::lab) async fn prepare(&self, store: &Store) -> Result<ContrastWork, LabError> {
        let series = StoredSeries::open(store, self.scan_id).await?;
        check_region(&series, self.region.as_deref())?;
        Ok(ContrastWork {
            series,
            region: self.region.clone(),
        })
    }
}

/// A checked contrast table.
pub(in crate::lab) struct ContrastWork {
    series: StoredSeries,
    region: Option<String>,
}

impl Work for ContrastWork {
    fn forecast(&self, cancel: &AtomicBool) -> Option<Forecast> {
        of_reduction(&self.series, self.region.as_deref(), cancel)
    }

    fn run(&self, _: &Path, _: &ProgressMeter, cancel: &AtomicBool) -> Result<Finished, Failure> {
        let set = reduction::reduce(&self.series, self.region.as_deref(), cancel)?;
        let (_, report) =
            contrast::measure(&set).map_err(|e| Failure::because("no-contrast", e))?;
        Finished::new(&report)
    }
}
