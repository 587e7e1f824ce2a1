//! hostapd and wpa_supplicant, as they are, in the nodes of a datapath: a robot reaches a server over simulated radios, the
//! fabric's air, bridges and the fabric's links.
//!
//! Needs root and a kernel with mac80211_hwsim, such as that of `scripts/uml --radios 0`; the tests do nothing elsewhere.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

use std::{
    env,
    io::{self, BufRead, BufReader},
    net::{SocketAddr, UdpSocket},
    path::Path,
    process::{ChildStdout, Command, ExitStatus, Stdio},
    sync::mpsc::{Receiver, channel},
    time::Duration,
};

use cotorra_datapath::{
    Child, Datapath, Options, SpawnOptions,
    wifi::{self, BRIDGE, WLAN},
};
use cotorra_engine::Process;
use cotorra_fabric::{Association, Fabric};
use cotorra_graph::{
    ConditionChange, Direction, Event as NetworkEvent, HardwareGraph, HostAddress, LinkContext, LinkId, Loss,
    NodeId, PathLoss, Position, Probability, Stamped,
};
use cotorra_hwsim::Radios;
mod throughput;

use cotorra_wifi::{
    AccessPoint, Band, Bss, Channel, Client, Daemon, Event, Events, FastTransition, MacAddress,
    MobilityDomain, Network, Protection, Radio, Security, Station, Width, hostapd, wpa_supplicant,
};

/// Longer than anything here needs.
const LONG: Duration = Duration::from_secs(60);
/// Makes the process a helper of a test.
const HELPER: &str = "COTORRA_TEST_RADIOS";

/// A robot between two access points, and a server behind a switch.
const FLOOR: &str = "\
name: floor
wireless:
  lab:
    standard: n
    access: edca
    wifi: hwsim
    path_loss: { model: log_distance, exponent: 3 }
    shadowing: { deviation: 0 dB, correlation: 5 m }
nodes:
  robot: { kind: robot, position: [10, 0], cpus: 1, memory: 1 GB, tx_power: 15 dBm }
  ap0: { kind: radio_unit, position: [0, 0], channel: 1, tx_power: 20 dBm }
  ap1: { kind: radio_unit, position: [40, 0], channel: 6, tx_power: 20 dBm }
  lan: { kind: switch }
  edge: { kind: server, tier: edge, cpus: 1, memory: 1 GB }
links:
  - { ends: [lan, [ap0, ap1, edge]], delay: 2 ms }
";
const CHANNELS: [u8; 2] = [1, 6];

fn id(name: &str) -> NodeId {
    name.parse().unwrap()
}

fn graph() -> HardwareGraph {
    cotorra_testbed_file::parse("floor", FLOOR, Path::new("")).unwrap().graph
}

fn channel_number(number: u8) -> Channel {
    Channel::new(Band::Ghz2, number, Width::Mhz20).unwrap()
}

fn security(unit: usize, protection: Protection) -> Security {
    let transition = FastTransition {
        domain: MobilityDomain(1),
        holder: format!("ap{unit}").parse().unwrap(),
        over_ds: false,
    };
    Security::Wpa2 {
        passphrase: "an emulated network".parse().unwrap(),
        protection,
        fast_transition: Some(transition),
    }
}

/// Returns what starts programs in a node.
fn launcher<'a>(
    datapath: &'a Datapath,
    node: &str,
) -> impl FnMut(Command) -> io::Result<Box<dyn Process>> + use<'a> {
    let node = id(node);
    move |command| match datapath.spawn(
        &node,
        command,
        SpawnOptions { unique_number: true, ..SpawnOptions::default() },
    ) {
        Ok(child) => Ok(Box::new(InNode(child))),
        Err(error) => Err(io::Error::other(error)),
    }
}

/// A program in a node.
struct InNode(Child);

impl Process for InNode {
    fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
        self.0.try_wait()
    }

    fn terminate(&mut self) {
        self.0.terminate().unwrap();
    }

    fn kill(&mut self) {
        self.0.kill().unwrap();
    }

    fn stdout(&mut self) -> Option<ChildStdout> {
        self.0.pipes().1
    }
}

/// Fields are dropped in order: programs first.
struct Floor {
    supplicant: Client,
    told: Events,
    _programs: Vec<Daemon>,
    sockets: [UdpSocket; 2],
    datapath: Datapath,
    events: Receiver<Stamped>,
    graph: HardwareGraph,
}

impl Floor {
    /// Brings the floor up, with folders of this name; `None` where that cannot be.
    fn up(name: &str) -> Option<Self> {
        Self::protected(name, Protection::Optional)
    }

    /// Brings it up with or without protected management frames.
    fn protected(name: &str, protection: Protection) -> Option<Self> {
        let graph = graph();
        if let Err(error) = wifi::check(&graph) {
            eprintln!("nothing is tested: {error}");
            return None;
        }
        let (sender, events) = channel();
        let options = Options {
            // In virtual time, threads that keep cores awake would keep time from passing.
            let_cores_sleep: true,
            events: Some(Box::new(move |event| drop(sender.send(event)))),
            ..Options::default()
        };
        let datapath = Datapath::start(&graph, Fabric::new(&graph, 1).unwrap(), options).unwrap();
        let mut programs = Vec::new();
        for (unit, channel) in CHANNELS.into_iter().enumerate() {
            let bss = Bss {
                bridge: Some(BRIDGE.parse().unwrap()),
                ..Bss::new("lab".parse().unwrap(), security(unit, protection))
            };
            let access_point = AccessPoint {
                interface: WLAN.parse().unwrap(),
                driver: Default::default(),
                radio: Radio::new(channel_number(channel)),
                bss,
                virtual_aps: Vec::new(),
            };
            let folder = format!("/run/{name}-ap{unit}");
            let mut launch = launcher(&datapath, &format!("ap{unit}"));
            let daemon = Daemon::hostapd(&access_point, folder.as_ref(), &mut launch).unwrap();
            let mut client = daemon.client().unwrap();
            let mut events = client.events().unwrap();
            while client.request(&hostapd::status()).unwrap().state != hostapd::State::Enabled {
                events.next(LONG).unwrap().expect("it serves at last");
            }
            programs.push(daemon);
        }
        let network = Network {
            channels: CHANNELS.map(channel_number).to_vec(),
            ..Network::new("lab".parse().unwrap(), security(0, protection).credentials())
        };
        let station = Station {
            interface: WLAN.parse().unwrap(),
            driver: Default::default(),
            country: None,
            networks: vec![network],
        };
        let folder = format!("/run/{name}-robot");
        let daemon =
            Daemon::wpa_supplicant(&station, folder.as_ref(), &mut launcher(&datapath, "robot")).unwrap();
        let supplicant = daemon.client().unwrap();
        let told = supplicant.events().unwrap();
        programs.push(daemon);
        let sockets = ["robot", "edge"].map(|node| {
            let socket = datapath.namespace(&id(node)).unwrap().udp_socket("[::]:7711").unwrap();
            socket.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
            socket
        });
        let mut floor = Self { supplicant, told, _programs: programs, sockets, datapath, events, graph };
        floor.await_association(0, false);
        Some(floor)
    }

    fn address(&self, node: &str) -> HostAddress {
        self.graph.address(&id(node)).unwrap()
    }

    /// Waits until the robot is connected to an access point, and informs the fabric.
    fn await_association(&mut self, unit: usize, fast: bool) {
        let name = format!("ap{unit}");
        let bssid = MacAddress(self.address(&name).mac);
        let mut began = None;
        loop {
            let event = self.told.next(LONG).unwrap().expect("it connects at last").event;
            match event {
                Event::Authenticating { .. } => began = Some(self.datapath.clock().now()),
                Event::Connected { bssid: to } => {
                    assert_eq!(to, bssid);
                    break;
                }
                _ => {}
            }
        }
        let (robot, unit) = (id("robot"), id(&name));
        let handle = self.datapath.handle();
        let associate = move |fabric: &mut Fabric, now| {
            let association = Association { began: began.unwrap_or(now), fast };
            fabric.associate(now, &robot, &unit, association)
        };
        handle.with(associate).unwrap().unwrap();
    }

    /// Makes the robot roam.
    fn roam(&mut self, unit: usize) {
        let bssid = MacAddress(self.address(&format!("ap{unit}")).mac);
        self.supplicant.request(&wpa_supplicant::roam(bssid)).unwrap();
        self.await_association(unit, true);
    }

    /// Sends a datagram from the robot to the server and back. Returns how long it took.
    fn round_trip(&self, server: SocketAddr) -> Duration {
        let [robot, edge] = &self.sockets;
        let clock = self.datapath.clock();
        let mut buffer = [0; 2000];
        for number in 0..10_u64 {
            let sent = clock.now();
            robot.send_to(&number.to_ne_bytes(), server).unwrap();
            let Ok((length, from)) = edge.recv_from(&mut buffer) else { continue };
            edge.send_to(&buffer[..length], from).unwrap();
            if let Ok((length, _)) = robot.recv_from(&mut buffer)
                && buffer[..length] == number.to_ne_bytes()
            {
                return clock.now().since(sent);
            }
        }
        panic!("no answer from {server}");
    }

    /// Returns the packets that have crossed a link in both directions.
    fn packets(&self, link: &str) -> u64 {
        let contexts = self.datapath.handle().with(|fabric, now| fabric.link_contexts(now)).unwrap();
        contexts.iter().filter(|context| context.link == *link).map(|context| context.counters.packets).sum()
    }
}

#[test]
fn a_robot_reaches_a_server_and_roams_by_fast_transition() {
    let Some(mut floor) = Floor::up("reach") else { return };
    let HostAddress { ipv4, ipv6, .. } = floor.address("edge");
    let servers: [SocketAddr; 2] = [(ipv4, 7711).into(), (ipv6, 7711).into()];
    let lan = |unit: usize| format!("lan-ap{unit}");
    let both = |floor: &Floor| [0, 1].map(|unit| floor.packets(&lan(unit)));
    for server in servers {
        floor.round_trip(server);
        // Neighbours are known now. Each way has two links of 2 ms.
        let took = floor.round_trip(server);
        assert!((8..20).contains(&took.as_millis()), "{server}: {took:?}");
    }
    let handle = floor.datapath.handle();
    let walk = |fabric: &mut Fabric, now| fabric.move_robot(now, &id("robot"), Position::new(20.0, 0.0));
    handle.with(walk).unwrap().unwrap();
    floor.supplicant.request(&wpa_supplicant::scan(&CHANNELS.map(channel_number))).unwrap();
    while floor.told.next(LONG).unwrap().expect("a scan ends").event != Event::ScanResults {}
    for (from, to) in [(0, 1), (1, 0), (0, 1)] {
        floor.roam(to);
        let before = both(&floor);
        floor.round_trip(servers[0]);
        let after = both(&floor);
        assert!(after[to] >= before[to] + 2 && after[from] <= before[from] + 1, "{before:?}, {after:?}");
    }
    let handovers: Vec<_> = floor
        .events
        .try_iter()
        .filter_map(|Stamped { event, .. }| match event.clone() {
            NetworkEvent::Handover(handover) => {
                Some((handover.from, handover.to, handover.fast, handover.gap))
            }
            NetworkEvent::Detached { .. } => panic!("{event:?}"),
            _ => None,
        })
        .collect();
    eprintln!("{handovers:?}");
    let ways: Vec<_> =
        handovers.iter().map(|(from, to, fast, _)| (from.clone(), to.clone(), *fast)).collect();
    let [ap0, ap1] = ["ap0", "ap1"].map(id);
    assert_eq!(
        ways,
        [
            (None, ap0.clone(), false),
            (Some(ap0.clone()), ap1.clone(), true),
            (Some(ap1.clone()), ap0.clone(), true),
            (Some(ap0), ap1, true)
        ]
    );
    assert_eq!(floor.datapath.dropped_frames(), 0);
}

/// Returns the signal of the station at the other end by `iw`, dBm.
fn signal(floor: &Floor, node: &str) -> f64 {
    let text = iw(floor, node, &["dev", WLAN, "station", "dump"]);
    let signal = text.lines().find_map(|line| line.trim().strip_prefix("signal:"));
    signal.unwrap().split_whitespace().next().unwrap().parse().unwrap()
}

fn iw(floor: &Floor, node: &str, arguments: &[&str]) -> String {
    let run = || Command::new("iw").args(arguments).output().unwrap();
    let output = floor.datapath.namespace(&id(node)).unwrap().run(run);
    assert!(output.status.success(), "iw {arguments:?}: {output:?}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn signals_powers_and_losses_are_those_of_the_model() {
    const FRAMES: u64 = 1000;
    const PAYLOAD: usize = 500;
    let Some(floor) = Floor::up("asked") else { return };
    let server: SocketAddr = (floor.address("edge").ipv4, 7711).into();
    floor.round_trip(server);

    // Both ends show the power that they have in the testbed file, and the signal of the other one's.
    let path_loss = PathLoss::LogDistance { exponent: 3.0 };
    for (node, own, other) in [("robot", 15.0, 20.0), ("ap0", 20.0, 15.0)] {
        let shown = iw(&floor, node, &["dev", WLAN, "info"]);
        assert!(shown.contains(&format!("txpower {own:.2} dBm")), "{node}: {shown}");
        let (signal, asked) = (signal(&floor, node), other - path_loss.loss_db(10.0, 2412));
        assert!((signal - asked).abs() <= 0.5, "{node}: {signal} dBm instead of {asked}");
    }

    // At the edge of what the fastest rates reach, retries and slower rates bring all packets over. The link loses what it is asked to.
    let asked = 0.3;
    let (robot, link) = (id("robot"), LinkId::new("robot~ap0").unwrap());
    let change = move |fabric: &mut Fabric, now| {
        fabric.move_robot(now, &robot, Position::new(-60.0, 0.0))?;
        let loss = Loss::Independent { rate: Probability::new(asked).unwrap() };
        let change = ConditionChange { loss: Some(loss), ..ConditionChange::default() };
        fabric.change(now, &link, Some(Direction::Forward), &change)
    };
    floor.datapath.handle().with(change).unwrap().unwrap();
    let up = || {
        let contexts = floor.datapath.handle().with(|fabric, now| fabric.link_contexts(now)).unwrap();
        let is_it =
            |context: &&LinkContext| context.link == *"robot~ap0" && context.direction == Direction::Forward;
        contexts.iter().find(is_it).map(|context| context.counters).unwrap_or_default()
    };
    let before = up();
    let [robot, edge] = &floor.sockets;
    edge.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    let mut received = 0;
    for _ in 0..FRAMES {
        robot.send_to(&[0; PAYLOAD], server).unwrap();
        received += u64::from(edge.recv_from(&mut [0; PAYLOAD]).is_ok());
    }
    // The 99 % interval of the binomial distribution.
    let expected = FRAMES as f64 * (1.0 - asked);
    let deviation = 2.576 * (expected * asked).sqrt();
    eprintln!("{received} of {FRAMES} packets arrived, {expected:.0} ± {deviation:.0} by the conditions");
    assert!((received as f64 - expected).abs() < deviation);
    // The link counts them as Ethernet frames, and a few packets of the nodes' own.
    let after = up();
    let [packets, lost] = [after.packets - before.packets, after.lost - before.lost];
    assert!((received..received + 50).contains(&packets), "{packets} and {received}");
    assert!((FRAMES..FRAMES + 50).contains(&(packets + lost)), "{packets} and {lost}");
    assert!(after.bytes - before.bytes >= received * (14 + 20 + 8 + PAYLOAD as u64));
    // Frames of radios count in the lateness, by which the run is judged.
    let lateness = floor.datapath.handle().with(|fabric, _| fabric.lateness()).unwrap();
    assert!(lateness.frames > 2 * received, "{lateness:?}");
}

#[test]
fn broadcasts_cross_the_air_once() {
    let Some(floor) = Floor::up("broadcast") else { return };
    let HostAddress { ipv4, .. } = floor.address("edge");
    floor.round_trip((ipv4, 7711).into());
    let [robot, edge] = &floor.sockets;
    for (from, to) in [(edge, robot), (robot, edge)] {
        from.set_broadcast(true).unwrap();
        // A broadcast also comes back to its sender's node.
        let own = [floor.address("robot").ipv4, ipv4][usize::from(std::ptr::eq(to, edge))];
        let next = || loop {
            let mut buffer = [0; 10];
            match to.recv_from(&mut buffer) {
                Ok((_, from)) if from.ip().to_canonical() == own => {}
                Ok((length, _)) => break Some(buffer[..length].to_vec()),
                Err(_) => break None,
            }
        };
        for number in 0..10_u8 {
            from.send_to(&[number], "10.77.255.255:7711").unwrap();
            assert_eq!(next(), Some(vec![number]), "nothing is lost so near");
        }
        // Copies would be there by now.
        to.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
        assert_eq!(next(), None);
    }
}

#[test]
fn two_runs_have_their_own_air() {
    let Some(one) = Floor::up("one") else { return };
    let Some(other) = Floor::up("other") else { return };
    for floor in [&one, &other, &one] {
        floor.round_trip((floor.address("edge").ipv4, 7711).into());
    }
    // The radios of one go, those of the other stay.
    drop(one);
    other.round_trip((other.address("edge").ipv4, 7711).into());
    drop(other);
}

#[test]
fn a_helper_that_is_killed() {
    if env::var_os(HELPER).is_none() {
        return;
    }
    let floor = Floor::up("killed").unwrap();
    floor.round_trip((floor.address("edge").ipv4, 7711).into());
    println!("up");
    // Until it is killed.
    loop {
        drop(floor.events.recv_timeout(LONG));
    }
}

#[test]
fn nothing_survives_kill_9() {
    if wifi::check(&graph()).is_err() {
        return;
    }
    let mut helper = Command::new(env::current_exe().unwrap())
        .args(["--exact", "a_helper_that_is_killed", "--nocapture"])
        .env(HELPER, "1")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(helper.stdout.take().unwrap()).lines();
    assert!(lines.map_while(Result::ok).any(|line| line.contains("up")));
    helper.kill().unwrap();
    helper.wait().unwrap();
    // Another can be the medium at once, and no radio is left or has come back to this namespace.
    wifi::check(&graph()).unwrap();
    assert_eq!(Radios::new().list().unwrap(), []);
}
