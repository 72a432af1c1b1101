//! The log of the program, on stderr.
//!
//! A thread of its own writes the log: a reader of stderr that does not read (a pager, a hung terminal) must hold neither a
//! motion nor the stop. Lines for which there is no room are counted and left out.

use std::io::{IsTerminal, Write};
use std::sync::OnceLock;

use tracing_appender::non_blocking::{ErrorCounter, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::EnvFilter;

/// Most lines that wait to be written.
const WAITING_LINES_MAX: usize = 8192;

static LEFT_OUT: OnceLock<ErrorCounter> = OnceLock::new();

/// Starts the log with the levels of `RIDGED_LOG`; `stderr` writes to it. The waiting lines are written when the answer is dropped.
///
/// # Panics
/// If the log was started before.
pub fn start(stderr: impl Write + Send + 'static) -> WorkerGuard {
    let filter = EnvFilter::try_from_env("RIDGED_LOG")
        .unwrap_or_else(|_| EnvFilter::new("warn,ridged=info"));
    let (writer, guard) = NonBlockingBuilder::default()
        .lossy(true)
        .buffered_lines_limit(WAITING_LINES_MAX)
        .thread_name("log")
        .finish(stderr);
    LEFT_OUT.get_or_init(|| writer.error_counter());
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(writer)
        .with_ansi(std::io::stderr().is_terminal())
        // A message about it would go to the same stderr that cannot be written, and panic.
        .log_internal_errors(false)
        .init();
    guard
}

/// Number of lines left out because stderr had no reader.
#[must_use]
pub fn lines_left_out() -> u64 {
    LEFT_OUT.get().map_or(0, |n| n.dropped_lines() as u64)
}
