//! Wi-Fi interfaces are what the core wants as long as it is there, requests are carried out once, and no event is told twice,
//! whatever is lost, doubled, delayed or killed.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_agent_protocol::{
    Action, Agent, Controller, ControllerEvent, LEASE, RADIOS_KEPT, RadioState, Report, Run, Wanted,
    WantedRadio, WantedRequest, WantedWifi, WifiRequest,
};
use cotorra_graph::Timestamp;
use cotorra_wifi::{
    AccessPointSettings, Band, Bss, Channel, Credentials, Event, InterfaceName, MacAddress, Network, Power,
    Radio, Security, Ssid, StationSettings, Width,
};
use proptest::prelude::*;

use crate::rig::{Carrier, Fault, Machine, World, fault, nothing};

type Radios = BTreeMap<InterfaceName, WantedRadio>;

fn interface(number: u8) -> InterfaceName {
    format!("wlan{number}").parse().unwrap()
}

fn channel(number: u8) -> Channel {
    Channel::new(Band::Ghz2, number, Width::Mhz20).unwrap()
}

fn ssid() -> Ssid {
    "corridor".parse().unwrap()
}

fn settings(on: u8) -> AccessPointSettings {
    AccessPointSettings {
        radio: Radio::new(channel(on)),
        bss: Bss::new(ssid(), Security::Open),
        virtual_aps: Vec::new(),
        power: None,
        neighbours: Vec::new(),
    }
}

fn radio(on: u8) -> WantedRadio {
    WantedRadio::AccessPoint(Box::new(settings(1 + on % 13)))
}

fn roam() -> WantedRequest {
    let request = WifiRequest::Roam { to: MacAddress([2, 0, 0, 0, 1, 0]), over_ds: false };
    WantedRequest { interface: interface(0), request }
}

/// Each event differs.
fn event(number: u32) -> Event {
    Event::ChannelSwitched { frequency_mhz: number }
}

/// The machine of an agent that controls Wi-Fi interfaces.
#[derive(Default)]
struct Unit {
    /// State of the radios, which outlives the agent's process.
    used: Radios,
    /// Numbers of the requests that were carried out, by run.
    carried_out: BTreeSet<(Run, u64)>,
    wanted: Radios,
    /// The last state that the core learned of each interface in this run.
    told: BTreeMap<InterfaceName, RadioState>,
    /// Requests of this run, and whether each was taken.
    requests: BTreeMap<u64, Option<bool>>,
    happened: u32,
    /// Events that the core learned, in this run.
    events: Vec<u32>,
}

impl Machine for Unit {
    const AGENT: &str = "ap1";

    fn restart_core(&mut self) {
        (self.wanted, self.told, self.requests, self.events) = Default::default();
    }

    /// Puts back what a killed process left.
    fn restart_agent(&mut self) {
        self.used.clear();
    }

    fn learn(&mut self, run: Run, event: ControllerEvent) {
        match event {
            ControllerEvent::Radio(_, interface, state) => drop(self.told.insert(interface, state)),
            ControllerEvent::Request(_, number, answer) => {
                let was_taken = answer.is_ok();
                assert_eq!(self.requests.insert(number, Some(was_taken)), Some(None), "answered once");
                let is_done = self.carried_out.contains(&(run, number));
                assert!(is_done || !was_taken);
            }
            ControllerEvent::Wifi(_, event) => {
                let Event::ChannelSwitched { frequency_mhz } = event.event else { panic!("{event:?}") };
                assert!(self.events.last().is_none_or(|last| *last < frequency_mhz), "in order, once");
                self.events.push(frequency_mhz);
            }
            _ => {}
        }
    }

    fn act(&mut self, now: Timestamp, agent: &mut Agent, action: Action) {
        match action {
            Action::UseRadios(radios) => {
                self.used = radios;
                let states = self.used.keys().map(|its| (its.clone(), RadioState::Ready));
                agent.set_radio_states(now, states.collect());
            }
            Action::Request(number, request) => {
                assert_eq!(request, roam());
                let run = agent.run().unwrap();
                assert!(self.carried_out.insert((run, number)), "carried out once");
                agent.answered(now, number, Ok(()));
            }
            action => panic!("nobody wants {action:?}"),
        }
    }

    fn after(&mut self, _: Timestamp, _: &mut Agent, _: Run, silence: Duration) {
        assert!(silence < RADIOS_KEPT || self.used.is_empty(), "the core is away");
    }
}

impl World<Unit> {
    fn want(&mut self, number: u8, on: u8) {
        self.machine.wanted.insert(interface(number), radio(on));
        self.controller.use_radio(&Self::name(), interface(number), radio(on));
    }

    fn release(&mut self, number: u8) {
        self.machine.wanted.remove(&interface(number));
        self.controller.release_radio(&Self::name(), &interface(number));
    }

    fn request(&mut self) {
        if let Ok(number) = self.controller.request(&Self::name(), roam()) {
            assert_eq!(self.machine.requests.insert(number, None), None);
        }
    }

    fn happen(&mut self) {
        self.machine.happened += 1;
        if let Some(agent) = &mut self.agent {
            agent.happened(self.now, interface(0), event(self.machine.happened));
        }
    }
}

#[derive(Debug, Clone)]
enum Step {
    Want(u8, u8),
    Release(u8),
    Request,
    Happen,
    Fault(Fault),
    Outlast,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (0_u8..3, any::<u8>()).prop_map(|(number, on)| Step::Want(number, on)),
        1 => (0_u8..3).prop_map(Step::Release),
        3 => Just(Step::Request),
        4 => Just(Step::Happen),
        12 => fault().prop_map(Step::Fault),
        1 => Just(Step::Outlast),
    ]
}

proptest! {
    /// All assertions of the world hold at each step. In the end, radios are as wanted, the core knows it, and each request has
    /// an answer.
    #[test]
    fn radios_are_as_wanted_in_the_end(
        steps in prop::collection::vec(step(), 1..60),
        faults in prop::collection::vec(any::<u8>(), 1..200),
    ) {
        let mut world = World::<Unit>::new(Carrier::with(faults));
        for step in steps {
            match step {
                Step::Want(number, on) => world.want(number, on),
                Step::Release(number) => world.release(number),
                Step::Request => world.request(),
                Step::Happen => world.happen(),
                Step::Fault(fault) => world.suffer(fault),
                Step::Outlast => world.pass(RADIOS_KEPT),
            }
        }
        world.recover();
        prop_assert_eq!(&world.machine.used, &world.machine.wanted);
        for interface in world.machine.wanted.keys() {
            prop_assert_eq!(world.machine.told.get(interface), Some(&RadioState::Ready));
        }
        prop_assert!(world.machine.requests.values().all(Option::is_some));
        world.happen();
        world.settle();
        prop_assert_eq!(world.machine.events.last(), Some(&world.machine.happened));
    }
}

#[test]
fn events_arrive_once_although_reports_and_beats_are_lost() {
    let mut draw = 0;
    // Each third message is lost.
    let mut world = World::<Unit>::new(Carrier::new(move || {
        draw = (draw + 1) % 3;
        draw
    }));
    world.settle();
    for _ in 0..50 {
        world.happen();
        world.steps(3);
    }
    world.settle();
    assert_eq!(world.machine.events, (1..=50).collect::<Vec<_>>());
}

#[test]
fn late_reports_of_a_killed_process_hide_no_events_of_the_next() {
    // The last report of the first process arrives after the first report of the second.
    let mut world = World::<Unit>::new(Carrier::with(vec![0, 2, 2, 7]));
    world.steps(6);
    world.start_agent();
    world.network.heal();
    world.settle();
    world.happen();
    world.settle();
    assert_eq!(world.machine.events, [1]);
}

#[test]
fn an_agent_that_is_away_takes_no_request() {
    let mut world = World::<Unit>::new(Carrier::sound());
    assert!(world.controller.request(&World::<Unit>::name(), roam()).unwrap_err().contains("not connected"));
    world.settle();
    world.request();
    world.settle();
    assert_eq!(world.machine.requests[&1], Some(true));
    world.network.cut();
    world.request();
    world.settle();
    assert_eq!(world.machine.requests[&2], Some(false));
}

#[test]
fn radios_stay_with_a_core_that_is_silent_for_a_while() {
    let mut world = World::<Unit>::new(Carrier::sound());
    world.want(1, 6);
    world.settle();
    world.network.cut();
    world.pass(RADIOS_KEPT - LEASE);
    assert!(world.agent().is_alone());
    assert_eq!(world.machine.used, world.machine.wanted);
    world.pass(LEASE * 2);
    assert_eq!(world.machine.used, Radios::new());
    world.network.is_cut = false;
    world.settle();
    assert_eq!(world.machine.used, world.machine.wanted);
}

fn wanted(wifi: WantedWifi) -> Wanted {
    Wanted { wifi, ..nothing() }
}

#[test]
fn wanted_radios_are_read_as_they_were_written() {
    let station = Network {
        channels: vec![channel(1), channel(6)],
        ..Network::new(
            ssid(),
            Credentials::Wpa3 { passphrase: "correct horse".parse().unwrap(), fast_transition: true },
        )
    };
    let station = StationSettings { network: station, power: Some(Power::AtMost(1000)) };
    let radios = [radio(3), WantedRadio::Station(Box::new(station)), WantedRadio::Silent];
    let radios = (0..).map(interface).zip(radios).collect();
    let wanted = wanted(WantedWifi { radios, requests: BTreeMap::from([(7, roam())]) });
    assert_eq!(Wanted::decode(&wanted.encode()).unwrap(), wanted);
    assert!(!format!("{wanted:?}").contains("horse"));
}

#[test]
fn more_than_wifi_interfaces_can_have_is_rejected() {
    let error = |wifi| Wanted::decode(&wanted(wifi).encode()).unwrap_err().to_string();
    let radios = |radio: WantedRadio, count| WantedWifi {
        radios: (0..count).map(|number| (interface(number), radio.clone())).collect(),
        requests: BTreeMap::new(),
    };
    assert_eq!(error(radios(WantedRadio::Silent, 9)), "9 Wi-Fi interfaces, of at most 8");
    let bss = Bss::new(ssid(), Security::Open);
    let many = AccessPointSettings {
        virtual_aps: (0..16).map(|number| (interface(number), bss.clone())).collect(),
        ..settings(1)
    };
    let many = WantedRadio::AccessPoint(Box::new(many));
    assert_eq!(error(radios(many, 1)), "16 virtual access points, of at most 15");
    let requests = (0..65).map(|number| (number, roam())).collect();
    let many = WantedWifi { radios: Radios::new(), requests };
    assert_eq!(error(many), "65 requests to Wi-Fi programs, of at most 64");
}

/// Messages from which the fuzzer starts, too.
const WANTED: &[u8] = include_bytes!("../../../../../fuzz/seeds/agents/wanted");
const REPORT: &[u8] = include_bytes!("../../../../../fuzz/seeds/agents/report");

#[test]
fn messages_on_the_wire_are_read() {
    let wanted = Wanted::decode(WANTED).unwrap();
    assert_eq!((wanted.wifi.radios.len(), wanted.wifi.requests.len()), (3, 2));
    let report = Report::decode(REPORT).unwrap();
    let connected = Event::Connected { bssid: MacAddress([2, 0, 0, 0, 1, 0]) };
    assert_eq!(report.wifi.events[0].event, connected);
    assert_eq!(report.wifi.radios[&interface(1)], RadioState::Failed("no".to_owned()));
}

proptest! {
    #[test]
    fn damaged_messages_are_read_or_rejected(
        is_report: bool,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let mut bytes = if is_report { REPORT } else { WANTED }.to_vec();
        for (place, byte) in damage {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        let now = Timestamp::ZERO;
        if let Ok(wanted) = Wanted::decode(&bytes) {
            let mut agent = Agent::new(now, 1, None);
            agent.want(now, wanted);
            while let Some(action) = agent.poll(now) {
                if let Action::Report(report) = action {
                    prop_assert!(Report::decode(&report.encode()).is_ok());
                }
            }
        }
        if let Ok(report) = Report::decode(&bytes) {
            let mut controller = Controller::new(report.run, LEASE, Vec::new(), [World::<Unit>::name()]);
            controller.receive(now, &World::<Unit>::name(), report);
            while controller.poll_event().is_some() {}
        }
    }
}
