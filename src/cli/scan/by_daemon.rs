//! A scan by the daemon that runs on the data folder: this process starts it, follows it, and passes on the operator's
//! confirmations.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use serde::Deserialize as _;
use serde_json::{Value, json};

use super::{
    Args, ambiguous, estimate, material, no_sample, request, suits_the_sample, sure_words,
};
use crate::cli::client::Client;
use crate::cli::operator_prompt::OperatorPrompt;
use crate::cli::progress::Bar;
use crate::cli::{CliError, interrupt, say};
use crate::fit::FitReport;
use crate::fit::report::text::in_one_line;
use crate::lab::{FIT_NOT_STARTED, NOT_JUDGED};
use crate::material::Material;
use crate::scan::{OperatorAction, PlanRequest, ScanState};
use crate::sim::operator::TRACED_SAMPLE;
use crate::store::samples::AmbiguousPart;

/// Interval between requests for the scan's state, and so the longest time that a prompt outlives its step.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Requests for the scan's state per request for the uncertainty of its fit.
const LOOKS_PER_QUESTION: u32 = 16;

/// Formats the newest row of the fit that runs during the scan.
fn newest_words(client: &Client, id: i64) -> Option<String> {
    let rows = client
        .get(&format!("/scans/{id}/uncertainty?limit=1000"))
        .ok()?;
    let row = rows["items"].as_array()?.last()?.clone();
    let theta_r = &row["parameters"]["theta_r_deg"];
    let known = serde_json::from_value(theta_r.clone()).ok()?;
    Some(sure_words(known, row["elapsed_s"].as_f64()?))
}

/// Refuses options of a rig that is not the daemon's.
fn refuse_another_rig(client: &Client, args: &Args) -> Result<(), CliError> {
    if args.config.is_none() && !args.simulated_rig {
        return Ok(());
    }
    Err(CliError::bad_input(anyhow!(
        "a daemon runs on {} ({}) and has its own rig; leave out --config and --simulated-rig, or give another --data",
        args.data.display(),
        client.url
    )))
}

/// Prints the estimate of the scan on the daemon's rig.
///
/// # Errors
/// Bad input for options of another rig or a plan that cannot run; no result where something prevents the scan.
pub(super) fn estimate(
    client: &Client,
    args: &Args,
    plan: Option<PlanRequest>,
) -> Result<(), CliError> {
    refuse_another_rig(client, args)?;
    let rig = client.get("/rig")?;
    let sample_id = daemons_sample(client, args, rig["simulated"] == true)?;
    let body = json!(request(args, sample_id, plan));
    let estimate = client.post("/scans/estimate", Some(&body))?;
    let problem = rig["problem"]["detail"].as_str().map(str::to_owned);
    let held = rig["scan_id"].as_i64();
    let held = held.map(|id| format!("scan {id} holds the rig until its end"));
    estimate::print(args, estimate, held.or(problem).into_iter().collect())
}

/// Runs the scan on the daemon's rig, from plan to end.
///
/// # Errors
/// Bad input for options of another rig; no result where the scan does not complete; interrupted on Ctrl-C.
pub(super) fn scan(
    client: &Client,
    args: &Args,
    plan: Option<PlanRequest>,
) -> Result<Value, CliError> {
    refuse_another_rig(client, args)?;
    let rig = client.get("/rig")?;
    if let Some(problem) = rig["problem"]["detail"].as_str() {
        return Err(CliError::no_result(anyhow!("{problem}")));
    }
    let simulated = rig["simulated"] == true;
    let sample_id = daemons_sample(client, args, simulated)?;
    let body = json!(request(args, sample_id, plan));
    // Before the rig may move.
    let stopped = interrupt::flag()?;
    let begun = client.post("/scans", Some(&body))?;
    let id = begun["id"].as_i64().unwrap_or_default();
    let mut people = (!simulated).then(OperatorPrompt::at_the_terminal);
    let scan = followed(client, id, &mut people, &stopped)?;
    if let Some(sure) = newest_words(client, id) {
        say(&format_args!("fitted during the scan: {sure}"));
    }
    let state = scan["state"].as_str().unwrap_or_default();
    if state != "completed" {
        let why = match scan["reason"].as_str() {
            Some(reason) => format!(" ({reason})"),
            None => String::new(),
        };
        return Err(CliError::no_result(anyhow!(
            "scan {id} is {state}{why}; committed frames are kept"
        )));
    }
    say(&format_args!("its result: {}/#/result/{id}", client.url));
    let mut answer = json!({ "id": id, "scan_id": id, "state": state });
    if args.specification.is_some() && !args.json {
        answer["verdicts"] = verdicts(client, id, &stopped)?;
        for fit in fits(client, id)? {
            say(&fit);
        }
    }
    Ok(answer)
}

/// Returns the completed fits of a scan, in a line each.
fn fits(client: &Client, id: i64) -> Result<Vec<String>, CliError> {
    let rows = client.get(&format!("/fits?scan_id={id}&limit=1000"))?;
    let rows = rows["items"].as_array().into_iter().flatten().rev();
    let completed = rows.filter(|row| row["state"] == "completed");
    let lines = completed.map(|row| {
        let report = FitReport::deserialize(row).map_err(CliError::no_result)?;
        Ok(format!("fit {}: {}", row["id"], in_one_line(&report)))
    });
    lines.collect()
}

/// Waits for the verdicts on a completed scan.
///
/// # Errors
/// No result where an alarm says that there is none; interrupted on Ctrl-C, after which the daemon still judges.
fn verdicts(client: &Client, id: i64, stopped: &AtomicBool) -> Result<Value, CliError> {
    let bar = Bar::new("verdicts");
    loop {
        let rows = |noun: &str| client.get(&format!("/{noun}?scan_id={id}&limit=1000"));
        let (fits, verdicts) = (rows("fits")?, rows("verdicts")?);
        let in_state = |rows: &Value, state: &str| {
            let rows = rows["items"].as_array().into_iter().flatten();
            rows.filter(|row| row["state"] == state).count()
        };
        let n_fits = in_state(&fits, "completed");
        let n_verdicts = in_state(&verdicts, "completed");
        bar.show(
            n_verdicts as u64,
            n_fits.max(1) as u64,
            "fitting and judging",
        );
        let running = in_state(&fits, "running") + in_state(&verdicts, "running");
        if n_fits > 0 && running == 0 && n_verdicts >= n_fits {
            bar.clear();
            return Ok(verdicts["items"].clone());
        }
        let incidents = client.get(&format!("/scans/{id}/incidents?limit=1000"))?;
        let gave_up = incidents["items"].as_array().into_iter().flatten();
        let mut gave_up =
            gave_up.filter(|i| i["code"] == FIT_NOT_STARTED || i["code"] == NOT_JUDGED);
        if let Some(alarm) = gave_up.next() {
            bar.clear();
            let why = alarm["message"].as_str().unwrap_or_default();
            return Err(CliError::no_result(anyhow!("{why}")));
        }
        let ended_without = in_state(&fits, "failed") + in_state(&fits, "cancelled");
        if running == 0 && ended_without > 0 {
            bar.clear();
            return Err(CliError::no_result(anyhow!(
                "scan {id} has no verdict, since its fit has no result; see {}/#/result/{id}",
                client.url
            )));
        }
        if stopped.load(Ordering::Relaxed) {
            bar.clear();
            return Err(CliError::Interrupted);
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Follows a scan to its end and passes on the confirmations of the operator at this terminal.
///
/// # Errors
/// No result where it pauses, or waits for an operator and the input has ended; interrupted where it was paused on Ctrl-C.
pub(in crate::cli) fn followed(
    client: &Client,
    id: i64,
    people: &mut Option<OperatorPrompt>,
    stopped: &AtomicBool,
) -> Result<Value, CliError> {
    let bar = Bar::new("frames");
    let mut sure: Option<String> = None;
    let mut looks = 0u32;
    // The step shown on the terminal, which Enter confirms.
    let mut asked: Option<OperatorAction> = None;
    loop {
        if stopped.load(Ordering::Relaxed) {
            bar.clear();
            return Err(match paused(client, id) {
                Ok(()) => CliError::Interrupted,
                Err(error) => error,
            });
        }
        if looks % LOOKS_PER_QUESTION == LOOKS_PER_QUESTION - 1 {
            sure = newest_words(client, id).or(sure);
        }
        looks = looks.wrapping_add(1);
        let scan = client.get(&format!("/scans/{id}"))?;
        let state = state_of(&scan);
        let progress = &scan["progress"];
        let number = |key: &str| progress[key].as_u64().unwrap_or(0);
        let word = sure
            .as_deref()
            .unwrap_or(state.map_or("", ScanState::as_str));
        bar.show(number("frames_done"), number("frames_total"), word);
        let waits_for = scan["operator"]["action"]
            .as_str()
            .and_then(OperatorAction::from_word);
        if asked.is_some() && asked != waits_for {
            asked = None;
            if matches!(
                state,
                Some(ScanState::Running | ScanState::WaitingForOperator)
            ) {
                bar.say("Another client has confirmed this step.");
            }
        }
        match (state, waits_for, &mut *people) {
            (Some(state), ..) if state.is_end() || state == ScanState::Interrupted => {
                bar.clear();
                return Ok(scan);
            }
            (Some(ScanState::Paused), ..) => {
                bar.clear();
                let reason = scan["reason"].as_str().unwrap_or("by another client");
                return Err(CliError::no_result(anyhow!(
                    "scan {id} is paused: {reason} (to resume: {}, or `ridged scan resume {id}`)",
                    client.url
                )));
            }
            (_, Some(action), None) => {
                continued(client, id, action)?;
            }
            (_, Some(action), Some(people)) => {
                if asked.is_none() {
                    people.ask(&bar, action);
                    asked = Some(action);
                }
                match people.done_by_now(&bar) {
                    // Ctrl-C came first.
                    _ if stopped.load(Ordering::Relaxed) => {}
                    None => {}
                    // The confirmation came too late for this step; the next request shows the present one.
                    Some(true) if !continued(client, id, action)? => {}
                    Some(true) => asked = None,
                    Some(false) => {
                        bar.clear();
                        return Err(CliError::no_result(anyhow!(
                            "scan {id} waits for the operator ({}), but the input of this command has ended; continue on {}",
                            action.message(),
                            client.url
                        )));
                    }
                }
            }
            _ => {}
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

fn state_of(scan: &Value) -> Option<ScanState> {
    scan["state"].as_str().and_then(ScanState::from_word)
}

/// Confirms a step; false where the scan no longer waits for it.
fn continued(client: &Client, id: i64, action: OperatorAction) -> Result<bool, CliError> {
    let done = json!({ "action": action });
    let answer = client.post_in_time(&format!("/scans/{id}/continue"), Some(&done))?;
    Ok(answer.is_some())
}

/// Pauses a daemon's scan, waits until its motion has ended, and reports its state.
///
/// # Errors
/// No result where the state is unknown: the stages may be moving.
fn paused(client: &Client, id: i64) -> Result<(), CliError> {
    /// Longer than most poses take.
    const PATIENCE: Duration = Duration::from_secs(60);
    let unsure = |why: String| {
        CliError::no_result(anyhow!(
            "the pause of scan {id} is not confirmed: {why}; the stages may be moving: `ridged rig stop` stops them, or see {}",
            client.url
        ))
    };
    let lost = |error: CliError| match error {
        CliError::BadInput(why) | CliError::NoResult(why) => unsure(why.to_string()),
        ended @ (CliError::Interrupted | CliError::Verdict(_)) => ended,
    };
    let begun = Instant::now();
    let mut is_reported = false;
    loop {
        let scan = client.get(&format!("/scans/{id}")).map_err(lost)?;
        let state = state_of(&scan);
        match state {
            Some(ScanState::Paused) => {
                say(&format_args!(
                    "scan {id} is paused, {} of {} frames are kept; resume or abort it on {}, or with `ridged scan resume {id}`",
                    scan["progress"]["frames_done"], scan["progress"]["frames_total"], client.url
                ));
                return Ok(());
            }
            Some(state) if state.is_end() || state == ScanState::Interrupted => {
                say(&format_args!(
                    "scan {id} is {state}; committed frames are kept"
                ));
                return Ok(());
            }
            _ if begun.elapsed() > PATIENCE => {
                return Err(unsure(format!(
                    "it is {} after {} s",
                    scan["state"].as_str().unwrap_or("in an unknown state"),
                    PATIENCE.as_secs()
                )));
            }
            _ => {}
        }
        // A scan that waits for the operator does not move.
        if !is_reported && state != Some(ScanState::WaitingForOperator) {
            say(&format_args!(
                "scan {id} pauses after this pose (Ctrl-C again ends this command at once)"
            ));
            is_reported = true;
        }
        if matches!(
            state,
            Some(ScanState::Running | ScanState::WaitingForOperator)
        ) {
            // A conflict means that the state has changed in the meantime.
            client
                .post_in_time(&format!("/scans/{id}/pause"), None)
                .map_err(lost)?;
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Returns the sample that is on the rig: the one of `--sample`, or that of the last scan, else of a simulated rig its own.
fn daemons_sample(client: &Client, args: &Args, simulated: bool) -> Result<i64, CliError> {
    if let Some(id) = args.sample_id {
        client.get(&format!("/samples/{id}"))?;
        return Ok(i64::from(id));
    }
    let mut wanted = args.sample.as_deref();
    if wanted.is_none() {
        let scans = client.get("/scans?limit=1000")?;
        let last = scans["items"].as_array().into_iter().flatten();
        let last = last
            .filter(|scan| scan["origin"] == "rig" && scan["plan"]["repeats"] != 0)
            .find_map(|scan| scan["sample_id"].as_i64());
        if let Some(id) = last {
            return Ok(id);
        }
        wanted = simulated.then_some(TRACED_SAMPLE);
    }
    let found = match wanted {
        Some(name) => one_named(name, &client.search("/samples", &[("name", name)])?)?,
        None => Value::Null,
    };
    if let Some(id) = found["id"].as_i64() {
        if let Ok(kept) = serde_json::from_value::<Material>(found["material"].clone()) {
            suits_the_sample(args, &kept)?;
        }
        return Ok(id);
    }
    let Some(material) = material(args)? else {
        return Err(no_sample(wanted));
    };
    let body = json!({ "name": wanted.unwrap_or("sample"), "material": material });
    let added = client.post("/samples", Some(&body))?;
    Ok(added["id"].as_i64().unwrap_or_default())
}
/// Returns the part that has a name; null if no part has it.
///
/// # Errors
/// Bad input where several parts have the name.
fn one_named(name: &str, found: &Value) -> Result<Value, CliError> {
    match found["items"].as_array().map_or(&[][..], Vec::as_slice) {
        [] => Ok(Value::Null),
        [one] => Ok(one.clone()),
        several => {
            let ids = several.iter().filter_map(|part| part["id"].as_i64());
            let mut ids: Vec<i64> = ids.collect();
            ids.sort_unstable();
            let name = name.to_owned();
            Err(ambiguous(&AmbiguousPart { name, ids }))
        }
    }
}
