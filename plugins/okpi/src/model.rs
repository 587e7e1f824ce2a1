//! Input of a placement: the infrastructure as it is now, less the resources that others have taken, and the service.
//! Plain figures, so that any source can fill them in.

use std::time::Duration;

use cotorra_graph::{LinkId, NodeId, VnfId};

/// Nodes and links that a service can use now.
#[derive(Debug, Clone, Default)]
pub struct Infrastructure {
    /// Nodes; links and services name them by their place here.
    pub nodes: Vec<Node>,
    /// Links. Of a robot's wireless ones, the first is preferred where all else is equal.
    pub links: Vec<Link>,
}

/// A node and what is left of it.
#[derive(Debug, Clone)]
pub struct Node {
    /// Its name.
    pub id: NodeId,
    /// CPUs that are free.
    pub cpus: f64,
    /// Bytes of memory that are free.
    pub memory_bytes: u64,
    /// Price of a CPU.
    pub cost: f64,
    /// Probability that it works at any time; above 0.
    pub reliability: f64,
    /// Whether it passes on what is not for it.
    pub forwards: bool,
}

/// A link and what is left of it.
#[derive(Debug, Clone)]
pub struct Link {
    /// Its name.
    pub id: LinkId,
    /// The places of its two ends among the nodes. A wireless one's first is the robot, its second the radio unit.
    pub ends: [usize; 2],
    /// Delay there and back.
    pub round_trip: Duration,
    /// Free rate in the fuller direction, bit/s; infinite where nothing limits it.
    pub free_bps: f64,
    /// Probability that it works at any time; above 0.
    pub reliability: f64,
    /// Whether it joins a robot to a radio unit that covers its location. A robot uses one of them.
    pub wireless: bool,
}

/// A chain of VNFs, in the order in which packets visit them; the answer takes the same way back.
#[derive(Debug, Clone)]
pub struct Service {
    /// Its VNFs.
    pub vnfs: Vec<Vnf>,
    /// D: its delay budget, there and back; above zero.
    pub service_time: Duration,
    /// H: the probability that all that it uses works.
    pub reliability: Option<f64>,
}

/// A VNF and what it needs.
#[derive(Debug, Clone)]
pub struct Vnf {
    /// Its name.
    pub id: VnfId,
    /// CPUs.
    pub cpus: f64,
    /// Bytes of memory.
    pub memory_bytes: u64,
    /// Places of the nodes that can carry it; of equals, the first is taken.
    pub hosts: Vec<usize>,
    /// Rate between it and the VNF before it, bit/s.
    pub rate_bps: f64,
    /// Its processor; `None` if processing takes no time.
    pub processing: Option<Queue>,
}

/// A VNF's processor as an M/M/1 queue with processor sharing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Queue {
    /// μ: packets a second that it can process.
    pub service_rate: f64,
    /// λ: packets a second that arrive.
    pub arrival_rate: f64,
}

impl Queue {
    /// Mean time in it, 1 / (μ - λ) (Kleinrock, Queueing Systems, volume 2, 4.4); `None` where it grows forever.
    pub fn delay(self) -> Option<Duration> {
        let seconds = 1.0 / (self.service_rate - self.arrival_rate);
        (seconds > 0.0).then(|| Duration::try_from_secs_f64(seconds).ok()).flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queues_delay_by_their_spare_capacity() {
        let queue = |service_rate, arrival_rate| Queue { service_rate, arrival_rate }.delay();
        assert_eq!(queue(1000.0, 500.0), Some(Duration::from_millis(2)));
        assert_eq!(queue(1000.0, 0.0), Some(Duration::from_millis(1)));
        assert_eq!(queue(20.0, 20.0), None);
        assert_eq!(queue(20.0, 30.0), None);
    }
}
