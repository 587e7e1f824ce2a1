//! Pinned paths: frames from one host to another can be pinned to any path between them, in that direction alone. All
//! others take the shortest path.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use cotorra_graph::{BitRate, Direction, LinkId, NodeId, Timestamp};

use super::{Fabric, Hop, Port, Reach, edge};
use crate::{error::NoPath, pipe::Pipe, port::PortId, queue::Share, routes::Path, settings::Carries};

/// A path for the frames from one host to another.
#[derive(Debug, Clone, PartialEq)]
pub struct PinnedPath {
    /// The host that sends them.
    pub from: NodeId,
    /// The host that receives them.
    pub to: NodeId,
    /// Its links, in order.
    pub links: Vec<LinkId>,
    /// The rate that its wired links keep for these frames, if they do.
    pub reservation: Option<Reservation>,
}

/// A rate that wired links keep for the frames of a path. Each link shares its rate as Linux's HTB does, with a class for each
/// reservation and one for all other frames. A class has at least its rate when it has frames to send. What it leaves over
/// goes to the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reservation {
    /// The rate of frames without FCS.
    pub rate: BitRate,
    /// Whether its frames have this rate at most. Otherwise they may borrow what others leave over.
    pub is_limited: bool,
}

/// A checked path.
struct Walked {
    hops: Vec<(LinkId, Direction)>,
    wired: Path,
}

impl Fabric {
    /// Returns the directions in which a path from one host to another crosses these links.
    ///
    /// # Errors
    /// [`NoPath`].
    pub fn check_path(
        &self,
        from: &NodeId,
        to: &NodeId,
        links: &[LinkId],
    ) -> Result<Vec<(LinkId, Direction)>, NoPath> {
        self.walk(from, to, links).map(|walked| walked.hops)
    }

    /// Pins frames from one host to another to paths, and replaces all pinned paths with their reservations. A path to or from
    /// a robot holds while the robot is attached to the path's radio unit. Frames in flight stay on their paths.
    ///
    /// # Errors
    /// [`NoPath`] for an impossible path. Nothing has changed then.
    pub fn pin(&mut self, now: Timestamp, paths: &[PinnedPath]) -> Result<(), NoPath> {
        let walk = |path: &PinnedPath| Ok((self.walk(&path.from, &path.to, &path.links)?, path.reservation));
        let walked = paths.iter().map(walk).collect::<Result<Vec<_>, _>>()?;
        let mut shares: BTreeMap<usize, Vec<Share>> = BTreeMap::new();
        for (walked, reservation) in &walked {
            let Some(Reservation { rate, is_limited }) = *reservation else { continue };
            for edge in &walked.wired.edges {
                let share = Share { key: walked.wired.ends, rate, is_limited };
                shares.entry(*edge).or_default().push(share);
            }
        }
        self.pinned =
            walked.into_iter().map(|(walked, _)| (walked.wired.ends, Arc::new(walked.wired))).collect();
        if shares.is_empty() && !self.pipes.iter().any(Pipe::is_shared) {
            return Ok(());
        }
        let now = self.advance(now);
        for (edge, pipe) in self.pipes.iter_mut().enumerate() {
            let shares = shares.get(&edge).map(Vec::as_slice).unwrap_or_default();
            pipe.reserve(now, shares, &mut self.pool);
            self.timers.set(edge, pipe.deadline());
        }
        Ok(())
    }

    /// Returns what one direction of a link can carry now; `None` for an unknown link.
    pub fn carries(&self, link: &LinkId, direction: Direction) -> Option<Carries> {
        match self.link_by_name.get(link) {
            Some(&index) => Some(Carries::of(self.pipes[edge(index, direction)].settings())),
            None => self.radio.carries(link, direction),
        }
    }

    /// Returns the number of packets that wait at the first link of the shortest path from one port to another, or are being
    /// sent on it.
    pub fn waiting(&mut self, from: PortId, to: PortId) -> u64 {
        let Some(&Port { vertex, reach, .. }) = self.ports.get(from.0) else {
            return self.edge_from(from).map_or(0, |edge| self.pipes[edge].waiting());
        };
        if let Reach::Robot { .. } = reach {
            return self.radio.waiting(from, Direction::Forward);
        }
        match self.hop(vertex, to) {
            Some(Hop::Edge(edge)) => self.pipes[edge].waiting(),
            Some(Hop::Air) => self.radio.waiting(to, Direction::Backward),
            Some(Hop::Out | Hop::Border) | None => 0,
        }
    }

    /// Returns the links that a frame between two nodes would cross now; `None` without a path.
    pub fn route(&self, from: &NodeId, to: &NodeId) -> Option<Vec<LinkId>> {
        let (from, to) = (*self.vertices.get(from)?, *self.vertices.get(to)?);
        if from == to {
            return Some(Vec::new());
        }
        let (start, end) = (self.on_wire(from)?, self.on_wire(to)?);
        let ports = self.port_of_vertex[from].zip(self.port_of_vertex[to]);
        let edges = match ports.and_then(|(from, to)| self.pinned(from, to, start)) {
            Some(path) => path.edges.clone(),
            None => self.routes.path(start, end)?,
        };
        let node = |vertex: usize| self.port_of_vertex[vertex].map(|port| &self.ports[port.0].node);
        let air = |robot: usize, unit: usize| {
            (robot != unit).then(|| Some(LinkId::wireless(node(robot)?, node(unit)?))).flatten()
        };
        let wired = edges.into_iter().map(|edge| self.links[edge / 2].clone());
        Some(air(from, start).into_iter().chain(wired).chain(air(to, end)).collect())
    }

    /// Returns the sum of the delays of all wired links that frames between two hosts would cross now, there and back, and
    /// the number of links. `None` without a path, or if one of the links loses every packet.
    pub fn round_trip(&self, a: &NodeId, b: &NodeId) -> Option<(Duration, usize)> {
        let mut all = (Duration::ZERO, 0);
        for (from, to) in [(a, b), (b, a)] {
            let links = self.route(from, to)?;
            for (link, direction) in self.walk(from, to, &links).ok()?.hops {
                if self.carries(&link, direction)?.is_cut {
                    return None;
                }
                let delay = self.effective(&link).map(|both| both[direction as usize].delay);
                all = (all.0.saturating_add(delay.unwrap_or_default()), all.1 + 1);
            }
        }
        Some(all)
    }

    /// Returns the pinned path of a frame that enters the wired network at a vertex.
    pub(super) fn pinned(&self, from: PortId, to: PortId, vertex: usize) -> Option<&Arc<Path>> {
        if self.pinned.is_empty() {
            return None;
        }
        let path = self.pinned.get(&[from, to])?;
        let end = self.on_wire(self.ports[to.0].vertex)?;
        (path.begin == vertex && path.end == end).then_some(path)
    }

    /// Returns a node's vertex on the wired network; for a robot, that of its radio unit.
    fn on_wire(&self, vertex: usize) -> Option<usize> {
        match self.port_of_vertex[vertex] {
            Some(port) if self.ports[port.0].is_robot() => {
                self.radio.attached_to(port).map(|unit| self.ports[unit.0].vertex)
            }
            _ => Some(vertex),
        }
    }

    fn walk(&self, from: &NodeId, to: &NodeId, links: &[LinkId]) -> Result<Walked, NoPath> {
        let host = |node: &NodeId| {
            let found =
                self.vertices.get(node).and_then(|vertex| Some((*vertex, self.port_of_vertex[*vertex]?)));
            found.ok_or_else(|| NoPath::NotAHost(node.clone()))
        };
        let ((start, source), (goal, sink)) = (host(from)?, host(to)?);
        let name = |vertex: usize| {
            let (node, _) =
                self.vertices.iter().find(|(_, at)| **at == vertex).expect("every vertex is a node");
            node.clone()
        };
        let mut visited = vec![start];
        let (mut hops, mut edges) = (Vec::new(), Vec::new());
        // Ends of the wired part: for a robot, its radio unit.
        let (mut begin, mut end) = (start, goal);
        let mut at = start;
        for link in links {
            if at != start && !self.routes.vertex(at).forwards {
                return Err(NoPath::NotForwarding(name(at)));
            }
            let next = if let Some(&index) = self.link_by_name.get(link) {
                let ways = [Direction::Forward, Direction::Backward].map(|way| (edge(index, way), way));
                let leaves = |(edge, _): &(usize, Direction)| self.routes.start(*edge) == at;
                let found = ways.into_iter().find(leaves);
                let (edge, way) = found.ok_or_else(|| NoPath::Apart { link: link.clone(), at: name(at) })?;
                edges.push(edge);
                hops.push((link.clone(), way));
                self.routes.end(edge)
            } else {
                let ends = self.radio.ends_of(link).ok_or_else(|| NoPath::UnknownLink(link.clone()))?;
                let [robot, unit] = ends.map(|port| self.ports[port.0].vertex);
                let (way, next) = match at {
                    at if at == robot => (Direction::Forward, unit),
                    at if at == unit => (Direction::Backward, robot),
                    _ => return Err(NoPath::Apart { link: link.clone(), at: name(at) }),
                };
                match way {
                    Direction::Forward => begin = unit,
                    Direction::Backward => end = unit,
                }
                hops.push((link.clone(), way));
                next
            };
            if visited.contains(&next) {
                return Err(NoPath::Loop(name(next)));
            }
            visited.push(next);
            at = next;
        }
        if at != goal {
            return Err(NoPath::WrongEnd { at: name(at), to: to.clone() });
        }
        Ok(Walked { hops, wired: Path { ends: [source, sink], begin, end, edges } })
    }
}
