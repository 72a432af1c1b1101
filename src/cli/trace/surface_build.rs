//! Builds surfaces in the background: shows the time on a terminal, and ends on Ctrl-C or `--max-seconds`.
//!
//! The build of a surface cannot be interrupted, so it runs in a thread that an ending command abandons.

use std::io::IsTerminal as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use indicatif::{ProgressBar, ProgressStyle};

use super::CliError;
use crate::cli::limits::Stopwatch;
use crate::cli::progress;
use crate::wording::significant;

/// Interval between checks of flag and clock.
const LOOK: Duration = Duration::from_millis(50);
/// Time after which the line on the terminal appears.
const SILENT: Duration = Duration::from_secs(1);

/// Returns the result of `make`; a line on the terminal shows the elapsed time.
///
/// # Errors
/// Interrupted once the flag is raised, no result once the time limit has passed, or the error of `make`.
pub(super) fn build<T: Send + 'static>(
    watch: &Stopwatch,
    cancel: &AtomicBool,
    make: impl FnOnce() -> Result<T, CliError> + Send + 'static,
) -> Result<T, CliError> {
    let begun = Instant::now();
    let (done, wait) = channel();
    std::thread::Builder::new()
        .name("surfaces".to_owned())
        // This fails only where the receiver is gone.
        .spawn(move || drop(done.send(make())))
        .map_err(CliError::no_result)?;
    let line = StatusLine::new();
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
                    "the surface could not be built: see above"
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
                "the time limit (--max-seconds) ended the build of the surface after {} s: allow more time, or use a smaller \
                surface (fewer cells or heights)",
                significant(spent.as_secs_f64())
            )));
        }
        line.show(spent);
    }
}

/// One line on a terminal.
struct StatusLine(ProgressBar);

impl StatusLine {
    fn new() -> Self {
        if !std::io::stderr().is_terminal() {
            return StatusLine(ProgressBar::hidden());
        }
        let bar = progress::drawn(ProgressBar::new_spinner());
        let style = ProgressStyle::with_template("{spinner} {msg}");
        StatusLine(bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner())))
    }

    fn show(&self, spent: Duration) {
        if spent >= SILENT {
            self.0.set_message(format!(
                "building the surface, {} s so far",
                spent.as_secs()
            ));
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
    fn a_build_ends_on_ctrl_c_and_at_its_time_limit() {
        let forever = || {
            std::thread::park_timeout(Duration::from_secs(600));
            Ok(())
        };
        let patient = Stopwatch::start(None);
        let calm = AtomicBool::new(false);
        assert_eq!(build(&patient, &calm, || Ok(7)).ok(), Some(7));
        let stopped = build(&patient, &AtomicBool::new(true), forever);
        assert!(matches!(stopped, Err(CliError::Interrupted)));
        let Err(CliError::NoResult(why)) = build(&Stopwatch::start(Some(1e-3)), &calm, forever)
        else {
            panic!("time is over");
        };
        let why = why.to_string();
        assert!(
            why.contains("--max-seconds") && why.contains("surface"),
            "{why}"
        );
        let refused = build::<()>(&patient, &calm, || Err(CliError::bad_input(anyhow!("no"))));
        assert!(matches!(refused, Err(CliError::BadInput(_))));
    }
}
