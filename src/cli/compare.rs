//! `ridged compare`: two scans of the store beside each other.

use std::path::PathBuf;
use std::sync::Arc;

use super::{CliError, output, runtime};
use crate::comparison::shared::SharedChoice;
use crate::comparison::{ComparedParameter, ComparedValue, Comparison};
use crate::fit::uncertainty::coverage::other_factor;
use crate::lab;
use crate::store::Store;
use crate::store::disk::RealDisk;
use crate::wording::{decimals, fixed, names, utc_words};

/// Compares two scans by their newest fits: the difference of each parameter with its expanded uncertainty U, and
/// E_n = difference / U. The results agree where |E_n| is at most 1.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged compare 12 15
  ridged compare 12 15 --shared reference,angles    lines of the budget with the same error in both
  ridged compare 12 15 --shared none --json")]
pub struct Args {
    /// Number of the first scan, A.
    #[arg(value_name = "A")]
    pub first: i64,
    /// Number of the second scan, B. Differences are B − A.
    #[arg(value_name = "B")]
    pub second: i64,
    /// What both commands have.
    #[command(flatten)]
    pub study: StudyArgs,
}

/// Options of comparisons and studies of repeatability.
#[derive(Debug, clap::Args)]
pub struct StudyArgs {
    /// Region of a part with several.
    #[arg(long, value_name = "NAME")]
    pub region: Option<String>,
    /// Lines of the budget with the same error in all scans, or none [default: those that the records show as the same].
    #[arg(long, value_name = "LINES", value_parser = SharedChoice::read)]
    pub shared: Option<SharedChoice>,
    /// One JSON object on stdout.
    #[arg(long)]
    pub json: bool,
    /// Data folder.
    #[arg(long, value_name = "DIR", default_value = "ridged-data")]
    pub data: PathBuf,
}

/// Opens the store for reading, also beside a running daemon.
///
/// # Errors
/// Bad input for a folder without a store.
pub(super) async fn opened(args: &StudyArgs) -> Result<Store, CliError> {
    let store = Store::open_for_reading(&args.data, Arc::new(RealDisk), runtime::real_clock());
    store
        .await
        .map_err(|error| runtime::lab_error(error.into()))
}

/// Runs the command, also beside a running daemon.
///
/// # Errors
/// Bad input for an unknown scan or line; no result for a scan without a completed fit.
pub fn run(args: Args) -> Result<(), CliError> {
    let study = &args.study;
    let shared = study.shared.clone().unwrap_or_default();
    let region = study.region.as_deref();
    let compared = runtime::block_on(async {
        let store = opened(study).await?;
        let compared = lab::compare(&store, &[args.first, args.second], region, &shared).await;
        store.close().await;
        compared.map_err(runtime::lab_error)
    })?;
    output::write(study.json, &compared, || text(&compared))
}

fn text(compared: &Comparison) -> String {
    let (a, b) = (&compared.first, &compared.second);
    let mut out = format!(
        "A: scan {}, {}, {}\nB: scan {}, {}, {}\n\n",
        a.scan_id,
        a.part,
        utc_words(&a.measured_at),
        b.scan_id,
        b.part,
        utc_words(&b.measured_at)
    );
    out.push_str("| parameter | A ± U | B ± U | B − A ± U | E_n | |\n|---|---|---|---|---|---|\n");
    for parameter in &compared.parameters {
        out.push_str(&row(parameter));
    }
    out.push('\n');
    for line in compared.shared_lines.iter().filter(|line| line.shared) {
        out.push_str(&format!(
            "Same error in both: {} ({})\n",
            line.line, line.why
        ));
    }
    for note in &compared.notes {
        out.push_str(&format!("{note}\n"));
    }
    out.push_str(FACTOR_NOTE);
    out
}

/// What ± is in a table whose values state their k by [`with_factor`].
pub(super) const FACTOR_NOTE: &str =
    "± is the expanded uncertainty U, with k = 2 where no other k is stated.\n";

/// Adds the coverage factor to a value ± U where it is not 2.
pub(super) fn with_factor(text: String, factor: Option<f64>) -> String {
    match other_factor(factor) {
        Some(k) => format!("{text} ({k})"),
        None => text,
    }
}

fn row(parameter: &ComparedParameter) -> String {
    let name = names::quantity(parameter.name);
    let value = |value: &ComparedValue| {
        let text = stated(value.value, value.expanded, name.unit);
        with_factor(text, value.coverage_factor)
    };
    let (difference, normalised, word) = match &parameter.difference {
        Some(d) => (
            with_factor(
                stated(Some(d.value), Some(d.expanded), name.unit),
                Some(d.coverage_factor),
            ),
            fixed(d.normalised, 2),
            if d.agrees { "agree" } else { "differ" },
        ),
        None => ("–".to_owned(), "–".to_owned(), ""),
    };
    format!(
        "| {} | {} | {} | {difference} | {normalised} | {word} |\n",
        name.full(),
        value(&parameter.first),
        value(&parameter.second)
    )
}

/// A value with its expanded uncertainty and unit.
pub(super) fn stated(value: Option<f64>, expanded: Option<f64>, unit: &str) -> String {
    match (value, expanded) {
        (None, _) => "–".to_owned(),
        (Some(value), Some(expanded)) => {
            let digits = decimals(expanded);
            format!("{} ± {expanded:.digits$}{unit}", fixed(value, digits))
        }
        (Some(value), None) => format!("{value:.4}{unit}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comparison::compare;
    use crate::comparison::tests::result;
    use crate::fit::uncertainty::budget::Budget;

    #[test]
    fn the_text_states_difference_uncertainty_and_agreement() {
        let of = |scan, value| {
            let budget = Budget {
                counting: 0.02,
                model: 0.3,
                ..Budget::default()
            };
            result(scan, value, budget)
        };
        let compared = compare(&of(1, 10.0), &of(2, 10.1), &SharedChoice::Recorded);
        let text = text(&compared);
        for part in [
            "A: scan 1, B-17",
            "| θr ridge angle | 10.00 ± 0.60° | 10.10 ± 0.60° | 0.100 ± 0.057° | 1.77 | differ |",
            "Same error in both: model (same part, model and poses)",
            "k = 2",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("wedge"), "{text}");
    }

    #[test]
    fn an_unknown_line_is_refused_with_what_was_meant() {
        let refused = super::super::try_parsed::<Args>(&["1", "2", "--shared", "refernce"]);
        let words = refused.unwrap_err().to_string();
        assert!(words.contains("did you mean `reference`?"), "{words}");
    }
}
