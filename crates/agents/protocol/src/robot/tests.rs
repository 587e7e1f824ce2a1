use std::{collections::VecDeque, time::Duration};

use cotorra_graph::{RobotFault, Timestamp, Velocity};
use cotorra_testing::turtlebot::{Kobuki, Memory, Place, Rplidar, room};
use cotorra_turtlebot::{
    Body, Device, Readings, Turtlebot,
    kobuki::{Base, COMMAND_TIMEOUT},
    rplidar::{Lidar, LidarSettings, Sample, Turn},
};
use proptest::prelude::*;

use super::*;
use crate::{clock::AgentClock, message::Echo, run::Run};

const RUN: Run = Run(7);
/// Time of the core's clock at the start of the agent's.
const CORE_AHEAD_MS: u64 = 5000;
const FORWARD: Velocity = Velocity::planar(0.2, 0.0);

fn at(ms: u64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

/// Messages under way, with the time at which each arrives.
#[derive(Default)]
struct Way<M>(Vec<(u64, M)>);

impl<M> Way<M> {
    fn arrived(&mut self, ms: u64) -> Vec<M> {
        let (arrived, rest) = std::mem::take(&mut self.0).into_iter().partition(|(due, _)| *due <= ms);
        self.0 = rest;
        let mut arrived: Vec<_> = arrived;
        arrived.sort_by_key(|(due, _)| *due);
        arrived.into_iter().map(|(_, message)| message).collect()
    }
}

/// Fate of a message: the delays of its copies, milliseconds. Without one it is lost.
type Fate = Vec<u64>;

/// A core and an agent with a robot, in virtual time. `ms` is the agent's clock.
struct Lab {
    core: RemoteRobot,
    agent: Option<DrivenRobot>,
    openings: u64,
    /// The agent's process.
    boot: u64,
    kobuki: Kobuki,
    rplidar: Rplidar,
    ports: [Memory; 2],
    to_agent: Way<RobotCommand>,
    to_core: Way<(RobotReading, Option<RobotTurn>)>,
    fates: VecDeque<Fate>,
    ms: u64,
    /// When the core gave a velocity last.
    given: Option<u64>,
    /// Readings that were sent.
    sent: usize,
}

impl Lab {
    /// A robot in a room of 9 m × 4 m, at (1, 1). Messages have these fates, over and over.
    fn new(fates: Vec<Fate>) -> Self {
        let place = Place { x: 1.0, y: 1.0, heading: 0.0 };
        let mut lab = Self {
            core: RemoteRobot::new(RUN),
            agent: None,
            openings: 0,
            boot: 3,
            kobuki: Kobuki::at(place),
            rplidar: Rplidar::new(room((0.0, 0.0), (9.0, 4.0)), place),
            ports: [Memory::default(), Memory::default()],
            to_agent: Way(Vec::new()),
            to_core: Way(Vec::new()),
            fates: fates.into(),
            ms: 0,
            given: None,
            sent: 0,
        };
        lab.open();
        lab
    }

    /// Starts the agent's process anew, which opens the robot's ports.
    fn restart(&mut self) {
        self.agent = None;
        (self.boot, self.openings) = (self.boot + 1, 0);
        self.open();
    }

    /// Opens the robot's ports, also after they were closed.
    fn open(&mut self) {
        let now = at(self.ms);
        self.openings += 1;
        let base = Device::on(Box::new(self.ports[0].clone()), Base::default(), now);
        let lidar = Device::on(Box::new(self.ports[1].clone()), Lidar::new(LidarSettings::default()), now);
        let session = RobotSession { run: RUN, boot: self.boot, opening: self.openings };
        self.core.follow(self.boot, AgentClock::default());
        self.agent = Some(DrivenRobot::new(now, session, Turtlebot::on(base, Some(lidar))));
    }

    fn core_now(&self) -> Timestamp {
        at(self.ms + CORE_AHEAD_MS)
    }

    fn fate(&mut self) -> Fate {
        self.fates.rotate_left(1);
        self.fates.back().cloned().unwrap_or_else(|| vec![1])
    }

    /// Goes on until then. The core gives `velocity` ten times a second.
    fn run(&mut self, until: u64, velocity: Option<Velocity>) {
        while self.ms < until {
            self.step(velocity);
        }
    }

    fn step(&mut self, velocity: Option<Velocity>) {
        self.ms += 1;
        let (ms, now, core_now) = (self.ms, at(self.ms), self.core_now());
        for (reading, turn) in self.to_core.arrived(ms) {
            self.core.receive(core_now, reading);
            turn.into_iter().for_each(|turn| self.core.receive_turn(core_now, turn));
        }
        if let Some(velocity) = velocity.filter(|_| ms.is_multiple_of(100))
            && self.core.drive(core_now, velocity).is_ok()
        {
            self.given = Some(ms);
        }
        while let Some(command) = self.core.poll_command() {
            let command = RobotCommand::decode(&command.encode()).unwrap();
            let fate = self.fate();
            self.to_agent.0.extend(fate.into_iter().map(|delay| (ms + delay, command)));
        }
        for command in self.to_agent.arrived(ms) {
            self.agent.iter_mut().for_each(|agent| agent.receive(now, &command));
        }
        if let Some((reading, turn)) = self.agent.as_mut().and_then(|agent| agent.poll(now)) {
            self.sent += 1;
            let reading = RobotReading::decode(&reading.encode()).unwrap();
            let turn = turn.map(|turn| RobotTurn::decode(&turn.encode()).unwrap());
            let fate = self.fate();
            self.to_core
                .0
                .extend(fate.into_iter().map(|delay| (ms + delay, (reading.clone(), turn.clone()))));
        }
        let elapsed = Duration::from_millis(ms);
        let bytes = self.ports[0].exchange(self.kobuki.take_output());
        self.kobuki.receive(elapsed, &bytes);
        self.rplidar.place = self.kobuki.place;
        let bytes = self.ports[1].exchange(self.rplidar.take_output());
        self.rplidar.receive(elapsed, &bytes);
    }

    fn moves(&self) -> bool {
        self.kobuki.velocity() != (0.0, 0.0)
    }

    fn readings(&mut self) -> Readings {
        let now = self.core_now();
        self.core.read(now)
    }
}

#[test]
fn robot_at_an_agent_drives_and_its_readings_and_turns_arrive() {
    let mut lab = Lab::new(vec![vec![20]]);
    assert_eq!(lab.core.drive(at(0), FORWARD), Err(RobotFault::Absent));
    lab.run(1000, None);
    assert_eq!(lab.readings().faults, []);
    lab.run(3000, Some(FORWARD));
    let readings = lab.readings();
    let gone = lab.kobuki.place.x - 1.0;
    assert!(gone > 0.35 && (readings.odometry.position.0 - gone).abs() < 0.03, "{gone} {readings:?}");
    assert_eq!(readings.firmware.unwrap().to_string(), "1.2.0");
    let turn = lab.core.turn(None).unwrap();
    let ahead = turn.samples.iter().filter(|its| its.angle < 0.02).find_map(|its| its.range).unwrap();
    assert!((f64::from(ahead) - (8.0 - gone)).abs() < 0.06, "{ahead}");
    assert_eq!(lab.core.turn(Some(turn.at)), None);
}

#[test]
fn robot_stops_0_6_s_after_the_last_word_of_its_core_and_goes_on_with_the_next() {
    let mut lab = Lab::new(vec![vec![10]]);
    lab.run(2050, Some(FORWARD));
    // The network is cut: what is under way is lost.
    lab.fates = VecDeque::from([Fate::new()]);
    (lab.to_agent.0, lab.to_core.0) = (Vec::new(), Vec::new());
    let last = lab.given.unwrap();
    lab.run(last + 400, Some(FORWARD));
    assert!(lab.moves(), "a moment without network stops nothing");
    lab.run(last + 600, Some(FORWARD));
    assert!(!lab.moves());
    lab.run(4000, Some(FORWARD));
    assert_eq!(lab.readings().faults, [RobotFault::Silent]);
    lab.fates = VecDeque::from([vec![10]]);
    lab.run(5000, Some(FORWARD));
    assert!(lab.moves());
    assert_eq!(lab.readings().faults, []);
}

#[test]
fn late_doubled_and_foreign_commands_move_nothing() {
    let mut lab = Lab::new(vec![vec![5]]);
    lab.run(1000, None);
    let session = RobotSession { run: RUN, boot: 3, opening: 1 };
    let drive = |session, sequence, given| RobotCommand {
        session,
        sequence,
        heard_ns: 0,
        motion: Some(Motion::Drive { velocity: FORWARD, given_ns: at(given).as_nanos() }),
    };
    for foreign in [
        RobotSession { run: Run(6), ..session },
        RobotSession { boot: 4, ..session },
        RobotSession { opening: 2, ..session },
    ] {
        lab.agent.as_mut().unwrap().receive(at(1000), &drive(foreign, 1000, 1000));
        lab.step(None);
        assert!(!lab.moves(), "{foreign:?}");
    }
    lab.agent.as_mut().unwrap().receive(at(lab.ms), &drive(session, 1000, lab.ms - 600));
    lab.step(None);
    assert!(!lab.moves(), "it is too late");
    lab.agent.as_mut().unwrap().receive(at(lab.ms), &drive(session, 1001, lab.ms));
    lab.step(None);
    assert!(lab.moves());
    let stop = RobotCommand { motion: Some(Motion::Stop), ..drive(session, 1002, 0) };
    lab.agent.as_mut().unwrap().receive(at(lab.ms), &stop);
    lab.step(None);
    for old in [1001, 1002] {
        lab.agent.as_mut().unwrap().receive(at(lab.ms), &drive(session, old, lab.ms));
        lab.step(None);
        assert!(!lab.moves(), "{old}");
    }
}

#[test]
fn command_that_was_given_in_the_future_lasts_no_longer() {
    let mut lab = Lab::new(vec![vec![5]]);
    lab.run(1000, None);
    let motion = Some(Motion::Drive { velocity: FORWARD, given_ns: u64::MAX });
    let session = RobotSession { run: RUN, boot: 3, opening: 1 };
    let command = RobotCommand { session, sequence: 1000, heard_ns: u64::MAX, motion };
    lab.agent.as_mut().unwrap().receive(at(1000), &command);
    lab.run(1500, None);
    assert!(lab.moves());
    lab.run(1601, None);
    assert!(!lab.moves());
}

#[test]
fn command_for_an_earlier_process_is_not_sent_to_the_next() {
    let mut lab = Lab::new(vec![vec![5]]);
    lab.run(1000, None);
    let now = lab.core_now();
    while lab.core.poll_command().is_some() {}
    lab.core.drive(now, FORWARD).unwrap();
    lab.core.follow(4, AgentClock::default());
    let session = RobotSession { run: RUN, boot: 4, opening: 1 };
    let readings = lab.readings();
    lab.core.receive(now, RobotReading { session, sent_ns: 1, readings });
    let command = lab.core.poll_command().unwrap();
    assert_eq!((command.session, command.heard_ns, command.motion), (session, 1, None));
}

#[test]
fn readings_and_turns_that_were_overtaken_change_nothing() {
    let mut lab = Lab::new(vec![vec![5]]);
    lab.run(2000, None);
    let (now, newest) = (lab.core_now(), lab.readings());
    let session = RobotSession { run: RUN, boot: 3, opening: 1 };
    let turn = lab.core.turn(None).unwrap();
    for sent_ns in [0, at(1000).as_nanos()] {
        let readings = Readings { rejected_frames: 7, ..newest.clone() };
        lab.core.receive(now, RobotReading { session, sent_ns, readings });
        assert_eq!(lab.readings(), newest);
        let old = Turn { at: Timestamp::ZERO, samples: Vec::new(), ..turn.clone() };
        lab.core.receive_turn(now, RobotTurn { session, sent_ns, turn: old });
        assert!(lab.core.turn(None).is_some_and(|kept| kept == turn));
    }
}

#[test]
fn dropped_robot_is_at_rest_and_odometry_goes_on_when_its_ports_open_again() {
    let mut lab = Lab::new(vec![vec![10]]);
    lab.run(3000, Some(FORWARD));
    assert!(lab.moves());
    lab.agent = None;
    lab.step(None);
    assert!(!lab.moves() && lab.rplidar.motor == 0);
    lab.run(4500, None);
    assert_eq!(lab.readings().faults, [RobotFault::Silent]);
    lab.open();
    lab.run(8000, Some(FORWARD));
    let gone = lab.kobuki.place.x - 1.0;
    let readings = lab.readings();
    assert!(gone > 0.8 && (readings.odometry.position.0 - gone).abs() < 0.05, "{gone} {readings:?}");
    // A reading of the first session that comes late changes nothing.
    let session = RobotSession { run: RUN, boot: 3, opening: 1 };
    let late = RobotReading { session, sent_ns: u64::MAX, readings: Readings::default() };
    let now = lab.core_now();
    lab.core.receive(now, late.clone());
    assert_eq!(lab.readings().faults, []);
    // So does one of a process that does not report, or of another run.
    for foreign in [RobotSession { boot: 4, ..session }, RobotSession { run: Run(6), opening: 9, ..session }]
    {
        lab.core.receive(now, RobotReading { session: foreign, ..late.clone() });
        assert_eq!(lab.readings().faults, []);
    }
}

#[test]
fn robot_goes_on_when_its_agent_was_restarted() {
    let mut lab = Lab::new(vec![vec![10]]);
    lab.run(2000, Some(FORWARD));
    assert!(lab.moves());
    lab.restart();
    lab.step(Some(FORWARD));
    assert!(!lab.moves());
    lab.run(4500, Some(FORWARD));
    assert!(lab.moves());
    let gone = lab.kobuki.place.x - 1.0;
    let readings = lab.readings();
    assert!((readings.odometry.position.0 - gone).abs() < 0.05, "{gone} {readings:?}");
}

#[test]
fn velocities_beyond_those_of_the_robot_are_scaled_down() {
    for (wanted, driven) in [
        (Velocity::planar(1e300, 0.0), (0.7, 0.0)),
        (Velocity::planar(-7.0, 0.0), (-0.7, 0.0)),
        (Velocity::planar(0.0, 1e300), (0.0, std::f64::consts::PI)),
        (Velocity { vertical: 1e300, ..FORWARD }, (0.2, 0.0)),
    ] {
        let mut lab = Lab::new(vec![vec![5]]);
        lab.run(1000, None);
        lab.run(1300, Some(wanted));
        let (linear, angular) = lab.kobuki.velocity();
        assert!(
            (linear - driven.0).abs() < 0.002 && (angular - driven.1).abs() < 0.01,
            "{wanted:?}: {linear} {angular}"
        );
    }
}

#[test]
fn impossible_readings_are_rejected() {
    let mut lab = Lab::new(vec![vec![5]]);
    lab.run(1000, None);
    let session = RobotSession { run: RUN, boot: 3, opening: 1 };
    let decoded = |readings| RobotReading::decode(&RobotReading { session, sent_ns: 1, readings }.encode());
    let sound = lab.readings();
    assert_eq!(decoded(sound.clone()).unwrap().readings, sound);
    let changes: [fn(&mut Readings); 7] = [
        |its| its.odometry.position.0 = 1e9,
        |its| its.odometry.position.1 = f64::NAN,
        |its| its.odometry.heading = 1e6,
        |its| its.odometry.velocity.linear = -1e6,
        |its| its.odometry.way = -1.0,
        |its| its.angular_velocity = Some((Timestamp::ZERO, [0.0, 0.0, 1e9])),
        |its| its.faults = vec![RobotFault::Silent; 9],
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut readings = sound.clone();
        change(&mut readings);
        assert!(decoded(readings).is_err(), "{number}");
    }
    assert!(RobotReading::decode(&[b' '; 5000]).is_err());
    assert!(RobotCommand::decode(&[b' '; 5000]).is_err());
}

#[test]
fn measurements_keep_their_times_on_the_cores_clock() {
    let mut lab = Lab::new(vec![vec![300]]);
    // The agent's clock, by an exchange that took no time when it was 1 s.
    let clock = |core_ms: u64| {
        let (core, agents) = (at(core_ms), at(1000).as_nanos());
        let mut clock = AgentClock::default();
        clock.receive(core, Echo { sent_ns: core.as_nanos(), received_ns: agents, replied_ns: agents });
        clock
    };
    lab.core.follow(3, clock(1000 + CORE_AHEAD_MS));
    lab.run(2000, None);
    let measured = |lab: &mut Lab| lab.readings().basic.unwrap().0;
    let age = |lab: &Lab, at: Timestamp| lab.core_now().since(at);
    let first = measured(&mut lab);
    let range = Duration::from_millis(299)..Duration::from_millis(400);
    assert!(range.contains(&age(&lab, first)), "{:?}", age(&lab, first));
    // The base falls silent. Its last measurement is not made anew by readings that repeat it, or by a better offset.
    lab.kobuki.is_silent = true;
    lab.run(2600, None);
    let last = measured(&mut lab);
    lab.core.follow(3, clock(500 + CORE_AHEAD_MS));
    lab.run(2900, None);
    assert_eq!(measured(&mut lab), last);
    // Without a known distance of the clocks, a message took no time.
    let mut lab = Lab::new(vec![vec![300]]);
    lab.run(2000, None);
    let at = measured(&mut lab);
    assert!(age(&lab, at) < Duration::from_millis(100));
}

#[test]
fn readings_to_a_core_that_confirms_nothing_become_few() {
    let mut lab = Lab::new(vec![Fate::new()]);
    lab.run(10_000, None);
    assert!((10..=30).contains(&lab.sent), "{}", lab.sent);
    lab.fates = VecDeque::from([vec![10]]);
    let before = lab.sent;
    lab.run(12_000, None);
    assert!(lab.sent - before > 30, "{}", lab.sent - before);
}

#[test]
fn faults_of_the_lidar_stop_the_robot_without_the_core() {
    let mut lab = Lab::new(vec![vec![10]]);
    lab.run(2000, Some(FORWARD));
    assert!(lab.moves());
    lab.rplidar.is_silent = true;
    lab.run(3100, Some(FORWARD));
    assert!(!lab.moves());
    assert_eq!(lab.readings().faults, [RobotFault::Silent]);
}

fn fate() -> impl Strategy<Value = Fate> {
    prop_oneof![
        4 => (0_u64..100).prop_map(|delay| vec![delay]),
        2 => (0_u64..3000).prop_map(|delay| vec![delay]),
        1 => Just(Fate::new()),
        1 => prop::collection::vec(0_u64..2000, 2..4),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Whatever happens to messages, whenever the core falls silent, and whenever the ports are opened anew: the base moves
    /// only in the 600 ms after a velocity was given. When messages arrive again, the robot follows.
    #[test]
    fn robot_moves_only_by_velocities_of_the_last_600_ms(
        fates in prop::collection::vec(fate(), 1..60),
        pauses in prop::collection::vec((200_u64..2500, any::<bool>()), 1..6),
        reopened in prop::option::of((0_usize..6, any::<bool>())),
    ) {
        let mut lab = Lab::new(fates);
        for (number, (length, is_driving)) in pauses.into_iter().enumerate() {
            match reopened {
                Some((at, true)) if at == number => lab.restart(),
                Some((at, false)) if at == number => {
                    lab.agent = None;
                    lab.open();
                }
                _ => {}
            }
            for _ in 0..length {
                lab.step(is_driving.then_some(FORWARD));
                let timeout = COMMAND_TIMEOUT.as_millis() as u64;
                let is_given = lab.given.is_some_and(|given| lab.ms < given + timeout);
                prop_assert!(is_given || !lab.moves(), "at {} ms, given at {:?}", lab.ms, lab.given);
            }
        }
        lab.fates = VecDeque::from([vec![10]]);
        lab.run(lab.ms + 5000, Some(FORWARD));
        prop_assert!(lab.moves(), "{:?}", lab.readings());
    }

    #[test]
    fn turns_survive_their_encoding(
        numbers in any::<[u64; 5]>(),
        period in 0..=Turn::LONGEST_PERIOD.as_nanos() as u64,
        samples in prop::collection::vec((0.0..=std::f32::consts::TAU, prop::option::of(0.001_f32..16.0)), 0..200),
    ) {
        let [run, boot, opening, sent_ns, begin] = numbers;
        let samples = samples.into_iter().map(|(angle, range)| Sample { angle: angle.into(), range });
        let turn = Turn { at: Timestamp::from_nanos(begin), period: Duration::from_nanos(period), samples: samples.collect() };
        let turn = RobotTurn { session: RobotSession { run: Run(run), boot, opening }, sent_ns, turn };
        prop_assert_eq!(RobotTurn::decode(&turn.encode()), Ok(turn));
    }

    #[test]
    fn arbitrary_bytes_are_no_turn_or_one_with_sound_samples(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        if let Ok(turn) = RobotTurn::decode(&bytes) {
            let is_sound = |its: &Sample| its.angle.is_finite() && its.range.is_none_or(|range| range > 0.0 && range.is_finite());
            prop_assert!(turn.turn.samples.iter().all(is_sound) && turn.turn.period <= Turn::LONGEST_PERIOD);
            // NaN of any kind is the same.
            prop_assert_eq!(RobotTurn::decode(&turn.encode()), Ok(turn));
        }
    }
}

#[test]
fn turns_that_are_too_long_are_rejected() {
    let sample = Sample { angle: 1.0, range: None };
    let turn_of = |count, period| {
        let turn = Turn { samples: vec![sample; count], period, ..Turn::default() };
        RobotTurn { session: RobotSession { run: RUN, boot: 1, opening: 1 }, sent_ns: 1, turn }.encode()
    };
    let turn = |count| turn_of(count, Duration::ZERO);
    assert!(RobotTurn::decode(&turn(Turn::MOST_SAMPLES)).is_ok());
    assert!(RobotTurn::decode(&turn_of(1, Turn::LONGEST_PERIOD)).is_ok());
    assert_eq!(
        RobotTurn::decode(&turn_of(1, Turn::LONGEST_PERIOD + Duration::from_nanos(1))),
        Err(TurnError)
    );
    assert_eq!(RobotTurn::decode(&turn(Turn::MOST_SAMPLES + 1)), Err(TurnError));
}
