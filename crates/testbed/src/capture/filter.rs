//! Filters of captures: a subset of pcap-filter(7) in which nodes are hosts.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use cotorra_flows::headers::{ETHERNET, IPV6, IpVersion, PROTOCOL_TCP, PROTOCOL_UDP, find_ip, u16_at};
use cotorra_graph::{HardwareGraph, NodeId};

/// Longest text of a filter, bytes.
const LONGEST: usize = 1000;
const PROTOCOL_ICMP: u8 = 1;
const PROTOCOL_ICMP6: u8 = 58;
const ETHERTYPE_ARP: u16 = 0x0806;

/// Error of a text that is not a filter.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the filter is wrong: {0}. Filters are made of `ip`, `ip6`, `arp`, `icmp`, `icmp6`, `tcp`, `udp`, `[tcp|udp] [src|dst] \
     port N` and `[src|dst] host NODE-OR-ADDRESS` with `not`, `and`, `or` and parentheses, as in `udp and host edge`"
)]
pub(crate) struct FilterError(String);

/// Selects packets.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Filter {
    Not(Box<Filter>),
    And(Box<[Filter; 2]>),
    Or(Box<[Filter; 2]>),
    Arp,
    Ip(IpVersion),
    Protocol(IpVersion, u8),
    /// TCP or UDP, over IPv4 or IPv6.
    Transport(u8),
    /// The addresses of one host.
    Host(Option<End>, Vec<IpAddr>),
    Port(Option<End>, Option<u8>, u16),
}

/// One end of a packet; without one, either is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    Source,
    Destination,
}

impl Filter {
    /// Parses a filter for packets between the hosts of this graph.
    ///
    /// # Errors
    /// [`FilterError`].
    pub(crate) fn parse(text: &str, graph: &HardwareGraph) -> Result<Self, FilterError> {
        if text.len() > LONGEST {
            return Err(FilterError(format!("it has more than {LONGEST} bytes")));
        }
        let mut parser = Parser { words: words(text).into_iter(), next: None, graph };
        parser.step();
        let filter = parser.expression()?;
        match parser.next {
            None => Ok(filter),
            Some(word) => Err(FilterError(format!("`and` or `or` is missing before `{word}`"))),
        }
    }

    /// Whether it selects an Ethernet frame.
    pub(crate) fn selects(&self, frame: &[u8]) -> bool {
        self.holds(&Headers::of(frame))
    }

    fn holds(&self, headers: &Headers) -> bool {
        match self {
            Self::Not(one) => !one.holds(headers),
            Self::And(both) => both.iter().all(|one| one.holds(headers)),
            Self::Or(both) => both.iter().any(|one| one.holds(headers)),
            Self::Arp => headers.is_arp,
            Self::Ip(version) => headers.version == Some(*version),
            Self::Protocol(version, protocol) => {
                headers.version == Some(*version) && headers.protocol == Some(*protocol)
            }
            Self::Transport(protocol) => headers.protocol == Some(*protocol),
            Self::Host(end, addresses) => at(*end, headers.addresses, |address| addresses.contains(&address)),
            Self::Port(end, transport, port) => {
                transport.is_none_or(|transport| headers.protocol == Some(transport))
                    && at(*end, headers.ports, |other| other == *port)
            }
        }
    }
}

/// Whether something is true of one end, or of either.
fn at<T: Copy>(end: Option<End>, both: Option<[T; 2]>, is_true: impl Fn(T) -> bool) -> bool {
    both.is_some_and(|[source, destination]| match end {
        Some(End::Source) => is_true(source),
        Some(End::Destination) => is_true(destination),
        None => is_true(source) || is_true(destination),
    })
}

/// The fields of a packet that filters compare.
#[derive(Debug, Default)]
struct Headers {
    is_arp: bool,
    version: Option<IpVersion>,
    protocol: Option<u8>,
    /// Source and destination.
    addresses: Option<[IpAddr; 2]>,
    /// Those of TCP or UDP; `None` in a later fragment.
    ports: Option<[u16; 2]>,
}

impl Headers {
    fn of(frame: &[u8]) -> Self {
        let v4 = |at: usize| Some(IpAddr::from(Ipv4Addr::from(*frame.get(at..)?.first_chunk::<4>()?)));
        let v6 = |at: usize| Some(IpAddr::from(Ipv6Addr::from(*frame.get(at..)?.first_chunk::<16>()?)));
        let Some((ip, version)) = find_ip(frame) else {
            let is_arp = u16_at(frame, ETHERNET - 2) == Some(ETHERTYPE_ARP);
            let addresses = v4(ETHERNET + 14).zip(v4(ETHERNET + 24)).filter(|_| is_arp);
            return Self { is_arp, addresses: addresses.map(Into::into), ..Self::default() };
        };
        let (protocol, addresses, transport) = match version {
            IpVersion::V4 => {
                let is_first = u16_at(frame, ip + 6).is_some_and(|fragment| fragment & 0x1fff == 0);
                let length = frame.get(ip).map(|first| usize::from(first & 0x0f) * 4);
                let transport = length.filter(|_| is_first).map(|length| ip + length);
                (frame.get(ip + 9), v4(ip + 12).zip(v4(ip + 16)), transport)
            }
            IpVersion::V6 => (frame.get(ip + 6), v6(ip + 8).zip(v6(ip + 24)), Some(ip + IPV6)),
        };
        let protocol = protocol.copied();
        let has_ports = matches!(protocol, Some(PROTOCOL_TCP | PROTOCOL_UDP));
        let ports = transport.filter(|_| has_ports);
        let ports = ports.and_then(|at| Some([u16_at(frame, at)?, u16_at(frame, at + 2)?]));
        let version = Some(version);
        Self { is_arp: false, version, protocol, addresses: addresses.map(Into::into), ports }
    }
}

/// Splits a filter into words. Parentheses, `!`, `&&` and `||` are words of their own.
fn words(text: &str) -> Vec<&str> {
    let mut words = Vec::new();
    for part in text.split_whitespace() {
        let mut rest = part;
        while !rest.is_empty() {
            let length = match rest.as_bytes() {
                [b'(' | b')' | b'!', ..] => 1,
                [b'&', b'&', ..] | [b'|', b'|', ..] => 2,
                _ => {
                    let end = |(at, c): (usize, char)| (at > 0 && "()!&|".contains(c)).then_some(at);
                    rest.char_indices().find_map(end).unwrap_or(rest.len())
                }
            };
            let (word, after) = rest.split_at(length);
            words.push(word);
            rest = after;
        }
    }
    words
}

struct Parser<'a> {
    words: std::vec::IntoIter<&'a str>,
    next: Option<&'a str>,
    graph: &'a HardwareGraph,
}

impl<'a> Parser<'a> {
    /// Takes the next word.
    fn step(&mut self) -> Option<&'a str> {
        std::mem::replace(&mut self.next, self.words.next())
    }

    /// `and` and `or` bind equally, from the left, as in pcap-filter(7).
    fn expression(&mut self) -> Result<Filter, FilterError> {
        let mut left = self.term()?;
        loop {
            let join = match self.next {
                Some("and" | "&&") => Filter::And,
                Some("or" | "||") => Filter::Or,
                _ => return Ok(left),
            };
            self.step();
            left = join(Box::new([left, self.term()?]));
        }
    }

    fn term(&mut self) -> Result<Filter, FilterError> {
        let word = self.step().ok_or_else(|| FilterError("it ends too early".to_owned()))?;
        Ok(match word {
            "not" | "!" => Filter::Not(Box::new(self.term()?)),
            "(" => {
                let inner = self.expression()?;
                match self.step() {
                    Some(")") => inner,
                    _ => return Err(FilterError("a `)` is missing".to_owned())),
                }
            }
            "ip" => Filter::Ip(IpVersion::V4),
            "ip6" => Filter::Ip(IpVersion::V6),
            "arp" => Filter::Arp,
            "icmp" => Filter::Protocol(IpVersion::V4, PROTOCOL_ICMP),
            "icmp6" => Filter::Protocol(IpVersion::V6, PROTOCOL_ICMP6),
            "tcp" => return self.transport(PROTOCOL_TCP),
            "udp" => return self.transport(PROTOCOL_UDP),
            "src" => return self.end(End::Source),
            "dst" => return self.end(End::Destination),
            "host" => return self.host(None),
            "port" => return self.port(None, None),
            other => return Err(FilterError(format!("`{other}` is unknown"))),
        })
    }

    /// Parses what follows `tcp` or `udp`.
    fn transport(&mut self, protocol: u8) -> Result<Filter, FilterError> {
        let end = match self.next {
            Some("src") => Some(End::Source),
            Some("dst") => Some(End::Destination),
            Some("port") => None,
            _ => return Ok(Filter::Transport(protocol)),
        };
        if end.is_some() {
            self.step();
        }
        match self.step() {
            Some("port") => self.port(end, Some(protocol)),
            _ => Err(FilterError("`port` is missing after `src` or `dst`".to_owned())),
        }
    }

    /// Parses what follows `src` or `dst`.
    fn end(&mut self, end: End) -> Result<Filter, FilterError> {
        match self.step() {
            Some("host") => self.host(Some(end)),
            Some("port") => self.port(Some(end), None),
            _ => Err(FilterError("`host` or `port` is missing after `src` or `dst`".to_owned())),
        }
    }

    fn host(&mut self, end: Option<End>) -> Result<Filter, FilterError> {
        let name = self.step().ok_or_else(|| FilterError("a host is missing after `host`".to_owned()))?;
        if let Ok(address) = name.parse() {
            return Ok(Filter::Host(end, vec![address]));
        }
        let id = NodeId::new(name).ok();
        let ipv4 = id.as_ref().and_then(|id| self.graph.ipv4(id));
        let ipv4 = ipv4.ok_or_else(|| FilterError(format!("there is no host `{name}`")))?;
        let ipv6 = id.and_then(|id| self.graph.address(&id)).map(|address| address.ipv6.into());
        Ok(Filter::Host(end, [ipv4.into()].into_iter().chain(ipv6).collect()))
    }

    fn port(&mut self, end: Option<End>, transport: Option<u8>) -> Result<Filter, FilterError> {
        let number = self.step().unwrap_or_default();
        let port = number.parse().map_err(|_| FilterError(format!("`{number}` is not a port's number")))?;
        Ok(Filter::Port(end, transport, port))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_flows::headers::{Ipv4, udp_header};
    use cotorra_graph::HostAddress;

    use super::*;

    /// The hosts `left` and `right`.
    fn graph() -> HardwareGraph {
        let text = "
name: filtered
nodes:
  left: { kind: server, tier: fog, cpus: 1, memory: 1 GB }
  right: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links: [{ ends: [left, right] }]
";
        cotorra_testbed_file::parse("filtered.yaml", text, Path::new("")).unwrap().graph
    }

    fn ethernet(ethertype: u16, rest: &[&[u8]]) -> Vec<u8> {
        [&[0; 12][..], &ethertype.to_be_bytes(), &rest.concat()].concat()
    }

    /// A packet from `left` to `right` with this protocol, and ports where a transport has them.
    fn packet(protocol: u8, ports: [u16; 2], fragment: u16) -> Vec<u8> {
        let [source, destination] = [0, 1].map(|place| HostAddress::of(place).ipv4);
        let header = Ipv4 { protocol, source, destination, fragment, ..Ipv4::default() }.header(8);
        ethernet(0x0800, &[&header, &udp_header(ports[0], ports[1], 0)])
    }

    /// The same over IPv6.
    fn packet6(protocol: u8, ports: [u16; 2]) -> Vec<u8> {
        let [source, destination] = [0, 1].map(|place| HostAddress::of(place).ipv6.octets());
        let head = [0x60, 0, 0, 0, 0, 8, protocol, 64];
        ethernet(0x86dd, &[&head, &source, &destination, &udp_header(ports[0], ports[1], 0)])
    }

    fn arp() -> Vec<u8> {
        let [sender, target] = [0, 1].map(|place| HostAddress::of(place).ipv4.octets());
        ethernet(0x0806, &[&[0; 14], &sender, &[0; 6], &target])
    }

    #[test]
    fn packets_are_selected_as_pcap_filter_says() {
        let packets = [
            ("udp", packet(17, [5000, 53], 0)),
            ("tcp", packet(6, [5000, 80], 0)),
            ("ping", packet(1, [0, 0], 0)),
            ("udp6", packet6(17, [53, 5000])),
            ("ping6", packet6(58, [0, 0])),
            ("arp", arp()),
            ("fragment", packet(17, [5000, 53], 100)),
            ("short", vec![0; 14]),
        ];
        for (filter, selected) in [
            ("udp", "udp udp6 fragment"),
            ("tcp or icmp", "tcp ping"),
            ("ip", "udp tcp ping fragment"),
            ("ip6 and not icmp6", "udp6"),
            ("icmp6", "ping6"),
            ("arp", "arp"),
            ("port 53", "udp udp6"),
            ("src port 53", "udp6"),
            ("udp dst port 53", "udp"),
            ("tcp port 53", ""),
            ("tcp port 80", "tcp"),
            ("host left and arp", "arp"),
            ("src host right", ""),
            ("dst host right and tcp", "tcp"),
            ("host 10.77.0.2 && !(udp||tcp)", "ping arp"),
            ("src host fd77::1", "udp6 ping6"),
            ("not host left", "short"),
            // From the left: (udp or tcp) and port 80.
            ("udp or tcp and port 80", "tcp"),
            ("udp or (tcp and port 80)", "udp tcp udp6 fragment"),
        ] {
            let parsed = Filter::parse(filter, &graph()).unwrap_or_else(|error| panic!("{filter}: {error}"));
            let kept = packets.iter().filter(|(_, packet)| parsed.selects(packet));
            let kept: Vec<_> = kept.map(|(name, _)| *name).collect();
            assert_eq!(kept.join(" "), selected, "{filter}");
        }
    }

    #[test]
    fn filters_that_make_no_sense_are_rejected_with_the_reason() {
        let long = "udp or ".repeat(200) + "udp";
        for (filter, reason) in [
            ("", "it ends too early"),
            ("udp and", "it ends too early"),
            ("(udp", "a `)` is missing"),
            ("udp tcp", "`and` or `or` is missing before `tcp`"),
            ("udp)", "`and` or `or` is missing before `)`"),
            ("host nobody", "there is no host `nobody`"),
            ("host", "a host is missing"),
            ("port http", "`http` is not a port's number"),
            ("port 65536", "`65536` is not a port's number"),
            ("tcp src host left", "`port` is missing"),
            ("src left", "`host` or `port` is missing"),
            ("vlan", "`vlan` is unknown"),
            ("udp & tcp", "before `&`"),
            (&long, "more than 1000 bytes"),
        ] {
            let error = Filter::parse(filter, &graph()).unwrap_err().to_string();
            assert!(error.contains(reason), "{filter}: {error}");
        }
    }

    #[test]
    fn nested_filters_fit_on_the_stack() {
        for deep in ["!".repeat(LONGEST - 3) + "udp", "(".repeat(498) + "udp" + &")".repeat(498)] {
            assert!(Filter::parse(&deep, &graph()).is_ok());
        }
        assert!(Filter::parse(&"(".repeat(LONGEST), &graph()).is_err());
    }

    #[test]
    fn any_bytes_can_be_filtered() {
        let filter = Filter::parse("udp port 53 or host left", &graph()).unwrap();
        for packet in [packet(17, [5000, 53], 0), packet6(17, [53, 1]), arp()] {
            for length in 0..packet.len() {
                let cut = filter.selects(&packet[..length]);
                // Addresses end before ports, so that a cut packet is selected from its addresses on.
                assert!(cut <= filter.selects(&packet));
            }
        }
    }
}
