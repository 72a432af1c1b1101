//! `ridged man`: the manual pages.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow};
use clap::{Command, CommandFactory as _};
use clap_mangen::Man;

use super::{Cli, CliError, output_path};
use crate::version::VERSION;

/// Prints the manual page of ridged or of a command, or writes all of them into a folder.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  ridged man fit | man -l -
  ridged man --out ~/.local/share/man/man1        all pages: man ridged-fit")]
pub struct Args {
    /// Command, with its subcommand if it has one (for example: rig stop). Default: ridged itself.
    #[arg(value_name = "COMMAND", conflicts_with = "out")]
    pub of: Vec<String>,
    /// Folder for the pages of all commands.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// Bad input for an unknown command or a folder that cannot be written.
pub fn run(args: &Args) -> Result<(), CliError> {
    let mut command = Cli::command();
    command.build();
    if let Some(folder) = &args.out {
        output_path::check_folder(folder)?;
        return write_all(&command, "ridged", folder);
    }
    let mut of = &command;
    let words = args.of.iter().flat_map(|words| words.split_whitespace());
    let words: Vec<String> = words.map(str::to_owned).collect();
    for name in &words {
        of = of.find_subcommand(name).ok_or_else(|| {
            let known: Vec<&str> = of.get_subcommands().map(Command::get_name).collect();
            CliError::bad_input(anyhow!(
                "there is no command `{name}`; expected one of {}",
                known.join(", ")
            ))
        })?;
    }
    let name = page_name(&words);
    let page = page(of, &name).map_err(CliError::no_result)?;
    std::io::stdout()
        .write_all(&page)
        .map_err(CliError::no_result)
}

fn page_name(words: &[String]) -> String {
    let all = std::iter::once("ridged").chain(words.iter().map(String::as_str));
    all.collect::<Vec<_>>().join("-")
}

fn page(command: &Command, name: &str) -> std::io::Result<Vec<u8>> {
    let mut page = Vec::new();
    let named = command
        .clone()
        .display_name(name.to_owned())
        .version(VERSION);
    Man::new(named).render(&mut page)?;
    Ok(page)
}

fn write_all(command: &Command, name: &str, folder: &Path) -> Result<(), CliError> {
    let file = folder.join(format!("{name}.1"));
    page(command, name)
        .and_then(|page| std::fs::write(&file, page))
        .with_context(|| format!("cannot write {}", file.display()))
        .map_err(CliError::no_result)?;
    for below in command.get_subcommands() {
        if below.get_name() != "help" {
            write_all(below, &format!("{name}-{}", below.get_name()), folder)?;
        }
    }
    Ok(())
}
