//! Wi-Fi interfaces of this network namespace, as the kernel has them.

use std::{fs, io, path::PathBuf};

use cotorra_netlink::{NETLINK_ROUTE, Netlink, rtnetlink};
use rustix::net::{AddressFamily, SocketType, netdevice};

use crate::{address::MacAddress, names::InterfaceName};

/// `IFF_UP`.
const UP: u32 = 1;

/// Whether there is such an interface, with a radio.
pub(crate) fn has_radio(interface: &InterfaceName) -> bool {
    of(interface, "phy80211").exists()
}

/// Returns the address of an interface of this network namespace; `None` if there is no such interface.
pub fn interface_address(interface: &InterfaceName) -> Option<MacAddress> {
    fs::read_to_string(of(interface, "address")).ok()?.trim().parse().ok()
}

/// Whether it is set up.
pub(crate) fn is_up(interface: &InterfaceName) -> bool {
    let flags = fs::read_to_string(of(interface, "flags")).unwrap_or_default();
    let flags = flags.trim().strip_prefix("0x").and_then(|flags| u32::from_str_radix(flags, 16).ok());
    flags.is_some_and(|flags| flags & UP != 0)
}

/// Whether it is part of a network: it serves one, or is associated.
pub(crate) fn has_carrier(interface: &InterfaceName) -> bool {
    fs::read_to_string(of(interface, "carrier")).is_ok_and(|carrier| carrier.trim() == "1")
}

/// Returns the bridge that it is a port of.
pub(crate) fn bridge(interface: &InterfaceName) -> Option<InterfaceName> {
    let bridge = fs::read_link(of(interface, "brport/bridge")).ok()?;
    bridge.file_name()?.to_str()?.parse().ok()
}

fn of(interface: &InterfaceName, file: &str) -> PathBuf {
    PathBuf::from("/sys/class/net").join(interface.as_str()).join(file)
}

/// Returns the file that says whether the kernel forgets its neighbours' addresses when the interface loses its carrier.
pub(crate) fn forgets_neighbours(interface: &InterfaceName) -> PathBuf {
    PathBuf::from("/proc/sys/net/ipv4/conf").join(interface.as_str()).join("arp_evict_nocarrier")
}

/// Sets an interface up (rtnetlink).
///
/// # Errors
/// The error of the system.
pub(crate) fn set_up(interface: &InterfaceName) -> io::Result<()> {
    let socket = rustix::net::socket(AddressFamily::INET, SocketType::DGRAM, None)?;
    let index = netdevice::name_to_index(socket, interface.as_str())?;
    let request = rtnetlink::link_up(index).finish();
    Netlink::new(NETLINK_ROUTE).execute(rtnetlink::NEW_LINK, 0, &request).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loopback_interface_has_no_radio() {
        let loopback: InterfaceName = "lo".parse().expect("a name");
        assert!(!has_radio(&loopback));
        assert_eq!(bridge(&loopback), None);
        assert_eq!(interface_address(&loopback), Some(MacAddress([0; 6])));
        assert_eq!(interface_address(&"missing0".parse().expect("a name")), None);
    }

    #[test]
    fn missing_interfaces_are_reported() {
        let error = set_up(&"missing0".parse().expect("a name")).expect_err("there is none");
        assert_eq!(error.raw_os_error(), Some(rustix::io::Errno::NODEV.raw_os_error()));
    }
}
