//! The daemon as a process: a lab, the HTTP server in front of it, and the notice by which commands find it.

use std::fs::OpenOptions;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use metrics_exporter_prometheus::PrometheusBuilder;
use tokio_util::sync::CancellationToken;

use crate::access::Secret;
use crate::api::{self, Access, RenderMetrics, server};
use crate::clock::{Clock, SystemClock, WallWatch};
use crate::config::HooksSection;
use crate::lab::{Hooks, Lab, LabError, RigParts};
use crate::scan::RecordedEvent;
use crate::store::StoreError;
use crate::store::disk::Disk;

/// Opens the lab and logs what an earlier process left behind. Also returns the events of that, for hooks.
///
/// # Errors
/// What the store reports: the folder is in use, damaged or cannot be written.
pub async fn open_lab(
    folder: &Path,
    disk: Arc<dyn Disk>,
    clock: Arc<dyn Clock>,
    parts: Option<RigParts>,
) -> Result<(Lab, Vec<RecordedEvent>), StoreError> {
    let (lab, recovery) = Lab::open(folder, disk, clock, parts).await?;
    for scan in &recovery.interrupted_scans {
        tracing::warn!(
            scan,
            "scan {scan} was interrupted when the daemon ended; it can be resumed"
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
    Ok((lab, recovery.events))
}

/// A lab that answers HTTP.
pub struct Daemon {
    /// The lab behind it.
    pub lab: Lab,
    /// Its address: `http://ADDRESS`.
    pub url: String,
    /// Its address for programs on this machine.
    local_url: String,
    ending: CancellationToken,
    server: tokio::task::JoinHandle<std::io::Result<()>>,
    notice: PathBuf,
    hooks: Option<Hooks>,
    secret: PathBuf,
}

/// File in the data folder with the daemon's address, for commands.
pub const NOTICE_FILE: &str = "daemon.json";
/// File in the data folder with the secret of the running daemon. Only its user can read it, so commands of this user need no
/// token.
pub const SECRET_FILE: &str = "daemon.secret";

impl Daemon {
    /// Serves a lab to those who have access, and writes its address and its secret into the data folder.
    ///
    /// # Errors
    /// What the system reports where these files cannot be written.
    pub fn start(lab: Lab, sockets: server::Sockets, access: Access) -> std::io::Result<Daemon> {
        let (url, local_url) = (sockets.url()?, sockets.local_url()?);
        let owner = Secret::random()?;
        let access = access.with_owner(owner.fingerprint());
        let ending = CancellationToken::new();
        let router = api::router(lab.clone(), metrics(), ending.clone(), access);
        let folder = lab.store().folder();
        let (notice, secret) = (folder.join(NOTICE_FILE), folder.join(SECRET_FILE));
        let unwritten = |file: &Path, error: std::io::Error| {
            let message = format!("cannot write {}: {error}", file.display());
            std::io::Error::new(error.kind(), message)
        };
        // Before the notice: a command that finds the notice finds the secret.
        write_secret(&secret, &owner).map_err(|error| unwritten(&secret, error))?;
        let text = serde_json::json!({ "url": local_url, "process": std::process::id() });
        std::fs::write(&notice, format!("{text}\n")).map_err(|error| unwritten(&notice, error))?;
        tokio::spawn(watch_the_time_of_day(ending.clone()));
        tokio::spawn(watch_the_folder(lab.clone(), ending.clone()));
        let end = ending.clone();
        let server = tokio::spawn(server::serve(sockets, router, async move {
            end.cancelled().await;
        }));
        Ok(Daemon {
            lab,
            url,
            local_url,
            ending,
            server,
            notice,
            hooks: None,
            secret,
        })
    }

    /// Runs the hooks of the settings until the daemon ends. `earlier` are events of the start.
    pub fn run_hooks(&mut self, settings: &HooksSection, earlier: Vec<RecordedEvent>) {
        // Hooks run on this machine, where they need no certificate.
        let url = Some(self.local_url.clone());
        self.hooks = Some(Hooks::start(&self.lab, settings, url, earlier));
    }

    /// Ends the daemon: rig first, then connections, then the store.
    ///
    /// # Errors
    /// [`LabError::NotStopped`]: the stages could not be reached and may be moving; everything else is done.
    pub async fn end(self) -> Result<(), LabError> {
        /// Time for open answers; a client that does not read its answer must not hold the daemon.
        const DRAIN: Duration = Duration::from_secs(3);
        std::fs::remove_file(&self.notice).ok();
        std::fs::remove_file(&self.secret).ok();
        let stopped = self.lab.rest().await;
        if let Some(hooks) = self.hooks {
            hooks.finish().await;
        }
        self.ending.cancel();
        let abort = self.server.abort_handle();
        if tokio::time::timeout(DRAIN, self.server).await.is_err() {
            abort.abort();
        }
        self.lab.store().close().await;
        stopped.map_err(|source| LabError::NotStopped { source })
    }
}

/// Writes the secret of the daemon into a file that only its user can read. The file of a killed daemon is replaced, so that it
/// has the right mode and owner.
fn write_secret(file: &Path, secret: &Secret) -> std::io::Result<()> {
    std::fs::remove_file(file).ok();
    let mut file = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(file)?;
    writeln!(file, "{}", secret.reveal())
}

/// Warns when the wall clock steps. Waits follow the monotonic clock, but the wall clock dates frames and ages
/// calibrations.
async fn watch_the_time_of_day(ending: CancellationToken) {
    const LOOK_EVERY: Duration = Duration::from_secs(10);
    let clock = SystemClock::new();
    let mut watch = WallWatch::default();
    while !ending.is_cancelled() {
        if let Some(step) = watch.step(clock.now(), clock.utc()) {
            let step_s = step.as_seconds_f64();
            tracing::warn!(
                step_s,
                "the wall clock jumped by {step_s:+.1} s (it was set, or the machine slept); it dates frames and ages \
                 calibrations"
            );
        }
        tokio::select! {
            () = ending.cancelled() => {}
            () = tokio::time::sleep(LOOK_EVERY) => {}
        }
    }
}

/// Raises the alarm when the data folder is deleted, unmounted or replaced, also while nothing is written.
async fn watch_the_folder(lab: Lab, ending: CancellationToken) {
    const LOOK_EVERY: Duration = Duration::from_secs(5);
    while !ending.is_cancelled() {
        // The alarm says it.
        lab.check_folder().await.ok();
        tokio::select! {
            () = ending.cancelled() => {}
            () = tokio::time::sleep(LOOK_EVERY) => {}
        }
    }
}

fn metrics() -> RenderMetrics {
    // Only the first daemon of a process records; a test may start a second one.
    match PrometheusBuilder::new().install_recorder() {
        Ok(handle) => Arc::new(move || {
            handle.run_upkeep();
            handle.render()
        }),
        Err(_) => Arc::new(String::new),
    }
}
