//! Stores what the runner reports: file, then row, then event.

use std::sync::Arc;

use futures::future::BoxFuture;
use futures::{StreamExt, TryStreamExt};
use tokio::sync::watch;

use crate::frame::FrameKind;
use crate::lab::event_sink::{EventSink, FirstState};
use crate::lab::rig::operator_calls::Hands;
use crate::lab::{Occupation, publish};
use crate::scan::recorder::{RecordError, Recorder, Recovery, Visit};
use crate::scan::visit::is_stage_code;
use crate::scan::{Event, OperatorAction, Plan, Progress, ScanState};
use crate::store::StoreError;
use crate::store::calibrations::NewCalibration;
use crate::store::shots::{NewFrame, NewShot};

/// Frames of a point that are encoded and written at the same time: one is encoded while the other waits for the disk.
/// More would double the memory of a point with many repeats.
const FRAMES_AT_ONCE: usize = 2;

pub(in crate::lab) struct LabRecorder {
    pub sink: EventSink,
    pub scan_id: i64,
    pub rig_id: i64,
    pub saturation_dn: u16,
    pub plan: Plan,
    pub first_state: Option<FirstState>,
    pub occupation: Arc<watch::Sender<Occupation>>,
    pub hands: Hands,
    /// Whether the lamp is switched off or the axes are parked at the end: the rig is idle only after that.
    pub clears_up: bool,
}

impl From<&StoreError> for RecordError {
    fn from(error: &StoreError) -> Self {
        match error {
            StoreError::DiskFull { .. } => RecordError::DiskFull(error.to_string()),
            _ => RecordError::Failed(error.to_string()),
        }
    }
}

impl From<StoreError> for RecordError {
    fn from(error: StoreError) -> Self {
        RecordError::from(&error)
    }
}

impl LabRecorder {
    async fn keep(&self, visit: Visit, progress: Progress) -> Result<(), StoreError> {
        let store = &self.sink.store;
        let shot = NewShot {
            scan_id: self.scan_id,
            plan_index: visit.shot.index,
            attempt: visit.attempt,
            kind: visit.shot.kind,
            asked: visit.shot.pose,
            pose: visit.pose,
            rejected: visit.rejected.map(|why| why.to_string()),
            taken_at: visit.taken_at,
        };
        let frames = visit.frames.into_iter().map(|taken| {
            let name = format!(
                "frames/{}_{:05}_e{}_r{}{}.png",
                shot.kind.as_str(),
                shot.plan_index,
                taken.exposure_index,
                taken.repeat,
                match shot.rejected {
                    None => String::new(),
                    Some(_) => format!("_rejected{}", shot.attempt),
                }
            );
            let (taken_at, tag) = (taken.captured.started_utc, taken.captured.tag);
            let kept = store.keep_frame(taken.captured.frame, self.saturation_dn);
            async move {
                Ok::<_, StoreError>(NewFrame {
                    file: kept.await?,
                    name,
                    exposure_s: taken.exposure_s,
                    repeat: taken.repeat,
                    taken_at,
                    tag,
                })
            }
        });
        // Commit the row only after all files are durable.
        let frames = futures::stream::iter(frames).buffered(FRAMES_AT_ONCE);
        let frames: Vec<NewFrame> = self
            .sink
            .watched(self.scan_id, frames.try_collect())
            .await?;
        let commit = || store.commit_shot(&shot, &frames, progress);
        for event in self.sink.patiently(self.scan_id, commit).await? {
            publish(&self.sink.events, event);
        }
        Ok(())
    }
}

impl Recorder for LabRecorder {
    fn state<'a>(
        &'a mut self,
        next: ScanState,
        reason: Option<&'a str>,
        operator: Option<OperatorAction>,
        progress: Progress,
    ) -> BoxFuture<'a, Result<(), RecordError>> {
        Box::pin(async move {
            // Before the state: a client may confirm the step as soon as it sees the scan wait.
            if let Some(action) = operator {
                self.hands.act(self.scan_id, action).await;
            }
            if next == ScanState::Running {
                self.occupation.send_modify(|now| now.problem = None);
            }
            // First, so that a client that sees the scan end can get the rig.
            if next.is_end() || next == ScanState::Interrupted {
                let clears_up = self.clears_up;
                self.occupation.send_modify(|now| match clears_up {
                    true => now.clears_up = true,
                    false => now.activity = None,
                });
            }
            let store = &self.sink.store;
            let write = || store.change_state(self.scan_id, next, reason, operator, progress);
            let written = match &self.first_state {
                // Its caller waits for the answer.
                Some(_) => write().await,
                None => self.sink.patiently(self.scan_id, write).await,
            };
            let (first, outcome) = match written {
                Ok(event) => {
                    let scan = Some((next, reason.map(str::to_owned)));
                    self.occupation.send_modify(|now| now.scan_state = scan);
                    publish(&self.sink.events, event);
                    (Ok(next), Ok(()))
                }
                Err(error) => {
                    let outcome = Err(RecordError::from(&error));
                    (Err(error), outcome)
                }
            };
            if let Some(waiting) = self.first_state.take() {
                // The caller may be gone; an event reports it too.
                waiting.send(first).ok();
            }
            outcome
        })
    }

    fn visit(
        &mut self,
        visit: Visit,
        progress: Progress,
    ) -> BoxFuture<'_, Result<(), RecordError>> {
        Box::pin(async move { Ok(self.keep(visit, progress).await?) })
    }

    fn withdraw<'a>(
        &'a mut self,
        points: &'a [u32],
        why: &'a str,
    ) -> BoxFuture<'a, Result<(), RecordError>> {
        Box::pin(async move {
            let store = &self.sink.store;
            let withdraw = || store.withdraw_shots(self.scan_id, points, why);
            self.sink.patiently(self.scan_id, withdraw).await?;
            Ok(())
        })
    }

    fn phase_done(&mut self, kind: FrameKind) -> BoxFuture<'_, Result<(), RecordError>> {
        Box::pin(async move {
            let plan = &self.plan;
            let (exposures_s, theta_c_deg, repeats) = match kind {
                FrameKind::Sample => return Ok(()),
                FrameKind::Dark => (plan.all_exposures_s(), Vec::new(), plan.dark.repeats),
                FrameKind::Flat => (
                    plan.flat.exposures_s.clone(),
                    plan.flat.theta_c_deg.clone(),
                    plan.flat.repeats,
                ),
            };
            let n_frames = exposures_s.len() as u32 * theta_c_deg.len().max(1) as u32 * repeats;
            let new = NewCalibration {
                kind,
                scan_id: self.scan_id,
                rig_id: self.rig_id,
                exposures_s,
                theta_c_deg,
                n_frames,
            };
            let store = &self.sink.store;
            let add = || store.add_calibration(&new);
            self.sink.patiently(self.scan_id, add).await?;
            Ok(())
        })
    }

    fn recovered(&mut self, recovery: Recovery) -> BoxFuture<'_, ()> {
        Box::pin(async move {
            let Recovery {
                code,
                message,
                took_s,
                points,
                attended,
            } = recovery;
            let event = Event::Recovered {
                scan_id: Some(self.scan_id),
                code,
                message,
                took_s,
                points,
                attended,
            };
            self.sink.record(event).await;
        })
    }

    fn alarm<'a>(&'a mut self, code: &'a str, message: &'a str) -> BoxFuture<'a, ()> {
        Box::pin(async move {
            if is_stage_code(code) {
                let problem = Some((code.to_owned(), message.to_owned()));
                self.occupation.send_modify(|now| now.problem = problem);
            }
            let event = Event::Alarm {
                code: code.into(),
                message: message.into(),
                scan_id: Some(self.scan_id),
            };
            self.sink.record(event).await;
        })
    }

    fn free_bytes(&self) -> BoxFuture<'_, Result<u64, RecordError>> {
        Box::pin(async move {
            let free = self.sink.store.free_bytes();
            Ok(self.sink.watched(self.scan_id, free).await?)
        })
    }
}
