//! Hooks: programs of the settings that are run at events, so that a person or a robot learns of them.
//!
//! One task listens and puts each event into the bounded queue of its hook; one task per hook runs the program for one
//! event after another. So a slow or broken hook delays only itself; scan, store and page never wait for one.

use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{broadcast, mpsc};
use tokio::task::{JoinHandle, JoinSet};
use tokio_util::sync::CancellationToken;

use super::Lab;
use crate::config::HooksSection;
use crate::program::Program;
use crate::scan::event::OperatorStep;
use crate::scan::{Event, RecordedEvent, ScanState};
use crate::store::{Store, utc_text};

/// Events that may wait for a hook; more are dropped and logged.
const EVENTS_MAX: usize = 64;
/// Time that a hook waits for the store, which may be what is broken.
const STORE_WAIT: Duration = Duration::from_secs(2);

/// The running hooks of a daemon.
pub struct Hooks {
    ending: CancellationToken,
    listener: JoinHandle<()>,
    runners: JoinSet<()>,
    limit: Duration,
}

impl Hooks {
    /// Runs the hooks of the settings from now on. `earlier` are events of the start, before a task could listen. `url` is
    /// the address of the daemon, which hooks get.
    #[must_use]
    pub fn start(
        lab: &Lab,
        settings: &HooksSection,
        url: Option<String>,
        earlier: Vec<RecordedEvent>,
    ) -> Hooks {
        let ending = CancellationToken::new();
        let mut runners = JoinSet::new();
        let mut listener = Listener::default();
        for (name, words) in settings.commands() {
            let Some(program) = Program::of(words, settings.time_limit_s) else {
                continue;
            };
            let (queue, events) = mpsc::channel(EVENTS_MAX);
            listener.queues.push((name, queue));
            let hook = Hook {
                name,
                program,
                store: lab.store().clone(),
                url: url.clone(),
            };
            runners.spawn(hook.run(events));
        }
        for event in earlier {
            listener.take(&Arc::new(event));
        }
        Hooks {
            listener: tokio::spawn(listener.listen(lab.events(), ending.clone())),
            ending,
            runners,
            limit: Duration::from_secs_f64(settings.time_limit_s),
        }
    }

    /// Waits for the hooks of everything that has happened, at most as long as one hook may take.
    pub async fn finish(mut self) {
        self.ending.cancel();
        self.listener.await.ok();
        let all = async { while self.runners.join_next().await.is_some() {} };
        if tokio::time::timeout(self.limit, all).await.is_err() {
            tracing::warn!("hooks that still waited as the daemon ended did not run");
            self.runners.shutdown().await;
        }
    }
}

/// The queues of the hooks that have a program.
#[derive(Default)]
struct Listener {
    queues: Vec<(&'static str, mpsc::Sender<Arc<RecordedEvent>>)>,
}

impl Listener {
    async fn listen(
        self,
        mut events: broadcast::Receiver<Arc<RecordedEvent>>,
        ending: CancellationToken,
    ) {
        loop {
            let event = tokio::select! {
                biased;
                event = events.recv() => event,
                () = ending.cancelled() => return,
            };
            match event {
                Ok(event) => self.take(&event),
                Err(RecvError::Lagged(missed)) => {
                    tracing::warn!(missed, "{missed} events came too fast for the hooks");
                }
                Err(RecvError::Closed) => return,
            }
        }
    }

    /// Puts an event into the queue of its hook, if there is one.
    fn take(&self, event: &Arc<RecordedEvent>) {
        let Some(hook) = hook_of(&event.event) else {
            return;
        };
        let Some((_, queue)) = self.queues.iter().find(|(name, _)| *name == hook) else {
            return;
        };
        if queue.try_send(Arc::clone(event)).is_err() {
            tracing::error!(
                "an event is dropped, since {EVENTS_MAX} wait for the hook `{hook}`: it is too slow"
            );
            count(hook, "dropped");
        }
    }
}

/// Returns the name of the hook for an event.
fn hook_of(event: &Event) -> Option<&'static str> {
    match event {
        // An import is complete from its start.
        Event::Scan {
            previous: ScanState::Planned,
            state: ScanState::Completed,
            ..
        } => None,
        Event::Scan { state, .. } => match state {
            ScanState::Paused | ScanState::Interrupted => Some("paused"),
            ScanState::Failed => Some("failed"),
            ScanState::Completed => Some("completed"),
            ScanState::WaitingForOperator => Some("waiting"),
            ScanState::Planned | ScanState::Running | ScanState::Pausing | ScanState::Aborted => {
                None
            }
        },
        Event::Alarm { .. } => Some("alarm"),
        Event::Recovered { .. } => Some("recovered"),
        _ => None,
    }
}

fn count(hook: &'static str, outcome: &'static str) {
    metrics::counter!("ridged_hooks_total", "hook" => hook, "outcome" => outcome).increment(1);
}

struct Hook {
    name: &'static str,
    program: Program,
    store: Store,
    url: Option<String>,
}

impl Hook {
    async fn run(self, mut events: mpsc::Receiver<Arc<RecordedEvent>>) {
        let hook = self.name;
        while let Some(event) = events.recv().await {
            let input = self.describe(&event).await.to_string();
            match self.program.run(input.as_bytes()).await {
                Ok(()) => {
                    tracing::debug!(hook, "the hook `{hook}` ran");
                    count(hook, "done");
                }
                Err(error) => {
                    tracing::error!(hook, %error, "the hook `{hook}` failed: {error}");
                    count(hook, "failed");
                }
            }
        }
    }

    /// Returns what a hook gets on stdin. What the store does not return in time is null.
    async fn describe(&self, recorded: &RecordedEvent) -> Value {
        let mut event = serde_json::to_value(&recorded.event).unwrap_or_default();
        event["id"] = recorded.is_recorded().then_some(recorded.id).into();
        event["at"] = utc_text(recorded.at).into();
        event["who"] = recorded.who.clone().into();
        let scan_id = recorded.event.scan_id();
        let read = async {
            let scan_id = scan_id?;
            let scan = self.store.scan(scan_id).await.ok()?;
            let frame = self.store.newest_frame(scan_id).await.ok()?;
            Some((scan, frame))
        };
        let read = tokio::time::timeout(STORE_WAIT, read).await.ok().flatten();
        let (scan, frame) = match read {
            Some((scan, frame)) => (Some(scan), frame),
            None => (None, None),
        };
        let at = |path: String| self.url.as_ref().map(|url| format!("{url}/api/v1{path}"));
        let part = scan.as_ref().map(|scan| scan.sample_name.as_str());
        let operator = match &recorded.event {
            Event::Scan {
                scan_id,
                operator: Some(action),
                ..
            } => {
                let step = OperatorStep::from(*action);
                json!({
                    "scan_id": scan_id,
                    "part": part,
                    "action": step.action,
                    "message": step.message,
                    "continue_url": at(format!("/scans/{scan_id}/continue")),
                    "continue_body": { "action": step.action },
                })
            }
            _ => Value::Null,
        };
        json!({
            "hook": self.name,
            "message": message(&recorded.event, part),
            "event": event,
            "scan": scan.as_ref().map(|scan| json!({
                "id": scan.id,
                "sample_id": scan.sample_id,
                "part": scan.sample_name,
                "name": scan.name,
                "who": scan.who,
                "created_at": scan.created_at,
                "url": at(format!("/scans/{}", scan.id)),
            })),
            "operator": operator,
            "last_frame": frame.map(|frame| json!({
                "id": frame.id,
                "path": self.store.frame_path(&frame.sha256),
                "kind": frame.kind.as_str(),
                "theta_c_deg": frame.theta_c_deg,
                "phi_s_deg": frame.phi_s_deg,
                "exposure_s": frame.exposure_s,
                "accepted": frame.accepted,
                "timestamp": frame.timestamp,
            })),
            "data_folder": std::path::absolute(self.store.folder()).ok(),
            "url": self.url,
        })
    }
}

/// One line for people.
fn message(event: &Event, part: Option<&str>) -> String {
    let part = part.map_or_else(String::new, |part| format!(" ({part})"));
    match event {
        Event::Scan {
            scan_id,
            state,
            reason,
            operator,
            progress,
            ..
        } => {
            let why = match (reason, operator) {
                (_, Some(action)) => format!(": {}", action.message()),
                (Some(reason), None) => format!(": {reason}"),
                (None, None) => String::new(),
            };
            let (done, total) = (progress.shots_done, progress.shots_total);
            format!("scan {scan_id}{part} is {state}, {done} of {total} points{why}")
        }
        Event::Alarm {
            message, scan_id, ..
        } => match scan_id {
            Some(scan_id) => format!("alarm in scan {scan_id}{part}: {message}"),
            None => format!("alarm: {message}"),
        },
        Event::Recovered {
            message, scan_id, ..
        } => match scan_id {
            Some(scan_id) => format!("recovered in scan {scan_id}{part}: {message}"),
            None => format!("recovered: {message}"),
        },
        other => match other.scan_id() {
            Some(scan_id) => format!("{} in scan {scan_id}{part}", other.kind()),
            None => other.kind().to_owned(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{OperatorAction, Progress};

    fn scan(state: ScanState) -> Event {
        Event::Scan {
            scan_id: 3,
            previous: ScanState::Running,
            state,
            reason: Some("the camera failed".into()),
            operator: None,
            progress: Progress::default(),
        }
    }

    #[test]
    fn every_state_that_a_person_should_know_of_has_a_hook() {
        let hooks = ScanState::ALL.map(|state| hook_of(&scan(state)));
        let expected = [
            None,
            Some("waiting"),
            None,
            None,
            Some("paused"),
            Some("paused"),
            Some("completed"),
            None,
            Some("failed"),
        ];
        assert_eq!(hooks, expected);
        let text = message(&scan(ScanState::Paused), Some("part 17"));
        assert_eq!(
            text,
            "scan 3 (part 17) is paused, 0 of 0 points: the camera failed"
        );
        let waiting = Event::Scan {
            scan_id: 3,
            previous: ScanState::Running,
            state: ScanState::WaitingForOperator,
            reason: None,
            operator: Some(OperatorAction::PlaceSample),
            progress: Progress::default(),
        };
        assert!(message(&waiting, None).contains("put the part on the table"));
    }

    #[tokio::test]
    async fn a_full_queue_drops_calls_and_never_blocks() {
        let (queue, mut calls) = mpsc::channel(EVENTS_MAX);
        let listener = Listener {
            queues: vec![("alarm", queue)],
        };
        let alarm = Event::Alarm {
            code: "a".into(),
            message: "look".into(),
            scan_id: None,
        };
        let event = Arc::new(RecordedEvent::unrecorded(
            time::OffsetDateTime::UNIX_EPOCH,
            alarm,
        ));
        for _ in 0..EVENTS_MAX + 10 {
            listener.take(&event);
        }
        let mut waiting = 0;
        while calls.try_recv().is_ok() {
            waiting += 1;
        }
        assert_eq!(waiting, EVENTS_MAX);
        // An event without a hook takes no place.
        let other = Arc::new(RecordedEvent::unrecorded(event.at, scan(ScanState::Paused)));
        listener.take(&other);
        assert!(calls.try_recv().is_err());
    }
}
