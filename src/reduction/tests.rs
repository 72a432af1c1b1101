//! Claims about the whole reduction: recorded series against their true radiances, spoilt frames
//! one by one; made frames whose truth is known (`made`), and a board that lies elsewhere (`board`).

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use super::synthetic::{Made, Memory};
use super::{FrameSource, ReductionError, reduce};
use crate::frame::{Frame, FrameKind};
use crate::observation::{Observation, ObservationSet};
use crate::series::Series;

mod board;
mod curve;
mod made;
mod once;

fn recorded(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/series")
        .join(name)
}

fn polymer() -> &'static Memory {
    static SERIES: OnceLock<Memory> = OnceLock::new();
    SERIES.get_or_init(|| Memory::of(&Series::open(&recorded("polymer-10")).unwrap()))
}

#[test]
fn readings_that_jitter_about_a_pose_are_one_observation() {
    let straight = polymer_part();
    let mut shaken = straight.clone();
    for (n, row) in shaken.rows.iter_mut().enumerate() {
        let off = if n % 2 == 0 { 0.003 } else { -0.003 };
        row.theta_c_deg += off;
        row.phi_s_deg -= off;
    }
    let of = |series: &Memory| reduce(series, None, &AtomicBool::new(false)).unwrap();
    let (straight, shaken) = (of(straight), of(&shaken));
    assert_eq!(straight.observations.len(), shaken.observations.len());
    for (a, b) in straight.observations.iter().zip(&shaken.observations) {
        assert_eq!(a.n_frames, b.n_frames);
        assert!((a.pose.theta_c - b.pose.theta_c).deg().abs() < 0.0031);
        assert!((a.pose.phi_s - b.pose.phi_s).wrapped().deg().abs() < 0.0031);
        assert!((a.signal / b.signal - 1.0).abs() < 1e-6);
    }
}

/// Three of its nine tilts, 80 × 80 pixels of the middle, for tests that reduce it many times.
fn polymer_part() -> &'static Memory {
    const EDGE: usize = 80;
    static SERIES: OnceLock<Memory> = OnceLock::new();
    SERIES.get_or_init(|| {
        let whole = polymer();
        let mut part = Memory {
            manifest: whole.manifest.clone(),
            rows: Vec::new(),
            frames: Vec::new(),
        };
        part.manifest.camera.width_px = EDGE as u32;
        part.manifest.camera.height_px = EDGE as u32;
        for (row, frame) in whole.rows.iter().zip(&whole.frames) {
            if row.kind == FrameKind::Sample && ![-20.0, 5.0, 10.0].contains(&row.theta_c_deg) {
                continue;
            }
            let pixels = frame.as_ref().unwrap().pixels_dn();
            let middle = (24..24 + EDGE)
                .flat_map(|r| pixels[r * 128 + 24..r * 128 + 24 + EDGE].to_vec())
                .collect();
            part.rows.push(row.clone());
            part.frames
                .push(Some(Frame::new(EDGE as u32, EDGE as u32, middle).unwrap()));
        }
        part
    })
}

fn checker() -> &'static Memory {
    static SERIES: OnceLock<Memory> = OnceLock::new();
    SERIES.get_or_init(|| Memory::of(&Series::open(&recorded("checker")).unwrap()))
}

fn reduced(source: &dyn FrameSource, region: Option<&str>) -> ObservationSet {
    reduce(source, region, &AtomicBool::new(false)).unwrap()
}

type Truth = HashMap<(i64, i64), f64>;

fn truth(name: &str, region: &str) -> Truth {
    let mut reader = csv::Reader::from_path(recorded(name).join("radiance.csv")).unwrap();
    let records = reader.records().map(Result::unwrap);
    records
        .filter(|r| &r[2] == region)
        .map(|r| {
            let f = |i: usize| r[i].parse::<f64>().unwrap();
            ((f(0).round() as i64, f(1).round() as i64), f(3))
        })
        .collect()
}

fn key(o: &Observation) -> (i64, i64) {
    (
        o.pose.theta_c.deg().round() as i64,
        o.pose.phi_s.deg().round() as i64,
    )
}

/// Deviations from the truth in standard uncertainties. The frames were made from the very
/// radiances of the table, so the renderer's own error is in both and does not count.
fn deviations(set: &ObservationSet, truth: &Truth) -> Vec<f64> {
    set.observations
        .iter()
        .map(|o| (o.signal - truth[&key(o)]) / o.sigma)
        .collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn reasons(set: &ObservationSet) -> HashMap<String, String> {
    let rejected = set.rejected_frames.iter();
    rejected
        .map(|r| (r.file.clone(), r.reason.clone()))
        .collect()
}

#[test]
fn recorded_series_give_their_true_radiances_within_their_uncertainty() {
    // Single deviations within k = 5; their rms near 1: uncertainties neither too small nor padded.
    // What all observations share (the flats' own noise) may add to the rms, hence 1.6.
    for (name, region, column, poses) in [
        ("polymer-10", None, "all", 108),
        ("steel-15", None, "all", 108),
        ("paper-rig-full", None, "all", 48),
        ("checker", Some("even"), "even", 24),
        ("checker", Some("odd"), "odd", 24),
        ("checker", Some("patch-1-2"), "worn", 24),
    ] {
        let series = Series::open(&recorded(name)).unwrap();
        let set = reduced(&series, region);
        assert_eq!(set.observations.len(), poses, "{name}");
        let z = deviations(&set, &truth(name, column));
        let worst = z.iter().fold(0.0_f64, |a, z| a.max(z.abs()));
        assert!(worst < 5.0, "{name} {region:?}: {worst}");
        assert!(
            (0.5..1.6).contains(&rms(&z)),
            "{name} {region:?}: {}",
            rms(&z)
        );
        assert_eq!(
            set.n_frames_used as usize + set.rejected_frames.len(),
            series.rows().len()
        );
        assert!(set.rejected_frames.iter().all(|r| r.reason == "saturated"));
    }
}

#[test]
fn the_flats_come_out_as_the_lambertian_reference() {
    let set = reduced(polymer(), None);
    assert_eq!(set.flats.len(), 9);
    let white = set.white_reference.unwrap();
    for flat in &set.flats {
        let due = white.reflectance / std::f64::consts::PI * set.rig.cos_incidence(flat.theta_c);
        assert!((flat.signal - due).abs() < 5.0 * flat.sigma, "{flat:?}");
        assert!(flat.sigma < 1e-4 * due);
    }
}

#[test]
fn a_worn_patch_is_left_out_by_name_and_the_others_are_not() {
    let odd = reduced(checker(), Some("odd"));
    let named: Vec<&String> = odd
        .warnings
        .iter()
        .filter(|w| w.contains("patch-"))
        .collect();
    assert_eq!(named.len(), 1, "{:?}", odd.warnings);
    assert!(named[0].starts_with("patch-1-2 "));
    assert!((odd.region_azimuth.deg() - 90.0).abs() < 1e-12);
    let even = reduced(checker(), Some("even"));
    // But for what is assumed of the rig.
    assert!(
        even.warnings.iter().all(|w| w.contains("states no [rig]")),
        "{:?}",
        even.warnings
    );
    assert!(even.region_azimuth.deg().abs() < 1e-12);
}

#[test]
fn a_board_asks_for_its_region_and_knows_their_names() {
    let never = AtomicBool::new(false);
    match reduce(checker(), None, &never) {
        Err(ReductionError::RegionNeeded { available }) => assert_eq!(available.len(), 18),
        other => panic!("{other:?}"),
    }
    for (source, name) in [(checker(), "patch-9-9"), (polymer(), "even")] {
        assert!(matches!(
            reduce(source, Some(name), &never),
            Err(ReductionError::UnknownRegion { .. })
        ));
    }
}

fn roll(pixels: &mut Vec<u16>, columns: i32, rows: i32) {
    let edge = (pixels.len() as f64).sqrt() as i32;
    *pixels = (0..edge * edge)
        .map(|i| {
            let column = (i % edge - columns).rem_euclid(edge);
            let row = (i / edge - rows).rem_euclid(edge);
            pixels[(row * edge + column) as usize]
        })
        .collect();
}

#[test]
fn each_spoilt_frame_is_rejected_by_name_and_changes_nothing_else() {
    const FILE: &str = "frames/sample_tc+05_ps030_e1_r0.png";
    type Spoil = fn(&mut Memory);
    let cases: [(&str, Spoil); 13] = [
        ("black", |m| m.edit(FILE, |p| p.fill(0))),
        ("black", |m| m.edit(FILE, |p| p.fill(200))),
        ("black", |m| {
            let dark = m.index_of("dark_e1_r2");
            let noise = m.frames[dark].clone().unwrap();
            m.edit(FILE, |p| {
                // A new dark frame: the same noise mirrored about the level, so no copy.
                p.copy_from_slice(noise.pixels_dn());
                p.iter_mut()
                    .step_by(3)
                    .for_each(|dn| *dn = 404 - (*dn).min(404));
            });
        }),
        ("saturated", |m| m.edit(FILE, |p| p.fill(65535))),
        ("partly saturated", |m| {
            m.edit(FILE, |p| p[2000..3000].fill(65535))
        }),
        ("constant", |m| m.edit(FILE, |p| p.fill(30_000))),
        ("torn", |m| m.edit(FILE, |p| p[4000..].fill(0))),
        ("shifted", |m| m.edit(FILE, |p| roll(p, 3, -2))),
        ("shifted", |m| m.edit(FILE, |p| roll(p, 0, 1))),
        ("shifted", |m| m.edit(FILE, |p| p.reverse())),
        ("level", |m| {
            m.edit(FILE, |p| {
                p.iter_mut()
                    .for_each(|dn| *dn = (f64::from(*dn) * 1.25) as u16)
            });
        }),
        ("unreadable", |m| {
            let at = m.index_of(FILE);
            m.frames[at] = None;
        }),
        ("wrong size", |m| {
            let at = m.index_of(FILE);
            m.frames[at] = Some(Frame::new(64, 64, vec![9000; 64 * 64]).unwrap());
        }),
    ];
    let before = reduced(polymer_part(), None);
    let truth = truth("polymer-10", "all");
    for (reason, spoil) in cases {
        let mut series = polymer_part().clone();
        spoil(&mut series);
        let after = reduced(&series, None);
        let mut expected = reasons(&before);
        expected.insert(FILE.to_owned(), reason.to_owned());
        assert_eq!(reasons(&after), expected, "{reason}");
        for (a, b) in before.observations.iter().zip(&after.observations) {
            assert_eq!(a.pose, b.pose);
            if key(a) == (5, 30) {
                assert_eq!(b.n_frames, a.n_frames - 1, "{reason}");
                assert!(
                    (b.signal - truth[&key(b)]).abs() < 5.0 * b.sigma,
                    "{reason}"
                );
            } else {
                assert!((a.signal - b.signal).abs() < 1e-12, "{reason}");
            }
        }
    }
}

#[test]
fn dark_frames_brighter_than_the_sample_are_named() {
    let mean = |frame: &Option<Frame>| {
        let counts = frame.as_ref().unwrap().pixels_dn();
        counts.iter().map(|dn| f64::from(*dn)).sum::<f64>() / counts.len() as f64
    };
    let frames = polymer_part().rows.iter().zip(&polymer_part().frames);
    let samples = frames.filter(|(row, _)| row.kind == FrameKind::Sample);
    let mut means: Vec<f64> = samples.map(|(_, frame)| mean(frame)).collect();
    means.sort_by(f64::total_cmp);
    let light = means[means.len() * 3 / 4] as u16;
    let mut series = polymer_part().clone();
    for (row, frame) in series.rows.iter().zip(&mut series.frames) {
        if row.kind == FrameKind::Dark {
            let lit = frame.as_ref().unwrap().pixels_dn();
            let lit = lit.iter().map(|dn| dn.saturating_add(light)).collect();
            *frame = Some(Frame::new(80, 80, lit).unwrap());
        }
    }
    let named = |series: &Memory| match reduce(series, None, &AtomicBool::new(false)) {
        Ok(set) => set.warnings.join("\n"),
        Err(error) => error.to_string(),
    };
    let text = named(&series);
    assert!(text.contains("darker than the dark frames"), "{text}");
    assert!(!named(polymer_part()).contains("dark frames"));
}

#[test]
fn a_stale_frame_is_found_whichever_of_the_two_came_first() {
    let before = reduced(polymer_part(), None);
    for (stale, original) in [
        (
            "sample_tc+05_ps030_e1_r0.png",
            "sample_tc-20_ps180_e1_r0.png",
        ),
        (
            "sample_tc-20_ps180_e1_r0.png",
            "sample_tc+05_ps030_e1_r0.png",
        ),
        (
            "sample_tc+10_ps090_e0_r0.png",
            "sample_tc+10_ps060_e0_r0.png",
        ),
    ] {
        let mut series = polymer_part().clone();
        let from = series.index_of(original);
        let to = series.index_of(stale);
        series.frames[to] = series.frames[from].clone();
        let set = reduced(&series, None);
        let found = reasons(&set);
        assert!(
            found.contains_key(&format!("frames/{stale}")),
            "{stale}: {found:?}"
        );
        assert_eq!(
            found.len(),
            before.rejected_frames.len() + 1,
            "{stale}: {found:?}"
        );
    }
}

#[test]
fn spoilt_darks_and_flats_are_rejected_too() {
    type Spoil = fn(&mut Memory);
    let cases: [(&str, &str, Spoil); 6] = [
        ("dark_e1_r1", "level", |m| {
            m.edit("dark_e1_r1", |p| p.iter_mut().for_each(|dn| *dn += 60));
        }),
        ("dark_e1_r1", "saturated", |m| {
            m.edit("dark_e1_r1", |p| p.fill(65535))
        }),
        ("dark_e1_r1", "black", |m| {
            m.edit("dark_e1_r1", |p| p.fill(0))
        }),
        ("flat_tc+05_ps000_e0", "shifted", |m| {
            m.edit("flat_tc+05_ps000_e0", |p| roll(p, 2, 2));
        }),
        ("flat_tc+05_ps000_e0", "level", |m| {
            m.edit("flat_tc+05_ps000_e0", |p| {
                p.iter_mut().for_each(|dn| *dn = *dn / 10 * 9)
            });
        }),
        ("flat_tc+05_ps000_e0", "black", |m| {
            m.edit("flat_tc+05_ps000_e0", |p| {
                p.iter_mut().for_each(|dn| *dn = 190 + *dn % 21)
            });
        }),
    ];
    let before = reduced(polymer_part(), None);
    for (file, reason, spoil) in cases {
        let mut series = polymer_part().clone();
        spoil(&mut series);
        let after = reduced(&series, None);
        let name = &series.rows[series.index_of(file)].file;
        assert_eq!(
            reasons(&after).get(name).map(String::as_str),
            Some(reason),
            "{file}"
        );
        assert_eq!(
            after.rejected_frames.len(),
            before.rejected_frames.len() + 1
        );
        for (a, b) in before.observations.iter().zip(&after.observations) {
            assert!(
                (a.signal - b.signal).abs() < 3e-4 * a.signal,
                "{file} {reason}"
            );
        }
    }
}

#[test]
fn the_order_of_the_list_does_not_matter() {
    let mut series = polymer().clone();
    series.rows.reverse();
    series.frames.reverse();
    let a = reduced(polymer(), None);
    let b = reduced(&series, None);
    assert_eq!(a.rejected_frames, b.rejected_frames);
    for (a, b) in a.observations.iter().zip(&b.observations) {
        assert_eq!(a.pose, b.pose);
        assert!((a.signal - b.signal).abs() < 1e-12 && (a.sigma - b.sigma).abs() < 1e-12);
    }
}

#[test]
fn times_that_cannot_be_read_are_reported_and_missing_ones_are_not() {
    let warned = |timestamp: &str| {
        let mut series = polymer().clone();
        series.rows[3].timestamp = timestamp.to_owned();
        series.rows[5].timestamp = timestamp.to_owned();
        let file = series.rows[3].file.clone();
        let all = reduced(&series, None).warnings;
        let of_times = all.into_iter().filter(move |w| w.contains(&file));
        of_times.collect::<Vec<String>>()
    };
    let reported = warned("yesterday");
    assert!(
        reported.len() == 1
            && reported[0].contains("2 frames")
            && reported[0].contains("yesterday"),
        "{reported:?}"
    );
    assert!(warned("").is_empty());
}

#[test]
fn without_a_white_reference_the_scale_is_relative() {
    let mut bare = polymer().clone();
    let keep: Vec<bool> = bare
        .rows
        .iter()
        .map(|r| r.kind != FrameKind::Flat)
        .collect();
    let mut at = keep.iter();
    bare.rows.retain(|_| *at.next().unwrap());
    let mut at = keep.iter();
    bare.frames.retain(|_| *at.next().unwrap());
    let mut unstated = polymer().clone();
    unstated.manifest.flat = None;
    let absolute = reduced(polymer(), None);
    let peak = absolute
        .observations
        .iter()
        .map(|o| o.signal)
        .fold(0.0, f64::max);
    for series in [bare, unstated] {
        let set = reduced(&series, None);
        assert!(set.white_reference.is_none() && set.flats.is_empty());
        assert!(set.warnings.iter().any(|w| w.contains("relative")));
        for (a, r) in absolute.observations.iter().zip(&set.observations) {
            assert!((a.signal / peak - r.signal).abs() < 2e-4, "{a:?} {r:?}");
            assert!(r.shared.white_reference == 0.0);
        }
    }
}

#[test]
fn a_raised_flag_ends_the_reduction() {
    let flag = AtomicBool::new(false);
    flag.store(true, Ordering::Relaxed);
    assert!(matches!(
        reduce(polymer(), None, &flag),
        Err(ReductionError::Cancelled)
    ));
}

#[test]
fn what_is_assumed_of_stages_and_lamp_is_reported_and_can_be_stated() {
    let reported = |set: &ObservationSet| -> Vec<String> {
        let warnings = set.warnings.iter();
        warnings
            .filter(|w| w.contains("assumed"))
            .cloned()
            .collect()
    };
    let silent = reduced(polymer_part(), None);
    let shared = |set: &ObservationSet| {
        let o = set.observations[0];
        let drift = o.shared.led_drift / o.signal;
        (
            o.shared.theta_c_zero.deg(),
            o.shared.phi_s_zero.deg(),
            drift,
        )
    };
    let near = |found: (f64, f64, f64), due: (f64, f64, f64)| {
        let off = [found.0 - due.0, found.1 - due.1, found.2 - due.2];
        assert!(off.iter().all(|x| x.abs() < 1e-12), "{found:?}");
    };
    near(shared(&silent), (0.02, 0.02, 1e-3));
    let words = reported(&silent).concat();
    for word in [
        "theta_c_std_deg",
        "phi_s_std_deg",
        "lamp_drift_std",
        "0.02°",
        "0.001",
    ] {
        assert!(words.contains(word), "{word}: {words}");
    }
    assert_eq!(reported(&silent).len(), 1);

    let mut stated = polymer_part().clone();
    let rig = &mut stated.manifest.rig;
    rig.theta_c_std_deg = Some(0.1);
    rig.phi_s_std_deg = Some(0.05);
    rig.lamp_drift_std = Some(0.004);
    let set = reduced(&stated, None);
    near(shared(&set), (0.1, 0.05, 0.004));
    assert_eq!(reported(&set), Vec::<String>::new());

    stated.manifest.rig.phi_s_std_deg = None;
    let words = reported(&reduced(&stated, None)).concat();
    assert!(
        words.contains("[rig] phi_s_std_deg: ") && !words.contains("lamp"),
        "{words}"
    );
}

#[test]
fn counts_that_the_converter_cannot_give_are_no_full_pixels() {
    let made = Made {
        saturation_dn: 4095,
        gain_dn: 0.4,
        read_electrons: 3.0,
        black_dn: 64.0,
        electrons_per_radiance_second: 3e5,
        ..Made::default()
    };
    let mut series = made.series(
        &[-10.0, 0.0, 10.0],
        &[0.0, 90.0, 180.0],
        &[0.02, 0.06],
        |_, _| 0.1,
    );
    series.manifest.camera.bit_depth = Some(12);
    let before = reduced(&series, None);
    assert!(
        before.rejected_frames.is_empty(),
        "{:?}",
        before.rejected_frames
    );

    // One frame with a few: it is left out by name.
    let mut spoilt = series.clone();
    let file = "sample_0_90_0.06_0";
    spoilt.edit(file, |p| p[40..43].fill(40_000));
    let after = reduced(&spoilt, None);
    assert_eq!(after.rejected_frames.len(), 1);
    let rejected = &after.rejected_frames[0];
    assert!(rejected.file.contains(file) && rejected.reason == "impossible counts");
    for word in [
        "3 of 9216 pixels",
        "above 4095",
        "40000",
        "camera.bit_depth = 12",
    ] {
        assert!(
            rejected.detail.contains(word),
            "{word}: {}",
            rejected.detail
        );
    }

    // All of them: no frame is what it seems.
    for kind in [FrameKind::Flat, FrameKind::Sample] {
        let mut shifted = series.clone();
        for (row, frame) in shifted.rows.iter().zip(&mut shifted.frames) {
            let of = frame.take().unwrap();
            let shift = if row.kind == kind { 4 } else { 0 };
            let pixels = of.pixels_dn().iter().map(|dn| dn << shift).collect();
            *frame = Some(Frame::new(of.width_px(), of.height_px(), pixels).unwrap());
        }
        let said = reduce(&shifted, None, &AtomicBool::new(false))
            .unwrap_err()
            .to_string();
        for word in [
            kind.as_str(),
            "frames/",
            "above 4095",
            "camera.bit_depth = 12",
            "right-align the counts, or correct bit_depth",
        ] {
            assert!(said.contains(word), "{word}: {said}");
        }
    }
}

#[test]
fn frames_of_a_pose_without_a_level_are_named() {
    let made = Made::default();
    let mut series = made.series(&[-10.0, 0.0, 10.0], &[0.0, 90.0], &[0.02], |_, _| 0.1);
    let file = "sample_0_90_0.02_0";
    let at = series.index_of(file);
    // So short that no double holds the counts per second.
    series.rows[at].exposure_s = 1e-308;
    let set = reduced(&series, None);
    assert_eq!(set.observations.len(), 5);
    let named: Vec<_> = set.rejected_frames.iter().collect();
    assert!(
        named.len() == 1 && named[0].file.contains(file) && named[0].detail.contains("1e-308 s"),
        "{named:?}"
    );
    assert_eq!(set.n_frames_used as usize + 1, series.rows.len());
}

#[test]
fn a_near_rig_without_distances_is_refused_by_name() {
    let mut series = polymer_part().clone();
    series.manifest.camera.projection = "perspective".to_owned();
    let said = reduce(&series, None, &AtomicBool::new(false))
        .unwrap_err()
        .to_string();
    assert!(said.contains("perspective"), "{said}");
}
