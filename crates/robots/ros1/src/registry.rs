//! The state of a master: publishers, subscribers, services, watches and parameters. It takes calls, and returns answers
//! and notices to nodes.
//!
//! Source: ROS wiki, "ROS/Master_API" and "ROS/Parameter Server API".

use std::{collections::BTreeMap, net::IpAddr};

use crate::{
    slave::done,
    xmlrpc::{Call, Fault, Value},
};

/// A call that the master owes a node. What it says is decided when it is made, so that many changes need one call only.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Notice {
    /// The address that registered the node for it.
    pub owner: IpAddr,
    /// The node's address.
    pub node: String,
    pub about: About,
}

/// Subject of a notice.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum About {
    /// Publishers of a topic.
    Publishers(String),
    /// A parameter.
    Parameter(String),
    /// Another node took its name.
    Shutdown(String),
}

/// Nodes registered for each name, with the addresses that registered them.
type Entries = BTreeMap<String, BTreeMap<String, IpAddr>>;

/// Longest name of a node, topic, type, service or parameter, and longest address, bytes.
const LONGEST_NAME: usize = 512;
/// Most registrations of publishers, subscribers, services and watched parameters.
const MOST_REGISTRATIONS: usize = 8192;
/// Most of these by one address.
const MOST_OF_ADDRESS: usize = 2048;
/// Most bytes that parameters take, with their names and structures.
const MOST_PARAMETER_BYTES: usize = 4 << 20;
/// Most of these that one address has set.
const MOST_PARAMETER_BYTES_OF_ADDRESS: usize = 2 << 20;
/// Bytes of a value in addition to its text.
const OVERHEAD: usize = 64;

/// The state of a master.
#[derive(Debug)]
pub(crate) struct Registry {
    /// The master's address.
    uri: String,
    /// Addresses of nodes, and who registered them there, by name.
    nodes: BTreeMap<String, (String, IpAddr)>,
    publishers: Entries,
    subscribers: Entries,
    watchers: Entries,
    /// Nodes and addresses of services, and who registered them.
    services: BTreeMap<String, (String, String, IpAddr)>,
    /// Number of registrations by each address.
    registered: BTreeMap<IpAddr, usize>,
    /// Types of topics that are registered.
    types: BTreeMap<String, String>,
    params: Value,
    /// Bytes that the parameters take.
    param_bytes: usize,
    /// The address that set each parameter or namespace, and the bytes that it took.
    authors: BTreeMap<String, (IpAddr, usize)>,
}

/// Caller name of a master.
const MASTER: &str = "/master";

fn unknown(what: &str, name: &str) -> Value {
    refused(&format!("unknown {what} {name}"))
}

/// Returns the answer to a call that is rejected.
fn refused(reason: &str) -> Value {
    Value::Array(vec![(-1).into(), reason.into(), 0.into()])
}

/// Returns the bytes that a value takes.
fn size(value: &Value) -> usize {
    OVERHEAD
        + match value {
            Value::Bool(_) | Value::Int(_) | Value::Double(_) => 0,
            Value::String(text) | Value::DateTime(text) => text.len(),
            Value::Bytes(bytes) => bytes.len(),
            Value::Array(values) => values.iter().map(size).sum(),
            Value::Struct(members) => {
                members.iter().map(|(name, value)| OVERHEAD + name.len() + size(value)).sum()
            }
        }
}

fn path(name: &str) -> impl Iterator<Item = &str> {
    name.split('/').filter(|part| !part.is_empty())
}

/// Normalizes a name: a slash before each part, and none at the end.
fn canonical(name: &str) -> String {
    path(name).flat_map(|part| ["/", part]).collect()
}

fn find<'a>(params: &'a Value, name: &str) -> Option<&'a Value> {
    path(name).try_fold(params, |at, part| match at {
        Value::Struct(members) => members.get(part),
        _ => None,
    })
}

/// Returns the members of a namespace. Creates it if it is missing.
fn namespace<'a>(mut at: &'a mut Value, parts: &[&str]) -> &'a mut BTreeMap<String, Value> {
    for part in parts {
        at = members(at).entry((*part).to_owned()).or_insert_with(empty);
    }
    members(at)
}

fn members(value: &mut Value) -> &mut BTreeMap<String, Value> {
    if !matches!(value, Value::Struct(_)) {
        *value = empty();
    }
    match value {
        Value::Struct(members) => members,
        _ => unreachable!("it was made a struct"),
    }
}

fn empty() -> Value {
    Value::Struct(BTreeMap::new())
}

fn leaves(value: &Value, name: &str, names: &mut Vec<String>) {
    match value {
        Value::Struct(members) => {
            members.iter().for_each(|(part, value)| leaves(value, &format!("{name}/{part}"), names));
        }
        _ => names.push(name.to_owned()),
    }
}

fn lists(entries: &Entries) -> Value {
    let entry = |(name, nodes): (&String, &BTreeMap<String, IpAddr>)| {
        let nodes = nodes.keys().map(String::as_str).collect::<Vec<_>>();
        Value::Array(vec![name.as_str().into(), nodes.into()])
    };
    Value::Array(entries.iter().map(entry).collect())
}

/// Adds a registration, unless it is there.
fn add(entries: &mut Entries, registered: &mut BTreeMap<IpAddr, usize>, by: IpAddr, name: &str, node: &str) {
    let nodes = entries.entry(name.to_owned()).or_default();
    if !nodes.contains_key(node) {
        nodes.insert(node.to_owned(), by);
        *registered.entry(by).or_default() += 1;
    }
}

/// Takes a registration off the number of its address.
fn forget(registered: &mut BTreeMap<IpAddr, usize>, by: IpAddr) {
    if let Some(count) = registered.get_mut(&by) {
        *count -= 1;
        if *count == 0 {
            registered.remove(&by);
        }
    }
}

fn remove(entries: &mut Entries, registered: &mut BTreeMap<IpAddr, usize>, name: &str, node: &str) -> bool {
    let Some(nodes) = entries.get_mut(name) else { return false };
    let removed = nodes.remove(node);
    if nodes.is_empty() {
        entries.remove(name);
    }
    removed.inspect(|by| forget(registered, *by)).is_some()
}

/// Whether a canonical name is that of a parameter, or of one in it.
fn within(inner: &str, outer: &str) -> bool {
    inner.strip_prefix(outer).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

impl Registry {
    /// An empty master at an address.
    pub fn new(uri: String) -> Self {
        Self {
            uri,
            nodes: BTreeMap::new(),
            publishers: Entries::new(),
            subscribers: Entries::new(),
            watchers: Entries::new(),
            services: BTreeMap::new(),
            registered: BTreeMap::new(),
            types: BTreeMap::new(),
            param_bytes: size(&empty()),
            params: empty(),
            authors: BTreeMap::new(),
        }
    }

    /// Returns the method and the arguments of a notice as they are now.
    pub fn call_of(&self, notice: &Notice) -> (&'static str, Vec<Value>) {
        match &notice.about {
            About::Publishers(topic) => {
                let publishers = self.addresses(&self.publishers, topic);
                ("publisherUpdate", vec![MASTER.into(), topic.as_str().into(), publishers])
            }
            About::Parameter(name) => {
                let value = find(&self.params, name).cloned().unwrap_or_else(empty);
                ("paramUpdate", vec![MASTER.into(), format!("{name}/").into(), value])
            }
            About::Shutdown(node) => {
                ("shutdown", vec![MASTER.into(), format!("another node took the name {node}").into()])
            }
        }
    }

    /// Carries out a call of an address. Appends the notices to other nodes to `notices`.
    ///
    /// # Errors
    /// The fault to return, if masters have no such method or it has other arguments.
    pub fn answer(&mut self, by: IpAddr, call: &Call, notices: &mut Vec<Notice>) -> Result<Value, Fault> {
        let texts: Option<Vec<&str>> = call.arguments.iter().map(Value::as_str).collect();
        let caller = call.arguments.first().and_then(Value::as_str).unwrap_or_default();
        if call.arguments.iter().take(4).filter_map(Value::as_str).any(|text| text.len() > LONGEST_NAME)
            && call.method != "setParam"
        {
            return Ok(refused(&format!("names and addresses have {LONGEST_NAME} bytes at most")));
        }
        if call.method.starts_with("register") || call.method == "subscribeParam" {
            let of_address = self.registered.get(&by).copied().unwrap_or_default();
            if of_address >= MOST_OF_ADDRESS {
                let reason =
                    format!("{by} has {MOST_OF_ADDRESS} registrations, which is the most: unregister some");
                return Ok(refused(&reason));
            }
            if self.registered.values().sum::<usize>() >= MOST_REGISTRATIONS {
                return Ok(refused(&format!(
                    "this master has {MOST_REGISTRATIONS} registrations, which is the most"
                )));
            }
        }
        let answer = match (call.method.as_str(), texts.as_deref(), call.arguments.as_slice()) {
            ("registerPublisher", Some([node, topic, kind, api]), _) => {
                self.meet(by, node, api, notices);
                add(&mut self.publishers, &mut self.registered, by, topic, node);
                self.learn_type(topic, kind);
                self.tell_publishers(topic, notices);
                done(self.addresses(&self.subscribers, topic))
            }
            ("unregisterPublisher", Some([node, topic, api]), _) => {
                let known =
                    self.is_at(node, api) && remove(&mut self.publishers, &mut self.registered, topic, node);
                if known {
                    self.tell_publishers(topic, notices);
                }
                self.forget_type(topic);
                self.part(node);
                done(i32::from(known))
            }
            ("registerSubscriber", Some([node, topic, kind, api]), _) => {
                self.meet(by, node, api, notices);
                add(&mut self.subscribers, &mut self.registered, by, topic, node);
                self.learn_type(topic, kind);
                done(self.addresses(&self.publishers, topic))
            }
            ("unregisterSubscriber", Some([node, topic, api]), _) => {
                let known =
                    self.is_at(node, api) && remove(&mut self.subscribers, &mut self.registered, topic, node);
                self.forget_type(topic);
                self.part(node);
                done(i32::from(known))
            }
            ("registerService", Some([node, name, service, api]), _) => {
                self.meet(by, node, api, notices);
                let server = ((*node).to_owned(), (*service).to_owned(), by);
                *self.registered.entry(by).or_default() += 1;
                if let Some((.., before)) = self.services.insert((*name).to_owned(), server) {
                    forget(&mut self.registered, before);
                }
                done(1)
            }
            ("unregisterService", Some([node, name, service]), _) => {
                let known = self.services.get(*name).is_some_and(|(_, at, _)| at == service);
                if let Some((.., by)) = known.then(|| self.services.remove(*name)).flatten() {
                    forget(&mut self.registered, by);
                }
                self.part(node);
                done(i32::from(known))
            }
            ("lookupNode", Some([_, name]), _) => {
                self.nodes.get(*name).map_or_else(|| unknown("node", name), |(api, _)| done(api.as_str()))
            }
            ("lookupService", Some([_, name]), _) => self
                .services
                .get(*name)
                .map_or_else(|| unknown("service", name), |(_, at, _)| done(at.as_str())),
            ("getSystemState", ..) => {
                let services = self.services.iter();
                let services =
                    services.map(|(name, (node, _, by))| (name.clone(), [(node.clone(), *by)].into()));
                let state = [lists(&self.publishers), lists(&self.subscribers), lists(&services.collect())];
                done(Value::from(state.to_vec()))
            }
            ("getTopicTypes", ..) => done(self.topic_types(|_| true)),
            ("getPublishedTopics", Some([_, within]), _) => {
                let within = canonical(within);
                done(self.topic_types(|topic| {
                    let inside = topic.strip_prefix(&within).is_some_and(|rest| rest.starts_with('/'));
                    inside && self.publishers.contains_key(topic)
                }))
            }
            ("getUri", ..) => done(self.uri.as_str()),
            ("getPid", ..) => done(i32::try_from(std::process::id()).unwrap_or_default()),
            ("setParam", _, [_, Value::String(name), value]) => {
                match self.set_param(by, name, value.clone()) {
                    Ok(()) => {
                        self.tell_watchers(name, caller, notices);
                        done(0)
                    }
                    Err(reason) => refused(&reason),
                }
            }
            ("getParam", Some([_, name]), _) => find(&self.params, name)
                .map_or_else(|| unknown("parameter", name), |value| done(value.clone())),
            ("hasParam", Some([_, name]), _) => done(find(&self.params, name).is_some()),
            ("deleteParam", Some([_, name]), _) => {
                if find(&self.params, name).is_none() {
                    unknown("parameter", name)
                } else {
                    self.remove_param(name);
                    self.tell_watchers(name, caller, notices);
                    done(0)
                }
            }
            ("searchParam", Some([from, name]), _) => match self.search_param(from, name) {
                Some(found) => done(found),
                None => unknown("parameter", name),
            },
            ("getParamNames", ..) => {
                let mut names = Vec::new();
                leaves(&self.params, "", &mut names);
                done(names)
            }
            ("subscribeParam", Some([node, api, name]), _) => {
                self.meet(by, node, api, notices);
                add(&mut self.watchers, &mut self.registered, by, &canonical(name), node);
                done(find(&self.params, name).cloned().unwrap_or_else(empty))
            }
            ("unsubscribeParam", Some([node, api, name]), _) => {
                let known = self.is_at(node, api)
                    && remove(&mut self.watchers, &mut self.registered, &canonical(name), node);
                self.part(node);
                done(i32::from(known))
            }
            (method, ..) => {
                return Err(Fault {
                    code: 1,
                    message: format!("masters have no {method} with such arguments"),
                });
            }
        };
        Ok(answer)
    }

    /// Notes the address of a node. A node of the same name at another address gets a request to shut down.
    fn meet(&mut self, by: IpAddr, node: &str, api: &str, notices: &mut Vec<Notice>) {
        if self.is_at(node, api) {
            return;
        }
        let Some((before, owner)) = self.nodes.insert(node.to_owned(), (api.to_owned(), by)) else { return };
        notices.push(Notice { owner, node: before, about: About::Shutdown(node.to_owned()) });
        let of_node = self.publishers.iter().filter(|(_, nodes)| nodes.contains_key(node));
        let topics: Vec<_> = of_node.map(|(topic, _)| topic.clone()).collect();
        let registered = &mut self.registered;
        for entries in [&mut self.publishers, &mut self.subscribers, &mut self.watchers] {
            entries.retain(|_, nodes| {
                if let Some(by) = nodes.remove(node) {
                    forget(registered, by);
                }
                !nodes.is_empty()
            });
        }
        self.services.retain(|_, (server, _, by)| {
            let stays = server != node;
            if !stays {
                forget(registered, *by);
            }
            stays
        });
        let (publishers, subscribers) = (&self.publishers, &self.subscribers);
        self.types.retain(|topic, _| publishers.contains_key(topic) || subscribers.contains_key(topic));
        topics.iter().for_each(|topic| self.tell_publishers(topic, notices));
    }

    fn is_at(&self, node: &str, api: &str) -> bool {
        self.nodes.get(node).is_some_and(|(known, _)| known == api)
    }

    /// Removes a node without registrations.
    fn part(&mut self, node: &str) {
        let mut entries = [&self.publishers, &self.subscribers, &self.watchers].into_iter();
        let registered = entries.any(|entries| entries.values().any(|nodes| nodes.contains_key(node)))
            || self.services.values().any(|(server, ..)| server == node);
        if !registered {
            self.nodes.remove(node);
        }
    }

    /// Notes the type of a topic. `*` stands for an unknown type.
    fn learn_type(&mut self, topic: &str, kind: &str) {
        let known = self.types.entry(topic.to_owned()).or_insert_with(|| kind.to_owned());
        if kind != "*" {
            kind.clone_into(known);
        }
    }

    /// Forgets the type of a topic without publishers and subscribers.
    fn forget_type(&mut self, topic: &str) {
        if !self.publishers.contains_key(topic) && !self.subscribers.contains_key(topic) {
            self.types.remove(topic);
        }
    }

    fn topic_types(&self, chosen: impl Fn(&str) -> bool) -> Value {
        let chosen = self.types.iter().filter(|(topic, _)| chosen(topic));
        chosen.map(|(topic, kind)| [topic.as_str(), kind]).collect::<Vec<_>>().into()
    }

    fn addresses(&self, entries: &Entries, name: &str) -> Value {
        let nodes = entries.get(name).into_iter().flat_map(BTreeMap::keys);
        nodes.filter_map(|node| self.nodes.get(node)).map(|(api, _)| api.as_str()).collect::<Vec<_>>().into()
    }

    fn tell_publishers(&self, topic: &str, notices: &mut Vec<Notice>) {
        let subscribers = self.subscribers.get(topic).into_iter().flatten();
        notices.extend(subscribers.filter_map(|(node, owner)| {
            let (node, _) = self.nodes.get(node)?;
            Some(Notice { owner: *owner, node: node.clone(), about: About::Publishers(topic.to_owned()) })
        }));
    }

    /// Sets a parameter in the name of an address.
    ///
    /// # Errors
    /// The reason for which there is no room.
    fn set_param(&mut self, by: IpAddr, name: &str, value: Value) -> Result<(), String> {
        if name.len() > LONGEST_NAME {
            return Err(format!("names have {LONGEST_NAME} bytes at most"));
        }
        let name = canonical(name);
        let bytes = size(&value) + name.len() + path(&name).count() * 2 * OVERHEAD;
        let others =
            self.authors.iter().filter(|(other, (author, _))| *author == by && !within(other, &name));
        if others.map(|(_, (_, bytes))| bytes).sum::<usize>() + bytes > MOST_PARAMETER_BYTES_OF_ADDRESS {
            return Err(format!(
                "the parameters of {by} would take more than {MOST_PARAMETER_BYTES_OF_ADDRESS} bytes: delete some"
            ));
        }
        let before = find(&self.params, &name).map_or(0, size);
        if self.param_bytes.saturating_sub(before) + bytes > MOST_PARAMETER_BYTES {
            return Err(format!(
                "all parameters would take more than {MOST_PARAMETER_BYTES} bytes: delete some"
            ));
        }
        self.authors.retain(|other, _| !within(other, &name));
        self.authors.insert(name.clone(), (by, bytes));
        self.put_param(&name, value);
        self.param_bytes = size(&self.params);
        Ok(())
    }

    fn remove_param(&mut self, name: &str) {
        let name = canonical(name);
        self.put_param(&name, empty());
        let parts: Vec<_> = path(&name).collect();
        if let Some((last, above)) = parts.split_last() {
            namespace(&mut self.params, above).remove(*last);
        }
        self.authors.retain(|other, _| !within(other, &name));
        self.param_bytes = size(&self.params);
    }

    fn put_param(&mut self, name: &str, value: Value) {
        let parts: Vec<_> = path(name).collect();
        match parts.split_last() {
            Some((last, above)) => {
                namespace(&mut self.params, above).insert((*last).to_owned(), value);
            }
            None => self.params = if matches!(value, Value::Struct(_)) { value } else { empty() },
        }
    }

    /// Notifies the watchers of a changed parameter, of those above it and of those in it, but not its author.
    fn tell_watchers(&self, changed: &str, caller: &str, notices: &mut Vec<Notice>) {
        let changed = canonical(changed);
        for (watched, nodes) in &self.watchers {
            let name = if within(&changed, watched) {
                &changed
            } else if within(watched, &changed) {
                watched
            } else {
                continue;
            };
            let others = nodes.iter().filter(|(node, _)| *node != caller);
            notices.extend(others.filter_map(|(node, owner)| {
                let (node, _) = self.nodes.get(node)?;
                Some(Notice { owner: *owner, node: node.clone(), about: About::Parameter(name.clone()) })
            }));
        }
    }

    /// Finds the parameter whose first part is nearest, going up from the caller.
    fn search_param(&self, caller: &str, name: &str) -> Option<String> {
        let first = path(name).next()?;
        let mut above = if name.starts_with('/') { String::new() } else { canonical(caller) };
        loop {
            if find(&self.params, &format!("{above}/{first}")).is_some() {
                return Some(format!("{above}{}", canonical(name)));
            }
            let end = above.rfind('/')?;
            above.truncate(end);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    const US: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 77, 0, 1));
    const THEM: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 77, 0, 2));

    /// A call that a node gets.
    type Told = (String, &'static str, Vec<Value>);

    fn call_by(
        registry: &mut Registry,
        by: IpAddr,
        method: &str,
        arguments: Vec<Value>,
    ) -> (Value, Vec<Told>) {
        let mut notices = Vec::new();
        let answer = registry.answer(by, &Call::new(method, arguments), &mut notices).unwrap();
        let told = notices.into_iter().map(|notice| {
            let (method, arguments) = registry.call_of(&notice);
            (notice.node, method, arguments)
        });
        (answer, told.collect())
    }

    fn call(registry: &mut Registry, method: &str, arguments: &[&str]) -> (Value, Vec<Told>) {
        let arguments = arguments.iter().map(|argument| Value::from(*argument)).collect();
        let (answer, told) = call_by(registry, US, method, arguments);
        (answer.as_array().unwrap()[2].clone(), told)
    }

    /// Returns the reason for which a call is rejected; `None` if it is not.
    fn refusal(registry: &mut Registry, by: IpAddr, method: &str, arguments: &[&str]) -> Option<String> {
        let arguments = arguments.iter().map(|argument| Value::from(*argument)).collect();
        let (answer, _) = call_by(registry, by, method, arguments);
        let [code, reason, _] = answer.as_array().unwrap() else { panic!("{answer:?}") };
        (code.as_int() != Some(1)).then(|| reason.as_str().unwrap().to_owned())
    }

    fn update(node: &str, publishers: &[&str]) -> Told {
        let arguments = vec![MASTER.into(), "/scan".into(), publishers.to_vec().into()];
        (node.to_owned(), "publisherUpdate", arguments)
    }

    #[test]
    fn an_address_fills_a_share_of_the_registrations_only() {
        let registry = &mut Registry::new("http://m:1/".to_owned());
        let register = |registry: &mut Registry, by, topic: usize| {
            let topic = format!("/t{topic}");
            refusal(registry, by, "registerPublisher", &["/p", &topic, "a/B", "http://p:1/"])
        };
        for topic in 0..MOST_OF_ADDRESS {
            assert_eq!(register(registry, THEM, topic), None, "{topic}");
        }
        let reason = register(registry, THEM, MOST_OF_ADDRESS).unwrap();
        assert!(reason.starts_with("10.77.0.2 has 2048 registrations"), "{reason}");
        for (method, arguments) in [
            ("registerSubscriber", ["/s", "/t", "*", "http://s:1/"].as_slice()),
            ("registerService", &["/s", "/a", "rosrpc://s:1", "http://s:1/"]),
            ("subscribeParam", &["/s", "http://s:1/", "/a"]),
        ] {
            assert!(refusal(registry, THEM, method, arguments).is_some(), "{method}");
            assert_eq!(refusal(registry, US, method, arguments), None, "{method}");
        }
        assert_eq!(registry.registered, BTreeMap::from([(US, 3), (THEM, MOST_OF_ADDRESS)]));
        // All that is unregistered makes room again, and leaves nothing.
        call(registry, "unregisterSubscriber", &["/s", "/t", "http://s:1/"]);
        call(registry, "unregisterService", &["/s", "/a", "rosrpc://s:1"]);
        call(registry, "unsubscribeParam", &["/s", "http://s:1/", "/a"]);
        for topic in 0..MOST_OF_ADDRESS {
            let topic = format!("/t{topic}");
            refusal(registry, THEM, "unregisterPublisher", &["/p", &topic, "http://p:1/"]);
        }
        assert!(registry.registered.is_empty() && registry.types.is_empty() && registry.nodes.is_empty());
        let taken = refusal(registry, US, "registerPublisher", &["/p", "/t", "a/B", "http://p:2/"]);
        assert_eq!((taken, registry.registered.clone()), (None, BTreeMap::from([(US, 1)])));
        call(registry, "registerPublisher", &["/p", "/t", "a/B", "http://p:3/"]);
        assert_eq!(registry.registered, BTreeMap::from([(US, 1)]), "the second replaces the first");
    }

    #[test]
    fn all_addresses_together_have_so_many_registrations() {
        let registry = &mut Registry::new("http://m:1/".to_owned());
        for address in 0..5 {
            let by = IpAddr::from([10, 77, 1, address]);
            for topic in 0..MOST_OF_ADDRESS {
                let topic = format!("/t{topic}");
                let node = format!("/n{address}");
                refusal(registry, by, "registerSubscriber", &[&node, &topic, "*", "http://p:1/"]);
            }
        }
        assert_eq!(registry.registered.values().sum::<usize>(), MOST_REGISTRATIONS);
    }

    #[test]
    fn an_address_fills_a_share_of_the_parameters_only() {
        let registry = &mut Registry::new("http://m:1/".to_owned());
        let set = |registry: &mut Registry, by, name: &str, bytes: usize| {
            refusal(registry, by, "setParam", &["/x", name, &"a".repeat(bytes)])
        };
        let half = MOST_PARAMETER_BYTES_OF_ADDRESS / 2;
        assert_eq!(set(registry, THEM, "/a/b", half), None);
        assert_eq!(set(registry, THEM, "/a/b", half), None, "it replaces the first");
        let reason = set(registry, THEM, "/a/c", half).unwrap();
        assert!(reason.starts_with("the parameters of 10.77.0.2 would take more than 2097152"), "{reason}");
        assert_eq!(set(registry, US, "/a/c", half), None);
        let many: BTreeMap<String, Value> = (0..20_000).map(|i| (format!("p{i}"), true.into())).collect();
        let arguments = vec!["/x".into(), "/many".into(), Value::Struct(many)];
        let (answer, _) = call_by(registry, US, "setParam", arguments);
        assert_eq!(answer.as_array().unwrap()[0], (-1).into(), "small values take room, too");
        for by in 3..9 {
            set(registry, IpAddr::from([10, 77, 0, by]), &format!("/n{by}"), half - 10_000);
        }
        assert!(
            registry.param_bytes <= MOST_PARAMETER_BYTES && size(&registry.params) == registry.param_bytes
        );
        let reason = set(registry, IpAddr::from([10, 77, 0, 9]), "/last", half).unwrap();
        assert!(reason.starts_with("all parameters would take more"), "{reason}");
        call(registry, "deleteParam", &["/x", "/a"]);
        assert_eq!(set(registry, THEM, "/a/c", half), None, "what is deleted makes room");
        call(registry, "deleteParam", &["/x", "/"]);
        assert_eq!((registry.param_bytes, registry.authors.len()), (OVERHEAD, 0));
    }

    #[test]
    fn long_names_are_rejected() {
        let registry = &mut Registry::new("http://m:1/".to_owned());
        let long = format!("/{}", "a".repeat(LONGEST_NAME));
        for (method, arguments) in [
            ("registerPublisher", ["/p", &long, "a/B", "http://p:1/"].as_slice()),
            ("registerPublisher", &["/p", "/t", &long, "http://p:1/"]),
            ("registerService", &["/p", "/s", "rosrpc://s:1", &long]),
            ("subscribeParam", &[&long, "http://p:1/", "/a"]),
            ("setParam", &["/p", &long, "1"]),
        ] {
            let reason = refusal(registry, US, method, arguments).unwrap();
            assert!(reason.contains("512 bytes at most"), "{reason}");
        }
        assert_eq!(refusal(registry, US, "setParam", &["/p", "/text", &long]), None, "a value may be long");
    }

    #[test]
    fn subscribers_are_notified_of_publishers() {
        let registry = &mut Registry::new("http://m:1/".to_owned());
        let (publishers, _) = call(registry, "registerSubscriber", &["/s", "/scan", "*", "http://s:1/"]);
        assert_eq!(publishers, Value::Array(vec![]));
        let (subscribers, notices) =
            call(registry, "registerPublisher", &["/p", "/scan", "a/B", "http://p:1/"]);
        assert_eq!(subscribers, vec!["http://s:1/"].into());
        assert_eq!(notices, [update("http://s:1/", &["http://p:1/"])]);
        assert_eq!(call(registry, "getTopicTypes", &["/x"]).0, vec![Value::from(["/scan", "a/B"])].into());
        let (known, notices) = call(registry, "unregisterPublisher", &["/p", "/scan", "http://p:1/"]);
        assert_eq!((known, notices), (1.into(), vec![update("http://s:1/", &[])]));
        assert_eq!(call(registry, "lookupNode", &["/x", "/p"]).0, 0.into());
    }

    #[test]
    fn second_node_of_a_name_replaces_the_first() {
        let registry = &mut Registry::new("http://m:1/".to_owned());
        call(registry, "registerPublisher", &["/p", "/scan", "a/B", "http://p:1/"]);
        let (_, notices) = call(registry, "registerPublisher", &["/p", "/odom", "a/B", "http://p:2/"]);
        assert_eq!((notices[0].0.as_str(), notices[0].1), ("http://p:1/", "shutdown"));
        // The first unregisters when it ends, which changes nothing.
        assert_eq!(call(registry, "unregisterPublisher", &["/p", "/odom", "http://p:1/"]).0, 0.into());
        assert_eq!(call(registry, "lookupNode", &["/x", "/p"]).0, "http://p:2/".into());
        assert_eq!(
            call(registry, "registerSubscriber", &["/s", "/scan", "*", "http://s:1/"]).0,
            Value::Array(vec![])
        );
    }

    #[test]
    fn watchers_are_notified_of_changes_in_the_parameter_tree() {
        let registry = &mut Registry::new("http://m:1/".to_owned());
        assert_eq!(call(registry, "subscribeParam", &["/w", "http://w:1/", "/a"]).0, empty());
        let (_, notices) = call(registry, "setParam", &["/x", "/a/b/c", "1"]);
        let arguments = vec![MASTER.into(), "/a/b/c/".into(), "1".into()];
        assert_eq!(notices, [("http://w:1/".to_owned(), "paramUpdate", arguments)]);
        assert!(call(registry, "setParam", &["/w", "/a/b/d", "2"]).1.is_empty());
        assert_eq!(call(registry, "getParam", &["/x", "a/b/c"]).0, "1".into());
        assert_eq!(call(registry, "getParamNames", &["/x"]).0, vec!["/a/b/c", "/a/b/d"].into());
        assert_eq!(call(registry, "searchParam", &["/a/b/node", "c"]).0, "/a/b/c".into());
        assert_eq!(call(registry, "searchParam", &["/z", "c"]).0, 0.into());
        call(registry, "deleteParam", &["/x", "/a/b"]);
        assert_eq!(call(registry, "hasParam", &["/x", "/a/b/c"]).0, false.into());
    }

    #[test]
    fn unknown_methods_of_a_master_are_faults() {
        let registry = &mut Registry::new("http://m:1/".to_owned());
        for (method, arguments) in
            [("explode", vec![]), ("setParam", vec!["/x".into()]), ("lookupNode", vec![1.into()])]
        {
            assert!(registry.answer(US, &Call::new(method, arguments), &mut Vec::new()).is_err());
        }
    }
}
