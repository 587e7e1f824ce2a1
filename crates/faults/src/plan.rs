//! Random faults at random times, from the same seed as the testbed.

use std::{fmt, time::Duration};

use cotorra_graph::{
    AccessPoint, ConditionChange, Direction, Image, Instruction, LinkId, Loss, NodeId, NodeKind, Nodes,
    PluginId, Position, Probability, Program, Rate, Rights, Testbed, ThroughputTest, Timestamp, Velocity,
    Vnf, VnfId,
};

use super::{draw::Draw, invariants::SABOTEUR};

/// A fault, or its end.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "most faults are instructions")]
pub(crate) enum Fault {
    /// An instruction, which may be rejected. Links are also cut and repaired by instructions.
    Instruct { kind: &'static str, instruction: Instruction },
    /// All instances of a VNF die.
    Kill(VnfId),
    /// All its instances stop answering.
    Hang(VnfId),
    /// All its instances answer after this delay.
    Slow(VnfId, Duration),
    /// All its instances answer at once again.
    Recover(VnfId),
    /// Instances that are started do not become ready.
    HoldStarts,
    /// Started instances become ready again.
    ReleaseStarts,
    /// A robot neither sends nor receives.
    Silence(NodeId),
    /// A robot sends and receives again.
    Hear(NodeId),
    /// A robot receives its last answer once more.
    Replay(NodeId),
    /// A robot receives its last answer once more, with this byte changed.
    Forge(NodeId, usize),
    /// The history's disk is full.
    FillDisk,
    /// The disk has room again.
    FreeDisk,
    /// The ledger's last blocks with calls are reorganised away, this many.
    Reorganise(usize),
    /// A plug-in misbehaves.
    Sabotage(Saboteur),
}

/// A plug-in that moves a robot, and then misbehaves.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Saboteur {
    pub(crate) id: PluginId,
    pub(crate) robot: NodeId,
    pub(crate) how: Sabotage,
}

/// Misbehaviour of a plug-in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sabotage {
    Panic,
    /// It does not return from a call.
    Hang,
    /// It gives far too many instructions at once, i.e. a flood.
    Flood,
}

impl Fault {
    /// Returns its name in the summary.
    pub(crate) const fn kind(&self) -> &'static str {
        match self {
            Self::Instruct { kind, .. } => kind,
            Self::Kill(_) => "VNF killed",
            Self::Hang(_) => "VNF hung",
            Self::Slow(..) => "VNF slowed",
            Self::Recover(_) => "VNF recovered",
            Self::HoldStarts => "starts held",
            Self::ReleaseStarts => "starts released",
            Self::Silence(_) => "robot silent",
            Self::Hear(_) => "robot heard again",
            Self::Replay(_) => "answer repeated",
            Self::Forge(..) => "answer forged",
            Self::FillDisk => "disk full",
            Self::FreeDisk => "disk freed",
            Self::Reorganise(_) => "ledger reorganised",
            Self::Sabotage(Saboteur { how: Sabotage::Panic, .. }) => "plug-in panicked",
            Self::Sabotage(Saboteur { how: Sabotage::Hang, .. }) => "plug-in hung",
            Self::Sabotage(Saboteur { how: Sabotage::Flood, .. }) => "plug-in flooded",
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = self.kind();
        match self {
            Self::Instruct { instruction, .. } => {
                write!(f, "{kind}: {}", serde_json::to_string(instruction).map_err(|_| fmt::Error)?)
            }
            Self::Kill(vnf) | Self::Hang(vnf) | Self::Recover(vnf) => write!(f, "{kind}: {vnf}"),
            Self::Slow(vnf, later) => write!(f, "{kind}: {vnf} by {later:?}"),
            Self::Silence(robot) | Self::Hear(robot) | Self::Replay(robot) => write!(f, "{kind}: {robot}"),
            Self::Forge(robot, byte) => write!(f, "{kind}: {robot}, byte {byte}"),
            Self::Reorganise(depth) => write!(f, "{kind}: {depth} blocks"),
            Self::Sabotage(Saboteur { id, robot, .. }) => write!(f, "{kind}: {id}, which moved {robot}"),
            Self::HoldStarts | Self::ReleaseStarts | Self::FillDisk | Self::FreeDisk => f.write_str(kind),
        }
    }
}

/// The faults of a run.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Plan {
    pub(crate) until: Timestamp,
    /// Whether the history is in a file, which a full disk stops from growing.
    pub(crate) on_disk: bool,
    /// In order of time.
    pub(crate) faults: Vec<(Timestamp, Fault)>,
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, fault) in &self.faults {
            writeln!(f, "{:>9.3} s  {fault}", at.as_secs_f64())?;
        }
        writeln!(f, "{:>9.3} s  end", self.until.as_secs_f64())
    }
}

/// The objects of faults.
struct Names {
    robots: Vec<NodeId>,
    units: Vec<NodeId>,
    nodes: Vec<NodeId>,
    links: Vec<LinkId>,
    /// VNFs that can be moved and killed.
    vnfs: Vec<VnfId>,
    on_disk: bool,
    has_ledger: bool,
}

impl Plan {
    /// Draws the plan of a seed for its testbed.
    pub(crate) fn new(seed: u64, testbed: &Testbed) -> Self {
        let mut draw = Draw::new(seed, "plan");
        let graph = &testbed.graph;
        let has_ledger = graph.domains.len() > 1;
        // A negotiation takes some blocks.
        let (least, most) = if has_ledger { (12.0, 24.0) } else { (6.0, 14.0) };
        let until = Timestamp::ZERO + draw.duration(least, most);
        let on_disk = draw.chance(0.25);
        let mut names = Names {
            robots: graph.robots().map(|(node, _)| node.id.clone()).collect(),
            units: graph.radio_units().map(|(node, _)| node.id.clone()).collect(),
            nodes: graph.nodes.iter().map(|node| node.id.clone()).collect(),
            links: graph.links.iter().map(|link| link.id.clone()).collect(),
            vnfs: testbed
                .vnfs()
                .filter(|vnf| vnf.program != Program::RobotDriver)
                .map(|vnf| vnf.id.clone())
                .collect(),
            on_disk,
            has_ledger,
        };
        let robots = names.robots.iter();
        names.links.extend(robots.flat_map(|robot| names.units.iter().map(|u| LinkId::wireless(robot, u))));
        let mut faults = Vec::new();
        for _ in 0..draw.whole(3..=25) {
            let at = Timestamp::ZERO + draw.duration(0.2, until.as_secs_f64() - 0.2);
            names.fault(&mut draw, at).into_iter().for_each(|fault| insert(&mut faults, fault));
        }
        let mut mappings = Draw::new(seed, "mappings");
        for _ in 0..mappings.whole(0..=6) {
            let at = Timestamp::ZERO + mappings.duration(0.2, until.as_secs_f64() - 0.2);
            let instruction = mapping(&mut mappings, testbed);
            insert(&mut faults, (at, Fault::Instruct { kind: "path mapped", instruction }));
        }
        let mut limits = Draw::new(seed, "speed limits");
        for _ in 0..limits.whole(0..=4) {
            let at = Timestamp::ZERO + limits.duration(0.2, until.as_secs_f64() - 0.2);
            let robot = limits.one(&names.robots).clone();
            // Some limits are negative, i.e. invalid.
            let speed_limit_mps = (!limits.chance(0.2)).then(|| limits.number(-0.05, 0.5));
            let instruction = Instruction::LimitSpeed { robot, speed_limit_mps };
            insert(&mut faults, (at, Fault::Instruct { kind: "speed limited", instruction }));
        }
        let mut goals = Draw::new(seed, "goals");
        for _ in 0..goals.whole(0..=3) {
            let at = Timestamp::ZERO + goals.duration(0.2, until.as_secs_f64() - 0.2);
            let instruction = goal(&mut goals, testbed);
            insert(&mut faults, (at, Fault::Instruct { kind: "goal given", instruction }));
        }
        for number in 1..=draw.whole(0..=2) {
            let how = *draw.one(&[Sabotage::Panic, Sabotage::Hang, Sabotage::Flood]);
            let id = PluginId::new(&format!("{SABOTEUR}{number}")).expect("a valid name");
            let at = Timestamp::ZERO + draw.duration(1.0, until.as_secs_f64() - 2.0);
            let robot = draw.one(&names.robots).clone();
            insert(&mut faults, (at, Fault::Sabotage(Saboteur { id, robot, how })));
        }
        Self { until, on_disk, faults }
    }
}

/// Inserts a fault after those that are earlier or at the same time.
fn insert(faults: &mut Vec<(Timestamp, Fault)>, fault: (Timestamp, Fault)) {
    faults.insert(faults.partition_point(|(at, _)| *at <= fault.0), fault);
}

/// Draws a mapping between a robot and a server: mostly the existing path, sometimes one with a gap, or none.
fn mapping(draw: &mut Draw, testbed: &Testbed) -> Instruction {
    let graph = &testbed.graph;
    let all = |is_one: fn(&NodeKind) -> bool| {
        graph.nodes.iter().filter(|node| is_one(&node.kind)).map(|node| node.id.clone()).collect::<Vec<_>>()
    };
    let robot = draw.one(&all(|kind| matches!(kind, NodeKind::Robot(_)))).clone();
    let unit = draw.one(&all(|kind| matches!(kind, NodeKind::RadioUnit(_)))).clone();
    let servers = all(|kind| matches!(kind, NodeKind::Server(_)));
    // Navigation starts on the first server.
    let server = if draw.chance(0.6) { &servers[0] } else { draw.one(&servers) }.clone();
    let route = graph.route(&robot, &server, |_| Some(&unit));
    let mut links = route.map_or_else(Vec::new, |route| route.links);
    let (mut from, mut to) = (robot, server);
    if draw.chance(0.5) {
        (from, to) = (to, from);
        links.reverse();
    }
    if draw.chance(0.1) {
        links.clear();
    } else if draw.chance(0.1) && !links.is_empty() {
        links.remove(draw.whole(0..=links.len() - 1));
    }
    Instruction::Map { from, to, links, reservation: None }
}

/// Draws a goal for a robot: mostly near a place of a walk, sometimes anywhere, or none.
fn goal(draw: &mut Draw, testbed: &Testbed) -> Instruction {
    let robots: Vec<_> = testbed.graph.robots().map(|(node, _)| node.id.clone()).collect();
    let places: Vec<_> = testbed.walks.iter().flat_map(|walk| walk.waypoints.iter().copied()).collect();
    let robot = draw.one(&robots).clone();
    if places.is_empty() || draw.chance(0.25) {
        return Instruction::NavigateTo { robot, goal: None };
    }
    let reach = if draw.chance(0.8) { 0.5 } else { 50.0 };
    let Position { x, y, z } = *draw.one(&places);
    let goal = Position { x: x + draw.number(-reach, reach), y: y + draw.number(-reach, reach), z };
    Instruction::NavigateTo { robot, goal: Some(goal) }
}

impl Names {
    /// Draws a fault and its end.
    fn fault(&self, draw: &mut Draw, at: Timestamp) -> Vec<(Timestamp, Fault)> {
        let later = at + draw.duration(0.0, 4.0);
        let (vnf, robot) = (draw.one(&self.vnfs).clone(), draw.one(&self.robots).clone());
        match draw.whole(0..=19) {
            0..=2 => {
                let link = draw.one(&self.links).clone();
                let direction = *draw.one(&[None, Some(Direction::Forward), Some(Direction::Backward)]);
                let cut = |kind, loss| {
                    let change = ConditionChange { loss: Some(loss), ..ConditionChange::default() };
                    let instruction = Instruction::Condition { link: link.clone(), direction, change };
                    Fault::Instruct { kind, instruction }
                };
                let all = Loss::Independent { rate: Probability::ONE };
                vec![(at, cut("link cut", all)), (later, cut("link mended", Loss::None))]
            }
            3 | 4 => vec![(at, Fault::Kill(vnf))],
            5 => vec![(at, Fault::Hang(vnf.clone())), (later, Fault::Recover(vnf))],
            6 => {
                let by = draw.duration(0.0, 1.0);
                vec![(at, Fault::Slow(vnf.clone(), by)), (later, Fault::Recover(vnf))]
            }
            7 => vec![(at, Fault::HoldStarts), (later, Fault::ReleaseStarts)],
            8 => vec![(at, Fault::Silence(robot.clone())), (later, Fault::Hear(robot))],
            9 => vec![(at, Fault::Replay(robot))],
            10 => vec![(at, Fault::Forge(robot, draw.whole(0..=255)))],
            11 if self.on_disk => vec![(at, Fault::FillDisk), (later, Fault::FreeDisk)],
            12 | 13 if self.has_ledger => vec![(at, Fault::Reorganise(draw.whole(1..=3)))],
            // Several at once, as a plug-in gives them.
            11..=14 => {
                let places = (0..draw.whole(1..=3)).map(|_| self.place(draw));
                places.map(|instruction| (at, Fault::Instruct { kind: "VNF moved", instruction })).collect()
            }
            15 => {
                let instruction = self.nonsense(draw);
                vec![(at, Fault::Instruct { kind: "nonsense asked", instruction })]
            }
            _ => {
                let instruction = self.instruction(draw, robot);
                vec![(at, Fault::Instruct { kind: "instruction", instruction })]
            }
        }
    }

    fn place(&self, draw: &mut Draw) -> Instruction {
        let vnf = draw.one(&self.vnfs).clone();
        let mut nodes = vec![draw.one(&self.nodes).clone()];
        while draw.chance(0.3) {
            let another = draw.one(&self.nodes);
            nodes.extend((!nodes.contains(another) && nodes.len() < Nodes::MOST).then(|| another.clone()));
        }
        Instruction::Place { vnf, node: Nodes::new(nodes).expect("they differ, and are few") }
    }

    /// Draws any instruction. It may be rejected.
    fn instruction(&self, draw: &mut Draw, robot: NodeId) -> Instruction {
        let radio_unit = draw.one(&self.units).clone();
        let link = draw.one(&self.links).clone();
        match draw.whole(0..=12) {
            0 | 1 => Instruction::Attach { robot, radio_unit },
            2 => Instruction::Scan { robot },
            3 => {
                let velocity = Velocity::planar(draw.number(-1.0, 1.0), draw.number(-2.0, 2.0));
                Instruction::Move { robot, velocity, waypoint: draw.whole(0..=2) as u32 }
            }
            4 => Instruction::Halt { robot },
            5 => Instruction::Go { robot },
            6 => {
                let access_point =
                    AccessPoint { ssid: "lab".to_owned(), mobility_domain: 1, key: None, core: None };
                Instruction::Deploy { radio_unit, access_point }
            }
            7 => Instruction::Remove { radio_unit },
            8 => {
                let test = ThroughputTest { duration: draw.duration(0.01, 0.2), rate_limit: None };
                Instruction::TestThroughput { link, direction: Direction::Forward, test }
            }
            9 | 10 => self.added(draw),
            11 => Instruction::RemoveVnf { vnf: added_name(draw) },
            _ => {
                let change = ConditionChange {
                    delay_ms: Some(draw.number(0.0, 100.0)),
                    drop_scale: Some(draw.number(0.5, 20.0)),
                    duplication: Probability::new(draw.number(0.0, 0.2)),
                    reordering: Probability::new(draw.number(0.0, 0.2)),
                    ..ConditionChange::default()
                };
                Instruction::Condition { link, direction: None, change }
            }
        }
    }

    /// Draws a VNF to add. Its node may have no room for it, and its name may be taken.
    fn added(&self, draw: &mut Draw) -> Instruction {
        let Instruction::Place { node, .. } = self.place(draw) else { unreachable!("it places a VNF") };
        let image = Image { reference: "a:1".to_owned(), start: draw.duration(0.0, 1.0), ..Image::default() };
        let vnf = Vnf {
            id: added_name(draw),
            program: Program::Command(vec!["serve".to_owned()]),
            cpus: draw.number(0.1, 2.0),
            cpu_limit: None,
            memory_bytes: draw.whole(1..=1_000_000_000) as u64,
            pinned_to: None,
            node,
            env: Vec::new(),
            rights: Rights::default(),
            keep: false,
            image: draw.chance(0.5).then(|| Box::new(image)),
            start: Duration::ZERO,
            computing: None,
            state: None,
        };
        Instruction::AddVnf { vnf: Box::new(vnf) }
    }

    /// Draws an instruction that is invalid in every testbed.
    fn nonsense(&self, draw: &mut Draw) -> Instruction {
        let nobody = NodeId::new("nobody").expect("a valid name");
        let change = ConditionChange { delay_ms: Some(-1.0), ..ConditionChange::default() };
        match draw.whole(0..=7) {
            6 => Instruction::RemoveVnf { vnf: draw.one(&self.vnfs).clone() },
            7 => {
                let Instruction::AddVnf { mut vnf } = self.added(draw) else { unreachable!("it adds a VNF") };
                vnf.rights = Rights::Trusted;
                Instruction::AddVnf { vnf }
            }
            0 => Instruction::Attach { robot: nobody, radio_unit: draw.one(&self.units).clone() },
            1 => Instruction::Place { vnf: draw.one(&self.vnfs).clone(), node: nobody.into() },
            2 => Instruction::Condition { link: draw.one(&self.links).clone(), direction: None, change },
            3 => {
                let change = ConditionChange { rate: Some(Rate::Unlimited), ..ConditionChange::default() };
                let link = LinkId::between(&nobody, &nobody);
                Instruction::Condition { link, direction: None, change }
            }
            4 => {
                let robot = draw.one(&self.robots).clone();
                Instruction::Move { robot, velocity: Velocity::default(), waypoint: u32::MAX }
            }
            _ => Instruction::Note { process: String::new(), step: "x".repeat(200), ago: None },
        }
    }
}

/// Draws one of few names, so that VNFs of one name come and go.
fn added_name(draw: &mut Draw) -> VnfId {
    VnfId::new(&format!("added-{}", draw.whole(1..=3))).expect("a valid name")
}
