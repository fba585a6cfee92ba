//! TLS of a client: what it trusts and shows, and what went wrong with it, in words.
//!
//! Invariant: what TLS says of a failure becomes a sentence that says what to do; what is not known is said as TLS says it.
//! Must not know: calls.

use std::time::Duration;

use tonic::transport::{Certificate, ClientTlsConfig, Identity};

use crate::endpoint::ServerUrl;
use crate::trust::Trust;

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

pub(super) fn settings(trust: &Trust, limit: Duration) -> ClientTlsConfig {
    let settings = ClientTlsConfig::new().timeout(limit);
    let settings = match &trust.authorities {
        Some(pem) => settings.ca_certificate(Certificate::from_pem(pem)),
        None => settings.with_native_roots(),
    };
    match &trust.identity {
        Some((cert, key)) => settings.identity(Identity::from_pem(cert, key)),
        None => settings,
    }
}

/// What a failure of the connection to `url` means, if TLS has to do with it.
pub(super) fn meaning(url: &ServerUrl, cause: &str) -> Option<String> {
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
    use super::*;

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
            let meaning = meaning(&https, cause).unwrap();
            assert!(meaning.contains(words) && meaning.contains(cause) && meaning.contains("https://a:1"), "{meaning}");
        }
        assert_eq!(meaning(&https, "Connection refused"), None);
        assert_eq!(meaning(&http, "Connection refused"), None);
        assert!(meaning(&http, "frame with invalid size").unwrap().contains("write https://a:1"));
    }
}
