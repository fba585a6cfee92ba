//! Promise: a blob is there for who uploaded it, and for nobody else: whatever others ask, the answer is that of a blob that
//! was never stored; also after a restart, and with keys or without.

use std::path::Path;

use jobs::blob::{BlobOptions, Digest, put};
use server::keys::{KeyFile, KeyLimits, NewKey, Role};
use server::service::{Access, AccessOptions};
use tessera::proto::blob_service_client::BlobServiceClient;
use tessera::proto::*;
use tonic::transport::Channel;
use tonic::{Code, Request, Status};
use tonic_types::StatusExt;

use crate::server::*;

type Blobs = BlobServiceClient<Channel>;

fn by<T>(tenant: &str, message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.metadata_mut().insert("tessera-tenant", tenant.parse().unwrap());
    request
}

fn content(length: usize, seed: u32) -> Vec<u8> {
    (0..length as u32).map(|i| ((i ^ seed).wrapping_mul(2_654_435_761) >> 24) as u8).collect()
}

fn pieces(data: &[u8]) -> Vec<WriteRequest> {
    let mut all: Vec<_> = (data.chunks(1000).enumerate())
        .map(|(i, part)| WriteRequest {
            digest: Digest::of(data).to_string(),
            size_bytes: data.len() as u64,
            offset: 1000 * i as u64,
            data: part.to_vec().into(),
            crc32c: crc32c::crc32c(part),
            finish: false,
        })
        .collect();
    all.last_mut().unwrap().finish = true;
    all
}

async fn write(client: &mut Blobs, tenant: &str, data: &[u8]) -> Result<WriteResponse, Status> {
    Ok(client.write(by(tenant, tokio_stream::iter(pieces(data)))).await?.into_inner())
}

/// What each call says of a blob, without its digest.
async fn said(client: &mut Blobs, tenant: &str, data: &[u8]) -> Vec<String> {
    let digest = Digest::of(data).to_string();
    let size_bytes = data.len() as u64;
    let mut said = Vec::new();
    let mut note = |what: Result<String, Status>| {
        let what = match what {
            Ok(what) => what,
            Err(status) => format!("{:?} {} {:?}", status.code(), status.message(), status.get_error_details()),
        };
        said.push(what.replace(&digest, "DIGEST"));
    };
    let (named, question) = (digest.clone(), ReadRequest { digest: digest.clone(), ..ReadRequest::default() });
    note(client.stat(by(tenant, StatRequest { digest: named.clone() })).await.map(|a| format!("{:?}", a.into_inner())));
    let read = async {
        let mut stream = client.read(by(tenant, question)).await?.into_inner();
        let mut bytes = 0;
        while let Some(piece) = stream.message().await? {
            bytes += piece.data.len();
        }
        Ok(format!("{bytes} bytes"))
    };
    note(read.await);
    let missing = FindMissingRequest { digests: vec![named.clone()] };
    note(client.find_missing(by(tenant, missing)).await.map(|a| format!("{:?}", a.into_inner())));
    let status = QueryWriteStatusRequest { digest: named.clone(), size_bytes };
    note(client.query_write_status(by(tenant, status)).await.map(|a| format!("{:?}", a.into_inner())));
    // The first piece, and no more; then one with another size.
    let first = pieces(data).into_iter().take(1).map(|piece| WriteRequest { finish: false, ..piece });
    let begun = client.write(by(tenant, tokio_stream::iter(first.collect::<Vec<_>>()))).await;
    note(begun.map(|a| format!("{:?}", a.into_inner())));
    let other = WriteRequest { size_bytes: size_bytes + 1, finish: false, ..pieces(data).remove(0) };
    note(client.write(by(tenant, tokio_stream::iter([other]))).await.map(|a| format!("{:?}", a.into_inner())));
    note(client.delete(by(tenant, DeleteRequest { digest: named })).await.map(|_| "deleted".to_owned()));
    said
}

#[tokio::test(flavor = "multi_thread")]
async fn another_s_blob_is_no_blob() {
    let server = Server::start(Setup::default()).await;
    let mut client = BlobServiceClient::new(server.channel().await);
    let (mine, never) = (content(5000, 1), content(5000, 2));
    assert!(write(&mut client, "a", &mine).await.unwrap().complete);
    assert_eq!(said(&mut client, "b", &mine).await, said(&mut client, "c", &never).await);
    // What the server stores for itself is nobody's.
    put(&*server.idle.blobs, content(5000, 3).into(), None).await.unwrap();
    assert_eq!(said(&mut client, "d", &content(5000, 3)).await, said(&mut client, "e", &never).await);
    let stat = StatRequest { digest: Digest::of(&mine).to_string() };
    assert_eq!(client.stat(by("a", stat.clone())).await.unwrap().into_inner().size_bytes, 5000, "its own is there");
    // Who sends all of it has it too, and loses it alone.
    assert!(write(&mut client, "f", &mine).await.unwrap().complete);
    assert_eq!(server.idle.blobs.usage().await.unwrap().blobs, 2, "the bytes are there once");
    client.delete(by("a", DeleteRequest { digest: stat.digest.clone() })).await.unwrap();
    assert_eq!(client.stat(by("a", stat.clone())).await.unwrap_err().code(), Code::NotFound);
    assert_eq!(client.stat(by("f", stat.clone())).await.unwrap().into_inner().size_bytes, 5000);
    client.delete(by("f", DeleteRequest { digest: stat.digest.clone() })).await.unwrap();
    assert_eq!(client.stat(by("f", stat.clone())).await.unwrap_err().code(), Code::NotFound);
    let begin = std::time::Instant::now();
    while server.idle.blobs.usage().await.unwrap().blobs > 1 {
        assert!(begin.elapsed().as_secs() < 60, "what is nobody's goes");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pin_of_another_tenant_is_nobody_s_business() {
    let server = Server::start(Setup::default()).await;
    let mut client = BlobServiceClient::new(server.channel().await);
    let data = content(3000, 1);
    let digest = Digest::of(&data);
    for tenant in ["a", "b"] {
        write(&mut client, tenant, &data).await.unwrap();
    }
    let owner = jobs::blob::Owner::of("a");
    server.idle.blobs.pin_for(owner, "a job of a", &[digest]).await.unwrap();
    let delete = DeleteRequest { digest: digest.to_string() };
    assert_eq!(client.delete(by("a", delete.clone())).await.unwrap_err().code(), Code::FailedPrecondition);
    client.delete(by("b", delete.clone())).await.expect("b has no job");
    assert!(server.idle.blobs.stat(digest).await.is_ok(), "the job still has it");
    server.idle.blobs.unpin("a job of a").await.unwrap();
    client.delete(by("a", delete)).await.unwrap();
    server.stop().await.unwrap();
}

async fn start(folder: &Path) -> (Server, Blobs) {
    let setup = Setup { folder: Some(folder.join("blobs")), ..Setup::default() };
    let server = Server::start(setup).await;
    let client = BlobServiceClient::new(server.channel().await);
    (server, client)
}

#[tokio::test(flavor = "multi_thread")]
async fn who_has_what_outlives_the_server() {
    let folder = tempfile::tempdir().unwrap();
    let (mine, never) = (content(4000, 1), content(4000, 2));
    let (server, mut client) = start(folder.path()).await;
    write(&mut client, "a", &mine).await.unwrap();
    write(&mut client, "b", &mine).await.unwrap();
    client.delete(by("b", DeleteRequest { digest: Digest::of(&mine).to_string() })).await.unwrap();
    server.stop().await.unwrap();
    drop(client);
    let (server, mut client) = start(folder.path()).await;
    assert_eq!(said(&mut client, "b", &mine).await, said(&mut client, "c", &never).await);
    let stat = StatRequest { digest: Digest::of(&mine).to_string() };
    client.stat(by("a", stat.clone())).await.unwrap();
    client.delete(by("a", DeleteRequest { digest: stat.digest.clone() })).await.unwrap();
    server.stop().await.unwrap();
    drop(client);
    // A mark without its blob, as a crash may leave it, gives nothing to who had it once.
    let name = Digest::of(&mine).to_string();
    let owner = jobs::blob::Owner::of("a");
    let mark = folder.path().join("blobs/owners").join(&name[..2]).join(format!("{name}-{owner}"));
    assert!(!mark.exists(), "a mark goes with its owner");
    std::fs::write(&mark, b"").unwrap();
    let (server, mut client) = start(folder.path()).await;
    assert!(!mark.exists());
    write(&mut client, "d", &mine).await.unwrap();
    assert_eq!(client.stat(by("a", stat)).await.unwrap_err().code(), Code::NotFound);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_has_so_many_bytes_and_gives_up_its_oldest() {
    let folder = tempfile::tempdir().unwrap();
    let file = KeyFile::in_folder(folder.path());
    let limits = KeyLimits { bytes: Some(10_000), ..KeyLimits::default() };
    let new = NewKey { name: "ci".to_owned(), role: Role::Submit, lasts: None, limits, is_second: false };
    let (_, secret) = file.change(|keys| keys.add(new)).unwrap();
    let access = Access::in_folder(folder.path(), AccessOptions::default()).unwrap();
    let blobs = BlobOptions { quota_bytes: 1 << 20, ..BlobOptions::default() };
    let server = Server::start(Setup { access, blobs, ..Setup::default() }).await;
    let mut client = BlobServiceClient::new(server.channel().await);
    fn with<T>(secret: &str, message: T) -> Request<T> {
        let mut request = Request::new(message);
        request.metadata_mut().insert("authorization", format!("Bearer {secret}").parse().unwrap());
        request
    }
    let put = async |client: &mut Blobs, data: &[u8]| {
        client.write(with(secret.reveal(), tokio_stream::iter(pieces(data)))).await.map(|answer| answer.into_inner())
    };
    let all: Vec<Vec<u8>> = (0..3).map(|seed| content(4000, seed)).collect();
    // Others have no such limit, and what they have does not count.
    for data in &all {
        write(&mut client, "other", data).await.unwrap();
    }
    for data in &all {
        assert!(put(&mut client, data).await.unwrap().complete);
    }
    let digests: Vec<String> = all.iter().map(|data| Digest::of(data).to_string()).collect();
    let missing = client.find_missing(with(secret.reveal(), FindMissingRequest { digests: digests.clone() })).await;
    assert_eq!(missing.unwrap().into_inner().digests, digests[..1], "the oldest went");
    let missing = client.find_missing(by("other", FindMissingRequest { digests: digests.clone() })).await.unwrap();
    assert!(missing.into_inner().digests.is_empty(), "of others nothing did");
    // What a job needs does not go.
    let owner = jobs::blob::Owner::of("ci");
    let pinned: Vec<Digest> = all[1..].iter().map(|data| Digest::of(data)).collect();
    server.idle.blobs.pin_for(owner, "jobs", &pinned).await.unwrap();
    for data in [&all[0], &content(10_001, 9)] {
        let status = put(&mut client, data).await.unwrap_err();
        assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}");
        assert_eq!(status.get_details_quota_failure().unwrap().violations[0].subject, "bytes");
    }
    assert!(put(&mut client, &content(2000, 7)).await.unwrap().complete, "there is room for that");
    server.stop().await.unwrap();
}
