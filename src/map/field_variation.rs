//! The off-centre change, over a near field, of light reflected between the facets.
//!
//! The costly terms are those of the field's centre ([`super::higher_order_terms`]). If camera or lamp are near, a pixel's own
//! directions change them by up to one percent of the peak. The change is small and smooth over the field, so it is
//! computed on a grid for the surfaces that represent most pixels, and interpolated by a polynomial of third degree in
//! the pixel's place. It is subtracted from the signals, pose by pose, before a pixel is fitted.
//!
//! *Conditioning.* Places are in half-widths of the field, so the condition of the polynomial's normal equations is
//! below 1e3. The change is 1e-2 of the signal, so the polynomial's rounding does not reach the signal's digits.

use nalgebra::{SMatrix, SVector};

use super::higher_order_terms::Costly;
use super::signals::view::View;
use super::solve::kernel::{Geometry, Parameters, difference, single};
use crate::geometry::Pose;
use crate::model::{Optics, Surface, Variant, radiance};

/// Grid points along an edge of the field.
const GRID: usize = 7;
/// Terms of a polynomial of third degree in two coordinates.
const TERMS: usize = 10;
/// Scales of the distance between two surfaces: rad, rad, logarithms, ρd.
const APART: [f64; 5] = [0.1, 0.3, 0.7, 0.7, 0.3];

/// Light of an observation, split into the parts that a map treats separately.
pub(super) struct Light {
    /// Light reflected once.
    pub(super) once: f64,
    /// All terms proportional to ρd.
    pub(super) diffuse: f64,
    pub(super) rest: f64,
    pub(super) geometry: Geometry,
}

/// One surface, evaluated anywhere in the field.
pub(super) struct Anywhere<'v> {
    view: &'v View,
    p: Parameters,
    lamp: f64,
    surface: Surface,
    optics: Optics,
}

impl<'v> Anywhere<'v> {
    pub(super) fn new(costly: &Costly, view: &'v View, p: &Parameters) -> Self {
        Anywhere {
            view,
            p: *p,
            lamp: costly.lamp(),
            surface: costly.surface(p),
            optics: *costly.optics(),
        }
    }

    /// Returns the light at a pose and a place of the sample, for an irradiance of 1.
    pub(super) fn light(&self, pose: &Pose, place_mm: [f64; 2]) -> Light {
        self.seen(self.view.geometry(*pose, place_mm))
    }

    /// Returns the light at the centre of tilt.
    pub(super) fn central(&self, pose: &Pose) -> Light {
        self.seen(self.view.central(*pose))
    }

    fn seen(&self, geometry: Geometry) -> Light {
        let once = self.surface.amplitude * single(&geometry, &self.p, self.lamp).0;
        let directions = geometry.directions(self.p[1]);
        let lobes = Surface {
            rho_d: 0.0,
            ..self.surface
        };
        let of =
            |surface: &Surface| radiance(Variant::Sawtooth, &directions, surface, &self.optics);
        let whole = of(&self.surface);
        let diffuse = whole - of(&lobes);
        Light {
            once,
            diffuse,
            rest: whole - diffuse - once,
            geometry,
        }
    }

    /// Transfers the diffuse light of the centre to a place.
    pub(super) fn brought(&self, centre: &Light, there: &Light) -> f64 {
        centre.diffuse * there.geometry.facing_beside(&centre.geometry, &self.p)
    }

    /// Returns the light at a place less that transferred from the centre, without single reflections.
    pub(super) fn lacks(&self, centre: &Light, there: &Light) -> f64 {
        (there.diffuse - self.brought(centre, there)) + (there.rest - centre.rest)
    }
}

/// One surface with its polynomials, one per pose.
type Known = (Parameters, Vec<[f64; TERMS]>);

/// The off-centre changes of a few surfaces.
#[derive(Debug, Clone)]
pub(super) struct Beside {
    half_mm: [f64; 2],
    middle_mm: [f64; 2],
    surfaces: Vec<Known>,
    /// Largest residual of the polynomials as a share of the brightest radiance.
    pub(super) left: f64,
}

impl Beside {
    /// Computes the changes for surfaces that represent most pixels; `None` without any.
    pub(super) fn new(costly: &Costly, view: &View, surfaces: &[Parameters]) -> Option<Self> {
        let last = view.pixels().checked_sub(1)?;
        let (a, b) = (view.place_mm(0), view.place_mm(last));
        let middle_mm = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        let half = |k: usize| (0.5 * (b[k] - a[k])).abs().max(f64::MIN_POSITIVE);
        let half_mm = [half(0), half(1)];
        let at = |k: usize| 2.0 * k as f64 / (GRID - 1) as f64 - 1.0;
        let grid: Vec<[f64; 2]> = (0..GRID * GRID)
            .map(|k| [at(k % GRID), at(k / GRID)])
            .collect();
        let normal = grid.iter().fold(SMatrix::zeros(), |sum, place| {
            let t = SVector::<f64, TERMS>::from(terms(*place));
            sum + t * t.transpose()
        });
        let normal = SMatrix::<f64, TERMS, TERMS>::cholesky(normal)?;
        let (mut left, mut peak) = (0.0_f64, f64::MIN_POSITIVE);
        let known = |p: &Parameters| -> Known {
            let anywhere = Anywhere::new(costly, view, p);
            let of_pose = |pose: &Pose| {
                let centre = anywhere.central(pose);
                peak = peak.max(centre.once + centre.diffuse + centre.rest);
                let lacks = grid.iter().map(|[x, y]| {
                    let place = [middle_mm[0] + x * half_mm[0], middle_mm[1] + y * half_mm[1]];
                    anywhere.lacks(&centre, &anywhere.light(pose, place))
                });
                let lacks: Vec<f64> = lacks.collect();
                let right = grid
                    .iter()
                    .zip(&lacks)
                    .fold(SVector::zeros(), |sum, (place, y)| {
                        sum + SVector::<f64, TERMS>::from(terms(*place)) * *y
                    });
                let polynomial: [f64; TERMS] = normal.solve(&right).into();
                for (place, y) in grid.iter().zip(&lacks) {
                    left = left.max((y - value(&polynomial, *place)).abs());
                }
                polynomial
            };
            (*p, costly.poses().iter().map(of_pose).collect())
        };
        let surfaces: Vec<Known> = surfaces.iter().map(known).collect();
        let finite = |(_, all): &Known| all.iter().flatten().all(|c| c.is_finite());
        (!surfaces.is_empty() && surfaces.iter().all(finite)).then_some(Beside {
            half_mm,
            middle_mm,
            surfaces,
            left: left / peak,
        })
    }

    /// For a pixel like `p` at a place: returns the change of its observation `j`.
    pub(super) fn at(&self, p: &Parameters, place_mm: [f64; 2]) -> impl Fn(usize) -> f64 {
        let away = |known: &Known| -> f64 {
            let apart = difference(p, &known.0).into_iter().zip(APART);
            apart.map(|(d, scale)| (d / scale).powi(2)).sum()
        };
        let nearest = self
            .surfaces
            .iter()
            .min_by(|a, b| away(a).total_cmp(&away(b)));
        let place = [0, 1].map(|k| (place_mm[k] - self.middle_mm[k]) / self.half_mm[k]);
        move |j| nearest.map_or(0.0, |(_, polynomials)| value(&polynomials[j], place))
    }
}

fn terms([x, y]: [f64; 2]) -> [f64; TERMS] {
    let (x2, y2) = (x * x, y * y);
    [1.0, x, y, x2, x * y, y2, x2 * x, x2 * y, x * y2, y2 * y]
}

fn value(polynomial: &[f64; TERMS], place: [f64; 2]) -> f64 {
    let pairs = polynomial.iter().zip(terms(place));
    pairs.map(|(c, t)| c * t).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::higher_order_terms::near;

    #[test]
    fn off_centre_changes_are_interpolated_for_the_most_similar_surface() {
        let board = near::board(50.0);
        let poses = near::poses();
        let costly = near::costly(&board, poses.clone());
        let near = &board.1;
        let surfaces = [0.0, 1.9].map(|lean| [0.2, lean, 0.1f64.ln(), 0.15f64.ln(), 0.3]);
        let beside = Beside::new(&costly, near, &surfaces).unwrap();
        assert!(Beside::new(&costly, near, &[]).is_none());
        let (mut lacking, mut left, mut peak) = (0.0_f64, 0.0_f64, 0.0_f64);
        for p in &surfaces {
            let anywhere = Anywhere::new(&costly, near, p);
            // A pixel similar to that surface, with a lean that is larger by one turn.
            let like = [
                p[0] + 0.01,
                p[1] + std::f64::consts::TAU,
                p[2],
                p[3] + 0.1,
                p[4],
            ];
            for pixel in (0..near.pixels()).step_by(near.pixels() / 97) {
                let place = near.place_mm(pixel);
                let more = beside.at(&like, place);
                for (j, pose) in poses.iter().enumerate() {
                    let centre = anywhere.central(pose);
                    let lacks = anywhere.lacks(&centre, &anywhere.light(pose, place));
                    peak = peak.max(centre.once + centre.diffuse + centre.rest);
                    lacking = lacking.max(lacks.abs());
                    left = left.max((lacks - more(j)).abs());
                }
            }
        }
        assert!(left < 0.2 * lacking, "{left} of {lacking}");
        // Between the grid points the error is at most three times that at them.
        assert!(
            left < 3.0 * beside.left * peak,
            "{left} {}",
            beside.left * peak
        );
    }
}
