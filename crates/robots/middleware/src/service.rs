//! The robot's end of the navigation service: emits position packets, decides which answers the robot follows, and measures
//! service times.

use std::{net::SocketAddrV4, time::Duration};

use cotorra_graph::{
    GoalEvent, GoalState, Pose, Position, RobotClock, ServiceId, ServiceTime, Timestamp, Velocity, Walk,
};
use cotorra_plugin::{
    convert::{from_twist, to_pose},
    wire::{NavigationPacket, PositionPacket},
};

use crate::{
    answer_error::AnswerError,
    beat::Beat,
    exchange::{Exchange, Reply, Route, Sent},
    goal::Goal,
    nonce::Nonces,
    request::Request,
};

/// The robot's end of the navigation service, as a state machine.
///
/// An answer must come within the robot's command timeout, from a recipient of the position packet and with its nonce. Else
/// the packet counts as unanswered, and the answer is rejected ([`AnswerError`]). Each packet is measured once, by the
/// first answer of its recipients.
///
/// The robot follows an answer only to a newer packet than all that it followed before. Answers that were overtaken, or
/// that belong to packets from before a change of goal, are measured but not followed.
#[derive(Debug, Clone)]
pub(crate) struct ServiceEndpoint {
    exchange: Exchange<Purpose>,
    walk_length: u32,
    beat: Beat,
    /// Whether the packet before was emitted, so that those that were due since then are missing.
    continues: bool,
    /// Index of the next waypoint.
    waypoint: u32,
    /// Replaces the walk while it is there.
    goal: Option<Goal>,
    /// Number of goal changes so far.
    goal_changes: u32,
    /// Sequence number of the newest packet whose answer was followed.
    followed: Option<u32>,
}

/// Purpose of a position packet.
#[derive(Debug, Clone, Copy)]
struct Purpose {
    /// Number of goal changes at the emission.
    goal_changes: u32,
    has_goal: bool,
}

/// Result of an answer.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Answer {
    /// Measured service time.
    pub service_time: ServiceTime,
    /// Velocity to follow; `None` if the robot does not follow this answer.
    pub velocity: Option<Velocity>,
    /// Whether the walk ended with this answer.
    pub finished: bool,
    /// Event of the robot's goal.
    pub goal: Option<GoalEvent>,
    /// Whether the brain requests a federation; `None` if the robot does not follow this answer on its walk.
    pub needs_federation: Option<bool>,
}

impl ServiceEndpoint {
    /// Most position packets at once that count as missed.
    pub const MOST_MISSED: usize = 10_000;

    /// Creates an endpoint at the start of the walk, or on its way. The clock's phase and drift are of the seed, so that
    /// robots do not emit in step. Intervals below [`Beat::LEAST_GAP`] count as that.
    pub fn new(
        service: ServiceId,
        walk: &Walk,
        command_timeout: Duration,
        clock: &RobotClock,
        seed: u64,
    ) -> Self {
        let beat = match walk.random_intervals {
            Some(intervals) => Beat::random(intervals, seed, &format!("{}/arrivals", walk.robot)),
            None => Beat::equal(clock, walk.position_interval, seed, &format!("{}/phase", walk.robot)),
        };
        Self {
            exchange: Exchange::new(service, walk.robot.clone(), command_timeout),
            walk_length: u32::try_from(walk.waypoints.len()).unwrap_or(u32::MAX),
            beat,
            continues: false,
            waypoint: walk.next.unwrap_or(0),
            goal: None,
            goal_changes: 0,
            followed: None,
        }
    }

    /// Returns the index of the walk's next waypoint; the number of waypoints at its end.
    pub fn waypoint(&self) -> u32 {
        self.waypoint
    }

    /// Whether the walk is at its end.
    pub fn finished(&self) -> bool {
        self.waypoint == self.walk_length
    }

    /// Whether the walk is at its end and there is no goal, so that no position packets are emitted.
    pub fn is_idle(&self) -> bool {
        self.finished() && self.goal.is_none()
    }

    /// Whether a goal has ended, where the robot waits.
    pub fn is_at_goal(&self) -> bool {
        self.goal.as_ref().is_some_and(Goal::has_ended)
    }

    /// Sets a goal in place of the walk, or cancels it. Returns the events of the goal before and of the new one.
    pub fn set_goal(
        &mut self,
        now: Timestamp,
        goal: Option<Position>,
    ) -> impl Iterator<Item = GoalEvent> + use<> {
        let ends = if goal.is_some() { GoalState::Replaced } else { GoalState::Canceled };
        let before = self.goal.take().filter(|goal| !goal.has_ended());
        self.goal = goal.map(|position| Goal::new(now, position));
        self.goal_changes = self.goal_changes.wrapping_add(1);
        self.continues &= !self.is_idle();
        let before = before.map(|goal| goal.event(self.exchange.robot(), ends));
        let set = self.goal.as_ref().map(|goal| goal.event(self.exchange.robot(), GoalState::Set));
        before.into_iter().chain(set)
    }

    /// Whether the walk has this waypoint. The number of waypoints, which means its end, is valid, too.
    pub fn has_waypoint(&self, waypoint: u32) -> bool {
        waypoint <= self.walk_length
    }

    /// Sets the next waypoint, if the walk has it. Returns whether the walk ended with this.
    pub fn reach(&mut self, waypoint: u32) -> bool {
        let finished_before = self.finished();
        if self.has_waypoint(waypoint) {
            self.waypoint = waypoint;
        }
        self.continues &= !self.is_idle();
        self.finished() && !finished_before
    }

    /// Whether no position packet is under way.
    pub fn is_quiet(&self) -> bool {
        self.exchange.is_quiet()
    }

    /// Returns the time at which a position packet is due or an unanswered one is given up.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        let emission = (!self.is_idle()).then_some(self.beat.next());
        [emission, self.exchange.next_deadline()].into_iter().flatten().min()
    }

    /// Whether a position packet is due.
    pub fn is_due(&self, now: Timestamp) -> bool {
        !self.is_idle() && self.beat.next() <= now
    }

    /// Returns the service times of the position packets that were due before the one that is due at `now`, because nobody
    /// asked for them in time. They are without an answer, and those above [`Self::MOST_MISSED`] are left out; their number is
    /// returned, too. Packets of a robot that was idle or had a fault were not due.
    pub fn miss(&mut self, now: Timestamp, route: &Route) -> (Vec<ServiceTime>, u64) {
        if !self.continues || !self.is_due(now) {
            return (Vec::new(), 0);
        }
        let (mut missed, mut left_out) = (Vec::new(), 0);
        self.beat.catch_up(now, |due| match missed.len() {
            Self::MOST_MISSED => left_out += 1,
            _ => missed.push(due),
        });
        (missed.into_iter().map(|due| self.exchange.miss(due, route)).collect(), left_out)
    }

    /// Emits the position packet that is due at `now`, if any, on this route, with a nonce for each server. Packets that were
    /// due before are skipped: ask [`Self::miss`] for them first.
    pub fn emit(
        &mut self,
        now: Timestamp,
        pose: &Pose,
        route: Route,
        nonces: &mut Nonces,
    ) -> Option<Request<PositionPacket>> {
        if !self.is_due(now) {
            return None;
        }
        self.skip(now);
        self.continues = true;
        let position = self.goal.as_ref().map(Goal::position);
        let purpose = Purpose { goal_changes: self.goal_changes, has_goal: position.is_some() };
        let Sent { sequence, nonce, copies } = self.exchange.emit(now, route, purpose, nonces);
        let packet = PositionPacket {
            sequence,
            emitted: now,
            nonce,
            waypoint: self.waypoint,
            goal: position,
            robot: self.exchange.robot().clone(),
            pose: to_pose(pose),
        };
        Some(Request { packet, copies })
    }

    /// Skips the position packet that is due at `now`.
    pub fn skip(&mut self, now: Timestamp) {
        if !self.is_due(now) {
            return;
        }
        self.beat.catch_up(now, |_| ());
        self.beat.step();
        self.continues = false;
    }

    /// Receives a navigation packet.
    ///
    /// # Errors
    /// [`AnswerError`] if the answer is rejected; nothing changes then.
    pub fn receive(
        &mut self,
        now: Timestamp,
        from: SocketAddrV4,
        packet: &NavigationPacket,
    ) -> Result<Answer, AnswerError> {
        let NavigationPacket { sequence, emitted, nonce, .. } = *packet;
        let is_valid = |purpose: &Purpose| packet.headway.is_some() == purpose.has_goal;
        let reply = Reply { from, sequence, emitted, nonce };
        let (service_time, purpose) = self.exchange.receive(now, reply, is_valid)?;
        let of_this_goal = purpose.goal_changes == self.goal_changes;
        let mut answer =
            Answer { service_time, velocity: None, finished: false, goal: None, needs_federation: None };
        let newest = self.followed.is_none_or(|followed| packet.sequence > followed);
        if !newest || !of_this_goal {
            return Ok(answer);
        }
        if let (Some(goal), Some(headway)) = (&mut self.goal, &packet.headway) {
            answer.goal = goal.update(now, self.exchange.robot(), headway);
            if goal.has_ended() {
                return Ok(answer);
            }
        } else if self.finished() || !self.has_waypoint(packet.waypoint) {
            return Ok(answer);
        } else {
            answer.finished = self.reach(packet.waypoint);
            answer.needs_federation = Some(packet.needs_federation);
        }
        self.followed = Some(packet.sequence);
        answer.velocity = Some(from_twist(&packet.velocity));
        Ok(answer)
    }

    /// Gives up the oldest position packet without an answer in time; `None` if there is none.
    pub fn expire(&mut self, now: Timestamp) -> Option<ServiceTime> {
        self.exchange.expire(now)
    }

    /// Returns the nonce of a packet that was given up.
    pub fn nonce_of(&self, given_up: &ServiceTime) -> Option<u64> {
        self.exchange.nonce_of(given_up.sequence)
    }
}

#[cfg(test)]
mod tests;
