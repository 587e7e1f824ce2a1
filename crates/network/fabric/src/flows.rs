//! Measures the flows of services at their clients' ports.

use std::{collections::VecDeque, time::Duration};

use cotorra_flows::{Counts, Id, Meter, Protocol, Sample};
use cotorra_graph::{
    Event, Flow, FlowId, FlowProtocol, NodeId, Service, ServiceId, ServiceTime, Stamped, Timestamp,
};

use crate::{
    following::{Following, Trip},
    frame::Frame,
    port::PortId,
};

/// Marks the absence of a port. There are fewer hosts.
const NONE: u16 = u16::MAX;
/// Marks the absence of a ticket. No run has so many packets.
const NO_TICKET: u32 = u32::MAX;

/// The server of a request, its robot's radio unit at that time, and the ticket of its first frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mark {
    pub server: Option<PortId>,
    pub attachment: Option<PortId>,
    pub ticket: Option<u32>,
}

impl Mark {
    fn pack(self) -> u64 {
        let packed = |port: Option<PortId>| u64::from(port.map_or(NONE, |PortId(place)| place as u16));
        u64::from(self.ticket.unwrap_or(NO_TICKET)) << 32
            | packed(self.server) << 16
            | packed(self.attachment)
    }

    fn unpack(packed: u64) -> Self {
        let port = |place: u16| (place != NONE).then_some(PortId(place.into()));
        Self {
            server: port((packed >> 16) as u16),
            attachment: port(packed as u16),
            ticket: Some((packed >> 32) as u32).filter(|ticket| *ticket != NO_TICKET),
        }
    }
}

/// A delivery that may answer requests.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Measuring<'a> {
    pub now: Timestamp,
    /// The sending host, if known.
    pub from: Option<PortId>,
    /// The frame's way, if it was followed.
    pub back: Option<&'a Trip>,
}

/// The flow of a service.
#[derive(Debug)]
struct Measured {
    service: ServiceId,
    robot: NodeId,
    from: PortId,
    meter: Meter,
}

/// The flows of all services that have one.
#[derive(Debug, Default)]
pub(crate) struct Flows {
    flows: Vec<Measured>,
    /// Whether a flow is measured, by port.
    watched: Vec<bool>,
    deadline: Option<Timestamp>,
    events: VecDeque<Stamped>,
}

impl Flows {
    /// Starts to measure the flow of a service at a port.
    pub fn add(&mut self, service: &Service, flow: &Flow, from: PortId) {
        let id = |id: Option<FlowId>| id.map(|FlowId { offset, length }| Id { offset, length });
        let protocol = match flow.protocol.clone() {
            FlowProtocol::Udp { port, id: its } => Protocol::Udp { port, id: id(its) },
            FlowProtocol::Tcp { port } => Protocol::Tcp { port },
            FlowProtocol::Http { port, path } => Protocol::Http { port, path },
            FlowProtocol::Ros1 { request, answer, id: its } => {
                Protocol::Ros1 { request, answer, id: id(its) }
            }
            FlowProtocol::Ros1Service { service } => Protocol::Ros1Service { service },
            FlowProtocol::Ros2 { request, answer, id: its } => {
                Protocol::Ros2 { request, answer, id: id(its) }
            }
            FlowProtocol::Ros2Service { service } => Protocol::Ros2Service { service },
            FlowProtocol::Ros2Action { action } => Protocol::Ros2Action { action },
        };
        let meter = Meter::new(protocol, flow.timeout);
        let (service, robot) = (service.id.clone(), service.robot.clone());
        self.flows.push(Measured { service, robot, from, meter });
        let PortId(place) = from;
        self.watched.resize(self.watched.len().max(place + 1), false);
        self.watched[place] = true;
    }

    /// Whether a flow is measured at a port.
    pub fn watch(&self, PortId(place): PortId) -> bool {
        self.watched.get(place).is_some_and(|watched| *watched)
    }

    /// Records a frame that enters the network at a port. `mark` gives the mark for a robot's service.
    pub fn entered(&mut self, now: Timestamp, port: PortId, frame: &Frame, mark: impl Fn(&NodeId) -> Mark) {
        for flow in self.flows.iter_mut().filter(|flow| flow.from == port) {
            flow.meter.entered(since_start(now), &frame.seen(), mark(&flow.robot).pack());
        }
        self.set_deadline();
    }

    /// Records a frame that is delivered at a port.
    pub fn delivered(
        &mut self,
        measuring: Measuring<'_>,
        port: PortId,
        frame: &Frame,
        following: &mut Following,
        name: impl Fn(PortId) -> NodeId,
    ) {
        for flow in self.flows.iter_mut().filter(|flow| flow.from == port) {
            flow.meter.delivered(since_start(measuring.now), &frame.seen());
        }
        self.collect_samples(measuring, following, name);
    }

    /// Expires requests without an answer in time.
    pub fn expire(&mut self, now: Timestamp, following: &mut Following, name: impl Fn(PortId) -> NodeId) {
        if self.deadline.is_some_and(|deadline| deadline <= now) {
            self.flows.iter_mut().for_each(|flow| flow.meter.expire(since_start(now)));
            self.collect_samples(Measuring { now, from: None, back: None }, following, name);
        }
    }

    pub fn deadline(&self) -> Option<Timestamp> {
        self.deadline
    }

    pub fn next_event(&mut self) -> Option<Stamped> {
        self.events.pop_front()
    }

    fn set_deadline(&mut self) {
        let deadlines = self.flows.iter().filter_map(|flow| flow.meter.deadline());
        self.deadline = deadlines.min().map(|deadline| Timestamp::ZERO + deadline);
    }

    /// Turns new samples into events.
    fn collect_samples(
        &mut self,
        measuring: Measuring<'_>,
        following: &mut Following,
        name: impl Fn(PortId) -> NodeId,
    ) {
        let Measuring { now, from, back } = measuring;
        for flow in &mut self.flows {
            while let Some(Sample { sequence, entered, took, mark }) = flow.meter.poll() {
                let Mark { server, attachment, ticket } = Mark::unpack(mark);
                let emitted = Timestamp::ZERO + entered;
                let parts = back.zip(took).and_then(|(back, took)| {
                    let later: Vec<u32> = flow
                        .meter
                        .pending()
                        .into_iter()
                        .filter_map(|mark| Mark::unpack(mark).ticket)
                        .collect();
                    let out = following.completing(flow.from, ticket?, &later, back.entered)?;
                    Some(Box::new(out.split(back.clone(), emitted, took)))
                });
                let lost_at = ticket.filter(|_| took.is_none());
                let lost_at =
                    lost_at.and_then(|ticket| following.unanswered(flow.from, ticket)).map(Box::new);
                // The server of a request to a group is the host that answered.
                let server = server.or(from.filter(|_| took.is_some()));
                let sample = ServiceTime {
                    service: flow.service.clone(),
                    robot: flow.robot.clone(),
                    sequence,
                    emitted,
                    took,
                    attachment: attachment.map(&name),
                    // The request went to no host, or to a group that did not answer.
                    server: name(server.unwrap_or(flow.from)),
                    parts,
                    lost_at,
                };
                self.events.push_back(Stamped { at: now, event: Event::ServiceTime(sample) });
            }
        }
        self.set_deadline();
    }

    /// Returns remarks on flows for people: unseen and unmeasured requests.
    pub fn remarks(&self) -> Vec<String> {
        self.flows.iter().flat_map(|flow| remarks(&flow.service, flow.meter.counts())).collect()
    }
}

fn remarks(service: &ServiceId, counts: Counts) -> Vec<String> {
    let Counts { requests, unclear, forgotten, rejected, given_up } = counts;
    let mut remarks = Vec::new();
    if requests == 0 {
        remarks.push(format!("flow of service `{service}`: no request seen"));
    }
    let mut not_measured = |count: u64, why: &str| {
        if count > 0 {
            remarks.push(format!("flow of service `{service}`: {count} {why}"));
        }
    };
    not_measured(
        unclear,
        "requests are not measured, because several were under way and nothing tells their answers apart: name an \
         `id`, or a shorter `timeout`",
    );
    not_measured(forgotten, "requests are not measured, because too many were under way");
    not_measured(rejected, "requests are not measured, because the server refused them");
    not_measured(
        given_up,
        "connections or writers were not followed to their end: too many, too much out of order, or another protocol",
    );
    remarks
}

fn since_start(at: Timestamp) -> Duration {
    at.since(Timestamp::ZERO)
}
