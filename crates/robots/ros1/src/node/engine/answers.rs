//! Answers to calls of the slave API.

use std::{
    collections::BTreeMap,
    io::{ErrorKind, Read},
    sync::{Arc, atomic::Ordering},
};

use mio::{Token, net::TcpStream};

use super::{
    Engine,
    connection::{Connection, Next},
};
use crate::{
    buffers::Buffers,
    http,
    node::{
        shared::{Errand, Shared},
        subscription::Subscription,
    },
    queue::SendQueue,
    slave::{self, Request},
    uri::Endpoint,
    xmlrpc::{self, Call, Value},
};

/// Longest call, bytes.
const MAX_CALL: usize = 1 << 20;

impl Engine {
    /// Answers calls of the slave API.
    pub(super) fn answer(
        &mut self,
        shared: &Arc<Shared>,
        stream: TcpStream,
        (mut input, mut held): (Vec<u8>, Buffers),
        mut output: SendQueue,
        mut last: bool,
        mut active: bool,
    ) -> Next {
        let over = loop {
            if output.flush(&mut &stream).is_err() {
                break true;
            }
            if !output.is_empty() {
                break false;
            }
            if last {
                return Next::Again(Connection::Ending { stream, output });
            }
            match http::parse_request(&input, MAX_CALL) {
                Ok(Some(request)) => {
                    let answer = Call::from_xml(request.body).map_err(|error| xmlrpc::Fault::from(&error));
                    let answer = answer.and_then(Request::read).map(|request| self.fulfil(shared, request));
                    let response = http::response(&xmlrpc::answer_to_xml(&answer), request.keep_alive);
                    (last, active) = (!request.keep_alive, true);
                    let len = request.len;
                    input = input.split_off(len);
                    held.hold(input.len());
                    output.push(Arc::new(response));
                }
                Ok(None) => {
                    let mut piece = [0; 4096];
                    match (&stream).read(&mut piece) {
                        Ok(0) => break true,
                        Ok(read) if held.hold(input.len() + read) => input.extend_from_slice(&piece[..read]),
                        Ok(_) => break true,
                        Err(error) if error.kind() == ErrorKind::WouldBlock => break false,
                        Err(error) if error.kind() == ErrorKind::Interrupted => {}
                        Err(_) => break true,
                    }
                }
                Err(error) => {
                    tracing::debug!("{} received a request that is not HTTP: {error}", shared.names.node());
                    output.push(Arc::new(http::refusal()));
                    last = true;
                }
            }
        };
        let connection = Connection::Caller { stream, input, held, output, last, active };
        if over { Next::End(connection) } else { Next::Wait(connection) }
    }

    /// Carries out a request.
    fn fulfil(&mut self, shared: &Arc<Shared>, request: Request) -> Value {
        let state = shared.state.lock();
        match request {
            Request::BusStats => {
                drop(state);
                slave::done(self.bus_stats(shared))
            }
            Request::BusInfo => slave::done(self.bus_info()),
            Request::MasterUri => slave::done(shared.master.endpoint().http()),
            Request::Shutdown { reason } => {
                tracing::info!("{} was asked to shut down: {reason}", shared.names.node());
                shared.errand(Errand::Stop);
                slave::done(0)
            }
            Request::Pid => slave::done(i32::try_from(std::process::id()).unwrap_or_default()),
            Request::Subscriptions => {
                let topics: BTreeMap<_, _> =
                    state.subscriptions.values().map(|s| (s.topic.as_str(), s.kind.name)).collect();
                slave::done(topics.into_iter().map(|(topic, kind)| [topic, kind]).collect::<Vec<_>>())
            }
            Request::Publications => {
                let topics = state.publications.values().map(|p| [p.topic.as_str(), p.kind.name]);
                slave::done(topics.collect::<Vec<_>>())
            }
            Request::ParamUpdate { name, value } => {
                state.watches.values().for_each(|watch| watch.update(&name, &value));
                slave::done(0)
            }
            Request::PublisherUpdate { topic, publishers } => {
                let of_it = state.subscriptions.values().filter(|subscription| subscription.topic == topic);
                let notify = |subscription: &Arc<Subscription>| {
                    subscription.notified.store(true, Ordering::Release);
                    subscription.id
                };
                let subscriptions: Vec<_> = of_it.map(notify).collect();
                drop(state);
                for subscription in subscriptions {
                    self.set_publishers(shared, subscription, &publishers);
                }
                slave::done(0)
            }
            Request::Topic { topic, protocols } => {
                let Endpoint { host, port } = &shared.tcpros;
                if !state.publications.contains_key(&topic) {
                    slave::refused(&format!("{topic} is not published here"))
                } else if !protocols.iter().any(|protocol| protocol == "TCPROS") {
                    slave::refused("only TCPROS is spoken here")
                } else {
                    slave::done([Value::from("TCPROS"), host.as_str().into(), i32::from(*port).into()])
                }
            }
        }
    }

    /// `[id, peer, direction, transport, topic, connected]` of each connection.
    fn bus_info(&self) -> Vec<Value> {
        let entry = |token: &Token, peer: &str, direction: &str, topic: &str| {
            let id = i32::try_from(token.0).unwrap_or(i32::MAX);
            let rest = [peer, direction, "TCPROS", topic].map(Value::from);
            Value::Array([Value::Int(id)].into_iter().chain(rest).chain([Value::Bool(true)]).collect())
        };
        let connection = |(token, connection): (&Token, &Connection)| match connection {
            Connection::Subscriber { outgoing, publication } => {
                Some(entry(token, &outgoing.subscriber, "o", &publication.topic))
            }
            Connection::Publisher { publisher, subscription, flow, .. } if flow.begun => {
                Some(entry(token, publisher, "i", &subscription.topic))
            }
            _ => None,
        };
        self.connections.iter().filter_map(connection).collect()
    }

    /// Traffic of the connections of each topic, in the 32-bit numbers of XML-RPC.
    fn bus_stats(&self, shared: &Shared) -> Value {
        let number = |count: u64| Value::Int(i32::try_from(count).unwrap_or(i32::MAX));
        let mut sent: BTreeMap<String, (u64, Vec<Value>)> = BTreeMap::new();
        let mut received: BTreeMap<String, Vec<Value>> = BTreeMap::new();
        {
            let state = shared.state.lock();
            sent.extend(state.publications.keys().map(|topic| (topic.clone(), Default::default())));
            received.extend(state.subscriptions.values().map(|s| (s.topic.clone(), Vec::new())));
        }
        for (token, connection) in &self.connections {
            let id = number(token.0 as u64);
            match connection {
                Connection::Subscriber { outgoing, publication } => {
                    let (bytes, frames) = outgoing.sent();
                    let (total, entries) = sent.entry(publication.topic.clone()).or_default();
                    *total += bytes;
                    entries.push(Value::Array(vec![id, number(bytes), number(frames), true.into()]));
                }
                Connection::Publisher { subscription, flow, .. } if flow.begun => {
                    let dropped = number(subscription.inbox.dropped());
                    let entry = vec![id, number(flow.bytes), number(flow.messages), dropped, true.into()];
                    received.entry(subscription.topic.clone()).or_default().push(Value::Array(entry));
                }
                _ => {}
            }
        }
        let sent = sent.into_iter().map(|(topic, (total, entries))| {
            Value::Array(vec![topic.into(), number(total), Value::Array(entries)])
        });
        let received = received
            .into_iter()
            .map(|(topic, entries)| Value::Array(vec![topic.into(), Value::Array(entries)]));
        Value::Array(vec![
            Value::Array(sent.collect()),
            Value::Array(received.collect()),
            Value::Array(vec![0.into(), 0.into(), 0.into()]),
        ])
    }
}
