//! The settings of the device that a move depends on: applied at the connection, and verified before moves and after a
//! restart.

use super::super::error::StageError;
use super::Axis;

/// Largest difference that rounding in the device explains, in its own unit.
const SLACK: f64 = 1.0;

/// A setting and the value that it must have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ProfileEntry {
    pub name: &'static str,
    pub of_controller: bool,
    pub value: f64,
    /// Read before each move: a wrong value changes how the axis moves.
    pub before_moves: bool,
}

impl Axis {
    async fn read_entry(&self, entry: &ProfileEntry) -> Result<f64, StageError> {
        match entry.of_controller {
            true => self.get_number(entry.name).await,
            false => self.get_finite(entry.name).await,
        }
    }

    async fn write_entry(&self, entry: &ProfileEntry) -> Result<(), StageError> {
        let words = format!("set {} {:.0}", entry.name, entry.value);
        match entry.of_controller {
            true => self.ask_controller(&words).await,
            false => self.ask(&words).await,
        }
        .map(|_| ())
    }

    /// Reads all settings of the profile, and writes those again that differ.
    ///
    /// # Errors
    /// [`StageError::Disagreement`] names a setting that the device does not take.
    pub(super) async fn restore_profile(&self) -> Result<(), StageError> {
        self.check_device().await?;
        let mut restored = Vec::new();
        for entry in &self.profile {
            let found = self.read_entry(entry).await?;
            if differs(entry, found) {
                let disagreement = |found| StageError::Disagreement {
                    axis: self.name,
                    name: entry.name,
                    expected: entry.value,
                    found,
                };
                match self.write_entry(entry).await {
                    Ok(()) => {}
                    Err(StageError::Refused { .. }) => return Err(disagreement(found)),
                    Err(error) => return Err(error),
                }
                let now = self.read_entry(entry).await?;
                if differs(entry, now) {
                    return Err(disagreement(now));
                }
                restored.push(format!(
                    "{} was {found}, set to {}",
                    entry.name, entry.value
                ));
            }
        }
        self.memory().profile_holds = true;
        if !restored.is_empty() {
            let message = format!(
                "the {} controller had lost its settings, and they were written again: {}. If this repeats, check its \
                 power supply and other programs on the port",
                self.name,
                restored.join("; ")
            );
            self.notices.send("stage-settings-restored", message);
        }
        Ok(())
    }

    /// Checks that the controller is the one that was connected: on a chain, one can be replaced while the line stays.
    async fn check_device(&self) -> Result<(), StageError> {
        let found: u32 = self.get_number("system.serial").await?;
        if found == self.identity.serial {
            return Ok(());
        }
        // The next connection checks all controllers and names those that differ.
        self.line.close();
        Err(StageError::Replaced {
            axis: self.name,
            before: self.identity.serial,
            found,
        })
    }

    /// Verifies before a motion that the device did not restart and still has its speeds.
    pub(super) async fn verify_profile(&self) -> Result<(), StageError> {
        self.check_device().await?;
        self.check_uptime().await?;
        let mut holds = self.memory().profile_holds;
        for entry in self.profile.iter().filter(|entry| entry.before_moves) {
            holds = holds && !differs(entry, self.read_entry(entry).await?);
        }
        match holds {
            true => Ok(()),
            false => self.restore_profile().await,
        }
    }
}

fn differs(entry: &ProfileEntry, found: f64) -> bool {
    let slack = if entry.of_controller { 0.0 } else { SLACK };
    let apart = (found - entry.value).abs();
    apart.is_nan() || apart > slack
}
