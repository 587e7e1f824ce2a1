//! Measures one flow at one host's port.

use std::time::Duration;

use crate::{
    packet::Frame,
    requests::{Counts, Id, Sample},
    ros1,
    ros2::{self, Ros2},
    tcp::{Kind, Tcp},
    udp::Udp,
};

/// The flow to measure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Protocol {
    /// Datagrams to a port, and the datagrams that answer them.
    Udp {
        /// The server's port.
        port: u16,
        /// Distinguishes requests of one socket.
        id: Option<Id>,
    },
    /// Bursts of a client on a connection to a port, each up to the first byte of the server's answer.
    Tcp {
        /// The server's port.
        port: u16,
    },
    /// Requests of HTTP/1 or HTTP/2 to a port, each up to the last byte of the response.
    Http {
        /// The server's port.
        port: u16,
        /// Measures only requests of this path, with any query.
        path: Option<String>,
    },
    /// Messages of a ROS 1 topic from the port, and messages of another topic to it.
    Ros1 {
        /// The topic of requests.
        request: String,
        /// The topic of answers.
        answer: String,
        /// Distinguishes messages: bytes of both, behind their length.
        id: Option<Id>,
    },
    /// Calls of a ROS 1 service.
    Ros1Service {
        /// The service.
        service: String,
    },
    /// Messages of a ROS 2 topic from the port, and messages of another topic to it.
    Ros2 {
        /// The topic of requests.
        request: String,
        /// The topic of answers.
        answer: String,
        /// Distinguishes messages: bytes of both, behind the encapsulation header.
        id: Option<Id>,
    },
    /// Calls of a ROS 2 service.
    Ros2Service {
        /// The service.
        service: String,
    },
    /// Goals of a ROS 2 action, up to their results.
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
    /// Creates a meter. A request without an answer within `timeout` is lost, and later answers are ignored.
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

    /// Records a frame that entered the network at the port. Samples of its requests carry `mark`.
    pub fn entered(&mut self, at: Duration, frame: &Frame<'_>, mark: u64) {
        match &mut self.0 {
            Followed::Udp(udp) => udp.entered(at, frame, mark),
            Followed::Tcp(tcp) => tcp.passed(at, frame, mark, true),
            Followed::Ros2(ros) => ros.passed(at, frame, mark, true),
        }
    }

    /// Records a frame that was delivered at the port.
    pub fn delivered(&mut self, at: Duration, frame: &Frame<'_>) {
        match &mut self.0 {
            Followed::Udp(udp) => udp.delivered(at, frame),
            Followed::Tcp(tcp) => tcp.passed(at, frame, 0, false),
            Followed::Ros2(ros) => ros.passed(at, frame, 0, false),
        }
    }

    /// Expires requests without an answer in time.
    pub fn expire(&mut self, now: Duration) {
        match &mut self.0 {
            Followed::Udp(udp) => udp.requests.expire(now),
            Followed::Tcp(tcp) => tcp.requests.expire(now),
            Followed::Ros2(ros) => ros.requests.expire(now),
        }
    }

    /// Returns when [`Meter::expire`] is due.
    pub fn deadline(&self) -> Option<Duration> {
        match &self.0 {
            Followed::Udp(udp) => udp.requests.deadline(),
            Followed::Tcp(tcp) => tcp.requests.deadline(),
            Followed::Ros2(ros) => ros.requests.deadline(),
        }
    }

    /// Returns the next sample, in the order of their completion.
    pub fn poll(&mut self) -> Option<Sample> {
        match &mut self.0 {
            Followed::Udp(udp) => udp.requests.poll(),
            Followed::Tcp(tcp) => tcp.requests.poll(),
            Followed::Ros2(ros) => ros.requests.poll(),
        }
    }

    /// Returns the marks of all pending requests, oldest first.
    pub fn pending(&self) -> Vec<u64> {
        match &self.0 {
            Followed::Udp(udp) => udp.requests.marks(),
            Followed::Tcp(tcp) => tcp.requests.marks(),
            Followed::Ros2(ros) => ros.requests.marks(),
        }
    }

    /// Returns the counters.
    pub fn counts(&self) -> Counts {
        match &self.0 {
            Followed::Udp(udp) => udp.requests.counts,
            Followed::Tcp(tcp) => tcp.requests.counts,
            Followed::Ros2(ros) => ros.requests.counts,
        }
    }
}
