//! Sets that cannot be fitted, and the report that says why.

use super::build::{build, program};
use super::{FitReport, Freedom, Parameter, Parameters, Starts, Status, Timing, VariantName};
use crate::fit::causes::wedge;
use crate::fit::search_setup::free_quantities;
use crate::fit::{FitOptions, VariantChoice};
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::wording::counted;

/// Why a set cannot be fitted.
pub(in crate::fit) fn refusal(set: &ObservationSet) -> Option<Status> {
    let finite = |v: f64| v.is_finite();
    let samples = set.observations.iter().all(|o| {
        finite(o.signal)
            && finite(o.sigma)
            && o.sigma > 0.0
            && o.pose.theta_c.is_finite()
            && o.pose.phi_s.is_finite()
    });
    let flats = set
        .flats
        .iter()
        .all(|f| finite(f.signal) && finite(f.sigma) && f.sigma > 0.0 && f.theta_c.is_finite());
    let prior = finite(set.background.mean) && set.background.std > 0.0;
    if !(samples && flats && prior) {
        return Some(Status::NotFinite);
    }
    // Flats and priors help to determine offsets and stray light, but not the surface.
    let needed = free_quantities(set, Variant::Sawtooth).0.len() + 1;
    (set.observations.len() < needed).then_some(Status::TooFewObservations)
}

/// Why a set cannot be fitted, as a message.
pub(in crate::fit) fn refused(set: &ObservationSet, options: &FitOptions) -> Option<String> {
    let status = refusal(set)?;
    empty(set, options, status).warnings.pop()
}

/// A report without numbers.
pub(in crate::fit) fn empty(
    set: &ObservationSet,
    options: &FitOptions,
    status: Status,
) -> FitReport {
    let reason = match status {
        Status::TooFewObservations => format!(
            "{} cannot determine the free parameters and their scatter. Measure more poses.",
            counted(set.observations.len(), "observation")
        ),
        Status::NotFinite => {
            "An observation, its uncertainty or the model's value for it is not finite. Check the frames and their \
             reduction."
                .to_owned()
        }
        Status::Cancelled => "The fit was cancelled before it was done.".to_owned(),
        Status::Stalled if options.variant == VariantChoice::Traced => {
            "The ray tracer did not finish its first pass. Allow more time.".to_owned()
        }
        _ => "No minimum was reached. Allow more starts, or check the residuals.".to_owned(),
    };
    let none = || Parameter::unknown(reason.clone());
    let mut warnings = set.warnings.clone();
    warnings.push(reason.clone());
    FitReport {
        variant: match options.variant {
            VariantChoice::Paper => VariantName::Paper,
            VariantChoice::Sawtooth | VariantChoice::Auto => VariantName::Sawtooth,
            VariantChoice::Traced => VariantName::Traced,
        },
        status,
        n_observations: set.observations.len(),
        n_frames_used: set.n_frames_used,
        region: set.region.clone(),
        reference_plane: wedge::plane(set),
        wedge_across: None,
        parameters: Parameters {
            theta_r_deg: none(),
            alpha_u: none(),
            alpha_v: none(),
            rho_d: none(),
            scale: none(),
            background: none(),
            azimuth_offset_deg: none(),
            tilt_offset_deg: none(),
            translucency: None,
            crest_radius: None,
            land_share: None,
        },
        covariance: None,
        rms_residual: None,
        model_discrepancy: None,
        chi2_reduced: None,
        chi2_reduced_without_model: None,
        rejected_frames: set.rejected_frames.clone(),
        warnings,
        notes: Vec::new(),
        findings: Vec::new(),
        slope_distribution: None,
        variants: Vec::new(),
        left_out: Vec::new(),
        tracer: None,
        fitted: Vec::new(),
        starts: Starts::default(),
        iterations: Vec::new(),
        freedom: Freedom::default(),
        timing_s: Timing::default(),
        program: program(),
        build: build(),
    }
}
