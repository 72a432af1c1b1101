//! `ridged sample`: lists and corrects the parts of a running daemon.

use serde_json::{Value, json};

use super::CliError;
use super::definitions::DaemonArgs;
use super::output;

/// Lists parts, renames one, or assigns a scan to another one.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged sample list
  ridged sample rename 3 \"panel B-17\"
  ridged sample assign --scan 12 --sample 3     earlier names and parts stay on record")]
pub struct Args {
    /// The action.
    #[command(subcommand)]
    pub action: Action,
    /// Where the daemon is, and what it is shown.
    #[command(flatten)]
    pub daemon: DaemonArgs,
}

/// An action on parts.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// List the newest parts.
    #[command(after_help = "Example:\n  ridged sample list --json")]
    List,
    /// Give a part another name.
    #[command(after_help = "Example:\n  ridged sample rename 3 \"panel B-17\"")]
    Rename {
        /// Number of the part.
        #[arg(value_name = "ID")]
        id: u32,
        /// The new name.
        #[arg(value_name = "NAME")]
        name: String,
    },
    /// Assign a scan to the part that was really scanned.
    #[command(after_help = "Example:\n  ridged sample assign --scan 12 --sample 3")]
    Assign {
        /// Number of the scan.
        #[arg(long, value_name = "ID")]
        scan: u32,
        /// Number of the part.
        #[arg(long, value_name = "ID")]
        sample: u32,
    },
}

/// Runs the command.
///
/// # Errors
/// No result if no daemon runs; bad input for an unknown part or scan, or an invalid name.
pub fn run(args: Args) -> Result<(), CliError> {
    let client = args.daemon.client()?;
    let (answer, text) = match args.action {
        Action::List => {
            let answer = client.get("/samples")?;
            let rows = answer["items"].as_array().into_iter().flatten();
            let text = rows.map(line).collect();
            (answer, text)
        }
        Action::Rename { id, name } => {
            let answer = client.patch(&format!("/samples/{id}"), &json!({ "name": name }))?;
            let text = line(&answer);
            (answer, text)
        }
        Action::Assign { scan, sample } => {
            let body = json!({ "sample_id": sample });
            let answer = client.patch(&format!("/scans/{scan}"), &body)?;
            let name = answer["sample_name"].as_str().unwrap_or_default();
            let text = format!("scan {scan} is a scan of part {sample}, {name}\n");
            (answer, text)
        }
    };
    output::write(args.daemon.json, &answer, || text)
}

/// A part in one line, with the names it had.
fn line(sample: &Value) -> String {
    let earlier: Vec<&str> = sample["earlier_names"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|earlier| earlier["name"].as_str())
        .collect();
    let before = match earlier.is_empty() {
        true => String::new(),
        false => format!(" (before: {})", earlier.join(", ")),
    };
    let name = sample["name"].as_str().unwrap_or_default();
    // A JSON value ignores the width of its place.
    let id = sample["id"].to_string();
    format!("{id:>6}  {name}{before}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_of_a_renamed_sample_has_the_names_it_had() {
        let sample = json!({ "id": 3, "name": "B-17", "earlier_names": [{ "name": "panel" }, { "name": "B-71" }] });
        assert_eq!(line(&sample), "     3  B-17 (before: panel, B-71)\n");
        let plain = json!({ "id": 4, "name": "B-18", "earlier_names": [] });
        assert_eq!(line(&plain), "     4  B-18\n");
    }
}
