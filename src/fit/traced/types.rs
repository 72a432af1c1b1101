//! Options, progress and outcome of a tracing.

use serde::{Deserialize, Serialize};

/// Settings of the tracer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TracingOptions {
    /// Paths per pose in the first passes.
    pub paths: u64,
    /// Maximum paths per pose in any pass.
    pub paths_max: u64,
    /// Standard error of the tracer at which it stops (root mean square over the poses, as a share of the largest
    /// radiance). If omitted, it stops when its line of the budget is small.
    pub target_error: Option<f64>,
}

impl TracingOptions {
    /// Settings for a stated error, if there is one. A stated error is reached with any number of paths.
    #[must_use]
    pub fn to_error(target_error: Option<f64>) -> Self {
        let default = TracingOptions::default();
        TracingOptions {
            target_error,
            paths_max: if target_error.is_some() {
                1 << 24
            } else {
                default.paths_max
            },
            ..default
        }
    }
}

impl Default for TracingOptions {
    fn default() -> Self {
        TracingOptions {
            paths: 4096,
            paths_max: 1 << 16,
            target_error: None,
        }
    }
}

/// Progress of a tracing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TracingProgress {
    /// Passes begun.
    pub pass: usize,
    /// Paths traced so far.
    pub done: u64,
    /// Planned paths; the number grows if more passes are needed.
    pub planned: u64,
}

/// The caller's watcher of a tracing. The tracing continues while it returns true.
pub type Watch<'w> = &'w (dyn Fn(TracingProgress) -> bool + Sync);

/// Why a tracing ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
#[schema(as = FitTracerEnd)]
pub enum TracingEnd {
    /// The parameters stay, and the requested error is reached.
    Settled,
    /// The parameters stay, but the maximum number of paths did not reach the requested error.
    MostPaths,
    /// The parameters still moved after the maximum number of passes.
    MostPasses,
    /// The watcher stopped it.
    Stopped,
}

/// What the tracer did for an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracing {
    /// Standard error of the traced radiances in the unit of the signals, one per observation.
    pub sigma: Vec<f64>,
    /// Difference of each free parameter from the `sawtooth` estimate with its integrated second bounce (units of the
    /// solver): two complete models of one sample that should agree. A measured profile makes them different samples.
    /// It is then the change of the ridge angle by the errors of the measurement, and the change of all parameters by
    /// what the measurement leaves open.
    pub apart: Vec<f64>,
    /// Expected change of each free parameter by further passes (units of the solver): the step of the last pass, less
    /// where earlier passes show how fast the steps shrink.
    pub ahead: Vec<f64>,
    /// Number of passes.
    pub passes: usize,
    /// Paths per pose in the last pass.
    pub paths: u64,
    /// Root mean square standard error as a share of the largest traced radiance.
    pub error: f64,
    /// Whether polarisation was followed: always for metals, otherwise if it fits the data better.
    pub polarised: bool,
    /// Why it ended.
    pub end: TracingEnd,
}
