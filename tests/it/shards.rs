//! Shards on the command line: for each command that has them, the merged files are those of one run, byte for byte.

use std::path::Path;

use serde_json::Value;

use crate::commands::{refuses, ridged};

/// Runs a command that succeeds, and returns its JSON.
fn json(folder: &Path, args: &[&str]) -> Value {
    let output = ridged(folder, args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{args:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Names and contents of the files of a folder, by name, without the summary of a map.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut files: Vec<(String, Vec<u8>)> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap() != "summary.json")
        .map(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            (name, std::fs::read(&path).unwrap())
        })
        .collect();
    files.sort();
    files
}

/// An object without what depends on the clock.
fn timeless(mut object: Value) -> Value {
    for key in ["seconds", "timing_s", "pixels_per_s"] {
        object.as_object_mut().unwrap().remove(key);
    }
    object
}

/// Runs `command` as a whole and in shards, and compares the files and what is printed.
fn equal_to_one_run(command: &[&str], of: usize, count: usize) {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let whole = json(at, &[command, &["--json", "--out", "whole"]].concat());
    let mut parts: Vec<String> = Vec::new();
    // The last shard first: the order of the files does not count.
    for number in (1..=of).rev() {
        let (shard, file) = (format!("{number}/{of}"), format!("parts/{number}"));
        let rest: &[&str] = &["--json", "--shard", &shard, "--out", &file];
        let written = json(at, &[command, rest].concat());
        assert_eq!(
            (&written["shard"], &written["of"]),
            (&number.into(), &of.into())
        );
        parts.push(file);
    }
    let mut merge = vec![command[0], "merge", "--json", "--out", "merged"];
    merge.extend(parts.iter().map(String::as_str));
    let merged = json(at, &merge);
    assert_eq!(timeless(merged), timeless(whole));
    assert_eq!(files(&at.join("merged")), files(&at.join("whole")));
    assert_eq!(files(&at.join("merged")).len(), count);
    // A shard that ran twice replaces its file; one that is missing is named.
    assert_eq!(files(&at.join("parts")).len(), of);
    let fewer = &merge[..merge.len() - 1];
    refuses(at, fewer, 2, &[&format!("of {of} shards"), ": 1"]);
}

#[test]
fn the_shards_of_a_sweep_of_wear_give_the_files_of_one_run() {
    let words = "wear --rounds 0 0.1 --burrs 0.2 --theta-c-deg 0 --theta-r-min-deg 8 --theta-r-max-deg 10 --theta-r-step-deg 1 \
                 --paths 64";
    equal_to_one_run(&words.split_whitespace().collect::<Vec<_>>(), 4, 2);
}

#[test]
fn the_shards_of_a_study_of_the_model_error_give_the_files_of_one_run() {
    let words = "model-error --theta-r-deg 10 --alpha 0.2 --paths 64";
    equal_to_one_run(&words.split_whitespace().collect::<Vec<_>>(), 2, 3);
}

#[test]
fn the_shards_of_a_map_give_the_files_of_one_run() {
    let series = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/data/series/paper-rig-full"
    );
    equal_to_one_run(&["map", series], 2, 25);
}

#[test]
fn shards_that_cannot_be_computed_or_merged_are_refused_with_the_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let small = "wear --rounds 0 --burrs --theta-c-deg 0 --theta-r-min-deg 9 --theta-r-max-deg 10 --theta-r-step-deg 1 --paths 64";
    let with = |rest: &[&str]| -> Vec<String> {
        let words = small.split_whitespace().chain(rest.iter().copied());
        words.map(str::to_owned).collect()
    };
    let refused = |rest: &[&str], words: &[&str]| {
        let all = with(rest);
        refuses(
            at,
            &all.iter().map(String::as_str).collect::<Vec<_>>(),
            2,
            words,
        );
    };
    refused(
        &["--shard", "1/3", "--out", "a"],
        &["2 surfaces", "at most 2 shards"],
    );
    refused(&["--shard", "1/2"], &["--out FILE"]);
    refused(&["--shard", "3/2", "--out", "a"], &["K/N", "2/4"]);
    refused(
        &["--shard", "1/2", "--out", "a", "--max-seconds", "9"],
        &["--max-seconds"],
    );
    assert!(!at.join("a").exists(), "a refused shard leaves no file");
    for (name, seed) in [("a", "1"), ("b", "2")] {
        let shard = format!("{seed}/2");
        let rest = ["--shard", &shard, "--out", name, "--seed", seed, "--json"];
        json(
            at,
            &with(&rest).iter().map(String::as_str).collect::<Vec<_>>(),
        );
    }
    let merge = ["wear", "merge", "a", "b", "--out", "merged"];
    refuses(at, &merge, 2, &["b: ", "--seed is 2, there 1"]);
    refuses(
        at,
        &["map", "merge", "a", "--out", "m"],
        2,
        &["ridged wear merge"],
    );
    assert!(
        !at.join("merged").exists(),
        "a refused merge leaves no files"
    );
}

#[test]
fn a_merge_of_fits_is_a_table_with_a_row_for_each() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let series = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/data/series/paper-rig-full"
    );
    let report = ridged(at, &["fit", series, "--variant", "paper", "--json"]).stdout;
    for name in ["00001-first.json", "00002-second.json"] {
        std::fs::write(at.join(name), &report).unwrap();
    }
    let both = ["00001-first.json", "00002-second.json"];
    let merge = [&["fit", "merge", "--out", "fits.csv", "--json"], &both[..]].concat();
    assert_eq!(json(at, &merge)["fits"], 2);
    let mut table = csv::Reader::from_path(at.join("fits.csv")).unwrap();
    let head = table.headers().unwrap().clone();
    let column = |name: &str| head.iter().position(|h| h == name).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let angle = &report["parameters"]["theta_r_deg"];
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 2);
    for (row, name) in rows.iter().zip(["00001-first", "00002-second"]) {
        assert_eq!(&row[column("fit")], name);
        assert_eq!(Some(&row[column("status")]), report["status"].as_str());
        for (kind, key) in [("", "value"), ("_std", "std"), ("_expanded", "expanded")] {
            let cell: f64 = row[column(&format!("theta_r_deg{kind}"))].parse().unwrap();
            assert_eq!(Some(cell), angle[key].as_f64());
        }
    }
    refuses(
        at,
        &["fit", "merge", both[0], both[0], "--out", "f.csv"],
        2,
        &["give it once"],
    );
    refuses(
        at,
        &["fit", "merge", "fits.csv", "--out", "f.csv"],
        2,
        &["ridged fit DIR --json"],
    );
    refuses(
        at,
        &["fit", "merge", both[0], "--out", both[0]],
        2,
        &["is an input"],
    );
}
