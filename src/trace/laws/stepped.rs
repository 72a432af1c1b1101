//! The remaining difference between the tracer and Smith's masking is a property of the surface. On
//! the same surface, the singly reflected light is computed again by stepping along rays, using
//! only the heights; and it differs from Smith's theory, which ignores the correlation of
//! neighbouring points.

use super::references::heitz;
use super::*;
use crate::model::polarisation::Boundary;
use crate::trace::rng::{Purpose, RandomStream};
use crate::trace::surfaces::beckmann::beckmann;
use crate::trace::surfaces::height_field::HeightField;
use crate::trace::vec3::{V3, combine, dot, unit};

/// Steps per cell.
const STEPS: f64 = 24.0;

/// Cell, triangle and height at a position.
fn under(field: &HeightField, x: f64, y: f64) -> (usize, usize, bool, f64) {
    let (nx, ny) = field.cells();
    let (dx, dy) = field.cell_size();
    let (u, v) = (x / dx, y / dy);
    let (i, j) = (
        (u.floor() as i64).rem_euclid(nx as i64) as usize,
        (v.floor() as i64).rem_euclid(ny as i64) as usize,
    );
    let (u, v) = (u - u.floor(), v - v.floor());
    let [h00, h10, h01, h11] = field.corner_heights(i, j);
    let upper = v > u;
    let height = if upper {
        h00 * (1.0 - v) + h01 * (v - u) + h11 * u
    } else {
        h00 * (1.0 - u) + h10 * (u - v) + h11 * v
    };
    (i, j, upper, height)
}

/// The first position in steps along a ray that is below the surface; `None` if it rises above all
/// of it.
fn below(field: &HeightField, from: &V3, k: &V3) -> Option<V3> {
    let step = field.cell_size().0 / STEPS / (k[0] * k[0] + k[1] * k[1]).sqrt().max(0.05);
    let mut n = 0.5;
    loop {
        let at = combine(1.0, from, n * step, k);
        if k[2] > 0.0 && at[2] > field.range().1 {
            return None;
        }
        if at[2] < under(field, at[0], at[1]).3 {
            // Bisection to the surface.
            let (mut over, mut under_it) = (n - 1.0, n);
            for _ in 0..20 {
                let middle = 0.5 * (over + under_it);
                let at = combine(1.0, from, middle * step, k);
                if at[2] < under(field, at[0], at[1]).3 {
                    under_it = middle;
                } else {
                    over = middle;
                }
            }
            return Some(combine(1.0, from, over * step, k));
        }
        n += 1.0;
    }
}

/// Fraction of the light reflected once, with its standard error.
fn reflected_once(
    field: &HeightField,
    boundary: &Boundary,
    theta: f64,
    rays: usize,
) -> MonteCarloEstimate {
    let (nx, ny) = field.cells();
    let (dx, dy) = field.cell_size();
    let k = [theta.sin(), 0.0, -theta.cos()];
    let mut random = RandomStream::new(8, Purpose::Batch, 0);
    let (mut sum, mut square) = (0.0, 0.0);
    for _ in 0..rays {
        let from = [
            random.uniform() * nx as f64 * dx,
            random.uniform() * ny as f64 * dy,
            field.range().1,
        ];
        let at = below(field, &from, &k).expect("a downward ray hits the surface");
        let (i, j, upper, _) = under(field, at[0], at[1]);
        let (sx, sy) = field.slopes(i, j, upper);
        let m = unit(&[-sx, -sy, 1.0]);
        let cos = -dot(&k, &m);
        let away = combine(1.0, &k, 2.0 * cos, &m);
        if cos > 0.0 && below(field, &at, &away).is_none() {
            let share = boundary.at(cos).reflected.unpolarised();
            sum += share;
            square += share * share;
        }
    }
    let n = rays as f64;
    let mean = sum / n;
    MonteCarloEstimate {
        value: mean,
        std: ((square / n - mean * mean) / n).sqrt(),
    }
}

#[test]
fn the_remaining_difference_from_smiths_energies_is_the_surfaces() {
    let mut differ = 0;
    for (alpha, theta_deg) in [(0.6, 20.0), (0.8, 40.0), (1.0, 60.0)] {
        let row = heitz()
            .into_iter()
            .find(|r| {
                (r.alpha - alpha).abs() < 1e-9
                    && (r.theta_i_deg - theta_deg).abs() < 1e-9
                    && r.k == 3.4
            })
            .unwrap();
        let field = beckmann(64, alpha, alpha, 1);
        let traced = single(
            theta_deg,
            &format!(
                "shape = \"beckmann\"\nalpha_u = {alpha}\nalpha_v = {alpha}\nseed = 1\ncells = 64"
            ),
            "{ n = 0.18, k = 3.4 }",
            "photons = 40000\npolarised = false\ntheta_bins = 9\nphi_bins = 12",
        )
        .energies()
        .reflected[0];
        let boundary = Boundary::new(1.0, 0.18, 3.4);
        let stepped = reflected_once(&field, &boundary, f64::to_radians(theta_deg), 6000);
        let std = traced.std.hypot(stepped.std);
        assert!(
            (traced.value - stepped.value).abs() < 4.0 * std,
            "{alpha}: {traced:?} {stepped:?}"
        );
        println!(
            "{alpha} {theta_deg} {} {} {stepped:?} {traced:?}",
            row.R1, row.R
        );
        differ += usize::from((traced.value - row.R1).abs() > 5.0 * std);
    }
    assert!(differ > 0, "this surface would agree with Smith's theory");
}
