//! The current state: the last of every embedding. The API and the terminal read it; only events change it.

use std::{collections::BTreeMap, sync::Arc};

use cotorra_graph::{
    Decision, Direction, Event, Instruction, Lateness, LinkContext, LinkId, MachineContext, MapReservation,
    NodeId, Nodes, Placement, RadioContext, RobotContext, SensorId, SensorReading, ServiceId, ServiceTime,
    Stamped, Timestamp, VirtualLinkMapping, Vnf, VnfEvent, VnfId, VnfState,
};
use parking_lot::RwLock;
use serde::Serialize;

/// The last of every embedding.
#[derive(Debug, Clone, Default, Serialize, utoipa::ToSchema)]
pub struct Snapshot {
    /// Time of the last event.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// κ of every robot.
    pub robots: BTreeMap<NodeId, RobotContext>,
    /// ι of every radio unit.
    pub radio_units: BTreeMap<NodeId, RadioContext>,
    /// Time of the last ι.
    #[serde(rename = "radio_units_at_ns")]
    pub radio_units_at: Timestamp,
    /// d, λ and conditions of every link and direction.
    #[serde(skip)]
    pub links: BTreeMap<(LinkId, Direction), LinkContext>,
    /// Times of the last link contexts.
    #[serde(skip)]
    pub links_at: BTreeMap<(LinkId, Direction), Timestamp>,
    /// a(n).
    pub placements: BTreeMap<VnfId, Placement>,
    /// The nodes of the last accepted `place` of every VNF that was placed. a(n) follows once the new instances serve.
    #[serde(skip)]
    pub wanted: BTreeMap<VnfId, Nodes>,
    /// a(n1,n2).
    pub virtual_links: Vec<VirtualLinkMapping>,
    /// The links of mapped paths from one node to another, and the reservations of their own.
    #[serde(skip)]
    pub mapped: BTreeMap<[NodeId; 2], (Vec<LinkId>, Option<MapReservation>)>,
    /// The last event of every VNF's process.
    pub vnfs: BTreeMap<VnfId, VnfEvent>,
    /// The VNFs that were added during the run.
    #[serde(skip)]
    pub added: BTreeMap<VnfId, Vnf>,
    /// The last service time of every service.
    pub service_times: BTreeMap<ServiceId, ServiceTime>,
    /// The last reading of every sensor, and the time of its event.
    #[serde(skip)]
    pub sensors: BTreeMap<(NodeId, SensorId), (Timestamp, SensorReading)>,
    /// The last context of every machine, and the time of its event.
    #[serde(skip)]
    pub machines: BTreeMap<NodeId, (Timestamp, MachineContext)>,
    /// The emulator's lateness.
    pub lateness: Lateness,
    /// Robots at the end of their walk.
    pub finished: Vec<NodeId>,
    /// Plug-ins that were cut off, with the reason.
    pub plugin_faults: Vec<String>,
}

impl Snapshot {
    /// Returns the present nodes of a VNF that was added during the run; `None` for all others.
    pub fn nodes_of_added(&self, vnf: &VnfId) -> Option<Nodes> {
        let added = self.added.get(vnf)?;
        Some(self.placements.get(vnf).map_or(&added.node, |placement| &placement.node).clone())
    }
}

/// A snapshot with many readers and one writer.
#[derive(Debug, Clone, Default)]
pub struct Live(Arc<RwLock<Snapshot>>);

impl Live {
    /// Gives access to the snapshot.
    pub fn read<R>(&self, read: impl FnOnce(&Snapshot) -> R) -> R {
        read(&self.0.read())
    }

    /// Sets the time, if it is later than that of the last event.
    pub(crate) fn reach(&self, at: Timestamp) {
        let mut now = self.0.write();
        now.at = now.at.max(at);
    }

    pub(crate) fn absorb(&self, Stamped { at, event }: &Stamped) {
        let mut now = self.0.write();
        now.at = now.at.max(*at);
        match event.clone() {
            Event::Robot(context) => {
                now.robots.insert(context.robot.clone(), context);
            }
            Event::Radio(context) => {
                now.radio_units_at = *at;
                now.radio_units.insert(context.radio_unit.clone(), context);
            }
            Event::Link(context) => {
                now.links_at.insert((context.link.clone(), context.direction), *at);
                now.links.insert((context.link.clone(), context.direction), context);
            }
            Event::Placement(placement) => {
                now.placements.insert(placement.vnf.clone(), placement);
            }
            Event::VirtualLink(mapping) => {
                now.virtual_links.retain(|m| (&m.from, &m.to) != (&mapping.from, &mapping.to));
                now.virtual_links.push(mapping);
            }
            Event::Vnf(event) => {
                match event.state {
                    VnfState::Started => {
                        // Other placements have events of their own. A vAP has none.
                        let placed = || Placement { vnf: event.vnf.clone(), node: event.node.clone().into() };
                        now.placements.entry(event.vnf.clone()).or_insert_with(placed);
                    }
                    // An instance is stopped after another node's has taken over.
                    VnfState::Stopped
                        if now.placements.get(&event.vnf).and_then(|p| p.node.only())
                            == Some(&event.node) =>
                    {
                        now.placements.remove(&event.vnf);
                    }
                    VnfState::Stopped | VnfState::Died | VnfState::Failed => {}
                }
                // The last instances of a removed VNF stop when it is forgotten already.
                if event.state != VnfState::Stopped || now.vnfs.contains_key(&event.vnf) {
                    now.vnfs.insert(event.vnf.clone(), event);
                }
            }
            Event::ServiceTime(sample) => {
                now.service_times.insert(sample.service.clone(), sample);
            }
            Event::Sensor(reading) => {
                now.sensors.insert((reading.robot.clone(), reading.sensor.clone()), (*at, reading));
            }
            Event::Machine(context) => {
                now.machines.insert(context.node.clone(), (*at, context));
            }
            Event::Decision(Decision { instruction, refused: None, .. }) => match instruction {
                Instruction::AddVnf { vnf } => {
                    now.added.insert(vnf.id.clone(), *vnf);
                }
                Instruction::Place { vnf, node } => {
                    now.wanted.insert(vnf, node);
                }
                Instruction::RemoveVnf { vnf } => {
                    now.added.remove(&vnf);
                    now.wanted.remove(&vnf);
                    now.placements.remove(&vnf);
                    now.vnfs.remove(&vnf);
                }
                Instruction::Map { from, to, links, reservation } => {
                    if links.is_empty() {
                        now.mapped.remove(&[from, to]);
                    } else {
                        now.mapped.insert([from, to], (links, reservation));
                    }
                }
                _ => {}
            },
            Event::Lateness(lateness) => now.lateness = lateness,
            Event::WalkFinished { robot } => now.finished.push(robot),
            Event::PluginFault { plugin, reason } => now.plugin_faults.push(format!("{plugin}: {reason}")),
            _ => {}
        }
    }
}
