//! The style sheet, executed: `docs/style.md` lists phrases and names to avoid; no comment, string, document or
//! part of the page has one.

use std::path::Path;

use crate::imports::code::without_comments_and_texts;
use crate::source_files::files;

/// What is read beside Rust sources: documents, settings, the page and the Python package.
const TEXTS: &[&str] = &[
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "docs",
    "ridged.example.toml",
    "scenes",
    "tests/data/README.md",
    "python",
    "web/src",
    "web/tests",
];

/// Their extensions.
const KINDS: &[&str] = &["md", "toml", "svelte", "ts", "css", "html", "py", "ipynb"];

/// Rust sources; identifiers are checked there too.
const SOURCES: &[&str] = &["src", "tests/it", "benches"];

/// The lines of the block of `docs/style.md` that begins with "```kind".
fn listed(sheet: &str, kind: &str) -> Vec<String> {
    let fence = format!("```{kind}\n");
    let (_, block) = sheet.split_once(&fence).expect("the sheet has the block");
    let (block, _) = block.split_once("```").expect("the block ends");
    block.lines().map(str::to_owned).collect()
}

/// Comments and strings of Rust source; everything else is blanks.
fn prose(source: &str) -> String {
    let code = without_comments_and_texts(source);
    source
        .char_indices()
        .map(|(at, c)| match code.as_bytes()[at] {
            b' ' | b'\n' => c,
            _ => ' ',
        })
        .collect()
}

/// The lines of `text`, from 1, in which `phrase` begins, as whole words. Line ends, comment marks and punctuation
/// between two words count as one blank.
fn lines_with(text: &str, phrase: &str) -> Vec<usize> {
    let mut words: Vec<(usize, String)> = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let cut = |c: char| !(c.is_alphanumeric() || c == '\'' || c == '’');
        words.extend(
            line.split(cut)
                .filter(|w| !w.is_empty())
                .map(|w| (i + 1, w.to_lowercase())),
        );
    }
    let phrase: Vec<&str> = phrase.split(' ').collect();
    words
        .windows(phrase.len())
        .filter(|window| window.iter().map(|(_, w)| w).eq(phrase.iter()))
        .map(|window| window[0].0)
        .collect()
}

/// Parts of the identifiers of `code`, in lower case, with their lines: `fooBar_baz` gives foo, bar, baz.
fn parts_of_names(code: &str) -> Vec<(usize, String)> {
    let mut parts = Vec::new();
    for (i, line) in code.lines().enumerate() {
        let mut part = String::new();
        for c in line.chars().chain([' ']) {
            let begins = c.is_uppercase() && part.ends_with(|p: char| p.is_lowercase());
            if (begins || !c.is_alphabetic()) && !part.is_empty() {
                parts.push((i + 1, std::mem::take(&mut part).to_lowercase()));
            }
            if c.is_alphabetic() {
                part.push(c);
            }
        }
    }
    parts
}

#[test]
fn no_text_or_name_has_what_the_style_sheet_avoids() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let sheet_path = root.join("docs/style.md");
    let sheet = std::fs::read_to_string(&sheet_path).expect("the style sheet is readable");
    let (phrases, names) = (listed(&sheet, "text"), listed(&sheet, "names"));
    let mut found = Vec::new();
    let mut report = |path: &Path, line: usize, what: &str| {
        let path = path.strip_prefix(root).unwrap_or(path).display();
        found.push(format!("{path}:{line}: {what}"));
    };
    for place in TEXTS {
        for path in files(place, KINDS) {
            if path == sheet_path {
                continue;
            }
            let text = std::fs::read_to_string(&path).expect("a text is UTF-8");
            for phrase in &phrases {
                for line in lines_with(&text, phrase) {
                    report(&path, line, phrase);
                }
            }
        }
    }
    for path in SOURCES.iter().flat_map(|place| files(place, &["rs"])) {
        let text = std::fs::read_to_string(&path).expect("a source file is UTF-8");
        let prose = prose(&text);
        for phrase in &phrases {
            for line in lines_with(&prose, phrase) {
                report(&path, line, phrase);
            }
        }
        for (line, part) in parts_of_names(&without_comments_and_texts(&text)) {
            if names.contains(&part) {
                report(&path, line, &format!("the name {part}"));
            }
        }
    }
    assert!(
        found.is_empty(),
        "{} phrases or names that docs/style.md avoids:\n{}",
        found.len(),
        found.join("\n")
    );
}

#[test]
fn the_reader_of_texts_sees_phrases_over_lines_and_parts_of_names() {
    let source = "/// Where it\n/// is, x ends.\nlet it_is = \"It  is\"; // done\n";
    assert_eq!(lines_with(&prose(source), "it is"), [1, 3]);
    let parts: Vec<String> = parts_of_names("fn fooBar_baz(x1: Angle)")
        .into_iter()
        .map(|(_, part)| part)
        .collect();
    assert_eq!(parts, ["fn", "foo", "bar", "baz", "x", "angle"]);
}
