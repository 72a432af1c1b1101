//! Commands that talk to a running daemon: where it is, and plain JSON over HTTP.

use std::path::Path;
use std::time::Duration;

use anyhow::anyhow;
use serde_json::Value;

use super::CliError;
use super::daemon::NOTICE_FILE;
use crate::store::Store;

/// A running daemon.
#[derive(Debug)]
pub struct Client {
    agent: ureq::Agent,
    /// `http://ADDRESS`.
    pub url: String,
}

/// Who works on a data folder.
enum Holder {
    Nobody,
    /// A daemon, by its notice; with its process where the lock names the same one.
    Daemon(Client, Option<u64>),
    /// A process that answers no commands: a scan or an import that does its work itself, a daemon that begins or ends.
    Other(Option<u64>),
}

impl Holder {
    fn of(folder: &Path) -> Holder {
        // The notice of a daemon that was killed is still there, and its port may be another's now:
        // only the lock tells that somebody has this folder.
        if !Store::is_in_use(folder) {
            return Holder::Nobody;
        }
        let locked_by = locked_by(folder);
        let Some((url, process)) = notice(folder) else {
            return Holder::Other(locked_by);
        };
        if locked_by.is_some() && locked_by != process {
            return Holder::Other(locked_by);
        }
        let client = Client {
            agent: ureq::Agent::config_builder()
                .timeout_global(Some(Duration::from_secs(60)))
                .http_status_as_error(false)
                .build()
                .into(),
            url,
        };
        Holder::Daemon(client, locked_by)
    }
}

/// Why there is nobody to talk to.
fn no_daemon(folder: &Path) -> CliError {
    CliError::no_result(anyhow!(
        "no daemon runs on {}; start one with `ridged serve`, or name its folder with --data",
        folder.display()
    ))
}

/// The same where the folder is taken: a second daemon would be refused.
fn works_alone(folder: &Path, process: Option<u64>) -> CliError {
    let folder = folder.display();
    CliError::no_result(match process {
        Some(process) => anyhow!(
            "no daemon runs on {folder}, but another ridged process (process {process}) has it and takes no commands: a \
             scan without a daemon, or a daemon that begins or ends; Ctrl-C there, or `kill -INT {process}`, stops \
             what it drives"
        ),
        None => anyhow!(
            "no daemon runs on {folder}, but another ridged process has it and takes no commands: a scan without a \
             daemon, or a daemon that begins or ends; Ctrl-C there stops what it drives"
        ),
    })
}

/// Number of the process that has the folder, as it wrote it into the lock; on a full disk it could not.
fn locked_by(folder: &Path) -> Option<u64> {
    let text = std::fs::read_to_string(folder.join("lock")).ok()?;
    text.trim().strip_prefix("process ")?.parse().ok()
}

/// Address and process of the daemon that left its notice last.
fn notice(folder: &Path) -> Option<(String, Option<u64>)> {
    let notice = std::fs::read_to_string(folder.join(NOTICE_FILE)).ok()?;
    let notice: Value = serde_json::from_str(&notice).ok()?;
    Some((
        notice.get("url")?.as_str()?.to_owned(),
        notice["process"].as_u64(),
    ))
}

impl Client {
    /// The daemon that runs on a data folder, if one does.
    ///
    /// # Errors
    /// No result if it is there and does not answer.
    pub fn find(folder: &Path) -> Result<Option<Client>, CliError> {
        let Holder::Daemon(client, process) = Holder::of(folder) else {
            return Ok(None);
        };
        let answer = client.agent.get(format!("{}/healthz", client.url)).call();
        let why = match answer {
            Ok(answer) if answer.status().is_success() => return Ok(Some(client)),
            Ok(mut answer) => match answer.body_mut().read_json() {
                Ok(problem) => told(&problem),
                Err(_) => format!("it answers {}", answer.status()),
            },
            Err(error) => error.to_string(),
        };
        match process {
            Some(process) => Err(CliError::no_result(anyhow!(
                "the daemon on {} is there (process {process}, {}) and does not answer: {why}",
                folder.display(),
                client.url
            ))),
            None => Ok(None),
        }
    }

    /// The daemon that runs on a data folder.
    ///
    /// # Errors
    /// No result if none does, or if it does not answer.
    pub fn require(folder: &Path) -> Result<Client, CliError> {
        match Client::find(folder)? {
            Some(client) => Ok(client),
            None => Client::noticed(folder),
        }
    }

    /// The daemon that runs on a data folder by its notice, without a question to it before: for the stop, which is
    /// answered where nothing else is.
    ///
    /// # Errors
    /// No result if none does.
    pub fn noticed(folder: &Path) -> Result<Client, CliError> {
        match Holder::of(folder) {
            Holder::Daemon(client, _) => Ok(client),
            Holder::Nobody => Err(no_daemon(folder)),
            Holder::Other(process) => Err(works_alone(folder, process)),
        }
    }

    /// Stops both axes.
    ///
    /// # Errors
    /// No result if the daemon does not answer, or could not reach the stages.
    pub fn stop(&self) -> Result<Value, CliError> {
        let answer = self.send("/rig/stop", None).map_err(|error| {
            CliError::no_result(anyhow!(
                "the daemon at {} does not answer the stop, and the stages may be moving: use the hardware emergency \
                 switch ({error})",
                self.url
            ))
        })?;
        read(answer)
    }

    /// Asks for a path below `/api/v1`.
    ///
    /// # Errors
    /// The daemon's problem, with exit code 2 where the input is to blame.
    pub fn get(&self, path: &str) -> Result<Value, CliError> {
        self.search(path, &[])
    }

    /// Asks for a path below `/api/v1` with parameters, whatever their values have in them.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn search(&self, path: &str, query: &[(&str, &str)]) -> Result<Value, CliError> {
        let answer = self
            .agent
            .get(format!("{}/api/v1{path}", self.url))
            .query_pairs(query.iter().copied())
            .call()
            .map_err(unreachable)?;
        read(answer)
    }

    /// Sends a body, or none, to a path below `/api/v1`.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn post(&self, path: &str, body: Option<&Value>) -> Result<Value, CliError> {
        read(self.send(path, body).map_err(unreachable)?)
    }

    /// The same for what is answered only once it is done, however long it takes.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn post_patiently(&self, path: &str, body: &Value) -> Result<Value, CliError> {
        let request = self.agent.post(format!("{}/api/v1{path}", self.url));
        let request = request.config().timeout_global(None).build();
        read(request.send_json(body).map_err(unreachable)?)
    }

    /// The same for what may have come too late: `None` where it is not allowed any more.
    ///
    /// # Errors
    /// As [`Client::get`], but for a conflict.
    pub fn post_in_time(
        &self,
        path: &str,
        body: Option<&Value>,
    ) -> Result<Option<Value>, CliError> {
        let answer = self.send(path, body).map_err(unreachable)?;
        match answer.status() == 409 {
            true => Ok(None),
            false => read(answer).map(Some),
        }
    }

    fn send(&self, path: &str, body: Option<&Value>) -> Result<Response, ureq::Error> {
        let request = self.agent.post(format!("{}/api/v1{path}", self.url));
        match body {
            Some(body) => request.send_json(body),
            None => request.send_empty(),
        }
    }
}

type Response = ureq::http::Response<ureq::Body>;

fn unreachable(error: ureq::Error) -> CliError {
    CliError::no_result(anyhow!("the daemon does not answer: {error}"))
}

/// What a problem says.
fn told(problem: &Value) -> String {
    let detail = problem["detail"].as_str();
    let detail = detail.unwrap_or("the daemon refused");
    match problem["code"] == "too-many-connections" {
        true => format!("the daemon is there, but full: {detail}"),
        false => detail.to_owned(),
    }
}

fn read(mut answer: Response) -> Result<Value, CliError> {
    let status = answer.status();
    let body: Value = answer.body_mut().read_json().map_err(|error| {
        CliError::no_result(anyhow!("the daemon's answer is not JSON: {error}"))
    })?;
    if status.is_success() {
        return Ok(body);
    }
    let error = anyhow!("{}", told(&body));
    // What the machine refuses is no mistake of the user.
    let refused = status.is_server_error() || status == 409;
    Err(match refused {
        true => CliError::NoResult(error),
        false => CliError::BadInput(error),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read as _, Write as _};
    use std::net::TcpListener;

    #[test]
    fn an_import_is_waited_for_however_long_it_takes() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let mut stream = stream;
                // All that was asked, and longer than the client waits for anything else.
                stream
                    .set_read_timeout(Some(Duration::from_millis(600)))
                    .ok();
                stream.read_to_end(&mut Vec::new()).ok();
                let answer = "HTTP/1.1 201 Created\r\nContent-Type: application/json\r\nContent-Length: 2\r\n\r\n{}";
                stream.write_all(answer.as_bytes()).ok();
            }
        });
        let timeout = Some(Duration::from_millis(100));
        let client = Client {
            agent: ureq::Agent::config_builder()
                .timeout_global(timeout)
                .build()
                .into(),
            url,
        };
        let body = serde_json::json!({});
        assert!(client.post("/imports", Some(&body)).is_err());
        assert_eq!(client.post_patiently("/imports", &body).unwrap(), body);
    }
}
