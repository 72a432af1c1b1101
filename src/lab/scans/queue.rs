//! Runs the queue: one order after the other, each as a scan.
//!
//! Between two parts nothing moves until a person has put the next part on the table: the scan of the next order begins with
//! the operator step `place-sample`, which names the part. The queue begins no order while it is stopped or paused, while
//! another caller holds the rig, and after a stop of the rig. After a restart it waits for a person.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::Notify;
use tokio::sync::broadcast::error::RecvError;

use super::plans::ScanRequest;
use crate::access::{DAEMON, Held};
use crate::lab::definitions::NameOrId;
use crate::lab::{Lab, LabError};
use crate::scan::faults::OnFailure;
use crate::scan::runner::ScanCommand;
use crate::scan::{Event, ScanState};
use crate::store::queue::{OrderChange, OrderState, QueueNow, QueueOrder, QueueState};
use crate::store::scans::Scan;
use crate::store::{PageRequest, StoreError};

/// Code of the alarm about a queue that waits for a person.
pub const QUEUE_WAITS: &str = "queue-waits";
/// Longest time between two looks at the queue: the rig may become free without an event.
const LOOK_EVERY: Duration = Duration::from_secs(2);
/// How often an order may fail before it no longer goes to the end of the queue.
const FAILURES_MAX: i64 = 2;

/// Why the queue stopped after its last order.
const ALL_DONE: &str = "all orders are done";

/// Returns who holds the lease of the rig.
pub type LeaseHolder = Arc<dyn Fn() -> Option<Held> + Send + Sync>;

/// What the queue keeps in memory.
#[derive(Default)]
pub(in crate::lab) struct QueueRun {
    /// Wakes the task after a change of the queue.
    changed: Notify,
    /// The rig was stopped: nothing begins until a person resumes.
    halted: AtomicBool,
    /// Where the lease is known.
    lease_holder: Mutex<Option<LeaseHolder>>,
    /// Name of the lease that the queue was started with.
    lease: Mutex<Option<String>>,
    /// One order or change at a time.
    turn: tokio::sync::Mutex<()>,
}

impl QueueRun {
    /// Begins no order from now on. Does not wait for anything, as the stop must not.
    pub(in crate::lab) fn halt(&self) {
        self.halted.store(true, Ordering::SeqCst);
        self.changed.notify_one();
    }
}

/// The queue with its present order.
#[derive(Debug, Clone, PartialEq)]
pub struct QueueView {
    /// State.
    pub now: QueueNow,
    /// The order whose scan has begun and has not ended, and the scan.
    pub current: Option<(QueueOrder, Scan)>,
    /// The order that begins next.
    pub next: Option<QueueOrder>,
    /// Number of orders by state.
    pub counts: Vec<(OrderState, i64)>,
    /// What follows a failed order.
    pub on_failure: OnFailure,
    /// What the queue does or waits for, as a sentence.
    pub message: String,
}

/// Starts the task that runs the queue. It ends with the lab.
pub(in crate::lab) async fn start(lab: &Lab) -> Result<(), StoreError> {
    if lab.inner.rig.is_none() {
        return Ok(());
    }
    lab.by(DAEMON).wait_for_a_person_after_restart().await?;
    let (mut events, run) = (lab.events(), Arc::clone(&lab.inner.queue));
    let inner = Arc::downgrade(&lab.inner);
    tokio::spawn(async move {
        // The order whose end the queue waits for.
        let mut watched = None;
        loop {
            {
                let Some(lab) = Lab::of_daemon(&inner) else {
                    return;
                };
                // The store closes as the daemon ends.
                if let Err(error) = lab.run_queue(&mut watched).await
                    && !lab.store().is_closed()
                {
                    tracing::error!(%error, "the queue stopped: {error}");
                }
            }
            // The end of a scan or a motion, a change of the queue, and now and then.
            loop {
                tokio::select! {
                    () = run.changed.notified() => break,
                    () = tokio::time::sleep(LOOK_EVERY) => break,
                    heard = events.recv() => match heard {
                        Ok(heard) if matches!(heard.event, Event::Scan { .. } | Event::Rig { .. }) => break,
                        Ok(_) => {}
                        Err(RecvError::Lagged(_)) => break,
                        Err(RecvError::Closed) => return,
                    },
                }
            }
        }
    });
    Ok(())
}

impl Lab {
    /// Lets the queue know who holds the lease of the rig.
    pub fn respect_lease(&self, holder: LeaseHolder) {
        let place = &self.inner.queue.lease_holder;
        *place.lock().unwrap_or_else(PoisonError::into_inner) = Some(holder);
    }

    fn lease_holder(&self) -> Option<Held> {
        let holder = self.inner.queue.lease_holder.lock();
        let holder = holder.unwrap_or_else(PoisonError::into_inner).clone();
        holder.and_then(|holder| holder())
    }

    /// Returns the queue.
    ///
    /// # Errors
    /// A store error.
    pub async fn queue(&self) -> Result<QueueView, LabError> {
        let store = self.store();
        let now = store.queue().await?;
        let current = self.current_order().await?;
        let next = self.first(OrderState::Waiting).await?;
        let message = message(&now, current.as_ref(), next.as_ref());
        Ok(QueueView {
            message,
            counts: store.order_counts().await?,
            on_failure: self.on_failure(),
            now,
            current,
            next,
        })
    }

    fn on_failure(&self) -> OnFailure {
        let settings = self.side().map(|side| side.settings.queue_on_failure);
        settings.unwrap_or_default()
    }

    async fn first(&self, state: OrderState) -> Result<Option<QueueOrder>, LabError> {
        let one = PageRequest {
            limit: 1,
            cursor: None,
        };
        let found = self.store().queue_orders(&[state], one).await?;
        Ok(found.items.into_iter().next())
    }

    async fn current_order(&self) -> Result<Option<(QueueOrder, Scan)>, LabError> {
        let Some(order) = self.first(OrderState::Running).await? else {
            return Ok(None);
        };
        let Some(scan_id) = order.scan_id else {
            return Ok(None);
        };
        let scan = self.with_unrecorded_end(self.store().scan(scan_id).await?);
        Ok(Some((order, scan)))
    }

    /// Starts the queue: orders begin one after the other, for the caller of this handle. Resumes a paused one.
    ///
    /// # Errors
    /// [`LabError::NoRig`], [`LabError::EmptyQueue`], what resuming its scan reports, or a store error.
    pub async fn start_queue(&self) -> Result<QueueView, LabError> {
        self.side()?;
        let run = &self.inner.queue;
        let turn = run.turn.lock().await;
        let current = self.current_order().await?;
        if current.is_none() && self.first(OrderState::Waiting).await?.is_none() {
            return Err(LabError::EmptyQueue);
        }
        if let Some((_, scan)) = &current
            && matches!(scan.state, ScanState::Paused | ScanState::Interrupted)
        {
            self.order(scan.id, ScanCommand::Resume).await?;
        }
        run.halted.store(false, Ordering::SeqCst);
        *run.lease.lock().unwrap_or_else(PoisonError::into_inner) =
            self.lease_holder().map(|held| held.name);
        self.set_queue(QueueState::Running, None, "started").await?;
        drop(turn);
        self.queue().await
    }

    /// Stops the queue once its present order has ended; at once if there is none.
    ///
    /// # Errors
    /// A store error.
    pub async fn stop_queue(&self) -> Result<QueueView, LabError> {
        let turn = self.inner.queue.turn.lock().await;
        let (state, done) = match self.current_order().await? {
            Some(_) => (QueueState::Stopping, "stops after this order"),
            None => (QueueState::Stopped, "stopped"),
        };
        if self.store().queue().await?.state != state {
            self.set_queue(state, None, done).await?;
        }
        drop(turn);
        self.queue().await
    }

    /// Pauses the queue and the scan of its present order.
    ///
    /// # Errors
    /// [`LabError::QueueConflict`] if it is stopped, what pausing the scan reports, or a store error.
    pub async fn pause_queue(&self) -> Result<QueueView, LabError> {
        let turn = self.inner.queue.turn.lock().await;
        match self.store().queue().await?.state {
            QueueState::Paused => {}
            QueueState::Stopped => {
                return Err(LabError::QueueConflict {
                    state: QueueState::Stopped,
                    problem: "there is nothing to pause; start it",
                });
            }
            QueueState::Running | QueueState::Stopping => {
                // Before the scan: its end must not begin the next order.
                self.set_queue(QueueState::Paused, None, "paused").await?;
                if let Some((_, scan)) = self.current_order().await?
                    && matches!(
                        scan.state,
                        ScanState::Running | ScanState::WaitingForOperator
                    )
                {
                    match self.order(scan.id, ScanCommand::Pause).await {
                        // It has ended or paused in the meantime.
                        Ok(_) | Err(LabError::NotNow { .. }) => {}
                        Err(error) => return Err(error),
                    }
                }
            }
        }
        drop(turn);
        self.queue().await
    }

    /// Confirms the operator step of the present order: the part is on the table.
    ///
    /// # Errors
    /// [`LabError::QueueConflict`] if no order waits for a step, or what the scan reports.
    pub async fn continue_queue(&self) -> Result<QueueView, LabError> {
        let current = self.current_order().await?;
        let waits = current.and_then(|(_, scan)| Some((scan.id, scan.operator?)));
        let Some((scan_id, step)) = waits else {
            return Err(LabError::QueueConflict {
                state: self.store().queue().await?.state,
                problem: "no order waits for an operator step",
            });
        };
        self.order(scan_id, ScanCommand::Done(step)).await?;
        self.queue().await
    }

    async fn set_queue(
        &self,
        state: QueueState,
        reason: Option<&str>,
        done: &str,
    ) -> Result<(), LabError> {
        self.store().set_queue(state, reason, &self.who).await?;
        let order = match reason {
            Some(reason) => format!("queue {done}: {reason}"),
            None => format!("queue {done}"),
        };
        self.record_order(order, None).await;
        self.inner.queue.changed.notify_one();
        Ok(())
    }

    /// Stops or pauses the queue for a reason that a person has to know.
    async fn wait_for_a_person(
        &self,
        state: QueueState,
        reason: &str,
        scan_id: Option<i64>,
    ) -> Result<(), LabError> {
        self.set_queue(state, Some(reason), state.as_str()).await?;
        let message = format!("the queue waits for a person: {reason}");
        self.alarm(QUEUE_WAITS, message, scan_id).await;
        Ok(())
    }

    /// A queue that ran when the daemon ended does not go on by itself: the part on the table may be another one.
    async fn wait_for_a_person_after_restart(&self) -> Result<(), StoreError> {
        if self.store().queue().await?.state == QueueState::Stopped {
            return Ok(());
        }
        let asked = async {
            let reason = match self.current_order().await? {
                Some((order, scan)) => format!(
                    "the daemon was restarted during order {} ({}, scan {}); check that this part is on the table, then resume \
                     the queue",
                    order.id, order.sample_name, scan.id
                ),
                None => "the daemon was restarted; check the rig, then resume the queue".to_owned(),
            };
            self.wait_for_a_person(QueueState::Paused, &reason, None)
                .await
        };
        match asked.await {
            Ok(()) => Ok(()),
            Err(LabError::Store(error)) => Err(error),
            Err(error) => {
                tracing::error!(%error, "the queue could not be read: {error}");
                Ok(())
            }
        }
    }

    /// Does what the queue has to do now: notices the end of an order, and begins the next one.
    async fn run_queue(&self, watched: &mut Option<i64>) -> Result<(), LabError> {
        let run = Arc::clone(&self.inner.queue);
        let _turn = run.turn.lock().await;
        let now = self.store().queue().await?;
        let goes_on = matches!(now.state, QueueState::Running | QueueState::Stopping);
        if !goes_on && watched.is_none() {
            return Ok(());
        }
        // A queue that stops after its present order begins no other: nothing is to be held back.
        let begins = now.state == QueueState::Running;
        if begins && run.halted.load(Ordering::SeqCst) {
            let reason = "the rig was stopped; check it, then resume the queue";
            return self
                .wait_for_a_person(QueueState::Paused, reason, None)
                .await;
        }
        if let Some((order, scan)) = self.current_order().await? {
            *watched = Some(order.id);
            if begins && scan.state == ScanState::Interrupted {
                let why = scan.reason.unwrap_or_default();
                let reason = format!(
                    "scan {} of order {} ({}) is interrupted: {why}; resume the queue",
                    scan.id, order.id, order.sample_name
                );
                return self
                    .wait_for_a_person(QueueState::Paused, &reason, Some(scan.id))
                    .await;
            }
            return Ok(());
        }
        if let Some(id) = watched.take() {
            let ended = self.store().queue_order(id).await?;
            if ended.state == OrderState::Failed && self.after_failure(&ended, now.state).await? {
                return Ok(());
            }
        }
        match now.state {
            QueueState::Stopped | QueueState::Paused => Ok(()),
            QueueState::Stopping => {
                let reason = "as asked, after the present order";
                self.set_queue(QueueState::Stopped, Some(reason), "stopped")
                    .await
            }
            QueueState::Running => {
                *watched = self.begin_next(&now.who).await?;
                Ok(())
            }
        }
    }

    /// Acts on a failed order by the setting; returns whether the queue waits for a person.
    async fn after_failure(&self, order: &QueueOrder, state: QueueState) -> Result<bool, LabError> {
        let why = order.reason.as_deref().unwrap_or("no reason is stated");
        let store = self.store();
        if self.on_failure() == OnFailure::End && order.failures < FAILURES_MAX {
            let reason = format!("it failed ({why}) and waits again at the end");
            store
                .change_order(order.id, OrderChange::Retried, Some(&reason), &self.who)
                .await?;
            store.place_order(order.id, usize::MAX).await?;
            let words = format!("order {} waits again at the end: {why}", order.id);
            self.record_order(words, order.scan_id).await;
            return Ok(false);
        }
        if !matches!(state, QueueState::Running | QueueState::Stopping) {
            return Ok(false);
        }
        let reason = format!(
            "order {} ({}) failed: {why}; let it wait again (retry) or remove it, then start the queue",
            order.id, order.sample_name
        );
        self.wait_for_a_person(QueueState::Stopped, &reason, order.scan_id)
            .await?;
        Ok(true)
    }

    /// Begins the next order for the caller that started the queue. Returns its number once its scan has begun.
    async fn begin_next(&self, who: &str) -> Result<Option<i64>, LabError> {
        let Some(order) = self.first(OrderState::Waiting).await? else {
            self.set_queue(QueueState::Stopped, Some(ALL_DONE), "stopped")
                .await?;
            return Ok(None);
        };
        if let Some(held) = self.lease_holder() {
            let own = self.inner.queue.lease.lock();
            let own = own.unwrap_or_else(PoisonError::into_inner).clone();
            if held.who != who || own.as_deref() != Some(held.name.as_str()) {
                let reason = format!(
                    "{} holds the rig ({}); resume the queue once it is free",
                    held.who, held.name
                );
                self.wait_for_a_person(QueueState::Paused, &reason, None)
                    .await?;
                return Ok(None);
            }
        }
        // Another scan or motion: its end wakes this task.
        if self.rig_user().is_some() {
            return Ok(None);
        }
        let request = ScanRequest {
            sample_id: order.sample_id,
            plan: None,
            recipe: Some(NameOrId::Id(order.recipe.0)),
            specification: order
                .specification
                .as_ref()
                .map(|(id, _)| NameOrId::Id(*id)),
            operator_name: order.operator_name.clone(),
            lot: order.lot.clone(),
            external_id: order.external_id.clone(),
        };
        match self.by(who).start_ordered_scan(&request, order.id).await {
            // The stop came while the scan began.
            Ok(scan) if self.inner.queue.halted.load(Ordering::SeqCst) => {
                match self.order(scan.id, ScanCommand::Pause).await {
                    Ok(_) | Err(LabError::NotNow { .. }) => Ok(Some(order.id)),
                    Err(error) => Err(error),
                }
            }
            Ok(_) => Ok(Some(order.id)),
            Err(LabError::Busy { .. } | LabError::Stopping) => Ok(None),
            // The order cannot be measured as it is; the others may.
            Err(error @ (LabError::Invalid { .. } | LabError::Plan(_) | LabError::Series(_))) => {
                let why = error.to_string();
                let failed = self
                    .store()
                    .change_order(order.id, OrderChange::Failed, Some(&why), &self.who)
                    .await?;
                if !self.after_failure(&failed, QueueState::Running).await? {
                    self.inner.queue.changed.notify_one();
                }
                Ok(None)
            }
            Err(error) => {
                let reason = format!(
                    "order {} ({}) could not start: {error}; resume the queue once this is mended",
                    order.id, order.sample_name
                );
                self.wait_for_a_person(QueueState::Paused, &reason, None)
                    .await?;
                Ok(None)
            }
        }
    }
}

/// What the queue does or waits for.
fn message(
    now: &QueueNow,
    current: Option<&(QueueOrder, Scan)>,
    next: Option<&QueueOrder>,
) -> String {
    // Not true of orders that came later.
    let reason = now
        .reason
        .as_deref()
        .filter(|reason| next.is_none() || *reason != ALL_DONE);
    let state = match (now.state, reason) {
        (QueueState::Stopped | QueueState::Paused, Some(reason)) => {
            return format!("The queue is {}: {reason}.", now.state);
        }
        (QueueState::Stopped, None) => {
            return match next {
                Some(next) => format!(
                    "The queue is stopped. Next part: {} (order {}).",
                    next.sample_name, next.id
                ),
                None => "The queue is stopped and no order waits.".to_owned(),
            };
        }
        (QueueState::Paused, None) => return "The queue is paused.".to_owned(),
        (QueueState::Stopping, _) => " The queue stops after this order.",
        (QueueState::Running, _) => "",
    };
    let Some((order, scan)) = current else {
        return format!("The queue begins the next order.{state}");
    };
    let part = &order.sample_name;
    match (scan.operator, scan.state) {
        (Some(step), _) => format!(
            "Next part: {part} (order {}, scan {}). {}{state}",
            order.id,
            scan.id,
            step.message()
        ),
        (None, ScanState::Paused | ScanState::Interrupted) => format!(
            "Scan {} of {part} is {}: {}.{state}",
            scan.id,
            scan.state,
            scan.reason.as_deref().unwrap_or("by a person")
        ),
        (None, _) => format!(
            "Scan {} measures {part} (order {}).{state}",
            scan.id, order.id
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_that_came_after_the_last_one_are_not_called_done() {
        let now = QueueNow {
            state: QueueState::Stopped,
            reason: Some(ALL_DONE.to_owned()),
            who: "local".to_owned(),
            at: None,
        };
        let next = QueueOrder {
            id: 3,
            position: 3,
            sample_id: 4,
            sample_name: "B-27".to_owned(),
            recipe: (1, "PX-1204".to_owned()),
            specification: None,
            lot: None,
            external_id: None,
            operator_name: None,
            note: None,
            state: OrderState::Waiting,
            reason: None,
            scan_id: None,
            failures: 0,
            who: "local".to_owned(),
            created_at: "2026-11-29T10:00:00.000Z".to_owned(),
        };
        assert_eq!(
            message(&now, None, None),
            "The queue is stopped: all orders are done."
        );
        assert_eq!(
            message(&now, None, Some(&next)),
            "The queue is stopped. Next part: B-27 (order 3)."
        );
    }
}
