//! The section on repeated scans of the part: their scatter beside the uncertainty that they state.

use super::MeasurementReport;
use super::markup::Markup;
use crate::repeatability::Repeatability;
use crate::repeatability::scatter::Scatter;
use crate::wording::utc_words as time;

/// Writes the section, if the part was measured often enough.
pub(super) fn section(page: &mut Markup, report: &MeasurementReport) {
    let Some(study) = &report.repeatability else {
        return;
    };
    let Some(scatter) = &study.scatter else {
        return;
    };
    page.tags("<h2>Repeatability</h2>\n<p class=\"note\">θr of this scan and of the earlier scans of this part by the same version of the recipe.</p>\n<dl>\n");
    summary(page, scatter);
    page.tags("</dl>\n");
    if let Some(message) = &scatter.message {
        page.tags("<p>").text(message).tags("</p>\n");
    }
    scans(page, study);
    let shared = study.shared_lines.iter().filter(|line| line.shared);
    let shared: Vec<String> = shared
        .map(|line| format!("{} ({})", line.line, line.why))
        .collect();
    if !shared.is_empty() {
        page.tags("<p class=\"note\">Lines of the budget with the same error in all scans, which do not scatter: ")
            .text(&shared.join("; "))
            .tags(".</p>\n");
    }
}

fn summary(page: &mut Markup, scatter: &Scatter) {
    if let Some(mean) = scatter.mean {
        page.entry("Mean θr", |p| {
            p.measured(mean, scatter.std)
                .text(&format!("° of {} scans", scatter.n))
        });
    }
    page.entry("Scatter s of one scan", |p| {
        let [low, high] = scatter.std_interval;
        p.rounded(scatter.std).text("° (95 %: ").rounded(low);
        p.text("° to ").rounded(high).text("°)")
    });
    page.entry("Stated u (k = 1)", |p| {
        p.rounded(scatter.stated_std).text("°; U ");
        p.rounded(scatter.stated_expanded)
            .text("°; without the lines that do not scatter u ");
        p.rounded(scatter.scattering_std).text("°")
    });
    if let Some(ratio) = scatter.ratio {
        page.entry("s / u", |p| p.rounded(ratio));
    }
    if let (Some(chi_square), Some(probability)) = (scatter.chi_square, scatter.probability) {
        page.entry("χ²", |p| {
            p.rounded(chi_square).text(&format!(
                " with {} degrees of freedom; probability of a larger one ",
                scatter.degrees_of_freedom
            ));
            p.number(probability, &format!("{:.2} %", 100.0 * probability))
        });
    }
}

fn scans(page: &mut Markup, study: &Repeatability) {
    page.tags("<div class=\"scroll\"><table>\n")
        .header(&[
            "scan",
            "measured",
            "operator",
            "θr ± U / °",
            "from the mean / °",
        ])
        .tags("<tbody>\n");
    for result in &study.results {
        page.tags("<tr>")
            .figures(|p| p.text(&result.of.scan_id.to_string()))
            .cell(|p| p.text(&time(&result.of.measured_at)))
            .cell(|p| match &result.of.operator_name {
                Some(name) => p.foreign(name),
                None => p.text("–"),
            })
            .figures(|p| {
                p.measured(result.value, result.expanded).text(" ± ");
                p.measured(result.expanded, result.expanded)
            })
            .figures(|p| p.measured(result.deviation, result.expanded))
            .tags("</tr>\n");
    }
    page.tags("</tbody></table></div>\n");
}
