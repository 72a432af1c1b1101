//! The client of a running daemon: finds it by its notice and sends JSON over HTTP.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::anyhow;
use serde_json::Value;

use super::CliError;
use crate::daemon::{NOTICE_FILE, SECRET_FILE};
use crate::store::Store;

/// A running daemon.
#[derive(Debug)]
pub struct Client {
    agent: ureq::Agent,
    /// Sent as `Authorization: Bearer`.
    token: Option<Secrecy>,
    /// Sent as `Ridged-Lease`.
    lease: Option<Secrecy>,
    /// `http://ADDRESS`.
    pub url: String,
}

/// The process that holds a data folder.
enum FolderHolder {
    Free,
    /// A daemon, by its notice; with its process number where the lock names the same one.
    Daemon(Client, Option<u64>),
    /// A process that answers no commands: a scan or import without a daemon, or a daemon that is starting or ending.
    Other(Option<u64>),
}

impl FolderHolder {
    fn of(folder: &Path) -> FolderHolder {
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
            agent: ureq::Agent::config_builder()
                .timeout_global(Some(Duration::from_secs(60)))
                .http_status_as_error(false)
                .build()
                .into(),
            token: token_of(folder),
            lease: None,
            url,
        };
        FolderHolder::Daemon(client, locked_by)
    }
}

/// A text that no message shows.
struct Secrecy(String);

impl std::fmt::Debug for Secrecy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("(not shown)")
    }
}

/// Returns the secret of the daemon of a folder, which only its own user can read. Other users of this machine present
/// nothing, or the token of their token file.
fn token_of(folder: &Path) -> Option<Secrecy> {
    let secret = std::fs::read_to_string(folder.join(SECRET_FILE)).ok()?;
    Some(Secrecy(secret.trim().to_owned()))
}

/// Reads a file with a token.
///
/// # Errors
/// Bad input if it cannot be read, if other users can read it, or if it has no token.
fn read_token(file: &Path) -> Result<Secrecy, CliError> {
    let wrong = |why: String| CliError::bad_input(anyhow!("token file {}: {why}", file.display()));
    let mode = std::fs::metadata(file).map_err(|error| wrong(error.to_string()))?;
    let mode = mode.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        let why = format!(
            "its mode is {mode:o}, so that others can read it; run `chmod 600 {}`",
            file.display()
        );
        return Err(wrong(why));
    }
    let text = std::fs::read_to_string(file).map_err(|error| wrong(error.to_string()))?;
    let token = text.trim();
    match token.is_empty() || token.chars().any(|c| c.is_whitespace() || c.is_control()) {
        true => Err(wrong(
            "expected one token, as `ridged token create` prints it".into(),
        )),
        false => Ok(Secrecy(token.to_owned())),
    }
}

/// What a command presents to the daemon.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct CredentialArgs {
    /// File with a token, which only its owner can read (mode 600). The daemon's own user needs none.
    #[arg(long, value_name = "FILE", env = "RIDGED_TOKEN_FILE", global = true)]
    pub token_file: Option<PathBuf>,
    /// Lease of the rig, as `ridged rig lease take` prints it.
    #[arg(
        long,
        value_name = "ID",
        env = "RIDGED_LEASE",
        hide_env_values = true,
        global = true
    )]
    pub lease: Option<String>,
}

/// The error where no daemon runs.
fn no_daemon(folder: &Path) -> CliError {
    CliError::no_result(anyhow!(
        "no daemon runs on {}; start one with `ridged serve`, or give its data folder with --data",
        folder.display()
    ))
}

/// The error where another process holds the folder, so that a second daemon would be refused.
fn works_alone(folder: &Path, process: Option<u64>) -> CliError {
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

impl Client {
    /// Returns the daemon that runs on a data folder, if there is one.
    ///
    /// # Errors
    /// No result if it is there and does not answer.
    pub fn find(folder: &Path) -> Result<Option<Client>, CliError> {
        let FolderHolder::Daemon(client, process) = FolderHolder::of(folder) else {
            return Ok(None);
        };
        let answer = client.agent.get(format!("{}/healthz", client.url)).call();
        let why = match answer {
            Ok(answer) if answer.status().is_success() => return Ok(Some(client)),
            Ok(mut answer) => match answer.body_mut().read_json() {
                Ok(problem) => message(&problem),
                Err(_) => format!("it answers {}", answer.status()),
            },
            Err(error) => error.to_string(),
        };
        match process {
            Some(process) => Err(CliError::no_result(anyhow!(
                "the daemon on {} runs (process {process}, {}) but does not answer: {why}",
                folder.display(),
                client.url
            ))),
            None => Ok(None),
        }
    }

    /// Returns the daemon that runs on a data folder.
    ///
    /// # Errors
    /// No result if none does, or if it does not answer.
    pub fn require(folder: &Path) -> Result<Client, CliError> {
        match Client::find(folder)? {
            Some(client) => Ok(client),
            None => Client::noticed(folder),
        }
    }

    /// Returns the daemon of a data folder by its notice, without asking it first: for the stop, which is answered even where
    /// other requests are not.
    ///
    /// # Errors
    /// No result if none does.
    pub fn noticed(folder: &Path) -> Result<Client, CliError> {
        match FolderHolder::of(folder) {
            FolderHolder::Daemon(client, _) => Ok(client),
            FolderHolder::Free => Err(no_daemon(folder)),
            FolderHolder::Other(process) => Err(works_alone(folder, process)),
        }
    }

    /// Presents a token and a lease with every request.
    ///
    /// # Errors
    /// Bad input for a token file or a lease that cannot be used.
    pub fn presenting(mut self, credentials: &CredentialArgs) -> Result<Client, CliError> {
        if let Some(file) = &credentials.token_file {
            self.token = Some(read_token(file)?);
        }
        if let Some(lease) = &credentials.lease {
            if lease.is_empty() || !lease.chars().all(|c| c.is_ascii_graphic()) {
                return Err(CliError::bad_input(anyhow!(
                    "--lease (RIDGED_LEASE): expected a lease as `ridged rig lease take` prints it"
                )));
            }
            self.lease = Some(Secrecy(lease.clone()));
        }
        Ok(self)
    }

    /// Stops both axes.
    ///
    /// # Errors
    /// No result if the daemon does not answer, or could not reach the stages.
    pub fn stop(&self) -> Result<Value, CliError> {
        let answer = self.send("/rig/stop", None).map_err(|error| {
            CliError::no_result(anyhow!(
                "the daemon at {} does not answer the stop; the stages may be moving: use the hardware emergency switch \
                ({error})",
                self.url
            ))
        })?;
        read(answer)
    }

    /// Gets the readiness of the daemon, ready or not.
    ///
    /// # Errors
    /// No result if the daemon does not answer.
    pub fn readiness(&self) -> Result<Value, CliError> {
        let request = self.signed(self.agent.get(format!("{}/readyz", self.url)));
        let mut answer = request.call().map_err(unreachable)?;
        answer.body_mut().read_json().map_err(CliError::no_result)
    }

    /// Gets a path below `/api/v1`.
    ///
    /// # Errors
    /// The daemon's problem, with exit code 2 where the input is to blame.
    pub fn get(&self, path: &str) -> Result<Value, CliError> {
        self.search(path, &[])
    }

    /// Gets a path below `/api/v1` with parameters, which are escaped.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn search(&self, path: &str, query: &[(&str, &str)]) -> Result<Value, CliError> {
        let request = self.agent.get(format!("{}/api/v1{path}", self.url));
        let answer = self
            .signed(request)
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

    /// Sends a correction to a path below `/api/v1`.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn patch(&self, path: &str, body: &Value) -> Result<Value, CliError> {
        let request = self.signed(self.agent.patch(format!("{}/api/v1{path}", self.url)));
        read(request.send_json(body).map_err(unreachable)?)
    }

    /// Sends a body without a time limit on the answer, for requests that are answered once their work is done.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn post_patiently(&self, path: &str, body: &Value) -> Result<Value, CliError> {
        let request = self.signed(self.agent.post(format!("{}/api/v1{path}", self.url)));
        let request = request.config().timeout_global(None).build();
        read(request.send_json(body).map_err(unreachable)?)
    }

    /// Sends a file, and waits for the answer however long it takes.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn upload(
        &self,
        path: &str,
        query: &[(&str, &str)],
        content_type: &str,
        file: &std::fs::File,
    ) -> Result<Value, CliError> {
        let request = self.signed(self.agent.post(format!("{}/api/v1{path}", self.url)));
        let request = request.query_pairs(query.iter().copied());
        let request = request.config().timeout_global(None).build();
        let request = request.content_type(content_type);
        read(request.send(file).map_err(unreachable)?)
    }

    /// Sends a body; returns `None` for a conflict, where the request came too late.
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

    /// Deletes what is at a path below `/api/v1`.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn delete(&self, path: &str) -> Result<Value, CliError> {
        let request = self.agent.delete(format!("{}/api/v1{path}", self.url));
        read(self.signed(request).call().map_err(unreachable)?)
    }

    /// Gets the bytes of a file at a path below `/api/v1`.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn download(&self, path: &str) -> Result<Vec<u8>, CliError> {
        let request = self.agent.get(format!("{}/api/v1{path}", self.url));
        let mut answer = self.signed(request).call().map_err(unreachable)?;
        match answer.status().is_success() {
            true => answer.body_mut().read_to_vec().map_err(unreachable),
            false => Err(read(answer)
                .err()
                .unwrap_or_else(|| CliError::no_result(anyhow!("the daemon sent no file")))),
        }
    }

    /// Adds token and lease.
    fn signed<B>(&self, mut request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
        if let Some(Secrecy(token)) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        if let Some(Secrecy(lease)) = &self.lease {
            request = request.header("ridged-lease", lease);
        }
        request
    }

    fn send(&self, path: &str, body: Option<&Value>) -> Result<Response, ureq::Error> {
        let request = self.signed(self.agent.post(format!("{}/api/v1{path}", self.url)));
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

/// The message of a problem.
fn message(problem: &Value) -> String {
    let detail = problem["detail"].as_str();
    let detail = detail.unwrap_or("the daemon refused");
    match problem["code"] == "too-many-connections" {
        true => format!("the daemon is busy: {detail}"),
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
    let error = anyhow!("{}", message(&body));
    // A refusal by the machine is not the user's mistake.
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
    fn an_import_may_take_any_time() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let mut stream = stream;
                // The answer comes later than the client waits for other requests.
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
            token: None,
            lease: None,
            url,
        };
        let body = serde_json::json!({});
        assert!(client.post("/imports", Some(&body)).is_err());
        assert_eq!(client.post_patiently("/imports", &body).unwrap(), body);
    }
}
