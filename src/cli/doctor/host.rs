//! The machine: its clock, and the programs that the settings name.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use time::OffsetDateTime;

use super::findings::Findings;
use crate::api::server::{self, CertificateState, TlsFiles};
use crate::config::Config;
use crate::wording::counted;

/// The year in which this program was written: an earlier clock was never set.
const YEAR_MIN: i32 = 2026;
/// Difference of clocks that counts as none.
const CLOCK_SLACK: time::Duration = time::Duration::seconds(60);

/// Checks the wall clock: against the newest event of the store, and whether a time server sets it.
pub async fn check_clock(
    now: OffsetDateTime,
    newest_event: Option<OffsetDateTime>,
    findings: &mut Findings,
) {
    let advice =
        "set the clock (timedatectl set-time, or NTP): it dates frames and ages calibrations";
    match newest_event {
        _ if now.year() < YEAR_MIN => {
            findings.fault("clock", format!("the clock shows {}", now.date()), advice);
        }
        Some(newest) if newest > now + CLOCK_SLACK => findings.fault(
            "clock",
            format!(
                "the newest event in the store is {} ahead of the clock",
                minutes(newest - now)
            ),
            advice,
        ),
        _ => findings.ok("clock", format!("{} UTC", now.date())),
    }
    match is_synchronised().await {
        Some(true) => findings.ok("clock", "a time server sets it"),
        Some(false) => findings.warning(
            "clock",
            "no time server sets it",
            "switch it on (timedatectl set-ntp true): a clock that is set by hand jumps",
        ),
        None => findings.note(
            "clock",
            "timedatectl does not say whether a time server sets it",
        ),
    }
}

fn minutes(ahead: time::Duration) -> String {
    format!("{:.1} min", ahead.as_seconds_f64() / 60.0)
}

async fn is_synchronised() -> Option<bool> {
    let asked = tokio::process::Command::new("timedatectl")
        .args(["show", "--property=NTPSynchronized", "--value"])
        .kill_on_drop(true)
        .output();
    let output = tokio::time::timeout(Duration::from_secs(3), asked).await;
    match output.ok()?.ok()?.stdout.trim_ascii() {
        b"yes" => Some(true),
        b"no" => Some(false),
        _ => None,
    }
}

/// Checks that the programs of the settings can be started: at night, no operator sees that one is missing.
pub fn check_programs(config: &Config, findings: &mut Findings) {
    let lamp = [("lamp.on", &config.lamp.on), ("lamp.off", &config.lamp.off)];
    let camera = [("camera.command", &config.camera.command)];
    let mut named: Vec<(String, &[String])> = lamp
        .into_iter()
        .chain(camera)
        .map(|(key, words)| (key.to_owned(), words.as_slice()))
        .collect();
    let hooks = config.hooks.commands();
    named.extend(hooks.map(|(name, words)| (format!("hooks.{name}"), words)));
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
    for (key, words) in named {
        let Some(name) = words.first() else { continue };
        match find(name, &folders) {
            Some(found) => findings.ok("program", format!("{key}: {}", found.display())),
            None => findings.fault(
                "program",
                format!("{key}: `{name}` is not an executable file"),
                "correct its path, or make it executable (chmod +x)",
            ),
        }
    }
    let reports = [
        &config.hooks.alarm,
        &config.hooks.paused,
        &config.hooks.failed,
    ];
    if reports.iter().all(|hook| hook.is_empty()) {
        findings.note(
            "program",
            "no hook reports a pause, a failure or an alarm: docs/how-to/leaving-the-rig-alone.md has examples",
        );
    }
}

/// Checks that the certificate of the daemon can be used, and for how long: no page and no script reaches a daemon after its end.
pub fn check_certificate(certificate: &Path, key: &Path, findings: &mut Findings) {
    let files = TlsFiles {
        certificate: certificate.into(),
        key: key.into(),
    };
    let file = certificate.display();
    match server::check_certificate(&files) {
        Ok(CertificateState::Valid { until, days_left }) => findings.ok(
            "tls",
            format!("the certificate {file} is valid until {until}, {}", left(days_left)),
        ),
        Ok(CertificateState::ExpiresSoon { until, days_left }) => findings.warning(
            "tls",
            format!("the certificate {file} expires on {until}, {}", left(days_left)),
            "renew it: a running daemon uses the new files within seconds",
        ),
        Ok(CertificateState::NotValid { from, until }) => findings.fault(
            "tls",
            format!("the certificate {file} is valid from {from} to {until}, so clients refuse the connection"),
            "renew it, or set the clock",
        ),
        Ok(CertificateState::Unknown) => findings.note(
            "tls",
            format!("the days of the certificate {file} cannot be read"),
        ),
        Err(error) => findings.error("tls", &error),
    }
}

fn left(days: i64) -> String {
    let days = usize::try_from(days).unwrap_or_default();
    format!("{} left", counted(days, "day"))
}

/// Returns the executable file of a command's first word.
fn find(name: &str, folders: &[PathBuf]) -> Option<PathBuf> {
    let is_executable = |path: &Path| {
        let found = std::fs::metadata(path);
        found.is_ok_and(|file| file.is_file() && file.permissions().mode() & 0o111 != 0)
    };
    if name.contains('/') {
        return is_executable(Path::new(name)).then(|| name.into());
    }
    let candidates = folders.iter().map(|folder| folder.join(name));
    candidates.into_iter().find(|path| is_executable(path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use time::macros::datetime;

    #[tokio::test]
    async fn a_clock_behind_the_store_or_never_set_is_a_fault() {
        for (now, newest, fault) in [
            (datetime!(2027-03-01 12:00 UTC), None, false),
            (
                datetime!(2027-03-01 12:00 UTC),
                Some(datetime!(2027-03-01 11:00 UTC)),
                false,
            ),
            (
                datetime!(2027-03-01 12:00 UTC),
                Some(datetime!(2027-03-01 14:00 UTC)),
                true,
            ),
            (datetime!(1970-01-01 00:00 UTC), None, true),
        ] {
            let mut findings = Findings::default();
            check_clock(now, newest, &mut findings).await;
            assert_eq!(
                findings.worst().exit_code() == 4,
                fault,
                "{}",
                findings.text()
            );
        }
    }

    #[test]
    fn a_certificate_is_checked_with_the_days_that_are_left() {
        let folder = tempfile::tempdir().unwrap();
        let (cert, key) = (
            folder.path().join("cert.pem"),
            folder.path().join("key.pem"),
        );
        let pair = rcgen::KeyPair::generate().unwrap();
        std::fs::write(&key, pair.serialize_pem()).unwrap();
        let now = OffsetDateTime::now_utc();
        let day = time::Duration::days(1);
        for (until, code, words) in [
            (now + 100 * day, 0, " days left"),
            (now + 10 * day + day / 2, 3, "10 days left"),
            (now - day, 4, "clients refuse the connection"),
        ] {
            let mut made = rcgen::CertificateParams::new(["localhost".to_owned()]).unwrap();
            (made.not_before, made.not_after) = (now - 200 * day, until);
            std::fs::write(&cert, made.self_signed(&pair).unwrap().pem()).unwrap();
            let mut findings = Findings::default();
            check_certificate(&cert, &key, &mut findings);
            let text = findings.text();
            assert!(text.contains(words), "{text}");
            assert_eq!(findings.worst().exit_code(), code, "{text}");
        }
        std::fs::write(&cert, "none").unwrap();
        let mut findings = Findings::default();
        check_certificate(&cert, &key, &mut findings);
        assert_eq!(findings.worst().exit_code(), 4);
    }

    #[test]
    fn a_program_that_cannot_be_started_is_named_by_its_key() {
        let mut config = Config::default();
        config.lamp.on = vec!["sh".into(), "-c".into(), "true".into()];
        config.hooks.paused = vec!["/no/such/program".into()];
        let mut findings = Findings::default();
        check_programs(&config, &mut findings);
        let text = findings.text();
        assert!(text.contains("hooks.paused: `/no/such/program`"), "{text}");
        assert!(text.contains("ok  program    lamp.on: "), "{text}");
        assert_eq!(findings.worst().exit_code(), 4);
    }
}
