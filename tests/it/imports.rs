//! The import rules, executed: which module may name which is the table [`RULES`], drawn in
//! `ARCHITECTURE.md`; a new module fails this test until it has a line. Within a module, files import
//! each other in one direction: [`circles`] says what counts as an import.

mod circles;
pub mod code;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use circles::Source;
use code::Code;

use crate::source_files::files;

/// A module and the modules it may name. `*` means every module.
const RULES: &[(&str, &str)] = &[
    ("units", ""),
    ("access", "words"),
    ("archive", ""),
    ("material", ""),
    ("frame", "words"),
    ("clock", ""),
    ("colour", ""),
    ("deadline", ""),
    ("figures", "colour"),
    ("jackknife", "units geometry"),
    ("forecast", ""),
    ("job", "words"),
    ("limits", ""),
    ("logging", ""),
    ("robust", ""),
    ("shard", ""),
    ("chart", ""),
    ("preview", "frame robust"),
    ("wording", ""),
    ("words", ""),
    ("program", ""),
    ("version", ""),
    ("geometry", "units"),
    ("observation", "units geometry material"),
    ("model", "units geometry material"),
    ("trace", "units geometry material model shard wording"),
    ("heights", "archive trace wording"),
    (
        "fit",
        "deadline units geometry jackknife material observation model robust trace wording",
    ),
    (
        "series",
        "units geometry material archive frame limits wording",
    ),
    (
        "tables",
        "units geometry heights material model observation robust series wording",
    ),
    (
        "reduction",
        "units geometry material observation frame series wording robust",
    ),
    (
        "analysis",
        "units frame geometry material observation model trace fit series reduction plan wording",
    ),
    ("comparison", "fit wording"),
    ("repeatability", "comparison fit wording"),
    (
        "judge",
        "units geometry observation model contrast fit wording",
    ),
    (
        "contrast",
        "units geometry observation model forecast wording",
    ),
    (
        "report",
        "figures fit frame judge material repeatability scan series wording",
    ),
    (
        "map",
        "units colour geometry jackknife material observation model frame series reduction fit \
         plan robust shard",
    ),
    (
        "cases",
        "units geometry material observation model frame series reduction",
    ),
    (
        "check",
        "units cases frame geometry material observation model trace fit series reduction map",
    ),
    ("plan", "units frame geometry material model trace series"),
    (
        "accuracy",
        "units cases figures frame geometry material observation model trace fit series \
         reduction plan map analysis forecast scan robust",
    ),
    ("bench", "units geometry frame clock program words"),
    (
        "scan",
        "units geometry frame clock limits series bench forecast job program wording words",
    ),
    (
        "sim",
        "units geometry material model frame clock series bench scan store lab wording",
    ),
    (
        "store",
        "access units geometry material observation frame clock limits series reduction fit job \
         scan version wording words",
    ),
    (
        "lab",
        "access units geometry material observation frame clock series reduction analysis model \
         fit bench job scan store contrast judge map trace chart comparison config forecast \
         accuracy heights tables preview program repeatability report robust version wording",
    ),
    (
        "api",
        "access accuracy units geometry material observation frame clock comparison contrast \
         series reduction analysis model fit forecast job scan store judge lab map preview \
         repeatability report logging trace wording",
    ),
    (
        "config",
        "units geometry material limits series bench scan wording",
    ),
    ("daemon", "access api clock config lab scan store"),
    ("cli", "*"),
];

/// Modules that are pure: no I/O, no clock, no log, no runtime.
const PURE: &[&str] = &[
    "units",
    "geometry",
    "material",
    "observation",
    "model",
    "trace",
    "fit",
    "chart",
    "comparison",
    "repeatability",
    "plan",
];

/// What a pure module may not name.
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

/// What `api` may not name: it reaches the disk through `lab` and `store`.
const DISK: &[&str] = &["std::fs", "tokio::fs", "File"];

/// [`RULES`] by module.
fn rules() -> BTreeMap<&'static str, Vec<&'static str>> {
    let rules = RULES.iter();
    rules
        .map(|(module, named)| (*module, named.split_whitespace().collect()))
        .collect()
}

/// Modules that a file names, `depth` levels below the crate: what follows `crate::`, or a chain of `super::` that leaves
/// the module. In a module within the file such a chain climbs less far, so a name too many may be found, never one too
/// few.
fn modules_named(code: &str, depth: usize) -> BTreeSet<String> {
    let mut modules = BTreeSet::new();
    let begins = |at: usize| !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_');
    for (at, _) in code.match_indices("crate::") {
        if begins(at) {
            modules.extend(first_segments(&code[at + "crate::".len()..]));
        }
    }
    for (at, _) in code.match_indices("super::") {
        if !begins(at) || code[..at].ends_with("super::") {
            continue;
        }
        let rest = code[at..].trim_start_matches("super::");
        if (code[at..].len() - rest.len()) / "super::".len() >= depth {
            modules.extend(first_segments(rest));
        }
    }
    modules
}

/// The first segment of a path, or those of each path in a group.
fn first_segments(rest: &str) -> BTreeSet<String> {
    let segment = |path: &str| -> String {
        path.trim_start()
            .chars()
            .take_while(|c| c.is_alphanumeric() || *c == '_')
            .collect()
    };
    let Some(group) = rest.strip_prefix('{') else {
        return BTreeSet::from([segment(rest)]);
    };
    let (mut segments, mut depth, mut from) = (BTreeSet::new(), 0, 0);
    for (at, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => {
                segments.insert(segment(&group[from..at]));
                break;
            }
            '}' => depth -= 1,
            ',' if depth == 0 => {
                segments.insert(segment(&group[from..at]));
                from = at + 1;
            }
            _ => {}
        }
    }
    segments
}

/// Ways around the rules, which are refused rather than resolved.
fn hidden_ways(code: &str) -> Vec<&'static str> {
    let words: Vec<&str> = code.split_whitespace().collect();
    let code = words.join(" ");
    ["crate::*", "use crate as", "::{super", ", super::super"]
        .into_iter()
        .filter(|way| code.contains(way))
        .collect()
}

/// Whether `code` has this word, which is no part of a longer one.
fn names(code: &str, word: &str) -> bool {
    let is_of_word = |c: char| c.is_alphanumeric() || c == '_';
    code.match_indices(word).any(|(at, _)| {
        !code[..at].ends_with(is_of_word) && !code[at + word.len()..].starts_with(is_of_word)
    })
}

/// Names of the store's methods that write to the database: those that open a transaction or execute a statement.
fn writers(store: &str) -> BTreeSet<String> {
    let functions = store.split("pub async fn ").skip(1);
    let writing = functions.filter(|function| {
        let body = function.split("\n    }\n").next().unwrap_or(function);
        let body: String = body.split_whitespace().collect();
        body.contains(".writing()") || body.contains(".execute(self.writer())")
    });
    let name = |function: &str| -> String {
        let is_of_name = |c: &char| c.is_alphanumeric() || *c == '_';
        function.chars().take_while(is_of_name).collect()
    };
    writing.map(name).collect()
}

/// Depth of the file's module below the crate.
fn depth_of(path: &Path, src: &Path) -> usize {
    let inner = path.strip_prefix(src).expect("the file is in src");
    let own = usize::from(!inner.ends_with("mod.rs"));
    inner.components().count() - 1 + own
}

fn module_of(path: &Path, src: &Path) -> String {
    let first = path
        .strip_prefix(src)
        .expect("the file is in src")
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

/// The production code of every file of `src`: without comments and texts, and without what only
/// tests compile.
fn production_code() -> Vec<(PathBuf, String)> {
    let files: Vec<(PathBuf, Code)> = files("src", &["rs"])
        .into_iter()
        .map(|path| {
            let text = std::fs::read_to_string(&path).expect("a source file is UTF-8");
            let code = code::read(&text, &path);
            (path, code)
        })
        .collect();
    let for_tests: BTreeSet<PathBuf> = files
        .iter()
        .flat_map(|(_, code)| code.for_tests.iter().cloned())
        .collect();
    files
        .into_iter()
        .filter(|(path, _)| !path.ancestors().any(|p| for_tests.contains(p)))
        .map(|(path, code)| (path, code.text))
        .collect()
}

#[test]
fn modules_name_only_whom_they_may() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let rules = rules();
    let mut broken = Vec::new();
    for (path, code) in &production_code() {
        let module = module_of(path, &src);
        if ["main", "lib"].contains(&module.as_str()) {
            continue;
        }
        let Some(allowed) = rules.get(module.as_str()) else {
            broken.push(format!(
                "module `{module}` has no rule in tests/it/imports.rs"
            ));
            continue;
        };
        for way in hidden_ways(code) {
            broken.push(format!("{} has `{way}`: name the module", path.display()));
        }
        for named in modules_named(code, depth_of(path, &src)) {
            let fine =
                named == module || allowed.contains(&"*") || allowed.contains(&named.as_str());
            if !fine && rules.contains_key(named.as_str()) {
                broken.push(format!(
                    "{} names `{named}`, which `{module}` may not",
                    path.display()
                ));
            }
        }
        let (forbidden, because) = match module.as_str() {
            "api" => (DISK, "reaches the disk through `lab` and `store`"),
            pure if PURE.contains(&pure) => (IMPURE, "is pure"),
            _ => continue,
        };
        for word in forbidden.iter().filter(|word| names(code, word)) {
            broken.push(format!(
                "{} names `{word}`; `{module}` {because}",
                path.display()
            ));
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
fn files_of_a_module_import_each_other_in_one_direction() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let sources: BTreeMap<String, Source> = production_code()
        .into_iter()
        .filter_map(|(path, code)| {
            let file = path.strip_prefix(&src).expect("the file is in src");
            let mut module = file.with_extension("");
            if module.ends_with("mod") {
                module.pop();
            }
            let names = module.iter().map(|s| s.to_string_lossy().into_owned());
            let module: Vec<String> = names.collect();
            let is_root = module == ["lib"] || module == ["main"];
            let file = file.to_string_lossy().replace('\\', "/");
            (!is_root).then_some((file, Source { module, code }))
        })
        .collect();
    let found = circles::find(&sources);
    let described: Vec<String> = found
        .iter()
        .map(|circle| circle.arrows.join("\n  "))
        .collect();
    assert!(found.is_empty(), "circles:\n  {}", described.join("\n\n  "));
}

#[test]
fn one_file_of_the_interface_knows_status_codes() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let files: Vec<String> = production_code()
        .iter()
        .filter(|(_, code)| code.contains("StatusCode"))
        .map(|(path, _)| path.strip_prefix(&src).unwrap().display().to_string())
        .collect();
    assert_eq!(files, ["api/status.rs"]);
}

#[test]
fn modules_name_each_other_in_one_direction() {
    let rules = rules();
    for module in rules.keys() {
        let (mut reached, mut ahead) = (BTreeSet::new(), vec![*module]);
        while let Some(next) = ahead.pop() {
            let named = rules[next].iter().filter(|named| **named != "*");
            ahead.extend(named.filter(|named| reached.insert(**named)));
        }
        assert!(
            !reached.contains(module),
            "`{module}` may name itself through others"
        );
    }
}

#[test]
fn only_the_lab_writes_to_the_store() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let files = production_code();
    let in_store = files
        .iter()
        .filter(|(path, _)| module_of(path, &src) == "store");
    let writers: BTreeSet<String> = in_store.flat_map(|(_, code)| writers(code)).collect();
    for known in ["add_sample", "add_scan", "keep_answer", "record"] {
        assert!(writers.contains(known), "{known} is not found: {writers:?}");
    }
    assert!(!writers.contains("sample"), "{writers:?}");
    for (path, code) in &files {
        if ["store", "lab"].contains(&module_of(path, &src).as_str()) {
            continue;
        }
        let code: String = code.split_whitespace().collect();
        for writer in &writers {
            let writes = ["store", "store()"]
                .iter()
                .any(|store| code.contains(&format!("{store}.{writer}(")));
            assert!(
                !writes,
                "{} writes to the store by `{writer}`: let a method of `Lab` do it",
                path.display()
            );
        }
    }
}

#[test]
fn the_reader_of_imports_sees_groups_and_paths() {
    let code = "use crate::units::Angle;\nuse crate::{geometry::{Pose, RigGeometry}, fit};\nlet x = crate::model::radiance(1);";
    let found: Vec<String> = modules_named(code, 1).into_iter().collect();
    assert_eq!(found, ["fit", "geometry", "model", "units"]);
}

#[test]
fn a_path_that_climbs_out_of_its_module_names_another() {
    let code = "use super::near;\nuse super::super::{far::{Away, super_fine}, wide};";
    for (depth, expected) in [
        (1, vec!["far", "near", "wide"]),
        (2, vec!["far", "wide"]),
        (3, vec![]),
    ] {
        let found: Vec<String> = modules_named(code, depth).into_iter().collect();
        assert_eq!(found, expected, "{depth}");
    }
    assert_eq!(hidden_ways("use crate::*;"), ["crate::*"]);
}

#[test]
fn what_stands_behind_an_item_for_tests_is_read() {
    let read = |text: &str| {
        let code = code::read(text, Path::new("src/trace/mod.rs"));
        let modules: Vec<String> = modules_named(&code.text, 1).into_iter().collect();
        (modules, code.for_tests)
    };
    for behind in [
        "mod t;",
        "#[path = \"t.rs\"]\nmod t;",
        "pub(crate) mod t;",
        "mod t {\n    use crate::lab::Lab;\n    const OPEN: (&str, char) = (\"}\", '}'); // }\n}",
        "use crate::lab::{Lab, fits};",
        "fn x<'a>(list: [&'a u8; 2]) -> u8 {\n    crate::lab::y(r#\"}\"#)\n}",
    ] {
        let (modules, for_tests) = read(&format!(
            "#[cfg(test)]\n{behind}\n\nuse crate::store::Store;\n"
        ));
        assert_eq!(modules, ["store"], "{behind}");
        let file = Path::new("src/trace/t.rs");
        assert_eq!(for_tests.contains(file), behind.ends_with("t;"), "{behind}");
    }
    let (modules, _) = read("/* crate::a */ // crate::b\nlet c = (\"crate::c\", '\\'', crate::d);");
    assert_eq!(modules, ["d"]);
}
