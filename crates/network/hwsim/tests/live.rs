//! Radios of this kernel on the fabric's air. Needs root, mac80211_hwsim (`modprobe mac80211_hwsim radios=0`), `iw` and `ip`; does
//! nothing elsewhere.
#![allow(clippy::unwrap_used, reason = "tests may panic")]
#![allow(clippy::disallowed_types, reason = "the kernel's radios run by the machine's clock")]

use std::{
    fs,
    net::UdpSocket,
    os::unix::fs::MetadataExt,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use cotorra_datapath::Namespace;
use cotorra_fabric::Fabric;
use cotorra_graph::{
    Capacity, Dbm, DomainId, Driver, Edca, GapPolicy, HandoverTimes, HardwareGraph, Loss, Node, NodeId,
    NodeKind, PathLoss, Position, RadioUnit, RateControl, Roaming, Robot, RobotModel, Shadowing, Timestamp,
    WifiStandard, WirelessNetwork,
};
use cotorra_hwsim::{Error, Incoming, MacAddress, Medium, MediumSocket, Message, Phys, Radio, Radios};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

const AP: MacAddress = MacAddress([2, 0, 0, 0xc0, 0, 1]);
const STATION: MacAddress = MacAddress([2, 0, 0, 0xc0, 0, 2]);
const PATH_LOSS: PathLoss = PathLoss::LogDistance { exponent: 3.0 };

fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

/// A radio unit on channel 1, and a robot 10 m away.
fn graph() -> HardwareGraph {
    let capacity = Capacity { cpus: 1.0, memory_bytes: 1 };
    let unit = RadioUnit {
        capacity,
        network: "lab".into(),
        channel: 1,
        tx_power: Dbm(20.0),
        serving: true,
        deployment: Duration::ZERO,
        agent: None,
    };
    let robot = Robot {
        capacity,
        model: RobotModel::Turtlebot2,
        network: "lab".into(),
        tx_power: Dbm(15.0),
        heading: 0.0,
        roaming: Roaming::Instructed,
        driver: Driver::default(),
        sensors: Vec::new(),
    };
    let network = WirelessNetwork {
        standard: WifiStandard::N,
        delay: Duration::ZERO,
        rate: None,
        loss: Loss::None,
        fast_transition: true,
        mobility_domain: 1,
        path_loss: PATH_LOSS,
        walls: None,
        access: Some(Edca { aggregation: false, rate_control: RateControl::Ideal, power_save: None }),
        interference: Vec::new(),
        shadowing: Shadowing { deviation_db: 0.0, correlation_m: 5.0 },
        fading: None,
        noise_floor: Dbm(-95.0),
        hysteresis_db: 4.0,
        time_to_trigger: Duration::ZERO,
        handover: HandoverTimes {
            scan: Duration::ZERO,
            visits: None,
            authenticate: Duration::ZERO,
            reassociate: Duration::ZERO,
            handshake: Duration::ZERO,
            variation: 0.0,
        },
        gap: GapPolicy::Hold,
    };
    let node = |name: &str, x: f64, kind: NodeKind| Node {
        id: id(name),
        domain: DomainId::new("d").unwrap(),
        position: Some(Position::new(x, 0.0)),
        kind,
    };
    HardwareGraph {
        domains: vec![DomainId::new("d").unwrap()],
        nodes: vec![node("ap", 0.0, NodeKind::RadioUnit(unit)), node("robot", 10.0, NodeKind::Robot(robot))],
        links: Vec::new(),
        wireless: [("lab".to_owned(), network)].into(),
    }
}

/// A medium that runs while the test waits for something.
struct Air {
    socket: MediumSocket,
    medium: Medium,
    fabric: Fabric,
    began: Instant,
    frames: u64,
    refused: u64,
}

impl Air {
    fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.began.elapsed().as_nanos() as u64)
    }

    /// Runs until something is done; `false` if it takes longer than `limit`.
    fn run_until(&mut self, limit: Duration, mut done: impl FnMut() -> bool) -> bool {
        let end = self.now() + limit;
        while !done() {
            if self.now() > end {
                return false;
            }
            self.step();
        }
        true
    }

    fn step(&mut self) {
        while let Some(incoming) = self.socket.receive().unwrap() {
            let now = self.now();
            match incoming {
                Incoming::Message(message) => {
                    self.frames += u64::from(matches!(message, Message::Frame(_)));
                    if let Some(answer) = self.medium.handle(now, &mut self.fabric, &message) {
                        self.socket.send(answer.number, &answer.message).unwrap();
                    }
                }
                Incoming::Refused { number, .. } => {
                    self.refused += 1;
                    self.medium.refused(now, &mut self.fabric, number);
                }
                Incoming::Unknown => panic!("the kernel's messages are known"),
                Incoming::Overrun => panic!("the medium keeps up"),
            }
        }
        let deadline = self.fabric.poll(self.now(), &mut |_, _| {});
        if let Some(outgoing) = self.medium.poll(&mut self.fabric) {
            return self.socket.send(outgoing.number, &outgoing.message).unwrap();
        }
        const LONGEST: Duration = Duration::from_millis(5);
        let wait = deadline.map_or(LONGEST, |deadline| deadline.since(self.now()).min(LONGEST));
        let wait = Timespec { tv_sec: 0, tv_nsec: wait.as_nanos() as i64 };
        poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&wait)).unwrap();
    }

    /// Runs a command, whose interfaces need the medium, and returns what it prints.
    fn sh(&mut self, namespace: Option<&Namespace>, line: &str) -> String {
        let spawn = || Command::new("sh").args(["-ec", line]).stdout(Stdio::piped()).spawn().unwrap();
        let mut child = match namespace {
            Some(namespace) => namespace.run(spawn),
            None => spawn(),
        };
        let ended = self.run_until(Duration::from_secs(20), || child.try_wait().unwrap().is_some());
        assert!(ended, "{line}: it does not end");
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{line}: {}", output.status);
        String::from_utf8(output.stdout).unwrap()
    }

    /// Whether datagrams come from one socket to another within some seconds.
    fn reaches(&mut self, from: &UdpSocket, to: &UdpSocket, limit: Duration) -> bool {
        let mut buffer = [0; 100];
        while to.recv(&mut buffer).is_ok() {}
        let mut sent = None::<Instant>;
        self.run_until(limit, || {
            if sent.is_none_or(|sent| sent.elapsed() > Duration::from_millis(200)) {
                _ = from.send_to(b"hello", to.local_addr().unwrap());
                sent = Some(Instant::now());
            }
            to.recv(&mut buffer).is_ok()
        })
    }
}

fn radio(name: &str, address: MacAddress) -> Radio {
    Radio {
        name: Some(name.to_owned()),
        permanent_address: Some(address),
        no_interface: true,
        ends_with_socket: true,
        ..Radio::default()
    }
}

fn names(radios: &mut Radios) -> Vec<String> {
    radios.list().unwrap().into_iter().filter_map(|radio| radio.name).collect()
}

#[test]
fn radios_of_two_namespaces_talk_over_the_fabrics_air() {
    let socket = match MediumSocket::register() {
        Ok(socket) if fs::metadata("/proc/self").unwrap().uid() == 0 => socket,
        Ok(_) | Err(Error::Missing | Error::NoRights) => {
            eprintln!("this kernel has no mac80211_hwsim, or the test no rights: nothing is tested");
            return;
        }
        Err(error) => panic!("{error}"),
    };
    assert!(matches!(MediumSocket::register(), Err(Error::Taken)));
    let (mut medium, mut fabric) = (Medium::new(), Fabric::new(&graph(), 1).unwrap());
    for (node, address) in [("ap", AP), ("robot", STATION)] {
        medium.join(Timestamp::ZERO, &mut fabric, &id(node), address).unwrap();
    }
    let mut air = Air { socket, medium, fabric, began: Instant::now(), frames: 0, refused: 0 };

    let mut radios = Radios::new();
    radios.create(&radio("air0", AP)).unwrap();
    let second = radios.create(&radio("air1", STATION)).unwrap();
    let third = MacAddress([2, 0, 0, 0xc0, 0, 3]);
    assert!(matches!(radios.create(&radio("air1", third)), Err(Error::NameTaken(name)) if name == "air1"));
    assert_eq!(names(&mut radios), ["air0", "air1"]);

    // Moved by a descriptor, the second one is seen in its namespace alone.
    let namespace = Namespace::new().unwrap();
    let mut phys = Phys::new();
    phys.move_to("air1", &namespace).unwrap();
    assert!(matches!(phys.move_to("air1", &namespace), Err(Error::NoPhy(_))));
    assert_eq!(names(&mut radios), ["air0"]);
    assert!(radios.delete(second).is_err());
    assert_eq!(namespace.run(|| names(&mut Radios::new())), ["air1"]);
    phys.add_station("air0", "air0").unwrap();
    namespace.run(|| Phys::new().add_station("air1", "air1")).unwrap();

    let join = |interface: &str, address: &str| {
        format!(
            "iw dev {interface} set type ibss; ip link set {interface} up; ip addr add {address}/24 dev {interface}; \
             iw dev {interface} ibss join air 2412 fixed-freq 02:11:22:33:44:55"
        )
    };
    air.sh(None, &join("air0", "10.99.0.1"));
    air.sh(Some(&namespace), &join("air1", "10.99.0.2"));
    let here = UdpSocket::bind("10.99.0.1:7000").unwrap();
    let there = namespace.udp_socket("10.99.0.2:7000").unwrap();
    here.set_nonblocking(true).unwrap();
    there.set_nonblocking(true).unwrap();
    assert!(air.reaches(&there, &here, Duration::from_secs(10)));
    assert!(air.reaches(&here, &there, Duration::from_secs(10)));

    // The signal is the model's, in both directions: 15 dBm and 20 dBm less the loss over 10 m.
    let loss = PATH_LOSS.loss_db(10.0, 2412);
    let stations = air.sh(None, "iw dev air0 station dump");
    let theirs = air.sh(Some(&namespace), "iw dev air1 station dump");
    for (dump, power) in [(stations, 15.0), (theirs, 20.0)] {
        let signal = dump.lines().find_map(|line| line.trim().strip_prefix("signal:").map(str::trim));
        let signal: f64 = signal.unwrap().split_whitespace().next().unwrap().parse().unwrap();
        assert!((signal - (power - loss)).abs() <= 0.5, "{signal} dBm, not {}", power - loss);
    }

    // Out of reach, nothing arrives, and nobody acknowledges.
    let now = air.now();
    air.fabric.move_robot(now, &id("robot"), Position::new(10_000.0, 0.0)).unwrap();
    assert!(!air.reaches(&there, &here, Duration::from_secs(3)));
    let now = air.now();
    air.fabric.move_robot(now, &id("robot"), Position::new(10.0, 0.0)).unwrap();
    assert!(air.reaches(&there, &here, Duration::from_secs(10)));
    eprintln!("{} frames in {:?}, {} refused", air.frames, air.began.elapsed(), air.refused);

    // Radios go with the socket that created them, wherever their phys are.
    drop(radios);
    assert!(air.run_until(Duration::from_secs(5), || names(&mut Radios::new()).is_empty()));
    assert!(namespace.run(|| names(&mut Radios::new())).is_empty());
    drop(air.socket);
    MediumSocket::register().unwrap();
}
