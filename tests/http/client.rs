//! A server with its HTTP door on a port of its own, and a client of as few words as HTTP has.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use jobs::blob::{BlobOptions, BlobStore};
use jobs::{Backends, Engine, EngineOptions, Executor, ExecutorOptions, JobError, Stores};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use serde_json::Value;
use server::config::Limits;
use server::hosts::Hosts;
use server::http::door;
#[cfg(feature = "ui")]
use server::http::door_with_page;
use server::keys::{KeyFile, KeyLimits, NewKey, Role, Secret};
use server::metrics::Metrics;
use server::readiness::Readiness;
use server::service::{self, About, Access, AccessOptions, Door, Jobs, Parts, ServeError};
use tessera::{BackendChoice, BackendKind};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use transport::Tls;

/// For whatever has to come.
const PATIENCE: Duration = Duration::from_secs(120);

pub struct House {
    pub http: SocketAddr,
    pub metrics: Metrics,
    pub blobs: Arc<dyn BlobStore>,
    stop: Mutex<Option<oneshot::Sender<()>>>,
    served: tokio::task::JoinHandle<Result<(), ServeError>>,
}

/// The keys of a server.
pub struct Keys {
    _folder: tempfile::TempDir,
    file: KeyFile,
}

impl Keys {
    pub fn add(&self, name: &str, role: Role, limits: KeyLimits) -> Secret {
        let new = NewKey { name: name.to_owned(), role, lasts: None, limits, is_second: false };
        self.file.change(|keys| keys.add(new)).unwrap().1
    }

    pub fn revoke(&self, name: &str) {
        self.file.change(|keys| keys.revoke(name)).unwrap();
    }
}

impl House {
    pub async fn open() -> Self {
        Self::start(Access::open(), None, door, Limits::default()).await
    }

    pub async fn with_limits(limits: Limits) -> Self {
        Self::start(Access::open(), None, door, limits).await
    }

    pub async fn with_tls(tls: Arc<Tls>) -> Self {
        Self::start(Access::open(), Some(tls), door, Limits::default()).await
    }

    pub async fn with_keys() -> (Self, Keys) {
        Self::locked(door, Limits::default()).await
    }

    /// Without keys, for one more host and the pages of one more site.
    pub async fn with_host(host: &str, origin: &'static str) -> Self {
        let hosts = Hosts { names: vec![host.to_owned()], origins: vec![origin.parse().unwrap()] };
        let options = AccessOptions { hosts, ..AccessOptions::default() };
        Self::start(Access::open().with(options), None, door, Limits::default()).await
    }

    /// Without keys, with the page.
    #[cfg(feature = "ui")]
    pub async fn with_open_page() -> Self {
        Self::start(Access::open(), None, door_with_page, Limits::default()).await
    }

    /// With keys too.
    #[cfg(feature = "ui")]
    pub async fn with_page() -> (Self, Keys) {
        Self::locked(door_with_page, Limits::default()).await
    }

    /// With keys, and with these limits.
    pub async fn with_keys_and_limits(limits: Limits) -> (Self, Keys) {
        Self::locked(door, limits).await
    }

    async fn locked(door: fn(TcpListener) -> Door, limits: Limits) -> (Self, Keys) {
        let folder = tempfile::tempdir().unwrap();
        let file = KeyFile::in_folder(folder.path());
        let options = AccessOptions { require_keys: true, ..AccessOptions::default() };
        let house = Self::start(Access::in_folder(folder.path(), options).unwrap(), None, door, limits).await;
        (house, Keys { _folder: folder, file })
    }

    async fn start(access: Access, tls: Option<Arc<Tls>>, door: fn(TcpListener) -> Door, limits: Limits) -> Self {
        let of = |kind: BackendKind, threads: usize| {
            tessera::BackendOptions::new().with_choice(BackendChoice::Only(kind)).with_threads(threads).open()
        };
        let factory = move || -> Result<Backends, JobError> {
            Ok(Backends {
                gpu: Err("no GPU in this test; use another backend".to_owned()),
                parallel: of(BackendKind::Parallel, 2)?,
                serial: of(BackendKind::Serial, 1)?,
                default: BackendChoice::Auto,
                pools: None,
            })
        };
        let options = EngineOptions { jobs_at_once: 1, ..EngineOptions::default() };
        let metrics = Metrics::default();
        let (engine, worker) = Engine::start_observed(factory, options, Arc::new(metrics.clone())).unwrap();
        let Limits { max_vertices, max_facets, max_seeds, max_iterations, .. } = limits;
        let bounds = wire::counts::Bounds { max_vertices, max_facets, max_seeds, max_iterations };
        let stores = Stores::ephemeral(BlobOptions::default());
        let blobs = Arc::clone(&stores.blobs);
        let executor = Executor::start(engine.clone(), stores, ExecutorOptions::new(bounds)).await.unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let beside = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let http = beside.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel();
        let parts = Parts {
            engine,
            worker,
            limits,
            jobs: Some(Jobs { blobs: Arc::clone(&blobs), api: Arc::new(executor) }),
            tls,
            access,
            metrics: metrics.clone(),
            readiness: Readiness::new(),
            about: About::default(),
            door: Some(door(beside)),
        };
        let served = tokio::spawn(service::run(listener, parts, async {
            let _ = stopped.await;
        }));
        Self { http, metrics, blobs, stop: Mutex::new(Some(stop)), served }
    }

    /// Until keys that were just made are known.
    pub async fn reload(&self) {
        tokio::time::sleep(Duration::from_millis(2500)).await;
    }

    pub fn begin_stop(&self) {
        if let Some(stop) = self.stop.lock().unwrap().take() {
            let _ = stop.send(());
        }
    }

    pub async fn stop(self) {
        self.begin_stop();
        tokio::time::timeout(PATIENCE, self.served).await.expect("the server stops").unwrap().unwrap();
    }
}

/// What came back.
pub struct Answer {
    pub status: u16,
    headers: Vec<(String, String)>,
    pub body: Vec<u8>,
}

impl std::fmt::Debug for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let body = String::from_utf8_lossy(&self.body[..self.body.len().min(500)]);
        write!(f, "{} {:?} {body}", self.status, self.headers)
    }
}

/// A server-sent event.
#[derive(Debug)]
pub struct Event {
    pub id: Option<u64>,
    pub name: String,
    pub data: Value,
}

impl Answer {
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// All values of a header.
    pub fn all(&self, name: &str) -> Vec<&str> {
        self.headers.iter().filter(|(other, _)| other == name).map(|(_, value)| value.as_str()).collect()
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error}: {self:?}"))
    }

    pub fn events(&self) -> Vec<Event> {
        let text = std::str::from_utf8(&self.body).unwrap();
        let field = |frame: &str, name: &str| {
            let line = frame.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
            line.map(str::to_owned)
        };
        let frames = text.split("\n\n").filter(|frame| !frame.is_empty() && !frame.starts_with(':'));
        frames
            .map(|frame| Event {
                id: field(frame, "id").map(|id| id.parse().unwrap()),
                name: field(frame, "event").unwrap(),
                data: serde_json::from_str(&field(frame, "data").unwrap()).unwrap(),
            })
            .collect()
    }
}

/// Whatever comes of a request for a path, in the protocol that TLS agrees on; only HTTP/1.1 is understood here.
pub async fn over_tls(house: &House, authority: &str, protocol: &[u8], path: &str) -> (Option<Vec<u8>>, String) {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(authority.as_bytes()).unwrap()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let mut config = config.with_root_certificates(roots).with_no_client_auth();
    config.alpn_protocols = vec![protocol.to_vec()];
    let stream = TcpStream::connect(house.http).await.unwrap();
    let name = ServerName::try_from("localhost").unwrap();
    let mut stream = tokio_rustls::TlsConnector::from(Arc::new(config)).connect(name, stream).await.unwrap();
    let agreed = stream.get_ref().1.alpn_protocol().map(<[u8]>::to_vec);
    let mut text = Vec::new();
    if protocol == b"http/1.1" {
        let head = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
        stream.write_all(head.as_bytes()).await.unwrap();
        stream.read_to_end(&mut text).await.unwrap();
    }
    (agreed, String::from_utf8(text).unwrap())
}

/// Sends a request, and does not wait.
pub async fn send(house: &House, method: &str, path: &str, headers: &[&str], body: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(house.http).await.unwrap();
    let length = body.len();
    let mut head = format!("{method} {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {length}\r\n");
    if !headers.iter().any(|header| header.starts_with("Host: ")) {
        head += "Host: localhost\r\n";
    }
    for header in headers {
        head += &format!("{header}\r\n");
    }
    stream.write_all((head + "\r\n").as_bytes()).await.unwrap();
    // A server that refuses may not read it all.
    let _ = stream.write_all(body).await;
    stream
}

pub async fn ask(house: &House, method: &str, path: &str, headers: &[&str], body: &[u8]) -> Answer {
    let mut stream = send(house, method, path, headers, body).await;
    let mut all = Vec::new();
    let read = tokio::time::timeout(PATIENCE, stream.read_to_end(&mut all)).await.expect("an answer comes");
    if all.is_empty() {
        read.unwrap();
    }
    let end = all.windows(4).position(|four| four == b"\r\n\r\n").expect("a head");
    let head = std::str::from_utf8(&all[..end]).unwrap();
    let mut lines = head.split("\r\n");
    let status = lines.next().unwrap().split(' ').nth(1).unwrap().parse().unwrap();
    let headers: Vec<(String, String)> = lines
        .map(|line| line.split_once(": ").unwrap())
        .map(|(name, value)| (name.to_ascii_lowercase(), value.to_owned()))
        .collect();
    let rest = &all[end + 4..];
    let is_chunked = headers.iter().any(|(name, value)| name == "transfer-encoding" && value == "chunked");
    let body = if is_chunked { joined(rest) } else { rest.to_vec() };
    Answer { status, headers, body }
}

/// Sends a body in chunks, whose length nobody knows before its end; gives the status line's number.
pub async fn post_chunked(house: &House, path: &str, headers: &[&str], body: &[u8]) -> u16 {
    let mut stream = TcpStream::connect(house.http).await.unwrap();
    let mut all =
        format!("POST {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nTransfer-Encoding: chunked\r\n");
    for header in headers {
        all += &format!("{header}\r\n");
    }
    let mut all = (all + "\r\n").into_bytes();
    for chunk in body.chunks(1000) {
        all.extend_from_slice(format!("{:x}\r\n", chunk.len()).as_bytes());
        all.extend_from_slice(chunk);
        all.extend_from_slice(b"\r\n");
    }
    all.extend_from_slice(b"0\r\n\r\n");
    // A server that refuses may not read it all.
    let _ = stream.write_all(&all).await;
    let mut answer = [0; 12];
    tokio::time::timeout(PATIENCE, stream.read_exact(&mut answer)).await.expect("an answer comes").unwrap();
    std::str::from_utf8(&answer[9..]).unwrap().parse().unwrap()
}

/// The bytes of chunks.
fn joined(mut rest: &[u8]) -> Vec<u8> {
    let mut all = Vec::new();
    while let Some(end) = rest.windows(2).position(|two| two == b"\r\n") {
        let length = usize::from_str_radix(std::str::from_utf8(&rest[..end]).unwrap(), 16).unwrap();
        if length == 0 {
            break;
        }
        all.extend_from_slice(&rest[end + 2..end + 2 + length]);
        rest = &rest[end + 4 + length..];
    }
    all
}

pub async fn get(house: &House, path: &str, headers: &[&str]) -> Answer {
    ask(house, "GET", path, headers, b"").await
}

pub async fn post(house: &House, path: &str, headers: &[&str], body: &[u8]) -> Answer {
    ask(house, "POST", path, headers, body).await
}

/// The same over HTTP/2, without headers.
pub async fn over_http2(house: &House, path: &str) -> (u16, Vec<u8>) {
    let stream = TcpStream::connect(house.http).await.unwrap();
    let (sender, connection) = h2::client::handshake(stream).await.unwrap();
    let driven = tokio::spawn(connection);
    let mut sender = sender.ready().await.unwrap();
    let request = http::Request::get(format!("http://{}{path}", house.http)).body(()).unwrap();
    let (response, _) = sender.send_request(request, true).unwrap();
    let response = response.await.unwrap();
    let status = response.status().as_u16();
    let (mut body, mut all) = (response.into_body(), Vec::new());
    while let Some(bytes) = body.data().await {
        let bytes = bytes.unwrap();
        body.flow_control().release_capacity(bytes.len()).unwrap();
        all.extend_from_slice(&bytes);
    }
    drop(sender);
    driven.abort();
    (status, all)
}
