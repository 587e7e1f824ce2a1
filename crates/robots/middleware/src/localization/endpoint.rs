//! The robot's end of the localization service: decides when a scan is sent, and estimates the pose between answers.

use std::{collections::VecDeque, net::SocketAddrV4, time::Duration};

use cotorra_graph::{NodeId, Pose, RobotModel, Timestamp};
use cotorra_localization::{Belief, Parameters, Pose2};
use cotorra_plugin::wire::{MAX_BEAMS, PosePacket, ScanPacket};

use super::{believed, parameters, planar, to_pose};
use crate::{answer_error::AnswerError, lidar::Scan, request::Recipients};

/// Time without an answer after which the next scan is sent, however little the robot moved.
const PATIENCE: Duration = Duration::from_secs(1);
/// Time after which an answer is rejected as late.
const GIVEN_UP: Duration = Duration::from_secs(3);
/// Longest time that a scan waits until no position packet is under way.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// Standard deviations of a robot's initial pose, metres and radians.
const PUT_DOWN: [f64; 2] = [0.1, 0.05];

/// The robot's end of the localization service, as a state machine.
///
/// A scan is sent when the robot has moved far enough, by its odometry, for the filter to use it. Until the next answer,
/// odometry moves the pose of the last one on, with growing covariance.
#[derive(Debug, Clone)]
pub(crate) struct LocalizationEndpoint {
    robot: NodeId,
    parameters: Parameters,
    /// The last accepted answer, and all later scans without an answer.
    pub(super) trail: VecDeque<Mark>,
    /// Sequence number of the scan whose answer was accepted last.
    since: Option<u32>,
    /// Sequence number of the next scan.
    sequence: u32,
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
    /// The scan; `None` at the start.
    scan: Option<Sent>,
    odometry: Pose2,
    believed: Belief,
}

/// A scan that was sent.
#[derive(Debug, Clone)]
struct Sent {
    sequence: u32,
    emitted: Timestamp,
    recipients: Recipients,
}

impl LocalizationEndpoint {
    /// Creates the endpoint of a robot that starts near this pose.
    pub fn new(robot: NodeId, model: RobotModel, start: &Pose, odometry: &Pose) -> Self {
        let [way, turn] = PUT_DOWN.map(|deviation| deviation * deviation);
        let covariance = [way, 0.0, 0.0, 0.0, way, 0.0, 0.0, 0.0, turn];
        let believed = Belief { pose: planar(start), covariance };
        Self {
            robot,
            parameters: parameters(model),
            trail: VecDeque::from([Mark { scan: None, odometry: planar(odometry), believed }]),
            since: None,
            sequence: 0,
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
        let given_up =
            |mark: &Mark| mark.scan.as_ref().is_some_and(|sent| now.since(sent.emitted) > GIVEN_UP);
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
            sequence: self.sequence,
            emitted: now,
            nonce: 0,
            robot: self.robot.clone(),
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
        let unanswered = match &mark.scan {
            None => true,
            Some(sent) => self.since != Some(sent.sequence) && now.since(sent.emitted) >= PATIENCE,
        };
        self.waiting.is_none() && (far || unanswered)
    }

    /// Returns the time at which the waiting scan is to be sent. `quiet` is whether no position packet is under way.
    pub fn next_deadline(&self, quiet: bool) -> Option<Timestamp> {
        let (since, _) = self.waiting.as_ref()?;
        Some(if quiet { *since } else { *since + LONGEST_WAIT })
    }

    /// Sends the waiting scan to these recipients, if it is due.
    pub fn emit(&mut self, now: Timestamp, quiet: bool, recipients: Recipients) -> Option<ScanPacket> {
        self.next_deadline(quiet).filter(|at| *at <= now)?;
        let (_, packet) = self.waiting.take()?;
        let packet = ScanPacket { emitted: now, nonce: recipients.nonce(), ..packet };
        let [x, y, heading] = packet.odometry;
        self.trail.push_back(Mark {
            scan: Some(Sent { sequence: packet.sequence, emitted: now, recipients }),
            odometry: Pose2::new(x, y, heading),
            believed: believed(&packet.believed),
        });
        self.sequence = self.sequence.wrapping_add(1);
        Some(packet)
    }

    /// Receives an answer.
    ///
    /// # Errors
    /// [`AnswerError`] if the answer is rejected; nothing changes then.
    pub fn receive(
        &mut self,
        now: Timestamp,
        from: SocketAddrV4,
        packet: &PosePacket,
    ) -> Result<(), AnswerError> {
        let is_of = |sent: &&mut Sent| sent.sequence == packet.sequence;
        let mut marks = self.trail.iter_mut().enumerate();
        let found = marks.find_map(|(place, mark)| Some((place, mark.scan.as_mut().filter(is_of)?)));
        let Some((place, sent)) = found else {
            let was_sent = packet.sequence < self.sequence;
            return Err(if was_sent { AnswerError::Late } else { AnswerError::Unknown });
        };
        let by = sent.recipients.find(from, packet.nonce).filter(|_| sent.emitted == packet.emitted);
        let by = by.ok_or(AnswerError::Forged)?;
        if self.since == Some(packet.sequence) {
            return Err(sent.recipients.reject_further(from, packet.nonce));
        }
        if now.since(sent.emitted) > GIVEN_UP {
            return Err(AnswerError::Late);
        }
        if [0, 4, 8].iter().any(|&entry| packet.pose.covariance[entry] < 0.0) {
            return Err(AnswerError::Invalid);
        }
        sent.recipients.accept(by);
        self.since = Some(packet.sequence);
        self.trail.drain(..place);
        let mut last = (self.trail[0].odometry, believed(&packet.pose));
        self.trail[0].believed = last.1;
        // Later scans are re-estimated from this answer.
        for mark in self.trail.iter_mut().skip(1) {
            let step = last.0.step_to(mark.odometry);
            mark.believed = last.1.moved_on(step, &self.parameters.motion);
            last = (mark.odometry, mark.believed);
        }
        Ok(())
    }
}
