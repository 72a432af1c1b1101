//! What all commands that run a lab have in common: settings, rig, server, signals, a clean end.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow};
use metrics_exporter_prometheus::PrometheusBuilder;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::CliError;
use super::interrupt::asked_to_stop;
use crate::api::{self, RenderMetrics, server};
use crate::bench::stage::NoFaults;
use crate::bench::watched_folder::{WatchedFolder, WatchedFolderSettings};
use crate::clock::{Clock, SystemClock, WallWatch};
use crate::config::{Config, ConfigError};
use crate::lab::{Lab, LabError, RigParts, RigSettings, StoredSeries};
use crate::scan::runner::RunnerSettings;
use crate::scan::visit::{CappedLimit, FrameRules, LookedAt};
use crate::scan::{Event, OperatorAction, Rig, StageLink};
use crate::series::CameraFacts;
use crate::store::disk::RealDisk;
use crate::store::{Store, StoreError};

/// Reads the settings of `--config` and of the environment.
///
/// # Errors
/// Bad input, naming file, line and key.
pub fn read_config(file: Option<&Path>) -> Result<Config, CliError> {
    let environment = std::env::vars_os()
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
    Config::read(file, environment).map_err(|error: ConfigError| CliError::bad_input(error))
}

/// How a scan deals with trouble, for a camera.
#[must_use]
pub fn runner_settings(
    camera: &CameraFacts,
    attempts_max: u32,
    reserve_mb: u64,
    capped: CappedLimit,
) -> RunnerSettings {
    let pixels = u64::from(camera.width_px) * u64::from(camera.height_px);
    RunnerSettings {
        attempts_max,
        disk_reserve_bytes: reserve_mb * 1_000_000,
        // Noise does not compress: two bytes a pixel, and PNG's own few.
        frame_bytes_max: pixels * 2 + pixels / 64 + 4096,
        frame: FrameRules {
            size_px: (camera.width_px, camera.height_px),
            black_level_dn: camera.black_level_dn.unwrap_or(0.0),
            read_noise_dn: camera.read_noise_electrons_rms.unwrap_or(2.0)
                * camera.gain_dn_per_electron,
            dark_sigmas: 10.0,
            saturation_dn: camera.full_count(),
            looked_at: LookedAt::default(),
            capped,
        },
    }
}

/// What the settings allow a frame under the cap.
#[must_use]
pub fn capped_limit(config: &Config) -> CappedLimit {
    let camera = &config.camera;
    CappedLimit {
        mean_dn_max: config.scan.capped_mean_dn_max,
        dark_dn_per_s: camera.dark_current_electrons_per_s * camera.gain_dn_per_electron,
    }
}

/// The real rig of the settings; `None` if they name none.
///
/// # Errors
/// Bad input for a port without a camera.
pub fn real_rig(config: &Config, clock: &Arc<dyn Clock>) -> Result<Option<RigParts>, CliError> {
    let Some(port) = config.port.clone() else {
        return Ok(None);
    };
    let stage = config
        .stage
        .clone()
        .expect("checked settings have a stage beside a port");
    let Some(folder) = config.camera.folder.clone() else {
        return Err(CliError::bad_input(anyhow!(
            "the settings name a port but no camera: set camera.folder to the folder into which the \
             camera's program writes frames (ridged.example.toml shows how)"
        )));
    };
    let camera = WatchedFolder::new(
        WatchedFolderSettings {
            folder,
            command: config.camera.command.clone(),
            timeout_s: config.camera.timeout_s,
            delete_read_frames: config.camera.delete_read_frames,
        },
        Arc::clone(clock),
    )
    .map_err(CliError::bad_input)?;
    let camera_facts = config.camera_facts();
    let scan = &config.scan;
    let hours = |h: f64| Duration::from_secs_f64(h * 3600.0);
    let settings = RigSettings {
        rig: config.rig_facts(),
        flat: config.flat_facts(),
        defaults: config.plan_defaults(),
        runner: runner_settings(
            &camera_facts,
            scan.attempts_max,
            config.store.reserve_mb,
            capped_limit(config),
        ),
        camera: camera_facts,
        dark_valid: hours(config.dark.valid_h),
        flat_valid: hours(config.flat.valid_h),
        simulated: None,
        label: String::new(),
    };
    let link = StageLink {
        port,
        settings: stage,
        clock: Arc::clone(clock),
        seam: Arc::new(NoFaults),
    };
    Ok(Some(RigParts {
        rig: Rig::new(link, Box::new(camera)),
        settings,
    }))
}

/// A clock for a daemon without a simulated rig.
#[must_use]
pub fn real_clock() -> Arc<dyn Clock> {
    Arc::new(SystemClock::new())
}

/// Opens the lab and tells what a kill had left behind.
///
/// # Errors
/// No result if the folder is in use, damaged or cannot be written.
pub async fn open_lab(
    folder: &Path,
    clock: Arc<dyn Clock>,
    parts: Option<RigParts>,
) -> Result<Lab, CliError> {
    let (lab, recovery) = Lab::open(folder, Arc::new(RealDisk), clock, parts)
        .await
        .map_err(CliError::no_result)?;
    for scan in &recovery.interrupted_scans {
        tracing::warn!(
            scan,
            "scan {scan} was under way when the daemon ended; resume it to go on"
        );
    }
    if !recovery.restored.is_empty() {
        tracing::warn!(
            files = recovery.restored.len(),
            "{} frame files that rows name came back from {}",
            recovery.restored.len(),
            folder.join("quarantine").display()
        );
    }
    if !recovery.quarantined.is_empty() {
        tracing::warn!(
            files = recovery.quarantined.len(),
            "{} half or unnamed frame files were moved to {}",
            recovery.quarantined.len(),
            folder.join("quarantine").display()
        );
    }
    Ok(lab)
}

/// Maps what the lab refuses to an exit code: bad input 2, everything else 1.
pub fn lab_error(error: LabError) -> CliError {
    match &error {
        LabError::Plan(_)
        | LabError::Invalid { .. }
        | LabError::Series(_)
        | LabError::Frame { .. }
        | LabError::Export(_)
        | LabError::NoRig
        | LabError::Store(
            StoreError::NotFound { .. }
            | StoreError::Missing { .. }
            | StoreError::FolderName { .. },
        ) => CliError::bad_input(error),
        LabError::BrokenOff => CliError::Interrupted,
        _ => CliError::no_result(error),
    }
}

/// Steps at which scans wait for a person, as they come.
pub fn watch_scan_steps(lab: &Lab) -> mpsc::Receiver<(i64, OperatorAction)> {
    let (sender, receiver) = mpsc::channel(16);
    let mut events = lab.events();
    tokio::spawn(async move {
        loop {
            match events.recv().await {
                Ok(event) => {
                    if let Event::Scan {
                        scan_id,
                        operator: Some(action),
                        ..
                    } = event.event
                        && sender.send((scan_id, action)).await.is_err()
                    {
                        return;
                    }
                }
                Err(tokio::sync::broadcast::error::RecvError::Lagged(_)) => {}
                Err(tokio::sync::broadcast::error::RecvError::Closed) => return,
            }
        }
    });
    receiver
}

/// A daemon that answers HTTP.
pub struct Daemon {
    /// What it answers for.
    pub lab: Lab,
    /// Where it answers: `http://ADDRESS`.
    pub url: String,
    ending: CancellationToken,
    server: tokio::task::JoinHandle<std::io::Result<()>>,
    notice: PathBuf,
}

/// File in the data folder that tells commands where the daemon answers.
pub const NOTICE_FILE: &str = "daemon.json";

impl Daemon {
    /// Puts a lab on a listener and leaves a notice of it in the data folder.
    ///
    /// # Errors
    /// No result if the notice cannot be written.
    pub fn start(lab: Lab, listener: tokio::net::TcpListener) -> Result<Daemon, CliError> {
        let address = listener.local_addr().map_err(CliError::no_result)?;
        let url = format!("http://{address}");
        let ending = CancellationToken::new();
        let router = api::router(lab.clone(), metrics(), ending.clone());
        tokio::spawn(watch_the_time_of_day(ending.clone()));
        let end = ending.clone();
        let server = tokio::spawn(server::serve(listener, router, async move {
            end.cancelled().await;
        }));
        let notice = lab.store().folder().join(NOTICE_FILE);
        let text = serde_json::json!({ "url": url, "process": std::process::id() });
        std::fs::write(&notice, format!("{text}\n"))
            .with_context(|| format!("cannot write {}", notice.display()))
            .map_err(CliError::NoResult)?;
        Ok(Daemon {
            lab,
            url,
            ending,
            server,
            notice,
        })
    }

    /// Ends it: rig first, then connections, then the store.
    pub async fn end(self) {
        /// A client that does not read its answer must not hold the daemon.
        const DRAIN: Duration = Duration::from_secs(3);
        std::fs::remove_file(&self.notice).ok();
        // Stages that could not be stopped are in the log.
        self.lab.rest().await.ok();
        self.ending.cancel();
        let abort = self.server.abort_handle();
        if tokio::time::timeout(DRAIN, self.server).await.is_err() {
            abort.abort();
        }
        self.lab.store().close().await;
    }
}

/// Tells when the time of day steps: everything here waits by the time that passes, but frames are dated by it, and
/// calibrations grow old by it.
async fn watch_the_time_of_day(ending: CancellationToken) {
    const LOOK_EVERY: Duration = Duration::from_secs(10);
    let clock = SystemClock::new();
    let mut watch = WallWatch::default();
    while !ending.is_cancelled() {
        if let Some(step) = watch.step(clock.now(), clock.wall()) {
            let step_s = step.as_seconds_f64();
            tracing::warn!(
                step_s,
                "the time of day went {step_s:+.1} s besides the time that passed (set, or the machine slept); \
                 frames are dated by it and calibrations grow old by it"
            );
        }
        tokio::select! {
            () = ending.cancelled() => {}
            () = tokio::time::sleep(LOOK_EVERY) => {}
        }
    }
}

/// Completes on Ctrl-C, SIGTERM or SIGHUP.
///
/// # Errors
/// No result if the system refuses a signal handler.
pub async fn told_to_end() -> Result<(), CliError> {
    asked_to_stop().await.map_err(CliError::no_result)
}

fn metrics() -> RenderMetrics {
    // A second daemon in one process (a test) goes without.
    match PrometheusBuilder::new().install_recorder() {
        Ok(handle) => Arc::new(move || {
            handle.run_upkeep();
            handle.render()
        }),
        Err(_) => Arc::new(String::new),
    }
}

/// A scan of the store as frames to reduce, also beside a running daemon.
///
/// # Errors
/// Bad input for a folder without a store or an unknown scan.
pub fn stored_series(folder: &Path, scan_id: i64) -> Result<StoredSeries, CliError> {
    block_on(async {
        let store = Store::open_for_reading(folder, Arc::new(RealDisk), real_clock())
            .await
            .map_err(|error| lab_error(error.into()))?;
        let series = StoredSeries::open(&store, scan_id).await.map_err(lab_error);
        // Frames are files: the database has said all it has to say.
        store.close().await;
        series
    })
}

/// Runs a command's future on a runtime of its own.
///
/// # Errors
/// What the command says, or that the system gives no threads.
pub fn block_on<T>(work: impl Future<Output = Result<T, CliError>>) -> Result<T, CliError> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(CliError::no_result)?
        .block_on(work)
}
