//! Jogging: an axis moves while its client renews the order, and no other client can renew it.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::axis_motion::{AxisMotion, JogWork};
use super::work::Work;
use crate::bench::stage::JogOrder;
use crate::lab::{AxisName, Lab, LabError};

/// How long an order lasts. Real time: it depends on a person.
const RENEW_WITHIN: Duration = Duration::from_millis(500);
/// Greatest speed of a request; the axis has its own limit.
const SPEED_DEG_S_MAX: f64 = 1000.0;

/// A request to begin, renew or end a jog.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JogRequest {
    /// The axis that moves; one axis at a time.
    pub axis: AxisName,
    /// Speed and direction, °/s; 0 ends the jog.
    pub speed_deg_s: f64,
    /// The jog to renew; `None` begins one.
    pub jog: Option<u64>,
}

/// State of a jog.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
#[schema(as = JogAnswer)]
pub struct JogView {
    /// Number of the jog: send it with each renewal.
    pub jog: u64,
    /// Whether the axis has stopped for good.
    pub ended: bool,
    /// Why the axis waits at the end of its way: its limit, or a forbidden region; null while it moves.
    pub at_end: Option<String>,
}

/// The last jog, as its clients see it.
#[derive(Debug, Default)]
pub(in crate::lab) struct Jogs {
    last: Mutex<Option<LiveJog>>,
}

#[derive(Debug, Clone)]
struct LiveJog {
    number: u64,
    axis: AxisName,
    order: watch::Sender<JogOrder>,
    at_end: Arc<Mutex<Option<String>>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("no holder of this lock panics")
}

impl LiveJog {
    fn is_over(&self) -> bool {
        self.order.is_closed()
    }

    fn view(&self) -> JogView {
        JogView {
            jog: self.number,
            ended: self.is_over(),
            at_end: locked(&self.at_end).clone(),
        }
    }
}

impl Lab {
    /// Begins, renews or ends a jog. The axis stops by itself [`RENEW_WITHIN`] after the last request.
    ///
    /// # Errors
    /// [`LabError::JogEnded`] where a renewal comes too late or after a stop, [`LabError::Invalid`], and what
    /// [`Lab::move_axis`] returns.
    pub async fn jog(&self, request: JogRequest) -> Result<JogView, LabError> {
        let JogRequest {
            axis,
            speed_deg_s,
            jog,
        } = request;
        if !(-SPEED_DEG_S_MAX..=SPEED_DEG_S_MAX).contains(&speed_deg_s) {
            return Err(LabError::Invalid {
                field: "speed_deg_s".into(),
                problem: format!(
                    "is {speed_deg_s}, expected -{SPEED_DEG_S_MAX} to {SPEED_DEG_S_MAX} degrees per second"
                ),
            });
        }
        let order = JogOrder {
            speed_deg_s,
            until: Instant::now() + RENEW_WITHIN,
        };
        match jog {
            Some(number) => self.renew_jog(number, axis, order).await,
            None if speed_deg_s == 0.0 => Err(LabError::Invalid {
                field: "speed_deg_s".into(),
                problem: "is 0, which ends a jog: send its number too".into(),
            }),
            None => self.begin_jog(axis, order).await,
        }
    }

    async fn begin_jog(&self, axis: AxisName, first: JogOrder) -> Result<JogView, LabError> {
        let side = self.side()?;
        let (order, orders) = watch::channel(first);
        let at_end = Arc::new(Mutex::new(None));
        // Numbers differ between jogs, also of earlier daemons: a late renewal must not find another jog.
        let number = side.sink.clock.utc().unix_timestamp_nanos() / 1000;
        let live = LiveJog {
            number: u64::try_from(number).unwrap_or_default(),
            axis,
            order,
            at_end: Arc::clone(&at_end),
        };
        let work = JogWork {
            axis,
            order: orders,
            at_end,
        };
        let motion = AxisMotion::Jog(work);
        self.request(Work::Motion {
            motion,
            number: None,
        })
        .await?;
        let view = live.view();
        // The rig was free, so that an earlier jog is over.
        *locked(&side.jogs.last) = Some(live);
        Ok(view)
    }

    async fn renew_jog(
        &self,
        number: u64,
        axis: AxisName,
        order: JogOrder,
    ) -> Result<JogView, LabError> {
        let live = locked(&self.side()?.jogs.last).clone();
        let ends = order.speed_deg_s == 0.0;
        let live = match live {
            Some(live) if live.number == number && (ends || !live.is_over()) => live,
            _ => return Err(LabError::JogEnded),
        };
        if live.axis != axis {
            return Err(LabError::Invalid {
                field: "axis".into(),
                problem: format!("is {axis}, but this jog moves {}", live.axis),
            });
        }
        live.order.send_replace(order);
        if ends {
            // Waits until the axis is at rest.
            live.order.closed().await;
        }
        match live.is_over() && !ends {
            true => Err(LabError::JogEnded),
            false => Ok(live.view()),
        }
    }
}
