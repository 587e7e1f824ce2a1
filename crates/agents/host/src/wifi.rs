//! Wi-Fi interfaces of this machine, with the busy shares of their channels since the last reading.

use std::{collections::HashMap, io};

use cotorra_graph::{MachineContext, WifiChannel, WifiContext, WifiStation};
use cotorra_netlink::{
    DecodeError, Family, Netlink,
    nl80211::{FAMILY, command, of_interface},
};

use crate::{
    bounds::keep,
    nl80211::{self, Interface, Survey, Times},
};

/// Interface, and frequency in MHz.
type ChannelKey = (u32, u32);

const ENODEV: i32 = 19;
const EOPNOTSUPP: i32 = 95;

/// Reader of Wi-Fi interfaces.
pub(crate) struct Wifi {
    nl80211: Family,
    /// Times of each channel at the last reading.
    before: HashMap<ChannelKey, Times>,
}

/// Result of a reading.
#[derive(Default)]
pub(crate) struct WifiReading {
    pub(crate) wifi: Vec<WifiContext>,
    pub(crate) left_out: u32,
    /// The first failure. The lists that it concerns are empty.
    pub(crate) error: Option<io::Error>,
}

impl Wifi {
    pub(crate) fn new() -> Self {
        Self { nl80211: Family::new(FAMILY), before: HashMap::new() }
    }

    /// Lets the next reading look again for nl80211, if the kernel did not have it.
    pub(crate) fn look_again(&mut self) {
        self.nl80211.look_again();
    }

    /// Reads all interfaces, oldest first.
    pub(crate) fn read(&mut self, socket: &mut Netlink) -> WifiReading {
        let mut reading = WifiReading::default();
        let interfaces = self.nl80211.dump(socket, command::GET_INTERFACE, &[], nl80211::interface);
        let mut interfaces = interfaces.unwrap_or_else(|error| {
            reading.error = Some(error);
            Vec::new()
        });
        interfaces.sort_by_key(|interface| interface.index);
        reading.left_out = keep(&mut interfaces, MachineContext::MOST_WIFI);
        let before = std::mem::take(&mut self.before);
        let mut room =
            Room { stations: MachineContext::MOST_STATIONS, channels: MachineContext::MOST_CHANNELS };
        for interface in interfaces {
            let mut list = ListReader { family: &mut self.nl80211, socket, error: &mut reading.error };
            let stations = list.read(&interface, command::GET_STATION, nl80211::station);
            let surveys = list.read(&interface, command::GET_SURVEY, nl80211::survey);
            let times = surveys.iter().filter_map(|survey| Some((key(&interface, survey), survey.times?)));
            self.before.extend(times);
            reading.wifi.push(context(interface, stations, surveys, &before, &mut room));
        }
        reading
    }
}

/// Room left in a report, for all interfaces together.
struct Room {
    stations: usize,
    channels: usize,
}

/// Reader of lists that a driver may not have.
struct ListReader<'a> {
    family: &'a mut Family,
    socket: &'a mut Netlink,
    error: &'a mut Option<io::Error>,
}

impl ListReader<'_> {
    /// Reads what a command gives of an interface. The list is empty if its driver does not support the command, or if the
    /// interface disappeared meanwhile.
    fn read<T>(
        &mut self,
        interface: &Interface,
        command: u8,
        decode: impl Fn(&[u8]) -> Result<Option<T>, DecodeError>,
    ) -> Vec<T> {
        let of = of_interface(interface.index).finish();
        self.family.dump(self.socket, command, &of, decode).unwrap_or_else(|error| {
            if !matches!(error.raw_os_error(), Some(ENODEV | EOPNOTSUPP)) {
                self.error.get_or_insert(error);
            }
            Vec::new()
        })
    }
}

fn key(interface: &Interface, survey: &Survey) -> ChannelKey {
    (interface.index, survey.frequency_mhz)
}

/// Puts together what was read of an interface, as far as there is room.
fn context(
    interface: Interface,
    mut stations: Vec<WifiStation>,
    mut surveys: Vec<Survey>,
    before: &HashMap<ChannelKey, Times>,
    room: &mut Room,
) -> WifiContext {
    // Those in use are left out last.
    surveys.sort_by_key(|survey| (!survey.in_use, survey.frequency_mhz));
    let stations_left_out = keep(&mut stations, room.stations);
    let channels_left_out = keep(&mut surveys, room.channels);
    room.stations -= stations.len();
    room.channels -= surveys.len();
    let channel = |survey: &Survey| WifiChannel {
        frequency_mhz: survey.frequency_mhz,
        in_use: survey.in_use,
        noise: survey.noise,
        busy: survey.times.and_then(|times| times.busy_since(*before.get(&key(&interface, survey))?)),
    };
    let channels = surveys.iter().map(channel).collect();
    WifiContext {
        interface: interface.name,
        role: interface.role,
        ssid: interface.ssid,
        stations,
        stations_left_out,
        channels,
        channels_left_out,
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Probability, WifiRole};
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{STATIONS, answers};

    fn interface(index: u32) -> Interface {
        Interface { index, name: format!("wlan{index}"), role: WifiRole::AccessPoint, ssid: None }
    }

    fn stations(count: usize) -> Vec<WifiStation> {
        let station = answers(STATIONS, nl80211::station).swap_remove(0);
        vec![station; count]
    }

    fn survey(frequency_mhz: u32, in_use: bool, active: u64, busy: u64) -> Survey {
        Survey { frequency_mhz, in_use, noise: None, times: Some(Times { active, busy }) }
    }

    fn room() -> Room {
        Room { stations: MachineContext::MOST_STATIONS, channels: MachineContext::MOST_CHANNELS }
    }

    #[test]
    fn busy_shares_are_those_of_the_same_interface_and_channel() {
        let before = HashMap::from([
            ((1, 2412), Times { active: 1000, busy: 100 }),
            ((2, 2437), Times { active: 1000, busy: 100 }),
        ]);
        let surveys = vec![survey(2412, false, 2000, 600), survey(2437, true, 2000, 600)];
        let context = context(interface(1), stations(2), surveys, &before, &mut room());
        let channels: Vec<_> =
            context.channels.iter().map(|c| (c.frequency_mhz, c.busy.map(Probability::get))).collect();
        assert_eq!(channels, [(2437, None), (2412, Some(0.5))]);
        assert_eq!((context.interface.as_str(), context.stations.len()), ("wlan1", 2));
    }

    #[test]
    fn channel_in_use_is_left_out_last() {
        let surveys = (0..300).map(|n| survey(2000 + n, n == 299, 1, 0)).collect();
        let context = context(interface(1), Vec::new(), surveys, &HashMap::new(), &mut room());
        assert_eq!((context.channels.len(), context.channels_left_out), (256, 44));
        assert_eq!(context.channels[0].frequency_mhz, 2299);
    }

    proptest! {
        #[test]
        fn bounds_hold_for_all_interfaces_together(counts in prop::collection::vec((0..300_usize, 0..300_u32), 0..6)) {
            let mut room = room();
            let (mut kept, mut total) = ([0; 2], [0; 2]);
            for (index, (count, channels)) in counts.into_iter().enumerate() {
                let surveys = (0..channels).map(|n| survey(n, false, 1, 0)).collect();
                let context = context(interface(index as u32), stations(count), surveys, &HashMap::new(), &mut room);
                kept = [kept[0] + context.stations.len(), kept[1] + context.channels.len()];
                total = [
                    total[0] + context.stations.len() + context.stations_left_out as usize,
                    total[1] + context.channels.len() + context.channels_left_out as usize,
                ];
                prop_assert_eq!(context.stations.len() + context.stations_left_out as usize, count);
            }
            prop_assert_eq!(kept[0], total[0].min(MachineContext::MOST_STATIONS));
            prop_assert_eq!(kept[1], total[1].min(MachineContext::MOST_CHANNELS));
        }
    }
}
