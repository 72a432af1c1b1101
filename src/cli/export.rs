//! `ridged export`: writes a scan of the store as a recorded series.

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::anyhow;

use super::CliError;
use super::interrupt;
use super::runtime;
use crate::lab::{self, Exported, LabError};
use crate::store::disk::RealDisk;
use crate::store::{Store, StoreError};
use crate::wording::counted;

/// Writes a scan as a recorded series, frames bit for bit.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  ridged export --scan 1 --out series && ridged fit series")]
pub struct Args {
    /// Number of the scan.
    #[arg(long, value_name = "ID")]
    pub scan: i64,
    /// New or empty folder to write to.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Leave out frames whose files are missing or damaged, instead of writing nothing.
    #[arg(long)]
    pub skip_unreadable: bool,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
}

/// Runs the command, also beside a running daemon.
///
/// # Errors
/// Bad input for an unknown scan or a folder that is not empty; no result for damaged frames or a
/// full disk; interrupted by Ctrl-C, with nothing written.
pub fn run(args: Args) -> Result<(), CliError> {
    let cancel = interrupt::flag()?;
    runtime::block_on(async {
        let clock = runtime::real_clock();
        let store = Store::open_for_reading(&args.data, Arc::new(RealDisk), clock)
            .await
            .map_err(|error| runtime::lab_error(error.into()))?;
        let written = match args.skip_unreadable {
            true => lab::export_readable(&store, args.scan, &args.out, cancel).await,
            false => lab::export(&store, args.scan, &args.out, cancel)
                .await
                .map(|n_frames| Exported {
                    n_frames,
                    skipped: Vec::new(),
                }),
        };
        store.close().await;
        let written = written.map_err(|error| match error {
            LabError::Store(StoreError::FrameDamaged { .. }) => CliError::no_result(anyhow!(
                "{error}, or pass --skip-unreadable to leave it out; nothing was written"
            )),
            error => runtime::lab_error(error),
        })?;
        for reason in &written.skipped {
            tracing::warn!("left out: {reason}");
        }
        writeln!(
            std::io::stdout(),
            "{} of scan {} in {}",
            counted(written.n_frames, "frame"),
            args.scan,
            args.out.display()
        )
        .map_err(CliError::no_result)
    })
}
