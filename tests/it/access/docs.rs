//! `docs/access.md`: each row of its threat table names a test.

use std::path::Path;

fn sources(folder: &Path, text: &mut String) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, text);
        } else if path.extension().is_some_and(|e| e == "rs") {
            text.push_str(&std::fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn every_row_of_the_threat_table_has_its_test() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(root.join("docs/access.md")).unwrap();
    let (_, table) = page.split_once("## Threats").unwrap();
    let table = table.split("\n## ").next().unwrap();
    let rows: Vec<&str> = table
        .lines()
        .filter(|line| {
            line.starts_with("| ") && !line.starts_with("| threat") && !line.starts_with("| ---")
        })
        .collect();
    assert!(rows.len() >= 20, "{}", rows.len());
    let mut code = String::new();
    for folder in ["src", "tests/it"] {
        sources(&root.join(folder), &mut code);
    }
    for row in rows {
        let last = row.trim_end_matches('|').rsplit('|').next().unwrap();
        let names: Vec<&str> = last.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "no test: {row}");
        for name in names {
            assert!(
                code.contains(&format!("fn {name}(")),
                "no test `{name}`: {row}"
            );
        }
    }
}
