//! The core's thread in real time: waits for messages and deadlines, and drives [`crate::core::Core`].
//!
//! It owns the clock and the sockets; decisions are the core's.

use std::{
    collections::BTreeMap,
    net::{SocketAddr, UdpSocket},
    sync::{Arc, mpsc},
};

use cotorra_datapath::StampedSocket;
use cotorra_engine::Engine;
use cotorra_fabric::Histogram;
use cotorra_graph::{NodeId, Stamped, Timestamp};
use cotorra_network_control::Network;
use parking_lot::Mutex;

use crate::{
    clock::Clock,
    core::{Core, images::ImageSender, message::Message},
    events::fanout::Fanout,
    history::bound::HistoryBound,
    plugins::running::RunningPlugins,
    real::control_sockets::ControlSockets,
    report::{End, Report},
};

/// Interval of checks of plug-ins.
const CHECK: std::time::Duration = std::time::Duration::from_millis(200);

/// State of the core's thread.
pub(crate) struct CoreLoop<N, E> {
    pub(crate) core: Core<N, E>,
    pub(crate) report: Report,
    pub(crate) plugins: RunningPlugins,
    pub(crate) fanout: Fanout,
    pub(crate) inbox: mpsc::Receiver<Message>,
    pub(crate) sockets: BTreeMap<NodeId, UdpSocket>,
    /// Sockets between the core and plug-ins on nodes.
    pub(crate) control: ControlSockets,
    /// Sender of images, if a camera's images go to a VNF.
    pub(crate) images: Option<ImageSender>,
    pub(crate) now: Clock,
    pub(crate) until: Option<Timestamp>,
    pub(crate) history: HistoryBound,
}

impl<N: Network, E: Engine> CoreLoop<N, E> {
    /// Observes the network for the first time, and publishes that: who asks the API first gets all contexts.
    pub(crate) fn observe(&mut self) {
        // If the network is gone, the next attempt ends the run.
        let _ = self.core.advance((self.now)());
        self.publish();
    }

    /// Runs until the end. Returns the report, and the time and reason of the end.
    pub(crate) fn run(mut self) -> (Report, Timestamp, End) {
        let mut next_check = Timestamp::ZERO;
        let end = loop {
            let now = (self.now)();
            if self.until.is_some_and(|until| now >= until) {
                break End::Until;
            }
            if self.core.is_finished() {
                break End::Walked;
            }
            if self.until.is_none() && self.core.is_stuck(now) {
                self.report.stuck(self.core.stand());
                break End::NoProgress;
            }
            if self.history.is_full(now) {
                break End::HistoryFull;
            }
            if self.core.advance(now).is_err() {
                break End::Broken;
            }
            self.transmit();
            if now >= next_check {
                next_check = now + CHECK;
                self.plugins.check(now, &mut self.core);
            }
            self.plugins.travel(now, &mut self.core);
            self.publish();
            while let Some(datagram) = self.plugins.poll_transmit((self.now)()) {
                self.control.send(&datagram);
            }
            let others = self.until.into_iter().chain(self.plugins.next_travel());
            let deadline = others.fold(self.core.next_deadline().min(next_check), Timestamp::min);
            match self.inbox.recv_timeout(deadline.since((self.now)())) {
                Ok(Message::Stop) | Err(mpsc::RecvTimeoutError::Disconnected) => break End::Stopped,
                Ok(message) => self.take(message),
                Err(mpsc::RecvTimeoutError::Timeout) => {}
            }
        };
        let now = (self.now)();
        if end != End::Stopped {
            // A plug-in that ended since the last check ended before the run did.
            self.plugins.check(now, &mut self.core);
        }
        self.core.shut_down(now);
        self.publish();
        for event in self.images.take().into_iter().flat_map(|sender| sender.remarks()) {
            self.publish_event(Stamped { at: now, event });
        }
        self.report.missed(self.plugins.missed());
        self.report.localized(self.core.localization_errors());
        self.report.waited(self.core.processor_waits());
        self.report.computed(self.core.computed());
        (self.report, now, end)
    }

    fn publish(&mut self) {
        // Data must be there when its event is published.
        while let Some(data) = self.core.poll_data() {
            self.fanout.data(data);
        }
        while let Some(event) = self.core.poll_event() {
            self.publish_event(event);
        }
        while let Some(scan) = self.core.poll_scan() {
            self.fanout.scan(scan);
        }
    }

    /// Passes an event on to the report, the plug-ins and all others.
    pub(crate) fn publish_event(&mut self, event: Stamped) {
        let Self { report, plugins, fanout, now, .. } = self;
        let now = now();
        fanout.publish(Arc::new(event), |event| {
            report.absorb(event);
            plugins.publish(now, event);
        });
    }

    fn transmit(&mut self) {
        while let Some(datagram) = self.core.poll_transmit((self.now)()) {
            let Some(socket) = self.sockets.get(&datagram.robot) else { continue };
            // A datagram that cannot be sent is lost, as on any network. Its sample then has no answer.
            if let Err(error) = socket.send_to(&datagram.bytes, SocketAddr::V4(datagram.to)) {
                tracing::debug!("{} cannot send to {}: {error}", datagram.robot, datagram.to);
            }
        }
        while let Some(image) = self.core.poll_image() {
            if let Some(sender) = &self.images {
                sender.offer(image);
            }
        }
    }

    fn take(&mut self, message: Message) {
        let now = (self.now)();
        match message {
            Message::Datagram { robot, from, at, bytes, _waiting } => {
                self.core.receive(at, &robot, from, &bytes);
            }
            Message::Instruct { given, reply } => {
                let done = self.plugins.instruct(now, given, &mut self.core);
                if let Some(reply) = reply {
                    // The instruction's events come before its reply.
                    self.publish();
                    reply(done);
                }
            }
            Message::Returned { plugin, at, handled, outcome } => {
                if handled {
                    self.plugins.handled(&plugin);
                }
                self.plugins.returned(at, &plugin, outcome, &mut self.core);
            }
            Message::Control { datagram, at, _waiting } => self.plugins.receive(at, &datagram),
            Message::Network(event) => self.core.observe(event),
            Message::Machine { context, .. } => self.core.observe(context),
            Message::Border(tunnel) => self.core.hear(now, tunnel),
            Message::Follow(_)
            | Message::Done { .. }
            | Message::ControlTime { .. }
            | Message::Wake
            | Message::Stop => {}
        }
    }
}

/// Largest number of a robot's datagrams that wait for the core. Further ones are lost, as with a full socket buffer.
const MAX_WAITING: usize = 128;

/// Receives a robot's datagrams, each with its time of arrival. Notes in `waits` for how long they waited before.
pub(crate) fn receive(
    robot: &NodeId,
    socket: &StampedSocket,
    now: &Clock,
    waits: &Mutex<Histogram>,
    tell: &mpsc::Sender<Message>,
) {
    let mut buffer = [0; 2048];
    let waiting = Arc::new(());
    loop {
        match socket.receive(&mut buffer) {
            Ok(_) if Arc::strong_count(&waiting) > MAX_WAITING => {}
            Ok((length, from, waited)) => {
                waits.lock().record(waited);
                let bytes = buffer[..length].to_vec();
                let message = Message::Datagram {
                    robot: robot.clone(),
                    from,
                    at: now(),
                    bytes,
                    _waiting: Arc::clone(&waiting),
                };
                if tell.send(message).is_err() {
                    return;
                }
            }
            Err(error) => match error.kind() {
                std::io::ErrorKind::Interrupted => {}
                // The read timeout, by which the thread notices the end of the core.
                std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut => {
                    if tell.send(Message::Wake).is_err() {
                        return;
                    }
                }
                _ => return tracing::error!("robot {robot} can receive nothing any more: {error}"),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{thread, time::Duration};

    use super::*;

    #[test]
    fn datagrams_wait_up_to_a_limit_and_further_ones_are_lost() {
        let robot: NodeId = "r1".parse().unwrap();
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let (to, sender) = (socket.local_addr().unwrap(), UdpSocket::bind("127.0.0.1:0").unwrap());
        let flood = || {
            for _ in 0..MAX_WAITING + 10 {
                sender.send_to(b"x", to).unwrap();
            }
        };
        let (tell, inbox) = mpsc::channel();
        let now: Clock = Arc::new(|| Timestamp::ZERO);
        // The thread sends `Wake` when no more datagrams arrive.
        let until_wake = || -> Vec<Message> {
            inbox.iter().take_while(|message| !matches!(message, Message::Wake)).collect()
        };
        flood();
        let socket = StampedSocket::new(socket).unwrap();
        let waits = Arc::<Mutex<Histogram>>::default();
        let its = Arc::clone(&waits);
        let receiver = thread::spawn(move || receive(&robot, &socket, &now, &its, &tell));
        let first = until_wake();
        assert_eq!(first.len(), MAX_WAITING);
        drop(first);
        flood();
        while until_wake().is_empty() {}
        assert!(waits.lock().summary().frames >= MAX_WAITING as u64, "the waits of all that came are known");
        drop(inbox);
        receiver.join().unwrap();
    }
}
