//! `ridged serve`: the daemon.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::sync::Arc;

use anyhow::Context as _;

use super::CliError;
use super::interrupt;
use super::runtime;
use super::simulated::{ConstructionArgs, FaultArgs};
use super::supervision;
use crate::access::TokenFile;
use crate::api::Access;
use crate::api::server::{self, ListenError, ListenSettings, TlsFiles};
use crate::config::{Config, ServerSection};
use crate::daemon::{self, Daemon};
use crate::lab::assembly::real_rig;
use crate::sim::faults::disk::FaultyDisk;
use crate::sim::rig::{SimulatedRig, Simulation};
use crate::store::disk::{Disk, RealDisk};

/// Runs the daemon: page, HTTP interface, rig.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged serve --simulated-rig                 a simulated rig to play with
  ridged serve --config rig.toml               a real one (copy ridged.example.toml)
  ridged serve --config rig.toml --listen 0.0.0.0:8787 --tls-cert cert.pem --tls-key key.pem
When it is ready it prints one line: listening on http://127.0.0.1:8787")]
pub struct Args {
    /// Settings of the rig (TOML).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Address to listen on; port 0 picks a free one [default: 127.0.0.1:8787]. One that other machines can reach needs a token
    /// (`ridged token create`), and --tls-cert or --behind-proxy.
    #[arg(long, value_name = "ADDR")]
    pub listen: Option<String>,
    /// Certificate for TLS with those that signed it (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the certificate (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Answer only a proxy on this machine, which has TLS and sets X-Forwarded-For and X-Forwarded-Proto.
    #[arg(long)]
    pub behind_proxy: bool,
    /// Data folder [default: ridged-data].
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Drive a simulated rig instead of the configured one; limits, forbidden regions and all other settings still apply.
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
    /// Seed of the simulated rig.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        requires = "simulated_rig"
    )]
    pub seed: u64,
    /// How the simulated rig is built.
    #[command(flatten)]
    pub construction: ConstructionArgs,
    /// What goes wrong with it.
    #[command(flatten)]
    pub faults: FaultArgs,
}

/// Runs until Ctrl-C, SIGTERM or SIGHUP.
///
/// # Errors
/// Bad input for settings or an address that cannot be used; no result if address or data folder are in use.
pub fn run(args: Args) -> Result<(), CliError> {
    runtime::block_on(serve(args))
}

async fn serve(args: Args) -> Result<(), CliError> {
    let faults = args.faults.read()?;
    let of_simulation = args.construction != ConstructionArgs::default() || faults.is_some();
    if !args.simulated_rig && of_simulation {
        return Err(CliError::bad_input(anyhow::anyhow!(
            "options of the simulated rig need --simulated-rig; describe a real rig in [rig] of the settings"
        )));
    }
    let config = runtime::read_config(args.config.as_deref())?;
    let folder = args
        .data
        .clone()
        .unwrap_or_else(|| config.store.folder.clone());
    let settings = listen_settings(&args, &config.server, &folder)?;
    let sockets = server::listen(&settings).await.map_err(listen_error)?;
    let mut disk: Arc<dyn Disk> = Arc::new(RealDisk);
    let (simulator, parts, clock) = if args.simulated_rig {
        let (rig, parts) = SimulatedRig::build(Simulation {
            time_scale: args.time_scale,
            seed: args.seed,
            construction: args.construction.into(),
            ..Simulation::default()
        })?;
        let mut parts = parts.simulating(&config);
        if let Some((text, seed)) = faults {
            let (faulty, plan) = rig.with_faults(parts, text, seed);
            parts = faulty;
            disk = Arc::new(FaultyDisk::new(disk, plan));
        }
        let clock = Arc::clone(&rig.clock);
        (Some(rig), Some(parts), clock)
    } else {
        let clock = runtime::real_clock();
        let parts = real_rig(&config, &clock).map_err(CliError::bad_input)?;
        if parts.is_none() {
            tracing::warn!(
                "no rig: the settings name no port; stored scans can be viewed and fitted \
                (--config FILE for a rig, --simulated-rig to try one)"
            );
        }
        (None, parts, clock)
    };
    let (lab, earlier) = daemon::open_lab(&folder, disk, clock, parts)
        .await
        .map_err(CliError::no_result)?;
    lab.keep_free(config.store.reserve_bytes());
    lab.set_due(config.due.clone());
    let operator = match &simulator {
        None => None,
        Some(rig) => {
            rig.add_samples(&lab).await.map_err(runtime::lab_error)?;
            Some(rig.operate(&lab, false))
        }
    };
    // Before the line with the address, since a reader of it may send the signal at once.
    let end_signal = interrupt::signals().map_err(CliError::no_result)?;
    let access = access(&config, &folder);
    let mut daemon = Daemon::start(lab, sockets, access).map_err(CliError::no_result)?;
    daemon.run_hooks(&config.hooks, earlier);
    let ready = writeln!(std::io::stdout(), "listening on {}", daemon.url)
        .and_then(|()| std::io::stdout().flush())
        .context("standard output is closed");
    ready.map_err(CliError::no_result)?;
    supervision::ready();
    supervision::report_life(&daemon.lab);
    // Connect now, so that faults of the port are reported before the first scan.
    let lab = daemon.lab.clone();
    let connecting = tokio::spawn(async move {
        if let Ok(view) = lab.rig().await
            && let Some((code, detail)) = view.problem
        {
            tracing::error!(code, "{detail}");
        }
    });
    end_signal.await;
    tracing::info!("stopping: rig first, then connections, then the store");
    connecting.abort();
    supervision::stopping();
    // The axes may be on their way to their park position; a second signal stops them.
    let lab = daemon.lab.clone();
    let again = interrupt::signals().map_err(CliError::no_result)?;
    let mut ending = pin!(daemon.end());
    let ended = tokio::select! {
        ended = &mut ending => ended,
        () = again => {
            // The end reports stages that cannot be stopped.
            lab.stop().await.ok();
            ending.await
        }
    };
    if let Some(operator) = operator {
        operator.abort();
    }
    ended.map_err(runtime::lab_error)
}

/// Returns where to listen. An option replaces its setting.
fn listen_settings(
    args: &Args,
    server: &ServerSection,
    folder: &Path,
) -> Result<ListenSettings, CliError> {
    let file = |option: &Option<PathBuf>, setting: &Option<PathBuf>| {
        option.clone().or_else(|| setting.clone())
    };
    let certificate = file(&args.tls_cert, &server.tls_cert);
    let key = file(&args.tls_key, &server.tls_key);
    let tokens = TokenFile::of_folder(folder).count_valid();
    Ok(ListenSettings {
        address: args.listen.clone().unwrap_or_else(|| server.listen.clone()),
        tls: certificate
            .zip(key)
            .map(|(certificate, key)| TlsFiles { certificate, key }),
        behind_proxy: args.behind_proxy || server.behind_proxy,
        tokens: tokens.map_err(CliError::bad_input)?,
        data_option: format!(" --data {}", folder.display()),
    })
}

/// Returns who has access by the settings.
fn access(config: &Config, folder: &Path) -> Access {
    let server = &config.server;
    let by_default = || std::env::home_dir().into_iter().chain([folder.to_owned()]);
    let roots = config.import.roots.clone();
    let access = Access::of_folder(folder)
        .with_import_roots(roots.unwrap_or_else(|| by_default().collect()))
        .with_tokens_on_loopback(server.token_on_loopback)
        .with_proxies(server.proxies.clone());
    match &server.hosts {
        Some(hosts) => access.with_hosts(hosts.clone()),
        None => access.with_name_of_machine(name_of_machine()),
    }
}

/// Returns the name of this machine, if the system states it.
fn name_of_machine() -> Option<String> {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").ok()?;
    let name = name.trim();
    (!name.is_empty()).then(|| name.to_owned())
}

/// Maps an error of the listener: an address that cannot or must not be used is the user's mistake; one in use is not.
pub fn listen_error(error: ListenError) -> CliError {
    match error {
        ListenError::Bind { .. } => CliError::no_result(error),
        ListenError::Malformed { .. }
        | ListenError::NotEncrypted { .. }
        | ListenError::NoToken { .. }
        | ListenError::Tls(_) => CliError::bad_input(error),
    }
}
