//! `/rig`: state of the rig, motions of one axis, and the stop, which is never refused.

use std::time::Duration;

use axum::Json;
use axum::extract::{Path, State};
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::Body;
use super::motions::about_to_move;
use super::status::{ApiError, Problem};
use super::{App, Begun};
use crate::lab::{AxisView, DeviceIdentity, JogRequest, JogView, LabError, RigView, StageIdentity};
use crate::scan::ScanState;
use crate::units::Angle;

/// Where motions of single axes can be followed.
const RIG: &str = "/api/v1/rig";

/// What the rig is doing.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Activity {
    /// Accepts commands.
    Idle,
    /// An axis moves.
    Moving,
    /// An axis homes.
    Homing,
    /// A scan runs.
    Scanning,
    /// A paused scan holds the rig.
    Paused,
    /// The stages do not answer, and nothing is running.
    NotConnected,
}

/// State of the rig.
#[derive(Debug, Serialize, ToSchema)]
pub struct RigBody {
    /// Whether the stages answer.
    connected: bool,
    /// Why the stages do not answer; null if they do.
    problem: Option<RigProblem>,
    /// Why the last motion of an axis failed; null if it succeeded or another one has started.
    failure: Option<RigProblem>,
    /// Whether the rig is simulated.
    simulated: bool,
    /// Protocol and port.
    description: String,
    /// The camera.
    camera: CameraBody,
    /// Speed of a simulated rig relative to real time; 1 for a real rig.
    time_scale: f64,
    /// The two axes.
    axes: AxesBody,
    /// What the rig is doing: idle (accepts commands), moving, homing, scanning, paused (a paused scan holds the rig) or
    /// not-connected (the stages do not answer and nothing is running).
    activity: Activity,
    /// Scan that holds the rig.
    scan_id: Option<i64>,
    /// State of that scan.
    scan_state: Option<ScanState>,
    /// Reason for that state, if there is one.
    scan_reason: Option<String>,
    /// Controllers that answer instead of those of the rig; null if there are none. `accept-stages` accepts them.
    refused_stages: Option<StagesBody>,
    /// Positions of lamp and camera.
    geometry: GeometryBody,
}

/// Two controllers.
#[derive(Debug, Serialize, ToSchema)]
pub struct StagesBody {
    /// The controller of the camera tilt.
    theta_c: ControllerBody,
    /// The controller of the sample azimuth.
    phi_s: ControllerBody,
}

/// A controller.
#[derive(Debug, Serialize, ToSchema)]
pub struct ControllerBody {
    /// Serial number.
    serial: String,
    /// The manufacturer's product number.
    device_id: u32,
    /// Firmware version.
    firmware: String,
}

impl From<StageIdentity> for StagesBody {
    fn from(stages: StageIdentity) -> Self {
        let of = |device: DeviceIdentity| ControllerBody {
            serial: device.serial.to_string(),
            device_id: device.device_id,
            firmware: device.firmware,
        };
        StagesBody {
            theta_c: of(stages.theta_c),
            phi_s: of(stages.phi_s),
        }
    }
}

/// What is wrong with the stages.
#[derive(Debug, Serialize, ToSchema)]
pub struct RigProblem {
    /// Stable word.
    code: String,
    /// Cause and remedy.
    detail: String,
}

/// The camera.
#[derive(Debug, Serialize, ToSchema)]
pub struct CameraBody {
    /// Make and model.
    description: String,
    /// Columns of a frame, px.
    width_px: u32,
    /// Rows of a frame, px.
    height_px: u32,
    /// Resolution of the converter, bit.
    bit_depth: u32,
    /// Count at which a pixel is full, DN.
    saturation_dn: f64,
    /// Default exposure times of a plan, s.
    exposures_s: Vec<f64>,
}

/// Both axes.
#[derive(Debug, Serialize, ToSchema)]
pub struct AxesBody {
    /// Camera tilt θc.
    theta_c: AxisBody,
    /// Sample azimuth φs.
    phi_s: AxisBody,
}

/// One axis.
#[derive(Debug, Serialize, ToSchema)]
pub struct AxisBody {
    /// Position read from the controller, degrees; null if the stage does not answer. Not a position of the axis while
    /// `referenced` is false.
    position_deg: Option<f64>,
    /// Whether `position_deg` counts from the reference position. False until the axis is homed.
    referenced: bool,
    /// Whether it moves; null if the stage does not answer, so that it may move.
    moving: Option<bool>,
    /// Whether the axis has a reference position.
    homed: bool,
    /// Warnings of the controller: code and meaning.
    warnings: Vec<String>,
    /// Serial number of the device; null if unknown.
    serial: Option<String>,
    /// Lowest position allowed, degrees.
    limit_min_deg: f64,
    /// Highest position allowed, degrees.
    limit_max_deg: f64,
}

/// Positions of lamp and camera.
#[derive(Debug, Serialize, ToSchema)]
pub struct GeometryBody {
    /// Angle between lamp and camera, degrees.
    theta_l_deg: f64,
    /// Azimuth of the lamp about the camera's axis, degrees: 0 in the tilt plane, 90 perpendicular to it.
    light_azimuth_deg: f64,
    /// Added to a recorded φs it gives the azimuth of the lean direction v, degrees.
    azimuth_zero_deg: f64,
    /// Angular radius of the lamp seen from the sample, degrees; null for a point.
    light_angular_radius_deg: Option<f64>,
    /// Angular radius of the lens's pupil seen from the sample, degrees; null for a point.
    lens_angular_radius_deg: Option<f64>,
    /// Wavelength of the lamp, nm; null if not stated.
    wavelength_nm: Option<f64>,
}

/// Returns degrees without the rounding error of the conversion to radians.
fn degrees(angle: Angle) -> f64 {
    (angle.deg() * 1e10).round() / 1e10
}

impl From<&AxisView> for AxisBody {
    fn from(axis: &AxisView) -> Self {
        AxisBody {
            position_deg: axis.position.map(degrees),
            referenced: axis.homed,
            moving: axis.moving,
            homed: axis.homed,
            warnings: axis.warnings.clone(),
            serial: axis.serial.map(|s| s.to_string()),
            limit_min_deg: degrees(axis.limit_min),
            limit_max_deg: degrees(axis.limit_max),
        }
    }
}

impl From<RigView> for RigBody {
    fn from(view: RigView) -> Self {
        use crate::scan::event::RigActivity;
        let [(_, theta_c), (_, phi_s)] = &view.axes;
        let camera = &view.camera_facts;
        let bit_depth = camera.bit_depth.unwrap_or(16).min(16);
        let (scan_state, scan_reason) = match view.scan_state {
            Some((state, reason)) => (Some(state), reason),
            None => (None, None),
        };
        RigBody {
            connected: view.connected,
            problem: view
                .problem
                .map(|(code, detail)| RigProblem { code, detail }),
            failure: view
                .failure
                .map(|(code, detail)| RigProblem { code, detail }),
            simulated: view.simulated.is_some(),
            description: format!("Zaber ASCII on {}", view.port),
            time_scale: view.simulated.unwrap_or(1.0),
            axes: AxesBody {
                theta_c: theta_c.into(),
                phi_s: phi_s.into(),
            },
            activity: match view.activity {
                RigActivity::Idle | RigActivity::Stopped => Activity::Idle,
                RigActivity::NotConnected => Activity::NotConnected,
                RigActivity::Moving => Activity::Moving,
                RigActivity::Homing => Activity::Homing,
                RigActivity::Scanning if scan_state == Some(ScanState::Paused) => Activity::Paused,
                RigActivity::Scanning => Activity::Scanning,
            },
            scan_id: view.scan_id,
            scan_state,
            scan_reason,
            refused_stages: view.refused_stages.map(StagesBody::from),
            geometry: GeometryBody {
                theta_l_deg: view.rig_facts.theta_l_deg,
                light_azimuth_deg: view.rig_facts.light_azimuth_deg,
                azimuth_zero_deg: view.rig_facts.azimuth_zero_deg,
                light_angular_radius_deg: view.rig_facts.light_angular_radius_deg,
                lens_angular_radius_deg: view.rig_facts.lens_angular_radius_deg,
                wavelength_nm: view.rig_facts.wavelength_nm,
            },
            camera: CameraBody {
                description: view.camera,
                width_px: camera.width_px,
                height_px: camera.height_px,
                bit_depth,
                saturation_dn: camera
                    .saturation_dn
                    .unwrap_or_else(|| f64::from((1_u32 << bit_depth) - 1)),
                exposures_s: camera.exposures_s.clone(),
            },
        }
    }
}

/// Target of a motion.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MoveBody {
    /// Absolute position to move to, degrees.
    #[schema(minimum = -36_000, maximum = 36_000)]
    position_deg: f64,
}

/// A jog of one axis.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JogBody {
    /// `theta_c` or `phi_s`.
    #[schema(pattern = "^(theta_c|phi_s)$", max_length = 7)]
    axis: String,
    /// Speed and direction, degrees per second: positive upwards, 0 to end the jog. A greater speed than that of the axis
    /// is limited to it.
    #[schema(minimum = -1000, maximum = 1000)]
    speed_deg_s: f64,
    /// Number of the jog to renew or end; omitted to begin one.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    jog: Option<u64>,
}

/// The controllers to accept.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AcceptStagesBody {
    /// Serial number of the controller of the camera tilt.
    #[schema(max_length = 20)]
    theta_c_serial: String,
    /// Serial number of the controller of the sample azimuth.
    #[schema(max_length = 20)]
    phi_s_serial: String,
}

/// State of the rig now.
#[utoipa::path(get, path = "/api/v1/rig", tag = "rig", responses(
    (status = 200, description = "The rig now; `connected` is false if the stages do not answer", body = RigBody),
    (status = 503, description = "This daemon has no rig", body = Problem),
))]
pub(super) async fn get_rig(State(app): State<App>) -> Result<Json<RigBody>, ApiError> {
    Ok(Json(app.lab.rig().await?.into()))
}

/// Move one axis to an absolute position.
#[utoipa::path(post, path = "/api/v1/rig/axes/{axis}/move", tag = "rig", params(("axis" = String, Path, description = "theta_c or phi_s")),
    request_body = MoveBody, responses(
    (status = 202, description = "The axis is about to move; `id` is the number of the motion", body = Begun),
    (status = 404, description = "There is no such axis", body = Problem),
    (status = 409, description = "The rig is busy, a stop was requested first (`stopped`), or the axis has no reference (`stage-not-referenced`): home it first", body = Problem),
    (status = 422, description = "The position is outside the travel", body = Problem),
    (status = 503, description = "The stages are not available", body = Problem),
))]
pub(super) async fn move_axis(
    Caller(app): Caller,
    Path(axis): Path<String>,
    Body(body): Body<MoveBody>,
) -> Result<Response, ApiError> {
    let target = Angle::from_deg(body.position_deg);
    let moved = app.lab.move_axis(axis_of(&axis)?, target).await;
    let id = moved.map_err(|error| ApiError::from(error).of_field("position_deg"))?;
    Ok(about_to_move(RIG, "moving", id))
}

/// Home one axis.
#[utoipa::path(post, path = "/api/v1/rig/axes/{axis}/home", tag = "rig", params(("axis" = String, Path, description = "theta_c or phi_s")), responses(
    (status = 202, description = "The axis is about to move; `id` is the number of the motion", body = Begun),
    (status = 404, description = "There is no such axis", body = Problem),
    (status = 409, description = "The rig is busy, or a stop was requested first (`stopped`)", body = Problem),
    (status = 503, description = "The stages are not available", body = Problem),
))]
pub(super) async fn home_axis(
    Caller(app): Caller,
    Path(axis): Path<String>,
) -> Result<Response, ApiError> {
    let id = app.lab.home(axis_of(&axis)?).await?;
    Ok(about_to_move(RIG, "homing", id))
}

/// Home both axes, in the order of the settings (`[stage.homing]`).
#[utoipa::path(post, path = "/api/v1/rig/home", tag = "rig", responses(
    (status = 202, description = "The axes are about to move; `id` is the number of the motion", body = Begun),
    (status = 409, description = "The rig is busy, or a stop was requested first (`stopped`)", body = Problem),
    (status = 503, description = "The stages are not available", body = Problem),
))]
pub(super) async fn home_both(Caller(app): Caller) -> Result<Response, ApiError> {
    let id = app.lab.home_both().await?;
    Ok(about_to_move(RIG, "homing", id))
}

/// Unpark an axis that another program parked. It keeps its position and does not move. Homing also unparks.
#[utoipa::path(post, path = "/api/v1/rig/axes/{axis}/unpark", tag = "rig", params(("axis" = String, Path, description = "theta_c or phi_s")), responses(
    (status = 200, description = "The axis is not parked", body = Begun),
    (status = 404, description = "There is no such axis", body = Problem),
    (status = 409, description = "The rig is busy", body = Problem),
    (status = 503, description = "The stages are not available, or cannot be parked", body = Problem),
))]
pub(super) async fn unpark_axis(
    Caller(app): Caller,
    Path(axis): Path<String>,
) -> Result<Json<Begun>, ApiError> {
    app.lab.unpark(axis_of(&axis)?).await?;
    Ok(Json(Begun {
        id: None,
        state: "unparked".into(),
    }))
}

/// Time after which a stop is answered, also where the stages do not answer.
const STOP_ANSWER: Duration = Duration::from_millis(900);

/// Begin, renew or end a jog. The axis moves while the jog is renewed at least every 0.5 s, and stops by itself when it is
/// not. It stays within its limits and outside the forbidden regions. Each jog has a number: after a stop, a renewal with
/// the old number starts nothing.
#[utoipa::path(post, path = "/api/v1/rig/jog", tag = "rig", request_body = JogBody, responses(
    (status = 200, description = "The axis moves, or has stopped where `ended` is true", body = JogView),
    (status = 409, description = "The rig is busy, the jog has ended (`jog-ended`), or the axis has no reference (`stage-not-referenced`)", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
    (status = 503, description = "The stages are not available", body = Problem),
))]
pub(super) async fn jog(
    Caller(app): Caller,
    Body(body): Body<JogBody>,
) -> Result<Json<JogView>, ApiError> {
    let axis = body.axis.parse().map_err(|_| {
        ApiError::invalid(
            "axis",
            format!("is {:?}, expected theta_c or phi_s", body.axis),
        )
    })?;
    let request = JogRequest {
        axis,
        speed_deg_s: body.speed_deg_s,
        jog: body.jog,
    };
    Ok(Json(app.lab.jog(request).await?))
}

/// Accept the controllers that answer instead of those of the rig. They are named, so that no others are accepted that were
/// connected in the meantime. Nothing moves; a scan that waits may then be resumed.
#[utoipa::path(post, path = "/api/v1/rig/accept-stages", tag = "rig", request_body = AcceptStagesBody, responses(
    (status = 200, description = "These controllers belong to the rig from now on", body = StagesBody),
    (status = 409, description = "Other controllers answer (`other-stages`)", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
    (status = 503, description = "This daemon has no rig", body = Problem),
))]
pub(super) async fn accept_stages(
    Caller(app): Caller,
    Body(body): Body<AcceptStagesBody>,
) -> Result<Json<StagesBody>, ApiError> {
    let serial = |field: &str, text: &str| {
        text.parse::<u32>()
            .map_err(|_| ApiError::invalid(field, format!("is {text:?}, expected a serial number")))
    };
    let serials = [
        serial("theta_c_serial", &body.theta_c_serial)?,
        serial("phi_s_serial", &body.phi_s_serial)?,
    ];
    Ok(Json(app.lab.accept_stages(serials).await?.into()))
}

/// Path of the preview.
pub(super) const PREVIEW: &str = "/api/v1/rig/preview";
/// Path of the stop.
pub(super) const STOP: &str = "/api/v1/rig/stop";

/// Stop both axes at once. Never refused; a running scan pauses. A body and an `Idempotency-Key`
/// are ignored: each request stops.
#[utoipa::path(post, path = "/api/v1/rig/stop", tag = "rig", responses(
    (status = 200, description = "The stages confirmed the stop", body = Begun),
    (status = 503, description = "The stages could not be reached, or have not confirmed the stop within 0.9 s (`stop-unconfirmed`), and may be moving: use the hardware emergency switch", body = Problem),
))]
pub(super) async fn stop(Caller(app): Caller) -> Result<Json<Begun>, ApiError> {
    // The stop is executed even if the client disconnects at once.
    let stop = tokio::spawn(async move { app.lab.stop().await });
    match tokio::time::timeout(STOP_ANSWER, stop).await {
        Ok(stopped) => stopped.expect("a stop does not panic")?,
        // The task repeats the stop until the stages answer or their link is lost.
        Err(_) => return Err(LabError::StopUnconfirmed.into()),
    }
    Ok(Json(Begun {
        id: None,
        state: "stopped".into(),
    }))
}

fn axis_of(word: &str) -> Result<crate::lab::AxisName, ApiError> {
    word.parse().map_err(|_| {
        ApiError::not_found(format!(
            "there is no axis `{word}`; expected theta_c or phi_s"
        ))
    })
}
