//! The command-line program: parses the command line, starts the log and runs one subcommand.

use std::process::ExitCode;

use ridged::{cli, logging};

fn main() -> ExitCode {
    let command = cli::parse();
    let _log = logging::start(cli::progress::AboveBars, command.serves());
    cli::run(command)
}
