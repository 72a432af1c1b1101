//! The motion of a motor: piecewise constant acceleration, as a pure function of time.
//!
//! [`Trajectory::to`] is the function to call. Positions are counts; times are seconds since the
//! start of the trajectory. The axis defines what a count means.

/// Cruising speed and ramps of a move; all positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramps {
    /// Cruising speed, counts/s.
    pub speed: f64,
    /// Acceleration, counts/s².
    pub acceleration: f64,
    /// Deceleration, counts/s².
    pub deceleration: f64,
}

/// An interval of constant acceleration. The velocity does not change its sign within it, so the
/// motor moves in one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stretch {
    duration_s: f64,
    position: f64,
    velocity: f64,
    acceleration: f64,
}

impl Stretch {
    fn at(&self, t: f64) -> (f64, f64) {
        (
            self.position + self.velocity * t + 0.5 * self.acceleration * t * t,
            self.velocity + self.acceleration * t,
        )
    }
}

/// Position of a motor as a function of the time since the start of a move. Ends at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    stretches: Vec<Stretch>,
    end: f64,
    duration_s: f64,
}

impl Trajectory {
    /// Makes the trajectory of a motor at rest at `position`.
    #[must_use]
    pub fn rest(position: f64) -> Self {
        Trajectory {
            stretches: Vec::new(),
            end: position,
            duration_s: 0.0,
        }
    }

    /// Makes a move from `position`, with initial `velocity` (counts/s), to rest at `target`:
    /// trapezoidal or triangular. A motor that moves away from the target, or too fast to stop in
    /// time, brakes to rest first and then returns.
    #[must_use]
    pub fn to(position: f64, velocity: f64, target: f64, ramps: Ramps) -> Self {
        let mut path = Builder::new(position, velocity);
        let distance = target - position;
        let braking = velocity * velocity / (2.0 * ramps.deceleration);
        if velocity != 0.0
            && (distance * velocity < 0.0 || braking > distance.abs() * (1.0 + 1e-12))
        {
            path.change_speed(0.0, ramps.deceleration);
        }
        path.travel(target, ramps);
        path.finish(target)
    }

    /// Brakes from `position` and `velocity` to rest on the shortest way. It ends at a whole count.
    #[must_use]
    pub fn brake(position: f64, velocity: f64, deceleration: f64) -> Self {
        let mut path = Builder::new(position, velocity);
        path.change_speed(0.0, deceleration);
        let end = path.position.round();
        path.finish(end)
    }

    /// Position (counts) and velocity (counts/s) `t` seconds after the start.
    #[must_use]
    pub fn at(&self, t: f64) -> (f64, f64) {
        if t >= self.duration_s {
            return (self.end, 0.0);
        }
        let mut left = t.max(0.0);
        for stretch in &self.stretches {
            if left < stretch.duration_s {
                return stretch.at(left);
            }
            left -= stretch.duration_s;
        }
        (self.end, 0.0)
    }

    /// Time from start to rest.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Where the motor comes to rest.
    #[must_use]
    pub fn end(&self) -> f64 {
        self.end
    }

    /// First time after the start at which the motor passes or reaches `position`, if it does.
    #[must_use]
    pub fn time_at(&self, position: f64) -> Option<f64> {
        let mut began = 0.0;
        for stretch in &self.stretches {
            let (from, to) = (stretch.position, stretch.at(stretch.duration_s).0);
            if from != position && (from - position) * (to - position) <= 0.0 {
                let (mut low, mut high) = (0.0, stretch.duration_s);
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if (stretch.at(middle).0 - position) * (from - position) > 0.0 {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                return Some(began + high);
            }
            began += stretch.duration_s;
        }
        None
    }

    /// Play in the gear `t` seconds after the start: the output is `gap` above the motor, with 0 ≤
    /// gap ≤ `play`. Upward motion closes the gap, downward motion opens it.
    #[must_use]
    pub fn gap(&self, gap_at_start: f64, play: f64, t: f64) -> f64 {
        let mut gap = gap_at_start;
        let mut left = t.max(0.0);
        for stretch in &self.stretches {
            let end = stretch.at(left.min(stretch.duration_s)).0;
            gap = (gap - (end - stretch.position)).clamp(0.0, play);
            left -= stretch.duration_s;
            if left <= 0.0 {
                break;
            }
        }
        gap
    }
}

struct Builder {
    stretches: Vec<Stretch>,
    position: f64,
    velocity: f64,
}

impl Builder {
    fn new(position: f64, velocity: f64) -> Self {
        Builder {
            stretches: Vec::new(),
            position,
            velocity,
        }
    }

    fn push(&mut self, duration_s: f64, acceleration: f64, velocity_after: f64) {
        if duration_s <= 0.0 {
            return;
        }
        let stretch = Stretch {
            duration_s,
            position: self.position,
            velocity: self.velocity,
            acceleration,
        };
        self.position = stretch.at(duration_s).0;
        self.velocity = velocity_after;
        self.stretches.push(stretch);
    }

    fn change_speed(&mut self, velocity: f64, rate: f64) {
        let change = velocity - self.velocity;
        self.push(change.abs() / rate, rate.copysign(change), velocity);
    }

    /// Trapezoid or triangle to `target`. The present velocity must point there or be zero, and
    /// leave room to brake.
    fn travel(&mut self, target: f64, ramps: Ramps) {
        let way = (target - self.position).signum();
        if self.velocity.abs() > ramps.speed {
            self.change_speed(way * ramps.speed, ramps.deceleration);
        }
        let distance = (target - self.position).abs();
        let v0 = self.velocity.abs();
        let (up, down) = (0.5 / ramps.acceleration, 0.5 / ramps.deceleration);
        // v² up − v0² up + v² down = distance
        let peak = ((distance + v0 * v0 * up) / (up + down)).sqrt().max(v0);
        let cruise = peak.min(ramps.speed.max(v0));
        self.change_speed(way * cruise, ramps.acceleration);
        let left = (target - self.position).abs() - cruise * cruise * down;
        if cruise > 0.0 && left > 0.0 {
            self.push(left / cruise, 0.0, way * cruise);
        }
        self.change_speed(0.0, ramps.deceleration);
    }

    fn finish(self, end: f64) -> Trajectory {
        Trajectory {
            duration_s: self.stretches.iter().map(|s| s.duration_s).sum(),
            stretches: self.stretches,
            end,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RAMPS: Ramps = Ramps {
        speed: 100.0,
        acceleration: 200.0,
        deceleration: 200.0,
    };

    #[test]
    fn a_long_move_is_a_trapezoid_and_a_short_one_a_triangle() {
        // v/a + d/v = 0.5 + 10
        let long = Trajectory::to(0.0, 0.0, 1000.0, RAMPS);
        assert!((long.duration_s() - 10.5).abs() < 1e-9);
        assert!((long.at(5.0).1 - 100.0).abs() < 1e-9);
        // 2 √(d/a)
        let short = Trajectory::to(0.0, 0.0, 8.0, RAMPS);
        assert!((short.duration_s() - 0.4).abs() < 1e-9);
        assert_eq!(Trajectory::to(5.0, 0.0, 5.0, RAMPS).duration_s(), 0.0);
    }

    #[test]
    fn a_motor_too_fast_to_stop_overshoots_and_returns() {
        // Braking takes 25 counts; the target is 5 ahead, so it returns by 20: 0.5 s + 2 √(20/200)
        // s.
        let path = Trajectory::to(0.0, 100.0, 5.0, RAMPS);
        assert!((path.duration_s() - (0.5 + 2.0 * 0.1f64.sqrt())).abs() < 1e-9);
        assert!((path.at(0.5).0 - 25.0).abs() < 1e-9);
        assert_eq!(path.at(9.0), (5.0, 0.0));
    }

    #[test]
    fn play_opens_downwards_and_closes_upwards() {
        let down = Trajectory::to(100.0, 0.0, 50.0, RAMPS);
        assert_eq!(down.gap(0.0, 3.0, 9.0), 3.0);
        let up = Trajectory::to(50.0, 0.0, 52.0, RAMPS);
        assert!((up.gap(3.0, 3.0, 9.0) - 1.0).abs() < 1e-9);
        let further = Trajectory::to(50.0, 0.0, 60.0, RAMPS);
        assert_eq!(further.gap(3.0, 3.0, 9.0), 0.0);
    }

    proptest! {
        #![proptest_config(crate::extremes::cases(256))]

        #[test]
        fn position_and_velocity_are_continuous_and_end_at_the_target(
            from in -1e5..1e5f64, v0 in -500.0..500.0f64, to in -1e5..1e5f64,
            speed in 1.0..1000.0f64, a in 1.0..5000.0f64, d in 1.0..5000.0f64,
        ) {
            let ramps = Ramps { speed, acceleration: a, deceleration: d };
            let path = Trajectory::to(from, v0, to, ramps);
            let n = 2000;
            let dt = path.duration_s() / f64::from(n);
            let fastest = speed.max(v0.abs()) * (1.0 + 1e-9) + 1e-9;
            let mut before = (from, v0);
            for i in 1..=n {
                let now = path.at(dt * f64::from(i));
                prop_assert!(now.1.abs() <= fastest);
                prop_assert!((now.1 - before.1).abs() <= a.max(d) * dt * (1.0 + 1e-6) + 1e-6);
                prop_assert!((now.0 - before.0).abs() <= fastest * dt + 1e-4);
                before = now;
            }
            prop_assert_eq!(path.at(path.duration_s()), (to, 0.0));
        }

        #[test]
        fn time_at_is_the_time_of_passing(to in 1.0..1e4f64, share in 0.01..0.99f64) {
            let path = Trajectory::to(0.0, 0.0, to, RAMPS);
            let t = path.time_at(to * share).unwrap();
            prop_assert!((path.at(t).0 - to * share).abs() < 1e-6);
            prop_assert!(path.time_at(-1.0).is_none());
        }
    }
}
