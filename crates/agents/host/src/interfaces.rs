//! Network interfaces of this machine, with their rates since the last reading.

use std::{collections::HashMap, io};

use cotorra_graph::{BitRate, InterfaceContext, MachineContext, Timestamp};
use cotorra_netlink::{DUMP, Family, Netlink};

use crate::{
    bounds::keep,
    ethtool,
    link::{self, Link},
};

/// Bytes that an interface received and sent.
type Bytes = [u64; 2];

/// Reader of network interfaces.
pub(crate) struct Interfaces {
    ethtool: Family,
    before: Option<(Timestamp, HashMap<u32, Bytes>)>,
}

impl Interfaces {
    pub(crate) fn new() -> Self {
        Self { ethtool: Family::new(ethtool::FAMILY), before: None }
    }

    /// Lets the next reading look again for speeds, if the kernel did not report any.
    pub(crate) fn look_again(&mut self) {
        self.ethtool.look_again();
    }

    /// Reads all interfaces, oldest first.
    pub(crate) fn links(route: &mut Netlink) -> io::Result<Vec<Link>> {
        let mut links = route.request(link::GET_LINK, DUMP, &[0; link::HEADER], link::decode)?;
        links.sort_by_key(|link| link.index);
        Ok(links)
    }

    /// Reads the speeds of all interfaces, by their indices.
    pub(crate) fn speeds(&mut self, generic: &mut Netlink) -> io::Result<HashMap<u32, BitRate>> {
        let speeds = self.ethtool.dump(generic, ethtool::GET_LINK_MODES, &ethtool::all(), ethtool::decode)?;
        Ok(speeds.into_iter().collect())
    }

    /// Returns the first interfaces, with their speeds and their rates since the last call, and the number of those left
    /// out.
    pub(crate) fn contexts(
        &mut self,
        now: Timestamp,
        mut links: Vec<Link>,
        speeds: &HashMap<u32, BitRate>,
    ) -> (Vec<InterfaceContext>, u32) {
        let left_out = keep(&mut links, MachineContext::MOST_INTERFACES);
        let bytes = |link: &Link| [link.interface.received.bytes, link.interface.sent.bytes];
        let counted = links.iter().map(|link| (link.index, bytes(link))).collect();
        let before = self.before.replace((now, counted));
        let context = |mut link: Link| {
            let known = before.as_ref().and_then(|(at, counted)| Some((*at, counted.get(&link.index)?)));
            if let Some((at, [received, sent])) = known {
                let seconds = now.since(at).as_secs_f64();
                let interface = &mut link.interface;
                interface.received.throughput_bps = rate(*received, interface.received.bytes, seconds);
                interface.sent.throughput_bps = rate(*sent, interface.sent.bytes, seconds);
            }
            InterfaceContext { speed: speeds.get(&link.index).copied(), ..link.interface }
        };
        (links.into_iter().map(context).collect(), left_out)
    }
}

/// Returns bit/s; `None` if the counter went back, or if no time passed.
fn rate(before: u64, bytes: u64, seconds: f64) -> Option<f64> {
    let bits = bytes.checked_sub(before)? as f64 * 8.0;
    (seconds > 0.0).then(|| bits / seconds)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use proptest::prelude::*;

    use super::*;
    use crate::testing::{LINKS, answers};

    const SECOND: Timestamp = Timestamp::from_nanos(1_000_000_000);

    /// Returns an interface with these counters.
    fn link((index, [received, sent]): (u32, Bytes)) -> Link {
        let mut link = answers(LINKS, link::decode).swap_remove(0);
        link.index = index;
        (link.interface.received.bytes, link.interface.sent.bytes) = (received, sent);
        link
    }

    fn rates(interfaces: &mut Interfaces, now: Timestamp, links: &[(u32, Bytes)]) -> Vec<[Option<f64>; 2]> {
        let links = links.iter().copied().map(link).collect();
        let (contexts, _) = interfaces.contexts(now, links, &HashMap::new());
        contexts.iter().map(|c| [c.received.throughput_bps, c.sent.throughput_bps]).collect()
    }

    #[test]
    fn rates_are_those_since_the_last_reading() {
        let mut interfaces = Interfaces::new();
        assert_eq!(rates(&mut interfaces, Timestamp::ZERO, &[(1, [1000, 0])]), [[None, None]]);
        let later = SECOND + Duration::from_secs(1);
        assert_eq!(rates(&mut interfaces, later, &[(1, [2000, 500])]), [[Some(4000.0), Some(2000.0)]]);
        // Nothing is known of a new interface, and nothing without time.
        assert_eq!(
            rates(&mut interfaces, later + Duration::from_secs(1), &[(1, [2000, 500]), (2, [9, 9])]),
            [[Some(0.0), Some(0.0)], [None, None]]
        );
        assert_eq!(rates(&mut interfaces, later, &[(1, [3000, 500])]), [[None, None]]);
    }

    #[test]
    fn counters_that_wrap_or_go_back_give_no_rate() {
        let mut interfaces = Interfaces::new();
        rates(&mut interfaces, Timestamp::ZERO, &[(1, [u64::from(u32::MAX), u64::MAX])]);
        assert_eq!(rates(&mut interfaces, SECOND, &[(1, [17, 0])]), [[None, None]]);
    }

    #[test]
    fn speeds_belong_to_interfaces_by_their_index() {
        let speed = BitRate::from_mbps(1000.0).unwrap();
        let links = vec![link((1, [0, 0])), link((7, [0, 0]))];
        let (contexts, _) =
            Interfaces::new().contexts(SECOND, links, &HashMap::from([(7, speed), (8, speed)]));
        let speeds: Vec<_> = contexts.iter().map(|context| context.speed).collect();
        assert_eq!(speeds, [None, Some(speed)]);
    }

    proptest! {
        #[test]
        fn rates_are_never_negative_and_bounds_hold(
            first in prop::collection::btree_map(0..120_u32, any::<Bytes>(), 0..100),
            second in prop::collection::btree_map(0..120_u32, any::<Bytes>(), 0..100),
            times in any::<[u64; 2]>(),
        ) {
            let [at, now] = times.map(Timestamp::from_nanos);
            let mut interfaces = Interfaces::new();
            let links = |from: &std::collections::BTreeMap<_, _>| {
                from.iter().map(|(index, bytes)| link((*index, *bytes))).collect::<Vec<_>>()
            };
            interfaces.contexts(at, links(&first), &HashMap::new());
            let (contexts, left_out) = interfaces.contexts(now, links(&second), &HashMap::new());
            prop_assert!(contexts.len() <= MachineContext::MOST_INTERFACES);
            prop_assert_eq!(contexts.len() + left_out as usize, second.len());
            for ((index, bytes), context) in second.iter().zip(&contexts) {
                let before = first.get(index).filter(|_| {
                    first.range(..index).count() < MachineContext::MOST_INTERFACES && now > at
                });
                for (side, rate) in [context.received.throughput_bps, context.sent.throughput_bps].iter().enumerate() {
                    let grew = before.is_some_and(|before| bytes[side] >= before[side]);
                    prop_assert_eq!(rate.is_some(), grew);
                    prop_assert!(rate.is_none_or(|rate| rate >= 0.0 && rate.is_finite()));
                }
            }
        }
    }
}
