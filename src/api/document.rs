//! The OpenAPI document.
//!
//! A test makes it from the handlers and compares it with the file that the program serves. [`complete`] adds what all routes
//! share: keys, ids, parameters and bodies.

use std::collections::HashMap;
use std::io::Read as _;
use std::sync::LazyLock;

use axum::http::Method;
use flate2::read::GzDecoder;
use serde::{Deserialize, Serialize};
use serde_json::ser::PrettyFormatter;
use serde_json::{Serializer, Value};
use utoipa::openapi::path::{Operation, Parameter, ParameterBuilder, ParameterIn};
use utoipa::openapi::response::{Response, ResponseBuilder};
use utoipa::openapi::schema::{
    AdditionalProperties, KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type,
};
use utoipa::openapi::security::{
    ApiKey, ApiKeyValue, HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme,
};
use utoipa::openapi::{Content, ContentBuilder, OpenApi, Ref, RefOr, Required};
use utoipa::{OpenApi as _, PartialSchema, ToSchema};

use super::authentication::cookie_name;
use super::keys::{KEY_LENGTH_MAX, UNKEYED};
use super::lease::LEASE_HEADER;
use super::need::Need;
use super::routes::Document;
use super::status::PROBLEM_JSON;
use super::table;

/// Returns the document as it is served: pretty-printed JSON.
#[must_use]
pub fn openapi() -> &'static str {
    static UNPACKED: LazyLock<String> = LazyLock::new(|| {
        let packed = include_bytes!(concat!(env!("OUT_DIR"), "/openapi.json.gz"));
        let mut text = String::new();
        GzDecoder::new(&packed[..])
            .read_to_string(&mut text)
            .expect("the build packed this text");
        text
    });
    &UNPACKED
}

/// Returns the document made from the handlers, pretty-printed. [`openapi`] is this text.
#[must_use]
pub fn openapi_of_handlers() -> String {
    let mut document = Document::openapi();
    complete(&mut document);
    let mut json = Vec::new();
    let formatter = PrettyFormatter::with_indent(b" ");
    let written = document.serialize(&mut Serializer::with_formatter(&mut json, formatter));
    written.expect("a document of text is JSON");
    json.push(b'\n');
    String::from_utf8(json).expect("JSON is UTF-8")
}

/// Bytes of a file.
pub(super) struct Binary;

impl PartialSchema for Binary {
    fn schema() -> RefOr<Schema> {
        let object = ObjectBuilder::new()
            .schema_type(Type::String)
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)));
        RefOr::T(object.build().into())
    }
}

impl ToSchema for Binary {
    fn name() -> std::borrow::Cow<'static, str> {
        "Binary".into()
    }
}

/// Adds the answers of the guards and the extractors to each route that they apply to.
fn complete(document: &mut OpenApi) {
    close_kinds(document, "MaterialBody");
    for (name, request) in [
        ("ReportedFit", "FitRequest"),
        ("ReportedVerdict", "VerdictRequest"),
    ] {
        refer(document, name, "request", request);
    }
    list_codes(document);
    add_security_schemes(document);
    let mut examples: HashMap<String, Example> =
        serde_json::from_str(EXAMPLES).expect("a test reads the examples");
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in [
            (Method::GET, &mut item.get),
            (Method::POST, &mut item.post),
            (Method::PATCH, &mut item.patch),
            (Method::DELETE, &mut item.delete),
        ] {
            if let Some(operation) = operation {
                let name = method.as_str().to_lowercase();
                operation.operation_id = Some(operation_id(&name, path));
                let example = examples.remove(&format!("{method} {path}"));
                add_examples(operation, example.unwrap_or_default());
                state_access(operation, table::need(&method, Some(path)));
            }
        }
        let begins = item.post.is_some() && !UNKEYED.contains(&path.as_str());
        if begins && let Some(operation) = &mut item.post {
            operation.parameters.get_or_insert_default().push(key());
        }
        let asks = item.get.iter_mut().map(|get| (get, false));
        let writes = [&mut item.post, &mut item.patch, &mut item.delete];
        let does = writes.into_iter().flatten().map(|write| (write, true));
        for (operation, does) in asks.chain(does) {
            let has = |place: &ParameterIn| {
                let all = operation.parameters.iter().flatten();
                all.filter_map(described).any(|p| &p.parameter_in == place)
            };
            let query = has(&ParameterIn::Query);
            if path.contains("{id}") {
                answers(operation, "400", "The id is not a whole number");
            }
            if query || !does {
                answers(operation, "400", "There is no such parameter");
            }
            if query {
                answers(operation, "422", "A value is not valid");
            }
            answers(
                operation,
                "403",
                "The request names another host than this machine (`forbidden-host`), comes from another page \
                 (`forbidden-origin`) or past the proxy (`not-by-proxy`), or needs another role (`role-too-low`)",
            );
            // A body is read even if the route does not need one.
            if does {
                answers(operation, "400", "The body cannot be read");
                answers(operation, "408", "The body did not arrive in time");
                answers(operation, "413", "The body is too large");
                answers(operation, "415", "`Content-Type` is not `application/json`");
            }
            if operation.request_body.is_some() {
                answers(operation, "422", "A value is not valid");
            }
            if begins && has_key(operation) {
                answers(
                    operation,
                    "422",
                    "The Idempotency-Key was used for another request",
                );
            }
            // The answer to a key is kept, so these routes write.
            if does && has_key(operation) {
                answers(
                    operation,
                    "503",
                    "The store cannot be written (`store-locked`, `disk-silent`, `data-folder-gone`)",
                );
                answers(operation, "507", "The disk is full (`disk-full`)");
            }
            for response in operation.responses.responses.values_mut() {
                name_problem(response);
            }
        }
    }
}

/// Bodies and answers by route, as a simulated rig gives them; of lists the first entries.
const EXAMPLES: &str = include_str!("examples.json");

/// The body and the answer of a route.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Example {
    #[serde(default)]
    request: Option<Value>,
    #[serde(default)]
    answer: Option<Value>,
}

/// Adds the examples of a route to its body and to the JSON of its success.
fn add_examples(operation: &mut Operation, example: Example) {
    let show = |content: &mut Content, example: &Value| content.example = Some(example.clone());
    if let (Some(RefOr::T(body)), Some(request)) = (&mut operation.request_body, &example.request)
        && let Some(RefOr::T(content)) = body.content.get_mut(JSON)
    {
        show(content, request);
    }
    let Some(answer) = example.answer else {
        return;
    };
    for (status, response) in &mut operation.responses.responses {
        if let (true, RefOr::T(response)) = (status.starts_with('2'), response)
            && let Some(RefOr::T(content)) = response.content.get_mut(JSON)
        {
            show(content, &answer);
        }
    }
}

/// Describes the two ways to present a token.
fn add_security_schemes(document: &mut OpenApi) {
    let components = document.components.get_or_insert_default();
    let bearer = HttpBuilder::new()
        .scheme(HttpAuthScheme::Bearer)
        .description(Some("A token of `ridged token create`"));
    components.add_security_scheme(BEARER, SecurityScheme::Http(bearer.build()));
    let cookie = ApiKeyValue::with_description(
        cookie_name(true),
        "Set by a login (`POST /api/v1/session`); over plain HTTP its name is `ridged-session`. A write also needs `Origin`, \
         `Sec-Fetch-Site: same-origin` or the header `Ridged-Request`",
    );
    let cookie = SecurityScheme::ApiKey(ApiKey::Cookie(cookie));
    components.add_security_scheme(COOKIE, cookie);
}

/// States which role a route needs, and its refusals.
fn state_access(operation: &mut Operation, need: Need) {
    let open = SecurityRequirement::default();
    let Some(role) = need.role() else {
        operation.security = Some(vec![open]);
        return;
    };
    let scheme = |name: &str| SecurityRequirement::new(name, Vec::<String>::new());
    // On loopback no token is needed, unless the settings ask for one.
    operation.security = Some(vec![scheme(BEARER), scheme(COOKIE), open]);
    let words = match need {
        Need::Stop => "Needs any token; none on the daemon's machine.".to_owned(),
        Need::Rig => format!(
            "Needs the role {role}, and that no other caller holds the rig; the header `Ridged-Lease` presents a lease."
        ),
        Need::Nothing | Need::Role(_) => format!("Needs the role {role}."),
    };
    let description = operation
        .description
        .take()
        .map(|text| format!("{text}\n\n"));
    operation.description = Some(description.unwrap_or_default() + &words);
    answers(
        operation,
        "401",
        "There is no valid token (`no-token`, `wrong-token`)",
    );
    answers(
        operation,
        "429",
        "Too many wrong tokens (`too-many-guesses`)",
    );
    if need == Need::Rig {
        answers(
            operation,
            "409",
            "Another caller holds the rig (`lease-held`), or the lease has ended (`lease-lost`)",
        );
        let lease = ParameterBuilder::new()
            .name(LEASE_HEADER)
            .parameter_in(ParameterIn::Header)
            .required(Required::False)
            .description(Some("The `id` of a lease (`POST /api/v1/lease`)"))
            .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
            .build();
        operation
            .parameters
            .get_or_insert_default()
            .push(lease.into());
    }
}

const BEARER: &str = "token";
const COOKIE: &str = "session";

/// Returns a unique name of an operation, for generated clients: the method and the words of the path.
fn operation_id(method: &str, path: &str) -> String {
    let words = path
        .strip_prefix("/api/v1")
        .unwrap_or(path)
        .split(['/', '.']);
    let words = words.map(|word| match word.strip_prefix('{') {
        Some(parameter) => format!("by_{}", parameter.trim_end_matches('}')),
        None => word.to_owned(),
    });
    let words = words.filter(|word| !word.is_empty());
    [method.to_owned()]
        .into_iter()
        .chain(words)
        .collect::<Vec<_>>()
        .join("_")
}

/// Sets the media type of problems.
fn name_problem(response: &mut RefOr<Response>) {
    let RefOr::T(response) = response else {
        return;
    };
    let is_problem = response.content.get(JSON).is_some_and(|content| {
        let schema = match content {
            RefOr::T(content) => content.schema.as_ref(),
            RefOr::Ref(_) => None,
        };
        matches!(schema, Some(RefOr::Ref(schema)) if schema.ref_location.ends_with("/Problem"))
    });
    if is_problem && let Some(content) = response.content.shift_remove(JSON) {
        response.content.insert(PROBLEM_JSON.into(), content);
    }
}

/// Sets the schema of a field whose type this module knows and the field's does not.
fn refer(document: &mut OpenApi, name: &str, field: &str, to: &str) {
    let schemas = document.components.as_mut().map(|c| &mut c.schemas);
    if let Some(RefOr::T(schema)) = schemas.and_then(|all| all.get_mut(name)) {
        for object in objects(schema) {
            if let Some(found) = object.properties.get_mut(field) {
                *found = Ref::from_schema_name(to).into();
            }
        }
    }
}

/// The objects that a schema consists of.
fn objects(schema: &mut Schema) -> Vec<&mut utoipa::openapi::Object> {
    match schema {
        Schema::Object(object) => vec![object],
        Schema::AllOf(all) => {
            let parts = all.items.iter_mut().filter_map(|part| match part {
                RefOr::T(schema) => Some(schema),
                RefOr::Ref(_) => None,
            });
            parts.flat_map(objects).collect()
        }
        _ => Vec::new(),
    }
}

/// The table of all codes, for people.
const CODES: &str = include_str!("../../docs/reference/codes.md");

/// Returns the codes in the first column of the tables, sorted. A test of the documents compares the table with the source.
#[must_use]
pub fn codes() -> Vec<&'static str> {
    let rows = CODES.lines().filter_map(|line| line.strip_prefix("| `"));
    let cells = rows.filter_map(|row| row.split(" | ").next());
    let mut codes: Vec<&str> = cells
        .flat_map(|cell| cell.split(", "))
        .map(|code| code.trim_matches('`'))
        .collect();
    codes.sort_unstable();
    codes.dedup();
    codes
}

/// Lists the codes of a problem.
fn list_codes(document: &mut OpenApi) {
    let schemas = document.components.as_mut().map(|c| &mut c.schemas);
    if let Some(RefOr::T(problem)) = schemas.and_then(|all| all.get_mut("Problem")) {
        for object in objects(problem) {
            if let Some(RefOr::T(Schema::Object(code))) = object.properties.get_mut("code") {
                code.enum_values = Some(codes().into_iter().map(Into::into).collect());
            }
        }
    }
}

/// Closes the variants of a schema to other fields; the derive macro does so for structs only.
fn close_kinds(document: &mut OpenApi, name: &str) {
    let schemas = document.components.as_mut().map(|c| &mut c.schemas);
    let Some(RefOr::T(Schema::OneOf(kinds))) = schemas.and_then(|all| all.get_mut(name)) else {
        return;
    };
    for kind in &mut kinds.items {
        if let RefOr::T(Schema::Object(kind)) = kind {
            kind.additional_properties = Some(Box::new(AdditionalProperties::FreeForm(false)));
        }
    }
}

fn described(parameter: &RefOr<Parameter>) -> Option<&Parameter> {
    match parameter {
        RefOr::T(parameter) => Some(parameter),
        RefOr::Ref(_) => None,
    }
}

fn has_key(operation: &Operation) -> bool {
    let all = operation.parameters.iter().flatten();
    all.filter_map(described).any(|p| p.name == KEY)
}

/// Adds a problem to the answers, unless the route describes that status itself.
fn answers(operation: &mut Operation, status: &str, description: &str) {
    let problem = ContentBuilder::new()
        .schema(Some(Ref::from_schema_name("Problem")))
        .build();
    let response = ResponseBuilder::new()
        .description(description)
        .content(PROBLEM_JSON, problem)
        .build();
    operation
        .responses
        .responses
        .entry(status.into())
        .or_insert_with(|| response.into());
}

const JSON: &str = "application/json";
const KEY: &str = "Idempotency-Key";

fn key() -> RefOr<Parameter> {
    let text = ObjectBuilder::new()
        .schema_type(Type::String)
        .min_length(Some(1))
        .max_length(Some(KEY_LENGTH_MAX));
    ParameterBuilder::new()
        .name(KEY)
        .parameter_in(ParameterIn::Header)
        .required(Required::False)
        .description(Some(
            "A request with a key is executed once; sent again with the same key, it gets the first answer",
        ))
        .schema(Some(text))
        .build()
        .into()
}
