//! A GET over HTTP/1.1 without TLS: the admin port of a server.
//!
//! Invariant: an answer is read within a time and a size. Must not know: what is in the answer.

use std::error::Error;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Empty, Limited};
use hyper::client::conn::http1;
use hyper::{Request, StatusCode};
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;

/// Asks `place`, HOST:PORT, for `path`. An answer has at most `most` bytes.
///
/// # Errors
/// A clause that says why there is no answer.
pub(crate) async fn get(place: &str, path: &str, limit: Duration, most: usize) -> Result<(StatusCode, Bytes), String> {
    match tokio::time::timeout(limit, answer(place, path, most)).await {
        Ok(answer) => answer.map_err(|error| match error.downcast_ref::<hyper::Error>() {
            Some(error) if error.is_parse() => "it does not speak HTTP".to_owned(),
            _ => error.to_string(),
        }),
        Err(_) => Err(format!("it did not answer within {} s", limit.as_secs_f64())),
    }
}

async fn answer(place: &str, path: &str, most: usize) -> Result<(StatusCode, Bytes), Box<dyn Error + Send + Sync>> {
    let (mut sender, connection) = http1::handshake(TokioIo::new(TcpStream::connect(place).await?)).await?;
    // It ends when the sender is dropped.
    tokio::spawn(connection);
    let answer = sender.send_request(Request::get(path).header("host", place).body(Empty::<Bytes>::new())?).await?;
    let status = answer.status();
    Ok((status, Limited::new(answer.into_body(), most).collect().await?.to_bytes()))
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    use super::*;

    #[tokio::test]
    async fn answers_are_read_within_their_bounds() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let place = listener.local_addr().unwrap().to_string();
        for (sent, expected) in [
            ("HTTP/1.1 404 Not Found\r\nContent-Length: 2\r\n\r\nno", Ok((404, "no"))),
            ("HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nab\r\n1\r\nc\r\n0\r\n\r\n", Ok((200, "abc"))),
            ("HTTP/1.1 200 OK\r\n\r\nup to the end", Ok((200, "up to the end"))),
            ("HTTP/1.1 200 OK\r\nContent-Length: 20\r\n\r\n01234567890123456789", Err("limit exceeded")),
            ("HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\ncut", Err("reading a body")),
            ("hello\r\n\r\n", Err("does not speak HTTP")),
        ] {
            let serve = async {
                let (mut stream, _) = listener.accept().await.unwrap();
                let mut request = [0; 256];
                assert!(stream.read(&mut request).await.unwrap() > 0);
                stream.write_all(sent.as_bytes()).await.unwrap();
            };
            let (read, ()) = tokio::join!(get(&place, "/x", Duration::from_secs(10), 16), serve);
            match (read, expected) {
                (Ok((status, body)), Ok(want)) => {
                    assert_eq!((status.as_u16(), body.as_ref()), (want.0, want.1.as_bytes()))
                }
                (Err(said), Err(words)) => assert!(said.contains(words), "{said}"),
                (read, _) => panic!("{sent:?}: {read:?}"),
            }
        }
        let silent = get(&place, "/x", Duration::from_millis(50), 16).await.unwrap_err();
        assert_eq!(silent, "it did not answer within 0.05 s");
    }
}
