//! What the doctor found: each check with its severity, and the remedy where there is one.

use serde::Serialize;

use crate::wording::counted;

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// As it should be.
    Ok,
    /// Worth knowing; nothing to do.
    Note,
    /// A scan would run, but may pause or be less certain.
    Warning,
    /// A scan would not run, or data are damaged.
    Fault,
}

impl Severity {
    /// Exit code of a run whose worst finding this is.
    pub fn exit_code(self) -> u8 {
        match self {
            Severity::Ok | Severity::Note => 0,
            Severity::Warning => 3,
            Severity::Fault => 4,
        }
    }

    fn label(self) -> &'static str {
        match self {
            Severity::Ok => "ok",
            Severity::Note => "note",
            Severity::Warning => "WARNING",
            Severity::Fault => "FAULT",
        }
    }
}

/// One checked item.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Stable word for the check.
    pub check: &'static str,
    /// How much it matters.
    pub severity: Severity,
    /// What was found.
    pub found: String,
    /// What to do; `None` where there is nothing to do, or where `found` already says it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}

/// All findings in the order of the checks.
#[derive(Debug, Default, Serialize)]
pub struct Findings {
    findings: Vec<Finding>,
}

impl Findings {
    /// Adds a check that found nothing wrong.
    pub fn ok(&mut self, check: &'static str, found: impl Into<String>) {
        self.add(check, Severity::Ok, found, None);
    }

    /// Adds something worth knowing.
    pub fn note(&mut self, check: &'static str, found: impl Into<String>) {
        self.add(check, Severity::Note, found, None);
    }

    /// Adds a warning and its remedy.
    pub fn warning(&mut self, check: &'static str, found: impl Into<String>, advice: &str) {
        self.add(check, Severity::Warning, found, Some(advice));
    }

    /// Adds a fault and its remedy.
    pub fn fault(&mut self, check: &'static str, found: impl Into<String>, advice: &str) {
        self.add(check, Severity::Fault, found, Some(advice));
    }

    /// Adds a fault whose error states the remedy itself.
    pub fn error(&mut self, check: &'static str, error: &dyn std::fmt::Display) {
        self.add(check, Severity::Fault, error.to_string(), None);
    }

    fn add(
        &mut self,
        check: &'static str,
        severity: Severity,
        found: impl Into<String>,
        advice: Option<&str>,
    ) {
        self.findings.push(Finding {
            check,
            severity,
            found: found.into(),
            advice: advice.map(str::to_owned),
        });
    }

    /// The worst severity.
    #[must_use]
    pub fn worst(&self) -> Severity {
        let all = self.findings.iter().map(|finding| finding.severity);
        all.max().unwrap_or(Severity::Ok)
    }

    /// All of them as text: a line per check, the remedy below it, and the verdict.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::new();
        for finding in &self.findings {
            let label = finding.severity.label();
            text.push_str(&format!(
                "{label:>8}  {:<10} {}\n",
                finding.check, finding.found
            ));
            if let Some(advice) = &finding.advice {
                text.push_str(&format!("{:>20} {advice}\n", "→"));
            }
        }
        let count = |severity| {
            let of_it = self.findings.iter().filter(|f| f.severity == severity);
            of_it.count()
        };
        text.push_str(&match self.worst() {
            Severity::Ok | Severity::Note => "nothing to do\n".to_owned(),
            _ => format!(
                "{}, {}\n",
                counted(count(Severity::Fault), "fault"),
                counted(count(Severity::Warning), "warning")
            ),
        });
        text
    }

    /// All of them as one JSON object.
    #[must_use]
    pub fn json(&self) -> serde_json::Value {
        serde_json::json!({
            "verdict": self.worst(),
            "exit_code": self.worst().exit_code(),
            "findings": self.findings,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_finding_decides_and_every_remedy_is_shown() {
        let mut findings = Findings::default();
        assert_eq!(findings.worst().exit_code(), 0);
        findings.ok("disk", "plenty");
        findings.note("daemon", "none runs");
        assert_eq!(findings.worst().exit_code(), 0);
        assert!(findings.text().ends_with("nothing to do\n"));
        findings.warning("clock", "not synchronised", "switch NTP on");
        assert_eq!(findings.worst().exit_code(), 3);
        findings.fault("port", "it is missing", "plug it in");
        let text = findings.text();
        for part in [
            "FAULT  port",
            "→ plug it in",
            "→ switch NTP on",
            "1 fault, 1 warning",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let json = findings.json();
        assert_eq!(json["verdict"], "fault");
        assert_eq!(json["exit_code"], 4);
        assert_eq!(json["findings"][0]["advice"], serde_json::Value::Null);
    }
}
