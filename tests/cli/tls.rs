//! Promise: a client asks over TLS, and says in words why it does not come to that; a signal has a server read its
//! certificate again.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::certificates::{Age, Authority, file};
use crate::process::address_of;

/// A server of its own, which ends with the test.
struct Server(Child, String);

impl Server {
    fn start(folder: &Path, options: &str) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_tessera"))
            .args(["serve", "--ephemeral", "--backend", "serial", "--listen", "127.0.0.1:0"])
            .args(options.split_whitespace())
            .current_dir(folder)
            .env("TESSERA_LOG", "error")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let address = address_of(&mut child);
        Self(child, address.rsplit(':').next().unwrap().to_owned())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Lists jobs; the exit code, and what is said.
fn list(folder: &Path, endpoint: &str, options: &str) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    for name in ["TESSERA_CA", "TESSERA_CLIENT_CERT", "TESSERA_CLIENT_KEY", "TESSERA_ENDPOINT"] {
        command.env_remove(name);
    }
    command.args(["jobs", "list", "--retry-s", "0", "--endpoint", endpoint]).args(options.split_whitespace());
    let out = command.current_dir(folder).output().unwrap();
    (out.status.code(), String::from_utf8(out.stderr).unwrap())
}

#[test]
fn what_is_wrong_with_tls_is_said_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (authority, clients, other) = (Authority::new("one"), Authority::new("clients"), Authority::new("other"));
    for (name, shown) in [
        ("server", authority.vouch(&["localhost"], Age::Good)),
        ("expired", authority.vouch(&["localhost"], Age::Expired)),
        ("client", clients.vouch(&["client"], Age::Good)),
        ("stranger", other.vouch(&["client"], Age::Good)),
    ] {
        file(folder, &format!("{name}.pem"), &shown.cert);
        file(folder, &format!("{name}.key"), &shown.key);
    }
    for (name, authority) in [("ca.pem", &authority), ("clients.pem", &clients), ("other.pem", &other)] {
        file(folder, name, &authority.pem());
    }
    let tls = Server::start(folder, "--tls-cert server.pem --tls-key server.key");
    let expired = Server::start(folder, "--tls-cert expired.pem --tls-key expired.key");
    let mutual = Server::start(folder, "--tls-cert server.pem --tls-key server.key --client-ca clients.pem");
    let clear = Server::start(folder, "");
    let here = |server: &Server| format!("https://localhost:{}", server.1);

    assert_eq!(list(folder, &here(&tls), "--ca ca.pem").0, Some(0));
    let client = "--ca ca.pem --client-cert client.pem --client-key client.key";
    let (code, told) = list(folder, &here(&mutual), client);
    assert_eq!(code, Some(0), "{told}");
    for (server, endpoint, options, words) in [
        (&tls, here(&tls), "--ca other.pem", "not by an authority that is trusted here"),
        (&tls, format!("https://127.0.0.1:{}", tls.1), "--ca ca.pem", "for another name"),
        (&tls, format!("http://localhost:{}", tls.1), "", "https://localhost"),
        (&expired, here(&expired), "--ca ca.pem", "has expired"),
        (&clear, here(&clear), "--ca ca.pem", "speaks no TLS"),
        (&mutual, here(&mutual), "--ca ca.pem", "wants a certificate of the client"),
        (
            &mutual,
            here(&mutual),
            "--ca ca.pem --client-cert stranger.pem --client-key stranger.key",
            "does not take this client's certificate",
        ),
    ] {
        // A reset of the connection may overtake the alert that says why: then it is asked again.
        let (mut code, mut told) = list(folder, &endpoint, options);
        for _ in 0..20 {
            if code != Some(69) || told.contains(words) {
                break;
            }
            (code, told) = list(folder, &endpoint, options);
        }
        assert!(code == Some(69) && told.contains(words), "{} {options}: {code:?} {told}", server.1);
    }
    let (code, told) = list(folder, &here(&tls), "--ca server.key");
    assert!(code.is_some_and(|code| code == 65 || code == 69), "{told}");
}

/// As an operator would.
#[cfg(unix)]
#[test]
fn a_signal_has_the_certificate_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let [old, new] = ["old", "new"].map(Authority::new);
    let write = |authority: &Authority| {
        let shown = authority.vouch(&["localhost"], Age::Good);
        file(folder, "server.key", &shown.key);
        file(folder, "server.pem", &shown.cert);
    };
    for (name, authority) in [("old.pem", &old), ("new.pem", &new)] {
        file(folder, name, &authority.pem());
    }
    write(&old);
    let server = Server::start(folder, "--tls-cert server.pem --tls-key server.key");
    let endpoint = format!("https://localhost:{}", server.1);
    assert_eq!(list(folder, &endpoint, "--ca old.pem").0, Some(0));
    write(&new);
    let told = Command::new("kill").args(["-HUP", &server.0.id().to_string()]).status().unwrap();
    assert!(told.success());
    let start = Instant::now();
    while list(folder, &endpoint, "--ca new.pem").0 != Some(0) {
        assert!(start.elapsed() < Duration::from_secs(60), "the new certificate is taken");
    }
    assert_eq!(list(folder, &endpoint, "--ca old.pem").0, Some(69));
}
