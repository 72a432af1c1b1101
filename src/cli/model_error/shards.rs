//! Shards of a comparison: every Nth surface.

use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::{Args, Compared, compare, wanted, write_result};
use crate::accuracy::model_error::{SurfaceComparison, SurfaceErrors};
use crate::cli::CliError;
use crate::cli::limits::Stopwatch;
use crate::cli::shards::{self, Fact, MergeArgs, Run, Target};

/// The results of a shard, with the numbers of their surfaces.
#[derive(Debug, Serialize, Deserialize)]
struct ErrorsPart {
    /// Surfaces of the whole run.
    count: usize,
    cells: Vec<(usize, Option<SurfaceErrors>)>,
}

/// The name of the command.
const COMMAND: &str = "model-error";

/// What all shards of a comparison have in common.
pub(super) fn run_of(args: &Args) -> Run {
    Run::new(
        COMMAND,
        [
            Fact::new("--theta-r-deg", format!("{:?}", args.theta_r_deg)),
            Fact::new("--alpha", format!("{:?}", args.alpha)),
            Fact::new("--rho-d", args.rho_d.to_string()),
            Fact::new("--paths", args.paths.to_string()),
            Fact::new("--seed", args.seed.to_string()),
        ],
    )
}

/// Compares the surfaces of a shard, into its file.
pub(super) fn trace(
    args: &Args,
    target: &Target<'_>,
    watch: &Stopwatch,
    cancel: &AtomicBool,
) -> Result<(), CliError> {
    let all = wanted(args)?;
    let own = shards::surfaces_of(target.shard, all.len())?;
    let surfaces: Vec<&SurfaceComparison> = own.iter().map(|n| &all[*n]).collect();
    let found = compare(&surfaces, args.paths, args.seed, None, watch, cancel)?;
    let part = ErrorsPart {
        count: all.len(),
        cells: own.into_iter().zip(found).collect(),
    };
    shards::write(target, watch.seconds(), &part)
}

/// Merges all shards of a comparison into its result.
pub(super) fn merge(args: &MergeArgs) -> Result<(), CliError> {
    let merged = shards::read::<ErrorsPart>(COMMAND, &args.files)?;
    let count = merged.parts.first().map_or(0, |part| part.count);
    let cells = merged.parts.into_iter().flat_map(|part| part.cells);
    let cells = shards::in_order(cells, count)?;
    let compared = Compared {
        cells: cells.into_iter().flatten().collect(),
        missing: Vec::new(),
        cut_short: false,
    };
    write_result(&compared, Some(&args.out), args.json, merged.seconds)
}
