//! Links over interfaces of agents' machines, as the core's thread uses them.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, mpsc},
    time::Duration,
};

use cotorra_agent_protocol::{LinkReading, MachineReading, WantedLink, WantedProbes};
use cotorra_graph::{
    AgentId, Conditions, Direction, HardwareGraph, LinkContext, LinkCounters, LinkId, Probed, Probing,
    Reached,
};
use parking_lot::Mutex;

use super::command::Command;
use crate::real::{network::AgentLinks, places::Place};

/// Reports of agents on their links. The agents' thread writes it, and the core's reads it.
#[derive(Clone)]
pub(super) struct LinkReports(Arc<Mutex<Reports>>);

struct Reports {
    present: BTreeSet<AgentId>,
    links: BTreeMap<LinkId, Reported>,
}

/// State of a link.
struct Reported {
    agent: AgentId,
    /// The process that read the counters last, and when, on its clock.
    read: Option<(u64, u64)>,
    leaving: Counted,
    arriving: Counted,
    /// Results of probes of the way there and back.
    probed: Option<[Probed; 2]>,
}

/// The traffic of one direction.
#[derive(Default)]
struct Counted {
    /// The last reading.
    last: LinkCounters,
    /// All readings together: an agent counts from zero when it applies conditions anew.
    total: LinkCounters,
    throughput_bps: f64,
}

impl Counted {
    /// Takes a reading. Without the time since the one before, the throughput is unknown.
    fn count(&mut self, now: LinkCounters, since: Option<Duration>) {
        let goes_on = now.packets >= self.last.packets && now.bytes >= self.last.bytes;
        let before = if goes_on { self.last } else { LinkCounters::default() };
        let bytes = now.bytes - before.bytes;
        self.total.bytes = self.total.bytes.saturating_add(bytes);
        self.total.packets = self.total.packets.saturating_add(now.packets - before.packets);
        self.total.lost = self.total.lost.saturating_add(now.lost.saturating_sub(before.lost));
        let seconds = since.map_or(0.0, |since| since.as_secs_f64());
        self.throughput_bps = if seconds > 0.0 { bytes as f64 * 8.0 / seconds } else { 0.0 };
        self.last = now;
    }

    /// Counts from zero from now on.
    fn reset(&mut self) {
        (self.last, self.throughput_bps) = (LinkCounters::default(), 0.0);
    }
}

impl Reported {
    /// Takes a reading. Ignores one that was overtaken.
    fn count(&mut self, boot: u64, read_ns: u64, reading: LinkReading) {
        if self.read.is_some_and(|(its, before)| its == boot && before >= read_ns) {
            return;
        }
        if self.read.is_some_and(|(its, _)| its != boot) {
            self.reset();
        }
        let before = self.read.replace((boot, read_ns));
        let since = before.map(|(_, before)| Duration::from_nanos(read_ns.saturating_sub(before)));
        let is_share = |loss: f64| (0.0..=1.0).contains(&loss);
        self.probed = reading.probed.filter(|ways| ways.iter().filter_map(|way| way.loss).all(is_share));
        self.leaving.count(reading.leaving, since);
        self.arriving.count(reading.arriving, since);
    }

    fn reset(&mut self) {
        (self.read, self.probed) = (None, None);
        self.leaving.reset();
        self.arriving.reset();
    }
}

/// Returns the links of a graph over interfaces of agents' machines.
fn at_agents(graph: &HardwareGraph) -> impl Iterator<Item = (&LinkId, &AgentId, Place)> {
    graph.real_links().filter_map(|real| Some((&real.link.id, real.reached.via.as_ref()?, Place::of(real))))
}

impl LinkReports {
    /// Nothing is reported yet.
    pub(super) fn new(graph: &HardwareGraph) -> Self {
        let link = |(link, agent, _): (&LinkId, &AgentId, _)| {
            let (leaving, arriving) = Default::default();
            let agent = agent.clone();
            (link.clone(), Reported { agent, read: None, leaving, arriving, probed: None })
        };
        let links = at_agents(graph).map(link).collect();
        Self(Arc::new(Mutex::new(Reports { present: BTreeSet::new(), links })))
    }

    /// Returns the links of each agent.
    pub(super) fn by_agent(&self) -> BTreeMap<AgentId, Vec<LinkId>> {
        let mut agents = BTreeMap::<_, Vec<_>>::new();
        for (link, reported) in &self.0.lock().links {
            agents.entry(reported.agent.clone()).or_default().push(link.clone());
        }
        agents
    }

    /// Notes that an agent came or went.
    pub(super) fn set_present(&self, agent: &AgentId, is_present: bool) {
        let mut reports = self.0.lock();
        if is_present {
            reports.present.insert(agent.clone());
        } else {
            reports.present.remove(agent);
            let its = reports.links.values_mut().filter(|its| its.agent == *agent);
            // Packets that cross a link while its agent is away are counted when it returns.
            for its in its {
                (its.leaving.throughput_bps, its.arriving.throughput_bps, its.probed) = (0.0, 0.0, None);
            }
        }
    }

    /// Takes the counters of an agent's links.
    pub(super) fn read(&self, agent: &AgentId, reading: &MachineReading) {
        for (link, its) in self.0.lock().links.iter_mut().filter(|(_, its)| its.agent == *agent) {
            match reading.links.get(link) {
                Some(counters) => its.count(reading.boot, reading.read_ns, *counters),
                None => its.reset(),
            }
        }
    }
}

/// The links of a run at agents.
pub(super) struct LinksAtAgents {
    places: BTreeMap<LinkId, (AgentId, Place)>,
    wanted: Mutex<BTreeMap<LinkId, WantedLink>>,
    reports: LinkReports,
    commands: mpsc::Sender<Command>,
}

impl LinksAtAgents {
    /// Wants agents to emulate the links of a graph, which are in these states, and to probe those that have reflectors like
    /// this. `commands` leads to the agents' thread.
    pub(super) fn begin(
        graph: &HardwareGraph,
        contexts: &[LinkContext],
        probing: Option<Probing>,
        reports: LinkReports,
        commands: mpsc::Sender<Command>,
    ) -> Self {
        let (mut places, mut all) = (BTreeMap::new(), BTreeMap::new());
        for (link, agent, place) in at_agents(graph) {
            let Reached { interface, address, reflector, .. } = &place.reached;
            let (interface, addresses) = (interface.clone(), *address);
            let (leaving, arriving) = Default::default();
            let reflector = addresses.filter(|_| *reflector).map(|address| address.address());
            let probes = reflector.zip(probing).map(|(reflector, probing)| WantedProbes {
                reflector,
                probing,
                medium_delay: place.medium.delay,
            });
            let mut wanted = WantedLink { interface, addresses, leaving, arriving, probes };
            for context in contexts.iter().filter(|context| context.link == *link) {
                want(&mut wanted, &place, context.direction, &context.effective);
            }
            // Fails only if the thread has ended.
            let _ = commands.send(Command::Emulate(agent.clone(), link.clone(), Box::new(wanted.clone())));
            all.insert(link.clone(), wanted);
            places.insert(link.clone(), (agent.clone(), place));
        }
        Self { places, wanted: Mutex::new(all), reports, commands }
    }
}

/// Sets the conditions of one direction.
fn want(wanted: &mut WantedLink, place: &Place, direction: Direction, conditions: &Conditions) {
    let way = if place.way(direction) == 0 { &mut wanted.leaving } else { &mut wanted.arriving };
    *way = place.added(conditions);
}

impl AgentLinks for LinksAtAgents {
    fn agent(&self, link: &LinkId) -> Option<&AgentId> {
        self.places.get(link).map(|(agent, _)| agent)
    }

    fn set(&self, link: &LinkId, direction: Direction, conditions: &Conditions) -> Result<(), String> {
        let (agent, place) = self.places.get(link).ok_or_else(|| format!("`{link}` is at no agent"))?;
        place.rule(link, direction, conditions).map_err(|reason| reason.to_string())?;
        if !self.reports.0.lock().present.contains(agent) {
            return Err(format!("agent `{agent}`, which emulates `{link}`, is not connected"));
        }
        let mut all = self.wanted.lock();
        let wanted = all.get_mut(link).ok_or_else(|| format!("`{link}` is at no agent"))?;
        want(wanted, place, direction, conditions);
        let command = Command::Emulate(agent.clone(), link.clone(), Box::new(wanted.clone()));
        self.commands.send(command).map_err(|_| "the agents' thread has ended".to_owned())
    }

    fn complete(&self, contexts: &mut [LinkContext]) {
        let reports = self.reports.0.lock();
        for context in contexts {
            let place = self.places.get(&context.link).map(|(_, place)| place);
            let (Some(place), Some(reported)) = (place, reports.links.get(&context.link)) else { continue };
            let counted =
                if place.way(context.direction) == 0 { &reported.leaving } else { &reported.arriving };
            (context.delay, context.probed) =
                (None, reported.probed.map(|ways| ways[place.way(context.direction)]));
            (context.throughput_bps, context.counters) = (counted.throughput_bps, counted.total);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_fabric::Fabric;
    use cotorra_graph::{MachineContext, Rate, Timestamp, Trace};
    use cotorra_graph_testing as base;

    use super::*;

    const TESTBED: &str = "\
name: gate
nodes:
  gate: { kind: machine, agent: gate1 }
  arm: { kind: machine, interface: eth1, address: 192.168.1.7, via: gate, reflector: true }
links:
  - { ends: [arm, gate], id: cable, forward: { delay: 5 ms }, backward: { delay: 20 ms }, medium_delay: 2 ms }
";

    const MEDIUM: Duration = Duration::from_millis(2);

    fn agent() -> AgentId {
        "gate1".parse().unwrap()
    }

    fn cable() -> LinkId {
        "cable".parse().unwrap()
    }

    struct World {
        graph: HardwareGraph,
        fabric: Fabric,
        reports: LinkReports,
        links: LinksAtAgents,
        commands: mpsc::Receiver<Command>,
        /// Agents' reports on probes.
        probed: Option<[Probed; 2]>,
    }

    impl World {
        fn new() -> Self {
            let graph = cotorra_testbed_file::parse("gate.yaml", TESTBED, Path::new(".")).unwrap().graph;
            let mut fabric = Fabric::new(&graph, 1).unwrap();
            let reports = LinkReports::new(&graph);
            let (sender, commands) = mpsc::channel();
            let contexts = fabric.link_contexts(Timestamp::ZERO);
            let links =
                LinksAtAgents::begin(&graph, &contexts, Some(Probing::default()), reports.clone(), sender);
            Self { graph, fabric, reports, links, commands, probed: None }
        }

        /// Returns the delays that were sent last, of leaving and of arriving packets, ms.
        fn sent(&self) -> Option<[u128; 2]> {
            let Command::Emulate(its, link, wanted) = self.commands.try_iter().last()? else { panic!() };
            assert_eq!((its, link, wanted.interface.as_str()), (agent(), cable(), "eth1"));
            let probes = wanted.probes.unwrap();
            assert_eq!((probes.reflector, probes.medium_delay), ([192, 168, 1, 7].into(), MEDIUM));
            Some([wanted.leaving, wanted.arriving].map(|way| way.delay.as_millis()))
        }

        fn set(&self, direction: Direction, conditions: &Conditions) -> Result<(), String> {
            self.links.set(&cable(), direction, conditions)
        }

        /// Takes the counters of an agent's process at a time of its clock: bytes of leaving and of arriving packets.
        fn read(&self, boot: u64, seconds: u64, bytes: Option<[u64; 2]>) {
            let counters = |bytes| LinkCounters { bytes, packets: bytes / 100, ..LinkCounters::default() };
            let reading = bytes.map(|bytes| {
                let [leaving, arriving] = bytes.map(counters);
                (cable(), LinkReading { leaving, arriving, probed: self.probed })
            });
            let context =
                MachineContext { node: self.graph.nodes[0].id.clone(), ..base::machine_context("machine") };
            let links = reading.into_iter().collect();
            let read_ns = seconds * 1_000_000_000;
            self.reports.read(
                &agent(),
                &MachineReading {
                    boot,
                    read_ns,
                    context,
                    links,
                    heard: BTreeMap::new(),
                    addresses: BTreeMap::new(),
                },
            );
        }

        /// Returns the context of the direction in which packets leave, and of the other one.
        fn contexts(&mut self) -> [LinkContext; 2] {
            let mut contexts = self.fabric.link_contexts(Timestamp::ZERO);
            self.links.complete(&mut contexts);
            [Direction::Backward, Direction::Forward].map(|direction| {
                let context = contexts.iter().find(|context| context.direction == direction).unwrap();
                assert_eq!(context.delay, None);
                context.clone()
            })
        }

        /// Returns bytes and throughput of both directions.
        fn counted(&mut self) -> [(u64, f64); 2] {
            self.contexts().map(|context| (context.counters.bytes, context.throughput_bps))
        }
    }

    #[test]
    fn agents_get_what_is_beyond_the_medium_once_they_are_there() {
        let world = World::new();
        assert_eq!(world.links.agent(&cable()), Some(&agent()));
        assert_eq!(world.links.agent(&"other".parse().unwrap()), None);
        // The file asks for a further delay, so that the medium adds to it.
        assert_eq!(world.sent(), Some([20, 5]));
        let slow = Conditions { delay: Duration::from_millis(42), ..Conditions::default() };
        assert!(
            world.set(Direction::Backward, &slow).unwrap_err().contains("`gate1`, which emulates `cable`")
        );
        assert_eq!(world.sent(), None);
        world.reports.set_present(&agent(), true);
        world.set(Direction::Backward, &slow).unwrap();
        assert_eq!(world.sent(), Some([40, 5]));
        world.set(Direction::Forward, &slow).unwrap();
        assert_eq!(world.sent(), Some([40, 40]));
        let trace = Rate::Trace { trace: Trace::parse("1").unwrap().into() };
        let error = world.set(Direction::Forward, &Conditions { rate: trace, ..slow.clone() }).unwrap_err();
        assert!(error.contains("packet-delivery traces"), "{error}");
        assert_eq!(world.sent(), None, "what is rejected changes nothing");
        world.reports.set_present(&agent(), false);
        assert!(world.set(Direction::Forward, &slow).unwrap_err().contains("is not connected"));
    }

    #[test]
    fn counters_go_on_when_an_agent_counts_from_zero() {
        let mut world = World::new();
        assert_eq!(world.counted(), [(0, 0.0), (0, 0.0)]);
        world.read(1, 10, Some([1000, 0]));
        assert_eq!(world.counted(), [(1000, 0.0), (0, 0.0)], "in an unknown time");
        world.read(1, 12, Some([2000, 500]));
        assert_eq!(world.counted(), [(2000, 4000.0), (500, 2000.0)]);
        world.reports.set_present(&agent(), false);
        assert_eq!(world.counted(), [(2000, 0.0), (500, 0.0)], "nothing is known while it is away");
        world.read(2, 1, Some([3000, 100]));
        assert_eq!(world.counted(), [(5000, 0.0), (600, 0.0)], "another process, with another clock");
        world.read(2, 2, Some([4000, 100]));
        assert_eq!(world.counted(), [(6000, 8000.0), (600, 0.0)]);
        // Its core was away for longer than the lease.
        world.read(2, 3, None);
        assert_eq!(world.counted(), [(6000, 0.0), (600, 0.0)]);
        world.read(2, 4, Some([100, 100]));
        assert_eq!(world.counted(), [(6100, 0.0), (700, 0.0)]);
        world.read(2, 5, Some([0, 200]));
        assert_eq!(
            world.counted(),
            [(6100, 0.0), (800, 800.0)],
            "its conditions were applied anew meanwhile"
        );
        world.read(2, 4, Some([100, 100]));
        world.read(2, 5, Some([0, 200]));
        assert_eq!(world.counted(), [(6100, 0.0), (800, 800.0)], "overtaken, and doubled");
    }

    #[test]
    fn probes_of_agents_are_those_of_their_directions_as_long_as_the_agent_is_there() {
        let mut world = World::new();
        let way = |ms, loss| Probed {
            delay: Some(Duration::from_millis(ms)),
            jitter: None,
            delay_age: None,
            loss: Some(loss),
            loss_age: Duration::ZERO,
        };
        let [there, back] = [way(22, 0.0), way(7, 1.0)];
        assert_eq!(world.contexts().map(|context| context.probed), [None, None]);
        world.probed = Some([there, back]);
        world.read(1, 1, Some([0, 0]));
        assert_eq!(world.contexts().map(|context| context.probed), [Some(there), Some(back)]);
        world.reports.set_present(&agent(), false);
        assert_eq!(world.contexts().map(|context| context.probed), [None, None]);
        world.read(1, 2, Some([0, 0]));
        assert_eq!(world.contexts().map(|context| context.probed), [Some(there), Some(back)]);
        world.probed = Some([way(22, 1.5), back]);
        world.read(1, 3, Some([0, 0]));
        assert_eq!(
            world.contexts().map(|context| context.probed),
            [None, None],
            "no link loses more than all"
        );
    }
}
