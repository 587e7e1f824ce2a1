//! Serves connections: accepts them, closes those that are too many or too slow, and bounds the memory of each.

use std::{
    convert::Infallible,
    future, io,
    net::{IpAddr, Ipv4Addr},
    pin::Pin,
    sync::Arc,
    task::{Context, Poll, ready},
    time::Duration,
};

use axum::{
    Router,
    body::{Body, Bytes, HttpBody},
    extract::{Extension, Request},
    http::{
        HeaderValue, StatusCode,
        header::{CONNECTION, CONTENT_TYPE},
    },
    middleware::Next,
    response::{IntoResponse, Response},
};
use hyper::{
    body::{Frame, SizeHint},
    server::conn::http1,
    service::{Service, service_fn},
};
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use parking_lot::Mutex;
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpStream, UnixListener, UnixStream},
    sync::oneshot,
    time::{Sleep, sleep, timeout},
};
use tokio_rustls::server::TlsStream;
use tokio_stream::StreamExt as _;
use tokio_util::either::Either;

use super::{
    connections::{Connections, Full, Whose},
    tls::{self, Origin, Port},
    types::Failure,
};
use crate::capture::PCAPNG;

/// Buffer of a connection per direction, bytes; also the longest head of a request.
const BUFFER: usize = 16 << 10;
/// Longest body of a request, bytes.
const LONGEST_BODY: usize = 256 << 10;
/// Pause in accepting when the system has no descriptor left.
const BREATH: Duration = Duration::from_millis(10);

/// Deadlines of the API for its clients.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    /// For the handshake of TLS.
    pub(super) begin: Duration,
    /// For a request's head, also after a previous request.
    pub(super) head: Duration,
    /// For a request's body.
    pub(super) body: Duration,
    /// For some of an answer to be taken.
    pub(super) answer: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            begin: Duration::from_secs(10),
            // Longer than clients keep a connection for their next request.
            head: Duration::from_secs(30),
            body: Duration::from_secs(10),
            // Longer than virtual time waits for a plug-in, which may read nothing meanwhile.
            answer: Duration::from_secs(120),
        }
    }
}

/// Makes a connection ready for requests.
type Beginning<S> = Pin<Box<dyn Future<Output = io::Result<S>> + Send>>;

/// A listener of any kind.
pub(super) trait Accept {
    type Socket: Send + 'static;
    type Stream: AsyncRead + AsyncWrite + Unpin + Send + 'static;

    /// Returns the origin of connections.
    fn origin(&self) -> Origin;

    /// Accepts the next connection. Returns the address whose connections share places with it, too.
    async fn accept(&self) -> io::Result<(Self::Socket, IpAddr)>;

    /// Makes a connection ready for its first request, as by the handshake of TLS.
    fn begin(&self, socket: Self::Socket) -> Beginning<Self::Stream>;
}

impl Accept for Port {
    type Socket = TcpStream;
    type Stream = Either<TcpStream, TlsStream<TcpStream>>;

    fn origin(&self) -> Origin {
        self.origin
    }

    async fn accept(&self) -> io::Result<(TcpStream, IpAddr)> {
        let (stream, from) = self.listener.accept().await?;
        // Events are sent at once, without waiting for the reader's acknowledgement of earlier ones.
        let _ = stream.set_nodelay(true);
        Ok((stream, from.ip()))
    }

    fn begin(&self, socket: TcpStream) -> Beginning<Self::Stream> {
        match self.tls.clone() {
            None => Box::pin(future::ready(Ok(Either::Left(socket)))),
            Some(tls) => Box::pin(tls::begin(tls, socket, BUFFER)),
        }
    }
}

impl Accept for UnixListener {
    type Socket = UnixStream;
    type Stream = UnixStream;

    fn origin(&self) -> Origin {
        Origin::User
    }

    async fn accept(&self) -> io::Result<(UnixStream, IpAddr)> {
        let (stream, _) = self.accept().await?;
        Ok((stream, Ipv4Addr::LOCALHOST.into()))
    }

    fn begin(&self, socket: UnixStream) -> Beginning<UnixStream> {
        Box::pin(future::ready(Ok(socket)))
    }
}

/// The places of one or several listeners.
pub(super) type Places = Arc<Mutex<Connections<Close>>>;

/// Serves until it is dropped.
pub(super) async fn serve<L: Accept>(listener: L, app: Router, connections: Places, patience: Patience) {
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(patience.head).max_buf_size(BUFFER);
    let app = TowerToHyperService::new(app);
    // Far fewer than there are places. More than one, because each pause costs a system call.
    let (batch, mut accepted) = ((connections.lock().limits().strangers / 8).max(1), 0_usize);
    loop {
        let (socket, from) = match listener.accept().await {
            Ok(connection) => connection,
            Err(error) if is_of_connection(&error) => continue,
            Err(error) => {
                tracing::debug!("the API accepts no connection: {error}");
                connections.lock().shed();
                sleep(BREATH).await;
                continue;
            }
        };
        let (close, closed) = oneshot::channel();
        let number = connections.lock().arrive(from, close);
        let connections = Arc::clone(&connections);
        let place = Arc::new(Place { connections, number, patience, origin: listener.origin() });
        let (http, app, begun) = (http.clone(), app.clone(), listener.begin(socket));
        tokio::spawn(async move {
            let connection = async {
                let Ok(Ok(stream)) = timeout(patience.begin, begun).await else { return };
                let stream = Impatient { stream, wait: None, place: Arc::clone(&place) };
                let service = service_fn(move |mut request: Request<hyper::body::Incoming>| {
                    request.extensions_mut().insert(Arc::clone(&place));
                    app.call(request)
                });
                // A client that breaks off only harms itself.
                let _ = http.serve_connection(TokioIo::new(stream), service).with_upgrades().await;
            };
            tokio::select! {
                () = connection => {}
                _ = closed => {}
            }
        });
        // Requests that have arrived are handled before other connections can push them out.
        accepted += 1;
        if accepted % batch == 0 {
            tokio::task::yield_now().await;
        }
    }
}

/// Whether accepting failed only for that one connection, which is gone.
fn is_of_connection(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

pub(super) type Close = oneshot::Sender<Infallible>;

/// A connection's place; released when the connection is closed.
pub(super) struct Place {
    connections: Arc<Mutex<Connections<Close>>>,
    number: u64,
    patience: Patience,
    origin: Origin,
}

impl Place {
    /// Returns the origin of the connection.
    pub(super) fn origin(&self) -> Origin {
        self.origin
    }

    /// Admits a request, and reads its body.
    pub(super) async fn let_in(&self, whose: Whose, request: Request) -> Result<Request, Failure> {
        self.connections.lock().let_in(self.number, whose)?;
        self.read(request).await
    }

    /// Reads the body of a request.
    pub(super) async fn read(&self, request: Request) -> Result<Request, Failure> {
        let (head, body) = request.into_parts();
        let body = timeout(self.patience.body, read(body)).await.map_err(|_| {
            let patience = self.patience.body.as_secs_f64();
            Failure::new(
                StatusCode::REQUEST_TIMEOUT,
                format!("the rest of the request did not come within {patience} s"),
            )
        })??;
        Ok(Request::from_parts(head, body.into()))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.connections.lock().leave(self.number);
    }
}

impl From<Full> for Failure {
    fn from(full: Full) -> Self {
        Self::new(StatusCode::TOO_MANY_REQUESTS, full.to_string())
    }
}

/// Reads a body of bounded length.
async fn read(body: Body) -> Result<Bytes, Failure> {
    let too_long = || {
        Failure::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            format!("the request is longer than {} KiB, and no instruction is", LONGEST_BODY >> 10),
        )
    };
    if body.size_hint().lower() > LONGEST_BODY as u64 {
        return Err(too_long());
    }
    let (mut parts, mut all) = (body.into_data_stream(), Vec::new());
    while let Some(part) = parts.next().await {
        let part =
            part.map_err(|error| Failure::bad_request(format!("the request's body broke off: {error}")))?;
        if all.len() + part.len() > LONGEST_BODY {
            return Err(too_long());
        }
        all.extend_from_slice(&part);
    }
    Ok(all.into())
}

/// Tracks whether each connection is being answered.
pub(super) async fn attend(
    Extension(place): Extension<Arc<Place>>,
    request: Request,
    next: Next,
) -> Response {
    let mut response = next.run(request).await;
    if !place.connections.lock().is_let_in(place.number) {
        // The place goes to another connection.
        response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
        return response;
    }
    let is_upgraded = response.status() == StatusCode::SWITCHING_PROTOCOLS;
    let kind = response.headers().get(CONTENT_TYPE);
    let is_stream = is_upgraded || kind.is_some_and(|kind| kind == "text/event-stream" || kind == PCAPNG);
    if is_stream {
        let streams = place.connections.lock().stream(place.number);
        if let Err(full) = streams {
            response = Failure::from(full).into_response();
        } else if is_upgraded {
            return response;
        }
    }
    response.map(|body| Body::new(Answer { body, place }))
}

/// An answer's body, which reports the end of the answer.
struct Answer {
    body: Body,
    place: Arc<Place>,
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for Answer {
    fn drop(&mut self) {
        self.place.connections.lock().rest(self.place.number);
    }
}

/// A connection that fails when the client takes nothing of an answer for too long.
struct Impatient<S> {
    stream: S,
    wait: Option<Pin<Box<Sleep>>>,
    /// Held as long as the connection is open, also after it became a WebSocket.
    place: Arc<Place>,
}

impl<S> Impatient<S> {
    fn wrote<T>(&mut self, context: &mut Context<'_>, wrote: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if wrote.is_ready() {
            self.wait = None;
            return wrote;
        }
        let patience = self.place.patience.answer;
        let wait = self.wait.get_or_insert_with(|| Box::pin(sleep(patience)));
        ready!(wait.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Impatient<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Impatient<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let wrote = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.wrote(context, wrote)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let wrote = Pin::new(&mut self.stream).poll_write_vectored(context, parts);
        self.wrote(context, wrote)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    // TLS keeps what the client does not take, up to a buffer.
    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let flushed = Pin::new(&mut self.stream).poll_flush(context);
        self.wrote(context, flushed)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let shut_down = Pin::new(&mut self.stream).poll_shutdown(context);
        self.wrote(context, shut_down)
    }
}
