//! Frames without information: they must be refused with the reason, and never become observations.

use std::sync::atomic::AtomicBool;

use super::criterion::{one_of, refused};
use super::fits::{HOPELESS, claim, fitted_in_full};
use super::{CheckEffort, CheckRow};
use crate::cases::{MemorySeries, POLYMER_10};
use crate::fit::loss::Loss;
use crate::frame::FrameKind;
use crate::reduction::reduce;

const AREA: &str = "frames";

/// A small series whose frames have one grey value per kind. A few counts of noise are added, because frames without any
/// are rejected as those of a stuck camera.
fn grey(edge_px: u32, dark_dn: u16, flat_dn: u16, sample_dn: u16) -> MemorySeries {
    let mut manifest = POLYMER_10.manifest();
    manifest.camera.width_px = edge_px;
    manifest.camera.height_px = edge_px;
    manifest.rig.rotation_axis_px = Some([f64::from(edge_px) / 2.0; 2]);
    let mut series = MemorySeries::new(manifest);
    let exposure_s = 0.02;
    series.take(FrameKind::Dark, 0.0, 0.0, exposure_s);
    for tilt_deg in [-10.0, 0.0, 10.0] {
        series.take(FrameKind::Flat, tilt_deg, 0.0, exposure_s);
        for azimuth_deg in [0.0, 90.0, 180.0, 270.0] {
            series.take(FrameKind::Sample, tilt_deg, azimuth_deg, exposure_s);
        }
    }
    series.expose(|index, row, pixel| {
        let level_dn = match row.kind {
            FrameKind::Dark => dark_dn,
            FrameKind::Flat => flat_dn,
            FrameKind::Sample => sample_dn,
        };
        let mixed =
            (pixel + 1).wrapping_mul(2_654_435_761) ^ (index as u32 + 1).wrapping_mul(40_503);
        level_dn.saturating_add((mixed >> 7) as u16 % 9)
    });
    series
}

fn reduced(series: &MemorySeries) -> Result<String, String> {
    reduce(series, None, &AtomicBool::new(false))
        .map(|set| {
            let rejected = set.rejected_frames.iter();
            let reasons: Vec<String> = rejected
                .map(|r| format!("; {} {}", r.reason, r.detail))
                .collect();
            format!(
                "{} observations{}",
                set.observations.len(),
                reasons.concat()
            )
        })
        .map_err(|e| e.to_string())
}

pub(super) fn rows(_: CheckEffort, cancel: &AtomicBool) -> Vec<CheckRow> {
    let black = 200;
    let full = u16::MAX;
    let source = "no value is possible";
    let mut rows = Vec::new();
    for (name, series, word) in [
        (
            "all sample frames saturated",
            grey(8, black, 20_000, full),
            "saturated",
        ),
        (
            "single-pixel frames, all saturated",
            grey(1, black, 20_000, full),
            "saturated",
        ),
        ("everything is 0", grey(8, 0, 0, 0), "no observation"),
    ] {
        let judged = refused(word, &reduced(&series));
        rows.push(CheckRow::new(AREA, name, "observations", source, judged));
    }
    // A black sample has observations, but a fit of them must give no value.
    let claim = reduce(&grey(8, black, 20_000, black), None, cancel).map_or_else(
        |e| e.to_string(),
        |set| claim(&fitted_in_full(&set, Loss::Linear, cancel)),
    );
    let judged = one_of(&HOPELESS, &claim);
    rows.push(CheckRow::new(
        AREA,
        "sample frames as black as the darks",
        "claim",
        source,
        judged,
    ));
    let reference = reduce(&grey(8, black, full, 20_000), None, cancel).map_or_else(
        |e| e.to_string(),
        |set| match set.white_reference {
            Some(_) => "a white reference".to_owned(),
            None => "none".to_owned(),
        },
    );
    let judged = one_of(&["none"], &reference);
    rows.push(CheckRow::new(
        AREA,
        "all flats saturated",
        "white reference",
        source,
        judged,
    ));
    // Single-pixel frames are valid: 12 poses, 12 observations.
    let found = reduced(&grey(1, black, 20_000, 10_000)).unwrap_or_else(|e| e);
    let judged = one_of(&["12 observations"], &found);
    rows.push(CheckRow::new(
        AREA,
        "single-pixel frames",
        "observations",
        "one per pose",
        judged,
    ));
    rows
}
