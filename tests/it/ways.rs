//! The table of `docs/reference/ways.md`: everything that the page does is a request of the API and a command.

use std::collections::BTreeSet;

use clap::CommandFactory;
use ridged::cli::Cli;
use serde_json::Value;

/// A row: what the page does, requests of the API (`GET /rig`) and commands (`ridged rig status`).
struct Way {
    on_page: String,
    requests: Vec<String>,
    commands: Vec<String>,
}

/// The texts between backticks.
fn quoted(cell: &str) -> Vec<String> {
    let parts = cell.split('`').skip(1).step_by(2);
    parts.map(str::to_owned).collect()
}

fn ways() -> Vec<Way> {
    let document = include_str!("../../docs/reference/ways.md");
    let rows = document.lines().filter(|line| line.starts_with("| "));
    let rows = rows.filter(|line| !line.starts_with("| on the page") && !line.starts_with("| ---"));
    rows.map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split(" | ").collect();
        let [on_page, requests, commands] = cells[..] else {
            panic!("three cells: {row}");
        };
        Way {
            on_page: on_page.trim().to_owned(),
            requests: quoted(requests),
            commands: quoted(commands),
        }
    })
    .collect()
}

/// All operations of the OpenAPI document below `/api/v1`, as `GET /rig`.
fn operations() -> BTreeSet<String> {
    let document: Value = serde_json::from_str(ridged::api::openapi()).unwrap();
    let mut found = BTreeSet::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        if let Some(path) = path.strip_prefix("/api/v1") {
            for method in item.as_object().unwrap().keys() {
                found.insert(format!("{} {path}", method.to_uppercase()));
            }
        }
    }
    found
}

#[test]
fn every_request_is_in_the_table_and_every_request_of_the_table_exists() {
    let listed: BTreeSet<String> = ways().into_iter().flat_map(|way| way.requests).collect();
    let operations = operations();
    let unlisted: Vec<&String> = operations.difference(&listed).collect();
    let unknown: Vec<&String> = listed.difference(&operations).collect();
    assert!(operations.len() > 60);
    assert!(
        unlisted.is_empty(),
        "add these to docs/reference/ways.md: {unlisted:?}"
    );
    assert!(
        unknown.is_empty(),
        "the API has no such requests: {unknown:?}"
    );
}

#[test]
fn every_row_has_a_request_and_a_command_that_exists() {
    let program = Cli::command();
    for way in ways() {
        assert!(!way.requests.is_empty(), "{}: no request", way.on_page);
        assert!(!way.commands.is_empty(), "{}: no command", way.on_page);
        for text in &way.commands {
            let mut words = text.split_whitespace();
            assert_eq!(words.next(), Some("ridged"), "{text}");
            let mut command = &program;
            for word in words {
                if let Some(option) = word.strip_prefix("--") {
                    let known = command
                        .get_arguments()
                        .any(|arg| arg.get_long() == Some(option));
                    assert!(known, "`{text}`: there is no --{option}");
                } else {
                    let known = command.find_subcommand(word);
                    command =
                        known.unwrap_or_else(|| panic!("`{text}`: there is no command {word}"));
                }
            }
        }
    }
}
