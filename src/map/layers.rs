//! The results per pixel: parameters with standard uncertainties, quality, flags.

use serde::{Deserialize, Serialize};

use super::solve::kernel::{FREE, packed};
use super::solve::{End, PixelFit};
use crate::units::Angle;

/// The descent did not end at a minimum.
pub const NOT_CONVERGED: u8 = 1;
/// A parameter ended on its bound.
pub const AT_BOUND: u8 = 2;
/// The data do not determine the parameters: no lobe, or too large an uncertainty.
pub const NOT_IDENTIFIABLE: u8 = 4;
/// χ² is far above the usual: no single ridged surface explains the pixel.
pub const MISFIT: u8 = 8;
/// Too few observations remain after masking.
pub const FEW_OBSERVATIONS: u8 = 16;
/// Some observations were masked: saturated, defective, or outside the field.
pub const PARTLY_MASKED: u8 = 32;
/// Within two pixels of another lean direction or of the sample's edge.
pub const BORDER: u8 = 64;
/// Belongs to a defect of the defect list.
pub const DEFECT: u8 = 128;

/// Flags with which a pixel has no value.
pub const NO_VALUE: u8 = NOT_CONVERGED | NOT_IDENTIFIABLE | FEW_OBSERVATIONS;

/// Names of the flags, lowest bit first.
pub const FLAG_NAMES: [&str; 8] = [
    "not_converged",
    "at_bound",
    "not_identifiable",
    "misfit",
    "few_observations",
    "partly_masked",
    "border",
    "defect",
];

/// Returns the names of the flags with the bit of each.
pub fn flag_bits() -> impl Iterator<Item = (&'static str, u8)> {
    FLAG_NAMES
        .iter()
        .enumerate()
        .map(|(n, name)| (*name, 1 << n))
}

/// One quantity over the map.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Stem of the file name, with the unit: `theta_r_deg`.
    pub name: &'static str,
    /// Title of the picture.
    pub title: &'static str,
    /// Unit in the picture; empty for pure numbers.
    pub unit: &'static str,
    /// Row by row from the top left; NaN if there is no value.
    pub values: Vec<f32>,
    /// Standard uncertainties from the pixel's own noise, scaled by the usual χ².
    pub std: Vec<f32>,
    /// Whether the quantity is a direction in (−180°, 180°]: −179.9° and 180° are neighbours.
    pub cyclic: bool,
}

/// All layers, flags and χ².
#[derive(Debug, Clone)]
pub struct Layers {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// θr, lean direction, αu, αv, and ρd or amplitude.
    pub parameters: [Layer; FREE],
    /// χ² per degree of freedom; NaN if the pixel was not fitted.
    pub chi2_reduced: Vec<f32>,
    /// Bits; see [`FLAG_NAMES`].
    pub flags: Vec<u8>,
    /// Observations used.
    pub n_observations: Vec<u32>,
}

impl Layers {
    pub(super) fn new(width: usize, height: usize, amplitude: bool) -> Self {
        let n = width * height;
        let layer = |name, title, unit, cyclic| Layer {
            name,
            title,
            unit,
            values: vec![f32::NAN; n],
            std: vec![f32::NAN; n],
            cyclic,
        };
        Layers {
            width,
            height,
            parameters: [
                layer("theta_r_deg", "ridge angle", "°", false),
                layer("lean_azimuth_deg", "lean direction", "°", true),
                layer("alpha_u", "roughness along the ridges", "", false),
                layer("alpha_v", "roughness across the ridges", "", false),
                if amplitude {
                    layer("amplitude", "amplitude", "", false)
                } else {
                    layer("rho_d", "diffuse reflectance", "", false)
                },
            ],
            chi2_reduced: vec![f32::NAN; n],
            flags: vec![FEW_OBSERVATIONS; n],
            n_observations: vec![0; n],
        }
    }

    /// Removes the diffuse reflectance, for data that do not determine it.
    pub(super) fn without_rho_d(&mut self) {
        for layer in self.parameters.iter_mut().filter(|l| l.name == "rho_d") {
            layer.values.fill(f32::NAN);
            layer.std.fill(f32::NAN);
        }
    }

    /// Whether a pixel has values.
    #[must_use]
    pub fn has_value(&self, pixel: usize) -> bool {
        self.flags[pixel] & NO_VALUE == 0
    }

    pub(super) fn put(&mut self, pixel: usize, answer: &Answer) {
        self.flags[pixel] = answer.flags;
        self.n_observations[pixel] = u32::try_from(answer.n_used).unwrap_or(u32::MAX);
        self.chi2_reduced[pixel] = answer.chi2_reduced;
        for (k, layer) in self.parameters.iter_mut().enumerate() {
            layer.values[pixel] = answer.values[k];
            layer.std[pixel] = answer.std[k];
        }
    }

    /// Returns the entry of a pixel as it was put.
    pub(super) fn get(&self, pixel: usize) -> Answer {
        let of = |values: fn(&Layer) -> &[f32]| {
            std::array::from_fn(|k| values(&self.parameters[k])[pixel])
        };
        Answer {
            values: of(|layer| &layer.values),
            std: of(|layer| &layer.std),
            chi2_reduced: self.chi2_reduced[pixel],
            n_used: self.n_observations[pixel] as usize,
            flags: self.flags[pixel],
        }
    }
}

/// One pixel's entry in the layers.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct Answer {
    values: [f32; FREE],
    std: [f32; FREE],
    chi2_reduced: f32,
    n_used: usize,
    pub(super) flags: u8,
}

impl Answer {
    /// A pixel without a fit, with the reason as flags.
    pub(super) fn none(flags: u8, n_used: usize) -> Answer {
        Answer {
            values: [f32::NAN; FREE],
            std: [f32::NAN; FREE],
            chi2_reduced: f32::NAN,
            n_used,
            flags,
        }
    }

    /// Converts a fit to the layers' units. `birge` is the usual χ² per degree of freedom, `observations` the number
    /// that a pixel without masks has.
    pub(super) fn of(fit: &PixelFit, birge: f64, observations: usize, amplitude: bool) -> Answer {
        let used = fit.n_used;
        if fit.end == End::TooFew {
            return Answer::none(FEW_OBSERVATIONS, used);
        }
        let freedom = super::run::freedom(fit);
        let reduced = fit.chi2 / freedom;
        let mut flags = 0;
        if fit.end != End::Converged || !fit.p.iter().all(|x| x.is_finite()) {
            flags |= NOT_CONVERGED;
        }
        if used < observations {
            flags |= PARTLY_MASKED;
        }
        let usual = birge * super::run::usual_chi2_max(freedom);
        // A fit that is worse than usual is scaled by its own χ².
        let scale = if reduced > usual {
            flags |= MISFIT;
            reduced
        } else {
            birge
        };
        if fit.at_bound(amplitude) {
            flags |= AT_BOUND;
        }
        let lobe_at_bound = fit.p[2] > -1e-6 || fit.p[3] > -1e-6;
        if lobe_at_bound || !fit.is_identifiable(scale) {
            flags |= NOT_IDENTIFIABLE;
        }
        let mut answer = Answer::none(flags, used);
        answer.chi2_reduced = reduced as f32;
        if flags & NO_VALUE != 0 {
            return answer;
        }
        let Some(covariance) = &fit.covariance else {
            return answer;
        };
        let std: [f64; FREE] =
            std::array::from_fn(|k| (scale * covariance[packed(k, k)]).max(0.0).sqrt());
        let (au, av) = (fit.p[2].exp(), fit.p[3].exp());
        let lean = Angle::from_rad(fit.p[1]).wrapped().deg();
        answer.values = [fit.p[0].to_degrees(), lean, au, av, fit.p[4]].map(|x| x as f32);
        answer.std = [
            std[0].to_degrees(),
            std[1].to_degrees(),
            au * std[2],
            av * std[3],
            std[4],
        ]
        .map(|x| x as f32);
        // −180 + 1e-9 rounds to −180 as an f32.
        if answer.values[1] <= -180.0 {
            answer.values[1] = 180.0;
        }
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_has_its_own_bit_under_its_name() {
        let bit = |wanted: &str| flag_bits().find(|(name, _)| *name == wanted).map(|f| f.1);
        for (name, value) in [
            ("not_converged", NOT_CONVERGED),
            ("at_bound", AT_BOUND),
            ("not_identifiable", NOT_IDENTIFIABLE),
            ("misfit", MISFIT),
            ("few_observations", FEW_OBSERVATIONS),
            ("partly_masked", PARTLY_MASKED),
            ("border", BORDER),
            ("defect", DEFECT),
        ] {
            assert_eq!(bit(name), Some(value), "{name}");
        }
        assert_eq!(flag_bits().map(|f| f.1).fold(0, |all, bit| all | bit), 255);
    }
}
