//! `manifest.toml`: the rig, the camera, the references and the nominal material of a series.
//!
//! Keys that are not known are kept as notes (recorded series carry many); one that looks like a
//! slip of a known key is refused, since a mistyped azimuth zero would otherwise count as 0.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::geometry::{Cones, RigGeometry};
use crate::material::{Material, tables};
use crate::units::Angle;

/// Standard uncertainty of a part of a refractive index where none is stated.
pub const INDEX_STD: f64 = 0.01;
/// Standard uncertainty of a stated translucency that states none.
pub const TRANSLUCENCY_STD: f64 = 0.05;

/// The form's name, the value of the manifest's `schema`.
pub const SCHEMA: &str = "gonio-series-1";

/// Keys that the program does not use, kept so that an export loses nothing.
pub type Notes = BTreeMap<String, toml::Value>;

/// Content of `manifest.toml`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`SCHEMA`].
    pub schema: String,
    /// Name of the series.
    #[serde(default)]
    pub name: String,
    /// File name of the list of frames.
    #[serde(default = "default_frames")]
    pub frames: String,
    /// Further keys.
    #[serde(flatten)]
    pub notes: Notes,
    /// The rig.
    pub rig: RigFacts,
    /// The camera.
    pub camera: CameraFacts,
    /// The white reference, if there was one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flat: Option<FlatFacts>,
    /// How dark frames were taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dark: Option<DarkFacts>,
    /// The sample.
    pub sample: SampleFacts,
}

fn default_frames() -> String {
    "frames.csv".to_owned()
}

/// `[rig]`: positions of lamp and camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RigFacts {
    /// Angle θl between lamp and camera.
    pub theta_l_deg: f64,
    /// Azimuth φl of the lamp about the camera's axis; 0 in the tilt plane.
    #[serde(default)]
    pub light_azimuth_deg: f64,
    /// Added to the recorded φs it gives the azimuth of v.
    #[serde(default)]
    pub azimuth_zero_deg: f64,
    /// Standard uncertainty of the azimuth of v at a recorded φs: that of `azimuth_zero_deg` and of laying a sample down.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub azimuth_zero_std_deg: Option<f64>,
    /// Half angle of the lamp seen from the sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_angular_radius_deg: Option<f64>,
    /// Wavelength of the lamp.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wavelength_nm: Option<f64>,
    /// Column and row of the point about which camera and lamp tilt; (0, 0) is the outer corner of the first pixel. The
    /// frame's centre by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tilt_centre_px: Option<[f64; 2]>,
    /// Column and row at which the rotation axis meets the sample at θc = 0. That of the centre of tilt by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_axis_px: Option<[f64; 2]>,
    /// `infinity` or `finite`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_distance: Option<String>,
    /// `infinity` or `finite`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_distance: Option<String>,
    /// From the centre of tilt to the lamp, where it is finite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_distance_mm: Option<f64>,
    /// Half angle of the lens's pupil seen from the sample; its sine is the numerical aperture there. A point
    /// where neither this nor `lens_radius_mm` is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens_angular_radius_deg: Option<f64>,
    /// Radius of the lamp, where its distance is finite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_radius_mm: Option<f64>,
    /// Standard uncertainty of the inclination of a sample's mean plane to the turntable, in any direction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sample_wedge_std_deg: Option<f64>,
    /// Standard uncertainty of `theta_l_deg`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub theta_l_std_deg: Option<f64>,
    /// From the centre of tilt to the camera's pupil, where it is finite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_distance_mm: Option<f64>,
    /// Radius of the lens's pupil, where its distance is finite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens_radius_mm: Option<f64>,
    /// Standard uncertainty of the recorded θc that is left once a fit knows the tilt's offset: of the stage's zero, and of
    /// its error at the ends of the range of tilts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub theta_c_std_deg: Option<f64>,
    /// The same for the recorded φs: the stage's zero, and its error over one turn.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phi_s_std_deg: Option<f64>,
    /// Relative standard uncertainty that the lamp's drift between white reference and sample gives the signals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lamp_drift_std: Option<f64>,
    /// Further keys.
    #[serde(flatten)]
    #[schema(ignore)]
    pub notes: Notes,
}

/// `[camera]`: how counts are made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CameraFacts {
    /// `orthographic` (telecentric) or `perspective`.
    #[serde(default = "default_projection")]
    pub projection: String,
    /// Columns of a frame.
    pub width_px: u32,
    /// Rows of a frame.
    pub height_px: u32,
    /// Width of the field in the plane through the centre of tilt, across the view.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field_width_mm: Option<f64>,
    /// Height of the field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field_height_mm: Option<f64>,
    /// Bits of the converter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bit_depth: Option<u32>,
    /// Count at which a pixel is full; by default what `bit_depth` allows, else 65535.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saturation_dn: Option<f64>,
    /// Counts per electron.
    pub gain_dn_per_electron: f64,
    /// Count without light and without dark current; dark frames replace it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub black_level_dn: Option<f64>,
    /// Read noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_electrons_rms: Option<f64>,
    /// Exposure times that the series has.
    #[serde(default)]
    pub exposures_s: Vec<f64>,
    /// From the centre of tilt to the camera's pupil, where it is finite and `[rig]` does not state it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_distance_mm: Option<f64>,
    /// Column and row of the foot of a near camera's optical axis. That of the centre of tilt by default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub principal_point_px: Option<[f64; 2]>,
    /// Relative standard uncertainty of an exposure time, independent between exposure times.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_rel_std: Option<f64>,
    /// Further keys.
    #[serde(flatten)]
    #[schema(ignore)]
    pub notes: Notes,
}

fn default_projection() -> String {
    "orthographic".to_owned()
}

/// `[flat]`: the white reference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FlatFacts {
    /// Diffuse reflectance from the certificate; without one the flats give no absolute scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reflectance: Option<f64>,
    /// Its standard uncertainty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reflectance_std: Option<f64>,
    /// Further keys.
    #[serde(flatten)]
    #[schema(ignore)]
    pub notes: Notes,
}

impl FlatFacts {
    /// Key of the certificate: its number, date and laboratory, for reports.
    pub const CERTIFICATE: &str = "certificate";

    /// Returns the certificate, where it is stated.
    #[must_use]
    pub fn certificate(&self) -> Option<&str> {
        self.notes.get(FlatFacts::CERTIFICATE)?.as_str()
    }
}

/// `[dark]`: how dark frames were taken; notes only.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DarkFacts {
    /// All keys.
    #[serde(flatten)]
    pub notes: Notes,
}

/// What kind of matter the sample is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SampleKind {
    /// Plastic, glass: `index_of_refraction`.
    Dielectric,
    /// Metal: `eta` and `k`.
    Conductor,
}

/// `[sample]`: the nominal material and, where the sample has patches, their layout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SampleFacts {
    /// Dielectric or conductor.
    pub kind: SampleKind,
    /// n of a dielectric.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub index_of_refraction: Option<f64>,
    /// Its standard uncertainty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub index_of_refraction_std: Option<f64>,
    /// A metal of the tables ([`crate::material::tables`]) that stands for `eta` and `k` at the lamp's wavelength,
    /// where they are not stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metal: Option<String>,
    /// n of a conductor (or of a dielectric).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eta: Option<f64>,
    /// k of a conductor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k: Option<f64>,
    /// Standard uncertainty of `eta`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eta_std: Option<f64>,
    /// Standard uncertainty of `k`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k_std: Option<f64>,
    /// Length of a pitch facet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pitch_length_um: Option<f64>,
    /// Share of the body's light that leaves evenly over the ridges (0: opaque, 1: all of it).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub translucency: Option<f64>,
    /// Standard uncertainty of `translucency`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub translucency_std: Option<f64>,
    /// Further keys.
    #[serde(flatten)]
    pub notes: Notes,
    /// Patches of different lean directions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layout: Option<LayoutFacts>,
}

/// `[sample.layout]`: a board of square patches, alternately of two lean directions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LayoutFacts {
    /// Patches along the sample's x.
    pub patches_x: u32,
    /// Patches along the sample's y.
    pub patches_y: u32,
    /// Edge of a patch.
    pub patch_size_mm: f64,
    /// Centre of the board from the rotation axis.
    #[serde(default)]
    pub centre_mm: [f64; 2],
    /// Lean direction of patches with i + j even, in words (`… v at phi_s …`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub even_patches: Option<String>,
    /// Lean direction of patches with i + j odd, in words (`… v at phi_s + 90 deg …`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub odd_patches: Option<String>,
    /// Further keys.
    #[serde(flatten)]
    pub notes: Notes,
}

impl LayoutFacts {
    /// Lean direction of a patch relative to the sample's own azimuth; `odd` for i + j odd. It is
    /// read from the words of the manifest; 0° and 90° where they state none.
    #[must_use]
    pub fn lean_azimuth(&self, odd: bool) -> Angle {
        let (words, default_deg) = if odd {
            (&self.odd_patches, 90.0)
        } else {
            (&self.even_patches, 0.0)
        };
        Angle::from_deg(
            words
                .as_deref()
                .and_then(degrees_after_phi_s)
                .unwrap_or(default_deg),
        )
    }
}

/// Whether words state a lean direction in the form that [`LayoutFacts::lean_azimuth`] reads: `phi_s`, then nothing up to the
/// next mark, or an angle in degrees with its sign.
pub(super) fn is_lean(words: &str) -> bool {
    let Some((_, rest)) = words.split_once("phi_s") else {
        return false;
    };
    if rest.starts_with(|c: char| c.is_alphanumeric() || c == '_') {
        return false;
    }
    let clause = rest.split(['(', ')', ';']).next().unwrap_or(rest).trim();
    let Some(turn) = clause.strip_prefix(['+', '-', '−']) else {
        // Words, but none that may mean an angle.
        let clause = clause.split(',').next().unwrap_or(clause);
        let signs = |word: &str| ["plus", "minus"].contains(&word);
        return !clause.contains(|c: char| c.is_ascii_digit() || "+-−*/".contains(c))
            && !clause.split_whitespace().any(signs);
    };
    let turn = turn.trim_start();
    let end = turn.find(|c: char| !(c.is_ascii_digit() || c == '.'));
    let (number, unit) = turn.split_at(end.unwrap_or(turn.len()));
    let unit = unit.trim_start();
    // A comma ends the clause, unless it is a decimal one.
    let ends = unit
        .strip_prefix(',')
        .is_some_and(|after| !after.trim_start().starts_with(|c: char| c.is_ascii_digit()));
    number.parse::<f64>().is_ok()
        && (unit.is_empty() || ends || unit.starts_with("deg") || unit.starts_with('°'))
}

/// 90 from `… v at phi_s + 90 deg …`, 0 from `… v at phi_s (…`, none without `phi_s`.
fn degrees_after_phi_s(words: &str) -> Option<f64> {
    let rest = words.split_once("phi_s")?.1.trim_start();
    let (sign, rest) = if let Some(rest) = rest.strip_prefix('+') {
        (1.0, rest)
    } else if let Some(rest) = rest.strip_prefix('-').or_else(|| rest.strip_prefix('−')) {
        (-1.0, rest)
    } else {
        return Some(0.0);
    };
    let number: String = rest
        .trim_start()
        .chars()
        .take_while(|c| c.is_ascii_digit() || *c == '.')
        .collect();
    number.parse::<f64>().ok().map(|deg| sign * deg)
}

impl Manifest {
    /// The manifest as the text of a TOML file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a manifest of numbers, text and tables is TOML")
    }

    /// The rig's angles, for directions.
    #[must_use]
    pub fn rig_geometry(&self) -> RigGeometry {
        let rig = &self.rig;
        // The angle where it is stated, else what the radius spans at its distance, else a point.
        let cone = |deg: Option<f64>, radius_mm: Option<f64>, distance_mm: Option<f64>| {
            deg.map(Angle::from_deg)
                .or_else(|| Some(Angle::from_rad((radius_mm? / distance_mm?).atan())))
                .unwrap_or(Angle::ZERO)
        };
        RigGeometry {
            theta_l: Angle::from_deg(rig.theta_l_deg),
            light_azimuth: Angle::from_deg(rig.light_azimuth_deg),
            azimuth_zero: Angle::from_deg(rig.azimuth_zero_deg),
            cones: Cones {
                lamp: cone(
                    rig.light_angular_radius_deg,
                    rig.light_radius_mm,
                    rig.light_distance_mm,
                ),
                lens: cone(
                    rig.lens_angular_radius_deg,
                    rig.lens_radius_mm,
                    self.camera_distance_mm(),
                ),
            },
        }
    }

    /// The metal that the sample names, at the lamp's wavelength; none where one of them is not stated.
    ///
    /// # Errors
    /// In words: no such metal, or a wavelength outside its table.
    pub(super) fn metal(&self) -> Option<Result<Material, String>> {
        let name = self.sample.metal.as_deref()?;
        let wavelength_nm = self.rig.wavelength_nm?;
        Some(tables::metal(name, wavelength_nm).map_err(|e| e.to_string()))
    }

    /// Share of the body's light that leaves evenly over the ridges and its standard uncertainty, where it is stated.
    #[must_use]
    pub fn translucency(&self) -> Option<(f64, f64)> {
        let std = self.sample.translucency_std.unwrap_or(TRANSLUCENCY_STD);
        Some((self.sample.translucency?, std))
    }

    /// The nominal material. A standard uncertainty that is not stated counts as [`INDEX_STD`], and that of a metal by name
    /// as [`tables::RELATIVE_STD`] of its index.
    #[must_use]
    pub fn material(&self) -> Material {
        let sample = &self.sample;
        if let Some(Ok(Material::Conductor {
            eta,
            k,
            eta_std,
            k_std,
        })) = self.metal()
        {
            // What is stated counts more than what a table says.
            let or = |stated: Option<f64>, std: Option<f64>, table: f64, table_std: f64| {
                stated.map_or((table, std.unwrap_or(table_std)), |x| {
                    (x, std.unwrap_or(INDEX_STD))
                })
            };
            let (eta, eta_std) = or(sample.eta, sample.eta_std, eta, eta_std);
            let (k, k_std) = or(sample.k, sample.k_std, k, k_std);
            return Material::Conductor {
                eta,
                k,
                eta_std,
                k_std,
            };
        }
        match sample.kind {
            SampleKind::Dielectric => Material::Dielectric {
                eta: sample
                    .index_of_refraction
                    .or(sample.eta)
                    .expect("`check` refuses a dielectric without an index"),
                eta_std: sample
                    .index_of_refraction_std
                    .or(sample.eta_std)
                    .unwrap_or(INDEX_STD),
            },
            SampleKind::Conductor => Material::Conductor {
                eta: sample.eta.expect("`check` refuses a conductor without eta"),
                k: sample.k.expect("`check` refuses a conductor without k"),
                eta_std: sample.eta_std.unwrap_or(INDEX_STD),
                k_std: sample.k_std.unwrap_or(INDEX_STD),
            },
        }
    }

    /// From the centre of tilt to the camera's pupil, wherever it is stated.
    #[must_use]
    pub fn camera_distance_mm(&self) -> Option<f64> {
        self.rig
            .camera_distance_mm
            .or(self.camera.camera_distance_mm)
    }

    /// Whether lamp and camera are so far away that every pixel has the same directions. A distance in millimetres is
    /// finite, with the word or without it.
    #[must_use]
    pub fn is_telecentric(&self) -> bool {
        let finite = |word: &Option<String>, mm: Option<f64>| match word.as_deref() {
            Some(word) => word == "finite",
            None => mm.is_some(),
        };
        self.camera.projection == "orthographic"
            && !finite(&self.rig.light_distance, self.rig.light_distance_mm)
            && !finite(&self.rig.camera_distance, self.camera_distance_mm())
    }

    /// Count at which a pixel is full.
    #[must_use]
    pub fn saturation_dn(&self) -> f64 {
        self.camera.full_dn()
    }
}

/// A value of a camera that does not fit the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Contradiction {
    /// Its key.
    pub key: &'static str,
    /// Its value.
    pub value: f64,
    /// What the other values allow.
    pub allowed: String,
}

impl CameraFacts {
    /// Largest count that the bits allow, where they are stated.
    #[must_use]
    pub fn count_max(&self) -> Option<f64> {
        let of_bits = |bits: u32| f64::from((1_u32 << bits.min(16)) - 1);
        self.bit_depth.map(of_bits)
    }

    /// Count at which a pixel is full: what is stated, or else what the bits allow.
    #[must_use]
    pub fn full_dn(&self) -> f64 {
        let most = || self.count_max().unwrap_or(f64::from(u16::MAX));
        self.saturation_dn.unwrap_or_else(most)
    }

    /// Returns the first value that contradicts the others.
    #[must_use]
    pub fn contradiction(&self) -> Option<Contradiction> {
        let full_dn = self.full_dn();
        let black_dn = self.black_level_dn.unwrap_or(0.0);
        let noise_dn = self.read_noise_electrons_rms.unwrap_or(0.0) * self.gain_dn_per_electron;
        let found = |key, value, allowed| {
            Some(Contradiction {
                key,
                value,
                allowed,
            })
        };
        match (self.bit_depth, self.count_max(), self.saturation_dn) {
            (Some(bits), Some(most), Some(full)) if full > most => {
                let allowed = format!("at most {most}, the largest count of bit_depth = {bits}");
                return found("saturation_dn", full, allowed);
            }
            _ => {}
        }
        if black_dn >= full_dn {
            let allowed = format!("below {full_dn}, the count at which a pixel is full");
            return found("black_level_dn", black_dn, allowed);
        }
        if noise_dn >= full_dn - black_dn {
            let allowed = format!(
                "less than what a pixel takes, which with gain_dn_per_electron = {} from black_level_dn = {black_dn} to \
                 {full_dn} counts is {:.4} electrons",
                self.gain_dn_per_electron,
                (full_dn - black_dn) / self.gain_dn_per_electron
            );
            let noise = self.read_noise_electrons_rms.unwrap_or(0.0);
            return found("read_noise_electrons_rms", noise, allowed);
        }
        None
    }

    /// The same as a count that a frame can have.
    #[must_use]
    pub fn full_count(&self) -> u16 {
        self.full_dn().clamp(1.0, f64::from(u16::MAX)) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CHECKER: &str = include_str!("../../tests/data/series/checker/manifest.toml");
    const STEEL: &str = include_str!("../../tests/data/series/steel-15/manifest.toml");

    #[test]
    fn a_manifest_survives_toml_and_json_with_its_notes() {
        for text in [CHECKER, STEEL] {
            let manifest = Manifest::from_toml(text, "").unwrap();
            assert!(manifest.rig.notes.contains_key("tilt_plane"));
            assert_eq!(
                Manifest::from_toml(&manifest.to_toml(), "").unwrap(),
                manifest
            );
            let json = serde_json::to_string(&manifest).unwrap();
            assert_eq!(serde_json::from_str::<Manifest>(&json).unwrap(), manifest);
        }
    }

    #[test]
    fn cones_are_stated_as_angles_or_spanned_by_radii() {
        let mut manifest = Manifest::from_toml(CHECKER, "").unwrap();
        let stated = manifest.rig.light_angular_radius_deg.unwrap();
        let cones = manifest.rig_geometry().cones;
        assert_eq!(
            (cones.lamp.deg_for_tables(), cones.lens.deg()),
            (stated, 0.0)
        );

        let rig = &mut manifest.rig;
        rig.light_angular_radius_deg = None;
        (rig.light_radius_mm, rig.light_distance_mm) = (Some(10.0), Some(1000.0));
        (rig.lens_radius_mm, rig.camera_distance_mm) = (Some(20.0), Some(1000.0));
        let cones = manifest.rig_geometry().cones;
        assert_eq!(cones.lamp.rad(), 0.01f64.atan());
        assert_eq!(cones.lens.rad(), 0.02f64.atan());

        manifest.rig.lens_angular_radius_deg = Some(3.0);
        let cones = manifest.rig_geometry().cones;
        assert_eq!(cones.lens.deg_for_tables(), 3.0);
        let doubled = cones.lens.rad().powi(2) + 0.01f64.atan().powi(2);
        assert!((cones.widening() - doubled / 8.0).abs() < 1e-18);
    }

    #[test]
    fn a_layouts_words_give_the_lean_of_its_patches() {
        let layout = Manifest::from_toml(CHECKER, "")
            .unwrap()
            .sample
            .layout
            .unwrap();
        assert!(layout.lean_azimuth(false).deg().abs() < 1e-12);
        assert!((layout.lean_azimuth(true).deg() - 90.0).abs() < 1e-12);
        assert_eq!(degrees_after_phi_s("v at phi_s - 45.5 deg"), Some(-45.5));
        assert_eq!(degrees_after_phi_s("anywhere"), None);
    }

    #[test]
    fn values_of_a_camera_that_do_not_fit_each_other_are_named() {
        let camera = Manifest::from_toml(STEEL, "").unwrap().camera;
        assert_eq!(camera.contradiction(), None);
        let with = |change: fn(&mut CameraFacts)| {
            let mut camera = camera.clone();
            change(&mut camera);
            camera
                .contradiction()
                .map(|wrong| (wrong.key, wrong.allowed))
        };
        let (key, allowed) = with(|c| c.saturation_dn = Some(65535.0)).unwrap();
        assert_eq!(key, "saturation_dn");
        assert!(
            allowed.contains("4095") && allowed.contains("bit_depth = 12"),
            "{allowed}"
        );
        let (key, allowed) = with(|c| c.black_level_dn = Some(4095.0)).unwrap();
        assert_eq!((key, allowed.contains("4095")), ("black_level_dn", true));
        let (key, _) = with(|c| c.read_noise_electrons_rms = Some(60000.0)).unwrap();
        assert_eq!(key, "read_noise_electrons_rms");
        // A converter of more bits than are used is none.
        assert_eq!(with(|c| c.bit_depth = Some(16)), None);
        assert_eq!(with(|c| c.bit_depth = None), None);
    }

    #[test]
    fn twelve_bits_saturate_at_4095() {
        let mut manifest = Manifest::from_toml(STEEL, "").unwrap();
        assert!((manifest.saturation_dn() - 4095.0).abs() < 1e-9);
        manifest.camera.saturation_dn = None;
        assert!((manifest.saturation_dn() - 4095.0).abs() < 1e-9);
    }
}
