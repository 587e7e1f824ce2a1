//! Robots that follow the actions of models: their observations, and the chunks that answer them.

use std::net::SocketAddrV4;

use cotorra_graph::{Event, NodeId, ServiceId, ServiceTime, Stamped, Testbed, Timestamp};
use cotorra_robot_middleware::{ActionChunks, Observed};

use super::{address, answerers::Answerer};
use crate::{
    followed::PolicyFollowed,
    parcel::{Parcel, Parcels},
};

/// An observation on its way to a model.
pub(crate) struct Observation {
    pub(crate) robot: NodeId,
    pub(crate) to: SocketAddrV4,
    pub(crate) parcel: Parcel,
    pub(crate) bytes: u32,
}

/// A robot's end of a policy.
struct Client {
    service: ServiceId,
    robot: NodeId,
    answerer: Answerer,
    observation_bytes: u32,
    chunks: ActionChunks,
    /// Nodes that the observation under way went to, and the robot's radio unit then.
    sent: (Vec<NodeId>, Option<NodeId>),
}

impl Client {
    fn sample(&self, observed: Observed, server: NodeId, received: Option<Timestamp>) -> ServiceTime {
        ServiceTime {
            service: self.service.clone(),
            robot: self.robot.clone(),
            sequence: observed.sequence,
            emitted: observed.at,
            took: received.map(|received| received.since(observed.at)),
            attachment: self.sent.1.clone(),
            server,
            parts: None,
            lost_at: None,
        }
    }
}

/// Robots' ends of all policies, in the order of their services.
#[derive(Default)]
pub(crate) struct Policies {
    /// By the number of the service in the testbed.
    clients: Vec<(u32, Client)>,
    arriving: Parcels,
    samples: Vec<Stamped>,
}

impl Policies {
    /// Creates the ends of a testbed, whose robots make their first step at `begin`.
    pub(super) fn new(testbed: &Testbed, begin: Timestamp) -> Self {
        let client = |(number, service): (usize, &cotorra_graph::Service)| {
            let policy = service.policy.as_deref()?;
            let server = testbed.vnfs().find(|vnf| vnf.id == policy.server)?.policy_server()?;
            let client = Client {
                service: service.id.clone(),
                robot: service.robot.clone(),
                answerer: Answerer::asking(testbed, &policy.server, service.requests)?,
                observation_bytes: policy.observation_bytes,
                chunks: ActionChunks::new(server.chunk, policy, begin),
                sent: (Vec::new(), None),
            };
            Some((number as u32, client))
        };
        let clients = testbed.services.iter().enumerate().filter_map(client).collect();
        Self { clients, arriving: Parcels::default(), samples: Vec::new() }
    }

    /// Returns the robots and the VNFs that they ask.
    pub(super) fn answerers(&mut self) -> impl Iterator<Item = (&NodeId, &mut Answerer)> {
        self.clients.iter_mut().map(|(_, client)| (&client.robot, &mut client.answerer))
    }

    pub(super) fn deadline(&self) -> Option<Timestamp> {
        self.clients.iter().map(|(_, client)| client.chunks.deadline()).min()
    }

    /// Makes the steps that are due. Returns the observations to send. `asked` are the nodes that a VNF's requests go to, and
    /// `attached` is the radio unit of a robot.
    pub(super) fn advance(
        &mut self,
        now: Timestamp,
        testbed: &Testbed,
        asked: impl Fn(&Answerer) -> Vec<NodeId>,
        attached: impl Fn(&NodeId) -> Option<NodeId>,
    ) -> Vec<Observation> {
        let mut observations = Vec::new();
        for (number, client) in &mut self.clients {
            let observed = client.chunks.advance(now);
            if let Some(lost) = client.chunks.given_up() {
                let server = client.sent.0.first().unwrap_or(&client.robot).clone();
                let sample = client.sample(lost, server, None);
                self.samples.push(Stamped { at: now, event: Event::ServiceTime(sample) });
            }
            let Some(observed) = observed else { continue };
            client.sent = (asked(&client.answerer), attached(&client.robot));
            let parcel = Parcel { client: *number, sequence: observed.sequence };
            let to = client.sent.0.iter().filter_map(|node| address(testbed, node, client.answerer.port));
            let (robot, bytes) = (&client.robot, client.observation_bytes);
            observations.extend(to.map(|to| Observation { robot: robot.clone(), to, parcel, bytes }));
        }
        observations
    }

    /// Takes a datagram that came from a node to a robot.
    pub(super) fn receive(&mut self, now: Timestamp, robot: &NodeId, from: &NodeId, datagram: &[u8]) {
        let Some(Parcel { client, sequence }) = self.arriving.receive(datagram) else { return };
        let its = self.clients.iter_mut().find(|(number, its)| *number == client && its.robot == *robot);
        let Some((_, client)) = its else { return };
        let Some(observed) = client.chunks.receive(sequence) else { return };
        let sample = client.sample(observed, from.clone(), Some(now));
        self.samples.push(Stamped { at: now, event: Event::ServiceTime(sample) });
    }

    /// Takes the samples since the last call.
    pub(super) fn samples(&mut self) -> Vec<Stamped> {
        std::mem::take(&mut self.samples)
    }

    /// Returns what robots followed so far.
    pub(super) fn followed(&self, now: Timestamp) -> Vec<PolicyFollowed> {
        let followed = |(_, client): &(u32, Client)| PolicyFollowed {
            service: client.service.clone(),
            robot: client.robot.clone(),
            followed: client.chunks.followed(now),
        };
        self.clients.iter().map(followed).collect()
    }
}
