//! The daemon of a data folder, found by its notice.

use std::path::Path;

use anyhow::anyhow;
use serde_json::Value;

use super::connection::Secrecy;
use super::{Client, agent_config};
use crate::cli::CliError;
use crate::daemon::{NOTICE_FILE, SECRET_FILE};
use crate::store::Store;

/// The process that holds a data folder.
pub(super) enum FolderHolder {
    Free,
    /// A daemon, by its notice; with its process number where the lock names the same one.
    Daemon(Client, Option<u64>),
    /// A process that answers no commands: a scan or import without a daemon, or a daemon that is starting or ending.
    Other(Option<u64>),
}

impl FolderHolder {
    pub(super) fn of(folder: &Path) -> FolderHolder {
        // The notice of a killed daemon remains, and another program may have its port now: only the lock shows whether a
        // process holds this folder.
        if !Store::is_in_use(folder) {
            return FolderHolder::Free;
        }
        let locked_by = locked_by(folder);
        let Some((url, process)) = notice(folder) else {
            return FolderHolder::Other(locked_by);
        };
        if locked_by.is_some() && locked_by != process {
            return FolderHolder::Other(locked_by);
        }
        let client = Client {
            // A proxy of the environment cannot reach the loopback of this machine.
            agent: agent_config().proxy(None).build().into(),
            token: token_of(folder),
            lease: None,
            url,
        };
        FolderHolder::Daemon(client, locked_by)
    }
}

/// Returns the secret of the daemon of a folder, which only its own user can read. Other users of this machine present
/// nothing, or the token of their token file.
fn token_of(folder: &Path) -> Option<Secrecy> {
    let secret = std::fs::read_to_string(folder.join(SECRET_FILE)).ok()?;
    Some(Secrecy::from(secret.trim()))
}

/// The error where no daemon runs.
pub(super) fn no_daemon(folder: &Path) -> CliError {
    CliError::no_result(anyhow!(
        "no daemon runs on {}; start one with `ridged serve`, or give its data folder with --data, or its address with --url",
        folder.display()
    ))
}

/// The error where another process holds the folder, so that a second daemon would be refused.
pub(super) fn works_alone(folder: &Path, process: Option<u64>) -> CliError {
    let folder = folder.display();
    CliError::no_result(match process {
        Some(process) => anyhow!(
            "no daemon runs on {folder}, but another ridged process (process {process}) holds it and takes no commands: \
            a scan without a daemon, or a daemon that is starting or ending; Ctrl-C there, or `kill -INT {process}`, \
            stops what it drives"
        ),
        None => anyhow!(
            "no daemon runs on {folder}, but another ridged process holds it and takes no commands: a scan without a \
            daemon, or a daemon that is starting or ending; Ctrl-C there stops what it drives"
        ),
    })
}

/// Number of the process that holds the folder, read from the lock; `None` if a full disk prevented writing it.
fn locked_by(folder: &Path) -> Option<u64> {
    let text = std::fs::read_to_string(folder.join("lock")).ok()?;
    text.trim().strip_prefix("process ")?.parse().ok()
}

/// Address and process of the daemon that wrote the last notice.
fn notice(folder: &Path) -> Option<(String, Option<u64>)> {
    let notice = std::fs::read_to_string(folder.join(NOTICE_FILE)).ok()?;
    let notice: Value = serde_json::from_str(&notice).ok()?;
    Some((
        notice.get("url")?.as_str()?.to_owned(),
        notice["process"].as_u64(),
    ))
}
