//! The border of a core: its robots that are with radio units of other cores, and the robots of other cores that are with
//! its own. The two cores share one key for each robot and radio unit, which the federation sealed for them.
//!
//! **At home**, a robot that was given the key of a radio unit elsewhere hears it from then on: its core sends its position,
//! and the other core answers with the signal. When it attaches, the robot departs from the fabric, and the other core
//! carries its packets.
//!
//! **At the visited core**, a visitor stands for the robot: a robot of its graph, whose radio is subject to all its
//! conditions. It is silent until its robot attaches.
//!
//! Each core sends its state at each κ. A core that hears nothing for the lease counts the other one as gone.

mod message;
mod tunnels;
mod visit;
mod visited;
mod visitor;

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use cotorra_engine::Engine;
use cotorra_graph::{
    AccessPoint, Attachment, Border as Settings, Event, Instruction, NodeId, Position, Testbed, Timestamp,
};
use cotorra_ledger::tunnel::TunnelId;
use cotorra_network_control::{InstructionError, Network, NetworkControl};

use self::{message::State, visit::Visit, visited::Visited};
pub(crate) use self::{tunnels::Tunnels, visitor::Places};

/// Time without a sign of life after which the other core counts as gone.
const LEASE: Duration = Duration::from_secs(2);

/// The border of a core.
pub(crate) struct Border {
    testbed: Arc<Testbed>,
    settings: Settings,
    tunnels: Tunnels,
    /// By robot.
    visits: BTreeMap<NodeId, Visit>,
    visited: Visited,
}

impl Border {
    pub(crate) fn new(testbed: Arc<Testbed>, settings: Settings, tunnels: Tunnels, places: Places) -> Self {
        let visited = Visited::new(settings.visitors.clone(), tunnels.clone(), places);
        Self { testbed, settings, tunnels, visits: BTreeMap::new(), visited }
    }

    /// Carries out an instruction to the network, which may concern radio units of other cores.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    pub(crate) fn instruct<N: Network, E: Engine>(
        &mut self,
        now: Timestamp,
        instruction: &Instruction,
        control: &mut NetworkControl<N, E>,
    ) -> Result<Vec<Event>, InstructionError> {
        match instruction {
            Instruction::Provision { robot, radio_unit, access_point } if self.is_elsewhere(access_point) => {
                return self.provision(now, (robot, radio_unit), access_point, control);
            }
            Instruction::Attach { robot, radio_unit } => {
                let visit = self.visits.get_mut(robot).filter(|visit| visit.radio_unit() == radio_unit);
                if let Some(visit) = visit {
                    return visit
                        .attach(now, &self.settings.node, &self.tunnels, control)
                        .map(|()| Vec::new());
                }
            }
            _ => {}
        }
        let events = control.instruct(now, instruction)?;
        match instruction {
            Instruction::Attach { robot, .. } => {
                self.visits.retain(|of, visit| of != robot || visit.returned(&self.tunnels))
            }
            Instruction::Deploy { radio_unit, access_point } => {
                self.visited.deployed(radio_unit, access_point)
            }
            Instruction::Remove { radio_unit } => self.visited.removed(radio_unit),
            _ => {}
        }
        Ok(events)
    }

    /// Whether an access point is on another core.
    fn is_elsewhere(&self, access_point: &AccessPoint) -> bool {
        access_point.core.is_some_and(|core| core != self.settings.address)
    }

    /// Lets a robot hear a radio unit of another core, with the key of its access point. Without a key, it hears it no more.
    fn provision<N: Network, E: Engine>(
        &mut self,
        now: Timestamp,
        (robot, radio_unit): (&NodeId, &NodeId),
        access_point: &AccessPoint,
        control: &NetworkControl<N, E>,
    ) -> Result<Vec<Event>, InstructionError> {
        let rejected =
            |reason: &str| Err(InstructionError(format!("`{radio_unit}` is on another core: {reason}")));
        if self.testbed.graph.node(radio_unit).is_some() {
            return rejected("this testbed has a node of the same name");
        }
        let is_own = self.testbed.graph.robots().any(|(node, _)| node.id == *robot);
        if !is_own || self.settings.visitors.contains(robot) {
            return rejected(&format!("`{robot}` is no robot of this core"));
        }
        let (Some(core), Some(key)) = (access_point.core, &access_point.key) else {
            let ended = self.visits.extract_if(robot..=robot, |_, visit| visit.radio_unit() == radio_unit);
            return Ok(ended.flat_map(|(_, visit)| visit.end(&self.tunnels, control)).collect());
        };
        if let Some(former) = self.visits.get(robot) {
            if !former.is_hearing() {
                return rejected(&format!("`{robot}` is with `{}` of another core", former.radio_unit()));
            }
            self.tunnels.close(former.tunnel());
        }
        let tunnel = self.tunnels.open_home(key, core);
        let visit = Visit::new(now, (robot, radio_unit), access_point.mobility_domain, tunnel);
        self.visits.insert(robot.clone(), visit);
        Ok(Vec::new())
    }

    /// Adds φ of a robot for radio units of other cores.
    pub(crate) fn complete(&self, now: Timestamp, robot: &NodeId, attachments: &mut Vec<Attachment>) {
        if let Some(visit) = self.visits.get(robot) {
            visit.complete(now, attachments);
        }
    }

    /// Tells other cores where robots are and what is wanted, and what visitors' radios do.
    pub(crate) fn tick<N: Network, E: Engine>(
        &mut self,
        now: Timestamp,
        places: &[(NodeId, Position)],
        control: &mut NetworkControl<N, E>,
    ) -> Vec<Event> {
        let mut events = Vec::new();
        for (robot, at) in places {
            if let Some(visit) = self.visits.get_mut(robot) {
                events.extend(visit.tick(now, *at, &self.tunnels, control));
            }
        }
        self.forget();
        self.visited.tick(now, control);
        events
    }

    /// Takes what another core told.
    pub(crate) fn hear<N: Network, E: Engine>(
        &mut self,
        now: Timestamp,
        tunnel: TunnelId,
        control: &mut NetworkControl<N, E>,
    ) -> Vec<Event> {
        let mut events = Vec::new();
        match self.tunnels.take(tunnel) {
            Some(State::Home(state)) => self.visited.hear(now, tunnel, state, control),
            Some(State::Visited(state)) => {
                let visit = self.visits.values_mut().find(|visit| visit.tunnel() == tunnel);
                if let Some(visit) = visit {
                    events = visit.hear(now, state, &self.tunnels, control);
                }
                self.forget();
            }
            None => {}
        }
        events
    }

    /// Takes an event of the network: visitors attach, and are lost.
    pub(crate) fn observe(&mut self, event: &Event) {
        self.visited.observe(event);
    }

    /// Ends the visits that are over.
    fn forget(&mut self) {
        for (_, over) in self.visits.extract_if(.., |_, visit| visit.is_over()) {
            self.tunnels.close(over.tunnel());
        }
    }
}

/// Carries out an instruction to the network, with a border or without.
///
/// # Errors
/// [`InstructionError`]. Nothing has changed then.
pub(crate) fn instruct<N: Network, E: Engine>(
    border: Option<&mut Border>,
    now: Timestamp,
    instruction: &Instruction,
    control: &mut NetworkControl<N, E>,
) -> Result<Vec<Event>, InstructionError> {
    match (border, instruction) {
        (Some(border), _) => border.instruct(now, instruction, control),
        (
            None,
            Instruction::Provision { radio_unit, access_point: AccessPoint { core: Some(_), .. }, .. },
        ) => {
            let reason = "is on another core, and this testbed has no `border`";
            Err(InstructionError(format!("`{radio_unit}` {reason}")))
        }
        (None, _) => control.instruct(now, instruction),
    }
}
