//! What the deviations of real samples make of the walls.

use crate::model::Surface;
use crate::model::prepared::OpticsTable;
use crate::model::real::Real;
use crate::model::rough_boundary::RoughBoundary;

/// The walls' numbers that do not depend on the pose; computed once per roughness.
#[derive(Debug, Clone)]
pub struct Walls {
    pub(super) boundary: RoughBoundary,
    /// Real part of the index of the numbers below.
    pub(super) eta: f64,
    /// 1/(π T̃(1) T̃(cos θl)) with its slope with respect to the real index.
    pub(super) diffuse: [f64; 2],
    /// π T̄² with its slope with respect to the real index.
    pub(super) exchange: [f64; 2],
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
            diffuse: [more * table.diffuse[0], more * table.diffuse[1]],
            boundary,
            ..Walls::smooth(table)
        }
    }

    /// Smooth walls.
    #[must_use]
    pub fn smooth(table: &OpticsTable) -> Self {
        Walls {
            eta: table.optics.eta,
            diffuse: [table.diffuse[0], table.diffuse[1]],
            exchange: [table.exchange[0], table.exchange[1]],
            boundary: RoughBoundary::smooth(),
        }
    }
}
