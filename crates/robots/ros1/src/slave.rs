//! The slave API, by which the master, other nodes and tools call a node: requests, and the form of answers.
//!
//! Source: ROS wiki, "ROS/Slave_API".

use crate::xmlrpc::{Call, Fault, Value};

/// A call of the slave API.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// Traffic of each connection.
    BusStats,
    /// The open connections.
    BusInfo,
    /// Address of the master.
    MasterUri,
    /// Shuts the node down.
    Shutdown {
        /// The reason.
        reason: String,
    },
    /// Process number of the node.
    Pid,
    /// Subscribed topics, with their types.
    Subscriptions,
    /// Published topics, with their types.
    Publications,
    /// A watched parameter changed.
    ParamUpdate {
        /// Its global name.
        name: String,
        /// Its value; an empty struct if it is no longer set.
        value: Value,
    },
    /// The publishers of a topic changed.
    PublisherUpdate {
        /// The topic.
        topic: String,
        /// Addresses of their nodes.
        publishers: Vec<String>,
    },
    /// Returns the protocol and address for a subscription.
    Topic {
        /// The topic.
        topic: String,
        /// Protocols that the subscriber supports.
        protocols: Vec<String>,
    },
}

/// Fault code. XML-RPC defines none that all follow; rospy uses 1, too.
const FAULT: i32 = 1;

impl Request {
    /// Reads a call.
    ///
    /// # Errors
    /// The fault to return, if nodes have no such method or it has other arguments.
    pub fn read(call: Call) -> Result<Self, Fault> {
        let Call { method, arguments } = call;
        // The first argument is the caller's name.
        let mut arguments = arguments.into_iter().skip(1);
        let mut next = || arguments.next();
        let request = match method.as_str() {
            "getBusStats" => Some(Self::BusStats),
            "getBusInfo" => Some(Self::BusInfo),
            "getMasterUri" => Some(Self::MasterUri),
            "shutdown" => {
                Some(Self::Shutdown { reason: next().and_then(|reason| text(&reason)).unwrap_or_default() })
            }
            "getPid" => Some(Self::Pid),
            "getSubscriptions" => Some(Self::Subscriptions),
            "getPublications" => Some(Self::Publications),
            "paramUpdate" => (|| Some(Self::ParamUpdate { name: text(&next()?)?, value: next()? }))(),
            "publisherUpdate" => (|| {
                let (topic, publishers) = (text(&next()?)?, next()?);
                let publishers = publishers.as_array()?.iter().map(text).collect::<Option<_>>()?;
                Some(Self::PublisherUpdate { topic, publishers })
            })(),
            "requestTopic" => (|| {
                let (topic, protocols) = (text(&next()?)?, next()?);
                let protocols = protocols.as_array()?.iter().filter_map(|p| text(p.as_array()?.first()?));
                Some(Self::Topic { topic, protocols: protocols.collect() })
            })(),
            _ => return Err(Fault { code: FAULT, message: format!("nodes have no method {method}") }),
        };
        request.ok_or_else(|| Fault { code: FAULT, message: format!("{method} has other arguments") })
    }
}

fn text(value: &Value) -> Option<String> {
    value.as_str().map(str::to_owned)
}

/// The answer to a successful call.
pub fn done(value: impl Into<Value>) -> Value {
    Value::Array(vec![1.into(), "".into(), value.into()])
}

/// The answer to a failed call.
pub fn refused(message: &str) -> Value {
    Value::Array(vec![0.into(), message.into(), 0.into()])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn call(method: &str, arguments: Vec<Value>) -> Call {
        Call::new(method, std::iter::once("/master".into()).chain(arguments).collect())
    }

    #[test]
    fn calls_are_read_as_requests() {
        let update = call("publisherUpdate", vec!["/scan".into(), vec!["http://a:1/"].into()]);
        let publishers = vec!["http://a:1/".to_owned()];
        assert_eq!(
            Request::read(update),
            Ok(Request::PublisherUpdate { topic: "/scan".to_owned(), publishers })
        );
        let protocols = Value::from(vec![Value::from(vec!["UDPROS", "x"]), Value::from(vec!["TCPROS"])]);
        let topic = call("requestTopic", vec!["/scan".into(), protocols]);
        let protocols = vec!["UDPROS".to_owned(), "TCPROS".to_owned()];
        assert_eq!(Request::read(topic), Ok(Request::Topic { topic: "/scan".to_owned(), protocols }));
        assert_eq!(Request::read(call("shutdown", vec![])), Ok(Request::Shutdown { reason: String::new() }));
    }

    #[test]
    fn unknown_methods_of_a_node_are_faults() {
        assert!(Request::read(call("system.listMethods", vec![])).is_err());
        assert!(Request::read(call("publisherUpdate", vec!["/scan".into(), vec![1].into()])).is_err());
        assert!(Request::read(call("paramUpdate", vec!["/a".into()])).is_err());
        assert!(Request::read(Call::new("requestTopic", vec![])).is_err());
    }
}
