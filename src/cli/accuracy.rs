//! `ridged accuracy`: error against run time, as a table, a CSV file and pictures.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;

use super::{CliError, interrupt};
use crate::accuracy::{self, Effort, Measurements, Point, plot, slope};

/// Measures error against run time on a fixed list of scenes, by every method that applies.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ridged accuracy --quick --out accuracy\n\nWrites accuracy.csv and one SVG per scene into DIR."
)]
pub struct Args {
    /// Fewer scenes and photons: less than a minute.
    #[arg(long)]
    pub quick: bool,
    /// Folder for accuracy.csv and the pictures.
    #[arg(long, value_name = "DIR", default_value = "accuracy")]
    pub out: PathBuf,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// No result where the folder cannot be written; interrupted after Ctrl-C, with what was measured written.
pub fn run(args: Args) -> Result<(), CliError> {
    let cancel = interrupt::flag()?;
    let effort = if args.quick {
        Effort::Quick
    } else {
        Effort::Full
    };
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make the folder {}", args.out.display()))
        .map_err(CliError::no_result)?;
    let started = Instant::now();
    let terminal = std::io::stderr().is_terminal();
    let found = accuracy::run(effort, &cancel, &|name, done, total| {
        if terminal {
            let passed = started.elapsed().as_secs_f64();
            let left = passed / (done.max(1) as f64) * (total - done) as f64;
            eprintln!("{} of {total}: {name} ({left:.0} s left)", done + 1);
        }
    });
    let machine = machine(started.elapsed().as_secs_f64());
    write(&args.out, &found, &machine).map_err(CliError::no_result)?;
    print(&found, &machine, args.json).map_err(CliError::no_result)?;
    if cancel.load(std::sync::atomic::Ordering::Relaxed) {
        return Err(CliError::Interrupted);
    }
    Ok(())
}

/// Program, processor, cores in use and the whole run's seconds.
fn machine(seconds: f64) -> String {
    let model = std::fs::read_to_string("/proc/cpuinfo")
        .ok()
        .and_then(|text| {
            let line = text
                .lines()
                .find(|l| l.starts_with("model name"))?
                .to_owned();
            Some(line.split_once(':')?.1.trim().to_owned())
        })
        .unwrap_or_else(|| std::env::consts::ARCH.to_owned());
    let build = if cfg!(debug_assertions) {
        ", debug build"
    } else {
        ""
    };
    format!(
        "ridged {}{build}, {model}, {} threads, {} {}, {seconds:.0} s in all",
        env!("CARGO_PKG_VERSION"),
        rayon::current_num_threads(),
        std::env::consts::OS,
        std::env::consts::ARCH
    )
}

/// Scenes in the order in which they were measured.
fn scenes(points: &[Point]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for p in points {
        if !names.contains(&p.scene.as_str()) {
            names.push(&p.scene);
        }
    }
    names
}

fn of<'a>(points: &'a [Point], scene: &str) -> Vec<&'a Point> {
    points.iter().filter(|p| p.scene == scene).collect()
}

fn write(folder: &Path, found: &Measurements, machine: &str) -> anyhow::Result<()> {
    let path = folder.join("accuracy.csv");
    let failed = || format!("cannot write {}", path.display());
    let mut table = csv::Writer::from_path(&path).with_context(failed)?;
    for point in &found.points {
        table.serialize(point).with_context(failed)?;
    }
    table.flush().with_context(failed)?;
    std::fs::write(folder.join("machine.txt"), format!("{machine}\n"))?;
    for scene in scenes(&found.points) {
        let name: String = scene
            .chars()
            .map(|c| {
                if c.is_ascii_alphanumeric() {
                    c.to_ascii_lowercase()
                } else {
                    '-'
                }
            })
            .collect();
        let file = folder.join(format!("{}.svg", name.trim_matches('-')));
        std::fs::write(&file, plot::svg(scene, &of(&found.points, scene), machine))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(())
}

fn print(found: &Measurements, machine: &str, json: bool) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if json {
        serde_json::to_writer_pretty(&mut out, found)?;
        return writeln!(out);
    }
    writeln!(out, "{machine}")?;
    for scene in scenes(&found.points) {
        let points = of(&found.points, scene);
        writeln!(out, "\n{scene}")?;
        for group in plot::groups(&points) {
            let best = group.iter().min_by(|a, b| a.error.total_cmp(&b.error));
            let Some(best) = best else { continue };
            write!(
                out,
                "  {:<40} {:.1e} after {:.1e} s ({})",
                group[0].method, best.error, best.seconds, group[0].quantity
            )?;
            match slope(&group) {
                Some(slope) => writeln!(out, ", slope {slope:.2}")?,
                None => writeln!(out)?,
            }
        }
    }
    let right = found
        .forecasts
        .iter()
        .filter(|f| f.within_a_factor_of_two())
        .count();
    writeln!(
        out,
        "\nforecasts within a factor of 2: {right} of {}",
        found.forecasts.len()
    )?;
    for f in &found.forecasts {
        writeln!(
            out,
            "  {:<40} told {:.2} s, took {:.2} s",
            f.scene, f.forecast_s, f.taken_s
        )?;
    }
    Ok(())
}
