//! `ridged queue`: orders of a running daemon, and the prompts for the person who puts the parts on the table.

mod csv;

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::anyhow;
use serde_json::{Value, json};

use super::client::Client;
use super::definitions::DaemonArgs;
use super::operator_prompt::OperatorPrompt;
use super::scan::followed;
use super::{CliError, interrupt, output, say};

/// Adds, moves and removes orders, and starts and stops the queue.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged queue add --part \"Panel B-17\" --recipe PX-1204 --specification \"drawing 4711\" --lot 4
  ridged queue add --csv parts.csv --recipe PX-1204
  ridged queue start
  ridged queue attend                    asks for each part at this terminal
  ridged queue stop                      after the present order
docs/how-to/queue.md describes the queue and the columns of the CSV file.")]
pub struct Args {
    /// The action.
    #[command(subcommand)]
    pub action: Action,
    /// Where the daemon is, and what it is shown.
    #[command(flatten)]
    pub daemon: DaemonArgs,
}

/// An action on the queue.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// Show the state of the queue and the orders in sequence.
    #[command(after_help = "Examples:\n  ridged queue list\n  ridged queue list --state failed")]
    List {
        /// Orders in this state; by default those that run or wait.
        #[arg(long, value_parser = ["waiting", "running", "done", "failed", "removed"])]
        state: Option<String>,
    },
    /// Add one order, or those of a CSV file, at the end.
    #[command(
        after_help = "Examples:\n  ridged queue add --part \"Panel B-17\" --recipe PX-1204\n  ridged queue add --csv parts.csv\n\
                      An option applies to each line of the file that leaves its column empty."
    )]
    Add(Box<AddArgs>),
    /// Move a waiting order.
    #[command(after_help = "Example:\n  ridged queue move 7 --to 1")]
    Move {
        /// Number of the order.
        #[arg(value_name = "ID")]
        id: u32,
        /// Place among the waiting orders, from 1 (the next one).
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
        to: u32,
    },
    /// Remove a waiting or failed order.
    #[command(after_help = "Example:\n  ridged queue remove 7")]
    Remove {
        /// Number of the order.
        #[arg(value_name = "ID")]
        id: u32,
    },
    /// Let a failed order wait again, as the next one.
    #[command(after_help = "Example:\n  ridged queue retry 7")]
    Retry {
        /// Number of the order.
        #[arg(value_name = "ID")]
        id: u32,
    },
    /// Start the queue, or resume a paused one.
    #[command(after_help = "Example:\n  ridged queue start && ridged queue attend")]
    Start,
    /// Stop after the present order; at once if none has begun.
    #[command(after_help = "Example:\n  ridged queue stop")]
    Stop,
    /// Pause the queue and the scan of its present order.
    #[command(after_help = "Example:\n  ridged queue pause")]
    Pause,
    /// Resume a paused queue: the same as start.
    #[command(after_help = "Example:\n  ridged queue resume")]
    Resume,
    /// Confirm the operator step of the present order.
    #[command(after_help = "Example:\n  ridged queue continue")]
    Continue,
    /// Ask at this terminal for each part until the queue stops. Ctrl-C pauses the present scan.
    #[command(after_help = "Example:\n  ridged queue attend")]
    Attend,
}

/// An order, or a file of orders.
#[derive(Debug, clap::Args)]
pub struct AddArgs {
    /// File with a header line and one order a line; columns part or part_id, recipe, specification, lot, external_id, operator, note.
    #[arg(long, value_name = "FILE.csv", conflicts_with_all = ["part", "part_id", "external_id"])]
    pub csv: Option<PathBuf>,
    /// Name of the part. A new one gets the material of the recipe.
    #[arg(long, value_name = "NAME", required_unless_present_any = ["csv", "part_id"])]
    pub part: Option<String>,
    /// Number of the part, where several have its name.
    #[arg(long, value_name = "ID", conflicts_with = "part")]
    pub part_id: Option<u32>,
    /// The recipe by name or number.
    #[arg(long, value_name = "NAME", required_unless_present = "csv")]
    pub recipe: Option<String>,
    /// The specification by name or number.
    #[arg(long, value_name = "NAME")]
    pub specification: Option<String>,
    /// Lot of the part.
    #[arg(long, value_name = "LOT")]
    pub lot: Option<String>,
    /// Number of the part or order in another system, unique in the queue.
    #[arg(long, value_name = "ID")]
    pub external_id: Option<String>,
    /// The person at the rig.
    #[arg(long, value_name = "NAME")]
    pub operator: Option<String>,
    /// Free text.
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
}

impl AddArgs {
    /// The stated options by the names of the columns.
    fn options(&self) -> Vec<(&'static str, String)> {
        let options = [
            ("part", self.part.clone()),
            ("part_id", self.part_id.map(|id| id.to_string())),
            ("recipe", self.recipe.clone()),
            ("specification", self.specification.clone()),
            ("lot", self.lot.clone()),
            ("external_id", self.external_id.clone()),
            ("operator", self.operator.clone()),
            ("note", self.note.clone()),
        ];
        let given = options.into_iter();
        given
            .filter_map(|(name, value)| Some((name, value?)))
            .collect()
    }

    /// Adds the orders; a refusal of an order of a file names its line.
    fn send(&self, client: &Client) -> Result<Value, CliError> {
        let post =
            |orders: Vec<Value>| client.post("/queue/orders", Some(&json!({ "orders": orders })));
        let Some(file) = &self.csv else {
            return post(vec![csv::order(self.options().into_iter())]);
        };
        let orders = csv::orders(file, &self.options())?;
        let lines: Vec<usize> = orders.iter().map(|order| order.line).collect();
        let bodies = orders.into_iter().map(|order| order.body).collect();
        let named = |error: anyhow::Error| {
            let message = csv::by_lines(&error.to_string(), &lines);
            anyhow!("{}: {message}", file.display())
        };
        post(bodies).map_err(|error| match error {
            CliError::BadInput(error) => CliError::BadInput(named(error)),
            CliError::NoResult(error) => CliError::NoResult(named(error)),
            other => other,
        })
    }
}

/// Runs the command.
///
/// # Errors
/// No result if no daemon runs, or where the queue's state does not allow it; bad input for an order that is wrong.
pub fn run(args: Args) -> Result<(), CliError> {
    let client = args.daemon.client()?;
    let order = |id: u32, what: &str, body: Option<Value>| {
        client.post(&format!("/queue/orders/{id}/{what}"), body.as_ref())
    };
    let change = |what: &str| client.post(&format!("/queue/{what}"), None);
    let (answer, text) = match args.action {
        Action::List { state } => {
            let query: Vec<(&str, &str)> = [("limit", "1000")]
                .into_iter()
                .chain(state.as_deref().map(|state| ("state", state)))
                .collect();
            let orders = client.search("/queue/orders", &query)?;
            let queue = client.get("/queue")?;
            let text = format!("{}{}", lines(&orders), summary(&queue));
            (json!({ "queue": queue, "orders": orders["items"] }), text)
        }
        Action::Add(add) => {
            let answer = add.send(&client)?;
            let text = lines(&answer);
            (answer, text)
        }
        Action::Move { id, to } => {
            let answer = order(id, "move", Some(json!({ "to": to })))?;
            let text = line(&answer);
            (answer, text)
        }
        Action::Remove { id } => {
            let answer = client.delete(&format!("/queue/orders/{id}"))?;
            let text = line(&answer);
            (answer, text)
        }
        Action::Retry { id } => {
            let answer = order(id, "retry", None)?;
            let text = line(&answer);
            (answer, text)
        }
        Action::Start | Action::Resume => with_summary(change("start")?),
        Action::Stop => with_summary(change("stop")?),
        Action::Pause => with_summary(change("pause")?),
        Action::Continue => with_summary(change("continue")?),
        Action::Attend => with_summary(attend(&client)?),
    };
    output::write(args.daemon.json, &answer, || text)
}

fn with_summary(queue: Value) -> (Value, String) {
    let text = summary(&queue);
    (queue, text)
}

/// Follows the queue until it stops or pauses, and passes on the confirmations of the person at this terminal.
///
/// # Errors
/// No result where a scan pauses, or the input of this command has ended; interrupted on Ctrl-C.
fn attend(client: &Client) -> Result<Value, CliError> {
    /// Interval between requests while no scan runs.
    const LOOK_EVERY: Duration = Duration::from_millis(200);
    let stopped = interrupt::flag()?;
    let mut people = Some(OperatorPrompt::at_the_terminal());
    let mut shown = None;
    loop {
        if stopped.load(Ordering::Relaxed) {
            return Err(CliError::Interrupted);
        }
        let queue = client.get("/queue")?;
        let order = &queue["current"]["order"];
        match (queue["state"].as_str(), order["scan_id"].as_i64()) {
            (Some("stopped" | "paused"), _) => return Ok(queue),
            (_, Some(scan_id)) if shown != Some(scan_id) => {
                shown = Some(scan_id);
                let part = order["part"].as_str().unwrap_or_default();
                say(&format_args!("part {part} (order {})", order["id"]));
                let scan = followed(client, scan_id, &mut people, &stopped)?;
                let state = scan["state"].as_str().unwrap_or_default();
                say(&format_args!("scan {scan_id} of {part}: {state}"));
            }
            _ => std::thread::sleep(LOOK_EVERY),
        }
    }
}

/// The state of the queue in words.
fn summary(queue: &Value) -> String {
    let counts = &queue["counts"];
    format!(
        "{}\n{} waiting, {} done, {} failed\n",
        queue["message"].as_str().unwrap_or_default(),
        counts["waiting"],
        counts["done"],
        counts["failed"]
    )
}

fn lines(orders: &Value) -> String {
    let items = orders["items"].as_array().into_iter().flatten();
    items.map(line).collect()
}

/// An order in one line.
fn line(order: &Value) -> String {
    let id = order["id"].to_string();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let mut line = format!(
        "{id:>6}  {:<8}  {}, recipe {}",
        text(&order["state"]),
        text(&order["part"]),
        text(&order["recipe"]["name"])
    );
    for (word, value) in [
        ("specification", &order["specification"]["name"]),
        ("lot", &order["lot"]),
        ("external id", &order["external_id"]),
        ("verdict", &order["verdict"]),
    ] {
        if let Some(value) = value.as_str() {
            line.push_str(&format!(
                ", {word} {}",
                value.replace("cannot-tell", "cannot tell")
            ));
        }
    }
    if let Some(scan) = order["scan_id"].as_i64() {
        line.push_str(&format!(", scan {scan}"));
    }
    if let Some(reason) = order["reason"].as_str() {
        line.push_str(&format!(" ({reason})"));
    }
    line + "\n"
}

/// The error of a file that cannot be used.
fn wrong_file(file: &std::path::Path, why: impl std::fmt::Display) -> CliError {
    CliError::bad_input(anyhow!("{}: {why}", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_of_an_order_has_what_is_stated_and_no_more() {
        let order = json!({
            "id": 7, "state": "done", "part": "B-17", "recipe": { "name": "PX" }, "specification": { "name": "S" },
            "lot": null, "external_id": "A-1", "verdict": "cannot-tell", "scan_id": 3, "reason": null
        });
        assert_eq!(
            line(&order),
            "     7  done      B-17, recipe PX, specification S, external id A-1, verdict cannot tell, scan 3\n"
        );
        let bare =
            json!({ "id": 8, "state": "waiting", "part": "B-18", "recipe": { "name": "PX" } });
        assert_eq!(line(&bare), "     8  waiting   B-18, recipe PX\n");
    }
}
