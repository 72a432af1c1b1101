//! `ridged scan pause|resume|abort|continue`: orders to a scan of a running daemon.

use anyhow::anyhow;
use serde_json::{Value, json};

use crate::cli::CliError;
use crate::cli::client::Client;
use crate::cli::output;

/// An order to a scan that runs or waits.
#[derive(Debug, clap::Subcommand)]
pub enum Order {
    /// Pause a scan after its present pose; its frames are kept.
    #[command(after_help = "Example:\n  ridged scan pause 12")]
    Pause {
        /// Number of the scan.
        #[arg(value_name = "ID")]
        scan: u32,
    },
    /// Resume a paused or interrupted scan.
    #[command(after_help = "Example:\n  ridged scan resume 12")]
    Resume {
        /// Number of the scan.
        #[arg(value_name = "ID")]
        scan: u32,
    },
    /// End a scan for good; its frames are kept.
    #[command(after_help = "Example:\n  ridged scan abort 12")]
    Abort {
        /// Number of the scan.
        #[arg(value_name = "ID")]
        scan: u32,
    },
    /// Confirm that the operator step that a scan waits for is done.
    #[command(after_help = "Example:\n  ridged scan continue 12")]
    Continue {
        /// Number of the scan.
        #[arg(value_name = "ID")]
        scan: u32,
    },
}

/// Gives the order and prints the state of the scan.
///
/// # Errors
/// No result where the state of the scan does not allow it.
pub(super) fn run(client: &Client, order: &Order, json: bool) -> Result<(), CliError> {
    let (scan, verb) = match order {
        Order::Pause { scan } => (scan, "pause"),
        Order::Resume { scan } => (scan, "resume"),
        Order::Abort { scan } => (scan, "abort"),
        Order::Continue { scan } => (scan, "continue"),
    };
    // Named, so that a step that someone else has confirmed meanwhile does not confirm the next one.
    let step = match order {
        Order::Continue { .. } => Some(waiting_step(&client.get(&format!("/scans/{scan}"))?)?),
        _ => None,
    };
    let answer = client.post(&format!("/scans/{scan}/{verb}"), step.as_ref())?;
    output::write(json, &answer, || {
        format!("scan {scan}: {}\n", answer["state"].as_str().unwrap_or("?"))
    })
}

/// Returns the body that confirms the step that a scan waits for.
fn waiting_step(scan: &Value) -> Result<Value, CliError> {
    match scan["operator"]["action"].as_str() {
        Some(action) => Ok(json!({ "action": action })),
        None => Err(CliError::no_result(anyhow!(
            "scan {} waits for no operator step; it is {}",
            scan["id"],
            scan["state"].as_str().unwrap_or("in an unknown state")
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_confirmed_by_its_name_and_only_where_a_scan_waits() {
        let waits = json!({ "id": 3, "state": "waiting-for-operator", "operator": { "action": "cap-lens" } });
        assert_eq!(
            waiting_step(&waits).unwrap(),
            json!({ "action": "cap-lens" })
        );
        let runs = json!({ "id": 3, "state": "running", "operator": null });
        let CliError::NoResult(why) = waiting_step(&runs).unwrap_err() else {
            panic!("another kind of error");
        };
        assert_eq!(
            why.to_string(),
            "scan 3 waits for no operator step; it is running"
        );
    }
}
