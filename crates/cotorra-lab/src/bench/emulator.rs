//! Measurements of the emulated network on this machine, through real sockets, as a user's traffic.
#![allow(clippy::disallowed_methods, reason = "a benchmark waits for the kernel on the wall clock")]

pub mod compare;

use std::{
    fs,
    io::{self, Read, Write},
    net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket},
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use cotorra_datapath::{
    BusyPoll, Clock, Datapath, Error, Handle, Namespace, Options, PortKind, be_timely, wait_until_removed,
};
use cotorra_fabric::Fabric;
use cotorra_graph::{
    BitRate, Capacity, Conditions, Direction, DomainId, HardwareGraph, HostAddress, Link, LinkId, Loss, Node,
    NodeId, NodeKind, Probability, Rate, Server, Tier, Timestamp,
};
use cotorra_numbers::quantile_of_times;

/// Datapath settings of a benchmark.
#[derive(Debug, Clone, Copy, Default)]
pub struct Setting {
    pub port: PortKind,
    /// Spinning policy.
    pub busy_poll: BusyPoll,
    /// Whether idle cores may sleep.
    pub let_cores_sleep: bool,
}

impl Setting {
    fn start(self, graph: &HardwareGraph) -> Result<Datapath, Error> {
        let Self { port, busy_poll, let_cores_sleep } = self;
        let options = Options { port, busy_poll, let_cores_sleep, ..Options::default() };
        let fabric = Fabric::new(graph, 1).expect("the graphs of benchmarks are sound");
        Datapath::start(graph, fabric, options)
    }
}

/// Percentiles of a distribution of durations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Percentiles {
    pub p50: Duration,
    /// 99th percentile.
    pub p99: Duration,
    pub max: Duration,
}

impl Percentiles {
    /// Computes the percentiles of at least one sample.
    fn of(mut samples: Vec<Duration>) -> Self {
        samples.sort_unstable();
        let at = |share| quantile_of_times(&samples, share).expect("there is a sample");
        Self { p50: at(0.5), p99: at(0.99), max: at(1.0) }
    }
}

/// Measures the excess of UDP round-trip times over a link's delay, in `round_trips` round trips of 64-byte packets,
/// one at a time.
///
/// # Errors
/// [`Error::Kernel`].
pub fn round_trip(setting: Setting, one_way: Duration, round_trips: usize) -> Result<Percentiles, Error> {
    let datapath = setting.start(&line(2, 1, &Conditions { delay: one_way, ..Conditions::default() }))?;
    let [client, server] = [0, 1].map(|place| socket(&datapath, place));
    let (client, server) = (client?, server?);
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| echo(&server, &done));
        let client = scope.spawn(|| {
            let to = SocketAddr::new(HostAddress::of(1).ipv4.into(), PORT);
            let percentiles = self::round_trips(&client, to, one_way, round_trips);
            done.store(true, Ordering::Relaxed);
            percentiles
        });
        let percentiles = client.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        percentiles.action("send a packet through the fabric")
    })
}

/// Echoes packets until `done`. The socket needs a read timeout, so that `done` is noticed.
pub fn echo(server: &UdpSocket, done: &AtomicBool) {
    be_timely();
    let mut buffer = [0; 64];
    while !done.load(Ordering::Relaxed) {
        if let Ok((length, from)) = server.recv_from(&mut buffer) {
            let _ = server.send_to(&buffer[..length], from);
        }
    }
}

/// Measures by how much each round trip to an [`echo`] exceeds twice the one-way delay.
///
/// # Errors
/// As [`UdpSocket::recv_from`].
pub fn round_trips(
    client: &UdpSocket,
    to: SocketAddr,
    one_way: Duration,
    round_trips: usize,
) -> io::Result<Percentiles> {
    be_timely();
    let clock = Clock::start();
    let once = |_| {
        let sent = clock.now();
        client.send_to(&[0; 64], to)?;
        client.recv_from(&mut [0; 64])?;
        Ok(clock.now().since(sent).saturating_sub(one_way * 2))
    };
    // The first few also resolve addresses.
    let samples: io::Result<Vec<_>> = (0..round_trips + 10).map(once).skip(10).collect();
    samples.map(Percentiles::of)
}

/// Measures TCP throughput in bit/s through `links` links in a row, each with these conditions. The first fifth of
/// `length`, while TCP speeds up, is not counted.
///
/// # Errors
/// [`Error::Kernel`].
pub fn tcp_throughput(
    setting: Setting,
    conditions: &Conditions,
    links: usize,
    length: Duration,
) -> Result<f64, Error> {
    let datapath = setting.start(&line(2, links, conditions))?;
    let listener = host(&datapath, 1).run(|| TcpListener::bind((Ipv4Addr::UNSPECIFIED, PORT)));
    let listener = listener.action("listen in a node")?;
    thread::scope(|scope| {
        let receiver = scope.spawn(move || receive(&listener, length));
        let to = SocketAddr::new(HostAddress::of(1).ipv4.into(), PORT);
        host(&datapath, 0).run(|| send(to)).action("connect through the fabric")?;
        let rate = receiver.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        rate.action("receive in a node")
    })
}

/// Sends over TCP until the other side closes the connection.
///
/// # Errors
/// As [`TcpStream::connect`].
pub fn send(to: SocketAddr) -> io::Result<()> {
    let mut sender = TcpStream::connect(to)?;
    let chunk = vec![0; 1 << 20];
    while sender.write_all(&chunk).is_ok() {}
    Ok(())
}

/// Returns the rate in bit/s at which the first connection sends. The first fifth of `length` is not counted.
///
/// # Errors
/// As [`TcpListener::accept`] and [`TcpStream::read`].
pub fn receive(listener: &TcpListener, length: Duration) -> io::Result<f64> {
    let (mut receiver, _) = listener.accept()?;
    let mut buffer = vec![0; 1 << 20];
    let clock = Clock::start();
    let begin = clock.now();
    let (mut bytes, mut from) = (0, None);
    loop {
        bytes += receiver.read(&mut buffer)? as u64;
        let now = clock.now();
        match from {
            None if now.since(begin) > length / 5 => (bytes, from) = (0, Some(now)),
            Some(from) if now.since(begin) > length => {
                return Ok(bytes as f64 * 8.0 / now.since(from).as_secs_f64());
            }
            _ => {}
        }
    }
}

/// Rate of small packets that the fabric's thread carries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PacketRate {
    /// Packets delivered per second of a flood from one sender.
    pub delivered: f64,
    /// Packets carried per second of the thread's running time, in bursts: the capacity of one core.
    pub per_core: f64,
}

/// Sends UDP packets of 64 bytes through one link: a flood for `length`, then bursts for `length`.
///
/// # Errors
/// [`Error::Kernel`].
pub fn packet_rate(setting: Setting, length: Duration) -> Result<PacketRate, Error> {
    let datapath = setting.start(&line(2, 1, &Conditions::default()))?;
    let (client, server) = (socket(&datapath, 0)?, socket(&datapath, 1)?);
    let clock = datapath.clock();
    let to = SocketAddr::new(HostAddress::of(1).ipv4.into(), PORT);
    let done = AtomicBool::new(false);
    let received = AtomicU64::new(0);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                if server.recv_from(&mut [0; 64]).is_ok() {
                    received.fetch_add(1, Ordering::Relaxed);
                }
            }
        });
        let begin = clock.now();
        while clock.now().since(begin) < length {
            for _ in 0..BURST {
                let _ = client.send_to(&[0; 64], to);
            }
        }
        let delivered = received.load(Ordering::Relaxed) as f64 / clock.now().since(begin).as_secs_f64();
        let per_core = bursts(&datapath.handle(), clock, length, || {
            let _ = client.send_to(&[0; 64], to);
        });
        done.store(true, Ordering::Relaxed);
        Ok(PacketRate { delivered, per_core: per_core? })
    })
}

/// Packets in a burst, few enough for any port's queue.
const BURST: u64 = 256;

/// Returns the packets carried per second of the fabric thread's running time, when it finds a burst each time it
/// wakes.
fn bursts(handle: &Handle, clock: Clock, length: Duration, send: impl Fn()) -> Result<f64, Error> {
    let carried = || {
        let contexts = handle.with(|fabric, now| fabric.link_contexts(now))?;
        Ok::<_, Error>(contexts.iter().map(|context| context.counters.packets).sum::<u64>())
    };
    let before = (carried()?, fabric_thread_busy());
    let begin = clock.now();
    while clock.now().since(begin) < length {
        let (holds, held) = mpsc::sync_channel(1);
        let (release, released) = mpsc::sync_channel::<()>(0);
        thread::scope(|scope| {
            scope.spawn(|| {
                handle.with(move |_, _| {
                    let _ = holds.send(());
                    // Returns when the other end is dropped.
                    let _ = released.recv();
                })
            });
            let _ = held.recv();
            (0..BURST).for_each(|_| send());
            drop(release);
        });
    }
    let after = (carried()?, fabric_thread_busy());
    Ok((after.0 - before.0) as f64 / after.1.saturating_sub(before.1).as_secs_f64())
}

/// Returns the running time of the fabric's thread so far.
fn fabric_thread_busy() -> Duration {
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let mut fabric =
        tasks.filter(|t| fs::read_to_string(t.path().join("comm")).is_ok_and(|n| n.trim() == "fabric"));
    let nanos = fabric.next().and_then(|task| {
        let stat = fs::read_to_string(task.path().join("schedstat")).ok()?;
        stat.split_whitespace().next()?.parse().ok()
    });
    Duration::from_nanos(nanos.unwrap_or_default())
}

/// Returns the relative error of a link's rate. Frames of 1442 bytes (Ethernet without preamble, FCS and gap) are
/// sent faster than the link takes them, for `length`.
///
/// # Errors
/// [`Error::Kernel`].
pub fn rate_error(setting: Setting, rate: BitRate, length: Duration) -> Result<f64, Error> {
    const PAYLOAD: usize = 1400;
    const FRAME: usize = 14 + 20 + 8 + PAYLOAD;
    let rate_limited = Rate::Fixed { bits_per_second: rate };
    let datapath = setting.start(&line(2, 1, &Conditions { rate: rate_limited, ..Conditions::default() }))?;
    let (client, server) = (socket(&datapath, 0)?, socket(&datapath, 1)?);
    let clock = datapath.clock();
    let to = SocketAddr::new(HostAddress::of(1).ipv4.into(), PORT);
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        let received = scope.spawn(|| {
            be_timely();
            let mut arrivals: Vec<Timestamp> = Vec::new();
            while !done.load(Ordering::Relaxed) {
                if server.recv_from(&mut [0; PAYLOAD]).is_ok() {
                    arrivals.push(clock.now());
                }
            }
            arrivals
        });
        let begin = clock.now();
        let mut sent = 0u64;
        while clock.now().since(begin) < length {
            // A fifth more than the rate keeps the queue full without occupying a core.
            let due = clock.now().since(begin).as_secs_f64() * rate.bits_per_second() as f64 * 1.2;
            while (sent * FRAME as u64 * 8) as f64 <= due {
                let _ = client.send_to(&[0; PAYLOAD], to);
                sent += 1;
            }
            thread::sleep(Duration::from_micros(200));
        }
        done.store(true, Ordering::Relaxed);
        let arrivals = received.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        // The queue fills at first.
        let steady = &arrivals[arrivals.len() / 10..];
        let (Some(first), Some(last)) = (steady.first(), steady.last()) else {
            return Err(Error::Stopped);
        };
        let bits = (steady.len() - 1) as f64 * FRAME as f64 * 8.0;
        let measured = bits / last.since(*first).as_secs_f64();
        Ok((measured / rate.bits_per_second() as f64 - 1.0).abs())
    })
}

/// Packet counts of a lossy link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LossCount {
    /// Packets that entered the link.
    pub packets: u64,
    /// Packets that it lost.
    pub lost: u64,
}

/// Sends UDP packets of 64 bytes over a link with this loss rate until `packets` have entered it.
///
/// # Errors
/// [`Error::Kernel`].
pub fn loss(setting: Setting, rate: Probability, packets: u64) -> Result<LossCount, Error> {
    let lossy = Conditions { loss: Loss::Independent { rate }, ..Conditions::default() };
    let datapath = setting.start(&line(2, 1, &lossy))?;
    // The server's socket is never read. Without it, ICMP errors would come back.
    let (client, _server) = (socket(&datapath, 0)?, socket(&datapath, 1)?);
    let to = SocketAddr::new(HostAddress::of(1).ipv4.into(), PORT);
    loop {
        for _ in 0..10_000 {
            let _ = client.send_to(&[0; 64], to);
        }
        // The link's own counters leave out drops at full sockets on either side.
        let counted = datapath.handle().with(|fabric, now| {
            let links = fabric.link_contexts(now);
            let forward = links.into_iter().find(|link| link.direction == Direction::Forward);
            let counters = forward.map(|link| link.counters).unwrap_or_default();
            LossCount { packets: counters.packets + counters.lost, lost: counters.lost }
        })?;
        if counted.packets >= packets {
            return Ok(counted);
        }
    }
}

/// Cost of bringing hosts up and down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BringUp {
    /// Time until every host can send.
    pub up: Duration,
    /// Time until all interfaces are gone.
    pub down: Duration,
    /// Decrease of available memory while they were up, including the kernel's.
    pub memory_bytes: u64,
}

/// Brings hosts up and down, each at its own switch, with the switches in a line: Mininet's `linear` topology.
///
/// # Errors
/// [`Error::Kernel`].
pub fn bring_up(setting: Setting, hosts: usize) -> Result<BringUp, Error> {
    let graph = line(hosts, 1, &Conditions::default());
    let clock = Clock::start();
    let before = available_memory();
    let begin = clock.now();
    let datapath = setting.start(&graph)?;
    let up = clock.now().since(begin);
    let memory_bytes = before.saturating_sub(available_memory());
    let begin = clock.now();
    drop(datapath);
    wait_until_removed()?;
    Ok(BringUp { up, down: clock.now().since(begin), memory_bytes })
}

fn available_memory() -> u64 {
    let info = fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = info.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kib.unwrap_or_default() * 1024
}

const PORT: u16 = 7711;

/// Adds the attempted action to an error of the kernel.
trait Action<T> {
    fn action(self, action: &'static str) -> Result<T, Error>;
}

impl<T> Action<T> for io::Result<T> {
    fn action(self, action: &'static str) -> Result<T, Error> {
        self.map_err(|source| Error::Kernel { action, source })
    }
}

fn host(datapath: &Datapath, place: usize) -> &Namespace {
    datapath.namespace(&server_name(place)).expect("a line has that many hosts")
}

/// Opens a socket with a read timeout, so that its thread can end.
fn socket(datapath: &Datapath, place: usize) -> Result<UdpSocket, Error> {
    let address = (IpAddr::from(Ipv4Addr::UNSPECIFIED), PORT);
    let socket = host(datapath, place).udp_socket(address).action("open a socket in a node")?;
    socket.set_read_timeout(Some(Duration::from_secs(1))).action("set a timeout")?;
    Ok(socket)
}

fn server_name(place: usize) -> NodeId {
    NodeId::new(&format!("h{place}")).expect("a letter and digits")
}

fn switch_name(place: usize) -> NodeId {
    NodeId::new(&format!("s{place}")).expect("a letter and digits")
}

/// Builds a line of switches with one host each. Two hosts with n links are instead the ends of n links in a row,
/// with n - 1 switches between.
fn line(hosts: usize, links: usize, conditions: &Conditions) -> HardwareGraph {
    let domain = DomainId::new("bench").expect("letters");
    let node = |id, kind| Node { id, domain: domain.clone(), position: None, kind };
    let server = NodeKind::Server(Server {
        tier: Tier::Fog,
        capacity: Capacity { cpus: 1.0, memory_bytes: 1 << 30, accelerators: None },
        cost: 0.0,
        used_cost: 0.0,
        memory_cost: 0.0,
        migration_cost: 0.0,
        reliability: 1.0,
        speed: 1.0,
        power: None,
        real: None,
    });
    let link = |a: NodeId, b: NodeId| Link {
        id: LinkId::new(&format!("{a}-{b}")).expect("two names and a dash"),
        ends: [a, b],
        forward: conditions.clone(),
        backward: conditions.clone(),
        scales: Default::default(),
        medium: BitRate::from_bits_per_second(100_000_000_000).expect("above zero"),
        medium_delay: Duration::ZERO,
        cost: 0.0,
        reliability: 1.0,
    };
    let mut nodes: Vec<Node> = (0..hosts).map(|i| node(server_name(i), server.clone())).collect();
    let switches = if hosts == 2 { links - 1 } else { hosts };
    nodes.extend((0..switches).map(|i| node(switch_name(i), NodeKind::Switch)));
    let mut wires: Vec<Link> = (1..switches).map(|i| link(switch_name(i - 1), switch_name(i))).collect();
    match (hosts, switches) {
        (2, 0) => wires.push(link(server_name(0), server_name(1))),
        (2, _) => {
            wires.push(link(server_name(0), switch_name(0)));
            wires.push(link(switch_name(switches - 1), server_name(1)));
        }
        _ => wires.extend((0..hosts).map(|i| link(server_name(i), switch_name(i)))),
    }
    HardwareGraph { domains: vec![domain.clone()], nodes, links: wires, wireless: Default::default() }
}
