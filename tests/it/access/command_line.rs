//! `ridged token`, `ridged rig lease`, and a daemon of the program itself.

use std::io::{BufRead, BufReader, Read};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

use serde_json::Value;

use crate::commands::{refuses, ridged};

/// Runs a command that must succeed, and returns its output.
fn output(folder: &Path, args: &[&str]) -> String {
    let output = ridged(folder, args);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {message}");
    String::from_utf8(output.stdout).unwrap()
}

struct Program {
    child: Child,
    url: String,
    /// Reads the log from the start: a full pipe would block the daemon.
    log: JoinHandle<String>,
}

impl Program {
    fn start(folder: &Path, settings: &str) -> Program {
        let file = folder.join("rig.toml");
        std::fs::write(&file, settings).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_ridged"))
            .args(["serve", "--simulated-rig", "--listen", "127.0.0.1:0"])
            .args(["--data", "data", "--config", "rig.toml"])
            .current_dir(folder)
            .env("RIDGED_LOG", "trace")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let mut lines = BufReader::new(child.stdout.take().unwrap());
        lines.read_line(&mut line).unwrap();
        let url = line
            .trim()
            .strip_prefix("listening on ")
            .unwrap()
            .to_owned();
        let mut stderr = child.stderr.take().unwrap();
        let log = std::thread::spawn(move || {
            let mut text = String::new();
            stderr.read_to_string(&mut text).ok();
            text
        });
        Program { child, url, log }
    }

    /// Ends it and returns its log.
    fn end(mut self) -> String {
        let process = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
        self.child.wait().unwrap();
        self.log.join().unwrap()
    }

    fn get(&self, path: &str, headers: &[(&str, &str)]) -> (u16, Value) {
        let config = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .build();
        let agent: ureq::Agent = config.into();
        let mut request = agent.get(format!("{}{path}", self.url));
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let mut answer = request.call().unwrap();
        let body = answer.body_mut().read_json().unwrap_or(Value::Null);
        (answer.status().as_u16(), body)
    }
}

#[test]
fn tokens_are_made_listed_and_revoked() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let data = ["--data", "data"];
    let create = |name: &str, more: &[&str]| {
        let args = [
            &["token", "create", name, "--role", "operator"],
            more,
            &data,
        ]
        .concat();
        output(at, &args)
    };
    let shown = create("anna", &[]);
    assert!(
        shown.starts_with("ridged_") && shown.trim().len() > 40,
        "{shown}"
    );
    let said = create("script", &["--out", "script.token"]);
    let token = std::fs::read_to_string(at.join("script.token")).unwrap();
    assert!(!said.contains(token.trim()), "{said}");
    let mode = std::fs::metadata(at.join("script.token"))
        .unwrap()
        .permissions();
    assert_eq!(mode.mode() & 0o777, 0o600);
    let listed = output(at, &["token", "list", "--json", "--data", "data"]);
    let listed: Value = serde_json::from_str(&listed).unwrap();
    assert_eq!(listed["items"][0]["name"], "anna");
    assert!(!listed.to_string().contains("sha256"));
    output(at, &["token", "revoke", "anna", "--data", "data"]);
    let listed = output(at, &["token", "list", "--data", "data"]);
    assert!(listed.contains("revoked"), "{listed}");
    for (args, words) in [
        (
            &["token", "create", "anna", "--role", "viewer"][..],
            &["anna", "another name"][..],
        ),
        (
            &["token", "create", "local", "--role", "viewer"],
            &["local"],
        ),
        (
            &["token", "create", "carl", "--role", "root"],
            &["viewer, analyst, operator or admin"],
        ),
        (&["token", "revoke", "anna"], &["token list"]),
        (
            &[
                "token",
                "create",
                "carl",
                "--role",
                "viewer",
                "--out",
                "script.token",
            ],
            &["script.token", "new file"],
        ),
    ] {
        refuses(at, &[args, &data].concat(), 2, words);
    }
}

#[test]
fn a_start_that_lets_others_in_unprotected_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let serve = |more: &[&'static str]| {
        let begin = [
            "serve",
            "--simulated-rig",
            "--data",
            "data",
            "--listen",
            "0.0.0.0:0",
        ];
        [&begin[..], more].concat()
    };
    let tls = ["--tls-cert", "cert.pem", "--tls-key", "key.pem"];
    let ways_out = ["--tls-cert", "--behind-proxy", "ssh -L", "access control"];
    refuses(at, &serve(&[]), 2, &ways_out);
    let words = ["ridged token create NAME --role admin --data data"];
    refuses(at, &serve(&["--behind-proxy"]), 2, &words);
    refuses(at, &serve(&tls), 2, &words);
    output(
        at,
        &[
            "token", "create", "anna", "--role", "admin", "--data", "data",
        ],
    );
    refuses(at, &serve(&[]), 2, &ways_out);
    refuses(at, &serve(&tls), 2, &["cert.pem"]);
    refuses(at, &serve(&["--tls-cert", "cert.pem"]), 2, &["--tls-key"]);
}

#[test]
fn no_token_is_in_an_answer_or_in_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let token = output(
        at,
        &[
            "token", "create", "anna", "--role", "admin", "--data", "data",
        ],
    );
    let token = token.trim();
    let program = Program::start(at, "[server]\ntoken_on_loopback = true\n");
    assert_eq!(program.get("/api/v1/rig", &[]).0, 401);
    let bearer = format!("Bearer {token}");
    let (status, rig) = program.get("/api/v1/rig", &[("authorization", &bearer)]);
    assert_eq!(status, 200, "{rig}");
    let in_url = format!("/api/v1/rig?token={token}");
    let (status, refused) = program.get(&in_url, &[]);
    assert_eq!(status, 401);
    assert!(!refused.to_string().contains(token), "{refused}");
    let wrong = format!("{token}x");
    let wrong_bearer = format!("Bearer {wrong}");
    let (status, refused) = program.get("/api/v1/rig", &[("authorization", &wrong_bearer)]);
    assert_eq!(status, 401);
    assert!(!refused.to_string().contains(&wrong), "{refused}");
    // Commands of the daemon's own user need no token, those with a token file present it.
    let secret = std::fs::read_to_string(at.join("data/daemon.secret")).unwrap();
    let lease = output(at, &["rig", "lease", "take", "night", "--data", "data"]);
    let lease = lease.trim();
    refuses(
        at,
        &["rig", "unpark", "--data", "data"],
        1,
        &["local holds the rig (night)"],
    );
    output(at, &["rig", "unpark", "--lease", lease, "--data", "data"]);
    output(at, &["rig", "stop", "--data", "data"]);
    let shown = output(at, &["rig", "lease", "show", "--data", "data"]);
    assert!(shown.starts_with("local holds the rig: night"), "{shown}");
    output(
        at,
        &["rig", "lease", "return", "--lease", lease, "--data", "data"],
    );
    std::fs::write(at.join("anna.token"), token).unwrap();
    let by_file = [
        "rig",
        "lease",
        "take",
        "by file",
        "--token-file",
        "anna.token",
        "--data",
        "data",
    ];
    std::fs::set_permissions(
        at.join("anna.token"),
        std::fs::Permissions::from_mode(0o644),
    )
    .unwrap();
    refuses(at, &by_file, 2, &["chmod 600 anna.token"]);
    std::fs::set_permissions(
        at.join("anna.token"),
        std::fs::Permissions::from_mode(0o600),
    )
    .unwrap();
    output(at, &by_file);
    let shown = output(at, &["rig", "lease", "show", "--data", "data"]);
    assert!(shown.starts_with("anna holds the rig: by file"), "{shown}");
    // A proxy of the environment is not asked for this machine.
    let mut status = Command::new(env!("CARGO_BIN_EXE_ridged"));
    status.args(["rig", "status", "--data", "data"]);
    status
        .current_dir(at)
        .env("ALL_PROXY", "http://127.0.0.1:9");
    let status = status.output().unwrap();
    assert!(status.status.success(), "{status:?}");
    let log = program.end();
    assert!(log.contains("/api/v1/rig"), "the log has the requests");
    for secret in [token, secret.trim(), lease, "Bearer"] {
        assert!(!log.contains(secret), "the log has a secret");
    }
}
