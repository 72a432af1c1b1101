//! Fits that the command line keeps in the store, without a daemon.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// Runs a command in a folder with the usual log.
fn run(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ridged"))
        .args(args)
        .current_dir(folder)
        .env_remove("RIDGED_LOG")
        .output()
        .unwrap()
}

/// Runs a command that succeeds, and returns its stdout and its stderr.
fn done(folder: &Path, args: &[&str]) -> (String, String) {
    let output = run(folder, args);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let (out, err) = (text(output.stdout), text(output.stderr));
    assert!(output.status.success(), "{args:?}: {out}{err}");
    (out, err)
}

/// The rows of `ridged results`.
fn results(folder: &Path) -> Vec<Value> {
    let (out, _) = done(folder, &["results", "--json"]);
    let listed: Value = serde_json::from_str(&out).unwrap();
    listed["items"].as_array().unwrap().clone()
}

#[test]
fn a_fit_of_an_imported_series_is_stored_on_request_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let series = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
    done(folder, &["import", series.to_str().unwrap()]);
    let fit = ["fit", "--scan", "1", "--fix", "rho_d=0.3", "--json"];
    done(folder, &fit);
    assert_eq!(results(folder)[0]["theta_r_deg"], Value::Null);
    let refused = run(folder, &["report", "--scan", "1", "--out", "report.html"]);
    let why = String::from_utf8(refused.stderr).unwrap();
    assert!(why.contains("ridged fit --scan 1 --store"), "{why}");

    let (out, err) = done(folder, &[&fit[..], &["--store"]].concat());
    assert!(err.contains("stored as fit 1 of scan 1"), "{err}");
    let fit: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(
        (&fit["id"], &fit["scan_id"]),
        (&Value::from(1), &Value::from(1))
    );
    // The option was used, and the row has the value that was printed.
    let rho_d = &fit["parameters"]["rho_d"];
    assert!(
        (rho_d["value"].as_f64().unwrap() - 0.3).abs() < 1e-9,
        "{rho_d}"
    );
    let angle = fit["parameters"]["theta_r_deg"]["value"].as_f64().unwrap();
    let row = &results(folder)[0];
    assert!(
        (row["theta_r_deg"].as_f64().unwrap() - angle).abs() < 1e-2,
        "{row}"
    );
    assert_eq!(row["fit_id"], Value::from(1));
    done(folder, &["report", "--scan", "1", "--out", "report.html"]);
    // A wrong folder stays no store.
    let nowhere = run(
        folder,
        &["fit", "--scan", "1", "--store", "--data", "elsewhere"],
    );
    assert_eq!(nowhere.status.code(), Some(2));
    assert!(!folder.join("elsewhere").exists());
}

/// A scan on a simulated rig, without a daemon.
const SCAN: [&str; 6] = [
    "scan",
    "--preset",
    "paper",
    "--simulated-rig",
    "--time-scale",
    "1000",
];

#[test]
fn a_scan_without_a_daemon_is_fitted_and_its_fit_is_stored() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (out, err) = done(folder, &[&SCAN[..], &["--json"]].concat());
    let scan: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(scan["state"], "completed");
    assert!(err.contains("fit 1: θr = "), "{err}");
    // The log has neither the events of the rig nor complaints about the end of the store.
    assert!(!err.contains("INFO") && !err.contains("WARN"), "{err}");
    let row = &results(folder)[0];
    assert!(row["theta_r_deg"].is_number(), "{row}");
}

#[test]
fn a_scan_without_a_daemon_is_not_fitted_where_the_setting_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("rig.toml"), "[scan]\nfit_at_end = false\n").unwrap();
    let (_, err) = done(folder, &[&SCAN[..], &["--config", "rig.toml"]].concat());
    assert!(
        err.contains("to fit it: ridged fit --scan 1 --store"),
        "{err}"
    );
    let row = &results(folder)[0];
    assert_eq!(row["theta_r_deg"], Value::Null, "{row}");
}
