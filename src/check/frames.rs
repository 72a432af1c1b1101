//! Frames that carry nothing: they must be refused by name, and never become observations.

use std::sync::atomic::AtomicBool;

use super::criterion::{one_of, refused};
use super::fits::{HOPELESS, claim, fitted_in_full};
use super::{Effort, Row};
use crate::fit::loss::Loss;
use crate::frame::{Frame, FrameKind};
use crate::reduction::{FrameReadError, FrameSource, reduce};
use crate::series::{FrameRow, Manifest};

/// A rig and camera as in the recorded series.
const MANIFEST: &str = include_str!("../../tests/data/series/polymer-10/manifest.toml");

/// A small series in memory whose frames are all of one grey per kind.
struct Grey {
    manifest: Manifest,
    rows: Vec<FrameRow>,
    dark_dn: u16,
    flat_dn: u16,
    sample_dn: u16,
}

impl Grey {
    fn new(edge: u32, dark_dn: u16, flat_dn: u16, sample_dn: u16) -> Self {
        let mut manifest = Manifest::from_toml(MANIFEST, "manifest.toml")
            .expect("the program's own manifest is right");
        manifest.camera.width_px = edge;
        manifest.camera.height_px = edge;
        manifest.rig.rotation_axis_px = Some([f64::from(edge) / 2.0; 2]);
        let mut rows = Vec::new();
        let mut take = |kind: FrameKind, theta_c_deg: f64, phi_s_deg: f64| {
            let n = rows.len();
            rows.push(FrameRow {
                file: format!("frames/{n}.png"),
                kind,
                theta_c_deg,
                phi_s_deg,
                exposure_s: 0.02,
                repeat: 0,
                timestamp: String::new(),
            });
        };
        take(FrameKind::Dark, 0.0, 0.0);
        for tilt in [-10.0, 0.0, 10.0] {
            take(FrameKind::Flat, tilt, 0.0);
            for turn in [0.0, 90.0, 180.0, 270.0] {
                take(FrameKind::Sample, tilt, turn);
            }
        }
        Grey {
            manifest,
            rows,
            dark_dn,
            flat_dn,
            sample_dn,
        }
    }

    fn reduced(&self) -> Result<String, String> {
        reduce(self, None, &AtomicBool::new(false))
            .map(|set| {
                let left_out = set.rejected_frames.iter();
                let why: Vec<String> = left_out
                    .map(|r| format!("; {} {}", r.reason, r.detail))
                    .collect();
                format!("{} observations{}", set.observations.len(), why.concat())
            })
            .map_err(|e| e.to_string())
    }
}

impl FrameSource for Grey {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let dn = match self.rows[index].kind {
            FrameKind::Dark => self.dark_dn,
            FrameKind::Flat => self.flat_dn,
            FrameKind::Sample => self.sample_dn,
        };
        // A few counts of noise: frames without any are taken for what a stuck camera sends.
        let noise = |pixel: u32| {
            let mixed =
                (pixel + 1).wrapping_mul(2_654_435_761) ^ (index as u32 + 1).wrapping_mul(40_503);
            (mixed >> 7) as u16 % 9
        };
        let (w, h) = (
            self.manifest.camera.width_px,
            self.manifest.camera.height_px,
        );
        let pixels = (0..w * h).map(|p| dn.saturating_add(noise(p))).collect();
        Ok(Frame::new(w, h, pixels).expect("a full frame"))
    }
}

const AREA: &str = "frames";

pub(super) fn rows(_: Effort, cancel: &AtomicBool) -> Vec<Row> {
    let black = 200;
    let full = u16::MAX;
    let source = "no such answer";
    let mut rows = Vec::new();
    for (name, grey, word) in [
        (
            "all sample frames saturated",
            Grey::new(8, black, 20_000, full),
            "saturated",
        ),
        (
            "single-pixel frames, all saturated",
            Grey::new(1, black, 20_000, full),
            "saturated",
        ),
        ("everything is 0", Grey::new(8, 0, 0, 0), "no observation"),
    ] {
        let judged = refused(word, &grey.reduced());
        rows.push(Row::new(AREA, name, "observations", source, judged));
    }
    // A sample that reflects nothing has observations, but nothing may be read from them.
    let claim = reduce(&Grey::new(8, black, 20_000, black), None, cancel).map_or_else(
        |e| e.to_string(),
        |set| claim(&fitted_in_full(&set, Loss::Linear, cancel)),
    );
    let judged = one_of(&HOPELESS, &claim);
    rows.push(Row::new(
        AREA,
        "sample frames as black as the darks",
        "claim",
        source,
        judged,
    ));
    let reference = reduce(&Grey::new(8, black, full, 20_000), None, cancel).map_or_else(
        |e| e.to_string(),
        |set| match set.white_reference {
            Some(_) => "a white reference".to_owned(),
            None => "none".to_owned(),
        },
    );
    let judged = one_of(&["none"], &reference);
    rows.push(Row::new(
        AREA,
        "all flats saturated",
        "white reference",
        source,
        judged,
    ));
    // A single pixel of one grey is a frame like any other: 12 poses, 12 observations.
    let told = Grey::new(1, black, 20_000, 10_000)
        .reduced()
        .unwrap_or_else(|e| e);
    let judged = one_of(&["12 observations"], &told);
    rows.push(Row::new(
        AREA,
        "single-pixel frames",
        "observations",
        "one per pose",
        judged,
    ));
    rows
}
