//! Every answer says how wrong it may be, what it cost, and what was left out to get it: asked of every command
//! that prints one as JSON.

use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

const SCENE: &str = "[light]\ntheta_i_deg = 40.0\n[[interface]]\nshape = \"beckmann\"\ncells = 16\nalpha_u = 0.2\nalpha_v = 0.2\nbelow = { n = 1.5 }\n[run]\nphotons = 4000\ntheta_bins = 9\nphi_bins = 12\n";

/// What a command prints as JSON.
fn json(folder: &Path, args: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_ridged"))
        .args(args)
        .arg("--json")
        .current_dir(folder)
        .env("RIDGED_LOG", "off")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {message}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Where a result says how wrong it may be, by command.
const ANSWERS: &[(&[&str], &str)] = &[
    (
        &["fit", "SERIES/paper-rig-full"],
        "/parameters/theta_r_deg/expanded",
    ),
    (
        &["fit", "SERIES/paper-rig-full", "another-day"],
        "/parameters/theta_r_deg/expanded",
    ),
    (
        &["map", "SERIES/paper-rig-full", "--out", "map"],
        "/parameters/theta_r_deg/std_median",
    ),
    (&["explain", "SERIES/paper-rig-full", "--map"], "/tolerance"),
    (
        &["judge", "SERIES/paper-rig-full", "--spec", "SPEC"],
        "/items/0/expanded",
    ),
    (&["contrast", "SERIES/paper-rig-full"], "/model_error/value"),
    (&["contrast"], "/model_error/value"),
    (&["contrast", "--variant", "paper"], "/model_error/value"),
    (
        &[
            "contrast",
            "--variant",
            "quadrature",
            "--target-error",
            "1e-3",
        ],
        "/model_error/value",
    ),
    (&["optimize", "--theta-c-deg", "0"], "/error/value"),
    (&["trace", "scene.toml"], "/relative_error"),
    (
        &[
            "trace",
            "compare",
            "scene.toml",
            "--pixels",
            "16",
            "--error-max",
            "10",
        ],
        "/angles/0/directions",
    ),
    (
        &["trace", "ellipsometer", "scene.toml", "--angles-deg", "40"],
        "/angles/0/points/0",
    ),
    (&["explain", "scene.toml"], "/tolerance"),
    (&["explain", "SERIES/paper-rig-full"], "/tolerance"),
    (
        &[
            "model-error",
            "--theta-r-deg",
            "10",
            "--alpha",
            "0.3",
            "--paths",
            "64",
        ],
        "/error/value",
    ),
    (
        &[
            "wear",
            "--rounds",
            "0",
            "--burrs",
            "--theta-r-min-deg",
            "8",
            "--theta-r-max-deg",
            "10",
            "--theta-r-step-deg",
            "1",
            "--paths",
            "64",
        ],
        "/error/value",
    ),
];

/// Another scan of the same sample: the series without its last frame.
fn another_day(series: &Path, folder: &Path) {
    std::fs::create_dir_all(folder.join("frames")).unwrap();
    std::fs::copy(series.join("manifest.toml"), folder.join("manifest.toml")).unwrap();
    let rows = std::fs::read_to_string(series.join("frames.csv")).unwrap();
    let (kept, _) = rows.trim_end().rsplit_once('\n').unwrap();
    std::fs::write(folder.join("frames.csv"), format!("{kept}\n")).unwrap();
    for frame in std::fs::read_dir(series.join("frames")).unwrap() {
        let frame = frame.unwrap();
        std::fs::copy(frame.path(), folder.join("frames").join(frame.file_name())).unwrap();
    }
}

#[test]
fn every_answer_says_how_wrong_what_it_cost_and_what_was_left_out() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let series = root.join("tests/data/series").display().to_string();
    another_day(
        &root.join("tests/data/series/paper-rig-full"),
        &folder.path().join("another-day"),
    );
    let spec = root
        .join("docs/examples/specification.toml")
        .display()
        .to_string();
    for (args, error) in ANSWERS {
        let args: Vec<String> = args
            .iter()
            .map(|a| a.replace("SERIES", &series).replace("SPEC", &spec))
            .collect();
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let answer = json(folder.path(), &args);
        let wrong = answer.pointer(error);
        assert!(
            wrong.is_some_and(|x| !x.is_null()),
            "{args:?} has no {error}"
        );
        let left_out = answer["left_out"].as_array();
        let left_out = left_out.unwrap_or_else(|| panic!("{args:?} has no left_out"));
        for entry in left_out {
            let reported = |key: &str| entry[key].as_str().is_some_and(|text| !text.is_empty());
            assert!(reported("what") && reported("why"), "{args:?}: {entry}");
            assert!(entry.get("cost").is_some(), "{args:?}: {entry}");
        }
        let seconds = match answer["seconds"].as_f64() {
            Some(seconds) => seconds,
            None => answer["timing_s"]
                .as_object()
                .unwrap_or_else(|| panic!("{args:?} has neither seconds nor timing_s"))
                .values()
                .filter_map(Value::as_f64)
                .sum(),
        };
        assert!(seconds > 0.0, "{args:?}: {seconds} s");
    }
}

#[test]
fn a_scan_given_twice_is_refused() {
    let series = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/paper-rig-full");
    let output = Command::new(env!("CARGO_BIN_EXE_ridged"))
        .arg("fit")
        .args([&series, &series])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(message.contains("are the same scan"), "{message}");
}

#[test]
fn what_takes_longer_than_allowed_says_what_it_has_not() {
    let folder = tempfile::tempdir().unwrap();
    let optimum = json(folder.path(), &["optimize", "--max-seconds", "1e-9"]);
    assert_eq!(optimum["complete"], false);
    assert!(optimum["within_1_percent_deg"].is_null());
    let reported = optimum["left_out"].to_string();
    assert!(reported.contains("the rest of the search"), "{reported}");
}
