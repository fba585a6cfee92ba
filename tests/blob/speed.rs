//! How fast a large blob is written and read, and what memory that takes.

use std::path::PathBuf;
use std::time::Instant;

use bytes::{Bytes, BytesMut};
use futures_util::TryStreamExt;
use jobs::blob::{BlobOptions, BlobStore, Chunk, Digest, UploadId};
use sha2::Digest as _;

use crate::process::MemoryPeak;
use crate::{content, local};

const MIB: u64 = 1 << 20;
const SIZE_MIB: u64 = 500;

/// Processor time of all threads, seconds, from ticks of 10 ms; 0 where the system does not say.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit_once(')').map_or("", |(_, rest)| rest).split_whitespace().skip(11).take(2);
    fields.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

#[test]
#[ignore = "a measurement; see the head of main.rs"]
fn speed() {
    let block = content(1, MIB as usize);
    let chunk = |k: u64| {
        let mut bytes = BytesMut::from(&block[..]);
        bytes[..8].copy_from_slice(&k.to_le_bytes());
        bytes.freeze()
    };
    let start = Instant::now();
    let mut sha = sha2::Sha256::new();
    (0..SIZE_MIB).for_each(|k| sha.update(chunk(k)));
    let digest = Digest::from(<[u8; 32]>::from(sha.finalize()));
    let hash_s = start.elapsed().as_secs_f64();
    let folder = match std::env::var("TESSERA_BLOB_FOLDER") {
        Ok(folder) => tempfile::tempdir_in(PathBuf::from(folder)),
        Err(_) => tempfile::tempdir(),
    };
    let folder = folder.unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let id = UploadId::new(digest, SIZE_MIB * MIB);
    let rate = |seconds: f64| SIZE_MIB as f64 * MIB as f64 / 1e6 / seconds;
    for fsync in [true, false] {
        runtime.block_on(async {
            let store = local(folder.path(), BlobOptions { fsync, ..BlobOptions::default() }).await;
            let (watch, start, cpu) = (MemoryPeak::new(), Instant::now(), cpu_s());
            store.begin(id).await.unwrap();
            for k in 0..SIZE_MIB {
                store.write(id, Chunk::new(k * MIB, chunk(k))).await.unwrap();
            }
            let chunks_s = start.elapsed().as_secs_f64();
            store.finish(id, None).await.unwrap();
            let write_cpu_s = cpu_s() - cpu;
            let (write_s, write_moved) = (start.elapsed().as_secs_f64(), watch.grown_mib());
            let (watch, start, cpu) = (MemoryPeak::new(), Instant::now(), cpu_s());
            let mut pieces = store.read(digest, 0..u64::MAX).await.unwrap().bytes;
            let mut read = 0;
            while let Some(piece) = pieces.try_next().await.unwrap() {
                let piece: Bytes = piece;
                read += std::hint::black_box(piece).len() as u64;
            }
            assert_eq!(read, id.size_bytes);
            let (read_s, read_moved) = (start.elapsed().as_secs_f64(), watch.grown_mib());
            let read_cpu_s = cpu_s() - cpu;
            store.delete(digest).await.unwrap();
            println!(
                "{{\"blob_mib\": {SIZE_MIB}, \"fsync\": {fsync}, \"sha256_mb_s\": {:.0}, \"write_mb_s\": {:.0}, \
                 \"write_cpu_s\": {write_cpu_s:.2}, \"read_cpu_s\": {read_cpu_s:.2}, \"chunks_s\": {chunks_s:.3}, \"finish_s\": {:.3}, \"write_memory_moved_mib\": {write_moved:.1}, \
                 \"read_mb_s\": {:.0}, \"read_memory_moved_mib\": {read_moved:.1}}}",
                rate(hash_s),
                rate(write_s),
                write_s - chunks_s,
                rate(read_s),
            );
        });
    }
}
