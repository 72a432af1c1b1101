//! `ridged scan`: one scan, by a running daemon or by this process itself.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use serde_json::{Value, json};

use super::CliError;
use super::client::Client;
use super::daemon;
use super::people::People;
use super::progress::Bar;
use super::simulated::{self, SimulatedRig, Simulation, TRACED_SAMPLE};
use crate::lab::{Lab, LabError, ScanRequest};
use crate::material::{Material, tables};
use crate::scan::plan::Preset;
use crate::scan::runner::{Order, RunEnd};
use crate::scan::{Event, OperatorAction, PlanRequest, ScanState};
use crate::store::samples::NewSample;

/// How often a daemon is asked where its scan stands: a prompt outlives its step by no longer.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// A daemon is asked how sure its fit is once in so many looks at its scan.
const LOOKS_PER_QUESTION: u32 = 16;

/// Runs one scan.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged scan --preset paper --simulated-rig --data /tmp/try
  ridged scan docs/example-plan.toml --config rig.toml --sample \"batch 7\"
If a daemon is running on the data folder, it does the scan.")]
pub struct Args {
    /// Plan (TOML); docs/example-plan.toml shows all keys.
    #[arg(
        value_name = "PLAN.toml",
        required_unless_present = "preset",
        conflicts_with = "preset"
    )]
    pub plan: Option<PathBuf>,
    /// A named plan instead of a file.
    #[arg(long, value_parser = preset, value_name = "paper|full")]
    pub preset: Option<Preset>,
    /// Name of the sample [default: the newest one].
    #[arg(long, value_name = "NAME")]
    pub sample: Option<String>,
    /// Index of refraction; adds the sample if it does not exist yet.
    #[arg(long, value_name = "N", requires = "sample")]
    pub eta: Option<f64>,
    /// Imaginary part of the index, for metals.
    #[arg(long, value_name = "K", requires = "eta")]
    pub k: Option<f64>,
    /// A metal by name (Ag, Al, Au, Cr, Cu, W) instead of its index.
    #[arg(long, value_name = "NAME", requires = "sample", conflicts_with = "eta")]
    pub metal: Option<String>,
    /// Wavelength at which the metal is looked up, in nm.
    #[arg(long, value_name = "NM", default_value_t = 550.0)]
    pub wavelength_nm: f64,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
    /// Settings of the rig (TOML), if no daemon is running.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Scan on a simulated rig, if no daemon is running.
    #[arg(long)]
    pub simulated_rig: bool,
    /// How many times faster than real time the simulated rig runs.
    #[arg(
        long,
        value_name = "X",
        default_value_t = 1.0,
        requires = "simulated_rig"
    )]
    pub time_scale: f64,
    /// Print how much longer the scan took than the ideal motion, settling and exposure of its plan.
    #[arg(long)]
    pub timing: bool,
    /// One JSON object on stdout.
    #[arg(long)]
    pub json: bool,
}

fn preset(word: &str) -> Result<Preset, String> {
    match word {
        "paper" => Ok(Preset::Paper),
        "full" => Ok(Preset::Full),
        other => Err(format!("`{other}` is neither paper nor full")),
    }
}

/// Runs the command.
///
/// # Errors
/// Bad input for a plan that cannot run; no result where the rig refuses or pauses; interrupted on
/// Ctrl-C.
pub fn run(args: Args) -> Result<(), CliError> {
    let plan = read_plan(&args)?;
    let answer = match Client::find(&args.data)? {
        Some(client) => by_daemon(&client, &args, &plan)?,
        None => daemon::block_on(by_itself(&args, plan))?,
    };
    let text = match args.json {
        true => format!("{answer:#}\n"),
        false => format!(
            "scan {} {}\n",
            answer["id"],
            answer["state"].as_str().unwrap_or("")
        ),
    };
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())
        .map_err(CliError::no_result)?;
    if args.timing && !args.json {
        out.write_all(timing_words(&answer).as_bytes())
            .map_err(CliError::no_result)?;
    }
    out.flush().map_err(CliError::no_result)
}

fn read_plan(args: &Args) -> Result<PlanRequest, CliError> {
    let Some(path) = &args.plan else {
        let preset = args.preset.unwrap_or(Preset::Paper);
        return Ok(PlanRequest::preset(preset));
    };
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("the plan {} cannot be read", path.display()))
        .map_err(CliError::BadInput)?;
    PlanRequest::from_toml(&text)
        .map_err(|refused| CliError::bad_input(anyhow!("the plan {}, {refused}", path.display())))
}

/// Time over ideal, in words.
pub fn timing_words(answer: &Value) -> String {
    match (answer["elapsed_s"].as_f64(), answer["ideal_s"].as_f64()) {
        (Some(elapsed), Some(ideal)) if ideal > 0.0 => format!(
            "scan time {elapsed:.1} s, ideal motion + settling + exposure {ideal:.1} s, ratio {:.3}\n",
            elapsed / ideal
        ),
        _ => "scan time over ideal is known where this command runs the scan itself\n".into(),
    }
}

/// Times of a run as JSON.
pub fn with_times(mut answer: Value, end: Option<RunEnd>) -> Value {
    if let Some(end) = end {
        answer["elapsed_s"] = json!(end.elapsed_s);
        answer["ideal_s"] = json!(end.ideal_s);
        answer["time_over_ideal"] = match end.ideal_s > 0.0 {
            true => json!(end.elapsed_s / end.ideal_s),
            false => Value::Null,
        };
    }
    answer
}

async fn by_itself(args: &Args, plan: PlanRequest) -> Result<Value, CliError> {
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
        super::say(&left);
        let stopped = stopped.map_err(|source| LabError::NotStopped { source });
        match (stopped, &outcome) {
            (Ok(()), _) => {
                super::say(&format_args!(
                    "the stages stand; the lamp is as it was: ridged does not switch it"
                ));
            }
            // Nothing is safe then, whatever Ctrl-C usually means.
            (Err(error), Err(CliError::Interrupted)) => return Err(daemon::lab_error(error)),
            (Err(error), _) => super::say(&error),
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

/// The material that the arguments state; the uncertainty of a number is that of a data sheet, one unit in
/// the second decimal.
///
/// # Errors
/// Bad input: a metal that is in no table, or not at that wavelength.
fn material(args: &Args) -> Result<Option<Material>, CliError> {
    const STD: f64 = 0.01;
    if let Some(name) = &args.metal {
        let metal = tables::metal(name, args.wavelength_nm).map_err(CliError::bad_input)?;
        return Ok(Some(metal));
    }
    Ok(args.eta.map(|eta| match args.k {
        None => Material::Dielectric { eta, eta_std: STD },
        Some(k) => Material::Conductor {
            eta,
            k,
            eta_std: STD,
            k_std: STD,
        },
    }))
}

fn no_sample(wanted: Option<&str>) -> CliError {
    CliError::bad_input(match wanted {
        Some(name) => {
            anyhow!("there is no sample `{name}`; add it on the page or by POST /api/v1/samples")
        }
        None => anyhow!(
            "there is no sample yet; add one on the page or by POST /api/v1/samples, then name it with --sample"
        ),
    })
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
                super::say(&format_args!("fitted along with the scan: {sure}"));
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

/// The ridge angle in passing, with its expanded uncertainty (k = 2) and the rig's time.
fn sure_words(value_deg: f64, std_deg: f64, elapsed_s: f64) -> String {
    let expanded = 2.0 * std_deg;
    // Two digits of the uncertainty.
    let digits = (1.0 - expanded.log10().floor()).clamp(0.0, 6.0) as usize;
    let minutes = elapsed_s / 60.0;
    format!("θr {value_deg:.digits$} ± {expanded:.digits$}° at {minutes:.1} min")
}

/// The newest row of what the fit along with a daemon's scan says.
fn newest_words(client: &Client, id: i64) -> Option<String> {
    let rows = client
        .get(&format!("/scans/{id}/uncertainty?limit=1000"))
        .ok()?;
    let row = rows["items"].as_array()?.last()?.clone();
    let theta_r = &row["parameters"]["theta_r_deg"];
    let (value, std) = (theta_r["value"].as_f64()?, theta_r["std"].as_f64()?);
    Some(sure_words(value, std, row["elapsed_s"].as_f64()?))
}

fn by_daemon(client: &Client, args: &Args, plan: &PlanRequest) -> Result<Value, CliError> {
    if args.config.is_some() || args.simulated_rig {
        return Err(CliError::bad_input(anyhow!(
            "a daemon runs on {} ({}): it has its own rig; leave out --config and --simulated-rig, or take another --data",
            args.data.display(),
            client.url
        )));
    }
    let rig = client.get("/rig")?;
    if let Some(problem) = rig["problem"]["detail"].as_str() {
        return Err(CliError::no_result(anyhow!("{problem}")));
    }
    let simulated = rig["simulated"] == true;
    let sample_id = daemons_sample(client, args)?;
    let body = json!({ "sample_id": sample_id, "plan": plan });
    // Before the rig may move.
    let stopped = super::interrupt::flag()?;
    let begun = client.post("/scans", Some(&body))?;
    let id = begun["id"].as_i64().unwrap_or_default();
    let mut people = (!simulated).then(People::at_the_terminal);
    let bar = Bar::new("frames");
    let mut sure: Option<String> = None;
    let mut looks = 0u32;
    // The step that stands on the terminal: Enter is for that one.
    let mut asked: Option<OperatorAction> = None;
    let scan = loop {
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
                bar.say("Somebody else has continued the scan: that step is done.");
            }
        }
        match (state, waits_for, &mut people) {
            (Some(state), ..) if state.is_end() || state == ScanState::Interrupted => break scan,
            (Some(ScanState::Paused), ..) => {
                bar.clear();
                let reason = scan["reason"].as_str().unwrap_or("by somebody");
                return Err(CliError::no_result(anyhow!(
                    "scan {id} is paused: {reason}; resume it on {}",
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
                    // Said too late, it was for a step that is over, and the next look shows what is.
                    Some(true) if !continued(client, id, action)? => {}
                    Some(true) => asked = None,
                    Some(false) => {
                        bar.clear();
                        return Err(CliError::no_result(anyhow!(
                            "scan {id} waits for a person ({}), but nobody is at this terminal; go on with it on {}",
                            action.message(),
                            client.url
                        )));
                    }
                }
            }
            _ => {}
        }
        std::thread::sleep(LOOK_EVERY);
    };
    bar.clear();
    if let Some(sure) = newest_words(client, id) {
        super::say(&format_args!("fitted along with the scan: {sure}"));
    }
    let state = scan["state"].as_str().unwrap_or_default();
    if state != "completed" {
        let why = match scan["reason"].as_str() {
            Some(reason) => format!(" ({reason})"),
            None => String::new(),
        };
        return Err(CliError::no_result(anyhow!(
            "scan {id} is {state}{why}; what it committed is kept"
        )));
    }
    Ok(json!({ "id": id, "scan_id": id, "state": state }))
}

fn state_of(scan: &Value) -> Option<ScanState> {
    scan["state"].as_str().and_then(ScanState::from_word)
}

/// Says that a step is done; false where the scan waits for it no more.
fn continued(client: &Client, id: i64, action: OperatorAction) -> Result<bool, CliError> {
    let done = json!({ "action": action });
    let answer = client.post_in_time(&format!("/scans/{id}/continue"), Some(&done))?;
    Ok(answer.is_some())
}

/// Pauses a daemon's scan, waits until nothing moves for it, and says how it is left.
///
/// # Errors
/// No result where that cannot be known: the stages may be moving.
fn paused(client: &Client, id: i64) -> Result<(), CliError> {
    /// Longer than most points take.
    const PATIENCE: Duration = Duration::from_secs(60);
    let unsure = |why: String| {
        CliError::no_result(anyhow!(
            "scan {id} was to pause, but {why}; it may be moving the stages: `ridged rig stop` stops them, or look at {}",
            client.url
        ))
    };
    let lost = |error: CliError| match error {
        CliError::BadInput(why) | CliError::NoResult(why) => unsure(why.to_string()),
        CliError::Interrupted => CliError::Interrupted,
    };
    let begun = Instant::now();
    let mut told = false;
    loop {
        let scan = client.get(&format!("/scans/{id}")).map_err(lost)?;
        let state = state_of(&scan);
        match state {
            Some(ScanState::Paused) => {
                super::say(&format_args!(
                    "scan {id} is paused, {} of {} frames are kept; resume or abort it on {}",
                    scan["progress"]["frames_done"], scan["progress"]["frames_total"], client.url
                ));
                return Ok(());
            }
            Some(state) if state.is_end() || state == ScanState::Interrupted => {
                super::say(&format_args!(
                    "scan {id} is {state}; what it committed is kept"
                ));
                return Ok(());
            }
            _ if begun.elapsed() > PATIENCE => {
                return Err(unsure(format!(
                    "it is {} after {} s",
                    scan["state"].as_str().unwrap_or("in no known state"),
                    PATIENCE.as_secs()
                )));
            }
            _ => {}
        }
        // Somebody who is waited for has no point under way.
        if !told && state != Some(ScanState::WaitingForOperator) {
            super::say(&format_args!(
                "scan {id} pauses after this point (Ctrl-C again leaves at once)"
            ));
            told = true;
        }
        if matches!(
            state,
            Some(ScanState::Running | ScanState::WaitingForOperator)
        ) {
            // Not allowed any more only if it has come to another state meanwhile.
            client
                .post_in_time(&format!("/scans/{id}/pause"), None)
                .map_err(lost)?;
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

fn daemons_sample(client: &Client, args: &Args) -> Result<i64, CliError> {
    let wanted = args.sample.as_deref();
    let query: Vec<_> = wanted.map(|name| ("name", name)).into_iter().collect();
    let samples = client.search("/samples", &query)?;
    if let Some(id) = samples["items"][0]["id"].as_i64() {
        return Ok(id);
    }
    let Some(material) = material(args)? else {
        return Err(no_sample(wanted));
    };
    let body = json!({ "name": wanted.unwrap_or("sample"), "material": material });
    let added = client.post("/samples", Some(&body))?;
    Ok(added["id"].as_i64().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ridge_angle_in_passing_has_two_digits_of_its_uncertainty() {
        assert_eq!(
            sure_words(10.0312, 0.041, 330.0),
            "θr 10.031 ± 0.082° at 5.5 min"
        );
        assert_eq!(sure_words(10.0312, 6.0, 60.0), "θr 10 ± 12° at 1.0 min");
    }
}
