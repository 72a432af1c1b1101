//! The controllers of a rig: pinned at the first connection, refused by name when they change, found on another port.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use ridged::bench::AxisName::ThetaC;
use ridged::bench::stage::{Stage, StageError, StageSettings};
use ridged::lab::{Lab, LabError, RigParts};
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, Rig as ScanRig, ScanState, StageLink};
use ridged::sim::world::AxisFault;
use ridged::store::disk::RealDisk;

use crate::bench_in_a_box::{BenchInABox, small};
use crate::http::{is_problem, request, router_of, send};
use crate::stage::{Rig, settings};

/// A rig whose settings state no serial numbers, as in the example file.
fn without_serials(parts: RigParts) -> RigParts {
    let RigParts { rig, settings } = parts;
    let link = rig.link().clone();
    let link = StageLink {
        settings: no_serials(link.settings),
        ..link
    };
    RigParts {
        rig: ScanRig::new(link, rig.camera),
        settings,
    }
}

fn no_serials(mut settings: StageSettings) -> StageSettings {
    settings.theta_c.serial = None;
    settings.phi_s.serial = None;
    settings
}

async fn opened(folder: &Path, hands: bool) -> BenchInABox {
    let disk = Arc::new(RealDisk);
    BenchInABox::open_as(folder, disk, hands, Duration::ZERO, without_serials).await
}

async fn alarms(lab: &Lab) -> Vec<String> {
    let events = lab.store().events_after(0, 1000).await.unwrap();
    let code = |event: &Event| match event {
        Event::Alarm { code, .. } => Some(code.clone()),
        _ => None,
    };
    events.iter().filter_map(|e| code(&e.event)).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn another_controller_is_refused_by_name_until_a_person_accepts_it() {
    let folder = tempfile::tempdir().unwrap();
    let bench = opened(folder.path(), false).await;
    assert!(bench.lab.rig().await.unwrap().connected);
    bench.end().await;

    let bench = opened(folder.path(), false).await;
    // A person is asked once whether the controllers are the right ones.
    let pinned = alarms(&bench.lab).await;
    assert_eq!(pinned, ["stages-pinned"]);
    bench.rig.world.cause(ThetaC, AxisFault::Replaced(777));
    let view = bench.lab.rig().await.unwrap();
    let (code, why) = view.problem.unwrap();
    assert_eq!(code, "stage-other-device");
    for part in ["90001", "777", "accept-stages"] {
        assert!(why.contains(part), "{part}: {why}");
    }
    assert_eq!(view.refused_stages.unwrap().theta_c.serial, 777);
    let refused = bench.lab.home(ThetaC).await.unwrap_err();
    assert_eq!(refused.code(), "stage-other-device", "{refused}");

    let router = router_of(&bench.lab);
    let accept = async |theta_c: &str| {
        let body = format!("{{\"theta_c_serial\":\"{theta_c}\",\"phi_s_serial\":\"90002\"}}");
        let asked = request("POST", "/api/v1/rig/accept-stages")
            .header("content-type", "application/json")
            .body(Body::from(body));
        send(&router, asked.unwrap()).await
    };
    is_problem(&accept("1").await, 409, "other-stages");
    is_problem(&accept("x").await, 422, "invalid-value");
    assert!(!bench.lab.rig().await.unwrap().connected);
    let accepted = accept("777").await;
    assert_eq!(accepted.status, 200, "{}", accepted.body);
    assert_eq!(accepted.body["theta_c"]["serial"], "777");
    let view = bench.lab.rig().await.unwrap();
    assert!(
        view.connected && view.refused_stages.is_none(),
        "{:?}",
        view.problem
    );
    assert!(
        alarms(&bench.lab)
            .await
            .contains(&"stages-accepted".to_owned())
    );
    bench.end().await;

    // The acceptance lasts: now the first controller is another one.
    let bench = opened(folder.path(), false).await;
    let view = bench.lab.rig().await.unwrap();
    assert_eq!(view.refused_stages.unwrap().theta_c.serial, 90_001);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_that_is_replaced_in_a_scan_pauses_it_and_the_scan_notes_the_new_one() {
    let folder = tempfile::tempdir().unwrap();
    let bench = opened(folder.path(), false).await;
    let scan = bench.start(small(&[0.0, 10.0], &[0.0, 30.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.rig.world.cause(ThetaC, AxisFault::Replaced(777));
    let hands = bench.rig.operate(&bench.lab, true);
    bench.until(scan.id, ScanState::Paused).await;
    // The restart alone pauses it. The line stayed; homing finds that the controller is another one.
    let resumed = bench.lab.order(scan.id, ScanCommand::Resume).await;
    resumed.unwrap();
    bench.until(scan.id, ScanState::Paused).await;
    let why = bench.lab.store().scan(scan.id).await.unwrap().reason;
    let why = why.unwrap();
    assert!(why.contains("777") && why.contains("90001"), "{why}");
    bench.lab.accept_stages([777, 90_002]).await.unwrap();
    let resumed = bench.lab.order(scan.id, ScanCommand::Resume).await;
    resumed.unwrap();
    let scan = bench.finish(scan.id).await;
    assert_eq!(scan.state, ScanState::Completed, "{:?}", scan.reason);
    let reported = alarms(&bench.lab).await;
    assert!(
        reported.contains(&"stages-changed".to_owned()),
        "{reported:?}"
    );
    hands.abort();
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_interrupted_scan_is_not_resumed_with_another_controller() {
    let folder = tempfile::tempdir().unwrap();
    let bench = opened(folder.path(), false).await;
    let scan = bench.start(small(&[0.0, 10.0], &[0.0, 30.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.end().await;
    let bench = opened(folder.path(), true).await;
    bench.rig.world.cause(ThetaC, AxisFault::Replaced(777));
    let refused = bench.lab.order(scan.id, ScanCommand::Resume).await;
    let refused = refused.unwrap_err();
    assert_eq!(refused.code(), "stage-other-device", "{refused}");
    let state = bench.lab.store().scan(scan.id).await.unwrap().state;
    assert_eq!(state, ScanState::Interrupted);
    let others = bench.lab.accept_stages([777, 1]).await.unwrap_err();
    assert!(
        matches!(others, LabError::OtherStagesAnswer { .. }),
        "{others}"
    );
    bench.end().await;
}

#[tokio::test]
async fn swapped_addresses_are_named_as_such_and_a_stated_serial_number_wins() {
    let rig = Rig::new();
    let notices = Default::default();
    let link = rig.link(no_serials(settings()));
    let first = Stage::connect_known(&link, None, &notices).await.unwrap();
    let known = first.identity();
    first.close();
    first.closed().await;
    for command in ["/1 0 renumber 3", "/2 0 renumber 1", "/3 0 renumber 2"] {
        rig.foreign(command);
    }
    let error = Stage::connect_known(&link, Some(&known), &notices).await;
    let error = error.err().unwrap();
    assert!(matches!(error, StageError::OtherStages(_)), "{error:?}");
    assert!(
        error.to_string().contains("swapped their addresses"),
        "{error}"
    );
    // They have executed the stop that begins every connection.
    let stop = LabError::NotStopped { source: error }.to_string();
    assert!(
        stop.contains("acknowledged the stop") && stop.contains("swapped their addresses"),
        "{stop}"
    );
    assert!(!stop.contains("did not reach"), "{stop}");
    let mut stated = settings();
    (stated.theta_c.serial, stated.phi_s.serial) = (Some(90_002), Some(90_001));
    let link = rig.link(stated);
    let error = Stage::connect_known(&link, Some(&known), &notices).await;
    let error = error.err().unwrap();
    // Nothing is said of the controllers any more; their travels are swapped too.
    assert!(
        matches!(error, StageError::BeyondTravel { .. }),
        "{error:?}"
    );
}

#[tokio::test]
async fn the_stages_are_found_under_another_name_of_their_port() {
    let rig = Rig::new();
    let folder = tempfile::tempdir().unwrap();
    let link_as = |name: &str| -> PathBuf { folder.path().join(name) };
    std::os::unix::fs::symlink(rig.server.path(), link_as("ttyRIG1")).unwrap();
    let named = StageLink {
        port: link_as("ttyRIG0").to_str().unwrap().parse().unwrap(),
        ..rig.link(no_serials(settings()))
    };
    let camera = crate::stage::no_camera();
    let mut owner = ScanRig::new(named, camera);
    let mut notices = owner.access().notices().subscribe();
    // Nothing is known of the controllers yet.
    let missing = owner.connect().await.err().unwrap();
    assert!(matches!(missing, StageError::Port(_)), "{missing:?}");
    let notices_of_the_first = Default::default();
    let link = rig.link(settings());
    let known = Stage::connect_known(&link, None, &notices_of_the_first).await;
    let known = known.unwrap();
    owner.access().expect(Some(known.identity()));
    known.close();
    known.closed().await;
    let stage = owner.connect().await.unwrap();
    assert!(stage.address().to_string().ends_with("ttyRIG1"));
    let reported = notices.recv().await.unwrap();
    assert_eq!(reported.code, "stage-port-changed");
    assert!(
        reported.message.contains("ttyRIG0") && reported.message.contains("by-id"),
        "{}",
        reported.message
    );
}
