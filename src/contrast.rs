//! The first paper's contrast, measured in the observations of a scan, and the object in which a
//! contrast table (measured or predicted) is told to scripts.
//!
//! [`measure`] is the one function to call; [`as_json`] writes what it gives and what
//! [`crate::model::contrast::predict`] gives. Source: Luongo et al. 2017, section 4 and Fig. 8.
//! Knows neither frames nor files.

mod stray;

use serde_json::{Value, json};

use crate::geometry::alike;
use crate::model::LeftOut;
use crate::model::contrast::{
    Contrast, Exposure, Findings, Mean, PAIRS, PAPER_AZIMUTHS_DEG, Table,
};
use crate::observation::{Observation, ObservationSet};
use crate::units::Angle;
use crate::wording::counted;
pub use stray::{Radiances, Stray};

/// Standard uncertainties by which a pair must be brighter than nothing.
const COVERAGE_FACTOR: f64 = 2.0;
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
    let stray = Stray::of_flats(set);
    let (table, stds) = of_observations(set, &stray);
    if table.lines.is_empty() {
        return Err(NoContrast);
    }
    let table = table.without_dark(|line, pair| stds[line][pair].michelson.is_nan());
    let mut report = as_json(&table, Some(&stds));
    report["mode"] = json!("measured");
    report["region"] = json!(set.region);
    report["scale"] = json!(if set.white_reference.is_some() {
        "white reference"
    } else {
        "arbitrary"
    });
    report["stray_light"] = json!({"radiance": stray.radiance, "std": stray.std});
    let mut warnings = set.warnings.clone();
    if set.white_reference.is_none() {
        warnings.push(
            "without a white reference absolute contrasts are shares of the brightest level; Michelson contrast does not need one"
                .to_owned(),
        );
    }
    warnings.extend(incomplete(set));
    let dark = stds.iter().flatten().filter(|std| std.michelson.is_nan());
    let dark = dark.count();
    if dark > 0 {
        warnings.push(format!(
            "{} no brighter than the stray light is known: no Michelson contrast",
            counted(dark, "pair")
        ));
    }
    report["warnings"] = json!(warnings);
    // How wrong: the largest standard uncertainty of a contrast beside the largest contrast.
    let largest = |all: &mut dyn Iterator<Item = f64>| all.fold(0.0, f64::max);
    let brightest = largest(
        &mut table
            .lines
            .iter()
            .flat_map(|l| l.contrast.map(|c| c.absolute)),
    );
    let std = largest(&mut stds.iter().flatten().map(|std| std.absolute));
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

/// Tilts that are no part of the table since one of the paper's azimuths is missing there, though other tilts have it.
fn incomplete(set: &ObservationSet) -> Option<String> {
    let places = places(&set.observations);
    let mut tilts: Vec<(usize, Angle, [bool; 3])> = Vec::new();
    for (place, o) in places.iter().zip(&set.observations) {
        let Some((tilt, azimuth)) = place else {
            continue;
        };
        let at = tilts.iter().position(|t| t.0 == *tilt).unwrap_or_else(|| {
            tilts.push((*tilt, o.pose.theta_c, [false; 3]));
            tilts.len() - 1
        });
        tilts[at].2[*azimuth] = true;
    }
    let left: Vec<String> = tilts
        .iter()
        .filter(|(_, _, has)| has.contains(&false))
        .map(|(_, theta_c, has)| {
            let missing = has.iter().zip(PAPER_AZIMUTHS_DEG).filter(|(has, _)| !**has);
            let missing: Vec<String> = missing.map(|(_, deg)| format!("{deg}°")).collect();
            format!("θc {theta_c} (no signal at φs {})", missing.join(", "))
        })
        .collect();
    (!left.is_empty()).then(|| {
        format!(
            "left out of the table and of its means: {}",
            left.join("; ")
        )
    })
}

/// Standard uncertainties of a pair's contrasts; that of the Michelson contrast is no number where the pair is dark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stds {
    /// Of the absolute contrast.
    pub absolute: f64,
    /// Of the Michelson contrast.
    pub michelson: f64,
}

/// Tilts within this of each other are one.
const SAME_TILT: Angle = Angle::from_deg(0.1);

/// Where an observation stands in the paper's table: the number of its tilt and that of its azimuth in
/// [`PAPER_AZIMUTHS_DEG`]; none for other azimuths. Where several stand at one place, the first counts.
#[must_use]
pub fn places(observations: &[Observation]) -> Vec<Option<(usize, usize)>> {
    let tilts: Vec<Angle> = observations.iter().map(|o| o.pose.theta_c).collect();
    let tilts = alike(&tilts, SAME_TILT);
    let mut taken = std::collections::HashSet::new();
    observations
        .iter()
        .zip(tilts)
        .map(|(o, tilt)| {
            let azimuth = PAPER_AZIMUTHS_DEG.iter().position(|a| {
                let off = (o.pose.phi_s - Angle::from_deg(*a)).wrapped();
                off.abs().deg() <= SNAP_DEG
            })?;
            taken.insert((tilt, azimuth)).then_some((tilt, azimuth))
        })
        .collect()
}

/// The contrast table of reduced observations and the standard uncertainty of every contrast: own noise of both, and
/// what white reference, lamp drift and stray light do to their difference.
fn of_observations(set: &ObservationSet, stray: &Stray) -> (Table, Vec<[Stds; 2]>) {
    let radiances = Radiances::of(set, stray);
    let places = places(&set.observations);
    let at = |place: (usize, usize)| places.iter().position(|p| *p == Some(place));
    let tilts = places.iter().flatten().map(|p| p.0).max();
    let mut exposures: Vec<Exposure> = Vec::new();
    let mut stds = Vec::new();
    for tilt in 0..tilts.map_or(0, |last| last + 1) {
        let [Some(a), Some(b), Some(c)] = [0, 1, 2].map(|azimuth| at((tilt, azimuth))) else {
            continue;
        };
        let three = [a, b, c];
        let mean: f64 = three
            .iter()
            .map(|n| set.observations[*n].pose.theta_c.deg() / 3.0)
            .sum();
        let theta_c = Angle::from_deg((mean * 100.0).round() / 100.0);
        for (n, azimuth) in three.iter().zip(PAPER_AZIMUTHS_DEG) {
            exposures.push(Exposure {
                theta_r: Angle::ZERO,
                theta_c,
                phi_s: Angle::from_deg(azimuth),
                radiance: radiances.values[*n],
            });
        }
        stds.push(PAIRS.map(|(_, j, k)| {
            let (j, k) = (three[j], three[k]);
            let (a, b) = (&set.observations[j], &set.observations[k]);
            let white = a.shared.white_reference - b.shared.white_reference;
            // As in a fit the lamp drifts between the white reference and the sample: one factor for all.
            let drift = a.shared.led_drift - b.shared.led_drift;
            let haze = (radiances.per_stray[j] - radiances.per_stray[k]) * stray.std;
            let signals = a.sigma.hypot(b.sigma).hypot(white).hypot(drift);
            let (x, y) = (radiances.values[j], radiances.values[k]);
            let sum = x + y;
            let hazes = (radiances.per_stray[j] + radiances.per_stray[k]) * stray.std;
            let of_sum = (a.sigma.hypot(b.sigma) / radiances.gain).hypot(hazes);
            // ∂/∂x (x − y)/(x + y) = 2y/(x + y)², ∂/∂y = −2x/(x + y)².
            let own = (y * a.sigma).hypot(x * b.sigma) / radiances.gain;
            let hazed = (y * radiances.per_stray[j] - x * radiances.per_stray[k]) * stray.std;
            Stds {
                absolute: (signals / radiances.gain).hypot(haze),
                michelson: match sum > COVERAGE_FACTOR * of_sum {
                    true => 2.0 * own.hypot(hazed) / (sum * sum),
                    false => f64::NAN,
                },
            }
        }));
    }
    (Table::of(&exposures), stds)
}

/// A table as an object; `stds` are the standard uncertainties of its contrasts (the absolute ones as radiance
/// for a lamp irradiance of 1; lines × pairs) where it was measured.
#[must_use]
pub fn as_json(table: &Table, stds: Option<&[[Stds; 2]]>) -> Value {
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
                    entry["absolute_std"] = json!(stds[n][pair].absolute);
                    entry["michelson_std"] = json!(stds[n][pair].michelson);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, RigGeometry};
    use crate::material::Material;
    use crate::observation::Prior;

    /// One tilt at the paper's azimuths; the signals are radiances.
    fn seen(signals: [f64; 3], sigma: f64, stray_std: f64) -> Value {
        let observations = signals.iter().zip(PAPER_AZIMUTHS_DEG);
        let observations = observations.map(|(signal, phi_s_deg)| {
            Observation::new(Pose::from_deg(0.0, phi_s_deg), *signal, sigma)
        });
        let set = ObservationSet::bare(
            RigGeometry::IN_PLANE,
            Material::exactly(1.54, 0.0),
            observations.collect(),
            Prior {
                mean: 0.0,
                std: stray_std,
            },
        );
        measure(&set).unwrap().1
    }

    #[test]
    fn a_michelson_contrast_has_the_uncertainty_of_its_two_signals_and_of_the_stray_light() {
        let (x, y, sigma, haze) = (0.3, 0.1, 1e-3, 2e-3);
        let ratio = |x: f64, y: f64| (x - y) / (x + y);
        let step = 1e-6;
        let by = |dx: f64, dy: f64| (ratio(x + dx, y + dy) - ratio(x - dx, y - dy)) / (2.0 * step);
        let own = by(step, 0.0).hypot(by(0.0, step)) * sigma;
        let expected = own.hypot(by(step, step) * haze);
        let report = seen([x, y, 0.2], sigma, haze);
        let pair = &report["lines"][0]["contrast"]["0-90"];
        let std = pair["michelson_std"].as_f64().unwrap();
        assert!((std / expected - 1.0).abs() < 1e-6, "{std} {expected}");
    }

    #[test]
    fn a_pair_as_dark_as_the_stray_light_is_known_has_no_michelson_contrast() {
        let report = seen([1e-4, 2e-4, 0.2], 1e-5, 2e-3);
        let line = &report["lines"][0]["contrast"];
        assert!(line["0-90"]["michelson"].is_null(), "{line}");
        let lit = line["90-180"]["michelson"].as_f64().unwrap();
        // Nor a part in a mean.
        assert_eq!(report["mean"]["by_theta_c"][0]["michelson"], lit);
    }
}
