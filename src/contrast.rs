//! The first paper's contrast, measured in the observations of a scan, and the object in which a
//! contrast table (measured or predicted) is told to scripts.
//!
//! [`measure`] is the one function to call; [`as_json`] writes what it gives and what
//! [`crate::model::contrast::predict`] gives. Source: Luongo et al. 2017, section 4 and Fig. 8.
//! Knows neither frames nor files.

use serde_json::{Value, json};

use crate::model::LeftOut;
use crate::model::contrast::{
    Contrast, Exposure, Findings, Mean, PAIRS, PAPER_AZIMUTHS_DEG, Table,
};
use crate::observation::ObservationSet;
use crate::units::Angle;

/// How far a recorded angle may be from the paper's and still count as it.
const SNAP_DEG: f64 = 0.5;

/// No tilt has frames at all three of the paper's azimuths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no camera tilt has frames at all of the azimuths 0, 90 and 180 degrees")]
pub struct NoContrast;

/// The contrast table of a scan and its object for scripts (`contrast --json`).
///
/// # Errors
/// [`NoContrast`] where no tilt was seen at φs = 0°, 90° and 180°.
pub fn measure(set: &ObservationSet) -> Result<(Table, Value), NoContrast> {
    let (table, stds) = of_observations(set);
    if table.lines.is_empty() {
        return Err(NoContrast);
    }
    let mut report = as_json(&table, Some(&stds));
    report["mode"] = json!("measured");
    report["region"] = json!(set.region);
    report["scale"] = json!(if set.white_reference.is_some() {
        "white reference"
    } else {
        "arbitrary"
    });
    report["warnings"] = json!(set.warnings);
    // How wrong: the largest standard uncertainty of a contrast beside the largest contrast.
    let largest = |all: &mut dyn Iterator<Item = f64>| all.fold(0.0, f64::max);
    let brightest = largest(
        &mut table
            .lines
            .iter()
            .flat_map(|l| l.contrast.map(|c| c.absolute)),
    );
    let std = largest(&mut stds.iter().flatten().copied());
    report["error"] = json!((brightest > 0.0).then(|| json!({
        "value": std / brightest,
        "of": "a contrast, of the largest",
    })));
    report["left_out"] = json!([LeftOut::new(
        "directions of single pixels",
        "the region's mean counts as seen from its centre, as in the paper",
        None,
    )]);
    Ok((table, report))
}

/// The contrast table of reduced observations and the standard uncertainty of every contrast: own
/// noise of both, and what white reference and lamp drift do to their difference.
fn of_observations(set: &ObservationSet) -> (Table, Vec<[f64; 2]>) {
    let mut exposures: Vec<Exposure> = Vec::new();
    let mut sources = Vec::new();
    for o in &set.observations {
        let recorded_deg = o.pose.phi_s.deg().rem_euclid(360.0);
        let Some(azimuth) = PAPER_AZIMUTHS_DEG.into_iter().find(|a| {
            let off = (recorded_deg - a).abs();
            off.min(360.0 - off) <= SNAP_DEG
        }) else {
            continue;
        };
        let theta_c = Angle::from_deg((o.pose.theta_c.deg() * 10.0).round() / 10.0);
        exposures.push(Exposure {
            theta_r: Angle::ZERO,
            theta_c,
            phi_s: Angle::from_deg(azimuth),
            radiance: o.signal,
        });
        sources.push(o);
    }
    let table = Table::of(&exposures);
    let stds = table
        .lines
        .iter()
        .map(|line| {
            let at = |j: usize| {
                exposures
                    .iter()
                    .zip(&sources)
                    .find(|(e, _)| {
                        e.theta_c == line.theta_c
                            && e.phi_s == Angle::from_deg(PAPER_AZIMUTHS_DEG[j])
                    })
                    .map(|(_, o)| *o)
                    .expect("a line is made of its exposures")
            };
            PAIRS.map(|(_, j, k)| {
                let (a, b) = (at(j), at(k));
                let white = a.shared.white_reference - b.shared.white_reference;
                let drift = a.shared.led_drift.hypot(b.shared.led_drift);
                a.sigma.hypot(b.sigma).hypot(white).hypot(drift)
            })
        })
        .collect();
    (table, stds)
}

/// A table as an object; `stds` are the standard uncertainties of its absolute contrasts (radiance
/// for a lamp irradiance of 1, lines × pairs) where it was measured.
#[must_use]
pub fn as_json(table: &Table, stds: Option<&[[f64; 2]]>) -> Value {
    let measured = stds.is_some();
    let lines: Vec<Value> = table
        .lines
        .iter()
        .enumerate()
        .map(|(n, line)| {
            let mut contrast = serde_json::Map::new();
            for (pair, (name, ..)) in PAIRS.iter().enumerate() {
                let mut entry = contrast_json(&line.contrast[pair]);
                if let Some(stds) = stds {
                    entry["absolute_std"] = json!(stds[n][pair]);
                }
                contrast.insert((*name).to_owned(), entry);
            }
            let mut entry = json!({
                "theta_c_deg": rounded_deg(line.theta_c),
                "radiance": {"0": line.radiance[0], "90": line.radiance[1], "180": line.radiance[2]},
                "contrast": contrast,
            });
            if !measured {
                entry["theta_r_deg"] = json!(rounded_deg(line.theta_r));
            }
            entry
        })
        .collect();
    let means = |name: &str, means: &[Mean]| {
        means
            .iter()
            .map(|m| {
                let mut entry = contrast_json(&m.contrast);
                entry[name] = m
                    .setting
                    .parse::<f64>()
                    .map_or_else(|_| json!(m.setting), |deg| json!(deg));
                entry
            })
            .collect::<Vec<_>>()
    };
    let mut mean = json!({
        "by_theta_c": means("theta_c_deg", &table.by_theta_c),
        "by_phi_s": means("phi_s_deg", &table.by_phi_s),
    });
    if !measured {
        mean["by_theta_r"] = json!(means("theta_r_deg", &table.by_theta_r));
    }
    json!({
        "lines": lines,
        "mean": mean,
        "findings": table.findings().map(findings_json),
        "program": concat!("ridged ", env!("CARGO_PKG_VERSION")),
    })
}

/// Degrees without the noise of the conversion to radians and back.
#[must_use]
pub fn rounded_deg(a: Angle) -> f64 {
    (a.deg() * 1e6).round() / 1e6
}

fn contrast_json(c: &Contrast) -> Value {
    json!({"absolute": c.absolute, "michelson": c.michelson})
}

/// Which of the paper's three findings a table shows.
#[must_use]
pub fn findings_json(f: Findings) -> Value {
    json!({
        "greatest_at_theta_c_0": f.greatest_at_normal_tilt,
        "greatest_at_smallest_theta_r": f.greatest_at_smallest_ridge,
        "0-90_above_90-180": f.first_quarter_stronger,
    })
}
