//! A stored scan as a series: the input of a reduction and of an export.

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::{Lab, LabError};
use crate::frame::{Frame, FrameKind};
use crate::reduction::{FrameReadError, FrameSource, ReductionCache, calibration_keys};
use crate::scan::plan::{DarkPlan, FlatPlan, PlanPose};
use crate::scan::{Plan, ScanState};
use crate::series::{FrameRow, Manifest};
use crate::store::frames::FrameRecord;
use crate::store::scans::Origin;
use crate::store::{Store, StoreError};

/// A stored scan in the form of a recorded series, with the frames of its calibrations.
#[derive(Debug, Clone)]
pub struct StoredSeries {
    store: Store,
    manifest: Manifest,
    rows: Vec<FrameRow>,
    ids: Vec<i64>,
    sha256: Vec<String>,
    /// What was computed of its frames.
    reductions: Arc<ReductionCache>,
    is_growing: bool,
    /// Newest frame.
    pub last_frame_id: i64,
    /// Whether no frame was left out.
    pub(super) is_whole: bool,
}

impl StoredSeries {
    /// Opens a scan of the store; frames are read on demand.
    ///
    /// # Errors
    /// An unknown scan, or a store error.
    pub async fn open(store: &Store, scan_id: i64) -> Result<StoredSeries, LabError> {
        let manifest = store.manifest(scan_id).await?;
        let manifest = Manifest::from_toml(&manifest, "manifest.toml")?;
        let imported = store.scan(scan_id).await?.origin == Origin::Import;
        let records = store.frames_for_reduction(scan_id).await?;
        let last_frame_id = records.iter().map(|r| r.id).max().unwrap_or(0);
        let mut rows = Vec::with_capacity(records.len());
        let mut ids = Vec::with_capacity(records.len());
        let mut sha256 = Vec::with_capacity(records.len());
        for record in records {
            rows.push(row(&record, imported));
            ids.push(record.id);
            sha256.push(record.sha256);
        }
        let mut series = StoredSeries {
            store: store.clone(),
            manifest,
            rows,
            ids,
            sha256,
            reductions: Arc::default(),
            is_growing: false,
            last_frame_id,
            is_whole: true,
        };
        // A series that gives no observations has nothing to share.
        if let Ok(keys) = calibration_keys(&series) {
            series.reductions = store.reductions(scan_id, &keys).await?;
        }
        Ok(series)
    }

    /// The same of a scan that still takes frames (see [`FrameSource::is_growing`]).
    ///
    /// # Errors
    /// As [`StoredSeries::open`].
    pub async fn open_growing(store: &Store, scan_id: i64) -> Result<StoredSeries, LabError> {
        let mut series = StoredSeries::open(store, scan_id).await?;
        series.is_growing = true;
        Ok(series)
    }

    /// Removes the frames whose files are missing or damaged, and returns which and why.
    pub(super) fn without_unreadable(
        mut self,
        cancel: &AtomicBool,
    ) -> Result<(Self, Vec<String>), LabError> {
        let mut skipped = Vec::new();
        let ids = self.ids.drain(..);
        let frames = self.rows.drain(..).zip(self.sha256.drain(..)).zip(ids);
        let (mut rows, mut sha256, mut ids) = (Vec::new(), Vec::new(), Vec::new());
        for ((row, hash), id) in frames {
            if cancel.load(Ordering::Relaxed) {
                return Err(LabError::BrokenOff);
            }
            match self.store.read_png(&hash) {
                Ok(_) => {
                    rows.push(row);
                    sha256.push(hash);
                    ids.push(id);
                }
                Err(error @ StoreError::FrameDamaged { .. }) => {
                    skipped.push(format!("{}: {error}", row.file));
                }
                Err(error) => return Err(error.into()),
            }
        }
        self.is_whole = skipped.is_empty();
        (self.rows, self.sha256, self.ids) = (rows, sha256, ids);
        Ok((self, skipped))
    }

    /// Returns the frames with the SHA-256 of their files.
    pub(super) fn hashes(&self) -> impl Iterator<Item = (&FrameRow, &str)> {
        self.rows.iter().zip(self.sha256.iter().map(String::as_str))
    }

    /// Reads the PNG file of a frame.
    pub(super) fn read_png(&self, index: usize) -> Result<Vec<u8>, StoreError> {
        self.store.read_png(&self.sha256[index])
    }
}

fn row(record: &FrameRecord, imported: bool) -> FrameRow {
    // Dark frames of a series have angles 0, 0; the store has the real ones.
    let (theta_c_deg, phi_s_deg) = match record.kind {
        FrameKind::Dark if !imported => (0.0, 0.0),
        _ => (record.theta_c_deg, record.phi_s_deg),
    };
    FrameRow {
        file: record.name.clone(),
        kind: record.kind,
        theta_c_deg,
        phi_s_deg,
        exposure_s: record.exposure_s,
        repeat: record.repeat,
        timestamp: record.timestamp.clone(),
    }
}

/// Returns the poses, exposures and repeats of a recorded series as a plan.
pub(super) fn plan_of_rows(rows: &[FrameRow]) -> Plan {
    let values = |kind: FrameKind, of: &dyn Fn(&FrameRow) -> f64| {
        let mut all: Vec<f64> = rows.iter().filter(|f| f.kind == kind).map(of).collect();
        all.sort_by(f64::total_cmp);
        // Recorded positions of the same pose differ slightly.
        all.dedup_by(|a, b| (*a - *b).abs() < 0.005);
        all
    };
    let repeats = |kind: FrameKind| {
        let last = rows.iter().filter(|f| f.kind == kind).map(|f| f.repeat + 1);
        last.max().unwrap_or(0)
    };
    let exposures = |kind: FrameKind| {
        let mut all: Vec<f64> = rows
            .iter()
            .filter(|f| f.kind == kind)
            .map(|f| f.exposure_s)
            .collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    };
    let theta_c_deg = values(FrameKind::Sample, &|f| f.theta_c_deg);
    let phi_s_deg = values(FrameKind::Sample, &|f| f.phi_s_deg);
    Plan {
        poses: poses_beside_a_grid(rows, &theta_c_deg, &phi_s_deg),
        theta_c_deg,
        phi_s_deg,
        exposures_s: exposures(FrameKind::Sample),
        repeats: repeats(FrameKind::Sample),
        dark: DarkPlan {
            repeats: repeats(FrameKind::Dark),
        },
        flat: FlatPlan {
            theta_c_deg: values(FrameKind::Flat, &|f| f.theta_c_deg),
            exposures_s: exposures(FrameKind::Flat),
            repeats: repeats(FrameKind::Flat),
        },
        reuse_calibrations: false,
        reference_every: 0,
    }
}

/// Returns the poses of the sample in the order of its rows; none if each tilt was visited at each azimuth.
fn poses_beside_a_grid(
    rows: &[FrameRow],
    tilts_deg: &[f64],
    azimuths_deg: &[f64],
) -> Vec<PlanPose> {
    // Recorded positions of the same pose differ slightly: each is the list's value that is nearest.
    let nearest = |values: &[f64], of: f64| {
        let after = values.partition_point(|value| *value < of);
        let before = after.saturating_sub(1);
        match values.get(after) {
            Some(next) if (next - of).abs() < (values[before] - of).abs() => after,
            _ => before,
        }
    };
    let mut seen = HashSet::new();
    let mut poses = Vec::new();
    for row in rows.iter().filter(|row| row.kind == FrameKind::Sample) {
        let tilt = nearest(tilts_deg, row.theta_c_deg);
        let azimuth = nearest(azimuths_deg, row.phi_s_deg);
        if seen.insert((tilt, azimuth)) {
            poses.push(PlanPose {
                theta_c_deg: tilts_deg[tilt],
                phi_s_deg: azimuths_deg[azimuth],
            });
        }
    }
    match poses.len() == tilts_deg.len() * azimuths_deg.len() {
        true => Vec::new(),
        false => poses,
    }
}

impl FrameSource for StoredSeries {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    fn frame_id(&self, index: usize) -> i64 {
        self.ids[index]
    }

    fn reductions(&self) -> Option<&ReductionCache> {
        Some(&self.reductions)
    }

    fn is_growing(&self) -> bool {
        self.is_growing
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        metrics::counter!("ridged_frames_decoded_total").increment(1);
        let file = || self.rows[index].file.clone();
        let png = self
            .read_png(index)
            .map_err(|source| FrameReadError::Store {
                file: file(),
                source: Box::new(source),
            })?;
        Frame::from_png(&png).map_err(|source| FrameReadError::NotAFrame {
            file: file(),
            source,
        })
    }
}

impl Lab {
    /// Returns the poses, exposures and repeats of an imported series as a plan.
    ///
    /// # Errors
    /// A store error.
    pub async fn plan_of_import(&self, scan_id: i64) -> Result<Plan, LabError> {
        let frames = self.store().frames_for_reduction(scan_id).await?;
        let rows: Vec<FrameRow> = frames.iter().map(|record| row(record, true)).collect();
        Ok(plan_of_rows(&rows))
    }

    /// Returns the manifest of a scan.
    ///
    /// # Errors
    /// An unknown scan, or a store error.
    pub async fn manifest(&self, scan_id: i64) -> Result<Manifest, LabError> {
        let text = self.store().manifest(scan_id).await?;
        Ok(Manifest::from_toml(&text, "manifest.toml")?)
    }

    /// Returns the regions of a sample with patches; empty for any other sample.
    #[must_use]
    pub fn regions(manifest: &Manifest) -> Vec<String> {
        let Some(layout) = &manifest.sample.layout else {
            return Vec::new();
        };
        let patches = (0..layout.patches_x)
            .flat_map(|i| (0..layout.patches_y).map(move |j| format!("patch-{i}-{j}")));
        ["even".to_owned(), "odd".to_owned()]
            .into_iter()
            .chain(patches)
            .collect()
    }

    /// Returns whether a scan in this state may get more frames.
    pub(super) fn more_frames_may_come(state: ScanState) -> bool {
        !state.is_end() && state != ScanState::Interrupted
    }
}
