//! Rebuilds what is embedded when it changes: the migrations, the page, the OpenAPI document. States the commit of a build.

use std::io::Write as _;
use std::path::Path;
use std::process::Command;

use flate2::Compression;
use flate2::write::GzEncoder;

fn main() {
    println!("cargo::rerun-if-changed=migrations");
    println!("cargo::rerun-if-changed=web/dist");
    println!("cargo::rerun-if-changed=src");
    println!("cargo::rerun-if-changed=build.rs");
    pack_the_document();
    let origin = commit().unwrap_or_else(|| "built outside git".to_owned());
    let version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    println!("cargo::rustc-env=RIDGED_VERSION={version} ({origin})");
}

/// Packs the OpenAPI document for the program: to a tenth of its 800 kB.
fn pack_the_document() {
    let document = std::fs::read("src/api/openapi.json").expect("the document is there");
    let mut packed = GzEncoder::new(Vec::new(), Compression::best());
    packed.write_all(&document).expect("memory takes all bytes");
    let packed = packed.finish().expect("memory takes all bytes");
    let folder = std::env::var("OUT_DIR").expect("cargo sets it");
    let file = Path::new(&folder).join("openapi.json.gz");
    std::fs::write(file, packed).expect("cargo made this folder");
}

/// Returns the commit of this folder, and whether the sources differ from it; none where the folder is not a checkout of
/// its own: the repository of a folder above says nothing about it.
fn commit() -> Option<String> {
    let top = git(&["rev-parse", "--show-toplevel"])?;
    let here = std::env::var("CARGO_MANIFEST_DIR").ok()?;
    if Path::new(&top).canonicalize().ok()? != Path::new(&here).canonicalize().ok()? {
        return None;
    }
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    // Grows with each commit and checkout. A build for development states the commit of its last change of a source, so that a
    // commit alone builds nothing again.
    let log = git(&["rev-parse", "--git-path", "logs/HEAD"])?;
    if std::env::var("PROFILE").is_ok_and(|p| p == "release") && Path::new(&log).exists() {
        println!("cargo::rerun-if-changed={log}");
    }
    let sources = ["src", "migrations", "build.rs", "Cargo.toml", "Cargo.lock"];
    let status = git(&[&["status", "--porcelain", "--"][..], &sources].concat())?;
    let modified = if status.is_empty() { "" } else { ", modified" };
    Some(format!("commit {commit}{modified}"))
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
