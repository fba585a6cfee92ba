//! `#[needs(...)]` on a test that cannot run everywhere.
//!
//! Purpose: the test runner reports a test as *ignored*, with the reason, if this machine lacks what it needs. A test that
//! returns early is reported as passed, which nobody notices. Invariant: with everything there the test is as written.
//! Must not know: how a test gets at what it needs.

use proc_macro::{TokenStream, TokenTree};

/// What a test may need, and why it is not there; empty if it is.
const NEEDS: [(&str, &str); 4] = [
    ("gpu", env!("NEEDS_GPU")),
    ("meshes", env!("NEEDS_MESHES")),
    ("postgres", env!("NEEDS_POSTGRES")),
    ("seeds", env!("NEEDS_SEEDS")),
];

/// Ignores a test without what it needs: `gpu` (a Vulkan driver, software too), `meshes` (the folder `TESSERA_MESHES`),
/// `postgres` (the programs of PostgreSQL), `seeds` (the folder `TESSERA_SEEDS`). Write it above `#[test]`, with one name or more.
#[proc_macro_attribute]
pub fn needs(names: TokenStream, test: TokenStream) -> TokenStream {
    let mut missing = "";
    for token in names {
        let name = match &token {
            TokenTree::Punct(comma) if comma.as_char() == ',' => continue,
            token => token.to_string(),
        };
        match NEEDS.iter().find(|(known, _)| *known == name) {
            Some((_, why)) if missing.is_empty() => missing = why,
            Some(_) => {}
            None => {
                return written(&format!(
                    "compile_error!(\"no test can need `{name}`: say gpu, meshes, postgres or seeds\");"
                ));
            }
        }
    }
    match missing.is_empty() {
        true => test,
        false => written(&format!("#[ignore = {missing:?}]")).into_iter().chain(test).collect(),
    }
}

/// Tokens of a text that is known to have some.
fn written(text: &str) -> TokenStream {
    text.parse().unwrap_or_default()
}
