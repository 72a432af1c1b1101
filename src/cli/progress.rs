//! A progress bar, shown only on a terminal and only for work of more than a second.

use std::io::{IsTerminal, Write};
use std::sync::{LazyLock, Mutex, OnceLock};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, MultiProgress, ProgressBar, ProgressStyle};

/// All bars of the process: lines on stderr appear above them.
static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Draws a bar together with the others.
pub fn drawn(bar: ProgressBar) -> ProgressBar {
    BARS.add(bar)
}

/// The end of the log: stderr, above the bars that are drawn on it.
#[derive(Debug, Clone, Copy)]
pub struct AboveBars;

impl Write for AboveBars {
    fn write(&mut self, text: &[u8]) -> std::io::Result<usize> {
        BARS.suspend(|| std::io::stderr().write(text))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}

/// A bar on stderr.
pub struct Bar {
    started: Instant,
    terminal: bool,
    unit: &'static str,
    bar: OnceLock<ProgressBar>,
    stage: Mutex<Option<CountedStage>>,
}

/// The present stage; another total, or a smaller count, starts a new stage.
struct CountedStage {
    begun: Instant,
    total: u64,
    /// Count at the start of the stage.
    from: u64,
    done: u64,
}

impl Bar {
    /// Creates a bar that counts `unit`; nothing is shown yet.
    #[must_use]
    pub fn new(unit: &'static str) -> Self {
        Bar {
            started: Instant::now(),
            terminal: std::io::stderr().is_terminal(),
            unit,
            bar: OnceLock::new(),
            stage: Mutex::new(None),
        }
    }

    /// Shows `done` of `total`, from one second after the start on.
    pub fn at(&self, done: u64, total: u64) {
        self.show(done, total, "");
    }

    /// Shows `done` of `total` with a word about the present work.
    pub fn show(&self, done: u64, total: u64, word: &str) {
        if !self.terminal {
            return;
        }
        let left = self.left(done, total);
        if self.started.elapsed() < Duration::from_secs(1) {
            return;
        }
        let bar = self.bar.get_or_init(|| {
            let template = format!(
                "{{msg:30}} {{wide_bar}} {{pos}}/{{len}} {}{{prefix}}",
                self.unit
            );
            let style = ProgressStyle::with_template(&template)
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            drawn(ProgressBar::new(total).with_style(style))
        });
        bar.set_length(total);
        bar.set_position(done);
        bar.set_prefix(left.map_or_else(String::new, |left| {
            format!(", {} left", HumanDuration(left))
        }));
        if !word.is_empty() {
            bar.set_message(word.to_owned());
        }
    }

    /// Time left in the present stage; `None` while it is unknown.
    fn left(&self, done: u64, total: u64) -> Option<Duration> {
        let done = done.min(total);
        let mut stage = self.stage.lock().expect("no holder of this lock panics");
        match stage.as_mut() {
            Some(s) if s.total == total && s.done <= done => s.done = done,
            _ => {
                *stage = Some(CountedStage {
                    begun: Instant::now(),
                    total,
                    from: done,
                    done,
                });
            }
        }
        let stage = stage.as_ref()?;
        time_left(done - stage.from, total - stage.from, stage.begun.elapsed())
    }

    /// Prints a line above the bar, or to stderr if there is no bar.
    pub fn say(&self, line: &str) {
        match self.bar.get() {
            Some(bar) => bar.println(line),
            None => drop(writeln!(AboveBars, "{line}")),
        }
    }

    /// Removes the bar.
    pub fn clear(&self) {
        if let Some(bar) = self.bar.get() {
            bar.finish_and_clear();
        }
    }
}

/// Time that the rest takes at the present pace; `None` in the first half second, before anything is done, and where less
/// than a second is left.
fn time_left(done: u64, total: u64, spent: Duration) -> Option<Duration> {
    let is_known = 0 < done && done < total && spent >= Duration::from_millis(500);
    is_known
        .then(|| spent.mul_f64((total - done) as f64 / done as f64))
        .filter(|left| *left >= Duration::from_secs(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_unknown_before_there_is_a_pace() {
        let s = Duration::from_secs;
        assert_eq!(time_left(0, 100, s(5)), None);
        assert_eq!(time_left(1, 10_000, Duration::from_millis(200)), None);
        assert_eq!(time_left(10, 100, Duration::from_millis(20)), None);
        assert_eq!(time_left(25, 100, s(4)), Some(s(12)));
        // At the end there is no time left to show.
        assert_eq!(time_left(99, 100, s(4)), None);
        assert_eq!(time_left(100, 100, s(4)), None);
    }

    #[test]
    fn a_new_total_begins_a_new_stage() {
        let bar = Bar::new("steps");
        bar.left(50, 100);
        bar.left(1, 10);
        let stage = bar.stage.lock().unwrap();
        assert_eq!(stage.as_ref().map(|s| (s.total, s.done)), Some((10, 1)));
    }
}
