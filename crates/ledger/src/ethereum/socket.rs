//! A node's WebSocket without delays on either side. Own messages leave at once (TCP_NODELAY), and the node's are
//! acknowledged at once (TCP_QUICKACK). A node that follows RFC 896, as anvil does, sends nothing new before the
//! acknowledgement of its last message, which otherwise comes 40 ms late (RFC 1122, 4.2.3.2).

use std::{
    io,
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use alloy::{
    pubsub::{ConnectionHandle, ConnectionInterface, PubSubConnect},
    rpc::json_rpc::PubSubItem,
    transports::{TransportErrorKind, TransportResult, ws::WsConnect},
};
use futures_util::{SinkExt, StreamExt};
use socket2::SockRef;
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::TcpStream,
    time::{Instant, timeout_at},
};
use tokio_tungstenite::{
    MaybeTlsStream, WebSocketStream, client_async_tls_with_config,
    tungstenite::{Message, client::IntoClientRequest},
};

/// Silence after which a node is pinged. After the same time without an answer it is considered gone.
const SILENCE: Duration = Duration::from_secs(10);
/// Longest time for requests to stay unanswered. After it, another connection is tried.
const ANSWER: Duration = Duration::from_secs(30);

/// Connector of undelayed WebSockets.
pub(super) struct NoDelay(WsConnect);

impl NoDelay {
    pub(super) fn new(url: &str) -> Self {
        Self(WsConnect::new(url))
    }
}

impl PubSubConnect for NoDelay {
    fn is_local(&self) -> bool {
        self.0.is_local()
    }

    async fn connect(&self) -> TransportResult<ConnectionHandle> {
        let request = self.0.clone().into_client_request().map_err(TransportErrorKind::custom)?;
        let uri = request.uri();
        let nowhere = || TransportErrorKind::custom_str(&format!("{uri} names no host"));
        let port = uri.port_u16().unwrap_or(if uri.scheme_str() == Some("wss") { 443 } else { 80 });
        // IPv6 addresses have brackets in a URL.
        let host = uri.host().ok_or_else(nowhere)?.trim_matches(['[', ']']);
        let stream = TcpStream::connect((host, port)).await.map_err(TransportErrorKind::custom)?;
        stream.set_nodelay(true).map_err(TransportErrorKind::custom)?;
        let connecting = client_async_tls_with_config(request, QuickAck(stream), None, None);
        let (socket, _) = connecting.await.map_err(TransportErrorKind::custom)?;
        let (handle, interface) = ConnectionHandle::new();
        tokio::spawn(converse(socket, interface));
        // The user of the connection reconnects, because only it knows which requests to repeat.
        Ok(handle.with_max_retries(0))
    }
}

/// Carries messages both ways until either side ends.
async fn converse(mut socket: WebSocketStream<MaybeTlsStream<QuickAck>>, mut interface: ConnectionInterface) {
    let (mut unanswered, mut is_pinged, mut since) = (0_u32, false, Instant::now());
    loop {
        let patience = if unanswered > 0 { ANSWER } else { SILENCE };
        tokio::select! {
            request = interface.recv_from_frontend() => {
                let Some(request) = request else { return };
                if unanswered == 0 {
                    since = Instant::now();
                }
                unanswered += 1;
                if socket.send(Message::text(request.get())).await.is_err() {
                    break;
                }
            }
            received = timeout_at(since + patience, socket.next()) => match received {
                Ok(Some(Ok(Message::Text(text)))) => {
                    let Ok(item) = serde_json::from_str(&text) else { break };
                    let is_answer = matches!(item, PubSubItem::Response(_));
                    unanswered = unanswered.saturating_sub(u32::from(is_answer));
                    if is_answer || unanswered == 0 {
                        (is_pinged, since) = (false, Instant::now());
                    }
                    if interface.send_to_frontend(item).is_err() {
                        return;
                    }
                }
                Ok(Some(Ok(Message::Ping(_) | Message::Pong(_)))) if unanswered > 0 => {}
                Ok(Some(Ok(Message::Ping(_) | Message::Pong(_)))) => (is_pinged, since) = (false, Instant::now()),
                Err(_) if unanswered == 0 && !is_pinged => {
                    (is_pinged, since) = (true, Instant::now());
                    if socket.send(Message::Ping(Default::default())).await.is_err() {
                        break;
                    }
                }
                Ok(_) | Err(_) => break,
            },
        }
    }
    interface.close_with_error();
}

/// A stream that acknowledges immediately what it reads.
struct QuickAck(TcpStream);

impl AsyncRead for QuickAck {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        // The kernel returns to delaying by itself. A failure costs only time.
        let _ = SockRef::from(&self.0).set_tcp_quickack(true);
        Pin::new(&mut self.0).poll_read(cx, buf)
    }
}

impl AsyncWrite for QuickAck {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.0).poll_write(cx, buf)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_shutdown(cx)
    }
}
