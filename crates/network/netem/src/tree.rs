//! The layout of rules on one interface, and the requests that change it. A single rule for all packets is a NetEm at
//! the root. Rules for networks are classes with a NetEm each, and filters that lead there, longest prefix first.
//! Packets that match no rule pass unchanged.

use std::collections::BTreeMap;

use crate::{
    filter::{Field, Filter, Packets, Verdict},
    handle::Handle,
    netem::Netem,
    request::{Discipline, Object, Request, Shape, Verb},
    rule::{Counters, DisciplineError, Replaced},
};
use cotorra_graph::IpNetwork;

/// Root discipline of an interface.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Root {
    /// The kernel's default.
    Default,
    /// Our NetEm for all packets.
    Plain,
    /// Our classes.
    Classes,
    /// A foreign discipline; `has_below` if other disciplines are below it.
    Foreign { handle: Handle, replaced: Replaced, has_below: bool },
}

/// A rule on the interface.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Installed {
    /// Number of its class; 0 at the root.
    pub(crate) number: u16,
    /// Priority of its filter.
    pub(crate) priority: u16,
    pub(crate) netem: Netem,
    pub(crate) counters: Counters,
}

/// The root discipline of an interface and the rules below it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tree {
    pub(crate) interface: (u32, String),
    /// Address field that filters compare.
    pub(crate) field: Field,
    pub(crate) root: Root,
    /// Rules by network. `None` matches all packets that no other rule matches.
    pub(crate) rules: BTreeMap<Option<IpNetwork>, Installed>,
    /// Counters of all NetEms.
    pub(crate) counters: Counters,
}

/// Number of priorities reserved for filters of each prefix length.
const PRIORITIES: u16 = 400;
/// Priority of the filter that matches all packets.
const LAST: u16 = 65_000;

impl Tree {
    fn request(&self, verb: Verb, object: Object) -> Request {
        Request { verb, interface: self.interface.clone(), object }
    }

    fn root(&self, verb: Verb, discipline: Discipline) -> Request {
        self.request(verb, Object::Discipline { parent: Handle::ROOT, handle: Handle::OURS, discipline })
    }

    /// Request for a rule's NetEm discipline.
    fn leaf(&self, verb: Verb, number: u16, netem: Netem, before: Option<Netem>) -> Request {
        let discipline = Discipline::Netem { netem, before };
        if number == 0 {
            return self.root(verb, discipline);
        }
        let (parent, handle) = (Handle::class(number), Handle::leaf(number));
        self.request(verb, Object::Discipline { parent, handle, discipline })
    }

    /// Request for a class that delays nothing.
    fn class(&self, verb: Verb, number: u16) -> Request {
        self.request(verb, Object::Class { number, shape: Shape::OPEN, before: None })
    }

    fn filter(&self, verb: Verb, network: Option<IpNetwork>, number: u16, priority: u16) -> Request {
        let verdict = Verdict::Class(Handle::class(number));
        let filter = Filter { packets: Packets::of(self.field, network), verdict, priority };
        self.request(verb, Object::Filter { parent: Handle::OURS, filter })
    }

    /// Requests that create a rule in a class.
    fn add_rule(&self, network: Option<IpNetwork>, number: u16, priority: u16, netem: Netem) -> [Request; 3] {
        [
            self.class(Verb::Add, number),
            self.leaf(Verb::Add, number, netem, None),
            self.filter(Verb::Add, network, number, priority),
        ]
    }

    /// Returns the first priority for filters of a network's prefix length.
    fn priorities(network: Option<IpNetwork>) -> u16 {
        let Some(network) = network else { return LAST };
        let group = match network.address() {
            std::net::IpAddr::V4(_) => 32 - u16::from(network.prefix()),
            std::net::IpAddr::V6(_) => 33 + 128 - u16::from(network.prefix()),
        };
        1 + group * PRIORITIES
    }

    /// Returns a free class number and a free priority.
    fn free(&self, network: Option<IpNetwork>) -> Result<(u16, u16), DisciplineError> {
        let first = Self::priorities(network);
        let mut priorities = first..first.saturating_add(PRIORITIES);
        let priority = priorities.find(|p| self.rules.values().all(|rule| rule.priority != *p));
        let number = (1..16_000).find(|n| self.rules.values().all(|rule| rule.number != *n));
        number.zip(priority).ok_or(DisciplineError::TooMany)
    }

    /// Returns the requests that set the conditions of a network, or of all packets. An existing rule is changed in
    /// place.
    pub(crate) fn set(
        &self,
        network: Option<IpNetwork>,
        netem: &Netem,
        replace: bool,
    ) -> Result<Vec<Request>, DisciplineError> {
        if let Some(rule) = self.rules.get(&network) {
            return Ok(vec![self.leaf(Verb::Change, rule.number, netem.clone(), Some(rule.netem.clone()))]);
        }
        let mut requests = Vec::new();
        if let Root::Foreign { handle, replaced, has_below } = &self.root {
            let name = || (self.interface.1.clone(), replaced.kind.clone());
            if *has_below {
                let (interface, kind) = name();
                return Err(DisciplineError::ForeignTree { interface, kind });
            }
            if !replace {
                let (interface, kind) = name();
                return Err(DisciplineError::Foreign { interface, kind });
            }
            requests.push(self.foreign(Verb::Delete, *handle, replaced));
        }
        if network.is_none() && self.root != Root::Classes {
            requests.push(self.leaf(Verb::Add, 0, netem.clone(), None));
            return Ok(requests);
        }
        let mut classes = self.clone();
        if self.root != Root::Classes {
            let all = classes.rules.remove(&None);
            if let Some(all) = &all {
                requests.push(self.leaf(Verb::Delete, 0, all.netem.clone(), None));
            }
            requests.push(self.root(Verb::Add, Discipline::Htb { default: 0 }));
            if let Some(all) = all {
                let (number, priority) = classes.free(None)?;
                requests.extend(self.add_rule(None, number, priority, all.netem.clone()));
                classes.rules.insert(None, Installed { number, priority, ..all });
            }
        }
        let (number, priority) = classes.free(network)?;
        requests.extend(self.add_rule(network, number, priority, netem.clone()));
        Ok(requests)
    }

    /// Returns the tree as it is after [`Self::set`].
    pub(crate) fn with(&self, network: Option<IpNetwork>, netem: &Netem) -> Result<Self, DisciplineError> {
        let mut tree = self.clone();
        if let Some(rule) = tree.rules.get_mut(&network) {
            rule.netem = netem.clone();
            return Ok(tree);
        }
        let (number, priority) = match (network, &tree.root) {
            (None, Root::Default | Root::Plain | Root::Foreign { .. }) => {
                tree.root = Root::Plain;
                (0, 0)
            }
            _ => {
                if tree.root != Root::Classes
                    && let Some(all) = tree.rules.remove(&None)
                {
                    let (number, priority) = tree.free(None)?;
                    tree.rules.insert(None, Installed { number, priority, ..all });
                }
                tree.root = Root::Classes;
                tree.free(network)?
            }
        };
        let installed = Installed { number, priority, netem: netem.clone(), counters: Counters::default() };
        tree.rules.insert(network, installed);
        Ok(tree)
    }

    /// Returns the requests that remove one rule of several.
    pub(crate) fn remove(&self, network: Option<IpNetwork>) -> Vec<Request> {
        let Some(rule) = self.rules.get(&network) else { return Vec::new() };
        vec![
            self.filter(Verb::Delete, network, rule.number, rule.priority),
            self.leaf(Verb::Delete, rule.number, rule.netem.clone(), None),
            self.class(Verb::Delete, rule.number),
        ]
    }

    /// Returns the requests that remove all of our disciplines.
    pub(crate) fn clear(&self) -> Vec<Request> {
        match self.root {
            Root::Default | Root::Foreign { .. } => Vec::new(),
            Root::Classes => vec![self.root(Verb::Delete, Discipline::Htb { default: 0 })],
            Root::Plain => {
                let netem = self.rules.get(&None).map(|rule| rule.netem.clone()).unwrap_or_default();
                vec![self.leaf(Verb::Delete, 0, netem, None)]
            }
        }
    }

    /// Request for a foreign discipline, as it was found.
    pub(crate) fn foreign(&self, verb: Verb, handle: Handle, replaced: &Replaced) -> Request {
        let Replaced { kind, options, .. } = replaced.clone();
        let discipline = Discipline::Foreign { kind, options };
        self.request(verb, Object::Discipline { parent: Handle::ROOT, handle, discipline })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::netem::tests::any_netem;

    fn any_network() -> impl Strategy<Value = Option<IpNetwork>> {
        prop::option::of((any::<u32>(), 0_u8..=32)).prop_map(|network| {
            network.and_then(|(bits, prefix)| IpNetwork::new(bits.to_be_bytes().into(), prefix))
        })
    }

    proptest! {
        /// Once set, each rule exists in the simulated tree and is changed in place from then on.
        #[test]
        fn set_rules_are_changed_in_place(rules in prop::collection::vec((any_network(), any_netem()), 1..6)) {
            let interface = (7, "eth0".to_owned());
            let (field, counters) = (Field::Destination, Counters::default());
            let mut tree = Tree { interface, field, root: Root::Default, rules: BTreeMap::new(), counters };
            for (network, netem) in &rules {
                tree = tree.with(*network, netem).unwrap();
            }
            for (network, netem) in &rules {
                let again = tree.set(*network, netem, false).unwrap();
                prop_assert_eq!(again.len(), 1);
                prop_assert_eq!(again[0].verb, Verb::Change);
            }
            let last: BTreeMap<_, _> = rules.iter().cloned().collect();
            let kept: BTreeMap<_, _> =
                tree.rules.iter().map(|(network, rule)| (*network, rule.netem.clone())).collect();
            prop_assert_eq!(kept, last);
        }
    }
}
