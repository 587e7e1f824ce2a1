//! What arrived of the traffic of sources.

use std::time::Duration;

use cotorra_graph::{NodeId, TrafficId};
use cotorra_numbers::{Gathered, Quantiles};
use serde::Serialize;

/// What arrived of a source's traffic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// The source.
    pub source: TrafficId,
    /// The host that sends.
    pub from: NodeId,
    /// The host that receives.
    pub to: NodeId,
    /// Packets with data that were sent, those that were sent again included.
    pub sent_packets: u64,
    /// Bytes of payload that arrived: of datagrams each once, of a connection in order.
    pub bytes: u64,
    /// Their rate while the source sent, bit/s.
    pub goodput_bps: f64,
    /// Their rate in each second of the run, bit/s.
    pub goodput_by_second_bps: Vec<u64>,
    /// Figures of a source of datagrams.
    #[serde(flatten)]
    pub udp: Option<UdpMeasured>,
    /// Figures of a connection.
    #[serde(flatten)]
    pub tcp: Option<TcpMeasured>,
}

/// Figures of a source of datagrams.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UdpMeasured {
    /// Datagrams that arrived.
    pub received_packets: u64,
    /// Datagrams that did not arrive, those under way at the end included.
    pub lost: u64,
    /// Time from one host to the other, of those that arrived, milliseconds.
    pub delay_ms: Option<Quantiles>,
}

/// Figures of a connection.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TcpMeasured {
    /// Packets that were sent again.
    pub retransmitted_packets: u64,
    /// Retransmission timeouts.
    pub timeouts: u64,
    /// Smoothed round trip at the end, milliseconds.
    pub smoothed_round_trip_ms: Option<f64>,
    /// Round trips of packets that were sent once, milliseconds.
    pub round_trip_ms: Option<Quantiles>,
    /// Time from the start until all bytes were acknowledged, milliseconds, if they were.
    pub finished_after_ms: Option<f64>,
}

impl Measured {
    /// Describes it in a sentence.
    pub fn sentence(&self) -> String {
        let Self { sent_packets: sent, goodput_bps, udp, tcp, .. } = self;
        let mut text = format!("{:.2} Mbit/s", goodput_bps / 1e6);
        let mut times = None;
        if let Some(UdpMeasured { received_packets, delay_ms, .. }) = udp {
            text += &format!("; {received_packets} of {sent} packets arrived");
            times = delay_ms.map(|delay| ("delay", delay));
        }
        if let Some(TcpMeasured {
            retransmitted_packets, timeouts, round_trip_ms, finished_after_ms, ..
        }) = tcp
        {
            let s = if *timeouts == 1 { "" } else { "s" };
            text += &format!("; {retransmitted_packets} of {sent} packets sent again, {timeouts} timeout{s}");
            if let Some(ms) = finished_after_ms {
                text += &format!("; all arrived after {:.2} s", ms / 1e3);
            }
            times = round_trip_ms.map(|trip| ("round trip", trip));
        }
        if let Some((what, Quantiles { p50, p95, p99, .. })) = times {
            text += &format!("; {what} median {p50:.2} ms, p95 {p95:.2} ms, p99 {p99:.2} ms");
        }
        text
    }
}

/// Adds a time to samples in milliseconds.
pub(crate) fn gather(samples: &mut Gathered, time: Duration) {
    samples.add(time.as_secs_f64() * 1e3);
}
