//! Gateways: ports of the fabric on interfaces that cotorra did not make, by which real machines reach hosts and are
//! reached. A real server is a gateway with one machine. Several can share an interface: each has a socket of its own, which
//! receives frames from its machine only.
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
    collections::HashMap,
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

use cotorra_graph::{HardwareGraph, HostAddress, NodeId, RealPort};
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
    _claim: Arc<Claim>,
}

/// A socket whose name shows other runs that an interface is taken. It ends with the process.
type Claim = UnixDatagram;

/// The traffic of a gateway or a real server so far.
#[derive(Debug, Clone, PartialEq)]
pub struct GatewayTraffic {
    pub gateway: NodeId,
    pub passed: Passed,
}

/// Checks whether the interfaces of a graph's gateways and real servers could be opened now, without changing anything.
/// `allowed` are interfaces that may carry the default route.
///
/// # Errors
/// [`Error::Gateway`].
pub fn check_gateways(graph: &HardwareGraph, allowed: &[String]) -> Result<(), Error> {
    for port in graph.real_ports() {
        in_namespace(port.netns, || {
            let interface = inspect(port.interface, allowed)?;
            unbound_socket(port.interface)?;
            claim(port.interface, interface.index).map(drop)
        })
        .map_err(|source| Error::Gateway { gateway: port.node.id.clone(), source })?;
    }
    Ok(())
}

/// Returns the addresses of all real machines: those behind gateways, and real servers.
pub(crate) fn machines(graph: &HardwareGraph) -> Vec<Ipv4Addr> {
    graph.real_ports().flat_map(|port| port.machines).collect()
}

/// Opens the gateways and real servers of a graph, and returns their ports by name, too.
///
/// # Errors
/// [`Error::Gateway`].
pub(crate) fn open(
    graph: &HardwareGraph,
    allowed: &[String],
) -> Result<(Vec<Opened>, HashMap<NodeId, Port>), Error> {
    let hosts = graph.hosts().count();
    let mut claims = HashMap::new();
    let opened = graph.real_ports().map(|port| {
        let id = port.node.id.clone();
        match open_port(&port, hosts, allowed, &mut claims) {
            Ok((opened, port)) => Ok((opened, (id, port))),
            Err(source) => Err(Error::Gateway { gateway: id, source }),
        }
    });
    opened.collect::<Result<Vec<_>, _>>().map(|opened| opened.into_iter().unzip())
}

/// Opens one, with the claims of the interfaces so far.
fn open_port<'a>(
    &RealPort { node, interface: name, netns, ref machines }: &RealPort<'a>,
    hosts: usize,
    allowed: &[String],
    claims: &mut HashMap<(Option<&'a str>, &'a str), Arc<Claim>>,
) -> Result<(Opened, Port), GatewayError> {
    let refused = |source| GatewayError::Socket { interface: name.to_owned(), source };
    let claimed = claims.get(&(netns, name));
    let (socket, claim) = in_namespace(netns, || {
        let interface = inspect(name, allowed)?;
        let socket = unbound_socket(name)?;
        let claim =
            claimed.map_or_else(|| claim(name, interface.index).map(Arc::new), |it| Ok(Arc::clone(it)))?;
        let addresses = (0..hosts).map(|place| HostAddress::of(place).mac);
        // From now on it receives frames from these machines to hosts.
        sys::bind_filtered(&socket, interface.index, &filter::filter(machines), addresses)
            .map_err(refused)?;
        Ok((socket, claim))
    })?;
    claims.insert((netns, name), Arc::clone(&claim));
    let gate = match node.real_server() {
        Some(real) => Gate::of_server(hosts, real.address),
        None => Gate::new(hosts, machines.iter().copied()),
    };
    let gate = Arc::new(Mutex::new(gate));
    let port = Port::of_gateway(socket.try_clone().map_err(refused)?, Arc::clone(&gate));
    Ok((Opened { id: node.id.clone(), gate, socket, _claim: claim }, port))
}

impl Opened {
    pub(crate) fn traffic(&self) -> GatewayTraffic {
        let mut gate = self.gate.lock();
        // Reading the counter resets it. It cannot fail on an open packet socket.
        gate.lost(sys::overflows(self.socket.as_fd()).unwrap_or(0));
        GatewayTraffic { gateway: self.id.clone(), passed: gate.passed() }
    }
}

/// Runs a closure in the network namespace of that name or path, if there is one.
fn in_namespace<T: Send>(
    netns: Option<&str>,
    inside: impl FnOnce() -> Result<T, GatewayError> + Send,
) -> Result<T, GatewayError> {
    let Some(netns) = netns else { return inside() };
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

/// Opens a packet socket in the calling thread's namespace.
fn unbound_socket(name: &str) -> Result<OwnedFd, GatewayError> {
    sys::unbound_packet_socket(SOCKET_BUFFER)
        .map_err(|source| GatewayError::Socket { interface: name.to_owned(), source })
}

/// Claims an interface for this run.
fn claim(name: &str, index: u32) -> Result<Claim, GatewayError> {
    // Abstract names belong to a network namespace, as interfaces do.
    let claim = SocketAddr::from_abstract_name(format!("cotorra-gateway-{index}"));
    claim.and_then(|address| UnixDatagram::bind_addr(&address)).map_err(|error| match error.kind() {
        io::ErrorKind::AddrInUse => GatewayError::Held(name.to_owned()),
        _ => GatewayError::Socket { interface: name.to_owned(), source: error },
    })
}
