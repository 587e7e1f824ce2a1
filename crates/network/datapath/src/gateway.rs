//! Gateways: ports of the fabric on interfaces that cotorra did not make, by which real machines reach hosts and are
//! reached.
//!
//! A gateway passes Ethernet frames on as they are, so that a real machine is on the same link as all hosts: they find each
//! other by ARP, and multicast discovery works. The machine keeps its address. Hosts have a route to it, and it needs one
//! route to them. No machine is changed otherwise, and nothing translates addresses.
//!
//! The socket takes copies of frames to hosts' own MAC addresses. The interface's other traffic and this machine's IP stack
//! are left alone: the stack ignores frames to other addresses. All that changes on the interface, its list of addresses to
//! receive, belongs to the socket, and goes with it however the process ends.

pub(crate) mod error;
mod filter;
pub(crate) mod gate;

use std::{
    ffi::CString,
    fs::File,
    io,
    net::{Ipv4Addr, UdpSocket},
    os::{
        fd::{AsFd, OwnedFd},
        linux::net::SocketAddrExt,
        unix::net::{SocketAddr, UnixDatagram},
    },
    path::Path,
    sync::Arc,
};

use cotorra_graph::{Gateway, HardwareGraph, HostAddress, NodeId};
use cotorra_netem::Kernel;
use parking_lot::Mutex;

use crate::{
    error::Error,
    hosts::{MTU, SOCKET_BUFFER},
    namespace::on_a_thread,
    port::Port,
    sys,
};
use error::GatewayError;
use gate::{Gate, Passed};

/// An open gateway.
pub(crate) struct Opened {
    id: NodeId,
    gate: Arc<Mutex<Gate>>,
    socket: OwnedFd,
    _claim: UnixDatagram,
}

/// The traffic of a gateway so far.
#[derive(Debug, Clone, PartialEq)]
pub struct GatewayTraffic {
    pub gateway: NodeId,
    pub passed: Passed,
}

/// Checks whether a graph's gateways could be opened now, without changing anything. `allowed` are interfaces that may carry
/// the default route.
///
/// # Errors
/// [`Error::Gateway`].
pub fn check_gateways(graph: &HardwareGraph, allowed: &[String]) -> Result<(), Error> {
    for (node, gateway) in graph.gateways() {
        in_namespace(gateway, || Unbound::new(&gateway.interface, allowed).map(drop))
            .map_err(|source| Error::Gateway { gateway: node.id.clone(), source })?;
    }
    Ok(())
}

/// Returns the addresses of all machines behind gateways.
pub(crate) fn machines(graph: &HardwareGraph) -> Vec<Ipv4Addr> {
    graph.gateways().flat_map(|(_, gateway)| gateway.machines.values().copied()).collect()
}

/// Opens the gateways of a graph and their ports, in order.
///
/// # Errors
/// [`Error::Gateway`].
pub(crate) fn open(graph: &HardwareGraph, allowed: &[String]) -> Result<(Vec<Opened>, Vec<Port>), Error> {
    let hosts = graph.hosts().count();
    let open = |id: &NodeId, gateway: &Gateway| {
        let machines: Vec<_> = gateway.machines.values().copied().collect();
        let name = &gateway.interface;
        let refused = |source| GatewayError::Socket { interface: name.clone(), source };
        let Unbound { socket, claim, .. } = in_namespace(gateway, || {
            let socket = Unbound::new(name, allowed)?;
            socket.bind(&machines, hosts).map_err(refused)?;
            Ok(socket)
        })?;
        let gate = Arc::new(Mutex::new(Gate::new(hosts, machines)));
        let port = Port::of_gateway(socket.try_clone().map_err(refused)?, Arc::clone(&gate));
        Ok((Opened { id: id.clone(), gate, socket, _claim: claim }, port))
    };
    let opened = graph.gateways().map(|(node, gateway)| {
        open(&node.id, gateway).map_err(|source| Error::Gateway { gateway: node.id.clone(), source })
    });
    opened.collect::<Result<Vec<_>, _>>().map(|opened| opened.into_iter().unzip())
}

impl Opened {
    pub(crate) fn traffic(&self) -> GatewayTraffic {
        let mut gate = self.gate.lock();
        // Reading the counter resets it. It cannot fail on an open packet socket.
        gate.lost(sys::overflows(self.socket.as_fd()).unwrap_or(0));
        GatewayTraffic { gateway: self.id.clone(), passed: gate.passed() }
    }
}

/// Runs a closure in the namespace of a gateway's interface.
fn in_namespace<T: Send>(
    gateway: &Gateway,
    inside: impl FnOnce() -> Result<T, GatewayError> + Send,
) -> Result<T, GatewayError> {
    let Some(netns) = &gateway.netns else { return inside() };
    // An absolute path replaces the folder.
    let path = Path::new("/run/netns").join(netns);
    on_a_thread(|| {
        let enter = || sys::setns(File::open(&path)?.as_fd(), libc::CLONE_NEWNET);
        enter().map_err(|source| GatewayError::Namespace { path: path.clone(), source })?;
        inside()
    })
}

/// Returns the interface if it can be a gateway's.
fn inspect(name: &str, allowed: &[String]) -> Result<sys::Interface, GatewayError> {
    let refused = |source| GatewayError::Socket { interface: name.to_owned(), source };
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).map_err(refused)?;
    let c_name = CString::new(name).map_err(|error| refused(error.into()))?;
    let interface = sys::interface(socket.as_fd(), &c_name).map_err(|error| match error.raw_os_error() {
        Some(libc::ENODEV) => GatewayError::Missing(name.to_owned()),
        _ => refused(error),
    })?;
    if !interface.is_ethernet {
        return Err(GatewayError::NotEthernet(name.to_owned()));
    }
    if !interface.is_up {
        return Err(GatewayError::Down(name.to_owned()));
    }
    if interface.mtu < MTU {
        return Err(GatewayError::ShortFrames {
            interface: name.to_owned(),
            mtu: interface.mtu,
            needed: MTU,
        });
    }
    if !allowed.iter().any(|allowed| allowed == name)
        && Kernel::open()?.default_routes()?.contains(&interface.index)
    {
        return Err(GatewayError::DefaultRoute(name.to_owned()));
    }
    Ok(interface)
}

/// A gateway's socket that is not bound to its interface yet.
struct Unbound {
    interface: sys::Interface,
    /// A socket whose name shows other runs that the interface is taken. It ends with the process.
    claim: UnixDatagram,
    socket: OwnedFd,
}

impl Unbound {
    /// Opens the socket in the calling thread's namespace.
    fn new(name: &str, allowed: &[String]) -> Result<Self, GatewayError> {
        let interface = inspect(name, allowed)?;
        let refused = |source| GatewayError::Socket { interface: name.to_owned(), source };
        let socket = sys::unbound_packet_socket(SOCKET_BUFFER).map_err(refused)?;
        // Abstract names belong to a network namespace, as interfaces do.
        let claim = SocketAddr::from_abstract_name(format!("cotorra-gateway-{}", interface.index));
        let claim = claim.and_then(|address| UnixDatagram::bind_addr(&address));
        let claim = claim.map_err(|error| match error.kind() {
            io::ErrorKind::AddrInUse => GatewayError::Held(name.to_owned()),
            _ => refused(error),
        })?;
        Ok(Self { interface, claim, socket })
    }

    /// Binds the socket, so that it receives frames from these machines to hosts.
    fn bind(&self, machines: &[Ipv4Addr], hosts: usize) -> io::Result<()> {
        let addresses = (0..hosts).map(|place| HostAddress::of(place).mac);
        sys::bind_filtered(&self.socket, self.interface.index, &filter::filter(machines), addresses)
    }
}
