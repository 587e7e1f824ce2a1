//! The brain as the navigation VNF: position packets in, navigation packets out.

use std::{collections::BTreeMap, convert::Infallible, io, net::UdpSocket};

use cotorra_graph::{Event, Instruction, NodeId, PoseSource, RobotContext, SensorData, Testbed, Velocity};
use cotorra_plugin::{
    Actions, Plugin,
    convert::{from_pose, to_twist},
    vnf::{self, Answer},
    wire::{Headway, NavigationPacket, PositionPacket, WireError},
};

use crate::{Brain, departing::Departing};

/// The testbed lets the robot go nowhere, so that it cannot be navigated.
#[derive(Debug, thiserror::Error)]
#[error("robot `{robot}` has no walk in testbed `{testbed}`")]
pub struct NoWalk {
    robot: NodeId,
    testbed: String,
}

impl NoWalk {
    pub(crate) fn new(robot: &NodeId, testbed: &Testbed) -> Self {
        Self { robot: robot.clone(), testbed: testbed.name.clone() }
    }
}

/// Reason why a datagram gets no answer.
#[derive(Debug, thiserror::Error)]
pub enum PacketError {
    /// The datagram is not a position packet.
    #[error(transparent)]
    Malformed(#[from] WireError),
    /// The packet is from another robot than the one that is served.
    #[error("the packet is from `{0}`, but this VNF serves another robot")]
    Stranger(NodeId),
}

/// The navigation VNF of one robot, without its socket.
#[derive(Debug, Clone)]
pub struct NavigationVnf {
    brain: Brain,
    actions: Actions,
    robot: NodeId,
    /// Present if the robot's domain federates at the brain's word.
    departing: Option<Departing>,
    /// Reason of a standstill in the last answer.
    standstill: Option<String>,
}

impl NavigationVnf {
    /// Plans the robot's walk.
    ///
    /// # Errors
    /// [`NoWalk`] if it has none.
    pub fn new(testbed: &Testbed, robot: &NodeId) -> Result<Self, NoWalk> {
        if testbed.walk(robot).is_none() {
            return Err(NoWalk::new(robot, testbed));
        }
        let mut brain = Brain::for_robot(robot.clone());
        brain.start(cotorra_graph::Timestamp::ZERO, testbed, &mut Actions::default());
        Ok(Self::with(testbed, robot.clone(), brain))
    }

    /// The navigation VNF of each robot that has a walk. They share the map's costs, which take longer to make than
    /// any plan; a clone serves as another instance.
    pub fn of_all(testbed: &Testbed) -> BTreeMap<NodeId, Self> {
        let mut brain = Brain::new();
        brain.start(cotorra_graph::Timestamp::ZERO, testbed, &mut Actions::default());
        brain.split().map(|(robot, brain)| (robot.clone(), Self::with(testbed, robot, brain))).collect()
    }

    fn with(testbed: &Testbed, robot: NodeId, brain: Brain) -> Self {
        let departing = Departing::of(testbed, &robot);
        Self { brain, actions: Actions::default(), robot, departing, standstill: None }
    }

    /// Writes the answer to a datagram to `answer`, in place of what it held.
    ///
    /// # Errors
    /// [`PacketError`] if there is none.
    pub fn answer(&mut self, datagram: &[u8], answer: &mut Vec<u8>) -> Result<(), PacketError> {
        let packet = PositionPacket::decode(datagram)?;
        if let Some(goal) = packet.goal {
            let pose = from_pose(&packet.pose, PoseSource::Localization);
            let Some((velocity, headway)) = self.brain.approach(&packet.robot, &pose, goal) else {
                return Err(PacketError::Stranger(packet.robot));
            };
            self.standstill = match &headway {
                Headway::Blocked(reason) => Some(reason.clone()),
                _ => None,
            };
            let walks = NavigationPacket::answering(&packet, packet.waypoint, to_twist(velocity));
            NavigationPacket { headway: Some(headway), ..walks }.encode(answer);
            return Ok(());
        }
        // The robot's time will do for a brain that depends on none.
        let now = packet.emitted;
        self.brain.handle(now, &Event::Robot(context(&packet)), &mut self.actions);
        let Some((Instruction::Move { velocity, waypoint, .. }, reason)) = self.actions.drain().next() else {
            return Err(PacketError::Stranger(packet.robot));
        };
        let needs_federation = self.departing.as_ref().is_some_and(|departing| {
            departing.is_soon(&from_pose(&packet.pose, PoseSource::Localization), waypoint)
        });
        let walks = NavigationPacket::answering(&packet, waypoint, to_twist(velocity));
        NavigationPacket { needs_federation, ..walks }.encode(answer);
        self.standstill = reason;
        Ok(())
    }

    /// Returns why the last answer stopped the robot in the middle of its walk; `None` if it did not.
    pub fn standstill(&self) -> Option<&str> {
        self.standstill.as_deref()
    }
}

/// κ(r) as far as a position packet has it.
fn context(packet: &PositionPacket) -> RobotContext {
    let pose = from_pose(&packet.pose, PoseSource::Localization);
    RobotContext {
        robot: packet.robot.clone(),
        attachments: Vec::new(),
        sensors: SensorData {
            pose,
            odometry: pose,
            velocity: Velocity::default(),
            bumper: false,
            nearest_obstacle_m: None,
        },
        waypoint: packet.waypoint,
        health: Vec::new(),
        speed_limit_mps: None,
        localization_error_m: None,
    }
}

/// Serves a robot on that socket until the process ends, with answers that `send` sends; what a user should know goes to
/// standard error.
///
/// # Errors
/// Errors from which the socket cannot recover.
pub fn serve(
    mut navigation: NavigationVnf,
    socket: &UdpSocket,
    send: impl FnMut(Answer<'_>),
) -> io::Result<Infallible> {
    let mut standstill: Option<String> = None;
    vnf::log(format_args!("navigating `{}`", navigation.robot));
    let answer = |datagram: &[u8], answer: &mut Vec<u8>| {
        let done = navigation.answer(datagram, answer);
        if navigation.standstill() != standstill.as_deref() {
            standstill = navigation.standstill().map(str::to_owned);
            vnf::log(format_args!("{}", standstill.as_deref().unwrap_or("the way is open again")));
        }
        done
    };
    vnf::serve(socket, answer, send)
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Pose, Position, Timestamp};

    use cotorra_plugin::convert::{from_twist, to_pose};

    use super::*;
    use crate::testing::{robot, testbed};

    fn vnf(goal: Position) -> NavigationVnf {
        let testbed =
            testbed(&["..........", "..........", "??????????"], 1.0, vec![Position::new(1.0, 2.0), goal]);
        NavigationVnf::new(&testbed, &robot()).unwrap()
    }

    fn towards(goal: Option<Position>, name: &str, sequence: u32, x: f64) -> Vec<u8> {
        let stamp = Timestamp::from_nanos(5_000 + u64::from(sequence));
        let pose = Pose::planar(x, 2.0, 0.0, [0.0; 9], PoseSource::Simulator);
        let mut bytes = Vec::new();
        PositionPacket {
            sequence,
            emitted: stamp,
            nonce: 5,
            waypoint: 0,
            goal,
            robot: NodeId::new(name).unwrap(),
            pose: to_pose(&pose),
        }
        .encode(&mut bytes);
        bytes
    }

    fn position(name: &str, sequence: u32, x: f64) -> Vec<u8> {
        towards(None, name, sequence, x)
    }

    #[test]
    fn each_position_packet_gets_its_own_answer() {
        let mut vnf = vnf(Position::new(9.0, 2.0));
        let mut answer = Vec::new();
        for sequence in [3, 4, 9] {
            vnf.answer(&position("robot", sequence, 1.0), &mut answer).unwrap();
            let packet = NavigationPacket::decode(&answer).unwrap();
            assert_eq!((packet.sequence, packet.waypoint), (sequence, 1));
            assert_eq!(packet.emitted, Timestamp::from_nanos(5_000 + u64::from(sequence)));
            assert_eq!(packet.nonce, 5);
            assert_eq!(from_twist(&packet.velocity), Velocity::planar(0.3, 0.0));
            assert_eq!(vnf.standstill(), None);
        }
    }

    #[test]
    fn other_datagrams_get_no_answer() {
        let mut vnf = vnf(Position::new(9.0, 2.0));
        let mut answer = Vec::new();
        assert!(matches!(vnf.answer(b"hello", &mut answer), Err(PacketError::Malformed(_))));
        assert!(matches!(vnf.answer(&position("other", 0, 1.0), &mut answer), Err(PacketError::Stranger(_))));
        assert!(vnf.answer(&position("robot", 0, 1.0), &mut answer).is_ok());
    }

    #[test]
    fn unreachable_goals_stop_the_robot_with_a_reason() {
        let mut vnf = vnf(Position::new(9.0, 0.5));
        let mut answer = Vec::new();
        vnf.answer(&position("robot", 0, 1.0), &mut answer).unwrap();
        assert_eq!(vnf.standstill(), Some("(9.0, 0.5) is not on the map's floor"));
        let packet = NavigationPacket::decode(&answer).unwrap();
        assert_eq!(from_twist(&packet.velocity), Velocity::default());
    }

    #[test]
    fn goals_replace_the_walk_per_answer() {
        let mut vnf = vnf(Position::new(9.0, 2.0));
        let mut answer = Vec::new();
        let mut asked = |goal: Option<Position>| {
            vnf.answer(&towards(goal, "robot", 7, 1.0), &mut answer).unwrap();
            let packet = NavigationPacket::decode(&answer).unwrap();
            let standstill = vnf.standstill().map(str::to_owned);
            (from_twist(&packet.velocity), packet.waypoint, packet.headway, standstill)
        };
        let walks = asked(None);
        assert_eq!(walks.clone(), (Velocity::planar(0.3, 0.0), 1, None, None));
        let (velocity, waypoint, headway, _) = asked(Some(Position::new(4.0, 2.0)));
        assert_eq!((velocity, waypoint), (Velocity::planar(0.3, 0.0), 0), "the walk waits");
        assert!(matches!(headway, Some(Headway::Left(left)) if (left - 3.0).abs() < 1e-6), "{headway:?}");
        let there = asked(Some(Position::new(1.1, 2.0)));
        assert_eq!(there, (Velocity::default(), 0, Some(Headway::Arrived), None));
        let reason = "(5.0, 0.5) is not on the map's floor".to_owned();
        let blocked = asked(Some(Position::new(5.0, 0.5)));
        assert_eq!(blocked, (Velocity::default(), 0, Some(Headway::Blocked(reason.clone())), Some(reason)));
        assert_eq!(asked(None), walks);
        let stranger = towards(Some(Position::new(2.0, 2.0)), "other", 8, 5.0);
        assert!(matches!(vnf.answer(&stranger, &mut answer), Err(PacketError::Stranger(_))));
    }

    #[test]
    fn a_robot_without_a_walk_is_an_error() {
        let mut testbed = testbed(&["..."], 1.0, Vec::new());
        testbed.walks.clear();
        let error = NavigationVnf::new(&testbed, &robot()).unwrap_err();
        assert_eq!(error.to_string(), "robot `robot` has no walk in testbed `drawn`");
    }

    #[test]
    fn serves_over_udp_and_ignores_noise() {
        let server = UdpSocket::bind("127.0.0.1:0").unwrap();
        let robot = UdpSocket::bind("127.0.0.1:0").unwrap();
        robot.connect(server.local_addr().unwrap()).unwrap();
        let vnf = vnf(Position::new(9.0, 2.0));
        // Runs until the test's process ends, as it does in a VNF.
        std::thread::spawn(move || serve(vnf, &server, vnf::at_once(&server)));
        let mut received = [0; 256];
        for sequence in 0..3 {
            robot.send(b"noise").unwrap();
            robot.send(&position("robot", sequence, 2.0)).unwrap();
            let length = robot.recv(&mut received).unwrap();
            assert_eq!(NavigationPacket::decode(&received[..length]).unwrap().sequence, sequence);
        }
    }
}
