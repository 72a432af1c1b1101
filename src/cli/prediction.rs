//! Options that all predictions share: rig and surface ([`Scene`]), and how radiances are computed ([`Model`]).
//! `contrast`, `optimize`, `render` and `wear` use them, so that an option means the same in all.

use anyhow::anyhow;
use clap::ValueEnum;

use super::CliError;
use crate::geometry::{Cones, RigGeometry};
use crate::limits::{self, Limit};
use crate::material::tables;
use crate::model::contrast::{PAPER_TILTS_DEG, Tier};
use crate::model::{LeftOut, Optics, Surface, Variant, domain, left_out};
use crate::units::Angle;
use crate::wording::percent;

/// A rig and a surface given by options; the defaults are the paper's rig with narrow lobes.
#[derive(Debug, Clone, clap::Args)]
pub struct Scene {
    /// Camera tilts.
    #[arg(long, num_args = 1.., value_delimiter = ',', value_name = "DEG", allow_negative_numbers = true,
          default_values_t = PAPER_TILTS_DEG)]
    pub theta_c_deg: Vec<f64>,
    /// Roughness along and across the ridges.
    #[arg(long, default_value_t = 0.05)]
    pub alpha: f64,
    /// Roughness along the ridges, if it differs.
    #[arg(long)]
    pub alpha_u: Option<f64>,
    /// Roughness across the ridges, if it differs.
    #[arg(long)]
    pub alpha_v: Option<f64>,
    /// Diffuse reflectance [default: 0.35, and 0 of a metal].
    #[arg(long)]
    pub rho_d: Option<f64>,
    /// Real part of the index.
    #[arg(long, default_value_t = 1.54)]
    pub eta: f64,
    /// Imaginary part of the index.
    #[arg(long, default_value_t = 0.0)]
    pub k: f64,
    /// A metal of the tables (Ag, Al, Au, Cr, Cu, W) instead of an index.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["eta", "k"])]
    pub metal: Option<String>,
    /// Wavelength at which the metal is looked up.
    #[arg(long, value_name = "NM", default_value_t = 550.0, requires = "metal")]
    pub wavelength_nm: f64,
    /// Angle between lamp and camera.
    #[arg(long, default_value_t = 10.0, value_name = "DEG")]
    pub theta_l_deg: f64,
    /// Azimuth of the lamp about the camera: 0 in the tilt plane, 90 beside it.
    #[arg(
        long,
        default_value_t = 90.0,
        value_name = "DEG",
        allow_negative_numbers = true
    )]
    pub light_azimuth_deg: f64,
    /// Azimuth of the lean direction at the recorded azimuth 0.
    #[arg(
        long,
        default_value_t = 90.0,
        value_name = "DEG",
        allow_negative_numbers = true
    )]
    pub azimuth_zero_deg: f64,
    /// Angular radius of the lamp.
    #[arg(long, default_value_t = 1.0, value_name = "DEG")]
    pub light_angular_radius_deg: f64,
    /// Angular radius of the lens's pupil, seen from the sample; 0 for a point.
    #[arg(long, default_value_t = 0.0, value_name = "DEG")]
    pub lens_angular_radius_deg: f64,
}

/// Tiers by the names of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Model {
    /// The BRDF as printed.
    Paper,
    /// The sawtooth's closed form.
    Sawtooth,
    /// Two bounces integrated.
    Quadrature,
}

impl Model {
    /// Returns the tier.
    #[must_use]
    pub fn tier(self) -> Tier {
        match self {
            Model::Paper => Tier::Closed(Variant::Paper),
            Model::Sawtooth => Tier::Closed(Variant::Sawtooth),
            Model::Quadrature => Tier::Quadrature,
        }
    }

    /// Effects that its radiances omit on a rig with these cones, where `alpha` is the smaller roughness; `apart` is their
    /// difference from radiances with two integrated bounces, as a share of the brightest.
    #[must_use]
    pub fn left_out(
        self,
        cones: &Cones,
        alpha: f64,
        metal: bool,
        apart: Option<f64>,
    ) -> Vec<LeftOut> {
        let of = |variant| left_out::of_closed_form(variant, cones, alpha);
        let mut list = match self {
            Model::Paper => {
                let mut list = of(Variant::Paper);
                list.pop();
                list.push(left_out::printed_lobe(apart));
                list
            }
            Model::Sawtooth => {
                let mut list = of(Variant::Sawtooth);
                list.push(left_out::two_bounce_quadrature(apart));
                list
            }
            // This tier averages over the cones.
            Model::Quadrature => {
                let mut list: Vec<LeftOut> = left_out::lens(cones).into_iter().collect();
                list.extend([left_out::ideal_profile(), left_out::third_bounce()]);
                list
            }
        };
        if !metal && self != Model::Paper {
            list.push(left_out::polarisation(
                "on plastic, predictions multiply unpolarised reflectances where light bounces twice; single reflections do not \
                depend on it",
            ));
        }
        list
    }

    /// Its name in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Model::Paper => "paper",
            Model::Sawtooth => "sawtooth",
            Model::Quadrature => "quadrature",
        }
    }
}

impl Scene {
    /// Checks the numbers, and that ridges of `theta_r_deg` (degrees) have a radiance with them. Returns rig, optics and
    /// surface (with ridge angle 0).
    ///
    /// # Errors
    /// Bad input, naming the option and its range.
    pub fn build(&self, theta_r_deg: &[f64]) -> Result<(RigGeometry, Optics, Surface), CliError> {
        let alpha_u = self.alpha_u.unwrap_or(self.alpha);
        let alpha_v = self.alpha_v.unwrap_or(self.alpha);
        for (name, own, alpha) in [
            ("alpha_u", self.alpha_u, alpha_u),
            ("alpha_v", self.alpha_v, alpha_v),
        ] {
            let name = own.map_or(limits::ALPHA.name, |_| name);
            check(
                &Limit {
                    name,
                    ..limits::ALPHA
                },
                alpha,
            )?;
        }
        for (limit, value) in [
            (limits::PREDICTED_ETA, self.eta),
            (limits::PREDICTED_K, self.k),
            (limits::PREDICTED_THETA_L_DEG, self.theta_l_deg),
            (limits::LIGHT_AZIMUTH_DEG, self.light_azimuth_deg),
            (limits::AZIMUTH_ZERO_DEG, self.azimuth_zero_deg),
            (
                limits::PREDICTED_LIGHT_ANGULAR_RADIUS_DEG,
                self.light_angular_radius_deg,
            ),
            (
                limits::PREDICTED_LENS_ANGULAR_RADIUS_DEG,
                self.lens_angular_radius_deg,
            ),
        ] {
            check(&limit, value)?;
        }
        for &tilt in &self.theta_c_deg {
            check(&limits::THETA_C_DEG, tilt)?;
        }
        let rig = RigGeometry {
            theta_l: Angle::from_deg(self.theta_l_deg),
            light_azimuth: Angle::from_deg(self.light_azimuth_deg),
            azimuth_zero: Angle::from_deg(self.azimuth_zero_deg),
            cones: Cones {
                lamp: Angle::from_deg(self.light_angular_radius_deg),
                lens: Angle::from_deg(self.lens_angular_radius_deg),
            },
        };
        let (eta, k) = match &self.metal {
            Some(name) => tables::metal(name, self.wavelength_nm)
                .map_err(CliError::bad_input)?
                .index(),
            None => (self.eta, self.k),
        };
        let rho_d = self.rho_d.unwrap_or(if k > 0.0 { 0.0 } else { 0.35 });
        check(&limits::RHO_D, rho_d)?;
        if k > 0.0 && rho_d > 0.0 {
            return Err(CliError::bad_input(anyhow!(
                "--rho-d is light from below the surface, which a metal does not return: leave out --rho-d, or --k"
            )));
        }
        let optics = Optics {
            eta,
            k,
            theta_l: rig.theta_l.rad(),
            cones: rig.cones,
        };
        let surface = Surface {
            theta_r: 0.0,
            alpha_u,
            alpha_v,
            rho_d,
            amplitude: 1.0,
        };
        for &ridge in theta_r_deg {
            check(&limits::THETA_R_DEG, ridge)?;
            let theta_r = ridge.to_radians();
            domain::check(&Surface { theta_r, ..surface }, &optics).map_err(CliError::bad_input)?;
        }
        Ok((rig, optics, surface))
    }
}

/// Least share of the brightest radiance that text mentions as the cost of an omission.
const MUCH_LEFT_OUT: f64 = 0.01;

/// Returns a line for each omission whose stated cost is above 1 % of the brightest radiance.
#[must_use]
pub fn costly_omissions(left_out: &[LeftOut]) -> String {
    let line = |left: &LeftOut| {
        let cost = left.cost.filter(|cost| *cost > MUCH_LEFT_OUT)?;
        Some(format!(
            "left out: {} (effect ≤ {} of the brightest radiance): {}\n",
            left.what,
            percent(cost),
            left.why
        ))
    };
    left_out.iter().filter_map(line).collect()
}

/// Refuses a number outside the limit of its option.
fn check(limit: &Limit, value: f64) -> Result<(), CliError> {
    let Limit { low, high, .. } = limit;
    if limit.holds(value) {
        return Ok(());
    }
    let option = limit.name.replace('_', "-");
    Err(CliError::bad_input(anyhow!(
        "--{option} {value} is out of range: expected {low} to {high}"
    )))
}
