//! The context of a real machine: its load, its memory, its network interfaces and its Wi-Fi.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::{
    id::NodeId,
    units::{BitRate, Dbm, Probability, Timestamp, millis},
};

/// Report of a real machine on itself. A part is `None` or empty if the machine does not offer it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct MachineContext {
    /// The machine.
    pub node: NodeId,
    /// Time of the reading; `None` if the distance of the machine's clock is not known yet.
    pub reading: Option<ReadingTime>,
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

/// Time at which a machine read its context, on the core's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ReadingTime {
    /// The time.
    #[serde(rename = "measured_ns")]
    pub measured: Timestamp,
    /// Most that the time is wrong by, because the distance of two clocks is an estimate.
    #[serde(rename = "time_error_ms", with = "millis")]
    #[schema(value_type = f64)]
    pub error: Duration,
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
    /// Highest number of bytes of a text, such as the name of an interface.
    pub const LONGEST_TEXT: usize = 128;

    /// Whether lists and texts keep to their bounds, all numbers are finite, and the memory is below 2^63 bytes.
    pub fn is_valid(&self) -> bool {
        let Self {
            node: _,
            reading: _,
            cpu: _,
            load_average,
            memory,
            interfaces,
            interfaces_left_out: _,
            wifi,
            wifi_left_out: _,
        } = self;
        let is_text = |text: &str| text.len() <= Self::LONGEST_TEXT;
        let is_number = |number: Option<f64>| number.is_none_or(f64::is_finite);
        let averages =
            load_average.map_or([0.0; 3], |load| [load.one_minute, load.five_minutes, load.fifteen_minutes]);
        let bytes = memory.map_or([0; 2], |memory| [memory.memory_bytes, memory.available_bytes]);
        let stations = || wifi.iter().flat_map(|of| &of.stations);
        let channels = || wifi.iter().flat_map(|of| &of.channels);
        averages.into_iter().all(f64::is_finite)
            && bytes.into_iter().all(|bytes| bytes <= i64::MAX.cast_unsigned())
            && interfaces.len() <= Self::MOST_INTERFACES
            && interfaces.iter().all(|of| {
                is_text(&of.name)
                    && is_number(of.received.throughput_bps)
                    && is_number(of.sent.throughput_bps)
            })
            && wifi.len() <= Self::MOST_WIFI
            && wifi.iter().all(|of| is_text(&of.interface) && of.ssid.as_deref().is_none_or(is_text))
            && stations().count() <= Self::MOST_STATIONS
            && stations().all(|of| is_text(&of.mac) && is_number(of.signal.map(|signal| signal.0)))
            && channels().count() <= Self::MOST_CHANNELS
            && channels().all(|of| is_number(of.noise.map(|noise| noise.0)))
    }
}

/// The CPUs of a machine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CpuContext {
    /// CPUs that are online.
    pub cpus: u32,
    /// Share of their time since the last reading in which they were not idle, time that a hypervisor stole included;
    /// `None` at the first reading.
    pub busy: Option<Probability>,
}

/// Mean number of tasks that run or wait for a CPU or a disk.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LoadAverage {
    /// Over one minute.
    pub one_minute: f64,
    /// Over five minutes.
    pub five_minutes: f64,
    /// Over fifteen minutes.
    pub fifteen_minutes: f64,
}

/// The memory of a machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct MemoryContext {
    /// All of it.
    pub memory_bytes: u64,
    /// Memory that new programs can use without swapping.
    pub available_bytes: u64,
}

/// A network interface of a machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
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
    #[schema(value_type = Option<f64>)]
    pub transmit_airtime: Option<Duration>,
    /// Airtime of frames received from it.
    #[serde(rename = "receive_airtime_ms", with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub receive_airtime: Option<Duration>,
    /// Time since its last frame.
    #[serde(rename = "inactive_ms", with = "millis::option")]
    #[schema(value_type = Option<f64>)]
    pub inactive: Option<Duration>,
}

/// Survey of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Event, Stamped};

    fn wifi() -> WifiContext {
        let station = WifiStation {
            mac: "02:00:00:00:01:00".to_owned(),
            signal: Some(Dbm(-60.0)),
            transmit_rate: BitRate::from_bits_per_second(65_000_000),
            receive_rate: None,
            retransmissions: Some(3),
            transmissions_failed: None,
            transmit_airtime: Some(Duration::from_micros(1500)),
            receive_airtime: None,
            inactive: Some(Duration::from_millis(20)),
        };
        WifiContext {
            interface: "wlan0".to_owned(),
            role: WifiRole::AccessPoint,
            ssid: Some("lab".to_owned()),
            stations: vec![station],
            stations_left_out: 0,
            channels: vec![WifiChannel {
                frequency_mhz: 2412,
                in_use: true,
                noise: Some(Dbm(-95.0)),
                busy: None,
            }],
            channels_left_out: 0,
        }
    }

    fn machine() -> MachineContext {
        let interface = InterfaceContext {
            name: "eth0".to_owned(),
            up: true,
            carrier: true,
            speed: BitRate::from_bits_per_second(1_000_000_000),
            mtu_bytes: 1500,
            received: InterfaceTraffic {
                packets: 1,
                throughput_bps: Some(8.0),
                ..InterfaceTraffic::default()
            },
            sent: InterfaceTraffic::default(),
        };
        MachineContext {
            node: NodeId::new("edge").unwrap(),
            reading: Some(ReadingTime {
                measured: Timestamp::from_nanos(7),
                error: Duration::from_micros(250),
            }),
            cpu: Some(CpuContext { cpus: 4, busy: Probability::new(0.25) }),
            load_average: Some(LoadAverage { one_minute: 0.5, five_minutes: 0.25, fifteen_minutes: 0.0 }),
            memory: Some(MemoryContext { memory_bytes: 8, available_bytes: 2 }),
            interfaces: vec![interface],
            interfaces_left_out: 0,
            wifi: vec![wifi()],
            wifi_left_out: 0,
        }
    }

    #[test]
    fn events_of_machines_survive_json() {
        let event = Stamped { at: Timestamp::from_nanos(9), event: Event::Machine(machine()) };
        let json = serde_json::to_string(&event).unwrap();
        assert!(
            json.starts_with(
                r#"{"at_ns":9,"event":"machine","node":"edge","reading":{"measured_ns":7,"time_error_ms":0.25},"cpu":{"cpus":4,"#
            ),
            "{json}"
        );
        assert_eq!(serde_json::from_str::<Stamped>(&json).unwrap(), event);
    }

    #[test]
    fn contexts_beyond_the_bounds_are_invalid() {
        assert!(machine().is_valid());
        let changes: [fn(&mut MachineContext); 12] = [
            |it| it.interfaces = vec![it.interfaces[0].clone(); MachineContext::MOST_INTERFACES + 1],
            |it| it.wifi = vec![it.wifi[0].clone(); MachineContext::MOST_WIFI + 1],
            |it| {
                it.wifi[0].stations = vec![it.wifi[0].stations[0].clone(); MachineContext::MOST_STATIONS + 1]
            },
            |it| it.wifi[0].channels = vec![it.wifi[0].channels[0]; MachineContext::MOST_CHANNELS + 1],
            |it| it.interfaces[0].name = "x".repeat(MachineContext::LONGEST_TEXT + 1),
            |it| it.wifi[0].interface = "x".repeat(MachineContext::LONGEST_TEXT + 1),
            |it| it.wifi[0].ssid = Some("x".repeat(MachineContext::LONGEST_TEXT + 1)),
            |it| it.wifi[0].stations[0].mac = "x".repeat(MachineContext::LONGEST_TEXT + 1),
            |it| it.wifi[0].channels[0].noise = Some(Dbm(f64::NAN)),
            |it| it.interfaces[0].sent.throughput_bps = Some(f64::INFINITY),
            |it| it.load_average.as_mut().unwrap().five_minutes = f64::NAN,
            |it| it.memory.as_mut().unwrap().memory_bytes = 1 << 63,
        ];
        for (number, change) in changes.into_iter().enumerate() {
            let mut context = machine();
            change(&mut context);
            assert!(!context.is_valid(), "change {number}");
        }
    }
}
