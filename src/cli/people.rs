//! Who does what a scan asks for, and says so at the terminal.

use std::io::{BufRead, IsTerminal};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::progress::Bar;
use crate::scan::OperatorAction;

/// Nobody reads a prompt and answers it in less: who presses Enter so soon meant the step before, which somebody else
/// has just ended.
const REACTION: Duration = Duration::from_secs(1);

/// People at the terminal who do what a scan asks for and press Enter.
pub struct People {
    typed: watch::Receiver<Typed>,
    /// Lines typed before the question: no answers to it.
    before: u64,
    /// When the question stood there long enough to be read.
    read_at: Instant,
    /// How long that takes; nothing where a program answers.
    reaction: Duration,
    /// Whether a question stands there that nobody here has answered: Enter may be on its way to it.
    open: bool,
}

/// What came from the terminal so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Typed {
    lines: u64,
    /// When the last of them came.
    at: Option<Instant>,
    ended: bool,
}

/// What somebody says of a question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    /// It is done.
    Done,
    /// Enter, but for the question before.
    TooSoon,
    /// Nobody is there.
    Nobody,
}

impl Typed {
    /// What came since; `None` where nothing has.
    fn since(self, before: u64, read_at: Instant) -> Option<Answer> {
        let soon = self.at.is_some_and(|at| at < read_at);
        match (self.lines > before, self.ended) {
            (true, _) if soon => Some(Answer::TooSoon),
            (true, _) => Some(Answer::Done),
            (false, true) => Some(Answer::Nobody),
            (false, false) => None,
        }
    }
}

impl People {
    /// Listens to the terminal from now on.
    #[must_use]
    pub fn at_the_terminal() -> People {
        let (sender, typed) = watch::channel(Typed::default());
        // A read cannot be cancelled: it has a thread of its own that dies with the process.
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
        People::heard(typed, reaction)
    }

    fn heard(typed: watch::Receiver<Typed>, reaction: Duration) -> People {
        People {
            typed,
            before: 0,
            read_at: Instant::now(),
            reaction,
            open: false,
        }
    }

    /// Says what to do; from now on Enter means that it is done.
    pub(super) fn ask(&mut self, bar: &Bar, action: OperatorAction) {
        let hint = if std::io::stdin().is_terminal() {
            " [Enter]"
        } else {
            ""
        };
        // First: who reads the question may answer at once.
        self.before = self.typed.borrow().lines;
        bar.say(&format!("{}{hint}", action.message()));
        self.read_at = match self.open {
            true => Instant::now() + self.reaction,
            false => Instant::now(),
        };
        self.open = true;
    }

    /// Waits for Enter; false where nobody is there to press it.
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

    /// The same without waiting; `None` where nothing has come.
    pub(super) fn done_by_now(&mut self, bar: &Bar) -> Option<bool> {
        let typed = *self.typed.borrow();
        match typed.since(self.before, self.read_at)? {
            Answer::Done => {
                self.open = false;
                Some(true)
            }
            Answer::Nobody => Some(false),
            Answer::TooSoon => {
                self.before = typed.lines;
                bar.say(
                    "That Enter came as the step changed and was not counted: press it again once this one is done.",
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
    fn what_was_typed_before_the_question_is_no_answer() {
        let now = Instant::now();
        let typed = |lines, ended| Typed {
            lines,
            at: Some(now),
            ended,
        };
        assert_eq!(typed(3, false).since(3, now), None);
        assert_eq!(typed(4, false).since(3, now), Some(Answer::Done));
        // Who answers and goes has answered.
        assert_eq!(typed(4, true).since(3, now), Some(Answer::Done));
        assert_eq!(typed(3, true).since(3, now), Some(Answer::Nobody));
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
        let mut people = People::heard(typed, Duration::from_millis(200));
        people.ask(&bar, OperatorAction::CapLens);
        // Somebody at the page continues the scan, and here Enter is on its way.
        people.ask(&bar, OperatorAction::PlaceSample);
        enter();
        assert_eq!(people.done_by_now(&bar), None);
        // It stays uncounted, however long nobody says more.
        while Instant::now() < people.read_at {
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_eq!(people.done_by_now(&bar), None);
        enter();
        assert!(people.done(&bar).await);
        // Nothing was on its way when this one was asked.
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
