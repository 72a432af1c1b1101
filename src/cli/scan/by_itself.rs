//! A scan by this process: it opens the rig and the store, and leaves both safe.

use std::sync::Arc;

use anyhow::anyhow;
use serde_json::{Value, json};

use super::{Args, material, no_sample, suits_the_sample, sure_words, with_times};
use crate::cli::people::People;
use crate::cli::progress::Bar;
use crate::cli::simulated::{self, SimulatedRig, Simulation, TRACED_SAMPLE};
use crate::cli::{CliError, daemon, say};
use crate::lab::{Lab, LabError, ScanRequest};
use crate::scan::runner::Order;
use crate::scan::{Event, PlanRequest, ScanState};
use crate::store::samples::NewSample;

/// The scan from its plan to its end, on the rig of the arguments.
///
/// # Errors
/// Bad input for a rig or a sample that is not there; no result where the scan does not complete; interrupted on Ctrl-C.
pub(super) async fn scan(args: &Args, plan: PlanRequest) -> Result<Value, CliError> {
    let config = daemon::read_config(args.config.as_deref())?;
    let (simulator, parts, clock) = if args.simulated_rig {
        let (rig, mut parts) = SimulatedRig::build(Simulation {
            time_scale: args.time_scale,
            ..Simulation::default()
        })?;
        simulated::obey(&mut parts.settings, &config);
        let clock = Arc::clone(&rig.clock);
        (Some(rig), parts, clock)
    } else {
        let clock = daemon::real_clock();
        let parts = daemon::real_rig(&config, &clock)?.ok_or_else(|| {
            CliError::bad_input(anyhow!(
                "no daemon runs on {} and no rig is named: start `ridged serve`, or give --config FILE or --simulated-rig",
                args.data.display()
            ))
        })?;
        (None, parts, clock)
    };
    let lab = daemon::open_lab(&args.data, clock, Some(parts)).await?;
    let begun = std::cell::Cell::new(None);
    let done = async {
        let hands = match &simulator {
            None => None,
            Some(rig) => {
                rig.stock(&lab).await.map_err(daemon::lab_error)?;
                Some(rig.hands(&lab, true))
            }
        };
        // A rig that cannot be had is told first, whatever else is missing.
        lab.have_rig().await.map_err(daemon::lab_error)?;
        let sample_id = sample_for(&lab, args).await?;
        let after = lab
            .store()
            .last_event_id()
            .await
            .map_err(|e| daemon::lab_error(e.into()))?;
        let request = ScanRequest { sample_id, plan };
        let scan = lab.start_scan(&request).await.map_err(daemon::lab_error)?;
        begun.set(Some(scan.id));
        let people = match hands {
            Some(_) => None,
            None => Some(People::at_the_terminal()),
        };
        let followed = follow(&lab, scan.id, after, people).await;
        if let Some(hands) = hands {
            hands.abort();
        }
        let state = followed?;
        let answer = json!({ "id": scan.id, "scan_id": scan.id, "state": state });
        Ok((state, with_times(answer, lab.run_end(scan.id))))
    };
    let outcome = tokio::select! {
        outcome = done => outcome,
        ended = daemon::told_to_end() => match ended {
            Ok(()) => Err(CliError::Interrupted),
            Err(error) => Err(error),
        },
    };
    let stopped = lab.rest().await;
    let left = match (&outcome, begun.get()) {
        (Err(_), Some(scan_id)) => Some(how_left(&lab, scan_id, args).await),
        _ => None,
    };
    lab.store().close().await;
    if let Some(left) = left {
        say(&left);
        let stopped = stopped.map_err(|source| LabError::NotStopped { source });
        match (stopped, &outcome) {
            (Ok(()), _) => {
                say(&format_args!(
                    "the stages stand; the lamp is as it was: ridged does not switch it"
                ));
            }
            // Nothing is safe then, whatever Ctrl-C usually means.
            (Err(error), Err(CliError::Interrupted)) => return Err(daemon::lab_error(error)),
            (Err(error), _) => say(&error),
        }
    }
    let (state, answer) = outcome?;
    match state {
        ScanState::Completed => Ok(answer),
        other => Err(CliError::no_result(anyhow!(
            "scan {} is {other}; what it committed is kept",
            answer["id"]
        ))),
    }
}

/// How a scan that was cut off is left, and the way to go on with it.
async fn how_left(lab: &Lab, scan_id: i64, args: &Args) -> String {
    let Ok(scan) = lab.store().scan(scan_id).await else {
        return format!("scan {scan_id} was cut off; what it committed is kept");
    };
    let progress = lab.store().last_progress(scan_id).await.unwrap_or_default();
    let kept = format!(
        "scan {scan_id} is {}, {} of {} frames are kept",
        scan.state, progress.frames_done, progress.frames_total
    );
    let rig = match (&args.config, args.simulated_rig) {
        (_, true) => " --simulated-rig".to_owned(),
        (Some(file), _) => format!(" --config {}", file.display()),
        (None, false) => String::new(),
    };
    match scan.state {
        ScanState::Interrupted => format!(
            "{kept}; to go on with it start `ridged serve{rig} --data {}` and resume it on the page, or by POST \
             /api/v1/scans/{scan_id}/resume",
            args.data.display()
        ),
        _ => kept,
    }
}

/// The sample that the arguments mean.
async fn sample_for(lab: &Lab, args: &Args) -> Result<i64, CliError> {
    let wanted = match (&args.sample, args.simulated_rig) {
        (Some(name), _) => Some(name.as_str()),
        (None, true) => Some(TRACED_SAMPLE),
        (None, false) => None,
    };
    let found = lab.store().newest_sample(wanted, |_| true).await;
    if let Some(sample) = found.map_err(|e| daemon::lab_error(e.into()))? {
        suits_the_sample(args, &sample.material)?;
        return Ok(sample.id);
    }
    let Some(material) = material(args)? else {
        return Err(no_sample(wanted));
    };
    let sample = NewSample {
        name: wanted.unwrap_or("sample").to_owned(),
        material,
        note: None,
        simulated: None,
    };
    if let Some((field, message)) = sample.fault() {
        let option = match field {
            "name" => "--sample",
            "material.k" => "--k",
            _ => "--eta",
        };
        return Err(CliError::bad_input(anyhow!("{option}: {message}")));
    }
    let sample = lab.store().add_sample(&sample).await;
    Ok(sample.map_err(|e| daemon::lab_error(e.into()))?.id)
}

/// Follows a scan of this process to its end, or to where it needs a person who is not there.
///
/// # Errors
/// No result where it pauses by itself.
pub async fn follow(
    lab: &Lab,
    scan_id: i64,
    mut after: i64,
    mut people: Option<People>,
) -> Result<ScanState, CliError> {
    let bar = Bar::new("frames");
    let mut sure = None;
    loop {
        let mut step = None;
        let mut paused = None;
        let scan = lab
            .wait_for_scan(scan_id, after, |event| {
                after = event.id;
                match &event.event {
                    Event::Scan {
                        state,
                        operator,
                        reason,
                        progress,
                        ..
                    } => {
                        bar.show(
                            u64::from(progress.frames_done),
                            u64::from(progress.frames_total),
                            state.as_str(),
                        );
                        step = *operator;
                        if *state == ScanState::Paused {
                            paused = reason.clone();
                        }
                        (step.is_some() && people.is_some()) || paused.is_some()
                    }
                    Event::Frame { progress, kind, .. } => {
                        bar.show(
                            u64::from(progress.frames_done),
                            u64::from(progress.frames_total),
                            sure.as_deref().unwrap_or(kind.as_str()),
                        );
                        false
                    }
                    Event::Uncertainty { certainty, .. } => {
                        sure = certainty
                            .parameters
                            .get("theta_r_deg")
                            .map(|p| sure_words(p.value, p.std, certainty.elapsed_s))
                            .or(sure.take());
                        false
                    }
                    _ => false,
                }
            })
            .await
            .map_err(daemon::lab_error)?;
        if let Some(reason) = paused {
            bar.clear();
            return Err(CliError::no_result(anyhow!(
                "scan {scan_id} was paused and needs a person: {reason}"
            )));
        }
        if scan.state.is_end() || scan.state == ScanState::Interrupted {
            bar.clear();
            if let Some(sure) = sure {
                say(&format_args!("fitted along with the scan: {sure}"));
            }
            if let (ScanState::Failed, Some(reason)) = (scan.state, &scan.reason) {
                return Err(CliError::no_result(anyhow!(
                    "scan {scan_id} failed: {reason}"
                )));
            }
            return Ok(scan.state);
        }
        if let (Some(action), Some(people)) = (step, &mut people) {
            people.ask(&bar, action);
            if !people.done(&bar).await {
                return Err(CliError::no_result(anyhow!(
                    "the scan needs a person ({}), but nobody is at the terminal; run it by `ridged serve` and the page",
                    action.message()
                )));
            }
            lab.order(scan_id, Order::Done(action))
                .await
                .map_err(daemon::lab_error)?;
        }
    }
}
