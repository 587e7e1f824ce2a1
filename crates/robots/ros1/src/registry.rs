//! The state of a master: publishers, subscribers, services, watches and parameters. It takes calls, and returns answers
//! and notices to nodes.
//!
//! Source: ROS wiki, "ROS/Master_API" and "ROS/Parameter Server API".

use std::collections::{BTreeMap, BTreeSet};

use crate::{
    slave::done,
    xmlrpc::{Call, Fault, Value},
};

/// A call that the master owes a node.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Notice {
    /// The node's address.
    pub node: String,
    pub method: &'static str,
    pub arguments: Vec<Value>,
}

/// Nodes registered for each name.
type Entries = BTreeMap<String, BTreeSet<String>>;

/// The state of a master.
#[derive(Debug)]
pub(crate) struct Registry {
    /// The master's address.
    uri: String,
    /// Addresses of nodes, by name.
    nodes: BTreeMap<String, String>,
    publishers: Entries,
    subscribers: Entries,
    watchers: Entries,
    /// Nodes and addresses of services.
    services: BTreeMap<String, (String, String)>,
    types: BTreeMap<String, String>,
    params: Value,
}

/// Caller name of a master.
const MASTER: &str = "/master";

fn unknown(what: &str, name: &str) -> Value {
    Value::Array(vec![(-1).into(), format!("unknown {what} {name}").into(), 0.into()])
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
    let entry = |(name, nodes): (&String, &BTreeSet<String>)| {
        let nodes = nodes.iter().map(String::as_str).collect::<Vec<_>>();
        Value::Array(vec![name.as_str().into(), nodes.into()])
    };
    Value::Array(entries.iter().map(entry).collect())
}

fn add(entries: &mut Entries, name: &str, node: &str) {
    entries.entry(name.to_owned()).or_default().insert(node.to_owned());
}

fn remove(entries: &mut Entries, name: &str, node: &str) -> bool {
    let Some(nodes) = entries.get_mut(name) else { return false };
    let removed = nodes.remove(node);
    if nodes.is_empty() {
        entries.remove(name);
    }
    removed
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
            types: BTreeMap::new(),
            params: empty(),
        }
    }

    /// Carries out a call. Appends the notices to other nodes to `notices`.
    ///
    /// # Errors
    /// The fault to return, if masters have no such method or it has other arguments.
    pub fn answer(&mut self, call: &Call, notices: &mut Vec<Notice>) -> Result<Value, Fault> {
        let texts: Option<Vec<&str>> = call.arguments.iter().map(Value::as_str).collect();
        let caller = call.arguments.first().and_then(Value::as_str).unwrap_or_default();
        let answer = match (call.method.as_str(), texts.as_deref(), call.arguments.as_slice()) {
            ("registerPublisher", Some([node, topic, kind, api]), _) => {
                self.meet(node, api, notices);
                add(&mut self.publishers, topic, node);
                self.learn_type(topic, kind);
                self.tell_publishers(topic, notices);
                done(self.addresses(&self.subscribers, topic))
            }
            ("unregisterPublisher", Some([node, topic, api]), _) => {
                let known = self.is_at(node, api) && remove(&mut self.publishers, topic, node);
                if known {
                    self.tell_publishers(topic, notices);
                }
                self.part(node);
                done(i32::from(known))
            }
            ("registerSubscriber", Some([node, topic, kind, api]), _) => {
                self.meet(node, api, notices);
                add(&mut self.subscribers, topic, node);
                self.learn_type(topic, kind);
                done(self.addresses(&self.publishers, topic))
            }
            ("unregisterSubscriber", Some([node, topic, api]), _) => {
                let known = self.is_at(node, api) && remove(&mut self.subscribers, topic, node);
                self.part(node);
                done(i32::from(known))
            }
            ("registerService", Some([node, name, service, api]), _) => {
                self.meet(node, api, notices);
                self.services.insert((*name).to_owned(), ((*node).to_owned(), (*service).to_owned()));
                done(1)
            }
            ("unregisterService", Some([node, name, service]), _) => {
                let known = self.services.get(*name).is_some_and(|(_, at)| at == service);
                if known {
                    self.services.remove(*name);
                }
                self.part(node);
                done(i32::from(known))
            }
            ("lookupNode", Some([_, name]), _) => {
                self.nodes.get(*name).map_or_else(|| unknown("node", name), |api| done(api.as_str()))
            }
            ("lookupService", Some([_, name]), _) => {
                self.services.get(*name).map_or_else(|| unknown("service", name), |(_, at)| done(at.as_str()))
            }
            ("getSystemState", ..) => {
                let services =
                    self.services.iter().map(|(name, (node, _))| (name.clone(), [node.clone()].into()));
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
                self.set_param(name, value.clone());
                self.tell_watchers(name, caller, notices);
                done(0)
            }
            ("getParam", Some([_, name]), _) => find(&self.params, name)
                .map_or_else(|| unknown("parameter", name), |value| done(value.clone())),
            ("hasParam", Some([_, name]), _) => done(find(&self.params, name).is_some()),
            ("deleteParam", Some([_, name]), _) => {
                if find(&self.params, name).is_none() {
                    unknown("parameter", name)
                } else {
                    self.set_param(name, empty());
                    let parts: Vec<_> = path(name).collect();
                    if let Some((last, above)) = parts.split_last() {
                        namespace(&mut self.params, above).remove(*last);
                    }
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
                self.meet(node, api, notices);
                add(&mut self.watchers, &canonical(name), node);
                done(find(&self.params, name).cloned().unwrap_or_else(empty))
            }
            ("unsubscribeParam", Some([node, api, name]), _) => {
                let known = self.is_at(node, api) && remove(&mut self.watchers, &canonical(name), node);
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

    /// Notes the address of a node. A node of the same name at another address is told to shut down.
    fn meet(&mut self, node: &str, api: &str, notices: &mut Vec<Notice>) {
        let before = self.nodes.insert(node.to_owned(), api.to_owned());
        let Some(before) = before.filter(|before| before != api) else { return };
        let reason = format!("another node took the name {node}");
        notices.push(Notice {
            node: before,
            method: "shutdown",
            arguments: vec![MASTER.into(), reason.into()],
        });
        let topics: Vec<_> = self
            .publishers
            .iter()
            .filter(|(_, nodes)| nodes.contains(node))
            .map(|(t, _)| t.clone())
            .collect();
        for entries in [&mut self.publishers, &mut self.subscribers, &mut self.watchers] {
            entries.retain(|_, nodes| {
                nodes.remove(node);
                !nodes.is_empty()
            });
        }
        self.services.retain(|_, (server, _)| server != node);
        topics.iter().for_each(|topic| self.tell_publishers(topic, notices));
    }

    fn is_at(&self, node: &str, api: &str) -> bool {
        self.nodes.get(node).is_some_and(|known| known == api)
    }

    /// Removes a node without registrations.
    fn part(&mut self, node: &str) {
        let mut entries = [&self.publishers, &self.subscribers, &self.watchers].into_iter();
        let registered = entries.any(|entries| entries.values().any(|nodes| nodes.contains(node)))
            || self.services.values().any(|(server, _)| server == node);
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

    fn topic_types(&self, chosen: impl Fn(&str) -> bool) -> Value {
        let chosen = self.types.iter().filter(|(topic, _)| chosen(topic));
        chosen.map(|(topic, kind)| [topic.as_str(), kind]).collect::<Vec<_>>().into()
    }

    fn addresses(&self, entries: &Entries, name: &str) -> Value {
        let nodes = entries.get(name).into_iter().flatten();
        nodes.filter_map(|node| self.nodes.get(node)).map(String::as_str).collect::<Vec<_>>().into()
    }

    fn tell_publishers(&self, topic: &str, notices: &mut Vec<Notice>) {
        let publishers = self.addresses(&self.publishers, topic);
        let subscribers = self.subscribers.get(topic).into_iter().flatten();
        notices.extend(subscribers.filter_map(|node| self.nodes.get(node)).map(|node| Notice {
            node: node.clone(),
            method: "publisherUpdate",
            arguments: vec![MASTER.into(), topic.into(), publishers.clone()],
        }));
    }

    fn set_param(&mut self, name: &str, value: Value) {
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
            let within = |inner: &str, outer: &str| {
                inner.strip_prefix(outer).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
            };
            let name = if within(&changed, watched) {
                &changed
            } else if within(watched, &changed) {
                watched
            } else {
                continue;
            };
            let value = find(&self.params, name).cloned().unwrap_or_else(empty);
            let others = nodes.iter().filter(|node| *node != caller).filter_map(|node| self.nodes.get(node));
            notices.extend(others.map(|node| Notice {
                node: node.clone(),
                method: "paramUpdate",
                arguments: vec![MASTER.into(), format!("{name}/").into(), value.clone()],
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
    use super::*;

    fn call(registry: &mut Registry, method: &str, arguments: &[&str]) -> (Value, Vec<Notice>) {
        let mut notices = Vec::new();
        let arguments = arguments.iter().map(|argument| Value::from(*argument)).collect();
        let answer = registry.answer(&Call::new(method, arguments), &mut notices).unwrap();
        (answer.as_array().unwrap()[2].clone(), notices)
    }

    fn update(node: &str, publishers: &[&str]) -> Notice {
        let arguments = vec![MASTER.into(), "/scan".into(), publishers.to_vec().into()];
        Notice { node: node.to_owned(), method: "publisherUpdate", arguments }
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
        assert_eq!((notices[0].node.as_str(), notices[0].method), ("http://p:1/", "shutdown"));
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
        assert_eq!(notices, [Notice { node: "http://w:1/".to_owned(), method: "paramUpdate", arguments }]);
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
            assert!(registry.answer(&Call::new(method, arguments), &mut Vec::new()).is_err());
        }
    }
}
