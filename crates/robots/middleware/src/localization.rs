//! The robot's end of the localization service: decides when a scan is sent, and estimates the pose between answers.

use std::{collections::VecDeque, net::SocketAddrV4, time::Duration};

use cotorra_graph::{NodeId, Pose, RobotModel, ServiceId, ServiceTime, Timestamp};
use cotorra_localization::{Belief, Parameters, Pose2, believed, parameters, planar, to_pose};
use cotorra_plugin::wire::{MAX_BEAMS, PosePacket, ScanPacket};

use crate::{
    answer_error::AnswerError,
    exchange::{Exchange, Reply, Route, Sent},
    lidar::Scan,
    nonce::Nonces,
    request::Request,
};

/// Time without an answer after which the next scan is sent, however little the robot moved.
const PATIENCE: Duration = Duration::from_secs(1);
/// Time after which a scan counts as unanswered, and an answer is rejected as late.
const GIVEN_UP: Duration = Duration::from_secs(3);
/// Longest time that a scan waits until no position packet is under way.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// Standard deviations of a robot's initial pose, metres and radians.
const PUT_DOWN: [f64; 2] = [0.1, 0.05];

/// The robot's end of the localization service, as a state machine.
///
/// A scan is sent when the robot has moved far enough, by its odometry, for the filter to use it. Until the next answer,
/// odometry moves the pose of the last one on, with growing covariance.
///
/// Each scan is measured once, by the first answer of its recipients. An answer that the answer to a later scan overtook
/// is measured, but not used.
#[derive(Debug, Clone)]
pub(crate) struct LocalizationEndpoint {
    exchange: Exchange<()>,
    parameters: Parameters,
    /// The last accepted answer, and all later scans without an answer.
    pub(super) trail: VecDeque<Mark>,
    /// Sequence number of the scan whose answer was accepted last.
    since: Option<u32>,
    /// Time and odometry of the last observation.
    observed: Option<(Timestamp, Pose2)>,
    /// Start of the last observed scan.
    seen: Option<Timestamp>,
    /// The scan to send, and the time since which it waits.
    waiting: Option<(Timestamp, ScanPacket)>,
}

/// The robot's state when a scan was sent.
#[derive(Debug, Clone)]
pub(super) struct Mark {
    /// Sequence number and emission of the scan; `None` at the start.
    scan: Option<(u32, Timestamp)>,
    odometry: Pose2,
    believed: Belief,
}

impl LocalizationEndpoint {
    /// Creates the endpoint of a robot that starts near this pose.
    pub fn new(service: ServiceId, robot: NodeId, model: RobotModel, start: &Pose, odometry: &Pose) -> Self {
        let [way, turn] = PUT_DOWN.map(|deviation| deviation * deviation);
        let covariance = [way, 0.0, 0.0, 0.0, way, 0.0, 0.0, 0.0, turn];
        let believed = Belief { pose: planar(start), covariance };
        Self {
            exchange: Exchange::new(service, robot, GIVEN_UP),
            parameters: parameters(model),
            trail: VecDeque::from([Mark { scan: None, odometry: planar(odometry), believed }]),
            since: None,
            observed: None,
            seen: None,
            waiting: None,
        }
    }

    /// Returns the estimated pose for the present odometry. Height, roll and pitch are those of the odometry.
    pub fn pose(&self, odometry: &Pose) -> Pose {
        let Pose { z, roll, pitch, .. } = *odometry;
        Pose { z, roll, pitch, ..to_pose(&self.belief(planar(odometry))) }
    }

    fn belief(&self, odometry: Pose2) -> Belief {
        let mark = self.trail.back().expect("the trail has a mark, and keeps one");
        mark.believed.moved_on(mark.odometry.step_to(odometry), &self.parameters.motion)
    }

    /// Records the robot's odometry and the last turn of its lidar, and queues that as a scan if one is wanted.
    pub fn observe(&mut self, now: Timestamp, odometry: &Pose, scan: Option<&Scan>) {
        let odometry = planar(odometry);
        let before = self.observed.replace((now, odometry));
        let given_up = |mark: &Mark| mark.scan.is_some_and(|(_, emitted)| now.since(emitted) > GIVEN_UP);
        while self.trail.get(1).is_some_and(given_up) {
            self.trail.pop_front();
        }
        let Some(scan) = scan.filter(|scan| self.seen.replace(scan.at) != Some(scan.at)) else { return };
        // The first scan after a pause may be from before it.
        let Some((at, from)) = before.filter(|_| self.is_wanted(now, odometry)) else { return };
        let rays = scan.ranges.len().saturating_sub(1);
        let swept = scan.ray_interval * u32::try_from(rays).unwrap_or(u32::MAX);
        let share = (swept.as_secs_f64() / now.since(at).as_secs_f64().max(1e-9)).min(1.0);
        let Pose2 { x, y, heading } = from.step_to(odometry);
        let step = scan.ranges.len().div_ceil(MAX_BEAMS).max(1);
        let usable = |range: &f32| if f64::from(*range) < scan.range_max { *range } else { f32::INFINITY };
        let ranges = ScanPacket::in_millimetres(scan.ranges.iter().step_by(step).map(usable)).collect();
        let packet = ScanPacket {
            sequence: 0,
            emitted: now,
            nonce: 0,
            robot: self.exchange.robot().clone(),
            odometry: [odometry.x, odometry.y, odometry.heading],
            sweep: [x, y, heading].map(|part| (share * part) as f32),
            believed: to_pose(&self.belief(odometry)),
            since: self.since,
            first_angle: scan.first_angle as f32,
            angle_step: (scan.angle_step * step as f64) as f32,
            ranges,
        };
        self.waiting = Some((now, packet));
    }

    /// Whether the filter would use a scan from this odometry.
    fn is_wanted(&self, now: Timestamp, odometry: Pose2) -> bool {
        let mark = self.trail.back().expect("the trail has a mark, and keeps one");
        let step = mark.odometry.step_to(odometry);
        let far = step.x.hypot(step.y) >= self.parameters.update_distance
            || step.heading.abs() >= self.parameters.update_angle;
        let unanswered = match mark.scan {
            None => true,
            Some((sequence, emitted)) => self.since != Some(sequence) && now.since(emitted) >= PATIENCE,
        };
        self.waiting.is_none() && (far || unanswered)
    }

    /// Returns the time at which the waiting scan is to be sent, or an unanswered one is given up. `quiet` is whether no
    /// position packet is under way.
    pub fn next_deadline(&self, quiet: bool) -> Option<Timestamp> {
        [self.next_emission(quiet), self.exchange.next_deadline()].into_iter().flatten().min()
    }

    /// Whether the waiting scan is to be sent.
    pub fn is_due(&self, now: Timestamp, quiet: bool) -> bool {
        self.next_emission(quiet).is_some_and(|at| at <= now)
    }

    fn next_emission(&self, quiet: bool) -> Option<Timestamp> {
        let (since, _) = self.waiting.as_ref()?;
        Some(if quiet { *since } else { *since + LONGEST_WAIT })
    }

    /// Sends the waiting scan on this route, if it is due, with a nonce for each server.
    pub fn emit(
        &mut self,
        now: Timestamp,
        quiet: bool,
        route: Route,
        nonces: &mut Nonces,
    ) -> Option<Request<ScanPacket>> {
        if !self.is_due(now, quiet) {
            return None;
        }
        let (_, packet) = self.waiting.take()?;
        let Sent { sequence, nonce, copies } = self.exchange.emit(now, route, (), nonces);
        let packet = ScanPacket { sequence, emitted: now, nonce, ..packet };
        let [x, y, heading] = packet.odometry;
        self.trail.push_back(Mark {
            scan: Some((sequence, now)),
            odometry: Pose2::new(x, y, heading),
            believed: believed(&packet.believed),
        });
        Some(Request { packet, copies })
    }

    /// Receives an answer. Returns the service time.
    ///
    /// # Errors
    /// [`AnswerError`] if the answer is rejected; nothing changes then.
    pub fn receive(
        &mut self,
        now: Timestamp,
        from: SocketAddrV4,
        packet: &PosePacket,
    ) -> Result<ServiceTime, AnswerError> {
        let PosePacket { sequence, emitted, nonce, .. } = *packet;
        let has_variances = [0, 4, 8].iter().all(|&entry| packet.pose.covariance[entry] >= 0.0);
        let reply = Reply { from, sequence, emitted, nonce };
        let (service_time, ()) = self.exchange.receive(now, reply, |()| has_variances)?;
        let is_its = |mark: &Mark| mark.scan.is_some_and(|(of, _)| of == sequence);
        let Some(place) = self.trail.iter().position(is_its) else { return Ok(service_time) };
        self.since = Some(sequence);
        self.trail.drain(..place);
        let mut last = (self.trail[0].odometry, believed(&packet.pose));
        self.trail[0].believed = last.1;
        // Later scans are re-estimated from this answer.
        for mark in self.trail.iter_mut().skip(1) {
            let step = last.0.step_to(mark.odometry);
            mark.believed = last.1.moved_on(step, &self.parameters.motion);
            last = (mark.odometry, mark.believed);
        }
        Ok(service_time)
    }

    /// Gives up the oldest scan without an answer in time; `None` if there is none.
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
