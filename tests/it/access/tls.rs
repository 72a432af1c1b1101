//! TLS by the daemon itself.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Output;
use std::sync::Arc;

use ridged::api::server::TlsFiles;
use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore, crypto::ring};

use crate::commands::ridged;

use super::{Answer, Ask, Served, Serving, Tokens, answer, get, head, order, post};

/// A daemon with a certificate of its own, and who trusts it.
struct Encrypted {
    served: Served,
    tokens: Tokens,
    connector: TlsConnector,
    files: tempfile::TempDir,
}

impl Encrypted {
    async fn new() -> Encrypted {
        let folder = tempfile::tempdir().unwrap();
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        let files = TlsFiles {
            certificate: folder.path().join("cert.pem"),
            key: folder.path().join("key.pem"),
        };
        std::fs::write(&files.certificate, made.cert.pem()).unwrap();
        std::fs::write(&files.key, made.signing_key.serialize_pem()).unwrap();
        let mut roots = RootCertStore::empty();
        let own: CertificateDer<'static> = made.cert.der().clone();
        roots.add(own).unwrap();
        let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_no_client_auth();
        let (served, tokens) = Served::new(Serving {
            token_on_loopback: true,
            tls: Some(files),
            ..Serving::default()
        })
        .await;
        assert!(served.daemon.url.starts_with("https://"));
        Encrypted {
            served,
            tokens,
            connector: TlsConnector::from(Arc::new(config)),
            files: folder,
        }
    }

    async fn connect(&self) -> TlsStream<tokio::net::TcpStream> {
        let name = ServerName::try_from("localhost").unwrap();
        let stream = self.served.connect().await;
        self.connector.connect(name, stream).await.unwrap()
    }

    async fn ask(&self, ask: Ask<'_>) -> Answer {
        ask.on(&mut self.connect().await, self.served.address).await
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_caller_with_a_token_is_served_over_tls() {
    let encrypted = Encrypted::new().await;
    encrypted.ask(get("/api/v1/rig")).await.is(401, "no-token");
    let rig = get("/api/v1/rig").by(&encrypted.tokens.viewer);
    encrypted.ask(rig).await.is_ok();
    encrypted.ask(order("/api/v1/rig/stop")).await.is_ok();
    // An event stream stays open, and its end does not hold the daemon.
    let mut stream = encrypted.connect().await;
    let events = get("/api/v1/events").by(&encrypted.tokens.viewer);
    let text = events.head(encrypted.served.address, 0);
    stream.write_all(text.as_bytes()).await.unwrap();
    assert_eq!(head(&mut stream).await.status, 200);
    encrypted.served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn with_tls_the_cookie_is_secure_and_of_this_host_only() {
    let encrypted = Encrypted::new().await;
    let login = post(
        "/api/v1/session",
        &json!({ "token": encrypted.tokens.viewer }),
    );
    let session = encrypted.ask(login).await;
    let cookie = session.header("set-cookie")[0].to_owned();
    assert!(cookie.starts_with("__Host-"), "{cookie}");
    for part in ["; Secure", "; HttpOnly", "; SameSite=Strict"] {
        assert!(cookie.contains(part), "{cookie}");
    }
    let own = format!("https://{}", encrypted.served.address);
    let pair = cookie.split(';').next().unwrap();
    let stop = order("/api/v1/rig/stop").with("cookie", pair);
    encrypted
        .ask(stop.clone().with("origin", own))
        .await
        .is_ok();
    let plain = format!("http://{}", encrypted.served.address);
    let forged = encrypted.ask(stop.with("origin", plain)).await;
    forged.is(403, "forbidden-origin");
    encrypted.served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unencrypted_request_gets_nothing() {
    let encrypted = Encrypted::new().await;
    let served = &encrypted.served;
    let mut stream = served.connect().await;
    let text = get("/api/v1/rig")
        .by(&encrypted.tokens.admin)
        .head(served.address, 0);
    stream.write_all(text.as_bytes()).await.unwrap();
    let nothing = answer(&mut stream).await;
    assert_eq!(nothing.status, 0, "{nothing:?}");
    encrypted.ask(get("/healthz")).await.is_ok();
    encrypted.served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_command_reaches_a_daemon_by_its_address() {
    let encrypted = Encrypted::new().await;
    let files = encrypted.files.path().to_owned();
    let token = files.join("token");
    std::fs::write(&token, &encrypted.tokens.operator).unwrap();
    std::fs::set_permissions(&token, Permissions::from_mode(0o600)).unwrap();
    let url = format!("https://localhost:{}", encrypted.served.address.port());
    let ask = async |args: &[&str]| {
        let mut args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
        args.extend(["--url", &url, "--token-file", "token"].map(str::to_owned));
        let files = files.clone();
        let asked = tokio::task::spawn_blocking(move || {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            ridged(&files, &args)
        });
        asked.await.unwrap()
    };
    let words = |output: &Output| {
        let text = [&output.stdout[..], &output.stderr[..]].concat();
        String::from_utf8(text).unwrap()
    };

    let trusting = ["--trust", "cert.pem"];
    let status = ask(&[&["rig", "status", "--json"], &trusting[..]].concat()).await;
    assert_eq!(status.status.code(), Some(0), "{}", words(&status));
    let rig: Value = serde_json::from_slice(&status.stdout).unwrap();
    assert!(rig["axes"]["theta_c"]["position_deg"].is_number(), "{rig}");
    let stopped = ask(&[&["rig", "stop"], &trusting[..]].concat()).await;
    assert_eq!(words(&stopped), format!("stopped: {url}\n"));

    let untrusted = ask(&["rig", "status"]).await;
    assert_eq!(untrusted.status.code(), Some(1), "{}", words(&untrusted));
    let text = words(&untrusted);
    assert!(text.contains("--trust"), "{text}");
    assert!(!text.contains(&encrypted.tokens.operator), "{text}");
    // The daemon cannot read this folder.
    let folder = ask(&[&["import", "."], &trusting[..]].concat()).await;
    assert_eq!(folder.status.code(), Some(2));
    assert!(words(&folder).contains("zip"), "{}", words(&folder));
    encrypted.served.end().await;
}
