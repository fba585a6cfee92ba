//! Promise: whatever bytes a client sends, it gets the code of the table of errors, and the server's memory stays where it was.

use std::collections::BTreeMap;
use std::time::Duration;

use prost::Message;
use prost::bytes::Bytes;
use sha2::{Digest as _, Sha256};
use tessera::proto::*;
use tokio::io::AsyncWriteExt;
use tonic::Code;
use tonic::codec::CompressionEncoding;

use super::program::*;
use super::raw::{Raw, closes, framed};

const LIMIT: Duration = Duration::from_secs(20);
const MIB: u64 = 1 << 20;

/// Everything that is said of a request.
struct Case {
    name: String,
    path: String,
    encoding: Option<&'static str>,
    bytes: Bytes,
    code: Code,
}

fn case(name: impl Into<String>, path: &str, bytes: impl Into<Bytes>, code: Code) -> Case {
    Case { name: name.into(), path: format!("/tessera.v1.{path}"), encoding: None, bytes: bytes.into(), code }
}

const UNARY: &[&str] = &[
    "BlobService/QueryWriteStatus",
    "BlobService/FindMissing",
    "BlobService/Stat",
    "BlobService/Delete",
    "BlobService/Read",
    "JobService/CreateJob",
    "JobService/GetJob",
    "JobService/ListJobs",
    "JobService/WatchJob",
    "JobService/CancelJob",
    "JobService/DeleteJob",
    "JobService/EstimateJob",
];
const STREAMS: &[&str] =
    &["RemeshService/ComputeRvd", "RemeshService/Cvt", "RemeshService/Remesh", "BlobService/Write"];

/// A message of bytes: whether it says that it is compressed, the length that it says, the bytes.
fn message(flag: u8, length: u32, bytes: &[u8]) -> Bytes {
    let mut all = vec![flag];
    all.extend(length.to_be_bytes());
    all.extend(bytes);
    all.into()
}

fn compressed(bytes: &[u8]) -> Bytes {
    message(1, bytes.len() as u32, bytes)
}

/// A zstd frame that becomes so many zeros, with a window of 2^`window` bytes.
fn zstd_bomb(bytes: u64, window: u8) -> Vec<u8> {
    const BLOCK: u64 = 128 << 10;
    // No size is said.
    let mut all = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, (window - 10) << 3];
    for block in (0..bytes / BLOCK).rev() {
        let head = (BLOCK as u32) << 3 | 1 << 1 | u32::from(block == 0);
        all.extend(&head.to_le_bytes()[..3]);
        all.push(0);
    }
    all
}

/// A gzip file that becomes so many zeros: a zero, and then the longest repetition of it again and again.
fn gzip_bomb(bytes: u64) -> Vec<u8> {
    let mut all = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255];
    let (mut bits, mut count) = (0u32, 0);
    // Codes are written from their first bit on, each into the lowest free one.
    let mut put = |code: u32, length: u32| {
        for bit in (0..length).rev() {
            bits |= (code >> bit & 1) << count;
            count += 1;
            if count == 8 {
                all.push(bits as u8);
                (bits, count) = (0, 0);
            }
        }
    };
    put(1, 1);
    // The kind of block, from its lowest bit on: fixed codes.
    put(0b10, 2);
    put(0b0011_0000, 8);
    for _ in 0..bytes / 258 {
        put(0b1100_0101, 8);
        put(0, 5);
    }
    put(0, 7);
    put(0, 7);
    all.extend([0; 8]);
    all
}

fn hostile() -> Vec<Case> {
    let garbage: &[u8] = &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x07];
    let mut all = Vec::new();
    for path in UNARY.iter().chain(STREAMS) {
        all.push(case("no protobuf", path, message(0, garbage.len() as u32, garbage), Code::InvalidArgument));
        // A field that says it has 3 GiB.
        let mut declared = vec![0x0a];
        prost::encoding::encode_varint(3 << 30, &mut declared);
        all.push(case("3 GiB in a field", path, message(0, declared.len() as u32, &declared), Code::InvalidArgument));
        all.push(case("length 2^32 - 1", path, message(0, u32::MAX, b"x"), Code::ResourceExhausted));
        all.push(case("3 GiB in a message", path, message(0, 3 << 30, b"x"), Code::ResourceExhausted));
        all.push(case("4 MiB and a byte", path, message(0, (4 << 20) + 1, &[0; 100]), Code::ResourceExhausted));
        all.push(case("flag 7", path, message(7, 1, b"x"), Code::InvalidArgument));
        all.push(case("compressed by nothing", path, compressed(b"xyz"), Code::InvalidArgument));
        all.push(case("cut short", path, message(0, 100, b"x"), Code::InvalidArgument));
        all.push(case("nothing", path, Bytes::new(), Code::InvalidArgument));
        for (encoding, bomb, code) in [
            ("zstd", zstd_bomb(3 << 30, 23), Code::ResourceExhausted),
            // Its window alone would be 128 MiB.
            ("zstd", zstd_bomb(3 << 30, 27), Code::InvalidArgument),
            ("gzip", gzip_bomb(64 << 20), Code::ResourceExhausted),
        ] {
            let bomb = case(format!("{encoding} bomb"), path, compressed(&bomb), code);
            all.push(Case { encoding: Some(encoding), ..bomb });
        }
        for encoding in ["zstd", "gzip"] {
            let noise = case(format!("no {encoding}"), path, compressed(&[7; 1000]), Code::InvalidArgument);
            all.push(Case { encoding: Some(encoding), ..noise });
        }
        let unknown = case("an unknown compression", path, compressed(b"xyz"), Code::Unimplemented);
        all.push(Case { encoding: Some("br"), ..unknown });
    }
    let digests = ["", "abc", &"A".repeat(64), &"g".repeat(64), &"a".repeat(63), "../../etc/passwd"];
    for digest in digests.map(str::to_owned) {
        let stat = framed(&StatRequest { digest: digest.clone() });
        all.push(case(format!("digest {digest:?}"), "BlobService/Stat", stat, Code::InvalidArgument));
        let job = framed(&CreateJobRequest { spec: Some(remesh(&digest, 10, 0)), ..CreateJobRequest::default() });
        all.push(case(format!("digest {digest:?}"), "JobService/CreateJob", job, Code::InvalidArgument));
    }
    let data = b"other bytes";
    let first = WriteRequest {
        digest: hex(&Sha256::digest(b"some bytes.")),
        size_bytes: data.len() as u64,
        offset: 0,
        crc32c: crc32c::crc32c(data),
        data: data.to_vec().into(),
        finish: true,
    };
    all.push(case("another digest", "BlobService/Write", framed(&first), Code::InvalidArgument));
    let huge = WriteRequest { size_bytes: u64::MAX, ..first };
    all.push(case("2^64 bytes", "BlobService/Write", framed(&huge), Code::InvalidArgument));
    let mesh = |vertices| Some(MeshHeader { vertices, facets: 8, ..MeshHeader::default() });
    let header = |header| framed(&ComputeRvdRequest { message: Some(compute_rvd_request::Message::Header(header)) });
    let of = |vertices, backend| ComputeRvdHeader { mesh: mesh(vertices), seeds: 5, backend, options: None };
    for (name, wrong) in [
        ("3 GiB of vertices", of((3 << 30) / 24, 0)),
        ("an unknown backend", of(6, 99)),
        ("2^64 vertices", of(u64::MAX, 0)),
    ] {
        all.push(case(name, "RemeshService/ComputeRvd", header(wrong), Code::InvalidArgument));
    }
    let mut unknown = remesh(&"a".repeat(64), 10, 0);
    unknown.backend = 99;
    let create = CreateJobRequest { spec: Some(unknown), ..CreateJobRequest::default() };
    all.push(case("an unknown backend", "JobService/CreateJob", framed(&create), Code::InvalidArgument));
    let list = ListJobsRequest { states: vec![99], ..ListJobsRequest::default() };
    all.push(case("an unknown state", "JobService/ListJobs", framed(&list), Code::InvalidArgument));
    all
}

fn code(end: &BTreeMap<String, String>) -> Code {
    end.get("grpc-status").map_or(Code::Ok, |code| Code::from_bytes(code.as_bytes()))
}

async fn send_all(address: std::net::SocketAddr, cases: &[Case]) {
    let mut raw = Raw::connect(address, 1 << 20).await;

    for Case { name, path, encoding, bytes, code: wanted } in cases {
        let headers: Vec<_> = encoding.map(|encoding| ("grpc-encoding", encoding)).into_iter().collect();
        let end = tokio::time::timeout(LIMIT, raw.end_of(path, &headers, bytes.clone())).await;
        let end = end.unwrap_or_else(|_| panic!("{name} at {path}: no answer"));
        assert_eq!(code(&end), *wanted, "{name} at {path}: {end:?}");
    }
}

/// An upload in compressed messages of the usual size.
async fn honest(program: &Program, round: u8) {
    let client = program.client().await;
    for encoding in [CompressionEncoding::Zstd, CompressionEncoding::Gzip] {
        let mut data: Vec<u8> = (0..7 << 19).map(|i: u32| (i / 100 % 10) as u8 + b'0').collect();
        data.extend([round, encoding as u8]);
        let pieces = pieces(&data, 4_000_000);
        let mut blobs = client.blobs.clone().send_compressed(encoding).max_encoding_message_size(8 << 20);
        assert!(blobs.write(tokio_stream::iter(pieces)).await.unwrap().into_inner().complete);
    }
}

/// What the server has made for itself, bytes; pages of the program's file are no memory of anybody's.
#[cfg(target_os = "linux")]
fn memory(program: &Program) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.child.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
    line.split_whitespace().next().unwrap().parse::<u64>().unwrap() * 1024
}

#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn hostile_bytes_have_their_code_and_move_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--threads", "2"]);
    let address = program.address.parse().unwrap();
    let cases = hostile();
    // What honest clients leave behind: threads, and what the allocator keeps of messages of the usual size.
    let fresh = memory(&program);
    for round in 0..8 {
        honest(&program, round).await;
    }
    let before = memory(&program);
    println!("{} MiB fresh, {} MiB after honest clients", fresh / MIB, before / MIB);
    let mut most = before;
    for _ in 0..5 {
        for some in cases.chunks(8) {
            send_all(address, some).await;
            most = most.max(memory(&program));
        }
    }
    println!("{} MiB before, {} MiB at most, {} requests", before / MIB, most / MIB, 5 * cases.len());
    assert!(most <= before + 8 * MIB, "{before} bytes before, {most} at most");
    // Frames that are none of HTTP/2: the connection goes, and nothing else.
    const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
    for frame in
        [&b"\xff\xff\xff\0\0\0\0\0\x01"[..], b"\xff\xff\xff\x01\x04\0\0\0\x01", b"\0\0\x08\x06\0\0\0\0\x01abcdefgh"]
    {
        let mut socket = tokio::net::TcpStream::connect(address).await.unwrap();
        socket.write_all(&[PREFACE, frame].concat()).await.unwrap();
        let _ = socket.write_all(&[0; 100_000]).await;
        assert!(closes(&mut socket, LIMIT).await, "{frame:?}");
    }
    assert!(memory(&program) <= before + 8 * MIB);
    let mut client = program.client().await;
    let digest = client.put(b"and it goes on").await;
    assert_eq!(client.read(&digest).await, b"and it goes on");
    // The bombs are ones.
    assert_eq!(zstd_bomb(3 << 30, 23).len(), 6 + 4 * (3 << 13));
    assert!(CreateJobRequest::decode(&gzip_bomb(1000)[..]).is_err());
}
