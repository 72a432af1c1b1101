//! The first paper's contrast, measured in the observations of a scan, and the report of a contrast table.
//!
//! [`measure`] is the function to call; [`ReportedTable::predicted`] reports a table from
//! [`crate::model::contrast::predict`]. Source: Luongo et al. 2017, section 4 and Fig. 8.
//! This module knows neither frames nor files.

mod compared_tilts;
mod report;
mod scan;
mod slopes;
mod stray_light;

use crate::forecast::Expected;
use crate::model::LeftOut;
use crate::model::contrast::Table;
use crate::observation::ObservationSet;
use crate::units::Angle;
use crate::wording::counted;
pub use compared_tilts::{ComparedTilts, CompleteTilt, missing_poses};
pub use report::{ContrastReport, ReportedContrast, ReportedFindings, ReportedTable};
pub use scan::{ContrastKind, ContrastScan, ContrastValue, ScanPair};
pub use slopes::{RadianceSlope, RadianceSlopes};
pub use stray_light::{SampleRadiances, StrayLight};

/// No tilt has frames at all three of the paper's azimuths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no camera tilt has frames at all of the azimuths 0, 90 and 180 degrees")]
pub struct NoContrast;

/// The contrast table of a scan and its report for scripts (`contrast --json`).
///
/// # Errors
/// [`NoContrast`] where no tilt was observed at φs = 0°, 90° and 180°.
pub fn measure(set: &ObservationSet) -> Result<(Table, ContrastReport), NoContrast> {
    let scan = ContrastScan::of(set);
    let table = Table::of(&scan.exposures());
    if table.lines.is_empty() {
        return Err(NoContrast);
    }
    let table = table.without_dark(|line, pair| !scan.is_lit((line, pair)));
    let mut warnings = set.warnings.clone();
    if set.white_reference.is_none() {
        warnings.push(
            "without a white reference, absolute contrasts are fractions of the brightest level; Michelson contrast does not need one"
                .to_owned(),
        );
    }
    warnings.extend(scan.turns.left_out());
    warnings.extend(scan.turns.substitutions(&scan::poses(set)));
    let pairs = scan.pairs();
    let dark = pairs.iter().filter(|pair| !scan.is_lit(**pair)).count();
    if dark > 0 {
        warnings.push(format!(
            "{} darker than the uncertainty of the stray light: no Michelson contrast",
            counted(dark, "pair")
        ));
    }
    // The error: the largest standard uncertainty of a contrast, relative to the largest contrast.
    let known: Vec<ContrastValue> = pairs
        .iter()
        .map(|pair| scan.mean(ContrastKind::Absolute, &[*pair]))
        .collect();
    let largest = |of: fn(&ContrastValue) -> f64| known.iter().map(of).fold(0.0, f64::max);
    let brightest = largest(|k| k.value);
    let model_error = (brightest > 0.0).then(|| Expected {
        value: largest(|k| k.std) / brightest,
        of: "a contrast, of the largest".to_owned(),
    });
    let mut left_out = vec![
        LeftOut::new(
            "directions of single pixels",
            "the mean over the region is taken as seen from its centre, as in the paper",
            None,
        ),
        LeftOut::new(
            "lobes narrower than the spacing of the poses",
            "the effect of stage errors is estimated from the radiances of neighbouring poses",
            None,
        ),
    ];
    left_out.extend(angles_left_out(&known, brightest));
    if set.theta_l_std.is_none() {
        left_out.push(LeftOut::new(
            "uncertainty of the angle between lamp and camera",
            "an error of the angle between lamp and camera moves every half vector by half of it; set rig.theta_l_std_deg",
            None,
        ));
    }
    let report = ContrastReport {
        table: ReportedTable::measured(&table, &scan),
        mode: "measured",
        region: set.region.clone(),
        scale: match set.white_reference {
            Some(_) => "white reference",
            None => "arbitrary",
        },
        stray_light: scan.stray,
        warnings,
        model_error,
        left_out,
    };
    Ok((table, report))
}

/// Stage errors that no uncertainty includes, because no neighbouring pose shows their effect.
#[must_use]
pub fn angles_left_out(known: &[ContrastValue], largest: f64) -> Option<LeftOut> {
    let most = known.iter().map(|k| k.may_cost).fold(0.0, f64::max);
    (most > 0.0).then(|| {
        LeftOut::new(
            "errors of the stages where poses have no neighbours",
            "there, the change of the radiance with the angle is unknown",
            (most.is_finite() && largest > 0.0).then(|| most / largest),
        )
    })
}

/// Degrees, without the rounding error of the conversion to radians and back.
#[must_use]
pub fn rounded_deg(a: Angle) -> f64 {
    (a.deg() * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::geometry::{Pose, RigGeometry};
    use crate::material::Material;
    use crate::model::contrast::PAPER_AZIMUTHS_DEG;
    use crate::observation::{Observation, Prior, SharedErrors};

    /// One tilt at the paper's azimuths; the signals are radiances.
    fn measured(signals: [f64; 3], sigma: f64, stray_std: f64) -> Value {
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
        written(&set)
    }

    /// The report as scripts read it.
    fn written(set: &ObservationSet) -> Value {
        serde_json::to_value(measure(set).unwrap().1).unwrap()
    }

    #[test]
    fn a_michelson_contrast_has_the_uncertainty_of_its_two_signals_and_of_the_stray_light() {
        let (x, y, sigma, haze) = (0.3, 0.1, 1e-3, 2e-3);
        let ratio = |x: f64, y: f64| (x - y) / (x + y);
        let step = 1e-6;
        let by = |dx: f64, dy: f64| (ratio(x + dx, y + dy) - ratio(x - dx, y - dy)) / (2.0 * step);
        let own = by(step, 0.0).hypot(by(0.0, step)) * sigma;
        let expected = own.hypot(by(step, step) * haze);
        let report = measured([x, y, 0.2], sigma, haze);
        let pair = &report["lines"][0]["contrast"]["0-90"];
        let std = pair["michelson_std"].as_f64().unwrap();
        assert!((std / expected - 1.0).abs() < 1e-6, "{std} {expected}");
    }

    #[test]
    fn a_pair_as_dark_as_the_stray_light_is_known_has_no_michelson_contrast() {
        let report = measured([1e-4, 2e-4, 0.2], 1e-5, 2e-3);
        let line = &report["lines"][0]["contrast"];
        assert!(line["0-90"]["michelson"].is_null(), "{line}");
        let lit = line["90-180"]["michelson"].as_f64().unwrap();
        // It does not count in a mean either.
        assert_eq!(report["mean"]["by_theta_c"][0]["michelson"], lit);
    }

    fn lobe(tilt_rad: f64, azimuth_rad: f64) -> f64 {
        let lean = tilt_rad - 0.12 * (azimuth_rad - 0.3).cos();
        0.1 + 0.3 * (-(lean / 0.2).powi(2)).exp()
    }

    /// That lobe every 2° and 15°, by stages whose angles are known to `zero_deg`.
    fn lobes(zero_deg: f64) -> ObservationSet {
        let zero = Angle::from_deg(zero_deg);
        let at = |(tilt_deg, azimuth_deg): (f64, f64)| Observation {
            shared: SharedErrors {
                theta_c_zero: zero,
                phi_s_zero: zero,
                ..SharedErrors::default()
            },
            ..Observation::new(
                Pose::from_deg(tilt_deg, azimuth_deg),
                lobe(tilt_deg.to_radians(), azimuth_deg.to_radians()),
                1e-9,
            )
        };
        let tilts = (-6..=6).map(|n| 2.0 * f64::from(n));
        let poses = tilts.flat_map(|tilt| (0..24).map(move |n| (tilt, 15.0 * f64::from(n))));
        ObservationSet::bare(
            RigGeometry::IN_PLANE,
            Material::exactly(1.54, 0.0),
            poses.map(at).collect(),
            Prior {
                mean: 0.0,
                std: 0.0,
            },
        )
    }

    /// Errors of the recorded θc and φs at a pose (rad).
    type PoseError<'a> = &'a dyn Fn(&Pose) -> [f64; 2];

    #[test]
    fn errors_of_the_stages_are_common_to_all_poses_and_do_not_average_out() {
        let set = lobes(0.02);
        let scan = ContrastScan::of(&set);
        let zero = 0.02_f64.to_radians();
        // Source by source: the tilt's zero and its range, the rotation's zero and its eccentricity.
        let sources: [PoseError<'_>; 5] = [
            &|_| [zero, 0.0],
            &|p| [zero * p.theta_c.deg() / 12.0, 0.0],
            &|_| [0.0, zero],
            &|p| [0.0, zero * p.phi_s.rad().sin()],
            &|p| [0.0, zero * p.phi_s.rad().cos()],
        ];
        let moved = sources.map(|source| {
            let mut moved = set.clone();
            for o in &mut moved.observations {
                let [tilt, turn] = source(&o.pose);
                o.signal = lobe(o.pose.theta_c.rad() + tilt, o.pose.phi_s.rad() + turn);
            }
            moved
        });
        let all = scan.pairs();
        let single = all.iter().map(|pair| vec![*pair]);
        for pairs in single.chain([all.clone()]) {
            for kind in [ContrastKind::Absolute, ContrastKind::Michelson] {
                let known = scan.mean(kind, &pairs);
                let change = |moved: &ObservationSet| {
                    ContrastScan::of(moved).mean(kind, &pairs).value - known.value
                };
                let expected = moved.iter().map(change).fold(0.0, f64::hypot);
                assert!(expected > 1e-6, "{pairs:?} {expected}");
                // Slopes from neighbours are accurate to a few percent, and less so at the ends of the tilts.
                let ratio = known.std / expected;
                let (least, most) = match pairs.len() {
                    1 => (0.85, 1.3),
                    _ => (0.95, 1.1),
                };
                assert!(ratio > least && ratio < most, "{pairs:?} {kind:?}: {ratio}");
            }
        }
    }

    /// Signals of a lobe about a facet that leans along v, as a rig of an angle between lamp and camera sees it.
    fn facet(rig: RigGeometry, pose: Pose, theta_l: Angle) -> f64 {
        let d = RigGeometry { theta_l, ..rig }.directions(pose);
        let h = d.incident + d.outgoing;
        let (along_u, along_v) = (h.x / h.z, h.y / h.z - 0.12);
        0.1 + 0.3 * (-(along_u / 0.25).powi(2) - (along_v / 0.2).powi(2)).exp()
    }

    #[test]
    fn the_effect_of_the_lamp_angle_follows_from_tilts_and_rotations() {
        let off = Angle::from_deg(0.2);
        for rig in [RigGeometry::IN_PLANE, RigGeometry::BESIDE] {
            let mut set = lobes(0.0);
            set.rig = rig;
            set.theta_l_std = Some(off);
            let seen = |theta_l: Angle| {
                let mut seen = set.clone();
                for o in &mut seen.observations {
                    o.signal = facet(rig, o.pose, theta_l);
                }
                seen
            };
            let set = seen(rig.theta_l);
            let (less, more) = (seen(rig.theta_l - off), seen(rig.theta_l + off));
            let by = |tilt: f64, turn: f64| {
                let at = |o: &Observation, sign: f64| {
                    let angle = |by: f64| Angle::from_rad(sign * by);
                    let pose = Pose {
                        theta_c: o.pose.theta_c + angle(tilt),
                        phi_s: o.pose.phi_s + angle(turn),
                    };
                    facet(rig, pose, rig.theta_l)
                };
                let slope = |o: &Observation| {
                    let value = (at(o, 1.0) - at(o, -1.0)) / (2.0 * tilt.max(turn));
                    Some(RadianceSlope { value, std: 0.0 })
                };
                set.observations.iter().map(slope).collect()
            };
            let exact = RadianceSlopes {
                theta_c: by(1e-5, 0.0),
                phi_s: by(0.0, 1e-5),
            };
            let by_neighbours = ContrastScan::of(&set);
            let by_slopes = by_neighbours.clone().with_slopes(exact);
            let (less, more) = (ContrastScan::of(&less), ContrastScan::of(&more));
            for pairs in [by_slopes.pairs(), vec![(2, 0)], vec![(9, 1)]] {
                for kind in [ContrastKind::Absolute, ContrastKind::Michelson] {
                    let known = by_slopes.mean(kind, &pairs);
                    let change = more.mean(kind, &pairs).value - less.mean(kind, &pairs).value;
                    let expected = 0.5 * change.abs();
                    assert!(expected > 1e-6, "{pairs:?} {expected}");
                    let ratio = known.std / expected;
                    assert!((ratio - 1.0).abs() < 0.03, "{pairs:?} {kind:?}: {ratio}");
                    // Slopes from neighbours 2° and 15° away are less accurate; in the mean of all pairs they almost cancel.
                    let ratio = by_neighbours.mean(kind, &pairs).std / expected;
                    let single = pairs.len() == 1;
                    assert!(
                        !single || ratio > 0.7 && ratio < 1.5,
                        "{pairs:?} {kind:?}: {ratio}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_common_dark_level_changes_only_michelson_contrast() {
        let known = |dark_std: f64| {
            let mut set = lobes(0.0);
            set.dark_std = dark_std;
            let scan = ContrastScan::of(&set);
            let pairs = scan.pairs();
            [ContrastKind::Absolute, ContrastKind::Michelson]
                .map(|kind| scan.mean(kind, &pairs).std)
        };
        let (none, some) = (known(0.0), known(1e-3));
        assert!(some[0] < 1.01 * none[0], "{some:?} {none:?}");
        let raised = |by: f64| {
            let mut set = lobes(0.0);
            for o in &mut set.observations {
                o.signal += by;
            }
            let scan = ContrastScan::of(&set);
            scan.mean(ContrastKind::Michelson, &scan.pairs()).value
        };
        let expected = (raised(1e-3) - raised(0.0)).abs();
        assert!(
            (some[1] / expected - 1.0).abs() < 0.02,
            "{some:?} {expected}"
        );
    }

    #[test]
    fn a_slope_without_neighbours_is_listed_as_left_out() {
        let set = lobes(0.02);
        let kept = |keep: fn(&Pose) -> bool| {
            let mut few = set.clone();
            few.observations.retain(|o| keep(&o.pose));
            written(&few)
        };
        let named = |report: &Value| {
            let list = report["left_out"].as_array().unwrap().clone();
            list.into_iter()
                .find(|l| l["what"] == "errors of the stages where poses have no neighbours")
        };
        assert_eq!(named(&kept(|_| true)), None);
        // With only the paper's azimuths, the slopes in tilt bound those in azimuth.
        let paper = kept(|p| (p.phi_s.deg() / 90.0).fract() == 0.0);
        let cost = named(&paper).unwrap()["cost"].as_f64().unwrap();
        assert!(cost > 0.0 && cost < 0.05, "{cost}");
        // A single tilt gives no bound.
        let one = kept(|p| p.theta_c == Angle::ZERO);
        assert!(named(&one).unwrap()["cost"].is_null());
    }

    #[test]
    fn a_substituted_azimuth_is_named_and_adds_to_the_uncertainty() {
        let exact = written(&lobes(0.0));
        let mut beside = lobes(0.0);
        for o in &mut beside.observations {
            o.pose.phi_s = o.pose.phi_s - Angle::from_deg(0.4);
        }
        let off = written(&beside);
        let said = |report: &Value| report["warnings"].to_string();
        assert!(!said(&exact).contains("in place of"), "{}", said(&exact));
        assert!(
            said(&off).contains("φs 89.600° in place of 90°"),
            "{}",
            said(&off)
        );
        let std = |report: &Value| report["mean"]["all"]["absolute_std"].as_f64().unwrap();
        let value = |report: &Value| report["mean"]["all"]["absolute"].as_f64().unwrap();
        assert!(std(&exact) < 1e-8, "{}", std(&exact));
        assert!(std(&off) > 1e-5, "{}", std(&off));
        assert_eq!(value(&off), value(&exact));
    }
}
