//! A client of the master and its parameter server, and of other nodes' slave APIs.
//!
//! Source: ROS wiki, "ROS/Master_API" and "ROS/Parameter Server API".

use std::{
    io::{self, Read, Write},
    net::{TcpStream, ToSocketAddrs},
    time::Duration,
};

use crate::{
    http::{self, HttpError},
    uri::Endpoint,
    xmlrpc::{self, Call, Fault, Value, XmlRpcError},
};

/// Longest response, bytes. Parameters may be large.
const MAX_ANSWER: usize = 16 << 20;

/// Deadline for a peer to accept a connection, and to answer.
pub(crate) const PATIENCE: Duration = Duration::from_secs(5);

/// Reason why a call to a node or the master failed.
#[derive(Debug, thiserror::Error)]
pub enum RpcError {
    /// The peer cannot be reached, or does not answer.
    #[error("{endpoint} does not answer: {reason}")]
    Unreachable {
        /// Address of the peer.
        endpoint: Endpoint,
        /// The cause.
        reason: io::Error,
    },
    /// The response is not HTTP.
    #[error(transparent)]
    Http(#[from] HttpError),
    /// The response is not XML-RPC.
    #[error(transparent)]
    XmlRpc(#[from] XmlRpcError),
    /// The peer does not know the method, or failed in it.
    #[error(transparent)]
    Fault(#[from] Fault),
    /// The peer rejected the call.
    #[error("{method}: {message}")]
    Refused {
        /// The called method.
        method: &'static str,
        /// The reason that it gave.
        message: String,
    },
    /// The response has another form than the method requires.
    #[error("the answer to {method} is not {expected}")]
    Answer {
        /// The called method.
        method: &'static str,
        /// The required form.
        expected: &'static str,
    },
}

/// Connects to the first of an endpoint's addresses that accepts.
pub(crate) fn connect(endpoint: &Endpoint) -> io::Result<TcpStream> {
    let mut result = Err(io::Error::new(io::ErrorKind::NotFound, "the host has no address"));
    for address in (endpoint.host.as_str(), endpoint.port).to_socket_addrs()? {
        result = TcpStream::connect_timeout(&address, PATIENCE);
        if result.is_ok() {
            break;
        }
    }
    let stream = result?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    Ok(stream)
}

fn exchange(endpoint: &Endpoint, request: &[u8]) -> io::Result<Result<Vec<u8>, HttpError>> {
    let mut stream = connect(endpoint)?;
    stream.write_all(request)?;
    let (mut answer, mut piece) = (Vec::new(), vec![0; 16 << 10]);
    loop {
        let read = stream.read(&mut piece)?;
        answer.extend_from_slice(&piece[..read]);
        match http::parse_response(&answer, read == 0, MAX_ANSWER) {
            Ok(Some(body)) => return Ok(Ok(body.to_vec())),
            Ok(None) => {}
            Err(error) => return Ok(Err(error)),
        }
    }
}

/// Calls a method of a node or a master. Both answer with `[code, message, value]`; returns the value.
pub(crate) fn ask(
    endpoint: &Endpoint,
    method: &'static str,
    arguments: Vec<Value>,
) -> Result<Value, RpcError> {
    let request = http::request(&endpoint.to_string(), &Call::new(method, arguments).to_xml());
    let unreachable = |reason| RpcError::Unreachable { endpoint: endpoint.clone(), reason };
    let body = exchange(endpoint, &request).map_err(unreachable)??;
    read_status(method, xmlrpc::answer_from_xml(&body)??)
}

/// Returns the value of `[code, message, value]` if the code means success.
fn read_status(method: &'static str, answer: Value) -> Result<Value, RpcError> {
    let wrong = RpcError::Answer { method, expected: "[code, message, value]" };
    let Value::Array(answer) = answer else { return Err(wrong) };
    let Ok([code, message, value]) = <[Value; 3]>::try_from(answer) else { return Err(wrong) };
    match (code.as_int(), message) {
        (Some(1), _) => Ok(value),
        (Some(_), Value::String(message)) => Err(RpcError::Refused { method, message }),
        _ => Err(wrong),
    }
}

/// Publishers, subscribers and servers: the name of each topic or service, with the names of the nodes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SystemState {
    /// Topics and their publishers.
    pub publishers: Vec<(String, Vec<String>)>,
    /// Topics and their subscribers.
    pub subscribers: Vec<(String, Vec<String>)>,
    /// Services and their servers.
    pub services: Vec<(String, Vec<String>)>,
}

/// A client of the master, on behalf of a node. Each call blocks until the answer arrives, for some seconds at most.
/// All names are global.
#[derive(Debug, Clone)]
pub struct Master {
    endpoint: Endpoint,
    /// Name of the calling node.
    caller: String,
}

fn strings(value: &Value) -> Option<Vec<String>> {
    value.as_array()?.iter().map(|item| item.as_str().map(str::to_owned)).collect()
}

fn pair(value: &Value) -> Option<(&str, &Value)> {
    let [name, value] = value.as_array()? else { return None };
    Some((name.as_str()?, value))
}

fn state(value: &Value) -> Option<SystemState> {
    let entries = |value: &Value| -> Option<Vec<(String, Vec<String>)>> {
        let entry = |entry| pair(entry).and_then(|(name, nodes)| Some((name.to_owned(), strings(nodes)?)));
        value.as_array()?.iter().map(entry).collect()
    };
    let [publishers, subscribers, services] = value.as_array()? else { return None };
    Some(SystemState {
        publishers: entries(publishers)?,
        subscribers: entries(subscribers)?,
        services: entries(services)?,
    })
}

/// All methods fail with [`RpcError`] if the master cannot be reached, rejects the call, or answers in another form.
#[expect(clippy::missing_errors_doc, reason = "the same for all methods")]
impl Master {
    /// A client of the master at `endpoint`, on behalf of the node `caller`.
    pub fn new(endpoint: Endpoint, caller: &str) -> Self {
        Self { endpoint, caller: caller.to_owned() }
    }

    /// Address of the master.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    fn ask<const N: usize>(&self, method: &'static str, arguments: [&str; N]) -> Result<Value, RpcError> {
        self.ask_with(method, arguments.map(Value::from))
    }

    fn ask_with<const N: usize>(
        &self,
        method: &'static str,
        arguments: [Value; N],
    ) -> Result<Value, RpcError> {
        let caller = std::iter::once(self.caller.as_str().into());
        ask(&self.endpoint, method, caller.chain(arguments).collect())
    }

    fn read<const N: usize, T>(
        &self,
        method: &'static str,
        arguments: [&str; N],
        expected: &'static str,
        read: impl FnOnce(&Value) -> Option<T>,
    ) -> Result<T, RpcError> {
        let value = self.ask(method, arguments)?;
        read(&value).ok_or(RpcError::Answer { method, expected })
    }

    /// Registers a publisher at `node`. Returns the addresses of the topic's subscribers.
    pub fn register_publisher(&self, topic: &str, kind: &str, node: &str) -> Result<Vec<String>, RpcError> {
        self.read("registerPublisher", [topic, kind, node], "addresses", strings)
    }

    /// Unregisters a publisher.
    pub fn unregister_publisher(&self, topic: &str, node: &str) -> Result<(), RpcError> {
        self.ask("unregisterPublisher", [topic, node]).map(drop)
    }

    /// Registers a subscriber at `node`. Returns the addresses of the topic's publishers.
    pub fn register_subscriber(&self, topic: &str, kind: &str, node: &str) -> Result<Vec<String>, RpcError> {
        self.read("registerSubscriber", [topic, kind, node], "addresses", strings)
    }

    /// Unregisters a subscriber.
    pub fn unregister_subscriber(&self, topic: &str, node: &str) -> Result<(), RpcError> {
        self.ask("unregisterSubscriber", [topic, node]).map(drop)
    }

    /// Registers a service at the address `service`, of the node at `node`.
    pub fn register_service(&self, name: &str, service: &str, node: &str) -> Result<(), RpcError> {
        self.ask("registerService", [name, service, node]).map(drop)
    }

    /// Unregisters a service.
    pub fn unregister_service(&self, name: &str, service: &str) -> Result<(), RpcError> {
        self.ask("unregisterService", [name, service]).map(drop)
    }

    /// Returns the address of a node.
    pub fn lookup_node(&self, name: &str) -> Result<String, RpcError> {
        self.read("lookupNode", [name], "an address", |value| value.as_str().map(str::to_owned))
    }

    /// Returns the address of a service.
    pub fn lookup_service(&self, name: &str) -> Result<String, RpcError> {
        self.read("lookupService", [name], "an address", |value| value.as_str().map(str::to_owned))
    }

    /// Returns all publishers, subscribers and servers.
    pub fn system_state(&self) -> Result<SystemState, RpcError> {
        self.read("getSystemState", [], "publishers, subscribers and services", state)
    }

    /// Returns topics and their types.
    pub fn topic_types(&self) -> Result<Vec<(String, String)>, RpcError> {
        self.read("getTopicTypes", [], "topics and types", |value| {
            let entry = |entry| {
                pair(entry).and_then(|(name, kind)| Some((name.to_owned(), kind.as_str()?.to_owned())))
            };
            value.as_array()?.iter().map(entry).collect()
        })
    }

    /// Returns a parameter, or a whole namespace of them; `None` if it is not set.
    pub fn param(&self, name: &str) -> Result<Option<Value>, RpcError> {
        match self.ask("getParam", [name]) {
            Ok(value) => Ok(Some(value)),
            Err(RpcError::Refused { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Sets a parameter; a struct sets a whole namespace.
    pub fn set_param(&self, name: &str, value: impl Into<Value>) -> Result<(), RpcError> {
        self.ask_with("setParam", [name.into(), value.into()]).map(drop)
    }

    /// Whether a parameter is set.
    pub fn has_param(&self, name: &str) -> Result<bool, RpcError> {
        self.read("hasParam", [name], "a flag", Value::as_bool)
    }

    /// Removes a parameter. Fails if it is not set.
    pub fn delete_param(&self, name: &str) -> Result<(), RpcError> {
        self.ask("deleteParam", [name]).map(drop)
    }

    /// Searches a relative name upwards from the node. Returns the global name of the nearest parameter.
    pub fn search_param(&self, name: &str) -> Result<Option<String>, RpcError> {
        match self.ask("searchParam", [name]) {
            Ok(found) => Ok(found.as_str().map(str::to_owned)),
            Err(RpcError::Refused { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns the names of all parameters.
    pub fn param_names(&self) -> Result<Vec<String>, RpcError> {
        self.read("getParamNames", [], "names", strings)
    }

    /// Subscribes the node at `node` to changes of a parameter. Returns its value, an empty struct if it is not set.
    pub fn subscribe_param(&self, name: &str, node: &str) -> Result<Value, RpcError> {
        self.ask("subscribeParam", [node, name])
    }

    /// Unsubscribes the node at `node` from changes of a parameter.
    pub fn unsubscribe_param(&self, name: &str, node: &str) -> Result<(), RpcError> {
        self.ask("unsubscribeParam", [node, name]).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(code: i32, message: &str, value: impl Into<Value>) -> Value {
        Value::Array(vec![code.into(), message.into(), value.into()])
    }

    #[test]
    fn only_a_success_code_has_a_value() {
        assert_eq!(read_status("m", status(1, "", "x")).unwrap(), "x".into());
        assert_eq!(
            read_status("m", status(-1, "unknown node", 0)).unwrap_err().to_string(),
            "m: unknown node"
        );
        assert!(matches!(read_status("m", Value::Int(1)), Err(RpcError::Answer { .. })));
        assert!(matches!(read_status("m", vec![1, 2].into()), Err(RpcError::Answer { .. })));
    }

    #[test]
    fn system_state_is_read_from_nested_lists() {
        let topic = Value::Array(vec!["/scan".into(), vec!["/robot", "/stage"].into()]);
        let value = Value::Array(vec![Value::Array(vec![topic]), Value::Array(vec![]), Value::Array(vec![])]);
        let scan = ("/scan".to_owned(), vec!["/robot".to_owned(), "/stage".to_owned()]);
        assert_eq!(state(&value), Some(SystemState { publishers: vec![scan], ..SystemState::default() }));
        assert_eq!(state(&Value::Array(vec![])), None);
    }
}
