//! Scenes: a TOML text, checked as a whole, made ready to trace.
//!
//! Call [`Scene::parse`], then [`Scene::prepare`]. Unknown keys are errors, so are keys that a shape
//! does not have; every message names the key, what is wrong and what would be right. Files are
//! read by the caller and handed in as heights: this room does no I/O.

mod shape;

use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use super::facet::{Diffuse, Roughness};
use super::grid::Grid;
use super::profile::ProfileError;
use super::rng::{Purpose, Stream};
use super::surface::{Interface, Relief, Stack};
use super::vec3::V3;
use super::walk::Method;
use crate::material::tables::{self, MediaError};
pub use crate::model::LeftOut;
use crate::model::fresnel;
use crate::model::polarisation::Boundary;
use crate::wording::refusals::plain;

pub use shape::{HeightMap, MapUnits, Shape};

/// A scene as written.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Index above the first interface.
    #[serde(default = "one")]
    pub n_top: f64,
    /// The lamp.
    #[serde(default)]
    pub light: Lamp,
    /// Interfaces, top first.
    #[serde(default)]
    pub interface: Vec<Shape>,
    /// How much of it.
    #[serde(default)]
    pub run: Run,
}

/// Where light comes from.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Lamp {
    /// Polar angle of the direction to the lamp, degrees from n.
    pub theta_i_deg: f64,
    /// Its azimuth, degrees from u to v.
    pub phi_i_deg: f64,
    /// Wavelength, nm: picks n and k of named materials.
    pub wavelength_nm: f64,
    /// Stokes vector of the lamp in the frame (z × k, k × s); only its direction counts.
    pub stokes: [f64; 4],
}

impl Default for Lamp {
    fn default() -> Self {
        Lamp {
            theta_i_deg: 0.0,
            phi_i_deg: 0.0,
            wavelength_nm: 550.0,
            stokes: [1.0, 0.0, 0.0, 0.0],
        }
    }
}

/// How to trace.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Run {
    /// Photons to launch.
    pub photons: u64,
    /// Seed of everything random.
    pub seed: u64,
    /// "auto", true or false.
    pub polarised: toml::Value,
    /// How chance is used.
    pub method: Method,
    /// A photon is given up after so many interactions.
    pub interactions_max: u32,
    /// Direction bins over the polar angle.
    pub theta_bins: usize,
    /// Direction bins over the azimuth.
    pub phi_bins: usize,
}

impl Default for Run {
    fn default() -> Self {
        Run {
            photons: 1_000_000,
            seed: 1,
            polarised: toml::Value::String("auto".to_owned()),
            method: Method::Split,
            interactions_max: 1000,
            theta_bins: 45,
            phi_bins: 180,
        }
    }
}

fn one() -> f64 {
    1.0
}

/// Why a scene cannot be traced.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error("the scene cannot be read: {0}")]
    Text(String),
    /// Nothing to trace.
    #[error("the scene has no interface: add at least one [[interface]]")]
    NoInterface,
    /// A value that makes no sense.
    #[error("{key} = {value}: {expected}")]
    Value {
        /// The key with its place.
        key: String,
        /// What it is.
        value: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A key that the shape needs.
    #[error("interface {number} ({shape}) needs the key {key}")]
    Missing {
        /// 1 for the topmost.
        number: usize,
        /// Its shape.
        shape: String,
        /// The key.
        key: &'static str,
    },
    /// A key that the shape does not have.
    #[error("interface {number} ({shape}) has no key {key}")]
    Foreign {
        /// 1 for the topmost.
        number: usize,
        /// Its shape.
        shape: String,
        /// The key.
        key: &'static str,
    },
    /// A material.
    #[error("interface {number}: {source}")]
    Material {
        /// 1 for the topmost.
        number: usize,
        /// Why.
        source: MediaError,
    },
    /// A profile.
    #[error("interface {number}: {source}")]
    Profile {
        /// 1 for the topmost.
        number: usize,
        /// Why.
        source: ProfileError,
    },
    /// A file of heights.
    #[error("interface {number}: {path}: {reason}")]
    File {
        /// 1 for the topmost.
        number: usize,
        /// The file.
        path: String,
        /// Why it cannot be used.
        reason: String,
    },
    /// Layers below a metal are never reached.
    #[error(
        "interface {number} is a metal or a diffuse body: nothing gets through, so it must be the last"
    )]
    Unreachable {
        /// 1 for the topmost.
        number: usize,
    },
}

/// A scene ready to trace.
#[derive(Debug, Clone)]
pub struct Prepared {
    pub(super) stack: Stack,
    pub(super) method: Method,
    pub(super) stokes: [f64; 4],
    pub(super) k: V3,
    pub(super) s: V3,
    pub(super) interactions_max: u32,
    pub(super) grid: Grid,
    pub(super) seed: u64,
    /// Whether what the elements of a Mueller matrix have in common is kept in the plane of incidence, for the errors of
    /// Stokes vectors and of degree and angle of polarisation there; some ten microseconds per batch.
    pub plane: bool,
    /// Photons to launch.
    pub photons: u64,
    /// Whether polarisation is followed.
    pub polarised: bool,
    /// What is left out.
    pub left_out: Vec<LeftOut>,
    /// Effective ridge angles of the interfaces that lean to +v (median inclination by area).
    pub ridge_angles: Vec<RidgeAngle>,
    /// Whether a surface is drawn at random: one of many of the same statistics.
    pub is_drawn: bool,
}

/// The effective ridge angle of an interface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RidgeAngle {
    /// 1 for the topmost.
    pub interface: usize,
    /// Median inclination, by area, of the parts whose normal leans to +v, degrees.
    pub theta_r_deg: f64,
}

impl Prepared {
    /// How chance is used.
    #[must_use]
    pub fn method(&self) -> Method {
        self.method
    }

    /// Azimuth of the lamp, degrees.
    pub(super) fn phi_i_deg(&self) -> f64 {
        let [sin, minus_cos, _] = self.s;
        sin.atan2(-minus_cos).to_degrees()
    }

    /// Gives photons up after `limit` interactions, if the scene does not do so earlier.
    pub fn give_up_after(&mut self, limit: u32) {
        self.interactions_max = self.interactions_max.min(limit);
    }
}

/// What several interfaces go without.
const REGISTRATION: &str = "lateral registration of the layers";

impl Prepared {
    /// Goes without interfaces of the `scene` that do nothing to light (1 for the topmost): the media on both sides are
    /// the same. The others keep their numbers.
    ///
    /// # Panics
    /// Where nothing would be left.
    pub fn leave_out(&mut self, idle: &[usize], scene: &Scene) {
        let is_idle = |number: usize| idle.contains(&number);
        let mut number = 0;
        self.stack.interfaces.retain(|_| {
            number += 1;
            !is_idle(number)
        });
        number = 0;
        self.stack.optical_depth.retain(|_| {
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

    /// The same surfaces, met by other photons.
    #[must_use]
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// The same scene, counted in other direction bins.
    #[must_use]
    pub fn with_grid(mut self, grid: Grid) -> Self {
        self.grid = grid;
        self
    }
}

/// The shapes of a scene's interfaces, built. They are the same whatever light falls on them, and cheap to clone.
#[derive(Debug, Clone)]
pub struct Shapes {
    reliefs: Vec<(Relief, Option<Roughness>)>,
    left_out: Vec<LeftOut>,
    ridge_angles: Vec<RidgeAngle>,
}

/// What the media of a scene do to its light.
struct Optics {
    /// Above and below each interface, top first: n above, n and k below, optical depth of the layer below, and
    /// what comes back from a diffuse body.
    media: Vec<(f64, Complex<f64>, f64, Option<f64>)>,
    left_out: Vec<LeftOut>,
}

struct Medium {
    index: Complex<f64>,
    rho_d: Option<f64>,
}

impl Scene {
    /// Reads a scene's text.
    ///
    /// # Errors
    /// Text that is not TOML, unknown keys, values of the wrong type.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        toml::from_str(text).map_err(|e: toml::de::Error| {
            // Only what stands there and what is wanted is put in other words, not where, nor which keys there are.
            let (told, said) = (e.to_string(), e.message());
            let told = match said.starts_with("invalid ") {
                true => told.replace(said, &plain(said)),
                false => told,
            };
            SceneError::Text(told.trim().to_owned())
        })
    }

    /// Checks everything and builds the surfaces. `load` reads a file of heights.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn prepare(
        &self,
        load: &dyn Fn(&str) -> Result<HeightMap, String>,
    ) -> Result<Prepared, SceneError> {
        // What is wrong with lamp or media is told before a surface takes its time.
        self.checked()?;
        self.prepare_on(&self.shapes(load)?)
    }

    /// Builds the shapes of the interfaces alone, to be lit in several ways ([`Scene::prepare_on`]).
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn shapes(
        &self,
        load: &dyn Fn(&str) -> Result<HeightMap, String>,
    ) -> Result<Shapes, SceneError> {
        let mut shapes = Shapes {
            reliefs: Vec::new(),
            left_out: Vec::new(),
            ridge_angles: Vec::new(),
        };
        for (i, shape) in self.interface.iter().enumerate() {
            let number = i + 1;
            let (relief, roughness) = self.relief(shape, number, load, &mut shapes.left_out)?;
            let angle = relief.ridge_angle().map(|angle| RidgeAngle {
                interface: number,
                theta_r_deg: angle.to_degrees(),
            });
            shapes.ridge_angles.extend(angle);
            shapes.reliefs.push((relief, roughness));
        }
        Ok(shapes)
    }

    /// The scene with the shapes of one that differs in lamp and run only.
    ///
    /// # Errors
    /// See [`SceneError`].
    ///
    /// # Panics
    /// Where the shapes are those of another number of interfaces.
    pub fn prepare_on(&self, shapes: &Shapes) -> Result<Prepared, SceneError> {
        assert_eq!(
            shapes.reliefs.len(),
            self.interface.len(),
            "shapes of another scene"
        );
        let (polarised, stokes, optics) = self.checked()?;
        let mut interfaces = Vec::new();
        let mut optical_depth = Vec::new();
        for ((relief, roughness), (above, below, depth, rho_d)) in
            shapes.reliefs.iter().zip(optics.media)
        {
            let (n, k) = (below.re, below.im);
            interfaces.push(Interface {
                relief: relief.clone(),
                from_above: Boundary::new(above, n, k),
                from_below: Boundary::new(n, above, 0.0),
                roughness: *roughness,
                diffuse: rho_d.map(|r| Diffuse::new(r, n / above, 1.0, 1.0)),
            });
            optical_depth.push(depth);
        }
        let mut left_out = vec![wave_optics()];
        left_out.extend(optics.left_out);
        left_out.extend_from_slice(&shapes.left_out);
        if self.interface.len() > 1 {
            left_out.push(LeftOut {
                what: REGISTRATION.to_owned(),
                why: "layers are taken as thick against their relief: the place of entry is drawn afresh"
                    .to_owned(),
                cost: None,
            });
        }
        let (sin, cos) = self.light.theta_i_deg.to_radians().sin_cos();
        let (sin_phi, cos_phi) = self.light.phi_i_deg.to_radians().sin_cos();
        Ok(Prepared {
            stack: Stack {
                interfaces,
                optical_depth,
            },
            method: self.run.method,
            stokes,
            k: [-sin * cos_phi, -sin * sin_phi, -cos],
            s: [sin_phi, -cos_phi, 0.0],
            interactions_max: self.run.interactions_max,
            grid: Grid::polar(self.run.theta_bins, self.run.phi_bins),
            seed: self.run.seed,
            plane: true,
            photons: self.run.photons,
            polarised,
            left_out,
            ridge_angles: shapes.ridge_angles.clone(),
            is_drawn: self.interface.iter().any(Shape::is_drawn),
        })
    }

    /// Everything but the shapes, checked: whether polarisation is followed, the lamp's Stokes vector, the media.
    fn checked(&self) -> Result<(bool, [f64; 4], Optics), SceneError> {
        let polarised = match &self.run.polarised {
            toml::Value::Boolean(b) => *b,
            toml::Value::String(s) if s == "auto" => true,
            other => {
                return Err(value(
                    "run.polarised",
                    other,
                    "write \"auto\", true or false",
                ));
            }
        };
        self.check_run()?;
        let stokes = self.check_light()?;
        if self.interface.is_empty() {
            return Err(SceneError::NoInterface);
        }
        Ok((polarised, stokes, self.optics()?))
    }

    fn optics(&self) -> Result<Optics, SceneError> {
        let mut optics = Optics {
            media: Vec::new(),
            left_out: Vec::new(),
        };
        let mut above = self.n_top;
        for (i, shape) in self.interface.iter().enumerate() {
            let number = i + 1;
            let last = number == self.interface.len();
            let medium = self.medium(shape, number, above)?;
            if medium.rho_d.is_some() && !last {
                return Err(SceneError::Unreachable { number });
            }
            let left_out = &mut optics.left_out;
            let (depth, k) = self.layer(shape, number, &medium, last, left_out)?;
            let below = Complex::new(medium.index.re, k);
            optics.media.push((above, below, depth, medium.rho_d));
            above = below.re;
        }
        Ok(optics)
    }

    /// The same scene with another draw of every surface that is drawn, the `number`th.
    #[must_use]
    pub fn redrawn(&self, number: u64) -> Scene {
        let mut scene = self.clone();
        for (k, shape) in scene.interface.iter_mut().enumerate() {
            if shape.is_drawn() {
                let seed = shape.seed.unwrap_or(self.run.seed);
                // Away from the numbers that interfaces without a seed of their own have.
                let index = (number << 16) + k as u64;
                shape.seed = Some(Stream::new(seed, Purpose::Surface, index).bits());
            }
        }
        scene
    }

    /// Checks lamp, run and media, without building surfaces.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn check(&self) -> Result<(), SceneError> {
        self.checked().map(|_| ())
    }

    /// Whether a material comes from a table over the wavelength.
    #[must_use]
    pub fn depends_on_wavelength(&self) -> bool {
        let named = |shape: &Shape| match &shape.below {
            toml::Value::String(name) => tables::is_dispersive(name),
            _ => false,
        };
        self.interface.iter().any(named)
    }

    fn check_run(&self) -> Result<(), SceneError> {
        let run = &self.run;
        if !(1..=10_000_000_000_000).contains(&run.photons) {
            return Err(value("run.photons", run.photons, "must be from 1 to 1e13"));
        }
        if run.interactions_max == 0 {
            return Err(value("run.interactions_max", 0, "must be 1 or more"));
        }
        for (key, bins) in [
            ("run.theta_bins", run.theta_bins),
            ("run.phi_bins", run.phi_bins),
        ] {
            if !(1..=1440).contains(&bins) {
                return Err(value(key, bins, "must be from 1 to 1440"));
            }
        }
        Ok(())
    }

    fn check_light(&self) -> Result<[f64; 4], SceneError> {
        let light = &self.light;
        if !(0.0..90.0).contains(&light.theta_i_deg) {
            return Err(value(
                "light.theta_i_deg",
                light.theta_i_deg,
                "must be in [0, 90)",
            ));
        }
        if !light.phi_i_deg.is_finite() {
            return Err(value("light.phi_i_deg", light.phi_i_deg, "must be finite"));
        }
        positive("light.wavelength_nm", light.wavelength_nm)?;
        index("n_top", self.n_top)?;
        let [i, q, u, v] = light.stokes;
        let polarised = (q * q + u * u + v * v).sqrt();
        if !(i > 0.0 && i.is_finite() && polarised <= i * (1.0 + 1e-9)) {
            return Err(value(
                "light.stokes",
                format!("{:?}", light.stokes),
                "I must be positive and the polarised part no larger than I",
            ));
        }
        Ok([1.0, q / i, u / i, v / i])
    }

    fn medium(&self, shape: &Shape, number: usize, above: f64) -> Result<Medium, SceneError> {
        let key = |k: &str| format!("interface {number}: below.{k}");
        match &shape.below {
            toml::Value::String(name) => {
                let index = tables::index_of(name, self.light.wavelength_nm)
                    .map_err(|source| SceneError::Material { number, source })?;
                Ok(Medium { index, rho_d: None })
            }
            toml::Value::Table(table) => {
                let number_of = |name: &str| match table.get(name) {
                    None => Ok(None),
                    Some(toml::Value::Float(x)) => Ok(Some(*x)),
                    Some(toml::Value::Integer(x)) => Ok(Some(*x as f64)),
                    Some(other) => Err(value(&key(name), other, "must be a number")),
                };
                if let Some(unknown) = table
                    .keys()
                    .find(|k| !["n", "k", "rho_d"].contains(&k.as_str()))
                {
                    return Err(value(
                        &key(unknown),
                        &table[unknown],
                        "unknown key; known are n, k, rho_d",
                    ));
                }
                let n = number_of("n")?.ok_or(SceneError::Missing {
                    number,
                    shape: shape.shape.clone(),
                    key: "below.n",
                })?;
                index(&key("n"), n)?;
                let k = number_of("k")?.unwrap_or(0.0);
                if !(0.0..=*INDEX_RANGE.end()).contains(&k) {
                    return Err(value(&key("k"), k, "must lie from 0 to 1e30"));
                }
                let rho_d = number_of("rho_d")?;
                if let Some(rho) = rho_d {
                    let t = fresnel::transmittance(1.0, n / above, 0.0);
                    if k > 0.0 || !(rho >= 0.0 && rho <= t * t) {
                        return Err(value(
                            &key("rho_d"),
                            rho,
                            "needs k = 0 and must be from 0 to what the boundary lets through",
                        ));
                    }
                }
                Ok(Medium {
                    index: Complex::new(n, k),
                    rho_d,
                })
            }
            other => Err(value(
                &format!("interface {number}: below"),
                other,
                "write { n = 1.5 }, { n = 0.35, k = 2.7 } or a material's name",
            )),
        }
    }

    /// Optical depth of the layer below, and the k that its boundary reflects with.
    fn layer(
        &self,
        shape: &Shape,
        number: usize,
        medium: &Medium,
        last: bool,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<(f64, f64), SceneError> {
        if let Some(thickness) = shape.thickness_um {
            positive(&format!("interface {number}: thickness_um"), thickness)?;
        }
        let k = medium.index.im;
        if last && shape.thickness_um.is_some() {
            left_out.push(LeftOut {
                what: format!("thickness_um of interface {number}"),
                why: "what lies below the last interface has no other side: light that enters it does not come back"
                    .to_owned(),
                cost: None,
            });
        }
        if last || k == 0.0 {
            return Ok((0.0, k));
        }
        // Beyond this the layer is opaque within a wavelength: not a layer but a substrate.
        if k > 0.1 * medium.index.re {
            return Err(SceneError::Unreachable { number });
        }
        let Some(thickness) = shape.thickness_um else {
            return Err(SceneError::Missing {
                number,
                shape: shape.shape.clone(),
                key: "thickness_um (the layer below absorbs)",
            });
        };
        let depth = 4.0e3 * std::f64::consts::PI * k * thickness / self.light.wavelength_nm;
        left_out.push(LeftOut {
            what: format!("absorption within the relief of interface {number}"),
            why: "a layer absorbs over its thickness between mean planes".to_owned(),
            cost: None,
        });
        left_out.push(LeftOut {
            what: format!("the absorption of layer {number} in its Fresnel amplitudes"),
            why: "a layer that light crosses has k much smaller than n".to_owned(),
            cost: Some((k / medium.index.re).powi(2)),
        });
        Ok((depth, 0.0))
    }
}

fn wave_optics() -> LeftOut {
    LeftOut {
        what: "interference and diffraction".to_owned(),
        why: "rays: structures and layers are taken as large against the wavelength".to_owned(),
        cost: None,
    }
}

fn value(key: &str, value: impl std::fmt::Display, expected: &'static str) -> SceneError {
    SceneError::Value {
        key: key.to_owned(),
        value: value.to_string(),
        expected,
    }
}

/// Indices beyond any medium's, whose powers numbers do not hold.
const INDEX_RANGE: std::ops::RangeInclusive<f64> = 1e-30..=1e30;

fn index(key: &str, x: f64) -> Result<(), SceneError> {
    positive(key, x)?;
    if INDEX_RANGE.contains(&x) {
        Ok(())
    } else {
        Err(value(key, x, "a refractive index lies from 1e-30 to 1e30"))
    }
}

fn positive(key: &str, x: f64) -> Result<(), SceneError> {
    if x > 0.0 && x.is_finite() {
        Ok(())
    } else {
        Err(value(key, x, "must be greater than 0"))
    }
}
