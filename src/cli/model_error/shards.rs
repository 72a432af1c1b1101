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
    count: u64,
    cells: Vec<(u64, Option<SurfaceErrors>)>,
}

/// The name of the command.
const COMMAND: &str = "model-error";

/// What all shards of a comparison have in common.
fn run_of(args: &Args) -> Run {
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
    let (shard, count) = (target.shard, all.len() as u64);
    if shard.of > count {
        return Err(shards::too_many(shard, count, "surface", count));
    }
    let own = (0..).zip(&all).filter(|(n, _)| shard.has(*n));
    let (numbers, own): (Vec<u64>, Vec<&SurfaceComparison>) = own.unzip();
    let found = compare(&own, args.paths, args.seed, None, watch, cancel)?;
    let part = ErrorsPart {
        count,
        cells: numbers.into_iter().zip(found).collect(),
    };
    shards::write(target, run_of(args), watch.seconds(), &part)
}

/// Merges all shards of a comparison into its result.
pub(super) fn merge(args: &MergeArgs) -> Result<(), CliError> {
    let merged = shards::read::<ErrorsPart>(COMMAND, &args.files)?;
    let count = merged.parts.first().map_or(0, |part| part.count);
    let cells = merged.parts.into_iter().flat_map(|part| part.cells);
    let cells = shards::in_order(cells, usize::try_from(count).unwrap_or(usize::MAX))?;
    let compared = Compared {
        cells: cells.into_iter().flatten().collect(),
        missing: Vec::new(),
        cut_short: false,
    };
    write_result(&compared, Some(&args.out), args.json, merged.seconds)
}
