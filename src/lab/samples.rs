//! Samples, corrections and kept answers: the small writes that clients ask the lab for.

use super::scans::plans::sample_facts;
use super::{Lab, LabError};
use crate::scan::ScanState;
use crate::series::{Manifest, SampleFacts};
use crate::store::StoreError;
use crate::store::idempotency::{KeptAnswer, KeyedRequest};
use crate::store::records::RecordPatch;
use crate::store::samples::{NewSample, Sample};
use crate::store::scans::Scan;

impl Lab {
    /// Adds a sample.
    ///
    /// # Errors
    /// [`LabError::Invalid`] for a value that is out of range, else what the store reports.
    pub async fn add_sample(&self, new: &NewSample) -> Result<Sample, LabError> {
        if let Some((field, problem)) = new.fault() {
            return Err(LabError::Invalid {
                field: field.into(),
                problem,
            });
        }
        Ok(self.store().add_sample(new).await?)
    }

    /// Gives a sample another name; the earlier one stays on record.
    ///
    /// # Errors
    /// [`LabError::Invalid`] for a name that is empty or too long, an unknown sample, or a store error.
    pub async fn rename_sample(&self, id: i64, name: &str) -> Result<Sample, LabError> {
        let new = NewSample {
            name: name.to_owned(),
            material: self.store().sample(id).await?.material,
            note: None,
            simulated: None,
        };
        if let Some(("name", problem)) = new.fault() {
            return Err(LabError::Invalid {
                field: "name".into(),
                problem,
            });
        }
        let renamed = self.store().rename_sample(id, name).await?;
        self.record_order(format!("part {id} named {name}"), None)
            .await;
        Ok(renamed)
    }

    /// Assigns a scan to another sample; the earlier one stays on record. If the material differs, later reductions use
    /// that of the new sample, and a completed scan is fitted again.
    ///
    /// # Errors
    /// [`LabError::NotNow`] while the scan holds the rig, an unknown scan or sample, or a store error.
    pub async fn assign_scan(&self, id: i64, sample_id: i64) -> Result<Scan, LabError> {
        let scan = self.with_unrecorded_end(self.store().scan(id).await?);
        if !scan.state.is_end() && scan.state != ScanState::Interrupted {
            return Err(LabError::NotNow {
                scan_id: id,
                state: scan.state,
                asked: "another part",
            });
        }
        let material = self.store().sample(sample_id).await?.material;
        let order = format!("assigned to part {sample_id}");
        let text = self.store().manifest(id).await?;
        let mut manifest = Manifest::from_toml(&text, "manifest.toml")?;
        if manifest.material() == material {
            let assigned = self.store().assign_scan(id, sample_id, &text).await?;
            self.record_order(order, Some(id)).await;
            return Ok(assigned);
        }
        manifest.sample = SampleFacts {
            layout: manifest.sample.layout.take(),
            ..sample_facts(&material)
        };
        let text = manifest.to_toml();
        let assigned = self.store().assign_scan(id, sample_id, &text).await?;
        self.record_order(order, Some(id)).await;
        if assigned.state == ScanState::Completed {
            self.fit_completed(id).await;
        }
        Ok(assigned)
    }

    /// Changes tags, note or archived flag of a scan; the earlier ones stay on record.
    ///
    /// # Errors
    /// [`LabError::Invalid`] for a value that is too long or not a tag, an unknown scan, or a store error.
    pub async fn change_record(&self, id: i64, patch: &RecordPatch) -> Result<Scan, LabError> {
        valid(patch)?;
        let before = self.store().scan(id).await?.record;
        let after = self.store().change_record(id, patch, &self.who).await?;
        if after != before {
            let order = match (before.archived, after.archived) {
                (false, true) => "scan archived",
                (true, false) => "scan restored",
                _ => "record of the scan changed",
            };
            self.record_order(order, Some(id)).await;
        }
        Ok(self.with_unrecorded_end(self.store().scan(id).await?))
    }

    /// Keeps the answer to a request under its idempotency key; the first answer under a key stays.
    ///
    /// # Errors
    /// What the store reports.
    pub async fn keep_answer(
        &self,
        asked: KeyedRequest<'_>,
        answer: &KeptAnswer,
    ) -> Result<(), StoreError> {
        self.store().keep_answer(asked, answer).await
    }
}

/// Checks a change of a record.
///
/// # Errors
/// [`LabError::Invalid`] for a value that is too long or not a tag.
fn valid(patch: &RecordPatch) -> Result<(), LabError> {
    match patch.fault() {
        None => Ok(()),
        Some((field, problem)) => Err(LabError::Invalid {
            field: field.into(),
            problem,
        }),
    }
}
