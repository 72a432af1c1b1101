//! A source file as the import rules read it: without comments, without texts and without what only
//! tests compile, which may name anything.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Words with which an item begins that may stand behind `#[cfg(test)]`; anything else stays and is read.
const ITEMS: &[&str] = &[
    "pub", "mod", "use", "fn", "async", "const", "unsafe", "struct", "enum", "impl", "type",
    "static", "trait",
];

/// What is read of a file, and the files beside it that only tests compile.
pub struct Code {
    /// Comments, texts and items for tests are blanks; lines and columns are the file's.
    pub text: String,
    /// Files of its `#[cfg(test)] mod x;`, with the folders of their own modules.
    pub for_tests: BTreeSet<PathBuf>,
}

/// Reads `text`, the file at `path`.
pub fn read(text: &str, path: &Path) -> Code {
    let mut code = without_comments_and_texts(text);
    let mut for_tests = BTreeSet::new();
    let mut from = 0;
    while let Some(at) = code[from..].find("#[cfg(test)]").map(|i| i + from) {
        let attributes = at..after_attributes(&code, at);
        from = attributes.end;
        let Some(end) = end_of_item(&code, attributes.end) else {
            continue;
        };
        if let Some(name) = name_of_file_module(&code[attributes.end..end]) {
            let named = text[attributes].split("#[path = \"").nth(1);
            let file = match named.and_then(|rest| rest.split('"').next()) {
                Some(file) => path.with_file_name(file),
                None => folder_of_modules(path).join(format!("{name}.rs")),
            };
            for_tests.insert(file.with_extension(""));
            for_tests.insert(file);
        }
        let blank = blanked(&code[at..end]);
        code.replace_range(at..end, &blank);
    }
    Code {
        text: code,
        for_tests,
    }
}

/// The folder in which the file's modules lie.
fn folder_of_modules(path: &Path) -> PathBuf {
    match path.file_stem().and_then(|s| s.to_str()) {
        Some("mod" | "lib" | "main") => path.parent().unwrap_or(path).to_owned(),
        _ => path.with_extension(""),
    }
}

/// The module's name if `item` is a `mod x;`.
fn name_of_file_module(item: &str) -> Option<&str> {
    let (before, after) = item.split_once("mod ")?;
    let visible = before.trim();
    let name = after.strip_suffix(';')?;
    (visible.is_empty() || visible.starts_with("pub")).then(|| name.trim())
}

/// Where the attributes end that begin at `at`, with the blanks behind them.
fn after_attributes(code: &str, at: usize) -> usize {
    let mut at = at;
    while code[at..].starts_with("#[") {
        let Some(end) = closing(code, at + 1) else {
            return code.len();
        };
        at = end + code[end..].len() - code[end..].trim_start().len();
    }
    at
}

/// Where the item ends that begins at `at`: behind its semicolon or its body.
fn end_of_item(code: &str, at: usize) -> Option<usize> {
    let word: String = code[at..]
        .chars()
        .take_while(|c| c.is_alphanumeric() || *c == '_')
        .collect();
    if !ITEMS.contains(&word.as_str()) {
        return None;
    }
    let head = code[at..].split([';', '{']).next().unwrap_or_default();
    let is_use = head.split_whitespace().any(|w| w == "use");
    let mut here = at;
    while let Some(c) = code[here..].chars().next() {
        match c {
            ';' => return Some(here + 1),
            '{' if !is_use => return closing(code, here),
            '{' | '(' | '[' => here = closing(code, here)?,
            _ => here += c.len_utf8(),
        }
    }
    None
}

/// Behind the bracket that closes the one at `open`.
fn closing(code: &str, open: usize) -> Option<usize> {
    let mut depth = 0;
    for (i, c) in code[open..].char_indices() {
        match c {
            '{' | '(' | '[' => depth += 1,
            '}' | ')' | ']' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return Some(open + i + 1);
        }
    }
    None
}

/// As many blanks as `text` has bytes, in as many lines.
fn blanked(text: &str) -> String {
    text.bytes()
        .map(|b| if b == b'\n' { '\n' } else { ' ' })
        .collect()
}

/// The file with its comments and texts as blanks, byte by byte; line ends stay.
pub fn without_comments_and_texts(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let in_word = code.ends_with(|c: char| c.is_alphanumeric() || c == '_');
        let skipped = match c {
            '/' if rest.starts_with("//") => rest.find('\n').unwrap_or(rest.len()),
            '/' if rest.starts_with("/*") => length_of_comment(rest),
            '"' => length_of_text(rest),
            'r' | 'b' if !in_word => length_of_prefixed_text(rest),
            '\'' => length_of_char(rest),
            _ => 0,
        };
        let (taken, length) = match skipped {
            0 => (rest[..c.len_utf8()].to_owned(), c.len_utf8()),
            n => (blanked(&rest[..n]), n),
        };
        code.push_str(&taken);
        rest = &rest[length..];
    }
    code
}

fn length_of_comment(rest: &str) -> usize {
    let mut depth = 0;
    for (i, _) in rest.char_indices() {
        if rest[i..].starts_with("/*") {
            depth += 1;
        } else if rest[i..].starts_with("*/") {
            depth -= 1;
            if depth == 0 {
                return i + 2;
            }
        }
    }
    rest.len()
}

fn length_of_text(rest: &str) -> usize {
    let mut escaped = false;
    for (i, c) in rest.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return i + 1,
            _ => {}
        }
    }
    rest.len()
}

/// Length of `r"…"`, `r#"…"#`, `b"…"`, `br"…"` or `b'…'`; 0 where `rest` begins with none.
fn length_of_prefixed_text(rest: &str) -> usize {
    let after_b = rest.strip_prefix('b').unwrap_or(rest);
    if rest.starts_with("b\"") {
        return 1 + length_of_text(after_b);
    }
    if rest.starts_with("b'") {
        return 1 + length_of_char(after_b);
    }
    let Some(after_r) = after_b.strip_prefix('r') else {
        return 0;
    };
    let hashes = after_r.len() - after_r.trim_start_matches('#').len();
    if !after_r[hashes..].starts_with('"') {
        return 0;
    }
    let start = rest.len() - after_r.len() + hashes + 1;
    let end = format!("\"{}", "#".repeat(hashes));
    rest[start..]
        .find(&end)
        .map_or(rest.len(), |i| start + i + end.len())
}

/// Length of `'x'` or `'\n'`; 0 of a lifetime.
fn length_of_char(rest: &str) -> usize {
    let mut chars = rest.char_indices().skip(1);
    match chars.next() {
        Some((_, '\\')) => rest[3..].find('\'').map_or(0, |i| 3 + i + 1),
        Some(_) => chars
            .next()
            .filter(|(_, c)| *c == '\'')
            .map_or(0, |(i, _)| i + 1),
        None => 0,
    }
}
