//! Configures interfaces through rtnetlink, with many requests in one message. The `ip` program is never started.

use std::{
    io,
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
    os::fd::{AsFd, AsRawFd, BorrowedFd},
    path::Path,
};

use cotorra_graph::HostAddress;
use cotorra_netlink::{
    ACK, CREATE, ERROR, EXCLUSIVE, NETLINK_ROUTE, REPLACE, REQUEST, Writer, message, messages, parse_i32,
    rtnetlink::{self, NEW_LINK, SET_LINK},
};
use netlink_sys::Socket;

/// `RTM_NEWADDR`.
const NEW_ADDRESS: u16 = 20;
/// `RTM_NEWROUTE`.
const NEW_ROUTE: u16 = 24;
/// `RTM_NEWNEIGH`.
const NEW_NEIGHBOUR: u16 = 28;
/// `RTM_NEWQDISC`.
const NEW_DISCIPLINE: u16 = 36;

/// Attributes of interfaces, `IFLA_*`.
mod link {
    pub(super) const ADDRESS: u16 = 1;
    pub(super) const NAME: u16 = 3;
    pub(super) const MTU: u16 = 4;
    pub(super) const MASTER: u16 = 10;
    pub(super) const QUEUE: u16 = 13;
    pub(super) const INFO: u16 = 18;
    pub(super) const INFO_KIND: u16 = 1;
    pub(super) const INFO_DATA: u16 = 2;
    /// `VETH_INFO_PEER`.
    pub(super) const PEER: u16 = 1;
    /// `IFLA_BR_MCAST_SNOOPING`.
    pub(super) const MULTICAST_SNOOPING: u16 = 23;
    pub(super) const AF_SPEC: u16 = 26;
    /// `IFLA_INET6_ADDR_GEN_MODE`.
    pub(super) const ADDRESS_MODE: u16 = 8;
    pub(super) const NAMESPACE: u16 = 28;
}

/// Attributes of addresses, `IFA_*`.
mod address {
    pub(super) const ADDRESS: u16 = 1;
    pub(super) const LOCAL: u16 = 2;
    pub(super) const BROADCAST: u16 = 4;
    pub(super) const FLAGS: u16 = 8;
    /// `IFA_F_NODAD`.
    pub(super) const NO_DETECTION: u8 = 2;
}

/// Numbers of routes.
mod route {
    /// `RTA_DST`.
    pub(super) const TO: u16 = 1;
    /// `RTA_OIF`.
    pub(super) const INTERFACE: u16 = 4;
    /// `RTPROT_STATIC`.
    pub(super) const STATIC: u8 = 4;
    /// `RTN_UNICAST`.
    pub(super) const UNICAST: u8 = 1;
    /// `RTN_LOCAL`.
    pub(super) const LOCAL: u8 = 2;
}

const INET: u8 = libc::AF_INET as u8;
const INET6: u8 = libc::AF_INET6 as u8;

/// A request, without its number.
#[derive(Debug, Clone)]
pub(crate) struct Request {
    kind: u16,
    body: Vec<u8>,
}

impl Request {
    fn new(kind: u16, body: Writer) -> Self {
        Self { kind, body: body.finish() }
    }
}

/// Index of the loopback interface in every network namespace.
pub(crate) const LOOPBACK: u32 = 1;
/// Most requests in a message, which must fit the socket's buffer, as must the answers if all are rejected.
const MOST_REQUESTS: usize = 200;
/// Group of changes of interfaces.
const RTNLGRP_LINK: u32 = 1;

/// An rtnetlink socket of one network namespace.
pub(crate) struct Netlink {
    socket: Socket,
}

impl Netlink {
    /// Opens a socket in the calling thread's network namespace. It stays in that namespace when the thread changes
    /// to another.
    pub(crate) fn open() -> io::Result<Self> {
        let mut socket = Socket::new(NETLINK_ROUTE)?;
        socket.bind_auto()?;
        // Errors come back without the request, so that all answers to a batch fit the buffer.
        socket.set_cap_ack(true)?;
        Ok(Self { socket })
    }

    /// Opens a socket that also receives changes of the namespace's interfaces, and does not block.
    pub(crate) fn of_changes() -> io::Result<Self> {
        let netlink = Self::open()?;
        netlink.socket.add_membership(RTNLGRP_LINK)?;
        netlink.socket.set_non_blocking(true)?;
        Ok(netlink)
    }

    /// Sends requests, many in one message, and returns once the kernel has done all. Returns the first error; the requests of
    /// later messages are not sent then.
    pub(crate) fn execute(&self, requests: Vec<Request>) -> io::Result<()> {
        let mut requests = requests.into_iter().peekable();
        while requests.peek().is_some() {
            let (batch, last) = batch(requests.by_ref().take(MOST_REQUESTS), EXCLUSIVE, ACK);
            self.socket.send(&batch, 0)?;
            self.answers_until(last)?;
        }
        Ok(())
    }

    /// Reads answers up to that to the request with this number. Returns the first error.
    fn answers_until(&self, last: u32) -> io::Result<()> {
        let mut result = Ok(());
        let mut answered = 0;
        let mut answers = Vec::with_capacity(8192);
        while answered != last {
            answers.clear();
            self.socket.recv(&mut answers, 0)?;
            for answer in messages(&answers) {
                let answer = answer.map_err(invalid)?;
                if answer.kind == ERROR {
                    answered = answer.sequence;
                    let code = parse_i32(answer.body.get(..4).unwrap_or_default()).map_err(invalid)?;
                    if code != 0 && result.is_ok() {
                        result = Err(io::Error::from_raw_os_error(code.wrapping_neg()));
                    }
                }
            }
        }
        result
    }

    /// Sends requests whose errors are ignored. They replace what is there.
    pub(crate) fn replace(&self, requests: Vec<Request>) -> io::Result<()> {
        let mut requests = requests.into_iter().peekable();
        while requests.peek().is_some() {
            let (batch, _) = batch(requests.by_ref().take(MOST_REQUESTS), REPLACE, 0);
            self.socket.send(&batch, 0)?;
        }
        Ok(())
    }

    /// Reads what has come to a socket [`Self::of_changes`]. Returns whether an interface may have been set up since.
    pub(crate) fn was_set_up(&self, interface: u32) -> bool {
        let mut was_set_up = false;
        let mut changes = Vec::with_capacity(8192);
        loop {
            changes.clear();
            match self.socket.recv(&mut changes, 0) {
                Ok(_) => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return was_set_up,
                // Changes were lost.
                Err(error) if error.raw_os_error() == Some(libc::ENOBUFS) => was_set_up = true,
                Err(_) => return false,
            }
            was_set_up |= messages(&changes).any(|change| match change {
                Ok(change) if change.kind == NEW_LINK => {
                    rtnetlink::set_up(change.body).map_or(true, |set_up| set_up == (interface, true))
                }
                Ok(_) => false,
                Err(_) => true,
            });
        }
    }
}

impl AsFd for Netlink {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

fn invalid(error: cotorra_netlink::DecodeError) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, error)
}

/// Writes requests into one message. The last one has more flags. Returns its number, too.
fn batch(requests: impl Iterator<Item = Request>, flags: u16, last_flags: u16) -> (Vec<u8>, u32) {
    let mut requests = requests.zip(1..).peekable();
    let (mut batch, mut last) = (Vec::new(), 0);
    while let Some((Request { kind, body }, number)) = requests.next() {
        let mut flags = REQUEST | CREATE | flags;
        if requests.peek().is_none() {
            flags |= last_flags;
            last = number;
        }
        batch.extend(message(kind, flags, number, &body));
    }
    (batch, last)
}

/// Sets an interface up.
pub(crate) fn up(index: u32) -> Request {
    Request::new(SET_LINK, rtnetlink::link_up(index))
}

/// Sets an interface up, as a port of a bridge.
pub(crate) fn up_in_bridge(index: u32, bridge: u32) -> Request {
    let mut port = rtnetlink::link_up(index);
    port.words(link::MASTER, &[bridge]);
    Request::new(SET_LINK, port)
}

fn veth_pair(name: &str, index: u32, peer: Writer) -> Request {
    let mut pair = rtnetlink::link(index);
    pair.text(link::NAME, name).with(link::INFO, |info| {
        info.text(link::INFO_KIND, "veth").with(link::INFO_DATA, |data| {
            data.bytes(link::PEER, &peer.finish());
        });
    });
    Request::new(NEW_LINK, pair)
}

/// Makes a pair of virtual Ethernet interfaces: one here, its peer in another network namespace, both with this
/// index. (Kernels ignore an index that is given for the peer only.)
pub(crate) fn veth(name: &str, peer: &str, index: u32, peer_space: BorrowedFd<'_>) -> Request {
    let mut there = rtnetlink::link(index);
    there.text(link::NAME, peer).words(link::NAMESPACE, &[peer_space.as_raw_fd().cast_unsigned()]);
    veth_pair(name, index, there)
}

/// Makes a pair of virtual Ethernet interfaces here, each with its name and index.
pub(crate) fn veth_here([(name, index), (peer, peer_index)]: [(&str, u32); 2]) -> Request {
    let mut other = rtnetlink::link(peer_index);
    other.text(link::NAME, peer);
    veth_pair(name, index, other)
}

pub(crate) fn bridge(name: &str, index: u32) -> Request {
    let mut bridge = rtnetlink::link(index);
    bridge.text(link::NAME, name).with(link::INFO, |info| {
        info.text(link::INFO_KIND, "bridge");
    });
    Request::new(NEW_LINK, bridge)
}

/// Makes a bridge that floods multicast packets to all its ports, and an interface one of these, both up and without addresses.
pub(crate) fn bridged(interface: u32, name: &str, index: u32, mtu: u32, queue: u32) -> Vec<Request> {
    let mut bridge = rtnetlink::link(index);
    bridge.text(link::NAME, name).with(link::INFO, |info| {
        info.text(link::INFO_KIND, "bridge").with(link::INFO_DATA, |data| {
            data.bytes(link::MULTICAST_SNOOPING, &[0]);
        });
    });
    let mut port = rtnetlink::link_up(interface);
    port.words(link::MASTER, &[index]).words(link::MTU, &[mtu]).words(link::QUEUE, &[queue]);
    let mut requests = vec![Request::new(NEW_LINK, bridge)];
    requests.extend(without_own_address(interface));
    requests.push(Request::new(SET_LINK, port));
    requests
}

/// Changes the MAC address of an interface that is down, and gives it no address by itself.
pub(crate) fn at_mac(interface: u32, mac: [u8; 6]) -> Vec<Request> {
    let mut change = rtnetlink::link(interface);
    change.bytes(link::ADDRESS, &mac);
    without_own_address(interface).into_iter().chain([Request::new(SET_LINK, change)]).collect()
}

/// Keeps the kernel from giving an interface a link-local address. `None` without IPv6.
fn without_own_address(interface: u32) -> Option<Request> {
    /// `IN6_ADDR_GEN_MODE_NONE`.
    const NONE: u8 = 1;
    let mut change = rtnetlink::link(interface);
    change.with(link::AF_SPEC, |families| {
        families.with(INET6.into(), |of| {
            of.bytes(link::ADDRESS_MODE, &[NONE]);
        });
    });
    has_ipv6().then(|| Request::new(SET_LINK, change))
}

fn octets(address: IpAddr) -> Vec<u8> {
    match address {
        IpAddr::V4(v4) => v4.octets().to_vec(),
        IpAddr::V6(v6) => v6.octets().to_vec(),
    }
}

fn family(address: IpAddr) -> u8 {
    if address.is_ipv4() { INET } else { INET6 }
}

fn address(index: u32, address: IpAddr, prefix: u8, scope: u8) -> Request {
    let mut request = Writer::default();
    // `struct ifaddrmsg`. Addresses follow from the graph and are unique. Duplicate address detection would only delay a host
    // by a second.
    request.raw(&[family(address), prefix, address::NO_DETECTION, scope]).raw(&index.to_ne_bytes());
    request.bytes(address::LOCAL, &octets(address)).bytes(address::ADDRESS, &octets(address));
    request.words(address::FLAGS, &[address::NO_DETECTION.into()]);
    if let IpAddr::V4(v4) = address {
        let broadcast = u32::from(v4) | (u32::MAX >> prefix);
        request.bytes(address::BROADCAST, &broadcast.to_be_bytes());
    }
    Request::new(NEW_ADDRESS, request)
}

/// Adds a route to what is reached without a router, also for broadcast or multicast, which the kernel would otherwise not
/// send.
pub(crate) fn route(index: u32, to: Ipv4Addr, prefix: u8) -> Request {
    let (table, scope) = (libc::RT_TABLE_MAIN, libc::RT_SCOPE_LINK);
    route_over(index, to.into(), prefix, [table, route::STATIC, scope, route::UNICAST])
}

/// `kind` has the route's table, protocol, scope and type.
fn route_over(index: u32, to: IpAddr, prefix: u8, [table, protocol, scope, kind]: [u8; 4]) -> Request {
    let mut request = Writer::default();
    // `struct rtmsg`.
    request.raw(&[family(to), prefix, 0, 0, table, protocol, scope, kind, 0, 0, 0, 0]);
    request.bytes(route::TO, &octets(to)).words(route::INTERFACE, &[index]);
    Request::new(NEW_ROUTE, request)
}

/// Tells an interface a neighbour's MAC address for good. The kernel never asks for it, and does not count it against the size
/// of its table.
pub(crate) fn neighbour(index: u32, address: IpAddr, mac: [u8; 6]) -> Request {
    /// `NDA_DST`.
    const ADDRESS: u16 = 1;
    /// `NDA_LLADDR`.
    const MAC: u16 = 2;
    /// `NUD_PERMANENT`.
    const PERMANENT: u16 = 0x80;
    let mut request = Writer::default();
    // `struct ndmsg`.
    request.raw(&[family(address), 0, 0, 0]).raw(&index.to_ne_bytes());
    request.raw(&PERMANENT.to_ne_bytes()).bytes(ADDRESS, &octets(address)).bytes(MAC, &mac);
    Request::new(NEW_NEIGHBOUR, request)
}

/// Adds the route by which a host receives packets to an address of its own. The kernel adds one, too, but later, on a
/// work queue: it drops packets that arrive before.
fn local_route(index: u32, to: Ipv6Addr) -> Request {
    let (table, scope) = (libc::RT_TABLE_LOCAL, libc::RT_SCOPE_UNIVERSE);
    route_over(index, to.into(), 128, [table, route::STATIC, scope, route::LOCAL])
}

/// Returns the link-local address that follows from a MAC address (RFC 4291, appendix A).
fn link_local(mac: [u8; 6]) -> Ipv6Addr {
    let [a, b, c, d, e, f] = mac.map(u16::from);
    Ipv6Addr::new(0xfe80, 0, 0, 0, (a ^ 2) << 8 | b, c << 8 | 0xff, 0xfe00 | d, e << 8 | f)
}

/// Whether the kernel has IPv6 in the calling thread's network namespace.
pub(crate) fn has_ipv6() -> bool {
    Path::new("/proc/thread-self/net/if_inet6").exists()
}

/// Returns the requests that set a host's interfaces up: loopback, and that with its addresses.
pub(crate) fn host(interface: u32, of: &HostAddress, mtu: u32, queue: u32) -> Vec<Request> {
    let mut requests = vec![up(LOOPBACK)];
    // The kernel's own link-local address would be tentative for a second.
    requests.extend(without_own_address(interface));
    let mut own = rtnetlink::link_up(interface);
    own.bytes(link::ADDRESS, &of.mac).words(link::MTU, &[mtu]).words(link::QUEUE, &[queue]);
    requests.push(Request::new(SET_LINK, own));
    requests
}

/// Returns the requests that give an interface that is up a host's addresses and routes.
pub(crate) fn addresses(interface: u32, of: &HostAddress, has_ipv6: bool) -> Vec<Request> {
    let (universe, on_this_link) = (libc::RT_SCOPE_UNIVERSE, libc::RT_SCOPE_LINK);
    let mut requests = vec![
        address(interface, of.ipv4.into(), HostAddress::IPV4_PREFIX, universe),
        route(interface, Ipv4Addr::new(224, 0, 0, 0), 4),
        route(interface, Ipv4Addr::BROADCAST, 32),
    ];
    if has_ipv6 {
        let on_link = link_local(of.mac);
        requests.push(address(interface, on_link.into(), 64, on_this_link));
        requests.push(address(interface, of.ipv6.into(), HostAddress::IPV6_PREFIX, universe));
        requests.extend([on_link, of.ipv6].map(|own| local_route(interface, own)));
    }
    requests
}

/// Puts a NetEm queueing discipline on an interface. `ENOENT` means that the kernel has none.
pub(crate) fn netem(index: u32) -> Request {
    /// `TCA_KIND`.
    const KIND: u16 = 1;
    /// `TCA_OPTIONS`.
    const OPTIONS: u16 = 2;
    /// `TC_H_ROOT`.
    const ROOT: u32 = u32::MAX;
    let mut request = Writer::default();
    // `struct tcmsg`: family, interface, handle, parent and info.
    request.raw(&[0, index, 1 << 16, ROOT, 0].map(u32::to_ne_bytes).concat());
    // `struct tc_netem_qopt`: latency, limit, loss, gap, duplicate, jitter. Only the limit must not be zero.
    request.text(KIND, "netem").words(OPTIONS, &[0, 1000, 0, 0, 0, 0]);
    Request::new(NEW_DISCIPLINE, request)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn link_local_address_follows_from_the_mac() {
        assert_eq!(link_local([0x02, 0x77, 0, 0, 0x12, 0x34]).to_string(), "fe80::77:ff:fe00:1234");
    }

    #[test]
    fn batches_of_any_length_return_the_first_error() {
        if !crate::privilege::have_rights() {
            // The test harness has threads, so an ordinary user cannot enter a user namespace here.
            return;
        }
        crate::namespace::Namespace::new().unwrap().run(|| {
            let netlink = Netlink::open().unwrap();
            netlink.execute(vec![up(1), up(1)]).unwrap();
            let error = netlink.execute(vec![up(1), up(4711), up(1)]).unwrap_err();
            assert_eq!(error.raw_os_error(), Some(libc::ENODEV));
            netlink.execute(vec![]).unwrap();
            netlink.execute(vec![up(1); 2 * MOST_REQUESTS + 1]).unwrap();
            for count in [1, MOST_REQUESTS, 3 * MOST_REQUESTS] {
                let error = netlink.execute(vec![up(4711); count]).unwrap_err();
                assert_eq!(error.raw_os_error(), Some(libc::ENODEV), "all {count} are rejected");
            }
            netlink.execute(vec![up(1)]).unwrap();
        });
    }
}
