//! `ridged rig lease`: shows, takes and returns the lease of the rig.

use serde_json::{Value, json};

use crate::cli::CliError;
use crate::cli::client::Client;

/// An action on the lease.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum LeaseAction {
    /// Show who holds the rig, and until when.
    #[command(after_help = "Example:\n  ridged rig lease show")]
    Show,
    /// Take the lease and print it. Give it to other commands as RIDGED_LEASE.
    #[command(
        after_help = "Example:\n  export RIDGED_LEASE=$(ridged rig lease take \"night run\" --seconds 3600)"
    )]
    Take {
        /// Name that others are shown.
        name: String,
        /// Seconds after its last use at which it expires, 10 to 86400.
        #[arg(long, value_name = "S", default_value_t = 600)]
        seconds: u64,
        /// Take it from the caller that holds it.
        #[arg(long)]
        take_over: bool,
    },
    /// Return the lease of --lease or RIDGED_LEASE.
    #[command(after_help = "Example:\n  ridged rig lease return")]
    Return,
}

/// Runs the action and returns the daemon's answer.
pub(super) fn run(client: &Client, action: &LeaseAction) -> Result<Value, CliError> {
    match action {
        LeaseAction::Show => client.get("/lease"),
        LeaseAction::Take {
            name,
            seconds,
            take_over,
        } => {
            let body = json!({ "name": name, "seconds": seconds, "take_over": take_over });
            client.post("/lease", Some(&body))
        }
        LeaseAction::Return => client.delete("/lease"),
    }
}

/// Returns the answer for people; of a lease that was taken only its id, for a script.
pub(super) fn words(action: &LeaseAction, answer: &Value) -> String {
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    match action {
        LeaseAction::Take { .. } => text(&answer["id"]) + "\n",
        LeaseAction::Return => "the rig is free\n".into(),
        LeaseAction::Show => {
            let holder = &answer["holder"];
            if holder.is_null() {
                return "the rig is free\n".into();
            }
            let until = match holder["until"].as_str() {
                Some(until) => format!("until {until}"),
                None => "until its end".to_owned(),
            };
            let own = if answer["own"] == true {
                " (this lease)"
            } else {
                ""
            };
            format!(
                "{} holds the rig: {}{own}, {until}\n",
                text(&holder["who"]),
                text(&holder["name"])
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_gets_the_lease_alone_and_a_person_reads_who_holds_it() {
        let take = LeaseAction::Take {
            name: "night".into(),
            seconds: 600,
            take_over: false,
        };
        assert_eq!(words(&take, &json!({ "id": "ridged_x" })), "ridged_x\n");
        let held =
            json!({ "holder": { "who": "anna", "name": "night", "until": "9999" }, "own": false });
        let said = words(&LeaseAction::Show, &held);
        assert_eq!(said, "anna holds the rig: night, until 9999\n");
        let scan =
            json!({ "holder": { "who": "anna", "name": "scan 3", "until": null }, "own": false });
        assert!(words(&LeaseAction::Show, &scan).contains("scan 3, until its end"));
        let free = json!({ "holder": null, "own": false });
        assert_eq!(words(&LeaseAction::Show, &free), "the rig is free\n");
    }
}
