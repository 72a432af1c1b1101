//! `/charts` and `/due`: control charts of results, and what the settings ask to measure again at intervals.

use axum::Json;
use axum::extract::{FromRequestParts, Query, State};
use axum::http::request::Parts;
use serde::Serialize;
use utoipa::openapi::path::{Parameter, ParameterIn};
use utoipa::openapi::schema::{ObjectBuilder, Type};

use super::App;
use super::results::{filters, parameter, refused};
use super::status::{ApiError, Problem};
use crate::fit::report::Parameters;
use crate::lab::{self, ChartChoice, Due, ResultChart};
use crate::store::results::ResultQuery;

/// Longest name of a specification, in characters.
const NAME_LENGTH_MAX: usize = 200;

/// What is charted: a parameter, a specification, and the filters of results.
pub(super) struct ChartParams(ChartChoice);

impl<S: Send + Sync> FromRequestParts<S> for ChartParams {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let query = Query::<Vec<(String, String)>>::from_request_parts(parts, state).await;
        let Query(all) = query.map_err(|refusal| ApiError::bad_request(refusal.body_text()))?;
        let mut choice = ChartChoice::default();
        let mut given = [false; 2];
        let mut rest = Vec::new();
        for (name, text) in &all {
            let at = match name.as_str() {
                "parameter" => 0,
                "limits_of" => 1,
                name => {
                    rest.push((name, text.as_str()));
                    continue;
                }
            };
            if std::mem::replace(&mut given[at], true) {
                return Err(ApiError::invalid(name.as_str(), "is given twice"));
            }
            match at {
                0 => choice.parameter.clone_from(text),
                _ => choice.limits_of = Some(text.clone()),
            }
        }
        choice.filters = ResultQuery::read_filters(rest).map_err(refused)?;
        Ok(ChartParams(choice))
    }
}

impl utoipa::IntoParams for ChartParams {
    fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
        let text = || ObjectBuilder::new().schema_type(Type::String);
        let own = [
            parameter(
                "parameter".to_owned(),
                "Key of the parameter; `theta_r_deg` if omitted".to_owned(),
                text().enum_values(Some(Parameters::NAMES)),
            ),
            parameter(
                "limits_of".to_owned(),
                "Name of the specification whose limits are beside the chart; empty for none. If omitted, that of the filter \
                 `specification`, or else the only one of the newest verdicts"
                    .to_owned(),
                text().max_length(Some(NAME_LENGTH_MAX)),
            ),
        ];
        own.into_iter().chain(filters()).collect()
    }
}

/// What is measured again at intervals.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct DueBody {
    /// Check standard and references, due or not; empty where the settings state no interval.
    #[schema(max_items = 2)]
    items: Vec<Due>,
}

/// The control chart of a parameter over the newest 1000 results that the filters select: individual values and moving ranges
/// (I-MR), values beyond the control limits (Western Electric rule 1) and runs of eight on one side of the mean; beside it the
/// limits of a specification, and what is due.
#[utoipa::path(get, path = "/api/v1/charts", tag = "results", params(ChartParams), responses(
    (status = 200, description = "The chart", body = ResultChart),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn chart(
    State(app): State<App>,
    ChartParams(choice): ChartParams,
) -> Result<Json<ResultChart>, ApiError> {
    let (lab, now) = (&app.lab, app.lab.clock().utc());
    Ok(Json(
        lab::chart(lab.store(), &choice, lab.due_settings(), now).await?,
    ))
}

/// Check standard and references that the settings (`[due]`) ask to measure again at intervals, due or not.
#[utoipa::path(get, path = "/api/v1/due", tag = "results", responses(
    (status = 200, description = "What is measured again, and when it is due", body = DueBody),
))]
pub(super) async fn due(State(app): State<App>) -> Result<Json<DueBody>, ApiError> {
    let items = app.lab.due().await?;
    Ok(Json(DueBody { items }))
}
