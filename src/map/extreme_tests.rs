//! The map's lanes at the limits of floating point: finite input gives a finite or flagged result.

use proptest::prelude::*;
use pulp::Scalar;

use super::pixels::{Instructions, PixelFitter};
use super::solve::inverse::invert;
use super::solve::kernel::{FREE, Geometry, PACKED, single};
use super::solve::{LOWER, UPPER};
use crate::extremes::{any_double, cases};
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::model::lanes::Lane;

/// Any signal of a pixel: every exponent of a single, and ordinary values.
fn any_single() -> impl Strategy<Value = f32> {
    prop_oneof![
        prop::sample::select(vec![
            0.0,
            1.0,
            f32::MAX,
            -f32::MAX,
            f32::MIN_POSITIVE,
            1e-45
        ]),
        proptest::num::f32::NORMAL | proptest::num::f32::SUBNORMAL,
        0.0..1.0f32,
    ]
}

/// Parameters within the bounds of a descent.
fn parameters() -> impl Strategy<Value = [f64; FREE]> {
    let within = |k: usize| prop_oneof![LOWER[k]..=UPPER[k], Just(LOWER[k]), Just(UPPER[k])];
    (within(0), -1e3..1e3f64, within(2), within(3), within(4))
        .prop_map(|(a, b, c, d, e)| [a, b, c, d, e])
}

prop_compose! {
    /// A direction away from the surface, down to the horizon.
    fn upwards()(theta in prop_oneof![0.0..std::f64::consts::FRAC_PI_2, (-16.0..0.0f64).prop_map(|e| std::f64::consts::FRAC_PI_2 - 10f64.powf(e))], phi in 0.0..std::f64::consts::TAU) -> [f64; 3] {
        [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
    }
}

proptest! {
    #![proptest_config(cases(600))]

    #[test]
    fn a_single_reflection_and_its_slopes_are_finite(i in upwards(), o in upwards(), p in parameters(), f in 0.0..=1.0f64, lamp in prop_oneof![Just(0.0), 0.0..1e-2f64]) {
        let geometry = Geometry::new(i, o, f);
        let (value, slopes) = single(&geometry, &p, lamp);
        prop_assert!(value.is_finite() && value >= 0.0, "{value}");
        prop_assert!(slopes.iter().all(|x| x.is_finite()), "{slopes:?}");
        let facing = geometry.facing(&p);
        prop_assert!(facing.is_finite() && facing >= 0.0, "{facing}");
    }

    #[test]
    fn the_lanes_exponential_is_a_share(q in any_double().prop_map(f64::abs)) {
        let e = Lane::splat(Scalar::new(), q).exp_neg().1;
        prop_assert!((0.0..=1.0).contains(&e), "{e}");
        prop_assert!((e - (-q.min(60.0)).exp()).abs() <= 1e-14 * e, "{q} {e}");
    }

    #[test]
    fn an_inverse_is_finite_or_there_is_none(normal in prop::array::uniform15(any_double())) {
        let packed: [f64; PACKED] = normal;
        if let Some(inverse) = invert(&packed) {
            prop_assert!(inverse.iter().all(|x| !x.is_nan()), "{inverse:?}");
        }
    }
}

proptest! {
    #![proptest_config(cases(32))]

    #[test]
    fn a_pixel_of_any_counts_ends_in_numbers(
        signal in prop::collection::vec(any_single(), 8), sigma in prop::collection::vec(any_single().prop_map(f32::abs), 8),
        start in parameters(), metal in any::<bool>(),
    ) {
        let material = if metal {
            Material::Conductor { eta: 2.9, k: 3.1, eta_std: 0.0, k_std: 0.0 }
        } else {
            Material::Dielectric { eta: 1.54, eta_std: 0.0 }
        };
        let poses = (0..8).map(|n| Pose::from_deg(10.0 * f64::from(n % 2), 45.0 * f64::from(n))).collect();
        let fitter = PixelFitter::new(RigGeometry::IN_PLANE, material, poses);
        let found = fitter.fit(signal, sigma, &[start], 1, Instructions::Widest)[0];
        // Pixels with fewer observations than unknowns are not fitted, and flagged.
        if found.evaluations == 0.0 {
            prop_assert!(!found.converged && found.std.is_none(), "{found:?}");
            return Ok(());
        }
        prop_assert!(found.values.iter().all(|x| x.is_finite()), "{found:?}");
        prop_assert!(!found.chi2.is_nan(), "{found:?}");
        prop_assert!(found.std.is_none_or(|s| s.iter().all(|x| !x.is_nan())), "{found:?}");
        prop_assert!(!found.converged || found.chi2.is_finite(), "{found:?}");
    }
}
