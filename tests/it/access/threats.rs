//! Callers without a token, with a token of too low a role, and with what other pages can send.

use std::os::unix::fs::PermissionsExt;

use ridged::access::TOKENS_FILE;
use ridged::daemon::SECRET_FILE;
use ridged::scan::event::RigActivity;
use ridged::scan::{Event, RecordedEvent};
use serde_json::{Value, json};

use super::{AT, Served, Serving, Tokens, answer, get, order, post};

const STOP: &str = "/api/v1/rig/stop";

/// All routes of the document: method, and path with numbers and words for its parameters.
fn routes() -> Vec<(String, String)> {
    let document: Value = serde_json::from_str(ridged::api::openapi()).unwrap();
    let mut routes = vec![("get".to_owned(), "/openapi.json".to_owned())];
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, _) in item.as_object().unwrap() {
            let path = path
                .replace("{id}", "1")
                .replace("{axis}", "theta_c")
                .replace("{order}", "pause")
                .replace("{name}", "theta_r_deg.png");
            routes.push((method.clone(), path));
        }
    }
    assert!(routes.len() > 40);
    routes
}

/// The least role that the document states for a route.
fn stated_role(method: &str, path: &str) -> Option<&'static str> {
    let document: Value = serde_json::from_str(ridged::api::openapi()).unwrap();
    let words = document["paths"][path][method]["description"]
        .as_str()
        .unwrap_or_default()
        .to_owned();
    ["viewer", "analyst", "operator", "admin"]
        .into_iter()
        .find(|role| words.contains(&format!("the role {role}")))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_names_another_host_is_refused() {
    let (served, _) = Served::new(Serving::default()).await;
    for host in ["evil.example", "127.0.0.1.evil.example:80", "lab-pc"] {
        let rebound = served.ask(get("/api/v1/rig").with("host", host)).await;
        rebound.is(403, "forbidden-host");
    }
    served.ask(get("/api/v1/rig")).await.is_ok();
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_of_another_site_writes_nothing() {
    let (served, tokens) = Served::with_tokens().await;
    let login = post("/api/v1/session", &json!({ "token": tokens.admin }));
    let session = served.ask(login).await;
    let cookie = session.header("set-cookie")[0].split(';').next().unwrap();
    let own = format!("http://{}", served.address);
    let sample = || {
        let sample = json!({ "name": "by another page" });
        post("/api/v1/samples", &sample).with("cookie", cookie)
    };
    for (name, value) in [
        ("origin", "https://evil.example"),
        ("sec-fetch-site", "cross-site"),
        ("sec-fetch-site", "same-site"),
        // A form sends neither.
        ("x-other", "1"),
    ] {
        let forged = served.ask(sample().with(name, value)).await;
        forged.is(403, "forbidden-origin");
    }
    let lists = served
        .ask(get("/api/v1/samples").with("cookie", cookie))
        .await;
    assert!(!lists.text.contains("by another page"), "{}", lists.text);
    for (name, value) in [
        ("origin", own.as_str()),
        ("sec-fetch-site", "same-origin"),
        ("ridged-request", "1"),
    ] {
        served.ask(sample().with(name, value)).await.is_ok();
    }
    // Without a cookie, a page on this machine is refused by its origin, and shows nothing of the daemon; a link may.
    let local = Served::new(Serving::default()).await.0;
    let read = |mode: &str, dest: &str| {
        get("/api/v1/rig")
            .with("sec-fetch-site", "cross-site")
            .with("sec-fetch-mode", mode)
            .with("sec-fetch-dest", dest)
    };
    for (mode, dest) in [
        ("no-cors", "image"),
        ("cors", "empty"),
        ("navigate", "iframe"),
    ] {
        local
            .ask(read(mode, dest))
            .await
            .is(403, "forbidden-origin");
    }
    local.ask(read("navigate", "document")).await.is_ok();
    let stop = order(STOP).with("origin", "https://evil.example");
    local.ask(stop).await.is(403, "forbidden-origin");
    local.end().await;
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_cookie_is_http_only_and_of_this_page_only() {
    let (served, tokens) = Served::with_tokens().await;
    let login = post("/api/v1/session", &json!({ "token": tokens.viewer }));
    let session = served.ask(login).await;
    session.is_ok();
    let cookie = session.header("set-cookie")[0].to_owned();
    for part in ["HttpOnly", "SameSite=Strict", "Path=/"] {
        assert!(cookie.contains(part), "{cookie}");
    }
    assert!(!cookie.contains(&tokens.viewer), "the cookie is the token");
    assert_eq!(session.header("x-frame-options"), ["DENY"]);
    let cookie = cookie.split(';').next().unwrap().to_owned();
    let who = served
        .ask(get("/api/v1/session").with("cookie", &cookie))
        .await;
    assert_eq!(
        who.json(),
        json!({ "who": "the-viewer", "role": "viewer", "logged_in": true })
    );
    let logout = super::Ask {
        method: "DELETE",
        ..get("/api/v1/session")
    };
    let logout = logout
        .with("cookie", &cookie)
        .with("sec-fetch-site", "same-origin");
    let out = served.ask(logout).await;
    assert!(out.header("set-cookie")[0].contains("Max-Age=0"), "{out:?}");
    let after = served
        .ask(get("/api/v1/session").with("cookie", &cookie))
        .await;
    after.is(401, "no-token");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_in_a_url_is_worth_nothing() {
    let (served, tokens) = Served::with_tokens().await;
    for path in [
        format!("/api/v1/rig?token={}", tokens.admin),
        format!("/api/v1/rig?access_token={}", tokens.admin),
    ] {
        served.ask(get(&path)).await.is(401, "no-token");
    }
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_peer_that_guesses_is_slowed_down_and_valid_tokens_pass() {
    let (served, tokens) = Served::with_tokens().await;
    let guess = |n: u32| get("/api/v1/rig").by(&format!("ridged_{n}"));
    for n in 0..10 {
        served.ask(guess(n)).await.is(401, "wrong-token");
    }
    let refused = served.ask(guess(11)).await;
    refused.is(429, "too-many-guesses");
    assert_eq!(refused.header("retry-after").len(), 1);
    let login = post("/api/v1/session", &json!({ "token": "ridged_guess" }));
    served.ask(login).await.is(429, "too-many-guesses");
    served
        .ask(get("/api/v1/rig").by(&tokens.viewer))
        .await
        .is_ok();
    served.ask(order(STOP).by("ridged_guess")).await.is_ok();
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_body_is_read_before_authentication() {
    let (served, tokens) = Served::with_tokens().await;
    let unfinished = async |path: &str, token: Option<&str>| {
        let mut ask = post(path, &json!({}));
        if let Some(token) = token {
            ask = ask.by(token);
        }
        let mut stream = served.connect().await;
        let head = ask.head(served.address, 8 << 20);
        tokio::io::AsyncWriteExt::write_all(&mut stream, head.as_bytes())
            .await
            .unwrap();
        // The answer comes although the body does not.
        answer(&mut stream).await
    };
    for path in ["/api/v1/scans", "/api/v1/traces", "/api/v1/nothing", "/"] {
        unfinished(path, None).await.is(401, "no-token");
    }
    let viewer = Some(tokens.viewer.as_str());
    unfinished("/api/v1/scans", viewer)
        .await
        .is(403, "role-too-low");
    // A login is the only body without a token, and a short one.
    unfinished("/api/v1/session", None)
        .await
        .is(413, "body-too-large");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_token_no_byte_of_data_leaves() {
    let (served, _) = Served::with_tokens().await;
    for (method, path) in routes() {
        let ask = super::Ask {
            method: &method.to_uppercase(),
            ..get(&path)
        };
        let reply = served.ask(ask).await;
        match path.as_str() {
            "/healthz" => assert_eq!(reply.text, "ok\n"),
            "/api/v1/session" if method != "get" => assert_ne!(reply.status, 401, "{method}"),
            // On this machine.
            STOP => reply.is_ok(),
            _ => reply.is(401, "no-token"),
        }
        assert!(!reply.text.contains("polymer") && !reply.text.contains("theta_c_deg"));
    }
    served
        .ask(get("/api/v1/unknown"))
        .await
        .is(404, "not-found");
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_role_may_do_what_the_table_says_and_no_more() {
    let (served, tokens) = Served::with_tokens().await;
    let Tokens {
        viewer,
        analyst,
        operator,
        admin,
    } = &tokens;
    let all = [
        ("viewer", viewer),
        ("analyst", analyst),
        ("operator", operator),
        ("admin", admin),
    ];
    let document: Value = serde_json::from_str(ridged::api::openapi()).unwrap();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, _) in item.as_object().unwrap() {
            let Some(needed) = stated_role(method, path) else {
                continue;
            };
            let rank = |role: &str| all.iter().position(|(name, _)| *name == role);
            for (role, token) in all {
                if path == "/api/v1/events" {
                    continue;
                }
                let concrete = path
                    .replace("{id}", "7000")
                    .replace("{axis}", "none")
                    .replace("{order}", "pause")
                    .replace("{name}", "none");
                let ask = super::Ask {
                    method: &method.to_uppercase(),
                    ..get(&concrete)
                };
                let reply = served.ask(ask.by(token)).await;
                let is_refused = reply.code() == "role-too-low";
                assert_eq!(
                    is_refused,
                    rank(role) < rank(needed),
                    "{role} {method} {path}: {reply:?}"
                );
                assert_ne!(reply.status, 401);
            }
        }
    }
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_reads_and_stops_and_nothing_else() {
    let (served, tokens) = Served::with_tokens().await;
    let token = &tokens.viewer;
    let scan = json!({ "sample_id": 1, "plan": { "preset": "paper" } });
    for write in [
        post("/api/v1/scans", &scan),
        post("/api/v1/samples", &json!({ "name": "x" })),
        post(
            "/api/v1/rig/axes/phi_s/move",
            &json!({ "position_deg": 10 }),
        ),
        post("/api/v1/lease", &json!({ "name": "x" })),
        order("/api/v1/rig/axes/theta_c/home"),
    ] {
        served.ask(write.by(token)).await.is(403, "role-too-low");
    }
    assert!(!served.bench.rig.world.is_moving());
    for read in [
        "/api/v1/rig",
        "/api/v1/samples",
        "/metrics",
        "/readyz",
        "/openapi.json",
    ] {
        served.ask(get(read).by(token)).await.is_ok();
    }
    served.ask(order(STOP).by(token)).await.is_ok();
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn on_this_machine_the_stop_needs_no_token_whatever_the_settings() {
    for serving in [
        Serving::default(),
        Serving {
            token_on_loopback: true,
            ..Serving::default()
        },
        Serving {
            behind_proxy: true,
            token_on_loopback: true,
            ..Serving::default()
        },
    ] {
        let (served, _) = Served::new(serving).await;
        for ask in [
            order(STOP),
            order(STOP).by("ridged_wrong"),
            order(STOP).with("authorization", "Basic eDp5"),
            order(STOP).with("ridged-lease", "ridged_none"),
        ] {
            served.ask(ask).await.is_ok();
        }
        served.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_token_and_its_sessions_end_at_once() {
    let (served, tokens) = Served::with_tokens().await;
    let login = post("/api/v1/session", &json!({ "token": tokens.operator }));
    let session = served.ask(login).await;
    let cookie = session.header("set-cookie")[0].split(';').next().unwrap();
    let by_cookie = || get("/api/v1/rig").with("cookie", cookie);
    served.ask(by_cookie()).await.is_ok();
    // An event stream that is open ends, too.
    let mut stream = served.connect().await;
    let events = get("/api/v1/events").with("cookie", cookie);
    let text = events.head(served.address, 0);
    tokio::io::AsyncWriteExt::write_all(&mut stream, text.as_bytes())
        .await
        .unwrap();
    assert_eq!(super::head(&mut stream).await.status, 200);
    served.tokens.revoke("the-operator", AT).unwrap();
    served.ask(by_cookie()).await.is(401, "no-token");
    let by_token = get("/api/v1/rig").by(&tokens.operator);
    served.ask(by_token).await.is(401, "wrong-token");
    answer(&mut stream).await;
    served.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn files_with_secrets_are_readable_by_their_owner_only() {
    let (served, tokens) = Served::with_tokens().await;
    let folder = served.bench.lab.store().folder().to_owned();
    for file in [TOKENS_FILE, SECRET_FILE] {
        let mode = std::fs::metadata(folder.join(file)).unwrap().permissions();
        assert_eq!(mode.mode() & 0o777, 0o600, "{file}");
    }
    // The daemon's own user needs no token, and the secret ends with the daemon.
    let secret = std::fs::read_to_string(folder.join(SECRET_FILE)).unwrap();
    let who = served.ask(get("/api/v1/session").by(secret.trim())).await;
    assert_eq!(who.json()["who"], "local", "{who:?}");
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read(&path).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        assert!(!text.contains(&tokens.admin), "{}", path.display());
    }
    served.daemon.end().await.unwrap();
    assert!(!folder.join(SECRET_FILE).exists());
    served.bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn scans_jobs_orders_and_events_name_their_caller() {
    let (served, tokens) = Served::with_tokens().await;
    let plan = json!({ "theta_c_deg": [0], "phi_s_deg": [0], "exposures_s": [0.02], "dark": {"repeats": 1} });
    let scan = json!({ "sample_id": 2, "plan": plan });
    let begun = served
        .ask(post("/api/v1/scans", &scan).by(&tokens.operator))
        .await;
    begun.is_ok();
    let id = begun.json()["id"].as_i64().unwrap();
    served.bench.finish(id).await;
    let fit = json!({ "scan_id": id });
    let fit = served
        .ask(post("/api/v1/fits", &fit).by(&tokens.analyst))
        .await;
    fit.is_ok();
    served.ask(order(STOP).by(&tokens.viewer)).await.is_ok();
    let read = async |path: &str| served.ask(get(path).by(&tokens.viewer)).await.json();
    assert_eq!(
        read(&format!("/api/v1/scans/{id}")).await["who"],
        "the-operator"
    );
    assert_eq!(read("/api/v1/fits/1").await["who"], "the-analyst");
    let is_stop = |event: &RecordedEvent| matches!(&event.event, Event::Rig { activity, .. } if *activity == RigActivity::Stopped);
    let events = served.events(|events| events.iter().any(is_stop)).await;
    let who_of = |kind: &str| -> Vec<&str> {
        let of_kind = events.iter().filter(|event| event.event.kind() == kind);
        of_kind.map(|event| event.who.as_deref().unwrap()).collect()
    };
    for (kind, who) in [
        ("scan", "the-operator"),
        ("frame", "the-operator"),
        ("fit", "the-analyst"),
    ] {
        let found = who_of(kind);
        assert!(
            !found.is_empty() && found.iter().all(|name| *name == who),
            "{kind}: {found:?}"
        );
    }
    let stop = events.iter().find(|event| is_stop(event)).unwrap();
    assert_eq!(stop.who.as_deref(), Some("the-viewer"));
    let of_rig = who_of("rig");
    assert!(!of_rig.contains(&"daemon"), "{of_rig:?}");
    served.end().await;
}
