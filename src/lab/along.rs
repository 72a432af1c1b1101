//! The fit that runs along with a scan: how sure the frames so far are, told while more come.
//!
//! Call [`begin`] when a scan begins and drop what it gives when the scan ends. It listens to the scan's own
//! events, so the runner knows nothing of it and never waits for it; it works on one thread of its own
//! and rests longer than it works, so stages and camera keep the rest of the machine. What it finds is
//! an event like any other. It knows neither stages nor camera.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rayon::ThreadPool;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::{RecvError, TryRecvError};
use tokio_util::sync::CancellationToken;

use super::event_sink::EventSink;
use super::job_work::word;
use super::tasks::blocking;
use super::{Lab, LabError, StoredSeries};
use crate::analysis::{self, AnalysisError, AnalysisOptions};
use crate::fit::FitReport;
use crate::frame::FrameKind;
use crate::scan::event::{Certainty, UncertainValue};
use crate::scan::{Event, RecordedEvent};

/// Rest over work: a third of one thread at most.
const REST: u32 = 2;
/// Least rest.
const REST_MIN: Duration = Duration::from_millis(200);

/// The fit of a scan that runs; dropped, it ends within one evaluation of the model.
pub(super) struct Along {
    cancel: Arc<AtomicBool>,
    ending: CancellationToken,
}

impl Drop for Along {
    fn drop(&mut self) {
        self.cancel.store(true, Ordering::Relaxed);
        self.ending.cancel();
    }
}

/// Fits the scan whenever new poses are durable, until what is given back is dropped.
pub(super) fn begin(told: &EventSink, scan_id: i64) -> Along {
    let along = Along {
        cancel: Arc::new(AtomicBool::new(false)),
        ending: CancellationToken::new(),
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .thread_name(|_| "fit-along".to_owned())
        .build();
    match pool {
        Ok(pool) => {
            let news = News {
                events: told.events.subscribe(),
                scan_id,
            };
            let companion = Companion {
                told: told.clone(),
                scan_id,
                cancel: Arc::clone(&along.cancel),
                pool: Arc::new(pool),
            };
            tokio::spawn(companion.run(news, along.ending.clone()));
        }
        Err(error) => {
            tracing::warn!(scan_id, %error, "scan {scan_id} runs without a fit beside it: {error}");
        }
    }
    along
}

/// Whether there are new poses.
struct News {
    events: Receiver<Arc<RecordedEvent>>,
    scan_id: i64,
}

impl News {
    fn concerns(&self, event: &RecordedEvent) -> bool {
        matches!(&event.event, Event::Frame { scan_id, kind: FrameKind::Sample, accepted: true, .. }
            if *scan_id == self.scan_id)
    }

    /// Completes when there are new poses; however many came meanwhile are one piece of news. `false` when
    /// nothing will come any more.
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

struct Companion {
    told: EventSink,
    scan_id: i64,
    cancel: Arc<AtomicBool>,
    pool: Arc<ThreadPool>,
}

impl Companion {
    async fn run(self, mut news: News, ending: CancellationToken) {
        loop {
            let more = tokio::select! {
                () = ending.cancelled() => false,
                more = news.come() => more,
            };
            if !more {
                return;
            }
            // The machine's own time, not the rig's: what is shared is the processor.
            let started = Instant::now();
            match self.look().await {
                Ok(Some(certainty)) if !self.cancel.load(Ordering::Relaxed) => {
                    let scan_id = self.scan_id;
                    self.told
                        .record(Event::Uncertainty { scan_id, certainty })
                        .await;
                }
                Ok(_) => {}
                // Too few frames for a reduction are no reason to give up: more will come.
                Err(error) => {
                    tracing::debug!(scan_id = self.scan_id, %error, "no fit beside the scan yet: {error}");
                }
            }
            let rest = (REST * started.elapsed()).max(REST_MIN);
            tokio::select! {
                () = ending.cancelled() => return,
                () = tokio::time::sleep(rest) => {}
            }
        }
    }

    /// Fits what is durable now; `None` where it was cancelled.
    async fn look(&self) -> Result<Option<Certainty>, LabError> {
        let store = &self.told.store;
        let series = StoredSeries::open(store, self.scan_id).await?;
        let elapsed_s = store.last_progress(self.scan_id).await?.elapsed_s;
        let options = AnalysisOptions {
            region: Lab::regions(crate::reduction::FrameSource::manifest(&series))
                .into_iter()
                .next(),
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
            // What is held fixed has no uncertainty that could fall.
            (std > 0.0).then(|| (name.to_owned(), UncertainValue { value, std }))
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
