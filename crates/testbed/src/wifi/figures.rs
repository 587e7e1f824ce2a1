//! Measurements of real radios: φ(r,R) and ι(R) of robots and radio units at agents.

use std::collections::BTreeMap;

use cotorra_graph::{
    Attachment, Dbm, NodeId, RadioContext, StationContext, StationCounts, Timestamp, WifiContext, WifiStation,
};
use cotorra_wifi::{MacAddress, wpa_supplicant::Heard};
use parking_lot::Mutex;

use crate::real::radio_figures::RadioFigures;

/// The newest figures of each real radio.
#[derive(Debug)]
pub(super) struct Figures {
    addresses: BTreeMap<NodeId, MacAddress>,
    /// With the time of the newest scan that was read.
    read: Mutex<BTreeMap<NodeId, (Timestamp, Read)>>,
}

/// Readings of a radio's machine.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Read {
    /// Its kernel's report of the interface; `None` if it has none.
    pub(super) wifi: Option<WifiContext>,
    /// Access points that a station heard at its last scan.
    pub(super) heard: Vec<Heard>,
}

impl Figures {
    /// Nothing is read yet of radios with these addresses.
    pub(super) fn new(addresses: BTreeMap<NodeId, MacAddress>) -> Self {
        Self { addresses, read: Mutex::default() }
    }

    /// Takes what was read of a radio. Returns whether its station heard something else than before.
    pub(super) fn read(&self, now: Timestamp, node: &NodeId, read: Read) -> bool {
        let mut all = self.read.lock();
        let same = all.get(node).filter(|(_, before)| before.heard == read.heard).map(|(heard, _)| *heard);
        all.insert(node.clone(), (same.unwrap_or(now), read));
        same.is_none()
    }

    /// Forgets what was read of a radio, whose agent is lost.
    pub(super) fn forget(&self, node: &NodeId) {
        self.read.lock().remove(node);
    }

    fn has_address(&self, node: &NodeId, mac: &str) -> bool {
        self.addresses.get(node).is_some_and(|address| address.to_string() == mac)
    }
}

impl RadioFigures for Figures {
    fn complete_attachments(&self, now: Timestamp, robot: &NodeId, attachments: &mut [Attachment]) {
        if !self.addresses.contains_key(robot) {
            return;
        }
        let all = self.read.lock();
        let read = all.get(robot);
        for Attachment { radio_unit, attached, signal, age } in attachments {
            // A client's only station is its access point.
            let stations =
                read.and_then(|(_, read)| read.wifi.as_ref()).map_or(&[][..], |wifi| &wifi.stations);
            let own = stations.iter().find(|station| *attached && self.has_address(radio_unit, &station.mac));
            let own = own.and_then(|station| Some((station.signal?, station.inactive)));
            let bssid = self.addresses.get(radio_unit);
            let heard = || {
                let (at, read) = read?;
                let heard = read.heard.iter().find(|heard| Some(&heard.bssid) == bssid)?;
                Some((Dbm(f64::from(heard.signal_dbm)), Some(now.since(*at))))
            };
            (*signal, *age) = own.or_else(heard).map_or((None, None), |(signal, age)| (Some(signal), age));
        }
    }

    fn complete_radio(&self, context: &mut RadioContext) {
        if !self.addresses.contains_key(&context.radio_unit) {
            return;
        }
        let all = self.read.lock();
        let wifi = all.get(&context.radio_unit).and_then(|(_, read)| read.wifi.as_ref());
        let in_use = wifi.and_then(|wifi| wifi.channels.iter().find(|channel| channel.in_use));
        context.load = in_use.and_then(|channel| channel.busy).map(|busy| busy.get());
        let station = |station: &WifiStation| {
            let robot = self.addresses.keys().find(|node| self.has_address(node, &station.mac))?;
            let bps =
                |rate: Option<cotorra_graph::BitRate>| rate.map_or(0.0, |rate| rate.bits_per_second() as f64);
            Some(StationContext {
                robot: robot.clone(),
                signal: station.signal?,
                downlink_bps: bps(station.transmit_rate),
                uplink_bps: bps(station.receive_rate),
                counted: StationCounts {
                    retransmissions: station.retransmissions,
                    transmissions_failed: station.transmissions_failed,
                    transmit_airtime: station.transmit_airtime,
                    receive_airtime: station.receive_airtime,
                },
            })
        };
        context.stations = wifi.into_iter().flat_map(|wifi| &wifi.stations).filter_map(station).collect();
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use cotorra_graph::{BitRate, Probability, WifiChannel, WifiRole};

    use super::*;

    fn id(name: &str) -> NodeId {
        NodeId::new(name).unwrap()
    }

    fn at(seconds: u64) -> Timestamp {
        Timestamp::from_nanos(seconds * 1_000_000_000)
    }

    fn mac(number: u8) -> MacAddress {
        MacAddress([2, 0, 0, 0, number, 0])
    }

    fn station(number: u8, signal: Option<f64>) -> WifiStation {
        WifiStation {
            mac: mac(number).to_string(),
            signal: signal.map(Dbm),
            transmit_rate: BitRate::from_bits_per_second(65_000_000),
            receive_rate: None,
            retransmissions: Some(3),
            transmissions_failed: None,
            transmit_airtime: Some(Duration::from_millis(7)),
            receive_airtime: None,
            inactive: Some(Duration::from_millis(30)),
        }
    }

    fn wifi(role: WifiRole, stations: Vec<WifiStation>) -> Option<WifiContext> {
        let channel = |frequency_mhz, in_use, busy| WifiChannel {
            frequency_mhz,
            in_use,
            noise: None,
            busy: Probability::new(busy),
        };
        Some(WifiContext {
            interface: "wlan0".to_owned(),
            role,
            ssid: None,
            stations,
            stations_left_out: 0,
            channels: vec![channel(2437, false, 0.75), channel(2412, true, 0.25)],
            channels_left_out: 0,
        })
    }

    /// A robot `r1` and radio units `A` and `B`, whose addresses have the numbers 0, 1 and 2.
    fn figures() -> Figures {
        let nodes = [("r1", 0), ("A", 1), ("B", 2)];
        Figures::new(nodes.into_iter().map(|(node, number)| (id(node), mac(number))).collect())
    }

    /// Returns the signals with their ages, ms, 5 s after the run began.
    fn signals(figures: &Figures) -> Vec<Option<(f64, u128)>> {
        let attachment = |unit: &str| Attachment {
            radio_unit: id(unit),
            attached: unit == "A",
            // That of the model.
            signal: Some(Dbm(-1.0)),
            age: Some(Duration::ZERO),
        };
        let mut attachments = ["A", "B"].map(attachment);
        figures.complete_attachments(at(5), &id("r1"), &mut attachments);
        attachments.iter().map(|its| Some((its.signal?.0, its.age?.as_millis()))).collect()
    }

    #[test]
    fn signals_are_those_of_the_access_point_and_of_the_last_scan() {
        let figures = figures();
        assert_eq!(signals(&figures), [None, None], "nothing is known, and the model says nothing");
        let heard = |number, signal_dbm| Heard {
            bssid: mac(number),
            frequency_mhz: 2412,
            signal_dbm,
            flags: String::new(),
            ssid: None,
        };
        let heard = vec![heard(1, -50), heard(2, -70), heard(9, -20)];
        let associated = wifi(WifiRole::Client, vec![station(1, Some(-48.0))]);
        assert!(figures.read(at(2), &id("r1"), Read { wifi: associated.clone(), heard: heard.clone() }));
        assert!(!figures.read(at(3), &id("r1"), Read { wifi: associated, heard }), "no other scan");
        assert_eq!(signals(&figures), [Some((-48.0, 30)), Some((-70.0, 3000))]);
        figures.forget(&id("r1"));
        assert_eq!(signals(&figures), [None, None]);
    }

    #[test]
    fn radio_units_know_the_robots_that_their_kernel_reports() {
        let figures = figures();
        let mut context =
            RadioContext { radio_unit: id("A"), channel: 1, load: Some(0.9), stations: Vec::new() };
        let stations = vec![station(0, Some(-55.0)), station(9, Some(-30.0)), station(2, None)];
        figures.read(
            at(0),
            &id("A"),
            Read { wifi: wifi(WifiRole::AccessPoint, stations), heard: Vec::new() },
        );
        figures.complete_radio(&mut context);
        let counted = StationCounts {
            retransmissions: Some(3),
            transmit_airtime: Some(Duration::from_millis(7)),
            ..StationCounts::default()
        };
        let (robot, signal) = (id("r1"), Dbm(-55.0));
        let known = StationContext { robot, signal, downlink_bps: 65e6, uplink_bps: 0.0, counted };
        assert_eq!((context.load, &context.stations[..]), (Some(0.25), &[known][..]));
        // No survey, no load.
        figures.forget(&id("A"));
        figures.complete_radio(&mut context);
        assert_eq!((context.load, &context.stations[..]), (None, &[][..]));
        let untouched = RadioContext { radio_unit: id("other"), load: Some(0.5), ..context.clone() };
        let mut other = untouched.clone();
        figures.complete_radio(&mut other);
        assert_eq!(other, untouched);
    }
}
