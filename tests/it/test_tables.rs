//! Tables of the documents whose rows name tests: the threats of `docs/reference/access.md`, the faults of `docs/reference/faults.md`.

use std::path::Path;

use crate::source_files::files;

/// The first cells of all rows of the tables of a page whose last cell names tests that exist.
fn rows(page: &str) -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(root.join(page)).unwrap();
    let sources = ["src", "tests/it"].map(|folder| files(folder, &["rs"]));
    let code: String = (sources.iter().flatten())
        .map(|path| std::fs::read_to_string(path).unwrap())
        .collect();
    let mut first_cells = Vec::new();
    let mut in_table = false;
    for row in page.lines() {
        if row.ends_with("| test |") || row.ends_with("| tests |") {
            in_table = true;
            continue;
        }
        in_table &= row.starts_with("| ");
        if !in_table || row.starts_with("| ---") {
            continue;
        }
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let names: Vec<&str> = cells
            .last()
            .unwrap()
            .split('`')
            .skip(1)
            .step_by(2)
            .collect();
        assert!(!names.is_empty(), "no test: {row}");
        for name in names {
            let is_there = code.contains(&format!("fn {name}("));
            assert!(is_there, "no test `{name}`: {row}");
        }
        first_cells.push(cells[0].to_owned());
    }
    first_cells
}

#[test]
fn every_row_of_the_threat_table_has_its_test() {
    let threats = rows("docs/reference/access.md");
    assert!(threats.len() >= 20, "{}", threats.len());
}

#[test]
fn every_row_of_the_fault_table_has_its_tests() {
    let numbers: Vec<String> = (1..=73).map(|number: u32| number.to_string()).collect();
    assert_eq!(rows("docs/reference/faults.md"), numbers);
}
