//! The map of a sample: ridge angle, roughness and lean direction of every pixel, from the frames of a series.
//!
//! Call [`map`]. It works in these steps:
//!
//! 1. `signals`: reads darks and flats, and resamples every sample frame into the sample's frame.
//! 2. `calibration`: fits the mean of the pixels, which gives what all of them share (`globals`), and the means of clusters of like
//!    pixels (`clusters`).
//! 3. `solve`: fits every pixel with the `sawtooth` closed form, from the surface of its cluster. A vector register has several
//!    pixels; tiles run in parallel. `higher_order_terms` and `double_reflection` correct the closed form.
//! 4. [`defects`] marks borders and defects; `basis` lists what is doubtful or omitted.
//!
//! [`shards`](mod@shards) splits the tiles between runs and merges their results. Each run repeats steps 1 and 2; the merge does
//! step 4.
//!
//! [`summary`] reduces a map to numbers. [`write::write`] makes the files; [`folder::map_into`] does both. Run time is
//! proportional to pixels × observations. Memory is bounded by [`MapOptions::memory_bytes_max`]; larger planes go to a
//! scratch file.
//!
//! [`plan`](mod@plan) decides which terms are omitted, on the surfaces that represent most pixels.
//!
//! The layout of the sample is not needed, because each pixel's lean direction is free. This module knows no scans and no command
//! line.

mod basis;
mod calibration;
pub mod defects;
mod double_reflection;
mod field_variation;
pub mod folder;
mod higher_order_terms;
pub mod layers;
mod picture;
pub mod pixels;
pub mod plan;
mod run;
pub mod shards;
mod signals;
mod solve;
pub mod summary;
mod tiles;
pub mod write;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use self::basis::{Basis, finished};
use self::calibration::GlobalCalibration;
use self::calibration::globals::Given;
pub use self::calibration::globals::Globals;
use self::layers::Layers;
use self::signals::Light;
use self::signals::planes::Planes;
use self::signals::view::View;
use self::solve::kernel::FREE;
use self::tiles::{fit_tiles, sampled};
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::model::LeftOut;
use crate::observation::RejectedFrame;
use crate::reduction::{CountedReads, FrameSource, ReductionError, calibrate};
use crate::shard::Shard;

/// Largest number of times that the costly terms are recomputed within a pixel's descent.
const REFRESHES: u8 = 3;
/// The region of a layout whose mean is fitted: a board has patches of two surfaces, and the mean of both is that of none.
const REGION: &str = "even";

/// Limits and tolerances of a map.
#[derive(Debug, Clone)]
pub struct MapOptions {
    /// Planes larger than this, in bytes, go to a scratch file.
    pub memory_bytes_max: usize,
    /// Folder for the scratch file.
    pub scratch: PathBuf,
    /// Share of the brightest radiance that may be omitted from a pixel's model to save time (see [`plan`]). `None`
    /// omits nothing for the sake of time.
    pub target_error: Option<f64>,
    /// Seconds after which no further tile is started; applied by the caller that holds the clock (see [`map_until`]).
    pub max_seconds: Option<f64>,
}

impl Default for MapOptions {
    fn default() -> Self {
        MapOptions {
            memory_bytes_max: 1 << 30,
            scratch: std::env::temp_dir(),
            target_error: None,
            max_seconds: None,
        }
    }
}

/// A step of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Darks and flats are read.
    Calibrating,
    /// Sample frames are read and resampled into the sample's frame; counted in poses.
    Resampling,
    /// Frames are read once more, for the fit of the pixels' mean.
    Averaging,
    /// The quantities that all pixels share, and the surfaces from which they start, are determined.
    Settling,
    /// Pixels are fitted; counted in pixels.
    Fitting,
}

impl Stage {
    /// Returns the step's name for the user.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Stage::Calibrating => "darks and flats",
            Stage::Resampling => "reading poses",
            Stage::Settling => "determining what all pixels share",
            Stage::Fitting => "fitting pixels",
            Stage::Averaging => "fitting the mean of the pixels",
        }
    }
}

/// Progress within a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// The step.
    pub stage: Stage,
    /// Units done.
    pub done: usize,
    /// Units in all.
    pub total: usize,
}

/// The reason why no map was made.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// Darks and flats could not be read.
    #[error(transparent)]
    Reduction(#[from] ReductionError),
    /// There are fewer poses than a pixel has unknowns.
    #[error(
        "{poses} poses cannot determine five parameters per pixel; scan at least {least}, better 5 tilts × 8 azimuths"
    )]
    TooFewPoses {
        /// Poses of the series.
        poses: usize,
        /// Least number of poses.
        least: usize,
    },
    /// All frames are dark.
    #[error(
        "the sample frames show no light above their noise; check lamp, lens cap and exposure times"
    )]
    NothingSeen,
    /// Every sample frame was rejected.
    #[error(
        "all {frames} sample frames were rejected, the first ({file}) as {why}; check the frames, their exposure times and the [camera] table of the manifest"
    )]
    AllLeftOut {
        /// Number of sample frames.
        frames: usize,
        /// The first of them.
        file: String,
        /// The reason why the first was rejected.
        why: String,
    },
    /// Every count is masked.
    #[error(
        "no pixel of the sample frames has a usable count: all are saturated, or darks and flats mark every pixel as defective; shorten the exposure times and check the flats"
    )]
    NothingUsable,
    /// No pixel shows a lobe.
    #[error(
        "no pixel shows the reflection of a ridged surface: its brightness changes with the pose no more than that of a matte surface; check focus, region and azimuths of the scan"
    )]
    NoLobes,
    /// No pixel's fit converged.
    #[error(
        "no pixel could be fitted at these {poses} poses (usual χ² per degree of freedom {chi2:.1}): they do not determine the lobes; scan more tilts and azimuths, or fit the whole area"
    )]
    NothingFitted {
        /// Poses of the series.
        poses: usize,
        /// Median χ² per degree of freedom of the sampled pixels' best fits.
        chi2: f64,
    },
    /// The scratch file failed.
    #[error(
        "the scratch file of the map failed: {0}; free disk space or choose another output folder"
    )]
    Scratch(std::io::Error),
    /// The time limit passed before a pixel with a lobe was fitted.
    #[error("the time limit passed before a pixel with a lobe was fitted; allow more seconds")]
    Late,
    /// The cancel flag was raised.
    #[error("the map was cancelled")]
    Cancelled,
}

/// A finished map.
#[derive(Debug, Clone)]
pub struct Map {
    /// Parameters, uncertainties and flags.
    pub layers: Layers,
    /// Millimetres per pixel (columns, rows); `None` if the manifest states no field size.
    pub pixel_mm: Option<[f64; 2]>,
    /// Column and row of the rotation axis, from the outer corner of the first pixel.
    pub axis_px: [f64; 2],
    /// What all pixels share.
    pub globals: Globals,
    /// Standard uncertainty of every pixel due to the shared quantities and the model discrepancy, per parameter in the
    /// layers' units (medians; absolute for α).
    pub shared_std: Option<[f64; FREE]>,
    /// Usual χ² per degree of freedom; standard uncertainties are scaled by its square root.
    pub birge: f64,
    /// Lean directions that many pixels share.
    pub leans: Vec<defects::Lean>,
    /// Connected areas that differ from the rest.
    pub defects: Vec<defects::Defect>,
    /// Pixels that were fitted.
    pub pixels_fitted: usize,
    /// Pixels from which the shared quantities were determined.
    pub pixels_sampled: usize,
    /// Evaluations per fitted pixel.
    pub evaluations: f64,
    /// Poses, which are the observations per pixel.
    pub n_poses: usize,
    /// Frames that were rejected.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
    /// What the model omits, why, and at which cost (as a share of the brightest radiance).
    pub left_out: Vec<LeftOut>,
    /// Pixels not reached within the time limit; flagged `few_observations`, with zero observations.
    pub pixels_left_out: usize,
}

/// Maps the sample of a series.
///
/// # Errors
/// [`MapError`]. Single unusable frames are no error: they are listed in `rejected_frames`.
pub fn map(
    source: &dyn FrameSource,
    options: &MapOptions,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Map, MapError> {
    map_until(source, options, &|| false, progress, cancel)
}

/// As [`map`], but starts no further tile once `late` returns true. The order of the tiles spreads over the field, so a
/// map that ends early covers all of it coarsely.
///
/// # Errors
/// [`MapError`], also if `late` returns true before the first tile.
pub fn map_until(
    source: &dyn FrameSource,
    options: &MapOptions,
    late: &(dyn Fn() -> bool + Sync),
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Map, MapError> {
    let (planes, settled, basis) = prepared(source, options, late, progress, cancel)?;
    let tiles = fit_tiles(&planes, &settled, Shard::WHOLE, late, progress, cancel)?;
    drop(planes);
    finished(basis, tiles)
}

/// Reads all frames and determines what the pixels share: everything before the first pixel is fitted.
fn prepared(
    source: &dyn FrameSource,
    options: &MapOptions,
    late: &(dyn Fn() -> bool + Sync),
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<(Planes, GlobalCalibration, Basis), MapError> {
    let manifest = source.manifest();
    let view = View::new(manifest);
    let material = manifest.material();
    let groups = signals::poses(source);
    if groups.len() <= FREE {
        return Err(MapError::TooFewPoses {
            poses: groups.len(),
            least: FREE + 1,
        });
    }
    progress(Progress {
        stage: Stage::Calibrating,
        done: 0,
        total: 1,
    });
    let calibration = calibrate(source, cancel)?;
    let light = Light::new(&calibration, calibration.radiance_per_dn_s().unwrap_or(1.0));
    let planes = Planes::new(
        groups.len(),
        view.pixels(),
        options.memory_bytes_max,
        &options.scratch,
    )
    .map_err(MapError::Scratch)?;
    let mut rejected = calibration.rejected_frames.clone();
    let left_out = signals::observe(source, &light, &view, &groups, &planes, progress, cancel)?;
    let frames = source.rows().iter();
    let frames = frames.filter(|row| row.kind == FrameKind::Sample).count();
    if let (true, Some(first)) = (left_out.len() >= frames, left_out.first()) {
        return Err(MapError::AllLeftOut {
            frames,
            file: first.file.clone(),
            why: first.cause(),
        });
    }
    rejected.extend(left_out);

    let recorded: Vec<Pose> = groups.iter().map(|g| g.pose).collect();
    let batch = sampled(&planes)?;
    if late() {
        return Err(MapError::Late);
    }
    // All frames are read once more, which takes as long as the first time.
    let averaging = |done: usize, total| {
        progress(Progress {
            stage: Stage::Averaging,
            done: done.min(total),
            total,
        });
    };
    let region = manifest.sample.layout.is_some().then_some(REGION);
    let mean = crate::reduction::reduce(&CountedReads::new(source, &averaging), region, cancel);
    let white = calibration.white_reference();
    let settled = calibration::settle(
        &batch,
        &view,
        &Given {
            rig: view.imaging.rig,
            material: &material,
            recorded: &recorded,
            flats: &calibration.flats(),
            white,
            largest: batch.largest(),
            target_error: options.target_error,
        },
        mean,
        progress,
        cancel,
    )?;
    let warnings = &calibration.warnings;
    let basis = Basis::new(manifest, warnings, rejected, white.is_some(), &settled);
    Ok((planes, settled, basis))
}

#[cfg(test)]
mod ambiguous_tests;
#[cfg(test)]
mod extreme_tests;
#[cfg(test)]
mod tests;
