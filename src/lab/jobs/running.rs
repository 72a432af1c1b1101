//! The jobs that have started and not ended: their progress, and how to cancel them.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::task::JoinHandle;

use super::progress::ProgressMeter;
use crate::job::JobId;
use crate::store::jobs::JobEnd;

struct RunningJob {
    cancel: Arc<AtomicBool>,
    progress: Arc<ProgressMeter>,
    task: JoinHandle<()>,
}

/// All jobs that have not ended.
#[derive(Default)]
pub(in crate::lab) struct RunningJobs {
    all: Mutex<HashMap<JobId, RunningJob>>,
    /// Whether the daemon ends.
    interrupted: AtomicBool,
}

impl RunningJobs {
    /// Spawns `work`, which gets its cancel flag and its progress meter. `work` calls [`RunningJobs::ended`] at its end.
    pub fn start<F>(&self, id: JobId, work: impl FnOnce(Arc<AtomicBool>, Arc<ProgressMeter>) -> F)
    where
        F: Future<Output = ()> + Send + 'static,
    {
        let progress = Arc::new(ProgressMeter::new());
        // Held while the task starts, so that it cannot end before it is listed.
        let mut all = self.lock();
        // A job that starts while the daemon ends is interrupted at once.
        let cancel = Arc::new(AtomicBool::new(self.interrupted.load(Ordering::Relaxed)));
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

    /// Returns the end of a job whose cancel flag was raised: by a person, or by the end of the daemon.
    pub fn end_of_cancelled(&self) -> JobEnd {
        match self.interrupted.load(Ordering::Relaxed) {
            true => JobEnd::Interrupted,
            false => JobEnd::Cancelled,
        }
    }

    /// Interrupts all jobs and waits until the end of each is stored.
    pub async fn interrupt_all(&self) {
        self.interrupted.store(true, Ordering::Relaxed);
        loop {
            let all: Vec<RunningJob> = self.lock().drain().map(|(_, job)| job).collect();
            if all.is_empty() {
                return;
            }
            for job in &all {
                job.cancel.store(true, Ordering::Relaxed);
            }
            for job in all {
                job.task.await.ok();
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<JobId, RunningJob>> {
        self.all.lock().expect("no holder of this lock panics")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::JobKind;

    #[tokio::test]
    async fn a_job_that_starts_while_the_daemon_ends_is_interrupted() {
        let jobs = RunningJobs::default();
        jobs.interrupt_all().await;
        let (send, flag) = tokio::sync::oneshot::channel();
        jobs.start(JobId::new(JobKind::Fit, 1), |cancel, _| async move {
            send.send(cancel.load(Ordering::Relaxed)).ok();
        });
        assert_eq!(flag.await, Ok(true));
        assert_eq!(jobs.end_of_cancelled(), JobEnd::Interrupted);
    }
}
