//! The recorded checkerboard, whose layout is not an input of the map, and the errors for invalid input.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock};

use super::layers::{BORDER, DEFECT, FEW_OBSERVATIONS, MISFIT};
use super::solve::kernel::Parameters;
use super::tiles::spread_out;
use super::*;
use crate::frame::{Frame, FrameKind};
use crate::reduction::FrameReadError;
use crate::series::{FrameRow, Manifest, Series};

/// Pixels per row, mm per pixel, mm per patch of the board, which is centred.
const WIDTH: usize = 256;
const PIXEL_MM: f64 = 0.2;
const PATCH_MM: f64 = 9.0;
/// Errors of the closed form itself against path tracing, from the document of the variant: up to 0.15° in θr, 1 % in
/// α, 0.4 % in ρd; for the lean direction, the turn that is equivalent to that error of θr.
const MODEL: [f64; FREE] = [0.15, 0.15, 0.01, 0.01, 0.004];

/// Input of the ray tracer: θr, α, and the apparent ρd.
const USUAL: [f64; 3] = [10.0, 0.12, 0.33725];
const WORN: [f64; 3] = [4.0, 0.25, 0.31322];

fn series(name: &str) -> Series {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data/series")
        .join(name);
    Series::open(&folder).unwrap()
}

fn mapped(source: &dyn FrameSource) -> Result<Map, MapError> {
    map(
        source,
        &MapOptions::default(),
        &|_| {},
        &AtomicBool::new(false),
    )
}

fn checker() -> &'static Map {
    static MAP: OnceLock<Map> = OnceLock::new();
    MAP.get_or_init(|| mapped(&series("checker")).unwrap())
}

#[test]
fn shared_uncertainties_are_at_least_those_of_a_fit_of_the_mean() {
    let cancel = AtomicBool::new(false);
    let set = crate::reduction::reduce(&series("checker"), Some("even"), &cancel).unwrap();
    let options = crate::fit::FitOptions {
        variant: crate::fit::VariantChoice::Sawtooth,
        ..Default::default()
    };
    let mean = crate::fit::fit(&set, &options, &cancel).parameters;
    let map = checker();
    let shared = map.shared_std.unwrap();
    let least = [
        (0, &mean.theta_r_deg),
        (2, &mean.alpha_u),
        (3, &mean.alpha_v),
        (4, &mean.rho_d),
    ];
    for (k, of_mean) in least {
        assert!(
            shared[k] >= of_mean.std.unwrap(),
            "{k}: {shared:?} {of_mean:?}"
        );
    }
    let zero = map.globals.tilt_offset_std.deg();
    assert!(zero >= mean.tilt_offset_deg.std.unwrap(), "{zero}");
    assert!(map.globals.stray_std >= mean.background.std.unwrap());
}

/// Returns the position on the board in patches, from its lower left corner.
fn on_board(pixel: usize) -> [f64; 2] {
    let x = ((pixel % WIDTH) as f64 + 0.5 - 128.0) * PIXEL_MM;
    let y = -((pixel / WIDTH) as f64 + 0.5 - 128.0) * PIXEL_MM;
    [x / PATCH_MM + 2.0, y / PATCH_MM + 2.0]
}

/// Returns the pixels of patch (i, j) at least three pixels away from its border.
fn inner(i: usize, j: usize) -> Vec<usize> {
    let margin = 3.0 * PIXEL_MM / PATCH_MM;
    let within = |t: f64, k: usize| t > k as f64 + margin && t < k as f64 + 1.0 - margin;
    (0..WIDTH * WIDTH)
        .filter(|p| {
            let [a, b] = on_board(*p);
            within(a, i) && within(b, j)
        })
        .collect()
}

fn truth(i: usize, j: usize) -> Parameters {
    let [theta, alpha, rho_d] = if (i, j) == (1, 2) { WORN } else { USUAL };
    let lean = if (i + j).is_multiple_of(2) { 0.0 } else { 90.0 };
    [theta, lean, alpha, alpha, rho_d]
}

/// Returns value less truth; for directions, the shorter way round.
fn away(k: usize, value: f64, truth: f64) -> f64 {
    let d = value - truth;
    if k == 1 {
        (d + 180.0).rem_euclid(360.0) - 180.0
    } else {
        d
    }
}

#[test]
fn every_patch_of_the_board_has_its_own_angle_lean_and_roughness() {
    let map = checker();
    let shared = map.shared_std.unwrap();
    for i in 0..4 {
        for j in 0..4 {
            let truth = truth(i, j);
            let pixels = inner(i, j);
            for k in 0..FREE {
                let layer = &map.layers.parameters[k];
                // The uncertainty of a lean direction is inversely proportional to the sine of the ridge angle.
                let lever = if k == 1 {
                    1.0 / f64::sin(truth[0].to_radians())
                } else {
                    1.0
                };
                let relative = if k > 1 { truth[k] } else { lever };
                let common2 = shared[k].powi(2) + (MODEL[k] * relative).powi(2);
                let mut within = 0;
                let (mut sum, mut sum2, mut std2) = (0.0, 0.0, 0.0);
                for p in &pixels {
                    let d = away(k, f64::from(layer.values[*p]), truth[k]);
                    let std = f64::from(layer.std[*p]);
                    within += usize::from(d.abs() <= 2.0 * (std * std + common2).sqrt());
                    sum += d;
                    sum2 += d * d;
                    std2 += std * std;
                }
                let n = pixels.len() as f64;
                assert!(
                    within as f64 >= 0.95 * n,
                    "patch {i}-{j}, {}: {within} of {n} within twice the uncertainty",
                    layer.name
                );
                // The pixels' own uncertainty must be their scatter: n ≈ 1500 gives 1.8 %, times four. Flats and
                // resampling correlate neighbours, which adds a few percent.
                let scatter = (sum2 / n - (sum / n).powi(2)).sqrt();
                let ratio = scatter / (std2 / n).sqrt();
                assert!(
                    (ratio - 1.0).abs() < 0.15,
                    "patch {i}-{j}, {}: {ratio}",
                    layer.name
                );
            }
        }
    }
}

#[test]
fn both_lean_directions_are_common_and_every_inner_pixel_has_the_true_one() {
    let map = checker();
    let mut leans: Vec<f64> = map
        .leans
        .iter()
        .map(|l| away(1, l.azimuth_deg, 0.0))
        .collect();
    leans.sort_by(f64::total_cmp);
    assert_eq!(leans.len(), 2);
    let shared = map.shared_std.unwrap()[1];
    let tolerance = 2.0 * shared.hypot(MODEL[1]);
    assert!(
        leans[0].abs() < tolerance && (leans[1] - 90.0).abs() < tolerance,
        "{leans:?}"
    );
    for i in 0..4 {
        for j in 0..4 {
            let lean = truth(i, j)[1];
            for p in inner(i, j) {
                let seen = f64::from(map.layers.parameters[1].values[p]);
                // Ten standard deviations of the worn patch, whose lean is the least certain: 2.1°.
                assert!(away(1, seen, lean).abs() < 21.0, "{i} {j} {p}: {seen}");
            }
        }
    }
}

#[test]
fn borders_are_marked_between_patches_and_nowhere_inside() {
    let layers = &checker().layers;
    let (mut meeting, mut marked) = (0, 0);
    for (p, flags) in layers.flags.iter().enumerate() {
        let [a, b] = on_board(p);
        let inside = |t: f64| t > 0.1 && t < 3.9;
        let near = |t: f64| (t - t.round()).abs() * PATCH_MM < 0.75 * PIXEL_MM;
        if inside(a) && inside(b) && (near(a) || near(b)) {
            meeting += 1;
            marked += usize::from(flags & (BORDER | MISFIT) != 0);
        }
    }
    assert!(
        meeting > 1000 && marked as f64 > 0.98 * f64::from(meeting),
        "{marked} of {meeting}"
    );
    let (mut inside, mut marked) = (0, 0);
    for i in 0..4 {
        for j in 0..4 {
            for p in inner(i, j) {
                inside += 1;
                marked += usize::from(layers.flags[p] & (BORDER | MISFIT) != 0);
            }
        }
    }
    // A rare outlier of the path tracer's own noise is flagged as a misfit, too.
    assert!(
        inside > 20_000 && marked * 1000 < inside,
        "{marked} of {inside}"
    );
}

#[test]
fn the_worn_patch_is_the_one_defect() {
    let map = checker();
    assert_eq!(map.defects.len(), 1, "{:?}", map.defects);
    let worn = &map.defects[0];
    // Patch (1, 2) spans −9 to 0 mm in x and 0 to 9 mm in y; borders of two pixels do not count.
    assert!((worn.x_mm + 4.5).abs() < PIXEL_MM && (worn.y_mm - 4.5).abs() < PIXEL_MM);
    for size in [worn.width_mm, worn.height_mm] {
        assert!(
            size > PATCH_MM - 6.0 * PIXEL_MM && size <= PATCH_MM,
            "{size}"
        );
    }
    for p in inner(1, 2) {
        assert_ne!(map.layers.flags[p] & DEFECT, 0);
    }
    let theta = &worn.deviations[0];
    assert_eq!(theta.parameter, "theta_r_deg");
    assert!((theta.usual - 10.0).abs() < 2.0 * MODEL[0]);
    assert!((theta.value.unwrap() - 4.0).abs() < 2.0 * MODEL[0]);
    assert!(theta.sigmas.unwrap() < -10.0);
}

#[test]
fn the_mount_beside_the_board_has_no_value() {
    let map = checker();
    let (mut mount, mut empty) = (0, 0);
    for p in 0..map.layers.flags.len() {
        let [a, b] = on_board(p);
        if [a, b].iter().any(|t| !(-0.1..=4.1).contains(t)) {
            mount += 1;
            empty += usize::from(!map.layers.has_value(p));
        }
    }
    assert!(
        mount > 20_000 && empty as f64 > 0.999 * f64::from(mount),
        "{empty} of {mount}"
    );
}

/// The central part of a series' frames.
struct Cropped {
    series: Series,
    manifest: Manifest,
    width: u32,
}

impl Cropped {
    fn new(series: Series, width: u32) -> Self {
        let mut manifest = series.manifest().clone();
        let share = f64::from(width) / f64::from(manifest.camera.width_px);
        manifest.camera.width_px = width;
        manifest.camera.height_px = width;
        manifest.camera.field_width_mm = manifest.camera.field_width_mm.map(|w| w * share);
        manifest.camera.field_height_mm = manifest.camera.field_height_mm.map(|h| h * share);
        manifest.rig.rotation_axis_px = Some([0.5 * f64::from(width); 2]);
        Cropped {
            series,
            manifest,
            width,
        }
    }
}

impl FrameSource for Cropped {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }
    fn rows(&self) -> &[FrameRow] {
        self.series.rows()
    }
    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let frame = self.series.read(index)?;
        let from = (frame.width_px() - self.width) / 2;
        let pixels = (from..from + self.width)
            .flat_map(|row| {
                let at = (row * frame.width_px() + from) as usize;
                frame.pixels_dn()[at..at + self.width as usize].to_vec()
            })
            .collect();
        Ok(Frame::new(self.width, self.width, pixels).unwrap())
    }
}

/// Pixels per row of the middle of the board, for tests that map it again: four tiles.
const CROP: usize = 128;

fn middle() -> Cropped {
    Cropped::new(series("checker"), CROP as u32)
}

fn middle_mapped() -> &'static Map {
    static MAP: OnceLock<Map> = OnceLock::new();
    MAP.get_or_init(|| mapped(&middle()).unwrap())
}

#[test]
fn a_scratch_file_changes_nothing_and_every_step_reports_progress_to_its_end() {
    let place = tempfile::tempdir().unwrap();
    let options = MapOptions {
        memory_bytes_max: 0,
        scratch: place.path().to_owned(),
        ..MapOptions::default()
    };
    let source = middle();
    let reported = Mutex::new(Vec::new());
    let report = |p: Progress| reported.lock().unwrap().push(p);
    let again = map(&source, &options, &report, &AtomicBool::new(false)).unwrap();
    let reported = reported.into_inner().unwrap();
    for stage in [Stage::Resampling, Stage::Fitting, Stage::Averaging] {
        let mut steps = reported.iter().filter(|p| p.stage == stage);
        assert!(steps.any(|p| p.done == p.total), "{stage:?}");
    }
    let first = middle_mapped();
    for k in 0..FREE {
        let pairs = first.layers.parameters[k]
            .values
            .iter()
            .zip(&again.layers.parameters[k].values);
        for (a, b) in pairs {
            assert!(
                a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan()),
                "{a} {b}"
            );
        }
    }
    assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0);
}

/// A series with some corrupted frames.
struct Spoilt<'a> {
    series: &'a dyn FrameSource,
    rows: Vec<FrameRow>,
    spoil: fn(&FrameRow, usize, &mut u16),
}

impl FrameSource for Spoilt<'_> {
    fn manifest(&self) -> &Manifest {
        self.series.manifest()
    }
    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }
    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let row = &self.rows[index];
        let all = self.series.rows();
        let original = all.iter().position(|r| r.file == row.file).unwrap();
        let frame = self.series.read(original)?;
        let mut pixels = frame.pixels_dn().to_vec();
        for (p, dn) in pixels.iter_mut().enumerate() {
            (self.spoil)(row, p, dn);
        }
        Ok(Frame::new(frame.width_px(), frame.height_px(), pixels).unwrap())
    }
}

#[test]
fn saturated_pixels_are_masked_pose_by_pose() {
    let series = middle();
    let source = Spoilt {
        rows: series.rows().to_vec(),
        series: &series,
        // At one pose a block of the frame is saturated: the map must lose that observation, and not be wrong.
        spoil: |row, p, dn| {
            let (r, c) = (p / CROP, p % CROP);
            let block = (26..46).contains(&r) && (82..102).contains(&c);
            if row.kind == FrameKind::Sample
                && row.theta_c_deg == 0.0
                && row.phi_s_deg == 0.0
                && block
            {
                *dn = 65535;
            }
        },
    };
    let spoilt = mapped(&source).unwrap();
    let first = middle_mapped();
    let inside = 36 * CROP + 92;
    assert_eq!(first.layers.n_observations[inside], 24);
    assert_eq!(spoilt.layers.n_observations[inside], 23);
    assert_ne!(spoilt.layers.flags[inside] & layers::PARTLY_MASKED, 0);
    for k in 0..FREE {
        let at = |map: &Map| {
            let layer = &map.layers.parameters[k];
            (
                f64::from(layer.values[inside]),
                f64::from(layer.std[inside]),
            )
        };
        let ((a, std_a), (b, std_b)) = (at(first), at(&spoilt));
        // One observation less moves the value by a few times the standard deviation that it adds.
        let added = (std_b * std_b - std_a * std_a).max(0.0).sqrt();
        assert!(
            away(k, b, a).abs() < 4.0 * added + 0.5 * std_a,
            "{k}: {a} {b}"
        );
    }
}

#[test]
fn a_steel_plate_has_its_angle_and_roughness_in_every_pixel() {
    const WIDTH: u32 = 20;
    let map = mapped(&Cropped::new(series("steel-15"), WIDTH)).unwrap();
    let truth = [15.0, 0.0, 0.06, 0.18, 1.0];
    let shared = map.shared_std.unwrap();
    for (k, layer) in map.layers.parameters.iter().enumerate() {
        let (mut sum, mut count) = (0.0, 0.0);
        let inner = (0..WIDTH * WIDTH).filter(|p| {
            let (r, c) = (p / WIDTH, p % WIDTH);
            (3..WIDTH - 3).contains(&r) && (3..WIDTH - 3).contains(&c)
        });
        for pixel in inner {
            let off = away(k, f64::from(layer.values[pixel as usize]), truth[k]);
            let std = f64::from(layer.std[pixel as usize]).hypot(shared[k]);
            assert!(
                off.abs() < 5.0 * std,
                "{} of pixel {pixel} is wrong by {off}, std {std}",
                layer.name
            );
            sum += off;
            count += 1.0;
        }
        // With the closed form only, θr would be 0.07° and αv 0.003 too large in all of them.
        let mean = sum / count;
        let allowed = [0.03, 0.03, 0.0004, 0.0008, 2.0 * shared[4]][k];
        assert!(
            mean.abs() < allowed,
            "{} is wrong by {mean} on average",
            layer.name
        );
    }
}

#[test]
fn too_few_poses_dark_frames_and_cancellation_have_errors_of_their_own() {
    let series = series("checker");
    let few = Spoilt {
        rows: {
            let mut samples = 0;
            let mut rows = series.rows().to_vec();
            rows.retain(|row| {
                samples += usize::from(row.kind == FrameKind::Sample);
                row.kind != FrameKind::Sample || samples <= 4
            });
            rows
        },
        series: &series,
        spoil: |_, _, _| {},
    };
    assert!(matches!(
        mapped(&few),
        Err(MapError::TooFewPoses { poses: 4, least: 6 })
    ));

    let dark = Spoilt {
        rows: series.rows().to_vec(),
        series: &series,
        spoil: |row, p, dn| {
            if row.kind == FrameKind::Sample {
                *dn = 200 + (p % 3) as u16;
            }
        },
    };
    let said = mapped(&dark).unwrap_err();
    assert!(
        matches!(said, MapError::NothingSeen | MapError::NoLobes),
        "{said}"
    );

    /// Sample frames of another size.
    struct Small<'a>(&'a Series);
    impl FrameSource for Small<'_> {
        fn manifest(&self) -> &Manifest {
            self.0.manifest()
        }
        fn rows(&self) -> &[FrameRow] {
            self.0.rows()
        }
        fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
            match self.0.rows()[index].kind {
                FrameKind::Sample => Ok(Frame::new(2, 2, vec![1000; 4]).unwrap()),
                _ => self.0.read(index),
            }
        }
    }
    let said = mapped(&Small(&series)).unwrap_err().to_string();
    assert!(said.contains("wrong size: 2 × 2 pixels"), "{said}");

    let raised = AtomicBool::new(true);
    let stopped = map(&series, &MapOptions::default(), &|_| {}, &raised);
    assert!(matches!(
        stopped,
        Err(MapError::Cancelled | MapError::Reduction(ReductionError::Cancelled))
    ));
}

#[test]
fn a_map_that_ran_out_of_time_counts_its_missing_pixels_and_a_target_error_lists_the_omissions() {
    let options = MapOptions {
        target_error: Some(1.0),
        ..MapOptions::default()
    };
    let source = middle();
    let asked = AtomicUsize::new(0);
    let late = || asked.fetch_add(1, Ordering::Relaxed) >= 2;
    let never = AtomicBool::new(false);
    let part = map_until(&source, &options, &late, &|_| {}, &never).unwrap();
    let all = part.layers.flags.len();
    // Two tiles, of which the last may be shorter.
    assert!(part.pixels_left_out >= all - 2 * signals::planes::TILE && part.pixels_left_out < all);
    let untouched = (0..all).filter(|p| part.layers.n_observations[*p] == 0);
    let untouched: Vec<usize> = untouched.collect();
    assert!(untouched.len() >= part.pixels_left_out);
    assert!(
        untouched
            .iter()
            .all(|p| part.layers.flags[*p] & FEW_OBSERVATIONS != 0 && !part.layers.has_value(*p))
    );
    let of = |what: &str| part.left_out.iter().find(|l| l.what.contains(what));
    assert!(of("pixels").is_some());
    let cost = of("double reflections by integration").unwrap().cost;
    assert!(cost.is_some_and(|c| c > 0.0 && c <= 1.0), "{cost:?}");
    let too_late = map_until(&source, &options, &|| true, &|_| {}, &never);
    assert!(matches!(too_late, Err(MapError::Late)));
}

#[test]
fn any_number_of_tiles_is_visited_once_each_in_a_spread_order() {
    for count in [1, 2, 3, 8, 9, 1000] {
        let order = spread_out(count);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..count).collect::<Vec<_>>());
    }
    assert_eq!(spread_out(8)[..4], [4, 0, 6, 2]);
}
