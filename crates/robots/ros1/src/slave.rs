//! What a node is asked by its master, by other nodes and by tools: calls to requests, and the form of answers.
//!
//! Source: ROS wiki, "ROS/Slave_API".

use crate::xmlrpc::{Call, Fault, Value};

/// What a node is asked for.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// How much went over each connection.
    BusStats,
    /// Which connections there are.
    BusInfo,
    /// Where its master is.
    MasterUri,
    /// To end.
    Shutdown {
        /// Why.
        reason: String,
    },
    /// Its process.
    Pid,
    /// Topics that it subscribes to, with their types.
    Subscriptions,
    /// Topics that it publishes, with their types.
    Publications,
    /// A parameter changed.
    ParamUpdate {
        /// Its global name.
        name: String,
        /// Its value; an empty struct if it is no longer set.
        value: Value,
    },
    /// These are a topic's publishers now.
    PublisherUpdate {
        /// The topic.
        topic: String,
        /// Addresses of their nodes.
        publishers: Vec<String>,
    },
    /// How to subscribe to a topic.
    Topic {
        /// The topic.
        topic: String,
        /// Protocols that the subscriber knows.
        protocols: Vec<String>,
    },
}

/// XML-RPC's own numbers for what is wrong have no source that all follow; rospy answers with 1, too.
const FAULT: i32 = 1;

impl Request {
    /// What a call asks for.
    ///
    /// # Errors
    /// The fault to answer with, if nodes have no such method or it has other arguments.
    pub fn read(call: Call) -> Result<Self, Fault> {
        let Call { method, arguments } = call;
        // The first is the caller's name.
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

/// It was done; this is what was asked for.
pub fn done(value: impl Into<Value>) -> Value {
    Value::Array(vec![1.into(), "".into(), value.into()])
}

/// It could not be done.
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
    fn calls_are_requests() {
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
    fn what_nodes_do_not_have_is_a_fault() {
        assert!(Request::read(call("system.listMethods", vec![])).is_err());
        assert!(Request::read(call("publisherUpdate", vec!["/scan".into(), vec![1].into()])).is_err());
        assert!(Request::read(call("paramUpdate", vec!["/a".into()])).is_err());
        assert!(Request::read(Call::new("requestTopic", vec![])).is_err());
    }
}
