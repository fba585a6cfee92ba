//! The order of an upload's messages: a header, chunks, an end mark.
//!
//! Purpose: [`Upload`] takes messages one by one and gives everything when the end mark comes.
//! Invariant: the header's counts are checked before anything is kept; any other order is refused.
//! Must not know: where messages come from, who owns the memory, jobs.

use super::WireError;
use super::assemble::{Assembly, Uploaded};
use super::attributes::AttributeCounts;
use super::counts::{Bounds, MeshCounts, SeedCounts};
use super::proto::Chunk;

/// What a message of an upload is, whatever its type.
pub enum Incoming<H> {
    Header(H),
    Chunk(Chunk),
    End,
    /// Nothing that belongs into an upload, or an empty message.
    Other,
}

/// What headers have in common.
pub trait Header {
    /// Checks everything in it.
    fn check(&self, bounds: &Bounds) -> Result<(MeshCounts, SeedCounts), WireError>;

    /// Which backend it asks for.
    fn backend(&self) -> i32;

    /// Checks what the mesh is said to carry.
    fn attributes(&self, _mesh: MeshCounts) -> Result<Vec<AttributeCounts>, WireError> {
        Ok(Vec::new())
    }
}

/// See the module's head.
pub struct Upload<H> {
    bounds: Bounds,
    open: Option<(H, SeedCounts, Assembly)>,
}

impl<H: Header> Upload<H> {
    /// Nothing has come yet.
    pub fn new(bounds: Bounds) -> Self {
        Self { bounds, open: None }
    }

    /// The header, once it has come and is in order.
    pub fn header(&self) -> Option<&H> {
        self.open.as_ref().map(|(header, ..)| header)
    }

    /// Takes the next message, or `None` for the end of the stream. Gives what was uploaded once it
    /// is complete. `grow` is asked for memory before a chunk is kept.
    pub fn take<E: From<WireError>>(
        &mut self,
        message: Option<Incoming<H>>,
        grow: impl FnOnce(u64) -> Result<(), E>,
    ) -> Result<Option<(H, SeedCounts, Uploaded)>, E> {
        let order = |text| Err(WireError::Order(text).into());
        match (message, self.open.take()) {
            (Some(Incoming::Header(header)), None) => {
                let (mesh, seeds) = header.check(&self.bounds)?;
                let assembly = Assembly::new(mesh, seeds).announce(mesh.facets, header.attributes(mesh)?);
                self.open = Some((header, seeds, assembly));
                Ok(None)
            }
            (Some(_), None) => order("the first message must be the header"),
            (None, None) => order("the stream ended before the header"),
            (Some(Incoming::Chunk(chunk)), Some((header, seeds, mut assembly))) => {
                assembly.take(&chunk, grow)?;
                self.open = Some((header, seeds, assembly));
                Ok(None)
            }
            (Some(Incoming::End), Some((header, seeds, assembly))) => Ok(Some((header, seeds, assembly.finish()?))),
            (Some(Incoming::Header(_)), Some(_)) => order("a second header came"),
            (Some(Incoming::Other), Some(_)) => order("the upload goes on with chunks until it is finished"),
            (None, Some(_)) => order("the stream ended before the upload was finished"),
        }
    }
}
