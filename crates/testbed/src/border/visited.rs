//! The visited core's part: robots of other cores at the radio units of this one.

use std::collections::{BTreeMap, BTreeSet};

use cotorra_engine::Engine;
use cotorra_graph::{AccessPoint, Event, Instruction, NodeId, Position, Timestamp};
use cotorra_ledger::tunnel::TunnelId;
use cotorra_network_control::{InstructionError, Network, NetworkControl};

use super::{
    LEASE, Places, Tunnels,
    message::{Attached, HomeState, State, VisitedState, reason},
};

/// The robots of other cores.
pub(super) struct Visited {
    visitors: Vec<NodeId>,
    /// Visitors whose radios are to be silent.
    leaving: BTreeSet<NodeId>,
    places: Places,
    tunnels: Tunnels,
    /// By their radio units.
    guests: BTreeMap<NodeId, Guest>,
}

/// A robot of another core that may attach to a radio unit.
struct Guest {
    tunnel: TunnelId,
    access_point: AccessPoint,
    visitor: Option<NodeId>,
    /// Time and number of the last state of its core.
    heard: Option<(Timestamp, u64)>,
    attempt: u32,
    stage: Stage,
    /// Last signal at the visitor, dBm.
    signal_dbm: Option<f64>,
    /// Number of the last state that was told.
    told: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Stage {
    Away,
    Coming,
    Attached { fast: bool },
    Refused(String),
}

impl Visited {
    pub(super) fn new(visitors: Vec<NodeId>, tunnels: Tunnels, places: Places) -> Self {
        let leaving = visitors.iter().cloned().collect();
        Self { visitors, leaving, places, tunnels, guests: BTreeMap::new() }
    }

    /// Admits a robot of another core to a radio unit that was deployed with a key.
    pub(super) fn deployed(&mut self, radio_unit: &NodeId, access_point: &AccessPoint) {
        self.removed(radio_unit);
        let Some(key) = access_point.key.as_ref().filter(|_| !self.visitors.is_empty()) else { return };
        let guest = Guest {
            tunnel: self.tunnels.open_visited(key),
            access_point: access_point.clone(),
            visitor: None,
            heard: None,
            attempt: 0,
            stage: Stage::Away,
            signal_dbm: None,
            told: 0,
        };
        self.guests.insert(radio_unit.clone(), guest);
    }

    /// Ends what [`Self::deployed`] began.
    pub(super) fn removed(&mut self, radio_unit: &NodeId) {
        let Some(mut guest) = self.guests.remove(radio_unit) else { return };
        guest.stage = Stage::Refused("it was taken down".to_owned());
        guest.tell(&self.tunnels);
        self.tunnels.close(guest.tunnel);
        self.leaving.extend(guest.visitor);
    }

    /// Takes an event of the network.
    pub(super) fn observe(&mut self, event: &Event) {
        let (robot, stage) = match event {
            Event::Handover(handover) => (&handover.robot, Stage::Attached { fast: handover.fast }),
            Event::Detached { robot, from } => (robot, Stage::Refused(reason(&format!("it lost `{from}`")))),
            _ => return,
        };
        let Some(guest) = self.guests.values_mut().find(|guest| guest.visitor.as_ref() == Some(robot)) else {
            return;
        };
        if !matches!(stage, Stage::Attached { .. }) {
            self.leaving.insert(robot.clone());
        } else if guest.stage != Stage::Coming {
            return;
        }
        guest.stage = stage;
        guest.tell(&self.tunnels);
    }

    /// Takes what a robot's core wants.
    pub(super) fn hear<N: Network, E: Engine>(
        &mut self,
        now: Timestamp,
        tunnel: TunnelId,
        state: HomeState,
        control: &mut NetworkControl<N, E>,
    ) {
        let Some((radio_unit, guest)) = self.guests.iter_mut().find(|(_, guest)| guest.tunnel == tunnel)
        else {
            return;
        };
        // A core that started again counts from the beginning.
        if guest.heard.is_some_and(|(at, number)| number >= state.number && now.since(at) < LEASE) {
            return;
        }
        guest.heard = Some((now, state.number));
        let radio_unit = radio_unit.clone();
        if guest.visitor.is_none() {
            self.take_in(&radio_unit, control);
        }
        let Some(guest) = self.guests.get_mut(&radio_unit) else { return };
        let Some(visitor) = guest.visitor.clone() else {
            guest.attempt = state.attempt;
            guest.stage = Stage::Refused("no visitor is free".to_owned());
            return guest.tell(&self.tunnels);
        };
        let [x, y, z] = state.position;
        self.places.set(&visitor, Position { x, y, z });
        if state.attempt == 0 {
            if matches!(guest.stage, Stage::Coming | Stage::Attached { .. }) {
                self.leaving.insert(visitor);
            }
            (guest.stage, guest.attempt) = (Stage::Away, 0);
        } else if state.attempt != guest.attempt && matches!(guest.stage, Stage::Away | Stage::Refused(_)) {
            guest.attempt = state.attempt;
            guest.stage = attach(now, (&visitor, &radio_unit), Position { x, y, z }, guest, control);
            self.leaving.remove(&visitor);
        }
        guest.tell(&self.tunnels);
    }

    /// Gives a robot of another core a visitor that is free.
    fn take_in<N: Network, E: Engine>(&mut self, radio_unit: &NodeId, control: &NetworkControl<N, E>) {
        self.silence(control);
        let is_free = |visitor: &&NodeId| {
            let taken = self.guests.values().any(|guest| guest.visitor.as_ref() == Some(*visitor));
            !taken && !self.leaving.contains(*visitor)
        };
        let free = self.visitors.iter().find(is_free).cloned();
        if let (Some(guest), Some(visitor)) = (self.guests.get_mut(radio_unit), free) {
            self.tunnels.carry(guest.tunnel, &visitor);
            (guest.stage, guest.visitor) = (Stage::Away, Some(visitor));
        }
    }

    /// Silences the radios of visitors that are to leave.
    fn silence<N: Network, E: Engine>(&mut self, control: &NetworkControl<N, E>) {
        // A radio that is scanning is silenced later. The mobility domain is known when its robot attaches.
        self.leaving.retain(|visitor| control.depart(visitor, 0, None).is_err());
    }

    /// Tells other cores about their robots. Visitors of cores that are gone leave.
    pub(super) fn tick<N: Network, E: Engine>(&mut self, now: Timestamp, control: &NetworkControl<N, E>) {
        for guest in self.guests.values_mut() {
            let is_gone = guest.heard.is_some_and(|(at, _)| now.since(at) >= LEASE);
            if is_gone && let Some(visitor) = guest.visitor.take() {
                self.tunnels.release(guest.tunnel);
                (guest.stage, guest.attempt) = (Stage::Away, 0);
                self.leaving.insert(visitor);
            }
        }
        self.silence(control);
        let pairs = |(unit, guest): (&NodeId, &Guest)| Some((guest.visitor.clone()?, unit.clone()));
        let Ok(signals) = control.reach(self.guests.iter().filter_map(pairs).collect()) else { return };
        let present = self.guests.values_mut().filter(|guest| guest.visitor.is_some());
        for (guest, signal) in present.zip(signals) {
            guest.signal_dbm = signal.map(|signal| signal.0);
            guest.tell(&self.tunnels);
        }
    }
}

/// Attaches a visitor to a radio unit.
fn attach<N: Network, E: Engine>(
    now: Timestamp,
    (visitor, radio_unit): (&NodeId, &NodeId),
    position: Position,
    guest: &Guest,
    control: &mut NetworkControl<N, E>,
) -> Stage {
    let (robot, radio_unit) = (visitor.clone(), radio_unit.clone());
    let access_point = guest.access_point.clone();
    let mut steps = || {
        control
            .locate(vec![(visitor.clone(), position)])
            .map_err(|gone| InstructionError(gone.to_string()))?;
        // From its radio unit at home, which is in the mobility domain that was asked for.
        control.depart(visitor, access_point.mobility_domain, None)?;
        let provision = Instruction::Provision {
            robot: robot.clone(),
            radio_unit: radio_unit.clone(),
            access_point: access_point.clone(),
        };
        control.instruct(now, &provision)?;
        control.instruct(now, &Instruction::Attach { robot: robot.clone(), radio_unit: radio_unit.clone() })
    };
    match steps() {
        Ok(_) => Stage::Coming,
        Err(error) => Stage::Refused(reason(&error.to_string())),
    }
}

impl Guest {
    fn tell(&mut self, tunnels: &Tunnels) {
        self.told += 1;
        let (attached, refused) = match &self.stage {
            Stage::Away | Stage::Coming => (None, None),
            Stage::Attached { fast } => (Some(Attached { fast: *fast }), None),
            Stage::Refused(reason) => (None, Some(reason.clone())),
        };
        let state = VisitedState {
            number: self.told,
            attempt: self.attempt,
            signal_dbm: self.signal_dbm,
            attached,
            refused,
        };
        tunnels.tell(self.tunnel, State::Visited(state));
    }
}
