//! What light that went between the facets is beside the centre of a near field.
//!
//! The costly terms are those of the field's centre ([`super::costly`]). Where camera or lamp are near, a pixel's own
//! directions change them by as much as a percent of the peak. That change is smooth over the field and small, so it is
//! worked out on the surfaces that most pixels look like, on a grid, and a polynomial of third degree in the
//! pixel's place brings it everywhere: pose by pose it comes off the signals before a pixel is fitted.
//!
//! *Conditioning.* Places are in half-widths of the field, so the polynomial's normal equations have a condition below 1e3; the
//! change is 1e-2 of the signal, and no digit of the signal depends on the polynomial.

use nalgebra::{SMatrix, SVector};

use super::costly::Costly;
use super::kernel::{Geometry, Parameters, single};
use super::view::View;
use crate::geometry::Pose;
use crate::model::{Optics, Surface, Variant, radiance};
use crate::units::Angle;

/// Places along an edge of the field.
const GRID: usize = 7;
/// Terms of a polynomial of third degree in two coordinates.
const TERMS: usize = 10;
/// Differences that make two surfaces as different as can be: rad, rad, logarithms, ρd.
const APART: [f64; 5] = [0.1, 0.3, 0.7, 0.7, 0.3];

/// Light of an observation by the ways that a map treats apart.
pub(super) struct Light {
    /// Reflected once.
    pub(super) once: f64,
    /// All that goes with ρd.
    pub(super) diffuse: f64,
    pub(super) rest: f64,
    pub(super) geometry: Geometry,
}

/// One surface anywhere in a field.
pub(super) struct Anywhere<'v> {
    view: &'v View,
    p: Parameters,
    lamp: f64,
    surface: Surface,
    optics: Optics,
}

impl<'v> Anywhere<'v> {
    pub(super) fn new(costly: &Costly, view: &'v View, p: &Parameters) -> Self {
        let (eta, k) = view.index();
        Anywhere {
            view,
            p: *p,
            lamp: costly.lamp(),
            surface: costly.surface(p),
            optics: Optics {
                eta,
                k,
                theta_l: view.imaging.rig.theta_l.rad(),
                cones: view.imaging.rig.cones,
            },
        }
    }

    /// At a pose and a place of the sample, for an irradiance of 1.
    pub(super) fn light(&self, pose: &Pose, place_mm: [f64; 2]) -> Light {
        self.seen(self.view.geometry(*pose, place_mm))
    }

    /// The same at the centre of tilt.
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

    /// Diffuse light as it is brought from the centre to a place.
    pub(super) fn brought(&self, centre: &Light, there: &Light) -> f64 {
        centre.diffuse * there.geometry.facing_beside(&centre.geometry, &self.p)
    }

    /// What the centre's light lacks at a place, single reflections apart.
    pub(super) fn lacks(&self, centre: &Light, there: &Light) -> f64 {
        (there.diffuse - self.brought(centre, there)) + (there.rest - centre.rest)
    }
}

/// One surface, and its polynomials by pose.
type Known = (Parameters, Vec<[f64; TERMS]>);

/// What pixels beside the centre have more than the centre.
#[derive(Debug, Clone)]
pub(super) struct Beside {
    half_mm: [f64; 2],
    middle_mm: [f64; 2],
    surfaces: Vec<Known>,
    /// What the polynomials leave, at most, as a share of the brightest radiance.
    pub(super) left: f64,
}

impl Beside {
    /// On the surfaces that most pixels look like; `None` without any.
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

    /// For a pixel at a place that looks like `p`: what its observation `j` has more.
    pub(super) fn at(&self, p: &Parameters, place_mm: [f64; 2]) -> impl Fn(usize) -> f64 {
        let away = |known: &Known| -> f64 {
            let apart = |k: usize| match k {
                1 => Angle::from_rad(p[1] - known.0[1]).wrapped().rad(),
                _ => p[k] - known.0[k],
            };
            (0..APART.len())
                .map(|k| (apart(k) / APART[k]).powi(2))
                .sum()
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
    use crate::map::costly::near;

    #[test]
    fn what_pixels_beside_the_centre_lack_is_brought_to_them_and_to_the_surface_that_they_look_like()
     {
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
            // A pixel of about that surface, its lean counted from a turn further.
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
        // Between the places of the grid it is no worse than three times what it is there.
        assert!(
            left < 3.0 * beside.left * peak,
            "{left} {}",
            beside.left * peak
        );
    }
}
