//! Compares the quantities that pixels share with a fit of the pixels' mean.
//!
//! Counting statistics of millions of pixels determine gain, stray light and tilt offset far better than stages,
//! lamps and closed forms are known. The budget of a fit includes all of these. The shared quantities cannot be known
//! better than those of the mean, so its standard uncertainties are the least that a map states. If the fit, which
//! has the more complete model, finds another value, the difference is added as an uncertainty
//! ([`Together::at_least`]).

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::costly::RealSurface;
use super::globals::Globals;
use super::kernel::FREE;
use super::layers::Layers;
use super::{Progress, Stage};
use crate::fit::report::{Parameter, Status};
use crate::fit::{FitOptions, FitReport, VariantChoice, fit};
use crate::model::extended::{Real, Walls};
use crate::model::prepared::OpticsTable;
use crate::model::{Optics, Surface};
use crate::observation::ObservationSet;
use crate::reduction::{CountedReads, FrameSource, reduce};
use crate::units::Angle;

/// Residual of the mean's fit (root mean square over the peak) up to which all pixels count as one kind of surface.
const WELL_MET: f64 = 3e-3;
/// Residual from which the pixels are no surface at all.
const MIXED: f64 = 0.01;
/// The region of a layout that is fitted.
const REGION: &str = "even";

/// A value of the pixels' mean and its standard uncertainty.
type Known = (f64, f64);

/// The layers of [`Together::mean`].
const MEAN: [&str; FREE] = [
    "theta_r_deg",
    "lean_azimuth_deg",
    "alpha_u",
    "alpha_v",
    "rho_d",
];

/// The fit of the pixels' mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Together {
    /// In the order of [`MEAN`] and the units of these layers; `None` if the data do not determine it.
    mean: [Option<Known>; FREE],
    /// Whether the mean is over all pixels and not over one region.
    of_all: bool,
    stray: Option<Known>,
    tilt_offset_deg: Option<Known>,
}

/// Fits the mean of a uniform sample, or of one region of a sample that has a layout. Also returns the sample's deviations
/// from an ideal sawtooth, if the fit is good enough to determine them.
///
/// # Errors
/// The reason why there is no such fit.
pub(super) fn together(
    source: &dyn FrameSource,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<(Together, Option<Arc<RealSurface>>), String> {
    // All frames are read once more, which takes as long as the first time.
    let report = |done: usize, total| {
        progress(Progress {
            stage: Stage::Averaging,
            done: done.min(total),
            total,
        });
    };
    let source = &CountedReads::new(source, &report);
    let layout = source.manifest().sample.layout.is_some();
    let region = layout.then_some(REGION);
    let set = reduce(source, region, cancel).map_err(|error| error.to_string())?;
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    let report = fit(&set, &options, cancel);
    if matches!(
        report.status,
        Status::NotFinite | Status::TooFewObservations | Status::Cancelled
    ) {
        return Err("the fit gave no result".to_owned());
    }
    if let Some(rms) = report.rms_residual.filter(|rms| *rms > MIXED) {
        return Err(format!(
            "its residual is {:.1} % of the peak: they are not one surface, or the sample does not fill the field",
            100.0 * rms
        ));
    }
    let p = &report.parameters;
    let absolute = set.white_reference.is_some();
    let of = |parameter: &Parameter| -> Option<Known> { Some((parameter.value?, parameter.std?)) };
    let mean = Together {
        mean: [
            of(&p.theta_r_deg),
            of(&p.azimuth_offset_deg),
            of(&p.alpha_u),
            of(&p.alpha_v),
            of(&p.rho_d),
        ],
        of_all: !layout,
        stray: of(&p.background).filter(|_| absolute),
        tilt_offset_deg: of(&p.tilt_offset_deg),
    };
    Ok((mean, real_surface(&report, &set)))
}

/// Returns the deviations from an ideal sawtooth; `None` if the fit's residual is large, as for the mean of unlike
/// pixels.
fn real_surface(report: &FitReport, set: &ObservationSet) -> Option<Arc<RealSurface>> {
    let p = &report.parameters;
    let value = |p: &Option<Parameter>| p.as_ref().and_then(|p| p.value).unwrap_or(0.0);
    let gamma = report.slope_distribution.as_ref().and_then(|s| s.shape);
    let real = Real {
        translucency: value(&p.translucency),
        tail: gamma.map_or(0.0, |gamma| 1.0 / (gamma - 1.0)),
        crest: value(&p.crest_radius),
        land: 0.0,
    };
    let well_met = report.rms_residual.is_some_and(|rms| rms < WELL_MET);
    if real == Real::NONE || !well_met {
        return None;
    }
    let surface = Surface {
        theta_r: p.theta_r_deg.value?.to_radians(),
        alpha_u: p.alpha_u.value?,
        alpha_v: p.alpha_v.value?,
        rho_d: p.rho_d.value.unwrap_or(0.0),
        amplitude: 1.0,
    };
    let table = OpticsTable::new(&Optics::new(&set.rig, &set.material));
    let walls = Walls::new(&surface, &real, &table);
    Some(Arc::new(RealSurface { real, walls }))
}

impl Together {
    /// Raises standard uncertainties, in the layers' units, to those of the mean; `typical` returns the pixels'
    /// medians.
    pub(super) fn at_least(
        &self,
        std: [f64; FREE],
        layers: &Layers,
        typical: impl Fn(usize) -> f64,
    ) -> [f64; FREE] {
        std::array::from_fn(|k| {
            let layer = &layers.parameters[k];
            let known = MEAN.iter().position(|name| *name == layer.name);
            let Some((value, of_mean)) = known.and_then(|n| self.mean[n]) else {
                return std[k];
            };
            // Directions count from another zero, and a region's mean is not that of its neighbours.
            let off = match self.of_all && !layer.cyclic {
                true => typical(k) - value,
                false => 0.0,
            };
            std[k].max(of_mean).hypot(off)
        })
    }

    /// Raises the standard uncertainties of the shared quantities to those of the mean.
    pub(super) fn raise(&self, globals: &mut Globals) {
        if let Some((value, std)) = self.stray {
            globals.stray_std = globals.stray_std.max(std).hypot(globals.stray - value);
        }
        if let Some((value, std)) = self.tilt_offset_deg {
            let own = globals.tilt_offset_std.deg().max(std);
            let off = globals.tilt_offset.deg() - value;
            globals.tilt_offset_std = Angle::from_deg(own.hypot(off));
        }
    }
}
