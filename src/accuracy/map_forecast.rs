//! Estimates the duration of a map before it starts: some of its poses are read, pixels of a typical surface are fitted
//! at all poses, double reflections of one surface are integrated, and one sheet is drawn.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::forecast::Forecast;
use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;
use crate::map::pixels::{Instructions, PixelFitter};
use crate::map::{self, MapOptions, Stage};
use crate::reduction::{FrameReadError, FrameSource, ReductionCache};
use crate::series::{FrameRow, Manifest};

/// Name of the part for reading and resampling.
pub const READ: &str = "to read and resample";
/// Name of the part for the quantities that all pixels share.
pub const SETTLE: &str = "for what pixels share";
/// Name of the part for the pixels.
pub const FIT: &str = "for the pixels";
/// Name of the part for their mean, for which the frames are read again.
pub const MEAN: &str = "for their mean";
/// Name of the part for the files.
pub const WRITE: &str = "for files";

/// Fewest poses that are read: a map needs more than five.
const POSES_MIN: usize = 8;
/// One pose in this many is read, where there are enough.
const THINNED: usize = 6;
/// Pixels that are fitted for the forecast.
const PIXELS: usize = 128;
/// Descents per sampled pixel for the shared quantities, and the number of these pixels.
const SETTLING: (f64, f64) = (5.0, 2048.0);
/// Descents per pixel of a map: noise and edges take longer than a clean surface.
const DESCENTS: f64 = 2.0;
/// Integrations of double reflections.
const INTEGRALS: f64 = 4.0;
/// Integrations that decide, with a target error, whether double reflections are needed.
const PROBES: f64 = 2.0;
/// Repeats of short pieces of work, so that other work on the machine matters less.
const REPEATED: usize = 5;
/// Sheets that a map draws.
const SHEETS: f64 = 12.0;

/// A series with a few of its sample frames.
struct ThinnedSeries<'a> {
    source: &'a dyn FrameSource,
    rows: Vec<FrameRow>,
    places: Vec<usize>,
}

impl<'a> ThinnedSeries<'a> {
    /// Keeps every calibration frame and one pose in `every`.
    fn new(source: &'a dyn FrameSource, every: usize) -> Self {
        let mut poses: Vec<Pose> = Vec::new();
        let mut thinned = ThinnedSeries {
            source,
            rows: Vec::new(),
            places: Vec::new(),
        };
        for (place, row) in source.rows().iter().enumerate() {
            let kept = match row.kind {
                FrameKind::Dark | FrameKind::Flat => true,
                FrameKind::Sample => {
                    if poses.last() != Some(&row.pose()) {
                        poses.push(row.pose());
                    }
                    poses.len() % every == 1 % every
                }
            };
            if kept {
                thinned.rows.push(row.clone());
                thinned.places.push(place);
            }
        }
        thinned
    }
}

impl FrameSource for ThinnedSeries<'_> {
    fn manifest(&self) -> &Manifest {
        self.source.manifest()
    }

    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    fn frame_id(&self, index: usize) -> i64 {
        self.source.frame_id(self.places[index])
    }

    fn reductions(&self) -> Option<&ReductionCache> {
        self.source.reductions()
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        self.source.read(self.places[index])
    }
}

/// Forecasts a map. `None` where its frames do not give a map, or `cancel` was raised.
#[must_use]
pub fn of_map(
    source: &dyn FrameSource,
    options: &MapOptions,
    cancel: &AtomicBool,
) -> Option<Forecast> {
    let manifest = source.manifest();
    let mut poses: Vec<Pose> = source
        .rows()
        .iter()
        .filter(|r| r.kind == FrameKind::Sample)
        .map(FrameRow::pose)
        .collect();
    poses.dedup();
    let every = (poses.len() / POSES_MIN).clamp(1, THINNED);
    let thinned = ThinnedSeries::new(source, every);
    let started = Instant::now();
    let read = std::sync::OnceLock::new();
    let enough = AtomicBool::new(false);
    let stopped = map::map(
        &thinned,
        options,
        &|p| {
            if p.stage == Stage::Settling {
                read.get_or_init(|| started.elapsed().as_secs_f64());
            }
            if p.stage == Stage::Settling || cancel.load(Ordering::Relaxed) {
                enough.store(true, Ordering::Relaxed);
            }
        },
        &enough,
    );
    drop(stopped);
    let share = source.rows().len() as f64 / thinned.rows().len().max(1) as f64;
    let read_s = share * read.get()?;
    let pixels = manifest.camera.width_px as usize * manifest.camera.height_px as usize;
    let metal = manifest.material().index().1 > 0.0;
    let truth = [
        0.2,
        0.3,
        0.1f64.ln(),
        0.1f64.ln(),
        if metal { 1.0 } else { 0.3 },
    ];
    let fitter = PixelFitter::new(manifest.rig_geometry(), manifest.material(), poses.clone());
    let clean = fitter.radiances(&truth);
    let brightest = clean.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let sigma = vec![(0.01 * brightest) as f32; PIXELS * poses.len()];
    let signal: Vec<f32> = (0..PIXELS)
        .flat_map(|pixel| {
            let noise = move |pose: usize| (1.7 * (pixel * 31 + pose) as f64).sin() * 0.014;
            clean
                .iter()
                .enumerate()
                .map(move |(pose, l)| (l + brightest * noise(pose)) as f32)
        })
        .collect();
    let starts = vec![[0.21, 0.31, truth[2] + 0.1, truth[3] + 0.1, truth[4]]; PIXELS];
    let again = || {
        let (signal, sigma) = (signal.clone(), sigma.clone());
        fitter.fit(signal, sigma, &starts, 2, Instructions::Widest)
    };
    // The first call fills a cache.
    std::hint::black_box(again());
    let per_pixel = usual_seconds(|| {
        std::hint::black_box(again());
    }) / PIXELS as f64;
    let threads = rayon::current_num_threads().max(1) as f64;
    let started = Instant::now();
    let lacking = fitter.lacking(&truth);
    let integral_s = started.elapsed().as_secs_f64();
    let share = lacking.iter().fold(0.0, |most: f64, x| most.max(x.abs())) / brightest;
    let integrals = match options.target_error {
        None => INTEGRALS,
        Some(target) if share <= target => PROBES,
        Some(_) => PROBES + INTEGRALS,
    };
    let settle_s = SETTLING.0 * SETTLING.1.min(pixels as f64) * per_pixel + integrals * integral_s;
    let fit_s = DESCENTS * pixels as f64 * per_pixel / threads;
    let write_s = SHEETS * map::write::seconds_of_a_sheet(manifest)? / threads;
    let forecast = Forecast::of_parts([
        (READ, read_s),
        (SETTLE, settle_s),
        (FIT, fit_s),
        (MEAN, read_s),
        (WRITE, write_s),
    ]);
    // A map that is late begins no further pixels and no fit of their mean; its files are written all the same.
    let limit = options.max_seconds.map(|s| s + write_s);
    Some(
        forecast
            .for_work(pixels as u64, "pixels")
            .to_error(options.target_error, "what may be left out of the physics")
            .within(limit),
    )
}

/// Median of the seconds that some work takes.
fn usual_seconds(work: impl Fn()) -> f64 {
    let mut seconds: Vec<f64> = (0..REPEATED)
        .map(|_| {
            let started = Instant::now();
            work();
            started.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds[REPEATED / 2]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::Series;

    #[test]
    fn a_thinned_series_has_all_calibrations_and_a_sixth_of_the_poses() {
        let series = Series::open("tests/data/series/paper-rig-full".as_ref()).unwrap();
        let thinned = ThinnedSeries::new(&series, THINNED);
        let count = |rows: &[FrameRow], sample: bool| {
            let kind = |r: &&FrameRow| (r.kind == FrameKind::Sample) == sample;
            rows.iter().filter(kind).count()
        };
        let (all, some) = (FrameSource::rows(&series), thinned.rows());
        assert_eq!(count(all, false), count(some, false));
        assert!(
            count(some, true) * THINNED >= count(all, true)
                && count(some, true) < count(all, true) / 3
        );
        // Each row keeps its own frame.
        for (place, row) in some.iter().enumerate() {
            assert_eq!(row.file, all[thinned.places[place]].file);
        }
    }

    #[test]
    fn a_map_is_forecast_in_its_parts_and_a_raised_flag_ends_it() {
        let series = Series::open("tests/data/series/checker".as_ref()).unwrap();
        let options = MapOptions::default();
        assert_eq!(of_map(&series, &options, &AtomicBool::new(true)), None);
        let reported = of_map(&series, &options, &AtomicBool::new(false)).unwrap();
        let camera = &series.manifest().camera;
        assert_eq!(
            reported.amount.as_ref().unwrap().count,
            u64::from(camera.width_px) * u64::from(camera.height_px)
        );
        let parts = [READ, SETTLE, FIT, MEAN, WRITE].map(|part| reported.part(part));
        assert!(parts.iter().all(|s| *s > 0.0), "{reported:?}");
        assert!((reported.seconds - parts.iter().sum::<f64>()).abs() < 1e-9 * reported.seconds);
    }
}
