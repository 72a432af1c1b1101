//! What a camera's program states about a frame: counter, start of the exposure, settings read back, camera, temperature.
//!
//! The program writes it as text chunks of the PNG (`tEXt`, or `iTXt` without compression) or as a JSON object beside the
//! frame. All keys are optional. A value that cannot be read is an error, so that no check is skipped silently.

use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Longest text of one value, bytes.
const TEXT_BYTES_MAX: usize = 256;

/// What a camera's program states about a frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct FrameTag {
    /// The camera's own count of frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counter: Option<u64>,
    /// Start of the exposure, UTC.
    #[serde(
        with = "time::serde::rfc3339::option",
        skip_serializing_if = "Option::is_none"
    )]
    pub exposure_start: Option<OffsetDateTime>,
    /// Exposure time read back from the camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_s: Option<f64>,
    /// Gain read back from the camera, in its own unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
    /// Serial number of the camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Temperature of the sensor, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
}

/// A value of a tag that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TagError {
    /// A value of the wrong form.
    #[error("{key} of the frame is {found:?}, expected {expected}; correct the camera's program")]
    BadValue {
        /// The key.
        key: &'static str,
        /// The value, shortened.
        found: String,
        /// The form expected.
        expected: &'static str,
    },
    /// Not a JSON object.
    #[error(
        "what is stated beside the frame is not a JSON object ({0}); correct the camera's program"
    )]
    NotAnObject(String),
}

impl FrameTag {
    /// Whether nothing is stated.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == FrameTag::default()
    }

    /// Reads the text chunks of a PNG that has been decoded without an error.
    ///
    /// # Errors
    /// [`TagError::BadValue`] for a known key.
    pub fn of_png(bytes: &[u8]) -> Result<FrameTag, TagError> {
        let mut tag = FrameTag::default();
        for (key, value) in texts(bytes) {
            tag.set(&key, value.trim())?;
        }
        Ok(tag)
    }

    /// Adds what a JSON object states; it takes precedence.
    ///
    /// # Errors
    /// [`TagError::NotAnObject`], or [`TagError::BadValue`] for a known key.
    pub fn with_json(mut self, text: &str) -> Result<FrameTag, TagError> {
        let values: serde_json::Map<String, serde_json::Value> =
            serde_json::from_str(text).map_err(|e| TagError::NotAnObject(e.to_string()))?;
        for (key, value) in values {
            match value {
                serde_json::Value::Null => {}
                serde_json::Value::String(text) => self.set(&key, text.trim())?,
                other => self.set(&key, &other.to_string())?,
            }
        }
        Ok(self)
    }

    /// Sets a value by its key; other keys are ignored.
    fn set(&mut self, key: &str, value: &str) -> Result<(), TagError> {
        let bad = |key: &'static str, expected: &'static str| TagError::BadValue {
            key,
            found: value.chars().take(40).collect(),
            expected,
        };
        let number = |key: &'static str, least: f64, expected: &'static str| {
            let read = value.parse::<f64>().ok();
            read.filter(|x| x.is_finite() && *x >= least)
                .ok_or_else(|| bad(key, expected))
        };
        match key.to_ascii_lowercase().as_str() {
            "counter" => {
                let counter = value
                    .parse()
                    .map_err(|_| bad("counter", "a whole number"))?;
                self.counter = Some(counter);
            }
            "exposure_start" => {
                let expected = "RFC 3339 in UTC or seconds since 1970";
                let started = OffsetDateTime::parse(value, &Rfc3339).ok().or_else(|| {
                    let seconds: f64 = value.parse().ok()?;
                    let nanos = (seconds * 1e9).is_finite().then_some(seconds * 1e9)?;
                    OffsetDateTime::from_unix_timestamp_nanos(nanos.round() as i128).ok()
                });
                let started = started.ok_or_else(|| bad("exposure_start", expected))?;
                self.exposure_start = Some(started.to_offset(time::UtcOffset::UTC));
            }
            "exposure_s" => {
                self.exposure_s = Some(number("exposure_s", 0.0, "a number of seconds")?);
            }
            "gain" => self.gain = Some(number("gain", f64::MIN, "a number")?),
            "serial" | "camera_serial" => {
                if value.is_empty() || value.len() > TEXT_BYTES_MAX {
                    return Err(bad("serial", "a text of 1 to 256 bytes"));
                }
                self.serial = Some(value.to_owned());
            }
            "temperature_c" | "temperature" => {
                self.temperature_c = Some(number("temperature_c", -273.15, "a number of °C")?);
            }
            _ => {}
        }
        Ok(())
    }
}

/// Returns keyword and text of the uncompressed text chunks of a PNG. Anything of another form is skipped: the decoder has
/// checked the file.
fn texts(bytes: &[u8]) -> Vec<(String, String)> {
    const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
    let Some(mut rest) = bytes.strip_prefix(SIGNATURE) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    while let Some((head, after)) = rest.split_at_checked(8) {
        let length = u32::from_be_bytes([head[0], head[1], head[2], head[3]]) as usize;
        let Some((data, after)) = after.split_at_checked(length) else {
            break;
        };
        let text = match &head[4..] {
            b"tEXt" => split_at_zero(data).map(|(key, text)| (key, latin1(text))),
            b"iTXt" => international(data),
            _ => None,
        };
        found.extend(text.map(|(key, text)| (latin1(key), text)));
        rest = after.get(4..).unwrap_or_default();
    }
    found
}

fn split_at_zero(data: &[u8]) -> Option<(&[u8], &[u8])> {
    let at = data.iter().position(|byte| *byte == 0)?;
    Some((&data[..at], &data[at + 1..]))
}

/// Keyword, compression flag and method, language, translated keyword, text.
fn international(data: &[u8]) -> Option<(&[u8], String)> {
    let (key, rest) = split_at_zero(data)?;
    let (flags, rest) = rest.split_at_checked(2)?;
    let (_, rest) = split_at_zero(rest)?;
    let (_, text) = split_at_zero(rest)?;
    (flags[0] == 0).then(|| (key, String::from_utf8_lossy(text).into_owned()))
}

fn latin1(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| char::from(*byte)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
        let length = (data.len() as u32).to_be_bytes();
        [&length[..], kind, data, &[0; 4]].concat()
    }

    fn png(chunks: &[Vec<u8>]) -> Vec<u8> {
        [b"\x89PNG\r\n\x1a\n".to_vec(), chunks.concat()].concat()
    }

    #[test]
    fn text_chunks_state_counter_start_settings_camera_and_temperature() {
        let tag = FrameTag::of_png(&png(&[
            chunk(b"IHDR", &[0; 13]),
            chunk(b"tEXt", b"counter\x0017"),
            chunk(b"tEXt", b"exposure_start\x002026-01-01T00:00:01.5Z"),
            chunk(b"iTXt", b"exposure_s\0\0\0en\0\x000.02"),
            chunk(b"tEXt", b"Gain\x001.5"),
            chunk(b"tEXt", b"serial\0A-\xe9 7"),
            chunk(b"tEXt", b"temperature_c\0-5"),
            chunk(b"tEXt", b"Author\0somebody"),
        ]))
        .unwrap();
        assert_eq!(tag.counter, Some(17));
        let start = time::macros::datetime!(2026-01-01 00:00:01.5 UTC);
        assert_eq!(tag.exposure_start, Some(start));
        assert_eq!((tag.exposure_s, tag.gain), (Some(0.02), Some(1.5)));
        assert_eq!(tag.serial.as_deref(), Some("A-é 7"));
        assert_eq!(tag.temperature_c, Some(-5.0));
        let json = serde_json::to_string(&tag).unwrap();
        assert_eq!(serde_json::from_str::<FrameTag>(&json).unwrap(), tag);
    }

    #[test]
    fn a_value_that_cannot_be_read_is_an_error_and_damaged_chunks_are_not() {
        for (text, key) in [
            (&b"counter\0seven"[..], "counter"),
            (b"exposure_start\0yesterday", "exposure_start"),
            (b"exposure_start\0nan", "exposure_start"),
            (b"exposure_start\x001e300", "exposure_start"),
            (b"exposure_s\0-1", "exposure_s"),
            (b"gain\0inf", "gain"),
            (b"serial\0", "serial"),
            (b"temperature\0cold", "temperature_c"),
        ] {
            let error = FrameTag::of_png(&png(&[chunk(b"tEXt", text)])).unwrap_err();
            assert!(error.to_string().starts_with(key), "{error}");
        }
        let cut = png(&[chunk(b"tEXt", b"counter\x0017")]);
        for end in 0..cut.len() {
            assert!(FrameTag::of_png(&cut[..end]).is_ok());
        }
        let huge = [&u32::MAX.to_be_bytes()[..], b"tEXt", b"counter\x0017"].concat();
        assert!(FrameTag::of_png(&png(&[huge])).unwrap().is_empty());
    }

    #[test]
    fn a_json_object_takes_precedence() {
        let of_png = FrameTag {
            counter: Some(1),
            gain: Some(2.0),
            ..FrameTag::default()
        };
        let text = r#"{"counter": 5, "exposure_start": 1767225601.5, "serial": "7", "other": [1], "gain": null}"#;
        let tag = of_png.clone().with_json(text).unwrap();
        assert_eq!((tag.counter, tag.gain), (Some(5), Some(2.0)));
        let start = time::macros::datetime!(2026-01-01 00:00:01.5 UTC);
        assert_eq!(tag.exposure_start, Some(start));
        for text in ["[1]", "{", ""] {
            let error = of_png.clone().with_json(text).unwrap_err();
            assert!(matches!(error, TagError::NotAnObject(_)), "{error}");
        }
    }
}
