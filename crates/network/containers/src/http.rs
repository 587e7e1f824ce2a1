//! Requests over HTTP to a Unix socket, each over a connection of its own.

use std::{error::Error, path::Path};

use bytes::Bytes;
use http_body_util::{BodyExt as _, Full, LengthLimitError, Limited};
use hyper::{
    Method, Request, StatusCode,
    body::Incoming,
    client::conn::http1::handshake,
    header::{CONTENT_TYPE, HOST},
};
use hyper_util::rt::TokioIo;
use serde::de::DeserializeOwned;
use tokio::{net::UnixStream, task::JoinSet};

use crate::daemon_error::DaemonError;

/// Most bytes of an answer, or of a part of one that is streamed, which are in memory at once.
const MOST_BYTES: usize = 16 << 20;

/// Body of a request: its type, and its bytes.
pub(crate) type Content = (&'static str, Bytes);

/// An answer whose body is not read yet. Dropping it closes the connection.
#[derive(Debug)]
pub(crate) struct Answer {
    status: StatusCode,
    body: Incoming,
    /// Bytes of a streamed value whose rest has not arrived.
    rest: Vec<u8>,
    /// Drives the connection.
    _connection: JoinSet<()>,
}

impl From<hyper::Error> for DaemonError {
    fn from(error: hyper::Error) -> Self {
        Self::Lost(describe(&error))
    }
}

/// Returns an error with its causes, which say what the system rejected.
fn describe(error: &dyn Error) -> String {
    let causes = std::iter::successors(error.source(), |cause| (*cause).source());
    causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
}

/// Sends a request. `target` is the path with the query.
pub(crate) async fn send(
    socket: &Path,
    method: Method,
    target: &str,
    content: Option<Content>,
) -> Result<Answer, DaemonError> {
    let stream = UnixStream::connect(socket).await;
    let stream =
        stream.map_err(|e| DaemonError::Lost(format!("cannot connect to {}: {e}", socket.display())))?;
    let (mut sender, connection) = handshake(TokioIo::new(stream)).await?;
    let mut driver = JoinSet::new();
    // Its error is that of the request or of the body, too.
    driver.spawn(async move { drop(connection.await) });
    let request = Request::builder().method(method).uri(target).header(HOST, "localhost");
    let request = match content {
        Some((kind, bytes)) => request.header(CONTENT_TYPE, kind).body(Full::new(bytes)),
        None => request.body(Full::default()),
    };
    let request = request.map_err(|e| DaemonError::Rejected { status: 400, message: e.to_string() })?;
    let (head, body) = sender.send_request(request).await?.into_parts();
    Ok(Answer { status: head.status, body, rest: Vec::new(), _connection: driver })
}

impl Answer {
    pub(crate) fn status(&self) -> StatusCode {
        self.status
    }

    /// Reads all of the body.
    pub(crate) async fn bytes(self) -> Result<Bytes, DaemonError> {
        let status = self.status;
        let read = Limited::new(self.body, MOST_BYTES).collect().await;
        read.map(|read| read.to_bytes()).map_err(|error| match error.downcast::<hyper::Error>() {
            Ok(error) => (*error).into(),
            Err(error) if error.is::<LengthLimitError>() => too_long(status),
            Err(error) => DaemonError::Lost(error.to_string()),
        })
    }

    /// Reads the body as one JSON value.
    pub(crate) async fn json<T: DeserializeOwned>(self) -> Result<T, DaemonError> {
        let status = self.status;
        serde_json::from_slice(&self.bytes().await?).map_err(|error| unreadable(status, &error))
    }

    /// Returns the next part of the body, as it arrives; `None` at its end.
    pub(crate) async fn part(&mut self) -> Result<Option<Bytes>, DaemonError> {
        while let Some(frame) = self.body.frame().await {
            // The other frames are trailers.
            if let Ok(part) = frame?.into_data() {
                return Ok(Some(part));
            }
        }
        Ok(None)
    }

    /// Returns the next of the JSON values of the body, as it arrives; `None` at its end.
    pub(crate) async fn value<T: DeserializeOwned>(&mut self) -> Result<Option<T>, DaemonError> {
        loop {
            let mut values = serde_json::Deserializer::from_slice(&self.rest).into_iter();
            match values.next() {
                Some(Ok(value)) => {
                    let read = values.byte_offset();
                    self.rest.drain(..read);
                    return Ok(Some(value));
                }
                Some(Err(error)) if !error.is_eof() => return Err(unreadable(self.status, &error)),
                _ if self.rest.len() > MOST_BYTES => return Err(too_long(self.status)),
                _ => {}
            }
            match self.part().await? {
                Some(part) => self.rest.extend(part),
                None if self.rest.trim_ascii().is_empty() => return Ok(None),
                None => return Err(DaemonError::Lost("its answer ends within a value".to_owned())),
            }
        }
    }
}

fn unreadable(status: StatusCode, error: &serde_json::Error) -> DaemonError {
    DaemonError::Rejected { status: status.as_u16(), message: format!("its answer cannot be read: {error}") }
}

fn too_long(status: StatusCode) -> DaemonError {
    let message = format!("its answer is longer than {} MiB", MOST_BYTES >> 20);
    DaemonError::Rejected { status: status.as_u16(), message }
}
