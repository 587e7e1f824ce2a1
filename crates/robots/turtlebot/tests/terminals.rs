//! Devices at pseudo-terminals: ports that vanish, stall, or are in use, and threads that end.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "drives emulators on the wall clock")]
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{path::PathBuf, sync::Arc, thread, time::Instant};

use cotorra_graph::{Timestamp, Velocity};
use cotorra_testing::{
    process::until,
    turtlebot::{Emulated, Place, Terminal, room},
};
use cotorra_turtlebot::{
    Clock, Device, PortError, PortSettings, Session,
    kobuki::{Base, Command},
    rplidar::{Lidar, LidarSettings},
};
use tempfile::TempDir;

fn clock() -> Clock {
    let began = Instant::now();
    Arc::new(move || Timestamp::ZERO + began.elapsed())
}

fn port(path: PathBuf) -> PortSettings {
    PortSettings { path, baud: 115_200 }
}

fn emulated(folder: &TempDir) -> Emulated {
    Emulated::start(folder.path(), room((-1.0, -2.0), (3.0, 2.0)), Place::default())
}

/// Drives forward until the emulated base moves.
fn moves(device: &Device<Base>, emulated: &Emulated, clock: &Clock) {
    until("it moves", || {
        let _ = device.with(clock(), |base, now| base.drive(now, Velocity::planar(0.2, 0.0)));
        emulated.state().kobuki.velocity().0 == 0.2
    });
}

#[test]
fn base_that_vanishes_is_found_again_stopped_and_driven() {
    let folder = TempDir::new().unwrap();
    let (emulated, clock) = (emulated(&folder), clock());
    let device = Device::open("base", port(emulated.base()), Base::default(), Arc::clone(&clock)).unwrap();
    moves(&device, &emulated, &clock);
    assert!(device.is_connected());
    emulated.unplug_base();
    until("it is lost", || !device.is_connected());
    let before = emulated.state().kobuki.controls.len();
    emulated.plug_base();
    until("it is back", || emulated.state().kobuki.controls.len() > before);
    let (_, speed, radius) = emulated.state().kobuki.controls[before];
    assert_eq!((speed, radius), (0, 0), "whatever it did meanwhile, it is stopped");
    moves(&device, &emulated, &clock);
    drop(device);
    until("it is at rest", || emulated.state().kobuki.velocity() == (0.0, 0.0));
}

#[test]
fn base_whose_driver_says_nothing_more_is_stopped() {
    let folder = TempDir::new().unwrap();
    let (emulated, clock) = (emulated(&folder), clock());
    let device = Device::open("base", port(emulated.base()), Base::default(), Arc::clone(&clock)).unwrap();
    moves(&device, &emulated, &clock);
    // Its thread does it without a call.
    until("it stands", || emulated.state().kobuki.velocity() == (0.0, 0.0));
    assert!(device.is_connected());
}

#[test]
fn lidar_is_started_and_left_at_rest() {
    let folder = TempDir::new().unwrap();
    let (emulated, clock) = (emulated(&folder), clock());
    let lidar = Lidar::new(LidarSettings::default());
    let device = Device::open("lidar", port(emulated.lidar()), lidar, Arc::clone(&clock)).unwrap();
    let ahead = || {
        device.with(clock(), |lidar, _| {
            let samples = lidar.turn().map(|turn| turn.samples.clone()).unwrap_or_default();
            samples.iter().filter(|sample| sample.angle < 0.05).find_map(|sample| sample.range)
        })
    };
    until("it sees the wall", || ahead().is_some_and(|range| (range - 3.0).abs() < 0.05));
    assert_eq!(emulated.state().rplidar.motor, 660);
    drop(device);
    until("its motor stands", || emulated.state().rplidar.motor == 0);
}

#[test]
fn port_has_one_user() {
    let folder = TempDir::new().unwrap();
    let emulated = emulated(&folder);
    let first = Device::open("base", port(emulated.base()), Base::default(), clock()).unwrap();
    let second = Device::open("base", port(emulated.base()), Base::default(), clock());
    assert!(matches!(second, Err(PortError::Busy(_))));
    drop(first);
    assert!(Device::open("base", port(emulated.base()), Base::default(), clock()).is_ok());
}

/// A base whose protocol panics on the device's thread once it was asked to.
struct Panics {
    base: Base,
    does: bool,
}

impl Session for Panics {
    fn connected(&mut self, now: Timestamp) {
        self.base.connected(now);
    }
    fn receive(&mut self, now: Timestamp, bytes: &[u8]) {
        assert!(!self.does || thread::current().name() != Some("base"), "as it was asked to");
        self.base.receive(now, bytes);
    }
    fn poll_transmit(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        self.base.poll_transmit(now)
    }
    fn next_deadline(&self, now: Timestamp) -> Option<Timestamp> {
        self.base.next_deadline(now)
    }
    fn farewell(&mut self) -> Vec<u8> {
        self.base.farewell()
    }
}

#[test]
fn panic_of_the_thread_leaves_the_base_at_rest() {
    let folder = TempDir::new().unwrap();
    let (emulated, clock) = (emulated(&folder), clock());
    let session = Panics { base: Base::default(), does: false };
    let device = Device::open("base", port(emulated.base()), session, Arc::clone(&clock)).unwrap();
    until("it moves", || {
        let drive = |its: &mut Panics, now| its.base.drive(now, Velocity::planar(0.2, 0.0));
        let _ = device.with(clock(), drive);
        emulated.state().kobuki.velocity().0 == 0.2
    });
    device.with(clock(), |its, now| {
        // Its own timeout is far away.
        let _ = its.base.drive(now, Velocity::planar(0.2, 0.0));
        its.does = true;
    });
    until("it is at rest", || !device.is_connected() && emulated.state().kobuki.velocity() == (0.0, 0.0));
}

/// Sends numbered pieces.
struct Talker(u32);

impl Session for Talker {
    fn connected(&mut self, _: Timestamp) {}
    fn receive(&mut self, _: Timestamp, _: &[u8]) {}
    fn poll_transmit(&mut self, _: Timestamp) -> Option<Vec<u8>> {
        self.0 += 1;
        (self.0 <= 1000).then(|| self.0.to_le_bytes().repeat(64))
    }
    fn next_deadline(&self, _: Timestamp) -> Option<Timestamp> {
        None
    }
    fn farewell(&mut self) -> Vec<u8> {
        Command::STOP.encode()
    }
}

#[test]
fn device_that_takes_no_bytes_blocks_no_call_and_gets_all_of_them_later() {
    let folder = TempDir::new().unwrap();
    let mut terminal = Terminal::open(&folder.path().join("port"));
    let device = Device::open("talker", port(folder.path().join("port")), Talker(0), clock()).unwrap();
    // The terminal holds far less than 256 kB.
    let sent = device.with(Timestamp::ZERO, |talker, _| talker.0);
    assert!(sent < 1000, "{sent}");
    let mut received = Vec::new();
    until("everything has arrived", || {
        received.extend(terminal.read());
        received.len() == 256_000
    });
    let expected: Vec<_> = (1..=1000_u32).flat_map(|piece| piece.to_le_bytes().repeat(64)).collect();
    assert!(received == expected, "in order, and whole");
}
