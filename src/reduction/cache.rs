//! What reductions of one series have computed already, so that no frame is read twice.
//!
//! A [`ReductionCache`] belongs to a source of frames. It keeps the sums of every frame that was measured, per region and
//! calibration, and the calibration's own sums. A cache with a [`TextStore`] stores the same as text and keeps only
//! [`IN_MEMORY`] rows of each part in memory, so memory does not grow with the series; it reads the others back where they are
//! needed. What cannot be read back when the cache is filled is computed again.

use std::collections::{HashMap, HashSet};
use std::fmt::Debug;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::ReductionError;
use super::calibration::Prepared;
use super::calibration_sums::CalibrationSums;
use super::detector::Exposures;
use super::measure::FrameOutcome;
use super::region::Placement;
use super::register::Picture;

/// Rows of one part that stay in memory where a store has them too. A scan of 108 poses at three exposure times has 324.
pub(super) const IN_MEMORY: usize = 512;
/// Frames whose sums are read from the store at once.
const READ_AT_ONCE: usize = 256;

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

/// Texts that are to be stored.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ReductionTexts {
    /// Calibrations.
    pub calibrations: Vec<CalibrationText>,
    /// Frames.
    pub frames: Vec<FrameText>,
}

/// Where the texts of a cache are stored. A reduction calls it on its own thread, which may wait.
pub trait TextStore: Debug + Send + Sync {
    /// Stores texts, and returns for each frame's whether it is there now: another one of the same frame and part stays.
    ///
    /// # Errors
    /// Why nothing was stored.
    fn add(&self, texts: &ReductionTexts) -> Result<Vec<bool>, String>;

    /// Returns the bodies of a part by frame, in any order. Frames without one are absent.
    ///
    /// # Errors
    /// Why nothing was read.
    fn bodies(
        &self,
        calibration: &str,
        part: &str,
        frame_ids: &[i64],
    ) -> Result<Vec<(i64, String)>, String>;
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
    pub fn stored_in(store: Arc<dyn TextStore>) -> Self {
        ReductionCache {
            kept: Mutex::new(Kept {
                store: Some(store),
                ..Kept::default()
            }),
        }
    }

    /// Takes back what a store has of a calibration. A text of another form is passed over.
    pub fn restore_calibration(&self, key: &str, body: &str) {
        if let Some(sums) = read::<CalibrationSums>(body).filter(CalibrationSums::is_usable) {
            let sums = Arc::new(sums);
            self.lock().calibrations.insert(key.to_owned(), sums);
        }
    }

    /// Takes back what a store has of a frame. A text of another form is passed over.
    pub fn restore_frame(&self, text: &FrameText) {
        if let Some((frames, row)) = CachedRow::read(&text.part, text.frame_id, &text.body) {
            let mut kept = self.lock();
            let is_stored = kept.store.is_some();
            let shelf = kept.shelf(&text.calibration, &text.part);
            shelf.here.insert(frames.clone(), row);
            if is_stored {
                shelf.leave_to_store(frames);
            }
        }
    }

    /// Rows in memory, by part.
    #[cfg(test)]
    pub(super) fn held(&self) -> Vec<usize> {
        let kept = self.lock();
        let shelves = kept.shelves.values().flat_map(HashMap::values);
        let mut held: Vec<usize> = shelves.map(|shelf| shelf.here.len()).collect();
        held.sort_unstable();
        held
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

/// What a cache keeps of a frame, or of the frames of a visit.
#[derive(Debug, Clone)]
enum CachedRow {
    Outcome(Arc<FrameOutcome>),
    Visit(Arc<Exposures>),
    Picture(Arc<Option<Picture>>),
}

impl CachedRow {
    /// Reads a stored row, with the frames that it is of.
    fn read(part: &str, frame_id: i64, body: &str) -> Option<(Vec<i64>, CachedRow)> {
        match part {
            EXPOSURES => {
                let Visited { frames, exposures } = read(body)?;
                Some((frames, CachedRow::Visit(Arc::new(exposures))))
            }
            PICTURE => Some((vec![frame_id], CachedRow::Picture(Arc::new(read(body)?)))),
            _ => Some((vec![frame_id], CachedRow::Outcome(Arc::new(read(body)?)))),
        }
    }
}

/// The rows of one part under one calibration, by the frames that they are of.
#[derive(Debug, Default)]
struct Shelf {
    here: HashMap<Vec<i64>, CachedRow>,
    /// Rows that only the store has.
    stored: HashSet<Vec<i64>>,
}

impl Shelf {
    /// Drops a stored row from memory where there are many. Pictures stay: the placement of a board needs all at once.
    fn leave_to_store(&mut self, frames: Vec<i64>) {
        let is_picture = matches!(self.here.get(&frames), Some(CachedRow::Picture(_)));
        if self.here.len() > IN_MEMORY && !is_picture {
            self.here.remove(&frames);
            self.stored.insert(frames);
        }
    }

    fn has(&self, frames: &[i64]) -> bool {
        self.here.contains_key(frames) || self.stored.contains(frames)
    }
}

/// The content of a cache. Keys are those of the calibration.
#[derive(Debug, Default)]
pub(super) struct Kept {
    store: Option<Arc<dyn TextStore>>,
    calibrations: HashMap<String, Arc<CalibrationSums>>,
    /// The last calibration, pixel by pixel: needed while frames are still to be measured.
    planes: Option<(String, Arc<Prepared>)>,
    /// By calibration and part.
    shelves: HashMap<String, HashMap<String, Shelf>>,
    /// Where the board was found last.
    pub(super) placement: Placement,
    /// What is not stored yet, with the frames that each of its texts is of.
    new: ReductionTexts,
    new_frames: Vec<Vec<i64>>,
}

impl Kept {
    pub(super) fn is_stored(&self) -> bool {
        self.store.is_some()
    }

    pub(super) fn calibration(&self, key: &str) -> Option<Arc<CalibrationSums>> {
        self.calibrations.get(key).cloned()
    }

    pub(super) fn planes(&self, key: &str) -> Option<Arc<Prepared>> {
        let (of, planes) = self.planes.as_ref()?;
        (of == key).then(|| Arc::clone(planes))
    }

    /// Whether a frame's outcome over that many segments is known.
    pub(super) fn has_outcome(
        &self,
        key: &str,
        part: &str,
        frame_id: i64,
        segments: usize,
    ) -> bool {
        let frames = [frame_id];
        let Some(shelf) = self.on_shelf(key, part) else {
            return false;
        };
        match shelf.here.get(frames.as_slice()) {
            Some(CachedRow::Outcome(outcome)) => outcome.is_of(segments),
            _ => shelf.stored.contains(frames.as_slice()),
        }
    }

    /// Calls `each` with the outcome over that many segments of every one of these frames, in their order.
    ///
    /// # Errors
    /// [`ReductionError::Vanished`] if the store no longer gives what it had.
    pub(super) fn each_outcome(
        &self,
        (key, part, segments): (&str, &str, usize),
        frame_ids: &[i64],
        mut each: impl FnMut(i64, &FrameOutcome),
    ) -> Result<(), ReductionError> {
        let here = |id: i64| match self.on_shelf(key, part)?.here.get([id].as_slice()) {
            Some(CachedRow::Outcome(outcome)) => Some(Arc::clone(outcome)),
            _ => None,
        };
        for ids in frame_ids.chunks(READ_AT_ONCE) {
            let only_stored: Vec<i64> = ids
                .iter()
                .copied()
                .filter(|id| here(*id).is_none())
                .collect();
            let mut read = self.read_back(key, part, &only_stored)?;
            for id in ids {
                let outcome = match (here(*id), read.remove([*id].as_slice())) {
                    (Some(outcome), _) | (None, Some(CachedRow::Outcome(outcome))) => outcome,
                    _ => return Err(vanished("one is no longer there")),
                };
                if !outcome.is_of(segments) {
                    return Err(vanished("one is of another region"));
                }
                each(*id, &outcome);
            }
        }
        Ok(())
    }

    pub(super) fn has_exposures(&self, key: &str, frames: &[i64]) -> bool {
        let shelf = self.on_shelf(key, EXPOSURES);
        shelf.is_some_and(|shelf| shelf.has(frames))
    }

    /// The exposures of a visit; `None` where it was not read yet.
    ///
    /// # Errors
    /// As [`Kept::each_outcome`].
    pub(super) fn exposures(
        &self,
        key: &str,
        frames: &[i64],
    ) -> Result<Option<Arc<Exposures>>, ReductionError> {
        let Some(shelf) = self.on_shelf(key, EXPOSURES).filter(|s| s.has(frames)) else {
            return Ok(None);
        };
        let row = match shelf.here.get(frames) {
            Some(row) => Some(row.clone()),
            None => self.read_back(key, EXPOSURES, &frames[..1])?.remove(frames),
        };
        match row {
            Some(CachedRow::Visit(exposures)) => Ok(Some(exposures)),
            _ => Err(vanished("those of a visit are no longer there")),
        }
    }

    pub(super) fn picture(&self, key: &str, frame_id: i64) -> Option<Arc<Option<Picture>>> {
        match self.on_shelf(key, PICTURE)?.here.get([frame_id].as_slice()) {
            Some(CachedRow::Picture(picture)) => Some(Arc::clone(picture)),
            _ => None,
        }
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
        if let (true, Ok(body)) = (self.is_stored(), serde_json::to_string(&**sums)) {
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
        outcome: FrameOutcome,
    ) {
        self.add_text(key, part, &[frame_id], &outcome);
        let row = CachedRow::Outcome(Arc::new(outcome));
        self.shelf(key, part).here.insert(vec![frame_id], row);
    }

    pub(super) fn keep_exposures(
        &mut self,
        key: &str,
        frames: Vec<i64>,
        exposures: &Arc<Exposures>,
    ) {
        let visited = Visited {
            frames: frames.clone(),
            exposures: (**exposures).clone(),
        };
        self.add_text(key, EXPOSURES, &frames, &visited);
        let row = CachedRow::Visit(Arc::clone(exposures));
        self.shelf(key, EXPOSURES).here.insert(frames, row);
    }

    pub(super) fn keep_picture(&mut self, key: &str, frame_id: i64, picture: Option<Picture>) {
        self.add_text(key, PICTURE, &[frame_id], &picture);
        let row = CachedRow::Picture(Arc::new(picture));
        self.shelf(key, PICTURE).here.insert(vec![frame_id], row);
    }

    /// Stores what is new. What the store does not take stays in memory.
    pub(super) fn save(&mut self) {
        let (new, frames) = (
            std::mem::take(&mut self.new),
            std::mem::take(&mut self.new_frames),
        );
        let Some(store) = self.store.clone() else {
            return;
        };
        if new.calibrations.is_empty() && new.frames.is_empty() {
            return;
        }
        match store.add(&new) {
            Ok(added) => {
                for ((text, frames), _) in
                    (new.frames.iter().zip(frames).zip(added)).filter(|(_, added)| *added)
                {
                    self.shelf(&text.calibration, &text.part)
                        .leave_to_store(frames);
                }
            }
            Err(why) => tracing::warn!(
                "the sums of new frames could not be stored: {why}; they are computed again after a restart"
            ),
        }
    }

    fn on_shelf(&self, key: &str, part: &str) -> Option<&Shelf> {
        self.shelves.get(key)?.get(part)
    }

    fn shelf(&mut self, key: &str, part: &str) -> &mut Shelf {
        let parts = self.shelves.entry(key.to_owned()).or_default();
        parts.entry(part.to_owned()).or_default()
    }

    /// Reads rows that only the store has.
    fn read_back(
        &self,
        key: &str,
        part: &str,
        frame_ids: &[i64],
    ) -> Result<HashMap<Vec<i64>, CachedRow>, ReductionError> {
        let Some(store) = self.store.as_ref().filter(|_| !frame_ids.is_empty()) else {
            return Ok(HashMap::new());
        };
        let bodies = store.bodies(key, part, frame_ids).map_err(vanished)?;
        let rows = bodies
            .iter()
            .filter_map(|(id, body)| CachedRow::read(part, *id, body));
        Ok(rows.collect())
    }

    fn add_text<T: Serialize>(&mut self, key: &str, part: &str, frames: &[i64], what: &T) {
        if let (true, Some(first), Ok(body)) = (
            self.is_stored(),
            frames.first(),
            serde_json::to_string(what),
        ) {
            self.new.frames.push(FrameText {
                calibration: key.to_owned(),
                frame_id: *first,
                part: part.to_owned(),
                body,
            });
            self.new_frames.push(frames.to_vec());
        }
    }
}

fn vanished(why: impl std::fmt::Display) -> ReductionError {
    tracing::error!("the stored sums of frames cannot be read back: {why}");
    ReductionError::Vanished {
        what: "the stored sums of some frames",
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
