//! The wait for surfaces: told on a terminal, ended by Ctrl-C and by `--max-seconds`.
//!
//! Making a surface cannot be stopped half-way, so it is left to a thread that a command which gives up leaves behind.

use std::io::IsTerminal as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use indicatif::{ProgressBar, ProgressStyle};

use super::CliError;
use crate::cli::limits::Stopwatch;
use crate::wording::significant;

/// Between two looks at flag and clock.
const LOOK: Duration = Duration::from_millis(50);
/// After which it is told that something is being made.
const SILENT: Duration = Duration::from_secs(1);

/// What `make` makes; meanwhile a line tells for how long.
///
/// # Errors
/// Interrupted once the flag is raised, no result once the watch is late, whatever is still being made; what `make` says.
pub(super) fn made<T: Send + 'static>(
    watch: &Stopwatch,
    cancel: &AtomicBool,
    make: impl FnOnce() -> Result<T, CliError> + Send + 'static,
) -> Result<T, CliError> {
    let begun = Instant::now();
    let (done, wait) = channel();
    std::thread::Builder::new()
        .name("surfaces".to_owned())
        // Nobody waits any more where this fails.
        .spawn(move || drop(done.send(make())))
        .map_err(CliError::no_result)?;
    let line = Line::new();
    loop {
        match wait.recv_timeout(LOOK) {
            Ok(found) => {
                line.clear();
                return found;
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                line.clear();
                return Err(CliError::no_result(anyhow!(
                    "the surface could not be made: see above"
                )));
            }
        }
        let spent = begun.elapsed();
        if cancel.load(Ordering::Relaxed) {
            line.clear();
            return Err(CliError::Interrupted);
        }
        if watch.is_late() {
            line.clear();
            return Err(CliError::no_result(anyhow!(
                "the time allowed (--max-seconds) is over and the surface is still being made, since {} s: allow more, or \
                 make it smaller (cells, or fewer heights)",
                significant(spent.as_secs_f64())
            )));
        }
        line.tell(spent);
    }
}

/// One line on a terminal.
struct Line(ProgressBar);

impl Line {
    fn new() -> Self {
        if !std::io::stderr().is_terminal() {
            return Line(ProgressBar::hidden());
        }
        let bar = ProgressBar::new_spinner();
        let style = ProgressStyle::with_template("{spinner} {msg}");
        Line(bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner())))
    }

    fn tell(&self, spent: Duration) {
        if spent >= SILENT {
            self.0
                .set_message(format!("making the surface, {} s so far", spent.as_secs()));
            self.0.tick();
        }
    }

    fn clear(&self) {
        self.0.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_waits_for_a_surface_may_stop_and_is_told_when_time_is_over() {
        let forever = || {
            std::thread::park_timeout(Duration::from_secs(600));
            Ok(())
        };
        let patient = Stopwatch::start(None);
        let calm = AtomicBool::new(false);
        assert_eq!(made(&patient, &calm, || Ok(7)).ok(), Some(7));
        let stopped = made(&patient, &AtomicBool::new(true), forever);
        assert!(matches!(stopped, Err(CliError::Interrupted)));
        let Err(CliError::NoResult(why)) = made(&Stopwatch::start(Some(1e-3)), &calm, forever)
        else {
            panic!("time is over");
        };
        let why = why.to_string();
        assert!(
            why.contains("--max-seconds") && why.contains("surface"),
            "{why}"
        );
        let refused = made::<()>(&patient, &calm, || Err(CliError::bad_input(anyhow!("no"))));
        assert!(matches!(refused, Err(CliError::BadInput(_))));
    }
}
