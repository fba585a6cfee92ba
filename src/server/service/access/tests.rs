//! What requests are let in, by their heads alone.

use super::*;
use crate::keys::{KeyLimits, KeySet, NewKey};

struct House {
    access: Access,
    admin: Secret,
    submit: Secret,
    read: Secret,
}

fn house(options: AccessOptions) -> House {
    let mut set = KeySet::default();
    let mut add = |name: &str, role| {
        let limits = KeyLimits { bytes: Some(7), ..KeyLimits::default() };
        set.add(NewKey { name: name.to_owned(), role, lasts: None, limits, is_second: false }).unwrap().1
    };
    let [admin, submit, read] =
        [("root", Role::Admin), ("ci", Role::Submit), ("eye", Role::Read)].map(|(n, r)| add(n, r));
    House { access: Access::new(None, options, Table::default().next(&set)), admin, submit, read }
}

const GET: &str = "/tessera.v1.JobService/GetJob";
const CREATE: &str = "/tessera.v1.JobService/CreateJob";
const CHECK: &str = "/grpc.health.v1.Health/Check";
const REFLECT: &str = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";

fn request(path: &str, headers: &[(&str, &str)]) -> Request<()> {
    let mut request = Request::builder().uri(path);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    request.body(()).unwrap()
}

/// The tenant that is let in, if it is known.
fn enter(access: &Access, path: &str, headers: &[(&str, &str)]) -> Result<Option<String>, Refusal> {
    let mut request = request(path, headers);
    let needs = methods::needs(path);
    let pass = access.enter(&mut request, needs)?;
    assert!(!request.headers().contains_key("authorization"), "it goes no further");
    let caller = request.extensions().get::<Caller>();
    assert_eq!(pass.is_some(), caller.is_some());
    Ok(caller.map(|caller| caller.tenant.clone()))
}

fn bearer(secret: &Secret) -> String {
    format!("Bearer {}", secret.reveal())
}

fn required() -> AccessOptions {
    AccessOptions { require_keys: true, ..AccessOptions::default() }
}

#[test]
fn roles_do_what_the_table_says() {
    let House { access, admin, submit, read } = house(required());
    for (secret, name, get, create) in
        [(&admin, "root", true, true), (&submit, "ci", true, true), (&read, "eye", true, false)]
    {
        let key = bearer(secret);
        let headers = [("authorization", key.as_str())];
        assert_eq!(enter(&access, GET, &headers).is_ok_and(|tenant| tenant.as_deref() == Some(name)), get);
        assert_eq!(enter(&access, REFLECT, &headers).unwrap().as_deref(), Some(name));
        assert_eq!(enter(&access, CREATE, &headers).is_ok(), create);
        assert_eq!(enter(&access, "/tessera.v1.JobService/NoSuch", &headers), Err(Refusal::Unknown));
    }
    let key = bearer(&read);
    assert_eq!(enter(&access, CREATE, &[("authorization", key.as_str())]), Err(Refusal::Role(Role::Submit)));
}

#[test]
fn without_a_good_key_there_is_one_answer() {
    let House { access, submit, .. } = house(required());
    let good = bearer(&submit);
    let wrong = good.replace(submit.reveal().rsplit_once('_').unwrap().1, &"0".repeat(64));
    let unknown = bearer(&Secret::random().unwrap());
    let (basic, bare, twice) =
        (format!("Basic {}", submit.reveal()), submit.reveal().to_owned(), format!("{good}, {good}"));
    let spaced = good.replace(' ', "  ");
    for headers in [
        &[][..],
        &[("authorization", "")],
        &[("authorization", "Bearer")],
        &[("authorization", "Bearer ")],
        &[("authorization", &wrong)],
        &[("authorization", &unknown)],
        &[("authorization", &basic)],
        &[("authorization", &bare)],
        &[("authorization", &twice)],
        &[("authorization", &spaced)],
        &[("authorization", &good), ("authorization", &good)],
        &[("authorization", &wrong), ("authorization", &good)],
        &[("authorization-bin", &good)],
        &[("proxy-authorization", &good)],
        &[("x-forwarded-authorization", &good)],
        &[("cookie", &good)],
        &[("tessera-tenant", "ci")],
        &[("tessera-tenant-bin", "Y2k="), ("x-forwarded-user", "ci")],
    ] {
        for path in [GET, CREATE, REFLECT, "/tessera.v1.JobService/NoSuch", "/"] {
            assert_eq!(enter(&access, path, headers), Err(Refusal::Unauthenticated), "{path} {headers:?}");
        }
    }
    for scheme in ["Bearer", "bearer", "BEARER"] {
        let key = format!("{scheme} {}", submit.reveal());
        assert_eq!(enter(&access, GET, &[("authorization", &key)]).unwrap().as_deref(), Some("ci"));
    }
}

#[test]
fn a_tenant_is_its_key_s() {
    let House { access, admin, submit, .. } = house(required());
    let (root, ci) = (bearer(&admin), bearer(&submit));
    let as_of = |key: &str, names: &[&str]| {
        let mut headers = vec![("authorization", key)];
        headers.extend(names.iter().map(|name| ("tessera-tenant", *name)));
        enter(&access, CREATE, &headers)
    };
    assert_eq!(as_of(&ci, &["ci"]).unwrap().as_deref(), Some("ci"));
    assert_eq!(as_of(&ci, &["eye"]), Err(Refusal::Tenant));
    assert_eq!(as_of(&ci, &["nobody"]), Err(Refusal::Tenant), "the same, whether there is one or not");
    assert_eq!(as_of(&root, &["eye"]).unwrap().as_deref(), Some("eye"));
    for names in [&["ci", "ci"][..], &["ci", "eye"], &[""], &["a b"]] {
        assert_eq!(as_of(&root, names), Err(Refusal::TenantName), "{names:?}");
        assert_eq!(as_of(&ci, names), Err(Refusal::TenantName), "{names:?}");
    }
}

#[test]
fn without_need_of_keys_a_bad_one_is_refused_and_nobody_is_somebody_with_a_key() {
    let House { access, submit, .. } = house(AccessOptions::default());
    let unknown = bearer(&Secret::random().unwrap());
    assert_eq!(enter(&access, CREATE, &[]), Ok(None));
    assert_eq!(enter(&access, CREATE, &[("tessera-tenant", "team")]), Ok(None));
    assert_eq!(enter(&access, CREATE, &[("tessera-tenant", "ci")]), Err(Refusal::Unauthenticated));
    assert_eq!(enter(&access, CREATE, &[("authorization", &unknown)]), Err(Refusal::Unauthenticated));
    assert_eq!(enter(&access, CHECK, &[("authorization", &unknown)]), Err(Refusal::Unauthenticated));
    assert_eq!(enter(&access, CREATE, &[("authorization", &bearer(&submit))]).unwrap().as_deref(), Some("ci"));
    assert_eq!(enter(&access, "/tessera.v1.Other/Method", &[]), Err(Refusal::Unknown));
}

#[test]
fn health_is_open_unless_it_is_said() {
    assert_eq!(enter(&house(required()).access, CHECK, &[]), Ok(None));
    let House { access, read, .. } = house(AccessOptions { health_needs_key: true, ..required() });
    assert_eq!(enter(&access, CHECK, &[]), Err(Refusal::Unauthenticated));
    assert!(enter(&access, CHECK, &[("authorization", &bearer(&read))]).is_ok());
}
