//! Shards of a sweep: every Nth surface.

use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::study::{Study, Surfaces};
use super::{Args, WearPoint, write_result};
use crate::cli::CliError;
use crate::cli::limits::Stopwatch;
use crate::cli::shards::{self, Fact, MergeArgs, Run, Target};

/// The points of a shard, with the numbers of their surfaces.
#[derive(Debug, Serialize, Deserialize)]
struct WearPart {
    surfaces: Surfaces,
    paths: u64,
    points: Vec<(usize, Option<WearPoint>)>,
}

/// The name of the command.
const COMMAND: &str = "wear";

/// What all shards of a sweep have in common.
pub(super) fn run_of(args: &Args) -> Run {
    let number = |name: &str, x: f64| Fact::new(name, x.to_string());
    Run::new(
        COMMAND,
        [
            Fact::new("--rounds", format!("{:?}", args.rounds)),
            Fact::new("--burrs", format!("{:?}", args.burrs)),
            number("--theta-r-min-deg", args.theta_r_min_deg),
            number("--theta-r-max-deg", args.theta_r_max_deg),
            number("--theta-r-step-deg", args.theta_r_step_deg),
            Fact::new("--paths", args.paths.to_string()),
            Fact::new("--seed", args.seed.to_string()),
            Fact::new("rig and surface", format!("{:?}", args.scene)),
        ],
    )
}

/// Traces the surfaces of a shard into its file.
pub(super) fn trace(
    args: &Args,
    target: &Target<'_>,
    watch: &Stopwatch,
    cancel: &AtomicBool,
) -> Result<(), CliError> {
    let study = Study::of(args)?;
    let own = shards::surfaces_of(target.shard, study.surfaces.count())?;
    let points = study.points(own.clone(), args.paths, watch, cancel)?;
    let part = WearPart {
        surfaces: study.surfaces,
        paths: args.paths,
        points: own.into_iter().zip(points).collect(),
    };
    shards::write(target, watch.seconds(), &part)
}

/// Merges all shards of a sweep into its result.
pub(super) fn merge(args: &MergeArgs) -> Result<(), CliError> {
    let mut merged = shards::read::<WearPart>(COMMAND, &args.files)?;
    let points: Vec<_> = merged
        .parts
        .iter_mut()
        .flat_map(|part| std::mem::take(&mut part.points))
        .collect();
    // The shards of one run have the same surfaces.
    let WearPart {
        surfaces, paths, ..
    } = &merged.parts[0];
    let points = shards::in_order(points, surfaces.count())?;
    let swept = surfaces.swept(&points, 0, *paths, false);
    write_result(&swept, Some(&args.out), args.json, merged.seconds)
}
