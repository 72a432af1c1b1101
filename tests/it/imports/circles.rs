//! Circles among the files of one module: files that import each other, directly or through others.
//!
//! An arrow runs from a file to the file that *defines* what it names. A re-export or an import in a
//! module's top file is followed to the definition, so `super::Plan` leads to `plan.rs` and not to
//! `mod.rs`; the re-export itself is no arrow unless the file that has it uses the name. Three ways to
//! name something are read: `use`, paths that begin with `crate`, `self` or `super`, and paths that
//! begin with a module that the file declares or imports.
//!
//! A file may use what its own top module defines (the `mod.rs` or `name.rs` above it), although that
//! file declares it: this is how Rust nests modules, and such an arrow is left out.

use std::collections::{BTreeMap, BTreeSet};

/// One source file: its module path below the crate, and its code without comments, texts and tests.
pub struct Source {
    pub module: Vec<String>,
    pub code: String,
}

/// A name that a `use` brings into a file: its path from the crate. The name `*` brings all.
struct Binding {
    name: String,
    path: Vec<String>,
    is_reexport: bool,
}

/// Files that import each other, by their paths below `src`, and each arrow among them with its names.
#[derive(Debug, PartialEq)]
pub struct Circle {
    pub files: Vec<String>,
    pub arrows: Vec<String>,
}

/// All circles, in the order of their files' names.
pub fn find(sources: &BTreeMap<String, Source>) -> Vec<Circle> {
    let tree = SourceTree::new(sources);
    let arrows: BTreeMap<&str, BTreeMap<&str, BTreeSet<String>>> = sources
        .keys()
        .map(|file| (file.as_str(), tree.arrows_from(file)))
        .collect();
    let reached: BTreeMap<&str, BTreeSet<&str>> = arrows
        .keys()
        .map(|file| (*file, reached_from(file, &arrows)))
        .collect();
    let mut circles: Vec<Circle> = Vec::new();
    for (file, others) in &reached {
        let is_in_one = circles.iter().any(|c| c.files.iter().any(|f| f == file));
        if is_in_one || !others.contains(file) {
            continue;
        }
        let files: Vec<&str> = others
            .iter()
            .copied()
            .filter(|other| reached[other].contains(file))
            .collect();
        let described = files.iter().flat_map(|from| {
            let inner = arrows[from].iter().filter(|(to, _)| files.contains(to));
            inner.map(move |(to, names)| {
                let names: Vec<&str> = names.iter().map(String::as_str).collect();
                format!("{from} -> {to}: {}", names.join(", "))
            })
        });
        circles.push(Circle {
            arrows: described.collect(),
            files: files.iter().map(|f| (*f).to_owned()).collect(),
        });
    }
    circles
}

/// All files that can be reached along the arrows; `file` itself only through a circle.
fn reached_from<'a>(
    file: &str,
    arrows: &BTreeMap<&'a str, BTreeMap<&'a str, BTreeSet<String>>>,
) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut ahead: Vec<&str> = vec![file];
    while let Some(from) = ahead.pop() {
        for to in arrows[from].keys() {
            if reached.insert(*to) {
                ahead.push(to);
            }
        }
    }
    reached
}

/// The files of the crate with what each imports.
struct SourceTree<'a> {
    sources: &'a BTreeMap<String, Source>,
    files: BTreeMap<&'a [String], &'a str>,
    bindings: BTreeMap<&'a str, Vec<Binding>>,
}

impl<'a> SourceTree<'a> {
    fn new(sources: &'a BTreeMap<String, Source>) -> SourceTree<'a> {
        let files: BTreeMap<&[String], &str> = sources
            .iter()
            .map(|(file, source)| (source.module.as_slice(), file.as_str()))
            .collect();
        let mut tree = SourceTree {
            sources,
            files,
            bindings: BTreeMap::new(),
        };
        for (file, source) in sources {
            let mut bindings = Vec::new();
            for (is_reexport, item) in uses(&source.code) {
                for (name, path) in leaves(item) {
                    if let Some(path) = tree.path_from_crate(source, &path, &[]) {
                        bindings.push(Binding {
                            name,
                            path,
                            is_reexport,
                        });
                    }
                }
            }
            tree.bindings.insert(file, bindings);
        }
        tree
    }

    /// The path from the crate of a path that `source` writes; `None` where another crate is named.
    fn path_from_crate(
        &self,
        source: &Source,
        path: &[String],
        bindings: &[Binding],
    ) -> Option<Vec<String>> {
        let (first, rest) = path.split_first()?;
        let child = || [source.module.as_slice(), &path[..1]].concat();
        let mut whole = match first.as_str() {
            "crate" => Vec::new(),
            "self" => source.module.clone(),
            "super" => {
                let mut above = source.module.clone();
                above.pop()?;
                above
            }
            _ if self.files.contains_key(child().as_slice()) => child(),
            name => bindings.iter().find(|b| b.name == name)?.path.clone(),
        };
        for segment in rest {
            if segment == "super" {
                whole.pop()?;
            } else {
                whole.push(segment.clone());
            }
        }
        Some(whole)
    }

    /// The file that defines what `path` names, and its name; `None` for a module as such and for
    /// paths outside the crate. `depth` ends the search in imports that name each other.
    fn definition(&self, path: &[String], depth: usize) -> Option<(&'a str, String)> {
        let modules = (1..=path.len())
            .take_while(|n| self.files.contains_key(&path[..*n]))
            .last()?;
        let file = self.files[&path[..modules]];
        let name = path.get(modules)?;
        if depth == 0 {
            return Some((file, name.clone()));
        }
        let behind = |binding: &Binding, from: usize| {
            let whole = [binding.path.as_slice(), &path[from..]].concat();
            self.definition(&whole, depth - 1)
        };
        let bindings = &self.bindings[file];
        let named = bindings.iter().filter(|binding| binding.name == *name);
        if let Some(found) = named.filter_map(|b| behind(b, modules + 1)).next() {
            return Some(found);
        }
        let globs = bindings.iter().filter(|b| b.name == "*");
        let is_own = defines(&self.sources[file].code, name);
        let imported = globs
            .filter(|b| !is_own && b.path != path[..modules])
            .filter_map(|b| behind(b, modules))
            .find(|(file, name)| defines(&self.sources[*file].code, name));
        Some(imported.unwrap_or_else(|| (file, name.clone())))
    }

    /// The files whose definitions `file` names, with the names, within its own top-level module and without the
    /// modules above it.
    fn arrows_from(&self, file: &str) -> BTreeMap<&'a str, BTreeSet<String>> {
        let source = &self.sources[file];
        let bindings = &self.bindings[file];
        let (words, written) = words_and_paths(&source.code);
        let mut paths: Vec<Vec<String>> = Vec::new();
        for binding in bindings {
            if binding.name == "*" {
                paths.extend(self.names_in(&binding.path).into_iter().filter_map(|name| {
                    let is_used = words.contains(name.as_str());
                    is_used.then(|| [binding.path.as_slice(), &[name]].concat())
                }));
            } else if !binding.is_reexport || words.contains(binding.name.as_str()) {
                paths.push(binding.path.clone());
            }
        }
        paths.extend(
            written
                .iter()
                .filter_map(|path| self.path_from_crate(source, path, bindings)),
        );
        let mut arrows: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
        for path in paths {
            let Some((to, name)) = self.definition(&path, 8) else {
                continue;
            };
            let other = &self.sources[to].module;
            let is_above = source.module.starts_with(other);
            if !is_above && other.first() == source.module.first() {
                arrows.entry(to).or_default().insert(name);
            }
        }
        arrows
    }

    /// The names that the module at `path` imports: those that a `use …::*` may bring from elsewhere.
    fn names_in(&self, path: &[String]) -> Vec<String> {
        let Some(file) = self.files.get(path) else {
            return Vec::new();
        };
        let imported = self.bindings[file].iter().map(|b| b.name.clone());
        imported.filter(|name| name != "*").collect()
    }
}

/// Whether `code` has an item of this name.
fn defines(code: &str, name: &str) -> bool {
    const KINDS: &[&str] = &[
        "fn", "struct", "enum", "trait", "type", "const", "static", "union", "mod",
    ];
    code.match_indices(name).any(|(at, _)| {
        let is_whole = !code[at + name.len()..].starts_with(is_of_word);
        let before = code[..at].trim_end();
        let kind = before.rsplit(|c| !is_of_word(c)).next();
        is_whole && before.len() < at && kind.is_some_and(|kind| KINDS.contains(&kind))
    })
}

fn is_of_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// All `use` items: whether each has a visibility, and the tokens of its tree.
fn uses(code: &str) -> Vec<(bool, Vec<&str>)> {
    let begins = |at: usize| !code[..at].ends_with(is_of_word);
    let items = code.match_indices("use ").filter(|(at, _)| begins(*at));
    items
        .map(|(at, found)| {
            let item = &code[at + found.len()..];
            let before = code[..at].trim_end();
            let is_reexport = before.ends_with("pub") || before.ends_with(')');
            (
                is_reexport,
                tokens(item.split(';').next().unwrap_or_default()),
            )
        })
        .collect()
}

/// Words, `::` and single other characters.
fn tokens(text: &str) -> Vec<&str> {
    let mut tokens = Vec::new();
    let mut rest = text.trim_start();
    while let Some(c) = rest.chars().next() {
        let length = if is_of_word(c) {
            rest.find(|c| !is_of_word(c)).unwrap_or(rest.len())
        } else if rest.starts_with("::") {
            2
        } else {
            c.len_utf8()
        };
        tokens.push(&rest[..length]);
        rest = rest[length..].trim_start();
    }
    tokens
}

/// The names that a tree of `use` brings, each with its path as written.
fn leaves(tokens: Vec<&str>) -> Vec<(String, Vec<String>)> {
    let mut found = Vec::new();
    // the path so far, and how long it was at the start of each open group
    let (mut path, mut groups): (Vec<String>, Vec<usize>) = (Vec::new(), Vec::new());
    let (mut alias, mut is_alias, mut is_leaf) = (None, false, false);
    let mut end = |path: &[String], alias: &mut Option<String>| {
        let mut path = path.to_vec();
        if path.last().is_some_and(|last| last == "self") && path.len() > 1 {
            path.pop();
        }
        let glob = path.last().is_some_and(|last| last == "*");
        let name = alias.take().or_else(|| path.last().cloned());
        if glob {
            path.pop();
        }
        found.extend(name.map(|name| (name, path)));
    };
    for token in tokens {
        match token {
            "::" => is_leaf = false,
            "{" => groups.push(path.len()),
            "}" | "," => {
                if is_leaf {
                    end(&path, &mut alias);
                    is_leaf = false;
                }
                path.truncate(groups.last().copied().unwrap_or(0));
                if token == "}" {
                    groups.pop();
                }
            }
            "as" => is_alias = true,
            word if is_alias => {
                alias = Some(word.to_owned());
                is_alias = false;
            }
            word => {
                path.push(word.to_owned());
                is_leaf = true;
            }
        }
    }
    if is_leaf {
        end(&path, &mut alias);
    }
    found
}

/// All words outside `use` and `mod x;`, and the paths of two segments or more there.
fn words_and_paths(code: &str) -> (BTreeSet<&str>, Vec<Vec<String>>) {
    let tokens = tokens(code);
    let is_word = |at: usize| tokens.get(at).is_some_and(|t| t.starts_with(is_of_word));
    let (mut words, mut paths) = (BTreeSet::new(), Vec::new());
    let mut at = 0;
    while at < tokens.len() {
        if tokens[at] == "use" {
            at += tokens[at..].iter().take_while(|t| **t != ";").count();
        } else if tokens[at] == "mod" {
            at += 1;
        } else if is_word(at) {
            let first = at;
            while tokens.get(at + 1) == Some(&"::") && is_word(at + 2) {
                at += 2;
            }
            let path = tokens[first..=at].iter().step_by(2);
            words.extend(path.clone());
            if at > first {
                paths.push(path.map(|word| (*word).to_owned()).collect());
            }
        }
        at += 1;
    }
    (words, paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(files: &[(&str, &str)]) -> BTreeMap<String, Source> {
        files
            .iter()
            .map(|(file, code)| {
                let path = file.trim_end_matches(".rs").trim_end_matches("/mod");
                let source = Source {
                    module: path.split('/').map(str::to_owned).collect(),
                    code: (*code).to_owned(),
                };
                ((*file).to_owned(), source)
            })
            .collect()
    }

    fn files_of(circles: &[Circle]) -> Vec<Vec<&str>> {
        let files = circles.iter().map(|c| &c.files);
        files
            .map(|files| files.iter().map(String::as_str).collect())
            .collect()
    }

    #[test]
    fn two_files_that_name_each_other_are_a_circle_however_they_are_named() {
        for back in [
            "use super::a::A;",
            "use crate::part::a::{self, A as C};",
            "use super::A;",
            "fn f(a: super::A) {}",
            "fn f(a: crate::part::a::A) {}",
            "use super::a; fn f() { a::go() }",
            "use super::*; fn f(a: A) {}",
        ] {
            let sources = tree(&[
                ("part/mod.rs", "mod a; mod b; pub use a::A; pub struct Top;"),
                (
                    "part/a.rs",
                    "use super::{Top, b::B}; pub struct A; pub fn go() {}",
                ),
                ("part/b.rs", &format!("pub struct B; {back}")),
            ]);
            let circles = find(&sources);
            assert_eq!(files_of(&circles), [["part/a.rs", "part/b.rs"]], "{back}");
        }
    }

    #[test]
    fn what_a_top_module_defines_is_for_the_files_below_it() {
        let sources = tree(&[
            (
                "part.rs",
                "mod a; use a::A; pub struct Top; fn f() { a::g() }",
            ),
            (
                "part/a.rs",
                "use super::Top; pub struct A(super::Top, crate::part::Top);",
            ),
            ("part/a/deep.rs", "use super::super::Top; use super::A;"),
        ]);
        assert_eq!(find(&sources), []);
    }

    #[test]
    fn a_circle_through_several_files_and_re_exports_is_named_with_its_arrows() {
        let sources = tree(&[
            (
                "part/mod.rs",
                "pub(crate) use self::b::Two as Second; mod a; mod b; mod c;",
            ),
            (
                "part/a.rs",
                "use crate::{other::X, part::Second}; pub struct One;",
            ),
            ("part/b.rs", "mod deep; pub(super) use deep::Two;"),
            (
                "part/b/deep.rs",
                "use super::super::c::three; pub struct Two;",
            ),
            ("part/c.rs", "pub fn three() -> crate::part::a::One {}"),
            ("other.rs", "use crate::part::a::One; pub struct X;"),
        ]);
        assert_eq!(
            find(&sources),
            [Circle {
                files: ["part/a.rs", "part/b/deep.rs", "part/c.rs"]
                    .map(str::to_owned)
                    .into(),
                arrows: [
                    "part/a.rs -> part/b/deep.rs: Two",
                    "part/b/deep.rs -> part/c.rs: three",
                    "part/c.rs -> part/a.rs: One",
                ]
                .map(str::to_owned)
                .into(),
            }]
        );
    }
}
