//! The map of a sample: ridge angle, roughness and lean direction of every pixel, from the frames
//! of a series.
//!
//! Call [`map`]. It reads darks and flats, turns and stretches every sample frame back into the
//! sample's frame (`observe`, `view`), settles on a sample of pixels what all of them share
//! (`settle`, `globals`), fits every pixel with the `sawtooth` closed form, several pixels per
//! vector register and tiles in parallel (`kernel`, `solve`, `costly`, `integrated`), looks again at those that may have
//! ended beside their deepest minimum (`doubt`), marks borders and
//! defects (`defects`), and sums up ([`summary`]). [`write::write`] makes the files; [`folder::map_into`] does both. Time grows with pixels ×
//! observations; memory is bounded by [`MapOptions::memory_bytes_max`], beyond which planes go to a
//! scratch file.
//!
//! What it does without is decided in [`plan`](mod@plan), on the surfaces that most pixels look like.
//!
//! Nobody tells it how the sample is laid out: each pixel finds its own lean direction. It does not
//! know about scans, fits of whole regions, or the command line.

mod beside;
pub mod colour;
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

/// How often the costly terms are taken anew within a pixel's descent, at most.
const REFRESHES: u8 = 3;

/// Common uncertainty of the ridge angle above which the map says so aloud.
const SHARED_THETA_R_STD_MAX_DEG: f64 = 0.5;

/// What to do how.
#[derive(Debug, Clone)]
pub struct MapOptions {
    /// Planes larger than this go to a scratch file.
    pub memory_bytes_max: usize,
    /// Folder for the scratch file.
    pub scratch: PathBuf,
    /// Share of the brightest radiance that may be left out of a pixel's physics where that saves time (see
    /// [`plan`]). Without it everything is in.
    pub target_error: Option<f64>,
    /// Seconds after which no further tile is begun; for whoever holds a clock (see [`map_until`]).
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

/// What is being done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Darks and flats are read.
    Calibrating,
    /// Sample frames are read and brought into the sample's frame; counted in poses.
    Resampling,
    /// Frames are read once more, for a fit of the pixels' mean.
    Averaging,
    /// Shared quantities and starts.
    Settling,
    /// Pixels are fitted; counted in pixels.
    Fitting,
}

impl Stage {
    /// The same for people.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Stage::Calibrating => "darks and flats",
            Stage::Resampling => "reading poses",
            Stage::Settling => "settling what all pixels share",
            Stage::Fitting => "fitting pixels",
            Stage::Averaging => "fitting their mean",
        }
    }
}

/// How far it has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// What is being done.
    pub stage: Stage,
    /// Done of it.
    pub done: usize,
    /// All of it.
    pub total: usize,
}

/// Why there is no map.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// Darks and flats could not be read.
    #[error(transparent)]
    Reduction(#[from] ReductionError),
    /// Fewer poses than a pixel has unknowns.
    #[error(
        "{poses} poses do not tell five parameters per pixel; scan at least {least}, better 5 tilts × 8 azimuths"
    )]
    TooFewPoses {
        /// Poses that the series has.
        poses: usize,
        /// The least that would do.
        least: usize,
    },
    /// All frames are dark.
    #[error(
        "the sample frames show no light above their noise; check lamp, lens cap and exposure times"
    )]
    NothingSeen,
    /// No sample frame can be used.
    #[error(
        "all {frames} sample frames were left out, the first ({file}) as {why}; look at the frames, at their exposure times and at the manifest's camera"
    )]
    AllLeftOut {
        /// How many there are.
        frames: usize,
        /// The first of them,
        file: String,
        /// and why it was left out.
        why: String,
    },
    /// No count can be used.
    #[error(
        "no pixel of the sample frames has a count that can be used: they are saturated, or darks and flats mark every pixel as defective; shorten the exposure times and check the flats"
    )]
    NothingUsable,
    /// No pixel shows a lobe.
    #[error(
        "no pixel shows the reflection of a ridged surface: brightness does not change with the pose beyond a matte surface's; check focus, region and azimuths of the scan"
    )]
    NoLobes,
    /// No pixel's fit came to an end.
    #[error(
        "no pixel could be fitted at these {poses} poses (usual χ² per degree of freedom {chi2:.1}): their lobes are told too poorly; scan more tilts and azimuths, or fit the whole area"
    )]
    NothingFitted {
        /// Poses that the series has.
        poses: usize,
        /// What the best fits of the sampled pixels leave.
        chi2: f64,
    },
    /// The scratch file failed.
    #[error("the scratch file of the map: {0}; free space there or choose another output folder")]
    Scratch(std::io::Error),
    /// No pixel that shows a lobe was reached in the time allowed.
    #[error("the time was over before a pixel with a lobe was fitted; allow more seconds")]
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
    /// Millimetres per pixel (columns, rows); `None` where the manifest states no field size.
    pub pixel_mm: Option<[f64; 2]>,
    /// Column and row of the rotation axis, from the outer corner of the first pixel.
    pub axis_px: [f64; 2],
    /// What all pixels share.
    pub globals: Globals,
    /// Standard uncertainty that the shared quantities and the model's misfit leave in every pixel, per parameter in the
    /// layers' units (medians; α's absolute).
    pub shared_std: Option<[f64; FREE]>,
    /// Usual χ² per degree of freedom; standard uncertainties are scaled by its root.
    pub birge: f64,
    /// Lean directions that many pixels share.
    pub leans: Vec<defects::Lean>,
    /// Connected areas that disagree with the rest.
    pub defects: Vec<defects::Defect>,
    /// Pixels that were fitted.
    pub pixels_fitted: usize,
    /// Pixels from which the shared quantities were settled.
    pub pixels_sampled: usize,
    /// Evaluations per fitted pixel.
    pub evaluations: f64,
    /// Poses, that is observations per pixel.
    pub n_poses: usize,
    /// Frames left out.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Sentences for the user.
    pub warnings: Vec<String>,
    /// What was left out, why, and what that may cost (as a share of the brightest radiance).
    pub left_out: Vec<LeftOut>,
    /// Pixels that nobody looked at because time was over; flagged `few_observations`, with none.
    pub pixels_left_out: usize,
}

/// Maps the sample of a series.
///
/// # Errors
/// [`MapError`]. Single frames that cannot be used are no error: they are in `rejected_frames`.
pub fn map(
    source: &dyn FrameSource,
    options: &MapOptions,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Map, MapError> {
    map_until(source, options, &|| false, progress, cancel)
}

/// [`map`], with no further tile begun once `late` says so. Tiles are taken in an order that spreads over
/// the field, so that a map that ends early shows all of it coarsely rather than its top.
///
/// # Errors
/// [`MapError`], also where it is late before the first tile.
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
    // The mean's fit comes first: what all pixels have beside an ideal sawtooth is asked of it.
    let mean = match late() {
        false => together::together(source, progress, cancel),
        true => Err("time was over".to_owned()),
    };
    // A mean that was cancelled is none that has no answer.
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
            "no white reference was recorded, so there is no rho_d: it is a share of that"
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
            "no fit of the pixels' mean says how well the stages' zeros and the model are known ({why}): std_shared has \
             gain, stray light and the tilt's zero by counting alone, and is too small"
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

/// What a map does without.
fn what_is_left_out(
    settled: &Settled,
    wedge: Option<Angle>,
    pixels_left_out: usize,
) -> Vec<LeftOut> {
    let view = &settled.view;
    let mut list = settled.plan.told();
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
            "integrated on the surfaces that most pixels look like, and taken from the nearest of them",
            None,
        ));
    }
    if included(Decision::PerPixelGeometry) {
        list.push(match &settled.beside {
            Some(beside) => LeftOut::new(
                "each pixel's own surface in what its own directions change of light that went between the facets",
                "it is small and smooth: that of the surfaces that most pixels look like stands for all",
                Some(beside.left),
            ),
            None => LeftOut::new(
                "each pixel's own directions in light that went between the facets",
                "they vary slowly: those of the field's centre stand for all",
                settled.centre_for_all,
            ),
        });
    }
    if pixels_left_out > 0 {
        list.push(LeftOut::new(
            format!("{pixels_left_out} of {} pixels", view.pixels()),
            "time was over; those that were fitted are spread over the field",
            None,
        ));
    }
    list
}

/// Shared shifts in the layers' units; those of ln α times the median α.
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

/// Median of a layer's values.
fn typical(layers: &Layers, k: usize) -> f64 {
    let values = layers.parameters[k].values.iter();
    settle::median(values.map(|x| f64::from(*x))).unwrap_or(0.0)
}

/// What a wedge of the sample adds to what pixels share: ridge angle along v, a turn of the lean direction along u.
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
            "the tilt's zero cannot be told from these poses (± {zero:.1}°): the recorded tilts are believed; scan more azimuths"
        ));
    }
    let shared = settled.shared_std.map_or(0.0, |std| std[0].to_degrees());
    if shared > SHARED_THETA_R_STD_MAX_DEG {
        doubts.push(format!(
            "these poses leave the ridge angle of all pixels open by ± {shared:.1}° together (gain, stray light, the tilt's zero and the model's misfit are not told from it): differences between pixels hold, the angle itself does not; scan more tilts"
        ));
    }
    if settled.birge > 4.0 {
        doubts.push(format!(
            "the usual χ² per degree of freedom is {:.1}: the model does not explain this sample's pixels at their noise; uncertainties are scaled by its root",
            settled.birge
        ));
    }
    if settled.costly.is_amplitude() {
        doubts.push(
            "on metal much light comes back from two reflections, which this map takes from the surfaces that most pixels look like: pixels unlike them, or with few observations in the lobe, may be off by several of their standard uncertainties; `ridged fit` has the whole"
                .to_owned(),
        );
    }
    if !view.has_scale {
        doubts.push(
            "the manifest states no field_width_mm: positions are in pixels and count as mm"
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
