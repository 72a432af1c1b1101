//! The program that was started for one frame: when it has ended, how, and the last that it said.
//!
//! It is listened to all the while, so that one which complains at length is not held up by a full pipe; and it is
//! left to end by itself, since what it does after the frame (closing the camera) is part of its work. Dropped while
//! it runs, it is killed.

use std::process::{ExitStatus, Stdio};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::process::{Child, Command};
use tokio::task::JoinHandle;
use tracing::warn;

use super::CameraError;
use crate::clock::Clock;

/// Of what a failed program wrote to stderr, this much is shown: its end, where the reason is.
const STDERR_BYTES_MAX: usize = 2000;
/// How long the last words of a program that has ended are waited for: a child of its own may hold the pipe for ever.
const LAST_WORDS_MAX: Duration = Duration::from_secs(1);
/// Least time to end by itself after the frame.
const ENDING_MIN: Duration = Duration::from_secs(1);

/// A running program.
pub(super) struct Program {
    name: String,
    child: Child,
    said: Said,
    listener: JoinHandle<()>,
}

#[derive(Clone, Default)]
struct Said(Arc<Mutex<Vec<u8>>>);

impl Said {
    fn lock(&self) -> MutexGuard<'_, Vec<u8>> {
        self.0.lock().expect("no holder of this lock panics")
    }

    async fn listen(self, mut to: impl AsyncRead + Unpin) {
        let mut bytes = [0; 4096];
        // What cannot be read is not shown; the status is the message.
        while let Ok(n @ 1..) = to.read(&mut bytes).await {
            let mut said = self.lock();
            said.extend_from_slice(&bytes[..n]);
            let over = said.len().saturating_sub(STDERR_BYTES_MAX);
            said.drain(..over);
        }
    }
}

impl Program {
    /// Starts a program with its arguments, without a shell; `None` for no words.
    ///
    /// # Errors
    /// The system cannot start it.
    pub(super) fn start(
        words: impl IntoIterator<Item = String>,
    ) -> Result<Option<Program>, CameraError> {
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
                    "the camera's program `{name}` could not be started: {error}; check the camera's command in the configuration"
                ))
            })?;
        let said = Said::default();
        let stderr = child.stderr.take().expect("it was piped");
        Ok(Some(Program {
            name,
            child,
            listener: tokio::spawn(said.clone().listen(stderr)),
            said,
        }))
    }

    /// Whether it has ended well.
    ///
    /// # Errors
    /// It has failed.
    pub(super) async fn has_ended(&mut self, clock: &dyn Clock) -> Result<bool, CameraError> {
        match self.child.try_wait().map_err(unwatched)? {
            None => Ok(false),
            Some(status) => self.judge(status, clock).await.map(|()| true),
        }
    }

    /// Waits for its end once the frame is there, for `left` at most. One that goes on is killed, and the frame counts.
    ///
    /// # Errors
    /// It has failed after all.
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
                warn!("`{name}` was still running {left_s:.1} s after its frame was there and is killed; a camera's program should end by itself");
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
        let said = String::from_utf8_lossy(&self.said.lock()).into_owned();
        let said = match said.trim() {
            "" => String::new(),
            said => format!(": {said}"),
        };
        Err(CameraError::Failed(format!(
            "the camera's program ended with {status}{said}"
        )))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.listener.abort();
    }
}

fn unwatched(error: std::io::Error) -> CameraError {
    CameraError::Failed(format!("the camera's program cannot be watched: {error}"))
}
