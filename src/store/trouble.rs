//! What keeps the store from answering: a disk that does not answer, and another program that holds the lock of the database.
//!
//! All who wait for the store ask here. The lock is noted by the write that finds it held. The disk is asked by changing the time
//! of a file: reading may still be possible on one that takes no change. All who ask at a time share one question, so that a
//! disk that hangs for a night holds one thread.

use std::sync::{Mutex, MutexGuard, OnceLock};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::time::{sleep, timeout};

use super::{Inner, LOCK_ATTEMPT, Store, StoreError, lock};

/// Time after which a disk counts as silent. Changing the time of a file takes only milliseconds on a slow disk.
const DISK_ANSWER: Duration = Duration::from_millis(900);

/// Time that a reading takes at most on a disk that answers: readings that take longer ask whether it does.
const READ_ANSWER: Duration = Duration::from_millis(200);

/// What keeps writes waiting.
#[derive(Debug, Default)]
pub(super) struct Watch {
    /// When a write last found the database locked by another program.
    lock_seen: Mutex<Option<Instant>>,
    /// From then on no write waits for such a lock.
    no_wait_from: OnceLock<Instant>,
    /// What the disk was asked last.
    question: Mutex<Option<Question>>,
}

/// A question to the disk.
#[derive(Debug, Clone)]
struct Question {
    asked: Instant,
    /// Turns true with the answer.
    answered: watch::Receiver<bool>,
}

impl Question {
    fn is_open(&self) -> bool {
        // A sender that is gone no longer answers.
        !*self.answered.borrow() && self.answered.has_changed().is_ok()
    }
}

impl Watch {
    /// A write found the database locked.
    pub fn lock_is_held(&self, now: Instant) {
        *self.lock_seen() = Some(now);
    }

    /// A write got the lock.
    pub fn lock_is_free(&self) {
        *self.lock_seen() = None;
    }

    /// Whether no write waits for another program any more.
    pub fn waits_are_over(&self, now: Instant) -> bool {
        self.no_wait_from.get().is_some_and(|from| now >= *from)
    }

    /// Whether a write waits because another program holds the lock.
    fn is_locked(&self) -> bool {
        let seen = *self.lock_seen();
        seen.is_some_and(|seen| seen.elapsed() < 3 * LOCK_ATTEMPT)
    }

    fn lock_seen(&self) -> MutexGuard<'_, Option<Instant>> {
        self.lock_seen
            .lock()
            .expect("no holder of this lock panics")
    }
}

impl Store {
    /// Checks that the disk answers, and that no other program holds the lock of the database or gives it up within this time.
    ///
    /// # Errors
    /// [`StoreError::Locked`] or [`StoreError::NoAnswer`]; the next write reports what else is wrong.
    pub async fn check_writing(&self, wait: Duration) -> Result<(), StoreError> {
        // First: a disk that takes no change may still give the lock.
        self.check_disk().await?;
        tokio::select! {
            biased;
            written = self.writing_within(wait) => match written {
                Err(StoreError::Locked) => Err(StoreError::Locked),
                Ok(_) | Err(_) => Ok(()),
            },
            // Other writes wait before this one.
            trouble = self.trouble(wait + LOCK_ATTEMPT) => Err(trouble),
        }
    }

    /// Waits while writes are possible; returns why they are not, at the earliest after this time.
    pub async fn trouble(&self, wait: Duration) -> StoreError {
        loop {
            let (answer, ()) = futures::join!(self.check_disk(), sleep(wait));
            match answer {
                Err(silent) => return silent,
                Ok(()) if self.inner.trouble.is_locked() => return StoreError::Locked,
                Ok(()) => {}
            }
        }
    }

    /// Waits while the disk answers, for one who reads; returns why it does not.
    pub async fn silence(&self) -> StoreError {
        loop {
            sleep(READ_ANSWER).await;
            if let Err(silent) = self.check_disk().await {
                return silent;
            }
        }
    }

    /// Checks that the disk takes a change.
    ///
    /// # Errors
    /// [`StoreError::NoAnswer`].
    pub async fn check_disk(&self) -> Result<(), StoreError> {
        let mut question = self.question();
        let left = DISK_ANSWER.saturating_sub(question.asked.elapsed());
        let answer = question.answered.wait_for(|answered| *answered);
        match timeout(left, answer).await {
            Ok(_) => Ok(()),
            Err(_) => Err(StoreError::NoAnswer),
        }
    }

    /// Returns the question that waits for its answer, or a new one.
    fn question(&self) -> Question {
        let asked_last = &self.inner.trouble.question;
        let mut asked_last = asked_last.lock().expect("no holder of this lock panics");
        if let Some(open) = asked_last.as_ref().filter(|last| last.is_open()) {
            return open.clone();
        }
        let (answer, answered) = watch::channel(false);
        let store = self.clone();
        tokio::task::spawn_blocking(move || {
            let Inner { disk, folder, .. } = &*store.inner;
            disk.ask(&folder.join(lock::FILE));
            // Those who asked may be gone.
            answer.send(true).ok();
        });
        let question = Question {
            asked: Instant::now(),
            answered,
        };
        asked_last.insert(question).clone()
    }

    /// Lets no write wait for another program's lock after this time: the daemon ends.
    pub fn end_waits(&self, after: Duration) {
        let from = Instant::now() + after;
        self.inner.trouble.no_wait_from.set(from).ok();
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::path::Path;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU32, Ordering};
    use std::sync::mpsc;

    use super::*;
    use crate::clock::SteppedClock;
    use crate::store::disk::{Disk, RealDisk};

    /// A disk that answers no question while its gate is closed.
    struct SilentDisk {
        gate: Mutex<mpsc::Receiver<()>>,
        asked: AtomicU32,
    }

    impl Disk for SilentDisk {
        fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
            RealDisk.write_durably(path, bytes)
        }

        fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
            RealDisk.free_bytes(folder)
        }

        fn ask(&self, _: &Path) {
            self.asked.fetch_add(1, Ordering::SeqCst);
            // An open gate has no sender.
            self.gate.lock().unwrap().recv().ok();
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn all_who_wait_for_a_silent_disk_share_one_question_and_continue_with_its_answer() {
        let folder = tempfile::tempdir().unwrap();
        let (gate, closed) = mpsc::channel();
        let disk = Arc::new(SilentDisk {
            gate: Mutex::new(closed),
            asked: AtomicU32::new(0),
        });
        let opened = Store::open(
            folder.path(),
            Arc::clone(&disk) as _,
            Arc::new(SteppedClock::new()),
        );
        let (store, _) = opened.await.unwrap();
        let begun = Instant::now();
        let asked = futures::future::join_all((0..50).map(|_| store.check_disk())).await;
        let is_silent =
            |answer: &Result<(), StoreError>| matches!(answer, Err(StoreError::NoAnswer));
        assert!(asked.iter().all(is_silent));
        // One after the other they would take five times as long.
        assert!(begun.elapsed() < 10 * DISK_ANSWER, "{:?}", begun.elapsed());
        // What is known is returned without the wait.
        let later = Instant::now();
        let wait = Duration::from_secs(60);
        let refused = store.check_writing(wait).await.unwrap_err();
        assert!(matches!(refused, StoreError::NoAnswer), "{refused}");
        assert!(matches!(store.silence().await, StoreError::NoAnswer));
        assert!(later.elapsed() < wait / 2, "{:?}", later.elapsed());
        assert_eq!(disk.asked.load(Ordering::SeqCst), 1);
        drop(gate);
        while store.check_disk().await.is_err() {
            tokio::task::yield_now().await;
        }
        store.check_writing(wait).await.unwrap();
        let quiet = timeout(3 * READ_ANSWER, store.silence()).await;
        quiet.unwrap_err();
        store.close().await;
    }
}
