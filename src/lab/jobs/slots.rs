//! Limits how many jobs of a kind run at once. Each job uses all cores and holds frames in memory, so only a few run;
//! the others wait in the order of their requests and can be cancelled while they wait.
//!
//! Kinds do not wait for each other: an hour-long trace does not delay a fit.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use tokio::sync::{Semaphore, SemaphorePermit};

use super::progress::ProgressMeter;
use crate::job::JobKind;

/// How often a waiting job checks whether it was cancelled, and updates its position.
const POLL: Duration = Duration::from_millis(50);

/// Jobs of a kind that run at once; fits are short.
const fn at_once(kind: JobKind) -> usize {
    match kind {
        JobKind::Fit => 4,
        JobKind::Map | JobKind::Contrast | JobKind::Verdict | JobKind::Trace => 2,
    }
}

/// The slots of all kinds.
pub(in crate::lab) struct JobSlots([Slots; JobKind::ALL.len()]);

impl Default for JobSlots {
    fn default() -> Self {
        JobSlots(JobKind::ALL.map(|kind| Slots::new(at_once(kind))))
    }
}

impl JobSlots {
    /// Returns the slots of a kind.
    pub(in crate::lab) fn of(&self, kind: JobKind) -> &Slots {
        &self.0[kind as usize]
    }
}

/// The slots of one kind and the queue for them.
pub(in crate::lab) struct Slots {
    free: Semaphore,
    queue: Mutex<Queue>,
}

/// Tickets of the waiting jobs; a lower ticket is served earlier.
#[derive(Default)]
struct Queue {
    next_ticket: u64,
    waiting: BTreeSet<u64>,
}

/// A place in the queue; it is given up when this is dropped.
struct Ticket<'a> {
    slots: &'a Slots,
    number: u64,
}

impl Ticket<'_> {
    fn position(&self) -> usize {
        let queue = self.slots.lock();
        queue.waiting.range(..=self.number).count()
    }
}

impl Drop for Ticket<'_> {
    fn drop(&mut self) {
        self.slots.lock().waiting.remove(&self.number);
    }
}

impl Slots {
    fn new(at_once: usize) -> Self {
        Slots {
            free: Semaphore::new(at_once),
            queue: Mutex::default(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().expect("no holder of this lock panics")
    }

    fn ticket(&self) -> Ticket<'_> {
        let mut queue = self.lock();
        let number = queue.next_ticket;
        queue.next_ticket += 1;
        queue.waiting.insert(number);
        Ticket {
            slots: self,
            number,
        }
    }

    /// Waits for a slot, which is free again when the permit is dropped. Returns none if the job is cancelled first.
    pub(in crate::lab) async fn acquire(
        &self,
        progress: &ProgressMeter,
        cancel: &AtomicBool,
    ) -> Option<SemaphorePermit<'_>> {
        let slot = match self.free.try_acquire() {
            Ok(slot) => slot,
            Err(_) => {
                let ticket = self.ticket();
                let mut slot = std::pin::pin!(self.free.acquire());
                loop {
                    progress.queue(ticket.position());
                    if cancel.load(Ordering::Relaxed) {
                        return None;
                    }
                    // One future for all polls: it holds the place in the semaphore's queue.
                    if let Ok(slot) = tokio::time::timeout(POLL, &mut slot).await {
                        break slot.ok()?;
                    }
                }
            }
        };
        progress.start();
        Some(slot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[tokio::test]
    async fn a_waiting_job_knows_its_position_gets_the_next_slot_and_can_be_cancelled() {
        let slots = Arc::new(Slots::new(1));
        let (first, never) = (ProgressMeter::new(), AtomicBool::new(false));
        let held = slots.acquire(&first, &never).await.unwrap();
        assert_eq!(first.now(), None);

        let waits = |cancel: Arc<AtomicBool>| {
            let (slots, progress) = (Arc::clone(&slots), Arc::new(ProgressMeter::new()));
            let meter = Arc::clone(&progress);
            let task = tokio::spawn(async move { slots.acquire(&meter, &cancel).await.is_some() });
            (task, progress)
        };
        let at = async |progress: &ProgressMeter, position: usize| {
            while progress.now().and_then(|now| now.queued_position) != Some(position) {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        let cancel = Arc::new(AtomicBool::new(false));
        let (cancelled, second) = waits(Arc::clone(&cancel));
        at(&second, 1).await;
        let (patient, third) = waits(Arc::default());
        at(&third, 2).await;
        cancel.store(true, Ordering::Relaxed);
        assert!(!cancelled.await.unwrap());
        at(&third, 1).await;
        assert!(!patient.is_finished());
        drop(held);
        assert!(patient.await.unwrap());
    }

    #[test]
    fn each_kind_has_its_own_slots() {
        let slots = JobSlots::default();
        for kind in JobKind::ALL {
            assert_eq!(slots.of(kind).free.available_permits(), at_once(kind));
        }
    }
}
