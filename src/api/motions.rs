//! `/rig/move` and `/rig/moves`: moves of both axes in one order, and waiting until the rig has arrived.

use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{Body, Id, Params};
use super::status::{self, ApiError, Problem};
use super::{App, Begun};
use crate::lab::{Motion, MotionState};
use crate::units::Angle;

/// Longest time to wait for a motion, s.
const WAIT_S_MAX: f64 = 60.0;

/// Targets of a motion; an axis without one stays where it is.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct MoveRigBody {
    /// Camera tilt θc to move to, degrees.
    #[serde(default)]
    #[schema(minimum = -36_000, maximum = 36_000)]
    theta_c_deg: Option<f64>,
    /// Sample azimuth φs to move to, degrees.
    #[serde(default)]
    #[schema(minimum = -36_000, maximum = 36_000)]
    phi_s_deg: Option<f64>,
}

/// A motion.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct MotionBody {
    /// Number of the motion.
    id: i64,
    /// State of the motion.
    state: MotionState,
    /// Camera tilt θc read back at its end, degrees; null before, and where the stage did not answer.
    theta_c_deg: Option<f64>,
    /// Sample azimuth φs read back at its end, degrees.
    phi_s_deg: Option<f64>,
    /// Why it failed.
    problem: Option<MotionProblem>,
}

/// Why a motion failed.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct MotionProblem {
    /// Stable word for programs.
    code: String,
    /// Cause and remedy.
    detail: String,
}

impl From<Motion> for MotionBody {
    fn from(motion: Motion) -> Self {
        MotionBody {
            id: motion.id,
            state: motion.state,
            theta_c_deg: motion.pose.map(|pose| pose.theta_c.deg()),
            phi_s_deg: motion.pose.map(|pose| pose.phi_s.deg()),
            problem: motion
                .problem
                .map(|(code, detail)| MotionProblem { code, detail }),
        }
    }
}

/// How long to wait.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct MotionParams {
    /// Answer once the motion has ended, or after this time, s.
    #[param(minimum = 0, maximum = 60)]
    wait_s: Option<f64>,
}

/// Returns 202 for a motion that is about to start.
pub(super) fn about_to_move(location: &str, state: &str, id: i64) -> Response {
    let body = Begun {
        id: Some(id),
        state: state.into(),
    };
    status::accepted(location, body)
}

/// Move both axes, or one, to absolute positions. Wait for the motion with `GET /api/v1/rig/moves/{id}?wait_s=30`.
#[utoipa::path(post, path = "/api/v1/rig/move", tag = "rig", request_body = MoveRigBody, responses(
    (status = 202, description = "The axes are about to move; `id` is the number of the motion", body = Begun,
        headers(("Location" = String, description = "The motion"))),
    (status = 409, description = "The rig is busy, a stop was requested first (`stopped`), or an axis has no reference (`stage-not-referenced`): home it first", body = Problem),
    (status = 422, description = "A position is outside the travel, or the way enters a forbidden region", body = Problem),
    (status = 503, description = "The stages are not available", body = Problem),
))]
pub(super) async fn move_rig(
    Caller(app): Caller,
    Body(body): Body<MoveRigBody>,
) -> Result<Response, ApiError> {
    let [theta_c, phi_s] = [body.theta_c_deg, body.phi_s_deg].map(|deg| deg.map(Angle::from_deg));
    let id = app.lab.move_rig(theta_c, phi_s).await?;
    let location = format!("/api/v1/rig/moves/{id}");
    Ok(about_to_move(&location, "moving", id))
}

/// A motion: whether it moves, has arrived, was stopped or failed. The daemon remembers the last 64.
#[utoipa::path(get, path = "/api/v1/rig/moves/{id}", tag = "rig", params(MotionParams, ("id" = i64, Path, description = "Number of the motion")), responses(
    (status = 200, description = "The motion", body = MotionBody),
    (status = 404, description = "There is no such motion, or it was long ago", body = Problem),
    (status = 503, description = "This daemon has no rig", body = Problem),
))]
pub(super) async fn motion(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<MotionParams>,
) -> Result<Json<MotionBody>, ApiError> {
    let wait_s = params.wait_s.unwrap_or(0.0);
    if !(0.0..=WAIT_S_MAX).contains(&wait_s) {
        return Err(ApiError::invalid("wait_s", "must be 0 to 60"));
    }
    let motion = app.lab.motion(id, Duration::from_secs_f64(wait_s)).await?;
    let motion = motion.ok_or_else(|| {
        ApiError::not_found(format!(
            "there is no motion {id}; the daemon remembers the last 64"
        ))
    })?;
    Ok(Json(motion.into()))
}
