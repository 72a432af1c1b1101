//! TLS of the listener: rustls with ring, and the certificate of two PEM files.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use time::macros::format_description;
use time::{Date, OffsetDateTime, PrimitiveDateTime};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

/// Files of a certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsFiles {
    /// The certificate and those that signed it, PEM.
    pub certificate: PathBuf,
    /// Its private key, PEM.
    pub key: PathBuf,
}

/// Why the certificate cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read or has no PEM of its kind.
    #[error("{} is not a PEM file with a {what}: {detail}", file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// What it should have.
        what: &'static str,
        /// What is wrong.
        detail: String,
    },
    /// Certificate and key do not belong together, or cannot be used.
    #[error(
        "the certificate {} cannot be used with the key {}: {detail}",
        files.certificate.display(), files.key.display()
    )]
    Pair {
        /// The files.
        files: TlsFiles,
        /// What is wrong.
        detail: String,
    },
}

/// How often the files are looked at: certificates are renewed while a scan runs.
const LOOK_EVERY: Duration = Duration::from_secs(10);

/// Time before the end of a certificate from which a start, a renewal and `ridged doctor` say so.
const EXPIRES_SOON: time::Duration = time::Duration::days(30);

/// A certificate that follows its files.
pub(super) struct Tls {
    files: TlsFiles,
    current: Mutex<Current>,
}

/// How a certificate stands at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CertificateState {
    /// It is valid for some time.
    Valid {
        /// Its last day.
        until: Date,
        /// Whole days until its end.
        days_left: i64,
    },
    /// It is valid, but has to be renewed.
    ExpiresSoon {
        /// Its last day.
        until: Date,
        /// Whole days until its end.
        days_left: i64,
    },
    /// Clients refuse it.
    NotValid {
        /// Its first day.
        from: Date,
        /// Its last day.
        until: Date,
    },
    /// Its days cannot be read.
    Unknown,
}

impl CertificateState {
    fn at(
        now: OffsetDateTime,
        valid: Option<(OffsetDateTime, OffsetDateTime)>,
    ) -> CertificateState {
        let Some((from, until)) = valid else {
            return CertificateState::Unknown;
        };
        let left = until - now;
        let (days_left, last) = (left.whole_days(), until.date());
        match () {
            () if now < from || now > until => CertificateState::NotValid {
                from: from.date(),
                until: last,
            },
            () if left < EXPIRES_SOON => CertificateState::ExpiresSoon {
                until: last,
                days_left,
            },
            () => CertificateState::Valid {
                until: last,
                days_left,
            },
        }
    }
}

struct Current {
    acceptor: TlsAcceptor,
    /// When the files were changed last.
    changed: [Option<SystemTime>; 2],
    looked_at: Instant,
}

impl Tls {
    /// Reads the certificate.
    ///
    /// # Errors
    /// [`TlsError`] with file and reason.
    pub fn new(files: &TlsFiles) -> Result<Tls, TlsError> {
        let current = Current {
            changed: changed(files),
            acceptor: acceptor(files)?,
            looked_at: Instant::now(),
        };
        Ok(Tls {
            files: files.clone(),
            current: Mutex::new(current),
        })
    }

    /// Returns what accepts a connection. Reads the files again if they have changed; keeps the old certificate if the new one
    /// cannot be used.
    pub fn acceptor(&self, now: Instant) -> TlsAcceptor {
        let mut current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        if now.duration_since(current.looked_at) >= LOOK_EVERY {
            current.looked_at = now;
            let changed = changed(&self.files);
            if changed != current.changed {
                current.changed = changed;
                match acceptor(&self.files) {
                    Ok(renewed) => {
                        tracing::info!("the certificate has changed; new connections use it");
                        current.acceptor = renewed;
                    }
                    Err(error) => {
                        tracing::error!(%error, "the old certificate stays: {error}");
                    }
                }
            }
        }
        current.acceptor.clone()
    }
}

fn changed(files: &TlsFiles) -> [Option<SystemTime>; 2] {
    [&files.certificate, &files.key].map(|file| file.metadata().ok()?.modified().ok())
}

/// Checks that a certificate can be used, and returns how it stands now.
///
/// # Errors
/// [`TlsError`] with file and reason.
pub fn check_certificate(files: &TlsFiles) -> Result<CertificateState, TlsError> {
    read(files).map(|(_, state)| state)
}

/// Reads the certificate, and returns what accepts connections with it. Logs where it is due to be renewed.
fn acceptor(files: &TlsFiles) -> Result<TlsAcceptor, TlsError> {
    let (acceptor, state) = read(files)?;
    let file = files.certificate.display();
    match state {
        // Clients refuse it, but one that trusts this very certificate may not.
        CertificateState::NotValid { from, until } => tracing::error!(
            "the certificate {file} is valid from {from} to {until}, so clients refuse the connection: renew it, or set the clock"
        ),
        CertificateState::ExpiresSoon { until, .. } => {
            tracing::warn!("the certificate {file} expires on {until}: renew it");
        }
        CertificateState::Valid { .. } | CertificateState::Unknown => {}
    }
    Ok(acceptor)
}

/// Reads the certificate: what accepts connections with it, and how it stands now.
fn read(files: &TlsFiles) -> Result<(TlsAcceptor, CertificateState), TlsError> {
    let wrong = |file: &Path, what, detail: String| TlsError::Unusable {
        file: file.to_owned(),
        what,
        detail,
    };
    let chain = CertificateDer::pem_file_iter(&files.certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| wrong(&files.certificate, "certificate", error.to_string()))?;
    let Some(own) = chain.first() else {
        let detail = "it has none".to_owned();
        return Err(wrong(&files.certificate, "certificate", detail));
    };
    let state = CertificateState::at(OffsetDateTime::now_utc(), validity(own));
    let key = PrivateKeyDer::from_pem_file(&files.key)
        .map_err(|error| wrong(&files.key, "private key", error.to_string()))?;
    let pair = |detail: String| TlsError::Pair {
        files: files.clone(),
        detail,
    };
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| pair(error.to_string()))?
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(|error| pair(error.to_string()))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok((TlsAcceptor::from(Arc::new(config)), state))
}

/// Returns from when to when a certificate is valid; `None` if it cannot be read.
fn validity(certificate: &[u8]) -> Option<(OffsetDateTime, OffsetDateTime)> {
    const SEQUENCE: u8 = 0x30;
    const VERSION: u8 = 0xA0;
    let (_, certificate, _) = element(certificate)?;
    let (_, mut fields, _) = element(certificate)?;
    if fields.first() == Some(&VERSION) {
        fields = element(fields)?.2;
    }
    // Serial number, algorithm and issuer come first.
    for _ in 0..3 {
        fields = element(fields)?.2;
    }
    let (SEQUENCE, times, _) = element(fields)? else {
        return None;
    };
    let (form, from, rest) = element(times)?;
    let (until_form, until, _) = element(rest)?;
    Some((moment(form, from)?, moment(until_form, until)?))
}

/// Splits an element of DER into its tag, its content and what follows.
fn element(der: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&tag, rest) = der.split_first()?;
    let (&first, rest) = rest.split_first()?;
    let (length, rest) = match first {
        0..=127 => (usize::from(first), rest),
        _ => {
            let (bytes, rest) = rest.split_at_checked(usize::from(first & 127))?;
            let length = bytes.iter().try_fold(0_usize, |length, byte| {
                Some(length.checked_mul(256)? + usize::from(*byte))
            });
            (length?, rest)
        }
    };
    let (content, rest) = rest.split_at_checked(length)?;
    Some((tag, content, rest))
}

/// Reads a time of DER: `YYMMDDhhmmssZ`, or with four digits of the year.
fn moment(form: u8, text: &[u8]) -> Option<OffsetDateTime> {
    const TWO_DIGITS: u8 = 0x17;
    let text = std::str::from_utf8(text).ok()?.strip_suffix('Z')?;
    let text = match form {
        // X.509 has them from 1950 to 2049.
        TWO_DIGITS if text.get(..2)? < "50" => format!("20{text}"),
        TWO_DIGITS => format!("19{text}"),
        _ => text.to_owned(),
    };
    let form = format_description!("[year][month][day][hour][minute][second]");
    let moment = PrimitiveDateTime::parse(&text, form).ok()?;
    Some(moment.assume_utc())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_days_of_a_certificate_are_read_and_a_torn_one_has_none() {
        let mut made = rcgen::CertificateParams::new(["localhost".to_owned()]).unwrap();
        let key = rcgen::KeyPair::generate().unwrap();
        for (from, until) in [
            ((1999, 3, 4), (2026, 1, 9)),
            ((2025, 12, 31), (2061, 2, 28)),
        ] {
            made.not_before = rcgen::date_time_ymd(from.0, from.1, from.2);
            made.not_after = rcgen::date_time_ymd(until.0, until.1, until.2);
            let signed = made.self_signed(&key).unwrap();
            let read = validity(signed.der()).unwrap();
            assert_eq!(read, (made.not_before, made.not_after));
            for length in 0..120 {
                assert_eq!(validity(&signed.der()[..length]), None);
            }
        }
    }

    #[test]
    fn a_certificate_is_valid_expires_soon_or_is_refused() {
        use time::macros::{date, datetime};
        let valid = Some((
            datetime!(2026-01-01 00:00 UTC),
            datetime!(2027-01-01 12:00 UTC),
        ));
        let until = date!(2027 - 01 - 01);
        let at = |now| CertificateState::at(now, valid);
        let days_left = 151;
        assert_eq!(
            at(datetime!(2026-08-03 00:00 UTC)),
            CertificateState::Valid { until, days_left }
        );
        let days_left = 29;
        assert_eq!(
            at(datetime!(2026-12-03 00:00 UTC)),
            CertificateState::ExpiresSoon { until, days_left }
        );
        let from = date!(2026 - 01 - 01);
        for now in [
            datetime!(2025-12-31 00:00 UTC),
            datetime!(2027-01-01 12:01 UTC),
        ] {
            assert_eq!(at(now), CertificateState::NotValid { from, until });
        }
        let unread = CertificateState::at(datetime!(2026-12-03 00:00 UTC), None);
        assert_eq!(unread, CertificateState::Unknown);
    }

    /// Writes a certificate of its own, and returns its files.
    fn written(folder: &Path) -> TlsFiles {
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        let files = TlsFiles {
            certificate: folder.join("cert.pem"),
            key: folder.join("key.pem"),
        };
        std::fs::write(&files.certificate, made.cert.pem()).unwrap();
        std::fs::write(&files.key, made.signing_key.serialize_pem()).unwrap();
        files
    }

    #[test]
    fn a_renewed_certificate_is_used_and_an_unusable_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let files = written(folder.path());
        let tls = Tls::new(&files).unwrap();
        let config = |at: Instant| Arc::as_ptr(tls.acceptor(at).config());
        let start = Instant::now();
        let first = config(start);
        let touch = |text: &str, later: u64| {
            std::fs::write(&files.certificate, text).unwrap();
            let file = std::fs::File::open(&files.certificate).unwrap();
            let at = SystemTime::now() + Duration::from_secs(later);
            file.set_modified(at).unwrap();
        };
        touch("no certificate", 60);
        assert_eq!(config(start + LOOK_EVERY), first);
        let other = tempfile::tempdir().unwrap();
        let renewed = written(other.path());
        std::fs::copy(&renewed.key, &files.key).unwrap();
        touch(&std::fs::read_to_string(&renewed.certificate).unwrap(), 120);
        assert_eq!(
            config(start + LOOK_EVERY),
            first,
            "it is not looked at that often"
        );
        assert_ne!(config(start + 2 * LOOK_EVERY), first);
    }

    #[test]
    fn a_pair_is_accepted_and_every_other_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let files = written(folder.path());
        assert!(acceptor(&files).is_ok());
        let refusal = |files: &TlsFiles| acceptor(files).err().unwrap().to_string();
        let swapped = TlsFiles {
            certificate: files.key.clone(),
            key: files.certificate.clone(),
        };
        assert!(
            refusal(&swapped).contains("key.pem"),
            "{}",
            refusal(&swapped)
        );
        let missing = TlsFiles {
            key: folder.path().join("none.pem"),
            ..files.clone()
        };
        assert!(refusal(&missing).contains("none.pem"));
        let other = tempfile::tempdir().unwrap();
        let mixed = TlsFiles {
            key: written(other.path()).key,
            ..files
        };
        assert!(
            refusal(&mixed).contains("cannot be used"),
            "{}",
            refusal(&mixed)
        );
    }
}
