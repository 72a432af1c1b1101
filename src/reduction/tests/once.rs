//! Every frame is read once, whatever is asked of it afterwards.

use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex};

use super::super::synthetic::{Made, Memory};
use super::super::{
    CalibrationText, FrameReadError, FrameText, ReductionCache, ReductionTexts, TextStore, cache,
};
use super::*;
use crate::series::{FrameRow, Manifest};

const TILTS: [f64; 4] = [-20.0, -5.0, 5.0, 20.0];
const AZIMUTHS: [f64; 5] = [0.0, 70.0, 140.0, 220.0, 290.0];

fn lobe(tilt: f64, azimuth: f64) -> f64 {
    0.03 + 0.35 * (-(tilt / 15.0).powi(2) + azimuth.to_radians().cos() - 1.0).exp()
}

/// Texts as a store keeps them.
#[derive(Debug, Default)]
struct Texts(Mutex<ReductionTexts>);

impl Texts {
    fn get(&self) -> ReductionTexts {
        self.0.lock().unwrap().clone()
    }
}

impl TextStore for Texts {
    fn add(&self, texts: &ReductionTexts) -> Result<Vec<bool>, String> {
        let mut all = self.0.lock().unwrap();
        all.calibrations.extend(texts.calibrations.iter().cloned());
        let add = |text: &FrameText| {
            let is_same = |other: &FrameText| {
                (&other.calibration, &other.part, other.frame_id)
                    == (&text.calibration, &text.part, text.frame_id)
            };
            let is_new = !all.frames.iter().any(is_same);
            if is_new {
                all.frames.push(text.clone());
            }
            is_new
        };
        Ok(texts.frames.iter().map(add).collect())
    }

    fn bodies(
        &self,
        calibration: &str,
        part: &str,
        frame_ids: &[i64],
    ) -> Result<Vec<(i64, String)>, String> {
        let all = self.0.lock().unwrap();
        let wanted = all.frames.iter().filter(|text| {
            text.calibration == calibration
                && text.part == part
                && frame_ids.contains(&text.frame_id)
        });
        Ok(wanted
            .map(|text| (text.frame_id, text.body.clone()))
            .collect())
    }
}

/// A series that counts how often each frame is read, with a cache as a store has it.
struct Watched {
    series: Memory,
    reads: Vec<AtomicUsize>,
    texts: Arc<Texts>,
    cache: ReductionCache,
    growing: bool,
}

impl Watched {
    fn new(series: Memory) -> Self {
        let texts = Arc::<Texts>::default();
        Watched {
            cache: ReductionCache::stored_in(Arc::clone(&texts) as Arc<dyn TextStore>),
            texts,
            reads: series.rows.iter().map(|_| AtomicUsize::new(0)).collect(),
            series,
            growing: false,
        }
    }

    fn restore(&self, texts: &ReductionTexts) {
        for text in &texts.calibrations {
            self.cache.restore_calibration(&text.key, &text.body);
        }
        for text in &texts.frames {
            self.cache.restore_frame(text);
        }
    }

    fn reduce(&self, region: Option<&str>) -> ObservationSet {
        reduce(self, region, &AtomicBool::new(false)).unwrap()
    }

    /// How often the frames of the list were read, each number once.
    fn counts(&self) -> Vec<usize> {
        let reads = self.reads[..self.series.rows.len()].iter();
        let mut counts: Vec<usize> = reads.map(|n| n.load(Ordering::Relaxed)).collect();
        counts.sort_unstable();
        counts.dedup();
        counts
    }
}

impl FrameSource for Watched {
    fn manifest(&self) -> &Manifest {
        &self.series.manifest
    }

    fn rows(&self) -> &[FrameRow] {
        &self.series.rows
    }

    fn reductions(&self) -> Option<&ReductionCache> {
        Some(&self.cache)
    }

    fn is_growing(&self) -> bool {
        self.growing
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        self.reads[index].fetch_add(1, Ordering::Relaxed);
        self.series.read(index)
    }
}

fn made() -> Made {
    Made {
        edge: 48,
        ..Made::default()
    }
}

fn bent() -> Memory {
    let bent = Made {
        bend: 0.06,
        flicker: 3e-4,
        ..made()
    };
    bent.series(&TILTS, &AZIMUTHS, &[0.02, 0.08], lobe)
}

fn straight() -> Memory {
    made().series(&TILTS, &AZIMUTHS, &[0.02, 0.08], lobe)
}

#[test]
fn a_reduction_reads_every_frame_once_and_the_next_one_none() {
    let near = Made {
        near_mm: Some((300.0, 250.0)),
        ..made()
    };
    let near = near.series(&TILTS, &AZIMUTHS, &[0.02], lobe);
    let checker = Memory::of(&Series::open(&recorded("checker")).unwrap());
    let mut full = straight();
    // A frame that is left out, and one of which a few pixels are full.
    full.edit("sample_5_140_0.08", |pixels| pixels.fill(65_535));
    full.edit("sample_5_70_0.08", |pixels| pixels[..300].fill(65_535));
    for (name, series, region) in [
        ("straight", straight(), None),
        ("bent", bent(), None),
        ("full", full, None),
        ("near", near, None),
        ("board", checker, Some("even")),
    ] {
        let watched = Watched::new(series);
        let first = watched.reduce(region);
        assert_eq!(watched.counts(), [1], "{name}");
        assert_eq!(watched.reduce(region), first, "{name}");
        assert_eq!(watched.counts(), [1], "{name}");
        // The same without a cache.
        let alone = reduced(&watched.series, region);
        assert_eq!(alone, first, "{name}");
    }
}

#[test]
fn a_series_that_grows_reads_only_what_is_new() {
    for series in [straight(), bent()] {
        let whole = series.rows.clone();
        let mut watched = Watched::new(series);
        watched.growing = true;
        let first = whole.iter().position(|row| row.kind == FrameKind::Sample);
        let calibration = first.expect("it has samples");
        for count in (calibration + 8..whole.len()).step_by(6) {
            watched.series.rows.truncate(count);
            watched
                .series
                .rows
                .extend_from_slice(&whole[watched.series.rows.len()..count]);
            watched.reduce(None);
            assert_eq!(watched.counts(), [1], "{count}");
        }
        watched.series.rows = whole;
        watched.growing = false;
        let last = watched.reduce(None);
        assert_eq!(watched.counts(), [1]);
        assert_eq!(last, reduced(&watched.series, None));
    }
}

#[test]
fn what_was_stored_is_as_good_as_what_was_read() {
    let checker = Memory::of(&Series::open(&recorded("checker")).unwrap());
    for (series, region) in [(straight(), None), (bent(), None), (checker, Some("odd"))] {
        let before = Watched::new(series.clone());
        let set = before.reduce(region);
        let texts = before.texts.get();
        assert!(!texts.frames.is_empty());
        before.reduce(region);
        assert_eq!(before.texts.get(), texts);
        let after = Watched::new(series.clone());
        after.restore(&texts);
        assert_eq!(after.reduce(region), set);
        assert_eq!(after.counts(), [0]);
        assert_eq!(after.texts.get(), ReductionTexts::default());
        // Texts of another form are passed over, and the frames are read.
        let strange = |body: &str| ReductionTexts {
            calibrations: vec![CalibrationText {
                body: body.to_owned(),
                ..texts.calibrations[0].clone()
            }],
            frames: (texts.frames.iter())
                .map(|text| FrameText {
                    body: body.to_owned(),
                    ..text.clone()
                })
                .collect(),
        };
        for body in ["", "null", "{}", "[1, 2]", "{\"Reduced\": 3}"] {
            let after = Watched::new(series.clone());
            after.restore(&strange(body));
            assert_eq!(after.reduce(region), set, "{body}");
        }
    }
}

#[test]
fn another_dark_frame_or_another_region_reads_the_frames_again() {
    let mut watched = Watched::new(straight());
    watched.reduce(None);
    let dark = |row: &FrameRow| row.kind == FrameKind::Dark;
    let at = watched
        .series
        .rows
        .iter()
        .position(dark)
        .expect("it has darks");
    watched.series.rows[at].exposure_s = 0.05;
    watched.reduce(None);
    assert_eq!(watched.counts(), [2]);
    let checker = Memory::of(&Series::open(&recorded("checker")).unwrap());
    let watched = Watched::new(checker);
    watched.reduce(Some("even"));
    watched.reduce(Some("odd"));
    // Darks and flats are those of both regions.
    assert_eq!(watched.counts(), [1, 2]);
}

#[test]
fn a_long_series_keeps_few_sums_in_memory_and_gives_the_same() {
    let tilts: Vec<f64> = (0..12).map(|i| f64::from(i) * 4.0 - 22.0).collect();
    let azimuths: Vec<f64> = (0..24).map(|i| f64::from(i) * 15.0).collect();
    let small = Made {
        edge: 16,
        bend: 0.06,
        flicker: 3e-4,
        ..Made::default()
    };
    let series = small.series(&tilts, &azimuths, &[0.02, 0.05, 0.08], lobe);
    let alone = reduced(&series, None);
    let mut watched = Watched::new(series);
    assert_eq!(watched.reduce(None), alone);
    assert_eq!(watched.reduce(None), alone);
    assert_eq!(watched.counts(), [1]);
    let held = watched.cache.held();
    assert!(held.iter().all(|n| *n <= cache::IN_MEMORY), "{held:?}");
    assert!(held.contains(&cache::IN_MEMORY), "{held:?}");
    // The same after a restart, with the texts in the store.
    let texts = watched.texts.get();
    watched.cache = ReductionCache::stored_in(Arc::clone(&watched.texts) as Arc<dyn TextStore>);
    watched.restore(&texts);
    assert_eq!(watched.cache.held(), held);
    assert_eq!(watched.reduce(None), alone);
    assert_eq!(watched.counts(), [1]);
    // A row that is of another region, or no longer there, is not passed over.
    let is_lost = || {
        let lost = reduce(&watched, None, &AtomicBool::new(false));
        matches!(lost, Err(ReductionError::Vanished { .. }))
    };
    for text in &mut watched.texts.0.lock().unwrap().frames {
        text.body = text.body.replace(
            "\"segments\":[",
            "\"segments\":[{\"cells\":[],\"inverse_response2\":1.0},",
        );
    }
    assert!(is_lost());
    watched.texts.0.lock().unwrap().frames.clear();
    assert!(is_lost());
}
