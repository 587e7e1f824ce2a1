//! Three machines with real agents, two access points and a robot, whose radios are emulated (mac80211_hwsim): a core serves a
//! network there, and sends the robot from one access point to the other. In the end, all is as their owners had it.
//!
//! Needs root of a kernel with three such radios, which `COTORRA_RADIOS` promises.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "the core's only clock")]

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::Child,
    sync::{Arc, mpsc},
    time::{Duration, Instant},
};

use cotorra_agent_protocol::{
    Controller, ControllerEvent, LEASE, MachineReading, RadioEvent, RadioState, Run, WantedRadio,
    WantedRequest, WifiRequest,
};
use cotorra_agent_transport::{Credentials, FromAgent, Granted, Receiver, Router};
use cotorra_enrolment::Authority;
use cotorra_graph::{AgentId, Timestamp};
use cotorra_testing::radios::{self, AGENTS, CORE, Ping, sh};
use cotorra_wifi::{
    AccessPointSettings, Band, Bss, Channel, Client, Event, FastTransition, InterfaceName, MacAddress,
    MobilityDomain, Network, Protection, Radio, Security, StationSettings, Width, hostapd,
};

const RUN: Run = Run(1);
const ROBOT: MacAddress = MacAddress([2, 0, 0, 0, 0, 0]);
/// Longer than anything here needs.
const LONG: Duration = Duration::from_secs(60);
fn name(number: usize) -> AgentId {
    AgentId::new(AGENTS[number]).unwrap()
}

fn interface(number: usize) -> InterfaceName {
    format!("wlan{number}").parse().unwrap()
}

fn bssid(unit: u8) -> MacAddress {
    MacAddress([2, 0, 0, 0, unit, 0])
}

fn channel(unit: u8) -> Channel {
    Channel::new(Band::Ghz2, if unit == 1 { 1 } else { 6 }, Width::Mhz20).unwrap()
}

fn security(unit: u8) -> Security {
    let holder = format!("unit{unit}").parse().unwrap();
    Security::Wpa2 {
        passphrase: "correct horse".parse().unwrap(),
        protection: Protection::Required,
        fast_transition: Some(FastTransition { domain: MobilityDomain(0xc070), holder, over_ds: true }),
    }
}

fn access_point(unit: u8) -> WantedRadio {
    WantedRadio::AccessPoint(Box::new(AccessPointSettings {
        radio: Radio::new(channel(unit)),
        bss: Bss { bridge: "br0".parse().ok(), ..Bss::new("corridor".parse().unwrap(), security(unit)) },
        virtual_aps: Vec::new(),
        power: None,
        neighbours: Vec::new(),
    }))
}

fn station() -> WantedRadio {
    let network = Network::new("corridor".parse().unwrap(), security(1).credentials());
    let network = Network { channels: vec![channel(1), channel(2)], ..network };
    WantedRadio::Station(Box::new(StationSettings { network, power: None }))
}

/// Waits until the machines are as their owners had them, and nothing is left on them.
fn become_home() {
    let is_left = |number| {
        let own = Path::new(&radios::state(number)).join(format!("wifi/wlan{number}"));
        own.join("own").exists() || own.join("owner.json").exists()
    };
    radios::wait_for_owners(|| !(0..3).any(is_left));
}

fn start_agent(number: usize) -> Child {
    radios::start_agent(env!("CARGO_BIN_EXE_cotorra-agent").as_ref(), number)
}

/// The core: a router, and the state of the protocol.
struct Core {
    router: Router,
    controller: Controller,
    inbox: mpsc::Receiver<(AgentId, FromAgent)>,
    began: Instant,
    /// The newest reading of each machine.
    readings: BTreeMap<AgentId, MachineReading>,
}

impl Core {
    fn start(authority: &Authority) -> Self {
        let today = chrono::Utc::now();
        let core = authority.core(today).unwrap();
        let credentials = Credentials {
            authority: &core.authority_pem,
            certificate: &core.certificate_pem,
            key: &core.key_pem,
        };
        let granted = authority.granted(today).unwrap().into_iter();
        let granted: Vec<_> =
            granted.map(|its| Granted { agent: its.name, common_name: its.common_name }).collect();
        let (arrived, inbox) = mpsc::channel();
        let receiver: Receiver = Arc::new(move |agent, message, _| drop(arrived.send((agent, message))));
        let router = Router::open(CORE.parse().unwrap(), credentials, &granted, BTreeMap::new(), &receiver);
        let controller = Controller::new(RUN, LEASE, Vec::new(), (0..3).map(name));
        let (router, began, readings) = (router.unwrap(), Instant::now(), BTreeMap::new());
        Self { router, controller, inbox, began, readings }
    }

    fn now(&self) -> Timestamp {
        Timestamp::ZERO + self.began.elapsed()
    }

    /// Runs until an event is the last that `is_last` waits for. Returns all events.
    fn until(
        &mut self,
        mut is_last: impl FnMut(&Self, Option<&ControllerEvent>) -> bool,
    ) -> Vec<ControllerEvent> {
        let (ends, mut seen) = (self.now() + LONG, Vec::new());
        loop {
            let now = self.now();
            assert!(now < ends, "only {seen:?}");
            self.controller.advance(now);
            while let Some(transmit) = self.controller.poll_transmit(now) {
                self.router.send(&transmit);
            }
            while let Some(event) = self.controller.poll_event() {
                seen.push(event);
                if is_last(self, seen.last()) {
                    return seen;
                }
            }
            if is_last(self, None) {
                return seen;
            }
            let Ok((agent, message)) = self.inbox.recv_timeout(self.controller.next_deadline().since(now))
            else {
                continue;
            };
            let now = self.now();
            match message {
                FromAgent::Connection { boot, is_there } => {
                    self.controller.connection(now, &agent, boot, is_there);
                }
                FromAgent::Report(report) => self.controller.receive(now, &agent, report),
                FromAgent::Context(bytes) => {
                    self.readings.insert(agent, MachineReading::decode(&bytes).unwrap());
                }
                other => panic!("{other:?}"),
            }
        }
    }

    /// Runs until each of these events has happened.
    fn until_all(&mut self, mut wanted: Vec<(usize, Event)>) -> Vec<RadioEvent> {
        let seen = self.until(|_, event| {
            if let Some(ControllerEvent::Wifi(agent, happened)) = event {
                wanted.retain(|(number, event)| *agent != name(*number) || happened.event != *event);
            }
            wanted.is_empty()
        });
        let event = |event| match event {
            ControllerEvent::Wifi(_, event) => Some(event),
            _ => None,
        };
        seen.into_iter().filter_map(event).collect()
    }

    /// Wants the access points, and then the robot to join them.
    fn want_all(&mut self) -> Vec<ControllerEvent> {
        for unit in [1, 2] {
            let number = usize::from(unit);
            self.controller.use_radio(&name(number), interface(number), access_point(unit));
        }
        let mut missing = vec![1, 2];
        let seen = self.until(|_, event| {
            if let Some(ControllerEvent::Wifi(agent, RadioEvent { event: Event::AccessPointEnabled, .. })) =
                event
            {
                missing.retain(|number| *agent != name(*number));
            }
            missing.is_empty()
        });
        self.controller.use_radio(&name(0), interface(0), station());
        seen
    }

    fn ask_robot(&mut self, request: WifiRequest) -> u64 {
        let request = WantedRequest { interface: interface(0), request };
        self.controller.request(&name(0), request).unwrap()
    }
}

/// Returns the time from a robot's first frame to the next access point until it may send data there.
fn gap(events: &[RadioEvent], to: MacAddress) -> Duration {
    let at = |wanted: &dyn Fn(&Event) -> bool| events.iter().rfind(|its| wanted(&its.event)).unwrap().at_ns;
    let connected = at(&|event| *event == Event::Connected { bssid: to });
    let began =
        at(&|event| [Event::Authenticating { bssid: to }, Event::Associating { bssid: to }].contains(event));
    Duration::from_nanos(connected - began)
}

fn is_joined(event: Option<&ControllerEvent>) -> bool {
    matches!(event, Some(ControllerEvent::Wifi(_, RadioEvent { event: Event::Connected { .. }, .. })))
}

#[test]
fn a_core_serves_a_network_by_agents_and_leaves_all_as_it_was() {
    if !radios::are_promised() {
        return;
    }
    radios::connect(["phy0", "phy1", "phy2"]);
    radios::start_owners("10.8.0.10/24");
    become_home();
    let today = chrono::Utc::now();
    let authority = Authority::create_or_open("/run/authority", today).unwrap();
    for number in 0..3 {
        let bundle = authority
            .enrol(&name(number), &CORE.parse().unwrap(), Duration::from_secs(86400), today)
            .unwrap();
        bundle.write(Path::new(&format!("/run/{}.agent", name(number)))).unwrap();
    }
    let mut agents: Vec<_> = (0..3).map(start_agent).collect();
    let mut core = Core::start(&authority);

    let served = core.want_all();
    let joined = core.until(|_, event| is_joined(event));
    let seen = [served, joined.clone()].concat();
    for unit in [1, 2] {
        let ready = ControllerEvent::Radio(name(unit), interface(unit), RadioState::Ready);
        assert!(seen.contains(&ready), "{seen:?}");
    }
    let Some(ControllerEvent::Wifi(_, RadioEvent { event: Event::Connected { bssid: at }, .. })) =
        joined.last()
    else {
        panic!("{joined:?}")
    };
    let (here, there) = if *at == bssid(1) { (1, 2) } else { (2, 1) };

    // Contexts: who is there with which signal, and which radio units the robot hears.
    core.ask_robot(WifiRequest::Scan { channels: vec![channel(1), channel(2)], stays: true });
    core.until_all(vec![(0, Event::ScanResults)]);
    core.until(|core, _| {
        let station = core.readings.get(&name(here)).and_then(|reading| {
            reading
                .context
                .wifi
                .iter()
                .flat_map(|wifi| &wifi.stations)
                .find(|its| its.mac == ROBOT.to_string())
        });
        let heard = core.readings.get(&name(0)).and_then(|reading| reading.heard.get(&interface(0)));
        station.is_some_and(|station| station.signal.is_some())
            && heard.is_some_and(|heard| {
                [1, 2].iter().all(|unit| heard.iter().any(|its| its.bssid == bssid(*unit)))
            })
    });

    // There over the air, and back over the distribution system.
    for (unit, over_ds) in [(there, false), (here, true)] {
        let to = bssid(u8::try_from(unit).unwrap());
        let ping = Ping::start();
        sh("sleep 0.1");
        let number = core.ask_robot(WifiRequest::Roam { to, over_ds });
        let mut is_taken = false;
        let mut wanted =
            vec![(0, Event::Connected { bssid: to }), (unit, Event::StationConnected { station: ROBOT })];
        let seen = core.until(|_, event| {
            match event {
                Some(ControllerEvent::Request(agent, its, answer)) => {
                    assert_eq!((agent, *its, answer), (&name(0), number, &Ok(())));
                    is_taken = true;
                }
                Some(ControllerEvent::Wifi(agent, happened)) => {
                    wanted.retain(|(number, event)| *agent != name(*number) || happened.event != *event);
                }
                _ => {}
            }
            wanted.is_empty() && is_taken
        });
        let events: Vec<_> = seen
            .into_iter()
            .filter_map(|event| match event {
                ControllerEvent::Wifi(agent, event) if agent == name(0) => Some(event),
                _ => None,
            })
            .collect();
        assert!(!events.iter().any(|its| matches!(its.event, Event::Disconnected { .. })), "{events:?}");
        let gap = gap(&events, to);
        sh("sleep 0.1");
        let without_answers = ping.longest_gap();
        let way = if over_ds { "over the DS" } else { "over the air" };
        eprintln!("FT {way}: gap {gap:?} by frames, {without_answers:?} by answers");
        let most = Duration::from_millis(50);
        assert!(gap < most && without_answers < most, "802.11r aims at 50 ms");
    }

    // The owner's neighbour knows no others.
    let nobody = core.ask_robot(WifiRequest::Roam { to: bssid(9), over_ds: false });
    core.until(
        |_, event| matches!(event, Some(ControllerEvent::Request(_, number, Err(_))) if *number == nobody),
    );

    // A killed agent's hostapd goes on until its next start, which puts it back, and then serves again.
    agents[1].kill().unwrap();
    agents[1].wait().unwrap();
    core.until(|_, event| matches!(event, Some(ControllerEvent::Left(agent, _)) if *agent == name(1)));
    assert!(sh("ip netns exec u1 iw dev").contains("ssid corridor"));
    agents[1] = start_agent(1);
    core.until_all(vec![(1, Event::AccessPointEnabled)]);
    assert!(fs::read_to_string(radios::log(1)).unwrap().contains("which a killed agent left"));

    // The end of a run.
    core.controller.stop_all();
    core.until(|core, _| core.controller.is_settled());
    become_home();

    // The loss of the core.
    core.want_all();
    core.until(|_, event| is_joined(event));
    drop(core);
    become_home();
    let mut client = Client::connect("/run/hostapd/wlan1".as_ref(), "/run".as_ref()).unwrap();
    assert_eq!(client.request(&hostapd::status()).unwrap().state, hostapd::State::Enabled);

    for agent in &mut agents {
        sh(&format!("kill {}", agent.id()));
        assert!(agent.wait().unwrap().success());
    }
}
