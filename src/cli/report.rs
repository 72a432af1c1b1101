//! `ridged report`: the report on a scan or a recorded series, to print and as JSON.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, anyhow};
use serde_json::{Value, json};

use super::fit::{Variant, watched};
use super::{CliError, interrupt, output, output_path, runtime};
use crate::analysis::AnalysisOptions;
use crate::fit::FitOptions;
use crate::lab::{self, ReportChoice};
use crate::reduction::Remembering;
use crate::report::{Check, MeasurementReport, check};
use crate::series::Series;
use crate::store::disk::RealDisk;
use crate::store::{Store, utc_text};

/// Writes the report on a scan of the store, or on a recorded series: one HTML file to print on A4 (no scripts, no other
/// files) and the same as JSON with all digits.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  ridged report 7                      report-scan-7.html and report-scan-7.json
  ridged report 7 --fit 12 -o B-17.html
  ridged report tests/data/series/polymer-10 -o polymer-10.html
  ridged report --check B-17.json      compare the JSON with the hash in it")]
pub struct Args {
    /// Number of a scan in the store, or the folder of a recorded series, which is fitted first.
    #[arg(
        value_name = "SCAN|DIR",
        required_unless_present_any = ["scan", "check"],
        conflicts_with_all = ["scan", "check"]
    )]
    pub of: Option<PathBuf>,
    /// Number of a scan in the store.
    #[arg(long, value_name = "ID")]
    pub scan: Option<i64>,
    /// Number of the fit. Default: the newest completed fit of the scan.
    #[arg(long, value_name = "ID", conflicts_with = "check")]
    pub fit: Option<i64>,
    /// Region of a part with a layout: even, odd or patch-I-J.
    #[arg(long, value_name = "NAME")]
    pub region: Option<String>,
    /// Model variant of the fit of a series.
    #[arg(long, value_enum, default_value_t = Variant::Auto)]
    pub variant: Variant,
    /// HTML file to write. Default: report-scan-N.html, or report.html for a series.
    #[arg(short, long, value_name = "FILE.html")]
    pub out: Option<PathBuf>,
    /// JSON file to write. Default: beside the HTML file, with the extension json.
    #[arg(long, value_name = "FILE.json")]
    pub json: Option<PathBuf>,
    /// Compare a report in JSON with the SHA-256 in it; write nothing. Exit 1 if it was changed.
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["scan", "out", "json", "region"])]
    pub check: Option<PathBuf>,
    /// Data folder of the store.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
}

/// The measurement to report.
enum Measurement<'a> {
    Scan(i64),
    Series(&'a Path),
}

/// Runs the command, also beside a running daemon.
///
/// # Errors
/// Bad input for an unknown scan, a folder that is not a series or a file that cannot be written; no result for a scan without
/// a completed fit, or a changed report.
pub fn run(args: Args) -> Result<(), CliError> {
    if let Some(file) = &args.check {
        return checked(file);
    }
    let measurement = match (&args.of, args.scan) {
        (_, Some(scan)) => Measurement::Scan(scan),
        (Some(of), None) => measurement(of),
        (None, None) => unreachable!("one of them is required"),
    };
    let html = args.out.clone().unwrap_or_else(|| match measurement {
        Measurement::Scan(scan) => format!("report-scan-{scan}.html").into(),
        Measurement::Series(_) => "report.html".into(),
    });
    let json = args
        .json
        .clone()
        .unwrap_or_else(|| html.with_extension("json"));
    if html == json {
        return Err(CliError::bad_input(anyhow!(
            "the HTML and the JSON form cannot have the same file, {}; set --out or --json to another one",
            html.display()
        )));
    }
    for file in [&html, &json] {
        output_path::check_file(file)?;
    }
    let report = match measurement {
        Measurement::Scan(scan) => of_scan(&args, scan)?,
        Measurement::Series(dir) => of_series(&args, dir)?,
    };
    let sealed = report.sealed();
    let mut text = serde_json::to_string_pretty(&sealed).map_err(CliError::no_result)?;
    text.push('\n');
    let printed_at = utc_text(runtime::real_clock().utc());
    for (file, content) in [(&html, report.html(&printed_at)), (&json, text)] {
        std::fs::write(file, content)
            .with_context(|| format!("cannot write {}", file.display()))
            .map_err(CliError::no_result)?;
    }
    let sha256 = sealed["sha256"].as_str().unwrap_or_default();
    output::write(false, &Value::Null, || {
        format!(
            "{}\n{}\nSHA-256 of the JSON form: {sha256}\n",
            html.display(),
            json.display()
        )
    })
}

/// Returns the measurement that a word names. Digits are the number of a scan; `./7` is a folder.
fn measurement(of: &Path) -> Measurement<'_> {
    match of.to_str().map(str::parse::<i64>) {
        Some(Ok(scan)) => Measurement::Scan(scan),
        _ => Measurement::Series(of),
    }
}

fn of_scan(args: &Args, scan: i64) -> Result<MeasurementReport, CliError> {
    let choice = ReportChoice {
        fit_id: args.fit,
        region: args.region.clone(),
    };
    runtime::block_on(async {
        let disk = Arc::new(RealDisk);
        let store = Store::open_for_reading(&args.data, disk, runtime::real_clock())
            .await
            .map_err(|error| runtime::lab_error(error.into()))?;
        let report = lab::report(&store, scan, &choice).await;
        store.close().await;
        report.map_err(runtime::lab_error)
    })
}

fn of_series(args: &Args, dir: &Path) -> Result<MeasurementReport, CliError> {
    if args.fit.is_some() {
        return Err(CliError::bad_input(anyhow!(
            "--fit: a folder has no stored fits; import it (`ridged import {}`), or omit --fit",
            dir.display()
        )));
    }
    let series = Series::open_own(dir).map_err(CliError::bad_input)?;
    let options = AnalysisOptions {
        region: args.region.clone(),
        fit: FitOptions {
            variant: args.variant.choice(),
            ..FitOptions::default()
        },
        ..AnalysisOptions::default()
    };
    let cancel = interrupt::flag()?;
    let source = Remembering::new(series.clone());
    let analysis = watched(&source, &options, None, &cancel)?;
    let request = json!({"variant": args.variant.choice(), "region": args.region});
    lab::report_on_series(&series, &analysis, request).map_err(CliError::no_result)
}

/// Compares a report with the hash in it.
fn checked(file: &Path) -> Result<(), CliError> {
    let name = file.display();
    let text = std::fs::read_to_string(file)
        .with_context(|| format!("cannot read {name}"))
        .map_err(CliError::bad_input)?;
    let document: Value = serde_json::from_str(&text).map_err(|error| {
        CliError::bad_input(anyhow!(
            "{name} is not JSON ({error}); --check expects the JSON form of a report"
        ))
    })?;
    match check(&document) {
        Check::Unchanged { sha256 } => output::write(false, &Value::Null, || {
            format!("{name}: unchanged, SHA-256 {sha256}\n")
        }),
        Check::Changed { stated, actual } => Err(CliError::no_result(anyhow!(
            "{name} was changed after it was made: it states the SHA-256 {stated} and has {actual}; \
             write the report again with `ridged report`"
        ))),
        Check::NoHash => Err(CliError::bad_input(anyhow!(
            "{name} has no `sha256`; --check expects the JSON form of a report"
        ))),
    }
}
