//! One path through the valley, facet then riser: the integrand and its adaptive cells.

use std::collections::BinaryHeap;

use super::{Lobe, Quadrature, Ray};
use crate::model::fresnel::reflectances;
use crate::model::gauss::{LEGENDRE_4, LEGENDRE_6};
use crate::model::third_bounce::{cos_double_turn, cross};

/// Number of cells at which an integral stops; its error then exceeds the tolerance.
const CELLS_MAX: usize = 1500;

/// The integrand of one path, facet then riser.
pub(super) struct Path<'a> {
    pub(super) walls: &'a Quadrature,
    pub(super) a: Ray,
    pub(super) b: Ray,
    pub(super) facet: Lobe,
    pub(super) riser: Lobe,
    pub(super) masking: Lobe,
    pub(super) smith_a: f64,
    pub(super) smith_b: f64,
    /// c_d T(a_m) a_m and c_d T(b_ρ) b_ρ.
    pub(super) diffuse_a: f64,
    pub(super) diffuse_b: f64,
}

struct Cell {
    beta: [f64; 2],
    gamma: [f64; 2],
    value: f64,
    error: f64,
    /// Whether halving β promises a greater gain than halving γ.
    split_beta: bool,
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        self.error == other.error
    }
}
impl Eq for Cell {}
impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Cell {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.error.total_cmp(&other.error)
    }
}

impl Path<'_> {
    /// Returns L (o·n) and its error over the cells between the borders, refined to the tolerance.
    pub(super) fn integrate(&self, betas: &[f64], gammas: &[f64], tolerance: f64) -> (f64, f64) {
        let mut cells = BinaryHeap::new();
        let mut error = 0.0;
        for beta in betas.windows(2) {
            for gamma in gammas.windows(2) {
                let cell = self.cell([beta[0], beta[1]], [gamma[0], gamma[1]]);
                error += cell.error;
                cells.push(cell);
            }
        }
        while error > tolerance && cells.len() < CELLS_MAX {
            let Some(worst) = cells.pop() else { break };
            error -= worst.error;
            let middle = |x: [f64; 2]| 0.5 * (x[0] + x[1]);
            let halves = if worst.split_beta {
                let m = middle(worst.beta);
                [
                    ([worst.beta[0], m], worst.gamma),
                    ([m, worst.beta[1]], worst.gamma),
                ]
            } else {
                let m = middle(worst.gamma);
                [
                    (worst.beta, [worst.gamma[0], m]),
                    (worst.beta, [m, worst.gamma[1]]),
                ]
            };
            for (beta, gamma) in halves {
                let cell = self.cell(beta, gamma);
                error += cell.error;
                cells.push(cell);
            }
        }
        // Summed from the cells, because the running error has cancelled many times.
        cells
            .iter()
            .fold((0.0, 0.0), |(v, e), c| (v + c.value, e + c.error))
    }

    /// Applies two product rules to one cell; the finer one is the value, their difference the error.
    fn cell(&self, beta: [f64; 2], gamma: [f64; 2]) -> Cell {
        let at = |x: [f64; 2], t: f64| 0.5 * (x[0] + x[1]) + 0.5 * (x[1] - x[0]) * t;
        let area = 0.25 * (beta[1] - beta[0]) * (gamma[1] - gamma[0]);
        let turned = |(t, weight): (f64, f64)| (at(gamma, t).sin_cos(), weight);
        let mut coarse = 0.0;
        let gammas = LEGENDRE_4.map(turned);
        for (tb, wb) in LEGENDRE_4 {
            let row = Row::new(self, at(beta, tb));
            if row.length <= 0.0 {
                continue;
            }
            for (turn, wg) in gammas {
                coarse += wb * wg * row.at(self, turn);
            }
        }
        let mut fine = 0.0;
        // Second differences of the fine nodes show the direction in which the integrand bends.
        let mut by_beta = [0.0; 6];
        let mut by_gamma = [0.0; 6];
        let gammas = LEGENDRE_6.map(turned);
        for (j, (tb, wb)) in LEGENDRE_6.into_iter().enumerate() {
            let row = Row::new(self, at(beta, tb));
            if row.length <= 0.0 {
                continue;
            }
            for (k, (turn, wg)) in gammas.into_iter().enumerate() {
                let f = row.at(self, turn);
                fine += wb * wg * f;
                by_beta[j] += wg * f;
                by_gamma[k] += wb * f;
            }
        }
        let bend = |x: [f64; 6]| {
            x.windows(3)
                .map(|w| (w[0] - 2.0 * w[1] + w[2]).abs())
                .fold(0.0, f64::max)
        };
        Cell {
            beta,
            gamma,
            value: area * fine,
            error: area * (fine - coarse).abs(),
            split_beta: bend(by_beta) >= bend(by_gamma),
        }
    }
}

/// The values that β determines.
struct Row {
    sin: f64,
    cos: f64,
    /// ℓ(β).
    length: f64,
}

impl Row {
    fn new(path: &Path<'_>, beta: f64) -> Self {
        let (sin, cos) = beta.sin_cos();
        let (r, p) = (path.walls.sin, path.walls.cos);
        let tan = sin / cos;
        let reach = p.min(r * tan);
        // If the whole facet is in reach, p − σ is computed without cancellation.
        let from_a = path.a.open - (p - reach);
        let length = from_a.min(reach - path.b.tau * tan);
        Row { sin, cos, length }
    }

    /// Returns the integrand at β and at sine and cosine of γ, Jacobian and ℓ included.
    fn at(&self, path: &Path<'_>, (u, flat): (f64, f64)) -> f64 {
        let walls = path.walls;
        let (e, m) = (flat * self.sin, flat * self.cos);
        let (a, b) = (&path.a, &path.b);
        // Half vectors on the facet (a, ω) and on the riser (−ω, b).
        let (xa, ya, za) = (a.u + u, a.e + e, a.m + m);
        let (xb, yb, zb) = (b.u - u, b.m - m, e - b.e);
        let lobe_a = path.facet.density(xa, ya, za);
        let lobe_b = path.riser.density(xb, yb, zb);
        let diffuse = walls.c_d > 0.0;
        if !diffuse && (lobe_a == 0.0 || lobe_b == 0.0) {
            return 0.0;
        }
        let mut specular_a = 0.0;
        let mut specular_b = 0.0;
        let mut product = 0.0;
        let mut polarised = [0.0; 2];
        if lobe_a > 0.0 {
            let cos = 0.5 * (xa * xa + ya * ya + za * za).sqrt();
            let (s, p) = reflectances(cos, walls.q.eta, walls.q.k);
            let geometry = 0.25 * lobe_a * path.smith_a * path.masking.smith(u, e, m);
            specular_a = 0.5 * (s + p) * geometry;
            polarised[0] = 0.5 * (s - p) * geometry;
        }
        if lobe_b > 0.0 {
            let cos = 0.5 * (xb * xb + yb * yb + zb * zb).sqrt();
            let (s, p) = reflectances(cos, walls.q.eta, walls.q.k);
            let geometry = 0.25 * lobe_b * path.smith_b * path.masking.smith(u, m, e) / e;
            specular_b = 0.5 * (s + p) * geometry;
            polarised[1] = 0.5 * (s - p) * geometry;
        }
        if lobe_a > 0.0 && lobe_b > 0.0 {
            product = specular_a * specular_b;
            if walls.polarised {
                let w = [u, e, m];
                let turn = cos_double_turn(cross([a.u, a.e, a.m], w), cross(w, [b.u, b.e, b.m]));
                product += polarised[0] * polarised[1] * turn;
            }
            product *= walls.q.amplitude * walls.q.amplitude;
        }
        let mut sum = product;
        if diffuse {
            let diffuse_a = path.diffuse_a * walls.transmittance(u, e, m) * m;
            let diffuse_b = path.diffuse_b * walls.transmittance(u, m, e);
            sum += specular_a * diffuse_b + diffuse_a * (specular_b + diffuse_b);
        }
        sum * self.length * flat
    }
}
