//! The tracer's kernels at the limits of their domain: finite input gives finite output or a named
//! end.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::Vector3;
use proptest::prelude::*;

use super::counting::grid::DirectionGrid;
use super::facets::scattering::{DiffuseBody, Roughness};
use super::pose_radiance::{RadianceOptions, RidgedSurface};
use super::rng::{Purpose, RandomStream};
use super::surfaces::height_field::{Flight, HeightField, Side};
use super::surfaces::surface_profile::{ProfileFlight, SurfaceProfile};
use super::vec3::{V3, dot};
use crate::extremes::{any_double, cases, wide};
use crate::geometry::{Cones, Directions};
use crate::model::polarisation::Boundary;
use crate::units::Angle;

/// An angle from n: anywhere above the surface, vertical, or almost horizontal.
fn polar() -> impl Strategy<Value = f64> {
    prop_oneof![
        0.0..FRAC_PI_2,
        Just(0.0),
        (-15.0..0.0f64).prop_map(|e| FRAC_PI_2 - 10f64.powf(e)),
    ]
}

prop_compose! {
    /// A unit vector pointing upwards.
    fn upwards()(theta in polar(), phi in prop_oneof![0.0..TAU, prop::sample::select(vec![0.0, 0.25 * TAU, 0.5 * TAU, 0.75 * TAU])]) -> V3 {
        [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
    }
}

prop_compose! {
    /// A unit vector in any direction.
    fn anywhere()(w in upwards(), down in any::<bool>()) -> V3 {
        if down { w.map(|x| -x) } else { w }
    }
}

fn is_unit(w: &V3) -> bool {
    (dot(w, w) - 1.0).abs() < 1e-9
}

proptest! {
    #![proptest_config(cases(400))]

    #[test]
    fn light_on_a_rough_facet_leaves_or_hits_a_normal_that_faces_it(k in anywhere(), alpha_u in wide(1e-12, 1e12), alpha_v in wide(1e-12, 1e12), height in 0.0..=1.0f64, seed in any::<u64>()) {
        let rough = Roughness { alpha_u, alpha_v };
        let mut random = RandomStream::new(seed, Purpose::Photon, 0);
        prop_assert!(!rough.lambda(&k).is_nan());
        if let Some(next) = rough.next_height(&k, height, &mut random) {
            // An invalid height ends the walk by name (see `walk`); a valid one meets a normal.
            prop_assert!(next >= 0.0 && !next.is_nan(), "{next}");
            let m = rough.visible_normal(&k, &mut random);
            prop_assert!(is_unit(&m) && m[2] >= 0.0, "{m:?}");
            prop_assert!(dot(&m, &k) <= 1e-9, "{m:?} {}", dot(&m, &k));
            prop_assert!(rough.density(&m) >= 0.0);
        }
    }

    #[test]
    fn a_boundary_conserves_energy_from_both_sides(cos in polar().prop_map(f64::cos), n in wide(1e-6, 1e6), k in prop_oneof![Just(0.0), wide(1e-15, 1e6)]) {
        let boundary = Boundary::new(1.0, n, k);
        let split = boundary.at(cos.max(1e-12));
        let (r, t) = (split.reflected.unpolarised(), split.refracted.unpolarised());
        prop_assert!((0.0..=1.0 + 1e-12).contains(&r) && (0.0..=1.0 + 1e-12).contains(&t), "{r} {t}");
        if boundary.is_transparent() {
            prop_assert!((r + t - 1.0).abs() < 1e-12, "{r} {t}");
        }
        prop_assert!(split.cos_refracted.is_finite());
    }

    #[test]
    fn rays_on_a_field_hit_it_within_a_cell_or_end_by_name(
        (columns, rows, heights) in (1..5usize, 1..5usize).prop_flat_map(|(c, r)| (Just(c), Just(r), prop::collection::vec(prop_oneof![-1.0..1.0f64, Just(0.0), Just(1.0)], c * r))),
        cell_x in wide(1e-3, 1e3), cell_y in wide(1e-3, 1e3), tall in wide(1e-6, 1e3),
        k in upwards(), x in 0.0..=1.0f64, y in 0.0..=1.0f64, onward in prop::collection::vec(anywhere(), 4),
    ) {
        let heights: Vec<f64> = heights.iter().map(|h| h * tall).collect();
        let field = HeightField::new(columns, rows, cell_x, cell_y, &heights);
        let down = k.map(|x| -x);
        let mut flight = field.enter(Side::Above, &down, x, y, &mut 0);
        for next in onward {
            let Flight::Hit(spot) = flight else { break };
            prop_assert!(spot.i < columns && spot.j < rows, "{spot:?}");
            prop_assert!((-1e-9..=1.0 + 1e-9).contains(&spot.x) && (-1e-9..=1.0 + 1e-9).contains(&spot.y), "{spot:?}");
            let (low, high) = field.range();
            let slack = 1e-6 * (high - low) + 1e-12;
            prop_assert!((low - slack..=high + slack).contains(&spot.z), "{spot:?} {low} {high}");
            let m = field.normal(&spot);
            prop_assert!(is_unit(&m) && m[2] >= 0.0, "{m:?}");
            let side = if dot(&next, &m) >= 0.0 { Side::Above } else { Side::Below };
            flight = field.onward(&spot, side, &next, &mut 0);
        }
    }

    #[test]
    fn rays_on_a_profile_hit_it_or_end_by_name(theta_r in prop_oneof![1e-4..1.48f64, wide(1e-4, 1e-2)], pitch in wide(1e-6, 1e6), round in prop_oneof![Just(0.0), 0.0..0.5f64], k in upwards(), at in 0.0..=1.0f64, onward in prop::collection::vec(anywhere(), 4)) {
        let Ok(profile) = SurfaceProfile::sawtooth(theta_r, pitch, round * pitch) else { return Ok(()) };
        prop_assert!(profile.effective_ridge_angle().is_none_or(|a| a.is_finite() && a > 0.0));
        let mut flight = profile.enter(Side::Above, &k.map(|x| -x), at, &mut 0);
        for next in onward {
            let ProfileFlight::Hit(spot) = flight else { break };
            let [tv, tz] = [0, 1].map(|c| profile.pieces()[spot.piece].normal[c]);
            prop_assert!(tv.is_finite() && tz.is_finite());
            let side = if next[1] * tv + next[2] * tz >= 0.0 { Side::Above } else { Side::Below };
            flight = profile.onward(&spot, side, &next, &mut 0);
        }
    }

    #[test]
    fn a_measured_profile_is_valid_or_refused(rows in prop::collection::vec((any_double(), any_double()), 0..6)) {
        if let Ok(profile) = SurfaceProfile::measured(&rows) {
            prop_assert!(profile.period() > 0.0 && profile.period().is_finite());
            prop_assert!(profile.pieces().iter().all(|p| p.normal.iter().all(|x| x.is_finite())));
        }
    }

    #[test]
    fn every_direction_has_a_bin(k in anywhere(), theta in 1..60u32, phi in 1..90u32) {
        let grid = DirectionGrid::polar(theta as usize, phi as usize);
        for side in [Side::Above, Side::Below] {
            let bin = grid.bin(side, &k);
            prop_assert!(bin / grid.per_side() == usize::from(side == Side::Below));
            prop_assert!(grid.projected_solid_angle(bin % grid.per_side()) > 0.0);
        }
    }
}

proptest! {
    #![proptest_config(cases(24))]

    #[test]
    fn a_traced_radiance_is_finite(
        i in upwards(), o in upwards(), theta_r in 1e-4..1.3f64, alpha_u in wide(1e-6, 1e3), alpha_v in wide(1e-6, 1e3),
        n in prop_oneof![wide(1e-3, 1e3), Just(1.0)], k in prop_oneof![Just(0.0), wide(1e-12, 1e3)], rho_d in prop_oneof![Just(0.0), 0.0..1.0f64],
        radius in prop_oneof![Just(0.0), wide(1e-9, 0.2)], lens in prop_oneof![Just(0.0), wide(1e-9, 0.2)], polarised in any::<bool>(), seed in any::<u64>(),
    ) {
        let Ok(profile) = SurfaceProfile::sawtooth(theta_r, 1.0, 0.0) else { return Ok(()) };
        let body = DiffuseBody::new(rho_d, n, 1.0, 0.98);
        let body = (k == 0.0 && rho_d > 0.0 && body.strength.is_finite() && body.strength <= 1e3).then_some(body);
        let surface = RidgedSurface::new(profile, Roughness { alpha_u, alpha_v }, [n, k], body);
        let directions = Directions { incident: Vector3::from(i), outgoing: Vector3::from(o) };
        let options = RadianceOptions { paths: 64, seed, cones: Cones { lamp: Angle::from_rad(radius), lens: Angle::from_rad(lens) }, polarised };
        let found = surface.radiance(&directions, &options);
        prop_assert!(found.value.is_finite() && found.std.is_finite() && found.value >= 0.0, "{found:?}");
    }
}
