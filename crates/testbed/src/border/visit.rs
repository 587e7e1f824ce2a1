//! The home core's part: a robot of this core and a radio unit of another.

use std::mem;

use cotorra_engine::Engine;
use cotorra_graph::{Attachment, Dbm, Event, Handover, NodeId, Position, Timestamp};
use cotorra_ledger::tunnel::TunnelId;
use cotorra_network_control::{InstructionError, Network, NetworkControl};

use super::{
    LEASE, Tunnels,
    message::{HomeState, State, VisitedState},
};

/// A robot of this core that was given the key of a radio unit of another.
pub(super) struct Visit {
    robot: NodeId,
    radio_unit: NodeId,
    mobility_domain: u16,
    tunnel: TunnelId,
    /// Number of the last state that was told.
    told: u64,
    attempt: u32,
    /// Last position that was told.
    position: Position,
    /// The last state of this session.
    heard: Option<(Timestamp, VisitedState)>,
    /// Begin of the session.
    greeted: Timestamp,
    stage: Stage,
}

#[derive(Debug, Clone, PartialEq)]
enum Stage {
    /// It hears the radio unit.
    Hearing,
    /// It left its radio unit of this core to attach there.
    Leaving {
        since: Timestamp,
        from: Option<NodeId>,
    },
    Attached,
    /// It lost the radio unit.
    Over,
}

impl Visit {
    pub(super) fn new(
        now: Timestamp,
        (robot, radio_unit): (&NodeId, &NodeId),
        mobility_domain: u16,
        tunnel: TunnelId,
    ) -> Self {
        Self {
            robot: robot.clone(),
            radio_unit: radio_unit.clone(),
            mobility_domain,
            tunnel,
            told: 0,
            attempt: 0,
            position: Position::default(),
            heard: None,
            greeted: now,
            stage: Stage::Hearing,
        }
    }

    pub(super) fn radio_unit(&self) -> &NodeId {
        &self.radio_unit
    }

    pub(super) fn tunnel(&self) -> TunnelId {
        self.tunnel
    }

    /// Whether the robot is with a radio unit of this core.
    pub(super) fn is_hearing(&self) -> bool {
        self.stage == Stage::Hearing
    }

    pub(super) fn is_over(&self) -> bool {
        self.stage == Stage::Over
    }

    /// Hands the robot over to the radio unit; packets for it leave the wired network at `border`.
    ///
    /// # Errors
    /// [`InstructionError`]. Nothing has changed then.
    pub(super) fn attach<N: Network, E: Engine>(
        &mut self,
        now: Timestamp,
        border: &NodeId,
        tunnels: &Tunnels,
        control: &NetworkControl<N, E>,
    ) -> Result<(), InstructionError> {
        if self.stage != Stage::Hearing {
            return Ok(());
        }
        if self.signal(now).is_none() {
            let reason =
                format!("`{}` of another core is out of the reach of `{}`", self.radio_unit, self.robot);
            return Err(InstructionError(reason));
        }
        let from = control.attached_to(&self.robot).ok().flatten();
        control.depart(&self.robot, self.mobility_domain, Some(border))?;
        self.attempt = self.attempt.wrapping_add(1).max(1);
        self.stage = Stage::Leaving { since: now, from };
        tunnels.carry(self.tunnel, &self.robot);
        // The gap goes on until the other core knows.
        self.tell(tunnels);
        Ok(())
    }

    /// Records that the robot attaches to a radio unit of this core. Returns whether the visit goes on.
    pub(super) fn returned(&mut self, tunnels: &Tunnels) -> bool {
        match mem::replace(&mut self.stage, Stage::Hearing) {
            Stage::Hearing => true,
            Stage::Leaving { .. } => {
                tunnels.release(self.tunnel);
                true
            }
            Stage::Attached | Stage::Over => {
                // Otherwise the other core waits for the lease.
                self.tell(tunnels);
                tunnels.close(self.tunnel);
                false
            }
        }
    }

    /// Ends the visit. A robot that is with the radio unit looks for one of this core.
    pub(super) fn end<N: Network, E: Engine>(
        mut self,
        tunnels: &Tunnels,
        control: &NetworkControl<N, E>,
    ) -> Vec<Event> {
        let events = match self.stage {
            Stage::Leaving { .. } | Stage::Attached => self.lose("its key was taken back", tunnels, control),
            Stage::Hearing | Stage::Over => Vec::new(),
        };
        tunnels.close(self.tunnel);
        events
    }

    /// Adds φ for the radio unit.
    pub(super) fn complete(&self, now: Timestamp, attachments: &mut Vec<Attachment>) {
        if let Stage::Leaving { from: Some(from), .. } = &self.stage {
            // As at any handover, it is attached to the former one until the end.
            let former = attachments.iter_mut().filter(|at| at.radio_unit == *from);
            former.for_each(|former| former.attached = true);
        }
        attachments.push(Attachment {
            radio_unit: self.radio_unit.clone(),
            attached: self.stage == Stage::Attached,
            signal: self.signal(now),
            age: self.signal(now).and(self.heard.as_ref()).map(|(at, _)| now.since(*at)),
        });
    }

    /// Tells the radio unit's core where the robot is, and what is wanted.
    pub(super) fn tick<N: Network, E: Engine>(
        &mut self,
        now: Timestamp,
        position: Position,
        tunnels: &Tunnels,
        control: &NetworkControl<N, E>,
    ) -> Vec<Event> {
        let mut events = Vec::new();
        let is_silent = now.since(self.heard.as_ref().map_or(self.greeted, |(at, _)| *at)) >= LEASE;
        match &self.stage {
            Stage::Attached if is_silent => events = self.lose("its core does not answer", tunnels, control),
            Stage::Leaving { since, .. } if now.since(*since) >= LEASE => {
                events = self.lose("it did not attach in time", tunnels, control);
            }
            _ => {}
        }
        if is_silent {
            // The other core may have started again, without the keys of the session.
            tunnels.renew(self.tunnel);
            (self.heard, self.greeted) = (None, now);
        }
        self.position = position;
        self.tell(tunnels);
        events
    }

    fn tell(&mut self, tunnels: &Tunnels) {
        self.told += 1;
        let is_wanted = matches!(self.stage, Stage::Leaving { .. } | Stage::Attached);
        let attempt = if is_wanted { self.attempt } else { 0 };
        let Position { x, y, z } = self.position;
        tunnels.tell(self.tunnel, State::Home(HomeState { number: self.told, attempt, position: [x, y, z] }));
    }

    /// Returns the last signal, unless it is old.
    fn signal(&self, now: Timestamp) -> Option<Dbm> {
        let (at, state) = self.heard.as_ref()?;
        (now.since(*at) < LEASE).then_some(Dbm(state.signal_dbm?))
    }

    /// Takes a state of the radio unit's core.
    pub(super) fn hear<N: Network, E: Engine>(
        &mut self,
        now: Timestamp,
        state: VisitedState,
        tunnels: &Tunnels,
        control: &NetworkControl<N, E>,
    ) -> Vec<Event> {
        if self.heard.as_ref().is_some_and(|(_, before)| before.number >= state.number) {
            return Vec::new();
        }
        let is_current = state.attempt == self.attempt;
        let (attached, refused) = (state.attached, state.refused.clone());
        self.heard = Some((now, state));
        match (&self.stage, attached, refused) {
            _ if !is_current => Vec::new(),
            (Stage::Leaving { since, from }, Some(attached), _) => {
                let (gap, from) = (now.since(*since), from.clone());
                self.stage = Stage::Attached;
                let (robot, to) = (self.robot.clone(), self.radio_unit.clone());
                vec![Event::Handover(Handover { robot, from, to, fast: attached.fast, gap })]
            }
            (Stage::Leaving { .. } | Stage::Attached, None, Some(reason)) => {
                self.lose(&reason, tunnels, control)
            }
            _ => Vec::new(),
        }
    }

    /// Lets the robot look for a radio unit of this core. A visit ends with the attachment.
    fn lose<N: Network, E: Engine>(
        &mut self,
        reason: &str,
        tunnels: &Tunnels,
        control: &NetworkControl<N, E>,
    ) -> Vec<Event> {
        let Self { robot, radio_unit, .. } = self;
        if let Err(error) = control.come_back(robot) {
            tracing::warn!("{robot} does not come back: {error}");
        }
        tunnels.release(self.tunnel);
        let message = format!("`{robot}` lost `{radio_unit}` of another core: {reason}");
        let notice = Event::Notice { message };
        if self.stage != Stage::Attached {
            self.stage = Stage::Hearing;
            return vec![notice];
        }
        self.stage = Stage::Over;
        vec![Event::Detached { robot: robot.clone(), from: radio_unit.clone() }, notice]
    }
}
