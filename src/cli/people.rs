//! Who does what a scan asks for, and says so at the terminal.

use std::io::{BufRead, IsTerminal};

use tokio::sync::watch;

use super::progress::Bar;
use crate::scan::OperatorAction;

/// People at the terminal who do what a scan asks for and press Enter.
pub struct People {
    typed: watch::Receiver<Typed>,
    /// Lines typed before the question: no answers to it.
    before: u64,
}

/// What came from the terminal so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Typed {
    lines: u64,
    ended: bool,
}

impl Typed {
    /// Whether somebody has pressed Enter since, or nobody ever will; `None` where neither is so yet.
    fn since(self, before: u64) -> Option<bool> {
        match (self.lines > before, self.ended) {
            (true, _) => Some(true),
            (false, true) => Some(false),
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
                    true => typed.lines += 1,
                    false => typed.ended = true,
                });
            }
        });
        People { typed, before: 0 }
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
    }

    /// Waits for Enter; false where nobody is there to press it.
    pub(super) async fn done(&mut self) -> bool {
        let before = self.before;
        let typed = self.typed.wait_for(|now| now.since(before).is_some());
        typed.await.is_ok_and(|now| now.since(before) == Some(true))
    }

    /// The same without waiting; `None` where nothing has come.
    pub(super) fn done_by_now(&self) -> Option<bool> {
        self.typed.borrow().since(self.before)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_typed_before_the_question_is_no_answer() {
        let typed = |lines, ended| Typed { lines, ended };
        assert_eq!(typed(3, false).since(3), None);
        assert_eq!(typed(4, false).since(3), Some(true));
        // Who answers and goes has answered.
        assert_eq!(typed(4, true).since(3), Some(true));
        assert_eq!(typed(3, true).since(3), Some(false));
    }
}
