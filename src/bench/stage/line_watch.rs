//! Watches a line for replies that nothing explains: of a second device at an address, or to another program.

use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use super::error::StageError;
use super::notice::Notices;
use crate::bench::line::PortLine;

/// Second answers since the last check that show a second device: fewer may be garbled replies.
const SECOND_ANSWERS: u64 = 3;
/// Number of foreign replies since the last notice that causes the next one.
const FOREIGN_REPLIES: u64 = 3;
/// Least time between two notices.
const NOTICE_EVERY: Duration = Duration::from_secs(600);

#[derive(Default)]
struct Seen {
    second_answers: u64,
    foreign: u64,
    reported_at: Option<Instant>,
}

/// What was seen on the line up to the last check.
pub(super) struct LineWatch {
    notices: Notices,
    seen: Mutex<Seen>,
}

impl LineWatch {
    pub fn new(notices: Notices) -> LineWatch {
        LineWatch {
            notices,
            seen: Mutex::default(),
        }
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().expect("no holder of this lock panics")
    }

    /// Refuses to continue if commands got two different answers.
    ///
    /// # Errors
    /// [`StageError::AddressConflict`].
    pub fn check(&self, line: &PortLine) -> Result<(), StageError> {
        self.report_foreign_traffic(line);
        let counts = line.counts();
        let mut seen = self.seen();
        if counts.second_answers < seen.second_answers + SECOND_ANSWERS {
            return Ok(());
        }
        seen.second_answers = counts.second_answers;
        Err(StageError::AddressConflict {
            address: counts.second_answer_address,
        })
    }

    /// Warns a person if another program or device talks on the line.
    pub fn report_foreign_traffic(&self, line: &PortLine) {
        let counts = line.counts();
        let mut seen = self.seen();
        if counts.foreign < seen.foreign + FOREIGN_REPLIES {
            return;
        }
        let count = counts.foreign - seen.foreign;
        seen.foreign = counts.foreign;
        if seen
            .reported_at
            .is_some_and(|at| at.elapsed() < NOTICE_EVERY)
        {
            return;
        }
        seen.reported_at = Some(Instant::now());
        let message = format!(
            "another program or device uses the line of the stages: {count} replies answer no command of this daemon. They \
             were ignored, but a foreign command may move the stages: close the other program, or disconnect the other \
             device"
        );
        self.notices.send("stage-foreign-traffic", message);
    }
}
