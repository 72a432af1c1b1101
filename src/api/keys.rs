//! Idempotency keys: a POST with a key is executed once per caller.

use std::collections::HashMap;
use std::sync::Arc;

use axum::body::{Body, to_bytes};
use axum::extract::{Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::sync::{Mutex, OwnedMutexGuard};

use super::App;
use super::caller::Principal;
use super::extract::{BODY_BYTES_MAX, UPLOAD};
use super::lease::LEASE;
use super::rig::{PREVIEW, STOP};
use super::session::SESSION;
use super::status::{self, ApiError};
use crate::access::LOCAL;
use crate::lab::LabError;
use crate::store::frames::sha256_hex;
use crate::store::idempotency::KeyedRequest;

/// Longest Idempotency-Key.
pub(super) const KEY_LENGTH_MAX: usize = 200;
/// Routes whose answers are not kept: each stop stops, each preview is new, an upload is too large to compare, and the
/// answers of the others have a secret.
pub(super) const UNKEYED: [&str; 5] = [STOP, SESSION, LEASE, PREVIEW, UPLOAD];

/// Executes a POST with an Idempotency-Key once. Sent again, it gets the first answer.
pub(super) async fn once_per_key(State(app): State<App>, request: Request, next: Next) -> Response {
    if UNKEYED.contains(&request.uri().path()) {
        return next.run(request).await;
    }
    let key = request.headers().get("idempotency-key").cloned();
    let Some(key) = key.filter(|_| request.method() == Method::POST) else {
        return next.run(request).await;
    };
    let key = match key.to_str() {
        Ok(key) if !key.is_empty() && key.len() <= KEY_LENGTH_MAX => key.to_owned(),
        _ => {
            let message = format!("must have 1 to {KEY_LENGTH_MAX} visible characters");
            return ApiError::invalid("Idempotency-Key", message).into_response();
        }
    };
    // When a client leaves, its request is dropped at any `.await`. On a task of its own the action is completed and
    // its answer is kept.
    let who = request.extensions().get::<Principal>();
    let who = who.map_or(LOCAL, |caller| &caller.name).to_owned();
    let acting = tokio::spawn(async move { keyed(&app, &who, &key, request, next).await });
    match acting.await {
        Ok(Ok(response)) => response,
        Ok(Err(problem)) => problem.into_response(),
        // The layer that catches panics answers.
        Err(broken) if broken.is_panic() => std::panic::resume_unwind(broken.into_panic()),
        Err(_) => ApiError::from(LabError::Stopping).into_response(),
    }
}

/// One lock per caller and key, so that requests with other keys do not wait for an import that takes minutes.
#[derive(Clone, Default)]
pub(super) struct KeyLocks(Arc<std::sync::Mutex<Locks>>);

/// Locks by caller and key.
type Locks = HashMap<(String, String), Arc<Mutex<()>>>;

impl KeyLocks {
    /// Waits for the lock of a caller's key.
    async fn of(&self, who: &str, key: &str) -> OwnedMutexGuard<()> {
        let lock = {
            let mut all = self.0.lock().expect("no holder of this lock panics");
            // Unused locks are removed.
            all.retain(|_, lock| Arc::strong_count(lock) > 1);
            Arc::clone(all.entry((who.to_owned(), key.to_owned())).or_default())
        };
        lock.lock_owned().await
    }
}

async fn keyed(
    app: &App,
    who: &str,
    key: &str,
    request: Request,
    next: Next,
) -> Result<Response, ApiError> {
    let (parts, body) = request.into_parts();
    let body = to_bytes(body, BODY_BYTES_MAX)
        .await
        .map_err(|_| ApiError::too_large(BODY_BYTES_MAX))?;
    let mut fingerprint = format!("{} {}\n", parts.method, parts.uri).into_bytes();
    fingerprint.extend_from_slice(&body);
    let asked = KeyedRequest {
        who,
        key,
        sha256: &sha256_hex(&fingerprint),
    };
    // The second of two simultaneous requests must find the first one's answer.
    let _lock = app.key_locks.of(who, key).await;
    let store = app.lab.store();
    if let Some(kept) = store.kept_answer(asked).await? {
        return Ok(status::repeated(kept));
    }
    let response = next.run(Request::from_parts(parts, Body::from(body))).await;
    if !response.status().is_success() {
        // Nothing was done, so the key can be used again.
        return Ok(response);
    }
    let (parts, body) = response.into_parts();
    let body = to_bytes(body, usize::MAX)
        .await
        .map_err(|_| ApiError::internal())?;
    let answer = status::to_keep(parts.status, &parts.headers, &body);
    app.lab.keep_answer(asked, &answer).await?;
    Ok(Response::from_parts(parts, Body::from(body)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;

    #[tokio::test]
    async fn a_key_waits_for_its_own_lock_only_and_is_removed_after() {
        let locks = KeyLocks::default();
        let first = locks.of("anna", "import").await;
        let mut again = Box::pin(locks.of("anna", "import"));
        assert!((&mut again).now_or_never().is_none());
        let other = locks.of("anna", "scan").now_or_never();
        assert!(other.is_some());
        let of_another = locks.of("bert", "import").now_or_never();
        assert!(of_another.is_some());
        drop((first, other, of_another));
        again.await;
        locks.of("anna", "last").await;
        let left = locks.0.lock().unwrap().len();
        assert_eq!(left, 1);
    }
}
