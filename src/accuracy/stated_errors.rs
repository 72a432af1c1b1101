//! Errors of the size that a series states for its rig, its reference and its material, drawn at random.
//!
//! A recorded series has one error of each kind, and a synthetic one often has none. Fits of the series with drawn errors
//! show whether the expanded uncertainties cover the errors for which their budgets have lines.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use crate::material::Material;
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Returns the set as a lab would have it with other errors, one normal draw of each stated standard uncertainty: zero and
/// scale of the tilt, zero and eccentricity of the rotation, lamp angle, certificate of the reference, lamp drift,
/// camera, and index. The errors are those of the budget of a fit (`fit::budget`). The light that was measured stays; what
/// is recorded or stated about it changes, so the true values stay, too.
#[must_use]
pub fn with_stated_errors(set: &ObservationSet, seed: u64) -> ObservationSet {
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut draw = || -> f64 { random.sample(StandardNormal) };
    let mut set = set.with_lamp_moved(Angle::from_rad(
        draw() * set.theta_l_std.map_or(0.0, Angle::rad),
    ));
    let tilt_scale = set.tilt_scale();
    let [zero, scale, turn, sine, cosine] = std::array::from_fn(|_| draw());
    let [reference, drift, detector] = std::array::from_fn(|_| draw());
    let tilted =
        |tilt: Angle, std: Angle| Angle::from_rad(std.rad() * (zero + scale * tilt_scale(tilt)));
    let of_flats = set.observations.first().map(|o| o.shared.theta_c_zero);
    for flat in &mut set.flats {
        flat.theta_c += tilted(flat.theta_c, of_flats.unwrap_or(Angle::ZERO));
    }
    for (i, o) in set.observations.iter_mut().enumerate() {
        let (sin, cos) = o.pose.phi_s.sin_cos();
        let by_tilt = tilted(o.pose.theta_c, o.shared.theta_c_zero);
        let by_turn = o.shared.phi_s_zero.rad() * (turn + sine * sin + cosine * cos);
        o.pose.theta_c += by_tilt;
        o.pose.phi_s += Angle::from_rad(by_turn);
        o.signal += drift * o.shared.led_drift + detector * o.shared.detector;
        for view in set.views.get_mut(i).into_iter().flatten() {
            view.directions = view.directions.tilted(by_tilt);
        }
    }
    if let Some(white) = &mut set.white_reference {
        white.reflectance += reference * white.reflectance_std;
    }
    match &mut set.material {
        Material::Dielectric { eta, eta_std } => *eta += draw() * *eta_std,
        Material::Conductor {
            eta,
            k,
            eta_std,
            k_std,
        } => {
            *eta += draw() * *eta_std;
            *k += draw() * *k_std;
        }
    }
    set
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, RigGeometry};
    use crate::observation::{Observation, Prior, View, WhiteReference};

    fn stated() -> ObservationSet {
        let observations = (0..40).map(|i| {
            let mut o = Observation::new(
                Pose::from_deg(f64::from(i - 20), f64::from(9 * i)),
                1.0,
                0.01,
            );
            o.shared.theta_c_zero = Angle::from_deg(0.02);
            o.shared.phi_s_zero = Angle::from_deg(0.05);
            o.shared.led_drift = 0.001;
            o
        });
        let material = Material::Dielectric {
            eta: 1.5,
            eta_std: 0.01,
        };
        let dark = Prior {
            mean: 0.0,
            std: 0.005,
        };
        let rig = RigGeometry::IN_PLANE;
        ObservationSet {
            white_reference: Some(WhiteReference {
                reflectance: 0.99,
                reflectance_std: 0.005,
            }),
            ..ObservationSet::bare(rig, material, observations.collect(), dark)
        }
    }

    #[test]
    fn errors_have_the_stated_sizes() {
        let set = stated();
        let draws: Vec<ObservationSet> = (0..2000)
            .map(|seed| with_stated_errors(&set, seed))
            .collect();
        let std_of = |error: &dyn Fn(&ObservationSet) -> f64| {
            let squares = draws.iter().map(|d| error(d) * error(d)).sum::<f64>();
            (squares / draws.len() as f64).sqrt()
        };
        let tilt = |i: usize| {
            std_of(&|d| (d.observations[i].pose.theta_c - set.observations[i].pose.theta_c).deg())
        };
        let close = |value: f64, expected: f64| {
            assert!(
                (value / expected - 1.0).abs() < 0.06,
                "{value} for {expected}"
            );
        };
        // The scale adds to the zero at the ends of the range and not in its middle.
        close(tilt(0), 0.02 * 2f64.sqrt());
        close(tilt(20), 0.02);
        // Zero and eccentricity are independent, and the eccentricity has the same size at each azimuth.
        for i in [0, 10, 23] {
            let turned = |d: &ObservationSet| {
                (d.observations[i].pose.phi_s - set.observations[i].pose.phi_s).deg()
            };
            close(std_of(&turned), 0.05 * 2f64.sqrt());
        }
        close(std_of(&|d| d.observations[7].signal - 1.0), 0.001);
        close(
            std_of(&|d| d.white_reference.unwrap().reflectance - 0.99),
            0.005,
        );
        close(std_of(&|d| d.material.index().0 - 1.5), 0.01);
        assert_eq!(with_stated_errors(&set, 3), draws[3]);
    }

    #[test]
    fn the_directions_of_a_near_rig_follow_its_recorded_tilt() {
        let mut set = stated();
        let recorded = |set: &ObservationSet, i: usize| {
            set.rig.rig_directions(set.observations[i].pose.theta_c)
        };
        let views = (0..40).map(|i| {
            let directions = recorded(&set, i);
            let weight = 0.5;
            vec![View { directions, weight }; 2]
        });
        set.views = views.collect();
        let drawn = with_stated_errors(&set, 5);
        for (i, views) in drawn.views.iter().enumerate() {
            assert_ne!(
                drawn.observations[i].pose.theta_c,
                set.observations[i].pose.theta_c
            );
            for view in views {
                let expected = recorded(&drawn, i);
                assert!((view.directions.outgoing - expected.outgoing).norm() < 1e-12);
                assert!((view.directions.incident - expected.incident).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn nothing_changes_where_nothing_is_stated() {
        let mut set = stated();
        set.material = Material::exactly(1.5, 0.0);
        set.white_reference = None;
        for o in &mut set.observations {
            o.shared = Default::default();
        }
        assert_eq!(with_stated_errors(&set, 1), set);
    }
}
