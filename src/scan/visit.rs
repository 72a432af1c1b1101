//! One visit to a point: move, capture, check the frames.

use super::plan::Shot;
use super::recorder::{BLACK, Rejected, TakenFrame, Visit};
use crate::bench::port::PortError;
use crate::bench::stage::{Flag, FlagClass, Stage, StageError, StageStatus};
use crate::bench::{AxisName, Camera, CameraError, CaptureRequest, Captured};
use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;

/// Rules that an accepted frame satisfies.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameRules {
    /// Width and height of the camera's images.
    pub size_px: (u32, u32),
    /// Counts without light.
    pub black_level_dn: f64,
    /// Read noise in counts.
    pub read_noise_dn: f64,
    /// Smallest mean above the black level, in standard deviations of the read noise, that counts as light.
    pub dark_sigmas: f64,
    /// Count at which a pixel is full.
    pub saturation_dn: u16,
    /// Faults that the operator has confirmed to be as intended.
    pub confirmed: Confirmed,
    /// Largest mean of a capped frame above the black level.
    pub capped: CappedLimit,
}

/// Largest mean of a capped frame above the black level. Dark current grows with the exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CappedLimit {
    /// Counts at any exposure.
    pub mean_dn_max: f64,
    /// Counts of dark current per second.
    pub dark_dn_per_s: f64,
}

impl CappedLimit {
    /// Counts above the black level at an exposure.
    fn at(&self, exposure_s: f64) -> f64 {
        self.mean_dn_max + self.dark_dn_per_s * exposure_s
    }
}

/// Observations that may be a fault or intended. The scan pauses once; by resuming, the operator confirms that they are
/// intended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Confirmed {
    /// A sample without light: a metal may show none, and neither does a sample under a lens cap.
    pub black_sample: bool,
    /// A sample that saturates the camera at every pose.
    pub full_sample: bool,
}

impl Confirmed {
    /// Notes that the operator has confirmed this.
    pub(super) fn note(&mut self, rejected: &Rejected) {
        match rejected {
            Rejected::BlackSample => self.black_sample = true,
            Rejected::FullSample { .. } => self.full_sample = true,
            // Confirming does not repair these.
            Rejected::SameFrame | Rejected::Otherwise(_) => {}
        }
    }
}

/// Why a visit gave no accepted frames.
#[derive(Debug, thiserror::Error)]
pub enum VisitError {
    /// The stage.
    #[error("{0}")]
    Stage(StageError),
    /// The camera.
    #[error("{0}")]
    Camera(CameraError),
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

/// Moves to a point and takes its frames. A caller that drops the future has to stop the stage.
pub(super) async fn visit(
    stage: &Stage,
    camera: &mut dyn Camera,
    shot: &Shot,
    attempt: u32,
    rules: &FrameRules,
) -> Result<Visit, VisitError> {
    let arrived = match shot.target {
        // The stage checks the limits before it moves.
        Some(target) => stage.move_pose(target).await.map_err(VisitError::Stage)?,
        None => stage.status().await.map_err(VisitError::Stage)?.pose(),
    };
    let pose = in_the_plans_turn(arrived, shot);
    let mut frames = Vec::with_capacity(shot.n_frames() as usize);
    for (exposure_index, exposure_s) in shot.exposures_s.iter().copied().enumerate() {
        for repeat in 0..shot.repeats {
            let request = CaptureRequest {
                kind: shot.kind,
                pose,
                exposure_s,
                repeat,
            };
            let captured = camera.capture(&request).await.map_err(VisitError::Camera)?;
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
    let settings = stage.settings();
    let drift = (still.theta_c.position - arrived.theta_c)
        .abs()
        .deg()
        .max((still.phi_s.position - arrived.phi_s).abs().deg());
    let tolerance = settings
        .theta_c
        .tolerance
        .deg()
        .max(settings.phi_s.tolerance.deg());
    let pushed = disturbance(&still)?;
    let rejected = if still.theta_c.moving || still.phi_s.moving || drift > tolerance {
        Some(Rejected::Otherwise(format!(
            "the stage moved by {drift:.4}° while the frames were taken"
        )))
    } else {
        pushed.or_else(|| fault(&frames, shot.kind, rules))
    };
    Ok(Visit {
        shot: shot.clone(),
        attempt,
        pose,
        frames,
        rejected,
        taken_at,
    })
}

/// Returns why frames do not count that were taken while these flags came up; `None` if no flag concerns them.
///
/// # Errors
/// A flag after which the position cannot be trusted, or which says that the axis was moved.
fn disturbance(after: &StageStatus) -> Result<Option<Rejected>, VisitError> {
    let mut pushed = None;
    for axis in AxisName::ALL {
        let status = after.axis(axis);
        for flag in status.flags.iter().copied() {
            match flag.class() {
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
                        pushed = Some(Rejected::Otherwise(format!(
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

/// Returns what is wrong with the frames of a point; `None` if they are accepted.
fn fault(frames: &[TakenFrame], kind: FrameKind, rules: &FrameRules) -> Option<Rejected> {
    for taken in frames {
        let frame = &taken.captured.frame;
        let size = (frame.width_px(), frame.height_px());
        if size != rules.size_px {
            return Some(Rejected::Otherwise(format!(
                "wrong size: the frame has {} × {} pixels, the camera is set to {} × {}",
                size.0, size.1, rules.size_px.0, rules.size_px.1
            )));
        }
    }
    match kind {
        FrameKind::Sample if rules.confirmed.black_sample => None,
        FrameKind::Dark => frames
            .iter()
            .map(|taken| {
                let above = mean_dn(&taken.captured.frame) - rules.black_level_dn;
                (above, taken.exposure_s)
            })
            .find(|(above, exposure_s)| *above > rules.capped.at(*exposure_s))
            .map(|(above, exposure_s)| {
                Rejected::Otherwise(format!(
                    "not dark: {above:.0} DN above the black level in {exposure_s} s, and at most {:.0} DN are allowed \
                     (scan.capped_mean_dn_max, {} DN, and what camera.dark_current_electrons_per_s makes in that time, \
                     {:.0} DN); check the lens cap; if it is on, this is dark current: state \
                     camera.dark_current_electrons_per_s, or plan shorter exposures",
                    rules.capped.at(exposure_s),
                    rules.capped.mean_dn_max,
                    rules.capped.dark_dn_per_s * exposure_s,
                ))
            }),
        FrameKind::Flat | FrameKind::Sample => {
            let longest = frames
                .iter()
                .max_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s))?;
            shows_no_light(&longest.captured.frame, rules).then(|| match kind {
                FrameKind::Sample => Rejected::BlackSample,
                FrameKind::Dark | FrameKind::Flat => Rejected::Otherwise(BLACK.into()),
            })
        }
    }
}

/// Returns what is wrong with a frame that is taken to check the camera; `None` if a scan would accept it.
#[must_use]
pub fn frame_fault(
    captured: Captured,
    exposure_s: f64,
    kind: FrameKind,
    rules: &FrameRules,
) -> Option<String> {
    let taken = TakenFrame {
        captured,
        exposure_s,
        exposure_index: 0,
        repeat: 0,
    };
    fault(&[taken], kind, rules).map(|why| why.to_string())
}

pub(super) fn shows_no_light(frame: &Frame, rules: &FrameRules) -> bool {
    let above = mean_dn(frame) - rules.black_level_dn;
    let sigma = rules.read_noise_dn.max(0.3) / (frame.pixels_dn().len() as f64).sqrt();
    above < rules.dark_sigmas * sigma
}

fn mean_dn(frame: &Frame) -> f64 {
    let sum: u64 = frame.pixels_dn().iter().map(|dn| u64::from(*dn)).sum();
    sum as f64 / frame.pixels_dn().len() as f64
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::bench::Captured;
    use std::time::Duration;

    pub fn rules() -> FrameRules {
        FrameRules {
            size_px: (16, 16),
            black_level_dn: 200.0,
            read_noise_dn: 4.0,
            dark_sigmas: 10.0,
            saturation_dn: 4000,
            confirmed: Confirmed::default(),
            capped: CappedLimit {
                mean_dn_max: 50.0,
                dark_dn_per_s: 0.0,
            },
        }
    }

    /// An even frame with noise seeded by its count.
    pub fn taken(dn: u16, exposure_s: f64) -> TakenFrame {
        let mut state = u32::from(dn);
        let noise = std::iter::repeat_with(|| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 30) as u16
        });
        let pixels: Vec<u16> = noise.take(256).map(|noise| dn - 1 + noise).collect();
        let at_the_ends = [vec![200; 256], vec![4095; 256]];
        let pixels = match dn {
            200 => &at_the_ends[0],
            4095 => &at_the_ends[1],
            _ => &pixels,
        };
        shown(pixels, exposure_s)
    }

    pub fn shown(dn: &[u16], exposure_s: f64) -> TakenFrame {
        TakenFrame {
            captured: Captured {
                frame: Frame::new(16, 16, dn.to_vec()).unwrap(),
                started_at: Duration::ZERO,
                started_utc: time::macros::datetime!(2026-01-01 00:00 UTC),
            },
            exposure_s,
            exposure_index: 0,
            repeat: 0,
        }
    }

    #[test]
    fn light_under_the_cap_and_a_black_sample_are_named() {
        let fault = |dn, kind| fault(&[taken(dn, 0.1)], kind, &rules());
        assert_eq!(fault(201, FrameKind::Dark), None);
        let words = |dn, kind| fault(dn, kind).unwrap().to_string();
        assert!(words(900, FrameKind::Dark).starts_with("not dark"));
        assert_eq!(fault(900, FrameKind::Sample), None);
        assert_eq!(fault(200, FrameKind::Sample), Some(Rejected::BlackSample));
        assert!(words(200, FrameKind::Sample).starts_with("black"));
        // A confirmed black sample does not make a black white reference acceptable.
        assert!(words(200, FrameKind::Flat).starts_with("black"));
        assert_ne!(fault(200, FrameKind::Flat), Some(Rejected::BlackSample));
    }

    #[test]
    fn dark_current_grows_with_the_exposure_and_more_is_light() {
        let mut rules = rules();
        rules.capped.dark_dn_per_s = 100.0;
        let fault = |dn, exposure_s| fault(&[taken(dn, exposure_s)], FrameKind::Dark, &rules);
        assert_eq!(fault(200 + 440, 4.0), None);
        assert_eq!(fault(200 + 40, 0.01), None);
        // The same count in less time is light.
        let words = fault(200 + 440, 0.5).unwrap().to_string();
        for part in [
            "in 0.5 s",
            "at most 100 DN",
            "dark_current_electrons_per_s",
            "50 DN)",
        ] {
            assert!(words.contains(part), "{part}: {words}");
        }
    }

    #[test]
    fn a_short_exposure_may_be_black_if_the_long_one_is_not() {
        let frames = [taken(200, 0.001), taken(900, 0.1)];
        assert_eq!(fault(&frames, FrameKind::Sample, &rules()), None);
    }

    #[test]
    fn a_frame_of_another_size_is_named() {
        let mut small = rules();
        small.size_px = (8, 8);
        let reason = fault(&[taken(900, 0.1)], FrameKind::Sample, &small).unwrap();
        assert!(reason.to_string().starts_with("wrong size"), "{reason}");
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
