//! Numbers at the ends of the doubles, for the property tests of every room's kernels.
//!
//! The same numbers with every run, so that a change is what fails and not the hour; as many others as
//! `PROPTEST_CASES` asks for, drawn afresh each time.

use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// So many cases per claim as is usual, always the same; or as many as `PROPTEST_CASES` asks for, new ones.
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

/// Every exponent, special values and plain ones, of either sign.
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

/// Anything between two positive numbers, every power of ten alike.
pub(crate) fn wide(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low.log10()..high.log10()).prop_map(|e| 10f64.powf(e))
}
