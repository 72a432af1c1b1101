//! Operator steps at the terminal: prints what a scan asks for and reads the confirmation.

use std::io::{BufRead, IsTerminal};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::progress::Bar;
use crate::scan::OperatorAction;

/// Shortest time in which a person reads a prompt and confirms it. An Enter that comes sooner was meant for the previous
/// step, which another client has just confirmed.
const REACTION: Duration = Duration::from_secs(1);

/// The prompt for the operator at the terminal, who does what a scan asks for and presses Enter.
pub struct OperatorPrompt {
    typed: watch::Receiver<Typed>,
    /// Number of lines typed before the prompt, which do not confirm it.
    before: u64,
    /// When the prompt has been shown long enough to be read.
    read_at: Instant,
    /// How long that takes; zero where a program answers.
    reaction: Duration,
    /// Whether a prompt is unconfirmed, so that an Enter for it may still come.
    open: bool,
}

/// Input from the terminal so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Typed {
    lines: u64,
    /// When the last line came.
    at: Option<Instant>,
    ended: bool,
}

/// An answer to a prompt.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reply {
    /// The step is done.
    Done,
    /// An Enter that was meant for the previous prompt.
    TooSoon,
    /// The input has ended.
    Ended,
}

impl Typed {
    /// Returns the answer since the prompt; `None` if there is none.
    fn since(self, before: u64, read_at: Instant) -> Option<Reply> {
        let soon = self.at.is_some_and(|at| at < read_at);
        match (self.lines > before, self.ended) {
            (true, _) if soon => Some(Reply::TooSoon),
            (true, _) => Some(Reply::Done),
            (false, true) => Some(Reply::Ended),
            (false, false) => None,
        }
    }
}

impl OperatorPrompt {
    /// Starts to read the terminal.
    #[must_use]
    pub fn at_the_terminal() -> OperatorPrompt {
        let (sender, typed) = watch::channel(Typed::default());
        // A read cannot be cancelled, so it has a thread of its own that ends with the process.
        std::thread::spawn(move || {
            let mut line = String::new();
            let mut more = true;
            while more && !sender.is_closed() {
                line.clear();
                let read = std::io::stdin().lock().read_line(&mut line);
                more = matches!(read, Ok(n) if n > 0);
                sender.send_modify(|typed| match more {
                    true => {
                        typed.lines += 1;
                        typed.at = Some(Instant::now());
                    }
                    false => typed.ended = true,
                });
            }
        });
        let reaction = match std::io::stdin().is_terminal() {
            true => REACTION,
            false => Duration::ZERO,
        };
        OperatorPrompt::heard(typed, reaction)
    }

    fn heard(typed: watch::Receiver<Typed>, reaction: Duration) -> OperatorPrompt {
        OperatorPrompt {
            typed,
            before: 0,
            read_at: Instant::now(),
            reaction,
            open: false,
        }
    }

    /// Prints the step; from now on Enter confirms it.
    pub(super) fn ask(&mut self, bar: &Bar, action: OperatorAction) {
        let hint = if std::io::stdin().is_terminal() {
            " [Enter]"
        } else {
            ""
        };
        // Before printing, since the answer may come at once.
        self.before = self.typed.borrow().lines;
        bar.say(&format!("{}{hint}", action.message()));
        self.read_at = match self.open {
            true => Instant::now() + self.reaction,
            false => Instant::now(),
        };
        self.open = true;
    }

    /// Waits for Enter; false if the input has ended.
    pub(super) async fn done(&mut self, bar: &Bar) -> bool {
        loop {
            let (before, read_at) = (self.before, self.read_at);
            let typed = self
                .typed
                .wait_for(|now| now.since(before, read_at).is_some());
            if typed.await.is_err() {
                return false;
            }
            if let Some(done) = self.done_by_now(bar) {
                return done;
            }
        }
    }

    /// Checks for Enter without waiting; `None` if there was none.
    pub(super) fn done_by_now(&mut self, bar: &Bar) -> Option<bool> {
        let typed = *self.typed.borrow();
        match typed.since(self.before, self.read_at)? {
            Reply::Done => {
                self.open = false;
                Some(true)
            }
            Reply::Ended => Some(false),
            Reply::TooSoon => {
                self.before = typed.lines;
                bar.say(
                    "Enter came while the step changed and was ignored: press it again once this step is done.",
                );
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_typed_before_a_prompt_do_not_confirm_it() {
        let now = Instant::now();
        let typed = |lines, ended| Typed {
            lines,
            at: Some(now),
            ended,
        };
        assert_eq!(typed(3, false).since(3, now), None);
        assert_eq!(typed(4, false).since(3, now), Some(Reply::Done));
        // A line before the end of the input counts.
        assert_eq!(typed(4, true).since(3, now), Some(Reply::Done));
        assert_eq!(typed(3, true).since(3, now), Some(Reply::Ended));
    }

    #[tokio::test]
    async fn enter_that_comes_as_the_step_changes_is_not_for_the_new_one() {
        let (keys, typed) = watch::channel(Typed::default());
        let enter = || {
            keys.send_modify(|typed| {
                typed.lines += 1;
                typed.at = Some(Instant::now());
            });
        };
        let bar = Bar::new("frames");
        let mut people = OperatorPrompt::heard(typed, Duration::from_millis(200));
        people.ask(&bar, OperatorAction::CapLens);
        // The page confirms the step while an Enter for it is still to come here.
        people.ask(&bar, OperatorAction::PlaceSample);
        enter();
        assert_eq!(people.done_by_now(&bar), None);
        // It stays ignored however long no other line comes.
        while Instant::now() < people.read_at {
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_eq!(people.done_by_now(&bar), None);
        enter();
        assert!(people.done(&bar).await);
        // No Enter was outstanding when this step was shown.
        people.ask(&bar, OperatorAction::PlaceSample);
        enter();
        assert_eq!(people.done_by_now(&bar), Some(true));
        // A program that answers has read the prompt.
        people.reaction = Duration::ZERO;
        people.ask(&bar, OperatorAction::CapLens);
        people.ask(&bar, OperatorAction::PlaceSample);
        enter();
        assert_eq!(people.done_by_now(&bar), Some(true));
    }
}
