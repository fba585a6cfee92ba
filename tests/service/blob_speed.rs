//! How fast a large blob goes up and comes down on loopback, and what memory that takes.
//!
//! Client and server share the process, so that the figures are of both:
//! `cargo test --release --test service blob_speed -- --ignored --nocapture`. `TESSERA_BLOB_FOLDER` says where blobs lie.

use std::time::Instant;

use jobs::blob::{BlobOptions, Digest};
use prost::bytes::{Bytes, BytesMut};
use sha2::Digest as _;
use tessera::proto::blob_service_client::BlobServiceClient;
use tessera::proto::*;

use crate::process::MemoryPeak;
use crate::server::*;

const MB: u64 = 1_000_000;
const SIZE: u64 = 500 * MB;
const PIECE: u64 = 1 << 20;

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
        let blobs = BlobOptions { fsync, ..BlobOptions::default() };
        let server = Server::start(Setup { blobs, folder: Some(folder.path().to_owned()), ..Setup::default() }).await;
        let mut client = BlobServiceClient::new(server.channel().await);
        let (block, named) = (block.clone(), digest.clone());
        let (watch, begin) = (MemoryPeak::new(), Instant::now());
        let messages = offsets().map(move |offset| {
            let data = piece(&block, offset);
            let crc32c = crc32c::crc32c(&data);
            let finish = offset + PIECE >= SIZE;
            WriteRequest { digest: named.clone(), size_bytes: SIZE, offset, data, crc32c, finish }
        });
        let done = client.write(tokio_stream::iter(messages)).await.unwrap().into_inner();
        assert!(done.complete);
        let (up_s, up_moved) = (begin.elapsed().as_secs_f64(), watch.grown_mib());
        let (watch, begin) = (MemoryPeak::new(), Instant::now());
        let question = ReadRequest { digest: digest.clone(), offset: 0, limit_bytes: 0 };
        let mut pieces = client.read(question).await.unwrap().into_inner();
        let mut read = 0;
        while let Some(piece) = pieces.message().await.unwrap() {
            assert_eq!(crc32c::crc32c(&piece.data), piece.crc32c);
            read += piece.data.len() as u64;
        }
        assert_eq!(read, SIZE);
        let (down_s, down_moved) = (begin.elapsed().as_secs_f64(), watch.grown_mib());
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
