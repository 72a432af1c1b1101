//! Plans: resolved, checked, ordered.

use std::time::Duration;

use super::*;
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::units::Angle;

fn limits() -> TravelLimits {
    TravelLimits {
        theta_c: (Angle::from_deg(-60.0), Angle::from_deg(60.0)),
        phi_s: (Angle::from_deg(-10.0), Angle::from_deg(345.0)),
    }
}

fn defaults() -> PlanDefaults {
    PlanDefaults {
        exposures_s: vec![0.02, 0.06, 0.18],
        flat_exposures_s: vec![0.02, 0.06],
        dark_repeats: 4,
        flat_repeats: 1,
        reference_every: 20,
    }
}

fn paper() -> Plan {
    PlanRequest::preset(Preset::Paper)
        .resolve(&defaults())
        .unwrap()
}

/// Both axes at once, at 10 °/s and 30 °/s.
fn move_time(from: Pose, to: Pose) -> Duration {
    let theta = (to.theta_c - from.theta_c).abs().deg() / 10.0;
    let phi = (to.phi_s - from.phi_s).abs().deg() / 30.0;
    Duration::from_secs_f64(theta.max(phi))
}

fn shots(steps: &[Step]) -> Vec<&Shot> {
    steps
        .iter()
        .filter_map(|step| match step {
            Step::Shot(shot) => Some(shot),
            Step::Operator(_) => None,
        })
        .collect()
}

#[test]
fn the_example_in_the_docs_is_a_plan_with_every_key_but_the_preset() {
    let text = include_str!("../../../docs/examples/plan.toml");
    let request = PlanRequest::from_toml(text).unwrap();
    let stated = serde_json::to_value(&request).unwrap();
    let open = |object: &serde_json::Value| -> Vec<String> {
        let keys = object.as_object().unwrap().iter();
        keys.filter(|(_, value)| value.is_null())
            .map(|(key, _)| key.clone())
            .collect()
    };
    assert_eq!(open(&stated), ["poses", "preset"]);
    assert!(open(&stated["dark"]).is_empty() && open(&stated["flat"]).is_empty());
    let plan = request.resolve(&defaults()).unwrap();
    plan.check(&limits()).unwrap();
    // 9 × 7 poses × 2 exposures × 2, 5 tilts × 1 exposure, 2 exposures × 4
    assert_eq!(plan.n_frames(), 252 + 5 + 8);
}

#[test]
fn the_full_preset_has_the_frames_of_the_recorded_series() {
    let plan = PlanRequest::preset(Preset::Full)
        .resolve(&defaults())
        .unwrap();
    plan.check(&limits()).unwrap();
    // 108 poses × 3 exposures, 9 tilts × 2 exposures, 3 exposures × 4 repeats
    assert_eq!(plan.n_frames(), 324 + 18 + 12);
    let steps = plan.steps(&limits(), Pose::from_deg(0.0, 0.0), &move_time);
    let total = estimate(&steps, Pose::from_deg(0.0, 0.0), &move_time, 1000);
    assert_eq!(u64::from(total.n_frames), plan.n_frames());
    assert_eq!(total.disk_bytes, 354_000);
}

#[test]
fn a_point_has_no_more_frames_than_memory_should_hold() {
    let frame_bytes = 50_000_000;
    let mut plan = paper();
    plan.check_points(frame_bytes).unwrap();
    plan.exposures_s = vec![0.01, 0.02];
    plan.repeats = 40;
    plan.check_points(frame_bytes).unwrap();
    plan.repeats = 41;
    plan.dark.repeats = 300_000;
    let error = plan.check_points(frame_bytes).unwrap_err();
    let fields: Vec<&str> = error.problems.iter().map(|p| p.field.as_str()).collect();
    assert_eq!(fields, ["plan.repeats", "plan.dark.repeats"]);
    assert!(error.to_string().contains("82 frames"), "{error}");
}

#[test]
fn the_order_visits_every_pose_once_and_beats_the_order_of_the_lists() {
    let plan = paper();
    let start = Pose::from_deg(0.0, 0.0);
    let steps = plan.steps(&limits(), start, &move_time);
    let sample: Vec<Pose> = shots(&steps)
        .into_iter()
        .filter(|shot| shot.kind == FrameKind::Sample)
        .filter_map(|shot| shot.pose)
        .collect();
    let mut naive = Vec::new();
    for theta in &plan.theta_c_deg {
        for phi in &plan.phi_s_deg {
            let pose = Pose::from_deg(*theta, *phi);
            assert_eq!(sample.iter().filter(|p| **p == pose).count(), 1);
            naive.push(pose);
        }
    }
    let cost = |poses: &[Pose]| {
        poses
            .windows(2)
            .map(|w| move_time(w[0], w[1]))
            .sum::<Duration>()
    };
    assert!(cost(&sample) < cost(&naive));
    // Serpentine over 5 tilts (1 s apart) inside 3 azimuths (3 s apart): 3·4·1 + 2·3.
    assert!((cost(&sample).as_secs_f64() - 18.0).abs() < 1e-6);
}

#[test]
fn an_azimuth_beyond_the_travel_is_reached_by_another_turn() {
    let request = PlanRequest {
        theta_c_deg: Some(Values::List(vec![0.0])),
        phi_s_deg: Some(Values::List(vec![0.0, 355.0])),
        ..PlanRequest::default()
    };
    let plan = request.resolve(&defaults()).unwrap();
    plan.check(&limits()).unwrap();
    let steps = plan.steps(&limits(), Pose::from_deg(0.0, 0.0), &move_time);
    let shot = shots(&steps)
        .into_iter()
        .find(|shot| shot.pose == Some(Pose::from_deg(0.0, 355.0)))
        .unwrap();
    assert!((shot.target.unwrap().phi_s.deg() + 5.0).abs() < 1e-9);
}

#[test]
fn a_points_index_does_not_depend_on_where_the_stages_stand() {
    let index = |start: Pose| {
        let steps = paper().steps(&limits(), start, &move_time);
        let mut all: Vec<(u32, f64, f64)> = shots(&steps)
            .into_iter()
            .filter_map(|s| s.pose.map(|p| (s.index, p.theta_c.deg(), p.phi_s.deg())))
            .collect();
        all.sort_by_key(|a| a.0);
        all
    };
    let here = index(Pose::from_deg(-20.0, 0.0));
    assert_eq!(here, index(Pose::from_deg(20.0, 180.0)));
    assert!(here.windows(2).all(|w| w[0].0 < w[1].0));
}

#[test]
fn stated_poses_are_visited_in_their_order() {
    let text = "poses = [\n  { theta_c_deg = 10, phi_s_deg = 355 },\n  { theta_c_deg = -20, phi_s_deg = 0 },\n  \
                { theta_c_deg = 10, phi_s_deg = 90 },\n]";
    let plan = PlanRequest::from_toml(text).unwrap();
    let plan = plan.resolve(&defaults()).unwrap();
    plan.check(&limits()).unwrap();
    assert_eq!(plan.theta_c_deg, [-20.0, 10.0]);
    assert_eq!(plan.phi_s_deg, [0.0, 90.0, 355.0]);
    // The white reference is taken at each tilt once.
    assert_eq!(plan.n_frames(), 3 * 3 + 2 * 2 + 3 * 4);
    let steps = plan.steps(&limits(), Pose::from_deg(0.0, 0.0), &move_time);
    let total = estimate(&steps, Pose::from_deg(0.0, 0.0), &move_time, 1);
    assert_eq!(u64::from(total.n_frames), plan.n_frames());
    let rounded = |angle: Angle| (angle.deg() * 1e6).round() / 1e6;
    let sample: Vec<(u32, [f64; 3])> = shots(&steps)
        .into_iter()
        .filter(|shot| shot.kind == FrameKind::Sample)
        .map(|shot| {
            let (pose, target) = (shot.pose.unwrap(), shot.target.unwrap());
            let angles = [pose.theta_c, pose.phi_s, target.phi_s];
            (shot.index, angles.map(rounded))
        })
        .collect();
    assert_eq!(
        sample,
        [
            (3, [10.0, 355.0, -5.0]),
            (4, [-20.0, 0.0, 0.0]),
            (5, [10.0, 90.0, 90.0]),
        ]
    );
    let kept: Plan = serde_json::from_value(serde_json::to_value(&plan).unwrap()).unwrap();
    assert_eq!(kept, plan);
}

#[test]
fn what_is_wrong_with_stated_poses_is_named_by_their_place() {
    let problems_of = |text: &str| {
        let request = PlanRequest::from_toml(text).unwrap();
        let checked = request
            .resolve(&defaults())
            .and_then(|plan| plan.check(&limits()));
        checked.unwrap_err().problems
    };
    let fields = |text: &str| -> Vec<String> {
        problems_of(text)
            .into_iter()
            .map(|problem| problem.field)
            .collect()
    };
    assert_eq!(fields("poses = []"), ["plan.poses"]);
    assert_eq!(
        fields(
            "poses = [{ theta_c_deg = 75, phi_s_deg = 0 }, { theta_c_deg = nan, phi_s_deg = 0 }, { theta_c_deg = 0, \
             phi_s_deg = inf }, { theta_c_deg = 5, phi_s_deg = 1 }, { theta_c_deg = 5, phi_s_deg = 1 }]"
        ),
        [
            "plan.poses[0].theta_c_deg",
            "plan.poses[1].theta_c_deg",
            "plan.poses[2].phi_s_deg",
            "plan.poses[4]",
        ]
    );
    let beyond = problems_of("poses = [{ theta_c_deg = 75, phi_s_deg = 347 }]");
    assert_eq!(beyond[0].out_of_range, Some([75.0, -60.0, 60.0]));
    assert_eq!(beyond[1].field, "plan.poses[0].phi_s_deg");
    assert_eq!(
        fields("preset = \"paper\"\nposes = [{ theta_c_deg = 5, phi_s_deg = 1 }]"),
        ["plan.poses"]
    );
}

#[test]
fn everything_wrong_is_named_at_once() {
    let mut plan = paper();
    plan.theta_c_deg = vec![f64::NAN, 75.0, 10.0, 10.0];
    plan.phi_s_deg = vec![];
    plan.exposures_s = vec![-1.0, 0.1, 0.1];
    plan.flat.theta_c_deg = vec![0.0, 75.0];
    plan.flat.exposures_s = vec![];
    let error = plan.check(&limits()).unwrap_err();
    let fields: Vec<&str> = error.problems.iter().map(|p| p.field.as_str()).collect();
    for field in [
        "plan.theta_c_deg[0]",
        "plan.theta_c_deg[1]",
        "plan.theta_c_deg[3]",
        "plan.phi_s_deg",
        "plan.exposures_s[0]",
        "plan.exposures_s[2]",
        "plan.flat.theta_c_deg[1]",
        "plan.flat.exposures_s",
    ] {
        assert!(fields.contains(&field), "{field} is not in {fields:?}");
    }
}

#[test]
fn no_repeats_of_the_sample_leave_the_calibrations() {
    let plan_of = |text: &str| {
        let plan = PlanRequest::from_toml(text).unwrap().resolve(&defaults())?;
        plan.check(&limits())?;
        Ok::<_, PlanError>(plan)
    };
    let kinds = |plan: &Plan| -> Vec<(FrameKind, Option<Pose>)> {
        let steps = plan.steps(&limits(), Pose::from_deg(3.0, 40.0), &move_time);
        let shots = shots(&steps).into_iter();
        shots.map(|shot| (shot.kind, shot.target)).collect()
    };
    // The azimuth plays no part: the turntable stays where it is.
    let both = plan_of("theta_c_deg = [5.0]\nrepeats = 0").unwrap();
    assert_eq!(
        kinds(&both),
        [
            (FrameKind::Dark, None),
            (FrameKind::Flat, Some(Pose::from_deg(5.0, 40.0)))
        ]
    );
    assert!(!both.reuse_calibrations);
    assert_eq!(both.n_frames(), 3 * 4 + 2);
    // Dark frames need no angle at all.
    let dark = plan_of("repeats = 0\nflat.repeats = 0").unwrap();
    assert_eq!(kinds(&dark), [(FrameKind::Dark, None)]);
    let preset = plan_of("preset = \"paper\"\nrepeats = 0").unwrap();
    assert_eq!(kinds(&preset).len(), 1 + 5);
    for (text, field) in [
        ("repeats = 0", "plan.theta_c_deg"),
        (
            "repeats = 0\nflat.repeats = 0\ndark.repeats = 0",
            "plan.repeats",
        ),
        (
            "preset = \"full\"\nrepeats = 0\nreuse_calibrations = true",
            "plan.reuse_calibrations",
        ),
        (
            "theta_c_deg = [5.0]\nrepeats = 0\nphi_s_deg = [nan]",
            "plan.phi_s_deg[0]",
        ),
    ] {
        let error = plan_of(text).unwrap_err();
        assert_eq!(error.problems[0].field, field, "{error}");
    }
}

#[test]
fn a_thousand_million_points_are_refused_before_they_take_memory() {
    let request = PlanRequest {
        theta_c_deg: Some(Values::Grid(Grid {
            from: -20.0,
            to: 20.0,
            step: 4e-8,
        })),
        phi_s_deg: Some(Values::List(vec![0.0])),
        ..PlanRequest::default()
    };
    let error = request.resolve(&defaults()).unwrap_err();
    assert_eq!(error.problems[0].field, "plan.theta_c_deg");
    let mut plan = paper();
    plan.repeats = u32::MAX;
    assert!(plan.check(&limits()).is_err());
}

#[test]
fn a_plan_file_with_an_unknown_key_is_refused_by_its_name() {
    let error = PlanRequest::from_toml("preset = \"paper\"\nexposure_s = [1.0]").unwrap_err();
    assert!(error.to_string().contains("exposure_s"), "{error}");
    assert!(error.to_string().contains("exposures_s"), "{error}");
    for (text, words) in [
        (
            "preset = \"papr\"",
            "line 1: preset: expected paper or full, got \"papr\"; did you mean `paper`?",
        ),
        ("repeats = 1.5", "line 1: repeats: expected a whole number"),
        (
            "\n[dark]\nrepeats = -1",
            "line 3: dark.repeats: expected a whole number",
        ),
        (
            "theta_c_deg = 5",
            "theta_c_deg: a list of numbers, or an object of from, to and step",
        ),
    ] {
        let error = PlanRequest::from_toml(text).unwrap_err().to_string();
        assert!(error.contains(words), "{words} is not in: {error}");
    }
}

#[test]
fn a_grid_reaches_its_last_value() {
    let text = "theta_c_deg = {from = -20, to = 20, step = 5}\nphi_s_deg = [0.0]";
    let plan = PlanRequest::from_toml(text)
        .unwrap()
        .resolve(&defaults())
        .unwrap();
    assert_eq!(plan.theta_c_deg.len(), 9);
    assert_eq!(plan.theta_c_deg[8], 20.0);
}
