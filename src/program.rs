//! Runs a program of the settings (a hook, a lamp's switch, a watched value) with a time limit in real time, without a shell.
//!
//! The program gets a process group of its own, so that at the time limit it is killed with its children. The end of its
//! stderr explains a failure.

use std::process::Stdio;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process_group};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt};
use tokio::process::{Child, Command};

/// Bytes of stderr that a failure quotes: the end, which has the reason.
const STDERR_BYTES_MAX: usize = 1000;
/// Time for the rest of stderr after the program has ended; a child may keep the pipe open.
const LAST_WORDS: Duration = Duration::from_millis(300);

/// A program with its arguments and its time limit.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    /// Program, then arguments; at least one word.
    pub words: Vec<String>,
    /// Time limit.
    pub limit: Duration,
}

/// Why a program did not do its work.
#[derive(Debug, thiserror::Error)]
pub enum ProgramError {
    /// The operating system cannot start it.
    #[error(
        "the command `{name}` could not be started ({source}): check its path and that it is executable"
    )]
    NotStarted {
        /// First word of the command.
        name: String,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// It reported a failure.
    #[error("the command `{name}` ended with {status}{stderr}")]
    Failed {
        /// First word of the command.
        name: String,
        /// How it ended.
        status: std::process::ExitStatus,
        /// The end of its stderr after a colon; empty if it wrote nothing.
        stderr: String,
    },
    /// It did not end in time.
    #[error("the command `{name}` still ran after its time limit of {} s and was killed", .limit.as_secs_f64())]
    TimedOut {
        /// First word of the command.
        name: String,
        /// Time limit.
        limit: Duration,
    },
}

impl Program {
    /// Returns the program of a command; `None` for an empty one.
    #[must_use]
    pub fn of(words: &[String], limit_s: f64) -> Option<Program> {
        (!words.is_empty()).then(|| Program {
            words: words.to_vec(),
            limit: Duration::from_secs_f64(limit_s),
        })
    }

    /// Runs it with `input` on stdin. If the future is dropped, the program is killed with its children.
    ///
    /// # Errors
    /// [`ProgramError`] if it cannot be started, fails, or exceeds its time limit.
    pub async fn run(&self, input: &[u8]) -> Result<(), ProgramError> {
        self.finish(input, None).await.map(drop)
    }

    /// Runs it as [`Program::run`] does, without input, and returns the first `bytes_max` bytes that it prints.
    ///
    /// # Errors
    /// As [`Program::run`].
    pub async fn output(&self, bytes_max: u64) -> Result<Vec<u8>, ProgramError> {
        self.finish(b"", Some(bytes_max)).await
    }

    /// Runs it to its end; without `bytes_max`, its output is not read.
    async fn finish(&self, input: &[u8], bytes_max: Option<u64>) -> Result<Vec<u8>, ProgramError> {
        let (name, arguments) = self.words.split_first().expect("a program has a name");
        let stdout = bytes_max.map_or_else(Stdio::null, |_| Stdio::piped());
        let mut child = Command::new(name)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(stdout)
            .stderr(Stdio::piped())
            .process_group(0)
            .kill_on_drop(true)
            .spawn()
            .map_err(|source| ProgramError::NotStarted {
                name: name.clone(),
                source,
            })?;
        let mut stdin = child.stdin.take().expect("it was piped");
        let stdout = child.stdout.take().zip(bytes_max);
        let mut stderr = child.stderr.take().expect("it was piped");
        let mut group = Group { child };
        let (mut printed, mut words) = (Vec::new(), Vec::new());
        let worked = tokio::time::timeout(self.limit, async {
            let work = async {
                if let Some((stdout, bytes_max)) = stdout {
                    // A program that prints more gets a closed pipe.
                    stdout.take(bytes_max).read_to_end(&mut printed).await?;
                }
                group.child.wait().await
            };
            let feed = async {
                // A program may ignore its input.
                stdin.write_all(input).await.ok();
                drop(stdin);
                std::future::pending().await
            };
            let listen = async {
                tail(&mut stderr, &mut words).await;
                std::future::pending().await
            };
            tokio::select! {
                status = work => status,
                never = feed => never,
                never = listen => never,
            }
        })
        .await;
        let Ok(status) = worked else {
            return Err(ProgramError::TimedOut {
                name: name.clone(),
                limit: self.limit,
            });
        };
        let status = status.map_err(|source| ProgramError::NotStarted {
            name: name.clone(),
            source,
        })?;
        if status.success() {
            return Ok(printed);
        }
        tokio::time::timeout(LAST_WORDS, tail(&mut stderr, &mut words))
            .await
            .ok();
        let text = String::from_utf8_lossy(&words).trim().to_owned();
        Err(ProgramError::Failed {
            name: name.clone(),
            status,
            stderr: match text.is_empty() {
                true => String::new(),
                false => format!(": {text}"),
            },
        })
    }
}

/// Reads to the end and keeps the last bytes.
async fn tail(from: &mut (impl AsyncRead + Unpin), kept: &mut Vec<u8>) {
    let mut bytes = [0; 4096];
    while let Ok(n @ 1..) = from.read(&mut bytes).await {
        kept.extend_from_slice(&bytes[..n]);
        let over = kept.len().saturating_sub(STDERR_BYTES_MAX);
        kept.drain(..over);
    }
}

/// A program and its children, which are killed with it if it has not ended when this is dropped.
struct Group {
    child: Child,
}

impl Drop for Group {
    fn drop(&mut self) {
        // While the program is not reaped, no other group can have its number.
        let leader = self.child.id().and_then(|id| Pid::from_raw(id as i32));
        if let Some(leader) = leader {
            kill_process_group(leader, Signal::KILL).ok();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str, limit_s: f64) -> Program {
        let words = ["sh", "-c", script].map(str::to_owned);
        Program::of(&words, limit_s).expect("it has words")
    }

    #[tokio::test]
    async fn a_program_gets_its_input_and_a_failure_has_its_last_words() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("got");
        let script = format!("cat > {}", file.display());
        shell(&script, 20.0).run(b"an event").await.unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"an event");
        // A program that reads nothing gets more than a pipe holds.
        shell("true", 20.0).run(&vec![b'x'; 1 << 20]).await.unwrap();
        let failed = shell("echo the lamp is not plugged in >&2; exit 3", 20.0);
        let failed = failed.run(b"").await.unwrap_err().to_string();
        assert!(
            failed.contains("`sh` ended with exit status: 3: the lamp is not plugged in"),
            "{failed}"
        );
        let words = ["/no/such/program".to_owned()];
        let missing = Program::of(&words, 1.0)
            .unwrap()
            .run(b"")
            .await
            .unwrap_err();
        assert!(missing.to_string().contains("check its path"), "{missing}");
        assert_eq!(Program::of(&[], 1.0), None);
    }

    #[tokio::test]
    async fn output_is_read_up_to_a_limit() {
        let printed = async |bytes_max| shell("echo 57.5", 20.0).output(bytes_max).await.unwrap();
        assert_eq!(printed(4096).await, b"57.5\n");
        assert_eq!(printed(2).await, b"57");
    }

    #[tokio::test]
    async fn a_program_over_its_time_limit_is_killed_with_its_children() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("child");
        let script = format!("sleep 60 & echo $! > {}; wait", file.display());
        let killed = shell(&script, 0.5).run(b"").await.unwrap_err();
        assert!(
            killed.to_string().contains("time limit of 0.5 s"),
            "{killed}"
        );
        let child = std::fs::read_to_string(&file).unwrap();
        let status = format!("/proc/{}/stat", child.trim());
        // The parent of an orphan reaps it a moment later; until then it is a zombie.
        let is_gone = || std::fs::read_to_string(&status).map_or(true, |s| s.contains(") Z "));
        for _ in 0..200 {
            if is_gone() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        panic!("the child still runs");
    }
}
