//! The dear terms: what the full closed form has and the kernel has not.
//!
//! At a point of parameter space the full `sawtooth` form gives L and its exact gradient. What is
//! left after the kernel's single reflection and after ρd · B, B = ∂L/∂ρd, is a small offset with a
//! small gradient. Space is cut into cells; the first pixel that comes near one pays for its centre,
//! and all others use the first-order expansion about it. The descent takes the offset anew when it
//! has nearly arrived, so the fit ends at the full form's minimum and not at the kernel's.
//!
//! A near camera or lamp gives each pixel its own directions; the offset is then that of the
//! centre of the field, since it varies slowly.

use std::collections::HashMap;
use std::sync::{Arc, RwLock};

use super::integrated::Integrated;
use super::kernel::{Geometry, Parameters, single};
use super::solve::FREE;
use crate::geometry::{Directions, Pose, RigGeometry};
use crate::material::Material;
use crate::model::prepared::{OpticsTable, Prepared};
use crate::model::quadrature::Quadrature;
use crate::model::{Optics, Surface, Variant};

/// Widths of a cell: rad, rad, logarithms, ρd or amplitude. Within half of it second order is below
/// 1e-3 of the offset, itself a few percent of the signal; a kink of the diffuse light (a direction
/// that passes the facets' normal) costs ρd/π · sin θr · half a width, 2e-4 of a usual peak.
pub(super) const CELL: [f64; FREE] = [0.005, 0.0175, 0.1, 0.1, 0.05];
/// ψ cells widen below this ridge angle, where turning changes little.
const SHALLOW: f64 = 0.1;

/// Integration error allowed, as a share of the brightest observation.
const TOLERANCE: f64 = 1e-5;

fn turned(pose: &Pose, p: &Parameters) -> Pose {
    Pose {
        phi_s: pose.phi_s + crate::units::Angle::from_rad(p[1]),
        ..*pose
    }
}

/// The rig and the matter that pixels share.
pub(super) struct Dear {
    rig: RigGeometry,
    table: OpticsTable,
    /// True poses: recorded, plus the tilt's zero.
    poses: Vec<Pose>,
    geometry: Vec<Geometry>,
    lamp: f64,
    amplitude: bool,
    /// Factor on [`CELL`].
    coarseness: f64,
    cells: RwLock<HashMap<[i32; FREE], Arc<Cell>>>,
    integrated: Integrated,
}

/// One cell's expansion, one element per observation.
pub(super) struct Cell {
    centre: Parameters,
    offset: Vec<f64>,
    basis: Vec<f64>,
    slopes: Vec<Parameters>,
    /// ∂L/∂θc, for the tilt's zero.
    pub(super) tilt: Vec<f64>,
}

impl Dear {
    pub(super) fn new(
        rig: RigGeometry,
        material: Material,
        poses: Vec<Pose>,
        geometry: Vec<Geometry>,
        coarseness: f64,
        integrated: Integrated,
    ) -> Self {
        let lamp = rig.light_angular_radius.rad().powi(2) / 8.0;
        Dear {
            table: OpticsTable::new(&Optics::new(&rig, &material)),
            amplitude: super::view::View::fits_amplitude(&material),
            rig,
            poses,
            geometry,
            lamp,
            coarseness,
            cells: RwLock::new(HashMap::new()),
            integrated,
        }
    }

    pub(super) fn lamp(&self) -> f64 {
        self.lamp
    }

    pub(super) fn is_amplitude(&self) -> bool {
        self.amplitude
    }

    pub(super) fn geometry(&self) -> &[Geometry] {
        &self.geometry
    }

    /// The cell that holds `p`.
    pub(super) fn cell(&self, p: &Parameters) -> Arc<Cell> {
        let (key, centre) = self.key(p);
        if let Some(cell) = self
            .cells
            .read()
            .expect("no holder of this lock panics")
            .get(&key)
        {
            return Arc::clone(cell);
        }
        // Two threads may compute the same cell; they get the same numbers.
        let cell = Arc::new(self.expand(&centre));
        self.cells
            .write()
            .expect("no holder of this lock panics")
            .entry(key)
            .or_insert(cell)
            .clone()
    }

    fn key(&self, p: &Parameters) -> ([i32; FREE], Parameters) {
        let mut width = CELL.map(|w| w * self.coarseness);
        let theta = (p[0] / width[0]).floor() * width[0] + 0.5 * width[0];
        width[1] *= (SHALLOW / theta).max(1.0);
        let mut x = *p;
        x[1] = p[1].rem_euclid(std::f64::consts::TAU);
        let key: [i32; FREE] = std::array::from_fn(|k| (x[k] / width[k]).floor() as i32);
        let mut centre: Parameters = std::array::from_fn(|k| (f64::from(key[k]) + 0.5) * width[k]);
        // The two logarithms end at their bound, α = 1.
        centre[2] = centre[2].min(0.0);
        centre[3] = centre[3].min(0.0);
        (key, centre)
    }

    fn expand(&self, centre: &Parameters) -> Cell {
        let n = self.poses.len();
        let (alpha_u, alpha_v) = (centre[2].exp(), centre[3].exp());
        let surface = self.surface(centre);
        let prepared = Prepared::new(Variant::Sawtooth, &surface, &self.table);
        let mut cell = Cell {
            centre: *centre,
            offset: Vec::with_capacity(n),
            basis: Vec::with_capacity(n),
            slopes: Vec::with_capacity(n),
            tilt: Vec::with_capacity(n),
        };
        for (pose, geometry) in self.poses.iter().zip(&self.geometry) {
            let full = prepared.gradient(&self.rig, turned(pose, centre));
            let (a, slopes) = single(geometry, centre, self.lamp);
            let share = surface.amplitude;
            let (rest, last, basis) = if self.amplitude {
                (full.value - share * a, full.amplitude - a, 0.0)
            } else {
                (full.value - a - centre[4] * full.rho_d, 0.0, full.rho_d)
            };
            cell.offset.push(rest);
            cell.basis.push(basis);
            cell.slopes.push([
                full.theta_r - share * slopes[0],
                full.phi_s - share * slopes[1],
                full.alpha_u * alpha_u - share * slopes[2],
                full.alpha_v * alpha_v - share * slopes[3],
                last,
            ]);
            cell.tilt.push(full.theta_c);
        }
        // B's own change with the shape belongs to the pixel's ρd, which the slopes hold to first
        // order at the centre's ρd.
        cell
    }

    /// Writes offset and B at `p`.
    pub(super) fn write(&self, p: &Parameters, offset: &mut [f64], basis: &mut [f64]) {
        let cell = self.cell(p);
        let mut away: Parameters = std::array::from_fn(|k| p[k] - cell.centre[k]);
        let turn = std::f64::consts::TAU;
        away[1] -= turn * (away[1] / turn).round();
        for (((offset, basis), (o, b)), slopes) in offset
            .iter_mut()
            .zip(basis)
            .zip(cell.offset.iter().zip(&cell.basis))
            .zip(&cell.slopes)
        {
            *offset = slopes
                .iter()
                .zip(&away)
                .fold(*o, |sum, (slope, away)| slope.mul_add(*away, sum));
            *basis = *b;
        }
        if let Some((share, integrated)) = self.integrated.near(p) {
            for (offset, extra) in offset.iter_mut().zip(integrated) {
                *offset = share.mul_add(*extra, *offset);
            }
        }
    }

    /// What the closed form lacks of integrated double reflections at `p`, per observation.
    pub(super) fn lacking(&self, p: &Parameters) -> Vec<f64> {
        let surface = self.surface(p);
        let directions: Vec<Directions> = self
            .poses
            .iter()
            .map(|pose| self.rig.directions(turned(pose, p)))
            .collect();
        let closed = self.closed(p);
        let brightest = closed.iter().copied().fold(0.0, f64::max);
        Quadrature::new(&surface, &self.table)
            .radiances(&directions, TOLERANCE * brightest)
            .iter()
            .zip(&closed)
            .map(|(integrated, closed)| integrated.value - closed)
            .collect()
    }

    fn surface(&self, p: &Parameters) -> Surface {
        Surface {
            theta_r: p[0],
            alpha_u: p[2].exp(),
            alpha_v: p[3].exp(),
            rho_d: if self.amplitude { 0.0 } else { p[4] },
            amplitude: if self.amplitude { p[4] } else { 1.0 },
        }
    }

    /// Full radiances at `p` for all observations, without an expansion.
    pub(super) fn full(&self, p: &Parameters) -> Vec<f64> {
        let mut full = self.closed(p);
        if let Some((share, integrated)) = self.integrated.near(p) {
            for (value, extra) in full.iter_mut().zip(integrated) {
                *value = share.mul_add(*extra, *value);
            }
        }
        full
    }

    fn closed(&self, p: &Parameters) -> Vec<f64> {
        let cell = self.expand(p);
        self.geometry
            .iter()
            .zip(&cell.offset)
            .zip(&cell.basis)
            .map(|((g, offset), basis)| {
                let a = single(g, p, self.lamp).0;
                if self.amplitude {
                    p[4] * a + offset
                } else {
                    a + p[4] * basis + offset
                }
            })
            .collect()
    }
}
