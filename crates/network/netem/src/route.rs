//! Reads routes (rtnetlink(7), linux/rtnetlink.h) to find the interfaces of default routes, so that conditions there
//! do not lock users out by accident.

use cotorra_netlink::{DecodeError, attributes};

use crate::structure::word;

/// Length of `struct rtmsg`.
const HEADER: usize = 12;
const OUT: u16 = 4;
const SEVERAL: u16 = 9;
/// Length of `struct rtnexthop`: length, flags, hops and interface. Attributes follow.
const NEXT_HOP: usize = 8;
/// A route to a destination (`RTN_UNICAST`).
const UNICAST: u8 = 1;

/// Returns the interfaces of a default route, none for any other route. `body` follows the header of an
/// `RTM_NEWROUTE` message.
pub(crate) fn default_route_interfaces(body: &[u8]) -> Result<Vec<u32>, DecodeError> {
    let (header, rest) = body.split_at_checked(HEADER).ok_or(DecodeError("a route is too short"))?;
    let (prefix, kind) = (header[1], header[7]);
    let mut default_route_interfaces = Vec::new();
    if prefix != 0 || kind != UNICAST {
        return Ok(default_route_interfaces);
    }
    for attribute in attributes(rest) {
        let (attribute, value) = attribute?;
        match attribute {
            OUT => default_route_interfaces.push(word(value, 0)?),
            SEVERAL => {
                let mut hops = value;
                while let Some(hop) = hops.get(..NEXT_HOP) {
                    default_route_interfaces.push(word(hop, 1)?);
                    let length = usize::from(u16::from_ne_bytes([hop[0], hop[1]])).max(NEXT_HOP);
                    hops = hops.get(length.next_multiple_of(4)..).unwrap_or_default();
                }
            }
            _ => {}
        }
    }
    Ok(default_route_interfaces)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use cotorra_netlink::Writer;

    fn route(prefix: u8, kind: u8, write: impl FnOnce(&mut Writer)) -> Vec<u8> {
        let mut w = Writer::default();
        w.raw(&[2, prefix, 0, 0, 254, 3, 0, kind, 0, 0, 0, 0]);
        write(&mut w);
        w.finish()
    }

    #[test]
    fn only_default_routes_count() {
        let over = |w: &mut Writer| {
            w.words(OUT, &[7]);
        };
        assert_eq!(default_route_interfaces(&route(0, UNICAST, over)), Ok(vec![7]));
        assert_eq!(default_route_interfaces(&route(24, UNICAST, over)), Ok(vec![]));
        assert_eq!(default_route_interfaces(&route(0, 7, over)), Ok(vec![]), "an unreachable route");
        let hop = |interface: u32| [16_u32, interface, 0, 0].map(u32::to_ne_bytes).concat();
        let both = route(0, UNICAST, |w| {
            w.bytes(SEVERAL, &[hop(3), hop(4)].concat());
        });
        assert_eq!(default_route_interfaces(&both), Ok(vec![3, 4]));
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..80)) {
            _ = default_route_interfaces(&bytes);
        }
    }
}
