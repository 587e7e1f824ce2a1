//! What ns-3 is to run, as JSON. Units are those of the SI.

use std::collections::BTreeMap;

use cotorra_graph::CongestionControl;
use serde::Serialize;

/// Time that ns-3's stations have to associate before the run begins, s.
pub(crate) const BEFORE: f64 = 3.0;

/// A scenario for `ns3/scenario.cc`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scenario {
    /// End, s.
    pub(crate) until_s: f64,
    /// Packets that a radio queues for each category.
    pub(crate) radio_queue: u32,
    pub(crate) networks: Vec<Network>,
    pub(crate) radio_units: Vec<RadioUnit>,
    pub(crate) wires: Vec<Wire>,
    /// Nodes of each path from a radio unit, or a server that is a source of traffic, to a server.
    pub(crate) paths: Vec<Vec<String>>,
    pub(crate) servers: Vec<String>,
    pub(crate) robots: Vec<Robot>,
    pub(crate) senders: Vec<Sender>,
    pub(crate) traffic: Vec<Traffic>,
}

impl Scenario {
    /// Returns the time for which robots send, s.
    pub(crate) fn seconds(&self) -> f64 {
        self.until_s - BEFORE
    }
}

/// A wireless network.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Network {
    pub(crate) name: String,
    /// `g`, `a`, `n`, `ac` or `ax`.
    pub(crate) standard: &'static str,
    pub(crate) is_5ghz: bool,
    pub(crate) width_mhz: u16,
    pub(crate) streams: u8,
    pub(crate) guard_interval_ns: u16,
    /// Exponent of the path loss.
    pub(crate) exponent: f64,
    /// Path loss at 1 m, dB.
    pub(crate) reference_db: f64,
    /// Noise floor over the thermal noise of the channel, dB.
    pub(crate) noise_figure_db: f64,
    /// Weakest frame that receivers find.
    pub(crate) sensitivity_dbm: f64,
    /// `ideal` or `minstrel`. None for a fixed rate.
    pub(crate) rate_control: Option<&'static str>,
    /// Mode of all data frames at a fixed rate, as ns-3 names it.
    pub(crate) mode: Option<String>,
    pub(crate) aggregation: bool,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct RadioUnit {
    pub(crate) name: String,
    pub(crate) network: String,
    /// Number of its channel by the centre of the whole width, and the place of the primary channel of 20 MHz in it, from
    /// below.
    pub(crate) channel: u8,
    pub(crate) primary: u8,
    pub(crate) position: [f64; 3],
    pub(crate) tx_power_dbm: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Wire {
    pub(crate) ends: [String; 2],
    pub(crate) rate_bps: u64,
    pub(crate) delay_s: f64,
    pub(crate) queue: Queue,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Queue {
    pub(crate) discipline: &'static str,
    pub(crate) limit: u64,
    pub(crate) in_bytes: bool,
    /// Parameters of the discipline, as ns-3 names and writes them.
    pub(crate) attributes: BTreeMap<&'static str, String>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Robot {
    pub(crate) name: String,
    pub(crate) tx_power_dbm: f64,
    /// Time (s) and place (m), in the order of time.
    pub(crate) places: Vec<[f64; 4]>,
    /// Time (s) from which a radio unit carries its packets.
    pub(crate) attachments: Vec<(f64, String)>,
}

/// What a robot sends to a server.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Sender {
    pub(crate) name: String,
    pub(crate) robot: String,
    /// Time (s) from which a server receives it.
    pub(crate) servers: Vec<(f64, String)>,
    /// Times of sending, s.
    pub(crate) times_s: Vec<f64>,
    /// Bytes of the UDP datagrams of each time.
    pub(crate) datagrams: Vec<u32>,
    /// Bytes of the answer; none for images.
    pub(crate) answer_bytes: Option<u32>,
    pub(crate) processing_s: f64,
    /// Age at which an answer counts no more, s.
    pub(crate) timeout_s: f64,
}

/// A source of traffic from a robot or a server to another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Traffic {
    pub(crate) name: String,
    pub(crate) from: String,
    pub(crate) to: String,
    pub(crate) start_s: f64,
    pub(crate) stop_s: f64,
    #[serde(flatten)]
    pub(crate) load: Load,
}

impl Traffic {
    /// Returns the time for which it sends, s.
    pub(crate) fn seconds(&self) -> f64 {
        self.stop_s - self.start_s
    }
}

/// What a source of traffic sends.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "protocol", rename_all = "snake_case")]
pub(crate) enum Load {
    Udp {
        /// Payload of a datagram.
        bytes: u16,
        /// Rate of the payloads; none for a source that always has a packet for its first link.
        rate_bps: Option<u64>,
        /// Whether the times between datagrams are random.
        poisson: bool,
    },
    Tcp {
        congestion_control: CongestionControl,
        /// Bytes to send in all, if there is an end.
        bytes: Option<u64>,
    },
}
