//! Commands that talk to a running daemon: where it is, and plain JSON over HTTP.

use std::path::Path;
use std::time::Duration;

use anyhow::anyhow;
use serde_json::Value;

use super::CliError;
use super::daemon::NOTICE_FILE;
use crate::store::Store;

/// A running daemon.
pub struct Client {
    agent: ureq::Agent,
    /// `http://ADDRESS`.
    pub url: String,
}

impl Client {
    /// The daemon that runs on a data folder, if one does.
    #[must_use]
    pub fn find(folder: &Path) -> Option<Client> {
        // The notice of a daemon that was killed is still there, and its port may be another's now:
        // only the lock tells that somebody has this folder.
        if !Store::is_in_use(folder) {
            return None;
        }
        let notice = std::fs::read_to_string(folder.join(NOTICE_FILE)).ok()?;
        let notice: Value = serde_json::from_str(&notice).ok()?;
        let client = Client {
            agent: ureq::Agent::config_builder()
                .timeout_global(Some(Duration::from_secs(60)))
                .http_status_as_error(false)
                .build()
                .into(),
            url: notice.get("url")?.as_str()?.to_owned(),
        };
        let answer = client.agent.get(format!("{}/healthz", client.url)).call();
        answer.ok()?.status().is_success().then_some(client)
    }

    /// The daemon that runs on a data folder.
    ///
    /// # Errors
    /// No result if none does.
    pub fn require(folder: &Path) -> Result<Client, CliError> {
        Client::find(folder).ok_or_else(|| {
            CliError::no_result(anyhow!(
                "no daemon runs on {}; start one with `ridged serve`, or name its folder with --data",
                folder.display()
            ))
        })
    }

    /// Asks for a path below `/api/v1`.
    ///
    /// # Errors
    /// The daemon's problem, with exit code 2 where the input is to blame.
    pub fn get(&self, path: &str) -> Result<Value, CliError> {
        let answer = self
            .agent
            .get(format!("{}/api/v1{path}", self.url))
            .call()
            .map_err(unreachable)?;
        read(answer)
    }

    /// Sends a body, or none, to a path below `/api/v1`.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn post(&self, path: &str, body: Option<&Value>) -> Result<Value, CliError> {
        let request = self.agent.post(format!("{}/api/v1{path}", self.url));
        let answer = match body {
            Some(body) => request.send_json(body),
            None => request.send_empty(),
        };
        read(answer.map_err(unreachable)?)
    }
}

fn unreachable(error: ureq::Error) -> CliError {
    CliError::no_result(anyhow!("the daemon does not answer: {error}"))
}

fn read(mut answer: ureq::http::Response<ureq::Body>) -> Result<Value, CliError> {
    let status = answer.status();
    let body: Value = answer.body_mut().read_json().map_err(|error| {
        CliError::no_result(anyhow!("the daemon's answer is not JSON: {error}"))
    })?;
    if status.is_success() {
        return Ok(body);
    }
    let detail = body
        .get("detail")
        .and_then(Value::as_str)
        .unwrap_or("the daemon refused");
    let error = anyhow!("{detail}");
    // What the machine refuses is no mistake of the user.
    let refused = status.is_server_error() || status == 409;
    Err(match refused {
        true => CliError::NoResult(error),
        false => CliError::BadInput(error),
    })
}
