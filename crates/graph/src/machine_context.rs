//! The context of a real machine: its load, its memory, its network interfaces and its Wi-Fi.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{
    id::NodeId,
    units::{BitRate, Dbm, Probability, millis},
};

/// What a real machine reports of itself. A part is `None` or empty if the machine does not offer it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MachineContext {
    /// The machine.
    pub node: NodeId,
    /// Its CPUs.
    pub cpu: Option<CpuContext>,
    /// Its load averages.
    pub load_average: Option<LoadAverage>,
    /// Its memory.
    pub memory: Option<MemoryContext>,
    /// Its network interfaces, at most [`Self::MOST_INTERFACES`], oldest first.
    pub interfaces: Vec<InterfaceContext>,
    /// Interfaces beyond the bound.
    pub interfaces_left_out: u32,
    /// Its Wi-Fi interfaces, at most [`Self::MOST_WIFI`].
    pub wifi: Vec<WifiContext>,
    /// Wi-Fi interfaces beyond the bound.
    pub wifi_left_out: u32,
}

impl MachineContext {
    /// Highest number of interfaces.
    pub const MOST_INTERFACES: usize = 64;
    /// Highest number of Wi-Fi interfaces.
    pub const MOST_WIFI: usize = 16;
    /// Highest number of stations of all Wi-Fi interfaces together.
    pub const MOST_STATIONS: usize = 256;
    /// Highest number of surveyed channels of all Wi-Fi interfaces together.
    pub const MOST_CHANNELS: usize = 256;
}

/// The CPUs of a machine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CpuContext {
    /// CPUs that are online.
    pub cpus: u32,
    /// Share of their time since the last reading in which they were not idle, time that a hypervisor stole included;
    /// `None` at the first reading.
    pub busy: Option<Probability>,
}

/// Mean number of tasks that run or wait for a CPU or a disk.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LoadAverage {
    /// Over one minute.
    pub one_minute: f64,
    /// Over five minutes.
    pub five_minutes: f64,
    /// Over fifteen minutes.
    pub fifteen_minutes: f64,
}

/// The memory of a machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MemoryContext {
    /// All of it.
    pub memory_bytes: u64,
    /// What new programs can use without swapping.
    pub available_bytes: u64,
}

/// A network interface of a machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct InterfaceContext {
    /// Name, such as `eth0`.
    pub name: String,
    /// Whether it is enabled.
    pub up: bool,
    /// Whether it has a carrier, i.e. can send.
    pub carrier: bool,
    /// Speed of its medium; `None` if its driver does not know.
    #[serde(rename = "speed_bps")]
    pub speed: Option<BitRate>,
    /// Largest packet.
    pub mtu_bytes: u32,
    /// Received traffic.
    pub received: InterfaceTraffic,
    /// Sent traffic.
    pub sent: InterfaceTraffic,
}

/// One direction of an interface, counted since the interface exists.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct InterfaceTraffic {
    /// Packets.
    pub packets: u64,
    /// Bytes.
    pub bytes: u64,
    /// Packets with an error.
    pub errors: u64,
    /// Packets dropped without an error, as by a full queue.
    pub dropped: u64,
    /// Throughput since the last reading, bit/s; `None` at the first one, or if the counter went back.
    pub throughput_bps: Option<f64>,
}

/// A Wi-Fi interface, the stations that it exchanges frames with, and the channels that it listened to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct WifiContext {
    /// Name of the interface.
    pub interface: String,
    /// Role of the interface.
    pub role: WifiRole,
    /// Name of its network, if it has one.
    pub ssid: Option<String>,
    /// Stations in its BSS: of an access point its clients, of a client its access point.
    pub stations: Vec<WifiStation>,
    /// Stations beyond [`MachineContext::MOST_STATIONS`].
    pub stations_left_out: u32,
    /// Channels with a survey.
    pub channels: Vec<WifiChannel>,
    /// Channels beyond [`MachineContext::MOST_CHANNELS`].
    pub channels_left_out: u32,
}

/// Role of a Wi-Fi interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum WifiRole {
    /// Access point.
    AccessPoint,
    /// Client of an access point.
    Client,
    /// Mesh point.
    Mesh,
    /// Any other, such as a monitor.
    Other,
}

/// A machine's view of a station in its BSS. Each figure is `None` if the driver does not report it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct WifiStation {
    /// MAC address, such as `02:00:00:00:01:00`.
    pub mac: String,
    /// Signal of the last frame received from it.
    #[serde(rename = "signal_dbm")]
    pub signal: Option<Dbm>,
    /// PHY rate of the last frame sent to it.
    #[serde(rename = "transmit_rate_bps")]
    pub transmit_rate: Option<BitRate>,
    /// PHY rate of the last frame received from it.
    #[serde(rename = "receive_rate_bps")]
    pub receive_rate: Option<BitRate>,
    /// Retransmissions to it.
    pub retransmissions: Option<u32>,
    /// Frames to it that were lost after the last retransmission.
    pub transmissions_failed: Option<u32>,
    /// Airtime of frames sent to it.
    #[serde(rename = "transmit_airtime_ms", with = "millis::option")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<f64>))]
    pub transmit_airtime: Option<Duration>,
    /// Airtime of frames received from it.
    #[serde(rename = "receive_airtime_ms", with = "millis::option")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<f64>))]
    pub receive_airtime: Option<Duration>,
    /// Time since its last frame.
    #[serde(rename = "inactive_ms", with = "millis::option")]
    #[cfg_attr(feature = "openapi", schema(value_type = Option<f64>))]
    pub inactive: Option<Duration>,
}

/// Survey of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct WifiChannel {
    /// Centre frequency.
    pub frequency_mhz: u32,
    /// Whether the interface uses it.
    pub in_use: bool,
    /// Noise.
    #[serde(rename = "noise_dbm")]
    pub noise: Option<Dbm>,
    /// Share of the time since the last reading in which it was busy; `None` at the first reading, or if the interface did
    /// not listen to it since.
    pub busy: Option<Probability>,
}
