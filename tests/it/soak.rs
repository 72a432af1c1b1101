//! Scans under seeded faults of line, stages, camera, disk, clock and people.
//!
//! A run must end completed and right, or in another named state with its cause: no hang, no panic, no wrong datum.
//! `make soak SEEDS=A..B` runs more seeds than the test of the suite; a seed that fails prints its plan and its story, and
//! `ridged serve --simulated-rig --faults FILE` runs such a plan.

use std::collections::BTreeMap;
use std::ops::Range;
use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use ridged::bench::AxisName;
use ridged::sim::faults::plan::{FaultKind, FaultPlan, PlannedFault};

use crate::night::{Button, Press, night, states_its_settings};

/// Seeds of the suite's own run.
const SEEDS: Range<u64> = 0..100;
#[test]
fn no_seed_gives_a_wrong_datum_a_hang_or_an_end_without_a_cause() {
    let seeds = match std::env::var("RIDGED_SOAK_SEEDS") {
        Ok(text) => range(&text).expect("RIDGED_SOAK_SEEDS is like 0..10000"),
        Err(_) => SEEDS,
    };
    let began = Instant::now();
    let (total, mut failed) = (seeds.end - seeds.start, Vec::new());
    let mut ends = BTreeMap::<String, u32>::new();
    for seed in seeds {
        let (text, presses) = drawn(seed);
        match night(seed, &text, &presses) {
            Ok(night) => *ends.entry(night.end).or_default() += 1,
            Err(story) => {
                println!("seed {seed} failed\n{story}\n");
                failed.push(seed);
            }
        }
    }
    let took_s = began.elapsed().as_secs_f64();
    println!(
        "{total} seeds in {took_s:.0} s, {:.3} s each: {ends:?}",
        took_s / total as f64
    );
    assert!(
        failed.is_empty(),
        "{} of {total} seeds failed: {failed:?}",
        failed.len()
    );
}

fn range(text: &str) -> Option<Range<u64>> {
    let (from, to) = text.split_once("..")?;
    Some(from.parse().ok()?..to.parse().ok()?)
}

/// The faults and the presses of a seed.
fn drawn(seed: u64) -> (FaultPlan, Vec<Press>) {
    let mut rng = Pcg64::seed_from_u64(seed ^ 0x50A4);
    let mut one_of = |n: usize| rng.random_range(0..n);
    const COMMANDS: [&str; 6] = ["", "move abs", "get pos", "warnings", "home", "stop"];
    let faults = (0..1 + one_of(5)).map(|_| {
        let mut fault = PlannedFault::of(FaultKind::ALL[one_of(FaultKind::ALL.len())]);
        if fault.kind == FaultKind::FrameExposure && !states_its_settings(seed) {
            // Nothing shows another exposure where each point has one and the camera states none.
            fault.kind = FaultKind::FrameSize;
        }
        // Most things happen while it homes and scans; some long after.
        fault.at_s = one_of(600) as f64 / if one_of(4) == 0 { 1.0 } else { 10.0 };
        fault.command = COMMANDS[one_of(COMMANDS.len())].into();
        if fault.kind.is_repeated() {
            fault.times = [1, 1, 2, 3, 8, 60][one_of(6)];
            fault.probability = [1.0, 1.0, 0.5, 0.15][one_of(4)];
        }
        if fault.kind.has_axis() {
            fault.axis = Some(AxisName::ALL[one_of(2)]);
        }
        if fault.kind.has_angle() {
            fault.by_deg = Some([0.1, 0.5, 2.0, -1.0][one_of(4)]);
        }
        if fault.kind.has_duration() {
            fault.for_s = Some([0.3, 1.0, 4.0, 30.0, 300.0][one_of(5)]);
        }
        if fault.kind == FaultKind::Refuse {
            let code = ["AGAIN", "STATUSBUSY", "BADDATA", "DRIVERDISABLED"][one_of(4)];
            fault.code = Some(code.into());
        }
        if fault.kind == FaultKind::FrameExposure {
            fault.factor = Some([0.25, 0.5, 1.5, 3.0][one_of(4)]);
        }
        fault
    });
    let text = FaultPlan {
        fault: faults.collect(),
    };
    let presses = (0..one_of(3)).map(|_| Press {
        at_event: 1 + one_of(60),
        button: [Button::Stop, Button::Pause, Button::Sleep][one_of(3)],
    });
    (text, presses.collect())
}
