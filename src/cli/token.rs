//! `ridged token`: tokens for callers on other machines, and on this one where the settings ask for them.

use std::fs::OpenOptions;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use anyhow::anyhow;
use serde_json::{Value, json};

use super::{CliError, output};
use crate::access::{Role, Secret, TokenFile, TokenFileError, TokenRow};
use crate::clock::{Clock, SystemClock};
use crate::store::utc_text;

/// Makes, lists and revokes tokens. A running daemon follows at once.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ridged token create anna --role operator     prints the token; it cannot be shown again
  ridged token create night-script --role operator --out night.token")]
pub struct Args {
    /// The action.
    #[command(subcommand)]
    pub action: Action,
    /// Data folder of the daemon.
    #[arg(long, value_name = "DIR", default_value = "ridged-data", global = true)]
    pub data: PathBuf,
    /// One JSON object on stdout.
    #[arg(long, global = true)]
    pub json: bool,
}

/// An action on tokens.
#[derive(Debug, clap::Subcommand)]
pub enum Action {
    /// Make a token for a person or a script, and show it once.
    #[command(after_help = "Example:\n  ridged token create anna --role operator")]
    Create {
        /// Name of its holder: letters, digits, dots, dashes and underscores. Scans, jobs and events show it.
        name: String,
        /// What it may do: viewer (reads and stops), analyst (also computes), operator (also moves the rig), admin.
        #[arg(long, value_name = "ROLE")]
        role: Role,
        /// Write the token into a new file that only its owner can read, instead of showing it.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// List all tokens with their roles, revoked ones included.
    #[command(after_help = "Example:\n  ridged token list --data /var/lib/ridged")]
    List,
    /// Revoke a token; its sessions on the page end, too.
    #[command(after_help = "Example:\n  ridged token revoke anna")]
    Revoke {
        /// Name of the token.
        name: String,
    },
}

/// Runs the command.
///
/// # Errors
/// Bad input for a name that cannot be used; no result where the file of tokens cannot be changed.
pub fn run(args: Args) -> Result<(), CliError> {
    let tokens = TokenFile::of_folder(&args.data);
    let now = utc_text(SystemClock::new().utc());
    let (answer, text) = match args.action {
        Action::Create { name, role, out } => {
            // Before the token is made: one that cannot be written would be lost.
            let file = out.as_deref().map(new_file).transpose()?;
            let made = tokens.create(&name, role, &now).map_err(wrong);
            let secret = match (made, &out) {
                (Ok(secret), _) => secret,
                (Err(error), Some(path)) => {
                    std::fs::remove_file(path).ok();
                    return Err(error);
                }
                (Err(error), None) => return Err(error),
            };
            created(&name, role, &secret, file.zip(out))?
        }
        Action::List => {
            let rows = tokens.rows().map_err(wrong)?;
            let items: Vec<_> = rows.iter().map(as_json).collect();
            (json!({ "items": items }), listed(&rows))
        }
        Action::Revoke { name } => {
            tokens.revoke(&name, &now).map_err(wrong)?;
            let text = format!("{name} is revoked\n");
            (json!({ "name": name, "revoked_at": now }), text)
        }
    };
    output::write(args.json, &answer, || text)
}

fn wrong(error: TokenFileError) -> CliError {
    match error {
        TokenFileError::Name { .. }
        | TokenFileError::Taken { .. }
        | TokenFileError::Unknown { .. } => CliError::bad_input(error),
        TokenFileError::File { .. } | TokenFileError::Damaged { .. } => CliError::no_result(error),
    }
}

fn new_file(path: &Path) -> Result<std::fs::File, CliError> {
    OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(path)
        .map_err(|error| {
            CliError::bad_input(anyhow!(
                "--out {}: {error}; give the name of a new file",
                path.display()
            ))
        })
}

/// Writes the token where it belongs, and returns what to print.
fn created(
    name: &str,
    role: Role,
    secret: &Secret,
    file: Option<(std::fs::File, PathBuf)>,
) -> Result<(Value, String), CliError> {
    let mut answer = json!({ "name": name, "role": role });
    let Some((mut file, path)) = file else {
        super::say("this token is shown once; its holder keeps it in a file of mode 600");
        answer["token"] = json!(secret.reveal());
        return Ok((answer, format!("{}\n", secret.reveal())));
    };
    writeln!(file, "{}", secret.reveal())
        .and_then(|()| file.sync_all())
        .map_err(|error| CliError::no_result(anyhow!("{}: {error}", path.display())))?;
    answer["file"] = json!(path);
    let text = format!("the token of {name} ({role}) is in {}\n", path.display());
    Ok((answer, text))
}

/// A row without its fingerprint, which helps no reader.
fn as_json(row: &TokenRow) -> Value {
    json!({
        "name": row.name, "role": row.role, "created_at": row.created_at, "revoked_at": row.revoked_at,
    })
}

fn listed(rows: &[TokenRow]) -> String {
    if rows.is_empty() {
        return "no tokens; `ridged token create NAME --role ROLE` makes one\n".to_owned();
    }
    let width = rows.iter().map(|row| row.name.len()).max().unwrap_or(0);
    let line = |row: &TokenRow| {
        let revoked = match &row.revoked_at {
            Some(at) => format!(", revoked {at}"),
            None => String::new(),
        };
        let role = row.role.as_str();
        format!(
            "{:width$}  {role:8}  {}{revoked}\n",
            row.name, row.created_at
        )
    };
    rows.iter().map(line).collect()
}
