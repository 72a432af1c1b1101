//! `ridged doctor`: checks everything that a scan needs, moves nothing, and says what to do.

mod findings;
mod folder;
mod host;
mod rig;

use std::path::PathBuf;

use anyhow::anyhow;

use super::client::Client;
use super::{CliError, output, runtime};
use crate::clock::{Clock as _, SystemClock};
use crate::config::Config;
use crate::lab::assembly::real_rig;
use crate::sim::rig::{SimulatedRig, Simulation};
use crate::store::Store;
use findings::Findings;

/// Checks rig, camera, disk, clock, database and frames before the rig is left alone. Moves nothing.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged doctor --config rig.toml                 before a scan
  ridged doctor --config rig.toml --frames        also takes a dark and a lit frame
  ridged doctor --data ridged-data --deep --json  also compares every frame with its hash
  ridged doctor --config rig.toml --tls-cert cert.pem --tls-key key.pem
Exit codes: 0 nothing to do, 3 warnings, 4 faults; 2 for settings that cannot be read.
Beside a running daemon it asks the daemon about the rig.")]
pub struct Args {
    /// Settings of the rig (TOML).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Data folder [default: ridged-data].
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Check a simulated rig instead of the configured one.
    #[arg(long)]
    pub simulated_rig: bool,
    /// Read every frame file and compare it with its hash.
    #[arg(long)]
    pub deep: bool,
    /// Take a dark and a lit frame where the axes are.
    #[arg(long)]
    pub frames: bool,
    /// Certificate of the daemon (PEM), where the settings do not name it.
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Its private key (PEM).
    #[arg(long, value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// One JSON object on stdout.
    #[arg(long)]
    pub json: bool,
}

/// Runs the checks.
///
/// # Errors
/// Bad input for settings that cannot be read; the exit code of the worst finding.
pub fn run(args: &Args) -> Result<(), CliError> {
    let config = runtime::read_config(args.config.as_deref())?;
    let mut findings = Findings::default();
    findings.ok(
        "settings",
        match &args.config {
            Some(file) => format!("{} can be read", file.display()),
            None => "the defaults (--config names a file)".to_owned(),
        },
    );
    runtime::block_on(check(args, &config, &mut findings))?;
    output::write(args.json, &findings.json(), || findings.text())?;
    match findings.worst().exit_code() {
        0 => Ok(()),
        code => Err(CliError::Verdict(code)),
    }
}

async fn check(args: &Args, config: &Config, findings: &mut Findings) -> Result<(), CliError> {
    let data = args.data.as_ref().unwrap_or(&config.store.folder).clone();
    host::check_programs(config, findings);
    let of_settings = (&config.server.tls_cert, &config.server.tls_key);
    let pair = match (&args.tls_cert, &args.tls_key) {
        (None, None) => of_settings,
        given => given,
    };
    if let (Some(certificate), Some(key)) = pair {
        host::check_certificate(certificate, key, findings);
    }
    let facts = config.camera_facts();
    let frame_bytes = 2 * u64::from(facts.width_px) * u64::from(facts.height_px);
    folder::check_disk(
        &data,
        config.store.reserve_mb * 1_000_000,
        frame_bytes,
        findings,
    );
    let known = folder::check_store(&data, args.deep, &config.due, findings).await;
    host::check_clock(SystemClock::new().utc(), known.newest_event, findings).await;
    // The client waits on its thread.
    let asked = data.clone();
    let daemon = tokio::task::spawn_blocking(move || Client::find(&asked));
    match daemon.await.map_err(CliError::no_result)? {
        Ok(Some(client)) => {
            let mut found = std::mem::take(findings);
            let asked = tokio::task::spawn_blocking(move || {
                rig::ask_daemon(&client, &mut found);
                found
            });
            *findings = asked.await.map_err(CliError::no_result)?;
            if args.frames {
                findings.note("camera", "--frames has no effect beside a running daemon");
            }
            return Ok(());
        }
        Ok(None) if Store::is_in_use(&data) => {
            findings.warning(
                "daemon",
                format!(
                    "another ridged process holds {} and takes no commands",
                    data.display()
                ),
                "wait for its end, or end it with Ctrl-C; the rig was not checked",
            );
            return Ok(());
        }
        Ok(None) => findings.note("daemon", format!("none runs on {}", data.display())),
        Err(error) => {
            findings.error("daemon", &rig::words(&error));
            return Ok(());
        }
    }
    let (simulated, parts) = if args.simulated_rig {
        let (simulated, parts) = SimulatedRig::build(Simulation::default())?;
        (Some(simulated), Some(parts.simulating(config)))
    } else {
        match real_rig(config, &runtime::real_clock()) {
            Ok(parts) => (None, parts),
            Err(error) => {
                findings.error("camera", &error);
                findings.note(
                    "stages",
                    "not checked; run doctor again when the settings of the camera are right",
                );
                return Ok(());
            }
        }
    };
    let Some(parts) = parts else {
        findings.note(
            "stages",
            "the settings name no port, so there is no rig to check",
        );
        return match args.frames {
            true => Err(CliError::bad_input(anyhow!(
                "--frames needs a rig: give --config FILE with a port, or --simulated-rig"
            ))),
            false => Ok(()),
        };
    };
    let world = simulated.as_ref().map(|rig| &rig.world);
    let darkness = args.frames.then(|| rig::Darkness::of(&parts, world));
    // The store may be that of a real rig.
    let pinned = known.stages.filter(|_| !args.simulated_rig);
    rig::check_rig(parts, pinned.as_ref(), darkness, findings).await;
    Ok(())
}
