//! Rig operations: status, motions, homing, and the stop, which is never refused.

pub(super) mod axis_motion;
pub(super) mod jog;
pub(super) mod motions;
pub(super) mod operator_calls;
pub(super) mod owner;
pub(super) mod park;
pub(super) mod pinned_stages;
pub(super) mod preview_work;
pub(super) mod previews;
pub(super) mod work;

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::oneshot;

use super::error::not_stopped;
use super::request_checks::invalid;
use super::{AxisName, Holder, Lab, LabError, RigSide};
use crate::bench::stage::{AxisStatus, Stage, StageIdentity};
use crate::geometry::Pose;
use crate::scan::event::{AxisEvent, RigActivity};
use crate::scan::runner::{CommandRequest, ScanCommand};
use crate::scan::visit::stage_code;
use crate::scan::{Event, RecordedEvent, ScanState, TravelLimits};
use crate::series::{CameraFacts, RigFacts};
use crate::units::Angle;
use axis_motion::AxisMotion;
use motions::Motion;
use work::{Request, Work};

/// State of the rig for clients.
#[derive(Debug, Clone, PartialEq)]
pub struct RigView {
    /// Whether the stages answer.
    pub connected: bool,
    /// Code and message, if they do not.
    pub problem: Option<(String, String)>,
    /// Code and message of the last failed motion of a single axis; `None` once another motion starts.
    pub failure: Option<(String, String)>,
    /// Time scale of a simulated rig; `None` for a real one.
    pub simulated: Option<f64>,
    /// Port of the stages.
    pub port: String,
    /// Make and model of the camera.
    pub camera: String,
    /// Facts about the camera.
    pub camera_facts: CameraFacts,
    /// Facts about the geometry.
    pub rig_facts: RigFacts,
    /// Camera tilt, then sample azimuth.
    pub axes: [(AxisName, AxisView); 2],
    /// Current activity.
    pub activity: RigActivity,
    /// Scan that holds the rig.
    pub scan_id: Option<i64>,
    /// Controllers that answer instead of those of the rig and were refused.
    pub refused_stages: Option<StageIdentity>,
    /// State of that scan and the reason for it.
    pub scan_state: Option<(ScanState, Option<String>)>,
}

/// State of one axis.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisView {
    /// Current position; `None` if the stage does not answer.
    pub position: Option<Angle>,
    /// Whether it moves; `None` if the stage does not answer and may be moving.
    pub moving: Option<bool>,
    /// Whether it is referenced.
    pub homed: bool,
    /// Warnings as text.
    pub warnings: Vec<String>,
    /// Serial number.
    pub serial: Option<u32>,
    /// Least position.
    pub limit_min: Angle,
    /// Greatest position.
    pub limit_max: Angle,
}

impl RigSide {
    /// Returns why the rig's owner does not answer: the daemon ends, or the owner panicked.
    fn gone(&self) -> LabError {
        let owner = self.owner.lock().expect("no holder of this lock panics");
        match owner.as_ref() {
            Some(_) => LabError::Panicked,
            None => LabError::Stopping,
        }
    }
}

impl Lab {
    /// Reads the state of the rig from the stages. Connects a rig that is neither connected nor in use.
    ///
    /// # Errors
    /// [`LabError::NoRig`]; a stage that does not answer is part of the view.
    pub async fn rig(&self) -> Result<RigView, LabError> {
        let side = self.side()?;
        if side.requests.is_closed() {
            return Err(side.gone());
        }
        let stage = match side.access.stage() {
            Some(stage) => Ok(stage),
            None => self.connect().await,
        };
        let status = match stage {
            Ok(stage) => stage.status().await.map_err(LabError::Stage),
            Err(error) => Err(error),
        };
        let occupation = side.occupation.borrow().clone();
        // A scan that has ended is about to return the rig.
        let holds = occupation.activity.is_some();
        let scan_id = occupation.scan_id.filter(|_| holds);
        // From memory: a person looks here also while the store does not answer.
        let waits = side.sink.waits();
        let scan_state = scan_id.and(occupation.scan_state);
        let scan_state = scan_state.map(|(state, reason)| (state, waits.or(reason)));
        let (status, problem) = match status {
            Ok(status) => (Some(status), None),
            Err(LabError::Busy { .. }) => {
                let lost = || {
                    let lost = side.access.loss()?;
                    Some((stage_code(&lost).to_owned(), lost.to_string()))
                };
                let problem = match (&scan_state, &occupation.problem) {
                    // A scan that lost its stages waits for the operator and states the reason itself.
                    (Some((ScanState::Paused, Some(reason))), Some((_, why))) if why == reason => {
                        Some(("scan-paused".to_owned(), reason.clone()))
                    }
                    // A scan may be paused for another reason than its stages.
                    (_, Some(problem)) => Some(problem.clone()),
                    (_, None) => lost(),
                };
                (None, problem)
            }
            Err(error) => (None, Some((error.code().to_owned(), error.to_string()))),
        };
        let axes = AxisName::ALL.map(|name| {
            let limits = match name {
                AxisName::ThetaC => &side.stage_settings.theta_c,
                AxisName::PhiS => &side.stage_settings.phi_s,
            };
            let axis = status.as_ref().map(|status| status.axis(name));
            let view = AxisView {
                position: axis.map(|a| a.position),
                moving: axis.map(|a| a.moving),
                homed: axis.is_some_and(|a| a.homed),
                warnings: axis.map(|a| a.warnings.clone()).unwrap_or_default(),
                serial: axis.map(|a| a.serial),
                limit_min: limits.limit_min,
                limit_max: limits.limit_max,
            };
            (name, view)
        });
        Ok(RigView {
            connected: status.is_some(),
            problem,
            failure: occupation.failure,
            simulated: side.settings.simulated,
            port: match side.access.stage() {
                Some(stage) => stage.address().to_string(),
                None => side.port.clone(),
            },
            refused_stages: side.access.refused(),
            camera: side.camera.clone(),
            camera_facts: side.settings.camera.clone(),
            rig_facts: side.settings.rig.clone(),
            axes,
            activity: match (occupation.activity, &status) {
                (Some(activity), _) => activity,
                (None, Some(_)) => RigActivity::Idle,
                (None, None) => RigActivity::NotConnected,
            },
            scan_id,
            scan_state,
        })
    }

    /// Reads the positions while an axis moves, as an event that is not stored; `None` while both axes are at rest, while the
    /// rig is not in use, and if the stages do not answer.
    pub async fn in_motion(&self) -> Option<RecordedEvent> {
        let side = self.side().ok()?;
        let activity = side.occupation.borrow().activity?;
        let status = side.access.stage()?.status().await.ok()?;
        let of = |axis: &AxisStatus| match axis.homed {
            true => AxisEvent::at(axis.position),
            false => AxisEvent::UNKNOWN,
        };
        (status.theta_c.moving || status.phi_s.moving).then(|| {
            let event = Event::Rig {
                activity,
                theta_c: of(&status.theta_c),
                phi_s: of(&status.phi_s),
            };
            RecordedEvent::unrecorded(self.clock().utc(), event)
        })
    }

    /// Whether the task that owns the rig works; true for a daemon without a rig.
    #[must_use]
    pub fn rig_has_an_owner(&self) -> bool {
        let side = self.inner.rig.as_ref();
        side.is_none_or(|side| !side.requests.is_closed())
    }

    /// Returns the travel limits of the axes.
    ///
    /// # Errors
    /// [`LabError::NoRig`].
    pub fn limits(&self) -> Result<TravelLimits, LabError> {
        let settings = &self.side()?.stage_settings;
        Ok(TravelLimits {
            theta_c: (settings.theta_c.limit_min, settings.theta_c.limit_max),
            phi_s: (settings.phi_s.limit_min, settings.phi_s.limit_max),
        })
    }

    pub(super) async fn request(&self, work: Work) -> Result<(), LabError> {
        let (reply, answer) = oneshot::channel();
        let side = self.side()?;
        let stops = side.access.stops();
        side.requests
            .send(Request {
                work,
                who: Arc::clone(&self.who),
                stops,
                reply,
            })
            .await
            .map_err(|_| side.gone())?;
        let answer = answer.await.map_err(|_| side.gone())?;
        match answer {
            Err(LabError::Busy {
                with: Holder::Scan { scan_id, .. },
            }) => {
                let now = side.occupation.borrow();
                let of_scan = now.scan_id == Some(scan_id);
                let known = now.scan_state.as_ref().filter(|_| of_scan);
                let state = known.map(|(state, _)| *state);
                let with = Holder::Scan { scan_id, state };
                Err(LabError::Busy { with })
            }
            other => other,
        }
    }

    async fn connect(&self) -> Result<Stage, LabError> {
        self.request(Work::Connect).await?;
        let stage = self.side()?.access.stage();
        stage.ok_or(LabError::Busy {
            with: Holder::Connecting,
        })
    }

    /// Connects the stages if they are not connected.
    ///
    /// # Errors
    /// [`LabError::NoRig`], [`LabError::Busy`], or [`LabError::Stage`].
    pub async fn have_rig(&self) -> Result<(), LabError> {
        self.request(Work::Connect).await
    }

    /// Starts a motion and returns its number, just before a stage moves.
    pub(super) async fn begin_motion(&self, motion: AxisMotion) -> Result<i64, LabError> {
        let side = self.side()?;
        let now_ns = side.sink.clock.utc().unix_timestamp_nanos();
        let id = side
            .motions
            .add(i64::try_from(now_ns / 1000).unwrap_or_default());
        let number = Some(id);
        match self.request(Work::Motion { motion, number }).await {
            Ok(()) => Ok(id),
            Err(error) => {
                side.motions.forget(id);
                Err(error)
            }
        }
    }

    /// Starts to move both axes; returns the number of the motion, just before a stage moves. They move at the same time, or
    /// one after the other where only this is free of forbidden regions. An axis without a target stays where it is.
    ///
    /// # Errors
    /// As [`Lab::move_axis`]; [`LabError::Invalid`] without a target.
    pub async fn move_rig(
        &self,
        theta_c: Option<Angle>,
        phi_s: Option<Angle>,
    ) -> Result<i64, LabError> {
        let finite = |target: Option<Angle>, field: &str| match target {
            Some(angle) if !angle.is_finite() => Err(invalid(field, "must be a finite number")),
            _ => Ok(()),
        };
        finite(theta_c, "theta_c_deg")?;
        finite(phi_s, "phi_s_deg")?;
        match (theta_c, phi_s) {
            (Some(theta_c), Some(phi_s)) => {
                let target = Pose { theta_c, phi_s };
                self.begin_motion(AxisMotion::MoveBoth { target }).await
            }
            (Some(theta_c), None) => self.move_axis(AxisName::ThetaC, theta_c).await,
            (None, Some(phi_s)) => self.move_axis(AxisName::PhiS, phi_s).await,
            (None, None) => Err(invalid(
                "theta_c_deg",
                "is missing; expected theta_c_deg, phi_s_deg or both",
            )),
        }
    }

    /// Returns a motion, once it has ended or after a time; `None` if it is not remembered.
    ///
    /// # Errors
    /// [`LabError::NoRig`].
    pub async fn motion(&self, id: i64, wait: Duration) -> Result<Option<Motion>, LabError> {
        Ok(self.side()?.motions.once_ended(id, wait).await)
    }

    /// Starts to move an axis; returns the number of the motion, just before the stage moves.
    ///
    /// # Errors
    /// [`LabError::Busy`], [`LabError::NoRig`], or [`LabError::Stage`], also for a position outside the limits.
    pub async fn move_axis(&self, axis: AxisName, target: Angle) -> Result<i64, LabError> {
        if !target.is_finite() {
            return Err(invalid("position_deg", "must be a finite number"));
        }
        self.begin_motion(AxisMotion::Move { axis, target }).await
    }

    /// Starts to home an axis; returns the number of the motion, just before the stage moves.
    ///
    /// # Errors
    /// As [`Lab::move_axis`].
    pub async fn home(&self, axis: AxisName) -> Result<i64, LabError> {
        self.begin_motion(AxisMotion::Home { axis }).await
    }

    /// Starts to home both axes, in the order of the settings; returns the number of the motion, just before a stage moves.
    ///
    /// # Errors
    /// As [`Lab::move_axis`].
    pub async fn home_both(&self) -> Result<i64, LabError> {
        self.begin_motion(AxisMotion::HomeBoth).await
    }

    /// Unparks an axis that another program parked; it keeps its position. Nothing moves.
    ///
    /// # Errors
    /// [`LabError::Busy`], [`LabError::NoRig`], or [`LabError::Stage`].
    pub async fn unpark(&self, axis: AxisName) -> Result<(), LabError> {
        self.request(Work::Unpark { axis }).await
    }

    /// Stops both axes at once, also during a scan, which pauses. Never refused; connects first if there is no link.
    ///
    /// # Errors
    /// [`LabError::NotStopped`] if the stages could not be reached; then they may be moving.
    pub async fn stop(&self) -> Result<(), LabError> {
        let side = self.side()?;
        side.access.forbid_unasked_motion();
        self.inner.queue.halt();
        let orders = side.occupation.borrow().orders.clone();
        if let Some(orders) = orders {
            let (reply, _) = oneshot::channel();
            let slip = CommandRequest {
                command: ScanCommand::Stop,
                reply,
            };
            // Sent before the stages stop, so that the scan does not start its next motion. A full channel already holds
            // orders.
            orders.try_send(slip).ok();
        }
        let stopped = side.access.stop().await;
        let event = match &stopped {
            Ok(()) => Event::Rig {
                activity: RigActivity::Stopped,
                theta_c: AxisEvent::UNKNOWN,
                phi_s: AxisEvent::UNKNOWN,
            },
            Err(error) => Event::Alarm {
                code: stage_code(error).into(),
                message: not_stopped(error),
                scan_id: side.occupation.borrow().scan_id,
            },
        };
        // Recorded behind the answer, which must not wait for the database.
        side.sink.report_by(&self.who, event);
        stopped.map_err(|source| LabError::NotStopped { source })
    }
}
