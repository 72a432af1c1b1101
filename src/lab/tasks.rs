//! Work on threads and tasks of its own.
//!
//! [`blocking`] computes away from the runtime's threads, [`to_the_end`] goes on where whoever asked is gone.
//! A panic in either is [`LabError::Panicked`], so that what waits for an end is told one.

use tokio::task::JoinError;

use super::LabError;

/// Computes on a thread for that.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, LabError> {
    tokio::task::spawn_blocking(work).await.map_err(panicked)
}

/// Does what must not be left half done: a client that goes away drops the request it sent, at any `.await`.
pub(super) async fn to_the_end<T: Send + 'static>(
    work: impl Future<Output = Result<T, LabError>> + Send + 'static,
) -> Result<T, LabError> {
    tokio::spawn(work).await.map_err(panicked)?
}

fn panicked(error: JoinError) -> LabError {
    tracing::error!(%error, "work broke off: {error}; the message is above");
    LabError::Panicked
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;
    use tokio::sync::oneshot;

    #[tokio::test]
    async fn a_panic_is_an_error_with_a_name_and_the_task_that_waits_lives_on() {
        let broken = blocking::<()>(|| panic!("a matrix without rows")).await;
        let error = broken.unwrap_err();
        assert_eq!(error.code(), "internal");
        assert!(error.to_string().contains("log"), "{error}");
        let broken = to_the_end::<()>(async { panic!("no such row") }).await;
        assert!(matches!(broken, Err(LabError::Panicked)), "{broken:?}");
    }

    #[tokio::test]
    async fn what_was_begun_is_done_although_nobody_waits() {
        let (go, gone) = oneshot::channel::<()>();
        let (done, is_done) = oneshot::channel();
        let work = to_the_end(async move {
            gone.await.ok();
            done.send(7).ok();
            Ok(())
        });
        assert!(work.now_or_never().is_none());
        go.send(()).unwrap();
        assert_eq!(is_done.await, Ok(7));
    }
}
