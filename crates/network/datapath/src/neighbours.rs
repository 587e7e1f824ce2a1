//! Neighbours of hosts: whose MAC addresses they know from the start, and whose they ask for.
//!
//! Addresses of hosts follow from their places, so that no host has to ask for them. This is not only faster. The kernel
//! keeps what was asked for in a table that all namespaces of a machine share, of 1,024 entries by default, and drops
//! packets to neighbours that do not fit. Permanent entries do not count. First round trips have no ARP in virtual time,
//! either.

use std::{
    fs, io,
    net::{IpAddr, Ipv4Addr},
    sync::OnceLock,
};

use cotorra_graph::{HardwareGraph, HostAddress, Node, NodeKind};

use crate::netlink::{self, Request};

/// Most permanent entries of IPv4, and of IPv6, in all namespaces together. They take 64 MiB of the kernel's memory.
const MOST: usize = 1 << 16;
/// Size of the kernel's table by default.
pub(crate) const USUAL_LIMIT: usize = 1024;

/// Whom the hosts of a network reach.
#[derive(Debug, Default)]
pub(crate) struct Neighbours {
    /// Places of hosts. The first `known` of them have entries of all others, and all others of them.
    hosts: Vec<usize>,
    known: usize,
    /// Addresses of real machines, which have MAC addresses of their own.
    machines: Vec<Ipv4Addr>,
    /// The kernel's first refusal of an entry.
    refused: OnceLock<io::Error>,
}

impl Neighbours {
    /// Returns those of a graph's emulated hosts, and of the real machines that they reach.
    pub(crate) fn of(graph: &HardwareGraph, machines: Vec<Ipv4Addr>) -> Self {
        // Of too many, servers come first: most packets have one at an end.
        let rank = |node: &Node| match node.kind {
            NodeKind::Server(_) => 0,
            NodeKind::RadioUnit(_) => 1,
            _ => 2,
        };
        let emulated = graph.hosts().enumerate().filter(|(_, node)| node.real_server().is_none());
        let mut hosts: Vec<_> = emulated.collect();
        hosts.sort_by_key(|(_, node)| rank(node));
        Self::bounded(hosts.into_iter().map(|(place, _)| place).collect(), machines, MOST)
    }

    /// Returns those of hosts, most important first, with so many entries at most.
    fn bounded(hosts: Vec<usize>, machines: Vec<Ipv4Addr>, most: usize) -> Self {
        let count = hosts.len();
        // These have an entry of each other host, and the rest one of each of these.
        let entries = |known: usize| known * (2 * count - known - 1);
        let known = (1..=count).take_while(|known| entries(*known) <= most).last().unwrap_or(0);
        Self { hosts, known, machines, refused: OnceLock::new() }
    }

    /// Returns those of hosts that know no others from the start.
    pub(crate) fn unknown(hosts: usize) -> Self {
        Self { hosts: (0..hosts).collect(), ..Self::default() }
    }

    pub(crate) fn machines(&self) -> &[Ipv4Addr] {
        &self.machines
    }

    /// Returns the places of the hosts that a host knows from the start.
    fn known_to(&self, place: usize) -> impl Iterator<Item = usize> {
        let (first, _) = self.hosts.split_at(self.known);
        let known = if first.contains(&place) { &self.hosts[..] } else { first };
        known.iter().copied().filter(move |other| *other != place)
    }

    /// Returns the requests for a host's entries, at its interface.
    pub(crate) fn entries(&self, interface: u32, place: usize, has_ipv6: bool) -> Vec<Request> {
        let entries = self.known_to(place).map(HostAddress::of).flat_map(|other| {
            let addresses = [Some(IpAddr::from(other.ipv4)), has_ipv6.then_some(other.ipv6.into())];
            let entry = move |address| netlink::neighbour(interface, address, other.mac);
            addresses.into_iter().flatten().map(entry)
        });
        entries.collect()
    }

    /// Records that the kernel refused an entry. Its host asks for others then.
    pub(crate) fn refuse(&self, error: io::Error) {
        let _ = self.refused.set(error);
    }

    /// Returns the number of pairs of a host and a neighbour that it asks for, if all talk to all.
    fn asked(&self) -> usize {
        let rest =
            if self.refused.get().is_some() { self.hosts.len() } else { self.hosts.len() - self.known };
        rest * rest.saturating_sub(1) + self.hosts.len() * self.machines.len()
    }

    /// Returns what is to be known before the figures are trusted, where the kernel's table has this limit.
    fn warning(&self, limit: usize) -> Option<String> {
        let asked = self.asked();
        (asked > limit).then(|| {
            let refused = self.refused.get().map(|error| format!("the kernel makes no permanent entries ({error}): "));
            format!(
                "{}{asked} pairs of nodes find each other by ARP if all talk to all, and the kernel's table of neighbours has \
                 room for {limit}, for all namespaces of this machine: it drops packets beyond. As root: \
                 `sysctl -w net.ipv4.neigh.default.gc_thresh3={needed} net.ipv6.neigh.default.gc_thresh3={needed}`",
                refused.unwrap_or_default(),
                needed = asked.saturating_mul(2).next_power_of_two(),
            )
        })
    }

    /// Warns of a network that this machine's table may be too small for.
    pub(crate) fn warn(&self) {
        // A container may not show it.
        if let Some(warning) = self.warning(limit().unwrap_or(USUAL_LIMIT)) {
            tracing::warn!("{warning}");
        }
    }
}

/// Returns the number of entries that the kernel's tables of IPv4 and IPv6 have room for.
pub(crate) fn limit() -> io::Result<usize> {
    let of = |version: u8| {
        let text = fs::read_to_string(format!("/proc/sys/net/ipv{version}/neigh/default/gc_thresh3"))?;
        text.trim().parse().map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))
    };
    let ipv4: usize = of(4)?;
    // There may be no IPv6.
    Ok(of(6).map_or(ipv4, |ipv6: usize| ipv4.min(ipv6)))
}

/// Returns how often the kernel dropped a packet since it started, because its tables of neighbours were full. `None` in network
/// namespaces other than the machine's, which do not show it.
pub(crate) fn overflows() -> Option<u64> {
    let of = |table: &str| table_fulls(&fs::read_to_string(format!("/proc/net/stat/{table}")).ok()?);
    Some(of("arp_cache")? + of("ndisc_cache").unwrap_or(0))
}

/// Reads the sum over all processors from the statistics of a table.
fn table_fulls(statistics: &str) -> Option<u64> {
    let mut lines = statistics.lines();
    let column = lines.next()?.split_whitespace().position(|name| name == "table_fulls")?;
    lines.map(|line| u64::from_str_radix(line.split_whitespace().nth(column)?, 16).ok()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(neighbours: &Neighbours, place: usize) -> Vec<usize> {
        neighbours.known_to(place).collect()
    }

    #[test]
    fn all_know_all_as_far_as_the_bound_allows() {
        let all = Neighbours::bounded(vec![2, 0, 1], Vec::new(), 6);
        assert_eq!([0, 1, 2].map(|place| known(&all, place)), [vec![2, 1], vec![2, 0], vec![0, 1]]);
        assert_eq!((all.asked(), all.warning(0)), (0, None));
        let few = Neighbours::bounded((0..256).collect(), Vec::new(), MOST);
        assert_eq!(few.asked(), 0, "256 hosts");
    }

    #[test]
    fn the_first_know_all_and_are_known_to_all_beyond_the_bound() {
        let star = Neighbours::bounded(vec![2, 0, 1, 3], Vec::new(), 8);
        assert_eq!(known(&star, 2), [0, 1, 3]);
        for place in [0, 1, 3] {
            assert_eq!(known(&star, place), [2]);
        }
        assert_eq!(star.asked(), 6);
        let large = Neighbours::bounded((0..1001).collect(), Vec::new(), MOST);
        let entries: usize = (0..1001).map(|place| large.known_to(place).count()).sum();
        assert!((MOST - 2000..=MOST).contains(&entries), "{entries}");
        assert_eq!(known(&large, 0).len(), 1000, "a hub");
    }

    #[test]
    fn none_are_known_of_too_many_hosts_or_of_none() {
        for (hosts, asked) in [(0, 0), (1, 0), (40_000, 40_000 * 39_999)] {
            let neighbours = Neighbours::bounded((0..hosts).collect(), Vec::new(), MOST);
            assert_eq!((known(&neighbours, 0).len(), neighbours.asked()), (0, asked));
        }
    }

    #[test]
    fn networks_that_ask_for_more_than_the_table_holds_get_a_warning_with_its_size() {
        let machines = vec![Ipv4Addr::LOCALHOST; 3];
        let gateway = Neighbours::bounded((0..40).collect(), machines, MOST);
        assert_eq!((gateway.asked(), gateway.warning(120)), (120, None));
        let warning = gateway.warning(119).unwrap();
        assert!(warning.contains("120 pairs") && warning.contains("gc_thresh3=256 "), "{warning}");
        let refused = Neighbours::bounded((0..40).collect(), Vec::new(), MOST);
        refused.refuse(io::Error::other("no"));
        let warning = refused.warning(1024).unwrap();
        assert!(warning.contains("no permanent entries (no)") && warning.contains("1560 pairs"), "{warning}");
        assert!(Neighbours::unknown(40).warning(1024).is_some());
        assert_eq!(Neighbours::unknown(32).warning(1024), None);
    }

    #[test]
    fn overflows_are_summed_over_processors() {
        let statistics = "entries  allocs unresolved_discards table_fulls\n\
                          00000002 000002 00000000            0000000a\n\
                          00000002 000000 00000000            00000100\n";
        assert_eq!(table_fulls(statistics), Some(266));
        assert_eq!(table_fulls("entries allocs\n1 2\n"), None);
    }
}
