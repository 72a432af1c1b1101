//! Samples and kept answers: the small writes that clients ask the lab for.

use super::{Lab, LabError};
use crate::store::StoreError;
use crate::store::idempotency::{KeptAnswer, KeyedRequest};
use crate::store::samples::{NewSample, Sample};

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
