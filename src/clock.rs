//! Time as an argument: the daemon, the simulated rig and the tests each get the clock they need.
//!
//! Monotonic time is used to order, wait and measure durations; UTC is only a label, and always the
//! machine's own. [`SystemClock`] is real time, [`ScaledClock`] runs a simulated rig faster than real
//! time, and [`SteppedClock`] advances only when a task sleeps on it, so a whole scan runs in a test
//! without waiting and reproducibly.

use std::sync::{LazyLock, Mutex};
use std::time::{Duration, Instant};

use futures::future::BoxFuture;
use time::OffsetDateTime;

/// Real time in seconds since the first call, for calculations, which neither wait nor need the
/// time of day.
#[must_use]
pub fn elapsed_s() -> f64 {
    monotonic().as_secs_f64()
}

/// Real time since the first call.
#[must_use]
pub fn monotonic() -> Duration {
    static STARTED: LazyLock<Instant> = LazyLock::new(Instant::now);
    STARTED.elapsed()
}

/// A source of time and the only way to wait.
pub trait Clock: Send + Sync + 'static {
    /// Monotonic time since the clock was created.
    fn now(&self) -> Duration;
    /// The machine's wall-clock time, however fast a simulated rig runs. Only a label: it may jump.
    fn utc(&self) -> OffsetDateTime;
    /// Seconds of the machine's time in a second of this clock: below 1 on a simulated rig that runs faster.
    fn machine_s_per_s(&self) -> f64 {
        1.0
    }
    /// Time of the machine since it was switched on, the time it was suspended included; `None` if it is unknown. Used only to
    /// find gaps in which the program did not run.
    fn machine_uptime(&self) -> Option<Duration> {
        let text = std::fs::read_to_string("/proc/uptime").ok()?;
        let seconds: f64 = text.split_whitespace().next()?.parse().ok()?;
        Duration::try_from_secs_f64(seconds).ok()
    }
    /// Completes after `duration` on this clock.
    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()>;
}

/// Real time.
#[derive(Debug)]
pub struct SystemClock {
    started: Instant,
}

impl SystemClock {
    /// Makes a clock that starts now.
    #[must_use]
    pub fn new() -> Self {
        SystemClock {
            started: Instant::now(),
        }
    }
}

impl Default for SystemClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Duration {
        self.started.elapsed()
    }

    fn utc(&self) -> OffsetDateTime {
        OffsetDateTime::now_utc()
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        Box::pin(tokio::time::sleep(duration))
    }
}

/// Real time multiplied by a constant factor, for a simulated rig.
#[derive(Debug)]
pub struct ScaledClock {
    started: Instant,
    scale: f64,
}

impl ScaledClock {
    /// Makes a clock on which `scale` seconds pass per real second. If `scale` is not finite and
    /// positive, 1 is used.
    #[must_use]
    pub fn new(scale: f64) -> Self {
        let scale = if scale.is_finite() && scale > 0.0 {
            scale
        } else {
            1.0
        };
        ScaledClock {
            started: Instant::now(),
            scale,
        }
    }
}

impl Clock for ScaledClock {
    fn now(&self) -> Duration {
        self.started.elapsed().mul_f64(self.scale)
    }

    fn utc(&self) -> OffsetDateTime {
        OffsetDateTime::now_utc()
    }

    fn machine_s_per_s(&self) -> f64 {
        self.scale.recip()
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        Box::pin(tokio::time::sleep(duration.div_f64(self.scale)))
    }
}

/// Time that stands still until a task sleeps: each sleep advances it at once.
#[derive(Debug)]
pub struct SteppedClock {
    now: Mutex<Duration>,
    suspended: Mutex<Duration>,
    epoch: OffsetDateTime,
}

impl SteppedClock {
    /// Makes a clock at zero, labelled with a fixed date so that tests are reproducible.
    #[must_use]
    pub fn new() -> Self {
        SteppedClock {
            now: Mutex::new(Duration::ZERO),
            suspended: Mutex::new(Duration::ZERO),
            epoch: time::macros::datetime!(2026-01-01 00:00 UTC),
        }
    }

    /// Suspends the machine for `duration`; the time itself stands still.
    pub fn suspend_machine(&self, duration: Duration) {
        *self
            .suspended
            .lock()
            .expect("no holder of this lock panics") += duration;
    }

    /// Advances the time by `duration`.
    pub fn advance(&self, duration: Duration) {
        *self.now.lock().expect("no holder of this lock panics") += duration;
    }
}

impl Default for SteppedClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for SteppedClock {
    fn now(&self) -> Duration {
        *self.now.lock().expect("no holder of this lock panics")
    }

    fn utc(&self) -> OffsetDateTime {
        self.epoch + self.now()
    }

    fn machine_uptime(&self) -> Option<Duration> {
        let suspended = self.suspended.lock();
        Some(*suspended.expect("no holder of this lock panics"))
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        self.advance(duration);
        Box::pin(tokio::task::yield_now())
    }
}

/// Compares the time of day with the elapsed time: the time of day is set by hand or by NTP, and
/// jumps when a machine was suspended.
#[derive(Debug, Default)]
pub struct WallWatch {
    last: Option<(Duration, OffsetDateTime)>,
}

impl WallWatch {
    /// Returns the deviation of the time of day since the last call, if it exceeds a second.
    pub fn step(&mut self, now: Duration, wall: OffsetDateTime) -> Option<time::Duration> {
        let (last_now, last_wall) = self.last.replace((now, wall))?;
        let step = (wall - last_wall) - (now.saturating_sub(last_now));
        (step.abs() > time::Duration::SECOND).then_some(step)
    }
}

/// Finds gaps in which this program did not run: the machine was suspended, or the process stopped.
#[derive(Debug)]
pub struct GapWatch {
    last: Option<Duration>,
}

impl GapWatch {
    /// Time between two looks.
    const LOOK_EVERY: Duration = Duration::from_millis(500);
    /// Shortest gap that counts; a busy machine makes shorter ones.
    const GAP_MIN: Duration = Duration::from_secs(5);

    /// Starts to watch.
    #[must_use]
    pub fn new(clock: &dyn Clock) -> GapWatch {
        GapWatch {
            last: clock.machine_uptime(),
        }
    }

    /// Completes after a gap.
    pub async fn next(&mut self, clock: &dyn Clock) -> Duration {
        loop {
            tokio::time::sleep(Self::LOOK_EVERY).await;
            if let Some(gap) = self.gap(clock) {
                return gap;
            }
        }
    }

    /// Returns the gap since the last look, if there was one.
    fn gap(&mut self, clock: &dyn Clock) -> Option<Duration> {
        let now = clock.machine_uptime()?;
        let last = self.last.replace(now)?;
        let gap = now.saturating_sub(last);
        (gap >= Self::GAP_MIN).then_some(gap)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_of_the_time_of_day_is_reported_once_and_drift_is_not() {
        let mut watch = WallWatch::default();
        let start = time::macros::datetime!(2026-01-01 00:00 UTC);
        let mut look = |now_s: u64, wall_s: f64| {
            let wall = start + time::Duration::seconds_f64(wall_s);
            let step = watch.step(Duration::from_secs(now_s), wall);
            step.map(time::Duration::as_seconds_f64)
        };
        assert_eq!(look(0, 0.0), None);
        assert_eq!(look(10, 10.5), None);
        assert_eq!(look(20, 21.0), None);
        assert_eq!(look(30, 3631.0), Some(3600.0));
        assert_eq!(look(40, 3641.0), None);
        assert_eq!(look(50, 41.0), Some(-3610.0));
    }

    #[test]
    fn a_gap_is_reported_once_and_a_busy_machine_makes_none() {
        let clock = SteppedClock::new();
        let mut watch = GapWatch::new(&clock);
        clock.suspend_machine(Duration::from_secs(2));
        assert_eq!(watch.gap(&clock), None);
        clock.suspend_machine(Duration::from_secs(30));
        assert_eq!(watch.gap(&clock), Some(Duration::from_secs(30)));
        assert_eq!(watch.gap(&clock), None);
    }

    #[test]
    fn what_a_fast_clock_dates_has_the_real_time_of_day() {
        let fast = ScaledClock::new(1e9);
        let began = OffsetDateTime::now_utc();
        // A microsecond of real time is a quarter of an hour on this clock.
        while fast.now() < Duration::from_secs(7200) {}
        assert!(fast.utc() >= began);
        assert!(fast.utc() - began < time::Duration::HOUR);
    }
}
