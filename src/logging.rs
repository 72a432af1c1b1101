//! The log of the program, on stderr.
//!
//! A thread of its own writes the log: a reader of stderr that does not read (a pager, a hung terminal) must hold neither a
//! motion nor the stop. Lines for which there is no room are counted and left out.

use std::io::{IsTerminal, Write};
use std::sync::OnceLock;

use tracing_appender::non_blocking::{ErrorCounter, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Most lines that wait to be written.
const WAITING_LINES_MAX: usize = 8192;

/// Variable with the levels of the log, by target.
const LEVELS_VARIABLE: &str = "RIDGED_LOG";

/// The levels of the daemon where it states none.
const LEVELS_OF_DAEMON: &str = "warn,ridged=info";
/// The levels of the other commands, whose lines would run through what they print on a terminal.
const LEVELS_OF_COMMAND: &str = "warn";

static LEFT_OUT: OnceLock<ErrorCounter> = OnceLock::new();

/// Starts the log with the levels of `RIDGED_LOG`; `stderr` writes to it. Without the variable a daemon (`serves`) logs its
/// events, other commands only warnings. The waiting lines are written when the answer is dropped.
///
/// # Panics
/// If the log was started before.
pub fn start(stderr: impl Write + Send + 'static, serves: bool) -> WorkerGuard {
    let usual = usual_levels(serves);
    let asked = std::env::var(LEVELS_VARIABLE).unwrap_or_default();
    let levels = match asked.trim() {
        "" => usual,
        levels => levels,
    };
    let (filter, wrong) = match levels.parse::<Targets>() {
        Ok(filter) => (filter, None),
        Err(error) => (usual.parse().unwrap_or_default(), Some(error)),
    };
    let (writer, guard) = NonBlockingBuilder::default()
        .lossy(true)
        .buffered_lines_limit(WAITING_LINES_MAX)
        .thread_name("log")
        .finish(stderr);
    LEFT_OUT.get_or_init(|| writer.error_counter());
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(writer)
        .with_ansi(std::io::stderr().is_terminal())
        // A message about it would go to the same stderr that cannot be written, and panic.
        .log_internal_errors(false);
    tracing_subscriber::registry()
        .with(lines)
        .with(filter)
        .init();
    if let Some(error) = wrong {
        tracing::warn!(
            "{LEVELS_VARIABLE}={asked:?} is not valid ({error}); expected a level or targets with levels, such as debug or \
             warn,ridged=debug. The log uses {usual}"
        );
    }
    guard
}

const fn usual_levels(serves: bool) -> &'static str {
    match serves {
        true => LEVELS_OF_DAEMON,
        false => LEVELS_OF_COMMAND,
    }
}

/// Number of lines left out because stderr had no reader.
#[must_use]
pub fn lines_left_out() -> u64 {
    LEFT_OUT.get().map_or(0, |n| n.dropped_lines() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing::Level;

    #[test]
    fn the_usual_log_of_a_daemon_has_the_events_of_ridged_and_that_of_a_command_only_warnings() {
        let levels: Targets = usual_levels(false).parse().unwrap();
        assert!(levels.would_enable("ridged::scan", &Level::WARN));
        assert!(!levels.would_enable("ridged::scan", &Level::INFO));
        let levels: Targets = usual_levels(true).parse().unwrap();
        assert!(levels.would_enable("ridged::scan", &Level::INFO));
        assert!(!levels.would_enable("ridged::scan", &Level::DEBUG));
        assert!(levels.would_enable("sqlx::query", &Level::WARN));
        assert!(!levels.would_enable("sqlx::query", &Level::INFO));
    }
}
