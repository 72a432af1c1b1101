//! One visit to a point: move, capture, check the frames.

use std::time::Duration;

use futures::future::BoxFuture;

use super::frame_rules::{FrameRules, fault};
use super::look::Look;
use super::plan::Shot;
use super::recorder::{Rejected, TakenFrame, Visit, unlit_message};
use super::seen_images::SeenImages;
use super::tag_history::{
    ExposureWindow, TagHistory, TagRules, TagVerdict, off_temperature, still_stale,
};
use crate::bench::port::PortError;
use crate::bench::stage::{Flag, FlagClass, Stage, StageError, StageStatus};
use crate::bench::{AxisName, Camera, CameraError, CaptureRequest};
use crate::clock::Clock;
use crate::frame::FrameKind;
use crate::geometry::Pose;

/// Why a visit gave no accepted frames.
#[derive(Debug, thiserror::Error)]
pub enum VisitError {
    /// The stage.
    #[error("{0}")]
    Stage(StageError),
    /// The camera.
    #[error("{0}")]
    Camera(CameraError),
    /// Another camera than before took the frames.
    #[error(
        "the camera with serial number {found} took the frame, but the scan's camera is {expected}: dark frames and gain of one \
         camera do not hold for another; connect {expected} again, or plan a new scan with new dark frames"
    )]
    OtherCamera {
        /// Serial number of the scan's camera.
        expected: String,
        /// Serial number that the frame states.
        found: String,
    },
    /// The program did not run for a while.
    #[error(
        "the computer was suspended, or the program stopped, for {gap_s:.0} s during a move or an exposure; disable suspend on \
         this computer"
    )]
    Suspended {
        /// How long.
        gap_s: f64,
    },
    /// The frames, after several visits.
    #[error("{0}; fix it, then resume")]
    Frames(Rejected),
}

impl VisitError {
    /// Reason of a scan that was stopped by the stop button.
    pub const STOPPED: &'static str = "stopped; resume to continue";

    /// Returns whether the plan requests what the rig cannot do.
    pub(super) fn contradicts_the_plan(&self) -> bool {
        matches!(self, VisitError::Stage(StageError::OutsideLimits { .. }))
    }

    /// Returns the code of the alarm; `None` for a stop by the user.
    pub(super) fn code(&self) -> Option<&'static str> {
        match self {
            VisitError::Stage(StageError::Stopped) => None,
            VisitError::Stage(error) => Some(stage_code(error)),
            VisitError::Camera(_) => Some("camera-failed"),
            VisitError::OtherCamera { .. } => Some("camera-replaced"),
            VisitError::Suspended { .. } => Some("host-suspended"),
            VisitError::Frames(_) => Some("frames-rejected"),
        }
    }
}

/// Returns the stable code of a stage error.
#[must_use]
pub fn stage_code(error: &StageError) -> &'static str {
    match error {
        StageError::Port(PortError::Missing { .. }) => "port-missing",
        StageError::Port(PortError::InUse { .. }) => "port-in-use",
        StageError::Port(PortError::Permission { .. }) => "port-forbidden",
        StageError::Port(PortError::NotASerialLine { .. }) => "port-not-serial",
        StageError::Port(PortError::Unreachable { .. }) => "port-unreachable",
        StageError::Port(PortError::NoThread { .. }) => "port-failed",
        StageError::BadSetting { .. } => "stage-setting-wrong",
        StageError::NoReply(_) => "stage-silent",
        StageError::Disconnected(_) => "stage-disconnected",
        StageError::Unsendable(_) | StageError::Unreadable { .. } => "stage-protocol",
        StageError::Refused { .. } => "stage-refused",
        StageError::WrongDevice { .. } => "stage-wrong-device",
        StageError::OtherStages(_) | StageError::Replaced { .. } => "stage-other-device",
        StageError::NotCarriedOut { .. } => "stage-not-carried-out",
        StageError::Forbidden(_) => "forbidden-region",
        StageError::HomingOrder { .. } | StageError::HomingBlocked { .. } => "homing-blocked",
        StageError::AddressConflict { .. } => "stage-address-conflict",
        StageError::NoScale { .. } => "stage-no-scale",
        StageError::NoSuchAxis { .. } => "stage-no-such-axis",
        StageError::Disagreement { .. } | StageError::BeyondTravel { .. } => "stage-disagrees",
        StageError::NotANumber { .. } | StageError::OutsideLimits { .. } => "outside-limits",
        StageError::NotReferenced { .. } => "stage-not-referenced",
        StageError::PowerCycled { .. } => "stage-power-cycled",
        StageError::Interrupted { .. } => "stage-interrupted",
        StageError::Stalled { .. } => "stage-stalled",
        StageError::Fault { .. } => "stage-fault",
        StageError::HomingFailed { .. } => "stage-homing-failed",
        StageError::Missed { .. } => "stage-missed",
        StageError::Slipped { .. } => "stage-slipped",
        StageError::TimedOut { .. } | StageError::HomingTimedOut { .. } => "stage-timed-out",
        StageError::Stopped => "stopped",
        StageError::Busy { .. } => "busy",
    }
}

/// Returns whether a code names a fault of the link or of the stages.
#[must_use]
pub fn is_stage_code(code: &str) -> bool {
    code.starts_with("port-") || code.starts_with("stage-")
}

/// Time between two looks at the stage during an exposure.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Frames that are discarded in a row before the point counts as failed.
const DISCARDED_MAX: u32 = 5;

/// What a visit needs besides the devices.
pub(super) struct VisitContext<'a> {
    pub rules: &'a FrameRules,
    pub tag_rules: &'a TagRules,
    pub tags: &'a mut TagHistory,
    pub seen: &'a mut SeenImages,
    pub clock: &'a dyn Clock,
}

/// Moves to a point and takes its frames. A caller that drops the future has to stop the stage.
pub(super) async fn visit(
    stage: &Stage,
    camera: &mut dyn Camera,
    shot: &Shot,
    attempt: u32,
    context: VisitContext<'_>,
) -> Result<Visit, VisitError> {
    let VisitContext {
        rules,
        tag_rules,
        tags,
        seen,
        clock,
    } = context;
    let (arrived, before) = match shot.target {
        // The stage checks the limits before it moves, and a move clears the flags of an earlier interruption.
        Some(target) => {
            let arrived = stage.move_pose(target).await.map_err(VisitError::Stage)?;
            (arrived, None)
        }
        None => {
            let before = stage.status().await.map_err(VisitError::Stage)?;
            (before.pose(), Some(before))
        }
    };
    let at_rest_utc = clock.utc();
    let pose = in_the_plans_turn(arrived, shot);
    let mut frames = Vec::with_capacity(shot.n_frames() as usize);
    let mut wrong = None;
    let mut discarded = None;
    for (exposure_index, exposure_s) in shot.exposures_s.iter().copied().enumerate() {
        for repeat in 0..shot.repeats {
            let request = CaptureRequest {
                kind: shot.kind,
                pose,
                exposure_s,
                repeat,
            };
            let mut discarded_here = 0;
            let captured = loop {
                let (captured, moved) = watched(stage, arrived, camera.capture(&request)).await;
                if let Some(moved) = moved {
                    wrong.get_or_insert(moved);
                }
                let captured = match captured {
                    Ok(captured) => captured,
                    Err(error) => {
                        tags.interrupted();
                        return Err(VisitError::Camera(error));
                    }
                };
                let window = ExposureWindow {
                    from: at_rest_utc,
                    until: clock.utc(),
                    machine_s_per_s: clock.machine_s_per_s(),
                };
                // Also of an image that will not count: the camera may return it again.
                let repeats = seen.shows_again(&captured.frame, rules);
                match tags.check(&captured.tag, exposure_s, window, tag_rules) {
                    TagVerdict::Fresh => {
                        if repeats {
                            wrong.get_or_insert(Rejected::SameFrame);
                        }
                        break captured;
                    }
                    TagVerdict::Stale(why) if discarded_here < DISCARDED_MAX => {
                        discarded_here += 1;
                        discarded = Some(why);
                    }
                    TagVerdict::Stale(why) => {
                        wrong.get_or_insert(still_stale(&why, discarded_here));
                        break captured;
                    }
                    TagVerdict::Wrong(why) => {
                        wrong.get_or_insert(Rejected::Otherwise(why));
                        break captured;
                    }
                    TagVerdict::OtherCamera { expected, found } => {
                        return Err(VisitError::OtherCamera { expected, found });
                    }
                }
            };
            if let Some(found) = off_temperature(&captured.tag, tag_rules, 1.0) {
                wrong.get_or_insert(Rejected::Otherwise(format!(
                    "the camera's sensor is at {found} °C, off its set point (camera.temperature_c)"
                )));
            }
            frames.push(TakenFrame {
                captured,
                exposure_s,
                exposure_index,
                repeat,
            });
        }
    }
    let taken_at = frames
        .first()
        .map(|frame| frame.captured.started_utc)
        .expect("a checked plan has frames at every point");
    let still = stage.status().await.map_err(VisitError::Stage)?;
    stage.check_slip().await.map_err(VisitError::Stage)?;
    let moved = displacement(stage, arrived, &still);
    let pushed = disturbance(before.as_ref(), &still)?;
    let rejected = moved
        .or(pushed)
        .or(wrong)
        .or_else(|| fault(&frames, shot.kind, rules))
        .or_else(|| unlit(&frames, shot.kind, rules))
        .or_else(|| disproportionate(&frames, rules));
    Ok(Visit {
        shot: shot.clone(),
        attempt,
        pose,
        frames,
        rejected,
        discarded,
        taken_at,
    })
}

/// Waits for a frame and watches the stage meanwhile: an axis that is pushed away and back is in its place again in the end.
async fn watched<T>(
    stage: &Stage,
    arrived: Pose,
    mut capture: BoxFuture<'_, T>,
) -> (T, Option<Rejected>) {
    let motion = async {
        loop {
            // In real time, as the port answers.
            tokio::time::sleep(LOOK_EVERY).await;
            // A stage that does not answer is reported after the frame.
            if let Ok(status) = stage.status().await
                && let Some(moved) = displacement(stage, arrived, &status)
            {
                return moved;
            }
        }
    };
    tokio::pin!(motion);
    let mut moved = None;
    loop {
        tokio::select! {
            biased;
            captured = &mut capture => return (captured, moved),
            found = &mut motion, if moved.is_none() => moved = Some(found),
        }
    }
}

/// Returns what is wrong if the stage moves, or is not where it arrived.
fn displacement(stage: &Stage, arrived: Pose, now: &StageStatus) -> Option<Rejected> {
    let settings = stage.settings();
    let tilt = (now.theta_c.position - arrived.theta_c).abs().deg();
    let drift = tilt.max((now.phi_s.position - arrived.phi_s).abs().deg());
    let tolerance = settings
        .theta_c
        .tolerance
        .deg()
        .max(settings.phi_s.tolerance.deg());
    (now.theta_c.moving || now.phi_s.moving || drift > tolerance).then(|| {
        Rejected::Disturbed(format!(
            "the stage moved by {drift:.4}° while the frames were taken"
        ))
    })
}

/// Returns why frames do not count that were taken while these flags came up; `None` if no flag concerns them.
///
/// `before` holds the flags that stood before the frames where no move cleared them. An interruption or a push among them is an
/// earlier one: a stop of a move leaves its flag raised until the axis moves again.
///
/// # Errors
/// A flag after which the position cannot be trusted, or which says that the axis was moved.
fn disturbance(
    before: Option<&StageStatus>,
    after: &StageStatus,
) -> Result<Option<Rejected>, VisitError> {
    let mut pushed = None;
    for axis in AxisName::ALL {
        let status = after.axis(axis);
        let stood = |flag| before.is_some_and(|before| before.axis(axis).flags.contains(&flag));
        for flag in status.flags.iter().copied() {
            match flag.class() {
                FlagClass::Interrupted | FlagClass::Informational if stood(flag) => {}
                FlagClass::Fault => {
                    return Err(VisitError::Stage(StageError::Fault { axis, flag }));
                }
                FlagClass::Interrupted => {
                    return Err(VisitError::Stage(StageError::Interrupted { axis, flag }));
                }
                FlagClass::ReferenceLost => {
                    return Err(VisitError::Stage(StageError::PowerCycled { axis }));
                }
                FlagClass::Informational => {
                    if matches!(flag, Flag::Displaced | Flag::StallRecovered) {
                        pushed = Some(Rejected::Disturbed(format!(
                            "{axis} reported {flag} while the frames were taken ({})",
                            flag.meaning()
                        )));
                    }
                }
            }
        }
    }
    Ok(pushed)
}

/// Returns what is wrong where a large part of the longest exposure shows no light: a shutter that hangs, a cable in the way.
fn unlit(frames: &[TakenFrame], kind: FrameKind, rules: &FrameRules) -> Option<Rejected> {
    let confirmed =
        kind == FrameKind::Sample && (rules.confirmed.unlit_sample || rules.confirmed.black_sample);
    if kind == FrameKind::Dark || confirmed {
        return None;
    }
    let longest = frames
        .iter()
        .max_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s))?;
    let look = Look::of(&longest.captured.frame, longest.exposure_s, rules);
    let share = look.unlit_share(rules);
    (share >= rules.unlit_share_max).then(|| {
        let percent = (100.0 * share).round() as u32;
        match kind {
            FrameKind::Sample => Rejected::UnlitSample { percent },
            FrameKind::Dark | FrameKind::Flat => Rejected::Otherwise(unlit_message(percent)),
        }
    })
}

/// Returns what is wrong where the counts of the frames do not follow their exposures: a camera that returns a frame of another
/// exposure, or does not set the exposure.
fn disproportionate(frames: &[TakenFrame], rules: &FrameRules) -> Option<Rejected> {
    // The first frame of each exposure: the oldest one of a camera whose buffer is behind.
    let mut first = frames.iter().filter(|taken| taken.repeat == 0).peekable();
    let look = |taken: &TakenFrame| Look::of(&taken.captured.frame, taken.exposure_s, rules);
    let mut looks: Vec<Look> = Vec::new();
    while let Some(taken) = first.next() {
        if looks.is_empty() && first.peek().is_none() {
            return None;
        }
        let next = look(taken);
        if let Some(other) = looks.iter().find(|other| !other.scales_with(&next, rules)) {
            return Some(Rejected::Otherwise(format!(
                "the counts do not follow the exposure: {:.0} DN above the black level in {} s, but {:.0} DN in {} s; the \
                 camera returned a frame of another exposure, or does not set the exposure: check its buffer and its \
                 capture program",
                other.level_dn(),
                other.exposure_s(),
                next.level_dn(),
                next.exposure_s()
            )));
        }
        looks.push(next);
    }
    None
}

/// Returns the position read back, in the turn of the plan: recorded angles are those of the plan.
fn in_the_plans_turn(arrived: Pose, shot: &Shot) -> Pose {
    match (shot.pose, shot.target) {
        (Some(asked), Some(target)) if asked.phi_s != target.phi_s => Pose {
            theta_c: arrived.theta_c,
            phi_s: arrived.phi_s + (asked.phi_s - target.phi_s),
        },
        _ => arrived,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::stage::AxisStatus;
    use crate::units::Angle;

    #[test]
    fn flags_that_come_up_in_an_exposure_decide_about_its_frames() {
        let status = |flags: &[Flag]| {
            let axis = |flags: &[Flag]| AxisStatus {
                position: Angle::ZERO,
                moving: false,
                homed: true,
                warnings: Vec::new(),
                flags: flags.to_vec(),
                serial: 1,
            };
            StageStatus {
                theta_c: axis(&[]),
                phi_s: axis(flags),
            }
        };
        let with = |flags: &[Flag]| disturbance(None, &status(flags));
        assert!(with(&[]).unwrap().is_none());
        assert!(with(&[Flag::ControllerHot]).unwrap().is_none());
        for pushed in [Flag::Displaced, Flag::StallRecovered] {
            let why = with(&[Flag::ControllerHot, pushed]).unwrap().unwrap();
            assert!(why.to_string().starts_with("phi_s reported W"), "{why}");
        }
        for flag in [Flag::EncoderError, Flag::IndexError, Flag::EmergencyStop] {
            let error = with(&[flag]).unwrap_err();
            assert!(
                matches!(error, VisitError::Stage(StageError::Fault { .. })),
                "{error}"
            );
        }
        let knob = with(&[Flag::ManualControl]).unwrap_err();
        assert!(matches!(
            knob,
            VisitError::Stage(StageError::Interrupted { .. })
        ));
        let lost = with(&[Flag::NoReference]).unwrap_err();
        assert!(matches!(
            lost,
            VisitError::Stage(StageError::PowerCycled { .. })
        ));
        for earlier in [Flag::MovementInterrupted, Flag::Displaced] {
            let stood = disturbance(Some(&status(&[earlier])), &status(&[earlier]));
            assert!(stood.unwrap().is_none(), "{earlier}");
        }
        let fault = status(&[Flag::EncoderError]);
        assert!(disturbance(Some(&fault), &fault).is_err());
    }

    #[test]
    fn a_pose_is_recorded_in_the_turn_of_the_plan() {
        let shot = Shot {
            index: 0,
            kind: FrameKind::Sample,
            pose: Some(Pose::from_deg(0.0, 355.0)),
            target: Some(Pose::from_deg(0.0, -5.0)),
            exposures_s: vec![0.1],
            repeats: 1,
        };
        let pose = in_the_plans_turn(Pose::from_deg(0.01, -4.99), &shot);
        assert!((pose.phi_s.deg() - 355.01).abs() < 1e-9);
        assert!((pose.theta_c.deg() - 0.01).abs() < 1e-12);
    }
}
