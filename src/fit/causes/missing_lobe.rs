//! Tests a lobe that few poses meet against no lobe.
//!
//! Call [`no_lobe`]. Light of the body alone also has chance maxima. Somewhere among the poses, a narrow lobe lies on
//! one of them, and there it fits better than no lobe by more than its own degrees of freedom allow, since the search
//! tried every pose. A surface without a lobe therefore stays possible until the data exclude it by more than that.

use std::sync::atomic::AtomicBool;

use crate::fit::least_squares::minimum::{Minimum, Settings};
use crate::fit::problem::{ALPHA_MIN, Problem, Quantity};
use crate::fit::subsample::minimise;
use crate::fit::uncertainty::coverage::COVERAGE;
use crate::model::Variant;

/// Trial steps of the descent without a lobe. It starts beside its minimum if there is no lobe; otherwise it is far from
/// any.
const STEPS: u64 = 40;

/// The best surface without a lobe near `minimum`, unless the data exclude it. Its roughness means nothing; it is
/// [`ALPHA_MIN`].
pub(in crate::fit) fn no_lobe(
    problem: &Problem<'_>,
    minimum: &Minimum,
    cancel: &AtomicBool,
) -> Option<Minimum> {
    // The lobe of the printed model carries ρd.
    if problem.variant() != Variant::Sawtooth {
        return None;
    }
    let dark = problem.clone().without_lobe();
    let mut bounds = dark.bounds();
    let mut start = minimum.parameters.clone();
    for alpha in [Quantity::AlphaU, Quantity::AlphaV] {
        let j = dark.column(alpha)?;
        start[j] = ALPHA_MIN.ln();
        bounds.upper[j] = start[j];
    }
    let settings = Settings::NEAR.within(STEPS);
    let found = minimise(&dark, &start, &bounds, &settings, cancel);
    let rise = found.cost - minimum.cost;
    let poses = dark.set().observations.len();
    (found.cost.is_finite() && rise < by_chance(poses)).then_some(found)
}

/// Fall of χ² that a lobe at the best of `poses` poses brings by chance, at the coverage of the report. A lobe has four
/// degrees of freedom, its place and its two widths. χ² then exceeds x at one pose with the probability
/// exp(−x/2) (1 + x/2).
fn by_chance(poses: usize) -> f64 {
    let chances = (poses.max(1) as f64 / (1.0 - COVERAGE)).ln();
    let mut half = chances;
    // A contraction by 1/(1 + x/2), at most 1/4.
    for _ in 0..12 {
        half = chances + half.ln_1p();
    }
    2.0 * half
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::FitOptions;
    use crate::fit::one_variant::estimate;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::report::VariantName;
    use crate::fit::report::build::report_of;
    use crate::geometry::Pose;
    use crate::observation::ObservationSet;

    /// Seven tilts and twelve azimuths of plastic, without its lobe if it is matte, with noise of 1e-3 of the lobe.
    fn scan(is_matte: bool, seed: u64) -> ObservationSet {
        let poses = (0..84).map(|n| {
            let (tilt, azimuth) = (f64::from(n / 12) - 3.0, f64::from(n % 12));
            Pose::from_deg(6.5 * tilt, 30.0 * azimuth)
        });
        let mut set = painted(poses, &TRUTH, 1e-3, seed);
        if is_matte {
            let lit = Problem::new(&set, Variant::Sawtooth, Quantity::ALL.to_vec(), TRUTH);
            let (clean, dark) = (
                lit.predicted(&TRUTH),
                lit.clone().without_lobe().predicted(&TRUTH),
            );
            let pairs = clean.iter().zip(dark);
            let lost: Vec<f64> = pairs.map(|(all, body)| all - body).collect();
            for (o, lost) in set.observations.iter_mut().zip(lost) {
                o.signal -= lost;
            }
        }
        set
    }

    #[test]
    fn light_of_the_body_alone_gives_an_angle_and_no_roughness() {
        for seed in 1..=6 {
            let set = scan(true, seed);
            let cancel = AtomicBool::new(false);
            let options = FitOptions::default();
            let e = estimate(&set, Variant::Sawtooth, &options, None, &cancel).unwrap();
            let report = report_of(&e, VariantName::Sawtooth);
            let p = &report.parameters;
            assert_eq!(p.alpha_u.value, None, "{seed} {p:?}");
            assert_eq!(p.alpha_v.value, None, "{seed} {p:?}");
            let off = p.theta_r_deg.value.unwrap() - TRUTH.theta_r.to_degrees();
            assert!(
                off.abs() < 1.5 * p.theta_r_deg.expanded.unwrap(),
                "{seed} {off} {p:?}"
            );
            let named = report
                .warnings
                .iter()
                .filter(|w| w.contains("may show no lobe"));
            assert_eq!(named.count(), 1, "{seed} {:?}", report.warnings);
        }
    }

    #[test]
    fn a_lobe_that_is_there_is_no_matter_of_chance() {
        let set = scan(false, 1);
        let cancel = AtomicBool::new(false);
        let options = FitOptions::default();
        let e = estimate(&set, Variant::Sawtooth, &options, None, &cancel).unwrap();
        assert_eq!(e.no_lobe, None);
        assert!(
            report_of(&e, VariantName::Sawtooth)
                .parameters
                .alpha_u
                .value
                .is_some()
        );
    }

    #[test]
    fn chance_at_the_best_of_many_poses_is_the_tail_of_chi_squared_times_their_number() {
        for poses in [1, 15, 84, 20_000] {
            let half = 0.5 * by_chance(poses);
            let chance = poses as f64 * (-half).exp() * (1.0 + half);
            assert!((chance - (1.0 - COVERAGE)).abs() < 1e-6, "{poses} {chance}");
        }
    }
}
