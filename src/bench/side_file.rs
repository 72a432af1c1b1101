//! The file beside a frame in which a camera's program may state how the frame was taken: `frame.png` → `frame.json`.

use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::CameraError;
use crate::frame::FrameTag;

/// Largest side file, bytes.
const BYTES_MAX: u64 = 65_536;

/// Returns the name of the side file of a frame.
pub(super) fn name(frame: &Path) -> PathBuf {
    frame.with_extension("json")
}

/// Adds what the side file of a frame states to what the frame itself states. Without such a file nothing is added.
///
/// # Errors
/// A file that cannot be read or is too large; a value that cannot be read.
pub(super) fn add(tag: FrameTag, frame: &Path) -> Result<FrameTag, CameraError> {
    let path = name(frame);
    let bad = |reason: String| {
        CameraError::Failed(format!(
            "the file {} beside the frame cannot be read ({reason}); correct the camera's program",
            path.display()
        ))
    };
    let file = match std::fs::File::open(&path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(tag),
        Err(error) => return Err(bad(error.to_string())),
    };
    let mut text = String::new();
    let read = file.take(BYTES_MAX + 1).read_to_string(&mut text);
    read.map_err(|error| bad(error.to_string()))?;
    if text.len() as u64 > BYTES_MAX {
        return Err(bad(format!("more than {BYTES_MAX} bytes")));
    }
    Ok(tag.with_json(&text)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_beside_a_frame_is_read_and_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let frame = folder.path().join("a.png");
        let read = || add(FrameTag::default(), &frame);
        assert!(read().unwrap().is_empty());
        let write = |text: &str| std::fs::write(folder.path().join("a.json"), text).unwrap();
        write(r#"{"counter": 5}"#);
        assert_eq!(read().unwrap().counter, Some(5));
        write(&" ".repeat(70_000));
        let error = read().unwrap_err().to_string();
        assert!(error.contains("more than 65536 bytes"), "{error}");
        write("[]");
        assert!(matches!(read(), Err(CameraError::BadTag(_))));
    }
}
