//! The certificates of the server, and their replacement.
//!
//! Purpose: [`Tls`] holds the configuration of new handshakes, and [`Tls::follow`] reloads its files.
//! Invariant: the configuration in use is complete and consistent. If the files are invalid, incomplete or out of date, the
//! old one stays in use, and the log says so once. Open connections keep their configuration.
//! Must not know: connections.

mod material;

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rustls::ServerConfig;
use tokio::sync::Notify;
use x509_parser::certificate::Validity;

use self::material::Material;
pub use self::material::TlsError;
use crate::config::TlsFiles;
use jobs::blob::Digest;
use jobs::lock;

/// The log warns of a certificate that ends within this time.
const WARN_BEFORE: Duration = Duration::from_secs(14 * 24 * 3600);

/// Time between two such warnings.
const WARN_EVERY: Duration = Duration::from_secs(24 * 3600);

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
    /// Digest of the files in use.
    active: Digest,
    /// Digest of the files of the last complaint in the log.
    complained: Option<Digest>,
    warned: Option<Instant>,
}

impl Tls {
    /// Reads the files.
    ///
    /// # Errors
    /// [`TlsError`] names the file and the remedy.
    pub fn load(files: TlsFiles) -> Result<Self, TlsError> {
        let material = Material::read(&files)?;
        let (config, validity) = material.config(&files)?;
        let state = State {
            web: with_http1(&config),
            config: Arc::new(config),
            validity,
            active: material.digest(),
            complained: None,
            warned: None,
        };
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
        let digest = match &read {
            Ok(material) => material.digest(),
            Err(error) => Digest::of(error.to_string().as_bytes()),
        };
        if lock(&self.state).active == digest {
            lock(&self.state).complained = None;
            return;
        }
        let made = read.and_then(|material| {
            let (config, validity) = material.config(&self.files)?;
            match validity.as_ref().is_some_and(|validity| !validity.is_valid()) {
                true => Err(TlsError::OutOfDate { file: self.files.cert.clone() }),
                false => Ok((config, validity)),
            }
        });
        let mut state = lock(&self.state);
        match made {
            Ok((config, validity)) => {
                let until = validity.as_ref().map(until);
                let (web, config, active) = (with_http1(&config), Arc::new(config), digest);
                *state = State { config, web, validity, active, complained: None, warned: None };
                tracing::info!(until, "new connections get the new certificate");
            }
            Err(error) if state.complained != Some(digest) => {
                state.complained = Some(digest);
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
