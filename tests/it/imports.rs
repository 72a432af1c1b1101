//! The rooms' import rules, executed: who may name whom is a table here and a drawing in
//! `ARCHITECTURE.md`. A new room fails this test until it has a line.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A room and the rooms it may name. `*` means every room.
const RULES: &[(&str, &[&str])] = &[
    ("units", &[]),
    ("material", &[]),
    ("frame", &[]),
    ("clock", &[]),
    ("jackknife", &["units", "geometry"]),
    ("forecast", &[]),
    ("wording", &[]),
    ("geometry", &["units"]),
    ("observation", &["units", "geometry", "material"]),
    ("model", &["units", "geometry", "material"]),
    (
        "trace",
        &["units", "geometry", "material", "model", "wording"],
    ),
    ("heights", &["trace"]),
    (
        "fit",
        &[
            "units",
            "geometry",
            "jackknife",
            "material",
            "observation",
            "model",
            "trace",
            "wording",
        ],
    ),
    (
        "series",
        &["units", "geometry", "material", "frame", "wording"],
    ),
    (
        "reduction",
        &[
            "units",
            "geometry",
            "material",
            "observation",
            "frame",
            "series",
            "wording",
        ],
    ),
    (
        "analysis",
        &[
            "units",
            "frame",
            "geometry",
            "material",
            "observation",
            "model",
            "trace",
            "fit",
            "series",
            "reduction",
            "plan",
            "wording",
        ],
    ),
    (
        "judge",
        &[
            "units",
            "geometry",
            "observation",
            "model",
            "contrast",
            "fit",
        ],
    ),
    ("contrast", &["units", "geometry", "observation", "model"]),
    (
        "map",
        &[
            "units",
            "geometry",
            "jackknife",
            "material",
            "observation",
            "model",
            "frame",
            "series",
            "reduction",
            "plan",
        ],
    ),
    (
        "check",
        &[
            "units",
            "frame",
            "geometry",
            "material",
            "observation",
            "model",
            "trace",
            "fit",
            "series",
            "reduction",
            "map",
        ],
    ),
    (
        "plan",
        &[
            "units", "frame", "geometry", "material", "model", "trace", "series",
        ],
    ),
    (
        "accuracy",
        &[
            "units",
            "frame",
            "geometry",
            "material",
            "observation",
            "model",
            "trace",
            "fit",
            "series",
            "reduction",
            "plan",
            "map",
            "analysis",
            "forecast",
        ],
    ),
    ("bench", &["units", "geometry", "frame", "clock"]),
    (
        "scan",
        &[
            "units", "geometry", "frame", "clock", "series", "bench", "forecast",
        ],
    ),
    (
        "sim",
        &[
            "units", "geometry", "material", "model", "frame", "clock", "series", "bench",
        ],
    ),
    (
        "store",
        &[
            "units",
            "geometry",
            "material",
            "observation",
            "frame",
            "clock",
            "series",
            "reduction",
            "fit",
            "scan",
        ],
    ),
    (
        "lab",
        &[
            "units",
            "geometry",
            "material",
            "observation",
            "frame",
            "clock",
            "series",
            "reduction",
            "analysis",
            "model",
            "fit",
            "bench",
            "scan",
            "store",
            "contrast",
            "judge",
            "map",
            "trace",
            "config",
            "forecast",
            "accuracy",
            "heights",
            "wording",
        ],
    ),
    (
        "api",
        &[
            "units",
            "geometry",
            "material",
            "observation",
            "frame",
            "clock",
            "series",
            "reduction",
            "analysis",
            "model",
            "fit",
            "scan",
            "store",
            "judge",
            "lab",
            "wording",
        ],
    ),
    (
        "config",
        &["units", "geometry", "material", "series", "bench", "scan"],
    ),
    ("cli", &["*"]),
];

/// Rooms that are pure: no I/O, no clock, no log, no runtime.
const PURE: &[&str] = &[
    "units",
    "geometry",
    "material",
    "observation",
    "model",
    "trace",
    "fit",
    "plan",
];

/// What a pure room may not name.
const IMPURE: &[&str] = &[
    "tokio",
    "axum",
    "sqlx",
    "serialport",
    "tracing",
    "std::fs",
    "std::net",
    "std::thread::sleep",
    "SystemTime",
    "Instant",
];

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).expect("src is readable") {
        let path = entry.expect("src is readable").path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files
}

/// The file's code without comments and without its test module, which may name anything.
fn code_of(path: &Path) -> String {
    let text = std::fs::read_to_string(path).expect("a source file is UTF-8");
    let production = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    production
        .lines()
        .map(|line| line.split("//").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join("\n")
}

/// First path segments after each `crate::`, groups (`crate::{a, b}`) included.
fn rooms_named(code: &str) -> BTreeSet<String> {
    let mut rooms = BTreeSet::new();
    for (at, _) in code.match_indices("crate::") {
        if at > 0 && matches!(code.as_bytes()[at - 1], b'$' | b'_' | b'a'..=b'z') {
            continue;
        }
        let rest = &code[at + "crate::".len()..];
        if let Some(group) = rest.strip_prefix('{') {
            let mut depth = 0;
            let mut segment = String::new();
            let mut fresh = true;
            for c in group.chars() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => fresh = true,
                    c if fresh && depth == 0 && (c.is_alphanumeric() || c == '_') => {
                        segment.push(c);
                        continue;
                    }
                    _ => {}
                }
                if !segment.is_empty() {
                    rooms.insert(std::mem::take(&mut segment));
                    fresh = c == ',';
                }
            }
            if !segment.is_empty() {
                rooms.insert(segment);
            }
        } else {
            rooms.insert(
                rest.chars()
                    .take_while(|c| c.is_alphanumeric() || *c == '_')
                    .collect(),
            );
        }
    }
    rooms
}

fn room_of(path: &Path, src: &Path) -> String {
    let first = path
        .strip_prefix(src)
        .expect("the file lies in src")
        .components()
        .next()
        .expect("a file has a name");
    let first = Path::new(first.as_os_str());
    first
        .file_stem()
        .expect("a file has a stem")
        .to_string_lossy()
        .into_owned()
}

#[test]
fn rooms_name_only_whom_they_may() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let rules: BTreeMap<&str, &[&str]> = RULES.iter().copied().collect();
    let mut broken = Vec::new();
    for path in rust_files(&src) {
        let room = room_of(&path, &src);
        // `extremes` is for the tests of all rooms.
        if ["main", "lib", "extremes"].contains(&room.as_str()) {
            continue;
        }
        let Some(allowed) = rules.get(room.as_str()) else {
            broken.push(format!("room `{room}` has no rule in tests/it/imports.rs"));
            continue;
        };
        let code = code_of(&path);
        for named in rooms_named(&code) {
            let fine = named == room || allowed.contains(&"*") || allowed.contains(&named.as_str());
            if !fine && rules.contains_key(named.as_str()) {
                broken.push(format!(
                    "{} names `{named}`, which `{room}` may not",
                    path.display()
                ));
            }
        }
        if PURE.contains(&room.as_str()) {
            for word in IMPURE {
                let used = code.match_indices(word).any(|(at, _)| {
                    let before = code[..at].chars().next_back();
                    let after = code[at + word.len()..].chars().next();
                    let part_of_word =
                        |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
                    !part_of_word(before) && !part_of_word(after)
                });
                if used {
                    broken.push(format!(
                        "{} names `{word}`; `{room}` is pure",
                        path.display()
                    ));
                }
            }
        }
    }
    broken.sort();
    broken.dedup();
    assert!(
        broken.is_empty(),
        "import rules broken:\n{}",
        broken.join("\n")
    );
}

#[test]
fn the_reader_of_imports_sees_groups_and_paths() {
    let code = "use crate::units::Angle;\nuse crate::{geometry::{Pose, RigGeometry}, fit};\nlet x = crate::model::radiance(1);";
    let found: Vec<String> = rooms_named(code).into_iter().collect();
    assert_eq!(found, ["fit", "geometry", "model", "units"]);
}
