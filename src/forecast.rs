//! What a calculation will take, told before it starts: one form for all of them.
//!
//! A [`Forecast`] is what the command line prints, what the daemon puts into a calculation that runs, into its
//! events and into its result, and what the page shows. How one is made is known where things are timed
//! (`accuracy::forecast` and its neighbours). This room names no other and knows no clock.

use serde::{Deserialize, Serialize};

/// What a calculation will take.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// Seconds in all.
    pub seconds: f64,
    /// Whether `seconds` is a bound, not an estimate.
    pub at_most: bool,
    /// What they go to, in the order in which they are spent; empty where nothing is told apart.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<Part>,
    /// How much work it is, where that can be counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub amount: Option<Amount>,
    /// Error of the answer at its end, where that can be told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<Expected>,
    /// Whether the time allowed is too short for what was asked for: parts, work and error are of all of it.
    #[serde(default)]
    pub cut_short: bool,
    /// Seconds that all of it would take, where a limit cuts it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncut_seconds: Option<f64>,
    /// What a limit leaves of work that is drawn at random; `amount` and `error` are of all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_limit: Option<AtLimit>,
}

/// How far random draws come by a limit of time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AtLimit {
    /// How many are drawn by then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count: Option<u64>,
    /// The error by then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
}

/// Seconds of a part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Part {
    /// What for: "to read frames".
    pub what: String,
    /// How long.
    pub seconds: f64,
}

/// Countable work.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Amount {
    /// How many.
    pub count: u64,
    /// Of what: "photons".
    pub of: String,
}

/// An error that is to be expected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Expected {
    /// Relative standard error, or a bound on the share that is left out.
    pub value: f64,
    /// Of what: "a reflected bin".
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

    /// The sum of parts; those of no time are not told.
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

    /// With how much work it is.
    #[must_use]
    pub fn for_work(self, count: u64, of: &str) -> Self {
        let of = of.to_owned();
        Forecast {
            amount: Some(Amount { count, of }),
            ..self
        }
    }

    /// With the error at its end; nothing is added where nobody knows it.
    #[must_use]
    pub fn to_error(self, value: Option<f64>, of: &str) -> Self {
        let of = of.to_owned();
        Forecast {
            error: value.map(|value| Expected { value, of }),
            ..self
        }
    }

    /// With no more than `limit` seconds spent on what is left when a limit is reached.
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

    /// The same for work that is drawn at random: fewer draws by the limit, and an error that grows with the root of
    /// what is missing.
    #[must_use]
    pub fn drawn_within(self, limit: Option<f64>) -> Self {
        let told = self.within(limit);
        let Some(uncut) = told.uncut_seconds.filter(|_| told.cut_short) else {
            return told;
        };
        let share = (told.seconds / uncut).clamp(0.0, 1.0);
        let at_limit = AtLimit {
            count: told
                .amount
                .as_ref()
                .map(|all| (share * all.count as f64) as u64),
            error: told.error.as_ref().map(|all| all.value / share.sqrt()),
        };
        Forecast {
            // A limit of no time leaves nothing to tell.
            at_limit: (share > 0.0).then_some(at_limit),
            ..told
        }
    }

    /// The same work so many times over.
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

    /// Seconds of a part by its name; 0 where it has none.
    #[must_use]
    pub fn part(&self, what: &str) -> f64 {
        let found = self.parts.iter().find(|p| p.what == what);
        found.map_or(0.0, |p| p.seconds)
    }
}

impl std::fmt::Display for Forecast {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let about = if self.at_most { "at most" } else { "about" };
        if let Some(uncut) = self.uncut_seconds {
            write!(f, "{:.1} s, where the limit ends what takes ", self.seconds)?;
            write!(f, "{about} {uncut:.1} s")?;
        } else {
            write!(f, "{about} {:.1} s", self.seconds)?;
        }
        if let Some(amount) = &self.amount {
            write!(f, " for {} {}", amount.count, amount.of)?;
            if let Some(count) = self.at_limit.as_ref().and_then(|at| at.count) {
                write!(f, " (about {count} by the limit)")?;
            }
        }
        for (n, part) in self.parts.iter().enumerate() {
            let before = if n == 0 { ":" } else { "," };
            write!(f, "{before} {:.1} s {}", part.seconds, part.what)?;
        }
        if let Some(error) = &self.error {
            write!(
                f,
                ", error of {} about {:.2} %",
                error.of,
                100.0 * error.value
            )?;
            if let Some(error) = self.at_limit.as_ref().and_then(|at| at.error) {
                write!(f, " ({:.2} % by the limit)", 100.0 * error)?;
            }
        }
        if self.cut_short && self.uncut_seconds.is_none() {
            f.write_str(" (time allows no more)")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_and_a_forecast_survives_its_json() {
        let told = Forecast::of_parts([("to read", 1.5), ("to draw", 0.0), ("to fit", 2.0)])
            .for_work(108, "poses")
            .to_error(Some(0.012), "a radiance");
        assert_eq!(told.seconds, 3.5);
        assert_eq!((told.part("to fit"), told.part("to draw")), (2.0, 0.0));
        assert_eq!(
            told.to_string(),
            "about 3.5 s for 108 poses: 1.5 s to read, 2.0 s to fit, error of a radiance about 1.20 %"
        );
        let json = serde_json::to_string(&told).unwrap();
        assert_eq!(serde_json::from_str::<Forecast>(&json).unwrap(), told);
    }

    #[test]
    fn a_limit_cuts_what_is_longer_and_nothing_else() {
        let told = Forecast::about(10.0);
        assert_eq!(told.clone().within(None), told);
        assert_eq!(told.clone().within(Some(20.0)), told);
        let cut = told.within(Some(4.0));
        assert!(cut.cut_short && cut.seconds == 4.0);
        assert_eq!(
            cut.to_string(),
            "4.0 s, where the limit ends what takes about 10.0 s"
        );
        // Every pixel of a map that is cut short is as good as before: only what is drawn at random gets worse.
        assert_eq!(cut.at_limit, None);
        let again = cut.within(Some(3.0));
        assert_eq!((again.seconds, again.uncut_seconds), (3.0, Some(10.0)));
    }

    #[test]
    fn fewer_draws_by_a_limit_have_the_larger_error() {
        let all = Forecast::about(100.0)
            .for_work(1_000_000, "photons")
            .to_error(Some(0.01), "a reflected bin");
        assert_eq!(all.clone().drawn_within(Some(200.0)), all);
        let cut = all.clone().drawn_within(Some(4.0));
        assert_eq!(
            cut.to_string(),
            "4.0 s, where the limit ends what takes about 100.0 s for 1000000 photons (about 40000 by the limit), \
             error of a reflected bin about 1.00 % (5.00 % by the limit)"
        );
        assert_eq!(all.drawn_within(Some(0.0)).at_limit, None);
    }
}
