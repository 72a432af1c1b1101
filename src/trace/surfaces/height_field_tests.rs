//! Rays on a rough tile, compared with the nearest hit over all triangles.

use super::*;
use crate::trace::rng::{Purpose, RandomStream};
use crate::trace::vec3::dot;

fn rough(nx: usize, ny: usize, height: f64, seed: u64) -> HeightField {
    let mut random = RandomStream::new(seed, Purpose::Surface, 0);
    let heights: Vec<f64> = (0..nx * ny).map(|_| height * random.uniform()).collect();
    HeightField::new(nx, ny, 1.0, 0.7, &heights)
}

fn direction(random: &mut RandomStream) -> V3 {
    let z = 2.0 * random.uniform() - 1.0;
    let phi = std::f64::consts::TAU * random.uniform();
    let r = (1.0f64 - z * z).sqrt();
    [r * phi.cos(), r * phi.sin(), z]
}

/// Nearest hit by testing every triangle of the tile and its periodic images.
fn brute_force(field: &HeightField, origin: &V3, k: &V3, reach: i64) -> Option<f64> {
    let mut best: Option<f64> = None;
    for ci in -reach..=reach {
        for cj in -reach..=reach {
            let i = ci.rem_euclid(field.nx as i64) as usize;
            let j = cj.rem_euclid(field.ny as i64) as usize;
            for upper in [false, true] {
                let h = field.corners[i * field.ny + j].map(f64::from);
                let (sx, sy) = field.slopes(i, j, upper);
                let (bx, by) = (ci as f64 * field.cell_x, cj as f64 * field.cell_y);
                // z − h00' − sx (x − bx) − sy (y − by) = 0; both planes go through h00.
                let f0 = origin[2] - h[0] - sx * (origin[0] - bx) - sy * (origin[1] - by);
                let rate = k[2] - sx * k[0] - sy * k[1];
                let t = -f0 / rate;
                if t.is_nan() || t <= 1e-9 {
                    continue;
                }
                let x = (origin[0] + t * k[0] - bx) / field.cell_x;
                let y = (origin[1] + t * k[1] - by) / field.cell_y;
                let inside = (0.0..=1.0).contains(&x)
                    && (0.0..=1.0).contains(&y)
                    && (if upper { y >= x } else { x >= y });
                if inside && best.is_none_or(|b| t < b) {
                    best = Some(t);
                }
            }
        }
    }
    best
}

#[test]
fn marching_agrees_with_brute_force() {
    let field = rough(6, 5, 1.5, 3);
    let mut random = RandomStream::new(11, Purpose::Photon, 0);
    let (mut hits, mut free) = (0, 0);
    for _ in 0..3000 {
        let mut k = direction(&mut random);
        if k[2].abs() < 0.15 {
            k[2] = 0.15f64.copysign(k[2]);
            k = unit(&k);
        }
        let side = if k[2] < 0.0 { Side::Above } else { Side::Below };
        let (x, y) = (random.uniform(), random.uniform());
        let Flight::Hit(spot) = field.enter(side, &k, x, y, &mut 0) else {
            panic!("a ray towards the surface must hit it");
        };
        let level = if side == Side::Above {
            field.highest
        } else {
            field.lowest
        };
        let origin = [x * 6.0, y * 5.0 * 0.7, level];
        let t = brute_force(&field, &origin, &k, 18).unwrap();
        assert!((origin[2] + t * k[2] - spot.z).abs() < 1e-9);
        // Continue in a random direction on the same side.
        let m = field.normal(&spot);
        let mut out = direction(&mut random);
        if side.sign() * dot(&out, &m) < 0.0 {
            out = out.map(|c| -c);
        }
        if out[2].abs() < 0.15 {
            continue;
        }
        let from = [
            (spot.i as f64 + spot.x) * field.cell_x,
            (spot.j as f64 + spot.y) * field.cell_y,
            spot.z,
        ];
        match (
            field.onward(&spot, side, &out, &mut 0),
            brute_force(&field, &from, &out, 18),
        ) {
            (Flight::Hit(next), Some(t)) => {
                assert!((from[2] + t * out[2] - next.z).abs() < 1e-7);
                hits += 1;
            }
            (Flight::Free, None) => free += 1,
            (found, expected) => panic!("{found:?} but {expected:?}"),
        }
    }
    assert!(hits > 500 && free > 500, "{hits} {free}");
}

#[test]
fn no_ray_passes_through_edges_and_corners() {
    let field = rough(4, 4, 0.5, 5);
    for (dx, dy) in [
        (1.0, 0.0),
        (0.0, 1.0),
        (1.0, 0.7),
        (-1.0, -0.7),
        (1.0, -0.7),
    ] {
        for step in 0..=40 {
            let k = unit(&[dx, dy, -0.3]);
            let at = f64::from(step) / 40.0;
            for y in [0.0, 0.25, 0.5, at] {
                assert!(matches!(
                    field.enter(Side::Above, &k, at.min(0.999_999), y.min(0.999_999), &mut 0),
                    Flight::Hit(_)
                ));
            }
        }
    }
}

#[test]
fn a_ridge_angle_below_the_resolution_is_not_stated() {
    assert_eq!(rough(16, 16, 1e-9, 5).effective_ridge_angle(), None);
    let angle = |height: f64| {
        let stated = rough(16, 16, height, 5).effective_ridge_angle();
        stated.unwrap_or_default().to_degrees()
    };
    // Small inclinations are proportional to the height.
    assert!(angle(1e-2) > 0.1 && (angle(2e-2) / angle(1e-2) - 2.0).abs() < 0.05);
}
