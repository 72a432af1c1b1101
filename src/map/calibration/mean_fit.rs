//! What all pixels share (gain, stray light, tilt offset, deviations from an ideal sawtooth, model error), from the fit of the
//! pixels' mean.
//!
//! The mean is that of the whole sample, or of a region of its layout. Without a white reference, or if a single surface does
//! not explain it and explains that of one of the largest clusters of pixels better, it is the mean of that. The fit's budget
//! includes references, stages, lamp and model error, so its standard uncertainties are those that the pixels share.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::clusters::Cluster;
use super::globals::{Given, Globals};
use crate::fit::fitted_surface::stated_deviations;
use crate::fit::report::{Parameter, Status};
use crate::fit::{FitOptions, FitReport, VariantChoice, fit};
use crate::map::higher_order_terms::RealSurface;
use crate::map::layers::Layers;
use crate::map::run::Batch;
use crate::map::signals::view::View;
use crate::map::solve::kernel::{FREE, Parameters};
use crate::material::Material;
use crate::model::extended::{Real, Walls};
use crate::model::left_out::POLARISATION;
use crate::model::prepared::OpticsTable;
use crate::model::{Optics, Surface};
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Residual of a fit (root mean square over the peak) up to which all pixels count as one kind of surface.
const WELL_MET: f64 = 3e-3;
/// Number of clusters that are fitted if the mean is not met: one fit takes as long as some ten thousand pixels.
const TRIED: usize = 2;

/// A tilt offset with a larger standard uncertainty is not applied.
const TILT_STD_MAX_DEG: f64 = 1.0;

/// A value of the pixels' mean and its standard uncertainty.
type Known = (f64, f64);

/// The fit of the pixels' mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::map) struct Mean {
    /// In the order and the units of the layers; `None` if the data do not determine it.
    pub(in crate::map) known: [Option<Known>; FREE],
    /// Whether the mean is over all pixels, and not over a region or a cluster.
    pub(in crate::map) of_all: bool,
    pub(in crate::map) stray: Option<Known>,
    pub(in crate::map) tilt_offset_deg: Option<Known>,
}

impl Mean {
    /// Returns the surface of the mean as the parameters of a pixel; `None` where the data do not determine all of it.
    pub(in crate::map) fn surface(&self) -> Option<Parameters> {
        let [theta_r_deg, lean_azimuth_deg, alpha_u, alpha_v, fifth] = self.known;
        Some([
            theta_r_deg?.0.to_radians(),
            lean_azimuth_deg?.0.to_radians(),
            alpha_u?.0.ln(),
            alpha_v?.0.ln(),
            fifth?.0,
        ])
    }

    /// Raises standard uncertainties, in the layers' units, to those of the mean. If the sample is `uniform`, they include the
    /// difference of the pixels' `typical` values from the fit, which has the more complete model.
    pub(in crate::map) fn at_least(
        &self,
        std: [f64; FREE],
        layers: &Layers,
        uniform: bool,
        typical: impl Fn(usize) -> f64,
    ) -> [f64; FREE] {
        std::array::from_fn(|k| {
            let Some((value, of_mean)) = self.known[k] else {
                return std[k];
            };
            let off = match self.of_all && uniform && !layers.parameters[k].cyclic {
                true => typical(k) - value,
                false => 0.0,
            };
            std[k].max(of_mean).hypot(off)
        })
    }

    /// Raises the standard uncertainties of the shared quantities to those of the mean.
    pub(in crate::map) fn raise(&self, globals: &mut Globals) {
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

/// What all pixels share.
pub(in crate::map) struct Shared {
    pub(in crate::map) globals: Globals,
    /// The fit, or why there is none.
    pub(in crate::map) mean: Result<Mean, String>,
    /// The sample's uniform deviations from an ideal sawtooth.
    pub(in crate::map) real: Option<Arc<RealSurface>>,
    /// Whether the first facet polarises the light that reaches the second one. In nature it does; many renderers omit that on
    /// plastic.
    pub(in crate::map) polarised: bool,
}

impl Shared {
    /// Fits the mean of all pixels and, if that is no single surface, those of the largest clusters.
    pub(in crate::map) fn new(
        batch: &Batch,
        view: &View,
        given: &Given<'_>,
        like: &ObservationSet,
        clusters: &[Cluster],
        cancel: &AtomicBool,
    ) -> Shared {
        let options = FitOptions {
            variant: VariantChoice::Sawtooth,
            tolerance: given.target_error,
            ..FitOptions::default()
        };
        let rms = |report: &FitReport| report.rms_residual.unwrap_or(f64::INFINITY);
        let mut best: Option<(FitReport, Shared)> = None;
        // The unit of a mean of all is not that of the pixels unless the white reference gives both.
        let all = like.white_reference.is_some().then(|| (like.clone(), 1.0));
        let of_all = all.is_some() && like.region.is_none();
        let largest = clusters.iter().take(TRIED);
        let largest = largest.map(|cluster| cluster.observed(batch, view, given, like));
        for (n, (set, unit)) in all.into_iter().chain(largest).enumerate() {
            let report = fit(&set, &options, cancel);
            let without = [
                Status::NotFinite,
                Status::TooFewObservations,
                Status::Cancelled,
            ];
            let better = |(before, _): &(FitReport, Shared)| rms(&report) < rms(before);
            if without.contains(&report.status) || !best.as_ref().is_none_or(better) {
                continue;
            }
            let shared = Shared::of(&report, &set, unit, given, of_all && n == 0);
            let is_met = rms(&report) <= WELL_MET;
            best = Some((report, shared));
            if is_met {
                break;
            }
        }
        best.map_or_else(
            || Shared {
                globals: Globals::first(given.largest).with_flats(given),
                mean: Err("the fit gave no result".to_owned()),
                real: None,
                polarised: true,
            },
            |(_, shared)| shared,
        )
    }

    fn of(
        report: &FitReport,
        set: &ObservationSet,
        unit: f64,
        given: &Given<'_>,
        of_all: bool,
    ) -> Shared {
        let p = &report.parameters;
        let of = |p: &Parameter| -> Option<Known> { Some((p.value?, p.std?)) };
        let absolute = set.white_reference.is_some();
        let scale = of(&p.scale).unwrap_or((1.0, 1.0));
        let per_radiance = if absolute { 1.0 } else { scale.0 };
        let mut globals = Globals::first(given.largest);
        let tilt_offset_deg = of(&p.tilt_offset_deg).filter(|(_, std)| *std < TILT_STD_MAX_DEG);
        if let Some((offset, std)) = tilt_offset_deg {
            globals.tilt_offset = Angle::from_deg(offset);
            globals.tilt_offset_std = Angle::from_deg(std);
        }
        if !absolute {
            globals.gain = scale.0 * unit;
            globals.gain_relative_std = scale.1 / scale.0;
            globals.stray_std /= globals.gain;
        }
        globals = globals.with_flats(given);
        let metal = matches!(set.material, Material::Conductor { .. });
        let stray = of(&p.background).map(|(s, std)| (s / per_radiance, std / per_radiance));
        if let Some((stray, std)) = stray.filter(|_| metal || !absolute) {
            (globals.stray, globals.stray_std) = (stray, std);
        }
        let fifth = match metal {
            true => Some((1.0, globals.gain_relative_std)),
            false => of(&p.rho_d),
        };
        let omitted = report.left_out.iter().any(|l| l.what == POLARISATION);
        Shared {
            globals,
            mean: Ok(Mean {
                stray: stray.filter(|_| absolute),
                tilt_offset_deg,
                known: [
                    of(&p.theta_r_deg),
                    of(&p.azimuth_offset_deg),
                    of(&p.alpha_u),
                    of(&p.alpha_v),
                    fifth,
                ],
                of_all,
            }),
            real: real_surface(report, set),
            polarised: metal || !omitted,
        }
    }
}

/// Returns the deviations from an ideal sawtooth; `None` if the fit's residual is large, as for the mean of unlike pixels.
fn real_surface(report: &FitReport, set: &ObservationSet) -> Option<Arc<RealSurface>> {
    let p = &report.parameters;
    let real = stated_deviations(report)?;
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
