//! A progress bar that shows itself on a terminal only, and only once it is worth it.

use std::io::IsTerminal;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// A bar on stderr.
pub struct Bar {
    started: Instant,
    terminal: bool,
    unit: &'static str,
    bar: OnceLock<ProgressBar>,
}

impl Bar {
    /// A bar that counts `unit`; nothing is shown yet.
    #[must_use]
    pub fn new(unit: &'static str) -> Self {
        Bar {
            started: Instant::now(),
            terminal: std::io::stderr().is_terminal(),
            unit,
            bar: OnceLock::new(),
        }
    }

    /// Shows `done` of `total`, from one second after the start on.
    pub fn at(&self, done: u64, total: u64) {
        self.show(done, total, "");
    }

    /// The same with a word on what is going on.
    pub fn show(&self, done: u64, total: u64, word: &str) {
        if !self.terminal || self.started.elapsed() < Duration::from_secs(1) {
            return;
        }
        let bar = self.bar.get_or_init(|| {
            let template = format!(
                "{{msg:30}} {{wide_bar}} {{pos}}/{{len}} {}, {{eta}} left",
                self.unit
            );
            let style = ProgressStyle::with_template(&template)
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            ProgressBar::new(total).with_style(style)
        });
        bar.set_length(total);
        bar.set_position(done);
        if !word.is_empty() {
            bar.set_message(word.to_owned());
        }
    }

    /// Prints a line above the bar, or plainly to stderr where there is none.
    pub fn say(&self, line: &str) {
        match self.bar.get() {
            Some(bar) => bar.println(line),
            None => eprintln!("{line}"),
        }
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        if let Some(bar) = self.bar.get() {
            bar.finish_and_clear();
        }
    }
}
