//! The map of a sample: ridge angle, roughness and lean direction of every pixel, from the frames of a series.
//!
//! Call [`map`]. It works in these steps:
//!
//! 1. It reads darks and flats, and resamples every sample frame into the sample's frame (`observe`, `view`).
//! 2. It determines what all pixels share, from a sample of pixels (`settle`, `globals`).
//! 3. It fits every pixel with the `sawtooth` closed form, several pixels per vector register and tiles in parallel
//!    (`kernel`, `solve`, `costly`, `integrated`), and refits pixels that may have ended in a local minimum (`doubt`).
//! 4. It marks borders and defects (`defects`).
//!
//! [`summary`] reduces a map to numbers. [`write::write`] makes the files; [`folder::map_into`] does both. Run time is
//! proportional to pixels × observations. Memory is bounded by [`MapOptions::memory_bytes_max`]; larger planes go to a
//! scratch file.
//!
//! [`plan`](mod@plan) decides which terms are omitted, on the surfaces that represent most pixels.
//!
//! The layout of the sample is not needed: each pixel's lean direction is free. This module does not depend on scans or
//! on the command line.

mod beside;
mod costly;
pub mod defects;
mod doubt;
pub mod folder;
mod globals;
mod integrated;
mod inverse;
mod kernel;
pub mod layers;
mod misfit;
mod observe;
mod picture;
pub mod pixels;
pub mod plan;
mod planes;
mod run;
mod settle;
mod solve;
mod start;
pub mod summary;
mod tiles;
mod together;
mod view;
pub mod write;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

pub use self::globals::Globals;
use self::kernel::Parameters;
use self::layers::Layers;
use self::observe::Light;
use self::planes::Planes;
use self::settle::{References, Settled};
use self::solve::FREE;
use self::tiles::{fit_tiles, sampled};
use self::view::View;
use crate::frame::FrameKind;
use crate::geometry::{Pose, turn_by_wedge};
use crate::model::{LeftOut, left_out};
use crate::observation::RejectedFrame;
use crate::plan::Decision;
use crate::reduction::{FrameSource, ReductionError, calibrate};
use crate::units::Angle;

/// Number of times that the costly terms are recomputed within a pixel's descent, at most.
const REFRESHES: u8 = 3;

/// Common standard uncertainty of the ridge angle, in degrees, above which the map warns.
const SHARED_THETA_R_STD_MAX_DEG: f64 = 0.5;

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
    /// Shared quantities and starts are determined.
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
    let manifest = source.manifest();
    let view = View::new(manifest);
    let material = manifest.material();
    let groups = observe::poses(source);
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
    let left_out = observe::observe(source, &light, &view, &groups, &planes, progress, cancel)?;
    let frames = source.rows().iter();
    let frames = frames.filter(|row| row.kind == FrameKind::Sample).count();
    if let (true, Some(first)) = (left_out.len() >= frames, left_out.first()) {
        return Err(MapError::AllLeftOut {
            frames,
            file: first.file.clone(),
            why: match first.detail.as_str() {
                "" => first.reason.clone(),
                detail => format!("{}: {detail}", first.reason),
            },
        });
    }
    rejected.extend(left_out);

    let recorded: Vec<Pose> = groups.iter().map(|g| g.pose).collect();
    let batch = sampled(&planes)?;
    let flats = calibration.flats();
    let references = References {
        flats: &flats,
        white: calibration.white_reference(),
    };
    // The mean is fitted first: it provides the deviations from an ideal sawtooth for all pixels.
    let mean = match late() {
        false => together::together(source, progress, cancel),
        true => Err("the time limit passed".to_owned()),
    };
    // A cancelled fit of the mean must not count as one without a result.
    if cancel.load(Ordering::Relaxed) {
        return Err(MapError::Cancelled);
    }
    let settled = settle::settle(
        &batch,
        &view,
        &settle::Given {
            material: &material,
            recorded: &recorded,
            references: &references,
            target_error: options.target_error,
            real: mean.as_ref().ok().and_then(|mean| mean.real.clone()),
        },
        progress,
        cancel,
    )?;
    drop(batch);

    let tiles = fit_tiles(&planes, &settled, late, progress, cancel)?;
    let (mut layers, evaluations) = (tiles.layers, tiles.evaluations);
    let pixels_left_out = view.pixels() - tiles.pixels;
    let leans = defects::leans(&layers);
    defects::mark_borders(&mut layers, &leans);
    let pixel_mm = view.has_scale.then_some(view.imaging.pixel_mm);
    let found = defects::defects(
        &mut layers,
        &leans,
        &|pixel| view.place_mm(pixel),
        view.imaging.pixel_mm,
    );
    let pixels_fitted = layers.chi2_reduced.iter().filter(|x| x.is_finite()).count();
    if pixels_fitted == 0 && pixels_left_out > 0 {
        return Err(MapError::Late);
    }
    if pixels_fitted == 0 {
        return Err(MapError::NothingFitted {
            poses: groups.len(),
            chi2: settled.birge,
        });
    }

    let mut warnings = calibration.warnings.clone();
    warnings.extend(doubts(&settled, &view));
    if references.white.is_none() && layers.parameters.iter().any(|l| l.name == "rho_d") {
        layers.without_rho_d();
        warnings.push(
            "the series has no white reference, so rho_d, which is relative to it, is not given"
                .to_owned(),
        );
    }
    let alike = leans.len() <= 1 || manifest.sample.layout.is_some();
    let mean = match alike {
        true => mean,
        false => Err(
            "the sample leans in several directions, and the manifest states no layout".to_owned(),
        ),
    };
    let mut globals = settled.globals;
    match &mean {
        Ok(mean) => mean.raise(&mut globals),
        Err(why) => warnings.push(format!(
            "the mean of the pixels was not fitted ({why}), so std_shared is too small: it includes only the counting \
             statistics of gain, stray light and tilt offset, not the uncertainties of the stages and the model"
        )),
    }
    let at_least = |std: [f64; FREE]| match &mean {
        Ok(mean) => mean.at_least(std, &layers, |k| typical(&layers, k)),
        Err(_) => std,
    };
    let wedge = manifest.rig.sample_wedge_std_deg.map(Angle::from_deg);
    let left_out = what_is_left_out(&settled, wedge, pixels_left_out);
    Ok(Map {
        shared_std: settled
            .shared_std
            .map(|std| at_least(with_wedge(in_layer_units(&std, &layers), wedge, &layers))),
        layers,
        pixel_mm,
        axis_px: view.imaging.rotation_axis_px,
        globals,
        birge: settled.birge,
        leans,
        defects: found,
        pixels_fitted,
        pixels_sampled: settled.sampled,
        evaluations: evaluations / pixels_fitted.max(1) as f64,
        n_poses: groups.len(),
        rejected_frames: rejected,
        warnings,
        left_out,
        pixels_left_out,
    })
}

/// Lists what the map omits.
fn what_is_left_out(
    settled: &Settled,
    wedge: Option<Angle>,
    pixels_left_out: usize,
) -> Vec<LeftOut> {
    let view = &settled.view;
    let mut list = settled.plan.omissions();
    list.extend(left_out::lens(&view.imaging.rig.cones));
    list.push(left_out::ideal_profile());
    list.push(left_out::third_bounce());
    if wedge.is_none() {
        list.push(left_out::wedge());
    }
    let included = |decision| settled.plan.on(decision).is_some_and(|c| c.included);
    if included(Decision::Bounces) {
        list.push(LeftOut::new(
            "double reflections by integration, pixel by pixel",
            "integrated only on the surfaces that represent most pixels; each pixel takes the nearest",
            None,
        ));
    }
    if included(Decision::PerPixelGeometry) {
        list.push(match &settled.beside {
            Some(beside) => LeftOut::new(
                "the pixel's own surface in the off-centre change of light reflected between the facets",
                "the change is small and smooth; that of the surfaces that represent most pixels is used",
                Some(beside.left),
            ),
            None => LeftOut::new(
                "each pixel's own directions in light reflected between the facets",
                "they vary slowly; those of the field's centre are used",
                settled.centre_for_all,
            ),
        });
    }
    if pixels_left_out > 0 {
        list.push(LeftOut::new(
            format!("{pixels_left_out} of {} pixels", view.pixels()),
            "the time limit passed; the fitted pixels are spread over the field",
            None,
        ));
    }
    list
}

/// Converts shared shifts to the layers' units; those of ln α are multiplied by the median α.
fn in_layer_units(std: &Parameters, layers: &Layers) -> [f64; FREE] {
    let typical = |k: usize| typical(layers, k);
    [
        std[0].to_degrees(),
        std[1].to_degrees(),
        std[2] * typical(2),
        std[3] * typical(3),
        std[4],
    ]
}

/// Returns the median of a layer's values.
fn typical(layers: &Layers, k: usize) -> f64 {
    let values = layers.parameters[k].values.iter();
    settle::median(values.map(|x| f64::from(*x))).unwrap_or(0.0)
}

/// Adds the wedge of the sample: its tilt along v to the ridge angle, its tilt along u, as a turn, to the lean
/// direction.
fn with_wedge(mut std: [f64; FREE], wedge: Option<Angle>, layers: &Layers) -> [f64; FREE] {
    if let Some(wedge) = wedge {
        let turn = turn_by_wedge(wedge, Angle::from_deg(typical(layers, 0)));
        std[0] = std[0].hypot(wedge.deg());
        std[1] = std[1].hypot(turn.deg());
    }
    std
}

fn doubts(settled: &Settled, view: &View) -> Vec<String> {
    let mut doubts = Vec::new();
    let zero = settled.globals.tilt_offset_std.deg();
    if zero > 1.0 {
        doubts.push(format!(
            "these poses do not determine the tilt offset (± {zero:.1}°), so the recorded tilts are used; scan more azimuths"
        ));
    }
    let shared = settled.shared_std.map_or(0.0, |std| std[0].to_degrees());
    if shared > SHARED_THETA_R_STD_MAX_DEG {
        doubts.push(format!(
            "these poses leave an uncertainty of {shared:.1}° (k = 1) that the ridge angles of all pixels share (they do not separate it from gain, stray light, tilt offset and model error): differences between pixels are valid, the absolute angle is not; scan more tilts"
        ));
    }
    if settled.birge > 4.0 {
        doubts.push(format!(
            "the usual χ² per degree of freedom is {:.1}: the model does not explain the pixels of this sample within their noise; uncertainties are scaled by its square root",
            settled.birge
        ));
    }
    if settled.costly.is_amplitude() {
        doubts.push(
            "on metal, double reflections are a large part of the light, and this map takes them from the surfaces that represent most pixels: pixels unlike these, or with few observations in the lobe, may be wrong by several standard uncertainties; use `ridged fit` for the full model"
                .to_owned(),
        );
    }
    if !view.has_scale {
        doubts.push(
            "the manifest states no field_width_mm: positions are given in pixels in place of mm"
                .to_owned(),
        );
    }
    doubts
}

#[cfg(test)]
mod doubles_tests;
#[cfg(test)]
mod extreme_tests;
#[cfg(test)]
mod tests;
