//! What a runner does while it does not move: it pauses, waits for people, and obeys orders.

use std::time::Duration;

use tokio::sync::{mpsc, oneshot};

use super::{CommandRequest, Ending, Runner, ScanCommand};
use crate::bench::stage::StageError;
use crate::scan::event::{OperatorAction, Progress};
use crate::scan::plan::Shot;
use crate::scan::recorder::{RecordError, Recorder};
use crate::scan::rig::Rig;
use crate::scan::stage_access::StageAccess;
use crate::scan::state::ScanState;
use crate::scan::visit::VisitError;

/// The orders to a scan, and what they change.
pub(super) struct Orders<'a> {
    pub commands: &'a mut mpsc::Receiver<CommandRequest>,
    pub recorder: &'a mut dyn Recorder,
    pub state: &'a mut ScanState,
    pub progress: Progress,
    pub access: StageAccess,
}

impl Orders<'_> {
    /// Does some work and obeys orders meanwhile. An order that ends the work drops it and is returned.
    pub async fn during<T>(
        mut self,
        work: impl Future<Output = T>,
    ) -> Result<Result<T, CommandRequest>, RecordError> {
        let mut work = std::pin::pin!(work);
        loop {
            tokio::select! {
                biased;
                request = self.commands.recv() => {
                    let request = request.unwrap_or_else(shut_down);
                    if let Some(cut) = self.obey(request).await? {
                        return Ok(Err(cut));
                    }
                }
                outcome = &mut work => return Ok(Ok(outcome)),
            }
        }
    }

    /// Obeys an order that does not end the current work; returns one that does.
    async fn obey(
        &mut self,
        request: CommandRequest,
    ) -> Result<Option<CommandRequest>, RecordError> {
        let next = match (request.command, *self.state) {
            (ScanCommand::Pause, ScanState::Running) => ScanState::Pausing,
            (ScanCommand::Resume, ScanState::Pausing) => ScanState::Running,
            (ScanCommand::Stop | ScanCommand::Pause, ScanState::Paused) => {
                // A suspended scan no longer resumes by itself.
                self.access.forbid_unasked_motion();
                request.reply.send(Ok(ScanState::Paused)).ok();
                return Ok(None);
            }
            (ScanCommand::Resume, ScanState::Paused)
            | (ScanCommand::Stop | ScanCommand::Abort | ScanCommand::ShutDown, _) => {
                return Ok(Some(request));
            }
            // An operator step does not resume a pause: it may have been asked before a stop.
            _ => {
                request.reply.send(Err(*self.state)).ok();
                return Ok(None);
            }
        };
        self.recorder.state(next, None, None, self.progress).await?;
        *self.state = next;
        request.reply.send(Ok(next)).ok();
        Ok(None)
    }
}

impl Runner<'_> {
    /// Waits, and obeys orders meanwhile. Returns whether the stop button ended the wait; then a person has resumed the
    /// scan.
    pub(super) async fn rest(&mut self, wait: Duration) -> Result<bool, Ending> {
        let clock = std::sync::Arc::clone(&self.run.clock);
        match self.orders().during(clock.sleep(wait)).await? {
            Ok(()) => Ok(false),
            Err(cut) => {
                self.pause_or_end(cut).await?;
                Ok(true)
            }
        }
    }

    /// The orders to this scan, for work that needs nothing of the runner.
    pub(super) fn orders(&mut self) -> Orders<'_> {
        self.orders_and_rig().0
    }

    /// The orders to this scan, and the rig for the work that they may end.
    pub(super) fn orders_and_rig(&mut self) -> (Orders<'_>, &mut Rig) {
        let orders = Orders {
            commands: &mut *self.commands,
            recorder: &mut *self.recorder,
            state: &mut self.state,
            progress: self.totals.progress,
            access: self.rig.access().clone(),
        };
        (orders, &mut *self.rig)
    }

    /// Pauses after the stop button until the scan is resumed; ends after the other orders.
    pub(super) async fn pause_or_end(&mut self, cut: CommandRequest) -> Result<(), Ending> {
        match cut.command {
            ScanCommand::Stop => self.hold_with(VisitError::STOPPED, None, Some(cut)).await,
            order => self.end_by(order, cut).await,
        }
    }

    /// The same, and makes the rig ready again.
    pub(super) async fn cut_short(&mut self, cut: CommandRequest) -> Result<(), Ending> {
        self.pause_or_end(cut).await?;
        self.make_ready().await
    }

    async fn end_by<T>(
        &mut self,
        order: ScanCommand,
        request: CommandRequest,
    ) -> Result<T, Ending> {
        let (state, reason) = match order {
            ScanCommand::Abort => (ScanState::Aborted, "aborted by the operator"),
            _ => (
                ScanState::Interrupted,
                "the daemon was stopped; resume the scan to continue",
            ),
        };
        self.enter(state, Some(reason)).await?;
        request.reply.send(Ok(state)).ok();
        Err(Ending::Recorded(state))
    }

    /// Pauses until there is room for all frames of a point.
    pub(super) async fn check_disk(&mut self, shot: &Shot) -> Result<(), Ending> {
        let settings = &self.run.settings;
        let needed =
            settings.disk_reserve_bytes + u64::from(shot.n_frames()) * settings.frame_bytes_max;
        loop {
            let free = self.recorder.free_bytes().await?;
            if free >= needed {
                return Ok(());
            }
            let why = format!(
                "the disk is full: {} MB are free and {} MB are needed; free some space, then resume",
                free / 1_000_000,
                needed / 1_000_000
            );
            self.hold_with(&why, Some("disk-full"), None).await?;
        }
    }

    pub(super) async fn pause_if_asked(&mut self) -> Result<(), Ending> {
        if self.state == ScanState::Pausing {
            self.enter(ScanState::Paused, None).await?;
            self.wait_for_resume().await?;
        }
        Ok(())
    }

    pub(super) async fn hold(&mut self, error: &VisitError) -> Result<(), Ending> {
        if matches!(error, VisitError::Stage(_)) {
            self.rig.access().forbid_unasked_motion();
        }
        let code = error.code();
        let reason = match error {
            // Errors of stages and camera do not mention the scan that waits.
            VisitError::Stage(
                StageError::PowerCycled { axis } | StageError::NotReferenced { axis },
            ) => format!(
                "the {axis} controller lost its reference, as after a power cycle, and the scan does not home it by itself \
                 (scan.home_after_power_cycle); check that the stages are clear, then resume: the scan homes them first"
            ),
            VisitError::Stage(error) if error.axis_to_home().is_some() => {
                format!("{error}; fix it, then resume: the scan homes the axis first")
            }
            VisitError::Stage(_) | VisitError::Camera(_) | VisitError::Suspended { .. }
                if code.is_some() =>
            {
                format!("{error}; fix it, then resume")
            }
            _ => error.to_string(),
        };
        self.hold_with(&reason, code, None).await
    }

    /// Pauses for a reason, raises the alarm if it has a code, and waits to be resumed.
    pub(super) async fn hold_with(
        &mut self,
        reason: &str,
        code: Option<&str>,
        request: Option<CommandRequest>,
    ) -> Result<(), Ending> {
        // Before the state: a client that sees the scan paused finds the alarm with the reason.
        if let Some(code) = code {
            self.recorder.alarm(code, reason).await;
            self.note_pause(code, reason);
        }
        self.enter(ScanState::Paused, Some(reason)).await?;
        if let Some(request) = request {
            // The stop of a person, after which the scan may have made ready once more.
            self.rig.access().forbid_unasked_motion();
            request.reply.send(Ok(ScanState::Paused)).ok();
        }
        self.wait_for_resume().await
    }

    async fn wait_for_resume(&mut self) -> Result<(), Ending> {
        loop {
            let request = self.commands.recv().await.unwrap_or_else(shut_down);
            if self.is_resumed_by(request).await? {
                return Ok(());
            }
        }
    }

    /// Waits while the scan is paused; returns whether a person resumed it.
    pub(super) async fn is_resumed_within(&mut self, wait: Duration) -> Result<bool, Ending> {
        let clock = std::sync::Arc::clone(&self.run.clock);
        match self.orders().during(clock.sleep(wait)).await? {
            Ok(()) => Ok(false),
            Err(cut) => self.is_resumed_by(cut).await,
        }
    }

    /// Obeys an order to a paused scan; returns whether it resumed the scan.
    pub(super) async fn is_resumed_by(&mut self, request: CommandRequest) -> Result<bool, Ending> {
        let Some(request) = self.orders().obey(request).await? else {
            return Ok(false);
        };
        match request.command {
            ScanCommand::Resume => {
                self.rig.access().allow_unasked_motion();
                self.enter(ScanState::Running, None).await?;
                request.reply.send(Ok(self.state)).ok();
                Ok(true)
            }
            order => self.end_by(order, request).await,
        }
    }

    pub(super) async fn wait_for_operator(&mut self, action: OperatorAction) -> Result<(), Ending> {
        loop {
            if self.state != ScanState::WaitingForOperator {
                self.recorder
                    .state(
                        ScanState::WaitingForOperator,
                        None,
                        Some(action),
                        self.totals.progress,
                    )
                    .await?;
                self.state = ScanState::WaitingForOperator;
            }
            let request = self.commands.recv().await.unwrap_or_else(shut_down);
            match request.command {
                ScanCommand::Done(other) if other != action => {
                    request.reply.send(Err(self.state)).ok();
                }
                // Asked while the scan was paused. It does not say that the step is done.
                ScanCommand::Resume => {
                    request.reply.send(Err(self.state)).ok();
                }
                ScanCommand::Continue | ScanCommand::Done(_) => {
                    self.enter(ScanState::Running, None).await?;
                    request.reply.send(Ok(self.state)).ok();
                    return Ok(());
                }
                ScanCommand::Abort | ScanCommand::ShutDown => {
                    return self.end_by(request.command, request).await;
                }
                ScanCommand::Pause | ScanCommand::Stop => {
                    let reason = match request.command {
                        ScanCommand::Stop => Some(VisitError::STOPPED),
                        _ => None,
                    };
                    self.enter(ScanState::Paused, reason).await?;
                    request.reply.send(Ok(self.state)).ok();
                    self.wait_for_resume().await?;
                }
            }
        }
    }
}

/// The command that a closed channel stands for: its sender is gone.
pub(super) fn shut_down() -> CommandRequest {
    CommandRequest {
        command: ScanCommand::ShutDown,
        reply: oneshot::channel().0,
    }
}
