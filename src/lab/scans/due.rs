//! What the settings ask to measure again at intervals: the check standard and the references.

use serde::Serialize;
use time::{Duration, OffsetDateTime};

use crate::config::DueSection;
use crate::lab::{Lab, LabError};
use crate::store::{Store, StoreError, utc_of, utc_text};

/// A record further in the future comes from a wrong clock and does not count.
const AHEAD_MAX: Duration = Duration::days(1);

/// What is measured again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DueKind {
    /// The part that does not change.
    CheckStandard,
    /// Dark and white-reference frames.
    References,
}

/// Something that the settings ask to measure again at intervals (`[due]`).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct Due {
    /// What it is.
    pub what: DueKind,
    /// Name of the check standard; null for references.
    pub part: Option<String>,
    /// When it was last measured, RFC 3339 in UTC: the start or import of the newest scan of the check standard with a
    /// converged fit that is not archived; of the newest dark and the newest white-reference frames, the older ones. Null if
    /// never.
    pub last_at: Option<String>,
    /// When it is due, RFC 3339 in UTC; null where it was never measured, so that it is due now.
    pub due_at: Option<String>,
    /// Whether it is due now.
    pub is_due: bool,
}

/// Returns what the settings ask to measure again, due or not, at a time of the day.
///
/// # Errors
/// A store error.
pub async fn due(
    store: &Store,
    settings: &DueSection,
    now: OffsetDateTime,
) -> Result<Vec<Due>, LabError> {
    let until = utc_text(now + AHEAD_MAX);
    let mut all = Vec::new();
    if let (Some(part), Some(days)) = (&settings.check_standard, settings.check_standard_every_days)
    {
        let last = store.last_measured(part, &until).await?;
        let part = Some(part.clone());
        all.push(at_interval(DueKind::CheckStandard, part, last, days, now)?);
    }
    if let Some(days) = settings.references_every_days {
        let last = store.references_taken(&until).await?;
        all.push(at_interval(DueKind::References, None, last, days, now)?);
    }
    Ok(all)
}

fn at_interval(
    what: DueKind,
    part: Option<String>,
    last_at: Option<String>,
    days: f64,
    now: OffsetDateTime,
) -> Result<Due, LabError> {
    let due_at = match &last_at {
        None => None,
        Some(text) => {
            let last = utc_of(text).ok_or_else(|| StoreError::bad_row("results", text))?;
            Some(last.saturating_add(Duration::seconds_f64(86_400.0 * days)))
        }
    };
    Ok(Due {
        what,
        part,
        last_at,
        due_at: due_at.map(utc_text),
        is_due: due_at.is_none_or(|due_at| now >= due_at),
    })
}

impl Lab {
    /// Takes what the settings ask to measure again at intervals. It is set once, at the start of the daemon.
    pub fn set_due(&self, settings: DueSection) {
        // Only a second call fails.
        self.inner.due.set(settings).ok();
    }

    /// Returns what the settings ask to measure again at intervals.
    #[must_use]
    pub fn due_settings(&self) -> &DueSection {
        self.inner.due.get().unwrap_or(&DueSection::NOTHING)
    }

    /// Returns what is measured again at intervals, due or not.
    ///
    /// # Errors
    /// A store error.
    pub async fn due(&self) -> Result<Vec<Due>, LabError> {
        due(self.store(), self.due_settings(), self.clock().utc()).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use time::macros::datetime;

    const LAST: OffsetDateTime = datetime!(2026-03-02 09:00 UTC);

    #[test]
    fn it_is_due_once_the_interval_is_over_and_at_once_if_it_was_never_measured() {
        let at = |last_at: Option<&str>, days: f64, now: OffsetDateTime| {
            let last_at = last_at.map(str::to_owned);
            at_interval(DueKind::References, None, last_at, days, now).unwrap()
        };
        let last = utc_text(LAST);
        for (days, after_s, is_due) in [
            (7.0, 7 * 86_400, true),
            (7.0, 7 * 86_400 - 1, false),
            (0.5, 43_200, true),
            (0.5, 43_199, false),
            // The clock was set back by less than a day.
            (0.5, -40_000, false),
        ] {
            let found = at(Some(&last), days, LAST + Duration::seconds(after_s));
            assert_eq!(found.is_due, is_due, "{days} {after_s}");
            let due_at = utc_text(LAST + Duration::seconds_f64(86_400.0 * days));
            assert_eq!(
                (found.last_at, found.due_at),
                (Some(last.clone()), Some(due_at))
            );
        }
        let never = at(None, 7.0, LAST);
        assert_eq!((never.due_at, never.is_due), (None, true));
        let damaged = at_interval(DueKind::References, None, Some("soon".into()), 1.0, LAST);
        assert!(damaged.is_err());
    }
}
