//! `ridged chart`: the control chart of results of the store.

use std::path::PathBuf;
use std::sync::Arc;

use super::result_filters::FilterArgs;
use super::{CliError, due, output, runtime};
use crate::chart::{ChartPoint, ChartRun, ControlLimits};
use crate::clock::{Clock as _, SystemClock};
use crate::lab::{self, ChartChoice, ChartedSpecification, GuardBasis, ResultChart};
use crate::repeatability::PARAMETER;
use crate::store::Store;
use crate::store::disk::RealDisk;
use crate::store::results::ResultQuery;
use crate::wording::{counted, decimals, fixed, names, percent, significant, stated, utc_words};

/// Points of the table; the figures have all of them.
const ROWS_SHOWN: usize = 100;
/// With fewer values the control limits themselves are uncertain.
const FEW: usize = 20;

/// Charts a parameter over the newest 1000 results: individual values and moving ranges (I-MR) with mean ± 3 s, values beyond
/// them, runs of eight on one side of the mean, the limits of a specification, and what is due.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged chart --part CS-1                               the check standard
  ridged chart --specification \"drawing 4711\"            with the limits of this specification
  ridged chart --lot L7 --parameter alpha_u --limits-of \"drawing 4711\"
  ridged chart --part CS-1 --config rig.toml --json      also what is due by the settings
docs/how-to/results.md explains the chart. `--filter` takes the columns of docs/reference/results.md, as for `ridged results`.")]
pub struct Args {
    /// Key of the parameter.
    #[arg(long, value_name = "KEY", default_value = PARAMETER)]
    pub parameter: String,
    /// Specification whose limits are beside the chart; empty for none [default: that of --specification, or the only one of
    /// the verdicts].
    #[arg(long, value_name = "NAME")]
    pub limits_of: Option<String>,
    /// Which results.
    #[command(flatten)]
    pub filters: FilterArgs,
    /// One JSON object on stdout.
    #[arg(long)]
    pub json: bool,
    /// Settings of the rig (TOML), which state what is due.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Data folder [default: ridged-data].
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
}

/// Runs the command, also beside a running daemon.
///
/// # Errors
/// Bad input for settings that cannot be read, a folder without a store, a filter, parameter or specification that is not
/// valid.
pub fn run(args: Args) -> Result<(), CliError> {
    let config = runtime::read_config(args.config.as_deref())?;
    let filters = args.filters.parameters()?;
    let choice = ChartChoice {
        filters: ResultQuery::read_filters(filters).map_err(CliError::bad_input)?,
        parameter: args.parameter,
        limits_of: args.limits_of,
    };
    let data = args.data.unwrap_or(config.store.folder);
    let found = runtime::block_on(async {
        let store = Store::open_for_reading(&data, Arc::new(RealDisk), runtime::real_clock()).await;
        let store = store.map_err(|error| runtime::lab_error(error.into()))?;
        let now = SystemClock::new().utc();
        let found = lab::chart(&store, &choice, &config.due, now).await;
        store.close().await;
        found.map_err(runtime::lab_error)
    })?;
    output::write(args.json, &found, || text(&found))
}

/// How the numbers of a chart are written.
#[derive(Clone, Copy)]
struct Form {
    unit: &'static str,
    decimals: usize,
}

impl Form {
    /// Two digits of s, or of the median u where all values are equal.
    fn of(found: &ResultChart) -> Form {
        let limits = found.chart.limits.filter(|limits| limits.s > 0.0);
        let scale = limits.map(|limits| limits.s);
        let mut all: Vec<f64> = found.chart.points.iter().map(|point| point.std).collect();
        let scale = scale.or_else(|| crate::robust::median(&mut all));
        Form {
            unit: names::known(&found.parameter).map_or("", |name| name.unit),
            decimals: decimals(scale.unwrap_or_default()),
        }
    }

    fn text(self, value: f64) -> String {
        format!("{}{}", fixed(value, self.decimals), self.unit)
    }

    /// A value as it was stated.
    fn stated(self, value: f64) -> String {
        format!("{}{}", stated(value), self.unit)
    }
}

fn text(found: &ResultChart) -> String {
    let form = Form::of(found);
    let name = names::known(&found.parameter);
    let title = name.map_or_else(|| found.parameter.clone(), |name| name.full());
    let mut out = String::new();
    if !found.chart.points.is_empty() {
        table(&mut out, &found.chart.points, form);
    }
    if let Some(limits) = &found.chart.limits {
        limits_text(&mut out, limits, form);
    }
    if let Some(specification) = &found.specification {
        specification_text(&mut out, specification, &title, form);
    }
    notes(&mut out, found, &title);
    let signals = signals(found, form);
    if !signals.is_empty() {
        out.push('\n');
        signals.iter().for_each(|line| line_of(&mut out, line));
    }
    if !found.due.is_empty() {
        out.push('\n');
    }
    for item in &found.due {
        line_of(&mut out, &first_upper(&due::words(item)));
        if item.is_due {
            line_of(&mut out, &first_upper(&due::advice(item)));
        }
    }
    if !out.is_empty() {
        out.push('\n');
    }
    line_of(&mut out, &answer(found, &title, signals.len(), form));
    out
}

fn line_of(out: &mut String, line: &str) {
    out.push_str(line);
    out.push('\n');
}

fn first_upper(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(|c| c.to_uppercase().to_string());
    format!("{}{}", first.unwrap_or_default(), letters.as_str())
}

fn table(out: &mut String, points: &[ChartPoint], form: Form) {
    out.push_str("| scan | part | when | value ± U | k | moving range | signal | verdict |\n");
    out.push_str("|---|---|---|---|---|---|---|---|\n");
    for point in &points[points.len().saturating_sub(ROWS_SHOWN)..] {
        let digits = decimals(point.expanded);
        let part = match &point.of.region {
            Some(region) => format!("{} {region}", point.of.part),
            None => point.of.part.clone(),
        };
        let signal = match (point.beyond, point.in_run) {
            (true, true) => "beyond 3 s, run",
            (true, false) => "beyond 3 s",
            (false, true) => "run",
            (false, false) => "",
        };
        let range = point.moving_range.map(|range| form.text(range));
        out.push_str(&format!(
            "| {} | {part} | {} | {} ± {}{} | {} | {} | {signal} | {} |\n",
            point.of.scan_id,
            utc_words(&point.of.created_at),
            fixed(point.value, digits),
            fixed(point.expanded, digits),
            form.unit,
            fixed(point.coverage_factor, 2),
            range.unwrap_or_default(),
            point.of.verdict.as_deref().unwrap_or(""),
        ));
    }
    out.push('\n');
}

fn limits_text(out: &mut String, limits: &ControlLimits, form: Form) {
    let s = format!("{}{}", significant(limits.s), form.unit);
    let lines = [
        format!(
            "Mean of {}: {}",
            counted(limits.n, "value"),
            form.text(limits.mean)
        ),
        format!("s (mean moving range / 1.128): {s}"),
        format!(
            "Control limits, mean ± 3 s: {} to {}",
            form.text(limits.lower),
            form.text(limits.upper)
        ),
        format!(
            "Moving range: mean {}, limit {}",
            form.text(limits.mean_range),
            form.text(limits.range_limit)
        ),
    ];
    lines.iter().for_each(|line| line_of(out, line));
}

/// Writes a range: `9.5° to 10.5°`, `at least 9.5°`.
fn range(lower: Option<f64>, upper: Option<f64>, number: impl Fn(f64) -> String) -> Option<String> {
    match (lower, upper) {
        (None, None) => None,
        (Some(lower), None) => Some(format!("at least {}", number(lower))),
        (None, Some(upper)) => Some(format!("at most {}", number(upper))),
        (Some(lower), Some(upper)) => Some(format!("{} to {}", number(lower), number(upper))),
    }
}

fn specification_text(out: &mut String, of: &ChartedSpecification, title: &str, form: Form) {
    let Some(limits) = range(of.lower, of.upper, |x| form.stated(x)) else {
        return line_of(out, &format!("{} has no limits of {title}.", of.name));
    };
    line_of(out, &format!("Limits of {}: {limits}", of.name));
    let Some(guard_band) = of.guard_band else {
        return;
    };
    let digits = decimals(guard_band);
    let number = |x: f64| format!("{}{}", fixed(x, digits), form.unit);
    let within = range(of.acceptance_lower, of.acceptance_upper, number);
    let within = within.unwrap_or_else(|| "no value: the guard bands meet".to_owned());
    let basis = match (of.guard_basis, of.verdict_id) {
        (Some(GuardBasis::Verdict), Some(id)) => format!("guard band of verdict {id}"),
        _ => format!("risk {}, median u", percent(of.max_false_accept_risk)),
    };
    line_of(out, &format!("Accepted within ({basis}): {within}"));
}

fn notes(out: &mut String, found: &ResultChart, title: &str) {
    let n = found.chart.points.len();
    let read = n + found.omitted;
    let mut note = |text: String| line_of(out, &format!("Note: {text}"));
    if found.chart.limits.is_some() && n < FEW {
        note(format!(
            "with fewer than {FEW} values the control limits are uncertain"
        ));
    }
    if n > ROWS_SHOWN {
        note(format!(
            "the table has the newest {ROWS_SHOWN} of {n} values; --json has all of them"
        ));
    }
    if found.omitted > 0 {
        note(format!(
            "{} without a converged fit that determines {title}",
            counted(found.omitted, "result")
        ));
    }
    if usize::try_from(found.count).is_ok_and(|count| count > read) {
        note(format!(
            "the newest {read} of {} results are charted",
            found.count
        ));
    }
}

/// Returns the signals as sentences, the newest first.
fn signals(found: &ResultChart, form: Form) -> Vec<String> {
    let Some(limits) = &found.chart.limits else {
        return Vec::new();
    };
    let points = &found.chart.points;
    let beyond = points.iter().enumerate().filter(|(_, point)| point.beyond);
    let beyond = beyond.map(|(at, point)| (at, beyond_text(point, limits, form)));
    let runs = found
        .chart
        .runs
        .iter()
        .map(|run| (run.last, run_text(run, points)));
    let mut all: Vec<(usize, String)> = beyond.chain(runs).collect();
    all.sort_by_key(|(at, _)| std::cmp::Reverse(*at));
    all.into_iter().map(|(_, text)| text).collect()
}

fn beyond_text(point: &ChartPoint, limits: &ControlLimits, form: Form) -> String {
    let (side, limit, sign) = match point.value > limits.upper {
        true => ("above", limits.upper, '+'),
        false => ("below", limits.lower, '−'),
    };
    format!(
        "Scan {}: {} is {side} the control limit {} (mean {sign} 3 s).",
        point.of.scan_id,
        form.text(point.value),
        form.text(limit)
    )
}

fn run_text(run: &ChartRun, points: &[ChartPoint]) -> String {
    let scan = |at: usize| points.get(at).map_or(0, |point| point.of.scan_id);
    format!(
        "Scans {} to {}: {} values in a row {} the mean.",
        scan(run.first),
        scan(run.last),
        run.last - run.first + 1,
        if run.is_above { "above" } else { "below" }
    )
}

/// The answer in one line.
fn answer(found: &ResultChart, title: &str, signals: usize, form: Form) -> String {
    let Some(limits) = &found.chart.limits else {
        let why = match found.chart.points.len() {
            0 => "no value",
            _ => "one value has no control limits",
        };
        return format!("{title}: {why}; `ridged chart --help` shows the filters");
    };
    let words = match signals {
        0 => "no signal".to_owned(),
        n => format!(
            "{}: look for a cause in rig, reference, operator or parts",
            counted(n, "signal")
        ),
    };
    format!(
        "{title}: mean {}, control limits {} to {}: {words}",
        form.text(limits.mean),
        form.text(limits.lower),
        form.text(limits.upper)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::tests::chart_of;
    use crate::lab::{Due, DueKind};

    fn found(values: &[f64]) -> ResultChart {
        let chart = chart_of(values);
        ResultChart {
            parameter: "theta_r_deg".into(),
            omitted: 2,
            count: 2 + values.len() as i64,
            chart,
            specification: Some(ChartedSpecification {
                name: "drawing 4711".into(),
                lower: Some(9.5),
                upper: None,
                guard_band: Some(0.2),
                acceptance_lower: Some(9.7),
                acceptance_upper: None,
                guard_basis: Some(GuardBasis::Verdict),
                verdict_id: Some(3),
                max_false_accept_risk: 0.025,
                limited: vec!["theta_r_deg".into()],
            }),
            due: vec![Due {
                what: DueKind::CheckStandard,
                part: Some("CS-1".into()),
                last_at: None,
                due_at: None,
                is_due: true,
            }],
        }
    }

    #[test]
    fn the_text_has_values_limits_signals_and_the_answer_last() {
        let mut values = [10.0, 10.02].repeat(10);
        values[15] = 10.5;
        let text = text(&found(&values));
        for part in [
            "| 16 | B-17 | 2026-03-01 09:00:00 UTC | 10.50 ± 0.25° | 2.50 | 0.500° | beyond 3 s |",
            "| 1 | B-17 | 2026-03-01 09:00:00 UTC | 10.00 ± 0.25° | 2.50 |  | run |",
            "Mean of 20 values: 10.034°",
            "Limits of drawing 4711: at least 9.5°",
            "Accepted within (guard band of verdict 3): at least 9.70°",
            "2 results without a converged fit",
            "Scan 16: 10.500° is above the control limit 10.2",
            "Scans 1 to 15: 15 values in a row below the mean.",
            "Check standard CS-1: never measured, due now",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("uncertain"), "{text}");
        let last = text.lines().last().unwrap();
        assert!(
            last.starts_with("θr ridge angle: mean 10.034°, control limits "),
            "{last}"
        );
        assert!(last.contains(": 2 signals: look for a cause"), "{last}");
        // The newest signal comes first.
        assert!(text.find("Scan 16:") < text.find("Scans 1 to 15"));
    }

    #[test]
    fn a_chart_without_signals_or_values_states_that() {
        let calm = text(&found(&[10.0, 10.1, 9.9, 10.0]));
        assert!(calm.trim_end().ends_with(": no signal"), "{calm}");
        assert!(calm.contains("fewer than 20 values"), "{calm}");
        let one = text(&found(&[10.0]));
        assert!(one.contains("one value has no control limits"), "{one}");
        let none = text(&found(&[]));
        assert!(none.contains("θr ridge angle: no value"), "{none}");
    }

    #[test]
    fn specifications_without_limits_and_guard_bands_that_meet_are_stated() {
        let mut chart = found(&[10.0, 10.1]);
        let of = chart.specification.as_mut().unwrap();
        (of.upper, of.acceptance_lower, of.guard_basis) = (Some(9.6), None, None);
        let meet = text(&chart);
        assert!(
            meet.contains("Accepted within (risk 2.5 %, median u): no value: the guard bands meet"),
            "{meet}"
        );
        let of = chart.specification.as_mut().unwrap();
        (of.lower, of.upper) = (None, None);
        let none = text(&chart);
        assert!(
            none.contains("drawing 4711 has no limits of θr ridge angle."),
            "{none}"
        );
    }

    #[test]
    fn the_filters_are_those_of_results() {
        let parsed = super::super::parsed::<Args>(&[
            "--part",
            "CS-1",
            "--latest",
            "--specification",
            "drawing 4711",
            "--filter",
            "alpha_u_max=0.2",
        ]);
        let parameters = parsed.filters.parameters().unwrap();
        let read = ResultQuery::read_filters(parameters).unwrap();
        let same = [
            ("part", "CS-1"),
            ("latest", "true"),
            ("specification", "drawing 4711"),
            ("alpha_u_max", "0.2"),
        ];
        let same = ResultQuery::read_filters(same).unwrap();
        assert_eq!(read.only_text("part"), Some("CS-1"));
        assert_eq!(
            read.only_text("specification"),
            same.only_text("specification")
        );
        assert_eq!(parsed.parameter, "theta_r_deg");
        let page = super::super::parsed::<Args>(&["--filter", "limit=5"]);
        assert!(page.filters.parameters().is_err());
    }
}
