//! The report as one HTML file: answer and verdict first, then what they rest on.

use serde_json::Value;

use super::markup::{Markup, in_digits_of};
use super::{MeasurementReport, plots, repeats, sections};
use crate::fit::report::{FitReport, Parameter, ReferencePlane, Status};
use crate::fit::uncertainty::coverage::COVERAGE;
use crate::judge::{JudgedItem, Verdict};
use crate::wording::names;
use crate::wording::{counted, percent, significant, utc_words};

const STYLE: &str = concat!("<style>", include_str!("report.css"), "</style>\n");

/// Builds the page.
pub(super) fn page(report: &MeasurementReport, printed_at: &str) -> String {
    let sealed = report.sealed();
    let mut page = Markup::default();
    head(&mut page, report, printed_at);
    answer(&mut page, report);
    warnings(&mut page, &report.fit.result);
    verdict(&mut page, report);
    parameters(&mut page, &report.fit.result);
    budget(&mut page, &report.fit.result);
    figures(&mut page, report);
    repeats::section(&mut page, report);
    sections::measurement(&mut page, report);
    sections::rig(&mut page, report);
    sections::calibrations(&mut page, report);
    sections::left_out(&mut page, &report.fit.result);
    sections::incidents(&mut page, report);
    let sha256 = sealed.get("sha256").and_then(Value::as_str);
    sections::record(&mut page, report, sha256.unwrap_or_default());
    page.tags("</body>\n</html>\n");
    page.finish()
}

fn head(page: &mut Markup, report: &MeasurementReport, printed_at: &str) {
    page.tags("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n")
        .tags("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>")
        .text(&format!(
            "Report on {}, {}",
            report.part.name,
            report.source()
        ))
        .tags("</title>\n")
        .tags(STYLE)
        .tags("</head>\n<body>\n<header>\n<h1>Ridge angle of ")
        .foreign(&report.part.name)
        .tags("</h1>\n<p class=\"sub\">Measurement report on ")
        .text(&report.source());
    if let Some(region) = &report.fit.result.region {
        page.text(", region ").foreign(region);
    }
    if let Some(fit) = report.fit.id {
        page.text(&format!(", fit {fit}"));
    }
    page.text(". Printed ")
        .text(&utc_words(printed_at))
        .tags(".</p>\n</header>\n");
    if report.rig.simulated {
        page.tags("<p class=\"simulated\">Simulated rig: these frames were computed, no part was measured.</p>\n");
    }
}

fn answer(page: &mut Markup, report: &MeasurementReport) {
    let fit = &report.fit.result;
    let angle = &fit.parameters.theta_r_deg;
    page.tags("<div class=\"answer\">\n<span class=\"value\">θ<sub>r</sub> ");
    match (angle.value, angle.expanded) {
        (Some(value), Some(expanded)) => {
            page.text("= ").measured(value, expanded).text("° ± ");
            page.measured(expanded, expanded).text("°");
        }
        (Some(value), None) => {
            page.text("= ").stated(value).text("° (fixed)");
        }
        _ => {
            page.text("not determined");
        }
    }
    page.tags("</span>\n");
    // A verdict on other values does not stand beside these.
    if let Some(verdict) = report.verdict.as_ref().filter(|v| v.result.rests_on(fit)) {
        badge(page, verdict.result.judgement.verdict);
    }
    page.tags("</div>\n<p class=\"sub k\">");
    match (angle.value, angle.coverage_factor) {
        (Some(_), Some(k)) => {
            page.text("± is the expanded uncertainty U with k = ")
                .number(k, &format!("{k:.2}"));
            coverage(page, k, angle.degrees_of_freedom);
            page.text(plane(fit.reference_plane));
        }
        _ => {
            let note = angle.note.as_deref();
            page.text(note.unwrap_or("The data do not determine the ridge angle."));
        }
    }
    page.tags("</p>\n");
    if fit.status != Status::Converged {
        page.tags("<p class=\"caution\">The fit did not converge normally: ")
            .text(status(fit.status))
            .tags(".</p>\n");
    }
}

fn coverage(page: &mut Markup, k: f64, freedom: Option<f64>) {
    match freedom {
        Some(freedom) => {
            page.text(" and ");
            page.number(freedom, &format!("{freedom:.0}"));
            page.text(" effective degrees of freedom. ");
        }
        None if (k - 2.0).abs() < 1e-9 => {
            let coverage = (100.0 * COVERAGE).round();
            page.text(&format!(
                ", a coverage probability of about {coverage} % for a normal distribution. "
            ));
        }
        None => {
            page.text(". ");
        }
    }
}

fn plane(plane: ReferencePlane) -> &'static str {
    match plane {
        ReferencePlane::Turntable => {
            "The angle refers to the plane of the turntable: a tilt of the sample on it is part of the angle and not of U."
        }
        ReferencePlane::Sample => {
            "The angle refers to the mean plane of the sample: U includes the stated tilt of the sample on the turntable."
        }
    }
}

fn status(status: Status) -> &'static str {
    match status {
        Status::Converged => "converged",
        Status::AtBound => "a parameter is at a bound",
        Status::RankDeficient => "the data leave a direction undetermined",
        Status::Stalled => "no start reached a minimum",
        Status::NotFinite => "a value is not finite",
        Status::TooFewObservations => "there are too few observations",
        Status::Cancelled => "it was cancelled",
    }
}

fn warnings(page: &mut Markup, fit: &FitReport) {
    if fit.warnings.is_empty() {
        return;
    }
    page.tags("<div class=\"caution\">\n<strong>Warnings</strong>\n<ul>\n");
    for warning in &fit.warnings {
        page.tags("<li>").message(warning).tags("</li>\n");
    }
    page.tags("</ul>\n</div>\n");
}

fn badge(page: &mut Markup, verdict: Verdict) {
    let (tags, word) = match verdict {
        Verdict::Pass => ("<span class=\"verdict pass\">", "PASS"),
        Verdict::Fail => ("<span class=\"verdict fail\">", "FAIL"),
        Verdict::CannotTell => ("<span class=\"verdict cannot-tell\">", "CANNOT TELL"),
    };
    page.tags(tags).text(word).tags("</span>\n");
}

fn verdict(page: &mut Markup, report: &MeasurementReport) {
    page.tags("<h2>Verdict</h2>\n");
    let Some(verdict) = &report.verdict else {
        page.tags("<p>The scan was not judged against a specification.</p>\n");
        return;
    };
    let judgement = &verdict.result.judgement;
    page.tags("<p>").text(&format!("{}: ", judgement.verdict));
    page.text("specification ")
        .foreign(&judgement.specification);
    page.text(&format!(", judged {} by ", utc_words(&verdict.created_at)));
    page.foreign(&verdict.who).tags(".</p>\n<p>Decision rule: ");
    page.text(&judgement.decision_rule).text(".");
    if let Some(probability) = judgement.conformance_probability_min {
        page.text(match probability > CERTAIN {
            true => " The probability that all quantities conform is ",
            false => " The probability that all quantities conform is at least ",
        });
        share(page, probability);
        page.text(".");
    }
    page.tags("</p>\n");
    if !verdict.result.rests_on(&report.fit.result) {
        page.tags("<p class=\"caution\">The verdict judged the values below, which are not those of the fit above (variant ")
            .text(&verdict.result.variant.to_string())
            .tags("). Judge the fit to get a verdict on it.</p>\n");
    }
    page.tags("<div class=\"scroll\"><table>\n").header(&[
        "quantity",
        "value ± U",
        "lower limit",
        "upper limit",
        "guard band",
        "P(conforms)",
        "verdict",
    ]);
    page.tags("<tbody>\n");
    for item in &judgement.items {
        judged(page, item);
    }
    page.tags("</tbody></table></div>\n");
    let fit = &report.fit.result.warnings;
    let own = judgement.warnings.iter().filter(|w| !fit.contains(w));
    for warning in own {
        page.tags("<p class=\"caution\">")
            .message(warning)
            .tags("</p>\n");
    }
}

fn judged(page: &mut Markup, item: &JudgedItem) {
    let name = names::known(&item.quantity);
    let unit = name.map_or("", |name| name.unit);
    let expanded = item.expanded.unwrap_or(f64::NAN);
    page.tags("<tr>")
        .cell(|p| match name {
            Some(name) => p.text(&name.full()),
            None => p.foreign(&item.quantity),
        })
        .figures(|p| match (item.value, item.expanded) {
            (Some(value), Some(expanded)) => {
                p.measured(value, expanded).text(" ± ");
                p.measured(expanded, expanded).text(unit)
            }
            _ => p.text("–"),
        });
    for limit in [item.lower, item.upper] {
        page.figures(|p| match limit {
            Some(limit) => p.stated(limit).text(unit),
            None => p.text("–"),
        });
    }
    page.figures(|p| match item.guard_band {
        Some(band) => p.number(band, &in_digits_of(band, expanded)).text(unit),
        None => p.text("–"),
    });
    page.figures(|p| match item.conformance_probability {
        Some(probability) => share(p, probability),
        None => p.text("–"),
    });
    page.cell(|p| {
        p.text(&item.verdict.to_string());
        p.tags("<br><span class=\"note\">");
        p.foreign(&item.reason).tags("</span>");
        p
    });
    page.tags("</tr>\n");
}

/// Writes a probability in per cent.
/// Probability above which certainty is not shown: the digits of the uncertainty do not give it.
const CERTAIN: f64 = 0.9999;

fn share(page: &mut Markup, probability: f64) -> &mut Markup {
    let percent = 100.0 * probability;
    let shown = match percent {
        p if p > 100.0 * CERTAIN => "> 99.99".to_owned(),
        p if p < 0.01 => "< 0.01".to_owned(),
        p => format!("{p:.2}"),
    };
    page.number(probability, &format!("{shown} %"))
}

fn parameters(page: &mut Markup, fit: &FitReport) {
    page.tags("<h2>Parameters</h2>\n<p>")
        .text(&format!(
            "Model variant {}, {}, {} from {}.",
            fit.variant,
            status(fit.status),
            counted(fit.n_observations, "observation"),
            counted(fit.n_frames_used as usize, "frame"),
        ))
        .tags("</p>\n<div class=\"scroll\"><table>\n")
        .header(&[
            "parameter",
            "value",
            "U",
            "k",
            "u (k = 1)",
            "degrees of freedom",
            "note",
        ])
        .tags("<tbody>\n");
    for (key, parameter) in fit.parameters.named() {
        parameter_row(page, key, parameter);
    }
    page.tags("</tbody></table></div>\n");
    quality(page, fit);
}

fn parameter_row(page: &mut Markup, key: &'static str, parameter: &Parameter) {
    let name = names::quantity(key);
    let expanded = parameter.expanded.unwrap_or(f64::NAN);
    page.tags("<tr>").cell(|p| p.text(&name.full()));
    page.figures(|p| match (parameter.value, parameter.expanded) {
        (Some(value), Some(expanded)) => p.measured(value, expanded).text(name.unit),
        (Some(value), None) => p.stated(value).text(name.unit),
        _ => p.text("–"),
    });
    page.figures(|p| match parameter.expanded {
        Some(expanded) => p.measured(expanded, expanded).text(name.unit),
        None => p.text("–"),
    });
    page.figures(|p| match parameter.coverage_factor {
        Some(k) => p.number(k, &format!("{k:.2}")),
        None => p.text("–"),
    });
    page.figures(|p| match parameter.std {
        Some(std) => p
            .number(std, &in_digits_of(std, std.min(expanded)))
            .text(name.unit),
        None => p.text("–"),
    });
    page.figures(|p| match parameter.degrees_of_freedom {
        Some(freedom) => p.number(freedom, &format!("{freedom:.0}")),
        None if parameter.std.is_some() => p.text("∞"),
        None => p.text("–"),
    });
    page.cell(|p| {
        let held = parameter.value.is_some() && parameter.std.is_none();
        let note = parameter.note.as_deref();
        p.tags("<span class=\"note\">")
            .foreign(note.unwrap_or(if held { "fixed" } else { "" }))
            .tags("</span>");
        p
    });
    page.tags("</tr>\n");
}

fn quality(page: &mut Markup, fit: &FitReport) {
    let (Some(rms), Some(reduced), Some(alone)) = (
        fit.rms_residual,
        fit.chi2_reduced,
        fit.chi2_reduced_without_model,
    ) else {
        return;
    };
    page.tags("<p class=\"note\">RMS residual ")
        .number(rms, &percent(rms))
        .text(" of the largest observation. Reduced χ² ")
        .rounded(reduced)
        .text(" with the model-error term, ")
        .rounded(alone)
        .text(" with counting noise only.");
    if let Some(slopes) = &fit.slope_distribution {
        page.text(" Slope distribution of the facets: ")
            .text(&slopes.name);
        if let Some(shape) = slopes.shape {
            page.text(", γ = ").rounded(shape);
        }
        page.text(".");
    }
    page.tags("</p>\n");
}

fn budget(page: &mut Markup, fit: &FitReport) {
    let angle = &fit.parameters.theta_r_deg;
    let (Some(std), Some(budget)) = (angle.std, angle.budget) else {
        return;
    };
    page.tags("<h2>Uncertainty budget of θ<sub>r</sub></h2>\n<div class=\"scroll\"><table>\n")
        .header(&[
            "source",
            "what it contains",
            "u (k = 1)",
            "share of the variance",
            "",
        ])
        .tags("<tbody>\n");
    let mut lines = budget.named();
    lines.sort_by(|a, b| b.1.total_cmp(&a.1));
    let digits = angle.expanded.unwrap_or(std).min(std);
    let of_variance = |part: f64| (part / std) * (part / std);
    for (name, part) in lines.into_iter().filter(|line| line.1 > 0.0) {
        page.tags("<tr>")
            .cell(|p| p.text(name))
            .cell(|p| p.text(names::budget_line(name)))
            .figures(|p| p.number(part, &two_digits(part)).text("°"))
            .figures(|p| p.text(&percent(of_variance(part))))
            .cell(|p| p.bar(of_variance(part)))
            .tags("</tr>\n");
    }
    page.tags("<tr><td><strong>combined</strong></td><td>root of the sum of squares</td>")
        .figures(|p| p.number(std, &in_digits_of(std, digits)).text("°"))
        .tags("<td></td><td></td></tr>\n</tbody></table></div>\n");
    others(page, fit);
}

/// Writes the budgets of the other parameters in one table.
fn others(page: &mut Markup, fit: &FitReport) {
    let named = fit.parameters.named();
    let known: Vec<_> = named
        .iter()
        .skip(1)
        .filter_map(|(key, p)| Some((names::quantity(key), p.budget?, p.std?)))
        .collect();
    if known.is_empty() {
        return;
    }
    page.tags("<h3>Standard uncertainties of the other parameters by source (k = 1)</h3>\n")
        .tags("<div class=\"scroll\"><table class=\"wide\">\n<thead><tr><th scope=\"col\">source</th>");
    for (name, ..) in &known {
        page.tags("<th scope=\"col\" class=\"n\">")
            .text(name.symbol);
        if !name.unit.is_empty() {
            page.text(&format!(" / {}", name.unit.trim_start()));
        }
        page.tags("</th>");
    }
    page.tags("</tr></thead>\n<tbody>\n");
    let lines = known[0].1.named();
    for (n, (line, _)) in lines.into_iter().enumerate() {
        if known
            .iter()
            .all(|(_, budget, _)| budget.named()[n].1 == 0.0)
        {
            continue;
        }
        page.tags("<tr>").cell(|p| p.text(line));
        for (_, budget, _) in &known {
            let part = budget.named()[n].1;
            page.figures(|p| match part == 0.0 {
                true => p.text("–"),
                false => p.number(part, &two_digits(part)),
            });
        }
        page.tags("</tr>\n");
    }
    page.tags("<tr><td><strong>combined</strong></td>");
    for (_, _, std) in &known {
        page.figures(|p| p.number(*std, &two_digits(*std)));
    }
    page.tags("</tr>\n</tbody></table></div>\n");
}

/// Returns two significant digits: in decimals down to 1e-5, below as a power of ten.
fn two_digits(value: f64) -> String {
    match value.abs() {
        1e-5..1e4 => in_digits_of(value, value),
        _ => significant(value),
    }
}

fn figures(page: &mut Markup, report: &MeasurementReport) {
    let figures = plots::figures(report);
    if figures.is_empty() {
        return;
    }
    page.tags("<h2>Observations, fit and residuals</h2>\n<p class=\"note\">");
    page.text(match report.absolute {
        true => "Above: BRDF times cos θi, the radiance over the lamp's irradiance on a surface that faces it. ",
        false => "Above: the signal in an arbitrary unit, since no white reference defines its scale. ",
    });
    page.text(
        "Dots are observations, bars their expanded uncertainty (k = 2) by independent errors, lines the fit. Below: \
         observation minus fit, in % of the largest observation.",
    );
    page.tags("</p>\n");
    for figure in figures {
        page.tags("<figure>").figure(&figure).tags("</figure>\n");
    }
}
