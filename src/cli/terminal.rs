//! The width of the terminal.

use std::io::IsTerminal;
use std::os::fd::AsFd;

/// Fewest columns that text is laid out for.
const LEAST: usize = 40;

/// Returns the columns of the terminal at stdout; none where it is a file or another program. `COLUMNS` wins.
pub fn columns() -> Option<usize> {
    columns_of(std::io::stdout())
}

/// Returns the columns of the terminal at stderr; none where it is a file or another program.
pub fn columns_of_stderr() -> Option<usize> {
    let out = std::io::stderr();
    out.is_terminal().then(|| columns_of(out)).flatten()
}

fn columns_of(out: impl AsFd + IsTerminal) -> Option<usize> {
    let stated = std::env::var("COLUMNS").ok();
    if let Some(columns) = stated.and_then(|text| text.trim().parse::<usize>().ok()) {
        return Some(columns.max(LEAST));
    }
    if !out.is_terminal() {
        return None;
    }
    let size = rustix::termios::tcgetwinsize(&out).ok()?;
    match usize::from(size.ws_col) {
        0 => None,
        columns => Some(columns.max(LEAST)),
    }
}
