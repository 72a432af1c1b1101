//! Curves of a fit over φs, to draw through its points.
//!
//! A curve is the closed form at the fitted parameters. The fit's corrections are computed only at the observed poses;
//! they are interpolated linearly over φs, so that the curve passes through the fitted values exactly.

use crate::fit::FitReport;
use crate::fit::report::{FittedObservation, VariantName};
use crate::geometry::{Pose, RigGeometry};
use crate::model::{self, Optics, Surface, Variant};
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Predicted signal over φs at one tilt.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
#[schema(as = CurveBody)]
pub struct Curve {
    /// Variant of the model.
    #[schema(value_type = VariantName)]
    pub variant: String,
    /// Camera tilt θc as recorded, degrees.
    pub theta_c_deg: f64,
    /// Sample azimuths φs as recorded, degrees.
    pub phi_s_deg: Vec<f64>,
    /// Predicted signals at these azimuths, in the observations' unit of radiance.
    pub signal: Vec<f64>,
}

/// A fit with its observations.
#[derive(Debug, Clone, PartialEq)]
pub struct FitCurves {
    /// Largest observation.
    pub peak: f64,
    /// Observed and fitted.
    pub observations: Vec<FittedObservation>,
    /// One per tilt.
    pub curves: Vec<Curve>,
}

/// Tilts closer than this are the same: positions of one tilt differ slightly.
const SAME_TILT_DEG: f64 = 0.25;

/// Returns curves over a full turn in steps of `step_deg`, one per tilt of the observations.
pub(in crate::lab) fn curves_of(
    report: &FitReport,
    set: &ObservationSet,
    step_deg: f64,
) -> FitCurves {
    let form = ClosedForm::new(report, set);
    let steps = (360.0 / step_deg).round().max(1.0) as usize;
    let phi_s_deg: Vec<f64> = (0..=steps)
        .map(|i| 360.0 * i as f64 / steps as f64)
        .collect();
    let curves = tilts(&report.fitted)
        .into_iter()
        .map(|theta_c_deg| {
            let mut added: Vec<(f64, f64)> = report
                .fitted
                .iter()
                .filter(|o| (o.theta_c_deg - theta_c_deg).abs() < SAME_TILT_DEG)
                .map(|o| {
                    let closed = form.signal(Pose::from_deg(o.theta_c_deg, o.phi_s_deg));
                    (o.phi_s_deg.rem_euclid(360.0), o.fitted - closed)
                })
                .collect();
            added.sort_by(|a, b| a.0.total_cmp(&b.0));
            let signal = phi_s_deg
                .iter()
                .map(|phi| form.signal(Pose::from_deg(theta_c_deg, *phi)) + periodic(&added, *phi))
                .collect();
            Curve {
                variant: report.variant.to_string(),
                theta_c_deg,
                phi_s_deg: phi_s_deg.clone(),
                signal,
            }
        })
        .collect();
    FitCurves {
        peak: report.fitted.iter().map(|o| o.signal).fold(0.0, f64::max),
        observations: report.fitted.clone(),
        curves,
    }
}

fn tilts(fitted: &[FittedObservation]) -> Vec<f64> {
    let mut tilts: Vec<f64> = Vec::new();
    for observation in fitted {
        let tilt = observation.theta_c_deg;
        if !tilts.iter().any(|t| (t - tilt).abs() < SAME_TILT_DEG) {
            tilts.push(tilt);
        }
    }
    tilts.sort_by(f64::total_cmp);
    tilts
}

/// The closed form at the fitted parameters, in the observations' unit.
struct ClosedForm {
    variant: Variant,
    rig: RigGeometry,
    surface: Surface,
    optics: Optics,
    scale: f64,
    background: f64,
    /// Offsets to add to recorded angles.
    tilt: Angle,
    azimuth: Angle,
}

impl ClosedForm {
    fn new(report: &FitReport, set: &ObservationSet) -> Self {
        let p = &report.parameters;
        let value = |parameter: &crate::fit::report::Parameter| parameter.value.unwrap_or(0.0);
        ClosedForm {
            variant: match report.variant {
                VariantName::Paper => Variant::Paper,
                VariantName::Sawtooth | VariantName::Traced => Variant::Sawtooth,
            },
            rig: set.rig,
            surface: Surface {
                theta_r: value(&p.theta_r_deg).to_radians(),
                // An undetermined parameter: the curve uses a typical value.
                alpha_u: p.alpha_u.value.unwrap_or(0.1),
                alpha_v: p.alpha_v.value.unwrap_or(0.1),
                rho_d: value(&p.rho_d),
                amplitude: 1.0,
            },
            optics: Optics::new(&set.rig, &set.material),
            scale: p.scale.value.unwrap_or(1.0),
            background: value(&p.background),
            tilt: Angle::from_deg(value(&p.tilt_offset_deg)),
            azimuth: Angle::from_deg(value(&p.azimuth_offset_deg)) + set.region_azimuth,
        }
    }

    fn signal(&self, recorded: Pose) -> f64 {
        let pose = Pose {
            theta_c: recorded.theta_c + self.tilt,
            phi_s: recorded.phi_s + self.azimuth,
        };
        let directions = self.rig.directions(pose);
        let radiance = model::radiance(self.variant, &directions, &self.surface, &self.optics);
        self.scale * radiance + self.background
    }
}

/// Linear interpolation of `points` (degrees within a turn, ascending) around the circle.
fn periodic(points: &[(f64, f64)], phi_deg: f64) -> f64 {
    let (Some(first), Some(last)) = (points.first(), points.last()) else {
        return 0.0;
    };
    let phi = phi_deg.rem_euclid(360.0);
    let after = points.iter().position(|p| p.0 >= phi);
    let (left, right) = match after {
        Some(0) => ((last.0 - 360.0, last.1), *first),
        Some(i) => (points[i - 1], points[i]),
        None => (*last, (first.0 + 360.0, first.1)),
    };
    let width = right.0 - left.0;
    if width < 1e-9 {
        return right.1;
    }
    left.1 + (right.1 - left.1) * (phi - left.0) / width
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpolation_passes_through_its_points_and_wraps_around_the_circle() {
        let points = [(10.0, 1.0), (100.0, 4.0), (350.0, 3.0)];
        for (phi, value) in points {
            assert!((periodic(&points, phi) - value).abs() < 1e-12);
        }
        // Halfway between 350 and 370.
        assert!((periodic(&points, 0.0) - 2.0).abs() < 1e-12);
        assert!((periodic(&points, 360.0) - 2.0).abs() < 1e-12);
        assert_eq!(periodic(&[], 5.0), 0.0);
        assert_eq!(periodic(&[(30.0, 7.0)], 200.0), 7.0);
    }
}
