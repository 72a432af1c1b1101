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

/// Folder of another scan of the same sample.
const ANOTHER_DAY: &str = "another-day";

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

/// Checks that the result of a command states its error, its run time, and what was left out.
fn check(command: &str, error: &str) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let series = root.join("tests/data/series");
    if command.contains(ANOTHER_DAY) {
        let copy = folder.path().join(ANOTHER_DAY);
        another_day(&series.join("paper-rig-full"), &copy);
    }
    let series = series.display().to_string();
    let spec = root.join("docs/examples/specification.toml");
    let spec = spec.display().to_string();
    let args: Vec<String> = command
        .split_whitespace()
        .map(|a| a.replace("SERIES", &series).replace("SPEC", &spec))
        .collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let answer = json(folder.path(), &args);
    let wrong = answer.pointer(error);
    assert!(wrong.is_some_and(|x| !x.is_null()), "no {error}");
    let left_out = answer["left_out"].as_array().expect("it has left_out");
    for entry in left_out {
        let reported = |key: &str| entry[key].as_str().is_some_and(|text| !text.is_empty());
        assert!(reported("what") && reported("why"), "{entry}");
        assert!(entry.get("cost").is_some(), "{entry}");
    }
    let seconds = match answer["seconds"].as_f64() {
        Some(seconds) => seconds,
        None => answer["timing_s"]
            .as_object()
            .expect("it has seconds or timing_s")
            .values()
            .filter_map(Value::as_f64)
            .sum(),
    };
    assert!(seconds > 0.0, "{seconds} s");
}

/// A test per command: where its result states the error.
macro_rules! every_answer_states_its_error_its_cost_and_what_was_left_out {
    ($($name:ident: $command:literal, $error:literal;)*) => {$(
        #[test]
        fn $name() {
            check($command, $error);
        }
    )*};
}

every_answer_states_its_error_its_cost_and_what_was_left_out! {
    fit: "fit SERIES/paper-rig-full", "/parameters/theta_r_deg/expanded";
    fit_of_two: "fit SERIES/paper-rig-full another-day", "/parameters/theta_r_deg/expanded";
    map: "map SERIES/paper-rig-full --out map", "/parameters/theta_r_deg/std_median";
    explain_map: "explain SERIES/paper-rig-full --map", "/tolerance";
    judge: "judge SERIES/paper-rig-full --spec SPEC", "/items/0/expanded";
    contrast_of_series: "contrast SERIES/paper-rig-full", "/model_error/value";
    contrast: "contrast", "/model_error/value";
    contrast_of_paper: "contrast --variant paper", "/model_error/value";
    contrast_by_quadrature: "contrast --variant quadrature --target-error 1e-3", "/model_error/value";
    optimize: "optimize --theta-c-deg 0", "/error/value";
    trace: "trace scene.toml", "/relative_error";
    trace_compare: "trace compare scene.toml --pixels 16 --error-max 10", "/angles/0/directions";
    ellipsometer: "trace ellipsometer scene.toml --angles-deg 40", "/angles/0/points/0";
    explain_scene: "explain scene.toml", "/tolerance";
    explain_series: "explain SERIES/paper-rig-full", "/tolerance";
    model_error: "model-error --theta-r-deg 10 --alpha 0.3 --paths 64", "/error/value";
    wear: "wear --rounds 0 --burrs --theta-r-min-deg 8 --theta-r-max-deg 10 --theta-r-step-deg 1 --paths 64", "/error/value";
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
