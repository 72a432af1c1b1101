//! A power law of the camera against errors of its exposure times.
//!
//! Exposures of one pose cannot distinguish the two ([`PowerLaw`]). The surface often can: under a power law the dim poses are too
//! bright or too dark against the bright ones. So both are fitted, and what leaves less is reported. Lobes as broad as the poses
//! reach can be bent into each other. Where the fits leave the same, large disagreements count as a power law, because the
//! exposure time of a camera is seldom off by as much, and the uncertainty reaches the other explanation.

use crate::observation::{DetectorCurve, ObservationSet, PowerLaw};
use crate::wording::counted;

/// Standard uncertainties below which a signal is not distinguished from zero: the law is straight there.
const DARK_SIGMAS: f64 = 3.0;

/// Ratio of the squared model errors of both explanations from which one is decided, as for every suspect.
const DECIDES: f64 = 2.0;
/// Disagreement of the exposures from which a power law is likelier where the surface does not decide: shutters and clocks are
/// off by one or two per cent at most.
const LARGE: f64 = 0.03;

/// Returns the observations by the explanation that holds, with the law decided; `None` if the set names no power law, or the
/// exposure times are wrong beyond doubt and nothing changes.
/// `discrepancy` is the model error of a fit as the set is; `fitted` returns that of other observations.
pub(in crate::fit) fn decided(
    set: &ObservationSet,
    discrepancy: f64,
    fitted: impl Fn(&ObservationSet) -> Option<f64>,
) -> Option<ObservationSet> {
    let law = set.power_law.as_ref()?;
    let mut power = linear(set, law, law.std)?;
    let ratio = (fitted(&power)? / discrepancy).powi(2);
    let open = (DECIDES.recip()..=DECIDES).contains(&ratio);
    // One standard uncertainty is half of the way to the other explanation.
    let std = match open {
        true => law.std.hypot(0.5 * (law.exponent - 1.0)),
        false => law.std,
    };
    if ratio < DECIDES.recip() || (open && law.spread > LARGE) {
        power = linear(set, law, std)?;
        power.warnings.retain(|words| *words != law.instead_of);
        power.warnings.push(format!(
            "the camera is not linear: its counts follow light^{:.3} (from {} of exposures of one pose, which deviate equally at \
             every level); all signals are corrected, and the uncertainty of the correction is the budget's line detector. Set \
             the camera's gamma to 1",
            law.exponent,
            counted(law.pairs, "pair")
        ));
        power.detector = Some(DetectorCurve {
            c: 0.0,
            exponent: law.exponent,
            std,
            pairs: law.pairs,
            full_scale_dn: 0.0,
            explains: law.explains,
        });
        return Some(power);
    }
    if !open {
        return None;
    }
    let mut clock = set.clone();
    clock.power_law = None;
    for (o, p) in clock.observations.iter_mut().zip(&power.observations) {
        o.shared.detector = o.shared.detector.hypot(0.5 * (p.signal - o.signal));
    }
    Some(clock)
}

/// Returns the observations of a linear camera if the present one follows a power law whose exponent has the standard
/// uncertainty `std`; `None` without light.
fn linear(set: &ObservationSet, law: &PowerLaw, std: f64) -> Option<ObservationSet> {
    let exponent = law.exponent;
    // The white reference, whose light is known, keeps its level.
    let flats = set.flats.iter().map(|f| f.signal);
    let level = match set.flats.len() {
        0 => crate::fit::model_discrepancy::peak(set),
        n => flats.sum::<f64>() / n as f64,
    };
    if !(level > 0.0 && level.is_finite()) {
        return None;
    }
    let factor = |signal: f64, sigma: f64| {
        let over = signal.max(DARK_SIGMAS * sigma) / level;
        over.powf(exponent.recip() - 1.0)
    };
    let mut straight = set.clone();
    for o in &mut straight.observations {
        let by = factor(o.signal, o.sigma);
        o.signal *= by;
        o.sigma *= by / exponent;
        o.shared.white_reference *= by;
        o.shared.led_drift *= by;
        let off = o.signal.max(DARK_SIGMAS * o.sigma) / level;
        o.shared.detector = -o.signal * off.ln() * std / exponent;
    }
    for f in &mut straight.flats {
        let by = factor(f.signal, f.sigma);
        f.signal *= by;
        f.sigma *= by / exponent;
    }
    straight.power_law = None;
    Some(straight)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::causes::findings::Code;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::problem::Values;
    use crate::fit::report::FitReport;
    use crate::fit::{FitOptions, VariantChoice, fit};
    use crate::geometry::Pose;
    use crate::observation::FlatObservation;
    use crate::units::Angle;

    const NARROW: Values = Values {
        alpha_u: 0.09,
        alpha_v: 0.09,
        ..TRUTH
    };

    /// Poses and flats counted as light^`exponent`, where exposures of a pose disagree as for `named`.
    fn counted_as(exponent: f64, named: f64) -> ObservationSet {
        let poses =
            (0..56).map(|k| Pose::from_deg(f64::from(k / 8) * 7.0 - 21.0, f64::from(k % 8) * 45.0));
        let mut set = painted(poses, &NARROW, 2e-4, 3);
        let flats = (-3..=3).map(|n| {
            let theta_c = Angle::from_deg(7.0 * f64::from(n));
            let signal = 0.99 / PI * set.rig.cos_incidence(theta_c);
            FlatObservation {
                theta_c,
                signal,
                sigma: 2e-4 * signal,
                times_s: Vec::new(),
            }
        });
        set.flats = flats.collect();
        let level = 0.3_f64;
        let bent = |light: f64| level * (light / level).powf(exponent);
        for o in &mut set.observations {
            o.sigma *= exponent * bent(o.signal) / o.signal;
            o.signal = bent(o.signal);
        }
        for f in &mut set.flats {
            f.signal = bent(f.signal);
        }
        set.power_law = Some(PowerLaw {
            exponent: named,
            std: 1e-3,
            spread: (1.0 - named).abs() * 1.6,
            explains: 0.99,
            pairs: 40,
            instead_of: "the clock".to_owned(),
        });
        set.warnings = vec!["the clock".to_owned()];
        set
    }

    fn fitted(set: &ObservationSet) -> FitReport {
        let options = FitOptions {
            variant: VariantChoice::Sawtooth,
            ..FitOptions::default()
        };
        fit(set, &options, &AtomicBool::new(false))
    }

    #[test]
    fn a_power_law_is_distinguished_from_errors_of_the_clock_by_the_surface() {
        for (exponent, named) in [(0.92, 0.92), (1.06, 1.06), (1.0, 0.94), (1.0, 1.05)] {
            let report = fitted(&counted_as(exponent, named));
            let codes: Vec<Code> = report.findings.iter().map(|f| f.code).collect();
            let clock = report.warnings.iter().any(|words| words == "the clock");
            match exponent == named {
                true => assert!(codes == [Code::NonLinear] && !clock, "{exponent} {codes:?}"),
                false => assert!(codes.is_empty() && clock, "{named} {codes:?}"),
            }
            let p = &report.parameters;
            for (found, truth) in [
                (&p.theta_r_deg, NARROW.theta_r.to_degrees()),
                (&p.alpha_u, NARROW.alpha_u),
                (&p.alpha_v, NARROW.alpha_v),
                (&p.rho_d, NARROW.rho_d),
            ] {
                let (value, u) = (found.value.unwrap(), found.expanded.unwrap());
                assert!(
                    (value - truth).abs() < u,
                    "{exponent} {named}: {value} ± {u}"
                );
            }
        }
    }
}
