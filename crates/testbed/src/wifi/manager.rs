//! Decides what the Wi-Fi programs do, and what the emulated network and the user learn of them. It has neither a clock nor a
//! socket: events, answers and instructions go in, each with the time, and actions come out.

mod attaching;
mod keys;
mod robots;
mod suggesting;
mod units;

use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    time::Duration,
};

use cotorra_engine::Backoff;
use cotorra_fabric::FabricError;
use cotorra_graph::{Event, NodeId, Timestamp};
use cotorra_wifi::{
    AccessPoint, Channel, MacAddress, Passphrase, Ssid, Station, hostapd::Neighbour, wpa_supplicant::Heard,
};

use self::{robots::RobotState, units::UnitState};
use super::plan::Plan;

/// Time that robots have to join at the start, before the run goes on without them.
const JOINING: Duration = Duration::from_secs(5);
/// Time that a robot has to arrive at an access point.
const PATIENCE: Duration = Duration::from_secs(10);
/// Time in which the same notice is not repeated.
const QUIET: Duration = Duration::from_secs(10);
/// Most notices that are remembered. Others have strange addresses in them, and are left out.
const MOST_NOTICES: usize = 100;
/// Most robots, or radio units, that are listed by their names.
const MOST_NAMED: usize = 6;
/// Most access points that do not belong to the testbed and are remembered.
const MOST_STRANGERS: usize = 1000;

/// A program: the hostapd of a radio unit, or the wpa_supplicant of a robot.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Program {
    /// The hostapd of this radio unit.
    Hostapd(NodeId),
    /// The wpa_supplicant of this robot.
    Supplicant(NodeId),
}

impl Program {
    /// Returns its node.
    pub(super) fn node(&self) -> &NodeId {
        let (Self::Hostapd(node) | Self::Supplicant(node)) = self;
        node
    }

    /// Returns the name of its log.
    pub(super) fn log(&self) -> String {
        match self {
            Self::Hostapd(unit) => format!("hostapd-{unit}.log"),
            Self::Supplicant(robot) => format!("wpa_supplicant-{robot}.log"),
        }
    }
}

impl std::fmt::Display for Program {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Hostapd(unit) => write!(f, "hostapd of `{unit}`"),
            Self::Supplicant(robot) => write!(f, "wpa_supplicant of `{robot}`"),
        }
    }
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Input {
    /// A program was started, and answers.
    Started(Program),
    /// A program ended by itself, or could not be started.
    Ended {
        program: Program,
        /// The reason, for people.
        reason: String,
    },
    /// A program reported an event.
    Event { program: Program, event: cotorra_wifi::Event },
    /// A program refused a request, or did not answer.
    Refused { program: Program, request: Request, reason: Refused },
    /// Answer to [`Request::ReadHeard`].
    Heard { robot: NodeId, heard: Vec<Heard> },
}

/// Why a request was refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Refused {
    /// The program cannot do it now.
    Busy,
    /// For another reason, for people.
    Other(String),
}

/// Something to do, in this order.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "actions are polled one at a time and carried out at once")]
pub(super) enum Action {
    /// Start a program. [`Input::Started`] or [`Input::Ended`] follows.
    Start { program: Program, configuration: Configuration },
    /// Stop a program, or its start. No input follows.
    Stop(Program),
    /// Send a program a request.
    Request { program: Program, request: Request },
    /// Change the emulated network.
    Change(Change),
    /// Report an event.
    Report(Event),
}

/// Action for a program.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Configuration {
    AccessPoint(Box<AccessPoint>),
    Station(Box<Station>),
}

/// A request to a program.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Request {
    /// To a robot: roam to an access point.
    Roam { to: MacAddress, over_ds: bool },
    /// To a robot: scan these channels. One that stays does not roam to what it finds.
    Scan { channels: Vec<Channel>, stays: bool },
    /// To a robot: join this access point only; any again if there is none.
    Pin { to: Option<MacAddress> },
    /// To a robot: use another passphrase from the next handshake on.
    SetPassphrase { ssid: Ssid, passphrase: Passphrase },
    /// To a robot: leave its access point, and join one.
    Rejoin,
    /// To a robot: report what was heard lately.
    ReadHeard,
    /// To a radio unit: announce a neighbour to stations.
    SetNeighbour(Box<Neighbour>),
    /// To a radio unit: suggest to a station that it moves to a neighbour.
    Suggest { station: MacAddress, to: Box<Neighbour> },
}

/// A change of the emulated network, which follows what the programs did.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Change {
    /// A robot is associated with a radio unit.
    Associate {
        robot: NodeId,
        radio_unit: NodeId,
        /// When it began to change.
        began: Timestamp,
        /// Whether by fast transition.
        fast: bool,
    },
    /// A robot has lost its radio unit.
    Disassociate { robot: NodeId },
    /// A robot has scanned.
    Scanned { robot: NodeId },
    /// A radio unit serves in this mobility domain.
    SwitchOn { radio_unit: NodeId, access_point: cotorra_graph::AccessPoint },
    /// A radio unit serves no more.
    SwitchOff { radio_unit: NodeId },
}

/// Why an instruction is rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum Rejected {
    /// As the emulated network's own radio would reject it.
    #[error(transparent)]
    Fabric(#[from] FabricError),
    /// The program is being started.
    #[error("{0} does not run now: ask again when it does")]
    NotRunning(String),
    /// Without a passphrase there is no key, and wpa_supplicant would leave its access point for another key of SAE.
    #[error("`{0}` has real Wi-Fi software, which takes a `key` with `security: wpa2` only")]
    Key(NodeId),
    /// Only a radio unit can suggest another one.
    #[error("`{0}` is at no radio unit, which could suggest another one")]
    Nowhere(NodeId),
    /// wpa_supplicant would move with the passphrase that it has.
    #[error("`{radio_unit}` takes another key than `{robot}` uses where it is: send it there by `attach`")]
    OtherKey {
        /// The robot.
        robot: NodeId,
        /// The radio unit.
        radio_unit: NodeId,
    },
}

/// Stage of the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Radio units begin to serve.
    Units,
    /// Robots join, until then at most. One that is out of reach does not hold the others up.
    Robots { until: Timestamp },
    /// All has begun.
    Up,
}

/// The programs of a testbed.
#[derive(Debug)]
pub(super) struct Manager {
    plan: Plan,
    units: BTreeMap<NodeId, UnitState>,
    robots: BTreeMap<NodeId, RobotState>,
    actions: VecDeque<Action>,
    stage: Stage,
    /// The first program that could not be started, with the reason.
    failure: Option<String>,
    /// Access points with the SSID of a network that is not theirs, and were reported already for it.
    strangers: BTreeSet<(String, MacAddress)>,
    /// The last time of each notice.
    notices: BTreeMap<String, Timestamp>,
    /// Whether all programs were stopped for good.
    is_over: bool,
}

impl Manager {
    /// Creates the manager, which starts the radio units that serve from the start, and then all robots.
    pub(super) fn new(now: Timestamp, plan: Plan) -> Self {
        let units = plan.units.iter().map(|(id, unit)| (id.clone(), UnitState::new(unit))).collect();
        let robots = plan.robots.keys().map(|robot| (robot.clone(), RobotState::default())).collect();
        let mut manager = Self {
            plan,
            units,
            robots,
            actions: VecDeque::new(),
            stage: Stage::Units,
            failure: None,
            strangers: BTreeSet::new(),
            notices: BTreeMap::new(),
            is_over: false,
        };
        manager.start_serving_units();
        manager.go_on(now);
        manager
    }

    /// Whether a robot or a radio unit has a program.
    pub(super) fn has(&self, node: &NodeId) -> bool {
        self.units.contains_key(node) || self.robots.contains_key(node)
    }

    /// Takes what happened.
    pub(super) fn handle(&mut self, now: Timestamp, input: Input) {
        if self.is_over {
            return;
        }
        match input {
            Input::Started(Program::Hostapd(unit)) => self.unit_started(now, &unit),
            Input::Started(Program::Supplicant(robot)) => self.supplicant_started(now, &robot),
            Input::Ended { program, reason } => self.ended(now, &program, &reason),
            Input::Event { program: Program::Hostapd(unit), event } => self.unit_event(now, &unit, &event),
            Input::Event { program: Program::Supplicant(robot), event } => {
                self.robot_event(now, &robot, &event);
            }
            Input::Refused { program: Program::Supplicant(robot), request, reason } => {
                self.robot_refused(now, &robot, &request, reason);
            }
            Input::Refused { program: Program::Hostapd(unit), request, reason } => {
                self.unit_refused(now, &unit, &request, &reason);
            }
            Input::Heard { robot, heard } => self.heard(now, &robot, &heard),
        }
        self.go_on(now);
    }

    /// Does everything that is due.
    pub(super) fn advance(&mut self, now: Timestamp) {
        if self.is_over {
            return;
        }
        self.advance_units(now);
        self.advance_robots(now);
        self.go_on(now);
    }

    /// Returns when [`Self::advance`] is due.
    pub(super) fn deadline(&self) -> Option<Timestamp> {
        let lives = self.units.values().map(|unit| &unit.life);
        let lives = lives.chain(self.robots.values().map(|robot| &robot.life));
        let starts = lives.filter_map(|life| life.deadline());
        let errands = self.robots.values().filter_map(RobotState::deadline);
        let joined = if let Stage::Robots { until } = self.stage { Some(until) } else { None };
        starts.chain(errands).chain(joined).min()
    }

    /// Returns the next action.
    pub(super) fn poll_action(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// Stops all programs for good: the robots' first, so that they take their leave.
    pub(super) fn stop(&mut self) {
        self.is_over = true;
        self.actions.clear();
        let robots = self.robots.iter_mut().filter_map(|(robot, state)| {
            state.life.end().then(|| Action::Stop(Program::Supplicant(robot.clone())))
        });
        let units = self.units.iter_mut().filter_map(|(unit, state)| {
            state.life.end().then(|| Action::Stop(Program::Hostapd(unit.clone())))
        });
        self.actions.extend(robots.chain(units));
    }

    /// Whether all radio units have begun to serve, and all robots have joined or had time to.
    pub(super) fn is_up(&self) -> bool {
        self.stage == Stage::Up
    }

    /// Returns the programs, and robots, that [`Self::is_up`] waits for, for people.
    pub(super) fn awaited(&self) -> Vec<String> {
        let units = self.units.iter().filter(|(_, unit)| unit.life.is_wanted() && !unit.serves);
        let units = units.map(|(unit, _)| Program::Hostapd(unit.clone()).to_string());
        let robots = self.robots.iter().filter(|(_, robot)| !robot.is_attached());
        units.chain(robots.map(|(robot, _)| Program::Supplicant(robot.clone()).to_string())).collect()
    }

    /// Returns which radio units serve and which robots have joined, in a line for people.
    pub(super) fn standing(&self) -> String {
        let serving: Vec<_> =
            self.units.iter().filter(|(_, unit)| unit.serves).map(|(id, _)| id.as_str()).collect();
        let units = match &serving[..] {
            [] => "no radio unit serves".to_owned(),
            [one] => format!("radio unit {one} serves"),
            few if few.len() <= MOST_NAMED => format!("radio units {} serve", few.join(", ")),
            many => format!("{} radio units serve", many.len()),
        };
        let at = |state: &RobotState| state.at.as_ref().map_or("no radio unit", NodeId::as_str).to_owned();
        let robots: Vec<_> =
            self.robots.iter().map(|(robot, state)| format!("{robot} is at {}", at(state))).collect();
        let robots = if robots.len() <= MOST_NAMED {
            robots.join(", ")
        } else {
            let joined = self.robots.values().filter(|state| state.is_attached()).count();
            format!("{joined} of {} robots have joined", robots.len())
        };
        if robots.is_empty() { units } else { format!("{units}; {robots}") }
    }

    /// Returns the reason why the first program could not be started, if one could not.
    pub(super) fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Goes on with the start. Robots are started once all radio units serve: one that finds nothing in its first scan would
    /// wait for the next.
    fn go_on(&mut self, now: Timestamp) {
        if self.stage == Stage::Units && self.units_serve() {
            self.stage = Stage::Robots { until: now + JOINING };
            for robot in self.robots.keys().cloned().collect::<Vec<_>>() {
                self.start_supplicant(&robot);
            }
        }
        if let Stage::Robots { until } = self.stage
            && (self.all_joined() || now >= until)
        {
            self.stage = Stage::Up;
        }
    }

    fn ended(&mut self, now: Timestamp, program: &Program, reason: &str) {
        if self.failure.is_none() && !self.is_up() {
            self.failure = Some(format!("{program} cannot be started: {reason}"));
        }
        match program {
            Program::Hostapd(unit) => self.hostapd_ended(now, unit, reason),
            Program::Supplicant(robot) => self.supplicant_ended(now, robot, reason),
        }
    }

    fn start(&mut self, program: Program, configuration: Configuration) {
        self.actions.push_back(Action::Start { program, configuration });
    }

    fn request(&mut self, program: Program, request: Request) {
        self.actions.push_back(Action::Request { program, request });
    }

    fn change(&mut self, change: Change) {
        self.actions.push_back(Action::Change(change));
    }

    /// Reports a notice, unless the same one was reported a short time ago.
    fn notice(&mut self, now: Timestamp, message: String) {
        self.notices.retain(|_, at| now.since(*at) < QUIET);
        if self.notices.contains_key(&message) || self.notices.len() >= MOST_NOTICES {
            return;
        }
        self.notices.insert(message.clone(), now);
        self.actions.push_back(Action::Report(Event::Notice { message }));
    }
}

/// Returns the end of a notice of a program that is started again.
fn again(now: Timestamp, until: Timestamp) -> String {
    debug_assert!(until.since(now) <= Backoff::LONGEST);
    format!("it is started again in {} ms", until.since(now).as_millis())
}

#[cfg(test)]
mod tests;
