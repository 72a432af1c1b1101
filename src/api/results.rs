//! `/results`: one short row per scan, for lists, searches and tables.

use axum::Json;
use axum::body::Body as AnswerBody;
use axum::extract::{FromRequestParts, Query, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use futures::stream::{self, StreamExt as _};
use serde::Serialize;
use serde_json::Value;
use utoipa::openapi::path::{Parameter, ParameterBuilder, ParameterIn};
use utoipa::openapi::schema::{
    ArrayBuilder, KnownFormat, ObjectBuilder, Schema, SchemaFormat, SchemaType, Type,
};
use utoipa::openapi::{RefOr, Required};

use super::App;
use super::status::{ApiError, Problem};
use crate::store::Store;
use crate::store::results::{
    ARCHIVED, COLUMNS, Column, GENERAL, Kind, LIMIT_MAX, OF_THE_PAGE, QueryError, ResultFormat,
    ResultPages, ResultQuery, ResultRow, csv_header, parameters,
};

/// The parameters of a query of results, read from the list of columns.
pub(super) struct ResultParams(ResultQuery);

impl<S: Send + Sync> FromRequestParts<S> for ResultParams {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let query = Query::<Vec<(String, String)>>::from_request_parts(parts, state).await;
        let Query(all) = query.map_err(|refusal| ApiError::bad_request(refusal.body_text()))?;
        let all = all
            .iter()
            .map(|(name, text)| (name.as_str(), text.as_str()));
        ResultQuery::read(all).map(ResultParams).map_err(refused)
    }
}

/// Refuses a query by the name of the parameter.
pub(super) fn refused(error: QueryError) -> ApiError {
    match error {
        QueryError::Unknown(detail) => ApiError::bad_request(detail),
        QueryError::Invalid { name, problem } => ApiError::invalid(name, problem),
    }
}

impl utoipa::IntoParams for ResultParams {
    fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
        described(|_| true).collect()
    }
}

/// Returns the parameters that select rows, without those of the page.
pub(super) fn filters() -> impl Iterator<Item = Parameter> {
    described(|name| !OF_THE_PAGE.contains(&name))
}

fn described(is_wanted: fn(&str) -> bool) -> impl Iterator<Item = Parameter> {
    let wanted = parameters()
        .into_iter()
        .filter(move |(name, _)| is_wanted(name));
    wanted.flat_map(|(name, column)| match column {
        None => vec![general(name)],
        Some(column) => of_column(column),
    })
}

pub(super) fn parameter(name: String, about: String, schema: ObjectBuilder) -> Parameter {
    ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Query)
        .required(Required::False)
        .description(Some(about))
        .schema(Some(Schema::Object(schema.build())))
        .build()
}

fn general(name: &'static str) -> Parameter {
    let about = GENERAL.iter().find(|(known, _)| *known == name);
    let about = about.map_or("", |(_, about)| about);
    let schema = ObjectBuilder::new();
    let words = |words: &[&str]| {
        let schema = ObjectBuilder::new().schema_type(Type::String);
        schema.enum_values(Some(words.iter().copied()))
    };
    let schema = match name {
        "latest" | "count" => schema.schema_type(Type::Boolean),
        "limit" => schema
            .schema_type(Type::Integer)
            .minimum(Some(1))
            .maximum(Some(LIMIT_MAX)),
        "format" => words(&["json", "csv"]),
        _ => schema.schema_type(Type::String),
    };
    parameter(name.to_owned(), about.to_owned(), schema)
}

/// The filters of a column.
fn of_column(column: &Column) -> Vec<Parameter> {
    let Column { name, about, .. } = column;
    let mut list = Vec::new();
    match column.kind {
        Kind::Text => list.push(parameter(
            (*name).to_owned(),
            format!("{about}: rows with this text; empty: rows without one"),
            ObjectBuilder::new().schema_type(Type::String),
        )),
        Kind::Word(words) => list.push(parameter(
            (*name).to_owned(),
            format!(
                "{about}: rows with one of these words, separated by commas: {}; empty: rows without one",
                words.join(", ")
            ),
            ObjectBuilder::new().schema_type(Type::String),
        )),
        Kind::Id => list.push(parameter(
            (*name).to_owned(),
            format!("{about}: rows with this number"),
            of_kind(column.kind),
        )),
        Kind::Flag => list.push(parameter(
            (*name).to_owned(),
            match *name {
                ARCHIVED => format!("{about}: true, false or all; false if omitted"),
                _ => format!("{about}: true or false"),
            },
            ObjectBuilder::new()
                .schema_type(Type::String)
                .enum_values(Some(["true", "false", "all"])),
        )),
        Kind::Tags => list.push(parameter(
            (*name).to_owned(),
            format!("{about}: rows with this tag; empty: rows without tags"),
            ObjectBuilder::new().schema_type(Type::String),
        )),
        Kind::Real { .. } | Kind::Time => {}
    }
    if column.kind.has_range() {
        for (end, words) in [("min", "at least"), ("max", "at most")] {
            list.push(parameter(
                format!("{name}_{end}"),
                format!("{about}: {words} this"),
                of_kind(column.kind),
            ));
        }
    }
    list
}

fn type_of(kind: Kind) -> (Type, Option<SchemaFormat>) {
    let (schema, format) = match kind {
        Kind::Flag => (Type::Boolean, None),
        Kind::Id => (Type::Integer, Some(KnownFormat::Int64)),
        Kind::Real { .. } => (Type::Number, Some(KnownFormat::Double)),
        Kind::Text | Kind::Word(_) | Kind::Time | Kind::Tags => (Type::String, None),
    };
    (schema, format.map(SchemaFormat::KnownFormat))
}

fn of_kind(kind: Kind) -> ObjectBuilder {
    let (schema, format) = type_of(kind);
    ObjectBuilder::new().schema_type(schema).format(format)
}

/// Any column may have no value.
fn of_kind_or_null(kind: Kind) -> ObjectBuilder {
    let (schema, format) = type_of(kind);
    let schema = SchemaType::from_iter([schema, Type::Null]);
    ObjectBuilder::new().schema_type(schema).format(format)
}

/// A row, for the description.
pub(super) struct ResultRowBody;

impl utoipa::PartialSchema for ResultRowBody {
    fn schema() -> RefOr<Schema> {
        let mut row = ObjectBuilder::new().description(Some(
            "A scan with its newest fit and verdict. Without `fields`, a row has the columns up to `ended_at` that a list needs and \
             at most 600 bytes: texts that are too long for it are shortened. Uncertainties have three significant digits, values \
             end at the same decimal; /fits/{id} has all digits",
        ));
        for column in COLUMNS {
            if column.kind == Kind::Tags {
                let text = ObjectBuilder::new().schema_type(Type::String);
                let list = ArrayBuilder::new().items(RefOr::T(Schema::Object(text.build())));
                let list = list.description(Some(column.about));
                row = row.property(column.name, Schema::Array(list.build()));
                continue;
            }
            let field = of_kind_or_null(column.kind).description(Some(column.about));
            let field = match column.kind {
                Kind::Word(words) => {
                    let words = words.iter().map(|word| Value::from(*word));
                    field.enum_values(Some(words.chain([Value::Null])))
                }
                _ => field,
            };
            row = row.property(column.name, Schema::Object(field.build()));
        }
        let shortened = ObjectBuilder::new()
            .schema_type(Type::Boolean)
            .description(Some(
                "True where texts of the row are shortened and end with `…`; `fields=usual` sends them whole. Omitted otherwise",
            ));
        row = row.property("shortened", Schema::Object(shortened.build()));
        RefOr::T(row.build().into())
    }
}

impl utoipa::ToSchema for ResultRowBody {
    fn name() -> std::borrow::Cow<'static, str> {
        "Result".into()
    }
}

/// A page of results.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ResultsBody<T> {
    /// The rows of this page.
    items: Vec<T>,
    /// `cursor` of the next page; null at the end.
    next_cursor: Option<String>,
    /// Number of all rows that the filters select, if `count` asks for it.
    #[serde(skip_serializing_if = "Option::is_none")]
    count: Option<i64>,
}

/// Results: one row per scan (per region of a part that has several), newest first, with the newest completed fit and the
/// newest verdict. Every column is a filter. A cursor stays valid while rows are added.
#[utoipa::path(get, path = "/api/v1/results", tag = "results", params(ResultParams), responses(
    (status = 200, description = "A page of results; as CSV all rows, or `limit` of them",
        content((ResultsBody<ResultRowBody> = "application/json"), (String = "text/csv"))),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn list(
    State(app): State<App>,
    headers: HeaderMap,
    ResultParams(query): ResultParams,
) -> Result<Response, ApiError> {
    let format = query.format.unwrap_or_else(|| accepted(&headers));
    match format {
        ResultFormat::Json => page(app.lab.store(), &query).await,
        ResultFormat::Csv => Ok(table(app.lab.store().clone(), query)),
    }
}

/// The form that the header Accept prefers: CSV only where it is named before JSON.
fn accepted(headers: &HeaderMap) -> ResultFormat {
    let accept = headers.get_all(header::ACCEPT).into_iter();
    let texts = accept.filter_map(|value| value.to_str().ok());
    let mut kinds = texts
        .flat_map(|text| text.split(','))
        .map(|kind| kind.split(';').next().unwrap_or_default().trim());
    let first = kinds.find(|kind| ["text/csv", "application/json"].contains(kind));
    match first {
        Some("text/csv") => ResultFormat::Csv,
        _ => ResultFormat::Json,
    }
}

async fn page(store: &Store, query: &ResultQuery) -> Result<Response, ApiError> {
    let count = async {
        match query.count {
            true => store.count_results(query).await.map(Some),
            false => Ok(None),
        }
    };
    let (page, count) = tokio::try_join!(store.results(query), count)?;
    let object = |row| match query.brief {
        true => ResultRow::brief(row, &query.fields),
        false => ResultRow::object(row, &query.fields),
    };
    let body = ResultsBody {
        items: page.rows.iter().map(object).collect(),
        next_cursor: page.next_cursor,
        count,
    };
    Ok(Json(&body).into_response())
}

/// Sends the rows page by page, so that a long table needs little memory.
fn table(store: Store, query: ResultQuery) -> Response {
    let head = csv_header(&query.fields);
    let rows = stream::try_unfold(ResultPages::new(store, query), ResultPages::next_lines);
    let lines = stream::once(async { Ok(head) }).chain(rows);
    let headers = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8"),
        (
            header::CONTENT_DISPOSITION,
            "attachment; filename=\"results.csv\"",
        ),
    ];
    (headers, AnswerBody::from_stream(lines)).into_response()
}
