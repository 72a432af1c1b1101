//! Prints the result of a fit as a table; call [`table`].

use super::Interval;
use super::{FitReport, Parameter, ReferencePlane, Status};
use crate::fit::causes::findings::{Code, Finding};
use crate::fit::joint::{EACH_ITS_OWN, JointReport};
use crate::fit::uncertainty::budget::Budget;
use crate::fit::uncertainty::coverage::{COVERAGE_FACTOR, other_factor};
use crate::model::left_out::LeftOut;
use crate::wording::layout::{width, wrapped};
use crate::wording::names::{self, QuantityName};
use crate::wording::{counted, decimals, factor, fixed, percent, significant, stated};

/// Prose is hard to read in wider lines.
const PROSE_COLUMNS: usize = 100;

/// How a result is printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Form {
    /// Whether ANSI attributes are allowed.
    pub colour: bool,
    /// Columns of the terminal, at least 60.
    pub columns: usize,
    /// Only the parameters, without what they are based on.
    pub brief: bool,
}

impl Form {
    /// For a file or another program.
    pub const PLAIN: Form = Form {
        colour: false,
        columns: 100,
        brief: false,
    };

    fn paint(&self, text: &str, code: &str) -> String {
        match self.colour {
            true => format!("\u{1b}[{code}m{text}\u{1b}[0m"),
            false => text.to_owned(),
        }
    }
}

/// Returns the report as text: parameters, what they are based on, and the ridge angle once more as the last line.
#[must_use]
pub fn table(report: &FitReport, form: &Form) -> String {
    let mut out = parameters(report, form);
    if form.brief {
        return out;
    }
    let mut rest = String::new();
    basis(report, form, &mut rest);
    out.push_str(&wrapped(&rest, form.columns.min(PROSE_COLUMNS)));
    line(&mut out, "");
    line(&mut out, &answer(report, form));
    out
}

/// Returns the ridge angle in one line, without colour.
#[must_use]
pub fn in_one_line(report: &FitReport) -> String {
    let region = report.region.as_ref();
    let region = region.map_or_else(String::new, |region| format!("region {region}, "));
    format!("{region}{}", answer(report, &Form::PLAIN))
}

/// Returns the ridge angle in one line.
fn answer(report: &FitReport, form: &Form) -> String {
    let angle = &report.parameters.theta_r_deg;
    let word = status_word(report.status);
    match (angle.value, angle.expanded) {
        (Some(_), Some(_)) => {
            let value = with_uncertainty(angle.value, angle.expanded);
            let k = factor(angle.coverage_factor.unwrap_or(COVERAGE_FACTOR));
            let value = form.paint(&format!("θr = {value}"), "1");
            format!("{value} (k = {k}), {word}")
        }
        (Some(fixed), None) => format!("θr = {}° (fixed), {word}", stated(fixed)),
        _ => format!("θr is not determined, {word}"),
    }
}

fn parameters(report: &FitReport, form: &Form) -> String {
    let paint = |text: &str, code: &str| form.paint(text, code);
    let mut out = String::new();
    let word = status_word(report.status);
    let status = if report.status == Status::Converged {
        paint(word, "32")
    } else {
        paint(word, "33")
    };
    let region = report
        .region
        .as_ref()
        .map_or_else(String::new, |r| format!(" · region {r}"));
    let frames = match report.n_frames_used as usize {
        n if n == report.n_observations => String::new(),
        n => format!(" from {}", counted(n, "frame")),
    };
    line(
        &mut out,
        &format!(
            "{} · {status}{region} · {}{frames}",
            paint(&format!("variant {}", report.variant), "1"),
            counted(report.n_observations, "observation"),
        ),
    );
    line(&mut out, "");
    if form.columns >= ROW_COLUMNS {
        let heading = format!("  {:<26}{:>10}   {:<12}", "", "value", "± U (k = 2)");
        let parts = "u (k = 1), largest parts";
        let has_room = width(&heading) + 1 + width(parts) <= form.columns;
        let parts = if has_room { parts } else { "" };
        line(&mut out, &format!("{heading} {parts}"));
    }
    for (name, parameter) in report.parameters.named() {
        line(
            &mut out,
            &row(names::quantity(name), parameter, form.columns),
        );
    }
    out
}

/// Adds what the parameters are based on.
fn basis(report: &FitReport, form: &Form, out: &mut String) {
    line(out, "");
    agreement(report, out);
    sections(report, form, out);
}

/// Adds how well the model describes the data, and which shape and plane it refers to.
fn agreement(report: &FitReport, out: &mut String) {
    if let (Some(rms), Some(reduced), Some(alone)) = (
        report.rms_residual,
        report.chi2_reduced,
        report.chi2_reduced_without_model,
    ) {
        line(
            out,
            &format!(
                "  RMS residual {} of the peak. Reduced χ² {} with the model-error term, {} with counting noise only.",
                percent(rms),
                significant(reduced),
                significant(alone)
            ),
        );
    }
    line(out, plane(report.reference_plane));
    if let Some(message) = report.wedge_across.and_then(|across| across.message()) {
        line(out, &format!("  {message}"));
    }
    let variants: Vec<String> = report
        .variants
        .iter()
        .map(|v| format!("{} {}", v.variant, percent(v.rms_residual)))
        .collect();
    if !variants.is_empty() {
        line(
            out,
            &format!("  RMS residual by variant: {}", variants.join(", ")),
        );
    }
    if let Some(map) = report.tracer.and_then(|t| t.height_map) {
        line(
            out,
            &format!(
                "  height map: {} ridges, period {:.4} µm, height {:.3} µm, azimuth of the lean {:.2}° from the rows, \
                 effective ridge angle {:.2}°, unevenness along the ridges {:.3} µm (rms)",
                map.ridges,
                map.period_um,
                map.height_um,
                map.lean_azimuth_deg,
                map.theta_r_deg,
                map.unevenness_um
            ),
        );
    }
    if report.tracer.is_some_and(|t| t.profile_turned) {
        line(
            out,
            "  profile reversed: as measured, its longer flanks (the facets) lean to −v",
        );
    }
}

/// Adds the lists: what is not determined, intervals, findings, warnings, notes, and what was left out.
fn sections(report: &FitReport, form: &Form, out: &mut String) {
    let named = || report.parameters.named().into_iter();
    let unknown = named().filter(|(_, p)| p.value.is_none());
    let unknown = unknown.filter_map(|(name, p)| {
        // The rows of the scans show what each scan has of its own.
        let note = p.note.as_deref().filter(|note| *note != EACH_ITS_OWN)?;
        Some(format!("{}: {note}", names::quantity(name).full()))
    });
    let intervals = named().filter_map(|(name, p)| intervals(name, p));
    let lists = [
        ("not determined by these data", unknown.collect()),
        ("intervals (independent errors only)", intervals.collect()),
        ("findings", report.findings.iter().map(finding).collect()),
        ("warnings", report.warnings.clone()),
        ("notes", report.notes.clone()),
        ("left out", report.left_out.iter().map(left_out).collect()),
        ("frames rejected", rejected(report)),
    ];
    for (title, entries) in lists {
        let entries: Vec<String> = entries;
        if entries.is_empty() {
            continue;
        }
        line(out, &format!("\n{}", form.paint(title, "1")));
        for entry in entries {
            line(out, &format!("  · {entry}"));
        }
    }
}

fn finding(f: &Finding) -> String {
    let moves = f.change_of_theta_r_deg.map_or_else(String::new, |change| {
        // The index never joins the fit, because it has a certificate.
        let changes = match f.code {
            Code::Index => "would change",
            _ => "changes",
        };
        format!(", {changes} θr by {change:+.3}°")
    });
    format!(
        "{} explains {} of χ²{moves}: {}",
        f.code.word(),
        percent(f.explains),
        f.advice
    )
}

fn left_out(l: &LeftOut) -> String {
    let cost = l.cost.map_or_else(
        || "effect unknown".to_owned(),
        |c| format!("effect ≤ {} of the peak", percent(c)),
    );
    format!("{}: {} ({cost})", l.what, l.why)
}

/// States what the angles refer to.
fn plane(plane: ReferencePlane) -> &'static str {
    match plane {
        ReferencePlane::Turntable => {
            "  θr and azimuth refer to the turntable: rig.sample_wedge_std_deg is not set"
        }
        ReferencePlane::Sample => {
            "  θr and azimuth refer to the plane of the sample: U includes the stated sample tilt"
        }
    }
}

/// Prints the common surface of several scans, then one row per scan.
#[must_use]
pub fn joint(report: &JointReport, form: &Form) -> String {
    let mut out = table(&report.report, form);
    if form.brief {
        return out;
    }
    line(&mut out, "");
    line(
        &mut out,
        &format!(
            "  {:<28}{:>17}{:>17}{:>17}{:>10}",
            "scan, ± U (k = 2)", "own θr", "azimuth offset", "tilt offset", "residual"
        ),
    );
    for scan in &report.scans {
        let own = &scan.report.parameters;
        line(
            &mut out,
            &format!(
                "  {:<28}{:>17}{:>17}{:>17}{:>10}",
                scan.name,
                with_uncertainty(
                    scan.theta_r_alone_deg,
                    scan.theta_r_alone_std.map(|std| COVERAGE_FACTOR * std)
                ),
                offset(&own.azimuth_offset_deg),
                offset(&own.tilt_offset_deg),
                scan.report
                    .rms_residual
                    .map_or_else(|| "–".to_owned(), percent)
            ),
        );
        let offsets = [
            ("azimuth offset", &own.azimuth_offset_deg),
            ("tilt offset", &own.tilt_offset_deg),
        ];
        for (name, offset) in offsets {
            if let Some(factor) = other_factor(offset.coverage_factor) {
                line(&mut out, &format!("  {:<28}{name}: {factor}", ""));
            }
        }
    }
    out
}

fn offset(of: &Parameter) -> String {
    with_uncertainty(of.value, of.expanded)
}

/// Formats degrees with their expanded uncertainty, if there is one.
fn with_uncertainty(value: Option<f64>, expanded: Option<f64>) -> String {
    match (value, expanded.filter(|e| e.is_finite() && *e > 0.0)) {
        (Some(value), Some(expanded)) => {
            let decimals = decimals(expanded);
            format!("{} ± {expanded:.decimals$}°", fixed(value, decimals))
        }
        (Some(value), None) => format!("{value:.3}°"),
        (None, _) => "–".to_owned(),
    }
}

fn line(out: &mut String, text: &str) {
    out.push_str(text.trim_end());
    out.push('\n');
}

/// Counts rejected frames by reason, so that a hundred saturated frames take one line.
fn rejected(report: &FitReport) -> Vec<String> {
    let mut reasons: Vec<&str> = report
        .rejected_frames
        .iter()
        .map(|f| f.reason.as_str())
        .collect();
    reasons.sort_unstable();
    reasons.dedup();
    reasons
        .into_iter()
        .map(|reason| {
            let files: Vec<&str> = report
                .rejected_frames
                .iter()
                .filter(|f| f.reason == reason)
                .map(|f| f.file.as_str())
                .collect();
            match files.as_slice() {
                [one] => format!("{reason}: {one}"),
                many => format!("{reason}: {} frames, first {}", many.len(), many[0]),
            }
        })
        .collect()
}

fn row(name: QuantityName, p: &Parameter, columns: usize) -> String {
    let (label, unit) = (format!("{:<4}{}", name.symbol, name.name), name.unit);
    if columns < ROW_COLUMNS {
        return narrow_row(&label, unit, p);
    }
    match (p.value, p.expanded, p.std, &p.budget) {
        (Some(value), Some(expanded), Some(std), Some(budget)) => {
            let decimals = decimals(expanded);
            let expanded = format!("{expanded:.decimals$}{unit}");
            let factor = other_factor(p.coverage_factor);
            let factor = factor.map_or_else(String::new, |k| format!("{k}; "));
            let value = fixed(value, decimals);
            let row = format!("  {label:<26}{value:>10} ± {expanded:<12} {factor}");
            let room = columns.saturating_sub(width(&row));
            format!("{row}{}", parts(budget, std, room))
        }
        (Some(value), None, ..) => {
            let decimals = decimals(1e-2 * value.abs());
            format!("  {label:<26}{:>10}{unit} held", fixed(value, decimals))
        }
        _ => format!("  {label:<26}{:>10}", "–"),
    }
}

/// Columns of a row without the parts of its uncertainty.
const ROW_COLUMNS: usize = 56;

/// Formats a row for a terminal that is narrower than the columns: the name, and the value below it.
fn narrow_row(label: &str, unit: &str, p: &Parameter) -> String {
    let value = match (p.value, p.expanded) {
        (Some(value), Some(expanded)) => {
            let decimals = decimals(expanded);
            let k = factor(p.coverage_factor.unwrap_or(COVERAGE_FACTOR));
            format!(
                "{} ± {expanded:.decimals$}{unit} (k = {k})",
                fixed(value, decimals)
            )
        }
        (Some(value), None) => {
            format!("{}{unit} held", fixed(value, decimals(1e-2 * value.abs())))
        }
        _ => "–".to_owned(),
    };
    format!("  {label}\n      {value}")
}

/// Lists the parts that make up nine tenths of the variance, largest first, as far as there is room.
fn parts(budget: &Budget, std: f64, room: usize) -> String {
    let mut all = budget.named();
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut text = String::new();
    let mut variance = 0.0;
    for (name, part) in all {
        if variance >= 0.9 * std * std || part == 0.0 {
            break;
        }
        variance += part * part;
        let comma = if text.is_empty() { "" } else { ", " };
        let decimals = decimals(part);
        let next = format!("{comma}{name} {part:.decimals$}");
        if !text.is_empty() && width(&text) + width(&next) > room {
            break;
        }
        text.push_str(&next);
    }
    text
}

/// Formats the profile and bootstrap intervals of one parameter in one line.
fn intervals(name: &'static str, p: &Parameter) -> Option<String> {
    let name = names::quantity(name);
    let (label, unit) = (name.full(), name.unit);
    let decimals = p.std.map_or(4, decimals) + 1;
    let end =
        |x: Option<f64>| x.map_or_else(|| "open".to_owned(), |x| format!("{x:.decimals$}{unit}"));
    let one = |word: &str, i: &Interval| format!("{word} {} … {}", end(i.lower), end(i.upper));
    let parts: Vec<String> = [("profile", &p.profile), ("bootstrap", &p.bootstrap)]
        .into_iter()
        .filter_map(|(word, i)| i.as_ref().map(|i| one(word, i)))
        .collect();
    (!parts.is_empty()).then(|| format!("{label}: {}", parts.join(", ")))
}

fn status_word(status: Status) -> &'static str {
    match status {
        Status::Converged => "converged",
        Status::AtBound => "at a bound",
        Status::RankDeficient => "rank-deficient",
        Status::Stalled => "stalled",
        Status::NotFinite => "not finite",
        Status::TooFewObservations => "too few observations",
        Status::Cancelled => "cancelled",
    }
}

#[cfg(test)]
#[path = "text_tests.rs"]
mod tests;
