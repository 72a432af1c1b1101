//! `ridged judge`: judges a series against a specification: pass, fail or cannot tell.

use std::path::PathBuf;

use anyhow::anyhow;

use super::fit::{Variant, print_forecast, watched};
use super::limits::FitLimits;
use super::{CliError, interrupt, output, runtime, terminal};
use crate::analysis::AnalysisOptions;
use crate::fit::FitOptions;
use crate::fit::traced::TracingOptions;
use crate::judge::{Specification, VerdictReport};
use crate::reduction::{FrameSource, Remembering};
use crate::series::Series;
use crate::wording::layout::width;
use crate::wording::{decimals, fixed, names, significant, stated, toml_text};

/// Measures a series and judges it against a specification: pass, fail or cannot tell.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Example:
  ridged judge tests/data/series/polymer-10 --spec docs/examples/specification.toml

The verdict is in the output; the exit code is 0 whatever it says. Decision rule (JCGM 106, guarded
acceptance): pass where the risk that the part does not conform is at most the specification's
max_false_accept_risk, fail where the chance that it conforms is at most max_false_reject_risk,
otherwise cannot tell, as where the data do not determine the quantity.")]
pub struct Args {
    /// Folder of a recorded series (manifest.toml, frames.csv, frames/).
    #[arg(required_unless_present = "scan", conflicts_with = "scan")]
    pub dir: Option<PathBuf>,
    /// Number of a scan in the store, instead of a folder.
    #[arg(long, value_name = "ID")]
    pub scan: Option<i64>,
    /// Data folder of the store.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
    /// Specification (TOML); docs/examples/specification.toml shows all keys.
    #[arg(long, value_name = "FILE")]
    pub spec: PathBuf,
    /// Model the reported result is based on.
    #[arg(long, value_enum, default_value_t = Variant::Auto)]
    pub variant: Variant,
    /// Region of a part with a layout: even, odd or patch-I-J.
    #[arg(long, value_name = "NAME")]
    pub region: Option<String>,
    /// Limits of time and error.
    #[command(flatten)]
    pub limits: FitLimits,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// Reads and checks a specification; `file` names it in errors.
fn specified(text: &str, file: &str) -> Result<Specification, CliError> {
    let specification: Specification = toml_text::read(text)
        .map_err(|refused| CliError::bad_input(anyhow!("{file}, {refused}")))?;
    match specification.check() {
        Ok(()) => Ok(specification),
        Err(error) => Err(CliError::bad_input(anyhow!("{file}: {error}"))),
    }
}

/// Runs the command.
///
/// # Errors
/// Bad input for a folder that is not a series or a text that is not a specification; no result where no frame can be
/// used; interrupted after Ctrl-C. A part that fails is not an error.
pub fn run(args: Args) -> Result<(), CliError> {
    let file = args.spec.display().to_string();
    let text = std::fs::read_to_string(&args.spec).map_err(|error| {
        CliError::bad_input(anyhow::Error::new(error).context(format!(
            "{file} cannot be read; docs/examples/specification.toml is an example of a specification"
        )))
    })?;
    let specification = specified(&text, &file)?;
    args.limits.check(args.variant == Variant::Traced)?;
    let mut options = AnalysisOptions {
        region: args.region.clone(),
        fit: FitOptions {
            variant: args.variant.choice(),
            tolerance: args.limits.tolerance,
            tracer: TracingOptions::to_error(args.limits.target_error),
            ..FitOptions::default()
        },
        max_seconds: args.limits.max_seconds,
        ..AnalysisOptions::default()
    };
    let source: Box<dyn FrameSource> = match (&args.dir, args.scan) {
        (Some(dir), _) => {
            let series = Series::open_own(dir).map_err(CliError::bad_input)?;
            Box::new(Remembering::new(series))
        }
        (None, scan) => Box::new(runtime::stored_series(
            &args.data,
            scan.unwrap_or_default(),
        )?),
    };
    let cancel = interrupt::flag()?;
    let expected_s = print_forecast(source.as_ref(), &mut options, &cancel);
    let analysis = watched(source.as_ref(), &options, expected_s, &cancel)?;
    let verdict = VerdictReport::new(
        &specification,
        &analysis.report,
        &analysis.observations,
        &source.sample_poses(),
    );
    output::write(args.json, &verdict, || table(&verdict, terminal::columns()))
}

/// Aligns columns: the first and the last to the left, numbers to the right.
fn columns<const N: usize>(rows: &[[String; N]]) -> Vec<String> {
    let widths: [usize; N] = std::array::from_fn(|k| {
        let cells = rows.iter().map(|row| row[k].chars().count());
        cells.max().unwrap_or(0)
    });
    let line = |row: &[String; N]| {
        let mut line = String::new();
        for (k, (cell, width)) in row.iter().zip(widths).enumerate() {
            line.push_str(&match k {
                0 => format!("  {cell:<width$}"),
                k if k + 1 == N => format!("  {cell}"),
                _ => format!("  {cell:>width$}"),
            });
        }
        line
    };
    rows.iter().map(line).collect()
}

/// Returns limits as one text: `9 … 11`, `≥ 9`, `≤ 11`.
fn limits(lower: Option<f64>, upper: Option<f64>, unit: &str) -> String {
    match (lower, upper) {
        (Some(lower), Some(upper)) => format!("{} … {}{unit}", stated(lower), stated(upper)),
        (Some(lower), None) => format!("≥ {}{unit}", stated(lower)),
        (None, Some(upper)) => format!("≤ {}{unit}", stated(upper)),
        (None, None) => "–".to_owned(),
    }
}

fn table(verdict: &VerdictReport, terminal: Option<usize>) -> String {
    let judgement = &verdict.judgement;
    let heads = [
        "quantity",
        "value ± U",
        "k",
        "limits",
        "guard band",
        "verdict",
    ];
    let mut rows = vec![heads.map(str::to_owned)];
    for item in &judgement.items {
        let name = names::known(&item.quantity);
        let unit = name.map_or("", |name| name.unit);
        let decimals = item.expanded.map_or(4, decimals);
        // Two digits of the uncertainty, unless the value is too large for a table.
        let digits = |x: f64| match x.abs() < 1e7 {
            true => fixed(x, decimals),
            false => significant(x),
        };
        let none = || "–".to_owned();
        let value = item.value.zip(item.expanded);
        rows.push([
            name.map_or_else(|| item.quantity.clone(), |name| name.full()),
            value.map_or_else(none, |(x, u)| {
                format!("{} ± {}{unit}", digits(x), digits(u))
            }),
            item.coverage_factor
                .map_or_else(none, |k| format!("{k:.2}")),
            limits(item.lower, item.upper, unit),
            item.guard_band
                .map_or_else(none, |band| format!("{}{unit}", digits(band))),
            item.verdict.to_string(),
        ]);
    }
    let mut text = format!(
        "{}: {}\n{}\n\n",
        judgement.specification, judgement.verdict, judgement.decision_rule
    );
    let lines = columns(&rows);
    let widest = lines.iter().map(|line| width(line)).max().unwrap_or(0);
    if terminal.is_none_or(|terminal| widest <= terminal) {
        for (n, row) in lines.into_iter().enumerate() {
            text.push_str(&row);
            text.push('\n');
            if let Some(item) = n.checked_sub(1).and_then(|n| judgement.items.get(n)) {
                text.push_str(&format!("      {}\n", item.reason));
            }
        }
    } else {
        // Columns would break within a row.
        for (row, item) in rows[1..].iter().zip(&judgement.items) {
            let [name, value, k, limits, band, verdict] = row;
            text.push_str(&format!(
                "  {name}: {verdict}\n    {value} (k = {k}), limits {limits}, guard band {band}\n    {}\n",
                item.reason
            ));
        }
    }
    if let Some(tilts) = &verdict.contrast_theta_c_deg {
        let tilts: Vec<String> = tilts.iter().map(|deg| format!("{deg}°")).collect();
        text.push_str(&format!(
            "Contrasts are means over θc {}.\n",
            tilts.join(", ")
        ));
    }
    for (quantity, found) in &judgement.would_decide {
        let name = names::known(quantity).map_or_else(|| quantity.clone(), |name| name.full());
        text.push_str(&format!("{name}: {}\n", found.message));
    }
    for warning in &judgement.warnings {
        text.push_str(&format!("warning: {warning}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_specification_is_refused_by_line_and_key() {
        let limits = "name = \"part 7\"\n[limits]\ntheta_r_deg = { lower = 9.5, upper = 10.5 }\n";
        assert!(specified(limits, "spec.toml").is_ok());
        for (from, to, words) in [
            (
                "9.5",
                "\"x\"",
                "spec.toml, line 3: limits.theta_r_deg.lower: expected a number, got \"x\"",
            ),
            (
                "lower",
                "least",
                "spec.toml, line 3: limits.theta_r_deg.least: there is no key `least`",
            ),
            ("10.5", "1.0", "theta_r_deg"),
        ] {
            let Err(CliError::BadInput(error)) = specified(&limits.replace(from, to), "spec.toml")
            else {
                panic!("{to} is refused");
            };
            assert!(
                error.to_string().contains(words),
                "{words} is not in: {error}"
            );
        }
    }
}
