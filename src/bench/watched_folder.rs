//! A camera made of any program that writes frames into a folder.
//!
//! For each frame the program is started from a command template, without a shell: `["vendor-snap",
//! "--ms", "{exposure_ms}", "--out", "{file}"]`.
//!
//! - With `{file}` in the template, the frame is expected under exactly that name, which no earlier
//!   frame had.
//! - Without it, the newest PNG or TIFF that is new or changed counts.
//! - With an empty template, no program is started; the operator or another program delivers the
//!   frames.
//!
//! A frame is complete when it decodes as a whole 16-bit grey PNG, or as a TIFF that has not
//! changed between two reads of the folder; until then it is read again. The program must end
//! within the frame's time limit. Poses are only printed into the template.
//!
//! The program may state counter, start of the exposure, settings, serial number and temperature with the frame
//! ([`FrameTag`]); a scan then checks them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use futures::future::BoxFuture;

use super::capture_program::CaptureProgram;
use super::{Camera, CameraError, CaptureRequest, Captured, side_file};
use crate::clock::Clock;
use crate::frame::{FileKind, Frame, FrameError, FrameTag, TagError};

/// Interval between two reads of the folder.
const LOOK_EVERY: Duration = Duration::from_millis(25);

/// Placeholders that the template may contain.
const PLACEHOLDERS: [&str; 7] = [
    "theta_c_deg",
    "phi_s_deg",
    "exposure_s",
    "exposure_ms",
    "kind",
    "repeat",
    "file",
];

/// The camera's folder and program, as `[camera]` of the settings states them.
#[derive(Debug, Clone, PartialEq)]
pub struct WatchedFolderSettings {
    /// Folder into which the program writes.
    pub folder: PathBuf,
    /// Program and arguments, with `{theta_c_deg}`, `{phi_s_deg}`, `{exposure_s}`, `{exposure_ms}`,
    /// `{kind}` (sample, dark, flat), `{repeat}` and `{file}` replaced. Empty: nothing is started.
    pub command: Vec<String>,
    /// Time limit for a frame beyond its exposure time, in seconds.
    pub timeout_s: f64,
    /// Whether a frame's file is deleted after it is read.
    pub delete_read_frames: bool,
}

/// Why settings are invalid.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum WatchedFolderError {
    /// The folder does not exist.
    #[error("the camera's folder {0} does not exist: create it or correct `folder`")]
    NoFolder(PathBuf),
    /// The template contains an unknown placeholder.
    #[error("unknown placeholder `{{{word}}}` in the camera's command: the known ones are {}", PLACEHOLDERS.map(|p| format!("{{{p}}}")).join(", "))]
    UnknownPlaceholder {
        /// The placeholder without its braces.
        word: String,
    },
    /// The first word of the template is empty.
    #[error("the camera's command names no program: its first word must be the program to start")]
    NoProgram,
    /// The time limit is not a positive number.
    #[error("the camera's timeout_s is {0}: set it to a number of seconds above 0")]
    BadTimeout(String),
}

/// A camera that reads frames from a folder.
pub struct WatchedFolder {
    settings: WatchedFolderSettings,
    clock: Arc<dyn Clock>,
    captures: u64,
}

/// Size and modification time of a file when it was last read.
type Stamp = (u64, Option<SystemTime>);

impl WatchedFolder {
    /// Makes a camera after checking its settings.
    ///
    /// # Errors
    /// [`WatchedFolderError`] names the setting to correct.
    pub fn new(
        settings: WatchedFolderSettings,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, WatchedFolderError> {
        if !settings.folder.is_dir() {
            return Err(WatchedFolderError::NoFolder(settings.folder));
        }
        if !(settings.timeout_s.is_finite() && settings.timeout_s > 0.0) {
            return Err(WatchedFolderError::BadTimeout(
                settings.timeout_s.to_string(),
            ));
        }
        if settings
            .command
            .first()
            .is_some_and(|p| p.trim().is_empty())
        {
            return Err(WatchedFolderError::NoProgram);
        }
        for word in settings.command.iter().flat_map(|w| placeholders(w)) {
            if !PLACEHOLDERS.contains(&word) {
                return Err(WatchedFolderError::UnknownPlaceholder {
                    word: word.to_owned(),
                });
            }
        }
        Ok(WatchedFolder {
            settings,
            clock,
            captures: 0,
        })
    }

    fn names_file(&self) -> bool {
        let mut words = self.settings.command.iter().flat_map(|w| placeholders(w));
        words.any(|word| word == "file")
    }

    /// Returns a file name in the folder that is not in use.
    fn fresh_name(&mut self, request: &CaptureRequest) -> PathBuf {
        loop {
            self.captures += 1;
            let stamp = self.clock.utc().unix_timestamp();
            let path = self.settings.folder.join(format!(
                "{}_{stamp}_{:06}.png",
                request.kind.as_str(),
                self.captures
            ));
            if !path.exists() {
                return path;
            }
        }
    }

    async fn await_frame(&mut self, request: &CaptureRequest) -> Result<Captured, CameraError> {
        let named = self.names_file();
        let file = self.fresh_name(request);
        let before = if named {
            HashMap::new()
        } else {
            listing(&self.settings.folder)?
        };
        let started_at = self.clock.now();
        let started_utc = self.clock.utc();
        let words = self.settings.command.iter();
        let mut program = CaptureProgram::start(words.map(|word| filled(word, request, &file)))?;
        let limit_s = request.exposure_s.max(0.0) + self.settings.timeout_s;
        let mut ended = program.is_none();
        let mut last_error: Option<(PathBuf, Stamp, FrameError)> = None;
        let mut last: Option<(PathBuf, Stamp)> = None;
        loop {
            if let Some(running) = program.as_mut()
                && !ended
            {
                ended = running.has_ended(&*self.clock).await?;
            }
            let candidate = if named {
                stamp_of(&file).map(|stamp| (file.clone(), stamp))
            } else {
                newest(&self.settings.folder, &before)?
            };
            // A PNG proves its end by a checksum. A TIFF has none, so it counts once it stops
            // changing.
            let rests = candidate.is_some() && candidate == last;
            last.clone_from(&candidate);
            if let Some((path, stamp)) = candidate {
                let unchanged = last_error
                    .as_ref()
                    .is_some_and(|(p, s, _)| *p == path && *s == stamp);
                if !unchanged {
                    match decoded(&path).await? {
                        Ok((_, FileKind::Tiff, _)) if !rests => {}
                        Ok((frame, _, tag)) => {
                            if let Some(program) = program {
                                let limit =
                                    Duration::try_from_secs_f64(limit_s).unwrap_or_default();
                                let waited = self.clock.now().saturating_sub(started_at);
                                let left = limit.saturating_sub(waited);
                                program.let_end(left, &*self.clock).await?;
                            }
                            let tag = side_file::add(tag?, &path)?;
                            if self.settings.delete_read_frames {
                                // A file that cannot be deleted must not cost the frame.
                                let _ = std::fs::remove_file(&path);
                                let _ = std::fs::remove_file(side_file::name(&path));
                            }
                            return Ok(Captured {
                                frame,
                                started_at,
                                started_utc: tag.exposure_start.unwrap_or(started_utc),
                                tag,
                            });
                        }
                        Err(error) => last_error = Some((path, stamp, error)),
                    }
                }
            }
            let waited = self.clock.now().saturating_sub(started_at);
            if waited.as_secs_f64() >= limit_s {
                return Err(match last_error {
                    Some((_, _, error)) => CameraError::NotAFrame(error),
                    None => CameraError::TimedOut {
                        waited_s: waited.as_secs_f64(),
                        hint: self.hint(named, ended, &file),
                    },
                });
            }
            self.clock.sleep(LOOK_EVERY).await;
        }
    }

    fn hint(&self, named: bool, ended: bool, file: &Path) -> String {
        let what = if named {
            format!("{} did not appear", file.display())
        } else {
            format!(
                "no new PNG or TIFF appeared in {}",
                self.settings.folder.display()
            )
        };
        match (self.settings.command.first(), ended) {
            (None, _) => format!("{what}; check that the program that delivers frames is running"),
            (Some(program), true) => format!(
                "{what} although `{program}` ended without an error; check that it writes 16-bit PNG or TIFF to that place"
            ),
            (Some(program), false) => {
                format!(
                    "{what} and `{program}` was still running; check that the camera is connected"
                )
            }
        }
    }
}

impl Camera for WatchedFolder {
    fn describe(&self) -> String {
        format!(
            "folder {}{}",
            self.settings.folder.display(),
            self.settings
                .command
                .first()
                .map(|program| format!(" filled by {program}"))
                .unwrap_or_default()
        )
    }

    fn capture<'a>(
        &'a mut self,
        request: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>> {
        Box::pin(self.await_frame(request))
    }
}

/// Returns the words in braces: `{name}` of small letters and underscores; other braces are
/// ignored.
fn placeholders(word: &str) -> Vec<&str> {
    let mut found = Vec::new();
    let mut rest = word;
    while let Some(open) = rest.find('{') {
        rest = &rest[open + 1..];
        let Some(close) = rest.find('}') else { break };
        let inner = &rest[..close];
        if !inner.is_empty() && inner.bytes().all(|b| b.is_ascii_lowercase() || b == b'_') {
            found.push(inner);
        }
    }
    found
}

fn filled(word: &str, request: &CaptureRequest, file: &Path) -> String {
    let values = [
        ("theta_c_deg", format!("{:.4}", request.pose.theta_c.deg())),
        ("phi_s_deg", format!("{:.4}", request.pose.phi_s.deg())),
        ("exposure_s", request.exposure_s.to_string()),
        // Rounded to the picosecond: 0.07 s is 70 ms, not 70.00000000000001 ms.
        (
            "exposure_ms",
            ((request.exposure_s * 1e12).round() / 1e9).to_string(),
        ),
        ("kind", request.kind.as_str().to_owned()),
        ("repeat", request.repeat.to_string()),
        ("file", file.display().to_string()),
    ];
    values.iter().fold(word.to_owned(), |text, (name, value)| {
        text.replace(&format!("{{{name}}}"), value)
    })
}

fn stamp_of(path: &Path) -> Option<Stamp> {
    let meta = std::fs::metadata(path).ok()?;
    meta.is_file().then(|| (meta.len(), meta.modified().ok()))
}

/// Lists the PNG and TIFF files of a folder with their stamps.
fn listing(folder: &Path) -> Result<HashMap<PathBuf, Stamp>, CameraError> {
    let unreadable = |error: std::io::Error| {
        CameraError::Failed(format!(
            "cannot read the camera's folder {}: {error}",
            folder.display()
        ))
    };
    let mut files = HashMap::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let ends_in = |ending: &&str| {
            let own = path.extension();
            own.is_some_and(|own| own.eq_ignore_ascii_case(ending))
        };
        if ["png", "tif", "tiff"].iter().any(ends_in)
            && let Some(stamp) = stamp_of(&path)
        {
            files.insert(path, stamp);
        }
    }
    Ok(files)
}

/// Returns the newest frame that is new or changed since `before`.
fn newest(
    folder: &Path,
    before: &HashMap<PathBuf, Stamp>,
) -> Result<Option<(PathBuf, Stamp)>, CameraError> {
    let now = listing(folder)?;
    Ok(now
        .into_iter()
        .filter(|(path, stamp)| before.get(path) != Some(stamp))
        .max_by(|a, b| (a.1.1, &a.0).cmp(&(b.1.1, &b.0))))
}

/// A frame, the kind of its file, and what the file states about it.
type Decoded = (Frame, FileKind, Result<FrameTag, TagError>);

/// Reads and decodes a file on a blocking thread. A file that has vanished counts as unreadable.
async fn decoded(path: &Path) -> Result<Result<Decoded, FrameError>, CameraError> {
    let path = path.to_owned();
    tokio::task::spawn_blocking(move || {
        let bytes = std::fs::read(path).unwrap_or_default();
        let frame = Frame::read(&bytes)?;
        Ok((frame, FileKind::of(&bytes), FrameTag::of_png(&bytes)))
    })
    .await
    .map_err(|error| CameraError::Failed(format!("reading the frame was interrupted: {error}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::{SteppedClock, SystemClock};
    use crate::frame::FrameKind;
    use crate::geometry::Pose;

    fn picture(dn: u16) -> Frame {
        Frame::new(4, 3, (0..12).map(|i| dn + i).collect()).unwrap()
    }

    fn request() -> CaptureRequest {
        CaptureRequest {
            kind: FrameKind::Sample,
            pose: Pose::from_deg(-5.0, 30.0),
            exposure_s: 0.02,
            repeat: 1,
        }
    }

    fn camera(
        folder: &Path,
        command: &[&str],
        clock: Arc<dyn Clock>,
    ) -> Result<WatchedFolder, WatchedFolderError> {
        let settings = WatchedFolderSettings {
            folder: folder.to_owned(),
            command: command.iter().map(|w| (*w).to_owned()).collect(),
            timeout_s: 20.0,
            delete_read_frames: false,
        };
        WatchedFolder::new(settings, clock)
    }

    #[tokio::test]
    async fn what_the_program_writes_beside_the_frame_is_its_tag() {
        let place = tempfile::tempdir().unwrap();
        let source = place.path().join("source.raw");
        std::fs::write(&source, picture(1000).to_png().unwrap()).unwrap();
        let folder = place.path().join("inbox");
        std::fs::create_dir(&folder).unwrap();
        let script = format!(
            "echo '{{\"counter\": 7, \"exposure_start\": \"2026-01-01T00:00:00Z\"}}' > \"${{1%.png}}.json\" && cp {} \"$1\"",
            source.display()
        );
        let command = ["sh", "-c", &script, "snap", "{file}"];
        let mut camera = camera(&folder, &command, Arc::new(SystemClock::new())).unwrap();
        camera.settings.delete_read_frames = true;
        let captured = camera.capture(&request()).await.unwrap();
        assert_eq!(captured.tag.counter, Some(7));
        assert_eq!(
            captured.started_utc,
            time::macros::datetime!(2026-01-01 00:00 UTC)
        );
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
    }

    #[tokio::test]
    async fn a_program_that_writes_the_named_file_is_a_camera() {
        let place = tempfile::tempdir().unwrap();
        let source = place.path().join("source.raw");
        std::fs::write(&source, picture(1000).to_png().unwrap()).unwrap();
        let folder = place.path().join("in box");
        std::fs::create_dir(&folder).unwrap();
        let source = source.display().to_string();
        let mut camera = camera(
            &folder,
            &["cp", &source, "{file}"],
            Arc::new(SystemClock::new()),
        )
        .unwrap();
        for n in 1..=2 {
            let captured = camera.capture(&request()).await.unwrap();
            assert_eq!(captured.frame, picture(1000));
            assert_eq!(std::fs::read_dir(&folder).unwrap().count(), n);
        }
    }

    #[tokio::test]
    async fn without_a_file_name_only_a_new_file_counts() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("box");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join("old.png"), picture(7).to_png().unwrap()).unwrap();
        let source = place.path().join("source.raw");
        std::fs::write(&source, picture(2000).to_png().unwrap()).unwrap();
        let target = folder.join("shot.png").display().to_string();
        let source = source.display().to_string();
        let mut camera = camera(
            &folder,
            &["cp", &source, &target],
            Arc::new(SystemClock::new()),
        )
        .unwrap();
        assert_eq!(
            camera.capture(&request()).await.unwrap().frame,
            picture(2000)
        );
    }

    #[tokio::test]
    async fn a_program_may_write_tiff() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("box");
        std::fs::create_dir(&folder).unwrap();
        let counts = picture(2000);
        let mut file = std::io::Cursor::new(Vec::new());
        tiff::encoder::TiffEncoder::new(&mut file)
            .unwrap()
            .write_image::<tiff::encoder::colortype::Gray16>(
                counts.width_px(),
                counts.height_px(),
                counts.pixels_dn(),
            )
            .unwrap();
        let source = place.path().join("source.raw");
        std::fs::write(&source, file.into_inner()).unwrap();
        let source = source.display().to_string();
        let named = folder.join("shot.TIF").display().to_string();
        for target in [named.as_str(), "{file}"] {
            let command = ["cp", &source, target];
            let mut camera = camera(&folder, &command, Arc::new(SystemClock::new())).unwrap();
            assert_eq!(camera.capture(&request()).await.unwrap().frame, counts);
        }
    }

    #[tokio::test]
    async fn a_missing_frame_times_out_with_a_hint() {
        let place = tempfile::tempdir().unwrap();
        std::fs::write(place.path().join("old.png"), picture(7).to_png().unwrap()).unwrap();
        let mut camera = camera(place.path(), &[], Arc::new(SteppedClock::new())).unwrap();
        match camera.capture(&request()).await {
            Err(CameraError::TimedOut { waited_s, hint }) => {
                assert!((20.0..20.2).contains(&waited_s));
                assert!(hint.contains("no new PNG"), "{hint}");
            }
            other => panic!("{other:?}"),
        }
    }

    #[tokio::test]
    async fn an_incomplete_frame_is_not_accepted() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("box");
        std::fs::create_dir(&folder).unwrap();
        let png = picture(1000).to_png().unwrap();
        let mut camera = camera(&folder, &[], Arc::new(SteppedClock::new())).unwrap();
        let asked = request();
        let shot = folder.join("shot.png");
        let capture = camera.capture(&asked);
        let writer = async {
            // The camera has read the folder once before this task runs.
            std::fs::write(&shot, &png[..png.len() - 5]).unwrap();
        };
        let (outcome, ()) = tokio::join!(capture, writer);
        assert!(
            matches!(outcome, Err(CameraError::NotAFrame(_))),
            "{outcome:?}"
        );
        std::fs::remove_file(&shot).unwrap();
        // The camera still works after the failure.
        let asked = request();
        let capture = camera.capture(&asked);
        let writer = async { std::fs::write(&shot, &png).unwrap() };
        let (outcome, ()) = tokio::join!(capture, writer);
        assert_eq!(outcome.unwrap().frame, picture(1000));
    }

    #[tokio::test]
    async fn a_program_with_long_output_is_not_blocked_and_ends_by_itself() {
        let place = tempfile::tempdir().unwrap();
        let source = place.path().join("source.raw");
        std::fs::write(&source, picture(1000).to_png().unwrap()).unwrap();
        let folder = place.path().join("box");
        std::fs::create_dir(&folder).unwrap();
        // More than a pipe holds, both before and after the frame.
        let script = "head -c 200000 /dev/zero >&2; cp \"$0\" \"$1\"; head -c 200000 /dev/zero >&2; touch \"$0.closed\"";
        let source = source.display().to_string();
        let command = ["sh", "-c", script, &source, "{file}"];
        let mut camera = camera(&folder, &command, Arc::new(SystemClock::new())).unwrap();
        let captured = camera.capture(&request()).await.unwrap();
        assert_eq!(captured.frame, picture(1000));
        assert!(place.path().join("source.raw.closed").exists());
    }

    #[tokio::test]
    async fn a_program_that_fails_after_its_frame_fails_the_capture_with_the_end_of_its_stderr() {
        let place = tempfile::tempdir().unwrap();
        let source = place.path().join("source.raw");
        std::fs::write(&source, picture(1000).to_png().unwrap()).unwrap();
        let folder = place.path().join("box");
        std::fs::create_dir(&folder).unwrap();
        let script = "cp \"$0\" \"$1\"; head -c 200000 /dev/zero | tr '\\0' x >&2; echo out of film >&2; exit 3";
        let source = source.display().to_string();
        let command = ["sh", "-c", script, &source, "{file}"];
        let mut camera = camera(&folder, &command, Arc::new(SystemClock::new())).unwrap();
        let said = camera.capture(&request()).await.unwrap_err().to_string();
        assert!(said.ends_with("out of film"), "{said}");
        assert!(said.len() < 3000, "{}", said.len());
    }

    #[tokio::test]
    async fn a_program_that_never_ends_does_not_lose_its_frame() {
        let place = tempfile::tempdir().unwrap();
        let pipe = place.path().join("never");
        let script = "mkfifo \"$0\"; exec cat \"$0\"";
        let words = ["sh", "-c", script, &pipe.display().to_string()].map(str::to_owned);
        let program = CaptureProgram::start(words).unwrap().unwrap();
        let clock = SteppedClock::new();
        program
            .let_end(Duration::from_secs(30), &clock)
            .await
            .unwrap();
        assert_eq!(clock.now(), Duration::from_secs(30));
    }

    #[tokio::test]
    async fn a_failed_or_missing_program_is_named_in_the_error() {
        let place = tempfile::tempdir().unwrap();
        let clock = Arc::new(SystemClock::new());
        let mut failing = camera(
            place.path(),
            &["ls", "/no such place/{repeat}"],
            clock.clone(),
        )
        .unwrap();
        let said = failing.capture(&request()).await.unwrap_err().to_string();
        assert!(said.contains("/no such place/1"), "{said}");
        let mut missing = camera(place.path(), &["no-such-program-here"], clock).unwrap();
        let said = missing.capture(&request()).await.unwrap_err().to_string();
        assert!(
            said.contains("no-such-program-here") && said.contains("could not be started"),
            "{said}"
        );
    }

    #[test]
    fn invalid_settings_are_refused() {
        let place = tempfile::tempdir().unwrap();
        let clock = || Arc::new(SteppedClock::new());
        let refusal = |command: &[&str]| camera(place.path(), command, clock()).err();
        assert_eq!(
            refusal(&["snap", "{exposre_s}"]),
            Some(WatchedFolderError::UnknownPlaceholder {
                word: "exposre_s".to_owned()
            })
        );
        assert_eq!(refusal(&[" "]), Some(WatchedFolderError::NoProgram));
        assert_eq!(refusal(&["snap", "{\"a\": 1}", "{file}"]), None);
        assert!(camera(&place.path().join("no"), &[], clock()).is_err());
    }

    #[test]
    fn the_template_is_filled_from_the_request() {
        let word = "{kind}-{theta_c_deg}-{phi_s_deg}-{exposure_s}-{exposure_ms}-{repeat}:{file}{x}";
        assert_eq!(
            filled(word, &request(), Path::new("/a b/c.png")),
            "sample--5.0000-30.0000-0.02-20-1:/a b/c.png{x}"
        );
        let seventy = CaptureRequest {
            exposure_s: 0.07,
            ..request()
        };
        assert_eq!(filled("{exposure_ms}", &seventy, Path::new("")), "70");
    }
}
