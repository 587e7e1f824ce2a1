//! The same misbehaving plug-in in real time, in virtual time and in a replay: the recorded events are the same.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use cotorra_fabric::Fabric;
use cotorra_graph::{Event, Instruction, PluginId, Stamped, Testbed, Timestamp, Velocity};
use cotorra_measurements::{History, RunInfo};
use cotorra_network_control::{Network, NetworkGone};
use cotorra_plugin::{Actions, Plugin, client::Client};
use cotorra_robot_middleware::Nonces;

use super::{host::PluginHost, lockstep::Guarded, running::RunningPlugins};
use crate::{
    api::{Operator, Tokens},
    clock::{Clock, wall_clock},
    core::{Core, message::Message, script::Script},
    events::{fanout::Fanout, live::Live, stream::EventStream},
    real::{core_loop::CoreLoop, robots::simulated},
    replay::{Played, Replay, ReplayEnd, ReplayOptions},
    report::Report,
    virtual_time::{Serving, Simulation, Stretch, VirtualEngine, VirtualNetwork, time_control::Speed},
};

const TESTBED: &str = "name: hall
wireless:
  hall: { standard: n, delay: 1 ms, path_loss: { model: log_distance, exponent: 3.0 } }
nodes:
  robot: { kind: robot, position: [0, 0], cpus: 2, memory: 8 GB }
  R1: { kind: radio_unit, position: [1, 1], channel: 1 }
  server: { kind: server, tier: edge, cpus: 2, memory: 8 GB }
links:
  - { ends: [R1, server], delay: 1 ms, rate: 1 Gbit/s }
";

/// Long enough for a call without work on a loaded machine.
const PATIENCE: Duration = Duration::from_secs(30);
const UNTIL: Timestamp = Timestamp::from_nanos(2_000_000_000);

#[derive(Debug, Clone, Copy)]
enum Misdeed {
    Panic,
    Flood,
    Hang,
}

/// Moves a robot, and misbehaves once it receives the event that the robot moves.
struct Misbehaving {
    misdeed: Misdeed,
    moved: Option<Timestamp>,
    hangs: Arc<AtomicBool>,
}

impl Plugin for Misbehaving {
    fn handle(&mut self, now: Timestamp, event: &Event, actions: &mut Actions) {
        let Event::Robot(context) = event else { return };
        let forward = Velocity::planar(0.2, 0.0);
        let go = Instruction::Move { robot: context.robot.clone(), velocity: forward, waypoint: 0 };
        let moved = self.moved.map(|moved| now.since(moved));
        if context.sensors.velocity.linear == 0.0 {
            if moved.is_none_or(|moved| moved > Duration::from_millis(200)) {
                self.moved = Some(now);
                actions.instruct_because(go, "to begin with");
            }
        } else if moved.is_some_and(|moved| moved > Duration::from_millis(50)) {
            match self.misdeed {
                Misdeed::Panic => panic!("by design"),
                Misdeed::Flood => (0..3000).for_each(|_| actions.instruct_because(go.clone(), "once more")),
                Misdeed::Hang => {
                    self.hangs.store(true, Ordering::Release);
                    loop {
                        thread::park();
                    }
                }
            }
        }
    }
}

/// The recorded events of the plug-in.
#[derive(Debug, PartialEq)]
struct Recorded {
    faults: Vec<(PluginId, String)>,
    /// Decisions about the flood's instructions, and whether one followed after the plug-in was cut off.
    flood: usize,
    any_later: bool,
}

impl Recorded {
    fn of(events: &[Stamped]) -> Self {
        let is_decision = |event: &Stamped| matches!(event.event, Event::Decision(_));
        let is_flood = |event: &&Stamped| matches!(&event.event, Event::Decision(decision) if decision.reason.as_deref() == Some("once more"));
        let is_fault = |event: &Stamped| matches!(event.event, Event::PluginFault { .. });
        let cut_off = events.iter().position(is_fault).unwrap_or(events.len());
        let faults = events.iter().filter_map(|event| match &event.event {
            Event::PluginFault { plugin, reason } => Some((plugin.clone(), reason.clone())),
            _ => None,
        });
        Self {
            faults: faults.collect(),
            flood: events.iter().filter(is_flood).count(),
            any_later: events[cut_off..].iter().any(is_decision),
        }
    }
}

fn testbed() -> Arc<Testbed> {
    Arc::new(
        cotorra_testbed_file::parse("hall.yaml", TESTBED, Path::new("")).unwrap_or_else(|e| panic!("{e:?}")),
    )
}

fn id() -> PluginId {
    "misbehaving".parse().unwrap()
}

impl Misdeed {
    /// Returns the plug-in, and a flag that it sets when it hangs.
    fn plugin(self) -> (Box<dyn Plugin>, Arc<AtomicBool>) {
        let hangs = Arc::new(AtomicBool::new(false));
        (Box::new(Misbehaving { misdeed: self, moved: None, hangs: Arc::clone(&hangs) }), hangs)
    }

    fn in_real_time(self) -> Vec<Stamped> {
        let (testbed, (plugin, hangs)) = (testbed(), self.plugin());
        let wall = wall_clock();
        // A call that hangs is at once past its limit.
        let now: Clock = Arc::new(move || {
            let late = if hangs.load(Ordering::Acquire) {
                PATIENCE + Duration::from_secs(1)
            } else {
                Duration::ZERO
            };
            wall() + late
        });
        let (messages, inbox) = mpsc::channel();
        let host = PluginHost::new([id()], PATIENCE);
        let mut plugins = RunningPlugins::new(host, Default::default());
        plugins.spawn(id(), plugin, &testbed, None, &now, messages.clone());
        let network = VirtualNetwork::new(Fabric::new(&testbed.graph, 1).unwrap());
        let network = Ticking { network, now: Arc::clone(&now) };
        let engine = VirtualEngine::new(&testbed, 1, Serving::default()).unwrap();
        let script = Script::load(&testbed).unwrap().0;
        let mut core =
            Core::new(Arc::clone(&testbed), 1, Nonces::seeded(1), network, engine, script, simulated)
                .unwrap();
        core.start(now());
        let stream = EventStream::default();
        let mut events = stream.subscribe();
        let fanout = Fanout { api: Some((Live::default(), stream)), ..Fanout::default() };
        let (sockets, until) = (BTreeMap::new(), None);
        let report = Report::new(&testbed, 1);
        let core = CoreLoop {
            core,
            report,
            plugins,
            fanout,
            inbox,
            sockets,
            control: Default::default(),
            images: None,
            now,
            until,
            history: Default::default(),
        };
        let core = thread::spawn(move || core.run());
        let (mut recorded, mut is_cut_off) = (Vec::new(), false);
        loop {
            let event = Stamped::clone(&events.wait());
            is_cut_off |= matches!(event.event, Event::PluginFault { .. });
            let stands =
                matches!(&event.event, Event::Robot(context) if context.sensors.velocity.linear == 0.0);
            recorded.push(event);
            if is_cut_off && stands {
                break;
            }
        }
        messages.send(Message::Stop).unwrap();
        core.join().unwrap();
        recorded
    }

    fn in_virtual_time(self) -> Vec<Stamped> {
        let (testbed, (plugin, hangs)) = (testbed(), self.plugin());
        let simulation = Simulation::new(Arc::clone(&testbed), 1).unwrap().with_patience(PATIENCE);
        let simulation = simulation.with_plugin(id(), plugin, &testbed);
        let mut simulation = Guarded::new(simulation, jumping(hangs));
        simulation.go(Stretch::Events(usize::MAX, Some(UNTIL)));
        assert!(simulation.run(&mut || true));
        std::iter::from_fn(|| simulation.poll_event()).collect()
    }

    /// Replays a run to the plug-in; returns the events about it.
    fn in_a_replay(self, run: &[Stamped]) -> Vec<Stamped> {
        let (plugin, hangs) = self.plugin();
        let replay = replay(run, 0, hangs).to(id(), plugin, &testbed(), PATIENCE);
        let (events, end) = play(replay);
        assert_eq!(end, ReplayEnd::Played);
        events
    }

    /// Replays a run to the same plug-in as a program.
    fn in_a_replay_as_a_program(self, run: &[Stamped]) -> Vec<Stamped> {
        let (mut plugin, hangs) = self.plugin();
        let replay = replay(run, 1, hangs);
        let client = Client::new(&format!("http://{}", replay.api_address())).unwrap().named(id());
        let follower = thread::spawn(move || client.run(&mut *plugin));
        let (events, end) = play(replay);
        assert_eq!(end, ReplayEnd::Alone, "it was the only follower");
        if !matches!(self, Self::Hang) {
            follower.join().unwrap().unwrap();
        }
        events
    }
}

/// A replay of a run that waits for this number of followers.
fn replay(run: &[Stamped], followers: usize, hangs: Arc<AtomicBool>) -> Replay {
    let history = History::in_memory().unwrap();
    let id = history.begin_run(&info()).unwrap();
    let recorder = history.paced_recorder(id).unwrap();
    run.iter().for_each(|event| recorder.record(event.clone()));
    recorder.flush().unwrap();
    let options = ReplayOptions {
        api: Some(([127, 0, 0, 1], 0).into()),
        known: None,
        tokens: Tokens::new(Operator::Everyone, BTreeMap::new()).unwrap(),
        encryption: Default::default(),
        folder: None,
        speed: Some(Speed::Max),
        followers,
        from: Timestamp::ZERO,
        to: None,
        foxglove: None,
        to_plugins: false,
    };
    Replay::by_the_clock(Testbed::clone(&testbed()), history, id, options, jumping(hangs)).unwrap()
}

/// Plays a replay; returns the events about plug-ins.
fn play(replay: Replay) -> (Vec<Stamped>, ReplayEnd) {
    let mut events = Vec::new();
    let end = replay.play(|played| {
        if let Played::Refused(event) | Played::CutOff(event) = played {
            events.push(event.clone());
        }
        true
    });
    (events, end.unwrap())
}

/// A clock that stands still, and jumps ahead at each reading once a call hangs.
fn jumping(hangs: Arc<AtomicBool>) -> Clock {
    let looks = AtomicU64::new(0);
    Arc::new(move || {
        let looks = if hangs.load(Ordering::Acquire) { looks.fetch_add(1, Ordering::Relaxed) } else { 0 };
        Timestamp::from_nanos(looks * 2 * PATIENCE.as_nanos() as u64)
    })
}

fn info() -> RunInfo {
    RunInfo { name: "hall".to_owned(), seed: 1, started_at_unix_ns: 0, testbed: TESTBED.to_owned() }
}

/// The network in memory, with a clock.
struct Ticking {
    network: VirtualNetwork,
    now: Clock,
}

impl Network for Ticking {
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone> {
        self.network.set_now((self.now)());
        self.network.with(action)
    }
}

#[test]
fn faults_end_the_same_in_real_time_virtual_time_and_replay() {
    for (misdeed, reason, flood) in [
        (Misdeed::Panic, "panicked: by design", 0),
        (
            Misdeed::Flood,
            "it gave more than 1000 instructions in a second, its `instructions_per_second`",
            1000,
        ),
        (Misdeed::Hang, "did not return from a call within 30 s", 0),
    ] {
        let expected = Recorded { faults: vec![(id(), reason.to_owned())], flood, any_later: false };
        let played = misdeed.in_virtual_time();
        assert_eq!(Recorded::of(&played), expected, "{misdeed:?} in virtual time");
        assert_eq!(Recorded::of(&misdeed.in_real_time()), expected, "{misdeed:?} in real time");
        let replayed = misdeed.in_a_replay(&played);
        assert_eq!(Recorded::of(&replayed), expected, "{misdeed:?} in a replay");
        // At exactly the same times.
        let times = |events: &[Stamped]| {
            let is_its = |e: &&Stamped| matches!(e.event, Event::Decision(_) | Event::PluginFault { .. });
            events.iter().filter(is_its).map(|event| event.at).collect::<Vec<_>>()
        };
        assert_eq!(times(&replayed), times(&played), "{misdeed:?}");
        assert_stops(&played);
    }
}

#[test]
fn a_program_that_floods_or_hangs_is_cut_off_in_a_replay() {
    for (misdeed, reason, flood) in [
        (
            Misdeed::Flood,
            "it gave more than 1000 instructions in a second, its `instructions_per_second`",
            1000,
        ),
        (Misdeed::Hang, "was not done with mark ", 0),
    ] {
        let played = misdeed.in_virtual_time();
        let recorded = Recorded::of(&misdeed.in_a_replay_as_a_program(&played));
        assert!(
            matches!(&recorded.faults[..], [(who, why)] if *who == id() && why.starts_with(reason)),
            "{recorded:?}"
        );
        assert_eq!((recorded.flood, recorded.any_later), (flood, false), "{misdeed:?}");
    }
}

/// Asserts that the robot moved, and stopped long before its command would have timed out.
fn assert_stops(events: &[Stamped]) {
    let speeds: Vec<_> = events
        .iter()
        .filter_map(|event| match &event.event {
            Event::Robot(context) => Some((event.at, context.sensors.velocity.linear)),
            _ => None,
        })
        .collect();
    let fault = events.iter().find(|event| matches!(event.event, Event::PluginFault { .. })).unwrap().at;
    assert!(speeds.iter().any(|(at, speed)| *at <= fault && *speed > 0.0), "{speeds:?}");
    let (before, since) = (Duration::from_millis(250), Duration::from_millis(350));
    let soon = speeds.iter().find(|(at, _)| *at >= fault + before).unwrap();
    assert!(soon.0 <= fault + since && soon.1 == 0.0, "cut off at {fault}: {speeds:?}");
    assert!(speeds.iter().all(|(at, speed)| *at <= soon.0 || *speed == 0.0), "{speeds:?}");
}
