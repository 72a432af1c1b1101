//! The rows of a problem: residuals of samples, flats and priors, with their derivatives by the free quantities.

use std::f64::consts::PI;

use super::{Problem, Ready};
use crate::fit::least_squares::LeastSquares;
use crate::fit::loss::Loss;
use crate::fit::quantity::{Quantity, Values};
use crate::units::Angle;

impl LeastSquares for &Problem<'_> {
    fn n_parameters(&self) -> usize {
        self.free.len()
    }

    /// Samples first, then flats, then priors.
    fn n_residuals(&self) -> usize {
        self.residual_count()
    }

    fn evaluate(&self, x: &[f64], residuals: &mut [f64], jacobian: &mut [f64]) {
        let values = self.unpack(x);
        let m = self.n_residuals();
        let samples = self.set.observations.len();
        let ready = self.ready(&values);
        let mut row = vec![0.0; self.free.len()];
        for i in 0..samples {
            residuals[i] = self.sample_row(i, &ready, &values, &mut row);
            for (j, d) in row.iter().enumerate() {
                jacobian[i + j * m] = *d;
            }
        }
        self.other_rows(&values, samples, m, residuals, jacobian);
    }
}

impl Problem<'_> {
    /// Returns the residual of prior number `row`, its quantity, and the slope of the residual in the unit of the
    /// solver.
    pub(in crate::fit) fn prior_row(&self, row: usize, values: &Values) -> (f64, Quantity, f64) {
        let (quantity, prior) = self.priors[row];
        let mut away = values.natural(quantity) - prior.mean;
        if quantity == Quantity::AzimuthOffset {
            away = Angle::from_rad(away).wrapped().rad();
        }
        let slope = match quantity {
            Quantity::ThetaR if values.theta_r < 0.0 => -1.0,
            Quantity::AlphaU => values.alpha_u,
            Quantity::AlphaV => values.alpha_v,
            _ => 1.0,
        };
        (away / prior.std, quantity, slope / prior.std)
    }

    /// Returns the residual of observation `index`, and writes its derivatives by the free quantities to `row`.
    pub(in crate::fit) fn sample_row(
        &self,
        index: usize,
        ready: &Ready,
        values: &Values,
        row: &mut [f64],
    ) -> f64 {
        let g = self.corrected(index, ready);
        let l = g.value;
        let (sigma, seen) = (self.sigma[index], self.set.observations[index].signal);
        let weight = 1.0 / sigma;
        let gain = values.scale;
        let residual = (gain * l + values.background - seen) * weight;
        for (d, q) in row.iter_mut().zip(&self.free) {
            *d = weight
                * match q {
                    Quantity::ThetaR => gain * g.theta_r,
                    Quantity::AlphaU => gain * g.alpha_u * values.alpha_u,
                    Quantity::AlphaV => gain * g.alpha_v * values.alpha_v,
                    Quantity::RhoD => gain * g.rho_d,
                    Quantity::Scale => l,
                    Quantity::Background => 1.0,
                    Quantity::Eta => gain * g.eta,
                    Quantity::K => gain * g.k,
                    Quantity::Translucency => gain * g.real.translucency,
                    Quantity::Tail => gain * g.real.tail,
                    Quantity::CrestRadius => gain * g.real.crest,
                    Quantity::Land => gain * g.real.land,
                    Quantity::Wedge => gain * g.wedge,
                    Quantity::LampTurn => gain * g.lamp_turn,
                    Quantity::AzimuthOffset => gain * g.phi_s,
                    Quantity::TiltOffset => gain * g.theta_c,
                };
        }
        if self.loss == Loss::Linear {
            return residual;
        }
        let (bent, slope) = self.loss.bent(residual);
        for d in row {
            *d *= slope;
        }
        bent
    }

    /// Writes residuals and derivatives of flats and priors, starting at row `first` of `m`.
    pub(in crate::fit) fn other_rows(
        &self,
        values: &Values,
        first: usize,
        m: usize,
        residuals: &mut [f64],
        jacobian: &mut [f64],
    ) {
        let flats = self.set.flats.len();
        let albedo = self.reflectance() / PI;
        for k in 0..flats {
            let i = first + k;
            let [cosine, by_tilt, by_lamp] = self.flat_cosine(k, values);
            let weight = 1.0 / self.flat_sigma[k];
            residuals[i] = (values.scale * albedo * cosine + values.background
                - self.set.flats[k].signal)
                * weight;
            for (j, q) in self.free.iter().enumerate() {
                jacobian[i + j * m] = weight
                    * match q {
                        Quantity::Scale => albedo * cosine,
                        Quantity::Background => 1.0,
                        Quantity::TiltOffset => values.scale * albedo * by_tilt,
                        Quantity::LampTurn => values.scale * albedo * by_lamp,
                        _ => 0.0,
                    };
            }
        }
        for row in 0..self.priors.len() {
            let i = first + flats + row;
            let (residual, quantity, slope) = self.prior_row(row, values);
            residuals[i] = residual;
            for (j, q) in self.free.iter().enumerate() {
                jacobian[i + j * m] = if *q == quantity { slope } else { 0.0 };
            }
        }
    }
}
