//! How fast a large blob goes up and comes down on loopback, and what memory that takes.
//!
//! Client and server share the process, so that the figures are of both:
//! `cargo test --release --test service blob_speed -- --ignored --nocapture`. `TESSERA_BLOB_FOLDER` says where blobs lie.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use prost::bytes::{Bytes, BytesMut};
use sha2::Digest as _;
use tessera::internals::blob::{BlobOptions, Digest};
use tessera::proto::blob_service_client::BlobServiceClient;
use tessera::proto::*;

use crate::server::*;

const MB: u64 = 1_000_000;
const SIZE: u64 = 500 * MB;
const PIECE: u64 = 1 << 20;

/// Memory that the process holds, bytes; 0 where the system does not say.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmRSS:"));
    line.and_then(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok()).unwrap_or(0) * 1024
}

/// The most memory from `new` on.
struct Watch(Arc<(AtomicBool, AtomicU64)>, u64);

impl Watch {
    fn new() -> Self {
        let state = Arc::new((AtomicBool::new(true), AtomicU64::new(0)));
        let seen = Arc::clone(&state);
        std::thread::spawn(move || {
            while seen.0.load(Ordering::Relaxed) {
                seen.1.fetch_max(resident(), Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        Self(state, resident())
    }

    fn moved_mib(self) -> f64 {
        self.0.0.store(false, Ordering::Relaxed);
        self.0.1.load(Ordering::Relaxed).saturating_sub(self.1) as f64 / (1 << 20) as f64
    }
}

/// A piece of the blob, made anew each time.
fn piece(block: &[u8], offset: u64) -> Bytes {
    let mut bytes = BytesMut::from(&block[..PIECE.min(SIZE - offset) as usize]);
    bytes[..8].copy_from_slice(&offset.to_le_bytes());
    bytes.freeze()
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a measurement; see the head of the file"]
async fn speed() {
    let block: Vec<u8> = (0..PIECE as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let offsets = || (0..SIZE).step_by(PIECE as usize);
    let mut sha = sha2::Sha256::new();
    offsets().for_each(|offset| sha.update(piece(&block, offset)));
    let digest = Digest::from(<[u8; 32]>::from(sha.finalize())).to_string();
    let folder = match std::env::var_os("TESSERA_BLOB_FOLDER") {
        Some(folder) => tempfile::tempdir_in(folder).unwrap(),
        None => tempfile::tempdir().unwrap(),
    };
    for fsync in [true, false] {
        let blobs = BlobOptions::default().with_fsync(fsync);
        let server = Server::start(Setup { blobs, folder: Some(folder.path().to_owned()), ..Setup::default() }).await;
        let mut client = BlobServiceClient::new(server.channel().await);
        let (block, named) = (block.clone(), digest.clone());
        let (watch, begin) = (Watch::new(), Instant::now());
        let messages = offsets().map(move |offset| {
            let data = piece(&block, offset);
            let crc32c = crc32c::crc32c(&data);
            let finish = offset + PIECE >= SIZE;
            WriteRequest { digest: named.clone(), size_bytes: SIZE, offset, data, crc32c, finish }
        });
        let done = client.write(tokio_stream::iter(messages)).await.unwrap().into_inner();
        assert!(done.complete);
        let (up_s, up_moved) = (begin.elapsed().as_secs_f64(), watch.moved_mib());
        let (watch, begin) = (Watch::new(), Instant::now());
        let question = ReadRequest { digest: digest.clone(), offset: 0, limit_bytes: 0 };
        let mut pieces = client.read(question).await.unwrap().into_inner();
        let mut read = 0;
        while let Some(piece) = pieces.message().await.unwrap() {
            assert_eq!(crc32c::crc32c(&piece.data), piece.crc32c);
            read += piece.data.len() as u64;
        }
        assert_eq!(read, SIZE);
        let (down_s, down_moved) = (begin.elapsed().as_secs_f64(), watch.moved_mib());
        client.delete(DeleteRequest { digest: digest.clone() }).await.unwrap();
        server.stop().await.unwrap();
        let rate = |seconds: f64| (SIZE / MB) as f64 / seconds;
        println!(
            "{{\"blob_mb\": {}, \"fsync\": {fsync}, \"up_mb_s\": {:.0}, \"up_memory_moved_mib\": {up_moved:.1}, \
             \"down_mb_s\": {:.0}, \"down_memory_moved_mib\": {down_moved:.1}}}",
            SIZE / MB,
            rate(up_s),
            rate(down_s),
        );
    }
}
