//! A daemon at an address, on this machine or another one, with or without TLS.

use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::anyhow;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use ureq::http::Uri;
use ureq::tls::{Certificate, RootCerts, TlsConfig};

use super::connection::ConnectionArgs;
use super::{Client, agent_config};
use crate::cli::CliError;

/// Files with the certificates that a machine trusts: of Debian, of Fedora.
const TRUSTED: [&str; 2] = [
    "/etc/ssl/certs/ca-certificates.crt",
    "/etc/pki/tls/certs/ca-bundle.crt",
];

/// Returns the client of a daemon at an address; nothing is sent yet.
///
/// # Errors
/// Bad input for a text that is no address of a daemon, for certificates that cannot be read, and for a token that would
/// cross a network in clear text.
pub(super) fn client(url: &str, connection: &ConnectionArgs) -> Result<Client, CliError> {
    let address = Address::read(url).map_err(|why| CliError::bad_input(anyhow!("--url: {why}")))?;
    if !address.is_encrypted && !address.is_loopback && connection.token_file.is_some() {
        return Err(CliError::bad_input(anyhow!(
            "--url: {url} is not encrypted, and everyone on the network could read the token; use https:// (the daemon needs \
            --tls-cert and --tls-key), or a tunnel to this machine"
        )));
    }
    let mut config = agent_config();
    if address.is_loopback {
        config = config.proxy(None);
    }
    if address.is_encrypted {
        let tls = TlsConfig::builder()
            .root_certs(RootCerts::from(trusted(connection.trust.as_deref())?))
            .unversioned_rustls_crypto_provider(Arc::new(ring::default_provider()));
        config = config.tls_config(tls.build());
    }
    Ok(Client {
        agent: config.build().into(),
        token: None,
        lease: None,
        url: address.url,
    })
}

/// The address of a daemon.
#[derive(Debug, PartialEq, Eq)]
struct Address {
    /// Scheme, host and port.
    url: String,
    is_encrypted: bool,
    is_loopback: bool,
}

impl Address {
    fn read(text: &str) -> Result<Address, String> {
        let form = || format!("expected http://HOST:PORT or https://HOST:PORT, got `{text}`");
        let uri: Uri = text.parse().map_err(|_| form())?;
        let authority = uri.authority().ok_or_else(form)?;
        if authority.as_str().contains('@') {
            return Err(
                "an address has no user name or password; --token-file presents a token".into(),
            );
        }
        if !matches!(uri.path(), "" | "/") || uri.query().is_some() {
            return Err(form());
        }
        let is_encrypted = match uri.scheme_str() {
            Some("https") => true,
            Some("http") => false,
            _ => return Err(form()),
        };
        let host = uri.host().unwrap_or_default();
        let number = host.trim_matches(['[', ']']).parse::<IpAddr>();
        Ok(Address {
            url: text.trim_end_matches('/').to_owned(),
            is_encrypted,
            is_loopback: host == "localhost" || number.is_ok_and(|ip| ip.is_loopback()),
        })
    }
}

/// Reads the certificates of a file, or those that this machine trusts.
fn trusted(file: Option<&Path>) -> Result<Vec<Certificate<'static>>, CliError> {
    let system = || TRUSTED.iter().map(PathBuf::from).find(|file| file.exists());
    let Some(file) = file.map(Path::to_owned).or_else(system) else {
        return Err(CliError::bad_input(anyhow!(
            "this machine has no list of certificates that it trusts ({}); name the certificate of the daemon with --trust",
            TRUSTED.join(", ")
        )));
    };
    let unusable = |why: String| {
        CliError::bad_input(anyhow!(
            "{} is not a PEM file with a certificate: {why}",
            file.display()
        ))
    };
    let all = CertificateDer::pem_file_iter(&file).and_then(Iterator::collect);
    let all: Vec<CertificateDer<'_>> = all.map_err(|error| unusable(error.to_string()))?;
    if all.is_empty() {
        return Err(unusable("it has none".into()));
    }
    let owned = all.iter().map(|der| Certificate::from_der(der).to_owned());
    Ok(owned.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_scheme_host_and_port_and_nothing_else() {
        let read = |text: &str| Address::read(text);
        assert_eq!(
            read("https://rig.lab.example:8787/"),
            Ok(Address {
                url: "https://rig.lab.example:8787".into(),
                is_encrypted: true,
                is_loopback: false,
            })
        );
        for text in [
            "http://127.0.0.1:8787",
            "http://[::1]:8787",
            "http://localhost:8787",
        ] {
            assert!(read(text).unwrap().is_loopback, "{text}");
        }
        for text in [
            "",
            "rig:8787",
            "ftp://rig",
            "https://rig/api/v1",
            "https://rig?token=1",
            "https://",
        ] {
            assert!(
                read(text).unwrap_err().starts_with("expected http"),
                "{text}"
            );
        }
        assert!(
            read("https://me:secret@rig")
                .unwrap_err()
                .contains("--token-file")
        );
    }

    #[test]
    fn a_token_does_not_cross_a_network_in_clear_text() {
        let with_token = ConnectionArgs {
            token_file: Some("token".into()),
            ..ConnectionArgs::default()
        };
        let refused = client("http://192.0.2.7:8787", &with_token).unwrap_err();
        assert!(
            format!("{refused:?}").contains("not encrypted"),
            "{refused:?}"
        );
        assert!(client("http://127.0.0.1:8787", &with_token).is_ok());
    }

    #[test]
    fn a_file_without_a_certificate_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("key.pem");
        std::fs::write(&file, "no certificate").unwrap();
        let refused = format!("{:?}", trusted(Some(&file)).unwrap_err());
        assert!(
            refused.contains("key.pem") && refused.contains("it has none"),
            "{refused}"
        );
    }
}
