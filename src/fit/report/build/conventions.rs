//! Asks whether another convention of angles, or another place of the lamp, describes poses that the model does not.
//!
//! Call [`other_convention`]. The starts that the bright spot suggests descend once for each convention, with weights that allow
//! errors of a few per cent.

use std::sync::atomic::AtomicBool;

use crate::fit::FitOptions;
use crate::fit::search_setup::Opening;
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Largest share of the residual that remains with the right convention.
const RIGHT: f64 = 0.2;
/// Ratio of residuals up to which two conventions cannot be distinguished.
const ALIKE: f64 = 2.0;

/// One convention: what is wrong if it fits, and its effect on the observations.
struct Convention {
    what: String,
    change: Box<dyn Fn(&mut ObservationSet)>,
}

/// Returns a warning that names the convention with which the observations fit, although they do not as stated; none if no
/// convention makes the residual five times smaller.
pub(super) fn other_convention(set: &ObservationSet) -> Option<String> {
    if !set.views.is_empty() {
        return None;
    }
    let as_stated = residual(set)?;
    let tried = conventions(set).into_iter().filter_map(|convention| {
        let mut changed = set.clone();
        (convention.change)(&mut changed);
        Some((residual(&changed)?, convention.what))
    });
    let mut tried: Vec<(f64, String)> = tried.collect();
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    // What remains of noise alone is no measure.
    let least = tried.first()?.0.max(as_stated * 1e-3);
    // Mirror images of the rig are alike.
    let alike = tried
        .iter()
        .filter(|(residual, _)| *residual <= ALIKE * least);
    let all: Vec<&str> = alike.map(|(_, what)| what.as_str()).collect();
    (least < RIGHT * as_stated).then(|| {
        format!(
            "The residual is {:.0} times smaller if {}. Correct it before you use any value.",
            as_stated / least,
            all.join(", or if ")
        )
    })
}

fn conventions(set: &ObservationSet) -> Vec<Convention> {
    let tilts = Convention {
        what: "the tilts θc count in the other direction (change the sign of theta_c_deg)"
            .to_owned(),
        change: Box::new(|set| {
            for o in &mut set.observations {
                o.pose.theta_c = -o.pose.theta_c;
            }
            for flat in &mut set.flats {
                flat.theta_c = -flat.theta_c;
            }
        }),
    };
    let azimuths = Convention {
        what: "the azimuths φs count in the other direction (change the sign of phi_s_deg)"
            .to_owned(),
        change: Box::new(|set| {
            for o in &mut set.observations {
                o.pose.phi_s = -o.pose.phi_s;
            }
        }),
    };
    let lamps = [90.0, 180.0, 270.0].map(|turn_deg| {
        let turned = set.rig.light_azimuth + Angle::from_deg(turn_deg);
        let stated_deg = turned.wrapped().deg();
        Convention {
            what: format!("the lamp is at rig.light_azimuth_deg = {stated_deg:.0}"),
            change: Box::new(move |set| set.rig.light_azimuth = turned),
        }
    });
    [tilts, azimuths].into_iter().chain(lamps).collect()
}

/// Returns the weighted residual of the best surface that the bright spot suggests.
fn residual(set: &ObservationSet) -> Option<f64> {
    let options = FitOptions::default();
    let opening = Opening::new(set, Variant::Sawtooth, &options);
    let cost = opening.first_cost(&options, &AtomicBool::new(false))?;
    cost.is_finite().then(|| cost.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::problem::{Problem, Quantity};
    use crate::geometry::{Pose, RigGeometry};

    fn poses() -> impl Iterator<Item = Pose> {
        (0..84).map(|n| Pose::from_deg(5.0 * f64::from(n / 12) - 15.0, f64::from(30 * (n % 12))))
    }

    fn seen_by(rig: RigGeometry) -> ObservationSet {
        let mut set = painted(poses(), &TRUTH, 1e-3, 5);
        set.rig = rig;
        let problem = Problem::new(&set, Variant::Sawtooth, Quantity::ALL.to_vec(), TRUTH);
        let clean = problem.predicted(&TRUTH);
        drop(problem);
        for (o, clean) in set.observations.iter_mut().zip(clean) {
            o.signal = clean;
        }
        set
    }

    #[test]
    fn the_slip_is_named_and_a_right_description_is_not_doubted() {
        let beside = seen_by(RigGeometry::BESIDE);
        let inside = seen_by(RigGeometry::IN_PLANE);
        assert_eq!(other_convention(&beside), None);
        assert_eq!(other_convention(&inside), None);
        let changed = |set: &ObservationSet, change: &dyn Fn(&mut ObservationSet)| {
            let mut set = set.clone();
            change(&mut set);
            other_convention(&set).unwrap_or_default()
        };
        let clockwise = changed(&beside, &|set| {
            for o in &mut set.observations {
                o.pose.phi_s = -o.pose.phi_s;
            }
        });
        assert!(
            clockwise.contains("azimuths φs count in the other"),
            "{clockwise}"
        );
        let signs = changed(&inside, &|set| {
            for o in &mut set.observations {
                o.pose.theta_c = -o.pose.theta_c;
            }
        });
        assert!(signs.contains("tilts θc count in the other"), "{signs}");
        let lamp = changed(&beside, &|set| set.rig.light_azimuth = Angle::ZERO);
        assert!(lamp.contains("rig.light_azimuth_deg = 90"), "{lamp}");
    }
}
