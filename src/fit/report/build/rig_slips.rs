//! Warnings about slips in the description of rig and poses: angles in radians, a wrong angle between lamp and camera, a sample
//! that is tilted more than stated.

use std::f64::consts::{FRAC_PI_2, TAU};

use crate::fit::causes::wedge::Across;
use crate::fit::estimate::Estimate;
use crate::fit::problem::Quantity;
use crate::fit::uncertainty::budget::Uncertainty;
use crate::observation::ObservationSet;
use crate::units::Angle;
use crate::wording::significant;

/// Distinct angles from which a range says something about their unit.
const SEVERAL: usize = 3;
/// Smallest range of azimuths, in the numbers stated, that is meant to go around.
const AROUND: f64 = 3.0;
/// Tilt offset that no stage's zero has by itself, degrees.
const FAR_OFF_DEG: f64 = 1.0;
/// Standard uncertainties above which an offset is no scatter.
const CLEAR: f64 = 4.0;

/// Lists the slips that an estimate shows.
pub(super) fn rig_slips(e: &Estimate<'_>, u: &Uncertainty) -> Vec<String> {
    let set = e.problem.set();
    let mut found = in_radians(set);
    // Offsets of a fit that missed the data mean nothing.
    if found.is_empty() && e.explained {
        found.extend(lamp_angle(e, u));
    }
    found
}

/// Names a tilt across the ridges that exceeds the stated wedge of the sample by far.
pub(super) fn steeper_than_stated(set: &ObservationSet, across: &Across) -> Option<String> {
    let stated = set.wedge_std?.deg();
    let (tilt, std) = (across.wedge_deg.abs(), across.wedge_std_deg?);
    (tilt > CLEAR * stated.hypot(std)).then(|| {
        format!(
            "The sample is tilted by {} ± {}° across the ridges, but rig.sample_wedge_std_deg states {}°. A tilt along the \
             other direction shifts θr degree for degree, and no frame shows it: level the sample, or state the wedge.",
            significant(tilt),
            significant(2.0 * std),
            (stated * 1e4).round() / 1e4
        )
    })
}

/// Angles that are probably in radians, because no larger number is among them.
fn in_radians(set: &ObservationSet) -> Vec<String> {
    let spread = |angle: &dyn Fn(usize) -> Angle| {
        let mut all: Vec<f64> = (0..set.observations.len())
            .map(|i| angle(i).deg())
            .collect();
        all.sort_by(f64::total_cmp);
        all.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        let range = (all.first().copied()?, all.last().copied()?);
        (all.len() >= SEVERAL).then_some(range)
    };
    let mut found = Vec::new();
    if let Some((low, high)) = spread(&|i| set.observations[i].pose.theta_c)
        && low.abs().max(high.abs()) <= FRAC_PI_2
    {
        found.push(format!(
            "All tilts θc are between {}° and {}°. If the table states radians, convert them to degrees.",
            significant(low),
            significant(high)
        ));
    }
    if let Some((low, high)) = spread(&|i| set.observations[i].pose.phi_s)
        && low.abs().max(high.abs()) <= TAU + 1e-3
        && high - low > AROUND
    {
        found.push(format!(
            "All azimuths φs are between {}° and {}°. If the table states radians, convert them to degrees.",
            significant(low),
            significant(high)
        ));
    }
    found
}

/// A tilt offset that a wrong angle between lamp and camera explains: the facets see the direction midway between them.
fn lamp_angle(e: &Estimate<'_>, u: &Uncertainty) -> Option<String> {
    let rig = &e.problem.set().rig;
    let j = e.problem.column(Quantity::TiltOffset)?;
    let offset = e.values.folded().tilt_offset.to_degrees();
    let std = u.budgets[j].combined().to_degrees();
    let in_plane = rig.light_azimuth.sin_cos().0.abs() < 1e-6;
    let clear = u.covariance.identifiable[j] && offset.abs() > FAR_OFF_DEG.max(CLEAR * std);
    (in_plane && clear && e.problem.set().views.is_empty()).then(|| {
        let towards = rig.light_azimuth.sin_cos().1;
        format!(
            "The tilt offset is {offset:.2}°. Either the zero of θc is off by as much, or rig.theta_l_deg = {} is wrong, \
             for which about {:.1}° would fit. Check the angle between lamp and camera.",
            significant(rig.theta_l.deg()),
            rig.theta_l.deg() + 2.0 * offset * towards
        )
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::FitOptions;
    use crate::fit::one_variant::estimate;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::uncertainty::budget::uncertainty;
    use crate::geometry::Pose;
    use crate::model::Variant;

    fn poses(unit: f64) -> impl Iterator<Item = Pose> {
        (0..60).map(move |n| {
            let (tilt, azimuth) = (f64::from(n / 12) - 2.0, f64::from(n % 12));
            Pose::from_deg(8.0 * tilt * unit, 30.0 * azimuth * unit)
        })
    }

    #[test]
    fn tilts_and_azimuths_in_radians_are_asked_about() {
        let found = in_radians(&painted(poses(1f64.to_radians()), &TRUTH, 1e-3, 1));
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].contains("tilts") && found[1].contains("azimuths"));
        assert_eq!(
            in_radians(&painted(poses(1.0), &TRUTH, 1e-3, 1)),
            Vec::<String>::new()
        );
        // A scan along one line has two azimuths, 0 and 180.
        let line = (0..9).map(|n| Pose::from_deg(f64::from(n) - 4.0, f64::from(n % 2) * 180.0));
        assert_eq!(
            in_radians(&painted(line, &TRUTH, 1e-3, 1)),
            Vec::<String>::new()
        );
    }

    #[test]
    fn a_wrong_angle_of_the_lamp_is_named_with_the_one_that_fits() {
        let mut set = painted(poses(1.0), &TRUTH, 1e-3, 1);
        let right = set.rig.theta_l;
        let message = |set: &ObservationSet| {
            let cancel = AtomicBool::new(false);
            let options = FitOptions::default();
            let e = estimate(set, Variant::Sawtooth, &options, None, &cancel).unwrap();
            rig_slips(&e, &uncertainty(&e)).pop()
        };
        assert_eq!(message(&set), None);
        set.rig.theta_l = right + Angle::from_deg(6.0);
        let text = message(&set).unwrap();
        // 10°, to the first order of the offset.
        assert!(text.contains("for which about 9.9° would fit"), "{text}");
    }
}
