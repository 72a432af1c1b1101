//! Telemetry: writes every event to the log and counts it for monitors.

use metrics::counter;

use crate::scan::{Event, RecordedEvent};

/// Counts an event; a state is counted when it is entered.
pub(super) fn count(event: &Event) {
    match event {
        Event::Scan { state, .. } => {
            counter!("ridged_scan_states_total", "state" => state.as_str()).increment(1);
        }
        Event::Frame { accepted, .. } => {
            let accepted = if *accepted { "true" } else { "false" };
            counter!("ridged_frames_total", "accepted" => accepted).increment(1);
        }
        Event::Fit { .. } | Event::Calculation { .. } => {
            if let Some((id, state)) = event.job() {
                let (task, state) = (id.kind.as_str(), state.as_str());
                counter!("ridged_task_states_total", "task" => task, "state" => state).increment(1);
            }
        }
        Event::Recovered { code, attended, .. } => {
            let attended = if *attended { "true" } else { "false" };
            counter!("ridged_recoveries_total", "code" => code.clone(), "attended" => attended)
                .increment(1);
        }
        Event::Alarm { code, .. } => {
            counter!("ridged_alarms_total", "code" => code.clone()).increment(1);
        }
        Event::Rig { .. }
        | Event::Uncertainty { .. }
        | Event::Forecast { .. }
        | Event::Order { .. } => {}
    }
}

/// Writes an event to the log.
pub(super) fn log(event: &RecordedEvent) {
    let id = event.id;
    match &event.event {
        Event::Rig { activity, .. } => tracing::debug!(id, "rig: {activity:?}"),
        Event::Scan {
            scan_id,
            state,
            reason,
            ..
        } => {
            let reason = reason
                .as_ref()
                .map_or_else(String::new, |r| format!(" ({r})"));
            tracing::info!(id, scan_id, %state, "scan {scan_id} is {state}{reason}");
        }
        Event::Frame {
            scan_id,
            frame_id,
            theta_c_deg,
            phi_s_deg,
            ..
        } => tracing::debug!(
            id,
            scan_id,
            frame_id,
            "scan {scan_id}: frame {frame_id} at θc {theta_c_deg:.3}°, φs {phi_s_deg:.3}°"
        ),
        Event::Fit { .. } | Event::Calculation { .. } => {
            if let Some((job, state)) = event.event.job() {
                tracing::info!(id, %job, "{job} is {state}");
            }
        }
        Event::Uncertainty { scan_id, certainty } => tracing::debug!(
            id,
            scan_id,
            "scan {scan_id}: {} after {} poses and {:.0} s",
            certainty.status,
            certainty.n_observations,
            certainty.elapsed_s
        ),
        Event::Forecast {
            of,
            number,
            forecast,
            ..
        } => tracing::info!(id, of, number, "{of} {number}, forecast: {forecast}"),
        Event::Recovered {
            scan_id,
            code,
            message,
            took_s,
            points,
            ..
        } => tracing::warn!(id, code, scan_id, took_s, ?points, "recovered: {message}"),
        Event::Order { order, scan_id } => {
            let who = event.who.as_deref().unwrap_or_default();
            tracing::info!(id, scan_id, who, "{who}: {order}");
        }
        Event::Alarm {
            code,
            message,
            scan_id,
        } => tracing::warn!(id, code, scan_id, "{code}: {message}"),
    }
}
