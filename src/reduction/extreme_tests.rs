//! The pixels' arithmetic at the ends: any counts and any camera that a manifest may state, then finite
//! observations or a refusal by name.

use std::sync::atomic::AtomicBool;

use proptest::prelude::*;

use super::reduce;
use super::synthetic::Memory;
use crate::extremes::{cases, wide};
use crate::frame::{Frame, FrameKind};
use crate::series::{FrameRow, Manifest};

/// A rig and camera as in the recorded series.
const MANIFEST: &str = include_str!("../../tests/data/series/polymer-10/manifest.toml");

/// Counts of a frame: black, full, anything, or a level with some noise.
fn counts(pixels: usize) -> impl Strategy<Value = Vec<u16>> {
    prop_oneof![
        Just(vec![0; pixels]),
        Just(vec![u16::MAX; pixels]),
        prop::collection::vec(any::<u16>(), pixels),
        (0..60_000u16).prop_flat_map(move |level| prop::collection::vec(
            (0..9u16).prop_map(move |n| level + n),
            pixels
        )),
    ]
}

/// Frames of a short scan: a dark, two flats, six poses; exposures in seconds.
fn series() -> impl Strategy<Value = Memory> {
    (1..5u32).prop_flat_map(|edge| {
        let pixels = (edge * edge) as usize;
        (
            prop::collection::vec(counts(pixels), 9),
            prop::collection::vec(wide(1e-9, 1e6), 9),
            wide(1e-9, 1e9),
            prop_oneof![Just(0.0), wide(1e-9, 1e9)],
            prop_oneof![Just(0.0), 0.0..70_000.0f64],
            prop_oneof![Just(None), (1.0..70_000.0f64).prop_map(Some)],
            wide(1e-6, 1.0),
        )
            .prop_map(
                move |(frames, exposures, gain, read, black, full, reflectance)| {
                    let mut manifest =
                        Manifest::from_toml(MANIFEST, "manifest.toml").expect("the program's own");
                    manifest.camera.width_px = edge;
                    manifest.camera.height_px = edge;
                    manifest.camera.gain_dn_per_electron = gain;
                    manifest.camera.read_noise_electrons_rms = Some(read);
                    manifest.camera.black_level_dn = Some(black);
                    if full.is_some() {
                        manifest.camera.saturation_dn = full;
                    }
                    if let Some(flat) = &mut manifest.flat {
                        flat.reflectance = Some(reflectance);
                    }
                    manifest.rig.rotation_axis_px = Some([f64::from(edge) / 2.0; 2]);
                    let kinds = |n: usize| match n {
                        0 => (FrameKind::Dark, 0.0, 0.0),
                        1 | 2 => (FrameKind::Flat, 10.0 * (n as f64 - 1.0), 0.0),
                        n => (FrameKind::Sample, 10.0 * ((n % 2) as f64), 60.0 * n as f64),
                    };
                    let rows = exposures.iter().enumerate().map(|(n, exposure_s)| {
                        let (kind, theta_c_deg, phi_s_deg) = kinds(n);
                        FrameRow {
                            file: format!("frames/{n}.png"),
                            kind,
                            theta_c_deg,
                            phi_s_deg,
                            exposure_s: *exposure_s,
                            repeat: 0,
                            timestamp: String::new(),
                        }
                    });
                    Memory {
                        rows: rows.collect(),
                        frames: frames
                            .into_iter()
                            .map(|f| Some(Frame::new(edge, edge, f).expect("a full frame")))
                            .collect(),
                        manifest,
                    }
                },
            )
    })
}

proptest! {
    #![proptest_config(cases(150))]

    #[test]
    fn any_frames_give_finite_observations_or_are_refused_by_name(series in series()) {
        match reduce(&series, None, &AtomicBool::new(false)) {
            Ok(set) => {
                let named = set.n_frames_used as usize + set.rejected_frames.len();
                prop_assert_eq!(named, series.rows.len(), "every frame is used or named");
                for o in &set.observations {
                    let numbers = [o.signal, o.sigma, o.shared.white_reference, o.shared.led_drift];
                    prop_assert!(numbers.iter().all(|x| x.is_finite()), "{o:?}");
                    prop_assert!(o.sigma > 0.0, "{o:?}");
                }
                for f in &set.flats {
                    prop_assert!(f.signal.is_finite() && f.sigma.is_finite() && f.sigma > 0.0, "{f:?}");
                }
                prop_assert!(set.background.mean.is_finite() && set.background.std.is_finite() && set.background.std >= 0.0, "{:?}", set.background);
            }
            Err(refusal) => prop_assert!(!refusal.to_string().is_empty()),
        }
    }
}
