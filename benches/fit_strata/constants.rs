//! What the search finds, and in which time, with each of its constants at half and at twice its value.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use rayon::prelude::*;
use ridged::fit::FitOptions;
use ridged::fit::multistart::tuning::Tuning;
use ridged::fit::one_variant::estimate;

use crate::Args;
use crate::draw::{self, Stratum};
use crate::judge;

/// Prints one line per value of a constant.
pub fn table(stratum: Stratum, args: &Args) {
    let first = args.seed.wrapping_mul(1_000_003);
    let crowd = |k| {
        let seed = first + k;
        let case = draw::case(stratum, seed);
        let best = judge::best_of(&case, stratum, args.crowd, seed).0;
        (case, best)
    };
    let cases: Vec<_> = (0..args.cases).into_par_iter().map(crowd).collect();
    let run = |name: &str, value: f64, tuning: Tuning| {
        let options = FitOptions {
            misfit: args.misfit,
            tuning,
            ..FitOptions::default()
        };
        let begun = Instant::now();
        let found = cases.par_iter().filter(|(case, best)| {
            let cancel = AtomicBool::new(false);
            let fitted = estimate(&case.set, case.variant, &options, None, &cancel);
            fitted.is_some_and(|e| {
                let chi2 = judge::chi2(case, &e.values);
                judge::is_deepest(chi2, chi2 - best)
            })
        });
        let found = 100.0 * found.count() as f64 / cases.len().max(1) as f64;
        let seconds = begun.elapsed().as_secs_f64();
        println!("{name:14} {value:>9} {found:>7.2} % {seconds:>8.1} s");
    };
    println!(
        "{:14} {:>9} {:>9} {:>10}",
        "constant", "value", "found", "time"
    );
    run("all", 1.0, Tuning::DEFAULT);
    for constant in Tuning::TABLE {
        for factor in [0.5, 2.0] {
            let mut tuning = Tuning::DEFAULT;
            let value = (constant.of)(&mut tuning);
            *value *= factor;
            let value = *value;
            run(constant.name, value, tuning);
        }
    }
    for constant in Tuning::TABLE {
        println!("{}: {}", constant.name, constant.reason);
    }
}
