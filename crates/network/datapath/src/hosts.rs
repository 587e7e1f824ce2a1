//! Brings hosts up: a namespace with an interface `eth0` each, on as many threads as there are cores, with few
//! netlink messages per host.

use std::{
    fs::{self, File, OpenOptions},
    io,
    net::{Ipv4Addr, UdpSocket},
    os::{
        fd::{AsFd, BorrowedFd, OwnedFd},
        unix::fs::OpenOptionsExt,
    },
    thread,
};

use cotorra_graph::HostAddress;

use crate::{
    error::{Action, Error},
    namespace::{Namespace, on_a_thread},
    neighbours::Neighbours,
    netlink::{self, Netlink, Request},
    sys,
};

/// The interface of a node's radio.
pub const WLAN: &str = "wlan0";

/// The bridge of a radio unit.
pub const BRIDGE: &str = "br0";

/// Largest payload of a frame, bytes.
pub(crate) const MTU: u32 = 1500;
/// Frames queued between the kernel and the fabric's thread. A TAP drops the excess without telling the sender.
const QUEUE: u32 = 4096;
/// Bytes buffered between the kernel and the fabric's thread at a packet socket.
pub(crate) const SOCKET_BUFFER: i32 = 32 << 20;
const TUN: &str = "/dev/net/tun";
/// The interface of a host's port.
pub(crate) const PORT: &str = "eth0";
/// Index of a radio unit's bridge. The loopback interface has 1, and kernels with built-in tunnels use the next few.
const BRIDGE_INDEX: u32 = 90;

/// Kind of port that connects a host to the fabric.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PortKind {
    /// TAPs if `/dev/net/tun` can be opened, else packet sockets.
    #[default]
    Auto,
    /// A TAP in the host's namespace.
    Tap,
    /// A virtual Ethernet pair with a packet socket at its other end.
    PacketSocket,
}

/// The interface that has a host's addresses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Addresses {
    /// `eth0`, its port.
    AtPort,
    /// A bridge, which `eth0` is a port of.
    AtBridge,
    /// Another one, which is made later. `eth0` stays down.
    Elsewhere,
}

/// A host that is up.
pub(crate) struct Host {
    pub(crate) namespace: Namespace,
    pub(crate) port: OwnedFd,
}

/// Resolves [`PortKind::Auto`].
pub(crate) fn resolve(kind: PortKind) -> PortKind {
    match kind {
        PortKind::Auto if open_tun().is_ok() => PortKind::Tap,
        PortKind::Auto => PortKind::PacketSocket,
        chosen => chosen,
    }
}

/// Brings up the hosts at these places, with the addresses that follow from them. They reach their neighbours without a router.
pub(crate) fn bring_up(
    places: &[(usize, Addresses)],
    kind: PortKind,
    neighbours: &Neighbours,
) -> Result<Vec<Host>, Error> {
    // Namespace of the virtual Ethernet pairs' other ends, invisible to others.
    let wiring = match kind {
        PortKind::PacketSocket => Some(Namespace::new()?),
        _ => None,
    };
    let host = |place: usize, addresses: Addresses| match &wiring {
        Some(wiring) => packet_socket_host(place, addresses, wiring, neighbours),
        None => tap_host(place, addresses, neighbours),
    };
    let workers = thread::available_parallelism().map_or(1, |cores| cores.get().min(8));
    let share = places.len().div_ceil(workers).max(1);
    thread::scope(|scope| {
        let shares: Vec<_> = places
            .chunks(share)
            .map(|places| {
                let host = &host;
                scope.spawn(move || {
                    let hosts = places.iter().map(|(place, addresses)| host(*place, *addresses));
                    hosts.collect::<Result<Vec<_>, _>>()
                })
            })
            .collect();
        let mut hosts = Vec::with_capacity(places.len());
        for share in shares {
            hosts.extend(share.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?);
        }
        Ok(hosts)
    })
}

fn open_tun() -> io::Result<File> {
    OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK).open(TUN)
}

/// Leaves the calling thread in the host's namespace.
fn enter_new_namespace() -> Result<Namespace, Error> {
    Namespace::enter_new().action("make a network namespace")
}

/// Configures the interfaces of a host in the calling thread's namespace.
fn configure_all(
    netlink: &Netlink,
    place: usize,
    addresses: Addresses,
    neighbours: &Neighbours,
) -> Result<(), Error> {
    match addresses {
        Addresses::AtPort => configure(netlink, PORT, place, neighbours),
        Addresses::AtBridge => {
            let port = sys::interface_index(PORT).action("find a host's interface")?;
            let requests = netlink::bridged(port, BRIDGE, BRIDGE_INDEX, MTU, QUEUE);
            netlink.execute(requests).action("make a radio unit's bridge")?;
            configure(netlink, BRIDGE, place, neighbours)
        }
        Addresses::Elsewhere => Ok(()),
    }
}

/// Configures a host's addresses at an interface in the calling thread's namespace, and whom it reaches there.
pub(crate) fn configure(
    netlink: &Netlink,
    interface: &str,
    place: usize,
    neighbours: &Neighbours,
) -> Result<(), Error> {
    let index = sys::interface_index(interface).action("find a host's interface")?;
    // The fabric has no router to solicit. Without IPv6 this file does not exist.
    let _ = set(6, interface, "router_solicitations", "0");
    let mut requests = netlink::host(index, &HostAddress::of(place), MTU, QUEUE);
    let has_ipv6 = netlink::has_ipv6();
    requests.extend(reach(index, place, neighbours, has_ipv6));
    netlink.execute(requests).action("configure a host's interface")?;
    if let Err(error) = netlink.execute(neighbours.entries(index, place, has_ipv6)) {
        neighbours.refuse(error);
    }
    Ok(())
}

/// Returns the requests by which a host has its addresses at an interface that is up, and reaches machines from there.
fn reach(interface: u32, place: usize, neighbours: &Neighbours, has_ipv6: bool) -> Vec<Request> {
    let mut requests = netlink::addresses(interface, &HostAddress::of(place), has_ipv6);
    let far = neighbours.machines().iter().filter(|address| !HostAddress::is_near(**address));
    requests.extend(far.map(|address| netlink::route(interface, *address, 32)));
    requests
}

/// A host's interface with its addresses. A program that sets it down and up again, as some do to configure it, loses most of
/// what [`configure`] did there.
pub(crate) struct Watched {
    netlink: Netlink,
    interface: u32,
    place: usize,
    has_ipv6: bool,
}

impl Watched {
    /// Watches an interface of a host.
    pub(crate) fn new(host: &Namespace, interface: Addresses, place: usize) -> Result<Self, Error> {
        let name = match interface {
            Addresses::AtPort => PORT,
            Addresses::AtBridge => BRIDGE,
            Addresses::Elsewhere => WLAN,
        };
        let watch = || {
            let interface = sys::interface_index(name)?;
            let netlink = Netlink::of_changes()?;
            Ok(Self { netlink, interface, place, has_ipv6: netlink::has_ipv6() })
        };
        host.run(watch).action("watch a host's interface")
    }

    /// Configures it again if it was set up since the last call.
    pub(crate) fn restore(&self, neighbours: &Neighbours) {
        if self.netlink.was_set_up(self.interface) {
            let Self { interface, place, has_ipv6, .. } = *self;
            let mut requests = reach(interface, place, neighbours, has_ipv6);
            requests.extend(neighbours.entries(interface, place, has_ipv6));
            if let Err(error) = self.netlink.replace(requests) {
                tracing::warn!(
                    "the addresses of a node whose interface was set up again are not complete: {error}"
                );
            }
        }
    }
}

impl AsFd for Watched {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.netlink.as_fd()
    }
}

/// Sets a parameter of an interface for IPv4 or IPv6.
pub(crate) fn set(version: u8, interface: &str, parameter: &str, value: &str) -> io::Result<()> {
    fs::write(format!("/proc/sys/net/ipv{version}/conf/{interface}/{parameter}"), value)
}

fn tap_host(place: usize, addresses: Addresses, neighbours: &Neighbours) -> Result<Host, Error> {
    let namespace = enter_new_namespace()?;
    let device = open_tun().action("open /dev/net/tun")?;
    sys::make_tap(&device, c"eth0").action("make a TAP with offloads")?;
    configure_all(&Netlink::open().action("open a netlink socket")?, place, addresses, neighbours)?;
    Ok(Host { namespace, port: device.into() })
}

/// Lists the offloads that a frame's virtio header can describe. A packet socket loses frames with other offloads,
/// such as tunnels, VLAN tags and SCTP checksums. A TAP restricts itself.
fn offloads() -> Vec<&'static str> {
    let mut offloads = vec![
        "tx-scatter-gather",
        "tx-scatter-gather-fraglist",
        "tx-checksum-ip-generic",
        "tx-generic-segmentation",
        "tx-tcp-segmentation",
        "tx-tcp-ecn-segmentation",
        "tx-tcp6-segmentation",
        "tx-nocache-copy",
    ];
    if kernel() >= (6, 2) {
        offloads.push("tx-udp-segmentation");
    }
    offloads
}

/// Returns the kernel's version; 0.0 if it is hidden.
fn kernel() -> (u32, u32) {
    let release = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let mut numbers = release.split(|c: char| !c.is_ascii_digit()).map(|n| n.parse().unwrap_or(0));
    (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0))
}

fn packet_socket_host(
    place: usize,
    addresses: Addresses,
    wiring: &Namespace,
    neighbours: &Neighbours,
) -> Result<Host, Error> {
    // The loopback interface has index 1, and kernels with built-in tunnels use the next few.
    let index = 100 + place as u32;
    let namespace = enter_new_namespace()?;
    let inside = Netlink::open().action("open a netlink socket")?;
    inside
        .execute(vec![netlink::veth("eth0", &format!("p{place}"), index, wiring.as_fd())])
        .action("make a virtual Ethernet pair")?;
    // Set the other end up first, so that the host's end has a carrier from the start.
    let port = on_a_thread(|| {
        wiring.enter().action("enter the wiring's namespace")?;
        let outside = Netlink::open().action("open a netlink socket")?;
        outside.execute(vec![netlink::up(index)]).action("set a port up")?;
        sys::packet_socket(index, SOCKET_BUFFER).action("open a packet socket")
    })?;
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).action("open a socket in a namespace")?;
    sys::restrict_offloads(socket.as_fd(), c"eth0", &offloads())
        .action("restrict the offloads of a virtual Ethernet pair")?;
    configure_all(&inside, place, addresses, neighbours)?;
    Ok(Host { namespace, port })
}
