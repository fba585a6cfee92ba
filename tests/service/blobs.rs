//! Promise: an upload that is cut anywhere goes on where it was, and becomes a blob only when all of its bytes are there and
//! right; what is wrong is refused with the field and stores nothing; ranges come as they were asked for.

use std::time::{Duration, Instant};

use jobs::blob::{BlobOptions, Digest, Owner};
use prost::bytes::Bytes;
use server::config::Limits;
use tessera::proto::blob_service_client::BlobServiceClient;
use tessera::proto::*;
use tokio::sync::mpsc::Sender;
use tokio::task::JoinHandle;
use tonic::transport::Channel;
use tonic::{Code, Request, Status};
use tonic_types::StatusExt;

use crate::server::*;

const SECOND: Duration = Duration::from_secs(1);

type Blobs = BlobServiceClient<Channel>;

#[tokio::test(flavor = "multi_thread")]
async fn a_blob_that_was_changed_is_said_and_can_be_sent_again() {
    let folder = tempfile::tempdir().unwrap();
    let setup = Setup { folder: Some(folder.path().to_owned()), ..Setup::default() };
    let server = Server::start(setup).await;
    let mut client = BlobServiceClient::new(server.channel().await);
    let data = content(3_000_000);
    let digest = Digest::of(&data).to_string();
    write(&mut client, upload(&data, 0, 1 << 20)).await.unwrap();
    let mut paths = vec![folder.path().to_owned()];
    let file = loop {
        let path = paths.pop().expect("the blob is a file");
        match path.is_dir() {
            true => paths.extend(std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path())),
            false if path.file_name().is_some_and(|name| *name == *digest) && path.metadata().unwrap().len() > 1000 => {
                break path;
            }
            false => {}
        }
    };
    let mut changed = data.clone();
    changed[2_999_999] ^= 1;
    std::fs::write(file, changed).unwrap();
    let status = read(&mut client, &digest, 0, 0).await.err().unwrap();
    assert_eq!(status.code(), Code::DataLoss, "{status}");
    assert!(status.message().contains("upload it again"), "{status}");
    assert_eq!(read(&mut client, &digest, 0, 0).await.err().unwrap().code(), Code::NotFound);
    write(&mut client, upload(&data, 0, 1 << 20)).await.unwrap();
    assert_eq!(joined(&read(&mut client, &digest, 0, 0).await.unwrap(), 0, 3_000_000), data);
    server.stop().await.unwrap();
}

async fn start(blobs: BlobOptions) -> (Server, Blobs) {
    let server = Server::start(Setup { blobs, ..Setup::default() }).await;
    let client = BlobServiceClient::new(server.channel().await);
    (server, client)
}

/// Bytes that differ from place to place.
fn content(length: usize) -> Vec<u8> {
    (0..length as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect()
}

fn piece(offset: usize, data: &[u8]) -> WriteRequest {
    let crc32c = crc32c::crc32c(data);
    WriteRequest { offset: offset as u64, data: data.to_vec().into(), crc32c, ..WriteRequest::default() }
}

/// An upload from `start` on, in pieces of `step`; the first names the blob, the last finishes.
fn upload(data: &[u8], start: usize, step: usize) -> Vec<WriteRequest> {
    let mut all: Vec<_> =
        data[start..].chunks(step).enumerate().map(|(i, part)| piece(start + i * step, part)).collect();
    if all.is_empty() {
        all.push(piece(start, &[]));
    }
    let first = &mut all[0];
    first.digest = Digest::of(data).to_string();
    first.size_bytes = data.len() as u64;
    all.last_mut().unwrap().finish = true;
    all
}

async fn write(client: &mut Blobs, messages: Vec<WriteRequest>) -> Result<WriteResponse, Status> {
    let answer = tokio::time::timeout(PATIENCE, client.write(tokio_stream::iter(messages)));
    Ok(answer.await.expect("an answer comes").map_err(same)?.into_inner())
}

fn same(status: Status) -> Status {
    status
}

async fn kept(client: &mut Blobs, data: &[u8]) -> Result<QueryWriteStatusResponse, Status> {
    let question = QueryWriteStatusRequest { digest: Digest::of(data).to_string(), size_bytes: data.len() as u64 };
    Ok(client.query_write_status(question).await?.into_inner())
}

async fn read(client: &mut Blobs, digest: &str, offset: u64, limit_bytes: u64) -> Result<Vec<ReadResponse>, Status> {
    let question = ReadRequest { digest: digest.to_owned(), offset, limit_bytes };
    let mut pieces = client.read(question).await?.into_inner();
    let mut all = Vec::new();
    while let Some(piece) = pieces.message().await? {
        all.push(piece);
    }
    Ok(all)
}

/// The bytes of pieces, each checked.
fn joined(pieces: &[ReadResponse], start: u64, size_bytes: u64) -> Vec<u8> {
    let mut data = Vec::new();
    for piece in pieces {
        assert_eq!(piece.offset, start + data.len() as u64);
        assert_eq!(piece.crc32c, crc32c::crc32c(&piece.data));
        assert_eq!(piece.size_bytes, size_bytes);
        assert!(piece.data.len() <= 1 << 20);
        data.extend_from_slice(&piece.data);
    }
    data
}

fn field(status: &Status) -> String {
    status.get_details_bad_request().expect("a field").field_violations[0].field.clone()
}

/// An upload that goes on by hand.
fn by_hand_on(client: &Blobs) -> (Sender<WriteRequest>, JoinHandle<Result<WriteResponse, Status>>) {
    let (send, stream) = by_hand();
    let mut client = client.clone();
    let answer = tokio::spawn(async move { Ok(client.write(stream).await?.into_inner()) });
    (send, answer)
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_is_cut_at_every_piece_and_goes_on() {
    const STEP: usize = 10_000;
    let (server, mut client) = start(BlobOptions::default()).await;
    for cut in 1..=20 {
        let mut data = content(20 * STEP);
        data[0] = cut as u8;
        let mut first = upload(&data, 0, STEP);
        // The last piece comes, and the word to finish does not.
        first[19].finish = false;
        first.truncate(cut);
        let (send, answer) = by_hand_on(&client);
        for message in first {
            send.send(message).await.unwrap();
        }
        if cut % 2 == 0 {
            // The client ends in order, without finish.
            drop(send);
            let answer = answer.await.unwrap().unwrap();
            assert_eq!((answer.kept_bytes as usize, answer.complete), (cut * STEP, false));
        } else {
            // The client goes without a word once its pieces are there.
            let begin = Instant::now();
            while !matches!(kept(&mut client, &data).await, Ok(status) if status.kept_bytes as usize == cut * STEP) {
                assert!(begin.elapsed() < PATIENCE);
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
            answer.abort();
            let _ = answer.await;
        }
        let status = kept(&mut client, &data).await.unwrap();
        assert_eq!((status.kept_bytes as usize, status.complete), (cut * STEP, false));
        let digest = Digest::of(&data).to_string();
        let missing = client.find_missing(FindMissingRequest { digests: vec![digest.clone()] }).await.unwrap();
        assert_eq!(missing.into_inner().digests, std::slice::from_ref(&digest), "never complete early");
        let rest = upload(&data, cut * STEP, STEP);
        assert!(rest.len() <= (20 - cut).max(1), "no piece comes twice");
        let done = write(&mut client, rest).await.unwrap();
        assert!(done.complete && done.kept_bytes == done.size_bytes && done.digest == digest);
        let pieces = read(&mut client, &digest, 0, 0).await.unwrap();
        assert_eq!(joined(&pieces, 0, data.len() as u64), data);
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_dies_in_the_middle_loses_no_stored_byte() {
    let (server, mut client) = start(BlobOptions::default()).await;
    let data = content(20 << 16);
    for (round, pieces) in [3, 9, 17].into_iter().enumerate() {
        // A connection of its own, which goes with its client.
        let own = BlobServiceClient::new(server.channel().await);
        let from = kept(&mut client, &data).await.map_or(0, |status| status.kept_bytes as usize);
        let (send, answer) = by_hand_on(&own);
        for message in upload(&data, from, 1 << 16).into_iter().take(pieces - round) {
            if send.send(WriteRequest { finish: false, ..message }).await.is_err() {
                break;
            }
        }
        answer.abort();
        let _ = answer.await;
        drop((send, own));
        tokio::time::sleep(SECOND / 10).await;
        if let Ok(status) = kept(&mut client, &data).await {
            assert!(!status.complete && status.kept_bytes as usize >= from);
            assert_eq!(status.kept_bytes % (1 << 16), 0);
        }
    }
    let from = kept(&mut client, &data).await.map_or(0, |status| status.kept_bytes as usize);
    assert!(write(&mut client, upload(&data, from, 1 << 16)).await.unwrap().complete);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_blob_that_is_stored_needs_no_second_upload() {
    let (server, mut client) = start(BlobOptions::default()).await;
    let data = content(5 << 20);
    assert!(write(&mut client, upload(&data, 0, 1 << 20)).await.unwrap().complete);
    // By another tenant; the client goes on sending what nobody needs.
    for _ in 0..5 {
        let mut request = Request::new(tokio_stream::iter(upload(&data, 0, 1 << 20)));
        request.metadata_mut().insert("tessera-tenant", "other".parse().unwrap());
        let answer = tokio::time::timeout(PATIENCE, client.write(request)).await.expect("at once").unwrap();
        assert!(answer.into_inner().complete);
    }
    let (send, answer) = by_hand_on(&client);
    let mut first = upload(&data, 0, 1 << 20).remove(0);
    first.data = Bytes::new();
    first.crc32c = 0;
    send.send(first).await.unwrap();
    let answer = tokio::time::timeout(PATIENCE, answer).await.expect("without another message").unwrap().unwrap();
    assert!(answer.complete && answer.kept_bytes == 5 << 20);
    let empty = write(&mut client, upload(&[], 0, 1)).await.unwrap();
    assert!(empty.complete && empty.size_bytes == 0);
    let pieces = read(&mut client, &Digest::of(&[]).to_string(), 0, 0).await.unwrap();
    assert_eq!((pieces.len(), joined(&pieces, 0, 0)), (1, Vec::new()));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn uploads_of_tenants_have_nothing_in_common() {
    let (server, mut client) = start(BlobOptions::default()).await;
    let data = content(3000);
    let half = upload(&data, 0, 1000).into_iter().take(1).collect();
    assert_eq!(write(&mut client, half).await.unwrap().kept_bytes, 1000);
    let question = |tenant: &str| {
        let message = QueryWriteStatusRequest { digest: Digest::of(&data).to_string(), size_bytes: 3000 };
        let mut request = Request::new(message);
        request.metadata_mut().insert("tessera-tenant", tenant.parse().unwrap());
        request
    };
    assert_eq!(client.query_write_status(question("other")).await.unwrap_err().code(), Code::NotFound);
    let own = client.query_write_status(question("127.0.0.1")).await.unwrap().into_inner();
    assert_eq!(own.kept_bytes, 1000, "who says nothing is his address");
    let status = client.query_write_status(question(&"x".repeat(129))).await.unwrap_err();
    assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "tessera-tenant".to_owned()));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_is_refused_and_stores_nothing() {
    let (server, mut client) = start(BlobOptions::default()).await;
    let data = content(4000);
    let good = || upload(&data, 0, 1000);
    type Change = fn(&mut Vec<WriteRequest>);
    let cases: [(&str, Change, Code, &str, u64); 11] = [
        ("checksum", |m| m[2].crc32c ^= 1, Code::InvalidArgument, "crc32c", 2000),
        (
            "checksum of nothing",
            |m| m.insert(1, WriteRequest { crc32c: 5, ..piece(1000, &[]) }),
            Code::InvalidArgument,
            "crc32c",
            1000,
        ),
        ("offset too small", |m| m[2].offset = 1999, Code::OutOfRange, "offset", 2000),
        ("offset too large", |m| m[2].offset = 2001, Code::OutOfRange, "offset", 2000),
        ("a piece left out", |m| drop(m.remove(2)), Code::OutOfRange, "offset", 2000),
        ("a piece twice", |m| m.insert(1, m[0].clone()), Code::OutOfRange, "offset", 1000),
        (
            "past the end",
            |m| m.push(WriteRequest { finish: true, ..piece(4000, &[1]) }),
            Code::InvalidArgument,
            "data",
            4000,
        ),
        ("finish too early", |m| m[2].finish = true, Code::InvalidArgument, "finish", 3000),
        ("another digest", |m| m[1].digest = Digest::of(b"x").to_string(), Code::InvalidArgument, "digest", 1000),
        ("another size", |m| m[1].size_bytes = 1, Code::InvalidArgument, "size_bytes", 1000),
        ("no digest", |m| m[0].digest.clear(), Code::InvalidArgument, "digest", 0),
    ];
    for (what, change, code, path, stored) in cases {
        let mut messages = good();
        if what == "past the end" {
            messages.last_mut().unwrap().finish = false;
        }
        change(&mut messages);
        // A tenant each, so that nobody goes on with another's upload.
        let tenant = what.replace(' ', "-");
        let mut request = Request::new(tokio_stream::iter(messages));
        request.metadata_mut().insert("tessera-tenant", tenant.parse().unwrap());
        let status = client.write(request).await.expect_err(what);
        assert_eq!((status.code(), field(&status)), (code, path.to_owned()), "{what}: {status:?}");
        let question = QueryWriteStatusRequest { digest: Digest::of(&data).to_string(), size_bytes: 4000 };
        let mut request = Request::new(question);
        request.metadata_mut().insert("tessera-tenant", tenant.parse().unwrap());
        let kept = client.query_write_status(request).await.map_or(0, |answer| answer.into_inner().kept_bytes);
        assert_eq!(kept, stored, "{what}");
    }
    assert_eq!(kept(&mut client, &data).await.unwrap_err().code(), Code::NotFound);
    let status = write(&mut client, Vec::new()).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument, "an upload of no message");
    let mut tampered = good();
    let mut other = data.clone();
    other[3500] ^= 1;
    tampered[3] = WriteRequest { finish: true, ..piece(3000, &other[3000..]) };
    let status = write(&mut client, tampered).await.unwrap_err();
    assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "digest".to_owned()));
    assert_eq!(kept(&mut client, &data).await.unwrap_err().code(), Code::NotFound, "such an upload is gone");
    assert!(write(&mut client, good()).await.unwrap().complete);
    let mut longer = good();
    longer[0].size_bytes = 4001;
    let status = write(&mut client, longer).await.unwrap_err();
    assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "size_bytes".to_owned()));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_does_not_fit_is_refused_before_its_bytes_come() {
    let blobs = BlobOptions { quota_bytes: 10_000, blob_bytes: 8000, uploads: 3, ..BlobOptions::default() };
    let (server, mut client) = start(blobs).await;
    for size_bytes in [8001, 1 << 40, u64::MAX] {
        let first = WriteRequest { size_bytes, ..upload(b"x", 0, 1).remove(0) };
        let status = write(&mut client, vec![first]).await.unwrap_err();
        assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "size_bytes".to_owned()));
        assert!(status.message().contains("8000"), "{status:?}");
    }
    // Promises of uploads count.
    let (one, two) = (content(6000), content(7000));
    let begun = |data: &[u8]| upload(data, 0, 1000).into_iter().take(1).collect::<Vec<_>>();
    assert!(!write(&mut client, begun(&one)).await.unwrap().complete);
    let status = write(&mut client, begun(&two)).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.get_details_retry_info().unwrap().retry_delay.is_some());
    assert!(write(&mut client, upload(&one, 1000, 1000)).await.unwrap().complete);
    // Blobs that nobody needs make room; one that is needed does not.
    server.idle.blobs.pin_for(Owner::of("127.0.0.1"), "a job", &[Digest::of(&one)]).await.unwrap();
    assert_eq!(write(&mut client, begun(&two)).await.unwrap_err().code(), Code::ResourceExhausted);
    let name = Digest::of(&one).to_string();
    let status = client.delete(DeleteRequest { digest: name.clone() }).await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert_eq!(status.get_details_precondition_failure().unwrap().violations[0].subject, name);
    server.idle.blobs.unpin("a job").await.unwrap();
    assert!(write(&mut client, upload(&two, 0, 1000)).await.unwrap().complete);
    assert_eq!(client.stat(StatRequest { digest: name }).await.unwrap_err().code(), Code::NotFound, "evicted");
    let few = |k: usize| upload(&content(600 + k), 0, 100).into_iter().take(1).collect::<Vec<_>>();
    for k in 0..3 {
        assert!(!write(&mut client, few(k)).await.unwrap().complete);
    }
    let status = write(&mut client, few(3)).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.get_details_retry_info().is_some());
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn ranges_come_as_they_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let on_disk = Setup { folder: Some(folder.path().to_owned()), ..Setup::default() };
    for setup in [Setup::default(), on_disk] {
        let server = Server::start(setup).await;
        let mut client = BlobServiceClient::new(server.channel().await);
        let data = content((5 << 19) + 7);
        let size = data.len() as u64;
        let digest = Digest::of(&data).to_string();
        assert!(write(&mut client, upload(&data, 0, 1 << 20)).await.unwrap().complete);
        for (offset, limit) in
            [(0, 0), (0, 1), (1, 1 << 20), (7, (1 << 20) + 1), (size - 1, 0), (size - 1, 100), (5, u64::MAX)]
        {
            let end = if limit == 0 { size } else { size.min(offset.saturating_add(limit)) };
            let pieces = read(&mut client, &digest, offset, limit).await.unwrap();
            assert!(joined(&pieces, offset, size) == data[offset as usize..end as usize], "{offset} {limit}");
        }
        let end = read(&mut client, &digest, size, 5).await.unwrap();
        assert_eq!((end.len(), end[0].offset, end[0].data.len(), end[0].size_bytes), (1, size, 0, size));
        let status = read(&mut client, &digest, size + 1, 0).await.unwrap_err();
        assert_eq!((status.code(), field(&status)), (Code::OutOfRange, "offset".to_owned()));
        server.stop().await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn blobs_are_found_told_of_and_removed() {
    let (server, mut client) = start(BlobOptions::default()).await;
    let data = content(1000);
    let (there, gone) = (Digest::of(&data).to_string(), Digest::of(b"gone").to_string());
    assert!(write(&mut client, upload(&data, 0, 400)).await.unwrap().complete);
    let ask = |digests: &[&String]| FindMissingRequest { digests: digests.iter().map(|d| (*d).clone()).collect() };
    let missing = client.find_missing(ask(&[&gone, &there, &gone])).await.unwrap().into_inner().digests;
    assert_eq!(missing, [gone.clone(), gone.clone()]);
    let most: Vec<_> = std::iter::repeat_n(&gone, 10_000).collect();
    assert_eq!(client.find_missing(ask(&most)).await.unwrap().into_inner().digests.len(), 10_000);
    let status = client.find_missing(ask(&[&most[..], &[&gone]].concat())).await.unwrap_err();
    assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "digests".to_owned()));
    let told = client.stat(StatRequest { digest: there.clone() }).await.unwrap().into_inner();
    assert_eq!((told.digest, told.size_bytes), (there.clone(), 1000));
    // What is no digest is told from what is not there.
    for wrong in ["", "abc", &there.to_uppercase(), &there[1..], &format!("{}g", &there[1..])] {
        let digest = wrong.to_owned();
        let answers = [
            client.stat(StatRequest { digest: digest.clone() }).await.unwrap_err(),
            client.delete(DeleteRequest { digest: digest.clone() }).await.unwrap_err(),
            read(&mut client, wrong, 0, 0).await.unwrap_err(),
            client.query_write_status(QueryWriteStatusRequest { digest, size_bytes: 1 }).await.unwrap_err(),
        ];
        for status in answers {
            assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "digest".to_owned()), "{wrong:?}");
        }
        let status = client.find_missing(ask(&[&there, &wrong.to_owned()])).await.unwrap_err();
        assert_eq!((status.code(), field(&status)), (Code::InvalidArgument, "digests[1]".to_owned()));
    }
    client.delete(DeleteRequest { digest: there.clone() }).await.unwrap();
    for digest in [there, gone] {
        let answers = [
            client.stat(StatRequest { digest: digest.clone() }).await.unwrap_err(),
            client.delete(DeleteRequest { digest: digest.clone() }).await.unwrap_err(),
            read(&mut client, &digest, 0, 0).await.unwrap_err(),
        ];
        for status in answers {
            assert_eq!(status.code(), Code::NotFound);
            assert_eq!(status.get_details_resource_info().unwrap().resource_name, digest);
        }
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_waits_for_a_silent_uploader_for_ever() {
    let limits = Limits { upload_idle: SECOND / 2, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = BlobServiceClient::new(server.channel().await);
    let data = content(4000);
    let (send, answer) = by_hand_on(&client);
    send.send(upload(&data, 0, 1000).remove(0)).await.unwrap();
    let status = tokio::time::timeout(PATIENCE, answer).await.unwrap().unwrap().unwrap_err();
    assert_eq!(status.code(), Code::DeadlineExceeded);
    assert_eq!(kept(&mut client, &data).await.unwrap().kept_bytes, 1000, "what came is kept");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shutdown_ends_uploads_and_says_when_to_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let limits = Limits { grace: 10 * PATIENCE, upload_idle: 10 * PATIENCE, ..Limits::default() };
    let setup = || Setup { folder: Some(folder.path().to_owned()), limits, ..Setup::default() };
    let server = Server::start(setup()).await;
    let mut client = BlobServiceClient::new(server.channel().await);
    let data = content(4000);
    let (send, answer) = by_hand_on(&client);
    send.send(upload(&data, 0, 1000).remove(0)).await.unwrap();
    let begin = Instant::now();
    while !matches!(kept(&mut client, &data).await, Ok(status) if status.kept_bytes == 1000) {
        assert!(begin.elapsed() < PATIENCE);
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let stopping = tokio::spawn(server.stop());
    let status = answer.await.unwrap().unwrap_err();
    assert_eq!(status.code(), Code::Unavailable);
    assert!(status.get_details_retry_info().unwrap().retry_delay.is_some());
    // The server's end would come too late if anybody waited for uploads.
    stopping.await.unwrap().unwrap();
    drop((send, client));
    let server = Server::start(setup()).await;
    let mut client = BlobServiceClient::new(server.channel().await);
    assert_eq!(kept(&mut client, &data).await.unwrap().kept_bytes, 1000);
    assert!(write(&mut client, upload(&data, 1000, 1000)).await.unwrap().complete);
    server.stop().await.unwrap();
}
