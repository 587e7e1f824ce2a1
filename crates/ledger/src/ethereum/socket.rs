//! A node's WebSocket whose messages nobody holds back: not this side, whose messages leave at once (TCP_NODELAY), and not the
//! node, whose are acknowledged at once (TCP_QUICKACK). A node that follows RFC 896, as anvil does, says nothing new before
//! it has the acknowledgement of what it said, which otherwise is 40 ms late (RFC 1122, 4.2.3.2).

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

/// A node that says nothing for so long is asked whether it is there, and gone if it says nothing for as long again.
const SILENCE: Duration = Duration::from_secs(10);
/// One that leaves questions unanswered for so long is as good as gone: another connection may have more luck.
const ANSWER: Duration = Duration::from_secs(30);

/// How a node is connected to.
pub(super) struct AtOnce(WsConnect);

impl AtOnce {
    pub(super) fn new(url: &str) -> Self {
        Self(WsConnect::new(url))
    }
}

impl PubSubConnect for AtOnce {
    fn is_local(&self) -> bool {
        self.0.is_local()
    }

    async fn connect(&self) -> TransportResult<ConnectionHandle> {
        let request = self.0.clone().into_client_request().map_err(TransportErrorKind::custom)?;
        let uri = request.uri();
        let nowhere = || TransportErrorKind::custom_str(&format!("{uri} names no host"));
        let port = uri.port_u16().unwrap_or(if uri.scheme_str() == Some("wss") { 443 } else { 80 });
        // An IPv6 address has brackets in a URL.
        let host = uri.host().ok_or_else(nowhere)?.trim_matches(['[', ']']);
        let stream = TcpStream::connect((host, port)).await.map_err(TransportErrorKind::custom)?;
        stream.set_nodelay(true).map_err(TransportErrorKind::custom)?;
        let connecting = client_async_tls_with_config(request, Acknowledged(stream), None, None);
        let (socket, _) = connecting.await.map_err(TransportErrorKind::custom)?;
        let (handle, interface) = ConnectionHandle::new();
        tokio::spawn(converse(socket, interface));
        // Whoever uses the connection reconnects: only it knows what is to be asked again.
        Ok(handle.with_max_retries(0))
    }
}

/// Carries messages both ways until either side ends.
async fn converse(
    mut socket: WebSocketStream<MaybeTlsStream<Acknowledged>>,
    mut interface: ConnectionInterface,
) {
    let (mut unanswered, mut is_asked, mut since) = (0_u32, false, Instant::now());
    loop {
        let patience = if unanswered > 0 { ANSWER } else { SILENCE };
        tokio::select! {
            asked = interface.recv_from_frontend() => {
                let Some(asked) = asked else { return };
                if unanswered == 0 {
                    since = Instant::now();
                }
                unanswered += 1;
                if socket.send(Message::text(asked.get())).await.is_err() {
                    break;
                }
            }
            said = timeout_at(since + patience, socket.next()) => match said {
                Ok(Some(Ok(Message::Text(text)))) => {
                    let Ok(item) = serde_json::from_str(&text) else { break };
                    let is_answer = matches!(item, PubSubItem::Response(_));
                    unanswered = unanswered.saturating_sub(u32::from(is_answer));
                    if is_answer || unanswered == 0 {
                        (is_asked, since) = (false, Instant::now());
                    }
                    if interface.send_to_frontend(item).is_err() {
                        return;
                    }
                }
                Ok(Some(Ok(Message::Ping(_) | Message::Pong(_)))) if unanswered > 0 => {}
                Ok(Some(Ok(Message::Ping(_) | Message::Pong(_)))) => (is_asked, since) = (false, Instant::now()),
                Err(_) if unanswered == 0 && !is_asked => {
                    (is_asked, since) = (true, Instant::now());
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

/// A stream that acknowledges at once what it reads.
struct Acknowledged(TcpStream);

impl AsyncRead for Acknowledged {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        // The kernel goes back to delaying by itself. Where it cannot be told, nothing but time is lost.
        let _ = SockRef::from(&self.0).set_tcp_quickack(true);
        Pin::new(&mut self.0).poll_read(cx, buf)
    }
}

impl AsyncWrite for Acknowledged {
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
