//! Every kernel at the limits of its domain: finite input gives a finite result or a named error.

use nalgebra::{Complex, Vector3};
use proptest::prelude::*;

use super::brdf::{self, Case};
use super::cone;
use super::contrast::Contrast;
use super::domain::check;
use super::flat_stack::FlatStack;
use super::fresnel::{Reflectances, amplitudes, reflectances};
use super::polarisation::Boundary;
use super::prepared::{OpticsTable, Prepared};
use super::quadrature::Quadrature;
use super::sawtooth::visible_and_lit_fraction;
use super::single_bounce::{Scattering, mueller_brdf};
use super::{Optics, Surface, Variant, radiance};
use crate::extremes::{any_double, cases, wide};
use crate::geometry::{Cones, Directions};
use crate::units::Angle;

/// An angle from n: any, or close to the horizon.
fn polar() -> impl Strategy<Value = f64> {
    prop_oneof![
        0.0..std::f64::consts::FRAC_PI_2,
        (-16.0..0.0f64).prop_map(|e| std::f64::consts::FRAC_PI_2 - 10f64.powf(e)),
        Just(std::f64::consts::FRAC_PI_2),
        Just(0.0),
    ]
}

prop_compose! {
    fn directions()(i in polar(), o in polar(), a in -7.0..7.0f64, b in prop_oneof![Just(0.0), Just(std::f64::consts::PI), -7.0..7.0f64])
        -> Directions
    {
        let of = |theta: f64, phi: f64| Vector3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
        Directions { incident: of(i, a), outgoing: of(o, a + b) }
    }
}

prop_compose! {
    fn surfaces()(theta_r in prop_oneof![polar(), polar().prop_map(|t| -t)], alpha_u in wide(1e-50, 1e50), alpha_v in wide(1e-6, 1e3),
                  rho_d in prop_oneof![Just(0.0), Just(1.0), 0.0..1.0f64], amplitude in wide(1e-12, 1e12)) -> Surface
    {
        Surface { theta_r, alpha_u, alpha_v, rho_d, amplitude }
    }
}

prop_compose! {
    fn optics()(eta in prop_oneof![wide(1e-6, 1e6), Just(1.0), Just(1.0 + 1e-12), 1.0..3.0f64],
                k in prop_oneof![Just(0.0), Just(30.0), wide(1e-15, 1e6)], theta_l in -1.5..1.5f64,
                lamp in prop_oneof![Just(0.0), 0.0..0.1f64],
                lens in prop_oneof![Just(0.0), 0.0..0.5f64]) -> Optics
    {
        let cones = Cones { lamp: Angle::from_rad(lamp), lens: Angle::from_rad(lens) };
        Optics { eta, k, theta_l, cones }
    }
}

fn in_unit(x: f64) -> bool {
    (0.0..=1.0 + 1e-12).contains(&x)
}

proptest! {
    #![proptest_config(cases(600))]

    #[test]
    fn the_printed_brdf_is_finite_or_refused(x in prop::array::uniform10(any_double())) {
        let case = Case {
            theta_i: x[0], phi_i: x[1], theta_o: x[2], phi_o: x[3], theta_r: x[4],
            alpha_u: x[5], alpha_v: x[6], rho_d: x[7], eta: x[8], k: x[9],
        };
        if let Ok(e) = brdf::evaluate(&case) {
            prop_assert!([e.f, e.d, e.g, e.fresnel].iter().all(|v| v.is_finite() && *v >= 0.0), "{e:?}");
        }
    }

    #[test]
    fn radiances_and_their_derivatives_are_finite_within_the_domain(d in directions(), s in surfaces(), o in optics()) {
        if check(&s, &o).is_ok() {
            for variant in [Variant::Paper, Variant::Sawtooth] {
                let value = radiance(variant, &d, &s, &o);
                prop_assert!(value.is_finite() && value >= 0.0, "{variant:?} {value}");
                let upright = Surface { theta_r: s.theta_r.abs(), ..s };
                let p = Prepared::new(variant, &upright, &OpticsTable::new(&o)).partials(&d);
                let slopes = [p.value, p.theta_r, p.alpha_u, p.alpha_v, p.amplitude];
                prop_assert!(slopes.iter().all(|v| v.is_finite()), "{variant:?} {p:?}");
            }
        }
    }

    #[test]
    fn fresnel_stays_between_0_and_1(cos in polar().prop_map(f64::cos), eta in wide(1e-6, 1e6), k in prop_oneof![Just(0.0), wide(1e-30, 1e6)]) {
        let (s, p) = reflectances(cos, eta, k);
        prop_assert!(in_unit(s) && in_unit(p), "{s} {p}");
        let (a, b) = amplitudes(cos, eta, k);
        prop_assert!(a.is_finite() && b.is_finite());
        let slopes = Reflectances::at(cos, eta, k);
        prop_assert!([slopes.s.value, slopes.p.value, slopes.s.cos, slopes.p.eta].iter().all(|x| x.is_finite()));
        let boundary = Boundary::new(1.0, eta, k);
        let split = boundary.at(cos);
        let (kept_s, kept_p) = boundary.kept(cos);
        let allowed = 1e-12;
        let reflected = [split.reflected.s, split.reflected.p];
        prop_assert!(reflected.iter().all(|r| (0.0..=1.0 + allowed).contains(r)), "{reflected:?}");
        prop_assert!((split.reflected.s + kept_s - 1.0).abs() < allowed, "{} {kept_s}", split.reflected.s);
        prop_assert!((split.reflected.p + kept_p - 1.0).abs() < allowed, "{} {kept_p}", split.reflected.p);
    }

    #[test]
    fn stacks_reflect_between_0_and_1(layers in prop::collection::vec(wide(1e-2, 1e2), 2..22), k in prop_oneof![Just(0.0), wide(1e-9, 1e3)], theta in any_double()) {
        let mut indices: Vec<Complex<f64>> = layers.iter().map(|n| Complex::new(*n, 0.0)).collect();
        if let Some(last) = indices.last_mut() { last.im = k; }
        if let Ok(r) = FlatStack::new(indices).and_then(|s| s.reflect(theta)) {
            prop_assert!(in_unit(r.channel.s) && in_unit(r.channel.p) && in_unit(r.scalar), "{r:?}");
            prop_assert!(r.channel.re.is_finite() && r.channel.im.is_finite());
        }
    }

    #[test]
    fn contrast_is_finite_and_michelson_s_is_at_most_1(a in any_double().prop_map(f64::abs), b in any_double().prop_map(f64::abs)) {
        let c = Contrast::between(a, b);
        prop_assert!(c.absolute.is_finite() && (0.0..=1.0 + 1e-15).contains(&c.michelson), "{c:?}");
        prop_assert_eq!(Contrast::between(a, 0.0).michelson, if a > 0.0 { 1.0 } else { 0.0 });
    }

    #[test]
    fn the_cones_nodes_are_an_average_of_unit_vectors(lamp in prop_oneof![Just(0.0), wide(1e-12, 0.3)], lens in prop_oneof![Just(0.0), wide(1e-12, 0.3)], alpha in wide(1e-9, 1e6), d in directions()) {
        let cones = Cones { lamp: Angle::from_rad(lamp), lens: Angle::from_rad(lens) };
        let nodes = cone::nodes(&cones, alpha);
        let mut sum = 0.0;
        for node in &nodes {
            sum += node.weight;
            let moved = cone::moved(&d, node);
            for w in [moved.incident, moved.outgoing] {
                prop_assert!((w.norm() - 1.0).abs() < 1e-12, "{w:?}");
            }
        }
        prop_assert!((sum - 1.0).abs() < 1e-12, "{sum}");
        let costs = cone::costs(&cones, alpha);
        prop_assert!(costs.widened.is_finite() && costs.widened >= 0.0, "{costs:?}");
    }

    #[test]
    fn the_visible_share_is_between_0_and_1(theta_r in 0.0..90.0f64, i in any_double(), o in any_double()) {
        let seen = visible_and_lit_fraction(theta_r, i, o);
        prop_assert!((0.0..=1.0).contains(&seen), "{seen}");
    }

    #[test]
    fn the_single_bounce_is_physical_or_refused(i in any_double(), s in any_double(), phi in any_double(), alpha in wide(1e-50, 1e50), n in wide(1e-3, 1e3), k in prop_oneof![Just(0.0), wide(1e-9, 1e3)]) {
        let scattering = Scattering { theta_i: i, theta_s: s, phi_s: phi };
        if let Some(m) = mueller_brdf(&scattering, alpha, n, k) {
            prop_assert!(m.0.iter().all(|x| x.is_finite()), "{m:?}");
            if m.0[(0, 0)] > 1e-200 {
                prop_assert!(m.smallest_cloude_share() > -1e-9);
            }
        }
    }
}

proptest! {
    #![proptest_config(cases(24))]

    #[test]
    fn the_quadrature_is_finite_within_the_domain(d in directions(), s in surfaces(), o in optics()) {
        let s = Surface { alpha_u: s.alpha_u.clamp(1e-6, 1e3), amplitude: 1.0, ..s };
        if check(&s, &o).is_ok() {
            let e = Quadrature::new(&s, &OpticsTable::new(&o)).radiance(&d, 1e-2);
            prop_assert!(e.value.is_finite() && e.error.is_finite(), "{e:?}");
        }
    }
}
