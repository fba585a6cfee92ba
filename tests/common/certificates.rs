//! Authorities and certificates, made for a test.

use std::path::{Path, PathBuf};
use std::time::Duration;

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair, KeyUsagePurpose};
use transport::TlsFiles;

/// Who vouches for certificates.
pub struct Authority(CertifiedIssuer<'static, KeyPair>);

/// A certificate and its key, in PEM.
pub struct Shown {
    pub cert: String,
    pub key: String,
    /// In DER.
    pub der: Vec<u8>,
}

/// When a certificate is good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Age {
    Good,
    Expired,
}

impl Authority {
    pub fn new(name: &str) -> Self {
        let mut params = CertificateParams::default();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        Self(CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap())
    }

    pub fn pem(&self) -> String {
        self.0.pem()
    }

    /// Vouches for `names`.
    pub fn vouch(&self, names: &[&str], age: Age) -> Shown {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let mut params = CertificateParams::new(names).unwrap();
        params.distinguished_name.push(DnType::CommonName, "test");
        if age == Age::Expired {
            params.not_before = rcgen::date_time_ymd(2020, 1, 1);
            params.not_after = rcgen::date_time_ymd(2020, 2, 1);
        }
        let key = KeyPair::generate().unwrap();
        let cert = params.signed_by(&key, &self.0).unwrap();
        Shown { cert: cert.pem(), key: key.serialize_pem(), der: cert.der().to_vec() }
    }
}

/// A server's files in `folder`.
pub fn files(folder: &Path, shown: &Shown, clients: Option<&Authority>) -> TlsFiles {
    let files = TlsFiles {
        cert: folder.join("cert.pem"),
        key: folder.join("key.pem"),
        client_ca: clients.map(|_| folder.join("clients.pem")),
        reload: Duration::from_secs(3600),
    };
    write(&files, shown);
    if let (Some(file), Some(clients)) = (&files.client_ca, clients) {
        std::fs::write(file, clients.pem()).unwrap();
    }
    files
}

/// Puts another certificate there.
pub fn write(files: &TlsFiles, shown: &Shown) {
    std::fs::write(&files.key, &shown.key).unwrap();
    std::fs::write(&files.cert, &shown.cert).unwrap();
}

/// A file of its own.
pub fn file(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}
