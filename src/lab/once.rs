//! Work that several ask for at once and that is done once.
//!
//! Call [`OncePerKey::ask`] and await what it gives. Who asks while the same is under way gets that one's result;
//! once nobody waits any more, the work is told to stop. It does not keep results.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use futures::FutureExt;
use futures::future::{BoxFuture, Shared, WeakShared};

/// Work that is awaited by all who asked for it.
pub(super) type Awaited<T> = Shared<BoxFuture<'static, T>>;

/// What is under way, by what it is of.
pub(super) struct OncePerKey<K, T: Clone>(Mutex<HashMap<K, WeakShared<BoxFuture<'static, T>>>>);

impl<K, T: Clone> Default for OncePerKey<K, T> {
    fn default() -> Self {
        OncePerKey(Mutex::new(HashMap::new()))
    }
}

/// Raises its flag when it goes.
struct RaisedAtTheEnd(Arc<AtomicBool>);

impl Drop for RaisedAtTheEnd {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl<K: Eq + Hash, T: Clone + Send + Sync + 'static> OncePerKey<K, T> {
    /// The work under way for `key`, or else `work`, which is given the flag that is raised once nobody waits for it.
    pub fn ask<F>(&self, key: K, work: impl FnOnce(Arc<AtomicBool>) -> F) -> Awaited<T>
    where
        F: Future<Output = T> + Send + 'static,
    {
        let mut all = self.0.lock().expect("no holder of this lock panics");
        all.retain(|_, work| work.upgrade().is_some());
        if let Some(under_way) = all.get(&key).and_then(WeakShared::upgrade) {
            return under_way;
        }
        let flag = RaisedAtTheEnd(Arc::new(AtomicBool::new(false)));
        let work = work(Arc::clone(&flag.0));
        let awaited = async move {
            let _raised_when_dropped = flag;
            work.await
        }
        .boxed()
        .shared();
        if let Some(under_way) = awaited.downgrade() {
            all.insert(key, under_way);
        }
        awaited
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;
    use tokio::sync::oneshot;

    #[tokio::test]
    async fn two_who_ask_at_once_share_one_piece_of_work_and_the_next_begins_anew() {
        let once = OncePerKey::<&str, u32>::default();
        let begun = Arc::new(AtomicU32::new(0));
        let ask = |key, gate: oneshot::Receiver<()>| {
            let begun = Arc::clone(&begun);
            once.ask(key, |_| async move {
                let number = begun.fetch_add(1, Ordering::Relaxed);
                gate.await.ok();
                number
            })
        };
        let (go, gate) = oneshot::channel();
        let mut first = ask("scan 1", gate);
        assert_eq!((&mut first).now_or_never(), None);
        let second = ask("scan 1", oneshot::channel().1);
        let other = ask("scan 2", oneshot::channel().1);
        assert_eq!(other.await, 1);
        // The one who came first goes; the other still gets what was begun for both.
        drop(first);
        go.send(()).unwrap();
        assert_eq!(second.await, 0);
        let third = ask("scan 1", oneshot::channel().1);
        assert_eq!(third.await, 2);
    }

    #[tokio::test]
    async fn work_that_nobody_waits_for_is_told_to_stop() {
        let once = OncePerKey::<i64, ()>::default();
        let mut told = None;
        let begin = |flag: Arc<AtomicBool>| {
            told = Some(flag);
            std::future::pending()
        };
        let mut first = once.ask(1, begin);
        let second = once.ask(1, |_| std::future::pending());
        let told = told.unwrap();
        assert_eq!((&mut first).now_or_never(), None);
        drop(first);
        assert!(!told.load(Ordering::Relaxed));
        drop(second);
        assert!(told.load(Ordering::Relaxed));
    }
}
