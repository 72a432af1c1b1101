//! The forecast of a calculation: time, work and error, stated before it starts, in one form for all calculations.
//!
//! The command line prints a [`Forecast`]; the daemon puts it into a running calculation, its events and its result; the
//! page shows it. `accuracy::forecast` and its neighbours make them. This module imports no other and knows no clock.

use serde::{Deserialize, Serialize};

/// Time, work and error that a calculation is expected to take.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Forecast {
    /// Seconds in all.
    pub seconds: f64,
    /// Whether `seconds` is a bound, not an estimate.
    pub at_most: bool,
    /// Parts of that time, in the order in which they are spent; empty where parts are not separated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Part>,
    /// Amount of work, where it can be counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub amount: Option<Amount>,
    /// Error of the complete result, where it can be predicted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<Expected>,
    /// Whether the time limit is too short for the whole calculation; parts, work and error are those of the whole.
    #[serde(default)]
    pub cut_short: bool,
    /// Seconds of the whole calculation, where a limit cuts it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncut_seconds: Option<f64>,
    /// What random sampling reaches at the limit; `amount` and `error` are those of the whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_limit: Option<AtLimit>,
}

/// What random sampling reaches at a time limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = ForecastAtLimit)]
pub struct AtLimit {
    /// Number of samples drawn at the limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count: Option<u64>,
    /// Error at the limit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
}

/// Seconds of a part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = ForecastPart)]
pub struct Part {
    /// Purpose: "to read frames".
    pub what: String,
    /// Duration, s.
    pub seconds: f64,
}

/// Countable work.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = ForecastAmount)]
pub struct Amount {
    /// Number.
    pub count: u64,
    /// Noun: "photons".
    pub of: String,
}

/// An expected error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = ForecastError)]
pub struct Expected {
    /// Relative standard error, or a bound on the share that is left out.
    pub value: f64,
    /// Quantity: "a reflected bin".
    pub of: String,
}

impl Forecast {
    /// An estimate without parts.
    #[must_use]
    pub fn about(seconds: f64) -> Self {
        Forecast {
            seconds,
            at_most: false,
            parts: Vec::new(),
            amount: None,
            error: None,
            cut_short: false,
            uncut_seconds: None,
            at_limit: None,
        }
    }

    /// Sums parts; a part without time is left out.
    #[must_use]
    pub fn of_parts<const N: usize>(parts: [(&str, f64); N]) -> Self {
        let taken = parts.into_iter().filter(|(_, seconds)| *seconds > 0.0);
        Forecast {
            parts: taken
                .map(|(what, seconds)| Part {
                    what: what.to_owned(),
                    seconds,
                })
                .collect(),
            ..Forecast::about(parts.iter().map(|(_, seconds)| seconds.max(0.0)).sum())
        }
    }

    /// Adds the amount of work.
    #[must_use]
    pub fn for_work(self, count: u64, of: &str) -> Self {
        let of = of.to_owned();
        Forecast {
            amount: Some(Amount { count, of }),
            ..self
        }
    }

    /// Adds the error of the complete result, if it is known.
    #[must_use]
    pub fn to_error(self, value: Option<f64>, of: &str) -> Self {
        let of = of.to_owned();
        Forecast {
            error: value.map(|value| Expected { value, of }),
            ..self
        }
    }

    /// Cuts the time to `limit` seconds.
    #[must_use]
    pub fn within(self, limit: Option<f64>) -> Self {
        match limit {
            Some(limit) if limit < self.seconds => Forecast {
                seconds: limit,
                cut_short: true,
                uncut_seconds: self.uncut_seconds.or(Some(self.seconds)),
                ..self
            },
            _ => self,
        }
    }

    /// Cuts random sampling to `limit` seconds: fewer samples, and an error that grows with the root of the missing share.
    #[must_use]
    pub fn drawn_within(self, limit: Option<f64>) -> Self {
        let forecast = self.within(limit);
        let Some(uncut) = forecast.uncut_seconds.filter(|_| forecast.cut_short) else {
            return forecast;
        };
        let share = (forecast.seconds / uncut).clamp(0.0, 1.0);
        let at_limit = AtLimit {
            count: forecast
                .amount
                .as_ref()
                .map(|all| (share * all.count as f64) as u64),
            error: forecast.error.as_ref().map(|all| all.value / share.sqrt()),
        };
        Forecast {
            // At a limit of 0 s nothing is sampled.
            at_limit: (share > 0.0).then_some(at_limit),
            ..forecast
        }
    }

    /// Returns the forecast of the same work repeated `count` times.
    #[must_use]
    pub fn times(self, count: u32) -> Self {
        let n = f64::from(count.max(1));
        Forecast {
            seconds: n * self.seconds,
            uncut_seconds: self.uncut_seconds.map(|s| n * s),
            parts: self
                .parts
                .into_iter()
                .map(|part| Part {
                    seconds: n * part.seconds,
                    ..part
                })
                .collect(),
            ..self
        }
    }

    /// Returns the seconds of a part by its name; 0 if there is no such part.
    #[must_use]
    pub fn part(&self, what: &str) -> f64 {
        let found = self.parts.iter().find(|p| p.what == what);
        found.map_or(0.0, |p| p.seconds)
    }
}

impl std::fmt::Display for Forecast {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let about = if self.at_most { "at most" } else { "about" };
        let parts = self.parts.iter().enumerate().map(|(n, part)| {
            let before = if n == 0 { ":" } else { "," };
            format!("{before} {:.1} s {}", part.seconds, part.what)
        });
        let parts: String = parts.collect();
        let work = self.amount.as_ref().map(|all| (all.count, &all.of));
        let error = self.error.as_ref().map(|all| (100.0 * all.value, &all.of));
        let Some(whole_s) = self.uncut_seconds else {
            write!(f, "{about} {:.1} s", self.seconds)?;
            if let Some((count, of)) = work {
                write!(f, " for {count} {of}")?;
            }
            f.write_str(&parts)?;
            if let Some((error, of)) = error {
                write!(f, ", error of {of} about {error:.2} %")?;
            }
            return match self.cut_short {
                true => f.write_str(" (limited by the time allowed)"),
                false => Ok(()),
            };
        };
        let at_limit = self.at_limit.as_ref();
        write!(f, "stops at the {:.1} s limit", self.seconds)?;
        let mut all = format!("all of it: {about} {whole_s:.1} s");
        match (work, at_limit.and_then(|at| at.count)) {
            (Some((count, of)), Some(drawn)) => write!(f, " after about {drawn} of {count} {of}")?,
            (Some((count, of)), None) => all.push_str(&format!(" for {count} {of}")),
            (None, _) => {}
        }
        all.push_str(&parts);
        match (error, at_limit.and_then(|at| at.error)) {
            (Some((error, of)), Some(reached)) => {
                write!(f, ", error of {of} about {:.2} %", 100.0 * reached)?;
                all.push_str(&format!(", error {error:.2} %"));
            }
            (Some((error, of)), None) => write!(f, ", error of {of} about {error:.2} %")?,
            (None, _) => {}
        }
        write!(f, " ({all})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_and_a_forecast_survives_its_json() {
        let forecast = Forecast::of_parts([("to read", 1.5), ("to draw", 0.0), ("to fit", 2.0)])
            .for_work(108, "poses")
            .to_error(Some(0.012), "a radiance");
        assert_eq!(forecast.seconds, 3.5);
        assert_eq!(
            (forecast.part("to fit"), forecast.part("to draw")),
            (2.0, 0.0)
        );
        assert_eq!(
            forecast.to_string(),
            "about 3.5 s for 108 poses: 1.5 s to read, 2.0 s to fit, error of a radiance about 1.20 %"
        );
        let json = serde_json::to_string(&forecast).unwrap();
        assert_eq!(serde_json::from_str::<Forecast>(&json).unwrap(), forecast);
    }

    #[test]
    fn a_limit_cuts_only_a_longer_calculation() {
        let forecast = Forecast::about(10.0);
        assert_eq!(forecast.clone().within(None), forecast);
        assert_eq!(forecast.clone().within(Some(20.0)), forecast);
        let cut = forecast.within(Some(4.0));
        assert!(cut.cut_short && cut.seconds == 4.0);
        assert_eq!(
            cut.to_string(),
            "stops at the 4.0 s limit (all of it: about 10.0 s)"
        );
        // A pixel of a map that is cut short is as good as before; only random sampling gets worse.
        assert_eq!(cut.at_limit, None);
        let again = cut.within(Some(3.0));
        assert_eq!((again.seconds, again.uncut_seconds), (3.0, Some(10.0)));
    }

    #[test]
    fn fewer_samples_have_a_larger_error() {
        let all = Forecast::about(100.0)
            .for_work(1_000_000, "photons")
            .to_error(Some(0.01), "a reflected bin");
        assert_eq!(all.clone().drawn_within(Some(200.0)), all);
        let cut = all.clone().drawn_within(Some(4.0));
        assert_eq!(
            cut.to_string(),
            "stops at the 4.0 s limit after about 40000 of 1000000 photons, error of a reflected bin about 5.00 % \
             (all of it: about 100.0 s, error 1.00 %)"
        );
        assert_eq!(all.drawn_within(Some(0.0)).at_limit, None);
    }
}
