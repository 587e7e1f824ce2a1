//! Links have the conditions that the core wants as long as it is there, whatever is lost, doubled, delayed or killed.

use std::{collections::BTreeMap, time::Duration};

use cotorra_agent_protocol::{
    Action, Agent, ControllerEvent, LEASE, LinkState, Report, Run, Wanted, WantedLink, WantedProbes,
};
use cotorra_graph::{Conditions, LinkId, Probing, Reached, Timestamp};
use proptest::prelude::*;

use crate::rig::{Carrier, Fault, Machine, World, fault, nothing};

type Links = BTreeMap<LinkId, WantedLink>;

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

/// The machine of an agent that emulates links.
#[derive(Default)]
struct Gate {
    /// The conditions of interfaces, which outlive the agent's process.
    emulated: Links,
    /// The links that the process is to emulate.
    to_emulate: Links,
    /// Whether the interface of a link is missing.
    is_missing: bool,
    /// Wanted state now, and in each generation.
    wanted: Links,
    generations: BTreeMap<(Run, u64), Links>,
    /// Reports of each link to the core, in this run.
    told: Vec<(LinkId, LinkState)>,
}

impl Machine for Gate {
    const AGENT: &str = "gate1";

    fn restart_core(&mut self) {
        self.wanted.clear();
        self.told.clear();
    }

    /// Restores what a killed process left.
    fn restart_agent(&mut self) {
        (self.emulated, self.to_emulate) = Default::default();
    }

    fn sent(&mut self, wanted: &Wanted) {
        self.generations.insert((wanted.run, wanted.generation), wanted.links.clone());
    }

    fn learn(&mut self, _: Run, event: ControllerEvent) {
        if let ControllerEvent::Link(agent, link, state) = event {
            assert_eq!(agent, World::<Self>::name());
            self.told.push((link, state));
        }
    }

    /// Does what the kernel allows, and reports the outcome.
    fn before(&mut self, now: Timestamp, agent: &mut Agent) {
        let is_missing = |link: &LinkId| self.is_missing && *link == self::link(0);
        self.emulated = self.to_emulate.clone();
        self.emulated.retain(|link, _| !is_missing(link));
        let state = |link| match is_missing(link) {
            true => LinkState::Failed("there is no interface `eth1`".to_owned()),
            false => LinkState::Applied,
        };
        let states = self.to_emulate.keys().map(|link| (link.clone(), state(link))).collect();
        agent.set_link_states(now, states);
    }

    fn act(&mut self, now: Timestamp, agent: &mut Agent, action: Action) {
        let Action::Emulate(links) = action else { panic!("nobody wants {action:?}") };
        self.to_emulate = links;
        self.before(now, agent);
    }

    /// A report says what is true when it is sent.
    fn examine(&self, report: &Report) {
        let emulated = &self.emulated;
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

    fn after(&mut self, _: Timestamp, _: &mut Agent, _: Run, silence: Duration) {
        assert!(silence < LEASE || self.emulated.is_empty(), "the core is away");
    }
}

impl World<Gate> {
    fn want(&mut self, number: u8, delay_ms: u8) {
        self.machine.wanted.insert(link(number), wanted(delay_ms));
        self.controller.emulate(&Self::name(), link(number), wanted(delay_ms));
    }

    fn stop_all(&mut self) {
        self.machine.wanted.clear();
        self.controller.stop_all();
    }
}

#[derive(Debug, Clone)]
enum Step {
    Want(u8, u8),
    StopAll,
    Unplug,
    Plug,
    Fault(Fault),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        5 => (0_u8..3, any::<u8>()).prop_map(|(number, delay)| Step::Want(number, delay)),
        1 => Just(Step::StopAll),
        1 => Just(Step::Unplug),
        1 => Just(Step::Plug),
        12 => fault().prop_map(Step::Fault),
    ]
}

proptest! {
    /// All assertions of the world hold at each step. In the end, what is emulated is what is wanted, and the core knows it.
    #[test]
    fn what_is_emulated_is_what_is_wanted_in_the_end(
        steps in prop::collection::vec(step(), 1..60),
        faults in prop::collection::vec(any::<u8>(), 1..200),
    ) {
        let mut world = World::<Gate>::new(Carrier::with(faults));
        for step in steps {
            match step {
                Step::Want(number, delay_ms) => world.want(number, delay_ms),
                Step::StopAll => world.stop_all(),
                Step::Unplug => world.machine.is_missing = true,
                Step::Plug => world.machine.is_missing = false,
                Step::Fault(fault) => world.suffer(fault),
            }
        }
        world.machine.is_missing = false;
        world.recover();
        prop_assert_eq!(&world.machine.emulated, &world.machine.wanted);
        for link in world.machine.wanted.keys() {
            let last = world.machine.told.iter().rfind(|(its, _)| its == link);
            prop_assert_eq!(last.map(|(_, state)| state), Some(&LinkState::Applied));
        }
    }
}

/// A world without faults in which two links are emulated.
fn emulating() -> World<Gate> {
    let mut world = World::<Gate>::new(Carrier::sound());
    world.want(0, 20);
    world.want(1, 5);
    world.settle();
    assert_eq!(world.machine.emulated, world.machine.wanted);
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
    assert_eq!(world.machine.emulated, world.machine.wanted);
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
    assert_eq!(world.machine.emulated, world.machine.wanted);
}

#[test]
fn a_failure_and_the_success_after_it_are_told_once() {
    let mut world = emulating();
    let applied = [0, 1].map(|number| (link(number), LinkState::Applied));
    assert_eq!(world.machine.told, applied);
    world.machine.is_missing = true;
    world.settle();
    world.want(0, 30);
    world.settle();
    let failed = LinkState::Failed("there is no interface `eth1`".to_owned());
    assert_eq!(world.machine.told[2..], [(link(0), failed)]);
    world.machine.is_missing = false;
    world.settle();
    assert_eq!(world.machine.told[3..], [(link(0), LinkState::Applied)]);
    world.want(0, 40);
    world.settle();
    assert_eq!(world.machine.told.len(), 4, "a change is no news");
}

/// A wanted state with so many links that are probed like this.
fn probed(count: usize, probing: Probing) -> Wanted {
    let probes =
        WantedProbes { reflector: [10, 0, 0, 7].into(), probing, medium_delay: Duration::from_micros(1500) };
    let link =
        |place| (format!("l{place}").parse().unwrap(), WantedLink { probes: Some(probes), ..wanted(1) });
    Wanted { links: (0..count).map(link).collect(), ..nothing() }
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
