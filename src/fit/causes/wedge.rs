//! Interprets an unexpected azimuth as a tilt of the sample on the turntable.
//!
//! The mean plane of the sample is tilted to the turntable by a wedge that turns with it: w_v along the lean direction
//! v, and w_u across it, towards rising azimuth. A fit assumes ridges on the turntable. To first order
//!
//! ```text
//! θr (turntable) = θr (sample) + w_v          azimuth = w_u / tan θr + z
//! ```
//!
//! where z is the error of the azimuth's zero: the rotation of the sample, or of the stage's zero, from the recorded
//! value. So w_v cannot be separated from the ridge angle, and a small w_u shows only in the azimuth ([`across`]). If the
//! zero is stated with an uncertainty, the azimuth is divided between the two, both expected at 0, in proportion to their
//! variances. A wedge without a stated uncertainty takes all of it. A larger w_u also turns the axes of an anisotropic
//! roughness against the facets. If that explains a residual, w_u joins the fit ([`super::suspects`]) and the data divide
//! the azimuth ([`fitted`]).

use serde::{Deserialize, Serialize};

use crate::observation::ObservationSet;
use crate::units::Angle;

/// Largest tilt of a sample on the turntable that a person overlooks, degrees.
const MOUNTED_DEG: f64 = 5.0;

/// The plane that angles refer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = FitReferencePlane)]
pub enum ReferencePlane {
    /// The turntable. The tilt of the sample on it is unknown and is part of the angles.
    #[default]
    Turntable,
    /// The mean plane of the sample. The uncertainty of its tilt on the turntable is stated and included.
    Sample,
}

impl ReferencePlane {
    /// All planes.
    pub const ALL: [ReferencePlane; 2] = [ReferencePlane::Turntable, ReferencePlane::Sample];
}

impl std::fmt::Display for ReferencePlane {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            ReferencePlane::Turntable => "turntable",
            ReferencePlane::Sample => "sample",
        })
    }
}

/// Stated standard uncertainties of how samples are mounted; `None` if not stated.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stated {
    /// Of the azimuth's zero.
    pub azimuth_zero: Option<Angle>,
    /// Of the tilt of the sample, along any direction.
    pub wedge: Option<Angle>,
}

/// Azimuth of the facets from the stage's zero, and its possible causes; degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitAcross)]
pub struct Across {
    /// Azimuth of the facets relative to the recorded φs and the stated zero.
    pub azimuth_deg: f64,
    /// Its standard uncertainty from the data, without a stated wedge.
    pub azimuth_std_deg: f64,
    /// Whether wedge and zero are separated: by a fit that contains the wedge, or because the zero is stated with an
    /// uncertainty. Otherwise each of the next two is the whole azimuth: the one *or* the other.
    pub split: bool,
    /// Tilt of the sample across v, towards rising azimuth.
    pub wedge_deg: f64,
    /// Its standard uncertainty; none if it is not separated from the zero.
    pub wedge_std_deg: Option<f64>,
    /// Error of the azimuth's zero: what to add to it.
    pub azimuth_zero_deg: f64,
    /// Its standard uncertainty; none if it is not separated from the wedge.
    pub azimuth_zero_std_deg: Option<f64>,
}

impl Across {
    /// Whether the azimuth differs from zero by more than its expanded uncertainty.
    #[must_use]
    pub fn is_significant(&self) -> bool {
        self.azimuth_deg.abs() > 2.0 * self.azimuth_std_deg
    }

    /// Whether the sample is significantly tilted across v: by more than the expanded uncertainty, and separately from
    /// the zero.
    #[must_use]
    pub fn is_wedge(&self) -> bool {
        self.wedge_std_deg
            .is_some_and(|std| self.wedge_deg.abs() > 2.0 * std)
    }

    /// Describes it in a sentence; none if the azimuth is as expected.
    #[must_use]
    pub fn message(&self) -> Option<String> {
        if !self.is_significant() {
            return None;
        }
        let azimuth = format!(
            "The azimuth of the facets is {}° from the stage's zero",
            signed(self.azimuth_deg)
        );
        Some(match (self.wedge_std_deg, self.azimuth_zero_std_deg) {
            (Some(wedge), Some(zero)) => format!(
                "{azimuth}: {} ± {}° of sample tilt across the ridges and {} ± {}° of the zero (k = 2).",
                signed(self.wedge_deg),
                short(2.0 * wedge),
                signed(self.azimuth_zero_deg),
                short(2.0 * zero),
            ),
            _ if self.wedge_deg.abs() > MOUNTED_DEG => format!(
                "{azimuth}, too much for a tilt of the sample: the ridges lie so on the turntable, or \
                 rig.azimuth_zero_deg is off by as much. Check both."
            ),
            _ => format!(
                "{azimuth}: either {}° of sample tilt across the ridges, or an error of the zero. Set \
                 rig.azimuth_zero_std_deg to separate them.",
                signed(self.wedge_deg)
            ),
        })
    }
}

/// Returns the plane that the angles of a fit refer to.
#[must_use]
pub fn plane(set: &ObservationSet) -> ReferencePlane {
    match set.wedge_std {
        Some(_) => ReferencePlane::Sample,
        None => ReferencePlane::Turntable,
    }
}

fn signed(deg: f64) -> String {
    let text = short(deg.abs());
    match deg < 0.0 {
        true => format!("−{text}"),
        false => text,
    }
}

/// Formats with hundredths of a degree, or two digits below.
fn short(deg: f64) -> String {
    match deg {
        0.095.. => format!("{deg:.2}"),
        0.0095.. => format!("{deg:.3}"),
        _ => format!("{deg:.4}"),
    }
}

/// Interprets the azimuth of ridges, at the angle `theta_r` to the turntable, as a wedge across v and an error of the
/// azimuth's zero. `azimuth_std` is the standard uncertainty of the azimuth without either. Returns `None` for flat
/// ridges, whose azimuth any wedge explains, and for values that are not finite.
#[must_use]
pub fn across(
    theta_r: Angle,
    azimuth: Angle,
    azimuth_std: Angle,
    stated: Stated,
) -> Option<Across> {
    let slope = theta_r.rad().tan();
    let (azimuth, std) = (azimuth.deg(), azimuth_std.deg());
    if !(slope > 0.0 && azimuth.is_finite() && std.is_finite()) {
        return None;
    }
    let alone = Across {
        azimuth_deg: azimuth,
        azimuth_std_deg: std,
        split: false,
        wedge_deg: azimuth * slope,
        wedge_std_deg: None,
        azimuth_zero_deg: azimuth,
        azimuth_zero_std_deg: None,
    };
    let Some(zero) = stated.azimuth_zero else {
        return Some(alone);
    };
    // In azimuth: z ~ N(0, zero²), w/tan θr ~ N(0, wedge²); their sum is observed with its own uncertainty.
    let zero = zero.deg().powi(2);
    let own = std * std;
    let Some(wedge) = stated.wedge.map(|w| (w.deg() / slope).powi(2)) else {
        return Some(Across {
            split: true,
            wedge_std_deg: Some((zero + own).sqrt() * slope),
            azimuth_zero_deg: 0.0,
            azimuth_zero_std_deg: Some(zero.sqrt()),
            ..alone
        });
    };
    let all = wedge + zero + own;
    // Both are stated as exactly 0: the azimuth is scatter.
    let share = |variance: f64| if all > 0.0 { variance / all } else { 0.0 };
    let left = |variance: f64| (variance * (1.0 - share(variance))).max(0.0).sqrt();
    Some(Across {
        split: true,
        wedge_deg: azimuth * share(wedge) * slope,
        wedge_std_deg: Some(left(wedge) * slope),
        azimuth_zero_deg: azimuth * share(zero),
        azimuth_zero_std_deg: Some(left(zero)),
        ..alone
    })
}

/// Returns the parts of the azimuth that a fit with a free wedge found, each with its standard uncertainty. `common` is
/// their covariance, rad².
pub(in crate::fit) fn fitted(
    theta_r: Angle,
    zero: (Angle, Angle),
    wedge: (Angle, Angle),
    common: f64,
) -> Across {
    let slope = theta_r.rad().tan();
    let ((zero, zero_std), (wedge, wedge_std)) = (zero, wedge);
    let variance =
        zero_std.rad().powi(2) + (wedge_std.rad() / slope).powi(2) + 2.0 * common / slope;
    Across {
        azimuth_deg: zero.deg() + wedge.deg() / slope,
        azimuth_std_deg: variance.max(0.0).sqrt().to_degrees(),
        split: true,
        wedge_deg: wedge.deg(),
        wedge_std_deg: Some(wedge_std.deg()),
        azimuth_zero_deg: zero.deg(),
        azimuth_zero_std_deg: Some(zero_std.deg()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(azimuth: f64, std: f64, zero: Option<f64>, wedge: Option<f64>) -> Across {
        let stated = Stated {
            azimuth_zero: zero.map(Angle::from_deg),
            wedge: wedge.map(Angle::from_deg),
        };
        let [theta_r, azimuth, std] = [8.812, azimuth, std].map(Angle::from_deg);
        across(theta_r, azimuth, std, stated).unwrap()
    }

    #[test]
    fn without_a_stated_zero_wedge_and_zero_are_not_separated() {
        // A wobble of 0.2° towards 200° has 0.2 sin 200° = −0.0684° across v, which turns 8.812° ridges by −0.441°.
        let found = of(-0.4413, 0.04, None, None);
        assert!((found.wedge_deg + 0.0684).abs() < 1e-4, "{found:?}");
        assert_eq!(found.azimuth_zero_deg, -0.4413);
        assert!(found.is_significant() && !found.is_wedge() && !found.split);
        let text = found.message().unwrap();
        assert!(
            text.contains("−0.44° from the stage's zero")
                && text.contains("either −0.068° of sample tilt"),
            "{text}"
        );
        let text = of(-90.0, 0.04, None, None).message().unwrap();
        assert!(
            text.contains("−90.00°") && text.contains("azimuth_zero_deg"),
            "{text}"
        );
        // A wedge stated without a zero does not separate them.
        assert!(!of(-0.44, 0.04, None, Some(0.1)).split);
        assert_eq!(of(-0.05, 0.04, None, None).message(), None);
    }

    #[test]
    fn with_a_stated_zero_the_wedge_takes_the_rest() {
        let found = of(-0.4413, 0.04, Some(0.1), None);
        assert!(found.is_wedge() && found.split);
        assert_eq!(found.azimuth_zero_deg, 0.0);
        // 0.1° of the zero and 0.04° of the fit, times tan θr.
        let std = found.wedge_std_deg.unwrap();
        assert!((std - 0.1077 * 0.155).abs() < 1e-4, "{std}");
        // An azimuth within the uncertainty of the zero is not a wedge.
        assert!(!of(-0.4413, 0.04, Some(0.3), None).is_wedge());
        let text = found.message().unwrap();
        assert!(text.contains("−0.068 ± 0.033° of sample tilt"), "{text}");
    }

    #[test]
    fn two_stated_uncertainties_share_the_azimuth_by_variance() {
        let slope = 8.812_f64.to_radians().tan();
        let found = of(0.6, 0.0, Some(0.1), Some(0.1 * slope));
        assert!((found.azimuth_zero_deg - 0.3).abs() < 1e-12, "{found:?}");
        assert!((found.wedge_deg - 0.3 * slope).abs() < 1e-12);
        // Their sum is known exactly, so each is uncertain by 0.1°/√2.
        let zero = found.azimuth_zero_std_deg.unwrap();
        assert!((zero - 0.1 / 2_f64.sqrt()).abs() < 1e-12);
        assert!((found.wedge_std_deg.unwrap() - zero * slope).abs() < 1e-12);
        let nothing = of(0.6, 0.0, Some(0.0), Some(0.0));
        assert_eq!((nothing.wedge_deg, nothing.azimuth_zero_deg), (0.0, 0.0));
    }

    #[test]
    fn flat_ridges_and_values_that_are_not_finite_give_nothing() {
        let at = |theta_r: f64, azimuth: f64| {
            let [theta_r, azimuth, std] = [theta_r, azimuth, 0.1].map(Angle::from_deg);
            across(theta_r, azimuth, std, Stated::default())
        };
        assert_eq!(at(0.0, 10.0), None);
        assert_eq!(at(f64::NAN, 10.0), None);
        assert_eq!(at(10.0, f64::INFINITY), None);
    }
}
