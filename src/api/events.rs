//! `/events`: server-sent events. A client that reconnects with its last id misses nothing.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Extension, State};
use axum::http::HeaderMap;
use axum::response::sse::{Event as SseEvent, KeepAlive, Sse};
use futures::Stream;
use serde::Deserialize;
use tokio::sync::broadcast;
use tokio::time::{Interval, MissedTickBehavior, interval};

use super::App;
use super::access::Access;
use super::caller::Principal;
use super::event_body::EventBody;
use super::extract::Params;
use super::peers::StreamPlace;
use super::status::ApiError;
use super::via::Client;
use crate::lab::Lab;
use crate::scan::RecordedEvent;

/// A client that has left is noticed only when something is written to it; until then it holds a seat.
const KEEP_ALIVE: Duration = Duration::from_secs(3);

/// Time between two readings of the positions while an axis moves.
const POSITIONS_EVERY: Duration = Duration::from_millis(200);

/// Start and content of the stream.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct EventParams {
    /// Start after this id; 0 for all events. A `Last-Event-ID` header takes precedence.
    since: Option<i64>,
    /// Also send `rig` events with both positions, five a second while an axis moves. They are not stored and have no id to
    /// continue after.
    #[serde(default)]
    positions: bool,
}

/// Events as they happen: rig, scan, frame, fit, uncertainty, calculation, forecast, recovered, order, alarm, each with an id.
#[utoipa::path(get, path = "/api/v1/events", tag = "events", params(EventParams,
    ("Last-Event-ID" = Option<i64>, Header, description = "Last id seen; later events are sent first")), responses(
    (status = 200, description = "Server-sent events; `data` of each is one JSON object of this form", content_type = "text/event-stream", body = EventBody),
    (status = 400, description = "Last-Event-ID is not an id", body = super::status::Problem),
    (status = 429, description = "Too many event streams are open (`too-many-streams`)", body = super::status::Problem),
))]
pub(super) async fn stream(
    State(app): State<App>,
    Params(params): Params<EventParams>,
    Extension(client): Extension<Client>,
    Extension(caller): Extension<Principal>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<SseEvent, Infallible>>>, ApiError> {
    let place = app.peers.stream(client.address);
    let place = place.ok_or_else(ApiError::too_many_streams)?;
    // Subscribe before reading the newest id, so that no event is missed.
    let listener = app.lab.events();
    let header = match headers.get("last-event-id") {
        None => None,
        Some(value) => Some(
            value
                .to_str()
                .ok()
                .and_then(|text| text.trim().parse::<i64>().ok())
                .ok_or_else(|| ApiError::bad_request("Last-Event-ID must be a whole number"))?,
        ),
    };
    let newest = app.lab.store().last_event_id().await?;
    let last = header.or(params.since).unwrap_or(newest).clamp(0, newest);
    let follower = Follower {
        lab: app.lab.clone(),
        listener,
        last,
        backlog: VecDeque::new(),
        behind: last < newest,
        positions: params.positions.then(|| {
            let mut ticks = interval(POSITIONS_EVERY);
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
            ticks
        }),
        _place: place,
    };
    let app = app.clone();
    let events = futures::stream::unfold(follower, move |mut follower| {
        let (app, caller) = (app.clone(), caller.clone());
        async move {
            let next = tokio::select! {
                () = app.ending.cancelled() => None,
                () = revoked(&app.access, &caller) => None,
                next = follower.next() => next,
            };
            // A token may have been revoked while no event came.
            let next = next.filter(|_| app.access.is_still_valid(&caller));
            next.map(|event| (Ok(sse(event)), follower))
        }
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)))
}

/// Completes when the token of a caller was revoked: its event stream ends then.
async fn revoked(access: &Access, caller: &Principal) {
    while access.is_still_valid(caller) {
        tokio::time::sleep(KEEP_ALIVE).await;
    }
}

/// The events of one client: from the store while it is behind, then live.
struct Follower {
    lab: Lab,
    listener: broadcast::Receiver<Arc<RecordedEvent>>,
    last: i64,
    backlog: VecDeque<RecordedEvent>,
    behind: bool,
    /// When the positions are read, if the client asked for them.
    positions: Option<Interval>,
    _place: StreamPlace,
}

impl Follower {
    async fn next(&mut self) -> Option<RecordedEvent> {
        loop {
            if let Some(event) = self.backlog.pop_front() {
                self.last = event.id;
                return Some(event);
            }
            if self.behind {
                match self.lab.store().events_after(self.last, 500).await {
                    Ok(events) => {
                        self.behind = !events.is_empty();
                        self.backlog = events.into();
                    }
                    Err(error) => {
                        tracing::warn!(%error, "events could not be read: {error}");
                        return None;
                    }
                }
                continue;
            }
            let heard = tokio::select! {
                biased;
                heard = self.listener.recv() => heard,
                event = in_motion(&self.lab, self.positions.as_mut()) => return Some(event),
            };
            match heard {
                Ok(event) if !event.is_recorded() => return Some(RecordedEvent::clone(&event)),
                Ok(event) if event.id <= self.last => {}
                Ok(event) if event.id == self.last + 1 => {
                    self.last = event.id;
                    return Some(RecordedEvent::clone(&event));
                }
                Ok(_) | Err(broadcast::error::RecvError::Lagged(_)) => self.behind = true,
                Err(broadcast::error::RecvError::Closed) => return None,
            }
        }
    }
}

/// Completes with the positions while an axis moves; never where the client did not ask for them.
async fn in_motion(lab: &Lab, ticks: Option<&mut Interval>) -> RecordedEvent {
    let Some(ticks) = ticks else {
        return std::future::pending().await;
    };
    loop {
        ticks.tick().await;
        if let Some(event) = lab.in_motion().await {
            return event;
        }
    }
}

fn sse(event: RecordedEvent) -> SseEvent {
    let (kind, id) = (event.event.kind(), event.is_recorded().then_some(event.id));
    let sent = SseEvent::default().event(kind);
    let body = serde_json::to_string(&EventBody::from(event));
    let sent = sent.data(body.expect("an event is JSON"));
    // A client continues after the last id it got, so an event without a number has none.
    match id {
        Some(id) => sent.id(id.to_string()),
        None => sent,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Event, OperatorAction, Progress, ScanState};

    #[test]
    fn an_event_of_a_waiting_scan_has_the_operator_step() {
        let event = RecordedEvent {
            id: 7,
            at: time::macros::datetime!(2026-01-01 00:00 UTC),
            who: Some("anna".into()),
            event: Event::Scan {
                scan_id: 3,
                previous: ScanState::Running,
                state: ScanState::WaitingForOperator,
                reason: None,
                operator: Some(OperatorAction::CapLens),
                progress: Progress::default(),
            },
        };
        let body = serde_json::to_value(EventBody::from(event)).unwrap();
        assert_eq!(body["id"], 7);
        assert_eq!(body["who"], "anna");
        assert_eq!(body["type"], "scan");
        assert_eq!(body["operator"]["action"], "cap-lens");
        assert!(
            body["operator"]["message"]
                .as_str()
                .unwrap()
                .contains("cap")
        );
    }
}
