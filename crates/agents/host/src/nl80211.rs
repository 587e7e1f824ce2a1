//! Wi-Fi interfaces, stations and channels, as nl80211 reports them (linux/nl80211.h).

use std::time::Duration;

use cotorra_graph::{BitRate, Dbm, Probability, WifiRole, WifiStation};
use cotorra_netlink::{
    DecodeError, answer, attributes,
    nl80211::{attribute as attr, interface_type},
    parse_i8, parse_mac, parse_u16, parse_u32, parse_u64, text,
};

/// `NL80211_STA_INFO_*`.
mod sta_info {
    /// u32, ms.
    pub(super) const INACTIVE_TIME: u16 = 1;
    /// i8 in a u8, dBm.
    pub(super) const SIGNAL: u16 = 7;
    pub(super) const TX_BITRATE: u16 = 8;
    pub(super) const TX_RETRIES: u16 = 11;
    pub(super) const TX_FAILED: u16 = 12;
    pub(super) const RX_BITRATE: u16 = 14;
    /// u64, µs.
    pub(super) const RX_DURATION: u16 = 32;
    /// u64, µs.
    pub(super) const TX_DURATION: u16 = 39;
}

/// `NL80211_RATE_INFO_*`, both in units of 100 kbit/s.
mod rate_info {
    /// u16.
    pub(super) const BITRATE: u16 = 1;
    /// u32, for rates that the other cannot hold.
    pub(super) const BITRATE32: u16 = 5;
}

/// `NL80211_SURVEY_INFO_*`.
mod survey_info {
    /// u32, MHz.
    pub(super) const FREQUENCY: u16 = 1;
    /// i8 in a u8, dBm.
    pub(super) const NOISE: u16 = 2;
    pub(super) const IN_USE: u16 = 3;
    /// u64, ms.
    pub(super) const TIME: u16 = 4;
    /// u64, ms.
    pub(super) const TIME_BUSY: u16 = 5;
}

/// Airtime beyond which a counter is nonsense: 285 years.
const LONGEST_US: u64 = 1 << 53;

/// A Wi-Fi interface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Interface {
    pub(crate) index: u32,
    pub(crate) name: String,
    pub(crate) role: WifiRole,
    pub(crate) ssid: Option<String>,
}

/// Counts of an interface on a channel, since it exists.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Survey {
    pub(crate) frequency_mhz: u32,
    pub(crate) in_use: bool,
    pub(crate) noise: Option<Dbm>,
    pub(crate) times: Option<Times>,
}

/// Times of a channel, ms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Times {
    /// Time for which the interface listened.
    pub(crate) active: u64,
    /// Of that, time in which the channel was busy.
    pub(crate) busy: u64,
}

impl Times {
    /// Returns the share of the time since `before` in which the channel was busy; `None` if the interface did not listen,
    /// or if the driver started to count anew.
    pub(crate) fn busy_since(self, before: Self) -> Option<Probability> {
        let active = self.active.checked_sub(before.active)? as f64;
        let busy = self.busy.checked_sub(before.busy)? as f64;
        // Drivers read the two one after the other. 0/0 is not a number, and so no probability.
        Probability::new(busy.min(active) / active)
    }
}

/// Decodes an interface; `None` for one that is no network interface, such as those of Wi-Fi Direct.
pub(crate) fn interface(body: &[u8]) -> Result<Option<Interface>, DecodeError> {
    let (mut index, mut name, mut role, mut ssid) = (None, None, WifiRole::Other, None);
    for attribute in answer(body) {
        match attribute? {
            (attr::IFINDEX, value) => index = Some(parse_u32(value)?),
            (attr::IFNAME, value) => name = Some(text(value)),
            (attr::IFTYPE, value) => {
                role = match parse_u32(value)? {
                    interface_type::AP | interface_type::P2P_GO => WifiRole::AccessPoint,
                    interface_type::STATION | interface_type::P2P_CLIENT => WifiRole::Client,
                    interface_type::MESH_POINT => WifiRole::Mesh,
                    _ => WifiRole::Other,
                }
            }
            // Any bytes, without a terminating zero.
            (attr::SSID, value) => {
                ssid = (!value.is_empty()).then(|| String::from_utf8_lossy(value).into_owned())
            }
            _ => {}
        }
    }
    Ok(index.zip(name).map(|(index, name)| Interface { index, name, role, ssid }))
}

/// Decodes a station.
pub(crate) fn station(body: &[u8]) -> Result<Option<WifiStation>, DecodeError> {
    let (mut mac, mut info) = (None, [].as_slice());
    for attribute in answer(body) {
        match attribute? {
            (attr::MAC, value) => mac = Some(parse_mac(value)?),
            (attr::STA_INFO, value) => info = value,
            _ => {}
        }
    }
    let Some([a, b, c, d, e, f]) = mac else { return Ok(None) };
    let mut station = WifiStation {
        mac: format!("{a:02x}:{b:02x}:{c:02x}:{d:02x}:{e:02x}:{f:02x}"),
        signal: None,
        transmit_rate: None,
        receive_rate: None,
        retransmissions: None,
        transmissions_failed: None,
        transmit_airtime: None,
        receive_airtime: None,
        inactive: None,
    };
    for attribute in attributes(info) {
        match attribute? {
            (sta_info::INACTIVE_TIME, value) => {
                station.inactive = Some(Duration::from_millis(parse_u32(value)?.into()))
            }
            (sta_info::SIGNAL, value) => station.signal = Some(Dbm(parse_i8(value)?.into())),
            (sta_info::TX_BITRATE, value) => station.transmit_rate = rate(value)?,
            (sta_info::RX_BITRATE, value) => station.receive_rate = rate(value)?,
            (sta_info::TX_RETRIES, value) => station.retransmissions = Some(parse_u32(value)?),
            (sta_info::TX_FAILED, value) => station.transmissions_failed = Some(parse_u32(value)?),
            (sta_info::TX_DURATION, value) => station.transmit_airtime = airtime(value)?,
            (sta_info::RX_DURATION, value) => station.receive_airtime = airtime(value)?,
            _ => {}
        }
    }
    Ok(Some(station))
}

/// Reads a PHY rate; `None` before the first frame.
fn rate(value: &[u8]) -> Result<Option<BitRate>, DecodeError> {
    let mut rate = 0;
    for attribute in attributes(value) {
        match attribute? {
            (rate_info::BITRATE32, value) => rate = parse_u32(value)?,
            (rate_info::BITRATE, value) if rate == 0 => rate = parse_u16(value)?.into(),
            _ => {}
        }
    }
    Ok(BitRate::from_bits_per_second(u64::from(rate) * 100_000))
}

fn airtime(value: &[u8]) -> Result<Option<Duration>, DecodeError> {
    let us = parse_u64(value)?;
    Ok((us < LONGEST_US).then(|| Duration::from_micros(us)))
}

/// Decodes the survey of a channel; `None` if there is nothing but its frequency.
pub(crate) fn survey(body: &[u8]) -> Result<Option<Survey>, DecodeError> {
    let (mut frequency, mut in_use, mut noise, mut active, mut busy) = (None, false, None, None, None);
    for attribute in answer(body) {
        let (attr::SURVEY_INFO, info) = attribute? else { continue };
        for attribute in attributes(info) {
            match attribute? {
                (survey_info::FREQUENCY, value) => frequency = Some(parse_u32(value)?),
                (survey_info::NOISE, value) => noise = Some(Dbm(parse_i8(value)?.into())),
                (survey_info::IN_USE, _) => in_use = true,
                (survey_info::TIME, value) => active = Some(parse_u64(value)?),
                (survey_info::TIME_BUSY, value) => busy = Some(parse_u64(value)?),
                _ => {}
            }
        }
    }
    let times = active.zip(busy).map(|(active, busy)| Times { active, busy });
    let surveyed = in_use || noise.is_some() || times.is_some_and(|times| times.active > 0);
    Ok(frequency.filter(|_| surveyed).map(|frequency_mhz| Survey { frequency_mhz, in_use, noise, times }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{INTERFACES, NO_SURVEY, STATIONS, SURVEY, answers, attribute, generic, nested};

    fn byte(kind: u16, value: u8) -> Vec<u8> {
        attribute(kind, &[value])
    }

    fn word(kind: u16, value: u32) -> Vec<u8> {
        attribute(kind, &value.to_ne_bytes())
    }

    fn long(kind: u16, value: u64) -> Vec<u8> {
        attribute(kind, &value.to_ne_bytes())
    }

    fn rate_of(bitrate: Option<u16>, bitrate32: Option<u32>) -> Option<u64> {
        let short = bitrate.map(|rate| attribute(rate_info::BITRATE, &rate.to_ne_bytes()));
        let wide = bitrate32.map(|rate| word(rate_info::BITRATE32, rate));
        let info = [wide, short].into_iter().flatten().collect::<Vec<_>>().concat();
        rate(&info).unwrap().map(BitRate::bits_per_second)
    }

    #[test]
    fn captured_interfaces_have_their_roles_and_networks() {
        let interfaces = answers(INTERFACES, interface);
        let mut seen: Vec<_> =
            interfaces.iter().map(|i| (i.index, i.name.as_str(), i.role, i.ssid.as_deref())).collect();
        seen.sort_by_key(|interface| interface.0);
        let expected = [
            (2, "wlan0", WifiRole::AccessPoint, Some("corridor")),
            (3, "wlan1", WifiRole::Client, Some("corridor")),
            (4, "wlan2", WifiRole::Client, Some("corridor")),
            (5, "wlan3", WifiRole::Client, None),
        ];
        assert_eq!(seen, expected);
    }

    /// As `iw dev wlan0 station dump` showed them, beside the capture.
    #[test]
    fn captured_stations_have_what_iw_shows() {
        let stations = answers(STATIONS, station);
        let macs: Vec<_> = stations.iter().map(|station| station.mac.as_str()).collect();
        assert_eq!(macs, ["02:00:00:00:01:00", "02:00:00:00:02:00"]);
        for station in &stations {
            assert_eq!(station.signal, Some(Dbm(-30.0)));
            assert_eq!(station.transmit_rate.map(BitRate::bits_per_second), Some(1_000_000));
            assert_eq!(station.retransmissions, Some(0));
            assert!(station.inactive.is_some_and(|time| time < Duration::from_secs(10)), "{station:?}");
        }
    }

    #[test]
    fn captured_survey_has_the_scanned_channels() {
        let mut surveys = answers(SURVEY, survey);
        surveys.sort_by_key(|survey| survey.frequency_mhz);
        let channels: Vec<_> = surveys.iter().map(|survey| survey.frequency_mhz).collect();
        assert_eq!(channels, [2412, 2437, 2462]);
        for survey in surveys {
            let times = survey.times.unwrap();
            assert_eq!((survey.noise, survey.in_use), (Some(Dbm(-92.0)), false));
            // mac80211_hwsim counts an eighth of the time as busy.
            assert_eq!(times.busy, times.active / 8);
        }
        assert_eq!(answers(NO_SURVEY, survey), []);
    }

    #[test]
    fn every_figure_of_a_station_is_decoded() {
        let mac = attribute(attr::MAC, &[2, 0x77, 0, 0xab, 0, 1]);
        let bitrate = |rate: u32| [word(rate_info::BITRATE32, rate)];
        let info = nested(
            attr::STA_INFO,
            &[
                word(sta_info::INACTIVE_TIME, 1250),
                byte(sta_info::SIGNAL, -67_i8 as u8),
                nested(sta_info::TX_BITRATE, &bitrate(8667)),
                nested(sta_info::RX_BITRATE, &bitrate(65)),
                word(sta_info::TX_RETRIES, 17),
                word(sta_info::TX_FAILED, 3),
                long(sta_info::TX_DURATION, 1_500_000),
                long(sta_info::RX_DURATION, 500),
                attribute(999, b"a later kernel's"),
            ],
        );
        let decoded = station(&generic(&[mac.clone(), info])).unwrap().unwrap();
        let expected = WifiStation {
            mac: "02:77:00:ab:00:01".to_owned(),
            signal: Some(Dbm(-67.0)),
            transmit_rate: BitRate::from_mbps(866.7),
            receive_rate: BitRate::from_mbps(6.5),
            retransmissions: Some(17),
            transmissions_failed: Some(3),
            transmit_airtime: Some(Duration::from_millis(1500)),
            receive_airtime: Some(Duration::from_micros(500)),
            inactive: Some(Duration::from_millis(1250)),
        };
        assert_eq!(decoded, expected);

        let bare = station(&generic(&[mac])).unwrap().unwrap();
        assert_eq!((bare.signal, bare.transmit_rate, bare.inactive), (None, None, None));
        assert_eq!(station(&generic(&[])).unwrap(), None);
    }

    #[test]
    fn fast_rates_come_from_the_wider_attribute() {
        assert_eq!(rate_of(Some(540), None), Some(54_000_000));
        assert_eq!(rate_of(None, Some(96_078)), Some(9_607_800_000));
        assert_eq!(rate_of(Some(65_535), Some(96_078)), Some(9_607_800_000));
        assert_eq!(rate_of(Some(0), Some(0)), None);
        assert_eq!(rate_of(None, None), None);
    }

    #[test]
    fn channels_without_a_survey_are_left_out() {
        let channel = |info: &[Vec<u8>]| {
            let frequency = vec![word(survey_info::FREQUENCY, 5180)];
            let info = nested(attr::SURVEY_INFO, &[frequency, info.to_vec()].concat());
            survey(&generic(&[info])).unwrap()
        };
        assert_eq!(channel(&[]), None);
        assert_eq!(channel(&[long(survey_info::TIME, 0), long(survey_info::TIME_BUSY, 0)]), None);
        let in_use = channel(&[attribute(survey_info::IN_USE, &[])]).unwrap();
        assert!(in_use.in_use && in_use.times.is_none() && in_use.noise.is_none());
        let noise = channel(&[byte(survey_info::NOISE, -95_i8 as u8)]).unwrap();
        assert_eq!(noise.noise, Some(Dbm(-95.0)));
    }

    #[test]
    fn busy_share_needs_time_and_counters_that_grow() {
        let times = |active, busy| Times { active, busy };
        let share = |now: Times, before| now.busy_since(before).map(Probability::get);
        assert_eq!(share(times(2000, 500), times(1000, 250)), Some(0.25));
        assert_eq!(share(times(1000, 250), times(1000, 250)), None);
        assert_eq!(share(times(100, 10), times(1000, 250)), None);
        assert_eq!(share(times(2000, 10), times(1000, 250)), None);
        // A driver that reads the busy time a moment later.
        assert_eq!(share(times(1010, 262), times(1000, 250)), Some(1.0));
    }
}
