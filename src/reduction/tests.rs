//! Claims about the whole reduction: recorded series against their true radiances, spoilt frames
//! one by one, and made frames whose truth is known.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::Ordering;

use super::synthetic::{Made, Memory};
use super::*;
use crate::geometry;

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
    assert!(even.warnings.is_empty(), "{:?}", even.warnings);
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

/// A lobe over a floor, as bright as 0.4.
fn lobe(tilt: f64, azimuth: f64) -> f64 {
    0.05 + 0.35 * (-(tilt / 15.0).powi(2) + azimuth.to_radians().cos() - 1.0).exp()
}

const TILTS: [f64; 5] = [-20.0, -10.0, 0.0, 10.0, 20.0];
const AZIMUTHS: [f64; 6] = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0];

/// Deviation of gain · (L + s) from the signals, the gain being what the flats' stray light does to
/// the provisional unit, in standard uncertainties of the samples and the reference together.
fn made_deviations(made: &Made, set: &ObservationSet) -> Vec<f64> {
    let white = set.white_reference.unwrap();
    let (mut with, mut without) = (0.0, 0.0);
    for flat in &set.flats {
        let due = white.reflectance / std::f64::consts::PI * set.rig.cos_incidence(flat.theta_c);
        with += flat.signal * due;
        without += (due + made.stray) * due;
    }
    let gain = with / without;
    set.observations
        .iter()
        .map(|o| {
            let due = lobe(o.pose.theta_c.deg(), o.pose.phi_s.deg()) + made.stray;
            (o.signal - gain * due) / o.sigma.hypot(1e-4 * due)
        })
        .collect()
}

#[test]
fn defects_pattern_and_stray_light_leave_the_signal_right() {
    for made in [
        Made::default(),
        Made {
            stray: 0.02,
            seed: 2,
            ..Made::default()
        },
        Made {
            hot: 0.004,
            dead: 0.004,
            prnu: 0.03,
            dsnu_dn: 8.0,
            seed: 3,
            ..Made::default()
        },
        Made {
            saturation_dn: 4095,
            gain_dn: 0.4,
            read_electrons: 3.0,
            black_dn: 64.0,
            electrons_per_radiance_second: 3e5,
            hot: 0.002,
            dead: 0.002,
            vignetting: 0.15,
            seed: 4,
            ..Made::default()
        },
    ] {
        let series = made.series(&TILTS, &AZIMUTHS, &[0.02, 0.06], lobe);
        let set = reduced(&series, None);
        assert_eq!(set.observations.len(), 30);
        let z = made_deviations(&made, &set);
        let worst = z.iter().fold(0.0_f64, |a, z| a.max(z.abs()));
        assert!(worst < 5.0, "{worst}: {z:?}");
        assert!(rms(&z) < 1.6, "{}", rms(&z));
        assert!(
            set.rejected_frames
                .iter()
                .all(|r| r.reason.contains("saturated"))
        );
    }
}

#[test]
fn clipping_in_the_only_exposure_does_not_darken_the_mean() {
    // The brightest poses lie at 60,000 to 66,000 DN: noise and the centre of the field clip.
    let made = Made {
        vignetting: 0.1,
        ..Made::default()
    };
    for exposure in [0.064, 0.0655, 0.068] {
        let series = made.series(&TILTS, &AZIMUTHS, &[exposure], lobe);
        let set = reduced(&series, None);
        let z = made_deviations(&made, &set);
        let worst = z.iter().fold(0.0_f64, |a, z| a.max(z.abs()));
        assert!(worst < 5.0, "{exposure} s: {worst}");
    }
}

#[test]
fn a_wrong_noise_figure_is_noticed_in_the_repeats() {
    let made = Made {
        read_electrons: 6.0,
        ..Made::default()
    };
    let mut series = made.series(&TILTS[..3], &AZIMUTHS, &[0.02], lobe);
    series.manifest.camera.read_noise_electrons_rms = Some(2.0);
    let set = reduced(&series, None);
    assert!(
        set.warnings.iter().any(|w| w.contains("scatter")),
        "{:?}",
        set.warnings
    );
}

#[test]
fn a_pose_without_light_amid_bright_ones_is_black_and_a_dark_sample_is_not() {
    let made = Made::default();
    let off = |tilt: f64, azimuth: f64| {
        if (tilt, azimuth) == (0.0, 120.0) {
            0.0
        } else {
            lobe(tilt, azimuth)
        }
    };
    let set = reduced(&made.series(&TILTS, &AZIMUTHS, &[0.02], off), None);
    assert_eq!(set.observations.len(), 29);
    assert_eq!(set.rejected_frames.len(), 1);
    assert_eq!(set.rejected_frames[0].reason, "black");
    assert!(set.warnings.iter().any(|w| w.contains("no observation")));
    let narrow = |tilt: f64, azimuth: f64| {
        if tilt == 0.0 {
            lobe(tilt, azimuth)
        } else {
            0.0
        }
    };
    let set = reduced(&made.series(&TILTS, &AZIMUTHS, &[0.02], narrow), None);
    assert_eq!(set.observations.len(), 30);
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
fn a_near_rig_without_distances_is_refused_by_name() {
    let mut series = polymer_part().clone();
    series.manifest.camera.projection = "perspective".to_owned();
    let said = reduce(&series, None, &AtomicBool::new(false))
        .unwrap_err()
        .to_string();
    assert!(said.contains("perspective"), "{said}");
}

#[test]
fn a_near_rig_sees_what_its_views_average_to() {
    // A lobe of 5° about a facet normal that leans 8° to +x at φs = 0 and turns with the sample; the
    // field of 51 mm spans ±5° from the camera.
    let glint = |azimuth: f64, d: &geometry::Directions| {
        let half = (d.incident + d.outgoing).normalize();
        let (s, c) = azimuth.to_radians().sin_cos();
        let lean = 8f64.to_radians().tan();
        let (x, y) = (half.x / half.z - lean * c, half.y / half.z - lean * s);
        0.1 * d.incident.z + 0.2 * (-(x * x + y * y) / 0.01).exp()
    };
    let made = Made {
        near_mm: Some((300.0, 250.0)),
        ..Made::default()
    };
    let series = made.series_of(&TILTS, &AZIMUTHS, &[0.02, 0.06], |_, azimuth, d| {
        glint(azimuth, d)
    });
    let set = reduced(&series, None);
    assert_eq!(set.observations.len(), 30);
    assert_eq!(set.views.len(), 30);
    let mut centre_off = 0.0_f64;
    for (o, views) in set.observations.iter().zip(&set.views) {
        let azimuth = o.pose.phi_s.deg();
        let due: f64 = views
            .iter()
            .map(|v| v.weight * glint(azimuth, &v.directions))
            .sum();
        let off = (o.signal - due) / o.sigma.hypot(3e-4 * due);
        assert!(off.abs() < 5.0, "{o:?}: {due}");
        let centre = glint(azimuth, &set.rig.rig_directions(o.pose.theta_c));
        centre_off = centre_off.max((centre / o.signal - 1.0).abs());
    }
    // Without the views the same numbers would be wrong by far more.
    assert!(centre_off > 0.05, "{centre_off}");
    let white = set.white_reference.unwrap();
    for flat in &set.flats {
        let due = white.reflectance / std::f64::consts::PI * set.rig.cos_incidence(flat.theta_c);
        assert!((flat.signal / due - 1.0).abs() < 5e-4, "{flat:?} {due}");
    }
}

#[test]
fn a_series_of_nothing_but_black_frames_gives_no_observation() {
    let made = Made::default();
    let series = made.series(&TILTS[..2], &AZIMUTHS[..2], &[0.02], |_, _| 0.0);
    let mut bare = series.clone();
    for (frame, row) in bare.frames.iter_mut().zip(&bare.rows) {
        if row.kind == FrameKind::Sample {
            *frame = None;
        }
    }
    let said = reduce(&bare, None, &AtomicBool::new(false)).unwrap_err();
    assert!(
        matches!(said, ReductionError::NoObservations { .. }),
        "{said}"
    );
}

/// Turns, moves and shrinks pictures of the recorded board: each frame is drawn anew from the levels
/// of its patches and mount as the board lies at `azimuth_offset`, `axis_px` away.
fn displaced_board(azimuth_offset: f64, axis_px: [f64; 2], moved: Option<&str>) -> Memory {
    let mut series = checker().clone();
    let layout = series.manifest.sample.layout.clone().unwrap();
    let board = Board::new(&series.manifest, &layout);
    let mut there = board.clone();
    there.placement.turn = Angle::from_deg(azimuth_offset);
    there.placement.axis_px = axis_px;
    for at in 0..series.rows.len() {
        if series.rows[at].kind != FrameKind::Sample {
            continue;
        }
        let frame = series.frames[at].clone().unwrap();
        let pose = series.rows[at].pose();
        let mut levels: HashMap<(u32, u32), Vec<u16>> = HashMap::new();
        let mut mount = Vec::new();
        board.draw(pose, 256 * 256, |pixel, spot| match spot {
            region::Spot::Patch(i, j) => {
                levels
                    .entry((i, j))
                    .or_default()
                    .push(frame.pixels_dn()[pixel]);
            }
            region::Spot::Mount => mount.push(frame.pixels_dn()[pixel]),
            region::Spot::Border => {}
        });
        let mut own = there.clone();
        if moved.is_some_and(|file| series.rows[at].file.contains(file)) {
            own.placement.axis_px = [axis_px[0] + 6.0, axis_px[1] - 4.0];
        }
        let drawing = own.at(pose, 0.0);
        let dn = (0..256 * 256)
            .map(|pixel| {
                let (c, r) = ((pixel % 256) as f64 + 0.5, (pixel / 256) as f64 + 0.5);
                let pool = match drawing.spot(c, r) {
                    region::Spot::Patch(i, j) => &levels[&(i, j)],
                    _ => &mount,
                };
                pool[pixel * 7919 % pool.len()]
            })
            .collect();
        series.frames[at] = Some(Frame::new(256, 256, dn).unwrap());
    }
    // Pixels were dealt anew, so the sensor's pattern is gone: uniform flats say there is none.
    for at in 0..series.rows.len() {
        if series.rows[at].kind == FrameKind::Flat {
            let file = series.rows[at].file.clone();
            series.edit(&file, |p| {
                let mean = p.iter().map(|d| f64::from(*d)).sum::<f64>() / p.len() as f64;
                p.iter_mut()
                    .enumerate()
                    .for_each(|(i, d)| *d = (mean + f64::from((i % 5) as u8) - 2.0) as u16);
            });
        }
    }
    series
}

#[test]
fn a_turned_and_displaced_board_is_found_and_its_patches_followed() {
    let truth = truth("checker", "even");
    for (turn, axis) in [(7.0, [0.0, 0.0]), (-4.0, [5.0, -3.0]), (0.0, [0.0, 0.0])] {
        let series = displaced_board(turn, axis, None);
        let set = reduced(&series, Some("even"));
        assert_eq!(set.observations.len(), 24, "{:?}", set.rejected_frames);
        // Vignetting of 3 % rms stays in the pixels that were dealt anew; a patch's neighbours or
        // the mount in it would be 10 % and more.
        for o in &set.observations {
            assert!(
                (o.signal / truth[&key(o)] - 1.0).abs() < 0.05,
                "{turn} {o:?}"
            );
        }
        let said = set.warnings.iter().any(|w| w.contains("turned"));
        assert_eq!(said, turn != 0.0, "{:?}", set.warnings);
    }
}

#[test]
fn a_frame_in_which_the_board_moved_is_shifted() {
    let series = displaced_board(0.0, [0.0, 0.0], Some("sample_tc+10_ps090"));
    let set = reduced(&series, Some("odd"));
    assert_eq!(set.rejected_frames.len(), 1, "{:?}", set.rejected_frames);
    assert_eq!(set.rejected_frames[0].reason, "shifted");
    assert!(set.rejected_frames[0].file.contains("tc+10_ps090"));
    // A frame rolled as a whole has the sensor's pattern elsewhere too.
    let mut rolled = checker().clone();
    rolled.edit("sample_tc+00_ps045", |p| roll(p, 4, 1));
    let set = reduced(&rolled, Some("even"));
    assert_eq!(set.rejected_frames.len(), 1, "{:?}", set.rejected_frames);
    assert_eq!(set.rejected_frames[0].reason, "shifted");
}
