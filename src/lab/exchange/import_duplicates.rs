//! Detects a series that was imported before, with the same or with other facts.
//!
//! Frames are identified by their content. Manifest and list of frames decide the result of a fit, so a series of the
//! same frames with other facts is a different series: both are stored, and the differences are listed.

use std::collections::HashMap;

use crate::lab::{Lab, LabError};
use crate::series::Manifest;
use crate::store::StoreError;
use crate::store::frames::{FrameRecord, ImportedFrame};
use crate::wording::counted;
use crate::wording::differences::{self, Difference};

/// An earlier scan of the same frames.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportDuplicate {
    /// The scan.
    pub scan_id: i64,
    /// Differences between its facts and those of the new series, as sentences; empty if they are the same.
    pub differences: Vec<String>,
}

impl Lab {
    /// Returns the newest import of this series, or else the import of the same frames whose facts differ least.
    pub(in crate::lab) async fn imported_before(
        &self,
        manifest: &Manifest,
        frames: &[ImportedFrame],
    ) -> Result<Option<ImportDuplicate>, LabError> {
        let Some(first) = frames.first() else {
            return Ok(None);
        };
        let mut alike: Option<ImportDuplicate> = None;
        for scan_id in self.store().imports_with(&first.file.sha256).await? {
            let mut kept = self.store().frames_for_reduction(scan_id).await?;
            kept.retain(|frame| frame.scan_id == scan_id);
            let Some(mut differences) = of_frames(&kept, frames) else {
                continue;
            };
            differences.extend(of_manifests(&self.manifest(scan_id).await?, manifest)?);
            let found = ImportDuplicate {
                scan_id,
                differences,
            };
            if found.differences.is_empty() {
                return Ok(Some(found));
            }
            // Most likely the one that this series corrects; the newest of equals.
            let n = found.differences.len();
            if alike.as_ref().is_none_or(|best| n < best.differences.len()) {
                alike = Some(found);
            }
        }
        Ok(alike)
    }
}

/// Lists the differences between two manifests.
fn of_manifests(before: &Manifest, now: &Manifest) -> Result<Vec<String>, StoreError> {
    let value = |manifest: &Manifest| {
        serde_json::to_value(manifest).map_err(|e| StoreError::bad_row("scans", e))
    };
    let differences = differences::between(&value(before)?, &value(now)?);
    Ok(differences.iter().map(Difference::to_string).collect())
}

/// Lists the differences between two lists of the same frames, by column; `None` if the frames differ.
fn of_frames(before: &[FrameRecord], now: &[ImportedFrame]) -> Option<Vec<String>> {
    if before.len() != now.len() {
        return None;
    }
    let by_name: HashMap<&str, &FrameRecord> = before
        .iter()
        .map(|kept| (kept.name.as_str(), kept))
        .collect();
    let find = |frame: &ImportedFrame| {
        let kept = by_name.get(frame.name.as_str()).copied()?;
        (kept.sha256 == frame.file.sha256).then_some(kept)
    };
    let pairs: Vec<(&FrameRecord, &ImportedFrame)> = now
        .iter()
        .map(|frame| Some((find(frame)?, frame)))
        .collect::<Option<_>>()?;
    type Column = (
        &'static str,
        fn(&FrameRecord) -> String,
        fn(&ImportedFrame) -> String,
    );
    let columns: [Column; 6] = [
        ("kind", |f| f.kind.to_string(), |f| f.kind.to_string()),
        (
            "theta_c_deg",
            |f| f.theta_c_deg.to_string(),
            |f| f.theta_c_deg.to_string(),
        ),
        (
            "phi_s_deg",
            |f| f.phi_s_deg.to_string(),
            |f| f.phi_s_deg.to_string(),
        ),
        (
            "exposure_s",
            |f| f.exposure_s.to_string(),
            |f| f.exposure_s.to_string(),
        ),
        ("repeat", |f| f.repeat.to_string(), |f| f.repeat.to_string()),
        (
            "timestamp",
            |f| f.timestamp.clone(),
            |f| f.timestamp.clone(),
        ),
    ];
    let mut differences = Vec::new();
    for (column, was, is) in columns {
        let other: Vec<_> = pairs.iter().filter(|(f, g)| was(f) != is(g)).collect();
        if let Some((kept, frame)) = other.first() {
            differences.push(format!(
                "{column} of {}, first {}, was {} and is {}",
                counted(other.len(), "frame"),
                frame.name,
                was(kept),
                is(frame)
            ));
        }
    }
    Some(differences)
}
