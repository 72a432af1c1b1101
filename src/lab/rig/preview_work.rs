//! What a preview is: the request, the answer, the work for the owner of the rig, and the frames that are kept in memory.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use crate::bench::stage::StageStatus;
use crate::frame::{Frame, Picture};
use crate::lab::LabError;
use crate::preview::Area;
use crate::preview::exposures::Suggestion;
use crate::preview::figures::Figures;

/// Exposures of one preview.
pub const PREVIEW_EXPOSURES_MAX: usize = 8;
/// Sum of the exposures of one preview, s.
pub const PREVIEW_TIME_S_MAX: f64 = 60.0;
/// Exposures that a preview suggests at most.
pub const SUGGESTED_MAX: usize = 2;
/// Frames that are kept in memory.
const KEPT_MAX: usize = 16;
/// Bytes of counts that are kept in memory, beside the newest frame.
const KEPT_BYTES_MAX: usize = 128 << 20;

/// A preview to take.
#[derive(Debug, Clone, PartialEq)]
pub struct PreviewRequest {
    /// Exposures; those of the settings if omitted.
    pub exposures_s: Option<Vec<f64>>,
    /// Whether the lamp is on. Off needs a command of the settings.
    pub lamp: bool,
    /// The part of the frame to measure; all of it if omitted.
    pub area: Option<Area>,
    /// Number of exposures to suggest for a scan; as many as are taken, at most [`SUGGESTED_MAX`], if omitted.
    pub suggest: Option<usize>,
}

/// A preview.
#[derive(Debug, Clone)]
pub struct PreviewView {
    /// State of the stages.
    pub stages: StageStatus,
    /// Whether the lamp was on.
    pub lamp: bool,
    /// The part that was measured.
    pub area: Area,
    /// Whether a dark frame of this rig names the defect pixels. Otherwise they are full pixels without full neighbours.
    pub defects_known: bool,
    /// One frame per exposure.
    pub frames: Vec<PreviewFrame>,
    /// Exposures for a scan; `None` if none were requested.
    pub suggestion: Option<Suggestion>,
}

/// A frame of a preview.
#[derive(Debug, Clone)]
pub struct PreviewFrame {
    /// Number of the frame, for its picture and its counts.
    pub id: u64,
    /// Exposure time, s.
    pub exposure_s: f64,
    /// Start of the exposure in UTC.
    pub taken_at: time::OffsetDateTime,
    /// Size of the frame: columns, rows.
    pub size_px: (u32, u32),
    /// Counts, histogram, focus and defect pixels.
    pub figures: Figures,
    /// 8-bit picture of the frame.
    pub picture: Arc<Picture>,
}

/// A preview for the owner of the rig.
pub(in crate::lab) struct PreviewWork {
    pub exposures_s: Vec<f64>,
    pub request: PreviewRequest,
    /// Cancelled by any other order to the rig.
    pub give_way: CancellationToken,
    pub answer: oneshot::Sender<Result<PreviewView, LabError>>,
}

/// The newest frames of previews, and the defect pixels of the rig.
#[derive(Debug, Clone, Default)]
pub(in crate::lab) struct Previews {
    shared: Arc<Mutex<Shared>>,
}

#[derive(Debug, Default)]
struct Shared {
    kept: VecDeque<KeptFrame>,
    taken: u64,
    /// Number of the dark calibration, and its defect pixels.
    defects: Option<(i64, Arc<[bool]>)>,
}

#[derive(Debug, Clone)]
struct KeptFrame {
    id: u64,
    frame: Arc<Frame>,
    picture: Arc<Picture>,
}

impl Previews {
    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().expect("no holder of this lock panics")
    }

    /// Returns a frame that is still kept, and its picture.
    pub fn kept(&self, id: u64) -> Option<(Arc<Frame>, Arc<Picture>)> {
        let found = self
            .lock()
            .kept
            .iter()
            .find(|kept| kept.id == id)
            .cloned()?;
        Some((found.frame, found.picture))
    }

    /// Returns the defect pixels of a dark calibration, if they are known.
    pub fn defects(&self, calibration_id: i64) -> Option<Arc<[bool]>> {
        let known = self.lock().defects.clone();
        known.and_then(|(id, defects)| (id == calibration_id).then_some(defects))
    }

    /// Keeps the defect pixels of the newest dark calibration.
    pub fn keep_defects(&self, calibration_id: i64, defects: Arc<[bool]>) {
        self.lock().defects = Some((calibration_id, defects));
    }

    /// Keeps a frame and returns its number. The oldest frames are dropped.
    pub fn keep(&self, frame: Arc<Frame>, picture: Arc<Picture>) -> u64 {
        let mut shared = self.lock();
        shared.taken += 1;
        let id = shared.taken;
        shared.kept.push_back(KeptFrame { id, frame, picture });
        let bytes = |shared: &Shared| -> usize {
            let all = shared.kept.iter();
            all.map(|kept| size_of_val(kept.frame.pixels_dn())).sum()
        };
        while shared.kept.len() > 1
            && (shared.kept.len() > KEPT_MAX || bytes(&shared) > KEPT_BYTES_MAX)
        {
            shared.kept.pop_front();
        }
        id
    }
}
