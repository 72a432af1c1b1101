//! Ends work that only checks a flag: the flag is raised when the work is cancelled or when its time is over.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// Time between two looks at the clock.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Does `work` with a flag that is raised once `cancel` is raised or `is_over` returns true, so that the work ends in the
/// midst of it.
pub fn flagging<T>(
    is_over: &(dyn Fn() -> bool + Sync),
    cancel: &AtomicBool,
    work: impl FnOnce(&AtomicBool) -> T,
) -> T {
    let flag = &AtomicBool::new(false);
    // Dropped at the end of the work, also where it panics, which ends the wait.
    let (working, end) = channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while !(cancel.load(Ordering::Relaxed) || is_over()) {
                if end.recv_timeout(LOOK_EVERY) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
            flag.store(true, Ordering::Relaxed);
        });
        let _working = working;
        work(flag)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    #[test]
    fn work_that_only_checks_a_flag_ends_with_its_time_and_on_cancel() {
        let begun = Instant::now();
        let until_raised = |flag: &AtomicBool| {
            while !flag.load(Ordering::Relaxed) {
                std::thread::yield_now();
            }
        };
        let time = Duration::from_millis(50);
        let calm = AtomicBool::new(false);
        flagging(&|| begun.elapsed() >= time, &calm, until_raised);
        assert!(begun.elapsed() >= time);
        flagging(&|| false, &AtomicBool::new(true), until_raised);
        assert!(flagging(&|| false, &calm, |flag| !flag.load(Ordering::Relaxed)));
    }

    #[test]
    #[should_panic(expected = "the work fails")]
    fn work_that_panics_ends_the_wait() {
        let calm = AtomicBool::new(false);
        flagging(&|| false, &calm, |flag| {
            assert!(flag.load(Ordering::Relaxed), "the work fails")
        });
    }
}
