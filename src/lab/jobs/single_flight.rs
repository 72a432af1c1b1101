//! Concurrent requests for the same work share one run of it.
//!
//! [`SingleFlight::run`] returns the shared future of the run in progress, or starts one. When the last waiting caller
//! drops it, the work's cancel flag is raised. Results are not kept.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use futures::FutureExt;
use futures::future::{BoxFuture, Shared, WeakShared};

/// Runs in progress by key.
pub(in crate::lab) struct SingleFlight<K, T: Clone>(
    Mutex<HashMap<K, WeakShared<BoxFuture<'static, T>>>>,
);

impl<K, T: Clone> Default for SingleFlight<K, T> {
    fn default() -> Self {
        SingleFlight(Mutex::new(HashMap::new()))
    }
}

/// Raises its flag when it is dropped.
struct RaisedOnDrop(Arc<AtomicBool>);

impl Drop for RaisedOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl<K: Eq + Hash, T: Clone + Send + Sync + 'static> SingleFlight<K, T> {
    /// Returns the run in progress for `key`, or starts `work` with the flag that cancels it.
    pub fn run<F>(
        &self,
        key: K,
        work: impl FnOnce(Arc<AtomicBool>) -> F,
    ) -> Shared<BoxFuture<'static, T>>
    where
        F: Future<Output = T> + Send + 'static,
    {
        let mut all = self.0.lock().expect("no holder of this lock panics");
        all.retain(|_, run| run.upgrade().is_some());
        if let Some(run) = all.get(&key).and_then(WeakShared::upgrade) {
            return run;
        }
        let cancel = RaisedOnDrop(Arc::default());
        let work = work(Arc::clone(&cancel.0));
        let run = async move {
            let _raised_on_drop = cancel;
            work.await
        };
        let run = run.boxed().shared();
        if let Some(weak) = run.downgrade() {
            all.insert(key, weak);
        }
        run
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;
    use tokio::sync::oneshot;

    #[tokio::test]
    async fn concurrent_callers_share_one_run_and_the_next_caller_starts_another() {
        let flights = SingleFlight::<&str, u32>::default();
        let begun = Arc::new(AtomicU32::new(0));
        let run = |key, gate: oneshot::Receiver<()>| {
            let begun = Arc::clone(&begun);
            flights.run(key, |_| async move {
                let number = begun.fetch_add(1, Ordering::Relaxed);
                gate.await.ok();
                number
            })
        };
        let (go, gate) = oneshot::channel();
        let mut first = run("scan 1", gate);
        assert_eq!((&mut first).now_or_never(), None);
        let second = run("scan 1", oneshot::channel().1);
        let other = run("scan 2", oneshot::channel().1);
        assert_eq!(other.await, 1);
        // The first caller goes away; the second still gets the shared result.
        drop(first);
        go.send(()).unwrap();
        assert_eq!(second.await, 0);
        let third = run("scan 1", oneshot::channel().1);
        assert_eq!(third.await, 2);
    }

    #[tokio::test]
    async fn work_is_cancelled_when_its_last_caller_goes_away() {
        let flights = SingleFlight::<i64, ()>::default();
        let mut cancel = None;
        let begin = |flag: Arc<AtomicBool>| {
            cancel = Some(flag);
            std::future::pending()
        };
        let mut first = flights.run(1, begin);
        let second = flights.run(1, |_| std::future::pending());
        let cancel = cancel.unwrap();
        assert_eq!((&mut first).now_or_never(), None);
        drop(first);
        assert!(!cancel.load(Ordering::Relaxed));
        drop(second);
        assert!(cancel.load(Ordering::Relaxed));
    }
}
