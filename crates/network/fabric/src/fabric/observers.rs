//! Shows frames to those who measure round trips: the flows of services, and the readers of followed datagrams.

use cotorra_graph::{Direction, LinkId, LinkTime, LostAt, LostCause, NodeId, Service, Timestamp};

use super::Fabric;
use crate::{
    flows::{Mark, Measuring},
    following::{Datagrams, FollowedReader, Trip},
    frame::Frame,
    port::PortId,
    radio::Path,
    trace::{Crossing, DirectedLink, Trace},
};

impl Fabric {
    /// Measures the flows of these services from now on.
    pub fn measure_flows(&mut self, services: &[Service]) {
        for service in services {
            let Some(flow) = &service.kpis.flow else { continue };
            if let Some(from) = self.port(&flow.from) {
                let observers = self.observers.get_or_insert_default();
                observers.following.follow_all(from);
                observers.flows.add(service, flow, from);
            }
        }
    }

    /// Follows datagrams and their answers from now on. What becomes of them goes to the reader, which replaces the one before.
    pub fn follow(&mut self, datagrams: &[Datagrams], reader: FollowedReader) {
        for Datagrams { from, port, id_at } in datagrams {
            if let Some(from) = self.port(from) {
                let observers = self.observers.get_or_insert_default();
                observers.following.follow_datagrams(from, *port, *id_at);
            }
        }
        if let Some(observers) = &mut self.observers {
            observers.following.read(reader);
        }
    }

    /// Returns remarks on flows for people: flows without any request, and requests that are not measured.
    pub fn flow_remarks(&self) -> Vec<String> {
        self.observers.as_ref().map_or_else(Vec::new, |observers| observers.flows.remarks())
    }

    /// Shows a frame at the port that it enters. Out of line, because most frames are of no interest.
    #[cold]
    pub(super) fn observe_entry(&mut self, now: Timestamp, port: PortId, frame: &mut Frame) {
        let Some(mut observers) = self.observers.take() else { return };
        let server = frame.destination().and_then(|address| self.owner(address));
        let ticket = server.and_then(|to| observers.following.enter(now, [port, to], frame));
        if observers.flows.watch(port) {
            let attached = |robot: &NodeId| self.radio.attached_to(self.port(robot)?);
            let mark = |robot: &NodeId| Mark { server, attachment: attached(robot), ticket };
            observers.flows.entered(now, port, frame, mark);
        }
        self.observers = Some(observers);
    }

    /// Shows a frame at the port where it is delivered.
    #[cold]
    pub(super) fn observe_delivery(
        &mut self,
        now: Timestamp,
        due: Timestamp,
        port: PortId,
        frame: &mut Frame,
    ) {
        let Some(mut observers) = self.observers.take() else { return };
        let name = |port: PortId| self.ports[port.0].node.clone();
        let trip = frame.take_trace().and_then(|trace| {
            if trace.ended.is_some() {
                // Its receiver rejects a damaged frame.
                let at = self.lost_at(&trace);
                observers.following.dropped(&trace, at);
                return None;
            }
            let of = (trace.port, trace.ticket);
            let trip = self.trip(*trace, due, now);
            observers.following.delivered(of, port, frame, &trip, name);
            Some(trip)
        });
        if observers.flows.watch(port) {
            let from = frame.source().and_then(|address| self.owner(address));
            let measuring = Measuring { now, from, back: trip.as_ref() };
            observers.flows.delivered(measuring, port, frame, &mut observers.following, name);
        }
        self.observers = Some(observers);
    }

    /// Shows followed frames that were dropped.
    #[cold]
    pub(super) fn observe_drops(&mut self) {
        self.radio.discard_lost(&mut self.pool);
        let dropped = self.pool.take_dropped();
        let Some(mut observers) = self.observers.take() else { return };
        for trace in dropped {
            let at = self.lost_at(&trace);
            observers.following.dropped(&trace, at);
        }
        self.observers = Some(observers);
    }

    /// Expires requests of flows without an answer in time.
    #[cold]
    pub(super) fn expire_requests(&mut self, now: Timestamp) {
        if let Some(observers) = &mut self.observers {
            observers.flows.expire(now, &mut observers.following, |port| self.ports[port.0].node.clone());
        }
    }

    /// Returns the way of a frame with the names of its links.
    fn trip(&self, trace: Trace, due: Timestamp, delivered: Timestamp) -> Trip {
        let on = |Crossing { link, queueing, retries, crossing }: Crossing| {
            let (link, direction) = self.named(link)?;
            Some(LinkTime { link: link.clone(), direction, back: false, queueing, retries, crossing })
        };
        let links = trace.crossings.into_iter().filter_map(on).collect();
        Trip { entered: trace.entered, due, delivered, links }
    }

    /// Returns where a request was lost or damaged, and why.
    fn lost_at(&self, trace: &Trace) -> LostAt {
        let (link, cause) = trace.ended.unwrap_or((None, LostCause::NoRoute));
        let link = link.and_then(|link| self.named(link)).map(|(link, _)| link.clone());
        LostAt { link, back: false, cause }
    }

    /// Returns the name of a link, and the direction.
    fn named(&self, link: DirectedLink) -> Option<(&LinkId, Direction)> {
        Some(match link {
            DirectedLink::Wire(edge) if edge.is_multiple_of(2) => (&self.links[edge / 2], Direction::Forward),
            DirectedLink::Wire(edge) => (&self.links[edge / 2], Direction::Backward),
            DirectedLink::Air(robot, unit, direction) => {
                (self.radio.counters(Path { robot, unit, direction })?.0, direction)
            }
        })
    }
}
