//! `ridged rig preview`: one frame per exposure at the present pose, its figures and its picture.

use std::path::PathBuf;

use anyhow::anyhow;
use serde_json::{Value, json};

use crate::cli::client::Client;
use crate::cli::{CliError, output_path};

/// Options of `rig preview`.
#[derive(Debug, Clone, clap::Args)]
pub struct PreviewArgs {
    /// Exposures in milliseconds, 1 to 8 [default: those of the settings].
    #[arg(long, num_args = 1.., value_delimiter = ',', value_name = "MS")]
    pub exposure_ms: Vec<f64>,
    /// Write the 8-bit picture of the longest exposure without saturated pixels (otherwise of the shortest) to a PNG file.
    #[arg(short, long, value_name = "FILE.png")]
    pub out: Option<PathBuf>,
    /// Switch the lamp off first (setting lamp.off).
    #[arg(long)]
    pub lamp_off: bool,
    /// Do not search for exposures for a scan.
    #[arg(long)]
    pub no_suggestion: bool,
}

/// Takes the preview, writes the picture, and returns the daemon's answer.
pub(super) fn run(client: &Client, args: &PreviewArgs) -> Result<Value, CliError> {
    if let Some(file) = &args.out {
        output_path::check_file(file)?;
    }
    let mut body = json!({ "lamp": !args.lamp_off });
    if !args.exposure_ms.is_empty() {
        let seconds: Vec<f64> = args.exposure_ms.iter().map(|ms| ms / 1000.0).collect();
        body["exposures_s"] = json!(seconds);
    }
    if args.no_suggestion {
        body["suggest"] = json!(0);
    }
    let answer = client.post_patiently("/rig/preview", &body)?;
    if let Some(file) = &args.out {
        let path = shown(&answer).and_then(|frame| frame["image"]["path"].as_str());
        let path = path.and_then(|path| path.strip_prefix("/api/v1"));
        let path = path.ok_or_else(|| CliError::no_result(anyhow!("the answer has no picture")))?;
        let picture = client.download(path)?;
        std::fs::write(file, picture).map_err(|error| {
            CliError::no_result(anyhow!("cannot write {}: {error}", file.display()))
        })?;
    }
    Ok(answer)
}

/// The frame whose picture is written.
fn shown(answer: &Value) -> Option<&Value> {
    let frames = answer["frames"].as_array()?;
    let exposure = |frame: &&Value| frame["exposure_s"].as_f64().unwrap_or_default();
    let by_exposure = |a: &&Value, b: &&Value| exposure(a).total_cmp(&exposure(b));
    let fine = frames.iter().filter(|frame| frame["saturated_px"] == 0);
    fine.max_by(by_exposure)
        .or_else(|| frames.iter().min_by(by_exposure))
}

/// Returns the figures for people.
pub(super) fn words(args: &PreviewArgs, answer: &Value) -> String {
    let number = |value: &Value| value.as_f64().unwrap_or_default();
    let pose = match answer["referenced"] == true {
        true => format!(
            "θc {:.3}°, φs {:.3}°",
            number(&answer["theta_c_deg"]),
            number(&answer["phi_s_deg"])
        ),
        false => "position unknown: the axes are not homed".to_owned(),
    };
    let lamp = if answer["lamp"] == true { "on" } else { "off" };
    let mut text = format!(
        "{pose}; lamp {lamp}\n{:>12} {:>8} {:>8} {:>8} {:>10} {:>8} {:>8}\n{:>12} {:>8} {:>8} {:>8} {:>10} {:>8} {:>8}\n",
        "exposure",
        "min",
        "median",
        "max",
        "saturated",
        "defects",
        "focus",
        "ms",
        "DN",
        "DN",
        "DN",
        "px",
        "px",
        "%/px",
    );
    for frame in answer["frames"].as_array().into_iter().flatten() {
        let focus = match frame["focus"].as_f64() {
            Some(focus) => format!("{:.3}", 100.0 * focus),
            None => "–".into(),
        };
        text.push_str(&format!(
            "{:>12} {:>8} {:>8} {:>8} {:>10} {:>8} {:>8}\n",
            in_ms(&frame["exposure_s"]),
            // The width has no effect on a JSON value.
            frame["min_dn"].to_string(),
            frame["median_dn"].to_string(),
            frame["max_dn"].to_string(),
            frame["saturated_px"].to_string(),
            frame["defect_px"].to_string(),
            focus
        ));
    }
    let suggestion = &answer["suggestion"];
    let exposures = suggestion["exposures_s"].as_array();
    let listed: Vec<String> = exposures.into_iter().flatten().map(in_ms).collect();
    if !listed.is_empty() {
        text.push_str(&format!(
            "exposures for a scan from this pose: {} ms\n",
            listed.join(", ")
        ));
    } else if !suggestion.is_null() {
        text.push_str("no suggestion of exposures\n");
    }
    if let Some(reason) = suggestion["reason"].as_str() {
        text.push_str(&format!("{reason}\n"));
    }
    if let (Some(file), Some(frame)) = (&args.out, shown(answer)) {
        text.push_str(&format!(
            "picture of {} ms written to {}\n",
            in_ms(&frame["exposure_s"]),
            file.display()
        ));
    }
    text
}

/// Milliseconds to the microsecond, without needless zeros.
fn in_ms(exposure_s: &Value) -> String {
    let us = (exposure_s.as_f64().unwrap_or_default() * 1e6).round();
    format!("{}", us / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_names_units_and_the_picture_is_the_best_exposure() {
        let frame = |exposure_s: f64, saturated: u32| {
            json!({
                "exposure_s": exposure_s, "min_dn": 190, "median_dn": 8000, "max_dn": 9000, "saturated_px": saturated,
                "defect_px": 5, "focus": if saturated > 0 { Value::Null } else { json!(0.0123) },
            })
        };
        let answer = json!({
            "theta_c_deg": 0.0, "phi_s_deg": 90.0, "referenced": true, "lamp": true,
            "frames": [frame(0.02, 0), frame(0.06, 0), frame(5.0, 12)],
            "suggestion": { "exposures_s": [0.058, 0.17], "reason": null },
        });
        let args = PreviewArgs {
            exposure_ms: Vec::new(),
            out: Some("look.png".into()),
            lamp_off: false,
            no_suggestion: false,
        };
        let text = words(&args, &answer);
        for part in [
            "θc 0.000°, φs 90.000°; lamp on",
            "          60      190     8000     9000          0        5    1.230\n",
            "exposures for a scan from this pose: 58, 170 ms",
            "picture of 60 ms written to look.png",
        ] {
            assert!(text.contains(part), "{part} is not in:\n{text}");
        }
        assert!(
            text.lines().all(|line| line.chars().count() <= 80),
            "{text}"
        );
    }

    #[test]
    fn a_reason_takes_the_place_of_a_suggestion() {
        let answer = json!({
            "theta_c_deg": 0.0, "phi_s_deg": 0.0, "referenced": false, "lamp": false, "frames": [],
            "suggestion": { "exposures_s": [], "reason": "there is no light" },
        });
        let args = PreviewArgs {
            exposure_ms: Vec::new(),
            out: None,
            lamp_off: true,
            no_suggestion: false,
        };
        let text = words(&args, &answer);
        assert!(text.contains("not homed; lamp off"), "{text}");
        assert!(
            text.ends_with("no suggestion of exposures\nthere is no light\n"),
            "{text}"
        );
    }
}
