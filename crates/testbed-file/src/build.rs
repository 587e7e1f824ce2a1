//! From what stands in a testbed file to a testbed: names become references, figures become conditions. What is
//! wrong with one thing by itself is found here; what is wrong between them, in [`super::check`].

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use cotorra_graph::{
    BUNDLED_PLUGINS, BitRate, Capacity, Conditions, DomainId, GeoOrigin, Granted, HandoverTimes,
    HardwareGraph, HostAddress, Jitter, JitterDistribution, Kpis, Link, LinkId, Loss, Machine, Node, NodeId,
    NodeKind, Nodes, OccupancyGrid, PathLoss, PluginId, PluginProgram, PluginSpec, Position, Probability,
    Probing, Program, RadioUnit, Rate, Reached, Requests, Retention, Retentions, Rights, Robot, Scale,
    Server, Service, ServiceId, Shadowing, Testbed, Trace, VirtualLink, Vnf, WaisSettings, Walk,
    WirelessNetwork,
};

use crate::{
    check, file, map_server,
    records::{
        ConditionsRecord, LinkRecord, LossRecord, MachineRecord, NodeRecord, PathLossRecord, PluginRecord,
        ProbesRecord, ProbesWord, ProgramWord, RetentionRecord, RetentionsRecord, ServiceRecord,
        TestbedRecord, VnfRecord, WaisRecord, WalkRecord, WirelessRecord,
    },
    ros, script, sensors,
    yaml::{
        Bytes, Sink, Span,
        decode::{Amount, Either, Name as _, Spanned, nearest, there_are, words},
    },
};

/// Builds and checks the testbed; `None` when it cannot be, which the sink then knows.
pub(super) fn build(record: TestbedRecord, base_dir: &Path, sink: &mut Sink) -> Option<Testbed> {
    // The testbed's name becomes part of the name of a run's folder, and keeps the rules of all names.
    ServiceId::read_or_report(&record.name.value, &record.name.span, sink);
    let mut builder = Builder {
        domains: domains(&record.domains, sink),
        nodes: record.nodes.0.iter().map(|(id, node)| (id.value.as_str(), node)).collect(),
        networks: record.wireless.0.iter().map(|(ssid, _)| ssid.value.as_str()).collect(),
        record: &record,
        base_dir,
        traces: HashMap::new(),
        sink,
    };
    let map = builder.map();
    let wireless: Option<BTreeMap<_, _>> = each(&record.wireless.0, |(ssid, network)| {
        Some((ssid.value.clone(), builder.wireless(ssid, network)?))
    });
    let nodes = builder.nodes();
    let links = builder.links();
    let services: Option<Vec<_>> = each(&record.services.0, |(id, service)| builder.service(id, service));
    let walks: Option<Vec<_>> = each(&record.walks.0, |(robot, walk)| builder.walk(robot, walk));
    let plugins = builder.plugins();
    let wais = builder.wais(&record.wais);
    let script = script::script(&mut builder, links.as_deref());
    let domains = builder.domains;
    let probes = probes(&record.probes, sink);
    let retention = retentions(&record.history.retention, sink);
    let testbed = Testbed {
        graph: HardwareGraph { domains, nodes: nodes?, links: links?, wireless: wireless? },
        services: services?,
        map: map?,
        walks: walks?,
        plugins: plugins?,
        wais: wais?,
        seed: record.seed,
        emulation: record.emulation,
        script: script?,
        probes,
        retention,
        description: record.description.clone(),
        name: record.name.value.clone(),
    };
    check::check(&record, &testbed, sink);
    Some(testbed)
}

fn probes(record: &Either<ProbesWord, ProbesRecord>, sink: &mut Sink) -> Option<Probing> {
    let Either::Long(ProbesRecord { interval, window }) = record else { return None };
    let probing = Probing { interval: interval.value, window: window.value };
    if probing.interval < Duration::from_millis(1) {
        sink.error(&interval.span, "probes less than a millisecond apart")
            .help("write `500 ms`, or any time from 1 ms on; `probes: none` switches them off");
    } else if probing.window < probing.interval * 2 {
        sink.error(&window.span, "this window has not even two probes")
            .help(format!("write {:?} or more, or a shorter `interval`", probing.interval * 2));
    } else if probing.window > probing.interval * Probing::MOST {
        sink.error(&window.span, format!("this window has more than {} probes", Probing::MOST))
            .help("write a shorter window, or a longer `interval`");
    }
    Some(probing)
}

pub(super) fn retentions(record: &RetentionsRecord, sink: &mut Sink) -> Retentions {
    let mut of = |record: &Option<RetentionRecord>| {
        let RetentionRecord { raw, step, keep } = record.as_ref()?;
        if !Retention::is_step(step.value) {
            sink.error(&step.span, "a minute is no multiple of this step, or it is shorter than 10 ms")
                .help("write it like `1 s`, `5 s` or `1 min`");
        }
        Some(Retention { raw: *raw, step: step.value, keep: *keep })
    };
    Retentions {
        robots: of(&record.robots),
        radio_units: of(&record.radio_units),
        links: of(&record.links),
        sensors: of(&record.sensors),
    }
}

/// Whether programs of cotorra's run on it.
fn is_host(record: &NodeRecord) -> bool {
    !matches!(record, NodeRecord::Switch(_) | NodeRecord::Machine(_))
}

/// Characters of the longest name of a variable.
const LONGEST_VARIABLE: usize = 255;
/// Metres from the ellipsoid beyond which the map's floor is surely elsewhere.
const HIGHEST_M: f64 = 1e5;

/// Applies `f` to all before any that failed ends it, so that each one's mistakes show.
fn each<T, U, C: FromIterator<U>>(items: &[T], mut f: impl FnMut(&T) -> Option<U>) -> Option<C> {
    let built: Vec<_> = items.iter().map(&mut f).collect();
    built.into_iter().collect()
}

fn domains(listed: &[Spanned<DomainId>], sink: &mut Sink) -> Vec<DomainId> {
    let mut seen = HashSet::new();
    for domain in listed {
        if !seen.insert(&domain.value) {
            sink.error(&domain.span, format!("the domain `{}` is here twice", domain.value))
                .help("remove one of them, or rename it");
        }
    }
    if listed.is_empty() {
        vec![DomainId::new("local").expect("it is a name")]
    } else {
        listed.iter().map(|d| d.value.clone()).collect()
    }
}

pub(super) struct Builder<'a> {
    pub(super) record: &'a TestbedRecord,
    pub(super) base_dir: &'a Path,
    domains: Vec<DomainId>,
    pub(super) nodes: HashMap<&'a str, &'a NodeRecord>,
    networks: Vec<&'a str>,
    /// By path, so that a trace is read once and shared; `None` when it cannot be read.
    traces: HashMap<String, Option<Arc<Trace>>>,
    pub(super) sink: &'a mut Sink,
}

impl Builder<'_> {
    /// Reports a name that nothing has.
    pub(super) fn dangling<'b>(
        &mut self,
        span: &Span,
        what: &str,
        name: &str,
        there: impl Iterator<Item = &'b str>,
    ) {
        dangling(span, what, name, there, self.sink);
    }

    /// The node of that name, which must be there.
    fn node(&mut self, id: &Spanned<NodeId>) -> Option<NodeId> {
        self.node_where(id, "node", |_| true)
    }

    /// The node of that name with a port to the emulated network, which must be there.
    pub(super) fn host(&mut self, id: &Spanned<NodeId>) -> Option<NodeId> {
        self.node_where(id, "robot, radio unit or server", |node| {
            matches!(node, NodeRecord::Robot(_) | NodeRecord::RadioUnit(_) | NodeRecord::Server(_))
        })
    }

    /// The robot of that name, which must be there.
    pub(super) fn robot(&mut self, id: &Spanned<NodeId>) -> Option<NodeId> {
        self.node_where(id, "robot", |node| matches!(node, NodeRecord::Robot(_)))
    }

    fn node_where(
        &mut self,
        id: &Spanned<NodeId>,
        what: &str,
        fits: impl Fn(&NodeRecord) -> bool,
    ) -> Option<NodeId> {
        find(&self.nodes, id, what, fits, self.sink)
    }

    fn map(&mut self) -> Option<Option<OccupancyGrid>> {
        let Some(path) = &self.record.map else { return Some(None) };
        match map_server::load(self.base_dir.join(&path.value)) {
            Ok(grid) => Some(Some(grid)),
            Err(found) => {
                for d in found.list {
                    let of_file = found.source_text.is_empty();
                    let place = format!("{}:{}:{}: ", path.value, d.line, d.column);
                    let message = if of_file { d.message } else { place + &d.message };
                    self.sink.error(&path.span, message).help(d.help.unwrap_or_default());
                }
                None
            }
        }
    }

    fn wireless(&mut self, ssid: &Spanned<String>, record: &WirelessRecord) -> Option<WirelessNetwork> {
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
        let handover = &record.handover;
        Some(WirelessNetwork {
            standard: record.standard,
            delay: record.delay,
            rate: record.rate,
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
            shadowing: Shadowing {
                deviation_db: record.shadowing.deviation.0,
                correlation_m: correlation.value.0,
            },
            noise_floor: record.noise_floor,
            hysteresis_db: record.hysteresis.0,
            time_to_trigger: record.time_to_trigger,
            handover: HandoverTimes {
                scan: handover.scan,
                authenticate: handover.authenticate,
                reassociate: handover.reassociate,
                handshake: handover.handshake,
                variation: handover.variation.get(),
            },
            gap: record.gap,
        })
    }

    fn nodes(&mut self) -> Option<Vec<Node>> {
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
                let walk = self.record.walks.0.iter().find(|(robot, _)| robot.value == id.value);
                let facing = |walk: &WalkRecord| {
                    let way: Vec<_> = walk.waypoints.value.iter().take(2).map(|w| w.value).collect();
                    if let [from, to] = way[..] { (to.y - from.y).atan2(to.x - from.x) } else { 0.0 }
                };
                let nodes = &self.nodes;
                let mut host = |node: &Spanned<NodeId>, sink: &mut Sink| {
                    find(nodes, node, "node with a network of its own", is_host, sink)
                };
                let driver = ros::driver(r, &id.value, &mut host, self.sink);
                let robot = Robot {
                    capacity: capacity(r.cpus, r.memory),
                    model: r.model,
                    network: network?,
                    tx_power: r.tx_power,
                    heading: r.heading.map_or_else(|| walk.map_or(0.0, |(_, w)| facing(w)), |a| a.0),
                    roaming: r.roaming,
                    sensors: sensors::sensors(r, driver.as_ref(), self.sink),
                    driver: driver?,
                };
                (Some(position?), NodeKind::Robot(robot))
            }
            NodeRecord::RadioUnit(r) => {
                let unit = RadioUnit {
                    capacity: capacity(r.cpus, r.memory),
                    network: self.network(id, r.network.as_ref())?,
                    channel: r.channel.value,
                    tx_power: r.tx_power,
                    serving: r.serving,
                    deployment: r.deployment,
                };
                (Some(r.position), NodeKind::RadioUnit(unit))
            }
            NodeRecord::Switch(s) => (s.position, NodeKind::Switch),
            NodeRecord::Server(s) => {
                let server = Server {
                    tier: s.tier,
                    capacity: capacity(s.cpus, s.memory),
                    cost: s.cost.0,
                    reliability: self.reliability(&s.reliability),
                };
                (s.position, NodeKind::Server(server))
            }
            NodeRecord::Machine(m) => (m.position, NodeKind::Machine(self.machine(m)?)),
        };
        Some(Node { id: id.value.clone(), domain: domain?, position, kind })
    }

    fn machine(&mut self, record: &MachineRecord) -> Option<Machine> {
        let Some(interface) = &record.interface else {
            if let Some(address) = &record.address {
                self.sink
                    .error(&address.span, "an address, and no interface through which it is reached")
                    .help("name the interface, such as `interface: eth1`; `ip route get ADDRESS` says which it is");
                return None;
            }
            return Some(Machine { reached: None });
        };
        // As the kernel has it (dev_valid_name).
        let name = &interface.value;
        let fits = |c: char| !c.is_whitespace() && !matches!(c, '/' | ':');
        if !(1..=15).contains(&name.len()) || matches!(name.as_str(), "." | "..") || !name.chars().all(fits) {
            self.sink
                .error(&interface.span, format!("no interface can have the name `{name}`"))
                .help("write one as `ip link` names it, such as `eth1`");
            return None;
        }
        let address = record.address.as_ref().map(|address| address.value);
        let reflector = record.reflector.value;
        if reflector && !address.is_some_and(|address| address.is_one()) {
            self.sink
                .error(&record.reflector.span, "a reflector, and not the one address at which it is")
                .help("write the machine's own, such as `address: 192.168.1.7`");
        }
        Some(Machine { reached: Some(Reached { interface: name.clone(), address, reflector }) })
    }

    fn domain(&mut self, wanted: Option<&Spanned<DomainId>>) -> Option<DomainId> {
        let Some(wanted) = wanted else { return self.domains.first().cloned() };
        if !self.domains.contains(&wanted.value) {
            let domains = self.domains.clone();
            self.dangling(
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
                self.dangling(&ssid.span, "wireless network", &ssid.value, networks.into_iter());
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

    /// Where a robot starts.
    fn start(&mut self, robot: &Spanned<NodeId>, at: Option<&Spanned<Position>>) -> Option<Position> {
        let walk = self.record.walks.0.iter().find(|(id, _)| id.value == robot.value);
        let first = walk.and_then(|(_, w)| w.waypoints.value.first()).map(|w| w.value);
        match (at, first) {
            (Some(at), Some(first)) if at.value != first => {
                self.sink
                    .error(
                        &at.span,
                        format!("`{}` starts at {}, but its walk at {first}", robot.value, at.value),
                    )
                    .help("leave out `position`: a robot starts at the first waypoint of its walk");
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

    fn reliability(&mut self, reliability: &Spanned<Probability>) -> f64 {
        let value = reliability.value.get();
        if value == 0.0 {
            self.sink
                .error(&reliability.span, "it would never work")
                .help("write a reliability above 0 %, or leave the thing out");
        }
        value
    }

    fn links(&mut self) -> Option<Vec<Link>> {
        if let Some((_, span)) = check::entries(self.record).nth(HardwareGraph::MAX_LINKS) {
            self.sink
                .error(
                    span,
                    format!("with this entry there are more than {} links", HardwareGraph::MAX_LINKS),
                )
                .help("connect nodes through a switch, which has one link to each");
            return None;
        }
        let nested: Option<Vec<Vec<Link>>> = each(&self.record.links, |record| self.links_of(record));
        let links: Vec<Link> = nested?.into_iter().flatten().collect();
        Some(links)
    }

    /// The links that one entry stands for.
    fn links_of(&mut self, record: &LinkRecord) -> Option<Vec<Link>> {
        let [first, second] = &record.ends.value[..] else {
            self.sink
                .error(&record.ends.span, format!("a link has 2 ends, not {}", record.ends.value.len()))
                .help("write `ends: [A, B]`, or `ends: [A, [B, C]]` for links from A to each of the others");
            return None;
        };
        let mut end = |end: &Either<Spanned<NodeId>, Vec<Spanned<NodeId>>>| -> Option<Vec<NodeId>> {
            let several = match end {
                Either::Short(one) => std::slice::from_ref(one),
                Either::Long(several) => several,
            };
            each(several, |id| {
                let node = self.node(id)?;
                if matches!(self.nodes[node.as_str()], NodeRecord::Robot(_)) {
                    self.sink
                        .error(&id.span, format!("`{node}` is a robot, and a robot has no wire"))
                        .help("it is reached through the radio units of its wireless network");
                }
                Some(node)
            })
        };
        let (first, second) = (end(first), end(second));
        let forward = self.conditions(record, record.forward.as_ref());
        let backward = self.conditions(record, record.backward.as_ref());
        let scales = [&record.forward, &record.backward].map(|own| self.scale(record, own.as_ref()));
        let reliability = self.reliability(&record.reliability);
        let (first, second, forward, backward) = (first?, second?, forward?, backward?);
        let several = first.len() * second.len() != 1;
        if let (true, Some(id)) = (several, &record.id) {
            self.sink
                .error(&id.span, "one name for several links")
                .help("leave out `id`: each is named `A-B` after its ends");
        }
        let mut links = Vec::with_capacity(first.len() * second.len());
        for a in &first {
            for b in &second {
                let id = match &record.id {
                    Some(id) => id.value.clone(),
                    None => LinkId::between(a, b),
                };
                if a == b {
                    self.sink
                        .error(&record.ends.span, format!("a link from `{a}` to itself"))
                        .help("name two different nodes");
                }
                links.push(Link {
                    id,
                    ends: [a.clone(), b.clone()],
                    forward: forward.clone(),
                    backward: backward.clone(),
                    scales,
                    medium: record.medium,
                    medium_delay: record.medium_delay.as_ref().map(|delay| delay.value).unwrap_or_default(),
                    reliability,
                });
            }
        }
        Some(links)
    }

    /// One direction's conditions: what it says itself, else what the link says.
    fn conditions(&mut self, link: &LinkRecord, own: Option<&ConditionsRecord>) -> Option<Conditions> {
        let base = &link.conditions;
        macro_rules! pick {
            ($key:ident) => {
                own.and_then(|own| own.$key.as_ref()).or(base.$key.as_ref())
            };
        }
        let delay = pick!(delay).copied().unwrap_or_default();
        let jitter = pick!(jitter).map(|jitter| match jitter {
            Either::Short(deviation) => {
                Jitter { deviation: *deviation, distribution: JitterDistribution::default() }
            }
            Either::Long(j) => Jitter { deviation: j.deviation, distribution: j.distribution },
        });
        let reordering = pick!(reordering);
        if let Some(share) = reordering.filter(|share| share.value.get() > 0.0 && delay.is_zero()) {
            self.sink
                .error(&share.span, "reordering on a link without delay")
                .help("packets overtake by skipping the delay: give the link one, such as `delay: 5 ms`");
        }
        let loss = match pick!(loss) {
            None => Loss::None,
            Some(loss) => self.loss(loss)?,
        };
        // A rate and a trace are two answers to one question: a direction's own stands in for either of the link's.
        let from = own.filter(|own| own.rate.is_some() || own.trace.is_some()).unwrap_or(base);
        Some(Conditions {
            delay,
            jitter,
            loss,
            duplication: pick!(duplication).copied().unwrap_or_default(),
            corruption: pick!(corruption).copied().unwrap_or_default(),
            reordering: reordering.map(|share| share.value).unwrap_or_default(),
            rate: self.rate(from, link.medium)?,
            queue: pick!(queue).copied().unwrap_or_default(),
        })
    }

    /// One direction's ψ and δ: what it says itself, else what the link says.
    fn scale(&mut self, link: &LinkRecord, own: Option<&ConditionsRecord>) -> Scale {
        let base = &link.conditions;
        let delay = own.and_then(|own| own.delay_scale).or(base.delay_scale);
        let drop = own.and_then(|own| own.drop_scale.as_ref()).or(base.drop_scale.as_ref());
        if let Some(drop) = drop.filter(|drop| drop.value.0 == 0.0) {
            self.sink
                .error(&drop.span, "a throughput cannot be divided by 0")
                .help("write a number above 0; 1 leaves the link as it is");
        }
        Scale {
            delay_scale: delay.map_or(1.0, |scale| scale.0),
            drop_scale: drop.map_or(1.0, |scale| scale.value.0),
        }
    }

    pub(super) fn loss(&mut self, loss: &Either<Probability, LossRecord>) -> Option<Loss> {
        match loss {
            Either::Short(rate) if rate.get() == 0.0 => Some(Loss::None),
            Either::Short(rate) => Some(Loss::Independent { rate: *rate }),
            Either::Long(loss) => self.bursty(&loss.rate, &loss.mean_burst),
        }
    }

    fn bursty(&mut self, rate: &Spanned<Probability>, mean_burst: &Spanned<Amount>) -> Option<Loss> {
        let (p, burst) = (rate.value.get(), mean_burst.value.0);
        if p == 1.0 {
            self.sink
                .error(&rate.span, "bursts that never end")
                .help("write a rate below 100 %, or `loss: 100 %` to lose everything");
        } else if burst < 1.0 {
            self.sink
                .error(&mean_burst.span, format!("a burst of {burst} packets"))
                .help("a burst has one packet or more: write 1 or above");
        } else if p / (1.0 - p) > burst {
            // The good state would have to be left with a probability above one.
            self.sink
                .error(&mean_burst.span, format!("{} % cannot be lost in bursts of {burst}", p * 100.0))
                .help(format!(
                    "at that rate a burst has {:.2} packets or more: rate / (1 - rate)",
                    p / (1.0 - p)
                ));
        } else {
            return Some(Loss::Bursty { rate: rate.value, mean_burst: burst });
        }
        None
    }

    pub(super) fn rate(&mut self, record: &ConditionsRecord, medium: BitRate) -> Option<Rate> {
        match (&record.rate, &record.trace) {
            (None, None) => Some(Rate::Fixed { bits_per_second: medium }),
            (Some(_), Some(trace)) => {
                self.sink
                    .error(&trace.span, "both a rate and a trace")
                    .help("a trace stands in place of a rate: keep one of them");
                None
            }
            (Some(rate), None) => {
                if let Rate::Fixed { bits_per_second } = rate.value
                    && bits_per_second > medium
                {
                    self.faster(&rate.span, &bits_per_second.to_string(), medium);
                }
                Some(rate.value.clone())
            }
            (None, Some(path)) => {
                let trace = self.trace(path)?;
                let mean = trace.mean_bits_per_second();
                if mean > medium.bits_per_second() as f64 {
                    self.faster(&path.span, &format!("{:.3} Mbit/s", mean / 1e6), medium);
                }
                Some(Rate::Trace { trace })
            }
        }
    }

    fn faster(&mut self, span: &Span, rate: &str, medium: BitRate) {
        self.sink
            .error(span, format!("{rate} is more than the medium carries"))
            .help(format!("write at most {medium}, or give the link a faster `medium`"));
    }

    fn trace(&mut self, path: &Spanned<String>) -> Option<Arc<Trace>> {
        if let Some(known) = self.traces.get(&path.value) {
            return known.clone();
        }
        let trace = file::read_text(&self.base_dir.join(&path.value))
            .map_err(|error| format!("the trace cannot be read: {error}"))
            .and_then(|text| Trace::parse(&text).map_err(|error| format!("{}: {error}", path.value)));
        let trace = match trace {
            Ok(trace) => Some(Arc::new(trace)),
            Err(message) => {
                self.sink.error(&path.span, message).help(
                    "a trace has a line for each 1500 bytes that can pass, with its time in milliseconds",
                );
                None
            }
        };
        self.traces.insert(path.value.clone(), trace.clone());
        trace
    }

    fn service(&mut self, id: &Spanned<ServiceId>, record: &ServiceRecord) -> Option<Service> {
        let robot = self.robot(&record.robot);
        let vnfs: Option<Vec<_>> = each(&record.vnfs.0, |(vnf, r)| {
            let (program, pinned_to, node) = self.vnf(&vnf.span, r)?;
            let id = vnf.value.clone();
            let is_command = matches!(program, Program::Command(_));
            let (env, rights) = (self.env(&r.env, is_command), self.rights(r, is_command));
            let (env, rights) = (env?, rights?);
            Some(Vnf { id, program, cpus: r.cpus.0, memory_bytes: r.memory.0, pinned_to, node, env, rights })
        });
        let virtual_links: Option<Vec<_>> = each(&record.virtual_links, |link| {
            for end in [&link.from, &link.to] {
                if !record.vnfs.0.iter().any(|(vnf, _)| vnf.value == end.value) {
                    let vnfs = record.vnfs.0.iter().map(|(vnf, _)| vnf.value.as_str());
                    self.dangling(&end.span, "VNF in this service named", end.value.as_str(), vnfs);
                }
            }
            if link.from.value == link.to.value {
                self.sink
                    .error(&link.to.span, format!("a virtual link from `{}` to itself", link.to.value))
                    .help("name two different VNFs");
            }
            Some(VirtualLink { from: link.from.value.clone(), to: link.to.value.clone(), rate: link.rate })
        });
        let kpis = Kpis {
            service_time: record.kpis.service_time.value,
            reliability: record.kpis.reliability.as_ref().map(|r| r.value.get()),
            area: record.kpis.area.as_ref().map(|a| a.value.clone()),
            radio: record.kpis.radio.as_ref().map(|r| r.value),
            flow: self.flow(record)?,
        };
        Some(Service {
            id: id.value.clone(),
            robot: robot?,
            vnfs: vnfs?,
            virtual_links: virtual_links?,
            kpis,
            requests: record.requests.as_ref().map_or_else(Requests::default, |requests| requests.value),
        })
    }

    /// What a VNF runs, the node that it is pinned to, and the nodes where it starts.
    fn vnf(&mut self, span: &Span, record: &VnfRecord) -> Option<(Program, Option<NodeId>, Nodes)> {
        let program = match (&record.program, &record.command) {
            (Some(word), None) => match word.value {
                ProgramWord::RobotDriver => Some(Program::RobotDriver),
                ProgramWord::Navigation => Some(Program::Navigation),
                ProgramWord::Localization => Some(Program::Localization),
            },
            (None, Some(command)) => self.command(command).map(Program::Command),
            (None, None) => {
                self.sink.error(span, "nothing says what this VNF runs").help(
                    "add `program: navigation`, `program: localization`, `program: robot_driver`, or \
                     `command: [program, argument]`",
                );
                None
            }
            (Some(_), Some(command)) => {
                self.sink
                    .error(&command.span, "both a program and a command")
                    .help("keep one of `program` and `command`");
                None
            }
        };
        let (pinned, node) = match (&record.pinned_to, &record.node) {
            (Some(pinned), None) => {
                let node = self.node(pinned);
                (node.clone(), node.map(Nodes::from))
            }
            (None, Some(node)) => (None, self.hosts_of(node)),
            (None, None) => {
                self.sink
                    .error(span, "nothing says where this VNF runs")
                    .help("add `node:` where it starts, or `pinned_to:` if it cannot move");
                (None, None)
            }
            (Some(_), Some(node)) => {
                self.sink
                    .error(&node.span, "both pinned and started on a node")
                    .help("keep `pinned_to` if it cannot move, else `node`");
                (None, None)
            }
        };
        let node = node?;
        if let Some(replicas) = record.replicas.as_ref().filter(|r| usize::from(r.value) != node.all().len())
        {
            let (wanted, nodes) = (replicas.value, node.all().len());
            let s = if nodes == 1 { "" } else { "s" };
            let help = if pinned.is_some() {
                "leave `replicas` out: a VNF that is pinned has one instance".to_owned()
            } else {
                let most = Nodes::MOST;
                format!(
                    "each has a node of its own: list as many under `node:`, such as `[a, b]`, {most} at most"
                )
            };
            self.sink.error(&replicas.span, format!("{wanted} instances on {nodes} node{s}")).help(help);
            return None;
        }
        Some((program?, pinned, node))
    }

    /// The nodes of a VNF's instances.
    fn hosts_of(&mut self, record: &Spanned<Either<Spanned<NodeId>, Vec<Spanned<NodeId>>>>) -> Option<Nodes> {
        let several = match &record.value {
            Either::Short(one) => return self.node(one).map(Nodes::from),
            Either::Long(several) => each(several, |node| self.node(node))?,
        };
        Nodes::new(several)
            .map_err(|wrong| {
                let help = "name different nodes, one for each instance, such as `[a, b]`";
                self.sink.error(&record.span, wrong.to_string()).help(help);
            })
            .ok()
    }

    fn command(&mut self, command: &Spanned<Vec<String>>) -> Option<Vec<String>> {
        if command.value.first().is_none_or(|program| program.trim().is_empty()) {
            self.sink
                .error(&command.span, "this command names no program")
                .help("write `[program, argument, …]`, such as `[python3, server.py]`");
            return None;
        }
        Some(command.value.clone())
    }

    /// What a command may do on this machine.
    fn rights(&mut self, record: &VnfRecord, is_command: bool) -> Option<Rights> {
        let VnfRecord { capabilities, readable, trusted, .. } = record;
        let given = [
            ("capabilities", &capabilities.span, !capabilities.value.is_empty()),
            ("readable", &readable.span, !readable.value.is_empty()),
        ];
        let mut well = true;
        for (key, span, is_given) in given {
            if is_given && trusted.value {
                self.sink
                    .error(span, format!("`{key}` of a VNF that is trusted"))
                    .help("keep one of the two: what is trusted may do all that cotorra may");
                well = false;
            }
            if is_given && !is_command {
                self.sink
                    .error(span, format!("only a `command` has `{key}`"))
                    .help(format!("leave out `{key}`: what is bundled has what it needs"));
                well = false;
            }
        }
        if trusted.value && !is_command {
            self.sink
                .error(&trusted.span, "only a `command` can be trusted or not")
                .help("leave out `trusted`: what is bundled is cotorra itself");
            well = false;
        }
        let readable = readable.value.iter().map(PathBuf::from).collect();
        let confined = Rights::Confined(Granted { capabilities: capabilities.value.clone(), readable });
        well.then_some(if trusted.value { Rights::Trusted } else { confined })
    }

    /// The variables that a command is to get.
    fn env(&mut self, names: &[Spanned<String>], is_command: bool) -> Option<Vec<String>> {
        each(names, |name| {
            let starts_well = name.value.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
            let all_well = name.value.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
            if !is_command {
                self.sink
                    .error(&name.span, "only a `command` gets variables")
                    .help("leave out `env`: what is bundled gets what it needs");
                None
            } else if !starts_well || !all_well || name.value.len() > LONGEST_VARIABLE {
                self.sink
                    .error(&name.span, format!("`{}` is not the name of a variable", name.value))
                    .help("write names alone, such as `env: [DISPLAY, MY_TOKEN]`: their values come from cotorra's environment");
                None
            } else {
                Some(name.value.clone())
            }
        })
    }

    fn walk(&mut self, robot: &Spanned<NodeId>, record: &WalkRecord) -> Option<Walk> {
        let robot = self.robot(robot);
        let mut waypoints: Vec<_> = record.waypoints.value.iter().map(|w| w.value).collect();
        if record.and_back {
            let back: Vec<_> = waypoints.iter().rev().skip(1).copied().collect();
            waypoints.extend(back);
        }
        Some(Walk {
            robot: robot?,
            waypoints,
            speed_limit: record.speed_limit.value.0,
            position_interval: record.position_interval.value,
        })
    }

    fn wais(&mut self, record: &WaisRecord) -> Option<WaisSettings> {
        let mut degrees = |figure: &Spanned<f64>, most: f64| {
            let well = figure.value.abs() <= most;
            if !well {
                self.sink
                    .error(&figure.span, format!("{} degrees are too many", figure.value))
                    .help(format!("write degrees from -{most} to {most}"));
            }
            well.then_some(figure.value)
        };
        let callbacks = record.callbacks.clone();
        let Some(origin) = &record.origin else { return Some(WaisSettings { callbacks, origin: None }) };
        let (latitude, longitude) = (degrees(&origin.latitude, 90.0), degrees(&origin.longitude, 180.0));
        let altitude = match &origin.altitude {
            Some(altitude) if altitude.value.abs() > HIGHEST_M => {
                self.sink
                    .error(&altitude.span, format!("{} m above the ellipsoid", altitude.value))
                    .help(format!("write metres from -{HIGHEST_M} to {HIGHEST_M}"));
                return None;
            }
            altitude => altitude.as_ref().map(|altitude| altitude.value),
        };
        let bearing = origin.bearing.0;
        let origin = GeoOrigin { latitude: latitude?, longitude: longitude?, bearing, altitude };
        Some(WaisSettings { callbacks, origin: Some(origin) })
    }

    fn plugins(&mut self) -> Option<Vec<PluginSpec>> {
        let mut seen = HashSet::new();
        let plugins: Vec<Option<PluginSpec>> = each(&self.record.plugins, |entry| {
            let plugin = match &entry.value {
                Either::Short(name) => {
                    let program = self.bundled(&Spanned { value: name.clone(), span: entry.span.clone() })?;
                    let id = PluginId::new(name).expect("bundled plug-ins have names");
                    PluginSpec {
                        id,
                        program,
                        domain: None,
                        env: Vec::new(),
                        settings: serde_json::Map::new(),
                    }
                }
                Either::Long(record) => self.plugin(&entry.span, record)?,
            };
            if !seen.insert(plugin.id.clone()) {
                self.sink
                    .error(&entry.span, format!("the plug-in `{}` is here twice", plugin.id))
                    .help("remove one of them, or give it another `id`");
            }
            let enabled = !matches!(&entry.value, Either::Long(record) if !record.enabled);
            Some(enabled.then_some(plugin))
        })?;
        Some(plugins.into_iter().flatten().collect())
    }

    fn plugin(&mut self, span: &Span, record: &PluginRecord) -> Option<PluginSpec> {
        let program = match (&record.bundled, &record.command) {
            (Some(name), None) => self.bundled(name),
            (None, Some(command)) => self.command(command).map(PluginProgram::Command),
            _ => {
                self.sink
                    .error(span, "a plug-in runs either something bundled or a command")
                    .help("keep one of `bundled: probing` and `command: [program, argument]`");
                None
            }
        };
        let id = match (&record.id, &record.bundled) {
            (Some(id), _) => Some(id.value.clone()),
            (None, Some(bundled)) => PluginId::new(&bundled.value).ok(),
            (None, None) => {
                self.sink.error(span, "this plug-in has no name").help("add `id: my-plugin`");
                None
            }
        };
        let domain = match &record.domain {
            Some(domain) if matches!(program, Some(PluginProgram::Command(_))) => {
                self.sink
                    .error(&domain.span, "a program is bound to a domain by the token that it shows")
                    .help("leave out `domain`, and give the program that domain's token: docs/federation.md");
                None
            }
            Some(domain) => self.domain(Some(domain)).map(Some),
            None => Some(None),
        };
        let env = self.env(&record.env, !matches!(program, Some(PluginProgram::Bundled(_))));
        let settings = record.settings.clone();
        Some(PluginSpec { id: id?, program: program?, domain: domain?, env: env?, settings })
    }

    fn bundled(&mut self, name: &Spanned<String>) -> Option<PluginProgram> {
        if BUNDLED_PLUGINS.contains(&name.value.as_str()) {
            return Some(PluginProgram::Bundled(name.value.clone()));
        }
        self.dangling(&name.span, "bundled plug-in", &name.value, BUNDLED_PLUGINS.iter().copied());
        None
    }
}

/// Reports a name that nothing has.
pub(super) fn dangling<'b>(
    span: &Span,
    what: &str,
    name: &str,
    there: impl Iterator<Item = &'b str>,
    sink: &mut Sink,
) {
    let mut there: Vec<_> = there.collect();
    there.sort_unstable();
    sink.error(span, format!("there is no {what} `{name}`")).help(
        match nearest(name, there.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None if there.is_empty() => format!("this file has no {what} at all"),
            None => there_are(&there),
        },
    );
}

/// The node of that name among those that fit; else that is reported.
fn find(
    nodes: &HashMap<&str, &NodeRecord>,
    id: &Spanned<NodeId>,
    what: &str,
    fits: impl Fn(&NodeRecord) -> bool,
    sink: &mut Sink,
) -> Option<NodeId> {
    if nodes.get(id.value.as_str()).is_some_and(|node| fits(node)) {
        return Some(id.value.clone());
    }
    let there: Vec<_> = nodes.iter().filter(|(_, node)| fits(node)).map(|(name, _)| *name).collect();
    dangling(&id.span, what, id.value.as_str(), there.into_iter(), sink);
    None
}

fn capacity(cpus: Amount, memory: Bytes) -> Capacity {
    Capacity { cpus: cpus.0, memory_bytes: memory.0 }
}
