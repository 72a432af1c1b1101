//! What a fit of the pixels' mean says of what they share.
//!
//! Counting tells gain, stray light and the tilt's zero from millions of pixels far better than stages stand, lamps last
//! and closed forms hold. The budget of a fit has all of that. What pixels share is known no better than their mean is, so
//! its standard uncertainties are the least that a map states ([`Together::at_least`]).

use std::sync::atomic::AtomicBool;

use super::globals::Globals;
use super::layers::Layers;
use super::solve::FREE;
use crate::fit::report::{Parameter, Status};
use crate::fit::{FitOptions, VariantChoice, fit};
use crate::reduction::{FrameSource, reduce};
use crate::units::Angle;

/// Of a layout's regions, the one that is fitted.
const REGION: &str = "even";

/// Standard uncertainties of the pixels' mean.
pub(super) struct Together {
    /// By the name of a layer, in its unit; none where the data do not determine it.
    std: [(&'static str, Option<f64>); FREE],
    stray: Option<f64>,
    tilt_offset: Option<Angle>,
}

/// Fits the mean of a uniform sample, or of one region of a sample that has a layout.
///
/// # Errors
/// Why there is no such fit, in words.
pub(super) fn together(source: &dyn FrameSource, cancel: &AtomicBool) -> Result<Together, String> {
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
        return Err("it has no answer".to_owned());
    }
    let p = &report.parameters;
    let absolute = set.white_reference.is_some();
    let of = |parameter: &Parameter| parameter.std;
    Ok(Together {
        std: [
            ("theta_r_deg", of(&p.theta_r_deg)),
            ("lean_azimuth_deg", of(&p.azimuth_offset_deg)),
            ("alpha_u", of(&p.alpha_u)),
            ("alpha_v", of(&p.alpha_v)),
            ("rho_d", of(&p.rho_d)),
        ],
        stray: of(&p.background).filter(|_| absolute),
        tilt_offset: of(&p.tilt_offset_deg).map(Angle::from_deg),
    })
}

impl Together {
    /// Raises standard uncertainties, in the layers' units, to those of the mean.
    pub(super) fn at_least(&self, std: [f64; FREE], layers: &Layers) -> [f64; FREE] {
        std::array::from_fn(|k| {
            let name = layers.parameters[k].name;
            let known = self.std.iter().find(|(known, _)| *known == name);
            let mean = known.and_then(|(_, std)| *std);
            mean.map_or(std[k], |mean| std[k].max(mean))
        })
    }

    /// Raises those of the shared quantities.
    pub(super) fn raise(&self, globals: &mut Globals) {
        if let Some(stray) = self.stray {
            globals.stray_std = globals.stray_std.max(stray);
        }
        if let Some(zero) = self.tilt_offset {
            let own = globals.tilt_offset_std;
            globals.tilt_offset_std = Angle::from_rad(own.rad().max(zero.rad()));
        }
    }
}
