//! Requests that a VNF gets, as its robot sends them in virtual time.

use std::sync::Arc;

use cotorra_graph::{Testbed, Timestamp, VnfId};
use cotorra_plugin::wire;

use super::Simulation;
use crate::error::RunError;

/// Requests to a port.
#[derive(Debug)]
pub(super) struct Requests {
    port: u16,
    all: Vec<Vec<u8>>,
    last: Option<Timestamp>,
}

impl Requests {
    /// Keeps a datagram to this port. Of copies for several instances, only one is kept.
    pub(super) fn add(&mut self, now: Timestamp, port: u16, bytes: &[u8]) {
        if port == self.port && self.last != Some(now) {
            self.last = Some(now);
            self.all.push(bytes.to_owned());
        }
    }
}

/// Returns the first requests to a bundled VNF, at most so many. There are fewer if the robot's walk ends before. Plug-ins do
/// not run, and demands take no time.
///
/// # Errors
/// [`RunError`] if the testbed cannot be simulated.
pub fn first_requests(
    mut testbed: Testbed,
    seed: u64,
    vnf: &VnfId,
    most: usize,
) -> Result<Vec<Vec<u8>>, RunError> {
    let Some(port) = wire::port(&testbed, vnf) else { return Ok(Vec::new()) };
    testbed.plugins.clear();
    testbed.services.iter_mut().flat_map(|service| &mut service.vnfs).for_each(|vnf| vnf.computing = None);
    let mut simulation = Simulation::new(Arc::new(testbed), seed)?;
    simulation.requests = Some(Requests { port, all: Vec::new(), last: None });
    loop {
        let so_far = simulation.requests.as_ref().map_or(0, |requests| requests.all.len());
        if so_far >= most || simulation.is_finished() || simulation.is_stuck() {
            break;
        }
        simulation.step();
        while simulation.poll_event().is_some() {}
    }
    let mut all = simulation.requests.take().map(|requests| requests.all).unwrap_or_default();
    all.truncate(most);
    Ok(all)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_plugin::wire::PositionPacket;

    use super::*;

    #[test]
    fn requests_are_those_of_the_walk() {
        let text = "
name: x
wireless: { w: {} }
nodes:
  r: { kind: robot }
  R1: { kind: radio_unit, position: [0, 2], channel: 1 }
  a: { kind: server, tier: edge, cpus: 4, memory: 1 GB }
  b: { kind: server, tier: edge, cpus: 4, memory: 1 GB }
links: [{ ends: [R1, [a, b]] }]
services:
  s:
    robot: r
    kpis: { service_time: 9 ms }
    vnfs:
      driver: { program: robot_driver, pinned_to: r, cpus: 0 }
      brain: { program: navigation, node: [a, b], demand: 40 ms }
walks:
  r: { waypoints: [[0, 0], [1, 0]], position_interval: 50 ms }
";
        let testbed = cotorra_testbed_file::parse("x.yaml", text, Path::new(".")).unwrap();
        let requests = |name: &str, most| {
            let vnf = VnfId::new(name).unwrap();
            let all = first_requests(testbed.clone(), 1, &vnf, most).unwrap();
            all.iter().map(|bytes| PositionPacket::decode(bytes).unwrap()).collect::<Vec<_>>()
        };
        let few = requests("brain", 10);
        let numbers: Vec<_> = few.iter().map(|packet| packet.sequence - few[0].sequence).collect();
        assert_eq!(numbers, (0..10).collect::<Vec<_>>());
        let all = requests("brain", 100_000);
        assert!((50..200).contains(&all.len()), "1 m at 0.3 m/s or so: {}", all.len());
        assert!(all.last().unwrap().pose.position.x > 0.5, "the robot has moved");
        assert_eq!(requests("driver", 10), []);
    }
}
