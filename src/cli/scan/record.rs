//! `ridged scan note|tag|archive|restore`: the record of a scan that is stored.

use serde_json::{Value, json};

use crate::cli::CliError;
use crate::cli::client::Client;
use crate::cli::output;

/// What to do with the record of a scan. Every change stays on record with who made it.
#[derive(Debug, clap::Subcommand)]
pub enum Change {
    /// Write a note on a scan, which replaces the one before; an empty text removes it.
    #[command(after_help = "Examples:
  ridged scan note 12 \"scratch at the edge\"
  ridged scan note 12 \"\"                      removes the note")]
    Note {
        /// Number of the scan.
        #[arg(value_name = "ID")]
        scan: u32,
        /// The note, at most 4000 characters.
        #[arg(value_name = "TEXT")]
        text: String,
    },
    /// Add tags to a scan or remove them.
    #[command(after_help = "Examples:
  ridged scan tag 12 --add study-1
  ridged scan tag 12 --add study-1,night --remove day")]
    Tag {
        /// Number of the scan.
        #[arg(value_name = "ID")]
        scan: u32,
        /// Tags to add, separated by commas.
        #[arg(
            long,
            value_name = "TAGS",
            value_delimiter = ',',
            required_unless_present = "remove"
        )]
        add: Vec<String>,
        /// Tags to remove, separated by commas.
        #[arg(long, value_name = "TAGS", value_delimiter = ',')]
        remove: Vec<String>,
    },
    /// Leave a scan out of lists. Nothing is deleted.
    #[command(after_help = "Example:\n  ridged scan archive 12")]
    Archive {
        /// Number of the scan.
        #[arg(value_name = "ID")]
        scan: u32,
    },
    /// Put an archived scan back into lists.
    #[command(after_help = "Example:\n  ridged scan restore 12")]
    Restore {
        /// Number of the scan.
        #[arg(value_name = "ID")]
        scan: u32,
    },
}

/// Changes the record and prints it.
///
/// # Errors
/// Bad input for an unknown scan, or a value that is not valid.
pub(super) fn run(client: &Client, change: &Change, json: bool) -> Result<(), CliError> {
    let (scan, body) = match change {
        Change::Note { scan, text } => (*scan, json!({ "note": text })),
        Change::Archive { scan } => (*scan, json!({ "archived": true })),
        Change::Restore { scan } => (*scan, json!({ "archived": false })),
        Change::Tag { scan, add, remove } => {
            let before = client.get(&format!("/scans/{scan}"))?;
            (*scan, json!({ "tags": tags(&before["tags"], add, remove) }))
        }
    };
    let answer = client.patch(&format!("/scans/{scan}"), &body)?;
    output::write(json, &answer, || line(&answer))
}

/// Tags without some and with others.
fn tags(before: &Value, add: &[String], remove: &[String]) -> Vec<String> {
    let kept = before.as_array().into_iter().flatten();
    let kept = kept.filter_map(Value::as_str).map(str::to_owned);
    let kept = kept.filter(|tag| !remove.iter().any(|other| other.trim() == tag));
    kept.chain(add.iter().map(|tag| tag.trim().to_owned()))
        .collect()
}

/// The record of a scan in one line.
fn line(scan: &Value) -> String {
    let tags = scan["tags"].as_array().into_iter().flatten();
    let tags: Vec<&str> = tags.filter_map(Value::as_str).collect();
    let mut text = format!("scan {}", scan["id"]);
    if scan["archived"] == json!(true) {
        text.push_str(", archived");
    }
    match tags.is_empty() {
        true => text.push_str(", no tags"),
        false => text.push_str(&format!(", tags: {}", tags.join(", "))),
    }
    if let Some(note) = scan["note"].as_str() {
        text.push_str(&format!(", note: {note}"));
    }
    text.push('\n');
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::scan::{Action, Args};
    use crate::cli::{parsed, try_parsed};

    #[test]
    fn actions_need_no_plan_and_a_plan_needs_no_action() {
        let args: Args = parsed(&["note", "12", "scratch", "--data", "lab", "--json"]);
        assert!(matches!(
            args.action,
            Some(Action::Record(Change::Note { scan: 12, .. }))
        ));
        assert!(args.json && args.data.ends_with("lab"));
        let args: Args = parsed(&["tag", "12", "--add", "a,b"]);
        let Some(Action::Record(Change::Tag { add, .. })) = args.action else {
            panic!("{args:?}");
        };
        assert_eq!(add, ["a", "b"]);
        assert!(try_parsed::<Args>(&["tag", "12"]).is_err());
        assert!(try_parsed::<Args>(&["--preset", "paper", "archive", "12"]).is_err());
        let args: Args = parsed(&["plan.toml"]);
        assert!(args.action.is_none() && args.plan.is_some());
    }

    #[test]
    fn tags_are_added_and_removed() {
        let words = |all: &[&str]| all.iter().map(|tag| (*tag).to_owned()).collect::<Vec<_>>();
        let before = json!(["a", "b"]);
        assert_eq!(tags(&before, &words(&["c "]), &words(&[" a"])), ["b", "c"]);
    }

    #[test]
    fn the_line_states_what_the_record_has() {
        let scan = json!({ "id": 3, "tags": ["a", "b"], "note": "edge", "archived": true });
        assert_eq!(line(&scan), "scan 3, archived, tags: a, b, note: edge\n");
        let scan = json!({ "id": 4, "tags": [], "note": null, "archived": false });
        assert_eq!(line(&scan), "scan 4, no tags\n");
    }
}
