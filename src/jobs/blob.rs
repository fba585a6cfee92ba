//! Content-addressed storage: meshes, arrays and results, named by the SHA-256 of their bytes.
//!
//! Purpose: [`BlobStore`] keeps blobs between requests. [`ObjectBlobs`] implements it on a folder, in memory, or on any
//! store that speaks S3. Invariant: a blob is visible only when all of its bytes are stored and their digest is right. The
//! bytes of blobs and uploads together stay within the quota. A pinned blob is never evicted. A refused call leaves no byte
//! behind. Bytes are stored once, and visible only to the tenants that uploaded them or got them as a result. [`index`]
//! says what may be stored and removed; the rest of the room moves bytes. Must not know: what the bytes mean, jobs, or the
//! wire.

mod cache;
mod chunk;
mod digest;
mod error;
pub mod index;
mod objects;
mod owners;
mod reader;
#[cfg(feature = "s3")]
mod s3;
mod staging;
mod store;
mod upload;

#[cfg(feature = "postgres")]
pub(crate) use chunk::NO_OWNER;
pub use chunk::{Chunk, MAX_CHUNK_BYTES, UploadId, UploadStatus};
pub use digest::{Digest, DigestError};
pub(crate) use digest::{from_hex, to_hex};
pub use error::BlobError;
pub use objects::ObjectBlobs;
#[cfg(feature = "postgres")]
pub(crate) use owners::MOST as MOST_OWNERS;
pub use owners::Owner;
pub use store::{BlobInfo, BlobOptions, BlobRead, BlobStore, ByteStream, CacheUse, READ_BYTES, Usage, put, put_of};
