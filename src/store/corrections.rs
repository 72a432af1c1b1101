//! Corrections: another name for a sample, another sample for a scan. Each is a row; nothing stored before changes.

use super::samples::Sample;
use super::scans::Scan;
use super::{Store, StoreError};

impl Store {
    /// Gives a sample another name. The same name again is no correction.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::PartNameTaken`] where another sample has the name, or a database error.
    pub async fn rename_sample(&self, id: i64, name: &str) -> Result<Sample, StoreError> {
        if self.sample(id).await?.name != name {
            let mut transaction = self.writing().await?;
            let other: Option<i64> =
                sqlx::query_scalar("SELECT max(sample_id) FROM sample_now WHERE name = ?")
                    .bind(name)
                    .fetch_one(&mut *transaction)
                    .await?;
            if let Some(other) = other {
                return Err(StoreError::PartNameTaken {
                    name: name.to_owned(),
                    id: other,
                });
            }
            sqlx::query("INSERT INTO sample_names (sample_id, name, at) VALUES (?, ?, ?)")
                .bind(id)
                .bind(name)
                .bind(self.now_text())
                .execute(&mut *transaction)
                .await?;
            transaction.commit().await?;
        }
        self.sample(id).await
    }

    /// Assigns a scan to another sample; reductions read `manifest` from now on.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn assign_scan(
        &self,
        id: i64,
        sample_id: i64,
        manifest: &str,
    ) -> Result<Scan, StoreError> {
        self.sample(sample_id).await?;
        if self.scan(id).await?.sample_id != sample_id {
            let mut transaction = self.writing().await?;
            sqlx::query(
                "INSERT INTO scan_samples (scan_id, sample_id, manifest, at) VALUES (?, ?, ?, ?)",
            )
            .bind(id)
            .bind(sample_id)
            .bind(manifest)
            .bind(self.now_text())
            .execute(&mut *transaction)
            .await?;
            transaction.commit().await?;
        }
        self.scan(id).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::PageRequest;
    use crate::store::samples::tests::polymer;
    use crate::store::scans::ScanFilter;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    #[tokio::test]
    async fn a_renamed_sample_is_found_by_its_name_and_keeps_the_earlier_ones() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let sample = polymer(&store).await;
        assert!(sample.earlier_names.is_empty());
        store.rename_sample(sample.id, "B-17").await.unwrap();
        store.rename_sample(sample.id, "B-17").await.unwrap();
        let renamed = store.rename_sample(sample.id, "B-18").await.unwrap();
        let earlier: Vec<&str> = renamed.earlier_names.iter().map(|e| &*e.name).collect();
        assert_eq!(
            (renamed.name.as_str(), earlier),
            ("B-18", vec!["polymer", "B-17"])
        );
        let named = async |name| {
            let found = store.samples(Some(name), PageRequest::default()).await;
            found.unwrap().items.len()
        };
        assert_eq!((named("B-18").await, named("polymer").await), (1, 0));
        // A second part cannot take its name; in an old store two parts may have it, and one of them can be renamed.
        let other = polymer(&store).await;
        let taken = store.rename_sample(other.id, "B-18").await.unwrap_err();
        assert!(
            matches!(&taken, StoreError::PartNameTaken { id, .. } if *id == sample.id),
            "{taken}"
        );
        let double = polymer(&store).await;
        store.rename_sample(double.id, "B-19").await.unwrap();
        assert_eq!(named("polymer").await, 1);
        let missing = store.rename_sample(99, "x").await;
        assert!(matches!(missing, Err(StoreError::NotFound { .. })));
    }

    #[tokio::test]
    async fn a_scan_of_another_sample_is_listed_there_with_its_trace() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let other = polymer(&store).await;
        store.rename_sample(other.id, "other").await.unwrap();
        let assigned = store
            .assign_scan(scan.id, other.id, "corrected")
            .await
            .unwrap();
        assert_eq!(
            (assigned.sample_id, assigned.sample_name.as_str()),
            (other.id, "other")
        );
        assert_eq!(store.manifest(scan.id).await.unwrap(), "corrected");
        let of = async |sample_id| {
            let filter = ScanFilter {
                sample_id: Some(sample_id),
                ..ScanFilter::default()
            };
            let found = store.scans(filter, PageRequest::default()).await;
            found.unwrap().items.len()
        };
        assert_eq!((of(other.id).await, of(scan.sample_id).await), (1, 0));
        // Back again: both assignments stay.
        let back = store
            .assign_scan(scan.id, scan.sample_id, "as before")
            .await
            .unwrap();
        let earlier: Vec<i64> = back.earlier_samples.iter().map(|e| e.sample_id).collect();
        assert_eq!(earlier, [scan.sample_id, other.id]);
        let unknown = store.assign_scan(scan.id, 99, "").await;
        assert!(matches!(unknown, Err(StoreError::NotFound { .. })));
    }
}
