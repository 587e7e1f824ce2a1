//! Brings hosts up: a namespace and an interface `eth0` each, on as many threads as there are cores, with one netlink
//! message a host.

use std::{
    fs::{self, File, OpenOptions},
    io,
    net::{Ipv4Addr, UdpSocket},
    os::{
        fd::{AsFd, OwnedFd},
        unix::fs::OpenOptionsExt,
    },
    thread,
};

use cotorra_graph::HostAddress;

use crate::{
    error::{Action, Error},
    namespace::{Namespace, on_a_thread},
    netlink::{self, Netlink},
    sys,
};

/// Largest payload of a frame.
const MTU: u32 = 1500;
/// Frames between the kernel and the fabric's thread: a TAP drops what comes on top, without telling the sender.
const QUEUE: u32 = 4096;
/// Bytes between the kernel and the fabric's thread at a packet socket.
const SOCKET_BUFFER: i32 = 32 << 20;
const TUN: &str = "/dev/net/tun";

/// Which kind of port hosts have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PortKind {
    /// TAPs where `/dev/net/tun` can be opened, else packet sockets.
    #[default]
    Auto,
    /// A TAP in the host's namespace.
    Tap,
    /// A virtual Ethernet pair with a packet socket at its other end.
    PacketSocket,
}

/// A host that is up.
pub(crate) struct Host {
    pub(crate) namespace: Namespace,
    pub(crate) port: OwnedFd,
}

/// Which kind of port it will be.
pub(crate) fn resolve(kind: PortKind) -> PortKind {
    match kind {
        PortKind::Auto if open_tun().is_ok() => PortKind::Tap,
        PortKind::Auto => PortKind::PacketSocket,
        chosen => chosen,
    }
}

/// Brings up that many hosts, with the addresses that follow from their places.
pub(crate) fn bring_up(count: usize, kind: PortKind) -> Result<Vec<Host>, Error> {
    // Where the other ends of virtual Ethernet pairs are; nobody else sees them.
    let wiring = match kind {
        PortKind::PacketSocket => Some(Namespace::new()?),
        _ => None,
    };
    let host = |place: usize| match &wiring {
        Some(wiring) => packet_socket_host(place, wiring),
        None => tap_host(place),
    };
    let workers = thread::available_parallelism().map_or(1, |cores| cores.get().min(8));
    let share = count.div_ceil(workers).max(1);
    thread::scope(|scope| {
        let shares: Vec<_> = (0..count)
            .step_by(share)
            .map(|from| {
                let host = &host;
                scope.spawn(move || (from..count.min(from + share)).map(host).collect::<Result<Vec<_>, _>>())
            })
            .collect();
        let mut hosts = Vec::with_capacity(count);
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

/// Gives `eth0` of the calling thread's namespace its addresses.
pub(crate) fn configure(netlink: &Netlink, place: usize) -> Result<(), Error> {
    let eth0 = sys::interface_index(c"eth0").action("find a host's interface")?;
    // There is no router in the fabric to ask for; without IPv6 there is no such file.
    let _ = fs::write("/proc/sys/net/ipv6/conf/eth0/router_solicitations", "0");
    netlink
        .execute(netlink::host(eth0, &HostAddress::of(place), MTU, QUEUE))
        .action("configure a host's interface")
}

fn tap_host(place: usize) -> Result<Host, Error> {
    let namespace = enter_new_namespace()?;
    let device = open_tun().action("open /dev/net/tun")?;
    sys::make_tap(&device, c"eth0").action("make a TAP with offloads")?;
    configure(&Netlink::open().action("open a netlink socket")?, place)?;
    Ok(Host { namespace, port: device.into() })
}

/// What the header in front of each frame can tell: a packet socket loses frames with anything else left to the
/// network card (tunnels, VLAN tags, SCTP's checksum). A TAP restricts itself.
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

/// The kernel's version; 0.0 if it hides it.
fn kernel() -> (u32, u32) {
    let release = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let mut numbers = release.split(|c: char| !c.is_ascii_digit()).map(|n| n.parse().unwrap_or(0));
    (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0))
}

fn packet_socket_host(place: usize, wiring: &Namespace) -> Result<Host, Error> {
    // The loopback interface has index 1, kernels with tunnels built in give the next few.
    let index = 100 + place as u32;
    let namespace = enter_new_namespace()?;
    let inside = Netlink::open().action("open a netlink socket")?;
    inside
        .execute(vec![netlink::veth("eth0", &format!("p{place}"), index, wiring.as_fd())])
        .action("make a virtual Ethernet pair")?;
    // With its other end up first, the host's has a carrier from the beginning.
    let port = on_a_thread(|| {
        wiring.enter().action("enter the wiring's namespace")?;
        let outside = Netlink::open().action("open a netlink socket")?;
        outside.execute(vec![netlink::up(index, vec![])]).action("set a port up")?;
        sys::packet_socket(index, SOCKET_BUFFER).action("open a packet socket")
    })?;
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).action("open a socket in a namespace")?;
    sys::restrict_offloads(socket.as_fd(), c"eth0", &offloads())
        .action("restrict the offloads of a virtual Ethernet pair")?;
    configure(&inside, place)?;
    Ok(Host { namespace, port })
}
