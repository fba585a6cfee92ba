//! The order of an upload's messages: a header, chunks, an end mark.
//!
//! Purpose: [`Upload`] takes messages one by one and gives everything when the end mark comes. Invariant: the header's counts
//! are checked before anything is kept; any other order is refused. Must not know: where messages come from, memory, jobs.

use super::WireError;
use super::assemble::{Assembly, Uploaded};
use super::attributes::{self, AttributeCounts};
use super::codec;
use super::counts::{self, Bounds, MeshCounts, Reads};
use super::options::{self, Beside, Diagram, Session};
use super::proto::{
    Chunk, ComputeRvdHeader, ComputeRvdRequest, CvtHeader, CvtRequest, MeshHeader, RemeshHeader, RemeshRequest,
    compute_rvd_request, cvt_request, remesh_request,
};
use geometry::remesh::RemeshOptions;
use geometry::rvd::BackendChoice;

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
    /// The options, checked.
    type Options;
    const READS: Reads;

    /// The mesh, the number of seeds that are uploaded, and the backend.
    fn parts(&self) -> (Option<&MeshHeader>, u64, i32);

    fn options(&self, beside: Beside, bounds: &Bounds) -> Result<Self::Options, WireError>;
}

#[derive(Clone, Debug)]
pub struct Checked<O> {
    pub mesh: MeshCounts,
    pub backend: BackendChoice,
    /// Arrays that are uploaded are empty.
    pub options: O,
    /// What the surface carries.
    pub attributes: Vec<AttributeCounts>,
}

pub type Complete<O> = (Checked<O>, Uploaded);

fn check<H: Header>(header: &H, bounds: &Bounds) -> Result<Checked<H::Options>, WireError> {
    let (of_mesh, seeds, backend) = header.parts();
    let backend = codec::backend(backend)?;
    let mesh = counts::mesh(of_mesh, seeds, H::READS, bounds)?;
    let beside = Beside {
        seeds: (seeds > 0).then_some(seeds),
        edge_lengths: mesh.edge_lengths > 0,
        weights: mesh.weights > 0,
        metric: mesh.metric > 0,
    };
    let options = header.options(beside, bounds).map_err(|error| error.under("options"))?;
    let attributes =
        attributes::check(of_mesh.map_or(&[], |mesh| &mesh.attributes), mesh).map_err(|error| error.under("mesh"))?;
    Ok(Checked { mesh, backend, options, attributes })
}

pub struct Upload<H: Header> {
    bounds: Bounds,
    open: Option<(Checked<H::Options>, Assembly)>,
}

impl<H: Header> Upload<H> {
    pub fn new(bounds: Bounds) -> Self {
        Self { bounds, open: None }
    }

    /// The header, once it has come and is in order.
    pub fn header(&self) -> Option<&Checked<H::Options>> {
        self.open.as_ref().map(|(header, _)| header)
    }

    /// Takes the next message, or `None` for the end of the stream. Gives what was uploaded once it
    /// is complete. `grow` is asked for memory before a chunk is kept.
    pub fn take<E: From<WireError>>(
        &mut self,
        message: Option<Incoming<H>>,
        grow: impl FnOnce(u64) -> Result<(), E>,
    ) -> Result<Option<Complete<H::Options>>, E> {
        let order = |text| Err(WireError::Order(text).into());
        match (message, self.open.take()) {
            (Some(Incoming::Header(header)), None) => {
                let checked = check(&header, &self.bounds).map_err(|error| error.under("header"))?;
                let assembly = Assembly::new(checked.mesh).announce(checked.mesh.facets, checked.attributes.clone());
                self.open = Some((checked, assembly));
                Ok(None)
            }
            (Some(_), None) => order("the first message must be the header"),
            (None, None) => order("the stream ended before the header"),
            (Some(Incoming::Chunk(chunk)), Some((header, mut assembly))) => {
                assembly.take(&chunk, grow)?;
                self.open = Some((header, assembly));
                Ok(None)
            }
            (Some(Incoming::End), Some((header, assembly))) => Ok(Some((header, assembly.finish()?))),
            (Some(Incoming::Header(_)), Some(_)) => order("a second header came"),
            (Some(Incoming::Other), Some(_)) => order("the upload goes on with chunks until it is finished"),
            (None, Some(_)) => order("the stream ended before the upload was finished"),
        }
    }
}

macro_rules! headers {
    ($($header:ty, $request:ty, $message:path, $end:ident; $check:path => $options:ty, $reads:expr;)*) => {$(
        impl Header for $header {
            type Options = $options;
            const READS: Reads = $reads;

            fn parts(&self) -> (Option<&MeshHeader>, u64, i32) {
                (self.mesh.as_ref(), self.seeds, self.backend)
            }

            fn options(&self, beside: Beside, bounds: &Bounds) -> Result<$options, WireError> {
                $check(&self.options.clone().unwrap_or_default(), beside, bounds)
            }
        }

        impl From<$request> for Incoming<$header> {
            fn from(request: $request) -> Self {
                use $message as Message;
                match request.message {
                    Some(Message::Header(header)) => Self::Header(header),
                    Some(Message::Chunk(chunk)) => Self::Chunk(chunk),
                    Some(Message::$end(_)) => Self::End,
                    #[allow(unreachable_patterns)]
                    _ => Self::Other,
                }
            }
        }
    )*};
}

headers! {
    ComputeRvdHeader, ComputeRvdRequest, compute_rvd_request::Message, Finish;
        options::diagram => Diagram, Reads { edge_lengths: false, features: false };
    CvtHeader, CvtRequest, cvt_request::Message, Start;
        options::session => Session, Reads { edge_lengths: true, features: false };
    RemeshHeader, RemeshRequest, remesh_request::Message, Finish;
        options::remesh => RemeshOptions, Reads { edge_lengths: true, features: true };
}
