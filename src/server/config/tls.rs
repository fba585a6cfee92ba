//! Which files TLS is made of.
//!
//! Must not know: their content.

use std::path::PathBuf;
use std::time::Duration;

/// The files of TLS.
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
