//! Sweeps as CSV, as a JSON object, and as tables.

use std::fmt::Write as _;

use serde_json::json;

use super::{Sweep, Swept, Wear, WearPoint};
use crate::forecast::Expected;
use crate::model::contrast::PAPER_RIDGES_DEG;

/// Comma-separated values, one line per surface.
pub(super) fn csv(sweeps: &[Sweep]) -> String {
    let mut text =
        String::from("round,burr,theta_r_deg,effective_theta_r_deg,contrast,contrast_std\n");
    for sweep in sweeps {
        let (round, burr) = match sweep.wear {
            Wear::Round(x) => (x, 0.0),
            Wear::Burr(x) => (0.0, x),
        };
        let mut all: Vec<&WearPoint> = sweep.all().collect();
        all.sort_by(|a, b| a.theta_r_deg.total_cmp(&b.theta_r_deg));
        for p in all {
            let _ = writeln!(
                text,
                "{round},{burr},{},{:.4},{:.7},{:.7}",
                p.theta_r_deg, p.effective_deg, p.contrast.value, p.contrast.std
            );
        }
    }
    text
}

/// The object of `wear --json`.
pub(super) fn report(swept: &Swept, seconds: f64) -> serde_json::Value {
    let rows: Vec<serde_json::Value> = swept
        .sweeps
        .iter()
        .map(|s| {
            let (round, burr) = match s.wear {
                Wear::Round(x) => (x, 0.0),
                Wear::Burr(x) => (0.0, x),
            };
            let optimum = s.optimum();
            let at = |number: &dyn Fn(&WearPoint) -> f64| -> Vec<Option<f64>> {
                let points = PAPER_RIDGES_DEG.iter().map(|t| s.at(*t));
                points.map(|p| p.map(number)).collect()
            };
            json!({
                "round": round,
                "burr": burr,
                "optimum_deg": optimum.map(|o| o.value),
                "optimum_std_deg": optimum.map(|o| o.std).filter(|s| s.is_finite()),
                "contrast_at_paper_ridges": at(&|p| p.contrast.value),
                "contrast_std_at_paper_ridges": at(&|p| p.contrast.std),
                "effective_deg_at_paper_ridges": at(&|p| p.effective_deg),
                "best_of_paper_ridges_deg": s.best_of_paper(),
            })
        })
        .collect();
    json!({
        "paper_ridges_deg": PAPER_RIDGES_DEG,
        "sweeps": rows,
        "error": Expected {
            value: swept.error(),
            of: "a contrast, at worst".to_owned(),
        },
        "paths": swept.paths,
        "seconds": seconds,
        "left_out": swept.left_out,
        "program": concat!("ridged ", env!("CARGO_PKG_VERSION")),
    })
}

/// A table in Markdown.
pub(super) fn table(sweeps: &[Sweep]) -> String {
    let mut text = String::from(
        "| wear | optimum θr | contrast at 5° | 10° | 15° | 20° | best of these | effective angle of 5° | of 10° |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
    );
    for sweep in sweeps {
        let wear = sweep.wear.name();
        let number = |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{x:.4}"));
        let degrees = |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{x:.1}°"));
        let optimum = match sweep.optimum() {
            Some(o) if o.std.is_finite() => format!("{:.1}° ± {:.1}°", o.value, o.std),
            Some(o) => format!("{:.1}° (bound)", o.value),
            None => "–".to_owned(),
        };
        let effective = |t: f64| degrees(sweep.at(t).map(|p| p.effective_deg));
        let _ = write!(text, "| {wear} | {optimum} |");
        for t in PAPER_RIDGES_DEG {
            let _ = write!(text, " {} |", number(sweep.at(t).map(|p| p.contrast.value)));
        }
        let _ = writeln!(
            text,
            " {} | {} | {} |",
            degrees(sweep.best_of_paper()),
            effective(5.0),
            effective(10.0)
        );
    }
    text
}

/// Standard errors of the contrasts in [`table`].
pub(super) fn errors_table(sweeps: &[Sweep]) -> String {
    let mut text = String::from(
        "| standard error of the contrast | at 5° | 10° | 15° | 20° |\n| --- | --- | --- | --- | --- |\n",
    );
    for sweep in sweeps {
        let _ = write!(text, "| {} |", sweep.wear.name());
        for t in PAPER_RIDGES_DEG {
            let std = sweep.at(t).map(|p| p.contrast.std);
            let std = std.map_or("–".to_owned(), |std| format!("{std:.5}"));
            let _ = write!(text, " {std} |");
        }
        text.push('\n');
    }
    text
}
