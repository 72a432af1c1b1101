//! `ridged map`: pictures of ridge angle and roughness from a recorded series.

mod shards;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use indicatif::{ProgressBar, ProgressStyle};

use super::limits::MapLimits;
use super::output_collision;
use super::shards::{MergeArgs, Target};
use super::{CliError, interrupt, output, output_path, runtime};
use crate::accuracy::map_forecast::of_map;
use crate::map::folder::{FolderError, map_into};
use crate::map::summary::Summary;
use crate::map::{MapError, MapOptions, Progress, Stage};
use crate::reduction::{FrameSource, ReductionError, Remembering};
use crate::series::Series;
use crate::shard::Shard;
use crate::wording::{counted, decimals, names, percent, significant};

/// Fits every pixel of a series: float32 TIFF and PNG of each parameter and its uncertainty.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "\
Examples:
  ridged map tests/data/series/checker --out checker-map --json
  ridged map tests/data/series/checker --shard 1/2 --out 1.shard
  ridged map merge 1.shard 2.shard --out checker-map

Pixels are those of the frames, in the sample's own axes at phi_s = 0 (row 0 at the top, +y up).
lean_azimuth_deg is the direction in which the facets lean, counter-clockwise from +x, -180 to 180.
Values are not a number where a pixel shows no lobe or cannot be fitted; flags.tif holds the reasons,
as a sum of bits (flag_bits in the summary):
    1 not_converged      the descent did not end at a minimum; no value
    2 at_bound           a parameter ended on its bound
    4 not_identifiable   no lobe, or an uncertainty beyond use; no value
    8 misfit             no single ridged surface explains the pixel
   16 few_observations   too few are left after masking; no value
   32 partly_masked      some observations were full, defect or out of the field
   64 border             next to another lean direction or to the sample's edge
  128 defect             belongs to a defect of the table
The uncertainties of the pixels are their own noise; what all pixels share is std_shared in the
summary.

Files take their names when all of them are written: Ctrl-C before leaves the folder as it was
(exit 130), Ctrl-C after leaves a whole map (exit 0)."
)]
pub struct Args {
    /// Merge shards instead.
    #[command(subcommand)]
    pub action: Option<Action>,
    /// Folder of a recorded series (manifest.toml, frames.csv, frames/).
    #[arg(required_unless_present = "scan", conflicts_with = "scan")]
    pub dir: Option<PathBuf>,
    /// Number of a scan in the store, instead of a folder.
    #[arg(long, value_name = "ID")]
    pub scan: Option<i64>,
    /// Data folder of the store.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
    /// Folder for the files; created if it does not exist. With --shard: file of the shard.
    #[arg(long, value_name = "DIR|FILE", required = true)]
    pub out: Option<PathBuf>,
    /// Fit part K of N of the pixels; `ridged map merge` puts the parts together.
    #[arg(long, value_name = "K/N", conflicts_with = "max_seconds")]
    pub shard: Option<Shard>,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
    /// Limits of time and error.
    #[command(flatten)]
    pub limits: MapLimits,
    /// Memory for resampled frames, in MiB; what exceeds it goes to a scratch file in the output folder.
    #[arg(long, value_name = "MIB", default_value_t = 1024)]
    pub memory_mib: usize,
}

/// Subcommands of `ridged map`.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// Merge the files of all shards of one map; the result is bit-equal to one run.
    #[command(after_help = "Example:\n  ridged map merge 1.shard 2.shard --out checker-map")]
    Merge(MergeArgs),
}

/// Runs the command.
///
/// # Errors
/// Bad input for a folder that is not a series or has too few poses; no result where no pixel has a lobe or files cannot
/// be written; interrupted after Ctrl-C.
pub fn run(args: Args) -> Result<(), CliError> {
    if let Some(Action::Merge(merge)) = &args.action {
        return shards::merge(merge);
    }
    args.limits.check()?;
    let out = args.out.as_deref();
    let out = out.ok_or_else(|| CliError::bad_input(anyhow!("expected --out DIR")))?;
    let source: Box<dyn FrameSource> = match (&args.dir, args.scan) {
        (Some(dir), _) => {
            let series = Series::open_own(dir).map_err(CliError::bad_input)?;
            match args.shard {
                None => output_collision::no_folder_of_frames(out, &series)?,
                Some(_) => output_collision::no_file_of_series(out, &series)?,
            }
            Box::new(Remembering::new(series))
        }
        (None, scan) => Box::new(runtime::stored_series(
            &args.data,
            scan.unwrap_or_default(),
        )?),
    };
    if let Some(shard) = args.shard {
        let run = shards::run_of(source.as_ref(), &args);
        let target = Target::new(run, shard, Some(out), args.json)?;
        return shards::fit(source.as_ref(), &args, &target);
    }
    output_path::check_folder(out)?;
    let cancel = interrupt::flag()?;
    let watch = Watch::new();
    let options = options(&args, out);
    if args.limits.is_any()
        && let Some(forecast) = of_map(source.as_ref(), &options, &cancel)
    {
        super::say(&format_args!("forecast: {forecast}"));
    }
    let summary = map_into(source.as_ref(), &options, out, &|p| watch.show(p), &cancel);
    watch.clear();
    let summary = summary.map_err(refusal)?;
    output::write(args.json, &summary, || table(&summary, out))
}

fn options(args: &Args, scratch: &Path) -> MapOptions {
    MapOptions {
        memory_bytes_max: args.memory_mib << 20,
        scratch: scratch.to_owned(),
        target_error: args.limits.target_error,
        max_seconds: args.limits.max_seconds,
    }
}

/// Maps a failed map to an exit code.
fn refusal(error: FolderError) -> CliError {
    match error {
        FolderError::Map(MapError::Cancelled | MapError::Reduction(ReductionError::Cancelled)) => {
            CliError::Interrupted
        }
        FolderError::Map(error @ MapError::TooFewPoses { .. }) => CliError::bad_input(error),
        error => CliError::no_result(error),
    }
}

/// A bar on a terminal once the work takes more than a second.
struct Watch {
    started: Instant,
    terminal: bool,
    bar: OnceLock<ProgressBar>,
    stage: Mutex<Option<Stage>>,
}

impl Watch {
    fn new() -> Self {
        Watch {
            started: Instant::now(),
            terminal: std::io::stderr().is_terminal(),
            bar: OnceLock::new(),
            stage: Mutex::new(None),
        }
    }

    fn show(&self, p: Progress) {
        if !self.terminal || self.started.elapsed() < Duration::from_secs(1) {
            return;
        }
        let first = {
            let mut stage = self.stage.lock().expect("no holder of this lock panics");
            stage.replace(p.stage) != Some(p.stage)
        };
        let bar = self.bar.get_or_init(|| {
            let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}, {eta} left")
                .expect("the template is constant");
            super::progress::drawn(ProgressBar::new(1).with_style(style))
        });
        if first {
            bar.reset();
        }
        bar.set_message(p.stage.words());
        bar.set_length(p.total as u64);
        bar.set_position(p.done as u64);
    }

    fn clear(&self) {
        if let Some(bar) = self.bar.get() {
            bar.finish_and_clear();
        }
    }
}

/// Returns a parameter as people read it, with its unit.
fn named(key: &str) -> String {
    match names::known(key) {
        Some(name) if name.unit.is_empty() => name.full(),
        Some(name) => format!("{} / {}", name.full(), name.unit.trim_start()),
        None => key.to_owned(),
    }
}

fn table(summary: &Summary, out: &Path) -> String {
    let mut text = format!(
        "{} of {} fitted pixels have values, {:.0} pixels/s, {}\n\n",
        summary.pixels_with_value,
        summary.pixels,
        summary.pixels_per_s,
        counted(summary.observations_per_pixel, "pose")
    );
    text.push_str(&format!(
        "{:<22} {:>9} {:>9} {:>9} {:>13} {:>13}\n",
        "", "median", "5 %", "95 %", "u of a pixel", "u, shared"
    ));
    for (key, s) in &summary.parameters {
        let name = named(key);
        let decimals = s.std_median.map_or(4, |std| decimals(std) + 1);
        let number =
            |x: Option<f64>| x.map_or_else(|| "–".to_owned(), |x| format!("{x:.decimals$}"));
        text.push_str(&format!(
            "{name:<22} {:>9} {:>9} {:>9} {:>13} {:>13}\n",
            number(s.median),
            number(s.p5),
            number(s.p95),
            number(s.std_median),
            number(s.std_shared)
        ));
    }
    text.push('\n');
    for lean in &summary.lean_directions {
        text.push_str(&format!(
            "{:.0} % of the pixels have the lean direction {:.2}°\n",
            100.0 * lean.share,
            lean.azimuth_deg
        ));
    }
    text.push_str(&format!("\n{}\n", counted(summary.defects.len(), "defect")));
    const SHOWN: usize = 20;
    for d in summary.defects.iter().take(SHOWN) {
        let deviation = d
            .deviations
            .iter()
            .find(|v| v.parameter == d.worst)
            .map_or_else(
                || "no single surface explains it".to_owned(),
                |v| {
                    let value = v.value.map_or_else(|| "–".to_owned(), significant);
                    format!(
                        "{} {value} instead of {}",
                        named(v.parameter),
                        significant(v.usual)
                    )
                },
            );
        text.push_str(&format!(
            "  at ({:.2}, {:.2}) mm, {:.2} × {:.2} mm, {:.3} mm²: {deviation}\n",
            d.x_mm, d.y_mm, d.width_mm, d.height_mm, d.area_mm2
        ));
    }
    if summary.defects.len() > SHOWN {
        text.push_str("  … the rest is in defects.csv\n");
    }
    for warning in &summary.warnings {
        text.push_str(&format!("warning: {warning}\n"));
    }
    for left in &summary.left_out {
        let cost = left.cost.map_or_else(
            || "effect unknown".to_owned(),
            |c| format!("effect ≤ {} of the brightest radiance", percent(c)),
        );
        text.push_str(&format!("left out: {} ({cost}): {}\n", left.what, left.why));
    }
    for frame in &summary.rejected_frames {
        text.push_str(&format!(
            "frame left out: {} ({}) {}\n",
            frame.file, frame.reason, frame.detail
        ));
    }
    text.push_str(&format!(
        "\n{} in {}\n",
        counted(summary.files.len(), "file"),
        out.display()
    ));
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::layers::flag_bits;
    use clap::Args as _;

    #[test]
    fn the_help_lists_every_flag_with_its_bit() {
        let mut command = Args::augment_args(clap::Command::new("map"));
        let help = command.render_long_help().to_string();
        for (name, bit) in flag_bits() {
            assert!(
                help.contains(&format!("{bit} {name} ")),
                "{bit} {name}: {help}"
            );
        }
    }
}
