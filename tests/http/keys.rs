//! Promise: keys over HTTP are those of the service, a call whose key ends has a whole answer, and pages of other sites use no
//! server without keys.

use std::sync::Arc;
use std::time::Duration;

use serde_json::json;
use server::keys::{KeyLimits, Role};

use crate::client::{House, ask, get, post};
use crate::torus;

#[tokio::test(flavor = "multi_thread")]
async fn keys_are_those_of_the_service() {
    let (house, keys) = House::with_keys().await;
    let few = KeyLimits { rate: Some(1), ..KeyLimits::default() };
    let secret = |name: &str, role, limits| format!("Authorization: Bearer {}", keys.add(name, role, limits).reveal());
    let submit = secret("ci", Role::Submit, KeyLimits::default());
    let read = secret("eye", Role::Read, KeyLimits::default());
    let slow = secret("slow", Role::Read, few);
    house.reload().await;
    for path in ["/v1/jobs", "/v1/nothing", "/v1/openapi.json"] {
        for given in [&[][..], &["Authorization: Bearer tsr_0000000000_00"], &[&submit, &read]] {
            let answer = get(&house, path, given).await;
            assert_eq!((answer.status, answer.header("www-authenticate")), (401, Some("Bearer")), "{path}");
            assert_eq!(answer.json()["reason"], "unauthenticated");
        }
    }
    assert_eq!(get(&house, "/v1/jobs", &[&submit]).await.status, 200);
    let forbidden = post(&house, "/v1/blobs", &[&read], b"bytes").await;
    assert_eq!((forbidden.status, forbidden.json()["reason"].as_str()), (403, Some("permission_denied")));
    // What one tenant has is not there for another.
    let stored = post(&house, "/v1/blobs", &[&submit], b"bytes").await;
    let path = stored.header("location").unwrap();
    assert_eq!(get(&house, path, &[&submit]).await.status, 200);
    assert_eq!(get(&house, path, &[&read]).await.status, 404);
    let mut refused = None;
    for _ in 0..20 {
        let answer = get(&house, "/v1/jobs", &[&slow]).await;
        if answer.status == 429 {
            refused = Some(answer);
            break;
        }
    }
    let refused = refused.expect("a call a second");
    assert_eq!(refused.header("retry-after"), Some("1"));
    assert_eq!(refused.json()["reason"], "rate");
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_call_whose_key_is_revoked_gets_a_whole_answer() {
    let (house, keys) = House::with_keys().await;
    let (house, keys) = (Arc::new(house), Arc::new(keys));
    let header =
        |name| format!("Authorization: Bearer {}", keys.add(name, Role::Submit, KeyLimits::default()).reveal());
    let (caller, eye) = (header("caller"), header("eye"));
    house.reload().await;
    let waiting = {
        let (house, caller) = (Arc::clone(&house), caller.clone());
        tokio::spawn(async move { post(&house, "/v1/remesh?points=20000&lloyd=2000", &[&caller], &torus(200)).await })
    };
    for _ in 0..500 {
        let jobs = get(&house, "/v1/jobs?states=running", &[&caller]).await.json();
        if !jobs["jobs"].as_array().unwrap().is_empty() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    keys.revoke("caller");
    let answer = waiting.await.unwrap();
    assert_eq!((answer.status, answer.json()["reason"].as_str()), (401, Some("unauthenticated")));
    assert_eq!(get(&house, "/v1/jobs", &[&eye]).await.status, 200);
    Arc::into_inner(house).unwrap().stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_sites_use_no_server_without_keys() {
    let house = House::with_host("proxy.example", "https://app.example").await;
    let page = [format!("Host: {}", house.http), format!("Origin: http://{}", house.http)];
    for headers in [
        &[][..],
        &page.each_ref().map(String::as_str),
        &["Origin: https://app.example"],
        &["Host: proxy.example", "Origin: https://proxy.example"],
    ] {
        assert_eq!(get(&house, "/v1/jobs", headers).await.status, 200, "{headers:?}");
    }
    for (headers, word) in [
        // A page of another site, and one whose name resolves to this machine.
        (&["Origin: https://evil.example"][..], "another site"),
        (&["Origin: null"], "another site"),
        (&["Origin: http://localhost:5173"], "another site"),
        (&["Sec-Fetch-Site: cross-site", "Sec-Fetch-Mode: no-cors"], "another site"),
        (&["Host: evil.example:8080", "Origin: http://evil.example:8080"], "localhost"),
        (&["Host: 192.0.2.1"], "localhost"),
    ] {
        for (method, path) in [("GET", "/v1/jobs"), ("POST", "/v1/blobs"), ("DELETE", "/v1/jobs/x"), ("GET", "/none")] {
            let answer = ask(&house, method, path, headers, b"").await;
            let told = answer.json();
            assert_eq!((answer.status, &told["reason"]), (403, &json!("permission_denied")), "{method} {headers:?}");
            let detail = told["detail"].as_str().unwrap();
            assert!(detail.contains(word) && detail.contains("--require-keys"), "{detail}");
            assert_eq!(answer.header("x-content-type-options"), Some("nosniff"));
        }
    }
    let twice = get(&house, "/v1/jobs", &["Host: localhost", "Host: localhost"]).await;
    assert_eq!(twice.status, 400, "{twice:?}");
    let text = ["Origin: https://app.example", "Content-Type: text/plain"];
    assert_eq!(post(&house, "/v1/jobs", &text, b"{}").await.status, 400);
    // The allowed site may read answers, and ask first; another one learns nothing.
    let asked =
        |origin| [origin, "Access-Control-Request-Method: DELETE", "Access-Control-Request-Headers: authorization"];
    let allowed = ask(&house, "OPTIONS", "/v1/jobs/x", &asked("Origin: https://app.example"), b"").await;
    assert_eq!(allowed.header("access-control-allow-origin"), Some("https://app.example"));
    assert!(allowed.header("access-control-allow-methods").is_some_and(|methods| methods.contains("DELETE")));
    let read = get(&house, "/v1/jobs", &["Origin: https://app.example"]).await;
    assert_eq!((read.status, read.header("access-control-allow-origin")), (200, Some("https://app.example")));
    let other = ask(&house, "OPTIONS", "/v1/jobs/x", &asked("Origin: https://evil.example"), b"").await;
    assert_eq!(other.header("access-control-allow-origin"), None);
    house.stop().await;
    // With keys the key decides: no page of another site has it.
    let (house, keys) = House::with_keys().await;
    let secret = keys.add("ci", Role::Submit, KeyLimits::default());
    house.reload().await;
    let key = format!("Authorization: Bearer {}", secret.reveal());
    assert_eq!(get(&house, "/v1/jobs", &[&key, "Host: tessera.example"]).await.status, 200);
    assert_eq!(get(&house, "/v1/jobs", &["Host: tessera.example"]).await.status, 401);
    house.stop().await;
}
