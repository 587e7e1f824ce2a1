//! Threads that use the CPU time of a VNF's demand, before its answers are sent.
#![allow(clippy::disallowed_types, reason = "the shell of a program: requests wait in real time")]

use std::{
    env, fmt, io,
    io::Write,
    net::{SocketAddr, UdpSocket},
    num::NonZero,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use cotorra_computing::{Demands, Limits};
use cotorra_engine::{RequestLine, START};
use cotorra_graph::{NodeKind, Testbed, Vnf, VnfId};
use cotorra_plugin::vnf::Answer;
use parking_lot::{Condvar, Mutex};
use rustix::time::{ClockId, clock_gettime};

use crate::requests::{Request, Requests};

/// Seed of the run; without it, that of the testbed file.
pub const SEED: &str = "COTORRA_SEED";

/// CPU time after which a served request lets others have their turn.
const TURN: Duration = Duration::from_micros(500);

/// The demand of a VNF has impossible parameters, which a testbed file's never has.
#[derive(Debug, thiserror::Error)]
#[error("the demand of `{0}` has no such distribution")]
pub struct NoDistribution(VnfId);

/// Computes the answers of this process's VNF.
pub(crate) struct Computer {
    demands: Demands,
    limits: Limits,
    speed: f64,
}

impl Computer {
    /// Returns the computer of the VNF that the variables of this process name; `None` if it has no demand.
    ///
    /// # Errors
    /// [`NoDistribution`].
    pub(crate) fn of(testbed: &Testbed) -> Result<Option<Self>, NoDistribution> {
        let text = |name: &str| env::var(name).unwrap_or_default();
        let number = |name: &str| text(name).parse().ok();
        let id = text("COTORRA_VNF");
        let Some(vnf) = testbed.vnfs().find(|vnf| vnf.id.as_str() == id) else { return Ok(None) };
        let speed = speed(testbed, &text("COTORRA_NODE"));
        let (replica, start) = (number("COTORRA_REPLICA").unwrap_or(0), number(START).unwrap_or(1));
        let seed = number(SEED).unwrap_or(testbed.seed);
        Self::new(vnf, seed, &format!("{id} {replica} {start}"), speed)
    }

    /// Creates the computer of a VNF on a node of that speed. Its demands are those that `label` has in virtual time.
    fn new(vnf: &Vnf, seed: u64, label: &str, speed: f64) -> Result<Option<Self>, NoDistribution> {
        let Some(computing) = &vnf.computing else { return Ok(None) };
        let demands = Demands::new(computing, seed, label).ok_or_else(|| NoDistribution(vnf.id.clone()))?;
        Ok(Some(Self { demands, limits: Limits::new(computing, vnf.most_cpus()), speed }))
    }

    /// Starts threads. Returns a function that takes answers: each is sent from the socket once its demand was computed, or
    /// dropped if the backlog is full.
    ///
    /// # Errors
    /// The error of the system if it has no threads.
    pub(crate) fn start(self, socket: &UdpSocket) -> io::Result<impl FnMut(Answer<'_>) + use<>> {
        let Self { mut demands, limits, speed } = self;
        let requests = Requests::new(&limits);
        let threads = threads(limits.cpus).min(requests.slots());
        let shared = Arc::new(Shared { requests: Mutex::new(requests), served: Condvar::new() });
        for _ in 0..threads {
            let (shared, socket) = (Arc::clone(&shared), socket.try_clone()?);
            thread::Builder::new().name("computes".to_owned()).spawn(move || shared.work(&socket))?;
        }
        Ok(move |answer: Answer<'_>| {
            let left = demands.next(answer.request_bytes).div_f64(speed);
            let token = Token {
                bytes: answer.bytes.into(),
                to: answer.to,
                arrived: Instant::now(),
                used: Duration::ZERO,
            };
            shared.arrive(Request { left, token });
        })
    }
}

impl fmt::Debug for Computer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Computer").field("limits", &self.limits).finish_non_exhaustive()
    }
}

/// Returns the speed of a node's CPUs.
fn speed(testbed: &Testbed, node: &str) -> f64 {
    match testbed.graph.nodes.iter().find(|its| its.id.as_str() == node).map(|node| &node.kind) {
        Some(NodeKind::Server(server)) => server.speed,
        _ => 1.0,
    }
}

/// Returns the number of threads that can use so many CPUs on this machine. More would use no more.
fn threads(cpus: f64) -> usize {
    let here = thread::available_parallelism().map_or(1, NonZero::get);
    (cpus.ceil() as usize).clamp(1, here)
}

/// An answer on its way.
struct Token {
    bytes: Box<[u8]>,
    to: SocketAddr,
    arrived: Instant,
    /// CPU time that it took so far.
    used: Duration,
}

struct Shared {
    requests: Mutex<Requests<Token>>,
    /// Signalled when a request is served that no thread works on.
    served: Condvar,
}

impl Shared {
    fn arrive(&self, request: Request<Token>) {
        let mut requests = self.requests.lock();
        // While no thread can answer it: its arrival comes first.
        match requests.arrive(request) {
            Ok(()) => {
                report(RequestLine::Arrived);
                self.served.notify_one();
            }
            Err(_) => report(RequestLine::Dropped),
        }
    }

    /// Works on requests until the process ends.
    fn work(&self, socket: &UdpSocket) {
        let mut requests = self.requests.lock();
        loop {
            let Some(Request { left, mut token }) = requests.take() else {
                self.served.wait(&mut requests);
                continue;
            };
            drop(requests);
            let used = use_cpu(left.min(TURN));
            token.used += used;
            let left = left.saturating_sub(used);
            if left.is_zero() {
                // A robot that cannot be reached now asks again soon enough.
                let _ = socket.send_to(&token.bytes, token.to);
                let waiting = token.arrived.elapsed().saturating_sub(token.used);
                report(RequestLine::Served { cpu_time: token.used, waiting });
            }
            requests = self.requests.lock();
            if left.is_zero() { requests.finish() } else { requests.put_back(Request { left, token }) }
        }
    }
}

/// Uses that much CPU time of this thread, and returns how much it was.
fn use_cpu(time: Duration) -> Duration {
    let clock = || {
        let now = clock_gettime(ClockId::ThreadCPUTime);
        Duration::new(now.tv_sec.cast_unsigned(), now.tv_nsec as u32)
    };
    let began = clock();
    loop {
        let used = clock().saturating_sub(began);
        if used >= time {
            return used;
        }
        std::hint::spin_loop();
    }
}

/// Reports a request to the engine that started this program.
fn report(line: RequestLine) {
    // Nobody reads it if the engine is gone, or this program was started by hand.
    let _ = writeln!(io::stdout().lock(), "{line}");
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn testbed(brain: &str) -> Testbed {
        let text = format!(
            "name: x
wireless: {{ w: {{}} }}
nodes:
  r: {{ kind: robot }}
  R1: {{ kind: radio_unit, position: [0, 2], channel: 1 }}
  fast: {{ kind: server, tier: edge, cpus: 1, memory: 1 GB, speed: 2.5 }}
links: [{{ ends: [R1, fast] }}]
services:
  s:
    robot: r
    kpis: {{ service_time: 9 ms }}
    vnfs:
      driver: {{ program: robot_driver, pinned_to: r, cpus: 0 }}
      n: {{ program: navigation, node: fast{brain} }}
walks: {{ r: {{ waypoints: [[0, 0], [1, 0]] }} }}
"
        );
        cotorra_testbed_file::parse("x.yaml", &text, Path::new(".")).unwrap_or_else(|wrong| panic!("{wrong}"))
    }

    fn computer(brain: &str) -> Option<Computer> {
        let testbed = testbed(brain);
        let vnf = testbed.vnfs().find(|vnf| vnf.id.as_str() == "n").unwrap();
        Computer::new(vnf, 7, "n 0 1", speed(&testbed, "fast")).unwrap()
    }

    #[test]
    fn a_thread_uses_the_cpu_time_that_it_should() {
        assert!(use_cpu(Duration::ZERO) < 50 * MS);
        assert!(use_cpu(3 * MS) >= 3 * MS);
    }

    #[test]
    fn only_servers_have_a_speed() {
        let testbed = testbed("");
        assert_eq!(
            ["fast", "R1", "r", "", "other"].map(|node| speed(&testbed, node)),
            [2.5, 1.0, 1.0, 1.0, 1.0]
        );
    }

    #[test]
    fn a_vnf_without_a_demand_has_no_computer() {
        assert!(computer("").is_none());
        assert_eq!(computer(", demand: 5 ms").unwrap().demands.next(0), 5 * MS);
    }

    #[test]
    fn answers_are_sent_in_the_order_of_their_requests_once_they_are_computed() {
        let [server, robot] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        let mut send = computer(", demand: 5 ms, backlog: 1000").unwrap().start(&server).unwrap();
        let (began, to) = (Instant::now(), robot.local_addr().unwrap());
        (0..5).for_each(|number| send(Answer { request_bytes: 100, bytes: &[number], to }));
        let mut received = [9; 2];
        for number in 0..5 {
            assert_eq!(robot.recv_from(&mut received).unwrap(), (1, server.local_addr().unwrap()));
            assert_eq!(received[0], number);
        }
        // Each takes 5 ms by a speed of 2.5, and one thread computes them.
        assert!(began.elapsed() >= 10 * MS);
    }

    #[test]
    fn an_answer_beyond_the_backlog_is_dropped() {
        let [server, robot] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        let mut send = computer(", demand: 1 s, backlog: 1").unwrap().start(&server).unwrap();
        let to = robot.local_addr().unwrap();
        (0..3).for_each(|number| send(Answer { request_bytes: 100, bytes: &[number], to }));
        let mut received = [9; 2];
        robot.recv_from(&mut received).unwrap();
        assert_eq!(received[0], 0);
        // The thread may not have ended its work yet.
        loop {
            send(Answer { request_bytes: 100, bytes: &[7], to });
            robot.set_read_timeout(Some(Duration::from_millis(1500))).unwrap();
            if let Ok((1, _)) = robot.recv_from(&mut received) {
                break;
            }
        }
        assert_eq!(received[0], 7, "1 and 2 were dropped");
    }
}
