//! The robot's end of the navigation service: emits position packets, decides which answers the robot follows, and
//! measures the service time of each.

use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{NodeId, Pose, ServiceId, ServiceTime, Timestamp, Velocity, Walk};
use cotorra_plugin::wire::{NavigationPacket, PositionPacket};

use crate::{middleware::Route, random::Stream};

/// The robot's end of the navigation service, as a state machine.
///
/// A position packet is answered within the robot's command timeout or counts as unanswered. Each is measured once:
/// of duplicates, the first counts. The robot follows an answer only if it is to a newer position packet than any
/// that it followed before, so that a late answer that was overtaken is measured and not followed.
#[derive(Debug, Clone)]
pub struct ServiceEndpoint {
    service: ServiceId,
    robot: NodeId,
    walk_length: u32,
    interval: Duration,
    timeout: Duration,
    next_emission: Timestamp,
    /// Sequence number of the next position packet.
    sequence: u32,
    /// The next waypoint.
    waypoint: u32,
    /// The newest position packet whose answer was followed.
    followed: Option<u32>,
    /// Emitted and neither answered nor given up, oldest first.
    pending: VecDeque<Pending>,
}

#[derive(Debug, Clone)]
struct Pending {
    sequence: u32,
    emitted: Timestamp,
    route: Route,
}

/// What an answer brings.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// What was measured; `None` if that was measured before, or given up.
    pub service_time: Option<ServiceTime>,
    /// How to move on; `None` if the robot does not follow this answer.
    pub velocity: Option<Velocity>,
    /// Whether the walk ended with this answer.
    pub finished: bool,
}

impl ServiceEndpoint {
    /// Position packets do not follow each other faster.
    pub const LEAST_INTERVAL: Duration = Duration::from_millis(1);

    /// An endpoint at the start of the walk. Its first packet comes somewhere in the first interval, by the seed, so
    /// that robots do not emit in step. An interval below [`Self::LEAST_INTERVAL`] counts as that.
    pub fn new(service: ServiceId, walk: &Walk, command_timeout: Duration, seed: u64) -> Self {
        let interval = walk.position_interval.max(Self::LEAST_INTERVAL);
        let phase = Stream::new(seed, &format!("{}/phase", walk.robot)).uniform();
        Self {
            service,
            robot: walk.robot.clone(),
            walk_length: u32::try_from(walk.waypoints.len()).unwrap_or(u32::MAX),
            interval,
            timeout: command_timeout,
            next_emission: Timestamp::ZERO + interval.mul_f64(phase),
            sequence: 0,
            waypoint: 0,
            followed: None,
            pending: VecDeque::new(),
        }
    }

    /// The next waypoint of the walk; its length at its end.
    pub fn waypoint(&self) -> u32 {
        self.waypoint
    }

    /// Whether the walk is at its end. No position packet is emitted from then on.
    pub fn finished(&self) -> bool {
        self.waypoint == self.walk_length
    }

    /// Whether the walk has that waypoint; its length, which says that it is at its end, included.
    pub fn has_waypoint(&self, waypoint: u32) -> bool {
        waypoint <= self.walk_length
    }

    /// The robot was navigated up to that waypoint, if the walk has it. Returns whether the walk ended with this.
    pub fn reach(&mut self, waypoint: u32) -> bool {
        let finished_before = self.finished();
        if self.has_waypoint(waypoint) {
            self.waypoint = waypoint;
        }
        self.finished() && !finished_before
    }

    /// Whether no position packet is under way.
    pub fn is_quiet(&self) -> bool {
        self.pending.is_empty()
    }

    /// When a position packet is due or an unanswered one is given up.
    pub fn next_deadline(&self) -> Option<Timestamp> {
        let emission = (!self.finished()).then_some(self.next_emission);
        let given_up = self.pending.front().map(|p| p.emitted + self.timeout);
        [emission, given_up].into_iter().flatten().min()
    }

    /// Whether a position packet is due.
    pub fn is_due(&self, now: Timestamp) -> bool {
        !self.finished() && self.next_emission <= now
    }

    /// The position packet that is due at `now`, if one is, with the robot's pose then; it takes the route given. One that is due for more than
    /// an interval is not made up for.
    pub fn emit(&mut self, now: Timestamp, pose: &Pose, route: Route) -> Option<PositionPacket> {
        if !self.is_due(now) {
            return None;
        }
        self.skip(now);
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        self.pending.push_back(Pending { sequence, emitted: now, route });
        Some(PositionPacket {
            sequence,
            emitted: now,
            waypoint: self.waypoint,
            robot: self.robot.clone(),
            pose: pose.into(),
        })
    }

    /// Leaves out what is due at `now`.
    pub fn skip(&mut self, now: Timestamp) {
        if !self.is_due(now) {
            return;
        }
        let missed = now.since(self.next_emission).as_nanos() / self.interval.as_nanos();
        let step = self.interval.as_nanos().saturating_mul(missed + 1);
        self.next_emission =
            self.next_emission + Duration::from_nanos(u64::try_from(step).unwrap_or(u64::MAX));
    }

    /// A navigation packet arrived.
    pub fn receive(&mut self, now: Timestamp, packet: &NavigationPacket) -> Answer {
        let ignored = Answer { service_time: None, velocity: None, finished: false };
        let place = self.pending.iter().position(|p| p.sequence == packet.sequence);
        let service_time = match place {
            // Another run's packet, or an invented one.
            Some(place) if self.pending[place].emitted != packet.emitted => return ignored,
            Some(place) if now.since(packet.emitted) < self.timeout => {
                let pending = self.pending.remove(place).expect("`position` found it there");
                Some(self.measured(pending, Some(now.since(packet.emitted))))
            }
            // Given up at the next `expire`, if it is not yet.
            Some(_) => None,
            None if packet.sequence >= self.sequence => return ignored,
            None => None,
        };
        let newest = self.followed.is_none_or(|followed| packet.sequence > followed);
        if !newest || self.finished() || !self.has_waypoint(packet.waypoint) {
            return Answer { service_time, ..ignored };
        }
        self.followed = Some(packet.sequence);
        let finished = self.reach(packet.waypoint);
        Answer { service_time, velocity: Some((&packet.velocity).into()), finished }
    }

    /// Gives up the oldest position packet that was not answered in time; `None` if there is none.
    pub fn expire(&mut self, now: Timestamp) -> Option<ServiceTime> {
        let pending = self.pending.pop_front_if(|p| now.since(p.emitted) >= self.timeout)?;
        Some(self.measured(pending, None))
    }

    fn measured(&self, pending: Pending, took: Option<Duration>) -> ServiceTime {
        ServiceTime {
            service: self.service.clone(),
            robot: self.robot.clone(),
            sequence: pending.sequence,
            emitted: pending.emitted,
            took,
            attachment: pending.route.attachment,
            server: pending.route.server,
        }
    }
}

#[cfg(test)]
mod tests;
