//! Shards of a map: a part of its tiles.

use std::path::Path;

use anyhow::anyhow;
use sha2::{Digest, Sha256};

use super::{Args, Watch, options, refusal, table};
use crate::cli::limits::Stopwatch;
use crate::cli::shards::{self, Fact, MergeArgs, Run, Target};
use crate::cli::{CliError, interrupt, output, output_path};
use crate::map::folder::write_into;
use crate::map::shards::{MapPart, PartError, merged, part};
use crate::reduction::FrameSource;
use crate::wording::hex;

/// The name of the command.
const COMMAND: &str = "map";

/// What all shards of a map have in common. The frames themselves are compared by what the pixels share.
pub(super) fn run_of(source: &dyn FrameSource, args: &Args) -> Run {
    let series = format!("{:?} {:?}", source.manifest(), source.rows());
    let tolerance = args.limits.target_error;
    let tolerance = tolerance.map_or("not given".to_owned(), |e| e.to_string());
    Run::new(
        COMMAND,
        [
            Fact::new("--tolerance", tolerance),
            Fact::new(
                "manifest with list of frames (SHA-256)",
                hex(&Sha256::digest(series)),
            ),
        ],
    )
}

/// Fits the pixels of a shard, into its file.
pub(super) fn fit(
    source: &dyn FrameSource,
    args: &Args,
    target: &Target<'_>,
) -> Result<(), CliError> {
    let (cancel, stopwatch) = (interrupt::flag()?, Stopwatch::start(None));
    let watch = Watch::new();
    let folder = target.file.parent().filter(|p| !p.as_os_str().is_empty());
    let options = options(args, folder.unwrap_or(Path::new(".")));
    let fitted = part(source, &options, target.shard, &|p| watch.show(p), &cancel);
    watch.clear();
    let fitted = fitted.map_err(|error| match error {
        PartError::TooMany { most } => {
            let camera = &source.manifest().camera;
            let pixels = u64::from(camera.width_px) * u64::from(camera.height_px);
            shards::too_many(target.shard, pixels, "pixel", most as u64)
        }
        error => failure(error),
    })?;
    shards::write(target, stopwatch.seconds(), &fitted)
}

/// Merges all shards of a map into its files.
pub(super) fn merge(args: &MergeArgs) -> Result<(), CliError> {
    output_path::check_folder(&args.out)?;
    let cancel = interrupt::flag()?;
    let parts = shards::read::<MapPart>(COMMAND, &args.files)?;
    let (map, timing) = merged(parts.parts).map_err(failure)?;
    let summary = write_into(&map, timing, &args.out, &cancel).map_err(refusal)?;
    output::write(args.json, &summary, || table(&summary, &args.out))
}

/// Maps a failed part or merge to an exit code.
fn failure(error: PartError) -> CliError {
    match error {
        PartError::Map(error) => refusal(error.into()),
        error => CliError::bad_input(anyhow!(error)),
    }
}
