//! The fabric's thread. It waits for frames, commands and the fabric's next deadline, and sends what the fabric
//! delivers. Only this thread touches the fabric, which therefore needs no lock.

use std::{
    io, mem,
    os::fd::AsFd,
    sync::{Arc, atomic::Ordering, mpsc},
    time::Duration,
};

use cotorra_fabric::{Departure, Fabric, Frame, PortId};
use cotorra_graph::{Stamped, Timestamp};
use cotorra_traffic::Sources;
use parking_lot::Mutex;

use crate::{
    clock::Clock,
    error::Error,
    gateway::gate::Gate,
    port::{self, Arrival, Port, Sent},
    presence::{LONGEST_SLEEP, PortWaits, Presence, RunQueue},
    punctual::{self, BusyPoll, Punctuality},
    shared::Shared,
    sys::{Epoll, Ready},
    wifi::Air,
};

/// Most frames read from a port before the next port's turn.
const BATCH: usize = 64;
/// The duration of one send in this many is measured.
const MEASURED: u64 = 4;
/// Most answers of sources of traffic to each other until ports have their turn: a link without a delay would never let them.
const ROUNDS: usize = 16;
/// Upper limit on a measured send. A longer one was interrupted by other load.
const MOST_HANDOVER: Duration = Duration::from_micros(15);

/// Receiver of the fabric's events. Runs on the fabric's thread and must not block.
pub type EventSink = Box<dyn FnMut(Stamped) + Send>;

/// Receiver of packets for other cores. Runs on the fabric's thread and must not block.
pub type DepartureSink = Box<dyn FnMut(Departure) + Send>;

/// Sources of traffic. The fabric's thread drives them; others only look at them.
pub type SharedSources = Arc<Mutex<Sources>>;

/// Access to the fabric from any thread.
#[derive(Clone)]
pub struct Handle(pub(crate) Arc<Shared>);

impl Handle {
    /// Runs a closure on the fabric's thread immediately and returns its result. `now` is the time at which it runs.
    /// It should take microseconds, because packets wait meanwhile.
    ///
    /// # Errors
    /// [`Error::Stopped`] once the datapath has stopped.
    pub fn with<R: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, Error> {
        let (result, wait) = mpsc::sync_channel(1);
        self.0.commands.lock().as_mut().ok_or(Error::Stopped)?.push(Box::new(move |fabric, now| {
            // The receiver waits below.
            let _ = result.send(work(fabric, now));
        }));
        self.0.waker.wake();
        wait.recv().map_err(|_| Error::Stopped)
    }

    /// Returns how long frames waited in ports, and how long the fabric's thread was away, up to a tenth of a second ago.
    pub fn port_waits(&self) -> PortWaits {
        *self.0.waits.lock()
    }
}

impl std::fmt::Debug for Handle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Handle").finish()
    }
}

/// State of the fabric's thread.
pub(crate) struct Engine {
    fabric: Fabric,
    clock: Clock,
    ports: Ports,
    shared: Arc<Shared>,
    punctuality: Punctuality,
    presence: Presence,
    /// Time of the fabric's last poll. Frames that came before enter as of then.
    polled: Timestamp,
    /// Buffer for the part of a frame that exceeds an ordinary one.
    spill: Box<[u8]>,
    sinks: Sinks,
    /// The medium of simulated radios, if there are any.
    air: Option<Air>,
}

/// Where frames come from and go to that are no frames of a port, and where events go to.
#[derive(Default)]
pub(crate) struct Sinks {
    pub(crate) events: Option<EventSink>,
    pub(crate) departures: Option<DepartureSink>,
    pub(crate) traffic: Option<SharedSources>,
}

/// The ports, and measurements of sending.
struct Ports {
    ports: Vec<Port>,
    /// Sent frames, whose buffers go back to the fabric.
    spent: Vec<Frame>,
    epoll: Epoll,
    shared: Arc<Shared>,
    clock: Clock,
    /// Number of frames sent, and the smoothed duration of a send. Each frame is sent that much before it is due.
    sent: u64,
    handover: Duration,
}

impl Ports {
    fn send(&mut self, PortId(index): PortId, frame: Frame) {
        if self.shared.stopping.load(Ordering::Relaxed) {
            return;
        }
        // A damaged frame of a source of traffic may come out of the end of a link, where no port is.
        let Some(port) = self.ports.get_mut(index) else { return self.spent.push(frame) };
        if let Some(gate) = port.gate.clone() {
            return self.send_out(index, &gate, frame);
        }
        self.sent += 1;
        let begin = self.sent.is_multiple_of(MEASURED).then(|| self.clock.now());
        let sent = port.send(frame, &mut self.spent);
        if let Some(begin) = begin {
            let took = self.clock.now().since(begin).min(MOST_HANDOVER);
            self.handover = (self.handover * 7 + took) / 8;
        }
        match sent {
            Sent::Now => {}
            Sent::Dropped => self.shared.count_drop(),
            Sent::Waits => self.wait_to_send(index),
        }
    }

    /// Sends a frame out of a gateway, if its rules let it.
    fn send_out(&mut self, index: usize, gate: &Mutex<Gate>, frame: Frame) {
        let begin = self.clock.now();
        let way_out = gate.lock().way_out(begin, frame.bytes());
        let Some(to) = way_out else { return self.spent.push(frame) };
        let (offload, mut bytes) = (frame.offload(), frame.into_bytes());
        bytes[..to.len()].copy_from_slice(&to);
        let frame = Frame::with_offload(bytes, offload);
        let sent = self.ports[index].send(frame, &mut self.spent);
        match sent {
            Sent::Dropped => gate.lock().lost(1),
            Sent::Now | Sent::Waits => gate.lock().went_out(self.clock.now().since(begin)),
        }
        if sent == Sent::Waits {
            self.wait_to_send(index);
        }
    }

    fn wait_to_send(&self, index: usize) {
        // A failure leaves the frame queued until the next one to this port.
        drop(self.epoll.set_writable(self.ports[index].as_fd(), index, true));
    }

    fn flush(&mut self, index: usize) {
        let port = &mut self.ports[index];
        if port.flush(&mut self.spent) {
            drop(self.epoll.set_writable(port.as_fd(), index, false));
        }
    }
}

impl Engine {
    pub(crate) fn new(
        fabric: Fabric,
        clock: Clock,
        ports: Vec<Port>,
        shared: Arc<Shared>,
        busy_poll: BusyPoll,
        sinks: Sinks,
        air: Option<Air>,
    ) -> io::Result<Self> {
        let epoll = Epoll::new()?;
        for (index, port) in ports.iter().enumerate() {
            epoll.add(port.as_fd(), index)?;
        }
        epoll.add(shared.waker.as_fd(), ports.len())?;
        if let Some(air) = &air {
            epoll.add(air.as_fd(), ports.len() + 1)?;
        }
        let ports = Ports {
            ports,
            spent: Vec::new(),
            epoll,
            shared: Arc::clone(&shared),
            clock,
            sent: 0,
            handover: Duration::ZERO,
        };
        Ok(Self {
            fabric,
            clock,
            ports,
            shared,
            punctuality: Punctuality::new(busy_poll),
            presence: Presence::new(clock.now()),
            polled: Timestamp::ZERO,
            spill: vec![0; port::LARGEST].into(),
            sinks,
            air,
        })
    }

    /// Runs until stopped.
    pub(crate) fn run(mut self) -> io::Result<Fabric> {
        // Releases waiting callers, however this thread ends.
        struct Closing(Arc<Shared>);
        impl Drop for Closing {
            fn drop(&mut self) {
                self.0.stop();
            }
        }
        let _closing = Closing(Arc::clone(&self.shared));
        punctual::be_punctual();
        let queue = RunQueue::of_this_thread();
        let mut ready: Vec<Ready> = Vec::new();
        let mut deadline = self.poll(self.clock.now())?;
        self.presence = Presence::new(self.clock.now());
        // Also where a command has cleared the wake-up of the stop.
        while !self.shared.stopping.load(Ordering::Relaxed) {
            let before = self.clock.now();
            let until_due = deadline.map(|at| self.punctuality.sleep(before, at - self.ports.handover));
            let sleep = until_due.unwrap_or(LONGEST_SLEEP).min(LONGEST_SLEEP);
            self.presence.sleeps(before, sleep, || queue.waited());
            ready.clear();
            ready.extend(self.ports.epoll.wait(Some(sleep))?);
            let now = self.clock.now();
            self.presence.woke(now, self.ports.epoll.was_interrupted(), || queue.waited());
            self.punctuality.woke(now, ready.is_empty() && until_due == Some(sleep));
            if let Some(waits) = self.presence.publish(now) {
                self.shared.publish(waits);
            }
            let radios = self.ports.ports.len() + 1;
            if let Some(air) = self.air.as_mut().filter(|_| ready.iter().all(|event| event.token != radios)) {
                air.nothing_waits();
            }
            // Frames that are due go first.
            if deadline.is_some_and(|at| at <= now + self.ports.handover) {
                deadline = self.poll(now)?;
            }
            let mut arrived = Some(self.punctuality.event_at(before, now));
            for event in &ready {
                if self.shared.stopping.load(Ordering::Relaxed) {
                    break;
                }
                match event.token.checked_sub(self.ports.ports.len()) {
                    None => {
                        if event.writable {
                            self.ports.flush(event.token);
                        }
                        if event.readable {
                            self.receive(event.token, arrived.take());
                        }
                    }
                    Some(0) => self.run_commands(),
                    Some(_) => {
                        self.presence.found(self.presence.wait());
                        self.receive_from_radios()?;
                    }
                }
                deadline = self.poll(self.clock.now())?;
            }
        }
        self.shared.publish(self.presence.waits());
        port::close(self.ports.ports);
        Ok(self.fabric)
    }

    /// Lets the fabric deliver what is due at `now`, also to radios, and returns its next deadline.
    fn poll(&mut self, now: Timestamp) -> io::Result<Option<Timestamp>> {
        let deadline = self.poll_fabric(now);
        let Some(air) = &mut self.air else { return Ok(deadline) };
        air.deliver(now, &mut self.fabric, &self.shared)?;
        // Refusals and frames of radios may have changed it.
        Ok(self.poll_fabric(now))
    }

    /// Takes what the kernel's radios send.
    fn receive_from_radios(&mut self) -> io::Result<()> {
        match &mut self.air {
            Some(air) => air.receive(self.clock.now(), &mut self.fabric, &self.shared),
            None => Ok(()),
        }
    }

    /// Lets the fabric deliver what is due at ports, and returns its next deadline.
    fn poll_fabric(&mut self, now: Timestamp) -> Option<Timestamp> {
        let out = now + self.ports.handover;
        self.polled = self.polled.max(out);
        let deadline = match self.sinks.traffic.clone() {
            Some(sources) => self.poll_with_traffic(out, &mut sources.lock()),
            None => self.fabric.poll(out, &mut |port, frame| self.ports.send(port, frame)),
        };
        for frame in self.ports.spent.drain(..) {
            self.fabric.recycle(frame);
        }
        if let Some(sink) = &mut self.sinks.events {
            while let Some(event) = self.fabric.next_event() {
                sink(event);
            }
        }
        if let Some(sink) = &mut self.sinks.departures {
            while let Some(departure) = self.fabric.next_departure() {
                sink(departure);
            }
        }
        deadline
    }

    /// Lets the fabric also deliver what sources of traffic send, and what these answer, and returns the next deadline of both.
    fn poll_with_traffic(&mut self, out: Timestamp, sources: &mut Sources) -> Option<Timestamp> {
        let Self { fabric, ports, .. } = self;
        let mut deadline = None;
        for _ in 0..ROUNDS {
            fabric.push_all(out, |fabric, buffer| {
                let waiting = |from, to| fabric.waiting(PortId(from), PortId(to)) as usize;
                sources.poll(out, waiting, buffer).map(PortId)
            });
            let mut is_settled = true;
            deadline = fabric.poll(out, &mut |port, frame| {
                if sources.handle(out, port.0, frame.bytes()) {
                    is_settled = false;
                    ports.spent.push(frame);
                } else {
                    ports.send(port, frame);
                }
            });
            if is_settled {
                break;
            }
        }
        deadline.into_iter().chain(sources.deadline(out)).min()
    }

    /// Receives frames at a port. `arrived` is the estimated arrival of the first at a port that does not report it.
    fn receive(&mut self, index: usize, mut arrived: Option<Timestamp>) {
        let port = &mut self.ports.ports[index];
        let wait = self.presence.wait().max(mem::take(&mut port.left));
        for count in 0..port.batch {
            match port.receive(&mut self.fabric, &mut self.spill) {
                Ok(Some((frame, _))) if is_membership_report(frame.bytes()) => self.fabric.recycle(frame),
                Ok(Some((frame, arrival))) => {
                    let at = match (arrival, &port.gate) {
                        (Arrival::Ago(age), gate) => {
                            let now = self.clock.now();
                            let at = now - age;
                            match gate {
                                Some(gate) if !gate.lock().admits(now, age, &frame) => {
                                    self.fabric.recycle(frame);
                                    continue;
                                }
                                Some(_) => {}
                                // From here on, its lateness is that of its delivery.
                                None => self.presence.found(self.polled.since(at)),
                            }
                            at
                        }
                        (Arrival::Unknown, _) => {
                            self.presence.found(wait);
                            arrived.take().unwrap_or_else(|| self.clock.now())
                        }
                    };
                    self.fabric.push(at, PortId(index), frame);
                }
                Ok(None) => {
                    port.batch = count.max(1);
                    return;
                }
                Err(e) => {
                    match &port.gate {
                        Some(gate) => gate.lock().reject(),
                        None => self.shared.count_drop(),
                    }
                    // A program in the node removed its interface: the descriptor would stay ready for ever.
                    if e.raw_os_error() == Some(libc::EBADFD) {
                        drop(self.ports.epoll.remove(port.as_fd()));
                        return;
                    }
                }
            }
        }
        port.left = wait;
        port.batch = (port.batch * 2).min(BATCH);
    }

    /// Runs the commands of other threads.
    fn run_commands(&mut self) {
        self.shared.waker.clear();
        let commands = self.shared.commands.lock().as_mut().map(mem::take);
        for command in commands.unwrap_or_default() {
            command(&mut self.fabric, self.clock.now());
        }
    }
}

/// Whether a frame reports a multicast group membership (IGMPv3, RFC 3376, 4.2.14; MLDv2, RFC 3810, 5.2.14). A switch
/// forwards such reports to multicast routers only (RFC 4541, 2.1.1), and a testbed has none. Flooded, the reports of
/// a thousand starting hosts would be millions of packets.
fn is_membership_report(frame: &[u8]) -> bool {
    const IGMP_V3: [u8; 6] = [0x01, 0x00, 0x5e, 0x00, 0x00, 0x16];
    const MLD_V2: [u8; 6] = [0x33, 0x33, 0x00, 0x00, 0x00, 0x16];
    frame.starts_with(&IGMP_V3) || frame.starts_with(&MLD_V2)
}

#[cfg(test)]
mod tests {
    use cotorra_graph::HardwareGraph;

    use super::*;

    #[test]
    fn a_stop_whose_wake_up_a_command_cleared_ends_the_thread() {
        let graph =
            HardwareGraph { domains: Vec::new(), nodes: Vec::new(), links: Vec::new(), wireless: [].into() };
        let shared = Arc::new(Shared::new().unwrap());
        let fabric = Fabric::new(&graph, 1).unwrap();
        let (clock, also_shared) = (Clock::start(), Arc::clone(&shared));
        let engine =
            Engine::new(fabric, clock, Vec::new(), also_shared, BusyPoll::Never, Sinks::default(), None)
                .unwrap();
        shared.stop();
        shared.waker.clear();
        engine.run().unwrap();
    }
}
