//! Files in a request: base64 content, and what the request's row stores of it.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};

use crate::heights;
use crate::heights::ridges::{self, MeasuredShape, Units};
use crate::lab::LabError;
use crate::store::frames::sha256_hex;
use crate::trace::scene::HeightMap;

/// Largest number of heights in a file, 2048 × 2048: no request may exhaust the memory of a daemon that drives a rig.
const HEIGHTS_MAX: usize = 1 << 22;

/// A file's content: base64 in a request; its size and hash in the stored request.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "String", into = "Fingerprint")]
pub struct Content(pub(in crate::lab) Vec<u8>);

/// Size and hash of a file.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[schema(as = FileFingerprint)]
pub(in crate::lab) struct Fingerprint {
    /// Number of its bytes.
    #[schema(minimum = 0, maximum = 8_388_608)]
    bytes: usize,
    /// SHA-256 of its bytes, hexadecimal.
    #[schema(max_length = 64)]
    sha256: String,
}

/// The content of a file as it is described: base64 in a request, and what is kept of it in the request of a job.
#[derive(utoipa::ToSchema)]
#[serde(untagged)]
#[schema(as = FileContent)]
#[expect(dead_code, reason = "it describes the field of a request")]
pub(in crate::lab) enum DescribedContent {
    /// Base64.
    Sent(String),
    /// Its size and hash.
    Kept(Fingerprint),
}

impl TryFrom<String> for Content {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let bytes = STANDARD.decode(text.trim());
        bytes
            .map(Content)
            .map_err(|e| format!("a file's content is base64 (RFC 4648, padded): {e}"))
    }
}

impl From<Content> for Fingerprint {
    fn from(content: Content) -> Self {
        Fingerprint {
            bytes: content.0.len(),
            sha256: sha256_hex(&content.0),
        }
    }
}

impl Content {
    /// Reads the heights; the extension of `name` states the format.
    pub(in crate::lab) fn heights(&self, name: &str) -> Result<HeightMap, String> {
        heights::read_within(name, &self.0, HEIGHTS_MAX)
    }
}

/// One number for both axes, or one for each.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(untagged, expecting = "one number, or a list of two, is expected")]
pub enum Pitch {
    /// Along rows and columns.
    Both(f64),
    /// Along the rows, along the columns.
    Each([f64; 2]),
}

/// The part's own shape, measured: a profile or a height map (see `docs/reference/height-maps.md`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShapeFile {
    /// Name; the extension states the format (csv, png, tif, x3p, sdf).
    #[schema(max_length = 200)]
    pub name: String,
    /// Content, base64.
    #[schema(value_type = DescribedContent)]
    pub content: Content,
    /// Spacing of samples, µm, if the file does not state it.
    #[serde(default)]
    pub pitch_um: Option<Pitch>,
    /// Micrometres per unit of height, if the file does not state it.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub height_unit_um: Option<f64>,
}

impl ShapeFile {
    /// Reads the ridges; for a map also the facts they come from.
    ///
    /// # Errors
    /// [`LabError::Invalid`] of `shape`.
    pub(in crate::lab) fn read(&self) -> Result<MeasuredShape, LabError> {
        let units = Units {
            pitch_um: match self.pitch_um {
                None => Vec::new(),
                Some(Pitch::Both(pitch)) => vec![pitch],
                Some(Pitch::Each(pitch)) => pitch.to_vec(),
            },
            height_unit_um: self.height_unit_um,
        };
        let map = self.content.heights(&self.name);
        map.and_then(|map| ridges::of(&map, &units).map_err(|e| e.to_string()))
            .map_err(|problem| LabError::Invalid {
                field: "shape".into(),
                problem: format!("{}: {problem}", self.name),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_is_sent_as_base64_and_stored_as_size_and_hash() {
        let content: Content = serde_json::from_str("\"MSwyCg==\"").unwrap();
        assert_eq!(content.0, b"1,2\n");
        assert_eq!(content.heights("a.csv").unwrap().columns, 2);
        // `printf '1,2\n' | sha256sum`
        let kept = serde_json::to_value(&content).unwrap();
        assert_eq!(kept["bytes"], 4);
        let sha256 = "52186c933993da4082b3cdc7c40bb4bf735b391ff54a2ef78c037dda6c38a680";
        assert_eq!(kept["sha256"], sha256);
        assert!(serde_json::from_str::<Content>("\"1,2\"").is_err());
    }

    #[test]
    fn an_error_names_the_fields_that_state_missing_units() {
        let shape = ShapeFile {
            name: "map.csv".to_owned(),
            content: Content(b"0,1,2\n0,1,2\n0,1,2\n".to_vec()),
            pitch_um: None,
            height_unit_um: None,
        };
        let error = shape.read().unwrap_err().to_string();
        assert!(
            error.contains("pitch_um") && error.contains("map.csv"),
            "{error}"
        );
    }
}
