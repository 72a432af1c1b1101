//! `ridged import`: a recorded series into the store.

use std::io::Write;
use std::path::PathBuf;

use serde_json::{Value, json};

use super::CliError;
use super::client::Client;
use super::daemon;
use super::progress::Bar;
use crate::lab::ImportOptions;

/// Takes a recorded series into the store, frames bit for bit.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ridged import tests/data/series/polymer-10 && ridged fit --scan 1"
)]
pub struct Args {
    /// Folder of the series (manifest.toml, frames.csv, frames/).
    pub dir: PathBuf,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
    /// Leave out frames that cannot be read, instead of refusing the series.
    #[arg(long)]
    pub skip_unreadable: bool,
    /// One JSON object on stdout.
    #[arg(long)]
    pub json: bool,
}

/// Runs the command; a daemon that runs on the folder does it.
///
/// # Errors
/// Bad input for a folder that is no series or a frame that cannot be read.
pub fn run(args: Args) -> Result<(), CliError> {
    let answer = match Client::find(&args.data) {
        Some(client) => {
            let folder = args.dir.canonicalize().unwrap_or_else(|_| args.dir.clone());
            let body = json!({ "folder": folder, "skip_unreadable": args.skip_unreadable });
            client.post("/imports", Some(&body))?
        }
        None => daemon::block_on(import(&args))?,
    };
    if let Some(skipped) = answer["skipped"].as_array() {
        for reason in skipped.iter().filter_map(Value::as_str) {
            tracing::warn!("left out: {reason}");
        }
    }
    if let Some(same) = answer["same_as_scan_id"].as_i64() {
        tracing::warn!("scan {same} holds the same series: it is in the store twice now");
    }
    let text = match args.json {
        true => format!("{answer:#}\n"),
        false => format!(
            "scan {} with {} frames\n",
            answer["scan_id"], answer["n_frames"]
        ),
    };
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(CliError::no_result)
}

async fn import(args: &Args) -> Result<Value, CliError> {
    // Looked at first, so that a wrong folder does not leave an empty store behind.
    crate::series::Series::open(&args.dir).map_err(CliError::bad_input)?;
    let lab = daemon::open_lab(&args.data, daemon::real_clock(), None).await?;
    let bar = Bar::new("frames");
    let options = ImportOptions {
        skip_unreadable: args.skip_unreadable,
    };
    let imported = lab
        .import(&args.dir, &options, &|done, total| {
            bar.at(done as u64, total as u64)
        })
        .await;
    bar.clear();
    lab.shut_down().await;
    let imported = imported.map_err(daemon::lab_error)?;
    Ok(json!({
        "scan_id": imported.scan_id,
        "sample_id": imported.sample_id,
        "n_frames": imported.n_frames,
        "skipped": imported.skipped,
        "same_as_scan_id": imported.same_as,
    }))
}
