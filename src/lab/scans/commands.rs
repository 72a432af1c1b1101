//! Commands to a scan: pause, resume, continue and abort, answered in time also where stages or database are not.

use std::time::Duration;

use tokio::sync::oneshot;
use tokio::time::{Instant, timeout_at};

use crate::bench::stage::StageError;
use crate::lab::{Lab, LabError, Occupation};
use crate::scan::runner::{CommandRequest, RunEnd, ScanCommand};
use crate::scan::{RecordedEvent, ScanState};
use crate::store::StoreError;
use crate::store::scans::Scan;

/// Time after which an order to a scan is answered, also where the stages do not answer or the database is locked.
pub(in crate::lab) const ORDER_ANSWER: Duration = Duration::from_millis(900);
/// Least time between two looks at why a scan does not answer.
const SHORT_WAIT: Duration = Duration::from_millis(100);

impl Lab {
    /// Sends a command to a running scan, or resumes an interrupted one.
    ///
    /// # Errors
    /// [`LabError::NotNow`] if the scan's state does not allow it, [`LabError::AbortedInMotion`], or a store error.
    pub async fn order(&self, scan_id: i64, order: ScanCommand) -> Result<ScanState, LabError> {
        let carried_out = self.carry_out(scan_id, order).await;
        let is_taken = matches!(
            carried_out,
            Ok(_) | Err(LabError::WaitsForDatabase { .. } | LabError::AbortUnconfirmed { .. })
        );
        if is_taken {
            self.record_order(asked(order), Some(scan_id)).await;
        }
        carried_out
    }

    async fn carry_out(&self, scan_id: i64, order: ScanCommand) -> Result<ScanState, LabError> {
        let answer_by = Instant::now() + ORDER_ANSWER;
        if order_moves(order) {
            // Nothing moves later, after a person was refused.
            self.store().check_writing(ORDER_ANSWER).await?;
        }
        let not_now = |state| LabError::NotNow {
            scan_id,
            state,
            asked: asked(order),
        };
        let occupation = match &self.inner.rig {
            Some(side) => side.occupation.borrow().clone(),
            None => Occupation::default(),
        };
        let orders = match occupation.orders {
            Some(orders) if occupation.scan_id == Some(scan_id) => orders,
            _ => return self.order_unheld(scan_id, order).await,
        };
        let states = states_for(order);
        if !states.is_empty() {
            let state = timeout_at(answer_by, self.inner.store.scan(scan_id)).await;
            let state = state.unwrap_or(Err(StoreError::NoAnswer))?.state;
            if !states.contains(&state) {
                return Err(not_now(match state {
                    // Another caller has just resumed it, and its row is not written yet.
                    ScanState::Interrupted => ScanState::Running,
                    state => state,
                }));
            }
        }
        let (reply, answer) = oneshot::channel();
        let sent = orders
            .send(CommandRequest {
                command: order,
                reply,
            })
            .await;
        let side = self.side()?;
        let stopped = match order {
            ScanCommand::Abort => self.stop_for_abort(scan_id, answer_by).await?,
            _ => Ok(()),
        };
        let answer = match sent {
            Ok(()) => {
                self.answer_in_time(scan_id, order, answer, answer_by)
                    .await?
            }
            Err(_) => None,
        };
        let state = match answer {
            Some(Ok(state)) => state,
            Some(Err(state)) => {
                return match (order, self.inner.store.scan(scan_id).await?.operator) {
                    (ScanCommand::Done(done), Some(waits_for)) if done != waits_for => {
                        Err(LabError::OtherStep {
                            scan_id,
                            done,
                            waits_for,
                        })
                    }
                    _ => Err(not_now(state)),
                };
            }
            // The scan ended before it read the command, or because the new state could not be written.
            None => {
                let mut occupation = side.occupation.clone();
                let gone = occupation.wait_for(|now| now.scan_id != Some(scan_id));
                // An owner that has ended holds no scan.
                gone.await.ok();
                if side.sink.unrecorded.has(scan_id) {
                    return self.order_unheld(scan_id, order).await;
                }
                match self.inner.store.scan(scan_id).await?.state {
                    state @ ScanState::Aborted if order == ScanCommand::Abort => state,
                    state => return Err(not_now(state)),
                }
            }
        };
        match stopped {
            Ok(()) => Ok(state),
            Err(source) => Err(LabError::AbortedInMotion { scan_id, source }),
        }
    }

    /// Stops the stages for an abort: homing and connecting do not read commands; the stage does.
    async fn stop_for_abort(
        &self,
        scan_id: i64,
        answer_by: Instant,
    ) -> Result<Result<(), StageError>, LabError> {
        let access = self.side()?.access.clone();
        access.forbid_unasked_motion();
        let stop = tokio::spawn(async move { access.stop_what_may_move().await });
        match timeout_at(answer_by, stop).await {
            Ok(stopped) => Ok(stopped.expect("a stop does not panic")),
            Err(_) => Err(LabError::AbortUnconfirmed { scan_id }),
        }
    }

    /// Waits for the answer of a scan, but neither for a database that another program has locked nor for a disk that does not
    /// answer.
    async fn answer_in_time(
        &self,
        scan_id: i64,
        order: ScanCommand,
        answer: oneshot::Receiver<Result<ScanState, ScanState>>,
        by: Instant,
    ) -> Result<Option<Result<ScanState, ScanState>>, LabError> {
        let left = by.saturating_duration_since(Instant::now());
        tokio::select! {
            biased;
            answer = answer => Ok(answer.ok()),
            trouble = self.store().trouble(left.max(SHORT_WAIT)) => Err(LabError::WaitsForDatabase {
                scan_id,
                asked: asked(order),
                no_answer: matches!(trouble, StoreError::NoAnswer),
            }),
        }
    }

    /// Sends a command to a scan that is not running.
    async fn order_unheld(&self, scan_id: i64, order: ScanCommand) -> Result<ScanState, LabError> {
        self.store().check_writing(ORDER_ANSWER).await?;
        if let Some(side) = &self.inner.rig {
            side.sink.record_end_of(scan_id).await?;
        }
        let scan = self.inner.store.scan(scan_id).await?;
        match (order, scan.state) {
            (ScanCommand::Resume, ScanState::Interrupted) => self.resume(&scan).await,
            (ScanCommand::Abort, ScanState::Interrupted) => {
                let reason = Some("aborted by the operator");
                let progress = self.store().last_progress(scan_id).await?;
                let event = self
                    .inner
                    .store
                    .change_state(scan_id, ScanState::Aborted, reason, None, progress)
                    .await?;
                self.publish(event);
                Ok(ScanState::Aborted)
            }
            (_, state) => Err(LabError::NotNow {
                scan_id,
                state,
                asked: asked(order),
            }),
        }
    }

    /// Waits until a scan has ended or is interrupted, or until `enough` is true for one of its events after number
    /// `after`.
    ///
    /// # Errors
    /// A store error.
    pub async fn wait_for_scan(
        &self,
        scan_id: i64,
        after: i64,
        mut enough: impl FnMut(&RecordedEvent) -> bool,
    ) -> Result<Scan, LabError> {
        let mut events = self.events();
        let mut last = after;
        loop {
            for event in self.inner.store.events_after(last, 1000).await? {
                last = event.id;
                if event.event.scan_id() == Some(scan_id) && enough(&event) {
                    return Ok(self.inner.store.scan(scan_id).await?);
                }
            }
            let scan = self.inner.store.scan(scan_id).await?;
            if scan.state.is_end() || scan.state == ScanState::Interrupted {
                return Ok(scan);
            }
            // Any event wakes this; the store has them all.
            events.recv().await.ok();
        }
    }

    /// Returns how a scan of this process ended, with its times.
    #[must_use]
    pub fn run_end(&self, scan_id: i64) -> Option<RunEnd> {
        self.inner.ends.borrow().get(&scan_id).copied()
    }
}

/// Returns the states of a scan in which an order is permitted; none for one that is permitted in every state, and so must not
/// wait for the database.
fn states_for(order: ScanCommand) -> &'static [ScanState] {
    match order {
        ScanCommand::Continue | ScanCommand::Done(_) => &[ScanState::WaitingForOperator],
        ScanCommand::Resume => &[ScanState::Paused, ScanState::Pausing],
        ScanCommand::Pause => &[ScanState::Running, ScanState::WaitingForOperator],
        ScanCommand::Abort | ScanCommand::Stop | ScanCommand::ShutDown => &[],
    }
}

/// Whether an order lets the stages move.
fn order_moves(order: ScanCommand) -> bool {
    matches!(
        order,
        ScanCommand::Resume | ScanCommand::Continue | ScanCommand::Done(_)
    )
}

fn asked(order: ScanCommand) -> &'static str {
    match order {
        ScanCommand::Pause => "pause",
        ScanCommand::Resume => "resume",
        ScanCommand::Continue | ScanCommand::Done(_) => "continue",
        ScanCommand::Abort => "abort",
        ScanCommand::Stop | ScanCommand::ShutDown => "stop",
    }
}
