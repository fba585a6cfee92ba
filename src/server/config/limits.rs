//! Limits of a request, of a connection, and of all together.
//!
//! Invariant: the defaults equal those of the command line; a test compares them.
//! Must not know: how limits are enforced.

use std::time::Duration;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    pub max_vertices: u64,
    pub max_facets: u64,
    pub max_seeds: u64,
    pub max_iterations: u32,
    pub max_streams: usize,
    pub max_sessions: usize,
    /// Uploaded geometry and waiting results in memory, all streams together, bytes.
    pub memory_bytes: u64,
    pub max_connections: usize,
    pub max_connections_per_peer: usize,
    /// For a new connection to send its first request.
    pub first_request: Duration,
    /// For a connection without open streams.
    pub idle_connection: Duration,
    /// For a whole upload.
    pub upload: Duration,
    /// Between two messages of an upload.
    pub upload_idle: Duration,
    /// Between two commands of a session.
    pub session_idle: Duration,
    /// For a client to take any of the bytes that wait for it.
    pub stall: Duration,
    /// For work to end after the shutdown began.
    pub grace: Duration,
    /// Between two probes of an idle backend.
    pub probe: Duration,
    pub transport: Transport,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_vertices: 20_000_000,
            max_facets: 40_000_000,
            max_seeds: 4_000_000,
            max_iterations: 10_000,
            max_streams: 256,
            max_sessions: 16,
            memory_bytes: 4 << 30,
            max_connections: 1024,
            max_connections_per_peer: 256,
            first_request: Duration::from_secs(20),
            idle_connection: Duration::from_secs(300),
            upload: Duration::from_secs(1800),
            upload_idle: Duration::from_secs(60),
            session_idle: Duration::from_secs(600),
            stall: Duration::from_secs(120),
            grace: Duration::from_secs(30),
            probe: Duration::from_secs(60),
            transport: Transport::default(),
        }
    }
}

/// Limits of a connection: errors, frames and silence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transport {
    /// Open streams of a connection; default: all streams plus [`Self::EXTRA_STREAMS`].
    pub streams: Option<u32>,
    /// All headers of a request, bytes.
    pub header_bytes: u32,
    /// Size of a message, bytes, compressed and uncompressed.
    pub message_bytes: usize,
    /// Streams that the client reset before the server processed them.
    pub pending_resets: usize,
    /// Streams that were reset for faults of the client.
    pub fault_resets: usize,
    /// Frames of a connection a second that carry neither a request nor its bytes.
    pub control_frames: u32,
    /// Between two pings, which keep boxes between here and the client from forgetting the connection.
    pub ping_every: Duration,
    /// Time for the answer to a ping; at least the time that a stream may stall, since it waits behind the data of a slow
    /// reader.
    pub ping_timeout: Duration,
    /// For a new connection to send anything.
    pub first_byte: Duration,
    pub handshakes: usize,
    /// For a TLS handshake, waiting for its turn included.
    pub handshake: Duration,
}

impl Transport {
    /// Streams of a connection for health and reflection.
    pub const EXTRA_STREAMS: usize = 16;
}

impl Default for Transport {
    fn default() -> Self {
        Self {
            streams: None,
            header_bytes: 16 << 10,
            message_bytes: 4 << 20,
            pending_resets: 32,
            fault_resets: 256,
            control_frames: 1000,
            ping_every: Duration::from_secs(20),
            ping_timeout: Duration::from_secs(60),
            first_byte: Duration::from_secs(10),
            handshakes: 256,
            handshake: Duration::from_secs(10),
        }
    }
}
