//! Work on its own threads and tasks.
//!
//! [`blocking`] computes on a thread for blocking work; [`for_a_download`] does so one at a time; [`to_the_end`] continues
//! when its caller is dropped. A panic in any becomes [`LabError::Panicked`], so that a waiting caller gets an answer.

use tokio::sync::Semaphore;
use tokio::task::JoinError;

use super::LabError;

/// Runs a computation on a thread for blocking work.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, LabError> {
    tokio::task::spawn_blocking(work).await.map_err(panicked)
}

/// Runs a part of a large download. Only one runs at a time, so that downloads leave a processor to the rig and to other
/// requests, however many there are.
pub(super) async fn for_a_download<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, LabError> {
    static TURN: Semaphore = Semaphore::const_new(1);
    let _turn = TURN.acquire().await;
    blocking(work).await
}

/// Completes work that must not stop half-way: a client that disconnects drops its request's future at any `.await`.
pub(super) async fn to_the_end<T: Send + 'static>(
    work: impl Future<Output = Result<T, LabError>> + Send + 'static,
) -> Result<T, LabError> {
    tokio::spawn(work).await.map_err(panicked)?
}

fn panicked(error: JoinError) -> LabError {
    tracing::error!(%error, "work panicked: {error}; the message is above");
    LabError::Panicked
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use futures::FutureExt;
    use tokio::sync::oneshot;

    #[tokio::test]
    async fn a_panic_becomes_an_error_and_the_waiting_task_survives() {
        let broken = blocking::<()>(|| panic!("a matrix without rows")).await;
        let error = broken.unwrap_err();
        assert_eq!(error.code(), "internal");
        assert!(error.to_string().contains("log"), "{error}");
        let broken = to_the_end::<()>(async { panic!("no such row") }).await;
        assert!(matches!(broken, Err(LabError::Panicked)), "{broken:?}");
    }

    #[tokio::test]
    async fn one_part_of_a_download_is_made_at_a_time() {
        let (busy, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
        let parts = (0..8).map(|_| {
            let (busy, most) = (Arc::clone(&busy), Arc::clone(&most));
            for_a_download(move || {
                busy.fetch_add(1, Ordering::SeqCst);
                // Long enough for the others to be seen if they were here.
                for _ in 0..1000 {
                    most.fetch_max(busy.load(Ordering::SeqCst), Ordering::SeqCst);
                    std::thread::yield_now();
                }
                busy.fetch_sub(1, Ordering::SeqCst);
            })
        });
        let made = futures::future::join_all(parts).await;
        assert!(made.iter().all(Result::is_ok));
        assert_eq!(most.load(Ordering::SeqCst), 1);
    }

    #[tokio::test]
    async fn work_is_completed_after_its_caller_has_gone() {
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
