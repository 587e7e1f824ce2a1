//! Checks the constraints of a placement, by other code than that which made it.

use std::time::Duration;

use cotorra_graph::{LinkId, NodeId};
use cotorra_okpi::{Chain, Infrastructure, Placed};

/// Hosts and paths of a placement by index, worked out from its names alone.
#[derive(Debug, Clone)]
pub struct Used {
    pub hosts: Vec<usize>,
    pub paths: Vec<Vec<usize>>,
}

impl Used {
    pub fn service_time(&self, service: &Chain, infrastructure: &Infrastructure) -> Duration {
        let links = self.paths.iter().flatten().map(|&link| infrastructure.links[link].round_trip);
        let processing = service
            .vnfs
            .iter()
            .filter_map(|vnf| vnf.processing)
            .map(|queue| queue.delay().expect("the queue is stable"));
        links.chain(processing).sum()
    }

    pub fn reliability(&self, infrastructure: &Infrastructure) -> f64 {
        let mut links: Vec<_> = self.paths.iter().flatten().copied().collect();
        let mut hosts = self.hosts.clone();
        links.sort_unstable();
        links.dedup();
        hosts.sort_unstable();
        hosts.dedup();
        links.iter().map(|&link| infrastructure.links[link].reliability).product::<f64>()
            * hosts.iter().map(|&host| infrastructure.nodes[host].reliability).product::<f64>()
    }

    pub fn cost(&self, service: &Chain, infrastructure: &Infrastructure) -> f64 {
        service
            .vnfs
            .iter()
            .zip(&self.hosts)
            .map(|(vnf, &host)| vnf.cpus * infrastructure.nodes[host].cost)
            .sum()
    }

    /// Returns the first constraint that the placement violates.
    pub fn violation(&self, service: &Chain, infrastructure: &Infrastructure) -> Option<&'static str> {
        for (i, node) in infrastructure.nodes.iter().enumerate() {
            let here =
                || service.vnfs.iter().zip(&self.hosts).filter(|(_, host)| **host == i).map(|(vnf, _)| vnf);
            if here().map(|vnf| vnf.cpus).sum::<f64>() > node.cpus + 1e-9 {
                return Some("CPUs");
            }
            if here().map(|vnf| vnf.memory_bytes).sum::<u64>() > node.memory_bytes {
                return Some("memory");
            }
        }
        if service.vnfs.iter().zip(&self.hosts).any(|(vnf, host)| !vnf.hosts.contains(host)) {
            return Some("hosts");
        }
        for (i, link) in infrastructure.links.iter().enumerate() {
            let over = self.paths.iter().zip(&service.vnfs[1..]).filter(|(path, _)| path.contains(&i));
            if over.map(|(_, vnf)| vnf.rate_bps).sum::<f64>() > link.free_bps + 1e-3 {
                return Some("bandwidth");
            }
        }
        let mut wireless: Vec<_> = self.paths.iter().flatten().collect();
        wireless.retain(|&&link| infrastructure.links[link].wireless);
        wireless.sort_unstable();
        wireless.dedup();
        if wireless.len() > 1 {
            return Some("one radio unit");
        }
        if self.service_time(service, infrastructure) > service.service_time {
            return Some("service time");
        }
        let reliable =
            service.reliability.is_none_or(|target| self.reliability(infrastructure) >= target - 1e-12);
        (!reliable).then_some("reliability")
    }

    /// Looks up the hosts and links of a placement.
    ///
    /// # Panics
    ///
    /// If its paths do not join its hosts.
    pub fn of(placed: &Placed, infrastructure: &Infrastructure) -> Self {
        let host =
            |id: &NodeId| infrastructure.nodes.iter().position(|node| node.id == *id).expect("it is a node");
        let link =
            |id: &LinkId| infrastructure.links.iter().position(|link| link.id == *id).expect("it is a link");
        let hosts: Vec<_> = placed.placement.iter().map(|placement| host(placement.node.first())).collect();
        let paths: Vec<Vec<_>> = placed.paths.iter().map(|path| path.iter().map(link).collect()).collect();
        assert_eq!(paths.len() + 1, hosts.len());
        for (path, ends) in paths.iter().zip(hosts.windows(2)) {
            let end = path.iter().enumerate().fold(ends[0], |at, (i, &link)| {
                let [a, b] = infrastructure.links[link].ends;
                assert!(at == a || at == b, "the path is broken");
                assert!(i == 0 || infrastructure.nodes[at].forwards, "the path crosses a host");
                if at == a { b } else { a }
            });
            assert_eq!(end, ends[1], "the path leads elsewhere");
        }
        Self { hosts, paths }
    }
}
