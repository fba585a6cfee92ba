//! Limits of connections.
//!
//! Invariant: every limit that a peer can meet is a field with a safe default. Must not know: how limits are enforced, the
//! options that set them.

use std::time::Duration;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConnectionLimits {
    /// Open connections, and those of one peer.
    pub max_connections: usize,
    pub max_connections_per_peer: usize,
    /// Open streams of a connection; without, as many as the service decides.
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
    /// Time for the answer to a ping; at least [`Self::stall`], since it waits behind the data of a slow reader.
    pub ping_timeout: Duration,
    /// For a new connection to send anything.
    pub first_byte: Duration,
    /// For a new connection to send its first request.
    pub first_request: Duration,
    /// For a connection without open streams.
    pub idle: Duration,
    /// For a client to take any of the bytes that wait for it.
    pub stall: Duration,
    pub handshakes: usize,
    /// For a TLS handshake, waiting for its turn included.
    pub handshake: Duration,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        Self {
            max_connections: 1024,
            max_connections_per_peer: 256,
            streams: None,
            header_bytes: 16 << 10,
            message_bytes: 4 << 20,
            pending_resets: 32,
            fault_resets: 256,
            control_frames: 1000,
            ping_every: Duration::from_secs(20),
            ping_timeout: Duration::from_secs(60),
            first_byte: Duration::from_secs(10),
            first_request: Duration::from_secs(20),
            idle: Duration::from_secs(300),
            stall: Duration::from_secs(120),
            handshakes: 256,
            handshake: Duration::from_secs(10),
        }
    }
}
