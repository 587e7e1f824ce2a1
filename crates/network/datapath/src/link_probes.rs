//! Measures the links of the kernel's network by packets of the fabric's own making: a socket at each end of each link
//! sends them through that end's NetEm and takes those that come out of the other's. The kernel stamps what arrives, so
//! that no wait of this thread counts as a delay of the link.

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

/// What waits at an end to be read: a test's packets at its fastest, for some 20 ms.
const BUFFER_BYTES: i32 = 4 << 20;
/// Packets that are sent before those that came are looked at.
const BATCH: usize = 64;

/// The packets that measure links, and the thread that sends and takes them; it ends with this.
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
    /// By edge: forward and backward of each link in turn.
    edges: Vec<Edge>,
    lateness: Histogram,
    buffer: Vec<u8>,
}

/// One direction of a link.
struct Edge {
    /// At the end where it leaves; what arrives there has crossed the other direction.
    socket: OwnedFd,
    conditions: Conditions,
    /// Since when nothing but them decides what packets meet that are sent.
    since: Timestamp,
    /// Of the packets that measure, what was sent and what has arrived.
    sent: u64,
    arrived: u64,
    arrived_bytes: u64,
    /// What was told last of all other packets.
    told: LinkCounters,
}

/// What is known of one direction of a link.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Measured {
    pub(crate) probed: Option<Probed>,
    pub(crate) tested: Option<Tested>,
}

fn edge(link: usize, direction: Direction) -> usize {
    2 * link + direction as usize
}

impl LinkProbes {
    /// Begins to probe links, if that is wanted. `ends` are the interfaces of each link in the calling thread's network
    /// namespace, the one where its forward direction leaves first, and the conditions in which packets leave there.
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
                told: LinkCounters::default(),
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
                tracing::error!("links are measured no longer: {error}");
            }
        })?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// A direction of a link has other conditions, since just now.
    pub(crate) fn change(&self, link: usize, direction: Direction, conditions: &Conditions) {
        let mut state = self.shared.state.lock();
        let now = self.shared.clock.now();
        let State { probes, edges, .. } = &mut *state;
        let its = &mut edges[edge(link, direction)];
        // What is sent sooner than that may have to wait for what was sent before, because order is kept.
        its.since = now + its.conditions.delay;
        its.conditions = conditions.clone();
        probes.change(
            link,
            [Direction::Forward, Direction::Backward].map(|d| &edges[edge(link, d)].conditions),
        );
    }

    /// Begins to test what a direction of a link carries.
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

    /// What is known of both directions of each link.
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

    /// What others' packets did, of all that a direction's NetEm has counted a moment ago. While packets that measure are
    /// under way that may be less than the truth, by as many; it never falls.
    pub(crate) fn others(&self, link: usize, direction: Direction, all: LinkCounters) -> LinkCounters {
        let mut state = self.shared.state.lock();
        let edge = edge(link, direction);
        // What NetEm has let go is there to be read.
        state.receive(edge ^ 1);
        let Edge { sent, arrived, arrived_bytes, told, .. } = &mut state.edges[edge];
        told.packets = told.packets.max(all.packets.saturating_sub(*arrived));
        told.bytes = told.bytes.max(all.bytes.saturating_sub(*arrived_bytes));
        told.lost = told.lost.max(all.lost.saturating_sub(sent.saturating_sub(*arrived)));
        *told
    }

    /// By how much probes took longer than they were asked to; those aside of which nobody knows how long that is.
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
    /// Sends what is due, and says when there is more.
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

    /// Takes what has come to a socket.
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
            // NetEm's own loss at a full queue, which it has counted.
            Err(error) if error.raw_os_error() == Some(libc::ENOBUFS) => self.sent += 1,
            // What never came to NetEm is lost like what it loses.
            Err(_) => {}
            Ok(()) => self.sent += 1,
        }
    }
}
