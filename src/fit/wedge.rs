//! What an azimuth that was not expected says of how the sample lies on the turntable.
//!
//! The sample's mean plane is inclined to the turntable by a wedge that turns with it: w_v along the lean direction v and
//! w_u across it, towards rising azimuth. A fit sees ridges on a turntable, and to first order
//!
//! ```text
//! θr (turntable) = θr (sample) + w_v          azimuth = w_u / tan θr + z
//! ```
//!
//! with z the error of the azimuth's zero: how far the sample, or the stage's zero, is turned from what was recorded. So w_v
//! cannot be told from the ridge angle, and of w_u and z the azimuth alone is told ([`across`]). Where the zero is stated with
//! an uncertainty, the two are split by what is known of each (both expected at 0): a share of the azimuth goes to each in
//! proportion to its variance. A wedge of which nothing is stated takes all of it.

use serde::{Deserialize, Serialize};

use super::budget::Budget;
use super::report::{Parameter, Parameters};
use crate::observation::ObservationSet;
use crate::units::Angle;

/// The plane that angles refer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ReferencePlane {
    /// The turntable's: how the sample lies on it is not known, and is in the angles.
    #[default]
    Turntable,
    /// The sample's mean plane: how well it lies on the turntable is stated, and is in the uncertainty.
    Sample,
}

impl ReferencePlane {
    /// All of them.
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

/// What is known of how samples lie, as standard uncertainties; `None` where nobody states it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stated {
    /// Of the azimuth's zero.
    pub azimuth_zero: Option<Angle>,
    /// Of the sample's inclination, along any direction.
    pub wedge: Option<Angle>,
}

/// The facets' azimuth from the stage's zero, and what it may come from; degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Across {
    /// The facets' azimuth from where the recorded φs and the stated zero have it.
    pub azimuth_deg: f64,
    /// Its standard uncertainty as the data have it, without what is stated of a wedge.
    pub azimuth_std_deg: f64,
    /// Whether wedge and zero are told apart, because the zero is stated with an uncertainty. Else the next two are each the
    /// whole azimuth, the one *or* the other.
    pub split: bool,
    /// Inclination of the sample across v, towards rising azimuth.
    pub wedge_deg: f64,
    /// Its standard uncertainty; none where it is not told from the zero.
    pub wedge_std_deg: Option<f64>,
    /// Error of the azimuth's zero: what to add to it.
    pub azimuth_zero_deg: f64,
    /// Its standard uncertainty; none where it is not told from the wedge.
    pub azimuth_zero_std_deg: Option<f64>,
}

impl Across {
    /// Whether the azimuth differs from zero by more than its expanded uncertainty.
    #[must_use]
    pub fn is_told(&self) -> bool {
        self.azimuth_deg.abs() > 2.0 * self.azimuth_std_deg
    }

    /// Whether the sample is inclined across v for certain: told apart from the zero, by more than its expanded uncertainty.
    #[must_use]
    pub fn is_wedge(&self) -> bool {
        self.wedge_std_deg
            .is_some_and(|std| self.wedge_deg.abs() > 2.0 * std)
    }

    /// In a sentence; none where the azimuth is where it was expected.
    #[must_use]
    pub fn told(&self) -> Option<String> {
        if !self.is_told() {
            return None;
        }
        let azimuth = format!(
            "the facets' azimuth is {}° from the stage's zero",
            signed(self.azimuth_deg)
        );
        Some(match (self.wedge_std_deg, self.azimuth_zero_std_deg) {
            (Some(wedge), Some(zero)) => format!(
                "{azimuth}: a wedge across of {} ± {}° and {} ± {}° of the zero (k = 2), by what is stated of the zero",
                signed(self.wedge_deg),
                short(2.0 * wedge),
                signed(self.azimuth_zero_deg),
                short(2.0 * zero),
            ),
            _ => format!(
                "{azimuth}: a wedge across of {}°, or the zero; state rig.azimuth_zero_std_deg to tell them apart",
                signed(self.wedge_deg)
            ),
        })
    }
}

/// The plane that the angles of a fit refer to.
#[must_use]
pub fn plane(set: &ObservationSet) -> ReferencePlane {
    match set.wedge_std {
        Some(_) => ReferencePlane::Sample,
        None => ReferencePlane::Turntable,
    }
}

/// [`across`] of what a fit found, where it found both angles.
#[must_use]
pub fn of_report(set: &ObservationSet, parameters: &Parameters) -> Option<Across> {
    let angle = |p: &Parameter| p.value.filter(|_| p.identifiable).map(Angle::from_deg);
    let azimuth = &parameters.azimuth_offset_deg;
    let own = Budget {
        wedge: 0.0,
        ..azimuth.budget?
    };
    across(
        angle(&parameters.theta_r_deg)?,
        angle(azimuth)?,
        Angle::from_deg(own.combined()),
        Stated {
            azimuth_zero: set.azimuth_zero_std,
            wedge: set.wedge_std,
        },
    )
}

fn signed(deg: f64) -> String {
    let text = short(deg.abs());
    match deg < 0.0 {
        true => format!("−{text}"),
        false => text,
    }
}

/// Hundredths of a degree, or two digits below.
fn short(deg: f64) -> String {
    match deg {
        0.095.. => format!("{deg:.2}"),
        0.0095.. => format!("{deg:.3}"),
        _ => format!("{deg:.4}"),
    }
}

/// What the azimuth of ridges of an angle to the turntable says of a wedge across v and of the azimuth's zero. `azimuth_std`
/// is the azimuth's standard uncertainty without either. `None` for flat ridges, whose azimuth is any wedge's, and for
/// numbers that are none.
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
    // In azimuth: z ~ N(0, zero²), w/tan θr ~ N(0, wedge²), their sum is observed with its own uncertainty.
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
    // Both known to be nothing: the azimuth is scatter.
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
    fn without_a_stated_zero_it_is_the_one_or_the_other() {
        // A wobble of 0.2° towards 200° has 0.2 sin 200° = −0.0684° across v, which turns 8.812° ridges by −0.441°.
        let told = of(-0.4413, 0.04, None, None);
        assert!((told.wedge_deg + 0.0684).abs() < 1e-4, "{told:?}");
        assert_eq!(told.azimuth_zero_deg, -0.4413);
        assert!(told.is_told() && !told.is_wedge() && !told.split);
        let text = told.told().unwrap();
        assert!(
            text.contains("−0.44° from the stage's zero") && text.contains("−0.068°, or the zero"),
            "{text}"
        );
        // A wedge that is stated without a zero leaves it at that.
        assert!(!of(-0.44, 0.04, None, Some(0.1)).split);
        assert_eq!(of(-0.05, 0.04, None, None).told(), None);
    }

    #[test]
    fn a_stated_zero_leaves_the_rest_to_the_wedge() {
        let told = of(-0.4413, 0.04, Some(0.1), None);
        assert!(told.is_wedge() && told.split);
        assert_eq!(told.azimuth_zero_deg, 0.0);
        // 0.1° of the zero and 0.04° of the fit, times tan θr.
        let std = told.wedge_std_deg.unwrap();
        assert!((std - 0.1077 * 0.155).abs() < 1e-4, "{std}");
        // What the zero explains is no wedge.
        assert!(!of(-0.4413, 0.04, Some(0.3), None).is_wedge());
        let text = told.told().unwrap();
        assert!(text.contains("a wedge across of −0.068 ± 0.033°"), "{text}");
    }

    #[test]
    fn where_both_are_stated_each_has_its_share_of_the_variance() {
        let slope = 8.812_f64.to_radians().tan();
        let told = of(0.6, 0.0, Some(0.1), Some(0.1 * slope));
        assert!((told.azimuth_zero_deg - 0.3).abs() < 1e-12, "{told:?}");
        assert!((told.wedge_deg - 0.3 * slope).abs() < 1e-12);
        // Known together exactly, each is open by 0.1°/√2.
        let zero = told.azimuth_zero_std_deg.unwrap();
        assert!((zero - 0.1 / 2_f64.sqrt()).abs() < 1e-12);
        assert!((told.wedge_std_deg.unwrap() - zero * slope).abs() < 1e-12);
        let nothing = of(0.6, 0.0, Some(0.0), Some(0.0));
        assert_eq!((nothing.wedge_deg, nothing.azimuth_zero_deg), (0.0, 0.0));
    }

    #[test]
    fn flat_ridges_and_numbers_that_are_none_say_nothing() {
        let at = |theta_r: f64, azimuth: f64| {
            let [theta_r, azimuth, std] = [theta_r, azimuth, 0.1].map(Angle::from_deg);
            across(theta_r, azimuth, std, Stated::default())
        };
        assert_eq!(at(0.0, 10.0), None);
        assert_eq!(at(f64::NAN, 10.0), None);
        assert_eq!(at(10.0, f64::INFINITY), None);
    }
}
