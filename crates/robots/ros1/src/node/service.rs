//! Services: those that a node offers, and calls of others'.

use std::{
    fmt,
    io::{self, Read, Write},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, mpsc},
    thread,
    time::Duration,
};

use cotorra_ros_messages::{DecodeError, Message, Service};
use mio::Token;

use super::{Node, NodeError, Shared, engine::Command, keeper::Errand};
use crate::{
    master::{self, RpcError},
    names::NameError,
    tcpros::{self, Header, LENGTH_LEN, MAX_HEADER_LEN, MAX_MESSAGE_LEN},
    uri::{Endpoint, UriError},
};

/// A service that the node offers.
#[derive(Debug)]
pub(super) struct Offer {
    pub name: String,
    pub kind: &'static str,
    pub request_kind: &'static str,
    pub response_kind: &'static str,
    pub md5sum: String,
    /// Requests, and whose they are, to the service's thread.
    pub requests: mpsc::Sender<(Token, Vec<u8>)>,
}

impl Offer {
    /// What a client's connection header is answered with.
    pub fn header(&self, node: &str) -> Header {
        Header::new([
            ("callerid", node),
            ("service", &self.name),
            ("type", self.kind),
            ("request_type", self.request_kind),
            ("response_type", self.response_kind),
            ("md5sum", &self.md5sum),
        ])
    }
}

/// What a service answers: whether it worked, then the response or the reason, with its length.
pub(super) fn response<M: Message>(answer: Result<M, String>) -> Vec<u8> {
    let framed = match &answer {
        Ok(response) => tcpros::frame(|buffer| response.encode_ros1(buffer)),
        Err(reason) => tcpros::frame(|buffer| buffer.extend_from_slice(reason.as_bytes())),
    };
    [&[u8::from(answer.is_ok())], framed.as_slice()].concat()
}

/// A service that the node offers; no longer once it is dropped.
pub struct ServiceServer {
    shared: Arc<Shared>,
    name: String,
}

impl fmt::Debug for ServiceServer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ServiceServer").field(&self.name).finish()
    }
}

impl Drop for ServiceServer {
    fn drop(&mut self) {
        self.shared.state.lock().services.remove(&self.name);
        self.shared.command(Command::Unserved(self.name.clone()));
        self.shared.errand(Errand::Unserved(self.name.clone()));
    }
}

/// Why a service was not called, or failed.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// Its name is none.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The master does not know it, or is not there.
    #[error("the master: {0}")]
    Master(#[from] RpcError),
    /// The master knows an address that is none.
    #[error(transparent)]
    Address(#[from] UriError),
    /// It is not there, or does not answer in time.
    #[error("the service does not answer: {0}")]
    Unreachable(#[from] io::Error),
    /// It does not accept the connection: it has another type, for one.
    #[error("the service refuses the connection: {0}")]
    Refused(String),
    /// It answers that it failed.
    #[error("the service failed: {0}")]
    Failed(String),
    /// It answers with something else than its type says.
    #[error("the service answers with something else: {0}")]
    Response(#[from] DecodeError),
}

fn read_frame(stream: &mut impl Read, limit: usize) -> io::Result<Vec<u8>> {
    let mut length = [0; LENGTH_LEN];
    stream.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length) as usize;
    if length > limit {
        let error = tcpros::TcprosError::LongFrame { length, limit };
        return Err(io::Error::new(io::ErrorKind::InvalidData, error));
    }
    let mut frame = Vec::new();
    // Grows with what arrives.
    stream.take(length as u64).read_to_end(&mut frame)?;
    if frame.len() == length { Ok(frame) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}

impl Node {
    /// Offers a service. `answer` gives the response to each request, or the reason why not; requests are answered
    /// one at a time, on a thread of the service's own. If it holds a clone of the node, that lives as long as the
    /// service does.
    ///
    /// # Errors
    /// [`NodeError`] if `name` is none, the node offers it already, or the master fails.
    pub fn service<S: Service>(
        &self,
        name: &str,
        mut answer: impl FnMut(S::Request) -> Result<S::Response, String> + Send + 'static,
    ) -> Result<ServiceServer, NodeError> {
        let (shared, name) = (self.shared(), self.resolve(name)?);
        let (requests, received) = mpsc::channel::<(Token, Vec<u8>)>();
        let offer = Offer {
            name: name.clone(),
            kind: S::TYPE_NAME,
            request_kind: S::Request::ROS1_NAME,
            response_kind: S::Response::ROS1_NAME,
            md5sum: S::md5sum(),
            requests,
        };
        let answerer = Arc::clone(shared);
        // Ends when the last sender, the offer's, is dropped.
        thread::Builder::new().name("ros1-service".to_owned()).spawn(move || {
            for (client, request) in received {
                let answered = S::Request::decode_ros1(&request).map_err(|error| error.to_string()).and_then(
                    |request| {
                        catch_unwind(AssertUnwindSafe(|| answer(request)))
                            .unwrap_or_else(|_| Err("the service panicked".to_owned()))
                    },
                );
                answerer.command(Command::Response { client, response: response(answered) });
            }
        })?;
        let tcpros = shared.tcpros.rosrpc();
        shared.register(
            |state| {
                if state.services.contains_key(&name) {
                    return Err(NodeError::Taken(name.clone()));
                }
                state.services.insert(name.clone(), Arc::new(offer));
                Ok(())
            },
            |master| master.register_service(&name, &tcpros, &shared.api),
            |state| drop(state.services.remove(&name)),
        )?;
        Ok(ServiceServer { shared: Arc::clone(shared), name })
    }

    /// Calls a service, and waits for its response so long.
    ///
    /// # Errors
    /// [`CallError`] if there is no such service, it does not answer in time, or it answers that it failed.
    pub fn call<S: Service>(
        &self,
        name: &str,
        request: &S::Request,
        timeout: Duration,
    ) -> Result<S::Response, CallError> {
        let name = self.resolve(name)?;
        let endpoint: Endpoint = self.master().lookup_service(&name)?.parse()?;
        let mut stream = master::connect(&endpoint)?;
        let header = Header::new([
            ("callerid", self.name()),
            ("service", &name),
            ("type", S::TYPE_NAME),
            ("md5sum", &S::md5sum()),
            ("tcp_nodelay", "1"),
        ]);
        stream.write_all(&header.to_frame())?;
        let answered = Header::from_bytes(&read_frame(&mut stream, MAX_HEADER_LEN)?)
            .map_err(|error| CallError::Refused(error.to_string()))?;
        if let Some(error) = answered.get("error") {
            return Err(CallError::Refused(error.to_owned()));
        }
        // Zero would mean that it does not matter.
        stream.set_read_timeout(Some(timeout.max(Duration::from_millis(1))))?;
        stream.write_all(&tcpros::frame(|buffer| request.encode_ros1(buffer)))?;
        let mut worked = [0];
        stream.read_exact(&mut worked)?;
        let response = read_frame(&mut stream, MAX_MESSAGE_LEN)?;
        if worked == [0] {
            return Err(CallError::Failed(String::from_utf8_lossy(&response).into_owned()));
        }
        Ok(S::Response::decode_ros1(&response)?)
    }
}
