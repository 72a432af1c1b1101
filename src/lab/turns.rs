//! Whose turn it is. Fits, maps and traces each take all cores and room for frames, so only a few of a kind work at a
//! time and the rest wait in the order in which they were asked for; what waits can be cancelled.
//!
//! Kinds do not wait for each other: a trace of an hour holds up no fit.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::sync::{Semaphore, SemaphorePermit};

use super::headway::Headway;
use crate::scan::event::CalculationKind;

/// How often what waits looks whether it was cancelled.
const LOOK: Duration = Duration::from_millis(50);

/// Fits that work at a time; they are soon done.
const FITS: usize = 4;
/// Maps, contrasts, verdicts or traces that work at a time, of each kind.
const CALCULATIONS: usize = 2;

/// Turns of all kinds of work.
pub(super) struct AllTurns {
    /// Of fits.
    pub(super) fits: Turns,
    maps: Turns,
    contrasts: Turns,
    verdicts: Turns,
    traces: Turns,
}

impl Default for AllTurns {
    fn default() -> Self {
        let few = || Turns::new(CALCULATIONS);
        AllTurns {
            fits: Turns::new(FITS),
            maps: few(),
            contrasts: few(),
            verdicts: few(),
            traces: few(),
        }
    }
}

impl AllTurns {
    /// Of a kind of calculation.
    pub(super) fn of(&self, kind: CalculationKind) -> &Turns {
        match kind {
            CalculationKind::Map => &self.maps,
            CalculationKind::Contrast => &self.contrasts,
            CalculationKind::Verdict => &self.verdicts,
            CalculationKind::Trace => &self.traces,
        }
    }
}

/// Turns of one kind of work.
pub(super) struct Turns(Semaphore);

impl Turns {
    /// So many work at a time.
    fn new(at_once: usize) -> Self {
        Turns(Semaphore::new(at_once))
    }

    /// Waits for a turn, which ends when it is dropped; none where the work is cancelled before.
    pub(super) async fn mine(
        &self,
        headway: &Headway,
        cancel: &AtomicBool,
    ) -> Option<SemaphorePermit<'_>> {
        let turn = match self.0.try_acquire() {
            Ok(turn) => turn,
            Err(_) => {
                headway.tell("waiting for its turn", 0, 1);
                let mut turn = std::pin::pin!(self.0.acquire());
                loop {
                    if cancel.load(Ordering::Relaxed) {
                        return None;
                    }
                    // Kept over the looks, and with it the place among those that wait.
                    if let Ok(turn) = tokio::time::timeout(LOOK, &mut turn).await {
                        break turn.ok()?;
                    }
                }
            }
        };
        headway.start();
        Some(turn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[tokio::test]
    async fn what_waits_has_its_turn_once_one_is_over_and_can_be_cancelled() {
        let turns = Arc::new(Turns::new(1));
        let (first, never) = (Headway::new(), AtomicBool::new(false));
        let held = turns.mine(&first, &never).await.unwrap();
        assert_eq!(first.now(), None);

        let waits = |cancel: Arc<AtomicBool>| {
            let (turns, headway) = (Arc::clone(&turns), Arc::new(Headway::new()));
            let told = Arc::clone(&headway);
            let task = tokio::spawn(async move { turns.mine(&told, &cancel).await.is_some() });
            (task, headway)
        };
        let cancel = Arc::new(AtomicBool::new(false));
        let (cancelled, seen) = waits(Arc::clone(&cancel));
        let (patient, _) = waits(Arc::default());
        while seen.now().is_none() {
            tokio::task::yield_now().await;
        }
        assert_eq!(seen.now().unwrap().stage, "waiting for its turn");
        cancel.store(true, Ordering::Relaxed);
        assert!(!cancelled.await.unwrap());
        assert!(!patient.is_finished());
        drop(held);
        assert!(patient.await.unwrap());
    }
}
