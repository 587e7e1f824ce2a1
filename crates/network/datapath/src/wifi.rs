//! Simulated radios of Linux for the robots and radio units of networks with real Wi-Fi software
//! ([`RadioKind::Hwsim`]).
//!
//! A robot's addresses are on its [`WLAN`]. A radio unit's are on its [`BRIDGE`], which joins its port of the fabric with its
//! [`WLAN`], once hostapd adds that. All have the MAC addresses of [`HostAddress`], which are the radio units' BSSIDs, too.
//! The software is for the caller to start, in the nodes' namespaces.

use std::{
    hash::{BuildHasher as _, RandomState},
    io,
    os::fd::{AsFd, BorrowedFd},
};

use cotorra_fabric::Fabric;
use cotorra_graph::{Dbm, HardwareGraph, HostAddress, Node, NodeKind, RadioKind, Timestamp};
use cotorra_hwsim::{Error as HwsimError, Exchange, MacAddress, MediumSocket, Phys, Radio, Radios};

use crate::{
    error::{Action, Error},
    hosts::{self, Addresses},
    namespace::Namespace,
    neighbours::Neighbours,
    netlink::{self, Netlink},
    shared::Shared,
    sys,
};

pub use crate::hosts::{BRIDGE, WLAN};

/// Checks that this kernel and this user can have simulated radios, if the graph needs any.
///
/// # Errors
/// [`Error::Wifi`], or [`Error::Kernel`] without the right to make a network namespace.
pub fn check(graph: &HardwareGraph) -> Result<(), Error> {
    Air::register(graph).map(drop)
}

/// The medium of the simulated radios.
///
/// It is registered in a network namespace of its own: an ordinary user may do so, and other media, such as those of other runs,
/// have theirs.
pub(crate) struct Air {
    namespace: Namespace,
    exchange: Exchange,
    /// The radios go with this.
    radios: Radios,
    /// Begin of the radios' hardware addresses.
    prefix: [u8; 4],
}

impl Air {
    /// Becomes the medium of the graph's simulated radios; `None` if it has none.
    pub(crate) fn register(graph: &HardwareGraph) -> Result<Option<Self>, Error> {
        if graph.nodes_with(RadioKind::Hwsim).next().is_none() {
            return Ok(None);
        }
        let namespace = Namespace::new()?;
        let exchange = Exchange::new(namespace.run(MediumSocket::register)?);
        // The kernel keeps the radios of all network namespaces in one table by these addresses, and does not compare them. Those
        // of interfaces may be the same in several runs.
        let [a, b, c, ..] = RandomState::new().hash_one(0_u8).to_ne_bytes();
        Ok(Some(Self { namespace, exchange, radios: Radios::new(), prefix: [0x06, a, b, c] }))
    }

    /// Gives a robot or a radio unit its radio.
    pub(crate) fn equip(
        &mut self,
        fabric: &mut Fabric,
        (place, node): (usize, &Node),
        host: &Namespace,
        neighbours: &Neighbours,
    ) -> Result<(), Error> {
        let [high, low] = (place as u16).to_be_bytes();
        let [a, b, c, d] = self.prefix;
        let hardware = MacAddress([a, b, c, d, high, low]);
        self.exchange.join(Timestamp::ZERO, fabric, &node.id, hardware)?;
        let radio = Radio {
            permanent_address: Some(hardware),
            channels: Some(1),
            no_interface: true,
            ends_with_socket: true,
            ..Radio::default()
        };
        let radios = &mut self.radios;
        let phy = self.namespace.run(|| {
            let phy = radios.create(&radio).and_then(|id| radios.name(id))?;
            Phys::new().move_to(&phy, host)?;
            Ok::<_, HwsimError>(phy)
        })?;
        host.run(|| {
            let mut phys = Phys::new();
            phys.add_station(&phy, WLAN)?;
            // The kernel has no powers below 0 dBm. It only shows what is set here.
            phys.set_power(&phy, power(node).0.max(0.0))?;
            let netlink = Netlink::open().action("open a netlink socket")?;
            match addresses(node) {
                Addresses::Elsewhere => {
                    keep_neighbours();
                    hosts::configure(&netlink, WLAN, place, neighbours)
                }
                _ => {
                    let wlan = sys::interface_index(WLAN).action("find a radio unit's interface")?;
                    let requests = netlink::at_mac(wlan, HostAddress::of(place).mac);
                    netlink.execute(requests).action("set the address of a radio unit's interface")
                }
            }
        })
    }

    /// Hands the kernel's messages to the fabric.
    pub(crate) fn receive(&mut self, now: Timestamp, fabric: &mut Fabric, shared: &Shared) -> io::Result<()> {
        self.exchange.receive(now, fabric).map(|lost| shared.count_drops(lost))
    }

    /// Records that the kernel has sent nothing since the last delivery.
    pub(crate) fn nothing_waits(&mut self) {
        self.exchange.nothing_waits();
    }

    /// Sends the kernel what the fabric reports.
    pub(crate) fn deliver(&mut self, now: Timestamp, fabric: &mut Fabric, shared: &Shared) -> io::Result<()> {
        self.exchange.deliver(now, fabric).map(|lost| shared.count_drops(lost))
    }
}

impl AsFd for Air {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.exchange.as_fd()
    }
}

/// Returns which interface of a node with a simulated radio has its addresses.
pub(crate) fn addresses(node: &Node) -> Addresses {
    match node.kind {
        NodeKind::RadioUnit(_) => Addresses::AtBridge,
        _ => Addresses::Elsewhere,
    }
}

fn power(node: &Node) -> Dbm {
    match &node.kind {
        NodeKind::RadioUnit(unit) => unit.tx_power,
        NodeKind::Robot(robot) => robot.tx_power,
        _ => Dbm(0.0),
    }
}

/// Keeps the neighbours that a robot knows when its radio has no carrier, as between two radio units. Linux forgets them by
/// default, and asks for them again at most once a second. Kernels before 5.16 cannot.
fn keep_neighbours() {
    let _ = hosts::set(4, WLAN, "arp_evict_nocarrier", "0");
    let _ = hosts::set(6, WLAN, "ndisc_evict_nocarrier", "0");
}
