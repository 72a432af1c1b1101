//! What a job looks like to a client: the fields that all kinds share, and those of its result.

use std::borrow::Cow;

use serde::Serialize;
use serde_json::Value;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, Ref, Schema, SchemaFormat, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::fit::VariantChoice;
use crate::fit::report::FitReport;
use crate::forecast::Forecast;
use crate::job::JobState;
use crate::lab::{FitRequest, JobProgress};

/// A job with the fields of its result, once it has one.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Job)]
pub(super) struct JobBody {
    /// The result: the object that the command of that name prints with `--json`.
    #[serde(flatten)]
    #[schema(ignore)]
    pub result: Value,
    /// Number of the job within its kind.
    pub id: i64,
    /// Number of its scan; null without one.
    pub scan_id: Option<i64>,
    /// Number of the sample of that scan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_id: Option<i64>,
    /// Name of that sample.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_name: Option<String>,
    /// State of the job.
    pub state: JobState,
    /// The request, as it was accepted.
    #[schema(value_type = Object)]
    pub request: Value,
    /// Who started it: the name of a token, or `local`.
    pub who: String,
    /// When it was accepted, RFC 3339 in UTC.
    pub created_at: String,
    /// When it ended, RFC 3339 in UTC; null while it runs.
    pub ended_at: Option<String>,
    /// Its progress, while it runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub progress: Option<JobProgress>,
    /// The forecast made before it started.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forecast: Option<Forecast>,
    /// Why it has no result.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<JobError>,
}

/// Why a job has no result.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = FitError)]
pub(super) struct JobError {
    /// Stable word for programs.
    code: String,
    /// Cause and remedy.
    detail: String,
}

/// Returns a stored result in today's form: contrasts of older versions have their model error under the key of a job's
/// error.
pub(super) fn result_of_today(mut result: Value) -> Value {
    if let Some(error) = result
        .as_object_mut()
        .and_then(|fields| fields.remove("error"))
    {
        result["model_error"] = error;
    }
    result
}

impl JobError {
    /// Joins the two columns of the store.
    pub fn of(code: Option<String>, detail: Option<String>) -> Option<Self> {
        let (code, detail) = (code?, detail?);
        Some(JobError { code, detail })
    }
}

/// A fit as it is sent, for the description: the fields of its job, and those of its report once it has one.
pub(super) struct FitBody;

impl PartialSchema for FitBody {
    fn schema() -> RefOr<Schema> {
        let (RefOr::T(Schema::Object(mut fit)), RefOr::T(Schema::Object(report))) =
            (JobBody::schema(), FitReport::schema())
        else {
            unreachable!("structs are described as objects");
        };
        fit.description = Some(
            "A fit: its request and its state; from `status` on its report, once it has completed"
                .into(),
        );
        for (name, field) in report.properties {
            fit.properties.entry(name).or_insert(field);
        }
        for (name, schema) in [("request", "FitRequest"), ("variant", "VariantChoice")] {
            let field = Ref::from_schema_name(schema);
            fit.properties.insert(name.into(), field.into());
        }
        // A fit always has a scan, and with it a sample.
        for (name, kind, format, description) in [
            (
                "scan_id",
                Type::Integer,
                Some(KnownFormat::Int64),
                "Number of its scan",
            ),
            (
                "sample_id",
                Type::Integer,
                Some(KnownFormat::Int64),
                "Number of its sample",
            ),
            ("sample_name", Type::String, None, "Name of its sample"),
            (
                "seconds",
                Type::Number,
                Some(KnownFormat::Double),
                "Run time, s",
            ),
        ] {
            let field = ObjectBuilder::new()
                .schema_type(kind)
                .format(format.map(SchemaFormat::KnownFormat))
                .description(Some(description));
            fit.properties.insert(name.into(), field.into());
        }
        let always = ["scan_id", "sample_id", "sample_name", "variant"];
        fit.required.extend(always.map(String::from));
        RefOr::T(Schema::Object(fit))
    }
}

impl ToSchema for FitBody {
    fn name() -> Cow<'static, str> {
        "Fit".into()
    }

    fn schemas(all: &mut Vec<(String, RefOr<Schema>)>) {
        JobBody::schemas(all);
        FitReport::schemas(all);
        FitRequest::schemas(all);
        for (name, schema) in [
            (FitRequest::name(), FitRequest::schema()),
            (VariantChoice::name(), VariantChoice::schema()),
        ] {
            all.push((name.into(), schema));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_model_error_of_an_old_contrast_is_not_taken_for_the_error_of_its_job() {
        let old = json!({"lines": [], "error": {"value": 0.01, "of": "a contrast"}});
        let today = result_of_today(old);
        assert_eq!(
            today,
            json!({"lines": [], "model_error": {"value": 0.01, "of": "a contrast"}})
        );
        assert_eq!(result_of_today(today.clone()), today);
    }
}
