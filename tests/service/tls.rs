//! Promise: TLS lets in who should, and nobody else; stalled handshakes hold up nobody; a new certificate cuts no stream.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::certificates::{self, Age, Authority, Shown};
use crate::raw::{closes, silent};
use crate::server::*;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use server::config::Limits;
use tessera::proto::*;
use tokio::io::AsyncReadExt;
use tokio::net::TcpStream;
use tokio_rustls::client::TlsStream;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;
use transport::{ConnectionLimits, Tls, TlsFiles};

const SECOND: Duration = Duration::from_secs(1);

/// The beginning of a handshake that never goes on: a record that announces 512 bytes of a ClientHello.
const HALF_HELLO: &[u8] = &[0x16, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3];

async fn start(files: TlsFiles, limits: Limits) -> (Server, Arc<Tls>) {
    let tls = Arc::new(Tls::load(files).unwrap());
    (Server::start(Setup { limits, tls: Some(tls.clone()), ..Setup::default() }).await, tls)
}

/// A client of `localhost`, and the first answer that it gets.
async fn connect(address: SocketAddr, authority: &Authority, shown: Option<&Shown>) -> Result<Channel, String> {
    connect_as("localhost", address, authority, shown).await
}

async fn connect_as(
    name: &str,
    address: SocketAddr,
    authority: &Authority,
    shown: Option<&Shown>,
) -> Result<Channel, String> {
    let mut tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(authority.pem())).domain_name(name);
    if let Some(shown) = shown {
        tls = tls.identity(Identity::from_pem(&shown.cert, &shown.key));
    }
    let endpoint = Endpoint::from_shared(format!("https://{address}")).unwrap().tls_config(tls).unwrap();
    let channel = endpoint.connect_timeout(PATIENCE).connect().await.map_err(|e| format!("{e:?}"))?;
    // With TLS 1.3 a client hears that it is refused with the first answer.
    let asked = HealthClient::new(channel.clone()).check(HealthCheckRequest::default()).await;
    asked.map(|_| channel).map_err(|e| format!("{e:?}"))
}

/// A bare TLS connection that shows a certificate, or none.
async fn handshake(address: SocketAddr, authority: &Authority, shown: Option<&Shown>) -> TlsStream<TcpStream> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(authority.pem().as_bytes()).unwrap()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots);
    let mut config = match shown {
        Some(shown) => {
            let key = PrivateKeyDer::from_pem_slice(shown.key.as_bytes()).unwrap();
            let cert = CertificateDer::from_pem_slice(shown.cert.as_bytes()).unwrap();
            config.with_client_auth_cert(vec![cert], key).unwrap()
        }
        None => config.with_no_client_auth(),
    };
    config.alpn_protocols = vec![b"h2".to_vec()];
    let socket = TcpStream::connect(address).await.unwrap();
    let name = ServerName::try_from("localhost").unwrap();
    tokio_rustls::TlsConnector::from(Arc::new(config)).connect(name, socket).await.unwrap()
}

/// The certificate that a new handshake sees.
async fn seen(address: SocketAddr, authority: &Authority) -> Vec<u8> {
    let stream = handshake(address, authority, None).await;
    let (_, session) = stream.get_ref();
    assert_eq!(session.alpn_protocol(), Some(&b"h2"[..]));
    session.peer_certificates().unwrap()[0].to_vec()
}

/// Why the server refuses a client. The client sends nothing after its handshake: a request that the server has not read when it
/// closes makes a reset of the connection, and a reset may overtake the alert that says why.
async fn refusal(address: SocketAddr, authority: &Authority, shown: Option<&Shown>) -> String {
    let mut stream = handshake(address, authority, shown).await;
    let mut answer = Vec::new();
    let read = tokio::time::timeout(PATIENCE, stream.read_to_end(&mut answer)).await.expect("an end");
    format!("{:?}", read.expect_err("a refusal"))
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_with_a_certificate_is_asked_over_tls_alone() {
    let (folder, authority, other) = (folder(), Authority::new("one"), Authority::new("other"));
    let shown = authority.vouch(&["localhost"], Age::Good);
    let (server, _) = start(certificates::files(folder.path(), &shown, None), Limits::default()).await;
    let channel = connect(server.address, &authority, None).await.unwrap();
    let mut client = Client::new(channel);
    ask_rvd(&mut client, small_rvd(BackendChoice::Parallel)).await.unwrap();
    assert_eq!(seen(server.address, &authority).await, shown.der);

    // Who trusts another authority, or means another name, is not fooled.
    let refused = connect(server.address, &other, None).await.unwrap_err();
    assert!(refused.contains("UnknownIssuer"), "{refused}");
    let refused = connect_as("example.org", server.address, &authority, None).await.unwrap_err();
    assert!(refused.contains("NotValidForName"), "{refused}");
    // Who speaks no TLS is not served, and learns it at once.
    let clear = Endpoint::from_shared(format!("http://{}", server.address)).unwrap().connect().await;
    if let Ok(channel) = clear {
        let mut health = HealthClient::new(channel);
        let asked = health.check(HealthCheckRequest::default());
        assert!(tokio::time::timeout(PATIENCE, asked).await.expect("at once").is_err());
    }
    // Nobody is held up by them.
    ask_rvd(&mut client, small_rvd(BackendChoice::Parallel)).await.unwrap();
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn clients_are_asked_for_a_certificate() {
    let (folder, authority, clients, other) =
        (folder(), Authority::new("server"), Authority::new("clients"), Authority::new("other"));
    let shown = authority.vouch(&["localhost"], Age::Good);
    let files = certificates::files(folder.path(), &shown, Some(&clients));
    let (server, tls) = start(files.clone(), Limits::default()).await;
    let good = clients.vouch(&["client"], Age::Good);
    let channel = connect(server.address, &authority, Some(&good)).await.unwrap();
    ask_rvd(&mut Client::new(channel), small_rvd(BackendChoice::Parallel)).await.unwrap();
    for (shown, alert) in [
        (None, "CertificateRequired"),
        (Some(other.vouch(&["client"], Age::Good)), "UnknownCA"),
        (Some(clients.vouch(&["client"], Age::Expired)), "CertificateExpired"),
    ] {
        connect(server.address, &authority, shown.as_ref()).await.expect_err(alert);
        let refused = refusal(server.address, &authority, shown.as_ref()).await;
        assert!(refused.contains(alert), "{alert}: {refused}");
    }
    // New authorities hold for new connections.
    std::fs::write(files.client_ca.unwrap(), other.pem()).unwrap();
    tls.look();
    let newcomer = other.vouch(&["client"], Age::Good);
    let start = Instant::now();
    while connect(server.address, &authority, Some(&newcomer)).await.is_err() {
        assert!(start.elapsed() < PATIENCE, "the new authorities are taken");
    }
    assert!(connect(server.address, &authority, Some(&good)).await.is_err());
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_expired_certificate_is_refused_by_clients() {
    let (folder, authority) = (folder(), Authority::new("one"));
    let shown = authority.vouch(&["localhost"], Age::Expired);
    let (server, _) = start(certificates::files(folder.path(), &shown, None), Limits::default()).await;
    let refused = connect(server.address, &authority, None).await.unwrap_err();
    assert!(refused.contains("Expired"), "{refused}");
    server.stop().await.unwrap();
}

/// How long a new client takes to be served.
async fn newcomer(address: SocketAddr, authority: &Authority) -> Duration {
    let start = Instant::now();
    connect(address, authority, None).await.unwrap();
    start.elapsed()
}

#[tokio::test(flavor = "multi_thread")]
async fn stalled_handshakes_hold_up_nobody_and_go() {
    let (folder, authority) = (folder(), Authority::new("one"));
    let files = certificates::files(folder.path(), &authority.vouch(&["localhost"], Age::Good), None);
    let limit = 6 * SECOND;
    let connections = ConnectionLimits { handshake: limit, first_byte: limit, ..ConnectionLimits::default() };
    let (server, _) = start(files, Limits { connections, ..Limits::default() }).await;
    // The first one pays for what is made once.
    newcomer(server.address, &authority).await;
    let mut sockets = Vec::new();
    for i in 0..200 {
        sockets.push(silent(server.address, if i % 2 == 0 { b"" } else { HALF_HELLO }).await);
    }
    let opened = Instant::now();
    let mut best = Duration::MAX;
    for _ in 0..3 {
        best = best.min(newcomer(server.address, &authority).await);
    }
    eprintln!("with 200 stalled handshakes a new client is served in {best:?}");
    assert!(best < limit / 3, "{best:?}");
    for socket in &mut sockets {
        assert!(closes(socket, PATIENCE).await, "each has an end");
    }
    assert!(opened.elapsed() < PATIENCE);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stalled_handshake_goes_where_all_turns_are_taken() {
    let (folder, authority) = (folder(), Authority::new("one"));
    let files = certificates::files(folder.path(), &authority.vouch(&["localhost"], Age::Good), None);
    let connections = ConnectionLimits { handshakes: 4, handshake: 10 * PATIENCE, ..ConnectionLimits::default() };
    let (server, _) = start(files, Limits { connections, ..Limits::default() }).await;
    let mut stalled = Vec::new();
    for _ in 0..4 {
        stalled.push(silent(server.address, HALF_HELLO).await);
    }
    tokio::time::sleep(SECOND / 5).await;
    let took = newcomer(server.address, &authority).await;
    assert!(took < PATIENCE, "{took:?}");
    let mut open = 0;
    for socket in &mut stalled {
        open += usize::from(!closes(socket, SECOND / 5).await);
    }
    assert!(open >= 2, "no more go than there are newcomers: {open} stay");
    server.stop().await.unwrap();
}

/// Waits until new handshakes see `shown`.
async fn until_seen(server: &Server, authority: &Authority, shown: &Shown) {
    let start = Instant::now();
    while seen(server.address, authority).await != shown.der {
        assert!(start.elapsed() < PATIENCE, "the new certificate is taken");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_certificate_cuts_no_stream() {
    let (folder, authority) = (folder(), Authority::new("one"));
    let files = certificates::files(folder.path(), &authority.vouch(&["localhost"], Age::Good), None);
    let (server, tls) = start(files.clone(), Limits::default()).await;
    let mut watches = Vec::new();
    for _ in 0..4 {
        let channel = connect(server.address, &authority, None).await.unwrap();
        let mut watch = HealthClient::new(channel).watch(HealthCheckRequest::default()).await.unwrap().into_inner();
        watch.message().await.unwrap().unwrap();
        watches.push(watch);
    }
    let (done, over) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(false)));
    let mut client = Client::new(connect(server.address, &authority, None).await.unwrap());
    let load = {
        let (done, over) = (done.clone(), over.clone());
        tokio::spawn(async move {
            while !over.load(Ordering::SeqCst) {
                ask_rvd(&mut client, small_rvd(BackendChoice::Parallel)).await.unwrap();
                done.fetch_add(1, Ordering::SeqCst);
            }
        })
    };
    for _ in 0..20 {
        let shown = authority.vouch(&["localhost"], Age::Good);
        certificates::write(&files, &shown);
        tls.look();
        until_seen(&server, &authority, &shown).await;
    }
    over.store(true, Ordering::SeqCst);
    load.await.expect("no call failed");
    assert!(done.load(Ordering::SeqCst) > 0);
    for watch in &mut watches {
        let more = tokio::time::timeout(Duration::from_millis(20), watch.message()).await;
        assert!(more.is_err(), "a watch goes on: {more:?}");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_new_files_change_nothing() {
    let (folder, authority) = (folder(), Authority::new("one"));
    let first = authority.vouch(&["localhost"], Age::Good);
    let mut files = certificates::files(folder.path(), &first, None);
    // By the clock, this time.
    files.reload = Duration::from_millis(50);
    let (server, _) = start(files.clone(), Limits::default()).await;
    let [next, expired] = [Age::Good, Age::Expired].map(|age| authority.vouch(&["localhost"], age));
    let half = |path: &Path, text: &str| std::fs::write(path, &text[..text.len() / 2]).unwrap();
    let bad: [&dyn Fn(); 5] = [
        &|| std::fs::write(&files.key, &next.key).unwrap(),
        &|| half(&files.cert, &next.cert),
        &|| std::fs::remove_file(&files.cert).unwrap(),
        &|| certificates::write(&files, &expired),
        &|| std::fs::write(&files.cert, "").unwrap(),
    ];
    for (i, make) in bad.iter().enumerate() {
        make();
        tokio::time::sleep(Duration::from_millis(200)).await;
        assert_eq!(seen(server.address, &authority).await, first.der, "case {i}");
    }
    certificates::write(&files, &next);
    until_seen(&server, &authority, &next).await;
    server.stop().await.unwrap();
}
