//! The creator's role for one robot: from its own domain's radio units to another domain's vAP and back. A robot that
//! no domain would serve is halted before it leaves coverage, and its attachment stays unchanged.

use std::time::Duration;

use cotorra_graph::{AccessPoint, Event, FtKey, Instruction, NodeId, RobotContext, Timestamp, Walk};
use cotorra_ledger::{
    Attachment, Call, Ledger, Requirements,
    negotiation::{Creator, CreatorStep},
};

use cotorra_plugin::{coverage::Edge, departure::Trigger};

use crate::{context::DomainContext, steps::Step};

/// Pause between attempts to attach.
const RETRY: Duration = Duration::from_millis(500);

/// A robot of the domain.
#[derive(Debug)]
pub(crate) struct Journey {
    walk: Walk,
    ssid: String,
    mobility_domain: u16,
    stage: Stage,
    attached_to: Option<NodeId>,
    /// Radio unit of its own domain that it was last attached to.
    own: Option<NodeId>,
    /// Time of its halt, if it is halted.
    halted: Option<Timestamp>,
    edge: Option<Edge>,
    /// Whether the robot's brain requested a service that was not announced yet.
    requested: bool,
    known: bool,
}

#[derive(Debug)]
enum Stage {
    /// Served by its own domain.
    Home,
    /// Needs a service, which is about to be announced.
    Wanting(Requirements),
    Negotiating(Box<Creator>),
    /// A vAP is deployed, according to its provider.
    Attaching {
        creator: Box<Creator>,
        attachment: Attachment,
        since: Timestamp,
        next_try: Timestamp,
    },
    /// Served by another domain.
    Away {
        creator: Box<Creator>,
        radio_unit: NodeId,
    },
    /// Returns to its own domain. The service used meanwhile is released then.
    Returning {
        creator: Option<Box<Creator>>,
        to: NodeId,
        next_try: Timestamp,
    },
    /// No domain serves it beyond the edge.
    GivenUp,
}

impl Journey {
    pub(crate) fn new(walk: Walk, ssid: String, mobility_domain: u16) -> Self {
        Self {
            walk,
            ssid,
            mobility_domain,
            stage: Stage::Home,
            attached_to: None,
            own: None,
            halted: None,
            edge: None,
            requested: false,
            known: false,
        }
    }

    pub(crate) fn attached_to(&self) -> Option<&NodeId> {
        self.attached_to.as_ref()
    }

    /// Whether it has reported since the orchestrator was started.
    pub(crate) fn is_known(&self) -> bool {
        self.known
    }

    /// Whether it needs a service that it does not have.
    pub(crate) fn is_lost(&self) -> bool {
        self.known && (matches!(self.stage, Stage::Wanting(_)) || self.is_stranded())
    }

    /// Whether another domain serves it by an unknown service.
    fn is_stranded(&self) -> bool {
        matches!(self.stage, Stage::Home) && self.attached_to.is_some() && self.attached_to != self.own
    }

    /// Returns the requirements to announce for it.
    pub(crate) fn wanted_requirements(&self) -> Option<Requirements> {
        match &self.stage {
            Stage::Wanting(requirements) => Some(requirements.clone()),
            _ => None,
        }
    }

    /// Resumes a service that was announced before the orchestrator was restarted.
    pub(crate) fn resume(&mut self, mut creator: Creator) {
        match self.attached_to.clone().filter(|_| self.is_stranded()) {
            Some(radio_unit) => {
                creator.attached();
                self.stage = Stage::Away { creator: Box::new(creator), radio_unit };
            }
            None => self.begin(creator),
        }
    }

    /// Begins the negotiation of its service.
    pub(crate) fn begin(&mut self, creator: Creator) {
        self.stage = Stage::Negotiating(Box::new(creator));
    }

    pub(crate) fn creator(&mut self) -> Option<&mut Creator> {
        match &mut self.stage {
            Stage::Negotiating(creator) | Stage::Attaching { creator, .. } | Stage::Away { creator, .. } => {
                Some(creator)
            }
            Stage::Returning { creator, .. } => creator.as_deref_mut(),
            Stage::Home | Stage::Wanting(_) | Stage::GivenUp => None,
        }
    }

    pub(crate) fn next_deadline(&self) -> Option<Timestamp> {
        match &self.stage {
            Stage::Negotiating(creator) => creator.next_deadline(),
            Stage::Attaching { creator, next_try, .. } => {
                Some(creator.next_deadline().map_or(*next_try, |at| at.min(*next_try)))
            }
            Stage::Away { creator, .. } => creator.next_deadline(),
            Stage::Returning { next_try, .. } => Some(*next_try),
            Stage::Home | Stage::Wanting(_) | Stage::GivenUp => None,
        }
    }

    /// Handles an event of the domain. `others` are the domain's robots with their radio units.
    pub(crate) fn observe(
        &mut self,
        robot: &NodeId,
        event: &Event,
        others: &[(NodeId, NodeId)],
        domain_context: &mut DomainContext<'_>,
    ) {
        match event {
            Event::Robot(context) if context.robot == *robot => {
                self.note_attachment(context.attached_to(), domain_context);
                self.foresee(context, domain_context);
                self.known = true;
                self.arrived(robot, others, domain_context);
            }
            Event::FederationRequested { robot: requester } if requester == robot => self.requested = true,
            Event::Handover(handover) if handover.robot == *robot => {
                self.note_attachment(Some(&handover.to), domain_context);
                self.arrived(robot, others, domain_context);
            }
            Event::Detached { robot: detached, from } if detached == robot => {
                self.attached_to = None;
                if matches!(&self.stage, Stage::Away { radio_unit, .. } if radio_unit == from) {
                    self.abandoned(robot, domain_context, "the vAP is gone");
                }
            }
            _ => {}
        }
    }

    fn note_attachment(&mut self, radio_unit: Option<&NodeId>, domain_context: &DomainContext<'_>) {
        self.attached_to = radio_unit.cloned();
        if let Some(own) = radio_unit.filter(|unit| domain_context.units.contains_key(*unit)) {
            self.own = Some(own.clone());
        }
    }

    /// Predicts where the walk leaves coverage, and acts before the edge.
    fn foresee(&mut self, context: &RobotContext, domain_context: &mut DomainContext<'_>) {
        let (pose, robot) = (&context.sensors.pose, &context.robot);
        let speed = self.walk.speed_limit.max(context.sensors.velocity.linear);
        let horizon = speed * domain_context.settings.lead.as_secs_f64();
        self.edge = domain_context.coverage.edge(pose, &self.walk, context.waypoint, horizon);
        let is_home = self.attached_to.as_ref().is_none_or(|unit| domain_context.units.contains_key(unit));
        match (&self.stage, &self.edge) {
            (Stage::Home, _) if is_home => {
                if let Some(edge) = self.edge_to_serve(context, domain_context) {
                    self.requested = false;
                    self.stage = Stage::Wanting(self.requirements(&edge, domain_context));
                }
            }
            (Stage::Away { .. }, None) => self.turn_back(pose.position(), domain_context),
            (Stage::Home, None) => self.turn_back(pose.position(), domain_context),
            _ => {}
        }
        let at_edge = self.edge.is_some_and(|edge| edge.within(speed) <= domain_context.settings.stop);
        let is_served = matches!(self.stage, Stage::Away { .. });
        if at_edge && is_home && !is_served && self.halted.is_none() {
            self.halt(robot, domain_context);
        }
    }

    /// Returns the edge around which the robot needs a service now; `None` if it needs none.
    fn edge_to_serve(&self, context: &RobotContext, domain_context: &DomainContext<'_>) -> Option<Edge> {
        match domain_context.settings.trigger {
            Trigger::Coverage => self.edge,
            Trigger::Brain if !self.requested => None,
            Trigger::Brain => {
                let pose = &context.sensors.pose;
                domain_context.coverage.edge(pose, &self.walk, context.waypoint, f64::INFINITY)
            }
        }
    }

    fn requirements(&self, edge: &Edge, domain_context: &DomainContext<'_>) -> Requirements {
        let mm = |metres: f64| (metres * 1e3).round() as i32;
        Requirements {
            vnf: "vAP".to_owned(),
            map: String::new(),
            x_mm: mm(edge.place.x),
            y_mm: mm(edge.place.y),
            radius_mm: mm(domain_context.settings.radius_m).unsigned_abs(),
            ssid: self.ssid.clone(),
            mobility_domain: self.mobility_domain,
            frequency_mhz: 0,
            width_mhz: 20,
            signal_dbm: domain_context.settings.edge.0.round() as i16,
        }
    }

    fn halt(&mut self, robot: &NodeId, domain_context: &mut DomainContext<'_>) {
        self.halted = Some(domain_context.now);
        let halt = Instruction::Halt { robot: robot.clone() };
        domain_context.actions.instruct_because(halt, "it would leave coverage, and nobody serves it there");
        if let Some(creator) = self.creator() {
            let id = creator.id();
            domain_context.note(id, Step::Halted, "");
        }
    }

    fn go(&mut self, robot: &NodeId, domain_context: &mut DomainContext<'_>) {
        if self.halted.take().is_some() {
            domain_context.actions.instruct(Instruction::Go { robot: robot.clone() });
            if let Some(creator) = self.creator() {
                let id = creator.id();
                domain_context.note(id, Step::WentOn, "");
            }
        }
    }

    /// Checks whether it is attached where it should be.
    fn arrived(
        &mut self,
        robot: &NodeId,
        others: &[(NodeId, NodeId)],
        domain_context: &mut DomainContext<'_>,
    ) {
        let Some(at) = self.attached_to.clone() else { return };
        match std::mem::replace(&mut self.stage, Stage::Home) {
            Stage::Attaching { mut creator, attachment, .. } if attachment.radio_unit == at.as_str() => {
                domain_context.note(creator.id(), Step::Attached, format!("to {at}"));
                creator.attached();
                self.stage = Stage::Away { creator, radio_unit: at };
                self.go(robot, domain_context);
                self.release_own(robot, others, domain_context);
            }
            Stage::Returning { creator, to, .. } if to == at => {
                self.go(robot, domain_context);
                if let Some(mut creator) = creator {
                    domain_context.note(creator.id(), Step::Returned, format!("to {at}"));
                    creator.release();
                    domain_context.closing.push(*creator);
                }
            }
            other => self.stage = other,
        }
    }

    /// Turns off the domain's radio unit that is no longer needed: a(R) = {}.
    fn release_own(
        &mut self,
        robot: &NodeId,
        others: &[(NodeId, NodeId)],
        domain_context: &mut DomainContext<'_>,
    ) {
        if !domain_context.settings.release {
            return;
        }
        let Some(last) = self.own.clone() else { return };
        let needed = others.iter().any(|(other, unit)| other != robot && *unit == last);
        let is_on = domain_context.units.get(&last).is_some_and(|unit| unit.on);
        let id = match self.creator() {
            Some(creator) if is_on && !needed => creator.id(),
            _ => return,
        };
        domain_context.actions.instruct(Instruction::Remove { radio_unit: last.clone() });
        domain_context.note(id, Step::OwnRadioUnitReleased, format!("a({last}) = {{}}"));
    }

    /// Returns the robot to its own domain, because the walk stays in that domain's coverage again.
    fn turn_back(&mut self, at: cotorra_graph::Position, domain_context: &mut DomainContext<'_>) {
        let Some((to, _)) = domain_context.coverage.strongest(at) else { return };
        let to = to.clone();
        let creator = match std::mem::replace(&mut self.stage, Stage::Home) {
            Stage::Away { creator, .. } => Some(creator),
            _ => None,
        };
        switch_on(&to, domain_context);
        self.stage = Stage::Returning { creator, to, next_try: domain_context.now };
    }

    /// Handles a lost vAP, or a service ended by its provider. The robot halts, and its own domain serves it again if
    /// it can.
    fn abandoned(&mut self, robot: &NodeId, domain_context: &mut DomainContext<'_>, reason: &str) {
        let (mut creator, radio_unit) = match std::mem::replace(&mut self.stage, Stage::GivenUp) {
            Stage::Away { creator, radio_unit } => (creator, radio_unit),
            other => return self.stage = other,
        };
        domain_context.note(creator.id(), Step::Failed, reason);
        self.halted = Some(domain_context.now);
        let halt = Instruction::Halt { robot: robot.clone() };
        domain_context.actions.instruct_because(halt, format!("`{radio_unit}` serves it no longer"));
        creator.release();
        domain_context.closing.push(*creator);
        let Some(to) = self.own.clone() else { return };
        switch_on(&to, domain_context);
        self.stage = Stage::Returning { creator: None, to, next_try: domain_context.now };
    }

    /// Submits pending calls and handles the steps that were reached. Returns whether there were any.
    pub(crate) fn work(&mut self, ledger: &mut dyn Ledger, domain_context: &mut DomainContext<'_>) -> bool {
        self.attach(domain_context);
        let Some(creator) = self.creator() else { return false };
        let id = creator.id();
        let reached = creator_steps(creator, ledger, domain_context.now);
        let worked = !reached.is_empty();
        for step in reached {
            match step {
                CreatorStep::Announcing => domain_context.note(id, Step::Announced, ""),
                CreatorStep::BidReceived { provider, price, endpoint } => {
                    domain_context.note(
                        id,
                        Step::BidReceived,
                        format!("{price} by {provider} {endpoint}").trim_end(),
                    );
                }
                CreatorStep::BidRejected { provider, reason } => {
                    domain_context.note(id, Step::BidRejected, format!("that by {provider}: {reason}"));
                }
                CreatorStep::Choosing { provider, price } => {
                    domain_context.note(id, Step::WinnerChosen, format!("{provider} for {price}"));
                }
                CreatorStep::Deployed(attachment) => self.deployed(attachment, domain_context),
                CreatorStep::InUse => domain_context.note(id, Step::InUse, ""),
                CreatorStep::Ended(outcome) => {
                    domain_context.note(id, Step::Ended, format!("{outcome:?}"));
                    ledger.submit(domain_context.now, Call::Withdraw { to: ledger.account() });
                    let robot = self.walk.robot.clone();
                    self.abandoned(&robot, domain_context, "its provider ended the service");
                }
                CreatorStep::Failed(failure) => {
                    domain_context.note(id, Step::Failed, failure.to_string());
                    let stage = std::mem::replace(&mut self.stage, Stage::GivenUp);
                    if let Stage::Attaching { attachment, .. } = &stage {
                        self.forget(attachment, domain_context);
                    }
                    if let Stage::Negotiating(creator) | Stage::Attaching { creator, .. } = stage {
                        domain_context.closing.push(*creator);
                    }
                }
                CreatorStep::Announced | CreatorStep::Chosen => {}
            }
        }
        worked
    }

    /// Handles the winner's data for attaching.
    fn deployed(&mut self, attachment: Attachment, domain_context: &mut DomainContext<'_>) {
        // Also from another provider, after one that could not be attached to.
        let (Stage::Negotiating(mut creator) | Stage::Attaching { mut creator, .. }) =
            std::mem::replace(&mut self.stage, Stage::Home)
        else {
            return;
        };
        domain_context.note(creator.id(), Step::ConfirmationReceived, attachment.radio_unit.clone());
        if domain_context.units.keys().any(|own| own.as_str() == attachment.radio_unit) {
            // A lie: the robot may be attached there already.
            creator.unusable();
            self.stage = Stage::Negotiating(creator);
            return;
        }
        let (since, next_try) = (domain_context.now, domain_context.now);
        if let Ok(radio_unit) = attachment.radio_unit.parse() {
            let access_point = AccessPoint {
                ssid: attachment.ssid.clone(),
                mobility_domain: self.mobility_domain,
                key: Some(FtKey(attachment.pmk_r1)),
                core: attachment.core,
            };
            let robot = self.walk.robot.clone();
            domain_context.actions.instruct(Instruction::Provision { robot, radio_unit, access_point });
        }
        self.stage = Stage::Attaching { creator, attachment, since, next_try };
        self.attach(domain_context);
    }

    /// Takes back what the robot was given to attach to a radio unit of another core, which then learns nothing more of it.
    fn forget(&self, attachment: &Attachment, domain_context: &mut DomainContext<'_>) {
        if let (Some(core), Ok(radio_unit)) = (attachment.core, attachment.radio_unit.parse()) {
            let access_point = AccessPoint {
                ssid: attachment.ssid.clone(),
                mobility_domain: self.mobility_domain,
                key: None,
                core: Some(core),
            };
            let robot = self.walk.robot.clone();
            domain_context.actions.instruct(Instruction::Provision { robot, radio_unit, access_point });
        }
    }

    /// Tries to attach to the target. A vAP out of reach may come into reach later: it is given up only once the
    /// robot has to wait for it.
    fn attach(&mut self, domain_context: &mut DomainContext<'_>) {
        let robot = self.walk.robot.clone();
        if let (Stage::Attaching { since, .. }, Some(halted)) = (&self.stage, self.halted)
            && domain_context.now.since(halted.max(*since)) >= domain_context.settings.attach_within
            && let Stage::Attaching { mut creator, attachment, .. } =
                std::mem::replace(&mut self.stage, Stage::Home)
        {
            self.forget(&attachment, domain_context);
            creator.unusable();
            self.stage = Stage::Negotiating(creator);
        }
        let (to, next_try) = match &mut self.stage {
            Stage::Attaching { attachment, next_try, .. } => (attachment.radio_unit.parse().ok(), next_try),
            Stage::Returning { to, next_try, .. } => {
                (domain_context.units.get(to).is_some_and(|unit| unit.on).then(|| to.clone()), next_try)
            }
            _ => return,
        };
        if *next_try > domain_context.now {
            return;
        }
        *next_try = domain_context.now + RETRY;
        if let Some(radio_unit) = to {
            domain_context.actions.instruct(Instruction::Attach { robot, radio_unit });
        }
    }
}

/// Makes one of the domain's own radio units serve its robots.
fn switch_on(radio_unit: &NodeId, domain_context: &mut DomainContext<'_>) {
    let Some(unit) = domain_context.units.get(radio_unit).filter(|unit| !unit.on) else { return };
    let access_point =
        AccessPoint { ssid: unit.ssid.clone(), mobility_domain: unit.mobility_domain, key: None, core: None };
    domain_context.actions.instruct(Instruction::Deploy { radio_unit: radio_unit.clone(), access_point });
}

/// Lets a creator do what is due, and returns the steps that it reached.
pub(crate) fn creator_steps(
    creator: &mut Creator,
    ledger: &mut dyn Ledger,
    now: Timestamp,
) -> Vec<CreatorStep> {
    if creator.next_deadline().is_some_and(|deadline| deadline <= now) {
        creator.expire(now);
    }
    creator.submit(now, ledger);
    std::iter::from_fn(|| creator.poll_step()).collect()
}
