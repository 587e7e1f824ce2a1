//! What arrived of the traffic of sources.

use std::time::Duration;

use cotorra_graph::{Direction, LinkId, NodeId, TrafficId};
use cotorra_numbers::{Gathered, Quantiles};
use serde::Serialize;

/// What arrived of a source's traffic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// The source.
    pub source: TrafficId,
    /// The host that sends, or the node at which it enters its link.
    pub from: NodeId,
    /// The host that receives, or the node at which it leaves its link.
    pub to: NodeId,
    /// The link that it crosses from end to end, if it does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub link: Option<LinkId>,
    /// The direction of its data over the link.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<Direction>,
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
    /// How late datagrams with a time were sent, microseconds; `None` in virtual time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sent_lateness_us: Option<Quantiles>,
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
    /// Figures of transfers over connections of their own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transfers: Option<TransfersMeasured>,
}

/// Figures of transfers over connections of their own.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TransfersMeasured {
    /// Transfers that were not begun, because too many were open.
    pub refused_transfers: u64,
    /// Transfers that were begun and did not arrive until the end.
    pub open_transfers: u64,
    /// Those that arrived.
    pub all: Option<CompletionTimes>,
    /// Those that arrived, by their size.
    pub by_size: Vec<CompletionTimes>,
}

/// Transfers that arrived, and their times from the begin until the last byte arrived.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CompletionTimes {
    /// Largest size, bytes; `None` without a bound.
    pub up_to_bytes: Option<u64>,
    /// Their number.
    pub arrived_transfers: u64,
    /// Their mean size, bytes.
    pub mean_bytes: f64,
    /// Mean of their times, milliseconds.
    pub mean_completion_ms: f64,
    /// Their times, milliseconds.
    pub completion_ms: Quantiles,
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
            retransmitted_packets,
            timeouts,
            round_trip_ms,
            finished_after_ms,
            transfers,
            ..
        }) = tcp
        {
            let s = if *timeouts == 1 { "" } else { "s" };
            text += &format!("; {retransmitted_packets} of {sent} packets sent again, {timeouts} timeout{s}");
            if let Some(ms) = finished_after_ms {
                text += &format!("; all arrived after {:.2} s", ms / 1e3);
            }
            times = round_trip_ms.map(|trip| ("round trip", trip));
            if let Some(TransfersMeasured { refused_transfers, open_transfers, all, .. }) = transfers {
                let arrived = all.as_ref().map_or(0, |all| all.arrived_transfers);
                text += &format!(
                    "; {arrived} transfers arrived, {open_transfers} open, {refused_transfers} refused"
                );
                times = all.as_ref().map(|all| ("completion", all.completion_ms));
            }
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
