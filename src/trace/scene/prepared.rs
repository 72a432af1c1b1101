//! A scene ready to trace, and the changes that are still possible.

use serde::{Deserialize, Serialize};

use super::{LeftOut, Scene};
use crate::trace::counting::grid::DirectionGrid;
use crate::trace::photons::interface::Stack;
use crate::trace::photons::walk::Method;
use crate::trace::vec3::V3;

/// A scene ready to trace.
#[derive(Debug, Clone)]
pub struct PreparedScene {
    pub(in crate::trace) stack: Stack,
    pub(in crate::trace) method: Method,
    pub(in crate::trace) stokes: [f64; 4],
    pub(in crate::trace) k: V3,
    pub(in crate::trace) s: V3,
    pub(in crate::trace) interactions_max: u32,
    pub(in crate::trace) grid: DirectionGrid,
    pub(in crate::trace) seed: u64,
    /// Whether the products of Mueller elements are accumulated in the plane of incidence, for the
    /// errors of Stokes vectors and of the degree and angle of polarisation there; costs about ten
    /// microseconds per batch.
    pub plane: bool,
    /// Photons to launch.
    pub photons: u64,
    /// Whether polarisation is followed.
    pub polarised: bool,
    /// Effects left out.
    pub left_out: Vec<LeftOut>,
    /// Effective ridge angles of the interfaces that lean to +v (area-weighted median inclination).
    pub ridge_angles: Vec<RidgeAngle>,
    /// Whether a surface is random: one realisation of its statistics.
    pub is_drawn: bool,
}

/// The effective ridge angle of an interface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RidgeAngle {
    /// 1 for the topmost.
    pub interface: usize,
    /// Area-weighted median inclination of the parts whose normal leans to +v, degrees. On a height field it has a resolution
    /// of 0.001°, and an interface with less is omitted.
    pub theta_r_deg: f64,
}

impl PreparedScene {
    /// How random numbers are used.
    #[must_use]
    pub fn method(&self) -> Method {
        self.method
    }

    /// Azimuth of the lamp, degrees.
    pub(in crate::trace) fn phi_i_deg(&self) -> f64 {
        let [sin, minus_cos, _] = self.s;
        sin.atan2(-minus_cos).to_degrees()
    }

    /// Gives photons up after `limit` interactions, unless the scene does so earlier.
    pub fn give_up_after(&mut self, limit: u32) {
        self.interactions_max = self.interactions_max.min(limit);
    }
}

/// An effect left out for several interfaces.
pub(super) const REGISTRATION: &str = "lateral registration of the layers";

impl PreparedScene {
    /// Removes interfaces of `scene` that do not affect light (1 for the topmost): both media are
    /// equal. The other interfaces keep their numbers.
    ///
    /// # Panics
    /// No interface would remain.
    pub fn leave_out(&mut self, idle: &[usize], scene: &Scene) {
        let is_idle = |number: usize| idle.contains(&number);
        let mut number = 0;
        self.stack.interfaces.retain(|_| {
            number += 1;
            !is_idle(number)
        });
        number = 0;
        self.stack.layers.retain(|_| {
            number += 1;
            !is_idle(number)
        });
        let left = self.stack.interfaces.len();
        assert!(left > 0, "light meets an interface");
        if left == 1 {
            self.left_out.retain(|l| l.what != REGISTRATION);
        }
        self.ridge_angles.retain(|a| !is_idle(a.interface));
        let all = (1..).zip(&scene.interface);
        self.is_drawn = all.filter(|(n, _)| !is_idle(*n)).any(|(_, s)| s.is_drawn());
    }

    /// The same surfaces with other photons.
    #[must_use]
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// The same scene with other direction bins.
    #[must_use]
    pub fn with_grid(mut self, grid: DirectionGrid) -> Self {
        self.grid = grid.straight_at(self.phi_i_deg());
        self
    }
}
