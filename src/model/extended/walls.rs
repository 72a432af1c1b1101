//! What the deviations of real samples make of the walls.

use crate::model::Surface;
use crate::model::number::Number;
use crate::model::prepared::OpticsTable;
use crate::model::real::Real;
use crate::model::rough_boundary::RoughBoundary;

/// The walls' numbers that do not depend on the pose; computed once per roughness.
#[derive(Debug, Clone)]
pub struct Walls {
    pub(in crate::model) boundary: RoughBoundary,
    /// Index η + ik of the numbers below.
    index: [f64; 2],
    /// 1/(π T̃(1) T̃(cos θl)) with ∂/∂η and ∂/∂k.
    diffuse: [f64; 3],
    /// π T̄² with ∂/∂η and ∂/∂k.
    exchange: [f64; 3],
}

impl Walls {
    /// Returns the walls of a surface; they are smooth for a metal or a body without diffuse light.
    #[must_use]
    pub fn new(surface: &Surface, real: &Real, table: &OpticsTable) -> Self {
        let optics = &table.optics;
        let boundary = if optics.k == 0.0 && surface.rho_d > 0.0 {
            RoughBoundary::new(surface.alpha_u, surface.alpha_v, real.tail, optics.eta)
        } else {
            RoughBoundary::smooth()
        };
        let more = boundary.per_entrance(optics);
        Walls {
            diffuse: table.diffuse.map(|x| more * x),
            boundary,
            ..Walls::smooth(table)
        }
    }

    /// Smooth walls.
    #[must_use]
    pub fn smooth(table: &OpticsTable) -> Self {
        Walls {
            index: [table.optics.eta, table.optics.k],
            diffuse: table.diffuse,
            exchange: table.exchange,
            boundary: RoughBoundary::smooth(),
        }
    }

    /// Walls of a body without diffuse light.
    #[must_use]
    pub fn dark() -> Self {
        Walls {
            index: [1.0, 0.0],
            diffuse: [0.0; 3],
            exchange: [0.0; 3],
            boundary: RoughBoundary::smooth(),
        }
    }

    /// Returns c_d/ρd and κ/c_d at an index near that of the walls, to the first order of their difference.
    pub(in crate::model) fn body<N: Number>(&self, eta: N, k: N) -> [N; 2] {
        [self.diffuse, self.exchange].map(|[at, by_eta, by_k]| {
            let near =
                |eta: f64, k: f64| at + by_eta * (eta - self.index[0]) + by_k * (k - self.index[1]);
            eta.map2(k, |eta, k| (near(eta, k), by_eta, by_k))
        })
    }
}
