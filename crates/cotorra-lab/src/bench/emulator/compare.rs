//! Compares the fabric with NetEm in one kernel: the same graph, conditions and probes, so that only the emulator
//! differs.

use std::{
    net::{Ipv4Addr, SocketAddr, TcpListener, UdpSocket},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use cotorra_datapath::{
    BusyPoll, Clock, Datapath, Error, KernelNetwork, KernelNetworkError, Namespace, PortKind, be_timely,
};
use cotorra_fabric::Fabric;
use cotorra_graph::{
    ConditionChange, Conditions, Direction, HardwareGraph, HostAddress, Jitter, JitterDistribution, LinkId,
    Loss, NodeId, Probability, Timestamp,
};

use super::{Action, PORT, Percentiles, Setting, line, receive, send, server_name};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Emulator {
    Fabric,
    /// The kernel's NetEm.
    NetEm,
}

/// Lets cores sleep: in a kernel with one core, such as user-mode Linux, keeping it awake would get in the way.
const SETTING: Setting = Setting { port: PortKind::Auto, busy_poll: BusyPoll::Never, let_cores_sleep: true };

/// A network emulated by either.
enum Network {
    Fabric(Datapath),
    NetEm(KernelNetwork),
}

impl Emulator {
    fn start(self, graph: &HardwareGraph) -> Result<Network, KernelNetworkError> {
        Ok(match self {
            Self::Fabric => Network::Fabric(SETTING.start(graph)?),
            Self::NetEm => {
                let fabric = Fabric::new(graph, 1).expect("the graphs of benchmarks are sound");
                Network::NetEm(KernelNetwork::start(graph, &fabric, None)?)
            }
        })
    }
}

impl Network {
    fn host(&self, place: usize) -> Result<&Namespace, Error> {
        let name: NodeId = server_name(place);
        match self {
            Self::Fabric(datapath) => datapath.namespace(&name),
            Self::NetEm(kernel) => kernel.namespace(&name),
        }
    }

    /// Sets another delay, which applies when this returns.
    fn change(&self, link: &LinkId, delay: Duration) -> Result<(), KernelNetworkError> {
        match self {
            Self::Fabric(datapath) => {
                let (link, change) = (
                    link.clone(),
                    ConditionChange {
                        delay_ms: Some(delay.as_secs_f64() * 1e3),
                        ..ConditionChange::default()
                    },
                );
                let changed = datapath
                    .handle()
                    .with(move |fabric: &mut Fabric, now| fabric.change(now, &link, None, &change))?;
                changed.expect("a delay of milliseconds can be");
                Ok(())
            }
            Self::NetEm(kernel) => {
                kernel.set(link, Direction::Forward, &Conditions { delay, ..Conditions::default() })
            }
        }
    }

    /// Sends `packets` packets of 64 bytes from one end of the line to the other, `at_once` of them every `gap`.
    /// Returns send and arrival time of each that arrived. Runs `meanwhile` in parallel.
    fn probe<R>(
        &self,
        packets: usize,
        at_once: usize,
        gap: Duration,
        meanwhile: impl FnOnce(Clock) -> R,
    ) -> Result<(Vec<(Timestamp, Timestamp)>, R), Error> {
        let sender =
            self.host(0)?.udp_socket((Ipv4Addr::UNSPECIFIED, PORT)).action("open a socket in a node")?;
        let receiver =
            self.host(1)?.udp_socket((Ipv4Addr::UNSPECIFIED, PORT)).action("open a socket in a node")?;
        receiver.set_read_timeout(Some(Duration::from_secs(1))).action("set a timeout")?;
        let to = SocketAddr::new(HostAddress::of(1).ipv4.into(), PORT);
        // Resolves the hosts' addresses.
        for _ in 0..10 {
            let _ = sender.send_to(&[0; 64], to);
            let _ = receiver.recv(&mut [0; 64]);
        }
        let clock = Clock::start();
        let done = AtomicBool::new(false);
        thread::scope(|scope| {
            let receiving = scope.spawn(|| collect(&receiver, clock, &done));
            let sending = scope.spawn(|| {
                be_timely();
                for number in 0..packets {
                    let mut packet = [0; 64];
                    packet[..8].copy_from_slice(&clock.now().as_nanos().to_ne_bytes());
                    // A full queue is a loss like another.
                    let _ = sender.send_to(&packet, to);
                    if number % at_once == at_once - 1 {
                        thread::sleep(gap);
                    }
                }
                done.store(true, Ordering::Relaxed);
            });
            let result = meanwhile(clock);
            sending.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            let arrived = receiving.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            Ok((arrived, result))
        })
    }
}

/// Collects arrivals until a second after the last packet was sent.
fn collect(receiver: &UdpSocket, clock: Clock, done: &AtomicBool) -> Vec<(Timestamp, Timestamp)> {
    be_timely();
    let mut arrived = Vec::new();
    let mut packet = [0; 64];
    loop {
        match receiver.recv(&mut packet) {
            Ok(_) => {
                let [a, b, c, d, e, f, g, h, ..] = packet;
                let sent = Timestamp::from_nanos(u64::from_ne_bytes([a, b, c, d, e, f, g, h]));
                arrived.push((sent, clock.now()));
            }
            Err(_) if done.load(Ordering::Relaxed) => return arrived,
            Err(_) => {}
        }
    }
}

const MILLISECOND: Duration = Duration::from_millis(1);

/// Measures by how much transit times exceed the delays of `links` links in a row.
///
/// # Errors
/// [`KernelNetworkError`].
pub fn delay_error(
    emulator: Emulator,
    links: usize,
    delay: Duration,
) -> Result<Percentiles, KernelNetworkError> {
    let network = emulator.start(&line(2, links, &Conditions { delay, ..Conditions::default() }))?;
    let (arrived, ()) = network.probe(2000, 1, MILLISECOND, |_| ())?;
    let error = |(sent, at): (Timestamp, Timestamp)| at.since(sent).saturating_sub(delay * links as u32);
    Ok(Percentiles::of(arrived.into_iter().map(error).collect()))
}

/// Measures the standard deviation of transit times over `links` links in a row, each of 20 ms with normal jitter of
/// this standard deviation.
///
/// # Errors
/// [`KernelNetworkError`].
pub fn jitter(emulator: Emulator, links: usize, deviation: Duration) -> Result<Duration, KernelNetworkError> {
    let jitter = Jitter { deviation, distribution: JitterDistribution::Normal, ..Jitter::default() };
    let delay = Duration::from_millis(20);
    let network = emulator.start(&line(
        2,
        links,
        &Conditions { delay, jitter: Some(jitter), ..Conditions::default() },
    ))?;
    // Packets are so far apart that keeping order delays none.
    let (arrived, ()) = network.probe(1000, 1, deviation * 5, |_| ())?;
    let took: Vec<_> = arrived.iter().map(|(sent, at)| at.since(*sent).as_secs_f64()).collect();
    let mean = took.iter().sum::<f64>() / took.len() as f64;
    let variance = took.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / took.len() as f64;
    Ok(Duration::from_secs_f64(variance.sqrt()))
}

/// Measures the share of packets lost over `links` links in a row with this loss rate each.
///
/// # Errors
/// [`KernelNetworkError`].
pub fn loss(emulator: Emulator, links: usize, rate: Probability) -> Result<f64, KernelNetworkError> {
    const PACKETS: usize = 50_000;
    let loss = Loss::Independent { rate };
    let network = emulator.start(&line(2, links, &Conditions { loss, ..Conditions::default() }))?;
    let (arrived, ()) = network.probe(PACKETS, 20, MILLISECOND, |_| ())?;
    Ok(1.0 - arrived.len() as f64 / PACKETS as f64)
}

/// Measures TCP throughput in bit/s over `links` unlimited links in a row.
///
/// # Errors
/// [`KernelNetworkError`].
pub fn throughput(emulator: Emulator, links: usize, length: Duration) -> Result<f64, KernelNetworkError> {
    let network = emulator.start(&line(2, links, &Conditions::default()))?;
    let listener = network.host(1)?.run(|| TcpListener::bind((Ipv4Addr::UNSPECIFIED, PORT)));
    let listener = listener.action("listen in a node")?;
    let client = network.host(0)?;
    thread::scope(|scope| {
        let receiver = scope.spawn(move || receive(&listener, length));
        let to = SocketAddr::new(HostAddress::of(1).ipv4.into(), PORT);
        client.run(|| send(to)).action("connect through the network")?;
        let rate = receiver.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        Ok(rate.action("receive in a node")?)
    })
}

/// Measures how long after a delay change returned packets were still sent under the old delay; zero if none. A
/// packet is sent about every 0.1 ms.
///
/// # Errors
/// [`KernelNetworkError`].
pub fn change_lag(emulator: Emulator, changes: usize) -> Result<Percentiles, KernelNetworkError> {
    const SHORT: Duration = MILLISECOND;
    const LONG: Duration = Duration::from_millis(15);
    let graph = line(2, 1, &Conditions { delay: SHORT, ..Conditions::default() });
    let network = emulator.start(&graph)?;
    let link = &graph.links[0].id;
    let (arrived, changed) = network.probe(changes * 1000, 1, Duration::from_micros(50), |clock| {
        let mut changed = Vec::new();
        for _ in 0..changes {
            thread::sleep(LONG);
            network.change(link, LONG)?;
            changed.push(clock.now());
            // The fabric brings packets in flight forward when a delay falls, so wait until all that count have
            // arrived.
            thread::sleep(LONG * 4);
            network.change(link, SHORT)?;
        }
        Ok::<_, KernelNetworkError>(changed)
    })?;
    let lag = |changed: Timestamp| {
        let missed = arrived
            .iter()
            // Until the delay falls again.
            .filter(|(sent, _)| *sent >= changed && sent.since(changed) < LONG)
            .filter(|(sent, at)| at.since(*sent) < (SHORT + LONG) / 2)
            .map(|(sent, _)| sent.since(changed));
        missed.max().unwrap_or_default()
    };
    Ok(Percentiles::of(changed?.into_iter().map(lag).collect()))
}
