//! Computes measurement reports from a survey: channel loads, beacons that stations hear, neighbors that they could
//! roam to.

use std::sync::Arc;

use cotorra_graph::Dbm;

use crate::{
    coding::{phy_type, rcpi, rsni, share},
    requests::{
        BeaconReportingConfig, BeaconRequestConfig, ChannelLoadConfig, MeasurementInfo, NeighborReportConfig,
    },
    survey::{Station, Survey, Unit},
    types::{
        BeaconReport, BssCapabilities, BssidInfo, ChannelLoad, Mac, NeighborReport, ReportedBeaconFrameInfo,
        StaIdentity,
    },
};

/// Duration of a load measurement in units of 1024 µs. A load is measured over a second, but the standard's type
/// holds no more.
const MEASUREMENT_DURATION: u8 = 255;

/// Reports by kind.
#[derive(Debug, Default)]
pub(crate) struct Reports {
    pub(crate) beacon_report: Vec<BeaconReport>,
    pub(crate) neighbor_report: Vec<NeighborReport>,
    pub(crate) channel_load: Vec<ChannelLoad>,
}

/// A measurement of one station.
pub(crate) struct Measured<'a> {
    pub(crate) survey: &'a Survey,
    pub(crate) station: &'a Station,
    pub(crate) id: &'a Arc<str>,
    /// Whether reports name the station.
    pub(crate) named: bool,
}

impl Measured<'_> {
    /// Adds the reports of this measurement.
    pub(crate) fn report(&self, info: &MeasurementInfo, reports: &mut Reports) {
        if let Some(wanted) = &info.channel_load_conf {
            reports.channel_load.extend(self.channel_load(wanted));
        }
        if let Some(wanted) = &info.beacon_request_conf {
            self.beacons(wanted, &mut reports.beacon_report);
        }
        if let Some(wanted) = &info.neighbor_report_conf {
            self.neighbors(wanted, &mut reports.neighbor_report);
        }
    }

    fn sta_id(&self) -> Option<StaIdentity> {
        self.named.then(|| self.station.identity.clone())
    }

    fn channel_load(&self, wanted: &ChannelLoadConfig) -> Option<ChannelLoad> {
        let load = share(self.survey.channel_load(wanted.operating_class, wanted.channel)?);
        let threshold = wanted.threshold.unwrap_or_default();
        let is_wanted = match wanted.reporting_condition.unwrap_or_default() {
            1 => load >= threshold,
            2 => load <= threshold,
            _ => true,
        };
        is_wanted.then(|| ChannelLoad {
            sta_id: self.sta_id(),
            measurement_id: Arc::clone(self.id),
            operating_class: wanted.operating_class,
            channel: wanted.channel,
            measurement_duration: MEASUREMENT_DURATION,
            channel_load: load,
        })
    }

    fn beacons(&self, wanted: &BeaconRequestConfig, reports: &mut Vec<BeaconReport>) {
        let serving_unit = self.survey.unit_of(self.station);
        let mut heard = self.survey.heard(self.station);
        let serving = heard.find(|(unit, _)| unit.identity.bssid == serving_unit.identity.bssid);
        let serving = serving.map(|(unit, signal)| Levels::new(unit, signal));
        for (unit, signal) in self.survey.heard(self.station) {
            let Some(operating_class) = unit.operating_class else { continue };
            let is_asked = operating_class == wanted.operating_class
                && (matches!(wanted.channel_id, 0 | 255) || wanted.channel_id == unit.channel)
                && wanted.bssid.is_none_or(|bssid| bssid == unit.identity.bssid)
                && wanted.ssid.as_ref().is_none_or(|ssid| *ssid == unit.ssid);
            let levels = Levels::new(unit, signal);
            if is_asked && levels.meet(&wanted.beacon_reporting_conf, serving) {
                let phy_type = phy_type(unit.standard);
                reports.push(BeaconReport {
                    sta_id: self.sta_id(),
                    measurement_id: Arc::clone(self.id),
                    operating_class,
                    channel: unit.channel,
                    reported_frame_info: ReportedBeaconFrameInfo { phy_type, frame_type: 0 },
                    bssid: unit.identity.bssid,
                    ssid: unit.ssid.clone(),
                    rcpi: levels.rcpi,
                    rsni: levels.rsni,
                });
            }
        }
    }

    fn neighbors(&self, wanted: &NeighborReportConfig, reports: &mut Vec<NeighborReport>) {
        let serving = self.survey.unit_of(self.station);
        // Networks may have the same SSID.
        let is_wanted = |unit: &Unit| match &wanted.ssid {
            Some(ssid) => unit.ssid == *ssid,
            None => unit.network == serving.network,
        };
        // Without an SSID, the BSSID is ignored, too.
        let bssid: Option<Mac> = wanted.bssid.filter(|_| wanted.ssid.is_some());
        for unit in self.survey.units() {
            let Some(operating_class) = unit.operating_class else { continue };
            let is_other = unit.identity.bssid != serving.identity.bssid;
            if is_other && is_wanted(unit) && bssid.is_none_or(|bssid| bssid == unit.identity.bssid) {
                reports.push(NeighborReport {
                    sta_id: self.sta_id(),
                    measurement_id: Arc::clone(self.id),
                    bssid: unit.identity.bssid,
                    bssid_info: bssid_info(unit, serving),
                    operating_class,
                    channel: unit.channel,
                    phy_type: phy_type(unit.standard),
                });
            }
        }
    }
}

/// Returns the properties of an emulated access point as seen from the serving one.
fn bssid_info(unit: &Unit, serving: &Unit) -> BssidInfo {
    use cotorra_graph::WifiStandard::Ac;
    let same = unit.network == serving.network;
    BssidInfo {
        // Access points of the same network are reachable. For others this is unknown.
        ap_reachability: if same { 3 } else { 2 },
        security: same,
        capabilities: BssCapabilities {
            spectrum_management: false,
            qos: false,
            apsd: false,
            radio_measurements: true,
            delayed_back: false,
            immediate_back: false,
        },
        mobility_domain: same && unit.fast_transition,
        high_throughput: unit.standard.aggregates(),
        very_high_throughput: unit.standard == Ac,
        ftm: false,
    }
}

/// Strength of a received beacon.
#[derive(Debug, Clone, Copy)]
struct Levels {
    rcpi: u8,
    rsni: u8,
}

impl Levels {
    fn new(unit: &Unit, signal: Dbm) -> Self {
        Self { rcpi: rcpi(signal), rsni: rsni(signal, unit.noise_floor) }
    }

    /// Whether the reporting condition is met (IEEE 802.11-2016, Table 9-89). Conditions relative to a serving access
    /// point that is not heard are never met.
    fn meet(self, wanted: &BeaconReportingConfig, serving: Option<Self>) -> bool {
        let threshold = i16::from(wanted.threshold);
        let offset = i16::from(wanted.threshold as i8);
        let (rcpi, rsni) = (i16::from(self.rcpi), i16::from(self.rsni));
        let beside = |level: i16, reference: fn(Self) -> u8, is_met: fn(i16, i16, i16) -> bool| {
            serving.is_some_and(|serving| {
                let reference = i16::from(reference(serving));
                is_met(level, reference, reference + offset)
            })
        };
        match wanted.reporting_condition {
            1 => rcpi > threshold,
            2 => rcpi < threshold,
            3 => rsni > threshold,
            4 => rsni < threshold,
            5 => beside(rcpi, |s| s.rcpi, |level, _, moved| level > moved),
            6 => beside(rcpi, |s| s.rcpi, |level, _, moved| level < moved),
            7 => beside(rsni, |s| s.rsni, |level, _, moved| level > moved),
            8 => beside(rsni, |s| s.rsni, |level, _, moved| level < moved),
            9 => beside(rcpi, |s| s.rcpi, is_between),
            10 => beside(rsni, |s| s.rsni, is_between),
            _ => true,
        }
    }
}

fn is_between(level: i16, one: i16, other: i16) -> bool {
    (one.min(other)..=one.max(other)).contains(&level)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reporting_conditions_follow_the_standard() {
        let serving = Levels { rcpi: 100, rsni: 60 };
        let stronger = Levels { rcpi: 110, rsni: 70 };
        let weaker = Levels { rcpi: 90, rsni: 50 };
        // An offset of -6, that is 250, and one of 6.
        for (condition, threshold, expected) in [
            (0, 0, [true, true]),
            (1, 100, [true, false]),
            (2, 100, [false, true]),
            (3, 60, [true, false]),
            (4, 60, [false, true]),
            (5, 6, [true, false]),
            (5, 250, [true, false]),
            (6, 250, [false, true]),
            (7, 6, [true, false]),
            (8, 6, [false, true]),
            (9, 10, [true, false]),
            (9, 246, [false, true]),
            (10, 10, [true, false]),
        ] {
            let wanted = BeaconReportingConfig { reporting_condition: condition, threshold };
            let met = [stronger, weaker].map(|levels| levels.meet(&wanted, Some(serving)));
            assert_eq!(met, expected, "{condition} {threshold}");
        }
        let beside = BeaconReportingConfig { reporting_condition: 5, threshold: 0 };
        assert!(!stronger.meet(&beside, None));
    }
}
