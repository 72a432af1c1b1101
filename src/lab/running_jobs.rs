//! The jobs that have started and not ended: their progress, and how to cancel them.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::task::JoinHandle;

use super::job_progress::ProgressMeter;
use crate::job::JobId;

struct RunningJob {
    cancel: Arc<AtomicBool>,
    progress: Arc<ProgressMeter>,
    task: JoinHandle<()>,
}

/// All jobs that have not ended.
#[derive(Default)]
pub(super) struct RunningJobs(Mutex<HashMap<JobId, RunningJob>>);

impl RunningJobs {
    /// Spawns `work`, which gets its cancel flag and its progress meter. `work` calls [`RunningJobs::ended`] at its end.
    pub fn start<F>(&self, id: JobId, work: impl FnOnce(Arc<AtomicBool>, Arc<ProgressMeter>) -> F)
    where
        F: Future<Output = ()> + Send + 'static,
    {
        let cancel = Arc::new(AtomicBool::new(false));
        let progress = Arc::new(ProgressMeter::new());
        // Held while the task starts, so that it cannot end before it is listed.
        let mut all = self.lock();
        let task = tokio::spawn(work(Arc::clone(&cancel), Arc::clone(&progress)));
        let job = RunningJob {
            cancel,
            progress,
            task,
        };
        all.insert(id, job);
    }

    /// Removes a job that has ended.
    pub fn ended(&self, id: JobId) {
        self.lock().remove(&id);
    }

    /// Returns the progress meter of a job; none if it has ended.
    pub fn progress(&self, id: JobId) -> Option<Arc<ProgressMeter>> {
        Some(Arc::clone(&self.lock().get(&id)?.progress))
    }

    /// Raises the cancel flag of a job. Returns whether it runs.
    pub fn cancel(&self, id: JobId) -> bool {
        let all = self.lock();
        let running = all.get(&id);
        if let Some(job) = running {
            job.cancel.store(true, Ordering::Relaxed);
        }
        running.is_some()
    }

    /// Cancels all jobs and waits until the end of each is stored.
    pub async fn cancel_all(&self) {
        let all: Vec<RunningJob> = self.lock().drain().map(|(_, job)| job).collect();
        for job in &all {
            job.cancel.store(true, Ordering::Relaxed);
        }
        for job in all {
            job.task.await.ok();
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<JobId, RunningJob>> {
        self.0.lock().expect("no holder of this lock panics")
    }
}
