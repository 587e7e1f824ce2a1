//! Radios of this kernel on the fabric's air, which runs while a test waits.

use std::{
    fs,
    net::UdpSocket,
    os::unix::fs::MetadataExt,
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use cotorra_datapath::Namespace;
use cotorra_fabric::Fabric;
use cotorra_graph::{HardwareGraph, NodeId, PathLoss, Position, Timestamp};
use cotorra_hwsim::{Error, Exchange, MacAddress, MediumSocket, Radio, Radios};
use parking_lot::{Mutex, MutexGuard};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

pub(crate) const PATH_LOSS: PathLoss = PathLoss::LogDistance { exponent: 3.0 };

pub(crate) fn id(name: &str) -> NodeId {
    NodeId::new(name).unwrap()
}

/// Radio units at these places and on these channels, and a robot 10 m from the first.
fn graph(units: &[(f64, u8)]) -> HardwareGraph {
    let mut testbed = String::from(
        "name: air\n\
         wireless: { lab: { standard: n, access: edca, path_loss: { model: log_distance, exponent: 3 }, \
         shadowing: { deviation: 0 dB, correlation: 5 m } } }\n\
         nodes:\n  \
         robot: { kind: robot, position: [10, 0], cpus: 1, memory: 1 GB, tx_power: 15 dBm }\n",
    );
    let mut links = String::from("links:\n");
    for (index, (x, channel)) in units.iter().enumerate() {
        let unit = format!("kind: radio_unit, position: [{x}, 0], channel: {channel}, tx_power: 20 dBm");
        testbed += &format!("  ap{index}: {{ {unit} }}\n");
        links += &format!("  - {{ ends: [ap{index}, lan] }}\n");
    }
    testbed += &format!("  lan: {{ kind: switch }}\n{links}");
    cotorra_testbed_file::parse("air", &testbed, Path::new("")).unwrap().graph
}

static TURN: Mutex<()> = Mutex::new(());

/// A medium that runs while the test waits for something.
pub(crate) struct Air {
    pub(crate) exchange: Exchange,
    /// One test at a time is the kernel's medium.
    pub(crate) turn: MutexGuard<'static, ()>,
    pub(crate) fabric: Fabric,
    began: Instant,
    pub(crate) radios: Radios,
}

/// Returns the address of a radio unit's radio.
pub(crate) fn ap(index: usize) -> MacAddress {
    MacAddress([2, 0, 0, 0xc0, 0, index as u8])
}

/// The address of the robot's radio.
pub(crate) const ROBOT: MacAddress = MacAddress([2, 0, 0, 0xc0, 1, 0]);

impl Air {
    /// Becomes the medium, with radios for radio units and a robot; `None` where that cannot be tested.
    pub(crate) fn new(units: &[(f64, u8)]) -> Option<Self> {
        let turn = TURN.lock();
        let socket = match MediumSocket::register() {
            Ok(socket) if fs::metadata("/proc/self").unwrap().uid() == 0 => socket,
            Ok(_) | Err(Error::Missing | Error::NoRights) => {
                eprintln!("this kernel has no mac80211_hwsim, or the test no rights: nothing is tested");
                return None;
            }
            Err(error) => panic!("{error}"),
        };
        let fabric = Fabric::new(&graph(units), 1).unwrap();
        let exchange = Exchange::new(socket);
        let mut air = Self { exchange, turn, fabric, began: Instant::now(), radios: Radios::new() };
        let nodes = (0..units.len()).map(|index| (format!("ap{index}"), ap(index)));
        for (name, address) in nodes.chain([("robot".to_owned(), ROBOT)]) {
            air.exchange.join(Timestamp::ZERO, &mut air.fabric, &id(&name), address).unwrap();
            air.radios.create(&radio(&name, address)).unwrap();
        }
        Some(air)
    }

    /// Moves the robot.
    pub(crate) fn walk_to(&mut self, x: f64) {
        let now = self.now();
        self.fabric.move_robot(now, &id("robot"), Position::new(x, 0.0)).unwrap();
    }

    pub(crate) fn now(&self) -> Timestamp {
        Timestamp::from_nanos(self.began.elapsed().as_nanos() as u64)
    }

    /// Runs until something is done; `false` if it takes longer than `limit`.
    pub(crate) fn run_until(&mut self, limit: Duration, mut done: impl FnMut() -> bool) -> bool {
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
        let now = self.now();
        assert_eq!(self.exchange.receive(now, &mut self.fabric).unwrap(), 0, "the medium keeps up");
        self.fabric.poll(now, &mut |_, _| {});
        assert_eq!(self.exchange.deliver(now, &mut self.fabric).unwrap(), 0, "the medium keeps up");
        let deadline = self.fabric.poll(now, &mut |_, _| {});
        const LONGEST: Duration = Duration::from_millis(5);
        let wait = deadline.map_or(LONGEST, |deadline| deadline.since(self.now()).min(LONGEST));
        let wait = Timespec { tv_sec: 0, tv_nsec: wait.as_nanos() as i64 };
        poll(&mut [PollFd::new(&self.exchange, PollFlags::IN)], Some(&wait)).unwrap();
    }

    /// Runs a command, whose interfaces need the medium, and returns what it prints.
    pub(crate) fn sh(&mut self, namespace: Option<&Namespace>, line: &str) -> String {
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
    pub(crate) fn reaches(&mut self, from: &UdpSocket, to: &UdpSocket, limit: Duration) -> bool {
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

pub(crate) fn is_installed(program: &str) -> bool {
    Command::new(program).arg("-v").stdout(Stdio::null()).stderr(Stdio::null()).spawn().is_ok()
}

pub(crate) fn radio(name: &str, address: MacAddress) -> Radio {
    Radio {
        name: Some(name.to_owned()),
        permanent_address: Some(address),
        no_interface: true,
        ends_with_socket: true,
        ..Radio::default()
    }
}

pub(crate) fn names(radios: &mut Radios) -> Vec<String> {
    radios.list().unwrap().into_iter().filter_map(|radio| radio.name).collect()
}
