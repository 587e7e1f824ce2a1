//! Nodes, and the wireless networks that connect them.

use std::{sync::Arc, time::Duration};

use cotorra_graph::{
    AgentId, BackgroundScan, Band, ChannelWidth, DomainId, Fading, Frames, Gateway, GuardInterval,
    HandoverTimes, HostAddress, Loss, Machine, Node, NodeId, NodeKind, OccupancyGrid, PassiveVisits,
    PathLoss, Position, Probability, RadioUnit, Reached, RealServer, Roaming, Robot, RobotClock, ScanVisits,
    Server, Shadowing, Walls, WifiStandard, WirelessNetwork,
};

use super::{
    builder::{Builder, each, find},
    ros, sensors,
};
use crate::{
    records::{
        AccessWord, ExchangeRecord, ExchangeWord, FadingRecord, FadingWord, GatewayRecord, MachineRecord,
        NodeRecord, PathLossRecord, RoamingRecord, ScanRecord, ServerRecord, SupplicantRecord, WalkRecord,
        WallsRecord, WifiWord, WirelessRecord,
    },
    walls::WallLoss,
    yaml::{
        Sink,
        decode::{Either, Spanned, words},
    },
};

/// Loss of one wall, at most, dB. A shielded room has as much.
const MOST_OF_A_WALL_DB: f64 = 100.0;
/// Interval of timers with 250 a second, as Debian's kernels have them.
const USUAL_TICK: Duration = Duration::from_millis(4);
/// Shortest time between background scans: the unit of wpa_supplicant's intervals.
const SHORTEST_SCAN_INTERVAL: Duration = Duration::from_secs(1);

impl Builder<'_> {
    pub(super) fn wireless(
        &mut self,
        ssid: &Spanned<String>,
        record: &WirelessRecord,
        map: Option<&Arc<OccupancyGrid>>,
    ) -> Option<WirelessNetwork> {
        if ssid.value.len() > 32 {
            self.sink
                .error(&ssid.span, format!("this SSID has {} bytes", ssid.value.len()))
                .help("IEEE 802.11 allows 32");
        }
        let correlation = &record.shadowing.correlation;
        if correlation.value.0 == 0.0 {
            self.sink
                .error(&correlation.span, "a correlation distance of zero")
                .help("write one above zero, such as `5 m`; `deviation: 0 dB` switches shadowing off");
        }
        let loss = match &record.loss {
            None => Loss::None,
            Some(loss) => self.loss(loss)?,
        };
        let walls = match &record.walls {
            None => None,
            Some(walls) => Some(self.walls(walls, self.band(ssid, record.standard), map)?),
        };
        self.check_rates(record);
        let handover = &record.handover;
        let (scan, visits) = self.scan(&handover.scan);
        Some(WirelessNetwork {
            standard: record.standard,
            width: record.width.value,
            streams: record.streams.value,
            guard_interval: record.guard_interval.value,
            delay: record.delay,
            rate: record.rate,
            loss,
            fast_transition: record.fast_transition,
            mobility_domain: record.mobility_domain,
            path_loss: match &record.path_loss {
                PathLossRecord::FreeSpace(_) => PathLoss::FreeSpace,
                PathLossRecord::LogDistance(model) => PathLoss::LogDistance { exponent: model.exponent.0 },
                PathLossRecord::ItuIndoor(model) => PathLoss::ItuIndoor {
                    coefficient: model.coefficient.0,
                    floor_loss_db: model.floor_loss.0,
                },
            },
            walls,
            shadowing: Shadowing {
                deviation_db: record.shadowing.deviation.0,
                correlation_m: correlation.value.0,
            },
            fading: record.fading.as_ref().map(fading),
            noise_floor: record.noise_floor,
            hysteresis_db: record.hysteresis.0,
            time_to_trigger: record.time_to_trigger,
            handover: HandoverTimes {
                scan,
                visits,
                scan_first: handover.scan_first,
                scan_every: self.scan_every(handover.scan_every.as_ref()),
                authenticate: handover.authenticate,
                reassociate: handover.reassociate,
                handshake: handover.handshake,
                variation: handover.variation.get(),
                frames: self.frames(record)?,
            },
            gap: record.gap,
            access: self.access(ssid, record)?,
        })
    }

    /// Returns the band of a network's radio units.
    fn band(&self, ssid: &Spanned<String>, standard: WifiStandard) -> Band {
        let mut channels = self.record.nodes.0.iter().filter_map(|(_, node)| match node {
            NodeRecord::RadioUnit(unit) => {
                let is_here = unit.network.as_ref().is_none_or(|network| network.value == ssid.value);
                is_here.then_some(unit.channel.value)
            }
            _ => None,
        });
        standard.band(channels.next().unwrap_or(1))
    }

    /// Checks that the standard has the width, streams and guard interval of a network, and its software, too.
    fn check_rates(&mut self, record: &WirelessRecord) {
        use GuardInterval::{Ns400, Ns800, Ns1600, Ns3200};
        let (widest, streams, guard_intervals): (_, _, &[_]) = match record.standard {
            WifiStandard::G | WifiStandard::A => (ChannelWidth::Mhz20, 1, &[Ns800]),
            WifiStandard::N => (ChannelWidth::Mhz40, 2, &[Ns400, Ns800]),
            WifiStandard::Ac => (ChannelWidth::Mhz80, 2, &[Ns400, Ns800]),
            WifiStandard::Ax => (ChannelWidth::Mhz80, 2, &[Ns800, Ns1600, Ns3200]),
        };
        let name = record.standard.described();
        if record.width.value > widest {
            self.sink
                .error(
                    &record.width.span,
                    format!("{name} has no channels of {} MHz", record.width.value.mhz()),
                )
                .help(format!("write at most `{} MHz`", widest.mhz()));
        }
        if !(1..=streams).contains(&record.streams.value) {
            self.sink
                .error(&record.streams.span, format!("{} streams with {name}", record.streams.value))
                .help(if streams == 1 { "write 1, or `standard: n`, `ac` or `ax`" } else { "write 1 or 2" });
        }
        if !guard_intervals.contains(&record.guard_interval.value) {
            let written: Vec<_> = guard_intervals.iter().map(|its| format!("`{} ns`", its.ns())).collect();
            self.sink
                .error(
                    &record.guard_interval.span,
                    format!("{name} has no guard interval of {} ns", record.guard_interval.value.ns()),
                )
                .help(format!("write {}", written.join(" or ")));
        }
        let is_usual = record.standard != WifiStandard::Ax
            && record.width.value == ChannelWidth::Mhz20
            && record.streams.value == 1
            && record.guard_interval.value == Ns800;
        if record.wifi.value != WifiWord::Model && !is_usual {
            self.sink
                .error(&record.wifi.span, "hostapd with settings that only the model has")
                .help("leave `width`, `streams` and `guard_interval` out, and write `standard: n` or `ac`");
        }
    }

    /// Returns how a network's handovers are frames on the air; `Some(None)` if they are not.
    fn frames(&mut self, record: &WirelessRecord) -> Option<Option<Frames>> {
        let exchange = &record.handover.exchange;
        let tick = match &exchange.value {
            Either::Short(ExchangeWord::Times) => return Some(None),
            Either::Short(ExchangeWord::Frames) => USUAL_TICK,
            Either::Long(ExchangeRecord { tick }) => *tick,
        };
        if let Either::Short(AccessWord::Turns) = record.access.value {
            self.sink
                .error(&exchange.span, "frames of handovers in a network whose senders take turns")
                .help("leave `access: turns` out, or write `exchange: times`");
            return None;
        }
        Some(Some(Frames { tick }))
    }

    /// Returns the time from one scan to the next.
    fn scan_every(&mut self, every: Option<&Spanned<Duration>>) -> Option<Duration> {
        let every = every?;
        if every.value < SHORTEST_SCAN_INTERVAL {
            self.sink
                .error(&every.span, "less than a second from scan to scan")
                .help("write `1 s` or more; NetworkManager waits up to `120 s`");
        }
        Some(every.value)
    }

    /// Returns the duration of a scan, and its visits of other channels.
    fn scan(&mut self, record: &Either<Duration, ScanRecord>) -> (Duration, Option<ScanVisits>) {
        let ScanRecord { channels, dwell, passive, listen, away, back } = match record {
            Either::Short(whole) => return (*whole, None),
            Either::Long(record) => record,
        };
        if channels.value == 0 && *passive == 0 {
            self.sink
                .error(&channels.span, "a scan of no channels")
                .help("write how many there are, such as `13` at 2.4 GHz");
        }
        let passive = (*passive > 0).then_some(PassiveVisits { channels: *passive, dwell: listen.value });
        let longest = passive.map_or(dwell.value, |passive| passive.dwell.max(dwell.value));
        let empty =
            [Some(dwell), passive.map(|_| listen)].into_iter().flatten().find(|time| time.value.is_zero());
        if let Some(empty) = empty {
            self.sink
                .error(&empty.span, "a scan that stays on no channel")
                .help("write a time above zero; Linux takes `60 ms`, or `111 ms` where it may only listen");
        } else if away.value < longest {
            self.sink
                .error(&away.span, "a shorter absence than one channel takes")
                .help("write at least the `dwell` and the `listen`; Linux has `125 ms`");
        }
        let probed = dwell.value * u32::from(channels.value);
        let visits = ScanVisits { dwell: dwell.value, passive, away: away.value, back: *back };
        (probed + passive.map_or(Duration::ZERO, |passive| passive.whole()), Some(visits))
    }

    fn walls(
        &mut self,
        record: &Spanned<Either<WallLoss, WallsRecord>>,
        band: Band,
        map: Option<&Arc<OccupancyGrid>>,
    ) -> Option<Walls> {
        let (each, place, at_most) = match &record.value {
            Either::Short(each) => (each, &record.span, None),
            Either::Long(long) => (&long.each.value, &long.each.span, long.at_most.as_ref()),
        };
        let loss_db = each.db(band);
        if loss_db > MOST_OF_A_WALL_DB {
            self.sink.error(place, format!("a wall that takes {loss_db} dB away")).help(format!(
                "write at most {MOST_OF_A_WALL_DB} dB, as a shielded room has; a brick wall has about 4 dB"
            ));
        }
        if let Some(most) = at_most.filter(|most| most.value.0 < loss_db) {
            self.sink
                .error(&most.span, format!("less than the {loss_db} dB of one wall"))
                .help(format!("write {loss_db} dB or more, or leave `at_most` out"));
        }
        // A map that cannot be read is reported there.
        if self.record.map.is_none() {
            self.sink
                .error(&record.span, "walls in a testbed without a map")
                .help("add `map: …` with a ROS map_server file, whose occupied cells are the walls");
        }
        let loss = cotorra_graph::WallLoss { loss_db, at_most_db: at_most.map(|most| most.value.0) };
        Some(Walls { loss, map: Arc::clone(map?) })
    }

    pub(super) fn nodes(&mut self) -> Option<Vec<Node>> {
        let records = &self.record.nodes.0;
        let hosts = records.iter().filter(|(_, n)| is_host(n));
        if let Some((id, _)) = hosts.clone().nth(HostAddress::MAX_HOSTS) {
            let message = format!("there are {} hosts", hosts.count());
            let help = format!("a testbed has addresses for {}", HostAddress::MAX_HOSTS);
            self.sink.error(&id.span, message).help(help);
        }
        if records.is_empty() {
            self.sink
                .error(&self.record.name.span, "this testbed has no nodes")
                .help("describe them under `nodes:`, such as `fog: { kind: server, … }`");
        }
        each(records, |(id, record)| self.build_node(id, record))
    }

    fn build_node(&mut self, id: &Spanned<NodeId>, record: &NodeRecord) -> Option<Node> {
        let domain = self.domain(record.domain());
        let (position, kind) = match record {
            NodeRecord::Robot(r) => {
                let position = self.start(id, r.position.as_ref());
                let network = self.network(id, r.network.as_ref());
                let places = (r.agent.as_ref(), r.interface.as_ref());
                let radio = network.as_ref().and_then(|network| self.radio(id, network, places, None));
                let walk = self.record.walks.0.iter().find(|(robot, _)| robot.value == id.value);
                let facing = |walk: &WalkRecord| {
                    let way: Vec<_> = walk.waypoints.value.iter().take(2).map(|w| w.value).collect();
                    if let [from, to] = way[..] { (to.y - from.y).atan2(to.x - from.x) } else { 0.0 }
                };
                let nodes = &self.nodes;
                let mut host = |node: &Spanned<NodeId>, sink: &mut Sink| {
                    find(nodes, node, "node with a network of its own", has_namespace, sink)
                };
                let at_ports = r.interface.is_none() && radio == Some(None);
                let driver = ros::driver(r, &id.value, at_ports, &mut host, self.sink);
                let robot = Robot {
                    capacity: self.capacity(r.cpus, r.memory, r.accelerators.as_ref())?,
                    model: r.model,
                    network: network?,
                    tx_power: r.tx_power,
                    heading: r.heading.map_or_else(|| walk.map_or(0.0, |(_, w)| facing(w)), |a| a.0),
                    roaming: self.roaming(&r.roaming),
                    sensors: sensors::sensors(r, driver.as_ref(), self.sink),
                    clock: RobotClock { phase: r.clock.phase, drift_ppm: r.clock.drift.0 },
                    driver: driver?,
                    radio: radio?,
                    power: self.robot_power(r)?,
                };
                (Some(position?), NodeKind::Robot(robot))
            }
            NodeRecord::RadioUnit(r) => {
                let network = self.network(id, r.network.as_ref())?;
                let places = (r.agent.as_ref(), r.interface.as_ref());
                let unit = RadioUnit {
                    capacity: self.capacity(r.cpus, r.memory, None)?,
                    radio: self.radio(id, &network, places, r.bridge.as_ref())?,
                    network,
                    channel: r.channel.value,
                    tx_power: r.tx_power,
                    serving: r.serving,
                    deployment: r.deployment,
                    agent: r.agent.as_ref().map(|agent| agent.value.clone()),
                };
                (Some(r.position), NodeKind::RadioUnit(unit))
            }
            NodeRecord::Switch(s) => (s.position, NodeKind::Switch),
            NodeRecord::Server(s) => {
                let server = Server {
                    tier: s.tier,
                    capacity: self.capacity(s.cpus, s.memory, s.accelerators.as_ref())?,
                    cost: s.cost.0,
                    used_cost: s.used_cost.0,
                    memory_cost: s.memory_cost.0,
                    migration_cost: s.migration_cost.0,
                    reliability: self.reliability(&s.reliability),
                    speed: self.speed(&s.speed)?,
                    power: self.server_power(s.power.as_ref())?,
                    real: self.real_server(s)?,
                };
                (s.position, NodeKind::Server(server))
            }
            NodeRecord::Gateway(g) => (g.position, NodeKind::Gateway(self.gateway(g)?)),
            NodeRecord::Machine(m) => (m.position, NodeKind::Machine(self.machine(m)?)),
        };
        Some(Node { id: id.value.clone(), domain: domain?, position, kind })
    }

    fn roaming(&mut self, record: &Either<Roaming, RoamingRecord>) -> Roaming {
        let SupplicantRecord { threshold, short_interval, long_interval } = match record {
            Either::Short(roaming) => return *roaming,
            Either::Long(RoamingRecord::Supplicant(record)) => record,
        };
        if short_interval.value < SHORTEST_SCAN_INTERVAL {
            self.sink
                .error(&short_interval.span, "less than a second from scan to scan")
                .help("write `1 s` or more, as wpa_supplicant's whole seconds; its default is `30 s`");
        } else if long_interval.value < short_interval.value {
            self.sink
                .error(&long_interval.span, "the long interval is shorter than the short one")
                .help("it holds where the signal is good: write at least the short interval");
        }
        Roaming::Supplicant(BackgroundScan {
            threshold: *threshold,
            short_interval: short_interval.value,
            long_interval: long_interval.value,
        })
    }

    fn machine(&mut self, record: &MachineRecord) -> Option<Machine> {
        let agent = record.agent.as_ref().map(|agent| agent.value.clone());
        let Some(interface) = &record.interface else {
            if let Some(via) = &record.via {
                self.sink.error(&via.span, "`via`, and no interface through which it is reached").help(
                    format!("name an interface of the machine of `{}`, such as `interface: eth1`", via.value),
                );
                return None;
            }
            if let Some(address) = &record.address {
                self.sink
                    .error(&address.span, "an address, and no interface through which it is reached")
                    .help("name the interface, such as `interface: eth1`; `ip route get ADDRESS` says which it is");
                return None;
            }
            return Some(Machine { reached: None, agent });
        };
        let name = self.interface(interface)?;
        let via =
            record.via.as_ref().map(|via| self.agent_of(via)).map_or(Some(None), |agent| agent.map(Some))?;
        let address = record.address.as_ref().map(|address| address.value);
        let reflector = record.reflector.value;
        if reflector && !address.is_some_and(|address| address.is_one()) {
            self.sink
                .error(&record.reflector.span, "a reflector, and not the one address at which it is")
                .help("write the machine's own, such as `address: 192.168.1.7`");
        }
        if let Some(agent) = &record.agent
            && !address.is_some_and(|address| address.is_one())
        {
            self.sink
                .error(&agent.span, "an agent, and not the one address of its machine")
                .help("write the machine's own, such as `address: 192.168.1.7`");
        }
        Some(Machine { reached: Some(Reached { via, interface: name, address, reflector }), agent })
    }

    /// Returns the agent of a machine that `via` names.
    fn agent_of(&mut self, via: &Spanned<NodeId>) -> Option<AgentId> {
        match self.nodes.get(via.value.as_str()) {
            Some(NodeRecord::Machine(MachineRecord { agent: Some(agent), .. })) => Some(agent.value.clone()),
            Some(node) => {
                let (what, help) = match node {
                    NodeRecord::Machine(_) => {
                        ("a machine without an agent", "give it one, such as `agent: gate1`")
                    }
                    _ => ("no real machine", "name a node with `kind: machine` and an `agent`"),
                };
                self.sink.error(&via.span, format!("`{}` is {what}", via.value)).help(help);
                None
            }
            None => {
                let machines =
                    self.record.nodes.0.iter().filter(|(_, node)| matches!(node, NodeRecord::Machine(_)));
                let names: Vec<_> = machines.map(|(id, _)| id.value.as_str()).collect();
                self.sink.unknown_name(&via.span, "node", via.value.as_str(), names.into_iter());
                None
            }
        }
    }

    fn gateway(&mut self, record: &GatewayRecord) -> Option<Gateway> {
        let interface = self.interface(&record.interface);
        let netns = self.netns(record.netns.as_ref());
        let machines = &record.machines.value.0;
        let machines = machines.iter().map(|(name, address)| (name.value.clone(), address.value)).collect();
        Some(Gateway { interface: interface?, netns, machines })
    }

    /// Returns the real machine that a server is, if it is one; `None` for a mistake.
    fn real_server(&mut self, record: &ServerRecord) -> Option<Option<RealServer>> {
        let ServerRecord { agent, interface, netns, address, .. } = record;
        let present = [
            ("agent", agent.as_ref().map(|agent| &agent.span)),
            ("interface", interface.as_ref().map(|interface| &interface.span)),
            ("address", address.as_ref().map(|address| &address.span)),
            ("netns", netns.as_ref().map(|netns| &netns.span)),
        ];
        let Some((name, span)) = present.iter().find_map(|(name, span)| Some((name, (*span)?))) else {
            return Some(None);
        };
        let (Some(agent), Some(interface), Some(address)) = (agent, interface, address) else {
            let missing: Vec<_> =
                present[..3].iter().filter(|(_, span)| span.is_none()).map(|(name, _)| *name).collect();
            self.sink.error(span, format!("`{name}` without {}", words(&missing))).help(
                "a server that is a real machine has all three, such as \
                 `agent: edge1, interface: eth1, address: 192.168.1.7`",
            );
            return None;
        };
        let interface = self.interface(interface);
        let netns = self.netns(netns.as_ref());
        let (agent, address) = (agent.value.clone(), address.value);
        Some(Some(RealServer { agent, interface: interface?, netns, address }))
    }

    /// Returns the name or path of a network namespace.
    fn netns(&mut self, netns: Option<&Spanned<String>>) -> Option<String> {
        let netns = netns?;
        let name = netns.value.as_str();
        let is_name = !name.is_empty() && !name.contains('/') && !matches!(name, "." | "..");
        if !is_name && !name.starts_with('/') {
            self.sink
                .error(&netns.span, format!("no network namespace can have the name `{name}`"))
                .help("write one as `ip netns` names it, or a path from the root such as `/proc/1/ns/net`");
        }
        Some(name.to_owned())
    }

    /// Returns the name of an interface, as the kernel has it (dev_valid_name).
    pub(super) fn interface(&mut self, interface: &Spanned<String>) -> Option<String> {
        let name = &interface.value;
        let fits = |c: char| !c.is_whitespace() && !matches!(c, '/' | ':');
        if !(1..=15).contains(&name.len()) || matches!(name.as_str(), "." | "..") || !name.chars().all(fits) {
            self.sink
                .error(&interface.span, format!("no interface can have the name `{name}`"))
                .help("write one as `ip link` names it, such as `eth1`");
            return None;
        }
        Some(name.clone())
    }

    pub(super) fn domain(&mut self, wanted: Option<&Spanned<DomainId>>) -> Option<DomainId> {
        let Some(wanted) = wanted else { return self.domains.first().cloned() };
        if !self.domains.contains(&wanted.value) {
            let domains = self.domains.clone();
            self.sink.unknown_name(
                &wanted.span,
                "domain",
                wanted.value.as_str(),
                domains.iter().map(DomainId::as_str),
            );
            return None;
        }
        Some(wanted.value.clone())
    }

    fn network(&mut self, node: &Spanned<NodeId>, wanted: Option<&Spanned<String>>) -> Option<String> {
        match (wanted, &self.networks[..]) {
            (Some(ssid), networks) if networks.contains(&ssid.value.as_str()) => Some(ssid.value.clone()),
            (Some(ssid), _) => {
                let networks = self.networks.clone();
                self.sink.unknown_name(&ssid.span, "wireless network", &ssid.value, networks.into_iter());
                None
            }
            (None, [only]) => Some((*only).to_owned()),
            (None, networks) => {
                let help = if networks.is_empty() {
                    "describe one under `wireless:`, such as `campus: {}`".to_owned()
                } else {
                    format!("add `network:` with one of {}", words(networks))
                };
                self.sink.error(&node.span, format!("`{}` has no wireless network", node.value)).help(help);
                None
            }
        }
    }

    /// Returns a robot's start.
    fn start(&mut self, robot: &Spanned<NodeId>, at: Option<&Spanned<Position>>) -> Option<Position> {
        let walk = self.record.walks.0.iter().find(|(id, _)| id.value == robot.value);
        let first = walk.and_then(|(_, w)| w.waypoints.value.first()).map(|w| w.value);
        let on_its_way = walk.is_some_and(|(_, walk)| walk.next.is_some());
        match (at, first) {
            (Some(at), Some(first)) if at.value != first && !on_its_way => {
                self.sink
                    .error(
                        &at.span,
                        format!("`{}` starts at {}, but its walk at {first}", robot.value, at.value),
                    )
                    .help(
                        "leave out `position`: a robot starts at the first waypoint of its walk, unless that has `next`",
                    );
                None
            }
            (Some(at), _) => Some(at.value),
            (None, Some(first)) => Some(first),
            (None, None) => {
                self.sink
                    .error(&robot.span, format!("nothing says where `{}` is", robot.value))
                    .help("add `position: [x, y]`, or a walk under `walks:`");
                None
            }
        }
    }

    pub(super) fn reliability(&mut self, reliability: &Spanned<Probability>) -> f64 {
        let value = reliability.value.get();
        if value == 0.0 {
            self.sink
                .error(&reliability.span, "it would never work")
                .help("write a reliability above 0 %, or leave the thing out");
        }
        value
    }
}

fn fading(record: &Either<FadingWord, FadingRecord>) -> Fading {
    match record {
        Either::Short(FadingWord::Rayleigh) => Fading { k_factor_db: None, motion_mps: 0.0 },
        Either::Long(long) => {
            Fading { k_factor_db: long.k_factor.map(|k_factor| k_factor.0), motion_mps: long.motion.0 }
        }
    }
}

/// Whether it has a network namespace on this machine.
fn has_namespace(record: &NodeRecord) -> bool {
    is_host(record) && !matches!(record, NodeRecord::Server(server) if server.interface.is_some())
}

/// Whether programs of a testbed run on it.
fn is_host(record: &NodeRecord) -> bool {
    !matches!(record, NodeRecord::Switch(_) | NodeRecord::Gateway(_) | NodeRecord::Machine(_))
}
