//! The runner by itself, on the simulated rig: what it tells a recorder when camera, disk or people are in its way.

mod rehearsal;

use std::time::{Duration, Instant};

use ridged::bench::AxisName;
use ridged::bench::watched_value::WatchedValue;
use ridged::frame::{FrameKind, FrameTag};
use ridged::geometry::Pose;
use ridged::scan::faults::Reaction;
use ridged::scan::runner::{RunnerSettings, ScanCommand};
use ridged::scan::{OperatorAction, ScanState, Shot, Step};
use ridged::sim::world::AxisFault;
use ridged::units::Angle;

use rehearsal::{Cue, Statement, grid, run, run_after, run_with, samples, shot, with_exposures};

#[tokio::test(flavor = "multi_thread")]
async fn who_resumes_after_another_trouble_has_not_looked_at_a_black_sample() {
    let cues = [1, 2, 3].map(|frame| (frame, Cue::Fail));
    let cues = cues.into_iter().chain([(7, Cue::Black)]);
    let (end, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    // The second time somebody has, and the third point is as black.
    assert_eq!(reported.alarms, ["camera-failed", "frames-rejected"]);
    assert_eq!(reported.accepted, [0, 1, 2]);
}

#[tokio::test(flavor = "multi_thread")]
async fn one_failure_of_the_camera_is_retried_and_reported_as_a_recovery() {
    let (end, reported) = run(samples(), &[], [(5, Cue::Fail)], |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert!(!reported.states.contains(&ScanState::Paused));
    assert_eq!(reported.accepted, [0, 1, 2]);
    assert_eq!(reported.alarms, Vec::<String>::new());
    let [recovery] = reported.recoveries.as_slice() else {
        panic!("{:?}", reported.recoveries);
    };
    assert_eq!(recovery.code, "camera-failed");
    assert_eq!(recovery.points, [1]);
    assert!(!recovery.attended);
    assert!(
        recovery.message.contains("the cable came off"),
        "{}",
        recovery.message
    );
    // The first wait and the second visit.
    assert!(
        recovery.took_s >= 1.0 && recovery.took_s < 10.0,
        "{}",
        recovery.took_s
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fault_that_persists_has_the_reaction_of_the_settings() {
    let failing = || (4..=6).map(|frame| (frame, Cue::Fail));
    for (reaction, state, accepted, alarms) in [
        (
            Reaction::Pause,
            ScanState::Completed,
            &[0, 1, 2][..],
            "camera-failed",
        ),
        (
            Reaction::Skip,
            ScanState::Completed,
            &[0, 2],
            "point-skipped",
        ),
        (Reaction::Abort, ScanState::Failed, &[0], "camera-failed"),
    ] {
        let (end, reported) = run_with(
            samples(),
            &[],
            failing(),
            |_| u64::MAX,
            |settings| {
                settings.faults.reactions.camera = reaction;
            },
        )
        .await;
        assert_eq!(end.state, state, "{reaction:?}");
        assert_eq!(reported.accepted, accepted, "{reaction:?}");
        assert_eq!(reported.alarms, [alarms], "{reaction:?}");
        let paused = reported.states.contains(&ScanState::Paused);
        assert_eq!(paused, reaction == Reaction::Pause);
        // A person resumed it after an hour.
        let attended: Vec<bool> = reported.recoveries.iter().map(|r| r.attended).collect();
        assert_eq!(attended, vec![true; usize::from(paused)]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_point_whose_axis_was_touched_in_the_exposure_is_taken_again() {
    let turn = Angle::from_deg(0.5);
    for (fault, alarm) in [
        // Turned there and back: only the flag says so.
        (AxisFault::Knob(Angle::ZERO), Some("stage-interrupted")),
        (AxisFault::PowerCycle, Some("stage-power-cycled")),
        (AxisFault::ForeignMove(turn), None),
        // The counter knows nothing of it; the encoder of the next move does.
        (AxisFault::Slip(turn), None),
    ] {
        let cues = [(5, Cue::Cause(AxisName::ThetaC, fault))];
        let (end, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
        assert_eq!(end.state, ScanState::Completed, "{fault:?}");
        assert_eq!(reported.alarms, Vec::from_iter(alarm), "{fault:?}");
        assert_eq!(reported.accepted, [0, 1, 2], "{fault:?}");
        let [recovery] = reported.recoveries.as_slice() else {
            panic!("{fault:?}: {:?}", reported.recoveries);
        };
        assert_eq!(recovery.attended, alarm.is_some(), "{fault:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_blinded_camera_pauses_the_scan_until_somebody_has_looked() {
    let (end, reported) = run(samples(), &[], [(1, Cue::Full)], |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, ["frames-rejected"]);
    assert_eq!(reported.accepted, [0, 1, 2]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_is_too_bright_is_found_out_at_the_poses_furthest_apart() {
    let grid = |backwards: bool| {
        let at = |index: u32| {
            let pose = Pose::from_deg(f64::from(index / 8) * 2.0, f64::from(index % 8) * 5.0);
            Step::Shot(Shot {
                index,
                kind: FrameKind::Sample,
                pose: Some(pose),
                target: Some(pose),
                exposures_s: vec![0.02],
                repeats: 1,
            })
        };
        let mut steps: Vec<Step> = (0..64).map(at).collect();
        if backwards {
            steps.reverse();
        }
        steps
    };
    for backwards in [false, true] {
        let (end, reported) = run(grid(backwards), &[], [(1, Cue::Full)], |_| u64::MAX).await;
        assert_eq!(end.state, ScanState::Completed);
        // Reported long before all are taken, and each is taken once.
        assert_eq!(reported.alarms, ["frames-rejected"]);
        let mut all = reported.accepted.clone();
        all.sort_unstable();
        assert_eq!(all, (0..64).collect::<Vec<u32>>());
        let ends = [0, 56].map(|i| reported.accepted.iter().position(|a| *a == i).unwrap());
        assert!(ends.iter().all(|at| *at < 20), "{ends:?}");
        // All points are alike: the way to one that is out of turn is no more of the plan.
        assert!(
            reported.ahead.iter().all(|ahead| ahead.abs() < 0.1),
            "{:?}",
            reported.ahead
        );
        // A lamp that is too bright from the middle on has left others as they should be.
        let (_, reported) = run(grid(backwards), &[], [(32, Cue::Full)], |_| u64::MAX).await;
        assert!(
            reported.accepted.is_sorted() || backwards,
            "{:?}",
            reported.accepted
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_hangs_pauses_the_scan_until_it_no_longer_does() {
    // Three frames a visit, three visits before each pause.
    let cues = [(4, Cue::Hang), (4 + 2 * 9, Cue::Wake)];
    let (end, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    // Who resumes has not mended it by that.
    assert_eq!(reported.alarms, ["frames-rejected"; 2]);
    assert_eq!(reported.accepted, [0, 1, 2]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rejected_or_discarded_image_does_not_count_when_it_comes_again() {
    // The stage moves while the second point is taken, and the first image of its retake is the last of those.
    let moved = AxisFault::ForeignMove(Angle::from_deg(0.5));
    let rejected = vec![
        (5, Cue::Cause(AxisName::ThetaC, moved)),
        (7, Cue::Hang),
        (8, Cue::Wake),
    ];
    // The first four images of a camera that states nothing are discarded, and the last of them comes again.
    let discarded = vec![
        (1, Cue::State(|tag| *tag = FrameTag::default())),
        (5, Cue::Hang),
        (6, Cue::Wake),
    ];
    for (steps, cues, accepted, failures) in [
        (samples(), rejected, 3, "after 2 failures"),
        (grid(), discarded, 6, "bit for bit"),
    ] {
        let (end, reported) = run(steps, &[], cues, |_| u64::MAX).await;
        assert_eq!(end.state, ScanState::Completed);
        assert_eq!(reported.accepted, (0..accepted).collect::<Vec<u32>>());
        let [recovery] = reported.recoveries.as_slice() else {
            panic!("{:?}", reported.recoveries);
        };
        assert!(recovery.message.contains(failures), "{recovery:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_hour_between_stop_and_resume_is_nobodys_motion() {
    let (end, reported) = run(samples(), &[], [(4, Cue::Stop)], |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert!(reported.states.contains(&ScanState::Paused));
    assert_eq!(reported.accepted, [0, 1, 2]);
    assert!(end.elapsed_s > 0.0 && end.elapsed_s < 600.0, "{end:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_are_obeyed_while_the_stages_are_homed() {
    let cues = [(0, Cue::Order(ScanCommand::Pause))];
    let (end, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    let begin = [ScanState::Running, ScanState::Pausing, ScanState::Paused];
    assert_eq!(reported.states[..3], begin);
    let (asked, paused) = (reported.at_states[1], reported.at_states[2]);
    assert_eq!((asked.1, paused.0.shots_done), (Duration::ZERO, 0));
    assert_eq!(reported.accepted, [0, 1, 2]);

    let cues = [(0, Cue::Order(ScanCommand::Stop))];
    let (end, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
    assert_eq!((end.state, reported.pauses), (ScanState::Completed, 1));
    assert_eq!(reported.accepted, [0, 1, 2]);

    let cues = [(0, Cue::Order(ScanCommand::Abort))];
    let (_, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
    assert_eq!(reported.states, [ScanState::Running, ScanState::Aborted]);
    assert_eq!(reported.at_states[1].1, Duration::ZERO);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_does_not_wait_for_a_program_that_a_condition_reads() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("ran");
    // It answers once, then hangs.
    let script = format!(
        "if [ -e {0} ]; then exec sleep 50; fi; : > {0}; echo 20",
        mark.display()
    );
    let humidity = WatchedValue {
        name: "humidity".into(),
        command: ["sh", "-c", &script].map(String::from).to_vec(),
        min: None,
        max: Some(60.0),
        hysteresis: 0.0,
        timeout_s: 60.0,
    };
    let watch = |settings: &mut RunnerSettings| settings.suspend.watched = vec![humidity];
    // Exposures longer than the time after which the program runs again.
    let long = |(index, theta_c_deg)| match shot(index, FrameKind::Sample, theta_c_deg) {
        Step::Shot(shot) => Step::Shot(Shot {
            exposures_s: vec![6.0],
            repeats: 1,
            ..shot
        }),
        step => step,
    };
    let steps = [(0, 0.0), (1, 5.0)].map(long).to_vec();
    let cues = [(1, Cue::OrderAfter(ScanCommand::Abort))];
    let began = Instant::now();
    let (end, reported) = run_with(steps, &[], cues, |_| u64::MAX, watch).await;
    assert_eq!(
        (end.state, reported.accepted.len()),
        (ScanState::Aborted, 1)
    );
    let took = began.elapsed();
    assert!(took < Duration::from_secs(40), "{took:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_phase_is_reported_done_whichever_run_took_its_last_point() {
    let steps = || {
        vec![
            shot(0, FrameKind::Dark, 0.0),
            shot(1, FrameKind::Flat, 0.0),
            shot(2, FrameKind::Flat, 5.0),
            shot(3, FrameKind::Sample, 5.0),
        ]
    };
    // Taken in another order before; taken as a whole by a run that was killed before it could say so.
    for done in [&[0, 2][..], &[0, 1, 2]] {
        let (_, reported) = run(steps(), done, [], |_| u64::MAX).await;
        let phases = [FrameKind::Dark, FrameKind::Flat, FrameKind::Sample];
        assert_eq!(reported.phases, phases, "{done:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_resumed_scan_states_what_earlier_runs_did_before_its_first_point() {
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    for (done, share) in [
        (&[][..], 0.0),
        (&[0, 1, 2], 0.5),
        (&[0, 1, 2, 3, 4, 5], 1.0),
    ] {
        let (_, reported) = run_with(grid(), done, [], |_| u64::MAX, none).await;
        let (first, _) = reported.at_states[0];
        assert!((first.fraction - share).abs() < 0.15, "{done:?}: {first:?}");
        let left_s = first.time_left_s.unwrap();
        assert_eq!(left_s > 0.1, share < 1.0, "{done:?}: {left_s}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_point_is_begun_where_all_of_its_frames_have_room() {
    let room_for =
        |frames: u64| move |s: &RunnerSettings| s.disk_reserve_bytes + frames * s.frame_bytes_max;
    let (_, reported) = run(samples(), &[], [], room_for(3)).await;
    assert_eq!(reported.alarms, Vec::<String>::new());
    let (end, reported) = run(samples(), &[], [], room_for(2)).await;
    assert_eq!(reported.alarms, ["disk-full"]);
    assert_eq!(end.state, ScanState::Completed);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_is_one_frame_behind_gives_no_frame_of_another_pose() {
    // A check of the reference pose would refuse a camera that lags and does not state when it exposed.
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    for (cue, timed) in [(Cue::Lag, true), (Cue::LagUntimed(1), false)] {
        let (end, reported) = run_with(grid(), &[], [(3, cue)], |_| u64::MAX, none).await;
        assert_eq!(end.state, ScanState::Completed, "timed: {timed}");
        assert!(
            !reported.states.contains(&ScanState::Paused),
            "{:?}",
            reported.alarms
        );
        assert_eq!(reported.accepted, [0, 1, 2, 3, 4, 5]);
        assert_eq!(
            reported.of_another_pose,
            Vec::<u32>::new(),
            "timed: {timed}"
        );
        assert!(!reported.recoveries.is_empty());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_lags_gives_no_frame_of_where_something_else_moved_an_axis() {
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    let moved = AxisFault::ForeignMove(Angle::from_deg(0.7));
    for exposure in 4..12 {
        let cues = [
            (3, Cue::LagUntimed(1)),
            (exposure, Cue::Cause(AxisName::ThetaC, moved)),
        ];
        let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, none).await;
        assert_eq!(end.state, ScanState::Completed, "{exposure}");
        assert_eq!(reported.of_another_pose, Vec::<u32>::new(), "{exposure}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_stale_frame_with_other_noise_is_found_by_its_look() {
    // Four frames are discarded; the sixth and the eighth confirm the first two points.
    let cues = [
        (1, Cue::State(|tag| *tag = FrameTag::default())),
        (9, Cue::Stale),
    ];
    let (end, reported) = run(grid(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.accepted, [0, 1, 2, 3, 4, 5]);
    assert_eq!(reported.of_another_pose, Vec::<u32>::new());
    assert_eq!(reported.recoveries.len(), 1, "{:?}", reported.recoveries);
    assert!(reported.recoveries[0].message.contains("earlier pose"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_lags_gives_no_frame_of_another_exposure() {
    let strict = |settings: &mut RunnerSettings| {
        settings.reference.every = 0;
        settings.faults.reactions.frames = Reaction::Abort;
    };
    for exposures_s in [&[0.01, 0.02][..], &[0.005, 0.01, 0.02]] {
        // Behind since before the run: no frame has its exposure.
        for lag in 1..=4 {
            let cues = [(0, Cue::LagUntimed(lag))];
            let steps = with_exposures(grid(), exposures_s);
            let (end, reported) = run_with(steps, &[], cues, |_| u64::MAX, strict).await;
            let case = format!("{lag} behind, {exposures_s:?}");
            assert_eq!(end.state, ScanState::Failed, "{case}");
            assert_eq!(reported.alarms, ["frames-rejected"], "{case}");
            assert_eq!(reported.accepted, Vec::<u32>::new(), "{case}");
        }
    }
    // Behind from some frame on.
    for frame in 5..=18 {
        let cues = [
            (1, Cue::State(|tag| *tag = FrameTag::default())),
            (frame, Cue::Lag),
        ];
        let steps = with_exposures(grid(), &[0.01, 0.02]);
        let (_, reported) = run_with(steps, &[], cues, |_| u64::MAX, strict).await;
        let wrong = (reported.of_another_kind, reported.of_another_pose);
        assert_eq!(wrong, (Vec::new(), Vec::new()), "from frame {frame} on");
    }
    // A camera that is not behind is not hindered.
    let cues = [(1, Cue::State(|tag| *tag = FrameTag::default()))];
    let steps = with_exposures(grid(), &[0.01, 0.02]);
    let (end, reported) = run_with(steps, &[], cues, |_| u64::MAX, strict).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.recoveries.len(), 0, "{:?}", reported.recoveries);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_lags_gives_no_old_frame_of_any_kind() {
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    let once = |index, kind, theta_c_deg| match shot(index, kind, theta_c_deg) {
        Step::Shot(shot) => Step::Shot(Shot { repeats: 1, ..shot }),
        step => step,
    };
    for lag in 0..=4 {
        let steps = vec![
            Step::Operator(OperatorAction::CapLens),
            once(0, FrameKind::Dark, 0.0),
            Step::Operator(OperatorAction::PlaceWhiteReference),
            once(1, FrameKind::Flat, 0.0),
            once(2, FrameKind::Flat, 20.0),
            Step::Operator(OperatorAction::PlaceSample),
            once(3, FrameKind::Sample, 20.0),
            once(4, FrameKind::Sample, 5.0),
        ];
        let cues = [(0, Cue::LagUntimed(lag))];
        let (end, reported) = run_with(steps, &[], cues, |_| u64::MAX, none).await;
        assert_eq!(
            end.state,
            ScanState::Completed,
            "{lag}: {:?}",
            reported.alarms
        );
        assert_eq!(reported.accepted, [0, 1, 2, 3, 4], "{lag}");
        assert_eq!(reported.of_another_kind, Vec::<u32>::new(), "{lag}");
        assert_eq!(reported.of_another_pose, Vec::<u32>::new(), "{lag}");
        assert_eq!(reported.alarms, Vec::<String>::new(), "{lag}");
        assert_eq!(reported.recoveries.is_empty(), lag == 0, "{lag}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_buffer_full_of_equal_old_frames_is_emptied_before_a_frame_counts() {
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    for lag in 1..=4 {
        let cues = [(0, Cue::LagUntimed(lag))];
        let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, none).await;
        assert_eq!(
            end.state,
            ScanState::Completed,
            "{lag}: {:?}",
            reported.alarms
        );
        assert_eq!(reported.accepted, [0, 1, 2, 3, 4, 5], "{lag}");
        assert_eq!(reported.of_another_pose, Vec::<u32>::new(), "{lag}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_camera_states_wrongly_is_taken_again_and_another_camera_is_refused() {
    let wrong: [(Statement, &str); 3] = [
        (|tag| tag.exposure_s = Some(0.04), "frames-rejected"),
        (|tag| tag.gain = Some(7.0), "frames-rejected"),
        (|tag| tag.serial = Some("another".into()), "camera-replaced"),
    ];
    for (change, alarm) in wrong {
        let cues = [(2, Cue::State(change))];
        let (_, reported) = run(grid(), &[], cues, |_| u64::MAX).await;
        // A person resumes, and nothing is mended by that.
        assert_eq!(reported.accepted, [0], "{alarm}");
        assert!(
            reported.alarms.iter().all(|code| code == alarm),
            "{:?}",
            reported.alarms
        );
    }
    let lost = [(
        2,
        Cue::State(|tag| tag.counter = tag.counter.map(|n| n + 3)),
    )];
    let (end, reported) = run(grid(), &[], lost, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, Vec::<String>::new());
    assert!(reported.recoveries[0].message.contains("frames were lost"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lamp_that_fades_in_a_block_has_it_taken_again() {
    let all_poses = |settings: &mut RunnerSettings| settings.reference.time_share_max = 10.0;
    let cues = [(4, Cue::Fade(0.9))];
    let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, all_poses).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, ["reference-changed"]);
    assert_eq!(reported.withdrawn, [[0, 1, 2, 3, 4, 5]]);
    let mut accepted = reported.accepted.clone();
    accepted.sort_unstable();
    assert_eq!(accepted, [0, 1, 2, 3, 4, 5]);
    assert_eq!(
        reported.recoveries.last().unwrap().points,
        [0, 1, 2, 3, 4, 5]
    );
    // Without reference poses it is not found.
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    let cues = [(4, Cue::Fade(0.9))];
    let (_, reported) = run_with(grid(), &[], cues, |_| u64::MAX, none).await;
    assert_eq!(reported.withdrawn.len(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slip_that_a_homing_mended_has_the_points_before_it_taken_again() {
    let slip = AxisFault::Slip(Angle::from_deg(2.0));
    let cues = [
        (0, Cue::NoEncoder),
        (3, Cue::Cause(AxisName::ThetaC, slip)),
        (5, Cue::Cause(AxisName::ThetaC, AxisFault::PowerCycle)),
    ];
    let (end, reported) = run(grid(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed, "{:?}", reported.alarms);
    assert_eq!(reported.alarms, ["stage-power-cycled", "reference-changed"]);
    assert_eq!(reported.of_another_pose, [2, 3]);
    assert_eq!(reported.withdrawn, [[0, 1, 2, 3, 4]]);
    let mut accepted = reported.accepted.clone();
    accepted.sort_unstable();
    assert_eq!(accepted, [0, 1, 2, 3, 4, 5]);
    // A homing after which the picture is the same costs one frame.
    let cues = [
        (0, Cue::NoEncoder),
        (5, Cue::Cause(AxisName::ThetaC, AxisFault::PowerCycle)),
    ];
    let (end, reported) = run(grid(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, ["stage-power-cycled"]);
    assert_eq!(reported.withdrawn.len(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slip_between_reference_poses_is_found_by_a_point_that_was_confirmed_before() {
    // In a scan shorter than a block; between a check and the next reference pose; and the first after a check.
    for (every, slips_at) in [(20, 4), (3, 5), (2, 3)] {
        let slip = AxisFault::Slip(Angle::from_deg(3.0));
        let cues = [
            (0, Cue::NoEncoder),
            (slips_at, Cue::Cause(AxisName::ThetaC, slip)),
        ];
        let often = |settings: &mut RunnerSettings| settings.reference.every = every;
        let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, often).await;
        assert_eq!(
            end.state,
            ScanState::Completed,
            "{every}: {:?}",
            reported.alarms
        );
        assert_eq!(reported.alarms, ["reference-changed"], "{every}");
        assert!(!reported.of_another_pose.is_empty(), "{every}");
        for wrong in &reported.of_another_pose {
            assert!(
                reported.withdrawn.concat().contains(wrong),
                "{every}: {wrong}"
            );
        }
        let mut accepted = reported.accepted.clone();
        accepted.sort_unstable();
        assert_eq!(accepted, [0, 1, 2, 3, 4, 5], "{every}");
        assert_eq!(reported.reason, None);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_slip_that_only_later_points_show_is_found_by_a_homing_after_the_last_one() {
    // The sample is alike at the first azimuths. After the slip it comes to those where it is not, and each later look finds the
    // picture that was taken there.
    let at = |phi_s_deg: f64| Pose::from_deg(0.0, phi_s_deg);
    let points = || -> Vec<Step> {
        let azimuths = [0.0, 10.0, 20.0, 30.0, 200.0, 210.0];
        let turned = |(step, phi_s_deg): (Step, f64)| match step {
            Step::Shot(shot) => Step::Shot(Shot {
                pose: Some(at(phi_s_deg)),
                target: Some(at(phi_s_deg)),
                ..shot
            }),
            step => step,
        };
        grid().into_iter().zip(azimuths).map(turned).collect()
    };
    let level_dn = |pose: Pose| match pose.phi_s.deg() {
        deg if (100.0..300.0).contains(&deg) => 2500.0 - 40.0 * (deg - 200.0),
        _ => 2000.0,
    };
    let slip = AxisFault::Slip(Angle::from_deg(5.0));
    let cues = [
        (0, Cue::NoEncoder),
        (1, Cue::Even(level_dn)),
        (4, Cue::Cause(AxisName::PhiS, slip)),
    ];
    let (end, reported) = run(points(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed, "{:?}", reported.alarms);
    let recoveries = &reported.recoveries;
    assert_eq!(reported.alarms, ["reference-changed"], "{recoveries:?}");
    assert_eq!(reported.withdrawn, [[0, 1, 2, 3, 4, 5]]);
    for wrong in [4, 5] {
        assert!(reported.of_another_pose.contains(&wrong), "{wrong}");
    }
    let mut accepted = reported.accepted.clone();
    accepted.sort_unstable();
    assert_eq!((accepted, reported.reason), (vec![0, 1, 2, 3, 4, 5], None));
    // Where no picture depends on the azimuth, nothing shows it, and the scan says so.
    let even = |_: Pose| 2000.0;
    let cues = [
        (0, Cue::NoEncoder),
        (1, Cue::Even(even)),
        (4, Cue::Cause(AxisName::PhiS, slip)),
    ];
    let (_, reported) = run(points(), &[], cues, |_| u64::MAX).await;
    let reason = reported.reason.unwrap();
    assert!(
        reason.starts_with("a slip of phi_s by less than"),
        "{reason}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_resumed_scan_whose_last_point_changed_takes_all_points_of_its_earlier_runs_again() {
    let even = |_: Pose| 2000.0;
    let resumed = async |before_dn: u16| {
        let unchecked_dn = [(0, None), (1, None), (2, Some(before_dn))];
        let cues = [(0, Cue::NoEncoder), (1, Cue::Even(even))];
        let done = [0, 1, 2];
        run_after(grid(), &done, &unchecked_dn, cues, |_| u64::MAX, |_| {}).await
    };
    let (end, reported) = resumed(2300).await;
    assert_eq!(end.state, ScanState::Completed, "{:?}", reported.alarms);
    assert_eq!(reported.alarms, ["reference-changed"]);
    let withdrawn = reported.withdrawn.concat();
    for earlier in [0, 1, 2] {
        assert!(withdrawn.contains(&earlier), "{withdrawn:?}");
    }
    let mut accepted = reported.accepted.clone();
    accepted.sort_unstable();
    assert_eq!(accepted, [0, 1, 2, 3, 4, 5]);
    // Where it is as before, they count.
    let (end, reported) = resumed(2000).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!((reported.alarms, reported.withdrawn), (vec![], vec![]));
    assert_eq!(reported.accepted, [3, 4, 5]);
}

#[tokio::test(flavor = "multi_thread")]
async fn points_that_nothing_confirms_are_stated_at_the_end() {
    // A sample without light at every pose, and no encoders.
    let cues = [(0, Cue::NoEncoder), (1, Cue::Black)];
    let (end, reported) = run(grid(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed, "{:?}", reported.alarms);
    let reason = reported.reason.unwrap();
    assert!(
        reason.starts_with("6 points of the sample could not be"),
        "{reason}"
    );
    let (_, reported) = run(grid(), &[], [(0, Cue::NoEncoder)], |_| u64::MAX).await;
    assert_eq!(reported.reason, None);
    // Encoders show slips at once.
    let (_, reported) = run(grid(), &[], [(1, Cue::Black)], |_| u64::MAX).await;
    assert_eq!(reported.reason, None);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lamp_that_stays_dimmer_than_at_confirmed_points_waits_for_a_person() {
    let often = |settings: &mut RunnerSettings| {
        settings.reference.every = 2;
        settings.reference.time_share_max = 10.0;
    };
    let cues = [(0, Cue::NoEncoder), (6, Cue::Fade(0.9))];
    let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, often).await;
    assert_eq!(end.state, ScanState::Completed, "{:?}", reported.alarms);
    // Then all points are taken in the new light.
    assert!(reported.pauses >= 1);
    assert_eq!(reported.withdrawn.last().unwrap()[..], [0, 1, 2, 3]);
    let mut accepted = reported.accepted.clone();
    accepted.sort_unstable();
    assert_eq!(accepted, [0, 1, 2, 3, 4, 5]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_computer_that_was_suspended_in_an_exposure_takes_the_point_again() {
    let (end, reported) = run(grid(), &[], [(3, Cue::Suspend)], |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, ["host-suspended"]);
    assert_eq!(reported.recoveries[0].points, [2]);
    assert!(!reported.recoveries[0].attended);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_is_stopped_while_it_is_suspended_waits_for_a_person() {
    let set_point = |settings: &mut RunnerSettings| settings.tags.temperature_c = Some(-5.0);
    let cues = [
        (3, Cue::State(|tag| tag.temperature_c = Some(-2.0))),
        (5, Cue::Order(ScanCommand::Stop)),
        (6, Cue::State(|tag| tag.temperature_c = Some(-4.9))),
    ];
    let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, set_point).await;
    assert_eq!(end.state, ScanState::Completed);
    // The person came after an hour; the condition was over long before.
    assert_eq!(reported.pauses, 1);
    let recovery = reported
        .recoveries
        .iter()
        .find(|recovery| recovery.code == "camera-temperature")
        .unwrap();
    assert!(
        recovery.attended && recovery.took_s > 3000.0,
        "{recovery:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_is_suspended_while_a_condition_holds_and_resumes_by_itself() {
    let set_point = |settings: &mut RunnerSettings| settings.tags.temperature_c = Some(-5.0);
    let cues = [
        (1, Cue::State(|tag| tag.temperature_c = Some(-5.2))),
        (3, Cue::State(|tag| tag.temperature_c = Some(-2.0))),
        // Within the tolerance, but not within the half of it that ends the suspension.
        (6, Cue::State(|tag| tag.temperature_c = Some(-4.3))),
        (9, Cue::State(|tag| tag.temperature_c = Some(-4.9))),
    ];
    let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, set_point).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.accepted, [0, 1, 2, 3, 4, 5]);
    let code = "camera-temperature";
    assert!(
        reported
            .recoveries
            .iter()
            .any(|r| r.code == code && !r.attended)
    );
    assert!(
        reported.alarms.iter().all(|alarm| alarm == code),
        "{:?}",
        reported.alarms
    );
}
