//! The files of TLS, and the configuration made of them.
//!
//! Invariant: a mismatch of certificate and key is refused, and so is a file without its expected content. One provider of
//! cryptography: ring.
//! Must not know: when files are read.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::WebPkiClientVerifier;
use rustls::version::{TLS12, TLS13};
use rustls::{RootCertStore, ServerConfig};
use x509_parser::certificate::{Validity, X509Certificate};
use x509_parser::prelude::FromDer;

use crate::config::TlsFiles;
use crate::keys::read_regular;
use jobs::blob::Digest;

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

pub(super) struct Material {
    cert: Vec<u8>,
    key: Vec<u8>,
    client_ca: Option<Vec<u8>>,
}

impl Material {
    pub(super) fn read(files: &TlsFiles) -> Result<Self, TlsError> {
        let client_ca = files.client_ca.as_deref().map(bytes).transpose()?;
        Ok(Self { cert: bytes(&files.cert)?, key: bytes(&files.key)?, client_ca })
    }

    pub(super) fn digest(&self) -> Digest {
        let parts = [Some(&self.cert), Some(&self.key), self.client_ca.as_ref()];
        let digests = parts.map(|part| part.map(|bytes| Digest::of(bytes).to_string()));
        Digest::of(format!("{digests:?}").as_bytes())
    }

    /// The configuration of handshakes, and the validity of the certificate if readable.
    pub(super) fn config(&self, files: &TlsFiles) -> Result<(ServerConfig, Option<Validity>), TlsError> {
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
        let digest = Material::read(&files).unwrap().digest();
        assert_eq!(digest, Material::read(&files).unwrap().digest());

        write(&files.key, &other.signing_key.serialize_pem());
        assert!(made(&files).unwrap_err().contains("do not belong together"));
        assert_ne!(digest, Material::read(&files).unwrap().digest());
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
