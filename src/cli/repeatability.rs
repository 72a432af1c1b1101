//! `ridged repeatability`: scatter of scans beside their stated uncertainty, and gauge R&R.

use super::compare::{FACTOR_NOTE, StudyArgs, opened, stated, with_factor};
use super::{CliError, output, runtime};
use crate::lab;
use crate::repeatability::gauge::{Gauge, GaugeNumber, GaugeSpread, GroupedBy, VarianceSource};
use crate::repeatability::scatter::{Scatter, ScatterVerdict};
use crate::repeatability::{PARAMETER, Repeatability, StudyChoice};
use crate::wording::{counted, decimals, fixed, names, percent, signed, significant, utc_words};

/// Compares the scatter of scans with the uncertainty that their newest fits state. Scans of one part, remounted in between,
/// show whether U is right; scans of several parts by several operators or on several days also give gauge R&R.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged repeatability 12 15 18 21
  ridged repeatability 12 15 18 21 --by day --json
  ridged repeatability 12 15 18 --shared none     no line of the budget has the same error in all scans
  ridged repeatability $(ridged results --tag study-1 --fields scan_id --csv | tail -n +2)     all scans with a tag
docs/how-to/check-the-uncertainty.md explains how to measure and what the answer means.")]
pub struct Args {
    /// Numbers of the scans, 2 to 200.
    #[arg(value_name = "SCAN", required = true, num_args = 1..)]
    pub scans: Vec<i64>,
    /// Key of the parameter.
    #[arg(long, value_name = "KEY", default_value = PARAMETER)]
    pub parameter: String,
    /// What reproducibility is taken over [default: operators where every scan names one, otherwise days].
    #[arg(long, value_name = "operator|day", value_parser = group)]
    pub by: Option<GroupedBy>,
    /// What both commands have.
    #[command(flatten)]
    pub study: StudyArgs,
}

fn group(word: &str) -> Result<GroupedBy, String> {
    match word {
        "operator" => Ok(GroupedBy::Operator),
        "day" => Ok(GroupedBy::Day),
        other => Err(format!("expected operator or day, got `{other}`")),
    }
}

/// Runs the command, also beside a running daemon.
///
/// # Errors
/// Bad input for fewer than two scans, an unknown scan, parameter or line.
pub fn run(args: Args) -> Result<(), CliError> {
    let choice = StudyChoice {
        parameter: args.parameter,
        by: args.by,
        shared: args.study.shared.clone().unwrap_or_default(),
    };
    let region = args.study.region.as_deref();
    let found = runtime::block_on(async {
        let store = opened(&args.study).await?;
        let found = lab::repeatability(&store, &args.scans, region, &choice).await;
        store.close().await;
        found.map_err(runtime::lab_error)
    })?;
    output::write(args.study.json, &found, || text(&found))
}

fn text(found: &Repeatability) -> String {
    let name = names::known(&found.parameter);
    let unit = name.map_or("", |name| name.unit);
    let title = name.map_or_else(|| found.parameter.clone(), |name| name.full());
    let mut out = String::from(
        "| scan | part | when | operator | value ± U | from the mean |\n|---|---|---|---|---|---|\n",
    );
    for result in &found.results {
        let digits = decimals(result.expanded) + 1;
        out.push_str(&format!(
            "| {} | {} | {} | {} | {} | {}{unit} |\n",
            result.of.scan_id,
            result.of.part,
            utc_words(&result.of.measured_at),
            result.of.operator_name.as_deref().unwrap_or(""),
            with_factor(
                stated(Some(result.value), Some(result.expanded), unit),
                Some(result.coverage_factor)
            ),
            signed(result.deviation, digits)
        ));
    }
    out.push_str(FACTOR_NOTE);
    for scan in &found.left_out {
        out.push_str(&format!("Left out: scan {}: {}\n", scan.scan_id, scan.why));
    }
    out.push('\n');
    match &found.scatter {
        Some(scatter) => scatter_text(&mut out, scatter, unit),
        None => out.push_str("No part has two results: there is no scatter to compare.\n"),
    }
    for line in found.shared_lines.iter().filter(|line| line.shared) {
        out.push_str(&format!(
            "Same error in all scans: {} ({})\n",
            line.line, line.why
        ));
    }
    out.push('\n');
    match (&found.gauge, &found.gauge_note) {
        (Some(gauge), _) => gauge_text(&mut out, gauge, unit),
        (None, Some(note)) => out.push_str(&format!("No gauge R&R: {note}.\n")),
        (None, None) => {}
    }
    out.push('\n');
    out.push_str(&answer(found, &title, unit));
    out
}

fn scatter_text(out: &mut String, scatter: &Scatter, unit: &str) {
    let number = |value: f64| format!("{}{unit}", significant(value));
    let [low, high] = scatter.std_interval;
    if let Some(mean) = scatter.mean {
        let digits = decimals(scatter.std) + 1;
        out.push_str(&format!(
            "Mean of {}: {mean:.digits$}{unit}\n",
            counted(scatter.n, "scan")
        ));
    }
    out.push_str(&format!(
        "Scatter s of one scan: {} (95 %: {} to {}; {})\n",
        number(scatter.std),
        number(low),
        number(high),
        freedom_text(scatter.degrees_of_freedom)
    ));
    out.push_str(&format!(
        "Stated u (k = 1): {}, without the lines that are the same in all scans {}\n",
        number(scatter.stated_std),
        number(scatter.scattering_std)
    ));
    if let (Some(chi_square), Some(probability)) = (scatter.chi_square, scatter.probability) {
        out.push_str(&format!(
            "χ² = {} with {}; probability of a larger one {}\n",
            significant(chi_square),
            freedom_text(scatter.degrees_of_freedom),
            probability_text(probability)
        ));
    }
}

fn freedom_text(freedom: usize) -> String {
    format!("{} of freedom", counted(freedom, "degree"))
}

fn probability_text(probability: f64) -> String {
    match probability {
        p if p < 1e-4 => "< 0.01 %".to_owned(),
        p => percent(p),
    }
}

/// A number of percent, with two digits however small it is.
fn of_hundred(value: f64) -> String {
    percent(value / 100.0)
}

fn gauge_text(out: &mut String, gauge: &Gauge, unit: &str) {
    let by = gauge.by.map_or("group", GroupedBy::as_str);
    out.push_str(&format!("Gauge R&R: {}", counted(gauge.n_parts, "part")));
    if gauge.by.is_some() {
        out.push_str(&format!(", {}", counted(gauge.n_groups, by)));
    }
    out.push_str("\n\n| | standard deviation | 95 % | degrees of freedom | of the total |\n|---|---|---|---|---|\n");
    let mut row = |name: &str, spread: &GaugeSpread| {
        let interval = spread.interval.map_or("–".to_owned(), |[low, high]| {
            format!("{} to {}{unit}", significant(low), significant(high))
        });
        let freedom = spread.degrees_of_freedom;
        out.push_str(&format!(
            "| {name} | {}{unit} | {interval} | {} | {} |\n",
            significant(spread.std),
            freedom.map_or("–".to_owned(), |freedom| format!("{freedom:.1}")),
            spread.percent_of_total.map_or("–".to_owned(), of_hundred),
        ));
    };
    row("repeatability", &gauge.repeatability);
    if let Some(spread) = &gauge.reproducibility {
        row(&format!("reproducibility ({by}s)"), spread);
    }
    row("gauge (R&R)", &gauge.gauge);
    if let Some(spread) = &gauge.part_to_part {
        row("part to part", spread);
    }
    if let Some(spread) = &gauge.total {
        row("total", spread);
    }
    out.push('\n');
    let mut number = |name: &str, number: &GaugeNumber, show: fn(f64) -> String| {
        let interval = number.interval.map_or(String::new(), |[low, high]| {
            format!(" (95 %: {} to {})", show(low), show(high))
        });
        out.push_str(&format!("{name}: {}{interval}\n", show(number.value)));
    };
    if let Some(share) = &gauge.gauge_percent {
        number("%GRR", share, of_hundred);
    }
    if let Some(categories) = &gauge.distinct_categories {
        number("Distinct categories", categories, |count| fixed(count, 0));
    }
    let has = |source| gauge.rows.iter().any(|row| row.source == source);
    if let Some(p) = gauge.interaction_probability {
        let done = match has(VarianceSource::Interaction) {
            true => "is part of the reproducibility",
            false => "is not significant and counts as repeatability",
        };
        out.push_str(&format!(
            "The interaction of part and {by} (p = {p:.3}) {done}.\n"
        ));
    }
    let spreads = [
        Some(&gauge.repeatability),
        gauge.reproducibility.as_ref(),
        gauge.part_to_part.as_ref(),
    ];
    let few = spreads
        .into_iter()
        .flatten()
        .filter_map(|s| s.note.as_ref());
    for note in few.chain(&gauge.notes) {
        out.push_str(&format!("Note: {note}\n"));
    }
}

/// The answer in one line.
fn answer(found: &Repeatability, title: &str, unit: &str) -> String {
    let Some(scatter) = &found.scatter else {
        return String::new();
    };
    let word = match scatter.verdict {
        Some(ScatterVerdict::Consistent) => "the scatter is consistent with the stated uncertainty",
        Some(ScatterVerdict::TooLarge) => "the scatter is too large for the stated uncertainty",
        Some(ScatterVerdict::Small) => "the scatter is smaller than the stated uncertainty",
        None => "a stated uncertainty of zero cannot be tested",
    };
    let ratio = scatter.ratio.map_or(String::new(), |ratio| {
        format!(", s/u = {}", significant(ratio))
    });
    format!(
        "{title}: s = {}{unit}{ratio}: {word}\n",
        significant(scatter.std)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comparison::tests::result;
    use crate::fit::uncertainty::budget::Budget;
    use crate::repeatability::study;

    #[test]
    fn the_text_states_scatter_components_and_the_answer_last() {
        let errors = [0.01, -0.02, 0.03, 0.0, -0.01, 0.02, 0.0, -0.03];
        let of = |i: usize| {
            let budget = Budget {
                counting: 0.02,
                ..Budget::default()
            };
            let mut result = result(i as i64 + 1, 10.0 + (i / 4) as f64 + errors[i], budget);
            result.of.sample_id = i as i64 / 4;
            result.of.operator_name = Some(["anna", "ben"][i / 2 % 2].into());
            result
        };
        let found = study(
            (0..8).map(of).collect(),
            Vec::new(),
            &StudyChoice::default(),
        );
        let text = text(&found);
        for part in [
            "| 1 | B-17 | 2026-03-01 09:00:00 UTC | anna | 10.010 ± 0.040° |",
            "Gauge R&R: 2 parts, 2 operators",
            "| reproducibility (operators) |",
            "%GRR: 3.3 %",
            "Note: 2 operators are too few for an interval",
            "Distinct categories: ",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let last = text.lines().last().unwrap();
        assert!(last.starts_with("θr ridge angle: s = 0.0"), "{last}");
        assert!(
            last.ends_with("consistent with the stated uncertainty"),
            "{last}"
        );
    }

    #[test]
    fn groups_are_operators_or_days() {
        let parsed = super::super::parsed::<Args>(&["1", "2", "--by", "day"]);
        assert_eq!(
            (parsed.by, parsed.scans),
            (Some(GroupedBy::Day), vec![1, 2])
        );
        assert!(super::super::try_parsed::<Args>(&["1", "--by", "week"]).is_err());
    }
}
