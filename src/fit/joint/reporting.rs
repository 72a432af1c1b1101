//! Reports on scans that were fitted together: common surface, zeros of each scan, and scatter between the scans.

use nalgebra::DMatrix;

use super::{EACH_ITS_OWN, Joint, JointReport, Scan, ScanReport};
use crate::fit::estimate::Estimate;
use crate::fit::problem::Quantity;
use crate::fit::report::build::{report_with, summary};
use crate::fit::report::{FitReport, Parameter, Parameters, Status, VariantName, VariantSummary};
use crate::fit::uncertainty::budget::{Budget, Part, Uncertainty, of_parts, uncertainty};
use crate::fit::uncertainty::covariance::Covariance;
use crate::model::Variant;
use crate::robust::reduced_chi2_at;

/// Normal quantiles of a scatter that widens the uncertainty (one in a hundred by chance, for each of four parameters),
/// and of one that causes a warning (one in a thousand).
const WIDENS: f64 = 2.326;
const DISAGREES: f64 = 3.09;

impl Joint<'_, '_> {
    /// Reports on all scans together and on each.
    pub(super) fn report(mut self, scans: &[Scan<'_>]) -> JointReport {
        let estimates = self.parts();
        let parts: Vec<Part<'_, '_>> = estimates
            .iter()
            .zip(&self.columns)
            .map(|(estimate, columns)| Part {
                estimate,
                columns: columns.clone(),
            })
            .collect();
        let mut joint = of_parts(&parts, &self.minimum.jacobian, &self.minimum.residuals);
        let singly: Vec<Uncertainty> = self.alone.iter().map(uncertainty).collect();
        let warnings = self.scatter(&mut joint, &singly, scans);
        let name = match estimates[0].problem.variant() {
            Variant::Paper => VariantName::Paper,
            Variant::Sawtooth => VariantName::Sawtooth,
        };
        let reports: Vec<FitReport> = estimates
            .iter()
            .zip(&self.columns)
            .map(|(e, columns)| report_with(e, &seen_by(&joint, columns), name))
            .collect();
        let absolute = scans.iter().position(|s| s.set.white_reference.is_some());
        let common = reports[absolute.unwrap_or(0)].clone();
        let mut top = together(&common, &reports, &estimates);
        top.warnings.extend(warnings);
        for (scan, report) in scans.iter().zip(&reports) {
            let named = report
                .warnings
                .iter()
                .map(|w| format!("{}: {w}", scan.name));
            top.warnings.extend(named);
        }
        let criterion = f64::from(u32::try_from(self.n).unwrap_or(u32::MAX));
        let one = summary(
            &estimates[absolute.unwrap_or(0)],
            name,
            top.status,
            2.0 * criterion,
        );
        top.variants = vec![VariantSummary {
            rms_residual: top.rms_residual.unwrap_or(one.rms_residual),
            chi2_reduced_without_model: top
                .chi2_reduced_without_model
                .unwrap_or(one.chi2_reduced_without_model),
            ..one
        }];
        let scans = scans.iter().zip(reports).zip(self.alone).zip(&singly);
        let scans = scans.map(|(((scan, mut report), alone), u)| {
            surface_of(&common.parameters, &mut report.parameters);
            let j = alone.problem.column(Quantity::ThetaR);
            ScanReport {
                name: scan.name.to_owned(),
                theta_r_alone_deg: j.map(|_| alone.values.folded().theta_r.to_degrees()),
                theta_r_alone_std: j.map(|j| u.budgets[j].combined().to_degrees()),
                report,
            }
        });
        JointReport {
            report: top,
            scans: scans.collect(),
        }
    }

    /// Adds to the line `model` the scatter of the single scans beyond their uncertainties. Returns a warning for each
    /// parameter on which they disagree.
    fn scatter(
        &self,
        joint: &mut Uncertainty,
        singly: &[Uncertainty],
        scans: &[Scan<'_>],
    ) -> Vec<String> {
        let mut warnings = Vec::new();
        for (q, spoken) in [
            (Quantity::ThetaR, "θr"),
            (Quantity::AlphaU, "αu"),
            (Quantity::AlphaV, "αv"),
            (Quantity::RhoD, "ρd"),
        ] {
            let mut column = None;
            let (mut weights, mut seen) = (Vec::new(), Vec::new());
            for ((e, u), columns) in self.alone.iter().zip(singly).zip(&self.columns) {
                let Some(j) = e.problem.column(q) else {
                    continue;
                };
                // Reference, index and stated values are common to all scans and cannot cause differences. The ray tracer
                // is for single scans.
                let own = Budget {
                    reference: 0.0,
                    material: 0.0,
                    prior: 0.0,
                    ..u.budgets[j]
                };
                let variance = own.variance();
                if u.covariance.identifiable[j] && variance.is_finite() && variance > 0.0 {
                    column = Some(columns[j]);
                    weights.push(1.0 / variance);
                    seen.push(e.values.folded().inner(q));
                }
            }
            let (Some(column), true) = (column, seen.len() > 1) else {
                continue;
            };
            let total: f64 = weights.iter().sum();
            let mean = seen.iter().zip(&weights).map(|(x, w)| x * w).sum::<f64>() / total;
            let freedom = (seen.len() - 1) as f64;
            let chi2 = seen
                .iter()
                .zip(&weights)
                .map(|(x, w)| w * (x - mean).powi(2));
            let birge = chi2.sum::<f64>() / freedom;
            if birge > reduced_chi2_at(freedom, WIDENS) {
                let extra = ((birge - 1.0) / total).sqrt();
                let budget = &mut joint.budgets[column];
                budget.model = budget.model.hypot(extra);
            }
            if birge > reduced_chi2_at(freedom, DISAGREES) {
                warnings.push(format!(
                    "The {} scans disagree on {spoken} by {:.1} times their uncertainties. Check that they are of the \
                     same part, and that it lay flat in each: a sample that is tilted on the turntable has another angle \
                     after it is turned.",
                    scans.len(),
                    birge.sqrt()
                ));
            }
        }
        warnings
    }
}

/// Extracts one scan's part of the joint uncertainty.
fn seen_by(joint: &Uncertainty, columns: &[usize]) -> Uncertainty {
    let all = &joint.covariance;
    let null = all.null_directions.iter().filter_map(|direction| {
        let part: Vec<f64> = columns.iter().map(|c| direction[*c]).collect();
        let length = part.iter().map(|p| p * p).sum::<f64>().sqrt();
        (length > 1e-3).then(|| part.iter().map(|p| p / length).collect())
    });
    Uncertainty {
        budgets: columns.iter().map(|c| joint.budgets[*c]).collect(),
        covariance: Covariance {
            matrix: DMatrix::from_fn(columns.len(), columns.len(), |a, b| {
                all.matrix[(columns[a], columns[b])]
            }),
            identifiable: columns.iter().map(|c| all.identifiable[*c]).collect(),
            null_directions: null.collect(),
            singular_values: all.singular_values.clone(),
            degrees_of_freedom: all.degrees_of_freedom,
            chi2_reduced: all.chi2_reduced,
        },
        propagated: DMatrix::from_fn(columns.len(), columns.len(), |a, b| {
            joint.propagated[(columns[a], columns[b])]
        }),
        model_freedom: joint.model_freedom,
    }
}

/// Copies the common surface.
fn surface_of(from: &Parameters, to: &mut Parameters) {
    to.theta_r_deg = from.theta_r_deg.clone();
    to.alpha_u = from.alpha_u.clone();
    to.alpha_v = from.alpha_v.clone();
    to.rho_d = from.rho_d.clone();
}

/// Reports on the common surface.
fn together(common: &FitReport, reports: &[FitReport], estimates: &[Estimate<'_>]) -> FitReport {
    let own = || Parameter::unknown(EACH_ITS_OWN);
    let count = |r: &FitReport| r.n_observations as f64;
    let total: f64 = reports.iter().map(count).sum();
    let mean = |of: &dyn Fn(&FitReport) -> Option<f64>| -> Option<f64> {
        let sum: f64 = (reports.iter().map(|r| of(r).map(|x| x * count(r)))).sum::<Option<_>>()?;
        Some(sum / total)
    };
    let worst = reports
        .iter()
        .map(|r| r.status)
        .find(|s| *s != common.status);
    FitReport {
        status: worst
            .filter(|_| common.status == Status::Converged)
            .unwrap_or(common.status),
        n_observations: reports.iter().map(|r| r.n_observations).sum(),
        n_frames_used: reports.iter().map(|r| r.n_frames_used).sum(),
        region: None,
        covariance: None,
        wedge_across: None,
        parameters: Parameters {
            scale: own(),
            background: own(),
            azimuth_offset_deg: own(),
            tilt_offset_deg: own(),
            ..common.parameters.clone()
        },
        rms_residual: mean(&|r| r.rms_residual.map(|x| x * x)).map(f64::sqrt),
        model_discrepancy: Some(estimates.iter().map(|e| e.discrepancy).fold(0.0, f64::max) * 1.1),
        chi2_reduced_without_model: mean(&|r| r.chi2_reduced_without_model),
        rejected_frames: reports
            .iter()
            .flat_map(|r| r.rejected_frames.clone())
            .collect(),
        warnings: Vec::new(),
        variants: Vec::new(),
        fitted: Vec::new(),
        ..common.clone()
    }
}
