//! The program that the camera starts for one frame: whether it has ended, its exit status, and the
//! end of its stderr.
//!
//! Its stderr is read continuously, so that a program that writes much is not blocked by a full
//! pipe. The program may finish by itself after the frame, because closing the camera is part of
//! its work. It is killed when the [`CaptureProgram`] is dropped.

use std::process::{ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::process::{Child, Command};
use tokio::task::JoinHandle;
use tracing::warn;

use super::CameraError;
use crate::clock::Clock;

/// Bytes of a failed program's stderr that an error quotes: the end, which holds the reason.
const STDERR_BYTES_MAX: usize = 2000;
/// Time limit for reading stderr after the program has ended; a child process may hold the pipe
/// open for ever.
const LAST_WORDS_MAX: Duration = Duration::from_secs(1);
/// Least time that a program gets to end by itself after the frame.
const ENDING_MIN: Duration = Duration::from_secs(1);

/// A running capture program.
pub(super) struct CaptureProgram {
    name: String,
    child: Child,
    stderr_tail: StderrTail,
    listener: JoinHandle<()>,
}

#[derive(Clone, Default)]
struct StderrTail(Arc<Mutex<Vec<u8>>>);

impl StderrTail {
    fn lock(&self) -> MutexGuard<'_, Vec<u8>> {
        self.0.lock().expect("no holder of this lock panics")
    }

    async fn listen(self, mut to: impl AsyncRead + Unpin) {
        let mut bytes = [0; 4096];
        // Output that cannot be read is not quoted; the exit status remains.
        while let Ok(n @ 1..) = to.read(&mut bytes).await {
            let mut stderr_tail = self.lock();
            stderr_tail.extend_from_slice(&bytes[..n]);
            let over = stderr_tail.len().saturating_sub(STDERR_BYTES_MAX);
            stderr_tail.drain(..over);
        }
    }
}

impl CaptureProgram {
    /// Starts a program with its arguments, without a shell; returns `None` for an empty command.
    ///
    /// # Errors
    /// The operating system cannot start the program.
    pub(super) fn start(
        words: impl IntoIterator<Item = String>,
    ) -> Result<Option<CaptureProgram>, CameraError> {
        let mut words = words.into_iter();
        let Some(name) = words.next() else {
            return Ok(None);
        };
        let mut child = Command::new(&name)
            .args(words)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .map_err(|error| {
                CameraError::Failed(format!(
                    "the camera's program `{name}` could not be started ({error}): check the camera's command in the configuration"
                ))
            })?;
        let stderr_tail = StderrTail::default();
        let stderr = child.stderr.take().expect("it was piped");
        Ok(Some(CaptureProgram {
            name,
            child,
            listener: tokio::spawn(stderr_tail.clone().listen(stderr)),
            stderr_tail,
        }))
    }

    /// Returns whether the program has ended successfully.
    ///
    /// # Errors
    /// The program failed.
    pub(super) async fn has_ended(&mut self, clock: &dyn Clock) -> Result<bool, CameraError> {
        match self.child.try_wait().map_err(unwatched)? {
            None => Ok(false),
            Some(status) => self.judge(status, clock).await.map(|()| true),
        }
    }

    /// Waits for the program's end after the frame has arrived, for `left` at most, then kills the
    /// program; the frame stays valid.
    ///
    /// # Errors
    /// The program failed after the frame.
    pub(super) async fn let_end(
        mut self,
        left: Duration,
        clock: &dyn Clock,
    ) -> Result<(), CameraError> {
        let left = left.max(ENDING_MIN);
        tokio::select! {
            biased;
            status = self.child.wait() => {
                let status = status.map_err(unwatched)?;
                self.judge(status, clock).await
            }
            () = clock.sleep(left) => {
                let (name, left_s) = (&self.name, left.as_secs_f64());
                warn!("`{name}` was still running {left_s:.1} s after its frame arrived and was killed; a camera's program should end by itself");
                Ok(())
            }
        }
    }

    async fn judge(&mut self, status: ExitStatus, clock: &dyn Clock) -> Result<(), CameraError> {
        if status.success() {
            return Ok(());
        }
        tokio::select! {
            biased;
            _ = &mut self.listener => {}
            () = clock.sleep(LAST_WORDS_MAX) => {}
        }
        let stderr_tail = String::from_utf8_lossy(&self.stderr_tail.lock()).into_owned();
        let stderr_tail = match stderr_tail.trim() {
            "" => String::new(),
            stderr_tail => format!(": {stderr_tail}"),
        };
        Err(CameraError::Failed(format!(
            "the camera's program ended with {status}{stderr_tail}"
        )))
    }
}

impl Drop for CaptureProgram {
    fn drop(&mut self) {
        self.listener.abort();
    }
}

fn unwatched(error: std::io::Error) -> CameraError {
    CameraError::Failed(format!(
        "cannot read the status of the camera's program: {error}"
    ))
}
