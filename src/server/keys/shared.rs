//! Keys that several servers share.
//!
//! Purpose: the set of keys as a document of their database. Invariant: concurrent changes are not lost: each names the version that
//! it has seen, and is made again if that was another one. Must not know: SQL, the use of keys.

#[cfg(feature = "postgres")]
use jobs::postgres::Operator;
use jobs::store::shared::Document;

use super::{KeySet, KeysError};

/// The document's name.
pub const DOCUMENT: &str = "keys";

/// The keys of a document; none without one. Errors: `Shared` if it cannot be read.
pub(crate) fn of_document(document: Option<&Document>) -> Result<KeySet, KeysError> {
    document.map_or(Ok(KeySet::default()), |document| {
        KeySet::from_json(document.content.as_bytes()).map_err(KeysError::Shared)
    })
}

/// Errors: `Shared`.
#[cfg(feature = "postgres")]
pub async fn read_shared(operator: &Operator) -> Result<KeySet, KeysError> {
    of_document(operator.document(DOCUMENT).await.map_err(away)?.as_ref())
}

#[cfg(feature = "postgres")]
fn away(error: jobs::store::StoreError) -> KeysError {
    KeysError::Shared(error.to_string())
}

/// Changes the keys, unless `change` fails. Errors: `Shared`, and the errors of `change`.
#[cfg(feature = "postgres")]
pub async fn change_shared<R>(
    operator: &Operator,
    mut change: impl FnMut(&mut KeySet) -> Result<R, KeysError>,
) -> Result<R, KeysError> {
    loop {
        let document = operator.document(DOCUMENT).await.map_err(away)?;
        let mut set = of_document(document.as_ref())?;
        let changed = change(&mut set)?;
        let seen = document.map(|document| document.version);
        if operator.replace(DOCUMENT, seen, &set.to_json()).await.map_err(away)? {
            return Ok(changed);
        }
    }
}
