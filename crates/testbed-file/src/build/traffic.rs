//! Sources of traffic.

use std::collections::HashSet;

use cotorra_graph::{
    Arrivals, Begin, BitRate, DatagramSize, Direction, Link, Load, NodeId, OnOff, OverLink, Probability,
    Rate, Sends, TrafficId, TrafficSource, Transfers, UdpRate,
};

use super::builder::{Builder, each};
use crate::{
    records::{
        ArrivalsRecord, OnOffRecord, TcpTrafficRecord, TrafficPathRecord, TrafficRecord, TransfersRecord,
        UdpTrafficRecord,
    },
    yaml::{
        Bytes, Span,
        decode::{Either, Spanned},
    },
};

/// Shortest mean time of a period with datagrams and one without, and between transfers, seconds.
const SHORTEST: f64 = 1e-4;
/// Transfers that may be open at once, if the file does not say it, and at most.
const MOST_OPEN: u16 = 100;
const MOST_MOST_OPEN: u16 = 1000;

/// The path of a source: from host to host, or over a link in some directions.
enum Path<'a> {
    Hosts([NodeId; 2]),
    Over(&'a Link, Vec<Direction>),
}

impl Builder<'_> {
    /// Builds all sources. One on both directions of a link becomes two, which have its name and a direction.
    pub(super) fn all_traffic(&mut self, links: Option<&[Link]>) -> Option<Vec<TrafficSource>> {
        let record = self.record;
        let built: Option<Vec<_>> = each(&record.traffic.0, |(id, traffic)| self.traffic(id, traffic, links));
        let all: Vec<_> = built?.into_iter().flatten().collect();
        let mut names = HashSet::new();
        for source in &all {
            if !names.insert(&source.id) {
                let (id, _) = record.traffic.0.iter().find(|(id, _)| id.value == source.id)?;
                self.sink
                    .error(&id.span, format!("`{}` is also one direction of another source", source.id))
                    .help("rename it, or give the other a `direction`");
                return None;
            }
        }
        Some(all)
    }

    fn traffic(
        &mut self,
        id: &Spanned<TrafficId>,
        record: &TrafficRecord,
        links: Option<&[Link]>,
    ) -> Option<Vec<TrafficSource>> {
        let path = match record {
            TrafficRecord::Udp(udp) => &udp.path,
            TrafficRecord::Tcp(tcp) => &tcp.path,
        };
        let TrafficPathRecord { start, stop, .. } = path;
        if let Some(stop) = stop.as_ref().filter(|stop| stop.value <= *start) {
            self.sink
                .error(
                    &stop.span,
                    format!("traffic that stops after {:?} and starts after {start:?}", stop.value),
                )
                .help("write a later `stop`, or leave it out");
            return None;
        }
        let found = self.traffic_path(&id.span, path, links);
        let over = match &found {
            Some(Path::Over(link, _)) => Some(*link),
            _ => None,
        };
        let loads = |builder: &mut Self, direction: Option<Direction>| match record {
            TrafficRecord::Udp(udp) => builder.datagrams(id, udp, over.zip(direction)),
            TrafficRecord::Tcp(tcp) => builder.connections(tcp),
        };
        let source = |id, [from, to]: [NodeId; 2], over, load| TrafficSource {
            id,
            from,
            to,
            over,
            start: *start,
            stop: stop.as_ref().map(|stop| stop.value),
            load,
        };
        let (link, directions) = match found {
            Some(Path::Over(link, directions)) => (link, directions),
            Some(Path::Hosts(ends)) => {
                return Some(vec![source(id.value.clone(), ends, None, loads(self, None)?)]);
            }
            None => {
                // Its other mistakes show, too.
                loads(self, Some(Direction::Forward));
                return None;
            }
        };
        let both = directions.len() > 1;
        let one = |direction: &Direction| {
            let load = loads(self, Some(*direction))?;
            let (ends, word) = match direction {
                Direction::Forward => (link.ends.clone(), "forward"),
                Direction::Backward => ([link.ends[1].clone(), link.ends[0].clone()], "backward"),
            };
            let name = if both { self.named(id, word)? } else { id.value.clone() };
            Some(source(name, ends, Some(OverLink { link: link.id.clone(), direction: *direction }), load))
        };
        each(&directions, one)
    }

    /// Returns the name of one direction of a source.
    fn named(&mut self, id: &Spanned<TrafficId>, direction: &str) -> Option<TrafficId> {
        let name = TrafficId::new(&format!("{}-{direction}", id.value)).ok();
        if name.is_none() {
            self.sink
                .error(&id.span, "the name of one direction of this source would be too long")
                .help(format!("shorten it by {} characters, or write a `direction`", direction.len() + 1));
        }
        name
    }

    fn traffic_path<'a>(
        &mut self,
        place: &Span,
        TrafficPathRecord { from, to, on, direction, .. }: &TrafficPathRecord,
        links: Option<&'a [Link]>,
    ) -> Option<Path<'a>> {
        if let Some(on) = on {
            if let Some(end) = from.as_ref().or(to.as_ref()) {
                self.sink
                    .error(&end.span, "both a link and a host")
                    .help("write either `on`, or `from` and `to`");
                return None;
            }
            // Mistakes in links are reported already.
            let links = links?;
            let Some(link) = links.iter().find(|link| link.id == on.value) else {
                let known = links.iter().map(|link| link.id.as_str());
                self.sink.unknown_name(&on.span, "wired link", on.value.as_str(), known);
                return None;
            };
            let both = || vec![Direction::Forward, Direction::Backward];
            let directions = direction.as_ref().map_or_else(both, |direction| vec![direction.value]);
            return Some(Path::Over(link, directions));
        }
        let (Some(from), Some(to)) = (from, to) else {
            let missing = if from.is_none() { "from" } else { "to" };
            self.sink
                .error(place, format!("`{missing}` is missing"))
                .help("write the hosts `from` and `to`, or a wired link behind `on`");
            return None;
        };
        if let Some(direction) = direction {
            self.sink
                .error(&direction.span, "a direction of traffic between hosts")
                .help("leave it out: the traffic goes from `from` to `to`. With `on`, it has a direction of that link");
            return None;
        }
        let ends = (self.host(from), self.host(to));
        if from.value == to.value {
            self.sink
                .error(&to.span, format!("traffic from `{}` to itself", from.value))
                .help("name another robot, radio unit or server: traffic goes over links");
            return None;
        }
        Some(Path::Hosts([ends.0?, ends.1?]))
    }

    fn datagrams(
        &mut self,
        id: &Spanned<TrafficId>,
        record: &UdpTrafficRecord,
        link: Option<(&Link, Direction)>,
    ) -> Option<Load> {
        let UdpTrafficRecord { rate, load, trace, pcap, size, arrivals, sender, speed, repeat, .. } = record;
        let named = [
            rate.as_ref().map(|rate| &rate.span),
            load.as_ref().map(|load| &load.span),
            trace.as_ref().map(|trace| &trace.span),
            pcap.as_ref().map(|pcap| &pcap.span),
        ];
        let named: Vec<_> = named.into_iter().flatten().collect();
        let wrong = match named[..] {
            [] => Some((&id.span, "`rate` is missing")),
            [_] => None,
            [_, second, ..] => Some((second, "a second rate of one source")),
        };
        if let Some((place, message)) = wrong {
            self.sink
                .error(place, message)
                .help("write one of `rate: 10 Mbit/s`, `load: 60 %`, `trace: FILE` and `pcap: FILE`");
            return None;
        }
        let is_recorded = trace.is_some() || pcap.is_some();
        let misplaced = [
            (size.as_ref().map(|its| &its.span), "size", is_recorded),
            (arrivals.as_ref().map(|its| &its.span), "arrivals", is_recorded),
            (speed.as_ref().map(|its| &its.span), "speed", !is_recorded),
            (repeat.as_ref().map(|its| &its.span), "loop", !is_recorded),
            (sender.as_ref().map(|its| &its.span), "sender", pcap.is_none()),
        ];
        let misplaced =
            misplaced.into_iter().find_map(|(place, key, is_wrong)| Some((place.filter(|_| is_wrong)?, key)));
        if let Some((place, key)) = misplaced {
            let (message, help) = match key {
                "size" | "arrivals" => {
                    (format!("`{key}` of a recording"), "leave it out: the recording has it")
                }
                "sender" => ("`sender` without a `pcap`".to_owned(), "leave it out"),
                _ => (format!("`{key}` without a recording"), "leave it out, or write `trace` or `pcap`"),
            };
            self.sink.error(place, message).help(help);
            return None;
        }
        if is_recorded {
            return self.replay(record).map(Load::Replay);
        }
        let size = self.datagram_size(record)?;
        let rate = match (rate, load) {
            (Some(rate), _) => rate.value,
            (None, Some(load)) => {
                UdpRate::Rate(self.rate_of_load(load, &size, (link, record.path.on.is_some()))?)
            }
            (None, None) => return None,
        };
        if let (UdpRate::Saturated, Some(arrivals)) = (rate, arrivals) {
            self.sink
                .error(
                    &arrivals.span,
                    "arrivals of a saturated source, which sends whenever its first link can",
                )
                .help("leave `arrivals` out, or write a rate, such as `rate: 10 Mbit/s`");
            return None;
        }
        let arrivals = match arrivals.as_ref().map(|arrivals| (&arrivals.value, &arrivals.span)) {
            None => Arrivals::Constant,
            Some((Either::Short(arrivals), _)) => *arrivals,
            Some((Either::Long(ArrivalsRecord { on_off }), place)) => {
                Arrivals::OnOff(self.on_off(on_off, place)?)
            }
        };
        Some(Load::Udp { rate, size, arrivals })
    }

    fn on_off(&mut self, OnOffRecord { on, off }: &OnOffRecord, place: &Span) -> Option<OnOff> {
        let (on, off) = (self.distribution(on, false), self.distribution(off, true));
        let periods = OnOff { on: on?, off: off? };
        if periods.on.mean() < SHORTEST {
            self.sink
                .error(place, "periods of less than 0.1 ms")
                .help("write a longer mean of `on`, or `arrivals: poisson`");
            return None;
        }
        Some(periods)
    }

    fn datagram_size(&mut self, record: &UdpTrafficRecord) -> Option<DatagramSize> {
        let Some(size) = &record.size else { return Some(DatagramSize::Constant(Load::MOST)) };
        let Either::Short(Bytes(bytes)) = size.value else {
            return self.distribution(size, false).map(DatagramSize::Random);
        };
        if !(u64::from(Load::LEAST)..=u64::from(Load::MOST)).contains(&bytes) {
            self.sink.error(&size.span, format!("datagrams of {bytes} B")).help(format!(
                "write a size from {} B to {} B, which one packet holds",
                Load::LEAST,
                Load::MOST
            ));
            return None;
        }
        Some(DatagramSize::Constant(bytes as u16))
    }

    /// Returns the rate of payloads whose frames take a share of a link's rate. A link that is not known, but named, is reported
    /// elsewhere.
    fn rate_of_load(
        &mut self,
        load: &Spanned<Probability>,
        size: &DatagramSize,
        (link, is_named): (Option<(&Link, Direction)>, bool),
    ) -> Option<BitRate> {
        let Some((link, direction)) = link else {
            if is_named {
                return None;
            }
            self.sink
                .error(&load.span, "the load of no link")
                .help("name the link by `on`, or write a rate, such as `rate: 10 Mbit/s`");
            return None;
        };
        let conditions = match direction {
            Direction::Forward => &link.forward,
            Direction::Backward => &link.backward,
        };
        let Rate::Fixed { bits_per_second } = conditions.rate else {
            self.sink
                .error(&load.span, format!("the load of `{}`, which has no fixed rate", link.id))
                .help("write a rate, such as `rate: 10 Mbit/s`, here or at the link");
            return None;
        };
        let link_bps = bits_per_second.bits_per_second() as f64 / link.scales[direction as usize].drop_scale;
        let payload = size.mean() / (size.mean() + f64::from(Load::HEADERS));
        let rate = BitRate::from_bits_per_second((load.value.get() * link_bps * payload).round() as u64);
        if rate.is_none() {
            self.sink.error(&load.span, "a load of nothing").help("write more, such as `load: 60 %`");
        }
        rate
    }

    fn connections(&mut self, record: &TcpTrafficRecord) -> Option<Load> {
        let TcpTrafficRecord { congestion_control, bytes, transfers, .. } = record;
        if let Some(none) = bytes.as_ref().filter(|bytes| bytes.value.0 == 0) {
            self.sink
                .error(&none.span, "a connection that sends nothing")
                .help("write 1 B or more, such as `10 MB`");
            return None;
        }
        let sends = match (bytes, transfers) {
            (Some(bytes), Some(_)) => {
                self.sink
                    .error(&bytes.span, "both `bytes` and `transfers`")
                    .help("leave `bytes` out: each transfer has its own `size`");
                return None;
            }
            (bytes, None) => Sends::Stream(bytes.as_ref().map(|bytes| bytes.value.0)),
            (None, Some(transfers)) => Sends::Transfers(self.transfers(transfers)?),
        };
        Some(Load::Tcp { congestion_control: *congestion_control, sends })
    }

    fn transfers(&mut self, record: &Spanned<TransfersRecord>) -> Option<Transfers> {
        let TransfersRecord { size, think, every, most_open } = &record.value;
        let size = self.distribution(size, false);
        if let Some(most) = most_open.as_ref().filter(|most| !(1..=MOST_MOST_OPEN).contains(&most.value)) {
            self.sink
                .error(&most.span, format!("{} open transfers", most.value))
                .help(format!("write a number from 1 to {MOST_MOST_OPEN}"));
            return None;
        }
        let begin = match (think, every) {
            (Some(think), None) => {
                if let Some(most) = most_open {
                    self.sink
                        .error(&most.span, "a number of transfers that follow each other")
                        .help("leave it out: one is open at once. With `every`, several may be");
                    return None;
                }
                Begin::AfterPause(self.distribution(think, true)?)
            }
            (None, Some(every)) => {
                let gap = self.distribution(every, false)?;
                if gap.mean() < SHORTEST {
                    self.sink
                        .error(&every.span, "more than 10,000 transfers a second")
                        .help("write a longer mean, from 0.1 ms on");
                    return None;
                }
                Begin::Every(gap, most_open.as_ref().map_or(MOST_OPEN, |most| most.value))
            }
            _ => {
                self.sink
                    .error(&record.span, "it is not clear when transfers begin")
                    .help("write either `think: 1 s`, or `every: { exponential: 200 ms }`");
                return None;
            }
        };
        Some(Transfers { size: size?, begin })
    }
}
