//! The OpenAPI document as a page for people.
//!
//! Purpose: [`serve`] answers with a page that is made of the document once. Invariant: the page runs no script and loads
//! nothing; all of its text is escaped. Must not know: single routes.

use std::fmt::Write;
use std::sync::LazyLock;

use axum::http::HeaderName;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use serde_json::Value;

use super::{ROUTES, openapi};

const POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color-scheme:light dark}\
    h2{margin:2.5rem 0 .25rem;font-size:1.15rem}h2 b{margin-right:.5rem}code,h2{font-family:ui-monospace,monospace}\
    table{border-collapse:collapse;width:100%}td,th{text-align:left;vertical-align:top;padding:.25rem .75rem .25rem 0;\
    border-bottom:1px solid #8884}h3{font-size:1rem;margin:1rem 0 .25rem}";

static PAGE: LazyLock<String> = LazyLock::new(|| page(&openapi::document(ROUTES)));

pub(super) async fn serve() -> Response {
    let headers: [(HeaderName, &str); 3] =
        [(CONTENT_TYPE, "text/html; charset=utf-8"), (CACHE_CONTROL, "no-cache"), (CONTENT_SECURITY_POLICY, POLICY)];
    (headers, PAGE.as_str()).into_response()
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn text<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or_default()
}

fn entries(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flatten()
}

/// A schema in a few words.
fn shape(schema: &Value) -> String {
    let words = |list: &Value| {
        let words = list.as_array().into_iter().flatten().filter_map(|word| word.as_str().map(str::to_owned));
        words.collect::<Vec<_>>().join(", ")
    };
    match (&schema["enum"], &schema["type"]) {
        (words_of @ Value::Array(_), _) => words(words_of),
        (_, Value::String(name)) => name.clone(),
        (_, names @ Value::Array(_)) => words(names),
        _ => text(schema, "$ref").rsplit('/').next().unwrap_or_default().to_owned(),
    }
}

fn page(document: &Value) -> String {
    let info = &document["info"];
    let mut out = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{0}: HTTP</title><style>{STYLE}</style><h1>{0}: HTTP</h1><p>{1}</p>\
         <p>For programs: <a href=\"/v1/openapi.json\">openapi.json</a>. <a href=\"/\">The page</a>.</p>",
        escaped(text(info, "title")),
        escaped(text(info, "description")),
    );
    for (path, methods) in entries(&document["paths"]) {
        for (method, operation) in entries(methods) {
            let _ = write!(
                out,
                "<section id=\"{}\"><h2><b>{}</b>{}</h2><p>{}. {}</p>",
                escaped(text(operation, "operationId")),
                escaped(&method.to_uppercase()),
                escaped(path),
                escaped(text(operation, "summary")),
                escaped(text(operation, "description")),
            );
            parameters(&mut out, &operation["parameters"]);
            let media: Vec<String> =
                entries(&operation["requestBody"]["content"]).map(|(media, _)| escaped(media)).collect();
            if !media.is_empty() {
                let _ = write!(out, "<h3>Body</h3><p><code>{}</code></p>", media.join("</code>, <code>"));
            }
            out.push_str("<h3>Answers</h3><table>");
            for (status, answer) in entries(&operation["responses"]) {
                let told = match answer["$ref"].is_string() {
                    true => "A problem (<code>application/problem+json</code>). Programs read <code>reason</code>."
                        .to_owned(),
                    false => escaped(text(answer, "description")),
                };
                let _ = write!(out, "<tr><td><code>{}</code><td>{told}", escaped(status));
            }
            out.push_str("</table></section>");
        }
    }
    out
}

fn parameters(out: &mut String, all: &Value) {
    let all = all.as_array().map(Vec::as_slice).unwrap_or_default();
    if all.is_empty() {
        return;
    }
    out.push_str("<h3>Parameters</h3><table>");
    for parameter in all {
        let _ = write!(
            out,
            "<tr><td><code>{}</code><td>{}<td>{}<td>{}",
            escaped(text(parameter, "name")),
            escaped(text(parameter, "in")),
            escaped(&shape(&parameter["schema"])),
            escaped(text(parameter, "description")),
        );
    }
    out.push_str("</table>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_route_and_its_parameters_are_there() {
        for route in ROUTES {
            assert!(PAGE.contains(&format!("<b>{}</b>{}</h2>", route.method, escaped(route.path))), "{}", route.path);
        }
        assert!(PAGE.contains("<code>max_deviation</code>") && PAGE.contains("multipart/form-data"));
        assert!(!PAGE.contains("<script"));
        assert_eq!(escaped("<a href=\"x\">&"), "&lt;a href=&quot;x&quot;&gt;&amp;");
    }
}
