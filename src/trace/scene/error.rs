//! Why a scene cannot be traced, in words that name the key.

use crate::material::tables::MaterialError;
use crate::trace::profile::ProfileError;
use crate::wording::significant;

/// Why a scene cannot be traced.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error("the scene cannot be read: {0}")]
    Text(String),
    /// Nothing to trace.
    #[error("the scene has no interface: add at least one [[interface]]")]
    NoInterface,
    /// A value that makes no sense.
    #[error("{key} = {value}: {expected}")]
    Value {
        /// The key with its place.
        key: String,
        /// What it is.
        value: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A key that the shape needs.
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
    /// A material.
    #[error("interface {number}: {source}")]
    Material {
        /// 1 for the topmost.
        number: usize,
        /// Why.
        source: MaterialError,
    },
    /// A profile.
    #[error("interface {number}: {source}")]
    Profile {
        /// 1 for the topmost.
        number: usize,
        /// Why.
        source: ProfileError,
    },
    /// A file of heights.
    #[error("interface {number}: {path}: {reason}")]
    File {
        /// 1 for the topmost.
        number: usize,
        /// The file.
        path: String,
        /// Why it cannot be used.
        reason: String,
    },
    /// A layer that lets nothing through.
    #[error(
        "interface {number}: below.k = {k} is more than a tenth of n = {n}: a layer keeps k to {} (0.1 n) at most, and a medium that \
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
    /// Layers below a metal are never reached.
    #[error(
        "interface {number} is a metal or a diffuse body: nothing gets through, so it must be the last"
    )]
    Unreachable {
        /// 1 for the topmost.
        number: usize,
    },
}

/// A value that the key may not have, and what it may be.
pub(super) fn value(
    key: &str,
    value: impl std::fmt::Display,
    expected: &'static str,
) -> SceneError {
    SceneError::Value {
        key: key.to_owned(),
        value: value.to_string(),
        expected,
    }
}

/// Refuses what is not above 0.
pub(super) fn positive(key: &str, x: f64) -> Result<(), SceneError> {
    if x > 0.0 && x.is_finite() {
        Ok(())
    } else if x == f64::INFINITY {
        Err(value(key, x, "must be a finite number"))
    } else {
        Err(value(key, x, "must be greater than 0"))
    }
}
