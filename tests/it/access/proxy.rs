//! A daemon behind a proxy: whom it believes.

use serde_json::json;

use super::{Ask, Served, Serving, get, order, post};

async fn behind_proxy() -> (Served, super::Tokens) {
    Served::new(Serving {
        behind_proxy: true,
        ..Serving::default()
    })
    .await
}

/// A request as a proxy on this machine forwards it.
fn forwarded(ask: Ask<'_>) -> Ask<'_> {
    ask.with("x-forwarded-for", "192.0.2.4")
        .with("x-forwarded-proto", "https")
        .with("host", "lab-pc")
}

#[tokio::test(flavor = "multi_thread")]
async fn the_address_of_a_proxy_is_refused_to_others() {
    let (served, tokens) = behind_proxy().await;
    for ask in [
        get("/api/v1/rig"),
        get("/"),
        get("/api/v1/rig").by(&tokens.admin),
        get("/api/v1/rig")
            .by(&tokens.admin)
            .with("x-forwarded-proto", "https"),
    ] {
        served.ask(ask).await.is(403, "not-by-proxy");
    }
    forwarded_is_answered(&served, &tokens).await;
    // Commands on this machine have their own address.
    let local = get("/api/v1/rig");
    let mut stream = tokio::net::TcpStream::connect(served.local).await.unwrap();
    local.on(&mut stream, served.local).await.is_ok();
    served.end().await;
}

async fn forwarded_is_answered(served: &Served, tokens: &super::Tokens) {
    let rig = forwarded(get("/api/v1/rig"));
    served.ask(rig.clone()).await.is(401, "no-token");
    served.ask(rig.by(&tokens.viewer)).await.is_ok();
}

#[tokio::test(flavor = "multi_thread")]
async fn beyond_this_machine_every_route_needs_a_token_the_stop_too() {
    let (served, tokens) = behind_proxy().await;
    let stop = || forwarded(order("/api/v1/rig/stop"));
    served.ask(stop()).await.is(401, "no-token");
    served
        .ask(stop().by("ridged_wrong"))
        .await
        .is(401, "wrong-token");
    served.ask(stop().by(&tokens.viewer)).await.is_ok();
    for path in [
        "/metrics",
        "/readyz",
        "/openapi.json",
        "/api/v1/events",
        "/api/v1/frames/1/image.png",
    ] {
        served.ask(forwarded(get(path))).await.is(401, "no-token");
    }
    let alive = served.ask(forwarded(get("/healthz"))).await;
    assert_eq!((alive.status, alive.text.as_str()), (200, "ok\n"));
    // The secret of the daemon's user is of this machine.
    let folder = served.bench.lab.store().folder();
    let secret = std::fs::read_to_string(folder.join(ridged::daemon::SECRET_FILE)).unwrap();
    let by_owner = forwarded(get("/api/v1/rig")).by(secret.trim());
    served.ask(by_owner).await.is(401, "wrong-token");
    let login = post("/api/v1/session", &json!({ "token": tokens.viewer }));
    let session = served.ask(forwarded(login)).await;
    let cookie = session.header("set-cookie")[0];
    assert!(
        cookie.starts_with("__Host-") && cookie.contains("Secure"),
        "{cookie}"
    );
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn forged_headers_of_a_proxy_are_ignored() {
    // Without a proxy, the headers change nothing.
    let (served, tokens) = Served::with_tokens().await;
    let forged = |ask: Ask<'static>| {
        ask.with("x-forwarded-for", "127.0.0.1")
            .with("x-forwarded-proto", "https")
            .with("x-forwarded-host", "lab-pc")
            .with("forwarded", "for=127.0.0.1")
    };
    served
        .ask(forged(get("/api/v1/rig")))
        .await
        .is(401, "no-token");
    let login = post("/api/v1/session", &json!({ "token": tokens.viewer }));
    let session = served.ask(forged(login)).await;
    assert!(!session.header("set-cookie")[0].contains("Secure"));
    served.end().await;
    // Behind one, a client's own entries come before that of the proxy.
    let (served, _) = behind_proxy().await;
    for ask in [
        get("/api/v1/rig").with("x-forwarded-for", "127.0.0.1, 192.0.2.4"),
        get("/api/v1/rig").with("x-forwarded-for", "127.0.0.1"),
    ] {
        let ask = ask
            .with("x-forwarded-proto", "https")
            .with("host", "lab-pc");
        served.ask(ask).await.is(401, "no-token");
    }
    let other = forwarded(get("/api/v1/rig")).with("x-forwarded-host", "evil.example");
    served.ask(other).await.is(403, "forbidden-host");
    served.end().await;
}
