//! What reductions of one series have computed already, so that no frame is read twice.
//!
//! A [`ReductionCache`] belongs to a source of frames. It keeps the sums of every frame that was measured, per region and
//! calibration, and the calibration's own sums. The store keeps the same as text: [`ReductionCache::take_new`] gives what was
//! added, [`ReductionCache::restore`] takes it back. What cannot be read back is computed again.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::calibration::Prepared;
use super::calibration_sums::CalibrationSums;
use super::detector::Exposures;
use super::measure::FrameOutcome;
use super::region::Placement;
use super::register::Picture;

/// The sums of a calibration, as text to be stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CalibrationText {
    /// SHA-256 of all inputs: camera, rig, white reference, layout, dark and flat frames, form of the sums.
    pub key: String,
    /// Frames of the series that it was made of.
    pub dark_frames: Vec<i64>,
    /// The same of the flats.
    pub flat_frames: Vec<i64>,
    /// JSON.
    pub body: String,
}

/// What was computed of one frame, as text to be stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameText {
    /// Key of the calibration.
    pub calibration: String,
    /// The frame.
    pub frame_id: i64,
    /// Which part: `sums`, `sums REGION`, `exposures` or `picture`.
    pub part: String,
    /// JSON.
    pub body: String,
}

/// Texts that were read from a store, or that are to go there.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ReductionTexts {
    /// Calibrations.
    pub calibrations: Vec<CalibrationText>,
    /// Frames.
    pub frames: Vec<FrameText>,
}

impl ReductionTexts {
    /// Whether there is nothing to store.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.calibrations.is_empty() && self.frames.is_empty()
    }
}

/// What reductions of one series have computed already.
#[derive(Debug, Default)]
pub struct ReductionCache {
    kept: Mutex<Kept>,
}

impl ReductionCache {
    /// A cache whose content is stored: all poses are compared for the camera's curve, also those that this reduction leaves
    /// out and a later one may need.
    #[must_use]
    pub fn to_be_stored() -> Self {
        ReductionCache {
            kept: Mutex::new(Kept {
                is_stored: true,
                ..Kept::default()
            }),
        }
    }

    /// Takes back what a store kept. Texts of another form are passed over.
    pub fn restore(&self, texts: ReductionTexts) {
        let mut kept = self.lock();
        for text in texts.calibrations {
            if let Some(sums) =
                read::<CalibrationSums>(&text.body).filter(CalibrationSums::is_usable)
            {
                kept.calibrations.insert(text.key, Arc::new(sums));
            }
        }
        for text in texts.frames {
            let place = (text.calibration, text.frame_id);
            match text.part.as_str() {
                EXPOSURES => {
                    if let Some(Visited { frames, exposures }) = read(&text.body) {
                        let exposures = Arc::new(exposures);
                        kept.exposures.insert((place.0, frames), exposures);
                    }
                }
                PICTURE => {
                    if let Some(picture) = read(&text.body) {
                        kept.pictures.insert(place, Arc::new(picture));
                    }
                }
                part => {
                    if let Some(outcome) = read(&text.body) {
                        let place = (place.0, part.to_owned(), place.1);
                        kept.outcomes.insert(place, Arc::new(outcome));
                    }
                }
            }
        }
    }

    /// Gives what was added since the last call. Empty for a cache that is not to be stored.
    pub fn take_new(&self) -> ReductionTexts {
        std::mem::take(&mut self.lock().new)
    }

    /// One reduction at a time: the second finds what the first computed.
    pub(super) fn lock(&self) -> MutexGuard<'_, Kept> {
        // Rows are whole or absent, also where a holder panicked.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

const EXPOSURES: &str = "exposures";
const PICTURE: &str = "picture";

fn read<T: DeserializeOwned>(body: &str) -> Option<T> {
    serde_json::from_str(body).ok()
}

/// The exposures of one visit with the frames that they were made of.
#[derive(Serialize, Deserialize)]
struct Visited {
    frames: Vec<i64>,
    exposures: Exposures,
}

/// The content of a cache. Keys begin with that of the calibration.
#[derive(Debug, Default)]
pub(super) struct Kept {
    pub(super) is_stored: bool,
    calibrations: HashMap<String, Arc<CalibrationSums>>,
    /// The last calibration, pixel by pixel: needed while frames are still to be measured.
    planes: Option<(String, Arc<Prepared>)>,
    outcomes: HashMap<(String, String, i64), Arc<FrameOutcome>>,
    exposures: HashMap<(String, Vec<i64>), Arc<Exposures>>,
    pictures: HashMap<(String, i64), Arc<Option<Picture>>>,
    /// Where the board was found last.
    pub(super) placement: Placement,
    new: ReductionTexts,
}

impl Kept {
    pub(super) fn calibration(&self, key: &str) -> Option<Arc<CalibrationSums>> {
        self.calibrations.get(key).cloned()
    }

    pub(super) fn planes(&self, key: &str) -> Option<Arc<Prepared>> {
        let (of, planes) = self.planes.as_ref()?;
        (of == key).then(|| Arc::clone(planes))
    }

    pub(super) fn outcome(
        &self,
        key: &str,
        part: &str,
        frame_id: i64,
    ) -> Option<Arc<FrameOutcome>> {
        let place = (key.to_owned(), part.to_owned(), frame_id);
        self.outcomes.get(&place).cloned()
    }

    pub(super) fn exposures(&self, key: &str, frames: &[i64]) -> Option<Arc<Exposures>> {
        self.exposures
            .get(&(key.to_owned(), frames.to_vec()))
            .cloned()
    }

    pub(super) fn picture(&self, key: &str, frame_id: i64) -> Option<Arc<Option<Picture>>> {
        self.pictures.get(&(key.to_owned(), frame_id)).cloned()
    }

    pub(super) fn keep_planes(&mut self, key: &str, planes: &Arc<Prepared>) {
        self.planes = Some((key.to_owned(), Arc::clone(planes)));
    }

    pub(super) fn keep_calibration(
        &mut self,
        key: &str,
        frames: [Vec<i64>; 2],
        sums: &Arc<CalibrationSums>,
    ) {
        if let (true, Ok(body)) = (self.is_stored, serde_json::to_string(&**sums)) {
            let [dark_frames, flat_frames] = frames;
            self.new.calibrations.push(CalibrationText {
                key: key.to_owned(),
                dark_frames,
                flat_frames,
                body,
            });
        }
        self.calibrations.insert(key.to_owned(), Arc::clone(sums));
    }

    pub(super) fn keep_outcome(
        &mut self,
        key: &str,
        part: &str,
        frame_id: i64,
        outcome: &Arc<FrameOutcome>,
    ) {
        self.add_text(key, part, frame_id, &**outcome);
        let place = (key.to_owned(), part.to_owned(), frame_id);
        self.outcomes.insert(place, Arc::clone(outcome));
    }

    pub(super) fn keep_exposures(
        &mut self,
        key: &str,
        frames: Vec<i64>,
        exposures: &Arc<Exposures>,
    ) {
        if let Some(first) = frames.first().copied() {
            let visited = Visited {
                frames: frames.clone(),
                exposures: (**exposures).clone(),
            };
            self.add_text(key, EXPOSURES, first, &visited);
        }
        let place = (key.to_owned(), frames);
        self.exposures.insert(place, Arc::clone(exposures));
    }

    pub(super) fn keep_picture(&mut self, key: &str, frame_id: i64, picture: Option<Picture>) {
        self.add_text(key, PICTURE, frame_id, &picture);
        let place = (key.to_owned(), frame_id);
        self.pictures.insert(place, Arc::new(picture));
    }

    fn add_text<T: Serialize>(&mut self, key: &str, part: &str, frame_id: i64, what: &T) {
        if let (true, Ok(body)) = (self.is_stored, serde_json::to_string(what)) {
            self.new.frames.push(FrameText {
                calibration: key.to_owned(),
                frame_id,
                part: part.to_owned(),
                body,
            });
        }
    }
}

/// The part that holds a frame's sums for a region, with the board where it was found.
pub(super) fn part_of(region: Option<&str>, placement: &Placement) -> String {
    let mut part = "sums".to_owned();
    if let Some(region) = region {
        part = format!("{part} {region}");
    }
    if *placement != Placement::default() {
        part = format!("{part} {}", placement.words());
    }
    part
}
