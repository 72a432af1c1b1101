//! Moves of both axes in one order, and waiting for a motion by its number.

use serde_json::json;

use super::{get, is_problem, opened_in, post};

#[tokio::test(flavor = "multi_thread")]
async fn both_axes_move_in_one_order_that_a_caller_waits_for() {
    let folder = tempfile::tempdir().unwrap();
    let (_rig, lab, router) = opened_in(folder.path(), 50.0).await;
    let order =
        async |body: serde_json::Value| post(&router, "/api/v1/rig/move", &body.to_string()).await;
    let ended = async |id: &serde_json::Value| {
        let path = format!("/api/v1/rig/moves/{id}?wait_s=60");
        get(&router, &path).await.body
    };

    let both = json!({ "theta_c_deg": 20.0, "phi_s_deg": 90.0 });
    is_problem(&order(both.clone()).await, 409, "stage-not-referenced");
    is_problem(&order(json!({})).await, 422, "invalid-value");
    let homing = post(&router, "/api/v1/rig/home", "").await;
    assert_eq!(homing.status, 202, "{}", homing.body);
    assert_eq!(ended(&homing.body["id"]).await["state"], "arrived");

    // The rig is free as soon as the caller knows that it has arrived.
    for (theta_c_deg, phi_s_deg) in [(20.0, 90.0), (0.0, 45.0), (-30.0, 0.0)] {
        let moving = order(json!({ "theta_c_deg": theta_c_deg, "phi_s_deg": phi_s_deg })).await;
        assert_eq!(moving.status, 202, "{}", moving.body);
        let motion = ended(&moving.body["id"]).await;
        assert_eq!(motion["state"], "arrived", "{motion}");
        assert!((motion["theta_c_deg"].as_f64().unwrap() - theta_c_deg).abs() < 0.01);
        assert!((motion["phi_s_deg"].as_f64().unwrap() - phi_s_deg).abs() < 0.01);
    }
    let one = order(json!({ "phi_s_deg": 90.0 })).await;
    let motion = ended(&one.body["id"]).await;
    assert!(
        (motion["theta_c_deg"].as_f64().unwrap() + 30.0).abs() < 0.01,
        "{motion}"
    );
    assert!((motion["phi_s_deg"].as_f64().unwrap() - 90.0).abs() < 0.01);

    // A refused order is no motion. A stop ends one.
    let outside = order(json!({ "theta_c_deg": 500.0, "phi_s_deg": 0.0 })).await;
    is_problem(&outside, 422, "outside-limits");
    let error = &outside.body["errors"][0];
    assert_eq!(error["field"], "theta_c_deg");
    assert_eq!(
        error["out_of_range"],
        json!({ "value": 500.0, "lower": -60.0, "upper": 60.0 })
    );
    let long = order(json!({ "theta_c_deg": 30.0, "phi_s_deg": 360.0 })).await;
    let path = format!("/api/v1/rig/moves/{}", long.body["id"]);
    assert_eq!(get(&router, &path).await.body["state"], "moving");
    lab.stop().await.unwrap();
    let motion = ended(&long.body["id"]).await;
    assert_eq!(
        (&motion["state"], &motion["problem"]["code"]),
        (&json!("stopped"), &json!("stopped"))
    );
    is_problem(&get(&router, "/api/v1/rig/moves/1").await, 404, "not-found");
    let path = format!("{path}?wait_s=61");
    is_problem(&get(&router, &path).await, 422, "invalid-value");
    lab.shut_down().await;
}
