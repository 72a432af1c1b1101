//! The commands in groups, as `ridged --help` lists them.

use clap::Command;

use crate::wording::layout::wrapped;

/// Width of the help, which terminals of the usual width show without wrapping it.
const COLUMNS: usize = 80;

/// Each group with its commands, in the order of the help.
const GROUPS: [(&str, &[&str]); 6] = [
    (
        "Measure",
        &[
            "demo",
            "serve",
            "scan",
            "queue",
            "rig",
            "doctor",
            "sample",
            "recipe",
            "specification",
            "token",
            "simulate-rig",
        ],
    ),
    (
        "Analyse",
        &[
            "fit",
            "map",
            "contrast",
            "judge",
            "chart",
            "compare",
            "repeatability",
            "report",
            "score",
        ],
    ),
    ("Data", &["results", "import", "export"]),
    (
        "Predict",
        &[
            "explain",
            "trace",
            "optimize",
            "render",
            "wear",
            "model-error",
            "eval",
        ],
    ),
    ("Check the program", &["check", "accuracy"]),
    ("Set up the shell", &["completions", "man"]),
];

/// The template of the help: the groups replace clap's one list.
const TEMPLATE: &str =
    "{about-with-newline}\n{usage-heading} {usage}\n{before-help}Options:\n{options}{after-help}";

/// Replaces the list of commands in the help of the whole program by groups.
pub(super) fn grouped(command: Command) -> Command {
    let text = text(&command);
    let text = text.trim_end().to_owned();
    command.help_template(TEMPLATE).before_help(text)
}

fn text(command: &Command) -> String {
    let names = command.get_subcommands().map(|c| c.get_name().len());
    let width = names.max().unwrap_or(0);
    let mut text = String::new();
    for (group, names) in GROUPS {
        text.push_str(&format!("\n{group}:\n"));
        for name in names {
            let known = command.find_subcommand(name);
            let about = known.and_then(Command::get_about);
            let about = about.map(ToString::to_string).unwrap_or_default();
            let indent = format!("\n{}", " ".repeat(width + 4));
            let about = wrapped(&about, COLUMNS - width - 4).replace('\n', &indent);
            text.push_str(&format!("  {name:<width$}  {about}\n"));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::CommandFactory as _;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn every_command_is_in_one_group() {
        let command = Cli::command();
        let known: BTreeSet<&str> = command.get_subcommands().map(Command::get_name).collect();
        let listed: Vec<&str> = GROUPS
            .iter()
            .flat_map(|(_, names)| names.iter().copied())
            .collect();
        assert_eq!(listed.len(), known.len());
        assert_eq!(listed.into_iter().collect::<BTreeSet<_>>(), known);
    }

    #[test]
    fn the_help_lists_the_groups_and_what_the_commands_do() {
        let help = grouped(Cli::command()).render_help().to_string();
        for words in ["\nAnalyse:\n", "Options:", "--version", "Examples:"] {
            assert!(help.contains(words), "{words}: {help}");
        }
        let longest = help.lines().map(|line| line.chars().count()).max();
        assert!(longest <= Some(COLUMNS), "{help}");
        assert_eq!(help.matches("\n  fit ").count(), 1, "{help}");
    }
}
