//! `ridged demo`: a simulated rig scans a part through the same lab as a real one; prints the fit beside the truth.

use std::io::{IsTerminal, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use serde_json::{Value, json};

use super::CliError;
use super::runtime;
use super::scan::{follow, timing_words, with_times};
use super::serve::listen_error;
use super::simulated::ConstructionArgs;
use crate::api::Access;
use crate::api::server::{self, ListenError, ListenSettings, Sockets};
use crate::daemon::{self, Daemon};
use crate::fit::uncertainty::coverage::other_factor;
use crate::job::{JobId, JobKind, JobState};
use crate::lab::{FIT_NOT_STARTED, Lab, ScanRequest};
use crate::scan::plan::Preset;
use crate::scan::{Event, PlanRequest, ScanState};
use crate::sim::operator::TRACED_SAMPLE;
use crate::sim::rig::{Construction, SimulatedRig, Simulation};
use crate::sim::sample::{SimulatedSample, Truth};
use crate::store::disk::RealDisk;
use crate::units::Angle;

/// A simulated rig on a pseudo-terminal scans a part; the fit is printed beside the truth.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged demo                                    then look at the page; Ctrl-C ends
  ridged demo --once --json --azimuth-offset-deg 7 --tilt-offset-deg 0.4
  ridged demo --once --camera-distance-mm 300 --light-distance-mm 250 --axis-offset-px=-6,4.5")]
pub struct Args {
    /// Exit once the result is printed.
    #[arg(long)]
    pub once: bool,
    /// Port of the page [default: 8787, or a free one if that is taken].
    #[arg(long, value_name = "N")]
    pub port: Option<u16>,
    /// Seed of the noise, the fixed pattern and the mechanics.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// True minus recorded azimuth of the sample, in degrees.
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub azimuth_offset_deg: f64,
    /// True minus recorded tilt of the camera, in degrees.
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    pub tilt_offset_deg: f64,
    /// How the simulated rig is built.
    #[command(flatten)]
    pub construction: ConstructionArgs,
    /// How many times faster than real time the rig runs.
    #[arg(long, value_name = "X", default_value_t = 30.0)]
    pub time_scale: f64,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
    /// Print how much longer the scan took than the ideal motion, settling and exposure of its plan.
    #[arg(long)]
    pub timing: bool,
    /// One JSON object on stdout.
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; Ctrl-C ends it cleanly at any time.
///
/// # Errors
/// Bad input for offsets out of range; no result where scan or fit give none; interrupted where Ctrl-C comes before the
/// result of `--once`.
pub fn run(args: Args) -> Result<(), CliError> {
    runtime::block_on(demo(args))
}

async fn demo(args: Args) -> Result<(), CliError> {
    let (rig, parts) = SimulatedRig::build(Simulation {
        time_scale: args.time_scale,
        seed: args.seed,
        azimuth_offset: Angle::from_deg(args.azimuth_offset_deg),
        tilt_offset: Angle::from_deg(args.tilt_offset_deg),
        construction: args.construction.into(),
    })?;
    let sockets = listen(args.port).await?;
    let (lab, _) = daemon::open_lab(
        &args.data,
        Arc::new(RealDisk),
        Arc::clone(&rig.clock),
        Some(parts),
    )
    .await
    .map_err(CliError::no_result)?;
    rig.add_samples(&lab).await.map_err(runtime::lab_error)?;
    let operator = rig.operate(&lab, true);
    let access = Access::of_folder(&args.data);
    let daemon = Daemon::start(lab, sockets, access).map_err(CliError::no_result)?;
    tracing::info!("page: {}", daemon.url);
    let work = async {
        let shown = show(&daemon, &args).await?;
        print(&shown, &args, &daemon.url)?;
        if args.once {
            Ok(())
        } else {
            super::say(&format_args!(
                "page and HTTP interface on {} until Ctrl-C",
                daemon.url
            ));
            std::future::pending().await
        }
    };
    let outcome = tokio::select! {
        outcome = work => outcome,
        // `--once` is incomplete without its result; otherwise Ctrl-C is the normal end.
        ended = runtime::stop_requested() => match args.once {
            true => ended.and(Err(CliError::Interrupted)),
            false => ended,
        },
    };
    let ended = daemon.end().await;
    operator.abort();
    outcome.and(ended.map_err(runtime::lab_error))
}

async fn listen(port: Option<u16>) -> Result<Sockets, CliError> {
    let on = |port: u16| ListenSettings::loopback(format!("127.0.0.1:{port}"));
    match (server::listen(&on(port.unwrap_or(8787))).await, port) {
        (Err(ListenError::Bind { .. }), None) => server::listen(&on(0)).await.map_err(listen_error),
        (bound, _) => bound.map_err(listen_error),
    }
}

/// Scans, fits and adds the truth.
async fn show(daemon: &Daemon, args: &Args) -> Result<Value, CliError> {
    let started = Instant::now();
    let lab = &daemon.lab;
    let after = lab
        .store()
        .last_event_id()
        .await
        .map_err(|e| runtime::lab_error(e.into()))?;
    let plan = PlanRequest {
        reuse_calibrations: Some(false),
        ..PlanRequest::preset(Preset::Full)
    };
    let sample_id = traced_sample(lab).await?;
    let scan = lab
        .start_scan(&ScanRequest::of(sample_id, plan))
        .await
        .map_err(runtime::lab_error)?;
    let state = follow(lab, scan.id, after, None).await?;
    if state != ScanState::Completed {
        return Err(CliError::no_result(anyhow!("scan {} is {state}", scan.id)));
    }
    let fit = fitted(lab, scan.id, after).await?;
    let Truth {
        theta_r_deg,
        alpha_u,
        alpha_v,
        rho_d,
    } = SimulatedSample::polymer_10().truth();
    // Relative to the turntable, as the fit reports it.
    let (steeper, turned) =
        Construction::from(args.construction).wedge_on(Angle::from_deg(theta_r_deg));
    let truth = json!({
        "theta_r_deg": theta_r_deg + steeper.deg(),
        "alpha_u": alpha_u,
        "alpha_v": alpha_v,
        "rho_d": rho_d,
        "azimuth_offset_deg": args.azimuth_offset_deg + turned.deg(),
        "tilt_offset_deg": args.tilt_offset_deg,
    });
    let shown = json!({
        "truth": truth,
        "left_out": fit["left_out"],
        "fit": fit,
        "scan_id": scan.id,
        "seconds": started.elapsed().as_secs_f64(),
    });
    Ok(with_times(shown, lab.run_end(scan.id)))
}

async fn traced_sample(lab: &Lab) -> Result<i64, CliError> {
    lab.store()
        .newest_sample(Some(TRACED_SAMPLE))
        .await
        .map_err(|e| runtime::lab_error(e.into()))?
        .map(|s| s.id)
        .ok_or_else(|| {
            CliError::bad_input(anyhow!(
                "{} has other parts already; give the demo a folder of its own with --data",
                lab.store().folder().display()
            ))
        })
}

/// Returns the fit that follows a completed scan; `after` is an event before it.
async fn fit_of(lab: &Lab, scan_id: i64, mut after: i64) -> Result<JobId, CliError> {
    const ROWS: u32 = 1000;
    let mut events = lab.events();
    loop {
        let rows = lab.store().events_after(after, ROWS).await;
        let rows = rows.map_err(|e| runtime::lab_error(e.into()))?;
        for row in &rows {
            after = row.id;
            match &row.event {
                Event::Fit {
                    fit_id,
                    scan_id: Some(of),
                    ..
                } if *of == scan_id => return Ok(JobId::new(JobKind::Fit, *fit_id)),
                Event::Alarm {
                    code,
                    message,
                    scan_id: Some(of),
                } if *of == scan_id && code == FIT_NOT_STARTED => {
                    return Err(CliError::no_result(anyhow!("{message}")));
                }
                _ => {}
            }
        }
        if rows.len() < ROWS as usize {
            // Any event is a reason to look.
            let next = tokio::time::timeout(Duration::from_secs(5), events.recv());
            next.await.ok();
        }
    }
}

/// Waits for the report of the fit that follows a completed scan.
async fn fitted(lab: &Lab, scan_id: i64, after: i64) -> Result<Value, CliError> {
    let id = fit_of(lab, scan_id, after).await?;
    let mut events = lab.events();
    loop {
        let fit = lab
            .store()
            .job(id)
            .await
            .map_err(|e| runtime::lab_error(e.into()))?;
        match (&fit.result, fit.state) {
            (Some(report), _) => {
                return serde_json::from_str(report).map_err(CliError::no_result);
            }
            (None, JobState::Running) => {
                // Any event is a reason to look; the store has the complete state.
                let next = tokio::time::timeout(Duration::from_secs(5), events.recv()).await;
                if let Ok(Ok(event)) = next
                    && let Some((job, state)) = event.event.job()
                {
                    tracing::debug!(%job, %state, "{job} is {state}");
                }
            }
            (None, state) => {
                let why = fit
                    .error_detail
                    .as_deref()
                    .unwrap_or("no reason was recorded");
                return Err(CliError::no_result(anyhow!("the fit is {state}: {why}")));
            }
        }
    }
}

fn print(shown: &Value, args: &Args, url: &str) -> Result<(), CliError> {
    let mut out = std::io::stdout().lock();
    let text = match args.json {
        true => format!("{shown:#}\n"),
        false => table(shown, args, url, out.is_terminal()),
    };
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(CliError::no_result)
}

/// The rows of the table: key, name, unit, digits.
const ROWS: [(&str, &str, &str, usize); 6] = [
    ("theta_r_deg", "ridge angle θr", "°", 3),
    ("alpha_u", "roughness along ridges αu", "", 4),
    ("alpha_v", "roughness across ridges αv", "", 4),
    ("rho_d", "diffuse reflectance ρd", "", 4),
    ("azimuth_offset_deg", "azimuth offset", "°", 3),
    ("tilt_offset_deg", "tilt offset", "°", 3),
];

fn table(shown: &Value, args: &Args, url: &str, colour: bool) -> String {
    let paint = |code: &str, text: String| match colour {
        true => format!("\u{1b}[{code}m{text}\u{1b}[0m"),
        false => text,
    };
    let fit = &shown["fit"];
    let mut text = format!(
        "\nscan {}, variant {}, {}: {} observations of {} frames\n\n",
        shown["scan_id"],
        fit["variant"].as_str().unwrap_or("?"),
        fit["status"].as_str().unwrap_or("?"),
        fit["n_observations"],
        fit["n_frames_used"],
    );
    let head = format!(
        "  {:<28}{:>12}{:>26}   {}\n",
        "", "truth", "fit ± U (k = 2)", "inside"
    );
    text.push_str(&paint("1", head));
    for (key, name, unit, digits) in ROWS {
        let truth = shown["truth"][key].as_f64().unwrap_or(f64::NAN);
        let parameter = &fit["parameters"][key];
        let row = match (parameter["value"].as_f64(), parameter["expanded"].as_f64()) {
            (Some(value), Some(expanded)) => {
                let inside = (value - truth).abs() <= expanded;
                let word = match inside {
                    true => paint("32", "yes".into()),
                    false => paint("31", "no".into()),
                };
                let fitted = format!("{value:.digits$}{unit} ± {expanded:.digits$}{unit}");
                let factor = other_factor(parameter["coverage_factor"].as_f64());
                let factor = factor.map_or_else(String::new, |k| format!("  {k}"));
                format!("{fitted:>26}   {word}{factor}")
            }
            _ => format!("{:>26}   -", "not identifiable"),
        };
        let truth = format!("{truth:.digits$}{unit}");
        text.push_str(&format!("  {name:<28}{truth:>12}{row}\n"));
    }
    if args.timing {
        text.push('\n');
        text.push_str(&timing_words(shown));
    }
    if !args.once {
        text.push_str(&format!("\npage: {url}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_shows_whether_the_truth_is_inside() {
        let parameter = |value: f64, expanded: f64| json!({"value": value, "expanded": expanded});
        let shown = json!({
            "truth": {"theta_r_deg": 10.0, "alpha_u": 0.12},
            "fit": {"parameters": {
                "theta_r_deg": parameter(10.05, 0.1),
                "alpha_u": parameter(0.2, 0.01),
                "alpha_v": {"value": null, "expanded": null},
            }},
        });
        let args = Args {
            once: true,
            port: None,
            seed: 1,
            azimuth_offset_deg: 0.0,
            tilt_offset_deg: 0.0,
            construction: ConstructionArgs::default(),
            time_scale: 1.0,
            data: PathBuf::new(),
            timing: false,
            json: false,
        };
        let text = table(&shown, &args, "http://127.0.0.1:1", false);
        let line = |name: &str| text.lines().find(|l| l.contains(name)).unwrap().to_owned();
        assert!(line("ridge angle").contains("10.050° ± 0.100°"), "{text}");
        assert!(line("ridge angle").ends_with("yes"), "{text}");
        assert!(line("along ridges").ends_with("no"), "{text}");
        assert!(line("across ridges").contains("not identifiable"), "{text}");
    }
}
