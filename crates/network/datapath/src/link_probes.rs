//! Measures the links of the kernel's network with the fabric's own probe packets. A socket at each end of a link
//! sends probes through that end's NetEm and receives those of the other end. The kernel timestamps arrivals, so that
//! this thread's own waiting does not count as link delay.

use std::{
    io,
    os::fd::{AsFd, OwnedFd},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
};

use cotorra_fabric::{
    Crossing, FabricError, Frame, Histogram, MEASURING_ETHERTYPE, ThroughputTests, WireProbes,
};
use cotorra_graph::{
    Conditions, Direction, Lateness, LinkCounters, LinkId, Probed, Probing, Tested, ThroughputTest, Timestamp,
};
use parking_lot::Mutex;

use crate::{
    clock::Clock,
    sys::{self, Epoll, Waker},
};

/// Receive buffer of an end: the packets of the fastest throughput test for some 20 ms.
const BUFFER_BYTES: i32 = 4 << 20;
/// Most packets sent before arrivals are read.
const BATCH: usize = 64;

/// The probes of all links, and the thread that sends and receives them. Dropping this ends the thread.
pub(crate) struct LinkProbes {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    clock: Clock,
    state: Mutex<State>,
    waker: Waker,
    stopping: AtomicBool,
}

struct State {
    clock: Clock,
    probes: WireProbes,
    throughput_tests: ThroughputTests,
    /// Indexed by edge: forward and backward of each link in turn.
    edges: Vec<Edge>,
    lateness: Histogram,
    buffer: Vec<u8>,
}

/// One direction of a link.
struct Edge {
    /// Socket at the end where it leaves. Arrivals there have crossed the other direction.
    socket: OwnedFd,
    conditions: Conditions,
    /// Time from which packets are under these conditions alone.
    since: Timestamp,
    /// Measurement packets sent.
    sent: u64,
    arrived: u64,
    arrived_bytes: u64,
    /// Counters of all other packets, as last reported.
    reported: LinkCounters,
}

/// Measurements of one direction of a link.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Measured {
    pub(crate) probed: Option<Probed>,
    pub(crate) tested: Option<Tested>,
}

fn edge(link: usize, direction: Direction) -> usize {
    2 * link + direction as usize
}

impl LinkProbes {
    /// Starts probing links, if requested. `ends` are the two interfaces of each link in the calling thread's network
    /// namespace, the forward one first, with the conditions of packets leaving there.
    pub(crate) fn start(ends: Vec<[(u32, Conditions); 2]>, probing: Option<Probing>) -> io::Result<Self> {
        let clock = Clock::start();
        let now = clock.now();
        let probes = match probing {
            Some(settings) => WireProbes::new(
                settings,
                now,
                ends.iter().map(|[(_, forward), (_, backward)]| [forward, backward]),
            ),
            None => WireProbes::none(),
        };
        let throughput_tests = ThroughputTests::new(2 * ends.len());
        let edge = |(interface, conditions)| {
            let socket = sys::stamped_packet_socket(interface, MEASURING_ETHERTYPE, BUFFER_BYTES)?;
            Ok(Edge {
                socket,
                conditions,
                since: now,
                sent: 0,
                arrived: 0,
                arrived_bytes: 0,
                reported: LinkCounters::default(),
            })
        };
        let edges = ends.into_iter().flatten().map(edge).collect::<io::Result<Vec<_>>>()?;
        let epoll = Epoll::new()?;
        for (token, edge) in edges.iter().enumerate() {
            epoll.add(edge.socket.as_fd(), token)?;
        }
        let waker = Waker::new()?;
        epoll.add(waker.as_fd(), edges.len())?;
        let (lateness, buffer) = (Histogram::default(), vec![0; 2048]);
        let state = Mutex::new(State { clock, probes, throughput_tests, edges, lateness, buffer });
        let shared = Arc::new(Shared { clock, state, waker, stopping: AtomicBool::new(false) });
        let its = Arc::clone(&shared);
        let thread = thread::Builder::new().name("probes".into()).spawn(move || {
            if let Err(error) = its.run(epoll) {
                tracing::error!("link measurements have stopped: {error}");
            }
        })?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Records that a direction of a link has just got other conditions.
    pub(crate) fn change(&self, link: usize, direction: Direction, conditions: &Conditions) {
        let mut state = self.shared.state.lock();
        let now = self.shared.clock.now();
        let State { probes, edges, .. } = &mut *state;
        let its = &mut edges[edge(link, direction)];
        // Packets sent before then may wait for earlier ones, because order is kept.
        its.since = now + its.conditions.delay;
        its.conditions = conditions.clone();
        probes.change(
            link,
            [Direction::Forward, Direction::Backward].map(|d| &edges[edge(link, d)].conditions),
        );
    }

    /// Starts a throughput test of a direction of a link.
    pub(crate) fn test_throughput(
        &self,
        (place, link): (usize, &LinkId),
        direction: Direction,
        test: ThroughputTest,
    ) -> Result<(), FabricError> {
        let mut state = self.shared.state.lock();
        let edge = edge(place, direction);
        let State { throughput_tests, edges, .. } = &mut *state;
        throughput_tests.begin(self.shared.clock.now(), (edge, link), test, &edges[edge].conditions.rate)?;
        drop(state);
        self.shared.waker.wake();
        Ok(())
    }

    /// Returns the measurements of both directions of each link.
    pub(crate) fn measured(&self) -> Vec<[Measured; 2]> {
        let state = self.shared.state.lock();
        let now = self.shared.clock.now();
        let of = |link| {
            let probed = state.probes.probed(now, link);
            [Direction::Forward, Direction::Backward].map(|direction| Measured {
                probed: probed.map(|both| both[direction as usize]),
                tested: state.throughput_tests.tested(now, edge(link, direction)),
            })
        };
        (0..state.edges.len() / 2).map(of).collect()
    }

    /// Returns the counters of other traffic, given all that a direction's NetEm has just counted. While measurement
    /// packets are in flight it may be short by that many. It never falls.
    pub(crate) fn other_traffic(&self, link: usize, direction: Direction, all: LinkCounters) -> LinkCounters {
        let mut state = self.shared.state.lock();
        let edge = edge(link, direction);
        // Packets that NetEm has released can be read now.
        state.receive(edge ^ 1);
        let Edge { sent, arrived, arrived_bytes, reported, .. } = &mut state.edges[edge];
        reported.packets = reported.packets.max(all.packets.saturating_sub(*arrived));
        reported.bytes = reported.bytes.max(all.bytes.saturating_sub(*arrived_bytes));
        reported.lost = reported.lost.max(all.lost.saturating_sub(sent.saturating_sub(*arrived)));
        *reported
    }

    /// Returns by how much probes exceeded their requested delay. Probes of unpredictable delay are left out.
    pub(crate) fn lateness(&self) -> Lateness {
        self.shared.state.lock().lateness.summary()
    }
}

impl Drop for LinkProbes {
    fn drop(&mut self) {
        self.shared.stopping.store(true, Ordering::Relaxed);
        self.shared.waker.wake();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn run(&self, mut epoll: Epoll) -> io::Result<()> {
        let mut ready = Vec::new();
        loop {
            let deadline = self.state.lock().send();
            let timeout = deadline.map(|at| at.since(self.clock.now()));
            ready.clear();
            ready.extend(epoll.wait(timeout)?.map(|event| event.token));
            if self.stopping.load(Ordering::Relaxed) {
                return Ok(());
            }
            let mut state = self.state.lock();
            for &token in &ready {
                if token < state.edges.len() {
                    state.receive(token);
                } else {
                    self.waker.clear();
                }
            }
        }
    }
}

impl State {
    /// Sends what is due, and returns the next deadline.
    fn send(&mut self) -> Option<Timestamp> {
        for _ in 0..BATCH {
            let now = self.clock.now();
            if let Some((link, probe)) = self.probes.poll(now) {
                self.edges[edge(link, Direction::Forward)].send(&probe);
            } else if let Some((edge, packet)) = self.throughput_tests.poll(now, Vec::with_capacity) {
                self.edges[edge].send(&packet);
            } else {
                break;
            }
        }
        self.probes.deadline().into_iter().chain(self.throughput_tests.deadline()).min()
    }

    /// Reads the packets at a socket.
    fn receive(&mut self, at: usize) {
        let crossed = at ^ 1;
        while let Ok((length, age)) = sys::read_with_age(self.edges[at].socket.as_fd(), &mut self.buffer) {
            let now = self.clock.now();
            let received = now - age;
            let edge = &mut self.edges[crossed];
            edge.arrived += 1;
            edge.arrived_bytes += length as u64;
            if length == ThroughputTests::PACKET_BYTES {
                self.throughput_tests.crossed(received, crossed);
                continue;
            }
            let frame = Frame::new(self.buffer[..length].to_vec());
            let way = (
                crossed / 2,
                if crossed.is_multiple_of(2) { Direction::Forward } else { Direction::Backward },
            );
            let Some(Crossing { took, answer }) = self.probes.crossed(received, now, way, frame) else {
                continue;
            };
            if received - took >= edge.since
                && let Some(asked) = edge.conditions.alone(length)
            {
                self.lateness.record(took.saturating_sub(asked));
            }
            if let Some(answer) = answer {
                self.edges[at].send(&answer);
            }
        }
    }
}

impl Edge {
    fn send(&mut self, frame: &Frame) {
        match sys::write_frame(self.socket.as_fd(), &[], frame.bytes()) {
            // NetEm dropped it at its full queue and counted it.
            Err(error) if error.raw_os_error() == Some(libc::ENOBUFS) => self.sent += 1,
            // It never reached NetEm, so it counts as neither sent nor lost.
            Err(_) => {}
            Ok(()) => self.sent += 1,
        }
    }
}
