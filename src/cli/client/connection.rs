//! How a command reaches the daemon and what it presents: address, token and lease.

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::anyhow;

use crate::cli::CliError;

/// How a command reaches the daemon, and what it presents.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ConnectionArgs {
    /// Address of a daemon on another machine, instead of a data folder on this one.
    #[arg(
        long,
        value_name = "https://HOST:PORT",
        global = true,
        conflicts_with = "data"
    )]
    pub url: Option<String>,
    /// PEM file with the certificate to trust at that address [default: those that this machine trusts].
    #[arg(long, value_name = "FILE", global = true)]
    pub trust: Option<PathBuf>,
    /// File with a token, which only its owner can read (mode 600). The daemon's own user needs none on its machine.
    #[arg(long, value_name = "FILE", env = "RIDGED_TOKEN_FILE", global = true)]
    pub token_file: Option<PathBuf>,
    /// Lease of the rig, as `ridged rig lease take` prints it.
    #[arg(
        long,
        value_name = "ID",
        env = "RIDGED_LEASE",
        hide_env_values = true,
        global = true
    )]
    pub lease: Option<String>,
}

impl ConnectionArgs {
    /// Reads the token file, if one is named.
    ///
    /// # Errors
    /// Bad input for a file that cannot be used.
    pub(super) fn token(&self) -> Result<Option<Secrecy>, CliError> {
        self.token_file.as_deref().map(read_token).transpose()
    }

    /// Reads the lease, if one is given.
    ///
    /// # Errors
    /// Bad input for a text that no lease can be.
    pub(super) fn lease(&self) -> Result<Option<Secrecy>, CliError> {
        match self.lease.as_deref() {
            None => Ok(None),
            Some(lease) if !lease.is_empty() && lease.chars().all(|c| c.is_ascii_graphic()) => {
                Ok(Some(Secrecy::from(lease)))
            }
            Some(_) => Err(CliError::bad_input(anyhow!(
                "--lease (RIDGED_LEASE): expected a lease as `ridged rig lease take` prints it"
            ))),
        }
    }
}

/// A text that no message shows.
pub(super) struct Secrecy(String);

impl Secrecy {
    pub(super) fn text(&self) -> &str {
        &self.0
    }
}

impl From<&str> for Secrecy {
    fn from(text: &str) -> Secrecy {
        Secrecy(text.to_owned())
    }
}

impl std::fmt::Debug for Secrecy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("(not shown)")
    }
}

/// Reads a file with a token.
///
/// # Errors
/// Bad input if it cannot be read, if other users can read it, or if it has no token.
fn read_token(file: &Path) -> Result<Secrecy, CliError> {
    let wrong = |why: String| CliError::bad_input(anyhow!("token file {}: {why}", file.display()));
    let mode = std::fs::metadata(file).map_err(|error| wrong(error.to_string()))?;
    let mode = mode.permissions().mode() & 0o777;
    if mode & 0o077 != 0 {
        let why = format!(
            "its mode is {mode:o}, so that others can read it; run `chmod 600 {}`",
            file.display()
        );
        return Err(wrong(why));
    }
    let text = std::fs::read_to_string(file).map_err(|error| wrong(error.to_string()))?;
    let token = text.trim();
    match token.is_empty() || token.chars().any(|c| c.is_whitespace() || c.is_control()) {
        true => Err(wrong(
            "expected one token, as `ridged token create` prints it".into(),
        )),
        false => Ok(Secrecy::from(token)),
    }
}
