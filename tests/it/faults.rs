//! One fault at a time, through a whole scan on a stepped clock: the reaction to each kind that a simulated rig can have.
//!
//! `docs/reference/faults.md` lists all faults of a rig with the reaction of the scan and the tests that check it.

use ridged::sim::faults::plan::FaultPlan;

use crate::night::{Night, night, states_its_settings};

/// What has to come of a fault. In all cases every accepted datum is right.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Due {
    /// The scan completes without a pause, and no frame is taken again.
    Nothing,
    /// The scan completes without a pause and reports the recovery.
    Healed,
    /// The scan pauses for a reason with these words and completes after a person resumed it.
    Pause(&'static str),
    /// The scan ends so, for a person to resume.
    Interrupted,
}

const FOREVER: &str = "times = 100000";

/// A fault of `docs/reference/faults.md`, by its number, as lines of a plan.
#[rustfmt::skip]
const CASES: &[(u32, &str, &str, Due)] = &[
    (1, "drop-byte", "at_s = 17\ntimes = 4", Due::Nothing),
    (2, "garble-reply", "times = 40\nprobability = 0.1", Due::Nothing),
    (2, "garble-command", "times = 40\nprobability = 0.1", Due::Nothing),
    (4, "double-reply", FOREVER, Due::Nothing),
    (5, "late-reply", "times = 30\nprobability = 0.2", Due::Nothing),
    (6, "noise", FOREVER, Due::Nothing),
    (8, "idle-alert", FOREVER, Due::Nothing),
    (10, "lose-command", "command = \"move abs\"", Due::Nothing),
    (11, "lose-reply", "command = \"move abs\"\ntimes = 6", Due::Nothing),
    (12, "refuse", "at_s = 17\ncommand = \"move abs\"\ncode = \"BADDATA\"", Due::Pause("BADDATA")),
    (13, "refuse", "at_s = 17\ncommand = \"move abs\"\ncode = \"AGAIN\"", Due::Nothing),
    (13, "refuse", "at_s = 17\ncommand = \"move abs\"\ncode = \"STATUSBUSY\"", Due::Nothing),
    (14, "refuse", "at_s = 17\ncommand = \"move abs\"\ncode = \"DRIVERDISABLED\"", Due::Pause("DRIVERDISABLED")),
    (16, "refuse", "at_s = 17\ncommand = \"get pos\"\ncode = \"BADCOMMAND\"", Due::Pause("BADCOMMAND")),
    (17, "stall", "at_s = 17.5\naxis = \"theta_c\"\ncommand = \"move abs\"", Due::Pause("stalled")),
    (19, "limit-sensor", "at_s = 17.5\naxis = \"theta_c\"", Due::Pause("limit")),
    (21, "foreign-stop", "at_s = 18.5\naxis = \"theta_c\"", Due::Pause("another")),
    (21, "foreign-move", "at_s = 17.5\naxis = \"phi_s\"\nby_deg = 2", Due::Nothing),
    (21, "knob", "at_s = 17.5\naxis = \"theta_c\"\nby_deg = 2", Due::Pause("knob")),
    (23, "emergency-stop", "at_s = 17.5\naxis = \"phi_s\"", Due::Pause("emergency")),
    (24, "power-cycle", "at_s = 17.5\naxis = \"theta_c\"", Due::Pause("power cycle")),
    (25, "power-off", "at_s = 17.5\naxis = \"phi_s\"\nfor_s = 5", Due::Pause("")),
    (27, "unplug", "at_s = 17.5\nfor_s = 1", Due::Healed),
    (27, "unplug", "at_s = 17.5\nfor_s = 60", Due::Pause("")),
    (33, "silence", "at_s = 17.5\nfor_s = 0.5", Due::Nothing),
    (33, "silence", "at_s = 17.5\nfor_s = 4", Due::Healed),
    (33, "silence", "at_s = 17.5\nfor_s = 60", Due::Pause("does not answer")),
    (42, "camera-hang", "at_s = 17", Due::Healed),
    (42, "camera-fail", "at_s = 17", Due::Healed),
    (42, "camera-fail", "at_s = 17\ntimes = 5", Due::Pause("exit status 3")),
    (43, "frame-repeat", "at_s = 17.5", Due::Healed),
    (46, "frame-black", "at_s = 17.5", Due::Healed),
    (46, "frame-black", "at_s = 17\ntimes = 30", Due::Pause("black")),
    (47, "frame-size", "at_s = 17.5", Due::Healed),
    (47, "frame-size", "at_s = 17.5\ntimes = 30", Due::Pause("2")),
    (40, "slip", "at_s = 18.5\naxis = \"theta_c\"\nby_deg = 2", Due::Healed),
    (43, "frame-behind", "at_s = 17\ntimes = 100000", Due::Healed),
    (45, "frame-full", "at_s = 17.5", Due::Nothing),
    (48, "frame-half-dark", "at_s = 17.5", Due::Healed),
    (48, "frame-exposure", "at_s = 17.5\nfactor = 2", Due::Healed),
    (55, "disk-error", "at_s = 17.5", Due::Interrupted),
    (56, "disk-full", "at_s = 17.5\nfor_s = 30", Due::Pause("disk is full")),
];

#[test]
fn each_fault_has_its_reaction() {
    let mut wrong = Vec::new();
    for (row, kind, lines, due) in CASES {
        let text = format!("[[fault]]\nkind = \"{kind}\"\n{lines}\n");
        let plan = FaultPlan::read(&text).unwrap_or_else(|error| panic!("{text}{error}"));
        let lines = lines.replace('\n', ", ");
        // Only what the camera states shows another exposure; all else has to be found without.
        let seed = if *kind == "frame-exposure" { 2 } else { 1 };
        assert_eq!(states_its_settings(seed), seed == 2);
        match night(seed, &plan, &[]) {
            Ok(night) => {
                println!("{row:3} {kind} {lines}: {}", in_words(&night));
                if let Some(why) = difference(&night, *due) {
                    wrong.push(format!("{row} {kind} {lines}: {why}\n{}", night.story));
                }
            }
            Err(why) => wrong.push(format!("{row} {kind} {lines}: {why}")),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
}

fn in_words(night: &Night) -> String {
    let Night {
        end,
        pauses,
        alarms,
        recovered,
        rejected,
        faults,
        ..
    } = night;
    format!(
        "{faults} faults; {end}; pauses {pauses:?}; alarms {alarms:?}; recovered {recovered:?}; rejected {rejected:?}"
    )
}

/// What differs from what is due.
fn difference(night: &Night, due: Due) -> Option<String> {
    let end = match due {
        Due::Interrupted => "interrupted",
        _ => "completed",
    };
    if night.faults == 0 {
        return Some("the fault did not happen".into());
    }
    if night.end != end {
        return Some(format!("it ended {}, due is {end}", night.end));
    }
    let by_itself = night.pauses.is_empty();
    let fine = match due {
        Due::Nothing => by_itself && night.rejected.is_empty(),
        Due::Healed => by_itself && !night.recovered.is_empty(),
        Due::Pause(words) => night.pauses.iter().any(|why| why.contains(words)),
        Due::Interrupted => true,
    };
    (!fine).then(|| format!("due is {due:?}"))
}
