//! One flow at one host's port.

use std::time::Duration;

use crate::{
    packet::Frame,
    requests::{Counts, Id, Sample},
    ros1,
    ros2::{self, Ros2},
    tcp::{Kind, Tcp},
    udp::Udp,
};

/// Which flow.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Protocol {
    /// A datagram to this port, and the datagram that answers it.
    Udp {
        /// The server's port.
        port: u16,
        /// What tells requests of one socket apart.
        id: Option<Id>,
    },
    /// What a client says on a connection to this port before the server says something, and the first byte of that.
    Tcp {
        /// The server's port.
        port: u16,
    },
    /// An HTTP/1 request to this port, and the last byte of the response.
    Http {
        /// The server's port.
        port: u16,
        /// Only requests of this path, whatever their query.
        path: Option<String>,
    },
    /// A message of a topic of ROS 1 from the port, and one of another topic to it.
    Ros1 {
        /// The topic of requests.
        request: String,
        /// The topic of answers.
        answer: String,
        /// What tells messages apart: bytes of both, behind their length.
        id: Option<Id>,
    },
    /// A call of a service of ROS 1.
    Ros1Service {
        /// The service.
        service: String,
    },
    /// A message of a topic of ROS 2 from the port, and one of another topic to it.
    Ros2 {
        /// The topic of requests.
        request: String,
        /// The topic of answers.
        answer: String,
        /// What tells messages apart: bytes of both, behind what says how they are serialized.
        id: Option<Id>,
    },
    /// A call of a service of ROS 2.
    Ros2Service {
        /// The service.
        service: String,
    },
    /// A goal of an action of ROS 2, and its result.
    Ros2Action {
        /// The action.
        action: String,
    },
}

#[derive(Debug)]
enum Followed {
    Udp(Udp),
    Tcp(Tcp),
    Ros2(Ros2),
}

/// Measures one flow at one host's port. See the [crate's documentation](crate).
#[derive(Debug)]
pub struct Meter(Followed);

impl Meter {
    /// A meter that has seen nothing. A request without an answer after `timeout` is lost; an answer that comes then is none.
    pub fn new(protocol: Protocol, timeout: Duration) -> Self {
        Self(match protocol {
            Protocol::Udp { port, id } => Followed::Udp(Udp::new(port, id, timeout)),
            Protocol::Tcp { port } => Followed::Tcp(Tcp::new(Kind::Bursts(port), timeout)),
            Protocol::Http { port, path } => Followed::Tcp(Tcp::new(Kind::Http(port, path), timeout)),
            Protocol::Ros1 { request, answer, id } => {
                let measured = ros1::Measured::Topics { request, answer, id };
                Followed::Tcp(Tcp::new(Kind::Ros1(measured), timeout))
            }
            Protocol::Ros1Service { service } => {
                Followed::Tcp(Tcp::new(Kind::Ros1(ros1::Measured::Service(service)), timeout))
            }
            Protocol::Ros2 { request, answer, id } => {
                Followed::Ros2(Ros2::new(ros2::Measured::Topics { request, answer, id }, timeout))
            }
            Protocol::Ros2Service { service } => {
                Followed::Ros2(Ros2::new(ros2::Measured::Service(service), timeout))
            }
            Protocol::Ros2Action { action } => {
                Followed::Ros2(Ros2::new(ros2::Measured::Action(action), timeout))
            }
        })
    }

    /// A frame entered the network at the port. Samples of requests in it have the mark.
    pub fn entered(&mut self, at: Duration, frame: &Frame<'_>, mark: u64) {
        match &mut self.0 {
            Followed::Udp(udp) => udp.entered(at, frame, mark),
            Followed::Tcp(tcp) => tcp.passed(at, frame, mark, true),
            Followed::Ros2(ros) => ros.passed(at, frame, mark, true),
        }
    }

    /// A frame was delivered at the port.
    pub fn delivered(&mut self, at: Duration, frame: &Frame<'_>) {
        match &mut self.0 {
            Followed::Udp(udp) => udp.delivered(at, frame),
            Followed::Tcp(tcp) => tcp.passed(at, frame, 0, false),
            Followed::Ros2(ros) => ros.passed(at, frame, 0, false),
        }
    }

    /// Gives up requests that were not answered in time.
    pub fn expire(&mut self, now: Duration) {
        match &mut self.0 {
            Followed::Udp(udp) => udp.requests.expire(now),
            Followed::Tcp(tcp) => tcp.requests.expire(now),
            Followed::Ros2(ros) => ros.requests.expire(now),
        }
    }

    /// When [`Meter::expire`] has something to do.
    pub fn deadline(&self) -> Option<Duration> {
        match &self.0 {
            Followed::Udp(udp) => udp.requests.deadline(),
            Followed::Tcp(tcp) => tcp.requests.deadline(),
            Followed::Ros2(ros) => ros.requests.deadline(),
        }
    }

    /// The next sample, in the order in which they came about.
    pub fn poll(&mut self) -> Option<Sample> {
        match &mut self.0 {
            Followed::Udp(udp) => udp.requests.poll(),
            Followed::Tcp(tcp) => tcp.requests.poll(),
            Followed::Ros2(ros) => ros.requests.poll(),
        }
    }

    /// How much was seen so far.
    pub fn counts(&self) -> Counts {
        match &self.0 {
            Followed::Udp(udp) => udp.requests.counts,
            Followed::Tcp(tcp) => tcp.requests.counts,
            Followed::Ros2(ros) => ros.requests.counts,
        }
    }
}
