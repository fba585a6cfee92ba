//! Trust and identity of a client over TLS.
//!
//! Purpose: the options of every command that asks a server, and [`Trust`] with what their files hold. Invariant: files are
//! read before any work, and a key is never shown. Must not know: connections.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;

use super::endpoint::ServerUrl;
use super::exit::{NoInput, Usage};

/// The options.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct TrustArgs {
    /// File with the authorities that vouch for the server, in PEM; those of the system if not given. For https:// alone.
    #[arg(long, value_name = "FILE", global = true, env = "TESSERA_CA")]
    pub(crate) ca: Option<PathBuf>,
    /// File with the client's certificate, in PEM.
    #[arg(long, value_name = "FILE", global = true, env = "TESSERA_CLIENT_CERT")]
    pub(crate) client_cert: Option<PathBuf>,
    /// File with that certificate's private key, in PEM.
    #[arg(long, value_name = "FILE", global = true, env = "TESSERA_CLIENT_KEY")]
    pub(crate) client_key: Option<PathBuf>,
}

/// What the files hold; nothing if the system's authorities are to be trusted and nothing is shown.
#[derive(Clone, Default)]
pub(crate) struct Trust {
    pub(crate) authorities: Option<Vec<u8>>,
    pub(crate) identity: Option<(Vec<u8>, Vec<u8>)>,
}

impl fmt::Debug for Trust {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Trust").finish_non_exhaustive()
    }
}

impl TrustArgs {
    pub(crate) fn read(&self, url: &ServerUrl) -> Result<Trust> {
        let given = [("--ca", &self.ca), ("--client-cert", &self.client_cert), ("--client-key", &self.client_key)];
        if let Some((option, _)) = given.iter().find(|(_, file)| file.is_some())
            && !url.has_tls()
        {
            let text = format!("{option} is for https, and {url} is not; write {}", url.with_tls());
            return Err(Usage(text).into());
        }
        let identity = match (&self.client_cert, &self.client_key) {
            (Some(cert), Some(key)) => Some((bytes(cert)?, bytes(key)?)),
            (None, None) => None,
            (Some(_), None) => return Err(Usage("--client-cert needs --client-key, its private key".into()).into()),
            (None, Some(_)) => return Err(Usage("--client-key needs --client-cert, its certificate".into()).into()),
        };
        Ok(Trust { authorities: self.ca.as_deref().map(bytes).transpose()?, identity })
    }
}

fn bytes(path: &Path) -> Result<Vec<u8>, NoInput> {
    std::fs::read(path).map_err(|cause| NoInput { path: path.to_owned(), cause })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exit::code;

    #[test]
    fn what_does_not_go_together_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pem");
        std::fs::write(&file, "x").unwrap();
        let (file, none) = (Some(file), Some(folder.path().join("none")));
        let [https, http] = ["https://a:1", "http://a:1"].map(|url| url.parse::<ServerUrl>().unwrap());
        let all = TrustArgs { ca: file.clone(), client_cert: file.clone(), client_key: file.clone() };
        assert!(all.read(&https).unwrap().identity.is_some());
        assert!(!format!("{:?}", all.read(&https).unwrap()).contains("120"), "no bytes are shown");
        for (args, url, exit, words) in [
            (TrustArgs { ca: file.clone(), ..TrustArgs::default() }, &http, 2, "write https://a:1"),
            (TrustArgs { client_cert: file.clone(), ..TrustArgs::default() }, &https, 2, "needs --client-key"),
            (TrustArgs { client_key: file.clone(), ..TrustArgs::default() }, &https, 2, "needs --client-cert"),
            (TrustArgs { ca: none, ..TrustArgs::default() }, &https, 66, "cannot read"),
        ] {
            let error = args.read(url).unwrap_err();
            assert!(code(&error) == exit && error.to_string().contains(words), "{error}");
        }
        assert!(TrustArgs::default().read(&http).is_ok());
    }
}
