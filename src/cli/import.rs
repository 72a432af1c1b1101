//! `ridged import`: imports a recorded series into the store.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use anyhow::anyhow;
use serde_json::{Value, json};

use super::CliError;
use super::client::{Client, ConnectionArgs};
use super::progress::Bar;
use super::{interrupt, output, runtime};
use crate::archive;
use crate::daemon;
use crate::lab::ImportOptions;
use crate::series::Series;
use crate::store::disk::RealDisk;
use crate::wording::differences;

/// Imports a recorded series into the store: PNG frames bit for bit, TIFF frames as PNG with the same counts.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  ridged import tests/data/series/polymer-10 && ridged fit --scan 1 --store\n  ridged import polymer-10.zip"
)]
pub struct Args {
    /// Folder of the series (manifest.toml, frames.csv, frames/), or a zip archive of it.
    pub series: PathBuf,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
    /// Leave out frames that cannot be read, instead of refusing the series.
    #[arg(long)]
    pub skip_unreadable: bool,
    /// One JSON object on stdout.
    #[arg(long)]
    pub json: bool,
    /// Address and token, for a running daemon.
    #[command(flatten)]
    pub connection: ConnectionArgs,
}

/// Runs the command; a daemon that runs on the folder does the import.
///
/// # Errors
/// Bad input for a folder that is not a series or a frame that cannot be read; no result where the disk has no room for
/// it beside the reserve; interrupted by Ctrl-C, with nothing imported.
pub fn run(args: Args) -> Result<(), CliError> {
    let cancel = interrupt::flag()?;
    let answer = match Client::of(&args.data, &args.connection)? {
        Some(client) => {
            let request = Request::of(&args)?;
            by_daemon(client, request, &cancel)?
        }
        None => runtime::block_on(import(&args, cancel))?,
    };
    if let Some(skipped) = answer["skipped"].as_array() {
        for reason in skipped.iter().filter_map(Value::as_str) {
            tracing::warn!("left out: {reason}");
        }
    }
    if let Some(same) = answer["same_as_scan_id"].as_i64() {
        tracing::warn!("scan {same} holds the same series: the store has it twice now");
    }
    if let Some(like) = answer["like_scan_id"].as_i64() {
        let all = answer["differences"].as_array();
        let differing: Vec<&str> = all
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
            .collect();
        tracing::warn!(
            "scan {like} holds the same frames with other facts: {}; both are kept, and a fit of this one uses the new facts",
            differences::in_words(&differing)
        );
    }
    output::write(args.json, &answer, || {
        format!(
            "scan {} with {} frames\n",
            answer["scan_id"], answer["n_frames"]
        )
    })
}

/// What the daemon is asked.
enum Request {
    /// To read a folder.
    Folder(Value),
    /// To take an archive.
    Archive {
        file: File,
        name: String,
        skip_unreadable: bool,
    },
}

impl Request {
    fn of(args: &Args) -> Result<Request, CliError> {
        if args.series.is_file() {
            let file = File::open(&args.series).map_err(|error| {
                CliError::bad_input(anyhow!("{}: {error}", args.series.display()))
            })?;
            let name = args.series.file_name().unwrap_or_default();
            return Ok(Request::Archive {
                file,
                name: name.to_string_lossy().into_owned(),
                skip_unreadable: args.skip_unreadable,
            });
        }
        if let Some(url) = &args.connection.url {
            return Err(CliError::bad_input(anyhow!(
                "the daemon at {url} cannot read the folder {series} of this machine; pack it (`zip -r series.zip {series}`) and \
                import the archive",
                series = args.series.display()
            )));
        }
        // A missing folder has an absolute path too, and the refusal names it.
        let folder = args
            .series
            .canonicalize()
            .or_else(|_| std::path::absolute(&args.series))
            .unwrap_or_else(|_| args.series.clone());
        let body = json!({ "folder": folder, "skip_unreadable": args.skip_unreadable });
        Ok(Request::Folder(body))
    }

    fn send(self, client: &Client) -> Result<Value, CliError> {
        match self {
            Request::Folder(body) => client.post_patiently("/imports", &body),
            Request::Archive {
                file,
                name,
                skip_unreadable,
            } => {
                let skip_unreadable = skip_unreadable.to_string();
                let query = [("name", &*name), ("skip_unreadable", &*skip_unreadable)];
                client.upload("/imports/upload", &query, "application/zip", &file)
            }
        }
    }
}

/// Waits for the daemon's answer until Ctrl-C.
fn by_daemon(client: Client, request: Request, cancel: &AtomicBool) -> Result<Value, CliError> {
    let (sender, answer) = mpsc::channel();
    std::thread::spawn(move || sender.send(request.send(&client)));
    loop {
        match answer.recv_timeout(Duration::from_millis(50)) {
            Ok(answer) => return answer,
            Err(RecvTimeoutError::Timeout) if cancel.load(Ordering::Relaxed) => {
                tracing::warn!("the daemon continues the import");
                return Err(CliError::Interrupted);
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                return Err(CliError::no_result(anyhow!("the daemon was not asked")));
            }
        }
    }
}

fn check_archive(file: &Path) -> Result<(), CliError> {
    let wrong = |error: String| {
        CliError::bad_input(anyhow!(
            "{} is neither a folder nor a zip archive: {error}",
            file.display()
        ))
    };
    let opened = File::open(file).map_err(|error| wrong(error.to_string()))?;
    archive::open(opened).map_err(wrong)?;
    Ok(())
}

async fn import(args: &Args, cancel: Arc<AtomicBool>) -> Result<Value, CliError> {
    let reserve_bytes = runtime::read_config(None)?.store.reserve_bytes();
    // The series is checked first, so that a wrong folder or file does not leave an empty store.
    let is_archive = args.series.is_file();
    match is_archive {
        true => check_archive(&args.series)?,
        false => {
            Series::open_own(&args.series).map_err(CliError::bad_input)?;
        }
    }
    let (lab, _) = daemon::open_lab(&args.data, Arc::new(RealDisk), runtime::real_clock(), None)
        .await
        .map_err(CliError::no_result)?;
    lab.keep_free(reserve_bytes);
    let bar = Bar::new("frames");
    let options = ImportOptions {
        skip_unreadable: args.skip_unreadable,
        follow_links: true,
        cancel,
    };
    let progress = |done, total| bar.at(done as u64, total as u64);
    let imported = match is_archive {
        true => lab.import_archive(&args.series, &options, &progress).await,
        false => lab.import(&args.series, &options, &progress).await,
    };
    bar.clear();
    lab.shut_down().await;
    let imported = imported.map_err(runtime::lab_error)?;
    Ok(json!({
        "scan_id": imported.scan_id,
        "sample_id": imported.sample_id,
        "n_frames": imported.n_frames,
        "skipped": imported.skipped,
        "same_as_scan_id": imported.same_as,
        "like_scan_id": imported.like.as_ref().map(|like| like.scan_id),
        "differences": imported.like.map_or_else(Vec::new, |like| like.differences),
    }))
}
