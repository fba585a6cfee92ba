//! The headers of the three streams, and which of their messages belong to an upload.
//!
//! Invariant: a header that passes needs no other check but of its arrays. Must not know: what a stream does.

use super::WireError;
use super::counts::{Bounds, Reads};
use super::options::{self, Beside, Diagram, Session};
use super::proto::{
    ComputeRvdHeader, ComputeRvdRequest, CvtHeader, CvtRequest, MeshHeader, RemeshHeader, RemeshRequest,
};
use super::proto::{compute_rvd_request, cvt_request, remesh_request};
use super::upload::{Header, Incoming};
use geometry::remesh::RemeshOptions;

macro_rules! header {
    ($header:ty, $options:ty, $check:path, $reads:expr, $request:ty, $message:path, $end:path) => {
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
                    Some($end(_)) => Self::End,
                    #[allow(unreachable_patterns)]
                    _ => Self::Other,
                }
            }
        }
    };
}

header!(
    ComputeRvdHeader,
    Diagram,
    options::diagram,
    Reads { edge_lengths: false, features: false },
    ComputeRvdRequest,
    compute_rvd_request::Message,
    compute_rvd_request::Message::Finish
);
header!(
    CvtHeader,
    Session,
    options::session,
    Reads { edge_lengths: true, features: false },
    CvtRequest,
    cvt_request::Message,
    cvt_request::Message::Start
);
header!(
    RemeshHeader,
    RemeshOptions,
    options::remesh,
    Reads { edge_lengths: true, features: true },
    RemeshRequest,
    remesh_request::Message,
    remesh_request::Message::Finish
);
