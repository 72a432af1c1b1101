//! A surface as a measured material of the RGL database (`.bsdf`), which renderers read (Dupuy and Jakob 2018, "An Adaptive
//! Parameterization for Efficient Material Acquisition and Rendering").
//!
//! A reader evaluates f cos θo = spectra · ndf / (4 sigma). It takes `ndf` at the half vector h and `sigma` at the direction of
//! incidence; `spectra` is interpolated linearly between the directions of incidence and over the unit square, whose
//! coordinates are the numbers that the density `vndf` maps to h. The format leaves these functions free. Here
//!
//! - `ndf` is the density of the slopes of facets and lands, and a constant, so that `spectra` stays smooth beside the lobe,
//! - `sigma` is cos θi,
//! - `vndf` is the same for all directions of incidence: one half is the widened lobe, the other half is uniform. With a fixed
//!   map, interpolation between directions of incidence compares equal half vectors, where the lobe stays in place,
//! - `luminance` is the density of f cos θo over the square, for sampling; it is nowhere 0.
//!
//! At half vectors that mirror the light below the horizon, `spectra` continues with its value at the horizon, so that cells on
//! the horizon interpolate well. Azimuths cover a full turn: a sawtooth is not symmetric about its ridges.

use std::f64::consts::PI;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::half_vectors::{Grid, Warp, of_zenith, solid_angle, vector, zenith};
use super::tensor_file::TensorFile;
use crate::geometry::Directions;
use crate::model::extended::slopes::relative_density;
use crate::model::surface_brdf::SurfaceBrdf;

/// Azimuths of incidence over the full turn; the last one repeats the first.
const AZIMUTHS: usize = 37;
/// Zenith angles of incidence.
const ZENITHS: usize = 19;
/// Last of them; a reader continues with it towards the horizon.
const ZENITH_MAX: f64 = 89.0 * PI / 180.0;
/// Nodes of the unit square along each side.
const NODES: usize = 48;
/// Nodes of the density that maps the square to half vectors.
const VNDF_NODES: [usize; 2] = [48, 48];
/// Nodes of `ndf`.
const NDF_NODES: [usize; 2] = [512, 1024];
/// Nodes of `sigma` along the zenith angle.
const SIGMA_NODES: usize = 64;
/// The constant part of `ndf` over the peak of the slopes' density.
const NDF_FLOOR: f64 = 0.1;
/// Share of the half vectors' density that is uniform over the square.
const UNIFORM: f64 = 0.5;
/// Width of the lobe in that density over its own.
const WIDENED: f64 = 1.5;
/// Least cosine with the normal: a direction below it continues with the value there.
const HORIZON: f64 = 1e-3;
/// Least density of samples over their mean.
const LUMINANCE_FLOOR: f64 = 1e-3;

/// The slopes of the facets, or of the lands between them.
#[derive(Debug, Clone, Copy)]
struct Lobe {
    /// sin and cos of the ridge angle.
    ridge: (f64, f64),
    alpha: [f64; 2],
    tail: f64,
}

impl Lobe {
    fn of(brdf: &SurfaceBrdf, inclination: f64) -> Self {
        let surface = brdf.surface();
        Lobe {
            ridge: inclination.sin_cos(),
            alpha: [surface.alpha_u, surface.alpha_v],
            tail: brdf.real().tail,
        }
    }

    /// Returns the density of normals at h, 1/sr.
    fn density(&self, h: &Vector3<f64>) -> f64 {
        let (sin, cos) = self.ridge;
        let (z, y) = (h.y * sin + h.z * cos, h.y * cos - h.z * sin);
        if z <= 0.0 {
            return 0.0;
        }
        let [a, b] = self.alpha;
        let square = ((h.x / a).powi(2) + (y / b).powi(2)) / (z * z);
        relative_density(self.tail, square) / (PI * a * b * z.powi(4))
    }

    /// Returns the same lobe, wider, and no narrower than the nodes of the density that maps the square.
    fn widened(self) -> Lobe {
        let (sin, cos) = self.ridge;
        let [columns, rows] = VNDF_NODES.map(|n| (n - 1) as f64);
        let node = [
            2.0 * PI * sin / rows,
            PI * of_zenith(sin.atan2(cos)) / columns,
        ];
        Lobe {
            alpha: [0, 1].map(|k| (WIDENED * self.alpha[k]).hypot(node[k])),
            ..self
        }
    }
}

/// The slopes of a surface: lobes with their shares of it.
struct Slopes(Vec<(f64, Lobe)>);

impl Slopes {
    fn of(brdf: &SurfaceBrdf) -> Self {
        let land = brdf.real().land;
        let parts = [(1.0 - land, brdf.surface().theta_r), (land, 0.0)];
        let there = parts.into_iter().filter(|(share, _)| *share > 0.0);
        Slopes(
            there
                .map(|(share, inclination)| (share, Lobe::of(brdf, inclination)))
                .collect(),
        )
    }

    /// Returns the density of normals at h, 1/sr.
    fn density(&self, h: &Vector3<f64>) -> f64 {
        let parts = self.0.iter();
        parts.map(|(share, lobe)| share * lobe.density(h)).sum()
    }

    /// Returns the same with wider lobes.
    fn widened(&self) -> Slopes {
        let parts = self.0.iter();
        Slopes(
            parts
                .map(|(share, lobe)| (*share, lobe.widened()))
                .collect(),
        )
    }
}

/// The parts of a file that do not depend on the direction of incidence.
struct Common {
    ndf: Grid,
    sigma: Grid,
    vndf: Warp,
    /// The half vectors of the square's nodes, x fastest.
    nodes: Vec<Node>,
    slopes: Slopes,
    /// The constant part of `ndf`.
    floor: f64,
}

/// A node of the unit square.
struct Node {
    half: Vector3<f64>,
    /// `ndf` as a reader interpolates it.
    ndf: f64,
    /// Solid angle of half vectors per area of the square.
    per_area: f64,
}

impl Common {
    fn new(brdf: &SurfaceBrdf) -> Self {
        let slopes = Slopes::of(brdf);
        let surface = brdf.surface();
        let floor = NDF_FLOOR / (PI * surface.alpha_u * surface.alpha_v);
        let ndf = Grid::new(NDF_NODES, |place| slopes.density(&vector(place)) + floor);
        let sigma = Grid::new([SIGMA_NODES, 2], |[x, _]| zenith(x).min(ZENITH_MAX).cos());
        let widened = slopes.widened();
        let lobes = Warp::new(Grid::new(VNDF_NODES, |place| {
            // The density must be positive.
            1e-30 + widened.density(&vector(place)) * solid_angle(place[0])
        }));
        let mut mixed = lobes.density;
        for x in &mut mixed.values {
            *x = UNIFORM + (1.0 - UNIFORM) * *x;
        }
        let vndf = Warp::new(mixed);
        let at = |k: usize| k as f64 / (NODES - 1) as f64;
        let nodes = (0..NODES * NODES)
            .map(|k| {
                let place = vndf.place([at(k % NODES), at(k / NODES)]);
                Node {
                    half: vector(place),
                    ndf: ndf.at(place),
                    per_area: solid_angle(place[0]) / vndf.density.at(place),
                }
            })
            .collect();
        Common {
            ndf,
            sigma,
            vndf,
            nodes,
            slopes,
            floor,
        }
    }

    /// Returns f cos θo and `ndf` at a node, or at the horizon below which the node mirrors the light.
    fn value(&self, brdf: &SurfaceBrdf, incident: Vector3<f64>, node: &Node) -> (f64, f64) {
        let outgoing = node.half * (2.0 * node.half.dot(&incident)) - incident;
        let lit = |outgoing: Vector3<f64>| {
            let directions = Directions { incident, outgoing };
            brdf.value(&directions) * outgoing.z
        };
        if outgoing.z >= HORIZON {
            return (lit(outgoing), node.ndf);
        }
        let raised = Vector3::new(outgoing.x, outgoing.y, HORIZON).normalize();
        let half = (raised + incident).normalize();
        (lit(raised), self.slopes.density(&half) + self.floor)
    }
}

/// Returns the file of a surface, about 22 MB. x is along the ridges, y is the direction in which the facets lean. The
/// spectrum has one wavelength, with which a reader continues on both sides.
#[must_use]
pub fn file(brdf: &SurfaceBrdf, wavelength_nm: f64, description: &str) -> Vec<u8> {
    let azimuths: Vec<f32> = (0..AZIMUTHS)
        .map(|k| (PI * (2.0 * k as f64 / (AZIMUTHS - 1) as f64 - 1.0)) as f32)
        .collect();
    let zeniths: Vec<f32> = (0..ZENITHS)
        .map(|k| (ZENITH_MAX * k as f64 / (ZENITHS - 1) as f64) as f32)
        .collect();
    let common = Common::new(brdf);
    let slices = azimuths.par_iter().map(|phi| {
        let (mut spectra, mut luminance) = (Vec::new(), Vec::new());
        for theta in &zeniths {
            let incidence = [f64::from(*theta), f64::from(*phi)];
            slice(&common, brdf, incidence, &mut spectra, &mut luminance);
        }
        (spectra, luminance)
    });
    let (spectra, luminance): (Vec<_>, Vec<_>) = slices.unzip();
    let (spectra, luminance) = (spectra.concat(), luminance.concat());
    let vndf = common.vndf.density.single().repeat(AZIMUTHS * ZENITHS);
    let rows = |grid: &Grid| [grid.size[1], grid.size[0]];
    let mut file = TensorFile::default();
    file.add_bytes("description", description.as_bytes());
    file.add_bytes("jacobian", &[1]);
    file.add_numbers("phi_i", &[AZIMUTHS], &azimuths);
    file.add_numbers("theta_i", &[ZENITHS], &zeniths);
    file.add_numbers("wavelengths", &[1], &[wavelength_nm as f32]);
    file.add_numbers("sigma", &rows(&common.sigma), &common.sigma.single());
    file.add_numbers("ndf", &rows(&common.ndf), &common.ndf.single());
    let [rows, columns] = rows(&common.vndf.density);
    file.add_numbers("vndf", &[AZIMUTHS, ZENITHS, rows, columns], &vndf);
    file.add_numbers("luminance", &[AZIMUTHS, ZENITHS, NODES, NODES], &luminance);
    file.add_numbers("spectra", &[AZIMUTHS, ZENITHS, 1, NODES, NODES], &spectra);
    file.encode()
}

/// Adds the values of one direction of incidence.
fn slice(
    common: &Common,
    brdf: &SurfaceBrdf,
    [theta, phi]: [f64; 2],
    spectra: &mut Vec<f32>,
    luminance: &mut Vec<f32>,
) {
    let (sin, cos) = theta.sin_cos();
    let incident = Vector3::new(sin * phi.cos(), sin * phi.sin(), cos);
    let sigma = common.sigma.at([of_zenith(theta), 0.5]);
    let mut density = Vec::with_capacity(common.nodes.len());
    for node in &common.nodes {
        let (value, ndf) = common.value(brdf, incident, node);
        spectra.push((value * 4.0 * sigma / ndf) as f32);
        density.push(value * 4.0 * node.half.dot(&incident).max(0.0) * node.per_area);
    }
    let mean = density.iter().sum::<f64>() / density.len() as f64;
    let least = if mean > 0.0 {
        LUMINANCE_FLOOR * mean
    } else {
        1.0
    };
    luminance.extend(density.iter().map(|x| x.max(least) as f32));
}

#[cfg(test)]
mod tests;
