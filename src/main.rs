//! The command-line program: starts the log, parses the command line and runs one subcommand.

use std::process::ExitCode;

use ridged::{cli, logging};

fn main() -> ExitCode {
    let _log = logging::start(cli::progress::AboveBars);
    cli::run(cli::parse())
}
