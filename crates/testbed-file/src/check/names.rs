//! Names that lead to what they name, where programs and the system read them: as host names, as names of files, and in the
//! names of wireless links.

use std::collections::HashMap;

use cotorra_graph::{HardwareGraph, NodeId, Testbed};

use crate::{
    records::{NodeRecord, PluginRecord, TestbedRecord},
    yaml::{
        Sink, Span,
        decode::{Either, Spanned},
    },
};

/// Names that systems have for themselves, or for groups of hosts: those of RFC 6761, and of the `/etc/hosts` of Linux and macOS.
const OF_SYSTEMS: &[&str] = &[
    "localhost",
    "localhost.localdomain",
    "localhost4",
    "localhost4.localdomain4",
    "localhost6",
    "localhost6.localdomain6",
    "ip6-localhost",
    "ip6-loopback",
    "ip6-localnet",
    "ip6-mcastprefix",
    "ip6-allnodes",
    "ip6-allrouters",
    "ip6-allhosts",
    "broadcasthost",
];
/// The domain whose names all lead to the machine itself.
const OF_THE_MACHINE: &str = ".localhost";

/// Checks names of nodes and machines, of wireless links, and those that become names of files.
pub(super) fn names(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    hosts(record, sink);
    wireless_links(record, &testbed.graph, sink);
    files(record, testbed, sink);
}

/// Nodes, and machines behind gateways, are found by their names.
fn hosts(record: &TestbedRecord, sink: &mut Sink) {
    let nodes = record.nodes.0.iter();
    let named = nodes.flat_map(|(id, node)| {
        let machines = match node {
            NodeRecord::Gateway(gateway) => &gateway.machines.value.0[..],
            _ => &[],
        };
        [id].into_iter().chain(machines.iter().map(|(name, _)| name))
    });
    let mut alike = Alike::new(
        "programs find nodes by their names, which are the same in upper and lower case: rename one of them",
    );
    for Spanned { value, span } in named {
        let name = host_name(value);
        let elsewhere = if is_number(&name) {
            Some("programs take it for an IP address")
        } else if OF_SYSTEMS.contains(&&*name) || name.ends_with(OF_THE_MACHINE) {
            Some("programs take it for their own machine, or for a group")
        } else {
            None
        };
        if let Some(elsewhere) = elsewhere {
            sink.error(span, format!("the name `{value}` leads elsewhere"))
                .label(elsewhere)
                .help(format!("write a name of its own, such as `node-{}`", name.replace('.', "-")));
        }
        alike.check(name, "node", value.as_str(), span, sink);
    }
}

/// Returns a name as resolvers compare it.
fn host_name(id: &NodeId) -> String {
    id.as_str().trim_end_matches('.').to_ascii_lowercase()
}

/// Whether the C library reads it as an IPv4 address, as it does with one to four numbers: decimal, octal or hexadecimal. A text
/// of more numbers looks like one.
fn is_number(name: &str) -> bool {
    name.split('.').all(|part| {
        let (digits, radix) = part.strip_prefix("0x").map_or((part, 10), |hexadecimal| (hexadecimal, 16));
        digits.chars().all(|c| c.is_digit(radix))
    })
}

/// Two wireless links never have one name: neither `a~b` of `a` with `b~c`, nor `a` of `a~b` with `c`.
fn wireless_links(record: &TestbedRecord, graph: &HardwareGraph, sink: &mut Sink) {
    let robots: HashMap<_, _> =
        graph.robots().map(|(node, robot)| (node.id.as_str(), &robot.network)).collect();
    let units: HashMap<_, _> =
        graph.radio_units().map(|(node, unit)| (node.id.as_str(), &unit.network)).collect();
    for (id, _) in &record.nodes.0 {
        let unit = id.value.as_str();
        let Some(network) = units.get(unit) else { continue };
        for (tilde, _) in unit.match_indices('~') {
            let (begin, rest) = (&unit[..tilde], &unit[tilde + 1..]);
            for (robot, _) in robots.iter().filter(|(_, of)| *of == network) {
                let longer = format!("{robot}~{begin}");
                if let (Some(of), Some(its)) = (robots.get(&*longer), units.get(rest))
                    && of == its
                {
                    sink.error(
                        &id.span,
                        format!(
                            "`{robot}` at `{unit}` and `{longer}` at `{rest}` have one wireless link, `{robot}~{unit}`"
                        ),
                    )
                    .help("rename one of them, without `~`");
                }
            }
        }
    }
}

/// VNFs, plug-ins and sensors have files of their own in the folder of a run, also where the names of files do not distinguish
/// upper from lower case.
fn files(record: &TestbedRecord, testbed: &Testbed, sink: &mut Sink) {
    const HELP: &str =
        "rename one of them: they have files of their names, which not every system tells apart by case";
    let mut logs = Alike::new(HELP);
    for host in &testbed.containers.hosts {
        let id = record.nodes.0.iter().map(|(id, _)| id).find(|id| id.value == *host.id.as_str());
        if let Some(id) = id {
            logs.check(host.id.as_str().to_ascii_lowercase(), "container", host.id.as_str(), &id.span, sink);
        }
    }
    for ((_, its), service) in record.services.0.iter().zip(&testbed.services) {
        let file = its.compose.as_ref().map(|compose| &compose.file.span);
        let places = its.vnfs.0.iter().map(|(id, _)| Some(&id.span)).chain(std::iter::repeat(file));
        for (vnf, place) in service.vnfs.iter().zip(places) {
            let Some(place) = place else { continue };
            logs.check(vnf.id.as_str().to_ascii_lowercase(), "VNF", vnf.id.as_str(), place, sink);
        }
    }
    let mut of_plugins = Alike::new(HELP);
    for entry in &record.plugins {
        // A bundled program has no log of its own.
        let Either::Long(PluginRecord { id: Some(id), command: Some(_), .. }) = &entry.value else {
            continue;
        };
        let file = id.value.as_str().to_ascii_lowercase();
        of_plugins.check(file, "plug-in", id.value.as_str(), &id.span, sink);
    }
    for (_, node) in &record.nodes.0 {
        let NodeRecord::Robot(robot) = node else { continue };
        let mut sensors = Alike::new(HELP);
        for (Spanned { value, span }, _) in &robot.sensors.0 {
            sensors.check(value.as_str().to_ascii_lowercase(), "sensor", value.as_str(), span, sink);
        }
    }
}

/// Names so far, by what they are elsewhere.
struct Alike<'a> {
    help: &'static str,
    seen: HashMap<String, (&'static str, &'a str)>,
}

impl<'a> Alike<'a> {
    fn new(help: &'static str) -> Self {
        Self { help, seen: HashMap::new() }
    }

    /// Reports a name that is the same as another one elsewhere, but not here: the same kind of thing twice is reported as such.
    fn check(&mut self, elsewhere: String, kind: &'static str, name: &'a str, span: &Span, sink: &mut Sink) {
        match self.seen.get(&elsewhere) {
            Some(before) if before.1 == name => {}
            Some((before_kind, before)) => {
                let message = match kind == *before_kind {
                    true => format!("`{before}` and `{name}` are one name"),
                    false => {
                        format!("the {before_kind} `{before}` and the {kind} `{name}` have files of one name")
                    }
                };
                sink.error(span, message).help(self.help);
            }
            None => {
                self.seen.insert(elsewhere, (kind, name));
            }
        }
    }
}
