//! Runs one scan on the rig, from its row to its end, with the live fit beside it.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};

use super::live_fit;
use super::recorder::LabRecorder;
use crate::bench::stage::{Stage, StageSettings};
use crate::frame::Frame;
use crate::frame::FrameTag;
use crate::geometry::Pose;
use crate::lab::error::store_code;
use crate::lab::event_sink::{EventSink, FirstState};
use crate::lab::rig::motions::Motions;
use crate::lab::rig::operator_calls::Hands;
use crate::lab::rig::pinned_stages::PinnedStages;
use crate::lab::rig::preview_work::Previews;
use crate::lab::{LabError, Occupation, RigSettings, publish};
use crate::scan::event::RigActivity;
use crate::scan::look::Look;
use crate::scan::recorder::RecordError;
use crate::scan::reference::{REMEMBERED_MAX, ReferenceRules};
use crate::scan::runner::{self, CommandRequest, ScanRun};
use crate::scan::{Event, Plan, Rig, ScanState, Step, TravelLimits};
use crate::store::StoreError;
use crate::store::scans::{NewScan, Scan};

/// A scan to run.
pub(in crate::lab) struct ScanWork {
    pub row: ScanRow,
    pub plan: Plan,
    /// Points that are already durable.
    pub done: BTreeSet<u32>,
    /// The saturated points of the sample among them.
    pub full: BTreeSet<u32>,
    /// Time spent on them.
    pub elapsed_s: f64,
    /// Gets the scan's first state.
    pub first_state: Option<FirstState>,
}

/// The row of a scan.
pub(in crate::lab) enum ScanRow {
    /// A new scan: only the owner of the rig adds its row. Sends the new row, or the reason it could not be written, to
    /// the caller.
    New(Box<NewScan>, oneshot::Sender<Result<Scan, StoreError>>),
    /// The row of an interrupted scan.
    Kept(i64),
}

/// What the owner of the rig and a scan run share.
#[derive(Clone)]
pub(in crate::lab) struct RigContext {
    pub rig_id: i64,
    pub settings: RigSettings,
    pub occupation: Arc<watch::Sender<Occupation>>,
    pub hands: Hands,
    pub pinned: PinnedStages,
    pub motions: Arc<Motions>,
    pub previews: Previews,
    pub sink: EventSink,
}

impl RigContext {
    /// Publishes what the rig begins to do, and who started it.
    pub(in crate::lab) fn begin(&self, activity: RigActivity, who: &Arc<str>) {
        self.occupation
            .send_modify(|now| now.who = Some(Arc::clone(who)));
        self.occupy(Some(activity), None);
    }

    /// Publishes what the rig is doing.
    pub(in crate::lab) fn occupy(&self, activity: Option<RigActivity>, scan_id: Option<i64>) {
        self.occupation.send_modify(|now| {
            now.activity = activity;
            now.scan_id = scan_id;
            now.failure = None;
            now.clears_up = false;
            if scan_id.is_none() {
                now.orders = None;
            }
        });
    }

    /// Runs a scan on the rig until it ends, and records its end.
    pub(in crate::lab) async fn run_scan(
        &self,
        rig: &mut Rig,
        work: ScanWork,
        who: &Arc<str>,
        reply: oneshot::Sender<Result<(), LabError>>,
    ) {
        self.begin(RigActivity::Scanning, who);
        let before = match &work.row {
            ScanRow::New(..) => ScanState::Planned,
            ScanRow::Kept(_) => ScanState::Interrupted,
        };
        let Some(scan_id) = self.row_of(work.row).await else {
            reply.send(Ok(())).ok();
            return;
        };
        let (book, mut orders) = mpsc::channel::<CommandRequest>(16);
        self.occupation.send_modify(|now| {
            now.scan_id = Some(scan_id);
            now.scan_state = Some((before, None));
            now.orders = Some(book);
        });
        reply.send(Ok(())).ok();
        let stage = rig.connect().await.ok();
        if let Some(stage) = &stage
            && let Err(error) = self.pinned.note_scan(scan_id, &stage.identity()).await
        {
            tracing::error!(scan_id, %error, "the controllers of scan {scan_id} could not be stored: {error}");
        }
        let settings = rig.link().settings.clone();
        let steps = in_order(work.plan.clone(), settings, rig.limits(), stage).await;
        let reference = ReferenceRules {
            every: work.plan.reference_every,
            ..self.settings.runner.reference
        };
        let mut recorder = LabRecorder {
            sink: self.sink.clone(),
            scan_id,
            rig_id: self.rig_id,
            saturation_dn: self.settings.camera.full_count(),
            plan: work.plan,
            first_state: work.first_state,
            occupation: Arc::clone(&self.occupation),
            hands: self.hands.clone(),
            clears_up: self.settings.lamp_off.is_some() || self.settings.park.is_some(),
        };
        let last_frames = self.last_frames(scan_id).await;
        let unchecked = self.unchecked(scan_id, reference.every).await;
        let stated = self.stated(scan_id).await;
        let mut settings = self.settings.runner.clone();
        settings.reference = reference;
        let run = ScanRun {
            steps,
            done: work.done,
            full: work.full,
            last_frames,
            unchecked,
            stated,
            elapsed_s: work.elapsed_s,
            settings,
            clock: Arc::clone(&self.sink.clock),
        };
        let live_fit = live_fit::start(&self.sink, scan_id);
        let end = runner::run(run, rig, &mut recorder, &mut orders).await;
        drop(live_fit);
        let parks = match &end {
            // Parked as the daemon ends; after an abort nothing moves.
            Ok(end) => matches!(end.state, ScanState::Completed | ScanState::Failed),
            Err(_) => true,
        };
        match end {
            Ok(end) => self.sink.ends.send_modify(|ends| {
                ends.insert(scan_id, end);
            }),
            Err(error) => {
                // The runner may have ended during a move; a stop that does not arrive is in the log.
                rig.access().stop_what_may_move().await.ok();
                self.note_unrecorded(scan_id, &error, who).await;
            }
        }
        self.occupation.send_modify(|now| {
            now.clears_up = true;
            now.scan_id = None;
            // No run receives them any more.
            now.orders = None;
        });
        // A failure is an alarm.
        self.switch_lamp_off(Some(scan_id)).await.ok();
        if parks {
            self.park(rig).await;
        }
        // Not before: what is idle does not move by itself.
        self.occupy(None, None);
    }

    /// Returns the number of the scan's row, which a new scan gets here; none if the row could not be written.
    async fn row_of(&self, row: ScanRow) -> Option<i64> {
        let (new, reply) = match row {
            ScanRow::Kept(scan_id) => return Some(scan_id),
            ScanRow::New(new, reply) => (new, reply),
        };
        match self.sink.store.add_scan(&new).await {
            Ok((scan, event)) => {
                publish(&self.sink.events, event);
                let scan_id = scan.id;
                reply.send(Ok(scan)).ok();
                Some(scan_id)
            }
            Err(error) => {
                // First, so that a caller that learns of it finds the rig free.
                self.occupy(None, None);
                reply.send(Err(error)).ok();
                None
            }
        }
    }

    /// Raises the alarm for a scan that ended because the store no longer records it, and marks it as interrupted once the store
    /// does.
    async fn note_unrecorded(&self, scan_id: i64, error: &RecordError, who: &Arc<str>) {
        tracing::error!(scan_id, %error, "scan {scan_id} can no longer be recorded: {error}");
        let code = match self.sink.store.find_folder().await {
            Ok(()) => "scan-unrecorded",
            Err(gone) => store_code(&gone),
        };
        let alarm = Event::Alarm {
            code: code.into(),
            message: format!(
                "scan {scan_id} has ended, since it can no longer be recorded: {error}; resume it once the store records \
                 again"
            ),
            scan_id: Some(scan_id),
        };
        self.sink.report_by(who, alarm);
        self.sink
            .unrecorded
            .all()
            .insert(scan_id, error.to_string());
        tokio::spawn(interrupt_when_possible(self.sink.clone(), scan_id));
    }

    /// Returns what the camera stated about the newest frame that a reduction of the scan reads, calibrations included; nothing
    /// if it cannot be read, which the scan's end will report.
    async fn stated(&self, scan_id: i64) -> FrameTag {
        let store = &self.sink.store;
        let records = store.frames_for_reduction(scan_id).await;
        let mut scans: Vec<i64> = Vec::new();
        for record in records.unwrap_or_default() {
            if !scans.contains(&record.scan_id) {
                scans.push(record.scan_id);
            }
        }
        for scan_id in scans {
            let tags = store
                .tags_of_scan(scan_id, 0, i64::MAX)
                .await
                .unwrap_or_default();
            if let Some((_, newest)) = tags.into_iter().next_back() {
                return newest;
            }
        }
        FrameTag::default()
    }

    /// Returns the accepted points of the sample, the newest `looks` of them with the look of their frames, in the order taken;
    /// none if they cannot be read, which the scan's end will report.
    async fn unchecked(&self, scan_id: i64, looks: u32) -> Vec<(u32, Vec<Look>)> {
        let store = self.sink.store.clone();
        let rules = self.settings.runner.frame.clone();
        let newest = store.newest_sample_shots(scan_id, REMEMBERED_MAX).await;
        let newest = newest.unwrap_or_default();
        let mut points = Vec::new();
        for (age, (index, shot_id)) in newest.into_iter().enumerate().rev() {
            if age >= looks as usize {
                points.push((index, Vec::new()));
                continue;
            }
            let frames = store.frames_of_shot(shot_id).await.unwrap_or_default();
            let (store, rules) = (store.clone(), rules.clone());
            let look = move || -> Vec<Look> {
                let first = frames.iter().filter(|frame| frame.repeat == 0);
                let looks = first.filter_map(|record| {
                    let png = store.read_png(&record.sha256).ok()?;
                    let frame = Frame::from_png(&png).ok()?;
                    Some(Look::of(&frame, record.exposure_s, &rules))
                });
                looks.collect()
            };
            let looks = tokio::task::spawn_blocking(look).await.unwrap_or_default();
            points.push((index, looks));
        }
        points
    }

    /// Returns the newest frames of a scan, also of points that do not count; none if they cannot be read, which the scan's end
    /// will report.
    async fn last_frames(&self, scan_id: i64) -> Vec<Frame> {
        const ENOUGH: u32 = 8;
        let store = self.sink.store.clone();
        let newest = store.newest_frames(scan_id, ENOUGH).await;
        let newest = newest.unwrap_or_default();
        let read = move || -> Vec<Frame> {
            let frames = newest.iter().filter_map(|sha256| {
                let png = store.read_png(sha256).ok()?;
                Frame::from_png(&png).ok()
            });
            frames.collect()
        };
        tokio::task::spawn_blocking(read).await.unwrap_or_default()
    }
}

/// Orders the points of a plan from where the axes are; from (0°, 0°) if they do not answer.
async fn in_order(
    plan: Plan,
    settings: StageSettings,
    limits: TravelLimits,
    stage: Option<Stage>,
) -> Vec<Step> {
    let start = match &stage {
        Some(stage) => stage.status().await.map(|status| status.pose()).ok(),
        None => None,
    };
    let start = start.unwrap_or(Pose::from_deg(0.0, 0.0));
    // Ordering a large plan takes seconds.
    let steps = move || {
        let move_time = |from, to| match &stage {
            Some(stage) => stage.predicted_move(from, to),
            None => settings.predicted_move(from, to),
        };
        plan.steps(&limits, start, &move_time)
    };
    tokio::task::spawn_blocking(steps)
        .await
        .expect("ordering poses does not panic")
}

/// Marks a scan whose state could not be written as interrupted as soon as the store accepts it.
async fn interrupt_when_possible(sink: EventSink, scan_id: i64) {
    while sink.record_end_of(scan_id).await.is_err() && !sink.store.is_closed() {
        sink.clock.sleep(Duration::from_secs(5)).await;
    }
}
