//! The client of a running daemon, of a data folder or at an address: sends JSON over HTTP.

mod connection;
mod folder;
mod remote;

use std::path::Path;
use std::time::Duration;

use anyhow::anyhow;
use serde_json::Value;
use ureq::config::ConfigBuilder;
use ureq::typestate::AgentScope;

use super::CliError;
pub use connection::ConnectionArgs;
use connection::Secrecy;
use folder::FolderHolder;

/// How long an answer may take.
const ANSWER_WITHIN: Duration = Duration::from_secs(60);
/// How long the answer to the stop may take: a daemon answers it within a second in every state.
const STOP_WITHIN: Duration = Duration::from_secs(2);
/// How long an answer may take that the daemon gives at once.
const STATE_WITHIN: Duration = Duration::from_secs(5);

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

impl Client {
    /// Returns the daemon that a command speaks to: that at `--url`, otherwise that of the data folder if one runs there.
    ///
    /// # Errors
    /// No result if it is there and does not answer; bad input for an address, token file or lease that cannot be used.
    pub fn of(folder: &Path, connection: &ConnectionArgs) -> Result<Option<Client>, CliError> {
        let client = match &connection.url {
            Some(url) => Some(remote::client(url, connection)?),
            None => Client::find(folder)?,
        };
        client
            .map(|client| client.presenting(connection))
            .transpose()
    }

    /// Returns the daemon that a command needs: that at `--url`, otherwise that of the data folder.
    ///
    /// # Errors
    /// As [`Client::of`]; no result if no daemon runs.
    pub fn require(folder: &Path, connection: &ConnectionArgs) -> Result<Client, CliError> {
        match Client::of(folder, connection)? {
            Some(client) => Ok(client),
            None => Client::noticed(folder)?.presenting(connection),
        }
    }

    /// Returns the daemon that runs on a data folder, if there is one.
    ///
    /// # Errors
    /// No result if it is there and does not answer.
    pub fn find(folder: &Path) -> Result<Option<Client>, CliError> {
        let FolderHolder::Daemon(client, process) = FolderHolder::of(folder) else {
            return Ok(None);
        };
        let request = client.agent.get(format!("{}/healthz", client.url));
        let answer = within(STATE_WITHIN, request).call();
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

    /// Returns the daemon of a data folder by its notice, without asking it first: for the stop, which is answered even where
    /// other requests are not.
    ///
    /// # Errors
    /// No result if none does.
    pub fn noticed(folder: &Path) -> Result<Client, CliError> {
        match FolderHolder::of(folder) {
            FolderHolder::Daemon(client, _) => Ok(client),
            FolderHolder::Free => Err(folder::no_daemon(folder)),
            FolderHolder::Other(process) => Err(folder::works_alone(folder, process)),
        }
    }

    /// Presents a token and a lease with every request.
    ///
    /// # Errors
    /// Bad input for a token file or a lease that cannot be used.
    fn presenting(mut self, connection: &ConnectionArgs) -> Result<Client, CliError> {
        self.token = connection.token()?.or(self.token);
        self.lease = connection.lease()?;
        Ok(self)
    }

    /// Stops both axes.
    ///
    /// # Errors
    /// No result if the daemon does not answer, or could not reach the stages.
    pub fn stop(&self) -> Result<Value, CliError> {
        let request = self.signed(self.agent.post(format!("{}/api/v1/rig/stop", self.url)));
        let answer = within(STOP_WITHIN, request).send_empty().map_err(|error| {
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

    /// Gets the state of the rig, which a daemon knows at once.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub fn rig(&self) -> Result<Value, CliError> {
        let request = self.signed(self.agent.get(format!("{}/api/v1/rig", self.url)));
        read(within(STATE_WITHIN, request).call().map_err(unreachable)?)
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
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {}", token.text()));
        }
        if let Some(lease) = &self.lease {
            request = request.header("ridged-lease", lease.text());
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

/// What every connection to a daemon has in common. A daemon redirects no request: a redirect would send the token
/// elsewhere.
fn agent_config() -> ConfigBuilder<AgentScope> {
    ureq::Agent::config_builder()
        .timeout_global(Some(ANSWER_WITHIN))
        .http_status_as_error(false)
        .max_redirects(0)
        .max_redirects_will_error(false)
}

/// Sets the time limit of one request.
fn within<B>(limit: Duration, request: ureq::RequestBuilder<B>) -> ureq::RequestBuilder<B> {
    request.config().timeout_global(Some(limit)).build()
}

fn unreachable(error: ureq::Error) -> CliError {
    let text = error.to_string();
    let way_out = match text.contains("peer certificate") {
        true => "; if this is the daemon, name the file of its certificate with --trust",
        false => "",
    };
    CliError::no_result(anyhow!("the daemon does not answer: {text}{way_out}"))
}

/// Returns the message of a problem.
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
    if status.is_redirection() {
        let place = answer.headers().get("location");
        let place = place.and_then(|place| place.to_str().ok());
        return Err(CliError::no_result(anyhow!(
            "this address is not a daemon's: it redirects requests to {}; name the address of the daemon itself",
            place.unwrap_or("another address")
        )));
    }
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
    use std::io::{BufRead as _, BufReader, Read as _, Write as _};
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
            agent: agent_config().timeout_global(timeout).build().into(),
            token: None,
            lease: None,
            url,
        };
        let body = serde_json::json!({});
        assert!(client.post("/imports", Some(&body)).is_err());
        assert_eq!(client.post_patiently("/imports", &body).unwrap(), body);
    }

    #[test]
    fn the_state_of_a_frozen_daemon_is_an_error_within_seconds() {
        // The system accepts connections for a process that is frozen.
        let frozen = TcpListener::bind("127.0.0.1:0").unwrap();
        let client = Client {
            agent: agent_config().build().into(),
            token: None,
            lease: None,
            url: format!("http://{}", frozen.local_addr().unwrap()),
        };
        let began = std::time::Instant::now();
        let error = client.rig().unwrap_err();
        assert!(began.elapsed() < ANSWER_WITHIN / 3, "{error:?}");
        assert!(matches!(error, CliError::NoResult(_)), "{error:?}");
    }

    #[test]
    fn a_redirect_is_an_error_and_takes_no_token_elsewhere() {
        let elsewhere = TcpListener::bind("127.0.0.1:0").unwrap();
        elsewhere.set_nonblocking(true).unwrap();
        let place = format!("http://{}/api/v1/rig", elsewhere.local_addr().unwrap());
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let location = place.clone();
        std::thread::spawn(move || {
            for mut stream in listener.incoming().flatten() {
                let lines = BufReader::new(&stream).lines();
                assert!(lines.map_while(Result::ok).any(|line| line.is_empty()));
                let answer = format!(
                    "HTTP/1.1 307 Temporary Redirect\r\nLocation: {location}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
                );
                stream.write_all(answer.as_bytes()).ok();
            }
        });
        let client = Client {
            agent: agent_config().build().into(),
            token: None,
            lease: None,
            url,
        };
        for error in [
            client.get("/rig").unwrap_err(),
            client.post("/rig/stop", None).unwrap_err(),
            client.download("/rig").unwrap_err(),
        ] {
            let CliError::NoResult(error) = error else {
                panic!("{error:?}");
            };
            assert!(error.to_string().contains(&place), "{error}");
        }
        let refused = elsewhere.accept().map(|_| ()).unwrap_err();
        assert_eq!(refused.kind(), std::io::ErrorKind::WouldBlock);
    }
}
