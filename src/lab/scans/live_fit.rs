//! The live fit: fits the frames of a scan while the scan runs, and reports the uncertainties so far.
//!
//! Call [`start`] when a scan starts, and drop the [`LiveFit`] when it ends. The live fit listens to the scan's events, so the
//! runner never waits for it. It works on one thread and rests longer than it works, which leaves the rest of the machine to
//! stages and camera. Each look measures only the frames that came since the last one, and stores their sums: the fits,
//! contrasts and verdicts that follow read no frame again. The result of a look is an event. This module knows neither
//! stages nor camera.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rayon::ThreadPool;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio_util::sync::CancellationToken;

use crate::analysis::{self, AnalysisError, AnalysisOptions};
use crate::fit::FitReport;
use crate::frame::FrameKind;
use crate::lab::event_sink::EventSink;
use crate::lab::jobs::work::word;
use crate::lab::tasks::blocking;
use crate::lab::{Lab, LabError, StoredSeries};
use crate::reduction::FrameSource;
use crate::scan::event::{Certainty, UncertainValue};
use crate::scan::{Event, RecordedEvent};

/// Rest over work: at most a third of one thread is used.
const REST: u32 = 2;
/// Shortest rest.
const REST_MIN: Duration = Duration::from_millis(200);

/// The live fit of a scan. Once dropped, it ends within one evaluation of the model.
pub(in crate::lab) struct LiveFit {
    cancel: Arc<AtomicBool>,
    ending: CancellationToken,
}

impl Drop for LiveFit {
    fn drop(&mut self) {
        self.cancel.store(true, Ordering::Relaxed);
        self.ending.cancel();
    }
}

/// Starts the live fit of a scan. It runs until the returned value is dropped.
pub(in crate::lab) fn start(sink: &EventSink, scan_id: i64) -> LiveFit {
    let live_fit = LiveFit {
        cancel: Arc::new(AtomicBool::new(false)),
        ending: CancellationToken::new(),
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .thread_name(|_| "live-fit".to_owned())
        .build();
    match pool {
        Ok(pool) => {
            let poses = NewPoses {
                events: sink.events.subscribe(),
                scan_id,
            };
            let follower = Follower {
                sink: sink.clone(),
                scan_id,
                cancel: Arc::clone(&live_fit.cancel),
                pool: Arc::new(pool),
            };
            let task = tokio::spawn(follower.run(poses, live_fit.ending.clone()));
            sink.live_fits.add(task);
        }
        Err(error) => {
            tracing::warn!(scan_id, %error, "scan {scan_id} runs without a live fit: {error}");
        }
    }
    live_fit
}

/// Waits for new poses of a scan.
struct NewPoses {
    events: Receiver<Arc<RecordedEvent>>,
    scan_id: i64,
}

impl NewPoses {
    fn concerns(&self, event: &RecordedEvent) -> bool {
        matches!(&event.event, Event::Frame { scan_id, kind: FrameKind::Sample, accepted: true, .. }
            if *scan_id == self.scan_id)
    }

    /// Completes when there are new poses; all that came meanwhile count as one. Returns `false` when no event can come
    /// any more.
    async fn come(&mut self) -> bool {
        let mut any = false;
        loop {
            match self.events.try_recv() {
                Ok(event) => any |= self.concerns(&event),
                Err(TryRecvError::Lagged(_)) => any = true,
                Err(TryRecvError::Closed) => return false,
                Err(TryRecvError::Empty) => break,
            }
        }
        while !any {
            match self.events.recv().await {
                Ok(event) => any = self.concerns(&event),
                Err(RecvError::Lagged(_)) => any = true,
                Err(RecvError::Closed) => return false,
            }
        }
        true
    }
}

/// Fits a scan again and again.
struct Follower {
    sink: EventSink,
    scan_id: i64,
    cancel: Arc<AtomicBool>,
    pool: Arc<ThreadPool>,
}

impl Follower {
    async fn run(self, mut poses: NewPoses, ending: CancellationToken) {
        loop {
            let more = tokio::select! {
                () = ending.cancelled() => false,
                more = poses.come() => more,
            };
            if !more {
                return;
            }
            // The machine's own time, not the rig's: what is shared is the processor.
            let started = Instant::now();
            match self.look().await {
                Ok(Some(certainty)) if !self.cancel.load(Ordering::Relaxed) => {
                    let scan_id = self.scan_id;
                    self.sink
                        .record(Event::Uncertainty { scan_id, certainty })
                        .await;
                }
                Ok(_) => {}
                // Too few frames for a reduction: more will come.
                Err(error) => {
                    tracing::debug!(scan_id = self.scan_id, %error, "no live fit yet: {error}");
                }
            }
            let rest = (REST * started.elapsed()).max(REST_MIN);
            tokio::select! {
                () = ending.cancelled() => return,
                () = tokio::time::sleep(rest) => {}
            }
        }
    }

    /// Fits the frames that are durable now; `None` where it was cancelled.
    async fn look(&self) -> Result<Option<Certainty>, LabError> {
        let store = &self.sink.store;
        let series = StoredSeries::open_growing(store, self.scan_id).await?;
        let elapsed_s = store.last_progress(self.scan_id).await?.elapsed_s;
        let options = AnalysisOptions {
            region: Lab::regions(series.manifest()).into_iter().next(),
            ..AnalysisOptions::default()
        };
        let (pool, cancel) = (Arc::clone(&self.pool), Arc::clone(&self.cancel));
        let analysed = blocking(move || {
            pool.install(|| analysis::analyse(&series, &options, &|_| {}, &cancel))
        })
        .await?;
        match analysed {
            Ok(analysed) => Ok(Some(certainty(&analysed.report, elapsed_s))),
            Err(AnalysisError::Cancelled) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

fn certainty(report: &FitReport, elapsed_s: f64) -> Certainty {
    let known = report
        .parameters
        .named()
        .into_iter()
        .filter_map(|(name, p)| {
            let (value, std) = (p.value?, p.std?);
            // A fixed parameter has no uncertainty that could fall.
            let known = UncertainValue {
                value,
                std,
                coverage_factor: p.coverage_factor?,
            };
            (std > 0.0).then(|| (name.to_owned(), known))
        });
    Certainty {
        elapsed_s,
        n_observations: report.n_observations,
        n_frames_used: report.n_frames_used,
        variant: report.variant.to_string(),
        status: word(&report.status),
        parameters: known.collect(),
    }
}
