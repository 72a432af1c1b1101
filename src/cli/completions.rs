//! `ridged completions`: the completions of a shell.

use std::io::Write as _;

use clap::CommandFactory as _;
use clap_complete::Shell;

use super::{Cli, CliError};

/// Prints the completions of a shell: commands, options and their values.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  ridged completions bash > ~/.local/share/bash-completion/completions/ridged
  ridged completions zsh > ~/.zfunc/_ridged        (with ~/.zfunc in fpath)
  ridged completions fish > ~/.config/fish/completions/ridged.fish")]
pub struct Args {
    /// The shell.
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Runs the command.
///
/// # Errors
/// No result if stdout cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "ridged", &mut text);
    std::io::stdout()
        .write_all(&text)
        .map_err(CliError::no_result)
}
