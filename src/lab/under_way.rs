//! Work that has begun and not ended, by number: how far it is, and how it is told to stop.
//!
//! The lab keeps one [`AllUnderWay`] for fits and one for calculations. It does not know what the work is, nor
//! how its end is kept.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::task::JoinHandle;

use super::LabError;
use super::headway::Headway;
use crate::scan::event::TaskState;

struct UnderWay {
    cancel: Arc<AtomicBool>,
    headway: Arc<Headway>,
    task: JoinHandle<()>,
}

/// All work of one kind that has not ended.
#[derive(Default)]
pub(super) struct AllUnderWay(Mutex<HashMap<i64, UnderWay>>);

impl AllUnderWay {
    /// Begins `work`, which is given the flag that cancels it and where to tell how far it is. At its end it
    /// calls [`AllUnderWay::ended`].
    pub fn begin<F>(&self, number: i64, work: impl FnOnce(Arc<AtomicBool>, Arc<Headway>) -> F)
    where
        F: Future<Output = ()> + Send + 'static,
    {
        let cancel = Arc::new(AtomicBool::new(false));
        let headway = Arc::new(Headway::new());
        // Held while the work begins, so that it cannot end before it is known.
        let mut all = self.lock();
        let task = tokio::spawn(work(Arc::clone(&cancel), Arc::clone(&headway)));
        let work = UnderWay {
            cancel,
            headway,
            task,
        };
        all.insert(number, work);
    }

    /// Forgets work that has ended.
    pub fn ended(&self, number: i64) {
        self.lock().remove(&number);
    }

    /// How far work is; none where it has ended.
    pub fn headway(&self, number: i64) -> Option<Arc<Headway>> {
        Some(Arc::clone(&self.lock().get(&number)?.headway))
    }

    /// Asks work to stop; `what` and `state` are what to call it and how it ended where it has.
    ///
    /// # Errors
    /// There is no such work under way.
    pub fn cancel(
        &self,
        number: i64,
        what: &dyn std::fmt::Display,
        state: TaskState,
    ) -> Result<(), LabError> {
        match self.lock().get(&number) {
            // Between its last row and the moment when it is forgotten it has ended, too.
            Some(work) if state == TaskState::Running => {
                work.cancel.store(true, Ordering::Relaxed);
                Ok(())
            }
            _ => Err(LabError::NotThere {
                what: what.to_string(),
                number,
                state,
                problem: "there is nothing to cancel",
            }),
        }
    }

    /// Cancels all and waits until each has said how it ended.
    pub async fn cancel_all(&self) {
        let all: Vec<UnderWay> = self.lock().drain().map(|(_, work)| work).collect();
        for work in &all {
            work.cancel.store(true, Ordering::Relaxed);
        }
        for work in all {
            work.task.await.ok();
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<i64, UnderWay>> {
        self.0.lock().expect("no holder of this lock panics")
    }
}
