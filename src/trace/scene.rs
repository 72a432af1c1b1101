//! Scenes: parses a TOML text, checks it, and prepares it for tracing.
//!
//! Call [`Scene::parse`], then [`Scene::prepare`]. Unknown keys are errors, and so are keys that a
//! shape does not have; every message names the key, the fault and the expected value. The caller
//! reads the files and passes the heights in: this module does no I/O.

mod error;
mod height_map;
mod media;
mod prepared;
mod shape;

use serde::Deserialize;

use super::counting::grid::DirectionGrid;
use super::facets::scattering::{DiffuseBody, Roughness};
use super::photons::interface::{Interface, Relief, Stack, StackLayer};
use super::photons::walk::Method;
use super::rng::{Purpose, RandomStream};
use crate::material::tables;
pub use crate::model::LeftOut;
use crate::model::polarisation::Boundary;
use crate::wording::toml_text;

use error::{positive, value};
use media::{MediumStep, SceneOptics, index};
use prepared::REGISTRATION;

pub use error::SceneError;
pub use height_map::{HeightMap, MapUnits};
pub use prepared::{PreparedScene, RidgeAngle};
pub use shape::InterfaceShape;

/// A scene as written.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Index above the first interface.
    #[serde(default = "one")]
    pub n_top: f64,
    /// The lamp.
    #[serde(default)]
    pub light: LampSettings,
    /// Interfaces, top first.
    #[serde(default)]
    pub interface: Vec<InterfaceShape>,
    /// Number of photons, seed and method.
    #[serde(default)]
    pub run: RunSettings,
}

/// The direction and state of the incident light.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LampSettings {
    /// Polar angle of the direction to the lamp, degrees from n.
    pub theta_i_deg: f64,
    /// Azimuth of that direction, degrees from u towards v.
    pub phi_i_deg: f64,
    /// Wavelength, nm; selects n and k of named materials.
    pub wavelength_nm: f64,
    /// Stokes vector of the lamp in the frame (z × k, k × s); only its ratios matter.
    pub stokes: [f64; 4],
}

impl Default for LampSettings {
    fn default() -> Self {
        LampSettings {
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
pub struct RunSettings {
    /// Photons to launch.
    pub photons: u64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// "auto", true or false.
    pub polarised: toml::Value,
    /// How random numbers are used.
    pub method: Method,
    /// Interactions after which a photon is given up.
    pub interactions_max: u32,
    /// Direction bins over the polar angle.
    pub theta_bins: usize,
    /// Direction bins over the azimuth.
    pub phi_bins: usize,
}

impl Default for RunSettings {
    fn default() -> Self {
        RunSettings {
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

/// The built shapes of a scene's interfaces. They do not depend on the light and are cheap to
/// clone.
#[derive(Debug, Clone)]
pub struct BuiltShapes {
    reliefs: Vec<(Relief, Option<Roughness>)>,
    left_out: Vec<LeftOut>,
    ridge_angles: Vec<RidgeAngle>,
}

impl Scene {
    /// Parses a scene.
    ///
    /// # Errors
    /// The text is not TOML, a key is unknown, or a value has the wrong type.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        toml::from_str(text)
            .map_err(|error: toml::de::Error| {
                // The parser shows the place; the second reader names the key and what is expected.
                let shown = error.to_string();
                SceneError::Text(match toml_text::read::<Scene>(text) {
                    Err(refused) if !refused.key.is_empty() => {
                        let refused = format!("{}: {}", refused.key, refused.words);
                        shown.trim().replace(error.message(), &refused)
                    }
                    _ => shown.trim().to_owned(),
                })
            })
            .and_then(Scene::with_seeds_in_range)
    }

    /// Refuses seeds above TOML's largest integer, which other programs cannot read.
    fn with_seeds_in_range(self) -> Result<Self, SceneError> {
        let shapes = self.interface.iter().enumerate();
        let shapes = shapes.map(|(i, shape)| (format!("interface {}: seed", i + 1), shape.seed));
        let run = ("run.seed".to_owned(), Some(self.run.seed));
        for (key, seed) in shapes.chain([run]) {
            if let Some(seed) = seed.filter(|seed| *seed > WHOLE_MAX) {
                let expected = "must be from 0 to 9223372036854775807 (2^63 − 1)";
                return Err(value(&key, seed, expected));
            }
        }
        Ok(self)
    }

    /// Checks the scene and builds its surfaces. `load` reads a file of heights.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn prepare(
        &self,
        load: &dyn Fn(&str) -> Result<HeightMap, String>,
    ) -> Result<PreparedScene, SceneError> {
        // Checked first, because building a surface may take long.
        self.checked()?;
        self.prepare_on(&self.shapes(load)?)
    }

    /// Builds only the shapes of the interfaces, to light them in several ways
    /// ([`Scene::prepare_on`]).
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn shapes(
        &self,
        load: &dyn Fn(&str) -> Result<HeightMap, String>,
    ) -> Result<BuiltShapes, SceneError> {
        let mut shapes = BuiltShapes {
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

    /// Prepares the scene with the shapes of another scene that differs only in lamp and run.
    ///
    /// # Errors
    /// See [`SceneError`].
    ///
    /// # Panics
    /// The shapes belong to a scene with another number of interfaces.
    pub fn prepare_on(&self, shapes: &BuiltShapes) -> Result<PreparedScene, SceneError> {
        assert_eq!(
            shapes.reliefs.len(),
            self.interface.len(),
            "shapes of another scene"
        );
        let (polarised, stokes, optics) = self.checked()?;
        let mut interfaces = Vec::new();
        let mut layers = Vec::new();
        for ((relief, roughness), step) in shapes.reliefs.iter().zip(optics.steps) {
            let MediumStep { above, below, .. } = step;
            // An absorbing medium below the last interface is treated as a metal.
            let enters = interfaces.len() + 1 < self.interface.len();
            interfaces.push(Interface {
                relief: relief.clone(),
                from_above: Boundary::between(above, below, enters),
                from_below: Boundary::between(below, above, true),
                roughness: *roughness,
                diffuse: step
                    .rho_d
                    .map(|r| DiffuseBody::new(r, below.re / above.re, 1.0, 1.0)),
            });
            layers.push(StackLayer {
                optical_depth: step.optical_depth,
                index: below,
            });
        }
        let mut left_out = vec![wave_optics()];
        left_out.extend(optics.left_out);
        left_out.extend_from_slice(&shapes.left_out);
        if self.interface.len() > 1 {
            left_out.push(LeftOut {
                what: REGISTRATION.to_owned(),
                why: "layers are assumed thick compared with their relief: the point of entry is drawn independently"
                    .to_owned(),
                cost: None,
            });
        }
        let (sin, cos) = self.light.theta_i_deg.to_radians().sin_cos();
        let (sin_phi, cos_phi) = self.light.phi_i_deg.to_radians().sin_cos();
        Ok(PreparedScene {
            stack: Stack { interfaces, layers },
            method: self.run.method,
            stokes,
            k: [-sin * cos_phi, -sin * sin_phi, -cos],
            s: [sin_phi, -cos_phi, 0.0],
            interactions_max: self.run.interactions_max,
            grid: DirectionGrid::polar(self.run.theta_bins, self.run.phi_bins)
                .straight_at(self.light.phi_i_deg),
            seed: self.run.seed,
            plane: true,
            photons: self.run.photons,
            polarised,
            left_out,
            ridge_angles: shapes.ridge_angles.clone(),
            is_drawn: self.interface.iter().any(InterfaceShape::is_drawn),
        })
    }

    /// Checks everything except the shapes; returns whether polarisation is followed, the lamp's
    /// Stokes vector, and the media.
    fn checked(&self) -> Result<(bool, [f64; 4], SceneOptics), SceneError> {
        let polarised = match &self.run.polarised {
            toml::Value::Boolean(b) => *b,
            toml::Value::String(s) if s == "auto" => true,
            other => {
                return Err(value(
                    "run.polarised",
                    other,
                    "must be \"auto\", true or false",
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

    /// The scene with the `number`th other realisation of each random surface.
    #[must_use]
    pub fn redrawn(&self, number: u64) -> Scene {
        let mut scene = self.clone();
        for (k, shape) in scene.interface.iter_mut().enumerate() {
            if shape.is_drawn() {
                let seed = shape.seed.unwrap_or(self.run.seed);
                // Different from the indices of interfaces without a seed of their own.
                let index = (number << 16) + k as u64;
                shape.seed = Some(RandomStream::new(seed, Purpose::Surface, index).bits());
            }
        }
        scene
    }

    /// Checks lamp, run and media without building surfaces.
    ///
    /// # Errors
    /// See [`SceneError`].
    pub fn check(&self) -> Result<(), SceneError> {
        self.checked().map(|_| ())
    }

    /// Whether a material is tabulated over the wavelength.
    #[must_use]
    pub fn depends_on_wavelength(&self) -> bool {
        let named = |shape: &InterfaceShape| match &shape.below {
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
}

/// The largest integer of TOML.
const WHOLE_MAX: u64 = i64::MAX as u64;

fn wave_optics() -> LeftOut {
    LeftOut {
        what: "interference and diffraction".to_owned(),
        why: "light is traced as rays: structures and layers are assumed large compared with the wavelength".to_owned(),
        cost: None,
    }
}
