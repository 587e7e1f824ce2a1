//! Packets between two nodes of a run, one each millisecond, and the gaps between their arrivals.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "the run's clock is the kernel's")]

use std::{
    net::{Ipv4Addr, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, SystemTime},
};

use crate::rig::Rig;

/// Time between two packets.
pub const INTERVAL: Duration = Duration::from_millis(1);
/// Time without a packet after which no more is to come.
const END: Duration = Duration::from_millis(500);

/// Packets that are being sent from a node to another.
pub struct Packets {
    goes_on: Arc<AtomicBool>,
    sender: JoinHandle<()>,
    receiver: JoinHandle<Vec<SystemTime>>,
}

impl Packets {
    /// Begins to send. Each node knows the other's address by then.
    pub fn start(rig: &Rig, from: &str, to: &str) -> Self {
        let [sender, receiver] =
            [from, to].map(|node| rig.inside(node, || UdpSocket::bind("0.0.0.0:0").unwrap()));
        let address: Ipv4Addr = rig.node(to)["address"]["ipv4"].as_str().unwrap().parse().unwrap();
        let target = (address, receiver.local_addr().unwrap().port());
        let mut buffer = [0; 100];
        loop {
            // Those before the first answer of the neighbour may get lost.
            sender.send_to(&[0; 100], target).unwrap();
            receiver.set_read_timeout(Some(END)).unwrap();
            if receiver.recv(&mut buffer).is_ok() {
                break;
            }
        }
        let goes_on = Arc::new(AtomicBool::new(true));
        let (sends, receives) = (Arc::clone(&goes_on), Arc::clone(&goes_on));
        let sender = thread::spawn(move || {
            while sends.load(Ordering::Relaxed) {
                // Without a radio unit, it may have no route.
                _ = sender.send_to(&[1; 100], target);
                thread::sleep(INTERVAL);
            }
        });
        let receiver = thread::spawn(move || {
            let mut arrivals = Vec::new();
            loop {
                match receiver.recv(&mut buffer) {
                    Ok(_) => arrivals.push(SystemTime::now()),
                    Err(_) if receives.load(Ordering::Relaxed) => {}
                    Err(_) => return arrivals,
                }
            }
        });
        Self { goes_on, sender, receiver }
    }

    /// Ends them. Returns the longest time between two arrivals. A gap that lasts counts until now.
    pub fn longest_gap(self) -> Duration {
        let now = SystemTime::now();
        self.goes_on.store(false, Ordering::Relaxed);
        self.sender.join().unwrap();
        let mut arrivals = self.receiver.join().unwrap();
        if arrivals.last().is_some_and(|last| *last < now) {
            arrivals.push(now);
        }
        let gaps = arrivals.windows(2).map(|pair| pair[1].duration_since(pair[0]).unwrap());
        gaps.max().expect("packets arrive")
    }
}
