//! Records of sources of traffic.

use std::time::Duration;

use cotorra_graph::{Arrivals, CongestionControl, Direction, LinkId, NodeId, Probability, UdpRate};

use super::distributions::{Sizes, Times};
use crate::yaml::{
    Bytes,
    decode::{Amount, Either, Spanned, choice, record, tagged},
};

tagged! {
    /// A source of traffic that needs no program.
    TrafficRecord by protocol {
        "udp" => Udp(UdpTrafficRecord),
        "tcp" => Tcp(TcpTrafficRecord),
    }
}

record! {
    /// Datagrams, by one of `rate`, `load`, `trace` and `pcap`.
    UdpTrafficRecord {
        /// Mean rate of the payloads. A saturated source always has a packet for its first link.
        rate: Option<Spanned<UdpRate>>,
        /// Mean rate of the frames, as a share of the rate that the link of `on` has at first.
        load: Option<Spanned<Probability>>,
        /// Recorded datagrams: path of a file of lines `time,bytes`, in seconds and bytes of payload, from this file's folder.
        trace: Option<Spanned<String>>,
        /// Recorded packets: path of a file of `tcpdump`, pcap or pcapng, from this file's folder.
        pcap: Option<Spanned<String>>,
        /// Of a `pcap`: only the packets from this IP address.
        sender: Option<Spanned<String>>,
        /// Of a recording: the factor by which it is faster.
        speed: Option<Spanned<Amount>>,
        /// Of a recording: whether it begins anew at its end.
        repeat as "loop": Option<Spanned<bool>>,
        /// Payload of a datagram, from 16 B to 1472 B; without it, 1472 B.
        size: Option<Sizes>,
        /// Times between datagrams. Without it, the rate is constant. A saturated source and a recording have none.
        arrivals: Option<Spanned<Either<Arrivals, ArrivalsRecord>>>,
        ..path: TrafficPathRecord,
    }
}

record! {
    /// Times between datagrams.
    ArrivalsRecord {
        /// A constant rate in some periods, and none in others, so that the mean rate is that of the source.
        on_off: OnOffRecord,
    }
}

record! {
    /// Periods with and without datagrams, in turns.
    OnOffRecord {
        /// Periods with datagrams.
        on: Times,
        /// Periods without.
        off: Times,
    }
}

record! {
    /// Connections: one, or one for each of its `transfers`.
    TcpTrafficRecord {
        /// Algorithm that says how much may be under way.
        congestion_control: CongestionControl = "cubic",
        /// Bytes to send in all. Without them, it sends until it stops.
        bytes: Option<Spanned<Bytes>>,
        /// Transfers, of which each has a connection of its own.
        transfers: Option<Spanned<TransfersRecord>>,
        ..path: TrafficPathRecord,
    }
}

record! {
    /// Transfers over connections of their own: one after the other with a `think` time, or one `every` so often.
    TransfersRecord {
        /// Bytes of each.
        size: Sizes,
        /// Time from the arrival of each until the next begins.
        think: Option<Times>,
        /// Time from the begin of each until the next begins. An exponential one makes a Poisson process.
        every: Option<Times>,
        /// With `every`: transfers that are open at once, from 1 to 1000; without it, 100. Further ones are refused.
        most_open: Option<Spanned<u16>>,
    }
}

record! {
    /// Path and time of a source of traffic.
    TrafficPathRecord {
        /// The robot, radio unit or server that sends.
        from: Option<Spanned<NodeId>>,
        /// The robot, radio unit or server that receives.
        to: Option<Spanned<NodeId>>,
        /// In place of both: a wired link, which the traffic crosses from end to end, whatever nodes are there.
        on: Option<Spanned<LinkId>>,
        /// With `on`: one direction. Without it: both, each with traffic of its own.
        direction: Option<Spanned<Direction>>,
        /// When it begins, from the run's start.
        start: Duration = "0 s",
        /// When it sends no new data any more. Without it, never.
        stop: Option<Spanned<Duration>>,
    }
}

choice!(Arrivals, "way of arrival", {
    "constant" => Self::Constant, "such that the rate is constant";
    "poisson" => Self::Poisson, "at random, independent of each other";
});
choice!(CongestionControl, "congestion control", {
    "reno" => Self::Reno, "Reno (RFC 5681)";
    "cubic" => Self::Cubic, "CUBIC (RFC 9438), the default of Linux";
    "bbr" => Self::Bbr, "BBR, version 1";
});
