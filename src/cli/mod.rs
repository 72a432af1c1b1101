//! The command line: one file or folder per subcommand, with its options and its output.
//!
//! JSON goes to stdout; progress, logs and errors go to stderr. Exit codes: 0 done, 1 no
//! result, 2 bad usage or bad input, 130 after Ctrl-C once things are safe, 141 (without a message) where the reader of stdout
//! has closed it.

pub mod accuracy;
pub mod chart;
pub mod check;
pub mod client;
pub mod compare;
pub mod completions;
pub mod constraint_args;
pub mod contrast;
pub mod definitions;
pub mod demo;
pub mod doctor;
mod due;
pub mod eval;
pub mod explain;
pub mod export;
pub mod fit;
mod groups;
pub mod import;
pub mod interrupt;
pub mod judge;
mod kept_part;
mod limits;
pub mod man;
pub mod map;
pub mod model_error;
mod nearby;
pub mod operator_prompt;
pub mod optimize;
mod output;
mod output_collision;
mod output_path;
pub mod prediction;
pub mod progress;
pub mod queue;
pub mod render;
pub mod repeatability;
pub mod report;
pub mod result_filters;
pub mod results;
pub mod rig;
pub mod runtime;
pub mod sample;
pub mod scan;
pub mod score;
pub mod serve;
mod shards;
pub mod simulate_rig;
pub mod simulated;
mod supervision;
mod terminal;
pub mod token;

pub mod trace;
mod values;
pub mod wear;

use std::io::{ErrorKind, IsTerminal as _, Write as _};
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::version::VERSION;
use crate::wording::layout::wrapped;
use crate::wording::numbers::readable;

/// Measures the ridge angle of micro-structured surfaces with its uncertainty.
#[derive(Debug, Parser)]
#[command(name = "ridged", version = VERSION, max_term_width = 100)]
#[command(after_help = "Examples:\n  \
    ridged demo             a simulated scan, its fit, then the page until Ctrl-C\n  \
    ridged fit my-series    the ridge angle of a recorded series\n  \
    ridged COMMAND --help   options and examples")]
pub struct Cli {
    /// The subcommand.
    #[command(subcommand)]
    pub command: Command,
}

/// One variant per subcommand; its arguments live in the subcommand's own file.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Scan a part on a simulated rig and show the fit beside the truth, then the page.
    Demo(demo::Args),
    /// Run the daemon: rig, store, HTTP interface, page.
    Serve(serve::Args),
    /// Show, home or stop the rig of a running daemon.
    Rig(rig::Args),
    /// Check rig, camera, disk, clock, database and frames, and say what to do.
    Doctor(doctor::Args),
    /// Make, list and revoke tokens for callers on other machines.
    Token(token::Args),
    /// Run a scan.
    Scan(scan::Args),
    /// List or rename parts, or assign a scan to another one.
    Sample(sample::Args),
    /// List, show, save and archive recipes: how parts are measured.
    Recipe(definitions::RecipeArgs),
    /// List, show, save and archive specifications: limits of parts.
    Specification(definitions::SpecificationArgs),
    /// Add, move and remove parts in the queue, start and stop it.
    Queue(queue::Args),
    /// List results: one row per scan, with filters; as a table, JSON or CSV.
    Results(results::Args),
    /// Chart a parameter over scans: mean ± 3 s, signals, limits, and what is due.
    Chart(chart::Args),
    /// Compare two scans: differences with U, and E_n.
    Compare(compare::Args),
    /// Compare the scatter of scans with their stated uncertainty; gauge R&R.
    Repeatability(repeatability::Args),
    /// Import a recorded series into the store.
    Import(import::Args),
    /// Export a scan from the store as a recorded series.
    Export(export::Args),
    /// Measure the contrast after rotation in a series, or predict it for a rig.
    Contrast(contrast::Args),
    /// Evaluate closed forms over a table of cases.
    Eval(eval::Args),
    /// Fit ridge angle, roughness and reflectance to a recorded series.
    Fit(fit::Args),
    /// Fit series of known truth and compare: value, uncertainty, difference.
    Score(score::Args),
    /// Fit ridge angle and roughness to every pixel of a recorded series.
    Map(map::Args),
    /// Judge a series against a specification: pass, fail or cannot tell.
    Judge(judge::Args),
    /// Write the report on a scan or a series: HTML to print, and JSON.
    Report(report::Args),
    /// Compare the closed forms with the ray tracer: the error at each pose.
    ModelError(model_error::Args),
    /// Find the micro-structure of greatest contrast on a rig.
    Optimize(optimize::Args),
    /// Draw a board of patches before and after a turn.
    Render(render::Args),
    /// Run only the simulated controller, on a pseudo-terminal or a TCP port.
    SimulateRig(simulate_rig::Args),
    /// Explain what would be computed, what is left out, and the possible error.
    Explain(explain::Args),
    /// Measure the error of every method against its run time.
    Accuracy(accuracy::Args),
    /// Run stiff and extreme test cases and compare with the expected results.
    Check(check::Args),
    /// Trace polarised light through single or layered micro-surfaces.
    Trace(trace::Args),
    /// Trace the contrast of worn ridges over the ridge angle.
    Wear(wear::Args),
    /// Print the completions of a shell.
    Completions(completions::Args),
    /// Print the manual pages, or write them into a folder.
    Man(man::Args),
}

/// Why a command ended without its result.
#[derive(Debug)]
pub enum CliError {
    /// The input or its use is wrong: exit 2.
    BadInput(anyhow::Error),
    /// The machine, the rig or the data gave no result: exit 1.
    NoResult(anyhow::Error),
    /// The user stopped it and everything is safe: exit 130.
    Interrupted,
    /// The result is printed, and is this exit code.
    Verdict(u8),
}

impl CliError {
    /// Wraps an error about the user's input.
    pub fn bad_input(error: impl Into<anyhow::Error>) -> Self {
        CliError::BadInput(error.into())
    }

    /// Wraps an error about everything else.
    pub fn no_result(error: impl Into<anyhow::Error>) -> Self {
        CliError::NoResult(error.into())
    }
}

/// Parses the command line. Help, and errors of the command line, end the program.
#[must_use]
pub fn parse() -> Cli {
    let command = groups::grouped(with_negative_numbers(Cli::command()));
    let matches = command.try_get_matches_from(values::words(std::env::args_os()));
    let parsed = matches.and_then(|matches| Cli::from_arg_matches(&matches));
    parsed.unwrap_or_else(|error| {
        if !error.use_stderr() {
            error.exit();
        }
        let message = values::message(&error, std::io::stderr().is_terminal());
        let _ = write!(std::io::stderr(), "{message}");
        std::process::exit(error.exit_code())
    })
}

/// Takes a negative number as a value, so that it is refused by its range and not as an unknown option.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    command
        .mut_args(|arg| {
            let takes_one = arg.get_action().takes_values() && !arg.is_positional();
            if takes_one {
                arg.allow_negative_numbers(true)
            } else {
                arg
            }
        })
        .mut_subcommands(with_negative_numbers)
}

impl Cli {
    /// Whether the command is the daemon, whose log is its record.
    #[must_use]
    pub fn serves(&self) -> bool {
        matches!(self.command, Command::Serve(_))
    }
}

/// Runs one command to its exit code; errors are printed with their causes.
#[must_use]
pub fn run(cli: Cli) -> ExitCode {
    let outcome: Result<(), CliError> = match cli.command {
        Command::Demo(args) => demo::run(args),
        Command::Serve(args) => serve::run(args),
        Command::Rig(args) => rig::run(args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Token(args) => token::run(args),
        Command::Scan(args) => scan::run(args),
        Command::Sample(args) => sample::run(args),
        Command::Recipe(args) => definitions::recipes(args),
        Command::Specification(args) => definitions::specifications(args),
        Command::Queue(args) => queue::run(args),
        Command::Results(args) => results::run(args),
        Command::Chart(args) => chart::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Repeatability(args) => repeatability::run(args),
        Command::Import(args) => import::run(args),
        Command::Export(args) => export::run(args),
        Command::Contrast(args) => contrast::run(args),
        Command::Eval(args) => eval::run(args),
        Command::Fit(args) => fit::run(args),
        Command::Score(args) => score::run(&args),
        Command::Judge(args) => judge::run(args),
        Command::Report(args) => report::run(args),
        Command::Map(args) => map::run(args),
        Command::Optimize(args) => optimize::run(args),
        Command::Render(args) => render::run(args),
        Command::SimulateRig(args) => simulate_rig::run(args),
        Command::Explain(args) => explain::run(args),
        Command::Accuracy(args) => accuracy::run(args),
        Command::Check(args) => check::run(args),
        Command::Trace(args) => trace::run(args),
        Command::ModelError(args) => model_error::run(args),
        Command::Wear(args) => wear::run(args),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(CliError::BadInput(error)) => {
            say(&format!("error: {}", once(&error)));
            ExitCode::from(2)
        }
        Err(CliError::NoResult(error)) if is_closed_pipe(&error) => ExitCode::from(CLOSED_PIPE),
        Err(CliError::NoResult(error)) => {
            say(&format!("error: {}", once(&error)));
            ExitCode::from(1)
        }
        Err(CliError::Verdict(code)) => ExitCode::from(code),
        Err(CliError::Interrupted) => {
            say("stopped by Ctrl-C; everything is safe");
            ExitCode::from(130)
        }
    }
}

/// Exit code where the reader of stdout has closed it: that of a program that SIGPIPE ends, as a shell shows it.
const CLOSED_PIPE: u8 = 128 + 13;

/// Returns whether a command could not print because the reader of stdout has read enough (`| head`), which is no error. The
/// error of anything else that is written has the name of its file.
fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let written = error.downcast_ref::<std::io::Error>();
    error.chain().count() == 1 && written.is_some_and(|e| e.kind() == ErrorKind::BrokenPipe)
}

/// Prints a line on stderr. Where it cannot be written (a closed terminal, a full disk), the work continues and the exit
/// code still shows how it ended.
fn say(line: &(impl std::fmt::Display + ?Sized)) {
    let line = line.to_string();
    let line = match terminal::columns_of_stderr() {
        Some(columns) => wrapped(&line, columns),
        None => line,
    };
    let _ = writeln!(progress::AboveBars, "{line}");
}

/// Returns an error with its causes, without causes that the error already contains.
fn once(error: &anyhow::Error) -> String {
    let mut said = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        if said.is_empty() {
            said = cause;
        } else if !said.contains(&cause) {
            said = format!("{said}: {cause}");
        }
    }
    readable(&said)
}

/// Parses arguments, for tests of the subcommands.
#[cfg(test)]
fn parsed<A: clap::Args>(words: &[&str]) -> A {
    try_parsed(words).unwrap_or_else(|error| panic!("{error}"))
}

/// Parses arguments, or returns the error.
#[cfg(test)]
fn try_parsed<A: clap::Args>(words: &[&str]) -> Result<A, clap::Error> {
    #[derive(Parser)]
    struct Line<A: clap::Args> {
        #[command(flatten)]
        args: A,
    }
    Line::try_parse_from(["ridged"].iter().chain(words)).map(|line| line.args)
}

#[cfg(test)]
mod tests {
    use anyhow::{Context as _, anyhow};

    use super::{Cli, CliError, is_closed_pipe, once};
    use crate::series::SeriesError;

    use clap::CommandFactory as _;

    #[test]
    fn every_command_has_an_example() {
        fn look(command: &clap::Command, path: &str) {
            let help = command.get_after_help().map(ToString::to_string);
            assert!(
                help.is_some_and(|h| h.contains("Example")),
                "{path} has none"
            );
            for below in command.get_subcommands() {
                look(below, &format!("{path} {}", below.get_name()));
            }
        }
        look(&Cli::command(), "ridged");
    }

    #[test]
    fn only_a_closed_stdout_is_a_quiet_end() {
        let is_quiet = |error| match error {
            CliError::NoResult(error) => is_closed_pipe(&error),
            other => panic!("{other:?}"),
        };
        let closed = || std::io::Error::from(std::io::ErrorKind::BrokenPipe);
        assert!(is_quiet(CliError::no_result(closed())));
        let full = std::io::Error::from(std::io::ErrorKind::StorageFull);
        assert!(!is_quiet(CliError::no_result(full)));
        let of_file = Err::<(), _>(closed()).context("cannot write fit.json");
        assert!(!is_quiet(CliError::NoResult(
            of_file.expect_err("it is one")
        )));
    }

    #[test]
    fn a_cause_that_the_error_contains_is_not_repeated() {
        let twice = SeriesError::Unreadable {
            file: "manifest.toml".into(),
            source: std::io::Error::other("it is a folder"),
        };
        let said = once(&twice.into());
        assert_eq!(said.matches("it is a folder").count(), 1, "{said}");
        let chain = Err::<(), _>(anyhow!("the disk is full")).context("cannot write");
        let said = once(&chain.expect_err("it is one"));
        assert_eq!(said, "cannot write: the disk is full");
    }
}
