//! One owner of the rig at a time.

use ridged::scan::{Event, RecordedEvent};
use serde_json::{Value, json};

use super::{AT, Answer, Ask, Served, Serving, get, order, post};

const LEASE: &str = "/api/v1/lease";
const HOME: &str = "/api/v1/rig/axes/theta_c/home";
const UNPARK: &str = "/api/v1/rig/axes/theta_c/unpark";
const STOP: &str = "/api/v1/rig/stop";

async fn taken(served: &Served, ask: Ask<'_>) -> String {
    let taken = served.ask(ask).await;
    assert_eq!(taken.status, 201, "{taken:?}");
    taken.json()["id"].as_str().unwrap().to_owned()
}

fn take<'a>(name: &str, take_over: bool) -> Ask<'a> {
    let body = json!({ "name": name, "seconds": 900, "take_over": take_over });
    post(LEASE, &body)
}

fn delete(path: &str) -> Ask<'_> {
    Ask {
        method: "DELETE",
        ..get(path)
    }
}

/// Asserts that an answer says who holds the rig and until when.
#[track_caller]
fn names_holder(answer: &Answer, who: &str, name: &str) {
    answer.is(409, "lease-held");
    let holder = &answer.json()["holder"];
    assert_eq!(
        (&holder["who"], &holder["name"]),
        (&json!(who), &json!(name))
    );
    let detail = answer.json()["detail"].as_str().unwrap().to_owned();
    let until = holder["until"]
        .as_str()
        .unwrap_or("until its end")
        .to_owned();
    for part in [who, name, &until, "take", "Stop is always allowed"] {
        assert!(detail.contains(part), "{part} is not in: {detail}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn while_a_lease_lasts_only_its_holder_gives_orders() {
    let (served, _) = Served::new(Serving::default()).await;
    served.ask(order(UNPARK)).await.is_ok();
    let free = served.ask(get(LEASE)).await.json();
    assert_eq!(free, json!({ "holder": null, "own": false }));
    let lease = taken(&served, take("night run", false)).await;
    for ask in [
        order(HOME),
        order(UNPARK).with("ridged-lease", "ridged_none"),
        post("/api/v1/scans", &json!({})),
        post("/api/v1/calibrations", &json!({})),
        order("/api/v1/scans/1/abort"),
        take("another", false),
    ] {
        names_holder(&served.ask(ask).await, "local", "night run");
    }
    let own = |path| order(path).with("ridged-lease", &lease);
    served.ask(own(UNPARK)).await.is_ok();
    // Reading, computing and the stop need none.
    served.ask(get("/api/v1/rig")).await.is_ok();
    served
        .ask(post("/api/v1/samples", &json!({ "name": "a" })))
        .await
        .is_ok();
    // Nor does the confirmation of a step at the rig; there is no scan 1.
    let confirmed = served.ask(order("/api/v1/scans/1/continue")).await;
    confirmed.is(404, "not-found");
    served.ask(order(STOP)).await.is_ok();
    served
        .ask(order(STOP).with("ridged-lease", "ridged_none"))
        .await
        .is_ok();
    let shown = served
        .ask(get(LEASE).with("ridged-lease", &lease))
        .await
        .json();
    assert_eq!(shown["own"], true);
    assert!(!shown.to_string().contains(&lease), "{shown}");
    served.ask(delete(LEASE)).await.is(409, "lease-held");
    let returned = served.ask(delete(LEASE).with("ridged-lease", &lease)).await;
    returned.is_ok();
    served.ask(order(UNPARK)).await.is_ok();
    served.ask(own(UNPARK)).await.is(409, "lease-lost");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lease_is_taken_over_by_saying_so_and_events_have_both() {
    let (served, tokens) = Served::with_tokens().await;
    let first = taken(&served, take("annas", false).by(&tokens.operator)).await;
    let refused = served.ask(take("berts", false).by(&tokens.admin)).await;
    names_holder(&refused, "the-operator", "annas");
    let over = served.ask(take("berts", true).by(&tokens.admin)).await;
    assert_eq!(over.json()["taken_from"]["name"], "annas", "{over:?}");
    let lost = order(UNPARK)
        .with("ridged-lease", &first)
        .by(&tokens.operator);
    names_holder(&served.ask(lost).await, "the-admin", "berts");
    let orders_of = |events: &[RecordedEvent]| -> Vec<(String, String)> {
        let order = |event: &RecordedEvent| match &event.event {
            Event::Order { order, .. } => Some((event.who.clone().unwrap(), order.clone())),
            _ => None,
        };
        events.iter().filter_map(order).collect()
    };
    let events = served.events(|events| orders_of(events).len() == 2).await;
    let orders = orders_of(&events);
    assert_eq!(orders[0].0, "the-operator");
    assert_eq!(orders[1].0, "the-admin");
    assert!(orders[1].1.contains("from the-operator"), "{orders:?}");
    assert!(!format!("{events:?}").contains(&first));
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stolen_lease_is_of_no_use() {
    let (served, tokens) = Served::with_tokens().await;
    let lease = taken(&served, take("annas", false).by(&tokens.operator)).await;
    let stolen = |ask: Ask<'static>| ask.with("ridged-lease", &lease).by(&tokens.admin);
    let refused = served.ask(stolen(order(UNPARK))).await;
    names_holder(&refused, "the-operator", "annas");
    served
        .ask(stolen(take("mine", false)))
        .await
        .is(409, "lease-held");
    served
        .ask(stolen(delete(LEASE)))
        .await
        .is(409, "lease-held");
    let own = order(UNPARK)
        .with("ridged-lease", &lease)
        .by(&tokens.operator);
    served.ask(own).await.is_ok();
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_preview_is_an_order_to_the_rig() {
    let (served, tokens) = Served::with_tokens().await;
    let preview = || post("/api/v1/rig/preview", &json!({ "suggest": 0 }));
    for token in [&tokens.viewer, &tokens.analyst] {
        served
            .ask(preview().by(token))
            .await
            .is(403, "role-too-low");
    }
    let taken_by = served.ask(preview().by(&tokens.operator)).await;
    taken_by.is_ok();
    // A viewer may look at what an operator has taken.
    let image = taken_by.json()["frames"][0]["image"]["path"].clone();
    let shown = get(image.as_str().unwrap()).by(&tokens.viewer);
    served.ask(shown).await.is_ok();
    let lease = taken(&served, take("annas", false).by(&tokens.admin)).await;
    let refused = served.ask(preview().by(&tokens.operator)).await;
    names_holder(&refused, "the-admin", "annas");
    let own = preview().with("ridged-lease", &lease).by(&tokens.admin);
    served.ask(own).await.is_ok();
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn any_token_stops_past_a_lease() {
    let (served, tokens) = Served::with_tokens().await;
    taken(&served, take("annas", false).by(&tokens.operator)).await;
    for token in [&tokens.viewer, &tokens.analyst, &tokens.admin] {
        served.ask(order(STOP).by(token)).await.is_ok();
    }
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_lease_a_scan_is_its_callers_until_its_end() {
    let (served, tokens) = Served::with_tokens().await;
    let plan = json!({ "preset": "full" });
    let scan = json!({ "sample_id": 2, "plan": plan });
    let begun = served
        .ask(post("/api/v1/scans", &scan).by(&tokens.operator))
        .await;
    begun.is_ok();
    let id = begun.json()["id"].as_i64().unwrap();
    let path = |word: &str| format!("/api/v1/scans/{id}/{word}");
    let by_another = served.ask(order(&path("abort")).by(&tokens.admin)).await;
    if by_another.status == 409 && by_another.code() == "lease-held" {
        names_holder(&by_another, "the-operator", &format!("scan {id}"));
        let shown: Value = served.ask(get(LEASE).by(&tokens.viewer)).await.json();
        assert_eq!(shown["holder"]["name"], format!("scan {id}"));
        let refused = served.ask(take("mine", false).by(&tokens.admin)).await;
        refused.is(409, "lease-held");
        let lease = taken(&served, take("mine", true).by(&tokens.admin)).await;
        let own = served.ask(order(&path("pause")).by(&tokens.operator)).await;
        names_holder(&own, "the-admin", "mine");
        let over = order(&path("abort")).with("ridged-lease", &lease);
        served.ask(over.by(&tokens.admin)).await.is_ok();
    } else {
        panic!("the scan did not hold the rig: {by_another:?}");
    }
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_terms_of_a_lease_are_checked() {
    let (served, _) = Served::new(Serving::default()).await;
    for body in [
        json!({ "name": "" }),
        json!({ "name": "x".repeat(101) }),
        json!({ "name": "a\nb" }),
        json!({ "name": "a", "seconds": 1 }),
        json!({ "name": "a", "seconds": 1_000_000 }),
    ] {
        served
            .ask(post(LEASE, &body))
            .await
            .is(422, "invalid-value");
    }
    served.ask(delete(LEASE)).await.is(409, "lease-lost");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lease_ends_with_the_token_of_its_holder() {
    let (served, tokens) = Served::with_tokens().await;
    taken(&served, take("night", false).by(&tokens.operator)).await;
    let other = order(UNPARK).by(&tokens.admin);
    names_holder(&served.ask(other.clone()).await, "the-operator", "night");
    served.tokens.revoke("the-operator", AT).unwrap();
    served.ask(other).await.is_ok();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_of_a_revoked_token_is_no_reason_to_refuse_others() {
    let (served, tokens) = Served::with_tokens().await;
    let scan = json!({ "sample_id": 2, "plan": { "preset": "full" } });
    let begun = served
        .ask(post("/api/v1/scans", &scan).by(&tokens.operator))
        .await;
    let abort = format!("/api/v1/scans/{}/abort", begun.json()["id"]);
    let abort = order(&abort).by(&tokens.admin);
    served.ask(abort.clone()).await.is(409, "lease-held");
    served.tokens.revoke("the-operator", AT).unwrap();
    served.ask(abort).await.is_ok();
    served.end().await;
}
