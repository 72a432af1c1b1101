//! Where the owner of the rig reports what happens: each event is recorded in the store and then sent to all listeners.
//!
//! A command to the rig must not wait for the database, so events of motions and stops are passed on with
//! [`EventSink::report`]: one task records them in this order.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::error::store_code;
use super::publish;
use crate::clock::Clock;
use crate::scan::runner::RunEnd;
use crate::scan::{Event, RecordedEvent, ScanState};
use crate::store::{Store, StoreError};

/// Events that may wait for the database.
const REPORTS_MAX: usize = 1024;

/// How long a scan waits for a database that another program has locked. Each attempt takes SQLite's busy timeout.
const LOCK_PATIENCE: Duration = Duration::from_secs(300);

/// Time after which a scan that waits for the store says so: longer than a slow disk or a backup holds a write.
const WAIT_SHOWS: Duration = Duration::from_secs(5);

/// Gets the first state of a run, or the reason it could not be recorded.
pub(super) type FirstState = oneshot::Sender<Result<ScanState, StoreError>>;

/// The store, the listeners, and the ends of runs.
#[derive(Clone)]
pub(super) struct EventSink {
    pub store: Store,
    pub clock: Arc<dyn Clock>,
    pub events: broadcast::Sender<Arc<RecordedEvent>>,
    pub ends: watch::Sender<HashMap<i64, RunEnd>>,
    pub unrecorded: UnrecordedScans,
    /// The daemon ends: nothing waits for a locked database any more.
    pub ending: CancellationToken,
    /// The live fits of scans, also those that end.
    pub live_fits: LiveFits,
    /// Why a scan waits for the store now, for those who cannot read it there.
    waits: Arc<Mutex<Option<String>>>,
    reports: mpsc::Sender<Report>,
}

/// What the recording task is asked for.
enum Report {
    /// An event, and who caused it.
    Event(Box<Event>, Option<Arc<str>>),
    /// Answered once everything before it is recorded.
    Flush(oneshot::Sender<()>),
}

/// Tasks that write sums into the store, so the store stays open for them.
#[derive(Clone, Default)]
pub(super) struct LiveFits {
    tasks: Arc<Mutex<Vec<JoinHandle<()>>>>,
}

impl LiveFits {
    /// Adds a task, and forgets those that have ended.
    pub(super) fn add(&self, task: JoinHandle<()>) {
        let mut tasks = self.all();
        tasks.retain(|task| !task.is_finished());
        tasks.push(task);
    }

    /// Waits until all have ended. Their scans have ended before.
    pub(super) async fn ended(&self) {
        let tasks = std::mem::take(&mut *self.all());
        for task in tasks {
            // A panic is in the log.
            task.await.ok();
        }
    }

    fn all(&self) -> MutexGuard<'_, Vec<JoinHandle<()>>> {
        self.tasks.lock().expect("no holder of this lock panics")
    }
}

/// Scans that have ended but whose end could not be written, each with the reason it ended.
#[derive(Clone, Default)]
pub(super) struct UnrecordedScans {
    scans: Arc<Mutex<HashMap<i64, String>>>,
    /// One writer at a time: a scan may be resumed a moment later.
    turn: Arc<tokio::sync::Mutex<()>>,
}

impl UnrecordedScans {
    pub(super) fn all(&self) -> MutexGuard<'_, HashMap<i64, String>> {
        self.scans.lock().expect("no holder of this lock panics")
    }

    /// Returns all of them with their reasons.
    pub(super) fn now(&self) -> HashMap<i64, String> {
        self.all().clone()
    }

    /// Returns the reason of one; none if its end is recorded.
    pub(super) fn why(&self, scan_id: i64) -> Option<String> {
        self.all().get(&scan_id).cloned()
    }

    pub(super) fn has(&self, scan_id: i64) -> bool {
        self.all().contains_key(&scan_id)
    }
}

impl EventSink {
    /// Makes the sink and spawns the task that records reports; it ends with the last clone.
    pub(super) fn new(
        store: Store,
        clock: Arc<dyn Clock>,
        events: broadcast::Sender<Arc<RecordedEvent>>,
        ends: watch::Sender<HashMap<i64, RunEnd>>,
    ) -> EventSink {
        let (reports, mut inbox) = mpsc::channel(REPORTS_MAX);
        let (to_store, to_events, its_clock) = (store.clone(), events.clone(), Arc::clone(&clock));
        tokio::spawn(async move {
            while let Some(report) = inbox.recv().await {
                match report {
                    Report::Event(event, who) => {
                        let clock = its_clock.as_ref();
                        record(&to_store, &to_events, clock, *event, who.as_deref()).await;
                    }
                    Report::Flush(done) => drop(done.send(())),
                }
            }
        });
        EventSink {
            store,
            clock,
            events,
            ends,
            unrecorded: UnrecordedScans::default(),
            ending: CancellationToken::new(),
            live_fits: LiveFits::default(),
            waits: Arc::default(),
            reports,
        }
    }

    /// Records an event, then sends it to all listeners. Waits for the database.
    pub(super) async fn record(&self, event: Event) {
        record(&self.store, &self.events, self.clock.as_ref(), event, None).await;
    }

    /// Records an event of a scan or of the daemon itself after those reported before it, then sends it to all listeners. Does
    /// not wait.
    pub(super) fn report(&self, event: Event) {
        self.pass_on(Report::Event(Box::new(event), None));
    }

    /// Records an event that `who` caused after those reported before it, then sends it to all listeners. Does not wait.
    pub(super) fn report_by(&self, who: &Arc<str>, event: Event) {
        self.pass_on(Report::Event(Box::new(event), Some(Arc::clone(who))));
    }

    fn pass_on(&self, report: Report) {
        if let Err(refused) = self.reports.try_send(report) {
            tracing::error!("an event is lost, since too many wait for the database: {refused}");
        }
    }

    /// Repeats what a scan writes while another program has the database locked, for a few minutes at most: a backup at
    /// night must not end the scan. Says so once, and when it is over.
    pub(super) async fn patiently<T, F: Future<Output = Result<T, StoreError>>>(
        &self,
        scan_id: i64,
        mut write: impl FnMut() -> F,
    ) -> Result<T, StoreError> {
        let mut wait = Wait::of(self, scan_id);
        loop {
            let written = wait.watch(write()).await;
            let is_locked = matches!(written, Err(StoreError::Locked));
            let has_patience = wait.began.elapsed() < LOCK_PATIENCE && !self.ending.is_cancelled();
            if !is_locked || !has_patience {
                wait.end(written.is_ok());
                return written;
            }
            wait.say(&StoreError::Locked);
        }
    }

    /// Waits for what a scan writes once. Says so where this takes long, and when it is over.
    pub(super) async fn watched<T>(
        &self,
        scan_id: i64,
        write: impl Future<Output = Result<T, StoreError>>,
    ) -> Result<T, StoreError> {
        let mut wait = Wait::of(self, scan_id);
        let written = wait.watch(write).await;
        wait.end(written.is_ok());
        written
    }

    /// Returns why a scan waits for the store now.
    pub(super) fn waits(&self) -> Option<String> {
        self.waits_now().clone()
    }

    fn waits_now(&self) -> MutexGuard<'_, Option<String>> {
        self.waits.lock().expect("no holder of this lock panics")
    }

    /// Waits until everything that was reported so far is recorded, or its failure is in the log.
    pub(super) async fn flush(&self) {
        let (done, recorded) = oneshot::channel();
        if self.reports.send(Report::Flush(done)).await.is_ok() {
            recorded.await.ok();
        }
    }

    /// Marks a scan whose end is unrecorded as interrupted, so that it can be resumed or aborted. No effect on others.
    pub(super) async fn record_end_of(&self, scan_id: i64) -> Result<(), StoreError> {
        let _turn = self.unrecorded.turn.lock().await;
        let Some(reason) = self.unrecorded.why(scan_id) else {
            return Ok(());
        };
        let state = ScanState::Interrupted;
        let progress = self.store.last_progress(scan_id).await.unwrap_or_default();
        let written = self
            .store
            .change_state(scan_id, state, Some(&reason), None, progress)
            .await;
        match written {
            Ok(event) => publish(&self.events, event),
            // It has ended before, or another task was faster.
            Err(StoreError::StateConflict { .. }) => {}
            Err(error) => return Err(error),
        }
        self.unrecorded.all().remove(&scan_id);
        Ok(())
    }
}

/// A scan that waits for the store.
struct Wait<'a> {
    sink: &'a EventSink,
    scan_id: i64,
    began: Instant,
    /// Code of the cause, once it was said.
    said: Option<&'static str>,
}

impl<'a> Wait<'a> {
    fn of(sink: &'a EventSink, scan_id: i64) -> Wait<'a> {
        Wait {
            sink,
            scan_id,
            began: Instant::now(),
            said: None,
        }
    }

    /// Waits for a write, and says why it waits where this takes long.
    async fn watch<T>(
        &mut self,
        write: impl Future<Output = Result<T, StoreError>>,
    ) -> Result<T, StoreError> {
        let mut write = std::pin::pin!(write);
        let store = self.sink.store.clone();
        if self.said.is_none() {
            tokio::select! {
                biased;
                written = &mut write => return written,
                trouble = store.trouble(WAIT_SHOWS) => self.say(&trouble),
            }
        }
        write.await
    }

    /// Raises the alarm, once. It cannot be recorded: the store is what the scan waits for.
    fn say(&mut self, trouble: &StoreError) {
        if self.said.is_some() {
            return;
        }
        let code = store_code(trouble);
        let message = match trouble {
            StoreError::Locked => {
                let minutes = LOCK_PATIENCE.as_secs() / 60;
                format!("{trouble}; the scan waits for up to {minutes} min and continues by itself")
            }
            trouble => format!("{trouble}; the scan waits and continues by itself"),
        };
        self.said = Some(code);
        *self.sink.waits_now() = Some(message.clone());
        let alarm = Event::Alarm {
            code: code.into(),
            message,
            scan_id: Some(self.scan_id),
        };
        let at = self.sink.clock.utc();
        publish(&self.sink.events, RecordedEvent::unrecorded(at, alarm));
    }

    /// The wait is over; reports this if it was said that the scan waits.
    fn end(self, is_written: bool) {
        let Some(code) = self.said else { return };
        *self.sink.waits_now() = None;
        if !is_written {
            return;
        }
        let took_s = self.began.elapsed().as_secs_f64();
        let cause = match code {
            "disk-silent" => "the disk of the data folder had not answered",
            _ => "another program had locked the database",
        };
        self.sink.report(Event::Recovered {
            scan_id: Some(self.scan_id),
            code: code.into(),
            message: format!("{cause} for {took_s:.0} s; the scan waited"),
            took_s,
            points: Vec::new(),
            attended: false,
        });
    }
}

/// Records an event, which `who` caused, and sends it to all listeners. An alarm that cannot be recorded is sent all the same: it may be about
/// the disk that cannot store it.
pub(super) async fn record(
    store: &Store,
    events: &broadcast::Sender<Arc<RecordedEvent>>,
    clock: &dyn Clock,
    event: Event,
    who: Option<&str>,
) {
    let recorded = match who {
        Some(who) => store.record_by(who, event.clone()).await,
        None => store.record(event.clone()).await,
    };
    match recorded {
        Ok(event) => publish(events, event),
        Err(error) => {
            tracing::error!(%error, "an event could not be recorded: {error}");
            if matches!(event, Event::Alarm { .. }) {
                let event = RecordedEvent {
                    who: who.map(str::to_owned),
                    ..RecordedEvent::unrecorded(clock.utc(), event)
                };
                publish(events, event);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SteppedClock;
    use crate::store::tests::open;

    #[tokio::test]
    async fn a_scan_waits_for_a_locked_database_and_says_so_until_the_daemon_ends() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let events = broadcast::Sender::new(16);
        let ends = watch::Sender::new(HashMap::new());
        let clock = Arc::new(SteppedClock::new());
        let sink = EventSink::new(store.clone(), clock, events.clone(), ends);
        let mut heard = events.subscribe();
        let mut attempts = 0;
        let write = || {
            attempts += 1;
            let outcome = match attempts {
                1 | 2 => Err(StoreError::Locked),
                _ => Ok("written"),
            };
            std::future::ready(outcome)
        };
        assert_eq!(sink.patiently(7, write).await.unwrap(), "written");
        let alarm = heard.recv().await.unwrap();
        assert!(!alarm.is_recorded());
        assert!(
            matches!(&alarm.event, Event::Alarm { code, scan_id: Some(7), .. } if code == "store-locked")
        );
        let recovered = heard.recv().await.unwrap();
        assert!(recovered.is_recorded());
        assert!(
            matches!(&recovered.event, Event::Recovered { code, .. } if code == "store-locked")
        );

        sink.ending.cancel();
        let locked = || std::future::ready(Err::<(), _>(StoreError::Locked));
        let refused = sink.patiently(7, locked).await.unwrap_err();
        assert!(matches!(refused, StoreError::Locked));
        assert!(heard.try_recv().is_err());
        store.close().await;
    }
}
