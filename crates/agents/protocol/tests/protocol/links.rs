//! Links have the conditions that the core wants as long as it is there, whatever is lost, doubled, delayed or killed.

use std::{collections::BTreeMap, time::Duration};

use cotorra_agent_protocol::{
    Action, Agent, Controller, ControllerEvent, LEASE, LinkState, Report, Run, Transmit, Wanted, WantedLink,
    WantedProbes,
};
use cotorra_graph::{AgentId, Conditions, LinkId, Probing, Reached, Timestamp};
use proptest::prelude::*;

use crate::rig::{Carrier, Message, STEP, settling, tell};

type Links = BTreeMap<LinkId, WantedLink>;

fn name() -> AgentId {
    AgentId::new("gate1").unwrap()
}

fn link(number: u8) -> LinkId {
    format!("gate-arm{number}").parse().unwrap()
}

fn wanted(delay_ms: u8) -> WantedLink {
    let conditions = Conditions { delay: Duration::from_millis(delay_ms.into()), ..Conditions::default() };
    WantedLink {
        interface: "eth1".to_owned(),
        addresses: None,
        leaving: conditions.clone(),
        arriving: conditions,
        probes: None,
    }
}

/// The machine of an agent: its disk, its kernel, and the agent's process if it lives.
struct Machine {
    saved: Option<Wanted>,
    boots: u64,
    agent: Option<Agent>,
    /// The conditions of interfaces, which outlive the agent's process.
    emulated: Links,
    /// The links that the process is to emulate.
    wanted: Links,
    /// Whether the interface of a link is missing.
    is_missing: bool,
    /// When a message of the newest run arrived last.
    heard: Timestamp,
}

impl Machine {
    /// Does what the kernel allows, and reports the outcome.
    fn emulate(&mut self) -> BTreeMap<LinkId, LinkState> {
        let is_missing = |link: &LinkId| self.is_missing && *link == self::link(0);
        self.emulated = self.wanted.clone();
        self.emulated.retain(|link, _| !is_missing(link));
        let state = |link| match is_missing(link) {
            true => LinkState::Failed("there is no interface `eth1`".to_owned()),
            false => LinkState::Applied,
        };
        self.wanted.keys().map(|link| (link.clone(), state(link))).collect()
    }
}

struct World {
    now: Timestamp,
    runs: u64,
    controller: Controller,
    /// Wanted state now, and in each generation.
    wanted: Links,
    generations: BTreeMap<(Run, u64), Links>,
    machine: Machine,
    network: Carrier,
    /// What the core learned of each link, in this run.
    told: Vec<(LinkId, LinkState)>,
}

impl World {
    fn new(network: Carrier) -> Self {
        let mut world = Self {
            now: Timestamp::ZERO,
            runs: 0,
            controller: Controller::new(Run(0), LEASE, Vec::new(), []),
            wanted: Links::new(),
            generations: BTreeMap::new(),
            machine: Machine {
                saved: None,
                boots: 0,
                agent: None,
                emulated: Links::new(),
                wanted: Links::new(),
                is_missing: false,
                heard: Timestamp::ZERO,
            },
            network,
            told: Vec::new(),
        };
        world.start_core();
        world.start_agent();
        world
    }

    /// Kills the core if it lives, and starts the next run.
    fn start_core(&mut self) {
        self.runs += 1;
        self.controller = Controller::new(Run(self.runs), LEASE, Vec::new(), [name()]);
        self.wanted.clear();
        self.told.clear();
    }

    /// Kills the agent. The kernel keeps its conditions.
    fn kill_agent(&mut self) {
        self.machine.agent = None;
    }

    /// Starts the agent, which restores what a killed one left.
    fn start_agent(&mut self) {
        self.kill_agent();
        let Machine { saved, boots, agent, emulated, wanted, .. } = &mut self.machine;
        *boots += 1;
        (*emulated, *wanted) = Default::default();
        *agent = Some(Agent::new(self.now, *boots, saved.clone()));
    }

    fn want(&mut self, number: u8, delay_ms: u8) {
        self.wanted.insert(link(number), wanted(delay_ms));
        self.controller.emulate(&name(), link(number), wanted(delay_ms));
    }

    fn stop_all(&mut self) {
        self.wanted.clear();
        self.controller.stop_all();
    }

    fn step(&mut self) {
        self.now = self.now + STEP;
        let now = self.now;
        for message in self.network.arrived(now) {
            match message {
                Message::ToAgent(transmit) => self.tell_agent(transmit),
                Message::ToCore(report) => self.controller.receive(now, &name(), report),
            }
        }
        self.controller.advance(now);
        while let Some(event) = self.controller.poll_event() {
            if let ControllerEvent::Link(agent, link, state) = event {
                assert_eq!(agent, name());
                self.told.push((link, state));
            }
        }
        while let Some(transmit) = self.controller.poll_transmit(now) {
            if let Transmit::Wanted(_, wanted) = &transmit {
                let links = wanted.links.clone();
                self.generations.insert((wanted.run, wanted.generation), links);
            }
            self.network.send(now, Message::ToAgent(transmit));
        }
        self.run_agent();
    }

    fn tell_agent(&mut self, transmit: Transmit) {
        let now = self.now;
        let Some(agent) = &mut self.machine.agent else { return };
        let run = tell(agent, now, transmit);
        if agent.run() == Some(run) {
            self.machine.heard = now;
        }
    }

    fn run_agent(&mut self) {
        let now = self.now;
        let Some(mut agent) = self.machine.agent.take() else { return };
        agent.advance(now);
        let states = self.machine.emulate();
        agent.set_link_states(now, states);
        let mut reports = Vec::new();
        while let Some(action) = agent.poll(now) {
            match action {
                Action::Save(wanted) => self.machine.saved = Some(*wanted),
                Action::Emulate(links) => {
                    self.machine.wanted = links;
                    let states = self.machine.emulate();
                    agent.set_link_states(now, states);
                }
                Action::Report(report) => {
                    self.check(&report);
                    reports.push(report);
                }
                action => panic!("nobody wants {action:?}"),
            }
        }
        if now >= self.machine.heard + LEASE {
            assert_eq!(self.machine.emulated, Links::new(), "the core is away");
        }
        self.machine.agent = Some(agent);
        reports.into_iter().for_each(|report| self.network.send(now, Message::ToCore(report)));
    }

    /// A report says what is true when it is sent.
    fn check(&self, report: &Report) {
        let Machine { emulated, .. } = &self.machine;
        let applied = report.links.iter().filter(|(_, state)| **state == LinkState::Applied);
        assert_eq!(applied.map(|(link, _)| link).collect::<Vec<_>>(), emulated.keys().collect::<Vec<_>>());
        if let Some(wanted) = self.generations.get(&(report.run, report.generation)) {
            for (link, conditions) in emulated {
                assert_eq!(wanted.get(link), Some(conditions), "it is what its generation wants");
            }
            assert!(report.links.is_empty() || report.links.len() == wanted.len());
        } else {
            assert_eq!(report.links.len(), 0, "nothing is wanted yet");
        }
    }

    fn steps(&mut self, count: u32) {
        (0..count).for_each(|_| self.step());
    }

    /// Steps until a lease and what is under way have passed, several times over.
    fn settle(&mut self) {
        self.steps(settling());
    }
}

#[derive(Debug, Clone)]
enum Step {
    Want(u8, u8),
    StopAll,
    StartCore,
    KillAgent,
    StartAgent,
    Cut,
    Heal,
    Unplug,
    Plug,
    Wait(u8),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        5 => (0_u8..3, any::<u8>()).prop_map(|(number, delay)| Step::Want(number, delay)),
        1 => Just(Step::StopAll),
        1 => Just(Step::StartCore),
        1 => Just(Step::KillAgent),
        2 => Just(Step::StartAgent),
        1 => Just(Step::Cut),
        1 => Just(Step::Heal),
        1 => Just(Step::Unplug),
        1 => Just(Step::Plug),
        6 => any::<u8>().prop_map(Step::Wait),
    ]
}

proptest! {
    /// All assertions of the world hold at each step. In the end, what is emulated is what is wanted, and the core knows it.
    #[test]
    fn what_is_emulated_is_what_is_wanted_in_the_end(
        steps in prop::collection::vec(step(), 1..60),
        faults in prop::collection::vec(any::<u8>(), 1..200),
    ) {
        let mut world = World::new(Carrier::with(faults));
        for step in steps {
            match step {
                Step::Want(number, delay_ms) => world.want(number, delay_ms),
                Step::StopAll => world.stop_all(),
                Step::StartCore => world.start_core(),
                Step::KillAgent => world.kill_agent(),
                Step::StartAgent => world.start_agent(),
                Step::Cut => world.network.is_cut = true,
                Step::Heal => world.network.is_cut = false,
                Step::Unplug => world.machine.is_missing = true,
                Step::Plug => world.machine.is_missing = false,
                Step::Wait(steps) => world.steps(steps.into()),
            }
        }
        if world.machine.agent.is_none() {
            world.start_agent();
        }
        world.machine.is_missing = false;
        world.network.heal();
        world.settle();
        prop_assert!(world.controller.is_settled());
        prop_assert_eq!(&world.machine.emulated, &world.wanted);
        for link in world.wanted.keys() {
            let last = world.told.iter().rfind(|(its, _)| its == link);
            prop_assert_eq!(last.map(|(_, state)| state), Some(&LinkState::Applied));
        }
    }
}

/// A world without faults in which two links are emulated.
fn emulating() -> World {
    let mut world = World::new(Carrier::sound());
    world.want(0, 20);
    world.want(1, 5);
    world.settle();
    assert_eq!(world.machine.emulated, world.wanted);
    world
}

#[test]
fn links_lose_their_conditions_without_the_core_and_get_them_back_with_it() {
    let mut world = emulating();
    world.network.is_cut = true;
    world.settle();
    assert_eq!(world.machine.emulated, Links::new());
    world.network.is_cut = false;
    world.settle();
    assert_eq!(world.machine.emulated, world.wanted);
}

#[test]
fn the_end_of_a_run_and_the_next_run_remove_conditions() {
    let mut world = emulating();
    world.stop_all();
    world.steps(20);
    assert_eq!(world.machine.emulated, Links::new());
    assert!(world.controller.is_settled());
    let mut world = emulating();
    world.start_core();
    world.steps(20);
    assert_eq!(world.machine.emulated, Links::new(), "well before the lease of the killed core ends");
}

#[test]
fn a_restarted_agent_waits_for_the_core() {
    let mut world = emulating();
    world.network.cut();
    world.start_agent();
    world.steps(20);
    assert_eq!(world.machine.emulated, Links::new());
    world.network.is_cut = false;
    world.settle();
    assert_eq!(world.machine.emulated, world.wanted);
}

#[test]
fn a_failure_and_the_success_after_it_are_told_once() {
    let mut world = emulating();
    let applied = [0, 1].map(|number| (link(number), LinkState::Applied));
    assert_eq!(world.told, applied);
    world.machine.is_missing = true;
    world.settle();
    world.want(0, 30);
    world.settle();
    let failed = LinkState::Failed("there is no interface `eth1`".to_owned());
    assert_eq!(world.told[2..], [(link(0), failed)]);
    world.machine.is_missing = false;
    world.settle();
    assert_eq!(world.told[3..], [(link(0), LinkState::Applied)]);
    world.want(0, 40);
    world.settle();
    assert_eq!(world.told.len(), 4, "a change is no news");
}

/// A wanted state with so many links that are probed like this.
fn probed(count: usize, probing: Probing) -> Wanted {
    let probes =
        WantedProbes { reflector: [10, 0, 0, 7].into(), probing, medium_delay: Duration::from_micros(1500) };
    let link =
        |place| (format!("l{place}").parse().unwrap(), WantedLink { probes: Some(probes), ..wanted(1) });
    Wanted {
        run: Run(1),
        generation: 1,
        lease_ms: 2000,
        files: Vec::new(),
        instances: BTreeMap::new(),
        robot: None,
        links: (0..count).map(link).collect(),
        wifi: Default::default(),
    }
}

#[test]
fn more_links_and_probes_than_an_agent_can_have_are_rejected() {
    let fastest = Probing { interval: Duration::from_millis(1), window: Duration::from_secs(10) };
    let most = probed(Reached::MOST_VIA_AGENT, fastest);
    assert_eq!(Wanted::decode(&most.encode()).unwrap(), most);
    let error = |count, probing| Wanted::decode(&probed(count, probing).encode()).unwrap_err().to_string();
    assert_eq!(error(Reached::MOST_VIA_AGENT + 1, fastest), "257 links, of at most 256");
    let faster = Probing { interval: Duration::from_micros(999), ..fastest };
    assert_eq!(error(1, faster), "probes of `l0` beyond the bounds");
    let longer = Probing { window: Duration::from_millis(10_001), ..fastest };
    assert_eq!(error(1, longer), "probes of `l0` beyond the bounds");
}
