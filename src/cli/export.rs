//! `ridged export`: writes a scan of the store as a recorded series, or as a file for other programs.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::anyhow;

use super::CliError;
use super::interrupt;
use super::runtime;
use crate::lab::{self, Exported, FrameStack, LabError, NexusFile, ReportChoice, StoredSeries};
use crate::reduction;
use crate::store::disk::RealDisk;
use crate::store::{Store, StoreError};
use crate::wording::counted;

/// Writes a scan as a recorded series, frames bit for bit, or as a file that other programs read.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged export --scan 1 --out series && ridged fit series
  ridged export --scan 1 --format bird --out brdf.json
  ridged export --scan 1 --format tiff --out frames.tif
  ridged export --scan 1 --format rgl --out surface.bsdf
  ridged export --scan 1 --format nexus --out scan.nxs")]
pub struct Args {
    /// Number of the scan.
    #[arg(long, value_name = "ID")]
    pub scan: i64,
    /// What to write.
    #[arg(long, value_enum, default_value_t = Format::Series)]
    pub format: Format,
    /// New or empty folder of the series, or new file.
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
    /// Region of a part with several, for bird and rgl.
    #[arg(long, value_name = "NAME")]
    pub region: Option<String>,
    /// Number of the fit, for rgl. Default: the newest completed fit of the scan.
    #[arg(long, value_name = "ID")]
    pub fit: Option<i64>,
    /// Leave out frames whose files are missing or damaged, instead of writing nothing (series only).
    #[arg(long)]
    pub skip_unreadable: bool,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
}

/// A form of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// A folder that `fit` and `import` read (gonio-series-1).
    Series,
    /// The observations as BRDF with its uncertainty, in the BiRD project's JSON.
    Bird,
    /// All frames as one 16-bit TIFF, a page per frame.
    Tiff,
    /// The fitted surface as a measured material that Mitsuba 3 reads (the RGL database's .bsdf).
    Rgl,
    /// Frames, poses, observations and fit as a NeXus file (HDF5).
    Nexus,
}

/// Runs the command, also beside a running daemon.
///
/// # Errors
/// Bad input for an unknown scan, a folder that is not empty or a file that exists; no result for damaged frames or a
/// full disk; interrupted by Ctrl-C, with nothing written.
pub fn run(args: Args) -> Result<(), CliError> {
    if args.format != Format::Series && args.skip_unreadable {
        return Err(CliError::bad_input(anyhow!(
            "--skip-unreadable belongs to --format series"
        )));
    }
    if args.region.is_some() && !matches!(args.format, Format::Bird | Format::Rgl) {
        return Err(CliError::bad_input(anyhow!(
            "--region belongs to --format bird and rgl: the other forms have whole frames"
        )));
    }
    if args.fit.is_some() && args.format != Format::Rgl {
        return Err(CliError::bad_input(anyhow!(
            "--fit belongs to --format rgl: the other forms do not depend on a fit"
        )));
    }
    let cancel = interrupt::flag()?;
    runtime::block_on(async {
        let clock = runtime::real_clock();
        let store = Store::open_for_reading(&args.data, Arc::new(RealDisk), clock)
            .await
            .map_err(|error| runtime::lab_error(error.into()))?;
        let written = match args.format {
            Format::Series => series(&store, &args, cancel).await,
            Format::Bird => bird(&store, &args, &cancel).await,
            Format::Tiff => tiff(&store, &args, &cancel).await,
            Format::Rgl => rgl(&store, &args, &cancel).await,
            Format::Nexus => nexus(&store, &args, &cancel).await,
        };
        store.close().await;
        let done = written?;
        writeln!(std::io::stdout(), "{done} in {}", args.out.display()).map_err(CliError::no_result)
    })
}

async fn series(store: &Store, args: &Args, cancel: Arc<AtomicBool>) -> Result<String, CliError> {
    let written = match args.skip_unreadable {
        true => lab::export_readable(store, args.scan, &args.out, cancel).await,
        false => lab::export(store, args.scan, &args.out, cancel)
            .await
            .map(|n_frames| Exported {
                n_frames,
                skipped: Vec::new(),
            }),
    };
    let written = written.map_err(|error| match error {
        LabError::Store(StoreError::FrameDamaged { .. }) => CliError::no_result(anyhow!(
            "{error}, or pass --skip-unreadable to leave it out; nothing was written"
        )),
        error => runtime::lab_error(error),
    })?;
    for reason in &written.skipped {
        tracing::warn!("left out: {reason}");
    }
    Ok(format!(
        "{} of scan {}",
        counted(written.n_frames, "frame"),
        args.scan
    ))
}

async fn bird(store: &Store, args: &Args, cancel: &AtomicBool) -> Result<String, CliError> {
    let scan = store.scan(args.scan).await;
    let scan = scan.map_err(|error| runtime::lab_error(error.into()))?;
    let series = StoredSeries::open(store, args.scan).await;
    let series = series.map_err(runtime::lab_error)?;
    let set = reduction::reduce(&series, args.region.as_deref(), cancel);
    let set = set.map_err(|error| match cancel.load(Ordering::Relaxed) {
        true => CliError::Interrupted,
        false => CliError::bad_input(error),
    })?;
    let file = lab::bird_file(&scan, &series, &set).map_err(runtime::lab_error)?;
    let text = format!("{file:#}\n");
    new_file(&args.out, |out| {
        out.write_all(text.as_bytes())
            .map_err(|error| unwritten(&args.out, &error))
    })?;
    Ok(format!(
        "{} of scan {}",
        counted(set.observations.len(), "observation"),
        args.scan
    ))
}

async fn tiff(store: &Store, args: &Args, cancel: &AtomicBool) -> Result<String, CliError> {
    let stack = FrameStack::open(store, args.scan).await;
    let stack = stack.map_err(runtime::lab_error)?;
    new_file(&args.out, |out| {
        let mut write = |bytes: &[u8]| {
            out.write_all(bytes)
                .map_err(|error| unwritten(&args.out, &error))
        };
        write(&stack.header())?;
        for index in 0..stack.n_pages() {
            if cancel.load(Ordering::Relaxed) {
                return Err(CliError::Interrupted);
            }
            write(&stack.page(index).map_err(runtime::lab_error)?)?;
        }
        Ok(())
    })?;
    Ok(format!(
        "{} of scan {}",
        counted(stack.n_pages(), "frame"),
        args.scan
    ))
}

async fn rgl(store: &Store, args: &Args, cancel: &AtomicBool) -> Result<String, CliError> {
    let choice = ReportChoice {
        fit_id: args.fit,
        region: args.region.clone(),
    };
    let surface = lab::surface_file(store, args.scan, &choice).await;
    let surface = surface.map_err(runtime::lab_error)?;
    if cancel.load(Ordering::Relaxed) {
        return Err(CliError::Interrupted);
    }
    new_file(&args.out, |out| {
        out.write_all(&surface.bytes)
            .map_err(|error| unwritten(&args.out, &error))
    })?;
    Ok(format!(
        "surface of fit {} of scan {}",
        surface.fit_id, args.scan
    ))
}

async fn nexus(store: &Store, args: &Args, cancel: &AtomicBool) -> Result<String, CliError> {
    let nexus = NexusFile::open(store, args.scan).await;
    let nexus = nexus.map_err(runtime::lab_error)?;
    new_path(&args.out, |part| {
        nexus
            .write(part, || Ok(()), cancel)
            .map_err(runtime::lab_error)
    })?;
    Ok(format!(
        "{} of scan {}",
        counted(nexus.n_frames(), "frame"),
        args.scan
    ))
}

/// Writes a new file whole or not at all.
fn new_file(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> Result<(), CliError>,
) -> Result<(), CliError> {
    new_path(path, |part| {
        let file = std::fs::File::create(part).map_err(|error| unwritten(path, &error))?;
        let mut out = std::io::BufWriter::new(file);
        fill(&mut out)?;
        let kept = out.flush().and_then(|()| out.get_ref().sync_all());
        kept.map_err(|error| unwritten(path, &error))
    })
}

/// The same for a file that is written by its name.
fn new_path(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<(), CliError>,
) -> Result<(), CliError> {
    if path.exists() {
        return Err(CliError::bad_input(anyhow!(
            "--out {}: the file exists; give the name of a new file",
            path.display()
        )));
    }
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().unwrap_or("export".as_ref()));
    name.push(format!("-{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let written = write(&part)
        .and_then(|()| std::fs::rename(&part, path).map_err(|error| unwritten(path, &error)));
    if written.is_err() {
        std::fs::remove_file(&part).ok();
    }
    written
}

fn unwritten(path: &Path, error: &std::io::Error) -> CliError {
    CliError::no_result(anyhow!("{} cannot be written: {error}", path.display()))
}
