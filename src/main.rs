//! The command-line program: parses, sets up logging, hands over to one subcommand.

use std::io::IsTerminal;
use std::process::ExitCode;

use ridged::cli;
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_env("RIDGED_LOG")
        .unwrap_or_else(|_| EnvFilter::new("warn,ridged=info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        // It would be told on the very stderr that cannot be written, and that panics.
        .log_internal_errors(false)
        .init();
    cli::run(cli::parse())
}
