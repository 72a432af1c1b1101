//! Switches the lamp on before the first exposure.

use super::{Ending, Runner};

impl Runner<'_> {
    /// Runs the command that switches the lamp on. While it fails, the scan pauses. Orders are obeyed meanwhile.
    pub(super) async fn switch_lamp_on(&mut self) -> Result<(), Ending> {
        let Some(program) = self.run.settings.lamp_on.clone() else {
            return Ok(());
        };
        loop {
            // A command that is cut short is killed and runs again, since what it did so far is unknown.
            match self.orders().during(program.run(b"")).await? {
                Ok(Ok(())) => return self.pause_if_asked().await,
                Ok(Err(error)) => {
                    let why =
                        format!("the lamp could not be switched on: {error}; fix it, then resume");
                    self.hold_with(&why, Some("lamp-failed"), None).await?;
                    self.make_ready().await?;
                }
                Err(cut) => self.cut_short(cut).await?,
            }
        }
    }
}
