//! Fits all variants to one set of observations, and decides whether another set has to be fitted in its place: one with finer
//! views of a near field, or one that corrects what the fits found wrong in camera, white reference, lamp or single poses.

use std::sync::atomic::{AtomicBool, Ordering};

use super::causes::findings::{Code, Finding};
use super::causes::lamp_drift::{to_correct, without};
use super::causes::suspects::{OBSERVATION_CAUSES, investigated};
use super::causes::{camera_response, downweighting};
use super::convergence_trace::Time;
use super::estimate::Estimate;
use super::higher_order::HigherOrder;
use super::least_squares::levenberg_marquardt::Ending;
use super::one_variant::estimate_until;
use super::{FitOptions, VariantChoice};
use crate::deadline;
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::trace::surfaces::surface_profile::SurfaceProfile;

/// A cause is named if it leaves less than this share of the squared model error.
const EXPLAINED: f64 = 0.5;

/// Arguments of a fit other than the observations.
pub(super) struct Fitting<'f> {
    pub options: &'f FitOptions,
    pub higher_order: Option<HigherOrder<'f>>,
    /// The caller's clock, if there is one.
    pub time: Option<Time<'f>>,
    pub cancel: &'f AtomicBool,
}

/// The fits of all variants to one set of observations.
pub(super) struct Fits<'a> {
    pub paper: Option<Estimate<'a>>,
    /// The sawtooth without terms of real samples.
    pub ideal: Option<Estimate<'a>>,
    pub sawtooth: Option<Estimate<'a>>,
    /// The same observations with the views that a narrow lobe needs.
    finer: Option<ObservationSet>,
    /// Whether the time was over when these fits ended.
    is_late: bool,
}

impl Fits<'_> {
    /// Returns the fit that the ray tracer corrects, if that is asked for. A measured profile has its own crests.
    pub(super) fn to_trace(
        &self,
        options: &FitOptions,
        profile: Option<&SurfaceProfile>,
    ) -> Option<&Estimate<'_>> {
        if !(options.variant == VariantChoice::Traced || options.judge) {
            return None;
        }
        let sawtooth = self.sawtooth.as_ref()?;
        match profile.is_some() && sawtooth.values.real.crest > 0.0 {
            true => self.ideal.as_ref(),
            false => Some(sawtooth),
        }
    }
}

/// Observations to fit in place of others, and the causes for which they were changed.
pub(super) struct Changed {
    pub set: ObservationSet,
    pub causes: Vec<Finding>,
}

impl Fitting<'_> {
    fn is_late(&self) -> bool {
        self.time.is_some_and(|time| !time.allows())
    }

    /// Runs work with a flag that is raised when the time is over: one descent of a near rig may take longer than the limit.
    fn within_time<T>(&self, work: impl FnOnce(&AtomicBool) -> T) -> T {
        match self.time.is_some_and(|time| time.limit_s.is_some()) {
            true => deadline::flagging(&|| self.is_late(), self.cancel, work),
            false => work(self.cancel),
        }
    }

    fn estimate<'a>(
        &self,
        set: &'a ObservationSet,
        variant: Variant,
        over: &AtomicBool,
    ) -> Option<Estimate<'a>> {
        let higher_order = self.higher_order.filter(|_| variant == Variant::Sawtooth);
        let late = || self.is_late();
        estimate_until(set, variant, self.options, higher_order, &late, over)
    }

    /// Fits every variant. `causes` are those for which the set was changed; the fits do not look for them again.
    pub(super) fn fits<'a>(&self, set: &'a ObservationSet, causes: &[Finding]) -> Fits<'a> {
        let (options, higher_order) = (self.options, self.higher_order);
        let excluded: Vec<Code> = OBSERVATION_CAUSES
            .into_iter()
            .filter(|code| match code {
                Code::LampDrift => set.lamp.is_some(),
                _ => causes.iter().any(|cause| cause.code.is_like(*code)),
            })
            .collect();
        let mut fits = self.within_time(|over| {
            let paper = self.estimate(set, Variant::Paper, over);
            let ideal = self.estimate(set, Variant::Sawtooth, over);
            let finer = ideal.as_ref().and_then(Estimate::with_finer_views);
            let sawtooth = match &ideal {
                Some(ideal) if finer.is_none() && !self.is_late() => {
                    let ideal = ideal.clone();
                    Some(investigated(ideal, options, higher_order, &excluded, over))
                }
                _ => ideal.clone(),
            };
            Fits {
                paper,
                ideal,
                sawtooth,
                finer,
                is_late: false,
            }
        });
        fits.is_late = self.is_late();
        let all = [&mut fits.paper, &mut fits.ideal, &mut fits.sawtooth];
        for e in all.into_iter().flatten() {
            if fits.is_late && e.minimum.ending == Ending::Cancelled {
                e.minimum.ending = Ending::MaxIterations;
                e.cut_short = true;
            }
        }
        fits
    }

    /// Returns the observations that have to be fitted in place of `set`, by the first reason that its fits give; `None` if there
    /// is no reason, or no time.
    pub(super) fn changed(
        &self,
        set: &ObservationSet,
        fits: &Fits<'_>,
        causes: &[Finding],
    ) -> Option<Changed> {
        if fits.is_late || self.cancel.load(Ordering::Relaxed) {
            return None;
        }
        let with = |set: ObservationSet, found: &[Finding]| {
            let causes = [causes, found].concat();
            Some(Changed { set, causes })
        };
        if let Some(finer) = &fits.finer {
            return with(finer.clone(), &[]);
        }
        let sawtooth = fits.sawtooth.as_ref()?;
        let discrepancy = |set: &ObservationSet| self.discrepancy(set);
        if let Some(decided) = camera_response::decided(set, sawtooth.discrepancy, discrepancy) {
            return with(decided, &[]);
        }
        let explained_by = |set: &ObservationSet| {
            let left = (discrepancy(set)? / sawtooth.discrepancy).powi(2);
            (left < EXPLAINED).then_some(1.0 - left)
        };
        let is_known = |code: Code| causes.iter().any(|cause| cause.code.is_like(code));
        let cause = sawtooth.observation_cause.as_deref();
        if !is_known(Code::WhiteReference)
            && let Some((lighter, mut finding)) = downweighting::of_flats(sawtooth)
            && let Some(explains) = explained_by(&lighter)
            && cause.is_none_or(|cause| {
                explained_by(&cause.set).is_none_or(|by_cause| by_cause < explains)
            })
        {
            finding.explains = explains;
            return with(lighter, &[finding]);
        }
        if let Some(cause) = cause {
            return with(cause.set.clone(), cause.finding.as_slice());
        }
        if !is_known(Code::BadPose)
            && let Some((lighter, finding)) = downweighting::of(sawtooth)
            && explained_by(&lighter).is_some()
        {
            return with(lighter, &[finding]);
        }
        if set.lamp.is_none()
            && let Some(lamp) = to_correct(sawtooth)
        {
            return with(without(set, lamp)?, &[]);
        }
        None
    }

    /// Returns the model error of a fit of the sawtooth.
    fn discrepancy(&self, set: &ObservationSet) -> Option<f64> {
        self.within_time(|over| {
            let e = self.estimate(set, Variant::Sawtooth, over)?;
            let e = investigated(
                e,
                self.options,
                self.higher_order,
                &OBSERVATION_CAUSES,
                over,
            );
            Some(e.discrepancy)
        })
    }
}
