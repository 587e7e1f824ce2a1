//! The state of the testbed's radio at a time: attachments of stations (φ), reports of radio units (ι(R)), signals
//! that stations hear, and traffic on the wire behind a radio unit (λ).

use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
};

use cotorra_graph::{
    BitRate, Dbm, Direction, HardwareGraph, HostAddress, LinkContext, LinkId, NodeId, NodeKind, RadioContext,
    Rate, RobotContext, Timestamp, WaisSettings, WifiStandard,
};
pub use cotorra_mec::Scope;

use crate::{
    coding::{geolocation, operating_class, share},
    types::{ApIdentity, ApLocation, Mac, StaIdentity, WanMetrics},
};

/// The fixed part: radio units and stations, and their identities.
#[derive(Debug)]
pub struct Site {
    units: Vec<Unit>,
    stations: HashMap<NodeId, StaIdentity>,
}

#[derive(Debug)]
pub(crate) struct Unit {
    id: NodeId,
    pub(crate) identity: ApIdentity,
    pub(crate) network: String,
    pub(crate) ssid: String,
    pub(crate) channel: u8,
    pub(crate) standard: WifiStandard,
    pub(crate) operating_class: Option<u8>,
    pub(crate) fast_transition: bool,
    pub(crate) noise_floor: Dbm,
    pub(crate) location: Option<ApLocation>,
    /// Whether it is in the service's scope.
    served: bool,
    uplink: Option<Uplink>,
}

/// The only wired link of a radio unit.
#[derive(Debug)]
struct Uplink {
    link: LinkId,
    /// The direction that leads to the radio unit.
    down: Direction,
    medium: BitRate,
}

/// The state at a time.
#[derive(Debug, Clone)]
pub struct Survey {
    pub at: Timestamp,
    pub(crate) site: Arc<Site>,
    pub(crate) access_points: Vec<AccessPoint>,
    pub(crate) stations: Vec<Station>,
    /// Channel load from 0 to 1, of each radio unit that reported it.
    loads: HashMap<usize, f64>,
}

/// An access point in scope.
#[derive(Debug, Clone)]
pub(crate) struct AccessPoint {
    unit: usize,
    pub(crate) load: Option<f64>,
    pub(crate) wan: Option<WanMetrics>,
    /// Indices into the survey's stations.
    pub(crate) associated: Vec<usize>,
}

/// A station associated with an access point in scope.
#[derive(Debug, Clone)]
pub(crate) struct Station {
    pub(crate) identity: StaIdentity,
    /// Index of its access point among the units.
    unit: usize,
    pub(crate) reception: Option<Reception>,
    /// Units that it hears.
    heard: Vec<(usize, Dbm)>,
}

/// An access point's knowledge of a station.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reception {
    pub(crate) signal: Dbm,
    pub(crate) downlink_kbps: u32,
    pub(crate) uplink_kbps: u32,
}

impl Site {
    /// Collects the radio units and robots of a graph.
    pub fn new(graph: &HardwareGraph, settings: &WaisSettings, scope: &Scope) -> Self {
        let (mut units, mut stations) = (Vec::new(), HashMap::new());
        for (place, node) in graph.hosts().enumerate() {
            let address = HostAddress::of(place);
            let ip: Arc<[String]> = [address.ipv4.to_string(), address.ipv6.to_string()].into();
            match &node.kind {
                NodeKind::RadioUnit(unit) => {
                    // A validated graph has the network of each radio unit.
                    let Some(network) = graph.wireless.get(&unit.network) else { continue };
                    let located = settings.origin.as_ref().zip(node.position);
                    let location = located.map(|(origin, place)| geolocation(origin, place));
                    let mut wires = graph.links.iter().filter(|link| link.ends.contains(&node.id));
                    let uplink = wires.next().filter(|_| wires.next().is_none()).map(|link| {
                        let is_second = link.ends[1] == node.id;
                        let down = if is_second { Direction::Forward } else { Direction::Backward };
                        Uplink { link: link.id.clone(), down, medium: link.medium }
                    });
                    let ssid = graph.ssid(&unit.network);
                    units.push(Unit {
                        id: node.id.clone(),
                        identity: ApIdentity {
                            bssid: Mac(address.mac),
                            ssid: [ssid.to_owned()].into(),
                            ip_address: ip,
                        },
                        network: unit.network.clone(),
                        ssid: ssid.to_owned(),
                        channel: unit.channel,
                        standard: network.standard,
                        operating_class: operating_class(network.standard, unit.channel),
                        fast_transition: network.fast_transition,
                        noise_floor: network.noise_floor,
                        location: location.map(|geolocation| ApLocation { geolocation }),
                        served: scope.covers(&node.domain),
                        uplink,
                    });
                }
                NodeKind::Robot(robot) => {
                    let ssid = [graph.ssid(&robot.network).to_owned()].into();
                    let identity = StaIdentity { mac_id: Mac(address.mac), ssid, ip_address: ip };
                    stations.insert(node.id.clone(), identity);
                }
                NodeKind::Switch | NodeKind::Server(_) | NodeKind::Gateway(_) | NodeKind::Machine(_) => {}
            }
        }
        Self { units, stations }
    }

    /// Whether an access point in scope has this address.
    pub(crate) fn serves(&self, bssid: Mac) -> bool {
        self.units.iter().any(|unit| unit.served && unit.identity.bssid == bssid)
    }

    /// Surveys the state. A station is where it reports to be attached (φ), or where a radio unit reports it (ι)
    /// before the station's first report.
    pub fn survey(
        self: &Arc<Self>,
        at: Timestamp,
        radio: &BTreeMap<NodeId, RadioContext>,
        robots: &BTreeMap<NodeId, RobotContext>,
        links: &BTreeMap<(LinkId, Direction), LinkContext>,
    ) -> Survey {
        let places: HashMap<_, _> = self.units.iter().enumerate().map(|(i, unit)| (&unit.id, i)).collect();
        let mut received: HashMap<(&NodeId, usize), Reception> = HashMap::new();
        let mut reported: HashMap<&NodeId, usize> = HashMap::new();
        let mut loads = HashMap::new();
        for (unit, context) in radio.values().filter_map(|c| Some((*places.get(&c.radio_unit)?, c))) {
            loads.extend(context.load.map(|load| (unit, load)));
            for station in &context.stations {
                let kbps = |bps: f64| (bps / 1e3).round() as u32;
                let (downlink_kbps, uplink_kbps) = (kbps(station.downlink_bps), kbps(station.uplink_bps));
                let reception = Reception { signal: station.signal, downlink_kbps, uplink_kbps };
                received.insert((&station.robot, unit), reception);
                reported.insert(&station.robot, unit);
            }
        }
        let mut access_points: Vec<_> = self
            .units
            .iter()
            .enumerate()
            .filter(|(_, unit)| unit.served)
            .map(|(i, unit)| AccessPoint {
                unit: i,
                load: loads.get(&i).copied(),
                wan: unit.uplink.as_ref().and_then(|uplink| uplink.metrics(links)),
                associated: Vec::new(),
            })
            .collect();
        let ap_places: HashMap<_, _> = access_points.iter().enumerate().map(|(i, ap)| (ap.unit, i)).collect();
        let mut known: Vec<_> = self.stations.iter().collect();
        known.sort_unstable_by_key(|(_, identity)| identity.mac_id);
        let mut stations = Vec::new();
        for (robot, identity) in known {
            let context = robots.get(robot);
            let attached =
                context.map(|context| context.attached_to().and_then(|id| places.get(id)).copied());
            let Some(unit) = attached.unwrap_or_else(|| reported.get(robot).copied()) else { continue };
            let Some(ap) = ap_places.get(&unit) else { continue };
            access_points[*ap].associated.push(stations.len());
            let attachments = context.map(|context| context.attachments.as_slice()).unwrap_or_default();
            let heard = attachments.iter().filter_map(|a| Some((*places.get(&a.radio_unit)?, a.signal?)));
            stations.push(Station {
                identity: identity.clone(),
                unit,
                reception: received.get(&(robot, unit)).copied(),
                heard: heard.collect(),
            });
        }
        Survey { at, site: Arc::clone(self), access_points, stations, loads }
    }
}

impl Uplink {
    fn metrics(&self, links: &BTreeMap<(LinkId, Direction), LinkContext>) -> Option<WanMetrics> {
        let other = match self.down {
            Direction::Forward => Direction::Backward,
            Direction::Backward => Direction::Forward,
        };
        let of = |direction| {
            let context = links.get(&(self.link.clone(), direction))?;
            let rate = match context.effective.rate {
                Rate::Unlimited => self.medium,
                Rate::Fixed { bits_per_second } => bits_per_second,
                // A trace has no current rate.
                Rate::Trace { .. } | Rate::NamedTrace(_) => return None,
            };
            let kbps = u32::try_from(rate.bits_per_second() / 1000).unwrap_or(u32::MAX);
            Some((kbps, share(context.throughput_bps / rate.bits_per_second() as f64)))
        };
        let ((downlink_speed, downlink_load), (uplink_speed, uplink_load)) = (of(self.down)?, of(other)?);
        let symmetric = if downlink_speed == uplink_speed { 4 } else { 0 };
        Some(WanMetrics {
            wan_info: 1 | symmetric,
            downlink_speed,
            uplink_speed,
            downlink_load,
            uplink_load,
            lmd: 10,
        })
    }
}

impl Survey {
    /// Returns a survey in which nothing is known yet.
    pub(crate) fn empty(site: &Arc<Site>) -> Self {
        site.survey(Timestamp::ZERO, &BTreeMap::new(), &BTreeMap::new(), &BTreeMap::new())
    }

    pub(crate) fn unit(&self, ap: &AccessPoint) -> &Unit {
        &self.site.units[ap.unit]
    }

    pub(crate) fn unit_of(&self, station: &Station) -> &Unit {
        &self.site.units[station.unit]
    }

    /// Returns the access point with this address, if it is in scope.
    pub(crate) fn access_point(&self, bssid: Mac) -> Option<&AccessPoint> {
        self.access_points.iter().find(|ap| self.unit(ap).identity.bssid == bssid)
    }

    /// Returns the station with this address, if it is associated with an access point in scope.
    pub(crate) fn station(&self, mac: Mac) -> Option<&Station> {
        let place = self.stations.binary_search_by_key(&mac, |station| station.identity.mac_id).ok()?;
        Some(&self.stations[place])
    }

    /// Returns the radio units that a station hears, in any domain, with their signals.
    pub(crate) fn heard<'a>(&'a self, station: &'a Station) -> impl Iterator<Item = (&'a Unit, Dbm)> {
        station.heard.iter().map(|(unit, signal)| (&self.site.units[*unit], *signal))
    }

    /// Returns the radio units in scope.
    pub(crate) fn units(&self) -> impl Iterator<Item = &Unit> {
        self.access_points.iter().map(|ap| self.unit(ap))
    }

    /// Returns the load of a channel as reported by a radio unit on it; `None` without one.
    pub(crate) fn channel_load(&self, operating_class: u8, channel: u8) -> Option<f64> {
        let on_it = |unit: &Unit| unit.operating_class == Some(operating_class) && unit.channel == channel;
        let mut units = self.site.units.iter().enumerate();
        units.find_map(|(i, unit)| self.loads.get(&i).copied().filter(|_| on_it(unit)))
    }
}
