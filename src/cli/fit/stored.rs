//! A fit that is kept in the store: by the daemon that runs on the folder, otherwise in this process. `report`, `compare`,
//! `repeatability` and `results` read it.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Map, Value, json};

use super::Args;
use crate::cli::client::Client;
use crate::cli::progress::Bar;
use crate::cli::{CliError, output, runtime, say};
use crate::daemon;
use crate::fit::FitReport;
use crate::fit::constraints::stated;
use crate::fit::report::text;
use crate::heights;
use crate::job::{JobId, JobKind, JobState};
use crate::lab::{FitRequest, Lab};
use crate::store::disk::RealDisk;

/// Interval between looks at the state of the fit.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// A fit that has ended.
struct Ended {
    id: i64,
    state: String,
    /// The report, or none where it has no result.
    result: Option<Value>,
    error: Option<String>,
}

/// Fits the scan, stores the fit and prints it.
///
/// # Errors
/// Bad input for a request that the daemon or the lab refuses; no result where the fit fails; interrupted on Ctrl-C, after
/// which the fit is cancelled.
pub(super) fn run(args: &Args, scan_id: i64, cancel: &AtomicBool) -> Result<(), CliError> {
    let body = body(args, scan_id)?;
    let ended = match Client::of(&args.data, &args.connection)? {
        Some(client) => by_daemon(&client, &body, cancel)?,
        None => runtime::block_on(by_itself(&args.data, body, cancel))?,
    };
    let result = match (ended.result, ended.state.as_str()) {
        (Some(result), _) => result,
        (None, "cancelled" | "interrupted") => return Err(CliError::Interrupted),
        (None, state) => {
            let why = ended.error.unwrap_or_else(|| format!("it is {state}"));
            return Err(CliError::no_result(anyhow!("fit {}: {why}", ended.id)));
        }
    };
    let report: FitReport = serde_json::from_value(result).map_err(CliError::no_result)?;
    let mut shown = json!({ "id": ended.id, "scan_id": scan_id });
    if let (Some(shown), Value::Object(fields)) = (shown.as_object_mut(), json!(report)) {
        shown.extend(fields);
    }
    output::write(args.printed.json, &shown, || {
        text::table(&report, &output::form(args.printed.brief))
    })?;
    say(&format_args!(
        "stored as fit {} of scan {scan_id}",
        ended.id
    ));
    Ok(())
}

/// The request of `POST /fits`.
fn body(args: &Args, scan_id: i64) -> Result<Value, CliError> {
    let mut body = json!({
        "scan_id": scan_id,
        "variant": args.variant.choice(),
        "judge": args.judge,
        "iterations": args.iterations,
        "profile": args.profile,
        "loss": args.loss.loss(),
    });
    let optional = [
        ("region", json!(args.region)),
        ("max_seconds", json!(args.limits.max_seconds)),
        ("target_error", json!(args.limits.target_error)),
        ("tolerance", json!(args.limits.tolerance)),
        ("starts", json!(args.starts)),
        ("bootstrap", json!(args.bootstrap)),
    ];
    for (name, value) in optional {
        if !value.is_null() {
            body[name] = value;
        }
    }
    let mut fixed = Map::new();
    for constraint in &args.fix {
        let (name, value, _) = stated(constraint);
        fixed.insert(name.to_owned(), json!(value));
    }
    body["fix"] = Value::Object(fixed);
    let mut priors = Map::new();
    for constraint in &args.prior {
        let (name, value, std) = stated(constraint);
        priors.insert(name.to_owned(), json!({ "value": value, "std": std }));
    }
    body["priors"] = Value::Object(priors);
    if let Some(path) = &args.shape {
        let content = heights::bytes_of(path)
            .map_err(anyhow::Error::msg)
            .with_context(|| format!("cannot read {}", path.display()))
            .map_err(CliError::bad_input)?;
        body["shape"] = json!({
            "name": path.file_name().unwrap_or_default().to_string_lossy(),
            "content": STANDARD.encode(content),
            "pitch_um": match args.pitch_um[..] {
                [] => Value::Null,
                [one] => json!(one),
                ref each => json!(each),
            },
            "height_unit_um": args.height_unit_um,
        });
    }
    Ok(body)
}

/// The end of a fit, or nothing while it runs.
fn by_daemon(client: &Client, body: &Value, cancel: &AtomicBool) -> Result<Ended, CliError> {
    let begun = client.post("/fits", Some(body))?;
    let id = begun["id"].as_i64().unwrap_or_default();
    let bar = Bar::new("%");
    let mut is_cancelled = false;
    loop {
        let fit = client.get(&format!("/fits/{id}"))?;
        let state = fit["state"].as_str().unwrap_or_default().to_owned();
        if state != JobState::Running.as_str() {
            bar.clear();
            let has_result = state == JobState::Completed.as_str();
            return Ok(Ended {
                id,
                state,
                error: fit["error"]["detail"].as_str().map(str::to_owned),
                result: has_result.then_some(fit),
            });
        }
        let progress = &fit["progress"];
        let fraction = progress["fraction"].as_f64().unwrap_or(0.0);
        let stage = progress["stage"].as_str().unwrap_or("fitting");
        bar.show((100.0 * fraction) as u64, 100, stage);
        if cancel.load(Ordering::Relaxed) && !is_cancelled {
            client.post_in_time(&format!("/fits/{id}/cancel"), None)?;
            is_cancelled = true;
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

async fn by_itself(folder: &Path, body: Value, cancel: &AtomicBool) -> Result<Ended, CliError> {
    let request: FitRequest = serde_json::from_value(body).map_err(CliError::bad_input)?;
    // A wrong folder does not become an empty store.
    drop(runtime::stored_series_of(folder, request.scan_id).await?);
    let (lab, _) = daemon::open_lab(folder, Arc::new(RealDisk), runtime::real_clock(), None)
        .await
        .map_err(CliError::no_result)?;
    let ended = fitted(&lab, request, cancel).await;
    lab.shut_down().await;
    ended
}

async fn fitted(lab: &Lab, request: FitRequest, cancel: &AtomicBool) -> Result<Ended, CliError> {
    let id = lab.start_job(request).await.map_err(runtime::lab_error)?;
    ended(lab, id, cancel).await
}

/// Waits for the end of a fit of this process, with a bar on a terminal.
async fn ended(lab: &Lab, id: JobId, cancel: &AtomicBool) -> Result<Ended, CliError> {
    debug_assert_eq!(id.kind, JobKind::Fit);
    let bar = Bar::new("%");
    loop {
        let job = lab.store().job(id).await;
        let job = job.map_err(|e| runtime::lab_error(e.into()))?;
        if job.state != JobState::Running {
            bar.clear();
            let result = job.result.as_deref().map(serde_json::from_str);
            return Ok(Ended {
                id: id.number,
                state: job.state.as_str().to_owned(),
                result: result.transpose().map_err(CliError::no_result)?,
                error: job.error_detail,
            });
        }
        if let (Some(progress), _) = lab.job_progress(id) {
            bar.show((100.0 * progress.fraction) as u64, 100, progress.stage);
        }
        if cancel.load(Ordering::Relaxed) {
            // A fit that has just ended is not cancelled any more.
            lab.cancel_job(id).await.ok();
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
}
