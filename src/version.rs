//! Version and commit of this build.

/// Version with the commit: `0.1.0 (commit 0123456789ab)`; `, modified` follows where the sources differed from the commit.
/// Outside a git checkout the commit is not known: `0.1.0 (built outside git)`.
pub const VERSION: &str = env!("RIDGED_VERSION");
/// Name and version of the program with its commit.
pub const BUILD: &str = concat!("ridged ", env!("RIDGED_VERSION"));

#[cfg(test)]
mod tests {
    use super::VERSION;

    #[test]
    fn a_build_states_its_commit_or_that_it_has_none() {
        let number = env!("CARGO_PKG_VERSION");
        let origin = VERSION
            .strip_prefix(number)
            .and_then(|rest| rest.strip_prefix(" ("))
            .and_then(|rest| rest.strip_suffix(')'))
            .unwrap_or_else(|| panic!("{VERSION}"));
        let commit = origin.strip_prefix("commit ").map(|c| &c[..12]);
        let is_hex = |c: &str| c.bytes().all(|b| b.is_ascii_hexdigit());
        assert!(
            origin == "built outside git" || commit.is_some_and(is_hex),
            "{VERSION}"
        );
    }
}
