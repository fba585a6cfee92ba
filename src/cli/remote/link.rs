//! The connection to a server, and how long each of its signs of life may take.
//!
//! Purpose: a server that is gone, stuck or no server of ours ends a call with a sentence. Invariant: no wait is without
//! an end; work that was admitted may take any time, as long as the connection lives. Each call carries tenant and key.
//! Must not know: what is asked.

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::Result;
use tonic::metadata::AsciiMetadataValue;
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Request, Response, Status, Streaming};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use super::faults;
use crate::exit::{BadInput, Unavailable, Usage};
use crate::server::{Server, ServerUrl, Tenant, Trust};

#[derive(Clone, Copy, Debug)]
pub(super) struct Patience {
    /// To connect; then, to answer anything at all.
    pub(super) connect: Duration,
    /// Between two HTTP/2 pings, and for the answer to one.
    pub(super) ping: Duration,
    /// For the first answer, from when the last message of the request left.
    pub(super) first: Duration,
}

impl Patience {
    /// For a request of `elements` vertices, facets and points: a server reads them before it answers.
    pub(super) fn with(elements: usize) -> Self {
        let reading = Duration::from_millis(elements as u64 / 10);
        let [connect, ping, first] = [10, 20, 60].map(Duration::from_secs);
        Self { connect, ping, first: first + reading }
    }
}

/// How much a server may send ahead of the reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Windows {
    /// As much as the transport likes.
    Usual,
    /// The least that HTTP/2 begins with: the server notices a slow reader.
    Narrow,
}

const NARROW_BYTES: u32 = 65_535;

pub(super) type Sent = Arc<AtomicU64>;

/// What a call answers.
pub(crate) type Answered<T> = Result<Response<T>, Status>;

const TENANT: &str = "tessera-tenant";
const KEY: &str = "authorization";

#[derive(Clone, Debug, Default)]
pub(crate) struct Caller {
    tenant: Option<AsciiMetadataValue>,
    /// Sensitive: nothing prints it.
    key: Option<AsciiMetadataValue>,
}

impl Caller {
    fn of(server: &Server) -> Result<Self> {
        let tenant = server.tenant.as_ref().map(Tenant::as_str).map(AsciiMetadataValue::try_from).transpose();
        let tenant = tenant.map_err(|e| Usage(format!("--tenant: {e}")))?;
        let key = server.key.as_ref().map(|key| AsciiMetadataValue::try_from(format!("Bearer {}", key.reveal())));
        let mut key = key.transpose().map_err(|_| Usage("--key-file: the key cannot be sent".to_owned()))?;
        key.iter_mut().for_each(|key| key.set_sensitive(true));
        Ok(Self { tenant, key })
    }
}

impl Interceptor for Caller {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(tenant) = &self.tenant {
            request.metadata_mut().insert(TENANT, tenant.clone());
        }
        if let Some(key) = &self.key {
            request.metadata_mut().insert(KEY, key.clone());
        }
        Ok(request)
    }
}

/// What calls are made on.
pub(crate) type Door = InterceptedService<Channel, Caller>;

pub(super) struct Link<'a> {
    pub(super) url: &'a ServerUrl,
    patience: Patience,
    channel: Channel,
    caller: Caller,
    sent: Sent,
}

impl<'a> Link<'a> {
    pub(super) async fn open(server: &'a Server, patience: Patience) -> Result<Self> {
        Self::open_with(server, patience, Windows::Usual).await
    }

    /// Connects, and lets the server send no more than `windows` before somebody reads.
    pub(super) async fn open_with(server: &'a Server, patience: Patience, windows: Windows) -> Result<Self> {
        let (url, trust, caller) = (&server.url, &server.trust, Caller::of(server)?);
        let endpoint = Endpoint::from_shared(url.to_string())
            .map_err(|e| Usage(format!("--endpoint {url}: {e}; an example is http://127.0.0.1:50051")))?;
        let mut endpoint = endpoint.connect_timeout(patience.connect);
        if url.has_tls() {
            endpoint = endpoint.tls_config(tls_settings(trust, patience.connect)).map_err(|e| {
                let cause = faults::innermost(&e);
                let text = tls_meaning(url, &cause).unwrap_or_else(|| {
                    format!("--ca, --client-cert or --client-key cannot be used: {cause}; they are to be files in PEM")
                });
                BadInput(text)
            })?;
        }
        if windows == Windows::Narrow {
            endpoint = endpoint.initial_stream_window_size(NARROW_BYTES).initial_connection_window_size(NARROW_BYTES);
        }
        let endpoint = endpoint.http2_keep_alive_interval(patience.ping).keep_alive_timeout(patience.ping);
        let channel = endpoint.connect().await.map_err(|e| {
            let cause = faults::innermost(&e);
            let meaning = tls_meaning(url, &cause);
            Unavailable(meaning.unwrap_or_else(|| format!("cannot reach {url}: {cause}; is a server running there?")))
        })?;
        let link = Self { url, patience, channel, caller, sent: Sent::default() };
        link.greet().await?;
        Ok(link)
    }

    /// Asks for anything. A socket that takes connections need not be a server, nor one that works. What the answer
    /// says does not matter: a server that is about to stop says so itself, and a proxy may not know the service.
    async fn greet(&self) -> Result<()> {
        let mut health = HealthClient::new(self.channel.clone());
        let asked = health.check(HealthCheckRequest { service: String::new() });
        let (url, limit) = (self.url, self.patience.connect);
        let cause = match tokio::time::timeout(limit, asked).await {
            Err(_) => format!("takes the connection, but said nothing for {} s", limit.as_secs_f32()),
            Ok(Err(status)) if std::error::Error::source(&status).is_some() => {
                let cause = faults::innermost(&status);
                if let Some(meaning) = tls_meaning(url, &cause) {
                    return Err(Unavailable(meaning).into());
                }
                format!("does not answer as a server of tessera ({cause})")
            }
            Ok(_) => return Ok(()),
        };
        Err(Unavailable(format!("{url} {cause}; is one running there, and has it room for another connection?")).into())
    }

    pub(super) fn channel(&self) -> Door {
        InterceptedService::new(self.channel.clone(), self.caller.clone())
    }

    /// To be counted up with each message that leaves.
    pub(super) fn sent(&self) -> Sent {
        Arc::clone(&self.sent)
    }

    /// Waits for the head of what `call` answers.
    pub(super) async fn asks<T>(
        &'a self,
        call: impl Future<Output = Answered<Streaming<T>>>,
    ) -> Result<Answers<'a, T>> {
        let stream = self.first(call).await?.map_err(|status| faults::of_status(self.url, &status))?;
        Ok(Answers { link: self, stream: stream.into_inner(), begun: false })
    }

    /// Waits for `answer`. An upload may take long on a slow line, as long as something leaves.
    pub(super) async fn first<R>(&self, answer: impl Future<Output = R>) -> Result<R> {
        let mut answer = std::pin::pin!(answer);
        let limit = self.patience.first;
        loop {
            let before = self.sent.load(Ordering::Relaxed);
            tokio::select! {
                answer = &mut answer => return Ok(answer),
                () = tokio::time::sleep(limit) => {}
            }
            if self.sent.load(Ordering::Relaxed) == before {
                let (url, seconds) = (self.url, limit.as_secs_f32());
                let text = format!("{url} took the request, but did not answer it for {seconds:.0} s; try again");
                return Err(Unavailable(text).into());
            }
        }
    }
}

/// A connection for many calls at once, of several tenants. The server answered on it once.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    server: Server,
    channel: Channel,
}

impl Line {
    pub(crate) async fn open(server: &Server, windows: Windows) -> Result<Self> {
        let Link { channel, .. } = Link::open_with(server, Patience::with(0), windows).await?;
        Ok(Self { server: server.clone(), channel })
    }

    /// A channel for calls of a tenant; of the server's own tenant if none is named.
    pub(crate) fn door(&self, tenant: Option<&Tenant>) -> Result<Door> {
        let server = Server { tenant: tenant.or(self.server.tenant.as_ref()).cloned(), ..self.server.clone() };
        Ok(InterceptedService::new(self.channel.clone(), Caller::of(&server)?))
    }
}

pub(super) struct Answers<'a, T> {
    link: &'a Link<'a>,
    stream: Streaming<T>,
    begun: bool,
}

impl<T> Answers<'_, T> {
    /// The next one. The caller asks for no more after the last, so that an end is an error.
    pub(super) async fn next(&mut self) -> Result<T> {
        let message = match self.begun {
            true => self.stream.message().await,
            false => self.link.first(self.stream.message()).await?,
        };
        self.begun = true;
        match message {
            Ok(Some(message)) => Ok(message),
            Ok(None) => Err(faults::wrong("it ended before the job was done")),
            Err(status) => Err(faults::of_status(self.link.url, &status)),
        }
    }
}

/// What TLS says, in any of these words, and what that means.
const MEANINGS: &[(&[&str], &str)] = &[
    (
        &["UnknownIssuer", "CaUsedAsEndEntity", "BadSignature", "UnsupportedSignatureAlgorithm"],
        "its certificate is not by an authority that is trusted here; give the authority's file with --ca",
    ),
    (&["certificate expired", "Expired"], "its certificate has expired; the server needs a new one"),
    (&["not valid yet", "NotValidYet"], "its certificate is not valid yet; see that the clocks are right"),
    (
        &["not valid for name", "NotValidForName"],
        "its certificate is for another name; write the name that the certificate has in --endpoint",
    ),
    (
        &["CertificateRequired", "HandshakeFailure"],
        "it wants a certificate of the client; give --client-cert and --client-key",
    ),
    (
        &["alert: UnknownCA", "alert: BadCertificate", "alert: CertificateExpired", "alert: CertificateUnknown"],
        "it does not take this client's certificate; give one by an authority that the server trusts, and that is valid \
         now",
    ),
    (&["InvalidContentType", "corrupt message"], "it speaks no TLS; write http:// if you trust the network"),
    (
        &["no native certs"],
        "this system has no authorities that vouch for servers; give the authority's file with --ca",
    ),
    (&["TLS handshake timeout"], "the TLS handshake took too long"),
];

pub(super) fn tls_settings(trust: &Trust, limit: Duration) -> ClientTlsConfig {
    let settings = ClientTlsConfig::new().timeout(limit);
    let settings = match &trust.authorities {
        Some(pem) => settings.ca_certificate(Certificate::from_pem(pem)),
        None => settings.with_native_roots(),
    };
    trust.identity.iter().fold(settings, |all, (cert, key)| all.identity(Identity::from_pem(cert, key)))
}

/// What a failure of the connection to `url` means, if TLS has to do with it.
pub(super) fn tls_meaning(url: &ServerUrl, cause: &str) -> Option<String> {
    if !url.has_tls() {
        // What a server says in TLS is no frame of HTTP/2.
        let garbled = cause.contains("frame with invalid size") || cause.contains("invalid HTTP");
        return garbled.then(|| {
            let https = url.with_tls();
            format!("{url} does not answer as a server of tessera ({cause}); if it speaks TLS, write {https}")
        });
    }
    let known = MEANINGS.iter().find(|(words, _)| words.iter().any(|word| cause.contains(word)));
    known.map(|(_, meaning)| format!("{url} cannot be asked: {meaning} ({cause})"))
}

#[cfg(test)]
mod tests {
    use tokio::io::AsyncWriteExt;
    use tokio::net::TcpListener;

    use super::*;
    use crate::exit::code;
    use crate::server::Trust;

    const SHORT: Duration = Duration::from_millis(300);
    const LONG: Duration = Duration::from_secs(10);

    /// What opening a connection to a socket says that sends `bytes` and no more.
    async fn open(bytes: &'static [u8], close: bool, connect: Duration) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url: ServerUrl = format!("http://{}", listener.local_addr().unwrap()).parse().unwrap();
        tokio::spawn(async move {
            let mut open = Vec::new();
            loop {
                let (mut socket, _) = listener.accept().await.unwrap();
                socket.write_all(bytes).await.unwrap();
                if !close {
                    open.push(socket);
                }
            }
        });
        let patience = Patience { connect, ping: LONG, first: LONG };
        let server = Server { url: url.clone(), tenant: None, trust: Trust::default(), key: None };
        let error = Link::open(&server, patience).await.err().expect("it is no server");
        assert_eq!(code(&error), 69);
        let said = format!("{error:#}");
        assert!(said.contains(&url.to_string()) && !said.contains("Error {") && !said.contains('\n'), "{said}");
        said
    }

    #[tokio::test]
    async fn what_is_no_server_is_said() {
        const SETTINGS: &[u8] = &[0, 0, 0, 4, 0, 0, 0, 0, 0];
        for silent in [&b""[..], SETTINGS] {
            let said = open(silent, false, SHORT).await;
            assert!(said.contains("said nothing"), "{said}");
        }
        let said = open(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n", false, LONG).await;
        assert!(said.contains("does not answer as a server"), "{said}");
        let said = open(b"", true, LONG).await;
        assert!(said.contains("room for another connection"), "{said}");
    }

    #[tokio::test]
    async fn nobody_waits_for_ever_for_a_first_answer() {
        let url: ServerUrl = "http://127.0.0.1:1".parse().unwrap();
        let channel = Endpoint::from_static("http://127.0.0.1:1").connect_lazy();
        let patience = Patience { connect: SHORT, ping: SHORT, first: SHORT };
        let link = Link { url: &url, patience, channel, caller: Caller::default(), sent: Sent::default() };
        let error = link.first(std::future::pending::<()>()).await.unwrap_err();
        assert!(code(&error) == 69 && error.to_string().contains("did not answer"), "{error}");

        // An upload that goes on is no silence.
        let sent = link.sent();
        tokio::spawn(async move {
            loop {
                sent.fetch_add(1, Ordering::Relaxed);
                tokio::time::sleep(SHORT / 100).await;
            }
        });
        let slow = tokio::time::sleep(3 * SHORT);
        assert!(link.first(slow).await.is_ok());
    }

    #[test]
    fn what_tls_says_is_put_into_words() {
        let [https, http] = ["https://a:1", "http://a:1"].map(|url| url.parse::<ServerUrl>().unwrap());
        for (cause, words) in [
            ("invalid peer certificate: UnknownIssuer", "--ca"),
            ("invalid peer certificate: certificate expired: verification time 5 (UNIX), but ...", "has expired"),
            ("invalid peer certificate: certificate not valid for name \"a\"; certificate is only", "another name"),
            ("received fatal alert: CertificateRequired", "--client-cert"),
            ("received fatal alert: UnknownCA", "this client's certificate"),
            ("received corrupt message of type InvalidContentType", "speaks no TLS"),
        ] {
            let meaning = tls_meaning(&https, cause).unwrap();
            assert!(meaning.contains(words) && meaning.contains(cause) && meaning.contains("https://a:1"), "{meaning}");
        }
        assert_eq!(tls_meaning(&https, "Connection refused"), None);
        assert_eq!(tls_meaning(&http, "Connection refused"), None);
        assert!(tls_meaning(&http, "frame with invalid size").unwrap().contains("write https://a:1"));
    }
}
