//! The page for browsers: files that are part of the program.
//!
//! Purpose: [`serve`] answers with a file of `ui/dist`. Invariant: the page needs no key, since a browser sends none for it, and
//! holds nothing that is anybody's: what it shows comes by the routes, with their keys. Its policy lets it load and ask nothing
//! but this server. Must not know: what the page does.

use axum::body::Body;
use axum::extract::Request;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, HeaderName, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use rust_embed::RustEmbed;

use super::blobs::is_known;

/// Paths of files, of the page itself `/`.
pub(super) const PATHS: [&str; 2] = ["/", "/ui/{file}"];

#[derive(RustEmbed)]
#[folder = "../../ui/dist"]
struct Files;

/// What the page may load and ask: scripts, styles, pictures and answers of this server.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
     connect-src 'self'; worker-src 'self'; font-src 'self'; base-uri 'none'; form-action 'none'; \
     frame-ancestors 'none'";

const SAME_ORIGIN: &str = "same-origin";

fn media_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("txt") => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

fn name(uri: &Uri) -> &str {
    match uri.path().strip_prefix("/ui/") {
        Some(name) => name,
        None => "index.html",
    }
}

pub(super) async fn serve(request: Request) -> Response {
    let name = name(request.uri());
    let Some(file) = Files::get(name) else {
        return (StatusCode::NOT_FOUND, [(CONTENT_TYPE, "text/plain; charset=utf-8")], "There is no such file.\n")
            .into_response();
    };
    let tag: String = file.metadata.sha256_hash().iter().map(|byte| format!("{byte:02x}")).collect();
    let tag = format!("\"{tag}\"");
    let is_known = is_known(request.headers(), &tag);
    let headers = [
        (CONTENT_TYPE, media_type(name)),
        (ETAG, &tag),
        (CACHE_CONTROL, "no-cache"),
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-opener-policy"), SAME_ORIGIN),
        (HeaderName::from_static("cross-origin-resource-policy"), SAME_ORIGIN),
    ];
    if is_known {
        return (StatusCode::NOT_MODIFIED, headers).into_response();
    }
    (headers, Body::from(file.data)).into_response()
}
