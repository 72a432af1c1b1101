//! Numbers at the limits of floating point, for the property tests of every module's kernels.
//!
//! Every run uses the same numbers, so that a failure is due to a change of the code; with `PROPTEST_CASES` each run
//! draws new ones.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Returns the configuration of a property test: `usual` cases with a fixed seed, or `PROPTEST_CASES` new ones.
pub(crate) fn cases(usual: u32) -> ProptestConfig {
    let asked = std::env::var("PROPTEST_CASES");
    let asked = asked.ok().and_then(|n| n.parse().ok());
    let default = ProptestConfig::default();
    ProptestConfig {
        cases: asked.unwrap_or(usual),
        rng_seed: match asked {
            Some(_) => default.rng_seed,
            None => RngSeed::Fixed(1),
        },
        failure_persistence: None,
        ..default
    }
}

/// Returns any f64: every exponent, special values and ordinary ones, of either sign.
pub(crate) fn any_double() -> impl Strategy<Value = f64> {
    prop_oneof![
        prop::sample::select(vec![
            0.0,
            -0.0,
            1.0,
            1.0 + 1e-12,
            1.0 - 1e-12,
            f64::MIN_POSITIVE,
            5e-324,
            f64::MAX,
            -f64::MAX,
            f64::EPSILON,
            std::f64::consts::FRAC_PI_2,
            90.0,
            30.0,
        ]),
        proptest::num::f64::NORMAL | proptest::num::f64::SUBNORMAL,
        -10.0..10.0f64,
        (-300.0..300.0f64).prop_map(|e| 10f64.powf(e)),
    ]
}

/// Returns numbers between two positive limits, uniform in the logarithm.
pub(crate) fn wide(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low.log10()..high.log10()).prop_map(|e| 10f64.powf(e))
}
