//! Sources of traffic.

use cotorra_graph::{Load, TrafficId, TrafficSource, UdpRate};

use super::builder::Builder;
use crate::{
    records::{TcpTrafficRecord, TrafficPathRecord, TrafficRecord, UdpTrafficRecord},
    yaml::{Bytes, decode::Spanned},
};

impl Builder<'_> {
    pub(super) fn traffic(
        &mut self,
        id: &Spanned<TrafficId>,
        record: &TrafficRecord,
    ) -> Option<TrafficSource> {
        let (path, load) = match record {
            TrafficRecord::Udp(udp) => (&udp.path, self.datagrams(udp)),
            TrafficRecord::Tcp(tcp) => (&tcp.path, self.connection(tcp)),
        };
        let TrafficPathRecord { from, to, start, stop } = path;
        let ends = (self.host(from), self.host(to));
        if from.value == to.value {
            self.sink
                .error(&to.span, format!("traffic from `{}` to itself", from.value))
                .help("name another robot, radio unit or server: traffic goes over links");
            return None;
        }
        if let Some(stop) = stop.as_ref().filter(|stop| stop.value <= *start) {
            self.sink
                .error(
                    &stop.span,
                    format!("traffic that stops after {:?} and starts after {start:?}", stop.value),
                )
                .help("write a later `stop`, or leave it out");
            return None;
        }
        let stop = stop.as_ref().map(|stop| stop.value);
        Some(TrafficSource {
            id: id.value.clone(),
            from: ends.0?,
            to: ends.1?,
            start: *start,
            stop,
            load: load?,
        })
    }

    fn datagrams(&mut self, record: &UdpTrafficRecord) -> Option<Load> {
        let Bytes(size) = record.size.value;
        let fits = (u64::from(Load::LEAST)..=u64::from(Load::MOST)).contains(&size);
        if !fits {
            self.sink.error(&record.size.span, format!("datagrams of {size} B")).help(format!(
                "write a size from {} B to {} B, which one packet holds",
                Load::LEAST,
                Load::MOST
            ));
            return None;
        }
        if let (UdpRate::Saturated, Some(arrivals)) = (record.rate, &record.arrivals) {
            self.sink
                .error(
                    &arrivals.span,
                    "arrivals of a saturated source, which sends whenever its first link can",
                )
                .help("leave `arrivals` out, or write a rate, such as `rate: 10 Mbit/s`");
            return None;
        }
        let arrivals = record.arrivals.as_ref().map(|arrivals| arrivals.value).unwrap_or_default();
        Some(Load::Udp { rate: record.rate, size: size as u16, arrivals })
    }

    fn connection(&mut self, record: &TcpTrafficRecord) -> Option<Load> {
        let bytes = record.bytes.as_ref();
        if let Some(none) = bytes.filter(|bytes| bytes.value.0 == 0) {
            self.sink
                .error(&none.span, "a connection that sends nothing")
                .help("write 1 B or more, such as `10 MB`");
            return None;
        }
        let bytes = bytes.map(|bytes| bytes.value.0);
        Some(Load::Tcp { congestion_control: record.congestion_control, bytes })
    }
}
