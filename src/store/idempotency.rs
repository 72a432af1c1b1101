//! Answers stored by Idempotency-Key, so that a request that is sent twice acts once.

use sqlx::FromRow;

use super::{Store, StoreError};

/// The first answer to a request.
#[derive(Debug, Clone, PartialEq, Eq, FromRow)]
pub struct KeptAnswer {
    /// HTTP status.
    pub status: u16,
    /// Location header.
    pub location: Option<String>,
    /// Body.
    pub body: String,
}

impl Store {
    /// Returns the answer stored under `key` for this request (`request` is its hash).
    ///
    /// # Errors
    /// [`StoreError::KeyReused`] if the key belongs to another request.
    pub async fn kept_answer(
        &self,
        key: &str,
        request: &str,
    ) -> Result<Option<KeptAnswer>, StoreError> {
        let row = sqlx::query_as::<_, (String, u16, Option<String>, String)>(
            "SELECT request, status, location, body FROM idempotency_keys WHERE key = ?",
        )
        .bind(key)
        .fetch_optional(self.readers())
        .await?;
        match row {
            None => Ok(None),
            Some((kept, ..)) if kept != request => Err(StoreError::KeyReused),
            Some((_, status, location, body)) => Ok(Some(KeptAnswer {
                status,
                location,
                body,
            })),
        }
    }

    /// Stores an answer; the first one under a key stays.
    ///
    /// # Errors
    /// A database error.
    pub async fn keep_answer(
        &self,
        key: &str,
        request: &str,
        answer: &KeptAnswer,
    ) -> Result<(), StoreError> {
        let mut transaction = self.writing().await?;
        sqlx::query(
            "INSERT OR IGNORE INTO idempotency_keys (key, request, status, location, body, at)
             VALUES (?, ?, ?, ?, ?, ?)",
        )
        .bind(key)
        .bind(request)
        .bind(answer.status)
        .bind(&answer.location)
        .bind(&answer.body)
        .bind(self.now_text())
        .execute(&mut *transaction)
        .await?;
        transaction.commit().await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::open;

    #[tokio::test]
    async fn a_key_answers_its_own_request_and_refuses_another() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let answer = KeptAnswer {
            status: 202,
            location: Some("/api/v1/scans/1".into()),
            body: "{}".into(),
        };
        assert_eq!(store.kept_answer("k", "r").await.unwrap(), None);
        store.keep_answer("k", "r", &answer).await.unwrap();
        assert_eq!(store.kept_answer("k", "r").await.unwrap(), Some(answer));
        assert!(matches!(
            store.kept_answer("k", "other").await,
            Err(StoreError::KeyReused)
        ));
    }
}
