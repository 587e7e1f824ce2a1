//! Configures interfaces through rtnetlink, with many requests in one message. The `ip` program is never started.

use std::{
    io,
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
    os::fd::{AsFd, AsRawFd, BorrowedFd},
    path::Path,
};

use cotorra_graph::HostAddress;
use netlink_packet_core::{
    NLM_F_ACK, NLM_F_CREATE, NLM_F_EXCL, NLM_F_REPLACE, NLM_F_REQUEST, NetlinkMessage, NetlinkPayload,
};
use netlink_packet_route::{
    AddressFamily, RouteNetlinkMessage,
    address::{AddressAttribute, AddressFlags, AddressHeaderFlags, AddressMessage, AddressScope},
    link::{
        AfSpecInet6, AfSpecUnspec, In6AddrGenMode, InfoBridge, InfoData, InfoKind, InfoVeth, LinkAttribute,
        LinkFlags, LinkHeader, LinkInfo, LinkMessage,
    },
    neighbour::{NeighbourAddress, NeighbourAttribute, NeighbourMessage, NeighbourState},
    route::{RouteAddress, RouteAttribute, RouteHeader, RouteMessage, RouteProtocol, RouteScope, RouteType},
    tc::{TcAttribute, TcHandle, TcMessage},
};
use netlink_sys::{Socket, protocols::NETLINK_ROUTE};

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
    pub(crate) fn execute(&self, requests: Vec<RouteNetlinkMessage>) -> io::Result<()> {
        let mut requests = requests.into_iter().peekable();
        while requests.peek().is_some() {
            let (batch, last) = batch(requests.by_ref().take(MOST_REQUESTS), NLM_F_EXCL, NLM_F_ACK);
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
                let answer = answer?;
                if let NetlinkPayload::Error(error) = &answer.payload {
                    answered = answer.header.sequence_number;
                    if error.code.is_some() && result.is_ok() {
                        result = Err(error.to_io());
                    }
                }
            }
        }
        result
    }

    /// Sends requests whose errors are ignored. They replace what is there.
    pub(crate) fn replace(&self, requests: Vec<RouteNetlinkMessage>) -> io::Result<()> {
        let mut requests = requests.into_iter().peekable();
        while requests.peek().is_some() {
            let (batch, _) = batch(requests.by_ref().take(MOST_REQUESTS), NLM_F_REPLACE, 0);
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
            was_set_up |= messages(&changes).any(|change| match change.map(|change| change.payload) {
                Ok(NetlinkPayload::InnerMessage(RouteNetlinkMessage::NewLink(link))) => {
                    let LinkHeader { index, flags, change_mask, .. } = link.header;
                    index == interface && (flags & change_mask).contains(LinkFlags::Up)
                }
                Ok(_) => false,
                Err(_) => true,
            });
        }
    }
}

impl AsFd for Netlink {
    fn as_fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the socket is open for as long as this borrow.
        unsafe { BorrowedFd::borrow_raw(self.socket.as_raw_fd()) }
    }
}

/// Writes requests into one message. The last one has more flags. Returns its number, too.
fn batch(requests: impl Iterator<Item = RouteNetlinkMessage>, flags: u16, last_flags: u16) -> (Vec<u8>, u32) {
    let mut requests = requests.zip(1..).peekable();
    let (mut batch, mut last) = (Vec::new(), 0);
    while let Some((request, number)) = requests.next() {
        let mut message = NetlinkMessage::from(request);
        message.header.flags = NLM_F_REQUEST | NLM_F_CREATE | flags;
        message.header.sequence_number = number;
        if requests.peek().is_none() {
            message.header.flags |= last_flags;
            last = number;
        }
        message.finalize();
        let start = batch.len();
        batch.resize(start + message.buffer_len(), 0);
        message.serialize(&mut batch[start..]);
    }
    (batch, last)
}

/// Reads the messages of a datagram.
fn messages(mut rest: &[u8]) -> impl Iterator<Item = io::Result<NetlinkMessage<RouteNetlinkMessage>>> {
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let message = NetlinkMessage::<RouteNetlinkMessage>::deserialize(rest)
            .map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e));
        let length = message.as_ref().map_or(rest.len(), |message| message.header.length as usize);
        rest = rest.get(length.next_multiple_of(4)..).unwrap_or_default();
        Some(message)
    })
}

fn link(index: u32, attributes: Vec<LinkAttribute>) -> LinkMessage {
    let mut link = LinkMessage::default();
    link.header.index = index;
    link.attributes = attributes;
    link
}

/// Sets an interface up.
pub(crate) fn up(index: u32, attributes: Vec<LinkAttribute>) -> RouteNetlinkMessage {
    let mut link = link(index, attributes);
    link.header.flags = LinkFlags::Up;
    link.header.change_mask = LinkFlags::Up;
    RouteNetlinkMessage::SetLink(link)
}

fn veth_pair(name: &str, index: u32, peer: LinkMessage) -> RouteNetlinkMessage {
    RouteNetlinkMessage::NewLink(link(
        index,
        vec![
            LinkAttribute::IfName(name.into()),
            LinkAttribute::LinkInfo(vec![
                LinkInfo::Kind(InfoKind::Veth),
                LinkInfo::Data(InfoData::Veth(InfoVeth::Peer(peer))),
            ]),
        ],
    ))
}

/// Makes a pair of virtual Ethernet interfaces: one here, its peer in another network namespace, both with this
/// index. (Kernels ignore an index that is given for the peer only.)
pub(crate) fn veth(name: &str, peer: &str, index: u32, peer_space: BorrowedFd<'_>) -> RouteNetlinkMessage {
    let peer =
        link(index, vec![LinkAttribute::IfName(peer.into()), LinkAttribute::NetNsFd(peer_space.as_raw_fd())]);
    veth_pair(name, index, peer)
}

/// Makes a pair of virtual Ethernet interfaces here, each with its name and index.
pub(crate) fn veth_here([(name, index), (peer, peer_index)]: [(&str, u32); 2]) -> RouteNetlinkMessage {
    let peer = link(peer_index, vec![LinkAttribute::IfName(peer.into())]);
    veth_pair(name, index, peer)
}

pub(crate) fn bridge(name: &str, index: u32) -> RouteNetlinkMessage {
    let kind = LinkAttribute::LinkInfo(vec![LinkInfo::Kind(InfoKind::Bridge)]);
    RouteNetlinkMessage::NewLink(link(index, vec![LinkAttribute::IfName(name.into()), kind]))
}

/// Makes a bridge that floods multicast packets to all its ports, and an interface one of these, both up and without addresses.
pub(crate) fn bridged(
    interface: u32,
    name: &str,
    index: u32,
    mtu: u32,
    queue: u32,
) -> Vec<RouteNetlinkMessage> {
    let kind = LinkAttribute::LinkInfo(vec![
        LinkInfo::Kind(InfoKind::Bridge),
        LinkInfo::Data(InfoData::Bridge(vec![InfoBridge::MulticastSnooping(false)])),
    ]);
    let name = LinkAttribute::IfName(name.into());
    let mut requests = vec![RouteNetlinkMessage::NewLink(link(index, vec![name, kind]))];
    requests.extend(without_own_address(interface));
    let attributes = vec![in_bridge(index), LinkAttribute::Mtu(mtu), LinkAttribute::TxQueueLen(queue)];
    requests.push(up(interface, attributes));
    requests
}

/// Changes the MAC address of an interface that is down, and gives it no address by itself.
pub(crate) fn at_mac(interface: u32, mac: [u8; 6]) -> Vec<RouteNetlinkMessage> {
    let mac = link(interface, vec![LinkAttribute::Address(mac.to_vec())]);
    without_own_address(interface).into_iter().chain([RouteNetlinkMessage::SetLink(mac)]).collect()
}

/// Keeps the kernel from giving an interface a link-local address. `None` without IPv6.
fn without_own_address(interface: u32) -> Option<RouteNetlinkMessage> {
    let none = AfSpecInet6::AddrGenMode(In6AddrGenMode::None);
    let attributes = vec![LinkAttribute::AfSpecUnspec(vec![AfSpecUnspec::Inet6(vec![none])])];
    has_ipv6().then(|| RouteNetlinkMessage::SetLink(link(interface, attributes)))
}

/// Makes an interface a port of a bridge.
pub(crate) fn in_bridge(bridge: u32) -> LinkAttribute {
    LinkAttribute::Controller(bridge)
}

fn address(index: u32, address: IpAddr, prefix: u8, scope: AddressScope) -> RouteNetlinkMessage {
    let mut message = AddressMessage::default();
    message.header.family = if address.is_ipv4() { AddressFamily::Inet } else { AddressFamily::Inet6 };
    message.header.prefix_len = prefix;
    message.header.index = index;
    message.header.scope = scope;
    // Addresses follow from the graph and are unique. Duplicate address detection would only delay a host by a
    // second.
    message.header.flags = AddressHeaderFlags::Nodad;
    message.attributes = vec![
        AddressAttribute::Local(address),
        AddressAttribute::Address(address),
        AddressAttribute::Flags(AddressFlags::Nodad),
    ];
    if let IpAddr::V4(v4) = address {
        let broadcast = u32::from(v4) | (u32::MAX >> prefix);
        message.attributes.push(AddressAttribute::Broadcast(Ipv4Addr::from(broadcast)));
    }
    RouteNetlinkMessage::NewAddress(message)
}

/// Adds a route to what is reached without a router, also for broadcast or multicast, which the kernel would otherwise not
/// send.
pub(crate) fn route(index: u32, to: Ipv4Addr, prefix: u8) -> RouteNetlinkMessage {
    let mut route = RouteMessage::default();
    route.header.address_family = AddressFamily::Inet;
    route.header.destination_prefix_length = prefix;
    route.header.table = RouteHeader::RT_TABLE_MAIN;
    route.header.protocol = RouteProtocol::Static;
    route.header.scope = RouteScope::Link;
    route.header.kind = RouteType::Unicast;
    route.attributes = vec![RouteAttribute::Destination(RouteAddress::Inet(to)), RouteAttribute::Oif(index)];
    RouteNetlinkMessage::NewRoute(route)
}

/// Tells an interface a neighbour's MAC address for good. The kernel never asks for it, and does not count it against the size
/// of its table.
pub(crate) fn neighbour(index: u32, address: IpAddr, mac: [u8; 6]) -> RouteNetlinkMessage {
    let mut neighbour = NeighbourMessage::default();
    neighbour.header.ifindex = index;
    neighbour.header.state = NeighbourState::Permanent;
    let destination = match address {
        IpAddr::V4(v4) => {
            neighbour.header.family = AddressFamily::Inet;
            NeighbourAddress::Inet(v4)
        }
        IpAddr::V6(v6) => {
            neighbour.header.family = AddressFamily::Inet6;
            NeighbourAddress::Inet6(v6)
        }
    };
    neighbour.attributes = vec![
        NeighbourAttribute::Destination(destination),
        NeighbourAttribute::LinkLayerAddress(mac.to_vec()),
    ];
    RouteNetlinkMessage::NewNeighbour(neighbour)
}

/// Adds the route by which a host receives packets to an address of its own. The kernel adds one, too, but later, on a
/// work queue: it drops packets that arrive before.
fn local_route(index: u32, to: Ipv6Addr) -> RouteNetlinkMessage {
    let mut route = RouteMessage::default();
    route.header.address_family = AddressFamily::Inet6;
    route.header.destination_prefix_length = 128;
    route.header.table = libc::RT_TABLE_LOCAL;
    route.header.protocol = RouteProtocol::Static;
    route.header.kind = RouteType::Local;
    route.attributes = vec![RouteAttribute::Destination(RouteAddress::Inet6(to)), RouteAttribute::Oif(index)];
    RouteNetlinkMessage::NewRoute(route)
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
pub(crate) fn host(interface: u32, of: &HostAddress, mtu: u32, queue: u32) -> Vec<RouteNetlinkMessage> {
    let mut requests = vec![up(LOOPBACK, vec![])];
    // The kernel's own link-local address would be tentative for a second.
    requests.extend(without_own_address(interface));
    requests.push(up(
        interface,
        vec![
            LinkAttribute::Address(of.mac.to_vec()),
            LinkAttribute::Mtu(mtu),
            LinkAttribute::TxQueueLen(queue),
        ],
    ));
    requests
}

/// Returns the requests that give an interface that is up a host's addresses and routes.
pub(crate) fn addresses(interface: u32, of: &HostAddress, has_ipv6: bool) -> Vec<RouteNetlinkMessage> {
    let mut requests = vec![
        address(interface, of.ipv4.into(), HostAddress::IPV4_PREFIX, AddressScope::Universe),
        route(interface, Ipv4Addr::new(224, 0, 0, 0), 4),
        route(interface, Ipv4Addr::BROADCAST, 32),
    ];
    if has_ipv6 {
        let on_link = link_local(of.mac);
        requests.push(address(interface, on_link.into(), 64, AddressScope::Link));
        requests.push(address(interface, of.ipv6.into(), HostAddress::IPV6_PREFIX, AddressScope::Universe));
        requests.extend([on_link, of.ipv6].map(|own| local_route(interface, own)));
    }
    requests
}

/// Puts a NetEm queueing discipline on an interface. `ENOENT` means that the kernel has none.
pub(crate) fn netem(index: u32) -> RouteNetlinkMessage {
    let mut message = TcMessage::default();
    message.header.index = index as i32;
    message.header.parent = TcHandle::ROOT;
    message.header.handle = TcHandle { major: 1, minor: 0 };
    // `struct tc_netem_qopt`: latency, limit, loss, gap, duplicate, jitter. Only the limit must not be zero.
    let mut options = [0u8; 24];
    options[4..8].copy_from_slice(&1000u32.to_ne_bytes());
    message.attributes = vec![
        TcAttribute::Kind("netem".into()),
        TcAttribute::Other(netlink_packet_core::DefaultNla::new(2, options.to_vec())),
    ];
    RouteNetlinkMessage::NewQueueDiscipline(message)
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
            netlink.execute(vec![up(1, vec![]), up(1, vec![])]).unwrap();
            let error = netlink.execute(vec![up(1, vec![]), up(4711, vec![]), up(1, vec![])]).unwrap_err();
            assert_eq!(error.raw_os_error(), Some(libc::ENODEV));
            netlink.execute(vec![]).unwrap();
            netlink.execute(vec![up(1, vec![]); 2 * MOST_REQUESTS + 1]).unwrap();
            for count in [1, MOST_REQUESTS, 3 * MOST_REQUESTS] {
                let error = netlink.execute(vec![up(4711, vec![]); count]).unwrap_err();
                assert_eq!(error.raw_os_error(), Some(libc::ENODEV), "all {count} are rejected");
            }
            netlink.execute(vec![up(1, vec![])]).unwrap();
        });
    }
}
