//! A measurement as one HTML page that needs no other file: figures, plans, forecasts and convergence.

use std::fmt::Write;

use super::plan_check::PlanCheck;
use super::{AccuracyPoint, ConvergenceRate, ForecastOutcome, Measurements, plot};

const STYLE: &str = "body{font-family:system-ui,sans-serif;margin:2rem auto;max-width:84rem;padding:0 1rem;color:#10161d}\
h1{font-size:1.6rem}h2{font-size:1.15rem;margin-top:2.5rem}.note{color:#566270}\
.pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(34rem,1fr));gap:1rem}\
.pictures svg{width:100%;height:auto;border:1px solid #e0e4e8;border-radius:6px}\
table{border-collapse:collapse;font-size:.92rem}td,th{padding:.25rem .7rem;border-bottom:1px solid #e9edf1;text-align:right}\
td:first-child,th:first-child,td.words,th.words{text-align:left}.no{color:#b3261e;font-weight:600}";

/// Writes the page. `scenes` orders the figures, `machine` names program and processor.
#[must_use]
pub fn html(found: &Measurements, scenes: &[&str], machine: &str) -> String {
    let mut out = String::new();
    let put = |out: &mut String, text: &str| {
        out.push_str(text);
        out.push('\n');
    };
    put(
        &mut out,
        &format!(
            "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>ridged accuracy</title><style>{STYLE}</style>\
             <h1>Error against run time</h1><p class=\"note\">{}</p>",
            escaped(machine)
        ),
    );
    put(&mut out, &plans(&found.proofs));
    put(&mut out, &forecasts(&found.forecasts));
    put(&mut out, &rates(&found.rates));
    put(
        &mut out,
        "<h2>Every method on every scene</h2><div class=\"pictures\">",
    );
    for scene in scenes {
        let points: Vec<&AccuracyPoint> =
            found.points.iter().filter(|p| p.scene == *scene).collect();
        put(&mut out, &plot::svg(scene, &points, machine));
    }
    put(&mut out, "</div></html>");
    out
}

/// Text for HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn verdict(holds: bool) -> &'static str {
    if holds {
        "<td>yes</td>"
    } else {
        "<td class=\"no\">no</td>"
    }
}

fn plans(proofs: &[PlanCheck]) -> String {
    let mut out = "<h2>Plans: what they omit, the error and the time saved</h2><p class=\"note\">Each plan is compared with the full \
                   computation: the difference, its limit (tolerance and two standard errors), and the time of both to a \
                   standard error equal to the tolerance, planning included.</p><table><tr><th>scene</th><th>difference</th>\
                   <th>allowed</th><th>within</th><th>full</th><th>planned</th><th>faster</th>\
                   <th class=\"words\">omitted (speed-up of each alone)</th></tr>"
        .to_owned();
    for p in proofs {
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{:+.2} %</td><td>{:.2} %</td>{}<td>{:.1} ms</td><td>{:.1} ms</td><td>×{:.2}</td><td class=\"words\">{}</td></tr>",
            escaped(&p.scene),
            100.0 * p.off,
            100.0 * p.allowed,
            verdict(p.holds),
            1e3 * p.full_s,
            1e3 * p.planned_s,
            p.speed_up(),
            escaped(&p.parts_text())
        );
    }
    out + "</table>"
}

fn forecasts(forecasts: &[ForecastOutcome]) -> String {
    let mut out = "<h2>Forecasts</h2><table><tr><th>scene</th><th>forecast</th><th>actual</th><th>within a factor of 2</th></tr>".to_owned();
    for f in forecasts {
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{:.2} s</td><td>{:.2} s</td>{}</tr>",
            escaped(&f.scene),
            f.forecast_s,
            f.taken_s,
            verdict(f.within_a_factor_of_two())
        );
    }
    out + "</table>"
}

fn rates(rates: &[ConvergenceRate]) -> String {
    let mut out = "<h2>Convergence of the solver</h2><table><tr><th>scene</th><th class=\"words\">quantity</th><th>predicted</th><th>measured</th></tr>".to_owned();
    for r in rates {
        let found = r
            .found
            .map_or_else(|| "hidden by rounding".to_owned(), |x| format!("{x:.4}"));
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"words\">{}</td><td>{:.4}</td><td>{found}</td></tr>",
            escaped(&r.scene),
            escaped(&r.quantity),
            r.predicted
        );
    }
    out + "</table>"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_has_a_picture_per_scene_and_every_table() {
        let found = Measurements {
            points: vec![AccuracyPoint {
                scene: "a < b".to_owned(),
                method: "m".to_owned(),
                seconds: 1.0,
                error: 0.1,
                quantity: "q".to_owned(),
                reference: "r".to_owned(),
            }],
            forecasts: vec![ForecastOutcome {
                scene: "late".to_owned(),
                forecast_s: 1.0,
                taken_s: 3.0,
            }],
            ..Measurements::default()
        };
        let page = html(&found, &["a < b"], "machine");
        assert_eq!(page.matches("<svg").count(), 1);
        assert_eq!(page.matches("<table>").count(), 3);
        assert!(page.contains("a &lt; b") && page.contains("class=\"no\""));
    }
}
