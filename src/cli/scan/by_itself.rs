//! A scan in this process: opens the rig and the store, and leaves both safe.

use std::sync::Arc;

use anyhow::anyhow;
use serde_json::{Value, json};

use super::{
    Args, ambiguous, estimate, material, no_sample, print, request, suits_the_sample, sure_words,
    with_times,
};
use crate::api::EstimateBody;
use crate::cli::operator_prompt::OperatorPrompt;
use crate::cli::progress::Bar;
use crate::cli::{CliError, runtime, say};
use crate::clock::Clock;
use crate::config::Config;
use crate::daemon;
use crate::fit::FitReport;
use crate::fit::report::text::in_one_line;
use crate::lab::assembly::real_rig;
use crate::lab::{Hooks, Lab, LabError, RigParts};
use crate::scan::runner::ScanCommand;
use crate::scan::{Event, PlanRequest, ScanState};
use crate::sim::operator::TRACED_SAMPLE;
use crate::sim::rig::{SimulatedRig, Simulation};
use crate::store::StoreError;
use crate::store::disk::RealDisk;
use crate::store::samples::NewSample;

/// Runs the scan on the rig of the arguments, from plan to end, prints it, and fits it if the settings say so. The fit follows
/// what is printed: a script does not wait for it.
///
/// # Errors
/// Bad input for a missing rig or sample; no result where the scan does not complete; interrupted on Ctrl-C.
pub(super) async fn scan(args: &Args, plan: Option<PlanRequest>) -> Result<(), CliError> {
    let config = runtime::read_config(args.config.as_deref())?;
    let is_calibration = plan.as_ref().is_some_and(|plan| plan.repeats == Some(0));
    let (simulator, mut parts, clock) = rig_of(args, &config)?;
    // Started below, once the scan is complete: this process takes no part in the fits of earlier scans.
    let is_fitted = std::mem::take(&mut parts.settings.fit_at_end);
    let (lab, earlier) = daemon::open_lab(&args.data, Arc::new(RealDisk), clock, Some(parts))
        .await
        .map_err(CliError::no_result)?;
    let hooks = Hooks::start(&lab, &config.hooks, None, earlier);
    let begun = std::cell::Cell::new(None);
    let done = async {
        let hands = match &simulator {
            None => None,
            Some(rig) => {
                rig.add_samples(&lab).await.map_err(runtime::lab_error)?;
                Some(rig.operate(&lab, true))
            }
        };
        // A rig that does not connect is reported first.
        lab.have_rig().await.map_err(runtime::lab_error)?;
        let sample_id = sample_for(&lab, args).await?;
        let after = lab
            .store()
            .last_event_id()
            .await
            .map_err(|e| runtime::lab_error(e.into()))?;
        let request = request(args, sample_id, plan);
        let scan = lab.start_scan(&request).await.map_err(runtime::lab_error)?;
        begun.set(Some(scan.id));
        let people = match hands {
            Some(_) => None,
            None => Some(OperatorPrompt::at_the_terminal()),
        };
        let followed = follow(&lab, scan.id, after, people).await;
        if let Some(hands) = hands {
            hands.abort();
        }
        let state = followed?;
        let mut answer = json!({ "id": scan.id, "scan_id": scan.id, "state": state });
        if state == ScanState::Completed && (scan.recipe.is_some() || scan.specification.is_some())
        {
            say("fitting the scan");
            let outcome = lab.until_judged(scan.id).await;
            let outcome = outcome.map_err(runtime::lab_error)?;
            let results = outcome
                .verdicts
                .iter()
                .filter_map(|job| job.result.as_deref());
            let verdicts: Result<Vec<Value>, _> = results.map(serde_json::from_str).collect();
            answer["verdicts"] = json!(verdicts.map_err(CliError::no_result)?);
        }
        let answer = with_times(answer, lab.run_end(scan.id));
        if state == ScanState::Completed {
            print(args, &answer)?;
            let follows = scan.recipe.is_some() || scan.specification.is_some();
            if is_fitted && !is_calibration && !follows {
                fit(&lab, scan.id).await?;
            }
        }
        Ok(state)
    };
    let outcome = tokio::select! {
        outcome = done => outcome,
        ended = runtime::stop_requested() => match ended {
            Ok(()) => Err(CliError::Interrupted),
            Err(error) => Err(error),
        },
    };
    let stopped = lab.rest().await;
    let left = match (&outcome, begun.get()) {
        (Err(_), Some(scan_id)) => Some(how_left(&lab, scan_id, args).await),
        _ => None,
    };
    hooks.finish().await;
    lab.store().close().await;
    if let Some(left) = left {
        say(&left);
        let stopped = stopped.map_err(|source| LabError::NotStopped { source });
        match (stopped, &outcome) {
            (Ok(()), _) => {
                say(match config.lamp.off.is_empty() {
                    true => {
                        "the stages are at rest; the settings name no command that switches the lamp"
                    }
                    false => "the stages are at rest",
                });
            }
            // The stages may be moving, so exit code 130 ("safe") does not apply.
            (Err(error), Err(CliError::Interrupted)) => return Err(runtime::lab_error(error)),
            (Err(error), _) => say(&error),
        }
    }
    let state = outcome?;
    let scan_id = begun.get().unwrap_or_default();
    match state {
        ScanState::Completed => {
            let follows = is_fitted || args.recipe.is_some() || args.specification.is_some();
            if !is_calibration && !follows {
                say(&format_args!(
                    "to fit it: ridged fit --scan {scan_id} --store --data {}",
                    args.data.display()
                ));
            }
            Ok(())
        }
        other => Err(CliError::no_result(anyhow!(
            "scan {scan_id} is {other}; committed frames are kept"
        ))),
    }
}

/// The simulator, if the rig is simulated, its parts, and the time that it follows.
type GivenRig = (Option<SimulatedRig>, RigParts, Arc<dyn Clock>);

/// Returns the rig of the arguments.
///
/// # Errors
/// Bad input where no rig is given, or where the settings of its camera are wrong.
fn rig_of(args: &Args, config: &Config) -> Result<GivenRig, CliError> {
    Ok(if args.simulated_rig {
        let (rig, parts) = SimulatedRig::build(Simulation {
            time_scale: args.time_scale,
            ..Simulation::default()
        })?;
        let clock = Arc::clone(&rig.clock);
        (Some(rig), parts.simulating(config), clock)
    } else {
        let clock = runtime::real_clock();
        let parts = real_rig(config, &clock).map_err(CliError::bad_input)?;
        let parts = parts.ok_or_else(|| {
            CliError::bad_input(anyhow!(
                "no daemon runs on {} and no rig is given: start `ridged serve`, or give --config FILE or --simulated-rig",
                args.data.display()
            ))
        })?;
        (None, parts, clock)
    })
}

/// Prints the estimate of the scan on the rig of the arguments, which is not connected.
///
/// # Errors
/// Bad input for a missing rig or sample, or a plan that cannot run; no result where something prevents the scan.
pub(super) async fn estimate(args: &Args, plan: Option<PlanRequest>) -> Result<(), CliError> {
    let config = runtime::read_config(args.config.as_deref())?;
    let (simulator, parts, clock) = rig_of(args, &config)?;
    let opened = daemon::open_lab(&args.data, Arc::new(RealDisk), clock, Some(parts)).await;
    let (lab, _) = opened.map_err(CliError::no_result)?;
    let estimated = async {
        if let Some(rig) = &simulator {
            rig.add_samples(&lab).await.map_err(runtime::lab_error)?;
        }
        let request = request(args, sample_for(&lab, args).await?, plan);
        lab.estimate(&request).await.map_err(runtime::lab_error)
    };
    let estimated = estimated.await;
    lab.shut_down().await;
    let estimate = serde_json::to_value(EstimateBody::from(estimated?));
    estimate::print(args, estimate.map_err(CliError::no_result)?, Vec::new())
}

/// Fits a completed scan, stores the fits of all regions, and reports the ridge angles on stderr.
async fn fit(lab: &Lab, scan_id: i64) -> Result<(), CliError> {
    say("fitting the scan");
    lab.fit_at_end(scan_id).await;
    let outcome = lab.until_judged(scan_id).await;
    for fit in outcome.map_err(runtime::lab_error)?.fits.iter().rev() {
        let report = fit.result.as_deref().map(serde_json::from_str::<FitReport>);
        match report.transpose().map_err(CliError::no_result)? {
            Some(report) => say(&format_args!(
                "fit {}: {}",
                fit.number,
                in_one_line(&report)
            )),
            None => {
                let why = fit.error_detail.as_deref().unwrap_or("it has no result");
                say(&format_args!("fit {}: {why}", fit.number));
            }
        }
    }
    Ok(())
}

/// Describes the state of an interrupted scan, and how to resume it.
async fn how_left(lab: &Lab, scan_id: i64, args: &Args) -> String {
    let Ok(scan) = lab.store().scan(scan_id).await else {
        return format!("scan {scan_id} was interrupted; committed frames are kept");
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
            "{kept}; to resume it, start `ridged serve{rig} --data {}` and use the page or POST \
            /api/v1/scans/{scan_id}/resume",
            args.data.display()
        ),
        _ => kept,
    }
}

/// Returns the sample of the arguments; adds it if it does not exist.
async fn sample_for(lab: &Lab, args: &Args) -> Result<i64, CliError> {
    let store_error = |e: StoreError| runtime::lab_error(e.into());
    if let Some(id) = args.sample_id {
        let sample = lab.store().sample(i64::from(id)).await;
        return Ok(sample.map_err(store_error)?.id);
    }
    let wanted = match (&args.sample, args.simulated_rig) {
        (Some(name), _) => Some(name.as_str()),
        (None, true) => Some(TRACED_SAMPLE),
        (None, false) => {
            let last = lab.store().last_scanned_sample().await;
            return last.map_err(store_error)?.ok_or_else(|| no_sample(None));
        }
    };
    let found = match wanted {
        Some(name) => lab.store().sample_named(name).await.map_err(store_error)?,
        None => Ok(None),
    };
    if let Some(sample) = found.map_err(|several| ambiguous(&several))? {
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
    let sample = lab.add_sample(&sample).await;
    Ok(sample.map_err(runtime::lab_error)?.id)
}

/// Follows a scan of this process to its end.
///
/// # Errors
/// No result where it pauses, fails, or waits for an operator and the input has ended.
pub async fn follow(
    lab: &Lab,
    scan_id: i64,
    mut after: i64,
    mut people: Option<OperatorPrompt>,
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
                            .map(|p| sure_words(*p, certainty.elapsed_s))
                            .or(sure.take());
                        false
                    }
                    _ => false,
                }
            })
            .await
            .map_err(runtime::lab_error)?;
        if let Some(reason) = paused {
            bar.clear();
            return Err(CliError::no_result(anyhow!(
                "scan {scan_id} is paused and needs attention: {reason}"
            )));
        }
        if scan.state.is_end() || scan.state == ScanState::Interrupted {
            bar.clear();
            if let Some(sure) = sure {
                say(&format_args!("fitted during the scan: {sure}"));
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
                    "the scan waits for the operator ({}), but the input of this command has ended; use `ridged serve` and the page",
                    action.message()
                )));
            }
            lab.order(scan_id, ScanCommand::Done(action))
                .await
                .map_err(runtime::lab_error)?;
        }
    }
}
