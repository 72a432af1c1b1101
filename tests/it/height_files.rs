//! Files of heights as laboratories have them, through the program: what is reported, and what is
//! refused.

use std::path::Path;

use serde_json::Value;

use super::commands::{refuses, ridged};

/// Heights of a sawtooth of 10° and facets of 100 µm at 1 µm, `columns` × `rows`, some of them `marked`.
fn map(columns: usize, rows: usize, marked: &str) -> String {
    let line = |row: usize| {
        let cell = |column: usize| match (row * columns + column) % 101 {
            50 if !marked.is_empty() => marked.to_owned(),
            _ => format!(
                "{:.3}",
                17.365 - 10f64.to_radians().tan() * (column as f64 % 101.54)
            ),
        };
        (0..columns).map(cell).collect::<Vec<_>>().join(",") + "\n"
    };
    (0..rows).map(line).collect()
}

fn json(folder: &Path, args: &[&str]) -> Value {
    let output = ridged(folder, args);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {message}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A scene on a file of heights.
fn scene(file: &str) -> String {
    format!(
        "[light]\ntheta_i_deg = 30.0\nphi_i_deg = 90.0\n[[interface]]\nshape = \"file\"\npath = \"{file}\"\npitch_um = 1.0\n\
         height_unit_um = 1.0\nbelow = \"Al\"\n[run]\nphotons = 20000\n"
    )
}

#[test]
fn all_forms_of_a_height_file_give_the_same_light_and_missing_points_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let points: String = map(200, 16, "")
        .lines()
        .enumerate()
        .flat_map(|(y, row)| {
            let cells: Vec<String> = row
                .split(',')
                .enumerate()
                .map(|(x, z)| format!("{x}.000 {y}.000 {z}\n"))
                .collect();
            cells
        })
        .collect();
    let mut reflected = Vec::new();
    for (name, text, reported) in [
        ("whole.csv", map(200, 16, ""), ""),
        ("bad.csv", map(200, 16, "Bad"), "heights are missing"),
        (
            "marked.csv",
            map(200, 16, "-9999"),
            "of -9999 are taken as missing",
        ),
        ("points.txt", points, "x, y, z"),
    ] {
        std::fs::write(at.join(name), text).unwrap();
        std::fs::write(at.join("scene.toml"), scene(name)).unwrap();
        let report = json(at, &["trace", "scene.toml", "--json"]);
        reflected.push(report["energy"]["reflected"]["value"].as_f64().unwrap());
        let left_out = report["left_out"].to_string();
        assert!(left_out.contains(reported), "{name}: {left_out}");
    }
    for other in &reflected[1..] {
        assert!((other - reflected[0]).abs() < 0.01, "{reflected:?}");
    }
}

#[test]
fn a_tiff_of_several_candidates_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = std::io::Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap();
    for n in 0..2u16 {
        let heights: Vec<u16> = (0..400).map(|k| n + 7 * k).collect();
        let written = encoder.write_image::<tiff::encoder::colortype::Gray16>(20, 20, &heights);
        written.unwrap();
    }
    std::fs::write(folder.path().join("two.tif"), file.into_inner()).unwrap();
    std::fs::write(folder.path().join("scene.toml"), scene("two.tif")).unwrap();
    let words = ["two.tif", "2 images", "save only the heights"];
    refuses(folder.path(), &["trace", "scene.toml"], 2, &words);
}

#[test]
fn a_shape_that_contradicts_light_and_manifest_gives_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    // Much higher than ridges of 12°, and half as long.
    let profile = "v_um,z_um\n0,26.795\n46.65,0\n51.76,26.795\n";
    std::fs::write(folder.path().join("twice.csv"), profile).unwrap();
    let series = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/series2/opaque-12");
    let args = [
        "fit",
        series,
        "--variant",
        "traced",
        "--shape",
        "twice.csv",
        "--max-seconds",
        "30",
        "--json",
    ];
    let warnings = json(folder.path(), &args)["warnings"].to_string();
    assert!(warnings.contains("vertical scale"), "{warnings}");
    assert!(warnings.contains("pitch_length_um"), "{warnings}");
}
