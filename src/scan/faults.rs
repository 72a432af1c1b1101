//! Which fault is retried, how often, how long apart, and what follows: one table for all faults of a scan.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::visit::VisitError;
use crate::bench::CameraError;
use crate::bench::stage::StageError;

/// Kinds of faults that are treated alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultKind {
    /// The port is gone, or the controller does not answer.
    Link,
    /// The stage did not arrive, or refused for a moment.
    Stage,
    /// The controller restarted and lost its reference.
    Power,
    /// The camera delivered no frame.
    Camera,
    /// The frames were rejected.
    Frames,
    /// Only a person can remove the cause: an emergency stop, another device, a manual knob.
    Person,
}

/// What follows when a fault persists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reaction {
    /// The scan pauses and states cause and way out.
    #[default]
    Pause,
    /// The scan continues without the point.
    Skip,
    /// The scan fails.
    Abort,
}

/// The reaction to each kind of fault that is retried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Reactions {
    /// The link stayed lost.
    pub link: Reaction,
    /// The stage did not arrive.
    pub stage: Reaction,
    /// The camera delivered no frame.
    pub camera: Reaction,
    /// The frames stayed wrong.
    pub frames: Reaction,
}

/// What follows a failed order of the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum OnFailure {
    /// The queue stops and waits for a person.
    #[default]
    Stop,
    /// The order waits again at the end of the queue, once; then the queue stops.
    End,
}

/// How a scan deals with faults.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultPolicy {
    /// Largest number of attempts at one point.
    pub attempts_max: u32,
    /// Wait before the first retry; doubles with each further one.
    pub retry_after: Duration,
    /// Longest wait between retries.
    pub retry_after_max: Duration,
    /// How long a lost link is reconnected.
    pub reconnect_for: Duration,
    /// Whether axes are homed without a person after their controller restarted.
    pub home_after_power_cycle: bool,
    /// What follows when retries did not help.
    pub reactions: Reactions,
}

/// Failed attempts at one point.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Attempts {
    /// Visits that failed, except by a lost link.
    failed: u32,
    /// Times that the link was lost and found again.
    outages: u32,
    /// Start of the present outage, and the failed attempts to connect since.
    outage: Option<(Duration, u32)>,
}

impl Attempts {
    /// Counts a failure at the time `now`.
    pub(super) fn count(&mut self, kind: FaultKind, now: Duration) {
        match kind {
            FaultKind::Link => self.outage.get_or_insert((now, 0)).1 += 1,
            _ => self.failed += 1,
        }
    }

    /// Returns whether the last failure is the first of an outage.
    pub(super) fn has_just_lost_the_link(&self) -> bool {
        self.outage.is_some_and(|(_, tries)| tries == 1)
    }

    /// Notes that the link is back.
    pub(super) fn linked(&mut self) {
        if self.outage.take().is_some() {
            self.outages += 1;
        }
    }
}

/// What to do about a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Try again after this time.
    RetryAfter(Duration),
    /// Stop trying.
    GiveUp(Reaction),
}

impl FaultPolicy {
    /// Returns what to do about a fault at the time `now`, after these attempts.
    pub(super) fn judge(&self, kind: FaultKind, attempts: &Attempts, now: Duration) -> Verdict {
        let backoff = |failed: u32| {
            let doublings = 2_u32.saturating_pow(failed.saturating_sub(1));
            let wait = self.retry_after.saturating_mul(doublings);
            wait.min(self.retry_after_max)
        };
        let counted = attempts.failed < self.attempts_max;
        let (again, wait, then) = match kind {
            FaultKind::Link => {
                let (since, tries) = attempts.outage.unwrap_or((now, 1));
                let left = self.reconnect_for.saturating_sub(now.saturating_sub(since));
                let again = !left.is_zero() && attempts.outages < self.attempts_max;
                (again, backoff(tries).min(left), self.reactions.link)
            }
            FaultKind::Stage => (counted, backoff(attempts.failed), self.reactions.stage),
            FaultKind::Camera => (counted, backoff(attempts.failed), self.reactions.camera),
            // Waiting does not improve a picture.
            FaultKind::Frames => (counted, Duration::ZERO, self.reactions.frames),
            FaultKind::Power => {
                let again = counted && self.home_after_power_cycle;
                (again, backoff(attempts.failed), Reaction::Pause)
            }
            FaultKind::Person => (false, Duration::ZERO, Reaction::Pause),
        };
        match again {
            true => Verdict::RetryAfter(wait),
            false => Verdict::GiveUp(then),
        }
    }
}

impl VisitError {
    /// Returns the kind of the fault.
    pub(super) fn kind(&self) -> FaultKind {
        match self {
            VisitError::Stage(error) => kind_of_stage(error),
            VisitError::Camera(
                CameraError::TimedOut { .. }
                | CameraError::NotAFrame(_)
                | CameraError::BadTag(_)
                | CameraError::Failed(_),
            ) => FaultKind::Camera,
            VisitError::OtherCamera { .. } => FaultKind::Person,
            // What happened to the stages meanwhile is unknown.
            VisitError::Suspended { .. } => FaultKind::Link,
            VisitError::Frames(_) => FaultKind::Frames,
        }
    }
}

/// Targets are absolute, so a repeated move is safe.
fn kind_of_stage(error: &StageError) -> FaultKind {
    match error {
        // A port that comes back may for a moment lack its permissions.
        StageError::Port(_)
        | StageError::NoReply(_)
        | StageError::Disconnected(_)
        // The next connection names the controllers that differ.
        | StageError::Replaced { .. } => FaultKind::Link,
        StageError::Refused { code, .. } if passes_by_itself(code) => FaultKind::Stage,
        StageError::Missed { .. }
        | StageError::Slipped { .. }
        | StageError::NotCarriedOut { .. }
        | StageError::Unreadable { .. }
        | StageError::TimedOut { .. } => FaultKind::Stage,
        StageError::PowerCycled { .. } | StageError::NotReferenced { .. } => FaultKind::Power,
        StageError::BadSetting { .. }
        | StageError::Unsendable(_)
        | StageError::Refused { .. }
        | StageError::WrongDevice { .. }
        | StageError::OtherStages(_)
        | StageError::Forbidden(_)
        | StageError::HomingOrder { .. }
        | StageError::HomingBlocked { .. }
        | StageError::AddressConflict { .. }
        | StageError::NoScale { .. }
        | StageError::Disagreement { .. }
        | StageError::BeyondTravel { .. }
        | StageError::NotANumber { .. }
        | StageError::OutsideLimits { .. }
        | StageError::Interrupted { .. }
        | StageError::Stalled { .. }
        | StageError::Fault { .. }
        | StageError::HomingFailed { .. }
        | StageError::HomingTimedOut { .. }
        | StageError::NoSuchAxis { .. }
        | StageError::Stopped
        | StageError::Busy { .. } => FaultKind::Person,
    }
}

/// Whether a controller refuses for a reason that ends by itself.
fn passes_by_itself(code: &str) -> bool {
    matches!(code, "AGAIN" | "STATUSBUSY" | "FULL")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn policy() -> FaultPolicy {
        FaultPolicy {
            attempts_max: 3,
            retry_after: Duration::from_secs(1),
            retry_after_max: Duration::from_secs(4),
            reconnect_for: Duration::from_secs(20),
            home_after_power_cycle: false,
            reactions: Reactions {
                camera: Reaction::Skip,
                ..Reactions::default()
            },
        }
    }

    fn after(failed: u32) -> Attempts {
        Attempts {
            failed,
            ..Attempts::default()
        }
    }

    #[test]
    fn waits_double_up_to_the_longest_and_end_at_the_last_attempt() {
        let mut policy = policy();
        let verdict = |policy: &FaultPolicy, failed| {
            policy.judge(FaultKind::Camera, &after(failed), Duration::ZERO)
        };
        let retry = |s| Verdict::RetryAfter(Duration::from_secs(s));
        assert_eq!(verdict(&policy, 1), retry(1));
        assert_eq!(verdict(&policy, 2), retry(2));
        assert_eq!(verdict(&policy, 3), Verdict::GiveUp(Reaction::Skip));
        policy.attempts_max = u32::MAX;
        assert_eq!(verdict(&policy, 100), retry(4));
    }

    #[test]
    fn a_lost_link_is_reconnected_for_a_time_and_not_a_number_of_attempts() {
        let mut attempts = Attempts::default();
        let mut at = |s: u64, lost: u32| {
            let now = Duration::from_secs(s);
            for _ in 0..lost {
                attempts.count(FaultKind::Link, now);
            }
            policy().judge(FaultKind::Link, &attempts, now)
        };
        let retry = |s| Verdict::RetryAfter(Duration::from_secs(s));
        assert_eq!(at(0, 1), retry(1));
        assert_eq!(at(15, 50), retry(4));
        // The last wait ends with the time.
        assert_eq!(at(19, 1), retry(1));
        assert_eq!(at(20, 1), Verdict::GiveUp(Reaction::Pause));
        // A link that is lost again and again is not reconnected for ever.
        for outage in 0..3 {
            let mut flapping = Attempts::default();
            for _ in 0..=outage {
                flapping.count(FaultKind::Link, Duration::ZERO);
                flapping.linked();
            }
            flapping.count(FaultKind::Link, Duration::ZERO);
            let verdict = policy().judge(FaultKind::Link, &flapping, Duration::ZERO);
            assert_eq!(verdict == Verdict::GiveUp(Reaction::Pause), outage == 2);
        }
    }

    #[test]
    fn a_restarted_controller_waits_for_a_person_unless_the_settings_allow_motion() {
        let mut policy = policy();
        let judge =
            |policy: &FaultPolicy| policy.judge(FaultKind::Power, &after(1), Duration::ZERO);
        assert_eq!(judge(&policy), Verdict::GiveUp(Reaction::Pause));
        policy.home_after_power_cycle = true;
        assert!(matches!(judge(&policy), Verdict::RetryAfter(_)));
    }

    #[test]
    fn a_controller_that_is_busy_is_asked_again_and_one_that_refuses_is_not() {
        let refused = |code: &str| {
            VisitError::Stage(StageError::Refused {
                axis: crate::bench::AxisName::PhiS,
                command: "move abs 1".into(),
                code: code.into(),
                meaning: "",
            })
            .kind()
        };
        assert_eq!(refused("AGAIN"), FaultKind::Stage);
        assert_eq!(refused("STATUSBUSY"), FaultKind::Stage);
        assert_eq!(refused("BADDATA"), FaultKind::Person);
    }
}
