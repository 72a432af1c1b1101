//! What a job looks like to a client: the fields that all kinds share, and those of its result.

use std::borrow::Cow;
use std::marker::PhantomData;

use serde::Serialize;
use serde_json::Value;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{
    KnownFormat, Object, ObjectBuilder, Ref, Schema, SchemaFormat, Type,
};
use utoipa::{PartialSchema, ToSchema};

use crate::contrast::ContrastReport;
use crate::fit::VariantChoice;
use crate::fit::report::FitReport;
use crate::forecast::Forecast;
use crate::job::JobState;
use crate::judge::VerdictReport;
use crate::lab::{FitRequest, JobProgress, TraceResult};
use crate::map::summary::Summary;
use crate::trace::report::TraceReport;

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
    /// Number of the part of that scan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_id: Option<i64>,
    /// Name of that part.
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

/// The result of a kind of job, for the description.
pub(super) trait JobResult: ToSchema {
    /// Name of a job with this result.
    const NAME: &'static str;
    /// Name of its request.
    const REQUEST: &'static str;
    /// What such a job is.
    const DESCRIPTION: &'static str;
}

impl JobResult for FitReport {
    const NAME: &'static str = "Fit";
    const REQUEST: &'static str = "FitRequest";
    const DESCRIPTION: &'static str =
        "A fit: its request and its state; from `status` on its report, once it has completed";
}

impl JobResult for Summary {
    const NAME: &'static str = "Map";
    const REQUEST: &'static str = "MapRequest";
    const DESCRIPTION: &'static str =
        "A map: its request and its state, and the object of `map --json`, once it has completed";
}

impl JobResult for ContrastReport {
    const NAME: &'static str = "Contrast";
    const REQUEST: &'static str = "ContrastRequest";
    const DESCRIPTION: &'static str = "A contrast: its request and its state, and the object of `contrast --json`, once it has completed";
}

impl JobResult for VerdictReport {
    const NAME: &'static str = "Verdict";
    const REQUEST: &'static str = "VerdictRequest";
    const DESCRIPTION: &'static str = "A verdict: its request and its state, and the object of `judge --json`, once it has completed";
}

impl JobResult for TraceReport {
    const NAME: &'static str = "Trace";
    const REQUEST: &'static str = "TraceRequest";
    const DESCRIPTION: &'static str = "A trace: its request and its state, and the object of `trace --json`, once it has completed";
}

/// A job with the fields of its result, none of which is there before it has completed.
pub(super) struct WithResult<R>(PhantomData<R>);

/// A map as it is sent.
pub(super) type MapBody = WithResult<Summary>;
/// A contrast as it is sent.
pub(super) type ContrastBody = WithResult<ContrastReport>;
/// A verdict as it is sent.
pub(super) type VerdictBody = WithResult<VerdictReport>;

impl<R: JobResult> WithResult<R> {
    fn object() -> Object {
        let mut all = Vec::new();
        R::schemas(&mut all);
        let mut job = Object::new();
        let mut known = vec![("Job".to_owned(), JobBody::schema())];
        known.append(&mut all);
        add_fields(&mut job, &JobBody::schema(), &known);
        job.required = required(&JobBody::schema());
        add_fields(&mut job, &R::schema(), &known);
        // Reports that state no time get that of the job.
        job.properties
            .entry("seconds".to_owned())
            .or_insert_with(|| {
                let seconds = ObjectBuilder::new()
                    .schema_type(Type::Number)
                    .format(Some(SchemaFormat::KnownFormat(KnownFormat::Double)))
                    .description(Some("Run time, s"));
                seconds.into()
            });
        let request = Ref::from_schema_name(R::REQUEST);
        job.properties.insert("request".into(), request.into());
        job.description = Some(R::DESCRIPTION.into());
        job
    }
}

/// Adds the fields of a schema, those of flattened parts among them, unless there is one of that name.
fn add_fields(to: &mut Object, of: &RefOr<Schema>, known: &[(String, RefOr<Schema>)]) {
    match of {
        RefOr::T(Schema::Object(object)) => {
            for (name, field) in &object.properties {
                to.properties
                    .entry(name.clone())
                    .or_insert_with(|| field.clone());
            }
        }
        RefOr::T(Schema::AllOf(parts)) => {
            for part in &parts.items {
                add_fields(to, part, known);
            }
        }
        RefOr::T(_) => {}
        RefOr::Ref(reference) => {
            let is_it = |name: &str| reference.ref_location.rsplit('/').next() == Some(name);
            if let Some((_, schema)) = known.iter().find(|(name, _)| is_it(name)) {
                add_fields(to, schema, known);
            }
        }
    }
}

fn required(of: &RefOr<Schema>) -> Vec<String> {
    match of {
        RefOr::T(Schema::Object(object)) => object.required.clone(),
        _ => Vec::new(),
    }
}

impl<R: JobResult> PartialSchema for WithResult<R> {
    fn schema() -> RefOr<Schema> {
        RefOr::T(Schema::Object(Self::object()))
    }
}

impl<R: JobResult> ToSchema for WithResult<R> {
    fn name() -> Cow<'static, str> {
        R::NAME.into()
    }

    fn schemas(all: &mut Vec<(String, RefOr<Schema>)>) {
        JobBody::schemas(all);
        R::schemas(all);
    }
}

/// A fit as it is sent, for the description.
pub(super) struct FitBody;

impl PartialSchema for FitBody {
    fn schema() -> RefOr<Schema> {
        let mut fit = WithResult::<FitReport>::object();
        let variant = Ref::from_schema_name("VariantChoice");
        fit.properties.insert("variant".into(), variant.into());
        // A fit always has a scan, and with it a part.
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
                "Number of its part",
            ),
            ("sample_name", Type::String, None, "Name of its part"),
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
        FitReport::NAME.into()
    }

    fn schemas(all: &mut Vec<(String, RefOr<Schema>)>) {
        WithResult::<FitReport>::schemas(all);
        FitRequest::schemas(all);
        for (name, schema) in [
            (FitRequest::name(), FitRequest::schema()),
            (VariantChoice::name(), VariantChoice::schema()),
        ] {
            all.push((name.into(), schema));
        }
    }
}

/// A trace as it is sent, for the description: its report, and what the daemon adds to it.
pub(super) struct TraceBody;

impl PartialSchema for TraceBody {
    fn schema() -> RefOr<Schema> {
        let mut trace = WithResult::<TraceReport>::object();
        add_fields(&mut trace, &TraceResult::schema(), &[]);
        RefOr::T(Schema::Object(trace))
    }
}

impl ToSchema for TraceBody {
    fn name() -> Cow<'static, str> {
        TraceReport::NAME.into()
    }

    fn schemas(all: &mut Vec<(String, RefOr<Schema>)>) {
        WithResult::<TraceReport>::schemas(all);
        TraceResult::schemas(all);
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
