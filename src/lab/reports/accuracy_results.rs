//! Results of `ridged accuracy` in the data folder.

use std::time::SystemTime;

use serde_json::{Value, json};

use crate::accuracy::{AccuracyReport, Measurements};
use crate::lab::{Lab, LabError};
use crate::model::LeftOut;
use crate::store::{StoreError, utc_text};

/// Folder of the results, below the data folder.
pub const ACCURACY_FOLDER: &str = "accuracy";
/// File of the results in that folder.
pub const ACCURACY_FILE: &str = "accuracy.json";

impl Lab {
    /// Returns the last result of `ridged accuracy`, with its time as `written_at`; an empty one, which states how to
    /// measure, if there is none.
    ///
    /// # Errors
    /// [`LabError::Store`] if it cannot be read.
    pub async fn accuracy(&self) -> Result<Value, LabError> {
        let path = self
            .store()
            .folder()
            .join(ACCURACY_FOLDER)
            .join(ACCURACY_FILE);
        let text = match tokio::fs::read_to_string(&path).await {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                return Ok(json!(nothing_measured()));
            }
            Err(e) => return Err(StoreError::file("the measurement", &path, e).into()),
        };
        let mut found: Value = serde_json::from_str(&text)
            .map_err(|e| StoreError::file("the measurement", &path, e.into()))?;
        let written: Option<SystemTime> = tokio::fs::metadata(&path)
            .await
            .and_then(|m| m.modified())
            .ok();
        found["written_at"] = json!(written.map(|at| utc_text(at.into())));
        Ok(found)
    }
}

fn nothing_measured() -> AccuracyReport {
    AccuracyReport {
        machine: String::new(),
        seconds: 0.0,
        left_out: vec![LeftOut::new(
            "all scenes",
            "no measurement yet: run `ridged accuracy --data FOLDER` with this daemon's data folder",
            None,
        )],
        found: Measurements::default(),
        written_at: None,
    }
}
