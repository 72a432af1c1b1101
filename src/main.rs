//! The command-line program: parses the command line, sets up logging and runs one subcommand.

use std::io::IsTerminal;
use std::process::ExitCode;

use ridged::cli;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_env("RIDGED_LOG")
        .unwrap_or_else(|_| EnvFilter::new("warn,ridged=info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(|| cli::progress::AboveBars)
        .with_ansi(std::io::stderr().is_terminal())
        // A message about it would go to the same stderr that cannot be written, and panic.
        .log_internal_errors(false)
        .init();
    cli::run(cli::parse())
}
