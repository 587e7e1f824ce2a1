//! Wi-Fi interfaces of this network namespace, as the kernel has them.

use std::{fs, io, path::PathBuf};

use netlink_packet_core::{NLM_F_ACK, NLM_F_REQUEST, NLMSG_ERROR, NetlinkBuffer, parse_i32};
use netlink_sys::{Socket, protocols::NETLINK_ROUTE};
use rustix::net::{AddressFamily, SocketType, netdevice};

use crate::{address::MacAddress, names::InterfaceName};

/// `IFF_UP`.
const UP: u32 = 1;
/// `RTM_NEWLINK`.
const CHANGE_LINK: u16 = 16;
/// Lengths of `struct nlmsghdr` and `struct ifinfomsg`.
const HEADERS: (usize, usize) = (16, 16);

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
    let mut socket = Socket::new(NETLINK_ROUTE)?;
    socket.bind_auto()?;
    // The kernel has answered before the request is sent.
    socket.set_non_blocking(true)?;
    socket.send(&request(index), 0)?;
    let mut answer = Vec::with_capacity(4096);
    socket.recv(&mut answer, 0)?;
    let invalid = |error| io::Error::new(io::ErrorKind::InvalidData, error);
    let answer = NetlinkBuffer::new_checked(&answer).map_err(invalid)?;
    let code = answer.payload().get(..4).map(parse_i32).transpose().map_err(invalid)?;
    match code {
        Some(0) if answer.message_type() == NLMSG_ERROR => Ok(()),
        Some(code) if answer.message_type() == NLMSG_ERROR => {
            Err(io::Error::from_raw_os_error(code.saturating_neg()))
        }
        _ => Err(io::ErrorKind::InvalidData.into()),
    }
}

/// Encodes a request to set an interface up.
fn request(index: u32) -> Vec<u8> {
    let (header, body) = HEADERS;
    let mut bytes = vec![0; header + body];
    let mut message = NetlinkBuffer::new(&mut bytes);
    message.set_length(u32::try_from(header + body).expect("it is short"));
    message.set_message_type(CHANGE_LINK);
    message.set_flags(NLM_F_REQUEST | NLM_F_ACK);
    message.set_sequence_number(1);
    bytes[header + 4..header + 8].copy_from_slice(&index.to_ne_bytes());
    bytes[header + 8..header + 12].copy_from_slice(&UP.to_ne_bytes());
    bytes[header + 12..].copy_from_slice(&UP.to_ne_bytes());
    bytes
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
