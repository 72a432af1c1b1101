//! Results of many fits as one table: a row for each file of `ridged fit DIR --json`.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde::Serialize;

use crate::cli::{CliError, output, output_collision, output_path};
use crate::fit::FitReport;
use crate::fit::report::{Parameters, Status};
use crate::wording::counted;

/// Results and the table.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Files that `ridged fit DIR --json` wrote; each is a row, under the name of the file.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// CSV file of the table.
    #[arg(long, value_name = "FILE.csv")]
    pub out: PathBuf,
    /// One JSON object on stdout instead of a sentence.
    #[arg(long)]
    pub json: bool,
}

/// What is printed.
#[derive(Serialize)]
struct Merged<'a> {
    fits: usize,
    /// Fits with the status `converged`.
    converged: usize,
    file: &'a Path,
}

/// Runs the command.
///
/// # Errors
/// Bad input for a file that is not the result of one series, or is given twice; no result where the table cannot be written.
pub(super) fn run(args: &Args) -> Result<(), CliError> {
    output_path::check_file(&args.out)?;
    let mut fits: Vec<(String, FitReport)> = Vec::new();
    for (n, file) in args.files.iter().enumerate() {
        output_collision::not_the_input(&args.out, file)?;
        let mut earlier = args.files[..n].iter();
        if let Some(twin) = earlier.find(|other| output_collision::same_file(other, file)) {
            return Err(CliError::bad_input(anyhow!(
                "{} and {} are the same file: give it once",
                twin.display(),
                file.display()
            )));
        }
        fits.push((name_of(file), read(file)?));
    }
    output_path::write_whole(&args.out, csv(&fits)?.as_bytes())?;
    let converged = |(_, report): &&(String, FitReport)| report.status == Status::Converged;
    let merged = Merged {
        fits: fits.len(),
        converged: fits.iter().filter(converged).count(),
        file: &args.out,
    };
    output::write(args.json, &merged, || {
        format!(
            "{}, {} of them converged, in {}\n",
            counted(merged.fits, "fit"),
            merged.converged,
            args.out.display()
        )
    })
}

fn name_of(file: &Path) -> String {
    let name = file.file_stem().unwrap_or(file.as_os_str());
    name.to_string_lossy().into_owned()
}

fn read(file: &Path) -> Result<FitReport, CliError> {
    let text = std::fs::read_to_string(file)
        .with_context(|| format!("cannot read {}", file.display()))
        .map_err(CliError::bad_input)?;
    serde_json::from_str(&text)
        .with_context(|| {
            format!(
                "{}: expected the result of one series (ridged fit DIR --json)",
                file.display()
            )
        })
        .map_err(CliError::bad_input)
}

/// The table: columns are named as in the list of results, where it has them.
fn csv(fits: &[(String, FitReport)]) -> Result<String, CliError> {
    let mut head: Vec<String> = ["fit", "status", "variant", "n_observations"]
        .map(str::to_owned)
        .into();
    for name in Parameters::NAMES {
        head.extend(["", "_std", "_expanded"].map(|kind| format!("{name}{kind}")));
    }
    head.extend(["coverage_factor", "rms_residual", "chi2_reduced", "finding"].map(str::to_owned));
    head.extend(["warnings", "program"].map(str::to_owned));
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(&head).map_err(CliError::no_result)?;
    for (name, report) in fits {
        table
            .write_record(row(name, report))
            .map_err(CliError::no_result)?;
    }
    let bytes = table
        .into_inner()
        .map_err(|error| CliError::no_result(anyhow!("{error}")))?;
    String::from_utf8(bytes).map_err(CliError::no_result)
}

fn row(name: &str, report: &FitReport) -> Vec<String> {
    let number = |x: Option<f64>| x.map_or(String::new(), |x| x.to_string());
    let status = serde_json::to_value(report.status).unwrap_or_default();
    let mut cells = vec![
        name.to_owned(),
        status.as_str().unwrap_or_default().to_owned(),
        report.variant.to_string(),
        report.n_observations.to_string(),
    ];
    let known = report.parameters.named();
    for wanted in Parameters::NAMES {
        let found = known.iter().find(|(name, _)| *name == wanted);
        let of = found.map(|(_, p)| [p.value, p.std, p.expanded]);
        cells.extend(of.unwrap_or_default().map(number));
    }
    let finding = report.findings.first().map(|f| f.code.word().to_owned());
    cells.extend([
        number(report.parameters.theta_r_deg.coverage_factor),
        number(report.rms_residual),
        number(report.chi2_reduced),
        finding.unwrap_or_default(),
        report.warnings.len().to_string(),
        report.program.clone(),
    ]);
    cells
}
