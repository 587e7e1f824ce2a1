//! Speeds of network interfaces, as ethtool's netlink reports them (linux/ethtool_netlink.h; Linux 5.6). Unlike the files in
//! `/sys/class/net`, it follows the network namespace.

use cotorra_graph::BitRate;
use cotorra_netlink::{DecodeError, NESTED, Writer, answer, attributes, parse_u32};

/// Name of the family.
pub(crate) const FAMILY: &str = "ethtool";
/// `ETHTOOL_MSG_LINKMODES_GET`.
pub(crate) const GET_LINK_MODES: u8 = 4;
/// `ETHTOOL_A_LINKMODES_HEADER`.
const HEADER: u16 = 1;
/// `ETHTOOL_A_HEADER_DEV_INDEX`.
const INDEX: u16 = 1;
/// `ETHTOOL_A_HEADER_FLAGS`.
const FLAGS: u16 = 3;
/// `ETHTOOL_FLAG_COMPACT_BITSETS`: leaves out the names of all modes.
const COMPACT: u32 = 1;
/// `ETHTOOL_A_LINKMODES_SPEED`, Mbit/s.
const SPEED: u16 = 5;
/// `SPEED_UNKNOWN`.
const UNKNOWN: u32 = u32::MAX;

/// Encodes the attributes of a request for all interfaces.
pub(crate) fn all() -> Vec<u8> {
    let mut writer = Writer::default();
    writer.with(HEADER | NESTED, |w| {
        w.words(FLAGS, &[COMPACT]);
    });
    writer.finish()
}

/// Decodes an answer: the index of an interface and its speed, if its driver knows one.
pub(crate) fn decode(body: &[u8]) -> Result<Option<(u32, BitRate)>, DecodeError> {
    let (mut index, mut speed) = (None, None);
    for attribute in answer(body) {
        match attribute? {
            (HEADER, value) => {
                for attribute in attributes(value) {
                    if let (INDEX, value) = attribute? {
                        index = Some(parse_u32(value)?);
                    }
                }
            }
            (SPEED, value) => speed = Some(parse_u32(value)?),
            _ => {}
        }
    }
    let speed = speed.filter(|mbps| *mbps != UNKNOWN);
    let speed = speed.and_then(|mbps| BitRate::from_bits_per_second(u64::from(mbps) * 1_000_000));
    Ok(index.zip(speed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{attribute, generic, nested};

    #[test]
    fn speeds_are_in_bits_per_second() {
        let word = |kind, value: u32| attribute(kind, &value.to_ne_bytes());
        let header = nested(HEADER, &[word(INDEX, 4), attribute(2, b"eth0\0")]);
        let speed = |mbps| decode(&generic(&[header.clone(), word(SPEED, mbps)])).unwrap();
        assert_eq!(speed(2500), BitRate::from_mbps(2500.0).map(|speed| (4, speed)));
        assert_eq!(speed(UNKNOWN), None);
        assert_eq!(speed(0), None);
        assert_eq!(decode(&generic(std::slice::from_ref(&header))).unwrap(), None);
    }
}
