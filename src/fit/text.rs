//! Prints the result of a fit as a table; call [`table`].

use std::fmt::Write as _;

use super::budget::Budget;
use super::intervals::Interval;
use super::joint::{EACH_ITS_OWN, JointReport};
use super::report::{COVERAGE_FACTOR, FitReport, Parameter, ReferencePlane, Status};
use crate::wording::{counted, decimals, percent, significant};

/// Lays out the report for a terminal of at least 80 columns. `colour` allows ANSI attributes.
#[must_use]
pub fn table(report: &FitReport, colour: bool) -> String {
    let paint = |text: &str, code: &str| {
        if colour {
            format!("\u{1b}[{code}m{text}\u{1b}[0m")
        } else {
            text.to_owned()
        }
    };
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
    line(
        &mut out,
        &format!(
            "{} · {status}{region} · {} from {}",
            paint(&format!("variant {}", report.variant), "1"),
            counted(report.n_observations, "observation"),
            counted(report.n_frames_used as usize, "frame")
        ),
    );
    line(&mut out, "");
    line(
        &mut out,
        &format!(
            "  {:<25}{:>10}   {:<10} {:<2} {}",
            "", "value", "± (k = 2)", "", "standard uncertainty, largest parts"
        ),
    );
    for (name, parameter) in report.parameters.named() {
        let (label, unit) = spoken(name);
        line(&mut out, &row(label, unit, parameter));
    }
    line(&mut out, "");
    if let (Some(rms), Some(reduced), Some(alone)) = (
        report.rms_residual,
        report.chi2_reduced,
        report.chi2_reduced_without_model,
    ) {
        line(
            &mut out,
            &format!(
                "  RMS residual {} of the peak. Reduced χ² {} with the model-error term, {} with counting noise only.",
                percent(rms),
                significant(reduced),
                significant(alone)
            ),
        );
    }
    line(&mut out, plane(report.reference_plane));
    if let Some(message) = report.wedge_across.and_then(|across| across.message()) {
        for part in wrapped(&message, 94) {
            line(&mut out, &format!("  {part}"));
        }
    }
    let variants: Vec<String> = report
        .variants
        .iter()
        .map(|v| format!("{} {}", v.variant, percent(v.rms_residual)))
        .collect();
    if !variants.is_empty() {
        line(
            &mut out,
            &format!("  RMS residual by variant: {}", variants.join(", ")),
        );
    }
    if let Some(map) = report.tracer.and_then(|t| t.height_map) {
        line(
            &mut out,
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
            &mut out,
            "  profile reversed: as measured, its longer flanks (the facets) lean to −v",
        );
    }
    let unknown: Vec<(&str, &str)> = report
        .parameters
        .named()
        .into_iter()
        .filter(|(_, p)| p.value.is_none())
        .filter_map(|(name, p)| p.note.as_deref().map(|note| (spoken(name).0, note)))
        // The rows of the scans show what each scan has of its own.
        .filter(|(_, note)| *note != EACH_ITS_OWN)
        .collect();
    section(
        &mut out,
        &paint("not determined by these data", "1"),
        unknown.iter().map(|(l, n)| format!("{l}: {n}")),
    );
    section(
        &mut out,
        &paint("intervals (independent errors only)", "1"),
        report
            .parameters
            .named()
            .into_iter()
            .filter_map(|(name, p)| intervals(name, p)),
    );
    section(
        &mut out,
        &paint("findings", "1"),
        report.findings.iter().map(|f| {
            let moves = f.change_of_theta_r_deg.map_or_else(String::new, |change| {
                format!(", changes θr by {change:+.3}°")
            });
            format!(
                "{} explains {} of χ²{moves}: {}",
                f.code.word(),
                percent(f.explains),
                f.advice
            )
        }),
    );
    section(
        &mut out,
        &paint("warnings", "1"),
        report.warnings.iter().cloned(),
    );
    section(&mut out, &paint("notes", "1"), report.notes.iter().cloned());
    section(
        &mut out,
        &paint("left out", "1"),
        report.left_out.iter().map(|l| {
            let cost = l.cost.map_or_else(
                || "effect unknown".to_owned(),
                |c| format!("effect ≤ {} of the peak", percent(c)),
            );
            format!("{}: {} ({cost})", l.what, l.why)
        }),
    );
    section(
        &mut out,
        &paint("frames rejected", "1"),
        rejected(report).into_iter(),
    );
    out
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
pub fn joint(report: &JointReport, colour: bool) -> String {
    let mut out = table(&report.report, colour);
    line(&mut out, "");
    line(
        &mut out,
        &format!(
            "  {:<28}{:>17}{:>17}{:>17}{:>10}",
            "scan, ± (k = 2)", "own θr", "azimuth offset", "tilt offset", "residual"
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
            format!("{value:.decimals$} ± {expanded:.decimals$}°")
        }
        (Some(value), None) => format!("{value:.3}°"),
        (None, _) => "–".to_owned(),
    }
}

fn line(out: &mut String, text: &str) {
    out.push_str(text.trim_end());
    out.push('\n');
}

fn section(out: &mut String, title: &str, entries: impl Iterator<Item = String>) {
    let mut entries = entries.peekable();
    if entries.peek().is_none() {
        return;
    }
    line(out, &format!("\n{title}"));
    for entry in entries {
        for (k, part) in wrapped(&entry, 94).iter().enumerate() {
            line(out, &format!("  {} {part}", if k == 0 { "·" } else { " " }));
        }
    }
}

/// Breaks a text between words into lines of at most `width` characters.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.last_mut().expect("never empty");
        if !last.is_empty() && last.chars().count() + 1 + word.chars().count() > width {
            lines.push(word.to_owned());
        } else {
            if !last.is_empty() {
                last.push(' ');
            }
            last.push_str(word);
        }
    }
    lines
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

fn row(label: &str, unit: &str, p: &Parameter) -> String {
    match (p.value, p.expanded, p.std, &p.budget) {
        (Some(value), Some(expanded), Some(std), Some(budget)) => {
            let decimals = decimals(expanded);
            format!(
                "  {label:<25}{value:>10.decimals$} ± {expanded:<10.decimals$} {unit:<2} {}",
                parts(budget, std)
            )
        }
        (Some(value), None, ..) => {
            let decimals = decimals(1e-2 * value.abs());
            format!("  {label:<25}{value:>10.decimals$}   {:<10} {unit}", "held")
        }
        _ => format!("  {label:<25}{:>10}", "–"),
    }
}

/// Lists the parts that make up nine tenths of the variance, largest first.
fn parts(budget: &Budget, std: f64) -> String {
    let mut all = [
        ("counting", budget.counting),
        ("reference", budget.reference),
        ("angles", budget.angles),
        ("material", budget.material),
        ("wedge", budget.wedge),
        ("drift", budget.drift),
        ("detector", budget.detector),
        ("background", budget.background),
        ("model", budget.model),
        ("shape", budget.shape),
        ("prior", budget.prior),
        ("tracer", budget.tracer),
    ];
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
        write!(text, "{comma}{name} {part:.decimals$}").expect("a string takes text");
    }
    text
}

/// Formats the profile and bootstrap intervals of one parameter in one line.
fn intervals(name: &str, p: &Parameter) -> Option<String> {
    let (label, unit) = spoken(name);
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

fn spoken(name: &str) -> (&'static str, &'static str) {
    match name {
        "theta_r_deg" => ("θr  ridge angle", "°"),
        "alpha_u" => ("αu  roughness along", ""),
        "alpha_v" => ("αv  roughness across", ""),
        "rho_d" => ("ρd  diffuse reflectance", ""),
        "scale" => ("g   gain (scale)", ""),
        "background" => ("B   stray light", ""),
        "azimuth_offset_deg" => ("Δφs azimuth offset", "°"),
        "translucency" => ("τ   translucency", ""),
        "crest_radius" => ("R/p crest radius", ""),
        _ => ("Δθc tilt offset", "°"),
    }
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
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::{FitOptions, fit};
    use crate::geometry::Pose;

    #[test]
    fn notes_follow_the_warnings() {
        let one = painted(std::iter::once(Pose::from_deg(0.0, 0.0)), &TRUTH, 1e-3, 1);
        let mut report = fit(&one, &FitOptions::default(), &AtomicBool::new(false));
        assert!(!table(&report, false).contains("notes"));
        report.notes.push("No action is needed.".to_owned());
        let text = table(&report, false);
        let place = |section: &str| text.find(section).unwrap_or_else(|| panic!("{text}"));
        assert!(place("\nwarnings\n  · ") < place("\nnotes\n  · No action is needed.\n"));
    }

    #[test]
    fn a_row_shows_two_digits_of_the_uncertainty_and_its_largest_parts() {
        let budget = Budget {
            material: 0.017,
            model: 0.011,
            counting: 0.0001,
            ..Budget::default()
        };
        let text = row("θr", "°", &Parameter::known(10.01732, budget, None));
        assert!(text.contains("10.017 ± 0.040"), "{text}");
        assert!(text.contains("material 0.017, model 0.011"), "{text}");
        assert!(!text.contains("counting"), "{text}");
    }

    #[test]
    fn an_undetermined_parameter_shows_no_number() {
        let text = row("ρd", "", &Parameter::unknown("no reference"));
        assert!(!text.chars().any(|c| c.is_ascii_digit()), "{text}");
    }

    #[test]
    fn long_sentences_wrap_between_words() {
        let lines = wrapped("one two three four", 9);
        assert_eq!(lines, ["one two", "three", "four"]);
    }
}
