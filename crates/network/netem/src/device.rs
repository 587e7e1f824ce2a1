//! The traffic control of one interface: its rules, and plans that change them. Pure: the kernel's answers go in,
//! requests come out.

use std::{collections::BTreeMap, fmt};

use crate::{
    filter::{Field, Filter, Packets, Verdict},
    handle::Handle,
    netem::Netem,
    request::{Discipline, Object, Request, Verb},
    rule::{Counters, DisciplineError, Replaced, Rule, Side},
    structure::{number, word},
    tree::{Installed, Root, Tree},
};
use cotorra_graph::IpNetwork;
use cotorra_netlink::{DecodeError, attributes, text};

/// A network interface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Interface {
    /// Index within its network namespace.
    pub index: u32,
    /// Name, such as `eth0`.
    pub name: String,
    /// Whether it is a loopback interface.
    pub loopback: bool,
}

/// A queueing discipline as the kernel reports it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DisciplineInfo {
    interface: u32,
    handle: Handle,
    parent: Handle,
    kind: String,
    options: Vec<u8>,
    counters: Counters,
}

/// The interfaces, disciplines and filters of a network namespace, as the kernel reports them.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Snapshot {
    pub(crate) interfaces: Vec<Interface>,
    pub(crate) disciplines: Vec<DisciplineInfo>,
    /// Filters, each with its interface and parent.
    pub(crate) filters: Vec<(u32, Handle, Filter)>,
}

/// An interface and the rules on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Device {
    interface: Interface,
    egress: Tree,
    /// Tree of the ifb interface that ingress traffic takes a detour through, if it exists.
    detour: Option<Tree>,
    /// Free index for a new detour interface.
    free_index: u32,
    hook: Hook,
}

/// State of the interface's ingress hook.
#[derive(Debug, Clone, PartialEq, Default)]
struct Hook {
    /// Kind of the ingress discipline, if any.
    discipline: Option<String>,
    /// Whether our filter redirects to the detour.
    redirects: bool,
    /// Number of filters that are not ours.
    others: usize,
}

/// Requests to the kernel, in order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan(pub(crate) Vec<Request>);

/// Priority of the filter that redirects ingress packets to the detour.
const DETOUR: u16 = 0xc070;

/// Name prefix of detour interfaces.
const DETOUR_NAME: &str = "cotorra-i";

/// Returns the name of an interface's detour.
pub(crate) fn detour_name(index: u32) -> String {
    format!("{DETOUR_NAME}{index}")
}

impl Plan {
    /// Whether the plan has no requests.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether the plan deletes a discipline and so loses the packets queued in it.
    pub fn loses_packets(&self) -> bool {
        self.0.iter().any(|request| {
            request.verb == Verb::Delete && matches!(request.object, Object::Discipline { .. } | Object::Ifb)
        })
    }
}

impl fmt::Display for Plan {
    /// Writes one `tc` or `ip` command per line.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|request| writeln!(f, "{request}"))
    }
}

impl Device {
    pub(crate) fn new(snapshot: &Snapshot, interface: &Interface) -> Result<Self, DecodeError> {
        let detour = detour_name(interface.index);
        let detour = snapshot.interfaces.iter().find(|other| other.name == detour);
        let taken = |index: &u32| snapshot.interfaces.iter().any(|other| other.index == *index);
        let arriving = |f: &&(u32, Handle, Filter)| f.0 == interface.index && f.1 == Handle::ARRIVING;
        let ours = |f: &&(u32, Handle, Filter)| {
            f.2.priority == DETOUR && detour.is_some_and(|d| f.2.verdict == Verdict::Redirect(d.index))
        };
        let filters: Vec<_> = snapshot.filters.iter().filter(arriving).collect();
        let hook = Hook {
            discipline: snapshot
                .disciplines
                .iter()
                .find(|d| d.interface == interface.index && d.parent == Handle::INGRESS)
                .map(|d| d.kind.clone()),
            redirects: filters.iter().copied().any(|f| ours(&f)),
            others: filters.iter().copied().filter(|f| !ours(f)).count(),
        };
        Ok(Self {
            egress: snapshot.tree(interface, Field::Destination)?,
            detour: detour.map(|detour| snapshot.tree(detour, Field::Source)).transpose()?,
            free_index: (1000..).find(|index| !taken(index)).expect("no machine has so many interfaces"),
            interface: interface.clone(),
            hook,
        })
    }

    /// Returns the interface.
    pub fn interface(&self) -> &Interface {
        &self.interface
    }

    /// Returns all rules with their counters: egress before ingress, and per side the rule for all packets before
    /// those for networks.
    pub fn rules(&self) -> impl Iterator<Item = (Rule, Counters)> {
        let of = |side, tree: &Tree| {
            let rule = move |(network, installed): (&Option<IpNetwork>, &Installed)| {
                let rule = Rule { side, network: *network, netem: installed.netem.clone() };
                (rule, installed.counters)
            };
            tree.rules.iter().map(rule).collect::<Vec<_>>()
        };
        let ingress = self.detour.iter().flat_map(move |tree| of(Side::Ingress, tree));
        of(Side::Egress, &self.egress).into_iter().chain(ingress)
    }

    /// Returns the counters of all packets that leave.
    pub fn leaving(&self) -> Counters {
        self.egress.counters
    }

    /// Sets the distribution of a rule's jitter. The kernel does not report it, and it is needed when the rule is
    /// created anew.
    pub fn recall(&mut self, side: Side, network: Option<IpNetwork>, distribution: crate::Distribution) {
        let tree = match side {
            Side::Egress => Some(&mut self.egress),
            Side::Ingress => self.detour.as_mut(),
        };
        let rule = tree.and_then(|tree| tree.rules.get_mut(&network));
        if let Some(jitter) = rule.and_then(|rule| rule.netem.jitter.as_mut()) {
            jitter.distribution = Some(distribution);
        }
    }

    /// Returns the foreign root discipline that an egress rule would replace.
    pub fn foreign(&self) -> Option<&Replaced> {
        match &self.egress.root {
            Root::Foreign { replaced, .. } => Some(replaced),
            _ => None,
        }
    }

    /// Plans the creation of a rule, or its change in place. `replace` allows NetEm to take the place of a foreign
    /// discipline.
    ///
    /// # Errors
    /// [`DisciplineError`].
    pub fn set(&self, rule: &Rule, replace: bool) -> Result<Plan, DisciplineError> {
        if rule.side == Side::Egress {
            return self.egress.set(rule.network, &rule.netem, replace).map(Plan);
        }
        if self.is_detour() {
            return Err(DisciplineError::Detour(self.interface.name.clone()));
        }
        let mut requests = Vec::new();
        let detour = self.detour.clone().unwrap_or_else(|| {
            let detour = self.new_detour();
            requests.push(Request {
                verb: Verb::Add,
                interface: detour.interface.clone(),
                object: Object::Ifb,
            });
            detour
        });
        // Redirect packets only once the detour is set up.
        requests.extend(detour.set(rule.network, &rule.netem, true)?);
        if self.hook.discipline.is_none() {
            requests.push(self.arriving(Verb::Add));
        }
        if !self.hook.redirects {
            requests.push(self.redirect(Verb::Add, &detour));
        }
        Ok(Plan(requests))
    }

    /// Plans all of these rules at once; see [`Self::set`].
    ///
    /// # Errors
    /// [`DisciplineError`].
    pub fn set_all(&self, rules: &[Rule], replace: bool) -> Result<Plan, DisciplineError> {
        let mut device = self.clone();
        let mut requests = Vec::new();
        for rule in rules {
            requests.extend(device.set(rule, replace)?.0);
            device.simulate(rule)?;
        }
        Ok(Plan(requests))
    }

    /// Updates this copy as if `rule` had been applied.
    fn simulate(&mut self, rule: &Rule) -> Result<(), DisciplineError> {
        match rule.side {
            Side::Egress => self.egress = self.egress.with(rule.network, &rule.netem)?,
            Side::Ingress => {
                let detour = self.detour.clone().unwrap_or_else(|| self.new_detour());
                self.detour = Some(detour.with(rule.network, &rule.netem)?);
                self.hook.discipline.get_or_insert_with(|| "ingress".to_owned());
                self.hook.redirects = true;
            }
        }
        Ok(())
    }

    /// Whether this interface is the ingress detour of another one.
    pub fn is_detour(&self) -> bool {
        self.interface.name.starts_with(DETOUR_NAME)
    }

    /// Plans the removal of a rule. Removing a side's last rule is [`Self::clear`].
    pub fn remove(&self, side: Side, network: Option<IpNetwork>, replaced: Option<&Replaced>) -> Plan {
        let tree = match side {
            Side::Egress => Some(&self.egress),
            Side::Ingress => self.detour.as_ref(),
        };
        match tree {
            Some(tree) if !tree.rules.contains_key(&network) => Plan::default(),
            Some(tree) if tree.rules.len() > 1 => Plan(tree.remove(network)),
            _ => self.clear(side, replaced),
        }
    }

    /// Plans the removal of all rules of a side, and the return of the discipline that they replaced.
    pub fn clear(&self, side: Side, replaced: Option<&Replaced>) -> Plan {
        let mut requests = Vec::new();
        match (side, &self.detour) {
            (Side::Egress, _) => {
                requests.extend(self.egress.clear());
                if let Some(replaced) = replaced.filter(|_| !requests.is_empty()) {
                    requests.push(self.egress.foreign(Verb::Add, replaced.handle, replaced));
                }
            }
            (Side::Ingress, Some(detour)) => {
                if self.hook.redirects {
                    requests.push(self.redirect(Verb::Delete, detour));
                }
                // `clsact` is never ours. An empty `ingress` discipline is unused.
                if self.hook.discipline.as_deref() == Some("ingress") && self.hook.others == 0 {
                    requests.push(self.arriving(Verb::Delete));
                }
                requests.push(Request {
                    verb: Verb::Delete,
                    interface: detour.interface.clone(),
                    object: Object::Ifb,
                });
            }
            (Side::Ingress, None) => {}
        }
        Plan(requests)
    }

    /// Plans the removal of all rules and the return of the replaced discipline. Works from any partial state, such
    /// as after an interrupted removal.
    pub fn restore(&self, replaced: Option<&Replaced>) -> Plan {
        let mut requests = self.clear(Side::Ingress, None).0;
        requests.extend(self.egress.clear());
        if let Some(replaced) = replaced.filter(|_| self.foreign().is_none()) {
            requests.push(self.egress.foreign(Verb::Add, replaced.handle, replaced));
        }
        Plan(requests)
    }

    fn new_detour(&self) -> Tree {
        Tree {
            interface: (self.free_index, detour_name(self.interface.index)),
            field: Field::Source,
            root: Root::Default,
            rules: BTreeMap::new(),
            counters: Counters::default(),
        }
    }

    fn request(&self, verb: Verb, object: Object) -> Request {
        Request { verb, interface: (self.interface.index, self.interface.name.clone()), object }
    }

    fn arriving(&self, verb: Verb) -> Request {
        let (parent, handle) = (Handle::INGRESS, Handle::INGRESS_DISCIPLINE);
        self.request(verb, Object::Discipline { parent, handle, discipline: Discipline::Ingress })
    }

    fn redirect(&self, verb: Verb, detour: &Tree) -> Request {
        let verdict = Verdict::Redirect(detour.interface.0);
        let filter = Filter { packets: Packets::All, verdict, priority: DETOUR };
        self.request(verb, Object::Filter { parent: Handle::ARRIVING, filter })
    }
}

impl Snapshot {
    /// Returns the parents, by interface index, whose filters matter for an interface.
    pub(crate) fn filter_places(&self, interface: &Interface) -> Vec<(u32, Handle)> {
        let detour = detour_name(interface.index);
        let detour = self.interfaces.iter().find(|other| other.name == detour).map(|other| other.index);
        let of = |d: &DisciplineInfo| match d {
            d if d.handle == Handle::OURS && d.kind == "htb" => Some((d.interface, Handle::OURS)),
            d if d.parent == Handle::INGRESS => Some((d.interface, Handle::ARRIVING)),
            _ => None,
        };
        let ours = |d: &&DisciplineInfo| d.interface == interface.index || Some(d.interface) == detour;
        self.disciplines.iter().filter(ours).filter_map(of).collect()
    }

    fn tree(&self, interface: &Interface, field: Field) -> Result<Tree, DecodeError> {
        let at: Vec<_> = self.disciplines.iter().filter(|d| d.interface == interface.index).collect();
        let top = at.iter().find(|d| d.parent == Handle::ROOT && d.handle != Handle(0));
        let mut rules = BTreeMap::new();
        let installed = |d: &DisciplineInfo, number, priority| {
            let netem = Netem::decode(&d.options)?;
            Ok(Installed { number, priority, netem, counters: d.counters })
        };
        let root = match top {
            None => Root::Default,
            Some(top) if top.handle == Handle::OURS && top.kind == "netem" => {
                rules.insert(None, installed(top, 0, 0)?);
                Root::Plain
            }
            Some(top) if top.handle == Handle::OURS && top.kind == "htb" => {
                for (_, _, filter) in
                    self.filters.iter().filter(|f| f.0 == interface.index && f.1 == Handle::OURS)
                {
                    let leaf =
                        at.iter().find(|d| Verdict::Class(d.parent) == filter.verdict && d.kind == "netem");
                    let network = match filter.packets {
                        Packets::All => None,
                        Packets::Network(_, network) => Some(network),
                        // A share of the rate is no rule.
                        Packets::Frames { .. } => continue,
                    };
                    if let Some(leaf) = leaf {
                        rules.insert(network, installed(leaf, leaf.parent.minor(), filter.priority)?);
                    }
                }
                Root::Classes
            }
            Some(top) => Root::Foreign {
                handle: top.handle,
                has_below: at.iter().any(|d| d.parent.major() == top.handle.major() && d.handle != Handle(0)),
                replaced: Replaced {
                    handle: top.handle,
                    kind: top.kind.clone(),
                    options: top.options.clone(),
                },
            },
        };
        let leaves = at.iter().filter(|discipline| discipline.kind == "netem");
        let counters = leaves.fold(Counters::default(), |sum, leaf| sum + leaf.counters);
        Ok(Tree { interface: (interface.index, interface.name.clone()), field, root, rules, counters })
    }
}

impl Interface {
    /// Reads the body of an `RTM_NEWLINK` message.
    pub(crate) fn decode(body: &[u8]) -> Result<Self, DecodeError> {
        let index = word(body, 1)?;
        let rest = body.get(16..).unwrap_or_default();
        let mut name = None;
        for attribute in attributes(rest) {
            if let (3, value) = attribute? {
                name = Some(text(value));
            }
        }
        // IFF_LOOPBACK
        let loopback = word(body, 2)? & 8 != 0;
        Ok(Self { index, name: name.ok_or(DecodeError("an interface has no name"))?, loopback })
    }
}

impl DisciplineInfo {
    /// Reads the body of an `RTM_NEWQDISC` message.
    pub(crate) fn decode(body: &[u8]) -> Result<Self, DecodeError> {
        let mut info = Self {
            interface: word(body, 1)?,
            handle: Handle(word(body, 2)?),
            parent: Handle(word(body, 3)?),
            kind: String::new(),
            options: Vec::new(),
            counters: Counters::default(),
        };
        for attribute in attributes(body.get(20..).unwrap_or_default()) {
            let (kind, value) = attribute?;
            match kind {
                1 => info.kind = text(value),
                2 => info.options = value.to_vec(),
                7 => info.counters = Counters::decode(value)?,
                _ => {}
            }
        }
        Ok(info)
    }
}

impl Counters {
    /// Reads `TCA_STATS2`.
    fn decode(value: &[u8]) -> Result<Self, DecodeError> {
        let mut counters = Self::default();
        for attribute in attributes(value) {
            let (kind, value) = attribute?;
            match kind {
                1 => {
                    counters.bytes = number(value)?;
                    counters.packets = word(value, 2)?.into();
                }
                3 => {
                    counters.waiting = word(value, 0)?.into();
                    counters.dropped = word(value, 2)?.into();
                }
                _ => {}
            }
        }
        Ok(counters)
    }
}

/// Reads the body of an `RTM_NEWTFILTER` message. Returns `None` for a filter of a form that this crate never writes.
pub(crate) fn decode_filter(body: &[u8]) -> Result<Option<(u32, Handle, Filter)>, DecodeError> {
    let (interface, parent, info) = (word(body, 1)?, Handle(word(body, 3)?), word(body, 4)?);
    let (priority, protocol) = ((info >> 16) as u16, u16::from_be(info as u16));
    for attribute in attributes(body.get(20..).unwrap_or_default()) {
        let (kind, value) = attribute?;
        if kind == 2
            && let Some(filter) = Filter::decode(value, protocol, priority)?
        {
            // The kernel reports an ingress filter's parent as either the discipline or the hook.
            let parent = if parent.major() == 0xffff { Handle::ARRIVING } else { parent };
            return Ok(Some((interface, parent, filter)));
        }
    }
    Ok(None)
}

/// Decodes arbitrary bytes as every kind of kernel answer. Entry point for the fuzzer.
#[doc(hidden)]
pub fn read_anything(bytes: &[u8]) {
    let _ = (Interface::decode(bytes), decode_filter(bytes), crate::route::default_route_interfaces(bytes));
    if let Ok(discipline) = DisciplineInfo::decode(bytes) {
        let interface = Interface { index: discipline.interface, name: "fuzz".to_owned(), loopback: false };
        let snapshot = Snapshot {
            interfaces: vec![interface.clone()],
            disciplines: vec![discipline],
            ..Snapshot::default()
        };
        let _ = Device::new(&snapshot, &interface);
    }
}
