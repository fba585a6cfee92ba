//! The certificates of the server, and their replacement.
//!
//! Purpose: [`Tls`] holds the configuration of new handshakes, and [`Tls::follow`] reloads its files.
//! Invariant: the configuration in use is complete and consistent. If the files are invalid, incomplete or out of date, the
//! old one stays in use, and the log says so once. Open connections keep their configuration.
//! One provider of cryptography: ring. Must not know: connections.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::version::{TLS12, TLS13};
use rustls::{RootCertStore, ServerConfig};
use tokio::sync::Notify;
use x509_parser::certificate::{Validity, X509Certificate};
use x509_parser::prelude::FromDer;

use super::{lock, read_regular};

/// The log warns of a certificate that ends within this time.
const WARN_BEFORE: Duration = Duration::from_secs(14 * 24 * 3600);

/// Time between two such warnings.
const WARN_EVERY: Duration = Duration::from_secs(24 * 3600);

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The server's certificate and its chain.
    pub cert: PathBuf,
    /// The certificate's private key.
    pub key: PathBuf,
    /// The authorities of clients, if these need a certificate.
    pub client_ca: Option<PathBuf>,
    /// Between two looks at the files.
    pub reload: Duration,
}

#[derive(Debug)]
pub struct Tls {
    files: TlsFiles,
    state: Mutex<State>,
    asked: Notify,
}

#[derive(Debug)]
struct State {
    config: Arc<ServerConfig>,
    /// Configuration that offers HTTP/1.1 too.
    web: Arc<ServerConfig>,
    validity: Option<Validity>,
    /// Content of the files in use.
    active: Material,
    /// Content of the files of the last complaint in the log, or why they could not be read.
    complained: Option<Result<Material, String>>,
    warned: Option<Instant>,
}

impl State {
    fn new(active: Material, config: ServerConfig, validity: Option<Validity>) -> Self {
        let web = with_http1(&config);
        Self { config: Arc::new(config), web, validity, active, complained: None, warned: None }
    }
}

impl Tls {
    pub fn load(files: TlsFiles) -> Result<Self, TlsError> {
        let material = Material::read(&files)?;
        let (config, validity) = material.config(&files)?;
        let state = State::new(material, config, validity);
        let tls = Self { files, state: Mutex::new(state), asked: Notify::new() };
        tls.warn();
        Ok(tls)
    }

    /// Has the files looked at as soon as may be.
    pub fn look(&self) {
        self.asked.notify_one();
    }

    /// The configuration of a new handshake; `web` offers HTTP/1.1 too.
    pub(super) fn current(&self, web: bool) -> Arc<ServerConfig> {
        let state = lock(&self.state);
        Arc::clone(if web { &state.web } else { &state.config })
    }

    /// Looks at the files again and again; never ends.
    pub(super) async fn follow(self: Arc<Self>) {
        loop {
            tokio::select! {
                () = tokio::time::sleep(self.files.reload) => {}
                () = self.asked.notified() => tracing::info!("looking at the files of TLS"),
            }
            let tls = Arc::clone(&self);
            // Files may lie where reading them takes its time.
            let _ = tokio::task::spawn_blocking(move || {
                tls.reload();
                tls.warn();
            })
            .await;
        }
    }

    /// Uses the files' current content, if it is valid and new.
    fn reload(&self) {
        let read = Material::read(&self.files);
        let seen = read.as_ref().map(Clone::clone).map_err(TlsError::to_string);
        if seen.as_ref().is_ok_and(|material| *material == lock(&self.state).active) {
            lock(&self.state).complained = None;
            return;
        }
        let made = read.and_then(|material| {
            let (config, validity) = material.config(&self.files)?;
            match validity.as_ref().is_some_and(|validity| !validity.is_valid()) {
                true => Err(TlsError::OutOfDate { file: self.files.cert.clone() }),
                false => Ok(State::new(material, config, validity)),
            }
        });
        let mut state = lock(&self.state);
        match made {
            Ok(made) => {
                *state = made;
                let until = state.validity.as_ref().map(until);
                tracing::info!(until, "new connections get the new certificate");
            }
            Err(error) if state.complained.as_ref() != Some(&seen) => {
                state.complained = Some(seen);
                tracing::error!(%error, "the new files of TLS cannot be used; the old certificate stays");
            }
            Err(_) => {}
        }
    }

    /// Tells ahead of time that the certificate ends.
    fn warn(&self) {
        let mut state = lock(&self.state);
        let Some(validity) = state.validity.clone() else { return };
        let is_long = validity.time_to_expiration().is_some_and(|left| left >= WARN_BEFORE);
        if is_long || state.warned.is_some_and(|last| last.elapsed() < WARN_EVERY) {
            return;
        }
        state.warned = Some(Instant::now());
        let (file, until) = (self.files.cert.display(), until(&validity));
        match validity.is_valid() {
            true => tracing::warn!(%file, until, "the certificate ends soon; put a new one there"),
            false => tracing::error!(%file, until, "the certificate is out of date: clients will refuse it"),
        }
    }
}

/// Last day of a certificate, as year-month-day.
fn until(validity: &Validity) -> String {
    validity.not_after.to_datetime().date().to_string()
}

/// The same for clients that speak HTTP/1.1.
fn with_http1(config: &ServerConfig) -> Arc<ServerConfig> {
    let mut config = config.clone();
    config.alpn_protocols.push(b"http/1.1".to_vec());
    Arc::new(config)
}

/// No chain of certificates is longer; a device that never ends is none.
const LONGEST_BYTES: u64 = 1 << 20;

const HTTP2: &[u8] = b"h2";

#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    #[error("cannot read {}: {cause}", file.display())]
    Read { file: PathBuf, cause: io::Error },
    #[error("{} holds no {what} in PEM{why}", file.display())]
    Missing { file: PathBuf, what: &'static str, why: String },
    #[error("the certificate {} and the key {} cannot be used: {why}", cert.display(), key.display())]
    Pair { cert: PathBuf, key: PathBuf, why: String },
    #[error("the authorities in {} cannot be used: {why}", file.display())]
    Authorities { file: PathBuf, why: String },
    #[error("the certificate {} is out of date", file.display())]
    OutOfDate { file: PathBuf },
}

#[derive(Clone, PartialEq)]
struct Material {
    cert: Vec<u8>,
    key: Vec<u8>,
    client_ca: Option<Vec<u8>>,
}

/// Shows no key.
impl std::fmt::Debug for Material {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Material").finish_non_exhaustive()
    }
}

impl Material {
    fn read(files: &TlsFiles) -> Result<Self, TlsError> {
        let client_ca = files.client_ca.as_deref().map(bytes).transpose()?;
        Ok(Self { cert: bytes(&files.cert)?, key: bytes(&files.key)?, client_ca })
    }

    /// The configuration of handshakes, and the validity of the certificate if readable.
    fn config(&self, files: &TlsFiles) -> Result<(ServerConfig, Option<Validity>), TlsError> {
        let chain = certificates(&files.cert, &self.cert)?;
        let key = PrivateKeyDer::from_pem_slice(&self.key).map_err(|error| {
            let why = format!(": {error}");
            TlsError::Missing { file: files.key.clone(), what: "private key", why }
        })?;
        let validity = chain.first().and_then(|first| X509Certificate::from_der(first).ok());
        let validity = validity.map(|(_, certificate)| certificate.validity().clone());
        let pair = |error: rustls::Error| TlsError::Pair {
            cert: files.cert.clone(),
            key: files.key.clone(),
            why: match error {
                rustls::Error::InconsistentKeys(_) => "they do not belong together".to_owned(),
                other => other.to_string(),
            },
        };
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let builder = ServerConfig::builder_with_provider(Arc::clone(&provider))
            .with_protocol_versions(&[&TLS13, &TLS12])
            .map_err(pair)?;
        let builder = match (&files.client_ca, &self.client_ca) {
            (Some(file), Some(bytes)) => {
                let cannot = |why: String| TlsError::Authorities { file: file.clone(), why };
                let mut roots = RootCertStore::empty();
                for authority in certificates(file, bytes)? {
                    roots.add(authority).map_err(|error| cannot(error.to_string()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider);
                builder.with_client_cert_verifier(verifier.build().map_err(|error| cannot(error.to_string()))?)
            }
            _ => builder.with_no_client_auth(),
        };
        let mut config = builder.with_single_cert(chain, key).map_err(pair)?;
        config.alpn_protocols = vec![HTTP2.to_vec()];
        Ok((config, validity))
    }
}

fn bytes(file: &Path) -> Result<Vec<u8>, TlsError> {
    read_regular(file, LONGEST_BYTES).map_err(|cause| TlsError::Read { file: file.to_owned(), cause })
}

/// The certificates in a file, at least one.
fn certificates(file: &Path, bytes: &[u8]) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let missing = |why: String| TlsError::Missing { file: file.to_owned(), what: "certificate", why };
    let all: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(bytes).collect();
    let all = all.map_err(|error| missing(format!(": {error}")))?;
    if all.is_empty() { Err(missing(String::new())) } else { Ok(all) }
}

#[cfg(test)]
mod tests {
    use rcgen::{CertifiedKey, generate_simple_self_signed};

    use super::*;

    fn files(folder: &Path) -> TlsFiles {
        let reload = std::time::Duration::from_secs(1);
        TlsFiles { cert: folder.join("cert"), key: folder.join("key"), client_ca: Some(folder.join("ca")), reload }
    }

    fn made(files: &TlsFiles) -> Result<(), String> {
        Material::read(files).and_then(|m| m.config(files)).map(|_| ()).map_err(|error| error.to_string())
    }

    #[test]
    fn what_does_not_fit_together_is_refused_with_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path());
        let [one, other] = [0, 1].map(|_| generate_simple_self_signed(["localhost".to_owned()]).unwrap());
        let CertifiedKey { cert, signing_key } = &one;
        let write = |file: &Path, text: &str| std::fs::write(file, text).unwrap();
        assert!(made(&files).unwrap_err().contains("cannot read"));
        write(&files.cert, &cert.pem());
        write(&files.key, &signing_key.serialize_pem());
        write(files.client_ca.as_deref().unwrap(), &other.cert.pem());
        made(&files).unwrap();

        write(&files.key, &other.signing_key.serialize_pem());
        assert!(made(&files).unwrap_err().contains("do not belong together"));
        write(&files.key, &cert.pem());
        assert!(made(&files).unwrap_err().contains("no private key"));
        write(&files.key, &signing_key.serialize_pem());
        for half in ["", "no PEM", &cert.pem()[..100]] {
            write(&files.cert, half);
            assert!(made(&files).unwrap_err().contains("no certificate"), "{half}");
        }
        write(&files.cert, &cert.pem());
        write(files.client_ca.as_deref().unwrap(), "");
        assert!(made(&files).unwrap_err().contains("ca holds no certificate"));
    }
}
