//! What a shell gets of the program: version, help, completions, manual pages, lines as wide as the terminal.

use std::path::Path;
use std::process::{Command, Output};

use crate::commands::{refuses, ridged};

fn text(output: &Output) -> String {
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout.clone()).unwrap()
}

#[test]
fn the_version_states_the_commit_or_that_there_is_none() {
    let version = text(&ridged(Path::new("."), &["--version"]));
    assert!(version.starts_with("ridged "), "{version}");
    assert!(
        version.contains("(commit ") || version.contains("(built outside git)"),
        "{version}"
    );
}

#[test]
fn completions_and_manual_pages_cover_the_commands() {
    let here = Path::new(".");
    for shell in ["bash", "zsh", "fish"] {
        let script = text(&ridged(here, &["completions", shell]));
        assert!(
            script.contains("model-error") && script.contains("brief"),
            "{shell}"
        );
    }
    let page = text(&ridged(here, &["man", "rig", "stop"]));
    assert!(page.contains(".TH ridged-rig-stop 1"), "{page}");
    refuses(here, &["man", "rgi"], 2, &["`rgi`", "rig"]);
    let folder = tempfile::tempdir().unwrap();
    text(&ridged(folder.path(), &["man", "--out", "man1"]));
    for name in ["ridged.1", "ridged-fit.1", "ridged-rig-stop.1"] {
        assert!(folder.path().join("man1").join(name).is_file(), "{name}");
    }
}

#[test]
fn text_fits_the_terminal_and_lists_take_commas() {
    let narrow = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ridged"));
        let output = command.args(args).env("COLUMNS", "72").output().unwrap();
        text(&output)
    };
    let table = narrow(&[
        "contrast",
        "--theta-r-deg",
        "5,10",
        "--theta-c-deg",
        "-10,0",
    ]);
    assert!(table.lines().count() > 6, "{table}");
    for line in table.lines() {
        assert!(line.chars().count() <= 72, "{line}");
    }
}

#[test]
fn a_missing_scene_is_refused_with_the_names_beside_it() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let words = ["scenes/glass.toml", "glass-over-gold.toml"];
    refuses(here, &["trace", "scenes/glass.toml"], 2, &words);
}

#[test]
fn a_reader_that_has_closed_stdout_is_no_error() {
    for args in [
        &["man"][..],
        &["completions", "bash"],
        &["contrast", "--theta-r-deg", "5"],
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ridged"));
        let (read, write) = std::io::pipe().unwrap();
        drop(read);
        let output = command.args(args).stdout(write).output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(141), "{args:?}: {message}");
        assert_eq!(message, "", "{args:?}");
    }
}
