//! The results of `model-error` as JSON, as CSV and as a table in Markdown.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::accuracy::full_scan;
use crate::accuracy::model_error::{ErrorSurface, MATERIALS, SurfaceErrors, summary};
use crate::forecast::Expected;
use crate::model::LeftOut;
use crate::wording::counted;

/// Effects that neither the closed forms nor the traced surfaces include, and surfaces left out by the time limit.
pub(super) fn left_out(missing: &[ErrorSurface]) -> Vec<LeftOut> {
    let mut list = vec![
        LeftOut::new(
            "rounded crests, burrs, draft of the risers",
            "closed forms and traced surfaces are ideal sawteeth; `ridged wear` shows the effect of wear",
            None,
        ),
        LeftOut::new(
            "bounces among the facets' own roughness",
            "on the facets, light meets one microfacet per hit, with Smith's masking",
            None,
        ),
    ];
    if !missing.is_empty() {
        let names: Vec<String> = missing.iter().map(ErrorSurface::name).collect();
        let what = counted(missing.len(), "surface");
        list.push(LeftOut::new(
            format!("{what}: {}", names.join(", ")),
            "time limit reached",
            None,
        ));
    }
    list
}

/// The object of `--json`.
pub(super) fn report(cells: &[SurfaceErrors], left_out: &[LeftOut], seconds: f64) -> Value {
    let surfaces = cells.iter().map(|cell| {
        // Signed, as in the table of poses: too bright is positive.
        let largest = |of: &[f64]| of.get(summary(of).1).copied();
        let fitted = ["paper", "sawtooth"].iter().zip(&cell.fitted);
        let fitted: serde_json::Map<String, Value> = fitted
            .map(|(name, m)| {
                let m = m.map(|m| {
                    json!({
                        "rms": m.rms,
                        "theta_r_error_deg": m.theta_r_deg,
                        "alpha_u_error": m.alpha[0],
                        "alpha_v_error": m.alpha[1],
                        "rho_d_error": m.rho_d,
                    })
                });
                ((*name).to_owned(), json!(m))
            })
            .collect();
        json!({
            "material": MATERIALS[cell.material].0,
            "theta_r_deg": cell.theta_r_deg,
            "alpha": cell.alpha,
            "paths": cell.paths,
            "noise": cell.noise,
            "closed_worst": largest(&cell.closed),
            "quadrature_worst": largest(&cell.quadrature),
            "fitted": fitted,
        })
    });
    let noise = cells.iter().map(|c| c.noise).fold(0.0, f64::max);
    json!({
        "surfaces": surfaces.collect::<Vec<_>>(),
        "error": Expected {
            value: noise,
            of: "a traced radiance, of the peak, at worst".to_owned(),
        },
        "seconds": seconds,
        "left_out": left_out,
        "program": concat!("ridged ", env!("CARGO_PKG_VERSION")),
    })
}

/// One line per surface.
pub(super) fn csv(cells: &[SurfaceErrors]) -> String {
    let mut text = String::from(
        "material,theta_r_deg,alpha,tracer_rms,closed_rms,closed_worst,worst_theta_c_deg,worst_phi_s_deg,\
         quadrature_rms,quadrature_worst",
    );
    for variant in ["paper", "sawtooth"] {
        for what in [
            "rms",
            "theta_r_error_deg",
            "alpha_u_error",
            "alpha_v_error",
            "rho_d_error",
        ] {
            let _ = write!(text, ",{variant}_fit_{what}");
        }
    }
    text.push('\n');
    for cell in cells {
        let (rms, worst) = summary(&cell.closed);
        let (quadrature_rms, quadrature_worst) = summary(&cell.quadrature);
        let at = full_scan().pose(worst);
        let _ = write!(
            text,
            "{},{},{},{:.2e},{rms:.2e},{:.2e},{:.0},{:.0},{quadrature_rms:.2e},{:.2e}",
            MATERIALS[cell.material].0,
            cell.theta_r_deg,
            cell.alpha,
            cell.noise,
            cell.closed[worst],
            at.theta_c.deg(),
            at.phi_s.deg(),
            cell.quadrature[quadrature_worst],
        );
        for fitted in &cell.fitted {
            match fitted {
                Some(m) => {
                    let rho = m.rho_d.map_or(String::new(), |r| format!("{r:.5}"));
                    let _ = write!(
                        text,
                        ",{:.2e},{:.4},{:.5},{:.5},{rho}",
                        m.rms, m.theta_r_deg, m.alpha[0], m.alpha[1]
                    );
                }
                None => text.push_str(",,,,,"),
            }
        }
        text.push('\n');
    }
    text
}

/// Per material and pose: root mean square over the surfaces of closed form minus traced.
pub(super) fn poses_csv(cells: &[SurfaceErrors]) -> String {
    let mut text = String::from("material,theta_c_deg,phi_s_deg,closed_rms,quadrature_rms\n");
    for (material, (name, ..)) in MATERIALS.iter().enumerate() {
        for (n, at) in full_scan().poses().enumerate() {
            let rms = |of: &dyn Fn(&SurfaceErrors) -> f64| {
                let own: Vec<f64> = cells
                    .iter()
                    .filter(|c| c.material == material)
                    .map(of)
                    .collect();
                summary(&own).0
            };
            let _ = writeln!(
                text,
                "{name},{:.0},{:.0},{:.2e},{:.2e}",
                at.theta_c.deg(),
                at.phi_s.deg(),
                rms(&|c| c.closed[n]),
                rms(&|c| c.quadrature[n])
            );
        }
    }
    text
}

/// A table in Markdown: the worst and the median over the roughnesses, by material and ridge angle.
pub(super) fn table(cells: &[SurfaceErrors]) -> String {
    let mut text = String::from(
        "| material | θr | paper, fitted: rms | its θr is off by | its αv by | sawtooth at the truth: rms | worst pose | two bounces integrated: rms | sawtooth, fitted: θr is off by | its α by | its ρd by | tracer's noise |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
    );
    let mut angles: Vec<(usize, f64)> = Vec::new();
    for cell in cells {
        if !angles.contains(&(cell.material, cell.theta_r_deg)) {
            angles.push((cell.material, cell.theta_r_deg));
        }
    }
    for (material, theta) in angles {
        let own: Vec<&SurfaceErrors> = cells
            .iter()
            .filter(|c| c.material == material && c.theta_r_deg == theta)
            .collect();
        let most = |of: &dyn Fn(&SurfaceErrors) -> Option<f64>| -> Option<f64> {
            own.iter()
                .filter_map(|c| of(c))
                .map(f64::abs)
                .fold(None, |m: Option<f64>, x| Some(m.map_or(x, |m| m.max(x))))
        };
        let percent =
            |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{:.3} %", 100.0 * x));
        let degrees = |x: Option<f64>| x.map_or("–".to_owned(), |x| format!("{x:.3}°"));
        let paper = |c: &SurfaceErrors| c.fitted[0];
        let sawtooth = |c: &SurfaceErrors| c.fitted[1];
        let _ = writeln!(
            text,
            "| {} | {theta}° | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            MATERIALS[material].0,
            percent(most(&|c| paper(c).map(|m| m.rms))),
            degrees(most(&|c| paper(c).map(|m| m.theta_r_deg))),
            percent(most(&|c| paper(c).map(|m| m.alpha[1]))),
            percent(most(&|c| Some(summary(&c.closed).0))),
            percent(most(&|c| Some(c.closed[summary(&c.closed).1]))),
            percent(most(&|c| Some(summary(&c.quadrature).0))),
            degrees(most(&|c| sawtooth(c).map(|m| m.theta_r_deg))),
            percent(most(
                &|c| sawtooth(c).map(|m| m.alpha[0].abs().max(m.alpha[1].abs()))
            )),
            percent(most(&|c| sawtooth(c).and_then(|m| m.rho_d))),
            percent(most(&|c| Some(c.noise))),
        );
    }
    text
}
