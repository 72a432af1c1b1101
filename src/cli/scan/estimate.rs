//! `ridged scan --estimate`: what a scan would take, and what would prevent it. Nothing moves.

use anyhow::anyhow;
use serde_json::{Value, json};

use super::Args;
use crate::cli::{CliError, output};
use crate::wording::counted;

/// Prints the estimate of a scan, as the interface returns it, with what would prevent the scan now.
///
/// # Errors
/// No result where something prevents the scan.
pub(super) fn print(
    args: &Args,
    mut estimate: Value,
    mut prevented_by: Vec<String>,
) -> Result<(), CliError> {
    prevented_by.extend(no_room(&estimate));
    estimate["prevented_by"] = json!(prevented_by);
    output::write(args.json, &estimate, || text(&estimate))?;
    match prevented_by.is_empty() {
        true => Ok(()),
        false => Err(CliError::no_result(anyhow!(
            "the scan cannot begin now: {}",
            prevented_by.join("; ")
        ))),
    }
}

/// States that the frames have no room, as the start of the scan would.
fn no_room(estimate: &Value) -> Option<String> {
    let bytes = |key: &str| estimate[key].as_u64().unwrap_or_default();
    let (needed, reserve) = (bytes("disk_bytes"), bytes("disk_reserve_bytes"));
    let free = bytes("disk_free_bytes");
    (free < needed.saturating_add(reserve)).then(|| {
        format!(
            "the disk has {} MB free, and the frames need up to {} MB beside {} MB of reserve",
            free / 1_000_000,
            needed.div_ceil(1_000_000),
            reserve.div_ceil(1_000_000)
        )
    })
}

fn text(estimate: &Value) -> String {
    let count = |key: &str, noun: &str| {
        let count = estimate[key].as_u64().unwrap_or_default();
        counted(usize::try_from(count).unwrap_or(usize::MAX), noun)
    };
    let mb = |key: &str| {
        estimate[key]
            .as_u64()
            .unwrap_or_default()
            .div_ceil(1_000_000)
    };
    let minutes = estimate["duration_s"].as_f64().unwrap_or_default() / 60.0;
    let mut text = format!(
        "{}, {}\n\
         time      {minutes:.1} min of motion, settling and exposure, without the operator's time\n\
         disk      up to {} MB; {} MB are free, of which scans leave {} MB\n",
        count("n_shots", "point"),
        count("n_frames", "frame"),
        mb("disk_bytes"),
        mb("disk_free_bytes"),
        mb("disk_reserve_bytes"),
    );
    let steps = estimate["operator_steps"].as_array().into_iter().flatten();
    for step in steps {
        let message = step["message"].as_str().unwrap_or_default();
        text.push_str(&format!("operator  {message}\n"));
    }
    let reused = estimate["calibration_ids"].as_array();
    let reused: Vec<String> = reused.into_iter().flatten().map(Value::to_string).collect();
    if !reused.is_empty() {
        let ids = reused.join(", ");
        text.push_str(&format!("reuses    the frames of calibrations {ids}\n"));
    }
    if estimate["prevented_by"] == json!([]) {
        text.push_str("nothing prevents the scan\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_states_time_disk_and_steps_and_what_prevents_the_scan() {
        let args = |options: &[&str]| -> Args {
            let always = ["--preset", "paper", "--estimate"];
            crate::cli::parsed(&[&always[..], options].concat())
        };
        let estimate = |free: u64| {
            json!({
                "n_frames": 12, "n_shots": 1, "duration_s": 90.0, "disk_bytes": 24_000_000,
                "disk_free_bytes": free, "disk_reserve_bytes": 100_000_000,
                "operator_steps": [{"action": "cap-lens", "message": "cap the lens"}],
                "calibration_ids": [3, 4], "prevented_by": [],
            })
        };
        let roomy = text(&estimate(124_000_000));
        for part in [
            "1 point, 12 frames",
            "1.5 min of motion",
            "up to 24 MB; 124 MB are free",
            "operator  cap the lens",
            "calibrations 3, 4",
            "nothing prevents the scan",
        ] {
            assert!(roomy.contains(part), "{part}: {roomy}");
        }
        print(&args(&[]), estimate(124_000_000), Vec::new()).unwrap();
        let refused = |free, by| print(&args(&["--json"]), estimate(free), by).unwrap_err();
        let CliError::NoResult(full) = refused(123_999_999, Vec::new()) else {
            panic!("the disk is full");
        };
        assert!(
            full.to_string().contains("beside 100 MB of reserve"),
            "{full}"
        );
        let busy = refused(u64::MAX, vec!["scan 3 holds the rig".to_owned()]);
        assert!(matches!(busy, CliError::NoResult(_)));
        let adds = [
            "--preset",
            "paper",
            "--estimate",
            "--sample",
            "a",
            "--eta",
            "1.5",
        ];
        assert!(
            crate::cli::try_parsed::<Args>(&adds).is_err(),
            "it stores nothing"
        );
    }
}
