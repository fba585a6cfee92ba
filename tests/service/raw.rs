//! Clients that no library would be: sockets that say nothing, windows that stay shut, a few bytes at a time.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use h2::client::{ResponseFuture, SendRequest};
use h2::{RecvStream, SendStream};
use prost::Message;
use prost::bytes::Bytes;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinHandle;

pub const COMPUTE_RVD: &str = "/tessera.v1.RemeshService/ComputeRvd";
pub const WATCH: &str = "/grpc.health.v1.Health/Watch";
pub const CHECK: &str = "/grpc.health.v1.Health/Check";

/// An HTTP/2 connection whose windows are opened by hand.
pub struct Raw {
    pub send: SendRequest<Bytes>,
    pub connection: JoinHandle<Result<(), h2::Error>>,
}

impl Raw {
    pub async fn connect(address: SocketAddr, window: u32) -> Self {
        Self::on(TcpStream::connect(address).await.unwrap(), window).await
    }

    pub async fn on(socket: TcpStream, window: u32) -> Self {
        let (send, connection) =
            h2::client::Builder::new().initial_window_size(window).handshake(socket).await.unwrap();
        Self { send, connection: tokio::spawn(connection) }
    }

    /// Sends a request's head.
    pub async fn begin(&mut self, path: &str) -> (ResponseFuture, SendStream<Bytes>) {
        self.begin_with(path, &[]).await
    }

    /// The same with more headers.
    pub async fn begin_with(&mut self, path: &str, more: &[(&str, &str)]) -> (ResponseFuture, SendStream<Bytes>) {
        self.try_begin(path, more).await.unwrap()
    }

    /// The same on a connection that the server may close at any moment.
    pub async fn try_begin(
        &mut self,
        path: &str,
        more: &[(&str, &str)],
    ) -> Result<(ResponseFuture, SendStream<Bytes>), h2::Error> {
        let mut request = http::Request::post(format!("http://localhost{path}"))
            .header("content-type", "application/grpc")
            .header("te", "trailers");
        for (name, value) in more {
            request = request.header(*name, *value);
        }
        let request = request.body(()).unwrap();
        self.send.clone().ready().await?.send_request(request, false)
    }

    /// Sends bytes as a whole request; gives all that is said of its end: status, message, details and other headers.
    pub async fn end_of(&mut self, path: &str, more: &[(&str, &str)], bytes: Bytes) -> BTreeMap<String, String> {
        let (response, mut body) = self.begin_with(path, more).await;
        // A request that is refused may be reset before its bytes are taken.
        let _ = body.send_data(bytes, true);
        let (head, mut body) = response.await.unwrap().into_parts();
        while let Some(Ok(data)) = body.data().await {
            let _ = body.flow_control().release_capacity(data.len());
        }
        let trailers = body.trailers().await.unwrap().unwrap_or_default();
        let all = head.headers.iter().chain(&trailers);
        all.map(|(name, value)| (name.to_string(), String::from_utf8_lossy(value.as_bytes()).into_owned())).collect()
    }

    /// Sends a whole request; gives the answer's body.
    pub async fn ask<M: Message>(&mut self, path: &str, messages: &[M]) -> Result<RecvStream, h2::Error> {
        let (response, mut body) = self.try_begin(path, &[]).await?;
        for message in messages {
            body.send_data(framed(message), false)?;
        }
        body.send_data(Bytes::new(), true)?;
        Ok(response.await?.into_body())
    }
}

/// A message with its length, as gRPC sends it.
pub fn framed(message: &impl Message) -> Bytes {
    let mut bytes = vec![0];
    bytes.extend((message.encoded_len() as u32).to_be_bytes());
    message.encode(&mut bytes).unwrap();
    bytes.into()
}

/// A socket from another address of this machine.
pub async fn from(source: &str, address: SocketAddr) -> std::io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    socket.bind(source.parse().unwrap())?;
    socket.connect(address).await
}

/// A socket that sends `bytes` and no more.
pub async fn silent(address: SocketAddr, bytes: &[u8]) -> TcpStream {
    let mut socket = TcpStream::connect(address).await.unwrap();
    socket.write_all(bytes).await.unwrap();
    socket
}

/// Whether the server closes the socket within `limit`.
pub async fn closes(socket: &mut TcpStream, limit: Duration) -> bool {
    let end = async {
        let mut buffer = [0; 1024];
        while socket.read(&mut buffer).await.is_ok_and(|n| n > 0) {}
    };
    tokio::time::timeout(limit, end).await.is_ok()
}
