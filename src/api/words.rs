//! What stands in a body as one of few words, and what is no text at all, as the description has them. The words are
//! those that are sent, so a program made from the description knows every one.

use serde::Serialize;
use serde_json::json;
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type};
use utoipa::openapi::{RefOr, schema::SchemaType};
use utoipa::{PartialSchema, ToSchema};

use crate::fit::report::{ReferencePlane, Status, VariantName};
use crate::frame::FrameKind as Kind;
use crate::job::JobState as Job;
use crate::scan::{OperatorAction as Action, ScanState as State};

/// Bytes of a file.
pub(super) struct Binary;

impl PartialSchema for Binary {
    fn schema() -> RefOr<Schema> {
        let object = ObjectBuilder::new()
            .schema_type(SchemaType::Type(Type::String))
            .format(Some(SchemaFormat::KnownFormat(KnownFormat::Binary)));
        RefOr::T(object.build().into())
    }
}

impl ToSchema for Binary {
    fn name() -> std::borrow::Cow<'static, str> {
        "Binary".into()
    }
}

/// A schema that allows the words of these values.
fn words<T: Serialize>(all: impl IntoIterator<Item = T>, told: &str) -> RefOr<Schema> {
    let object = ObjectBuilder::new()
        .schema_type(SchemaType::Type(Type::String))
        .description(Some(told))
        .enum_values(Some(all.into_iter().map(|one| json!(one))));
    RefOr::T(object.build().into())
}

/// Describes an enumeration by all its values.
macro_rules! described {
    ($($name:ident of $all:expr, $told:literal;)*) => {$(
        #[doc = $told]
        pub(super) struct $name;

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                words($all, $told)
            }
        }

        impl ToSchema for $name {
            fn name() -> std::borrow::Cow<'static, str> {
                stringify!($name).into()
            }
        }
    )*};
}

described! {
    ScanState of State::ALL, "Where a scan stands.";
    TaskState of Job::ALL, "Where a fit, map, contrast, verdict or trace stands.";
    FitStatus of Status::ALL, "How a fit ended.";
    FitReferencePlane of ReferencePlane::ALL, "The plane that angles refer to.";
    FitVariantName of VariantName::ALL, "A variant of the model.";
    FrameKind of Kind::ALL, "What a frame shows.";
    OperatorAction of Action::ALL, "What a person has to do at the rig.";
}
