//! Rebuilds what is embedded when it changes: the migrations and the page.

fn main() {
    println!("cargo::rerun-if-changed=migrations");
    println!("cargo::rerun-if-changed=web/dist");
}
