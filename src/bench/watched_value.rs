//! A value that an external program prints: a door, a thermometer, a vibration sensor. It has limits, within which the rig may
//! measure.

use serde::{Deserialize, Serialize};

use crate::program::{Program, ProgramError};

/// Longest output that is read, bytes.
const OUTPUT_BYTES_MAX: u64 = 4096;

/// A program that prints one number, and the range in which the rig may measure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WatchedValue {
    /// What the value is, for messages.
    pub name: String,
    /// Program and arguments, started without a shell.
    pub command: Vec<String>,
    /// Smallest value at which the rig may measure.
    #[serde(default)]
    pub min: Option<f64>,
    /// Largest value at which the rig may measure.
    #[serde(default)]
    pub max: Option<f64>,
    /// How far inside the limits the value has to be before a suspended scan resumes.
    #[serde(default)]
    pub hysteresis: f64,
    /// Time limit of the program, s.
    #[serde(default = "default_timeout_s")]
    pub timeout_s: f64,
}

fn default_timeout_s() -> f64 {
    5.0
}

impl WatchedValue {
    /// Returns the first invalid key and what is allowed.
    #[must_use]
    pub fn invalid(&self) -> Option<(&'static str, &'static str)> {
        let finite = |x: Option<f64>| x.is_none_or(f64::is_finite);
        if self.name.trim().is_empty() {
            return Some(("name", "a name for messages"));
        }
        if self.command.first().is_none_or(|p| p.trim().is_empty()) {
            return Some(("command", "a program and its arguments"));
        }
        if !(finite(self.min) && finite(self.max)) || (self.min.is_none() && self.max.is_none()) {
            return Some(("min", "min, max or both, as finite numbers"));
        }
        if !(self.hysteresis.is_finite() && self.hysteresis >= 0.0) {
            return Some(("hysteresis", "a number from 0"));
        }
        if !(0.1..=60.0).contains(&self.timeout_s) {
            return Some(("timeout_s", "0.1 to 60 s"));
        }
        None
    }

    /// Runs the program; returns why the rig must not measure. A program that fails counts as a reason. `is_back`: the value
    /// has to be inside its limits by the hysteresis.
    pub async fn problem(&self, is_back: bool) -> Option<String> {
        let name = &self.name;
        let value = match self.read().await {
            Ok(value) => value,
            Err(why) => return Some(format!("{name} cannot be read: {why}")),
        };
        let inside = if is_back { self.hysteresis } else { 0.0 };
        if let Some(min) = self.min.filter(|min| value < min + inside) {
            return Some(format!("{name} is {value}, below {min}"));
        }
        if let Some(max) = self.max.filter(|max| value > max - inside) {
            return Some(format!("{name} is {value}, above {max}"));
        }
        None
    }

    async fn read(&self) -> Result<f64, String> {
        let program = Program::of(&self.command, self.timeout_s).ok_or("no program")?;
        let text = program.output(OUTPUT_BYTES_MAX).await;
        let text = text.map_err(|error| match error {
            ProgramError::NotStarted { name, source } => format!("`{name}`: {source}"),
            ProgramError::Failed { name, status, .. } => format!("`{name}` ended with {status}"),
            ProgramError::TimedOut { name, .. } => {
                format!("`{name}` did not end within {} s", self.timeout_s)
            }
        })?;
        let value = String::from_utf8_lossy(&text).trim().parse::<f64>().ok();
        value
            .filter(|value| value.is_finite())
            .ok_or_else(|| format!("`{}` did not print a number", self.command[0]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(command: &[&str]) -> WatchedValue {
        WatchedValue {
            name: "humidity".into(),
            command: command.iter().map(|word| (*word).to_owned()).collect(),
            min: None,
            max: Some(60.0),
            hysteresis: 5.0,
            timeout_s: 5.0,
        }
    }

    #[tokio::test]
    async fn a_value_outside_its_limits_and_a_program_that_fails_are_reasons() {
        let problem = async |command: &[&str], is_back: bool| value(command).problem(is_back).await;
        assert_eq!(problem(&["echo", "57"], false).await, None);
        // On the way back the value has to be inside by the hysteresis.
        let why = problem(&["echo", "57"], true).await.unwrap();
        assert!(why.contains("humidity is 57, above 60"), "{why}");
        assert_eq!(problem(&["echo", "54.5"], true).await, None);
        for command in [&["echo", "wet"][..], &["false"], &["/no/such/program"]] {
            let why = problem(command, false).await.unwrap();
            assert!(why.starts_with("humidity cannot be read"), "{why}");
        }
    }
}
