//! Answers stored by caller and Idempotency-Key, so that a request that is sent twice acts once.

use std::time::Duration;

use sqlx::FromRow;

use super::{Store, StoreError, utc_text};

/// How long a key is known. Sent again later, the request acts again.
pub const KEY_AGE_MAX: Duration = Duration::from_secs(24 * 3600);

/// The first answer to a request.
#[derive(Debug, Clone, PartialEq, Eq, FromRow)]
pub struct KeptAnswer {
    /// HTTP status.
    pub status: u16,
    /// Value of the header Location, if it was sent.
    pub location: Option<String>,
    /// Body of the answer, JSON.
    pub body: String,
}

/// A request with a key.
#[derive(Debug, Clone, Copy)]
pub struct KeyedRequest<'a> {
    /// The caller: the key of another caller is another key.
    pub who: &'a str,
    /// Value of the header Idempotency-Key.
    pub key: &'a str,
    /// SHA-256 of method, address and body, in hexadecimal.
    pub sha256: &'a str,
}

impl Store {
    /// Time before which keys are forgotten.
    fn oldest_key(&self) -> String {
        utc_text(self.inner.clock.utc() - KEY_AGE_MAX)
    }

    /// Returns the answer stored for this request.
    ///
    /// # Errors
    /// [`StoreError::KeyReused`] if the caller used the key for another request.
    pub async fn kept_answer(
        &self,
        asked: KeyedRequest<'_>,
    ) -> Result<Option<KeptAnswer>, StoreError> {
        let row = sqlx::query_as::<_, (String, u16, Option<String>, String)>(
            "SELECT request, status, location, body FROM idempotency_keys WHERE who = ? AND key = ? AND at >= ?",
        )
        .bind(asked.who)
        .bind(asked.key)
        .bind(self.oldest_key())
        .fetch_optional(self.readers())
        .await?;
        match row {
            None => Ok(None),
            Some((kept, ..)) if kept != asked.sha256 => Err(StoreError::KeyReused),
            Some((_, status, location, body)) => Ok(Some(KeptAnswer {
                status,
                location,
                body,
            })),
        }
    }

    /// Stores an answer and forgets old keys; the first answer under a key stays.
    ///
    /// # Errors
    /// A database error.
    pub async fn keep_answer(
        &self,
        asked: KeyedRequest<'_>,
        answer: &KeptAnswer,
    ) -> Result<(), StoreError> {
        let mut transaction = self.writing().await?;
        sqlx::query("DELETE FROM idempotency_keys WHERE at < ?")
            .bind(self.oldest_key())
            .execute(&mut *transaction)
            .await?;
        sqlx::query(
            "INSERT OR IGNORE INTO idempotency_keys (who, key, request, status, location, body, at)
             VALUES (?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(asked.who)
        .bind(asked.key)
        .bind(asked.sha256)
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

    fn asked<'a>(who: &'a str, sha256: &'a str) -> KeyedRequest<'a> {
        KeyedRequest {
            who,
            key: "k",
            sha256,
        }
    }

    #[tokio::test]
    async fn a_key_answers_its_own_request_and_refuses_another_of_the_same_caller() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let answer = KeptAnswer {
            status: 202,
            location: Some("/api/v1/scans/1".into()),
            body: "{}".into(),
        };
        assert_eq!(store.kept_answer(asked("anna", "r")).await.unwrap(), None);
        store
            .keep_answer(asked("anna", "r"), &answer)
            .await
            .unwrap();
        let kept = store.kept_answer(asked("anna", "r")).await.unwrap();
        assert_eq!(kept, Some(answer));
        assert!(matches!(
            store.kept_answer(asked("anna", "other")).await,
            Err(StoreError::KeyReused)
        ));
        for request in ["r", "other"] {
            let of_another = store.kept_answer(asked("bert", request)).await;
            assert_eq!(of_another.unwrap(), None);
        }
    }

    #[tokio::test]
    async fn an_old_key_is_forgotten() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let answer = KeptAnswer {
            status: 202,
            location: None,
            body: "{}".into(),
        };
        store
            .keep_answer(asked("anna", "r"), &answer)
            .await
            .unwrap();
        let clock = &store.inner.clock;
        clock.sleep(KEY_AGE_MAX + Duration::from_secs(1)).await;
        assert_eq!(store.kept_answer(asked("anna", "r")).await.unwrap(), None);
        store
            .keep_answer(asked("bert", "r"), &answer)
            .await
            .unwrap();
        let rows: i64 = sqlx::query_scalar("SELECT count(*) FROM idempotency_keys")
            .fetch_one(store.readers())
            .await
            .unwrap();
        assert_eq!(rows, 1);
    }
}
