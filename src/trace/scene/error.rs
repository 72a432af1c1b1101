//! Why a scene cannot be traced; the messages name the key.

use crate::material::tables::MaterialError;
use crate::trace::surfaces::surface_profile::ProfileError;
use crate::wording::{significant, stated};

/// Why a scene cannot be traced.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error("the scene is invalid: {0}")]
    Text(String),
    /// The scene has no interface.
    #[error("the scene has no interface: add at least one [[interface]]")]
    NoInterface,
    /// A value is invalid.
    #[error("{key} = {value}: {expected}")]
    Value {
        /// The key with its place.
        key: String,
        /// The value.
        value: String,
        /// The expected values.
        expected: &'static str,
    },
    /// A key that the shape requires is missing.
    #[error("interface {number} ({shape}) needs the key {key}")]
    Missing {
        /// 1 for the topmost.
        number: usize,
        /// Its shape.
        shape: String,
        /// The key.
        key: &'static str,
    },
    /// A key that the shape does not have.
    #[error("interface {number} ({shape}) has no key {key}")]
    Foreign {
        /// 1 for the topmost.
        number: usize,
        /// Its shape.
        shape: String,
        /// The key.
        key: &'static str,
    },
    /// The material is invalid.
    #[error("interface {number}: {source}")]
    Material {
        /// 1 for the topmost.
        number: usize,
        /// The cause.
        source: MaterialError,
    },
    /// The profile is invalid.
    #[error("interface {number}: {source}")]
    Profile {
        /// 1 for the topmost.
        number: usize,
        /// The cause.
        source: ProfileError,
    },
    /// The file of heights cannot be used.
    #[error("interface {number}: {path}: {reason}")]
    File {
        /// 1 for the topmost.
        number: usize,
        /// The file.
        path: String,
        /// The cause.
        reason: String,
    },
    /// A layer absorbs too strongly.
    #[error(
        "interface {number}: below.k = {k} is more than a tenth of n = {n}: a layer's k must be at most {} (0.1 n); a medium that \
         is opaque within a wavelength must be the last",
        significant(*.limit)
    )]
    Opaque {
        /// 1 for the topmost.
        number: usize,
        /// Real part of its index.
        n: f64,
        /// Imaginary part.
        k: f64,
        /// The largest imaginary part of a layer.
        limit: f64,
    },
    /// Layers below a metal cannot be reached.
    #[error(
        "interface {number} is a metal or a diffuse body: it transmits no light, so it must be the last"
    )]
    Unreachable {
        /// 1 for the topmost.
        number: usize,
    },
}

/// The error of an invalid value, with the expected values.
pub(super) fn value(
    key: &str,
    value: impl std::fmt::Display,
    expected: &'static str,
) -> SceneError {
    /// Longer numbers are a row of digits without meaning.
    const DIGITS_MAX: usize = 20;
    let text = value.to_string();
    SceneError::Value {
        key: key.to_owned(),
        value: match text.parse() {
            Ok(number) if text.len() > DIGITS_MAX => stated(number),
            _ => text,
        },
        expected,
    }
}

/// Refuses values that are not above 0.
pub(super) fn positive(key: &str, x: f64) -> Result<(), SceneError> {
    if x > 0.0 && x.is_finite() {
        Ok(())
    } else if x == f64::INFINITY {
        Err(value(key, x, "must be a finite number"))
    } else {
        Err(value(key, x, "must be greater than 0"))
    }
}
