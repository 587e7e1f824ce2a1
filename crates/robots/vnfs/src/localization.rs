//! The VNF's end of the localization service: a particle filter for one robot, which answers its scans.
//!
//! Each scan carries the robot's own estimate. An instance that starts on another node, or resumes after another one
//! served, starts from that.

use std::{collections::BTreeMap, fmt, sync::Arc};

use cotorra_graph::{NodeId, OccupancyGrid, Pose, Program, RobotModel, Testbed};
use cotorra_localization::{
    LikelihoodField, LocalizationError, Localizer, Parameters, Pose2, Scan, believed, parameters, to_pose,
};
use cotorra_plugin::wire::{PosePacket, ScanPacket, WireError};

/// The reason for which a robot cannot be localized.
#[derive(Debug, thiserror::Error)]
pub enum NotLocalized {
    /// The testbed has no such robot.
    #[error("there is no robot `{0}`")]
    NoRobot(NodeId),
    /// The testbed has no map.
    #[error("testbed `{0}` has no map")]
    NoMap(String),
    /// The map is not usable.
    #[error("testbed `{testbed}` cannot localize `{robot}`: {reason}")]
    Map {
        /// The testbed.
        testbed: String,
        /// The robot.
        robot: NodeId,
        /// The cause.
        reason: LocalizationError,
    },
}

/// The reason for which a datagram gets no answer.
#[derive(Debug, thiserror::Error)]
pub enum PacketError {
    /// It is not a scan.
    #[error(transparent)]
    Malformed(#[from] WireError),
    /// It is from another robot than the one that is served.
    #[error("the packet is from `{0}`, but this VNF serves another robot")]
    Stranger(NodeId),
    /// A later scan was answered before.
    #[error("scan {0} was overtaken")]
    Overtaken(u32),
    /// It has no usable beam. The robot goes on by odometry.
    #[error("scan {0} has no beam that hit anything in reach")]
    Blind(u32),
    /// The robot's own estimate is not valid.
    #[error(transparent)]
    Nowhere(#[from] LocalizationError),
}

/// The localization VNF of one robot, without its socket. A clone serves as another instance, and shares the map.
#[derive(Clone)]
pub struct LocalizationVnf {
    robot: NodeId,
    field: Arc<LikelihoodField>,
    parameters: Parameters,
    seed: u64,
    served: Option<Served>,
    ranges: Vec<f32>,
}

/// State after the scans so far.
#[derive(Clone)]
struct Served {
    localizer: Localizer,
    /// Sequence number of the last scan.
    sequence: u32,
    answer: Pose,
}

impl fmt::Debug for LocalizationVnf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scan = self.served.as_ref().map(|served| served.sequence);
        f.debug_struct("LocalizationVnf")
            .field("robot", &self.robot)
            .field("scan", &scan)
            .finish_non_exhaustive()
    }
}

impl LocalizationVnf {
    /// Creates the VNF of a robot. Preparing the map takes some milliseconds.
    ///
    /// # Errors
    /// [`NotLocalized`].
    pub fn new(testbed: &Testbed, robot: &NodeId, seed: u64) -> Result<Self, NotLocalized> {
        let found = testbed.graph.robots().find(|(node, _)| node.id == *robot);
        let model =
            found.map(|(_, robot)| robot.model).ok_or_else(|| NotLocalized::NoRobot(robot.clone()))?;
        let map = testbed.map.as_ref().ok_or_else(|| NotLocalized::NoMap(testbed.name.clone()))?;
        Ok(Self::with(robot.clone(), model, prepared(testbed, robot, model, map)?, seed))
    }

    fn with(robot: NodeId, model: RobotModel, field: Arc<LikelihoodField>, seed: u64) -> Self {
        Self { robot, field, parameters: parameters(model), seed, served: None, ranges: Vec::new() }
    }

    /// Creates the localization VNF of each robot that has one; none without a map. They share the prepared map.
    ///
    /// # Errors
    /// [`NotLocalized::Map`].
    pub fn of_all(testbed: &Testbed, seed: u64) -> Result<BTreeMap<NodeId, Self>, NotLocalized> {
        let wanted = |robot: &NodeId| {
            let mut services = testbed.services.iter().filter(|service| service.robot == *robot);
            services.any(|service| service.vnfs.iter().any(|vnf| vnf.program == Program::Localization))
        };
        let mut fields: Vec<(RobotModel, Arc<LikelihoodField>)> = Vec::new();
        let mut all = BTreeMap::new();
        let Some(map) = &testbed.map else { return Ok(all) };
        for (node, robot) in testbed.graph.robots().filter(|(node, _)| wanted(&node.id)) {
            let model = robot.model;
            let known = fields.iter().find(|(of, _)| *of == model).map(|(_, field)| Arc::clone(field));
            let field = match known {
                Some(field) => field,
                None => {
                    let field = prepared(testbed, &node.id, model, map)?;
                    fields.push((model, Arc::clone(&field)));
                    field
                }
            };
            all.insert(node.id.clone(), Self::with(node.id.clone(), model, field, seed));
        }
        Ok(all)
    }

    /// Returns the served robot.
    pub fn robot(&self) -> &NodeId {
        &self.robot
    }

    /// Replaces the content of `answer` by the answer to a datagram.
    ///
    /// # Errors
    /// [`PacketError`] if there is no answer.
    pub fn answer(&mut self, datagram: &[u8], answer: &mut Vec<u8>) -> Result<(), PacketError> {
        let packet = ScanPacket::decode(datagram)?;
        if packet.robot != self.robot {
            return Err(PacketError::Stranger(packet.robot));
        }
        let pose = self.localize(&packet)?;
        let ScanPacket { sequence, emitted, nonce, .. } = packet;
        PosePacket { sequence, emitted, nonce, pose }.encode(answer);
        Ok(())
    }

    fn localize(&mut self, packet: &ScanPacket) -> Result<Pose, PacketError> {
        match &self.served {
            Some(served) if packet.sequence == served.sequence => return Ok(served.answer),
            Some(served) if packet.sequence < served.sequence => {
                return Err(PacketError::Overtaken(packet.sequence));
            }
            _ => {}
        }
        self.ranges.clear();
        self.ranges.extend(packet.in_metres());
        let [x, y, heading] = packet.sweep.map(f64::from);
        let scan = Scan {
            angle_min: packet.first_angle.into(),
            angle_increment: packet.angle_step.into(),
            ranges: &self.ranges,
            mount: Pose2::default(),
            sweep: Pose2::new(x, y, heading),
        };
        if !scan.is_usable(self.parameters.beams.range_max) {
            return Err(PacketError::Blind(packet.sequence));
        }
        // Continue unless another instance has answered since. An own answer that was lost still counts.
        let continues = |served: &Served| packet.since.is_none_or(|since| since <= served.sequence);
        let mut localizer = match self.served.take().filter(continues) {
            Some(served) => served.localizer,
            None => {
                let start = believed(&packet.believed);
                let field = Arc::clone(&self.field);
                Localizer::at(field, self.parameters, self.seed, start.pose, &start.covariance)?
            }
        };
        let [x, y, heading] = packet.odometry;
        let answer = to_pose(&localizer.observe(Pose2::new(x, y, heading), &scan)?.belief());
        self.served = Some(Served { localizer, sequence: packet.sequence, answer });
        Ok(answer)
    }
}

/// Prepares the map for a robot model.
fn prepared(
    testbed: &Testbed,
    robot: &NodeId,
    model: RobotModel,
    map: &OccupancyGrid,
) -> Result<Arc<LikelihoodField>, NotLocalized> {
    let field = LikelihoodField::new(map, &parameters(model));
    let checked = field.check();
    let wrong = |reason| NotLocalized::Map { testbed: testbed.name.clone(), robot: robot.clone(), reason };
    checked.map_err(wrong)?;
    Ok(Arc::new(field))
}
