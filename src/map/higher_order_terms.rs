//! The costly terms: the part of the full closed form that the kernel omits.
//!
//! At a point of parameter space the full `sawtooth` form gives L and its exact gradient. Without the kernel's single
//! reflection and without ρd · B, B = ∂L/∂ρd, a small offset with a small gradient remains. Parameter space is divided
//! into cells. The first pixel near a cell computes the terms at its centre; all others use the first-order expansion
//! about it. The descent recomputes the offset close to its minimum, so the fit ends at the full form's minimum and not
//! at the kernel's.
//!
//! A near camera or lamp gives each pixel its own directions. The offset is then that of the centre of the field,
//! since it varies slowly. B is mostly light that leaves the facets directly, so it is transferred from the centre to
//! the pixel by the ratio of the facets' projected irradiance ([`Geometry::facing_beside`]).
//!
//! *Conditioning.* Cells are stored in single precision: 6e-8 of a term that is a few percent of the signal. The
//! offset itself is the full form less the kernel's reflection, two numbers of the signal's size: 1e-16 of the
//! signal, 1e-14 of the offset. Cells end at the parameters' bounds, so no centre is out of bounds.

mod expansion;
mod few;

use std::sync::{Arc, RwLock};

use rustc_hash::FxHashMap;

use super::double_reflection::Integrated;
use super::solve::kernel::{FREE, Geometry, Parameters, single};
use crate::geometry::{Directions, Pose, RigGeometry};
use crate::material::Material;
use crate::model::extended::{self, Real, Terms, Walls};
use crate::model::prepared::{OpticsTable, Prepared};
use crate::model::quadrature::Quadrature;
use crate::model::{Gradient, Optics, Surface, Variant};
use expansion::{Cell, Expanded};
use few::few_of;

/// Widths of a cell: rad, rad, logarithms, ρd or amplitude. Within half a width the second order is below 1e-3 of the
/// offset, which is a few percent of the signal. A kink of the diffuse light (at a direction perpendicular to a facet's
/// normal) adds an error of ρd/π · sin θr · half a width, 2e-4 of a usual peak.
pub(super) const CELL: [f64; FREE] = [0.005, 0.0175, 0.1, 0.1, 0.05];
/// Factor by which the cells used far from the minimum are wider.
const LARGE: f64 = 3.0;
/// ψ cells widen below this ridge angle (rad), where a turn has less effect.
const SHALLOW: f64 = 0.1;

/// Integration error allowed, as a share of the brightest observation.
const TOLERANCE: f64 = 1e-5;

fn turned(pose: &Pose, p: &Parameters) -> Pose {
    Pose {
        phi_s: pose.phi_s + crate::units::Angle::from_rad(p[1]),
        ..*pose
    }
}

/// Returns the greatest integer not above `x`. `f64::floor` is a function call on machines without SSE4.1.
fn floor(x: f64) -> i32 {
    let cut = x as i32;
    cut - i32::from(x < f64::from(cut))
}

/// The integer coordinates of a cell.
type Key = [i32; FREE];
/// Cells by their coordinates. Cells come from fits, so collisions cannot be chosen by an attacker.
type Cells = FxHashMap<Key, Arc<Cell>>;

/// Returns coordinates and centre of the cell that contains `p`.
fn key(p: &Parameters, factor: f64) -> (Key, Parameters) {
    let mut width = CELL.map(|w| w * factor);
    let theta = (f64::from(floor(p[0] / width[0])) + 0.5) * width[0];
    width[1] *= (SHALLOW / theta).max(1.0);
    let mut x = *p;
    x[1] -= f64::from(floor(p[1] / std::f64::consts::TAU)) * std::f64::consts::TAU;
    let key: Key = std::array::from_fn(|k| floor(x[k] / width[k]));
    let mut centre: Parameters = std::array::from_fn(|k| (f64::from(key[k]) + 0.5) * width[k]);
    // The two logarithms end at their bound, α = 1.
    centre[2] = centre[2].min(0.0);
    centre[3] = centre[3].min(0.0);
    (key, centre)
}

fn add_scaled(to: &mut [f64], factor: f64, what: &[f64]) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += factor * what;
    }
}

/// The part of a descent, which decides on the observations and on the range that an expansion covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// All of it, from any start: the expansion's error is negligible in a pixel.
    Whole,
    /// With a subset of the observations ([`Costly::few`]) and large cells, as far as it determines the minimum; the fit's
    /// parameters are the next start.
    There,
}

/// The costly terms for the rig and the material that pixels share.
pub(super) struct Costly {
    rig: RigGeometry,
    table: OpticsTable,
    /// True poses: recorded, plus the tilt offset.
    poses: Vec<Pose>,
    geometry: Vec<Geometry>,
    /// The subset of observations used far from the minimum, and its geometry.
    few: Vec<usize>,
    few_geometry: Vec<Geometry>,
    lamp: f64,
    amplitude: bool,
    /// By [`Way`]; the large ones are few enough to stay in the processor's cache.
    cells: [RwLock<Cells>; 2],
    integrated: Integrated,
    /// The sample's uniform deviations from an ideal sawtooth.
    real: Option<Arc<RealSurface>>,
    arch: pulp::Arch,
}

/// Deviations from an ideal sawtooth, as found by the fit of the pixels' mean; the walls are those of the mean.
#[derive(Debug)]
pub(super) struct RealSurface {
    pub(super) real: Real,
    pub(super) walls: Walls,
}

/// Cells that one thread has used, by [`Way`], so that it finds them without a lock.
#[derive(Default)]
pub(super) struct Met([Cells; 2]);

impl Costly {
    pub(super) fn new(
        rig: RigGeometry,
        material: Material,
        poses: Vec<Pose>,
        geometry: Vec<Geometry>,
        integrated: Integrated,
    ) -> Self {
        let lamp = rig.cones.widening();
        let amplitude = super::signals::view::View::fits_amplitude(&material);
        // On metal all observations need the costly terms from the start.
        let few = if amplitude {
            Vec::new()
        } else {
            few_of(poses.len())
        };
        Costly {
            table: OpticsTable::new(&Optics::new(&rig, &material)),
            amplitude,
            few_geometry: few.iter().map(|j| geometry[*j]).collect(),
            few,
            rig,
            poses,
            geometry,
            lamp,
            cells: Default::default(),
            integrated,
            real: None,
            arch: pulp::Arch::new(),
        }
    }

    /// Sets the deviations of the sample from an ideal sawtooth.
    pub(super) fn with_real(self, real: Option<Arc<RealSurface>>) -> Self {
        Costly { real, ..self }
    }

    pub(super) fn optics(&self) -> &Optics {
        &self.table.optics
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

    /// Observations used far from the minimum; empty if all are.
    pub(super) fn few(&self) -> &[usize] {
        &self.few
    }

    /// Geometry of [`Costly::few`].
    pub(super) fn few_geometry(&self) -> &[Geometry] {
        &self.few_geometry
    }

    fn cell_of(&self, key: Key, centre: Parameters, way: Way) -> Arc<Cell> {
        let cells = &self.cells[way as usize];
        if let Some(cell) = cells
            .read()
            .expect("no holder of this lock panics")
            .get(&key)
        {
            return Arc::clone(cell);
        }
        // Two threads may compute the same cell; they get the same numbers.
        let cell = Arc::new(match way {
            Way::There => self.expand(&centre, self.few.iter().copied()),
            Way::Whole => self.expand(&centre, 0..self.poses.len()),
        });
        cells
            .write()
            .expect("no holder of this lock panics")
            .entry(key)
            .or_insert(cell)
            .clone()
    }

    /// Returns the deviations of the sample from an ideal sawtooth.
    fn real(&self) -> Real {
        self.real.as_ref().map_or(Real::NONE, |r| r.real)
    }

    /// Returns the full form with its gradient at `p`, by pose, with the given deviations from an ideal sawtooth.
    fn full_form(&self, p: &Parameters, real: Real) -> impl Fn(&Pose) -> Gradient {
        let surface = self.surface(p);
        let prepared = Prepared::new(Variant::Sawtooth, &surface, &self.table);
        move |pose| {
            let pose = turned(pose, p);
            let Some(RealSurface { walls, .. }) = self.real.as_deref() else {
                return prepared.gradient(&self.rig, pose);
            };
            let directions = self.rig.directions(pose);
            let optics = &self.table.optics;
            let terms = Terms::of(&real, optics, &Real::default());
            let (sin, cos) = (pose.phi_s + self.rig.azimuth_zero).sin_cos();
            extended::partials(&directions, &surface, &real, terms, optics, walls).on_rig(
                &directions,
                sin,
                cos,
            )
        }
    }

    /// Expands the costly terms of some observations about a centre. The change of B with the shape belongs to the pixel's
    /// ρd; the slopes contain it to first order, at the centre's ρd.
    fn expand(
        &self,
        centre: &Parameters,
        observations: impl ExactSizeIterator<Item = usize>,
    ) -> Cell {
        let n = observations.len();
        let (alpha_u, alpha_v) = (centre[2].exp(), centre[3].exp());
        let share = self.surface(centre).amplitude;
        let full_form = self.full_form(centre, self.real());
        let mut numbers = vec![0.0; (2 + FREE) * n];
        for (at, j) in observations.enumerate() {
            let full = full_form(&self.poses[j]);
            let (a, slopes) = single(&self.geometry[j], centre, self.lamp);
            let (rest, last, basis) = if self.amplitude {
                (full.value - share * a, full.amplitude - a, 0.0)
            } else {
                (full.value - a - centre[4] * full.rho_d, 0.0, full.rho_d)
            };
            let row = [
                rest,
                basis,
                full.theta_r - share * slopes[0],
                full.phi_s - share * slopes[1],
                full.alpha_u * alpha_u - share * slopes[2],
                full.alpha_v * alpha_v - share * slopes[3],
                last,
            ];
            for (column, x) in numbers.chunks_exact_mut(n).zip(row) {
                column[at] = x as f32;
            }
        }
        Cell {
            centre: *centre,
            numbers,
        }
    }

    /// Writes offset and B at `p`; `met` holds the thread's cells.
    pub(super) fn write(
        &self,
        p: &Parameters,
        way: Way,
        met: &mut Met,
        offset: &mut [f64],
        basis: &mut [f64],
    ) {
        let factor = match way {
            Way::Whole => 1.0,
            Way::There => LARGE,
        };
        let (key, centre) = key(p, factor);
        let cell = met.0[way as usize]
            .entry(key)
            .or_insert_with(|| self.cell_of(key, centre, way));
        let mut away: Parameters = std::array::from_fn(|k| p[k] - cell.centre[k]);
        let turn = std::f64::consts::TAU;
        away[1] -= turn * f64::from(floor(away[1] / turn + 0.5));
        let n = offset.len();
        self.arch.dispatch(Expanded {
            numbers: &cell.numbers,
            away: away.map(|x| x as f32),
            offset,
            basis,
        });
        if let Some((share, integrated)) = self.integrated.near(p) {
            if n == integrated.len() {
                add_scaled(offset, share, integrated);
            } else {
                for (offset, j) in offset.iter_mut().zip(&self.few) {
                    *offset += share * integrated[*j];
                }
            }
        }
    }

    /// Returns the difference between integrated and closed-form double reflections at `p`, per observation;
    /// `polarised` takes into account that the first facet polarises the light that reaches the second one.
    pub(super) fn lacking(&self, p: &Parameters, polarised: bool) -> Vec<f64> {
        let surface = self.surface(p);
        let directions: Vec<Directions> = self
            .poses
            .iter()
            .map(|pose| self.rig.directions(turned(pose, p)))
            .collect();
        // The integrals are those of the ideal sawtooth.
        let closed = self.closed(p, Real::NONE);
        let brightest = closed.iter().copied().fold(0.0, f64::max);
        Quadrature::new(&surface, &self.table)
            .with_polarisation(polarised)
            .radiances(&directions, TOLERANCE * brightest)
            .iter()
            .zip(&closed)
            .map(|(integrated, closed)| integrated.value - closed)
            .collect()
    }

    /// Returns the largest of these differences as a share of the brightest radiance.
    pub(super) fn share_lacking(&self, p: &Parameters) -> f64 {
        let largest = self.lacking(p, true).iter().fold(0.0, |most: f64, x| {
            if x.is_finite() {
                most.max(x.abs())
            } else {
                f64::INFINITY
            }
        });
        let closed = self.closed(p, self.real()).into_iter();
        let brightest = closed.fold(f64::MIN_POSITIVE, f64::max);
        largest / brightest
    }

    /// Returns the largest error of the expansions around `p`, as a share of the brightest radiance: at `p` and a
    /// quarter of a cell to either side.
    pub(super) fn share_expanded(&self, p: &Parameters) -> f64 {
        let n = self.poses.len();
        let (mut offset, mut basis) = (vec![0.0; n], vec![0.0; n]);
        let mut largest = 0.0f64;
        for side in [-0.25, 0.0, 0.25] {
            let mut at: Parameters = std::array::from_fn(|k| p[k] + side * CELL[k]);
            at[0] = at[0].max(0.0);
            let mut met = Met::default();
            self.write(&at, Way::Whole, &mut met, &mut offset, &mut basis);
            let closed = self.closed(&at, self.real());
            let brightest = closed.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
            for (j, exact) in closed.iter().enumerate() {
                let once = single(&self.geometry[j], &at, self.lamp).0;
                let (held, fifth) = match self.amplitude {
                    true => (0.0, once),
                    false => (once, basis[j]),
                };
                let expanded = held + at[4] * fifth + offset[j];
                largest = largest.max((expanded - exact).abs() / brightest);
            }
        }
        largest
    }

    /// True poses: recorded, plus the tilt offset.
    pub(super) fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Returns the poses relative to a surface that leans as `p` does.
    pub(super) fn turned_poses(&self, p: &Parameters) -> impl Iterator<Item = Pose> {
        self.poses.iter().map(|pose| turned(pose, p))
    }

    pub(super) fn surface(&self, p: &Parameters) -> Surface {
        Surface {
            theta_r: p[0],
            alpha_u: p[2].exp(),
            alpha_v: p[3].exp(),
            rho_d: if self.amplitude { 0.0 } else { p[4] },
            amplitude: if self.amplitude { p[4] } else { 1.0 },
        }
    }

    /// Returns the full radiances at `p` for all observations, without an expansion.
    pub(super) fn full(&self, p: &Parameters) -> Vec<f64> {
        let mut full = self.closed(p, self.real());
        if let Some((share, integrated)) = self.integrated.near(p) {
            add_scaled(&mut full, share, integrated);
        }
        full
    }

    fn closed(&self, p: &Parameters, real: Real) -> Vec<f64> {
        let full_form = self.full_form(p, real);
        self.poses
            .iter()
            .map(|pose| full_form(pose).value)
            .collect()
    }
}

/// The recorded checkerboard close to the camera, for tests of a near field.
#[cfg(test)]
pub(super) mod near {
    use super::*;
    use crate::map::signals::view::View;
    use crate::series::Series;

    /// Distance from camera to field, mm.
    const DISTANCE_MM: f64 = 300.0;

    /// The checkerboard on a field of the given width.
    pub(in crate::map) fn board(field_mm: f64) -> (Material, View) {
        let series = Series::open("tests/data/series/checker".as_ref()).unwrap();
        let manifest = series.manifest();
        (
            manifest.material(),
            View::new(manifest).brought_to(DISTANCE_MM, field_mm),
        )
    }

    /// Four tilts at each of twelve azimuths.
    pub(in crate::map) fn poses() -> Vec<Pose> {
        let tilts = [-20.0, -10.0, 5.0, 20.0];
        (0..12)
            .flat_map(|turn| tilts.map(|tilt| Pose::from_deg(tilt, 30.0 * f64::from(turn))))
            .collect()
    }

    /// The costly terms at the centre of the field.
    pub(in crate::map) fn costly((material, view): &(Material, View), poses: Vec<Pose>) -> Costly {
        let geometry = poses.iter().map(|p| view.central(*p)).collect();
        let none = Integrated::default();
        Costly::new(view.imaging.rig, *material, poses, geometry, none)
    }
}

#[cfg(test)]
mod tests {
    use super::few::{FEW_MIN, MANY_MIN};
    use super::*;

    #[test]
    fn the_subset_covers_every_tilt_and_azimuth() {
        assert!(few_of(MANY_MIN - 1).is_empty());
        for (tilts, azimuths) in [(9, 12), (6, 12), (8, 9), (5, 36), (11, 24), (20, 16)] {
            let few = few_of(tilts * azimuths);
            assert!(few.len() >= FEW_MIN - 2 && 2 * few.len() <= tilts * azimuths + 2);
            let tilts_met: std::collections::HashSet<_> =
                few.iter().map(|j| j / azimuths).collect();
            let azimuths_met: std::collections::HashSet<_> =
                few.iter().map(|j| j % azimuths).collect();
            assert_eq!(tilts_met.len(), tilts, "{tilts} × {azimuths}");
            // A lobe's turn is equally well determined if a single azimuth between two others is missing.
            assert!(
                3 * azimuths_met.len() >= 2 * azimuths,
                "{tilts} × {azimuths}: {azimuths_met:?}"
            );
        }
    }
}
