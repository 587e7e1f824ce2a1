//! Service servers, and calls of services.

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

use super::{
    offer::{Offer, response},
    shared::{Command, Errand, NodeError, Shared},
};
use crate::{
    master::{self, RpcError},
    names::NameError,
    tcpros::{self, Header, LENGTH_LEN, MAX_HEADER_LEN, MAX_MESSAGE_LEN},
    uri::{Endpoint, UriError},
};

/// Offers a service until it is dropped.
pub struct ServiceServer {
    shared: Arc<Shared>,
    name: String,
}

impl ServiceServer {
    /// Offers a service under a global name.
    pub(super) fn offer<S: Service>(
        shared: &Arc<Shared>,
        name: String,
        mut answer: impl FnMut(S::Request) -> Result<S::Response, String> + Send + 'static,
    ) -> Result<Self, NodeError> {
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
        // Ends when the only sender, in the offer, is dropped.
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
        Ok(Self { shared: Arc::clone(shared), name })
    }
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

/// Reason why a call of a service failed.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// Its name is invalid.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The master does not know it, or cannot be reached.
    #[error("the master: {0}")]
    Master(#[from] RpcError),
    /// The master returned an invalid address.
    #[error(transparent)]
    Address(#[from] UriError),
    /// The service cannot be reached, or does not answer in time.
    #[error("the service does not answer: {0}")]
    Unreachable(#[from] io::Error),
    /// The service rejected the connection, for example because of another type.
    #[error("the service rejects the connection: {0}")]
    Refused(String),
    /// The service reported a failure.
    #[error("the service failed: {0}")]
    Failed(String),
    /// The response does not fit the type.
    #[error("the response does not fit the type: {0}")]
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
    // Grows with received bytes.
    stream.take(length as u64).read_to_end(&mut frame)?;
    if frame.len() == length { Ok(frame) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}

/// Calls the service of a global name.
pub(super) fn call<S: Service>(
    shared: &Shared,
    name: &str,
    request: &S::Request,
    timeout: Duration,
) -> Result<S::Response, CallError> {
    let endpoint: Endpoint = shared.master.lookup_service(name)?.parse()?;
    let mut stream = master::connect(&endpoint)?;
    let header = Header::new([
        ("callerid", shared.names.node()),
        ("service", name),
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
    // Zero would mean no timeout.
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
