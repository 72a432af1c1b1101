//! `ridged accuracy`: error against run time, as a table, a CSV file and pictures.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;

use super::{CliError, interrupt, output_path};
use crate::accuracy::plan_check::{self, PlanCheck};
use crate::accuracy::{
    self, AccuracyEffort, AccuracyPoint, AccuracyReport, LEVEL, page, plot, slope,
};
use crate::lab::reports::accuracy_results::{ACCURACY_FILE, ACCURACY_FOLDER};

/// Measures error against run time on a fixed list of scenes, by every method that applies.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ridged accuracy --quick --out accuracy\n\nWrites accuracy.csv, plans.csv, accuracy.json, one SVG per scene and a page with all of them, index.html, into DIR."
)]
pub struct Args {
    /// Fewer scenes and photons; takes a minute or two.
    #[arg(long)]
    pub quick: bool,
    /// Folder for accuracy.csv and the pictures.
    #[arg(long, value_name = "DIR", default_value = "accuracy")]
    pub out: PathBuf,
    /// Data folder of a daemon, instead of --out: its page shows the last measurement.
    #[arg(long, value_name = "DIR", conflicts_with = "out")]
    pub data: Option<PathBuf>,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// No result where the folder cannot be written; interrupted after Ctrl-C, with what was measured written.
pub fn run(args: Args) -> Result<(), CliError> {
    let out = match &args.data {
        Some(data) => data.join(ACCURACY_FOLDER),
        None => args.out.clone(),
    };
    output_path::check_folder(&out)?;
    let cancel = interrupt::flag()?;
    let effort = if args.quick {
        AccuracyEffort::Quick
    } else {
        AccuracyEffort::Full
    };
    std::fs::create_dir_all(&out)
        .with_context(|| format!("cannot create the folder {}", out.display()))
        .map_err(CliError::no_result)?;
    let started = Instant::now();
    let terminal = std::io::stderr().is_terminal();
    let found = accuracy::run(effort, &cancel, &|name, done, total| {
        if terminal {
            let passed = started.elapsed().as_secs_f64();
            let left = passed / (done.max(1) as f64) * (total - done) as f64;
            super::say(&format_args!(
                "{} of {total}: {name} ({left:.0} s left)",
                done + 1
            ));
        }
    });
    let seconds = started.elapsed().as_secs_f64();
    let report = AccuracyReport {
        machine: machine(seconds),
        seconds,
        left_out: accuracy::left_out(effort),
        found,
        written_at: None,
    };
    write(&out, &report).map_err(CliError::no_result)?;
    print(&report, args.json).map_err(CliError::no_result)?;
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
fn scenes(points: &[AccuracyPoint]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for p in points {
        if !names.contains(&p.scene.as_str()) {
            names.push(&p.scene);
        }
    }
    names
}

fn of<'a>(points: &'a [AccuracyPoint], scene: &str) -> Vec<&'a AccuracyPoint> {
    points.iter().filter(|p| p.scene == scene).collect()
}

fn write(folder: &Path, report: &AccuracyReport) -> anyhow::Result<()> {
    let AccuracyReport { machine, found, .. } = report;
    let path = folder.join("accuracy.csv");
    let failed = || format!("cannot write {}", path.display());
    let mut table = csv::Writer::from_path(&path).with_context(failed)?;
    for point in &found.points {
        table.serialize(point).with_context(failed)?;
    }
    table.flush().with_context(failed)?;
    write_proofs(&folder.join("plans.csv"), &found.proofs)?;
    std::fs::write(folder.join("machine.txt"), format!("{machine}\n"))?;
    let report = serde_json::to_string(report)?;
    // Renamed, so that the daemon never reads half of it.
    let (part, whole) = (folder.join("accuracy.part"), folder.join(ACCURACY_FILE));
    std::fs::write(&part, report)
        .and_then(|()| std::fs::rename(&part, &whole))
        .with_context(|| format!("cannot write {}", whole.display()))?;
    let page = folder.join("index.html");
    std::fs::write(&page, page::html(found, &scenes(&found.points), machine))
        .with_context(|| format!("cannot write {}", page.display()))?;
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

/// Writes one row per scene: whether its plan stays within the tolerance, and the time that it saves.
fn write_proofs(path: &Path, proofs: &[PlanCheck]) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
    let mut table = csv::Writer::from_path(path).with_context(failed)?;
    table
        .write_record([
            "scene",
            "quantity",
            "tolerance",
            "full",
            "full_std",
            "planned",
            "planned_std",
            "off",
            "allowed",
            "holds",
            "full_seconds",
            "planned_seconds",
            "planning_seconds",
            "speed_up",
            "left_out",
        ])
        .with_context(failed)?;
    for p in proofs {
        let numbers = [
            p.tolerance,
            p.full[0],
            p.full[1],
            p.planned[0],
            p.planned[1],
            p.off,
            p.allowed,
        ];
        let seconds = [p.full_s, p.planned_s, p.planning_s, p.speed_up()];
        let mut record = vec![p.scene.clone(), p.quantity.clone()];
        record.extend(numbers.map(|x| x.to_string()));
        record.push(p.holds.to_string());
        record.extend(seconds.map(|x| x.to_string()));
        record.push(p.parts_text());
        table.write_record(&record).with_context(failed)?;
    }
    table.flush().with_context(failed)
}

/// Prints the comparisons of plans with full computations.
pub(super) fn print_proofs(proofs: &[PlanCheck], out: &mut dyn Write) -> std::io::Result<()> {
    if proofs.is_empty() {
        return Ok(());
    }
    let kept = proofs.iter().filter(|p| p.holds).count();
    writeln!(
        out,
        "\nplans within their tolerance (difference to the full computation at most tolerance + 2 σ): {kept} of {}",
        proofs.len()
    )?;
    for p in proofs {
        let verdict = if p.holds { "ok " } else { "NOT" };
        writeln!(
            out,
            "  {verdict} {:<32} error {:+.2} % (allowed {:.2} %), ×{:.2} faster ({:.1} ms instead of {:.1} ms): {}",
            p.scene,
            100.0 * p.off,
            100.0 * p.allowed,
            p.speed_up(),
            1e3 * p.planned_s,
            1e3 * p.full_s,
            p.parts_text()
        )?;
    }
    let of = |series: bool| {
        plan_check::median_speed_up(
            proofs
                .iter()
                .filter(move |p| p.scene.starts_with("series ") == series),
        )
    };
    for (name, median) in [("traced scenes", of(false)), ("recorded series", of(true))] {
        if let Some(median) = median {
            writeln!(out, "  median over {name}: ×{median:.2}")?;
        }
    }
    Ok(())
}

fn print(report: &AccuracyReport, json: bool) -> std::io::Result<()> {
    let AccuracyReport { machine, found, .. } = report;
    let mut out = std::io::stdout().lock();
    if json {
        serde_json::to_writer_pretty(&mut out, report)?;
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
                // More time does not help a method with a bias.
                Some(slope) if slope > LEVEL => writeln!(out, ", levels off")?,
                Some(slope) => writeln!(out, ", slope {slope:.2}")?,
                None => writeln!(out)?,
            }
        }
    }
    for r in &found.rates {
        let actual = r
            .found
            .map_or_else(|| "hidden by rounding".to_owned(), |x| format!("{x:.4}"));
        writeln!(
            out,
            "\n{}: {} {actual} ({:.4} predicted)",
            r.scene, r.quantity, r.predicted
        )?;
    }
    print_proofs(&found.proofs, &mut out)?;
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
            "  {:<40} forecast {:.2} s, took {:.2} s",
            f.scene, f.forecast_s, f.taken_s
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::Measurements;

    #[test]
    fn the_report_states_its_cost_and_what_it_left_out() {
        let report = AccuracyReport {
            machine: "a machine".to_owned(),
            seconds: 2.0,
            left_out: accuracy::left_out(AccuracyEffort::Quick),
            found: Measurements::default(),
            written_at: None,
        };
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["seconds"], 2.0);
        assert!(json["points"].is_array() && json["forecasts"].is_array());
        let left_out = json["left_out"].as_array().unwrap();
        assert!(
            left_out
                .iter()
                .all(|l| l["what"].is_string() && l["why"].is_string())
        );
        assert!(!left_out.is_empty() && accuracy::left_out(AccuracyEffort::Full).is_empty());
    }
}
