//! Network interfaces, as rtnetlink reports them (linux/rtnetlink.h, linux/if_link.h).

use cotorra_graph::{InterfaceContext, InterfaceTraffic};
use cotorra_netlink::{DecodeError, attributes, parse_u32, parse_u64, text};

/// `RTM_GETLINK`.
pub(crate) const GET_LINK: u16 = 18;
/// Length of `struct ifinfomsg`: family, type, index, flags and changes. All zero, it selects all interfaces.
pub(crate) const HEADER: usize = 16;

/// `IFLA_IFNAME`.
const NAME: u16 = 3;
/// `IFLA_MTU`.
const MTU: u16 = 4;
/// `IFLA_STATS64`, a `struct rtnl_link_stats64`.
const STATISTICS: u16 = 23;
/// `IFF_UP`.
const UP: u32 = 1;
/// `IFF_LOWER_UP`.
const CARRIER: u32 = 1 << 16;

/// An interface without what needs another source: its speed and its rates.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Link {
    pub(crate) index: u32,
    pub(crate) interface: InterfaceContext,
}

/// Decodes the body of an `RTM_NEWLINK`.
pub(crate) fn decode(body: &[u8]) -> Result<Option<Link>, DecodeError> {
    let Some((header, rest)) = body.split_at_checked(HEADER) else {
        return Err(DecodeError("an interface is too short"));
    };
    let flags = parse_u32(&header[8..12])?;
    let mut interface = InterfaceContext {
        name: String::new(),
        up: flags & UP != 0,
        carrier: flags & CARRIER != 0,
        speed: None,
        mtu_bytes: 0,
        received: InterfaceTraffic::default(),
        sent: InterfaceTraffic::default(),
    };
    for attribute in attributes(rest) {
        match attribute? {
            (NAME, value) => interface.name = text(value),
            (MTU, value) => interface.mtu_bytes = parse_u32(value)?,
            (STATISTICS, value) => (interface.received, interface.sent) = traffic(value)?,
            _ => {}
        }
    }
    Ok(Some(Link { index: parse_u32(&header[4..8])?, interface }))
}

/// Reads what was received and what was sent.
fn traffic(statistics: &[u8]) -> Result<(InterfaceTraffic, InterfaceTraffic), DecodeError> {
    // Packets, bytes, errors and dropped packets, of each first those received.
    let counter = |place: usize| {
        let bytes = statistics.get(place * 8..place * 8 + 8);
        parse_u64(bytes.ok_or(DecodeError("statistics are too short"))?)
    };
    let direction = |first: usize| {
        Ok::<_, DecodeError>(InterfaceTraffic {
            packets: counter(first)?,
            bytes: counter(first + 2)?,
            errors: counter(first + 4)?,
            dropped: counter(first + 6)?,
            throughput_bps: None,
        })
    };
    Ok((direction(0)?, direction(1)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{LINKS, answers, attribute};

    #[test]
    fn captured_links_have_their_state_and_counters() {
        let links = answers(LINKS, decode);
        let names: Vec<_> = links.iter().map(|link| (link.index, link.interface.name.as_str())).collect();
        let expected = [(1, "lo"), (2, "wlan0"), (3, "wlan1"), (4, "wlan2"), (5, "wlan3"), (6, "hwsim0")];
        assert_eq!(names, expected);
        let [lo, ap, .., off, _] = links.as_slice() else { panic!("there are six") };
        assert_eq!((lo.interface.up, lo.interface.carrier, lo.interface.mtu_bytes), (true, true, 65_536));
        assert_eq!((ap.interface.up, ap.interface.carrier, ap.interface.mtu_bytes), (true, true, 1500));
        assert_eq!((off.interface.up, off.interface.carrier), (false, false));
        assert!(ap.interface.received.packets > 0 && ap.interface.received.bytes > 0, "{ap:?}");
        assert_eq!(lo.interface.received, InterfaceTraffic::default());
    }

    #[test]
    fn counters_are_those_of_each_direction() {
        let header = [&[0_u8; 4][..], &9_u32.to_ne_bytes(), &(UP | CARRIER).to_ne_bytes(), &[0; 4]].concat();
        // `struct rtnl_link_stats64` of Linux 2.6.35 has 23 counters. Later kernels append others.
        let statistics: Vec<u8> = (1..=23_u64).flat_map(u64::to_ne_bytes).collect();
        let body = |statistics: &[u8]| {
            let attributes = [attribute(NAME, b"eth0\0"), attribute(MTU, &9000_u32.to_ne_bytes())].concat();
            [header.clone(), attributes, attribute(STATISTICS, statistics)].concat()
        };
        let link = decode(&body(&statistics)).unwrap().unwrap();
        let traffic = |packets, bytes, errors, dropped| InterfaceTraffic {
            packets,
            bytes,
            errors,
            dropped,
            throughput_bps: None,
        };
        let interface = InterfaceContext {
            name: "eth0".to_owned(),
            up: true,
            carrier: true,
            speed: None,
            mtu_bytes: 9000,
            received: traffic(1, 3, 5, 7),
            sent: traffic(2, 4, 6, 8),
        };
        assert_eq!(link, Link { index: 9, interface });
        assert!(decode(&body(&statistics[..56])).is_err());
        assert!(decode(&header[..12]).is_err());
    }
}
