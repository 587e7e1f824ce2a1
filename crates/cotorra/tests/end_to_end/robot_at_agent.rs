//! A TurtleBot 2 whose serial ports are at an agent. The emulated base goes on at its last speed without commands.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs::{self, File},
    io::{Read, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use cotorra_testing::turtlebot::{Emulated, Place, Wall, room};
use parking_lot::{Condvar, Mutex};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::{
    harness::{Run, agent_program, cotorra, events, kill, stderr, stdout, wait_until},
    one_robot::{NAVIGATED, robot, testbed},
    turtlebot::{CORRIDOR, LOCALIZED, map, node},
};

/// Most velocities that a base gets of a core that is gone. One is repeated each 50 ms for 600 ms; the core may also have given
/// new ones in these 600 ms, each of which replaces the last at once, for every packet of navigation.
const MOST_AFTER: usize = 12 + 1 + 12;

/// Time for which the robot follows a velocity.
const COMMAND_TIMEOUT: Duration = Duration::from_millis(600);

/// A network between the agent and the core, which can hold back what it carries to the agent, and deliver it late.
struct Network {
    address: SocketAddr,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    is_held: Mutex<bool>,
    changed: Condvar,
    /// Bytes that were delivered to the agent.
    delivered: AtomicUsize,
}

impl Network {
    /// Leads from an address of its own to the core's.
    fn to(core: SocketAddr) -> Self {
        let listener = TcpListener::bind((core.ip(), 0)).unwrap();
        let network = Self { address: listener.local_addr().unwrap(), state: Arc::default() };
        let state = Arc::clone(&network.state);
        thread::spawn(move || {
            for agents in listener.incoming().map_while(Result::ok) {
                // Without a core, the agent is refused.
                let Ok(cores) = TcpStream::connect(core) else { continue };
                carry(agents.try_clone().unwrap(), cores.try_clone().unwrap(), None);
                carry(cores, agents, Some(Arc::clone(&state)));
            }
        });
        network
    }

    /// Holds back everything to the agent from now on, or delivers what was held.
    fn hold(&self, is_held: bool) {
        *self.state.is_held.lock() = is_held;
        self.state.changed.notify_all();
    }

    /// Returns the number of bytes that were delivered to the agent.
    fn delivered(&self) -> usize {
        self.state.delivered.load(Ordering::SeqCst)
    }
}

/// Carries bytes one way. What `state` holds back waits in memory, also if its sender is gone.
fn carry(mut from: TcpStream, mut to: TcpStream, state: Option<Arc<State>>) {
    let (send, waiting) = mpsc::channel::<Vec<u8>>();
    thread::spawn(move || {
        let mut piece = [0; 16 * 1024];
        while let Ok(read @ 1..) = from.read(&mut piece) {
            if send.send(piece[..read].to_vec()).is_err() {
                break;
            }
        }
    });
    thread::spawn(move || {
        for bytes in waiting {
            if let Some(state) = &state {
                state.changed.wait_while(&mut state.is_held.lock(), |is_held| *is_held);
            }
            if to.write_all(&bytes).is_err() {
                break;
            }
            if let Some(state) = &state {
                state.delivered.fetch_add(bytes.len(), Ordering::SeqCst);
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
}

/// An agent with an emulated robot, and the addresses of its core.
struct Lab {
    folder: TempDir,
    emulated: Emulated,
    network: Network,
    core: SocketAddr,
    agent: Option<Child>,
}

impl Lab {
    /// A robot that can drive straight on for longer than any test takes.
    fn in_the_open() -> Self {
        Self::new(room((-5.0, -5.0), (600.0, 8.0)), Place { x: 2.0, y: 3.0, heading: 0.0 })
    }

    fn new(walls: Vec<Wall>, start: Place) -> Self {
        let folder = TempDir::new().unwrap();
        let emulated = Emulated::start(folder.path(), walls, start);
        // At a loopback address of its own, no other process takes the port before the core does.
        let [_, a, b, c] = std::process::id().to_be_bytes();
        let core =
            TcpListener::bind(SocketAddr::from(([127, a | 0xC0, b, c], 0))).unwrap().local_addr().unwrap();
        let network = Network::to(core);
        let lab = Self { folder, emulated, network, core, agent: None };
        let enrolled = lab.cotorra(&["agent", "enrol", "r1", "--core", &lab.network.address.to_string()]);
        assert!(enrolled.status.success(), "{}", stderr(&enrolled));
        lab
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs a command of cotorra on the lab's authority.
    fn cotorra(&self, arguments: &[&str]) -> Output {
        let mut command = cotorra(arguments);
        command.arg("--authority").arg(self.path("authority")).current_dir(self.folder.path());
        command.output().unwrap()
    }

    fn start_agent(&mut self) {
        let log = File::options().create(true).append(true).open(self.path("agent.txt")).unwrap();
        let mut command = Command::new(agent_program());
        command.arg("run").arg(self.path("r1.agent")).arg("--state").arg(self.path("state"));
        self.agent = Some(command.stdout(Stdio::null()).stderr(log).spawn().unwrap());
    }

    /// Sends a signal to the agent, and waits for its end.
    fn end_agent(&mut self, signal: &str) {
        let mut agent = self.agent.take().unwrap();
        kill(signal, &agent.id().to_string());
        agent.wait().unwrap();
    }

    fn testbed(&self, rest: &str, services: &str) -> PathBuf {
        testbed(self.folder.path(), "carried", &node(&self.emulated, &format!("agent: r1, {rest}")), services)
    }

    fn arguments(&self) -> [String; 4] {
        let authority = self.path("authority").display().to_string();
        ["--agents".into(), self.core.to_string(), "--authority".into(), authority]
    }

    fn run(&self, file: &Path) -> Run {
        Run::start(file, &self.arguments().each_ref().map(String::as_str))
    }

    /// Starts a run after an earlier one of the same test.
    fn run_again(&self, before: &Run, file: &Path) -> Run {
        before.another(file, &self.arguments().each_ref().map(String::as_str))
    }

    fn moves(&self) -> bool {
        self.emulated.state().kobuki.velocity() != (0.0, 0.0)
    }

    /// Returns the number of controls that the base got so far.
    fn controls(&self) -> usize {
        self.emulated.state().kobuki.controls.len()
    }

    /// Waits until the base has read everything that waits in its port. Returns the number of controls that it got so far.
    fn controls_read(&self) -> usize {
        let now = self.emulated.state().now;
        wait_until(|| self.emulated.state().now > now);
        self.controls()
    }

    /// Waits until the base is stopped. Returns the number of velocities that it got after the first `before` controls.
    fn velocities_until_stop(&self, before: usize) -> usize {
        wait_until(|| !self.moves());
        let controls = &self.emulated.state().kobuki.controls;
        controls[before..].iter().filter(|(_, speed, _)| *speed != 0).count()
    }

    /// Returns the time of the base's last stop, on its own clock.
    fn stopped_at(&self) -> Duration {
        let controls = &self.emulated.state().kobuki.controls;
        let last = controls.iter().rposition(|(_, speed, _)| *speed != 0).unwrap();
        controls[last + 1].0
    }

    /// Waits until the agent has closed the robot's ports, which stops the lidar's motor.
    fn wait_for_closed_ports(&self) {
        wait_until(|| self.emulated.state().rplidar.motor == 0);
    }

    fn log(&self) -> String {
        fs::read_to_string(self.path("agent.txt")).unwrap_or_default()
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        if let Some(mut agent) = self.agent.take() {
            let _ = agent.kill();
            let _ = agent.wait();
        }
        if thread::panicking() {
            eprintln!("--- the agent's log:\n{}", self.log());
        }
    }
}

#[test]
fn robot_at_an_agent_walks_to_its_goal_and_its_pose_and_scans_are_kept() {
    let mut lab = Lab::new(room(CORRIDOR.0, CORRIDOR.1), Place { x: 1.0, y: 1.0, heading: 0.0 });
    map(lab.folder.path());
    lab.start_agent();
    let sensors = "sensors: { pack: { kind: battery }, turns: { kind: lidar } }";
    let mut run = lab.run(&lab.testbed(sensors, LOCALIZED));
    wait_until(|| robot(&run)["sensors"]["pose"]["source"] == "localization");
    wait_until(|| robot(&run)["health"] == json!([]));
    let last = |sensor: &str| {
        let all = run.get("/api/v1/robots/tb/sensors");
        all.as_array().unwrap().iter().find(|one| one["declared"]["sensor"] == sensor).unwrap()["last"]
            .clone()
    };
    wait_until(|| last("pack").is_object() && last("turns").is_object());
    assert_eq!(last("pack")["values"]["voltage_v"], 16.0);
    assert_eq!(last("turns")["data"]["width"], 360);
    run.report();
    let place = lab.emulated.state().kobuki.place;
    assert!((place.x - 4.0).hypot(place.y - 1.0) < 0.4, "it is at its last waypoint: {place:?}");
    let robots = events(&run.folder, "robot");
    let x = |event: &Value| event.pointer("/sensors/pose/x").and_then(Value::as_f64);
    let far = robots.iter().filter_map(x).fold(0.0, f64::max);
    assert!(far > 3.0, "{far} {:?}", robots.last());
    assert!(events(&run.folder, "sensor").iter().any(|event| event["sensor"] == "turns"));
    // The run leaves both devices at rest.
    lab.wait_for_closed_ports();
    assert!(!lab.moves());
}

#[test]
fn robot_stops_when_its_core_is_killed_or_silent_and_no_late_command_moves_it() {
    let mut lab = Lab::in_the_open();
    lab.start_agent();
    let file = lab.testbed("position: [2, 3]", NAVIGATED);
    let mut run = lab.run(&file);
    wait_until(|| lab.moves());

    // Nothing arrives of the core any more, which goes on. The commands are held back, and delivered late.
    lab.network.hold(true);
    let before = lab.controls_read();
    let velocities = lab.velocities_until_stop(before);
    assert!(velocities <= MOST_AFTER, "{velocities}");

    // The core is killed meanwhile. What it said last comes 600 ms later.
    run.signal("KILL");
    run.wait();
    let killed = lab.emulated.state().now;
    wait_until(|| lab.emulated.state().now > killed + COMMAND_TIMEOUT);
    let (before, delivered) = (lab.controls_read(), lab.network.delivered());
    lab.network.hold(false);
    wait_until(|| lab.network.delivered() > delivered);
    lab.wait_for_closed_ports();
    assert_eq!(lab.velocities_until_stop(before), 0, "a command of before moves nothing");

    // The next run drives it again. It is stopped first, as its ports are opened anew.
    let before = lab.controls();
    let mut run = lab.run_again(&run, &file);
    wait_until(|| lab.moves());
    assert_eq!(lab.emulated.state().kobuki.controls[before].1, 0);

    // A core that is killed while it drives.
    let at = lab.emulated.state().now;
    run.signal("KILL");
    let before = lab.controls_read();
    let velocities = lab.velocities_until_stop(before);
    run.wait();
    let stopped = lab.stopped_at().saturating_sub(at);
    eprintln!("stopped {stopped:?} after the kill, with {velocities} velocities after it");
    assert!(velocities <= MOST_AFTER, "{velocities}");
    let mut run = lab.run_again(&run, &file);
    wait_until(|| lab.moves());

    // Ctrl-C of the run leaves it at rest.
    run.signal_group("INT");
    run.wait();
    lab.wait_for_closed_ports();
    assert!(!lab.moves());
}

#[test]
fn robot_stops_with_its_agent_however_that_ends_and_goes_on_with_the_next() {
    let mut lab = Lab::in_the_open();
    lab.start_agent();
    let run = lab.run(&lab.testbed("position: [2, 3]", NAVIGATED));
    for signal in ["TERM", "KILL", "TERM", "KILL"] {
        wait_until(|| lab.moves());
        let from = lab.emulated.state().kobuki.place.x;
        wait_until(|| lab.emulated.state().kobuki.place.x > from + 0.3);
        let at = lab.emulated.state().now;
        lab.end_agent(signal);
        let before = lab.controls_read();
        // The emulated base does not stop by itself.
        assert_eq!(lab.velocities_until_stop(before), 0);
        eprintln!("{signal}: stopped {:?} after the signal", lab.stopped_at().saturating_sub(at));
        lab.wait_for_closed_ports();
        wait_until(|| robot(&run)["health"] == json!(["silent"]));
        lab.start_agent();
    }
    wait_until(|| lab.moves());
    // Odometry goes on where it was.
    wait_until(|| {
        let pose = robot(&run)["sensors"]["pose"]["x"].as_f64().unwrap();
        (pose - lab.emulated.state().kobuki.place.x).abs() < 0.3
    });
    assert!(lab.emulated.state().kobuki.place.x > 3.0);
}

#[test]
fn missing_port_at_an_agent_is_reported_with_its_remedy_and_used_once_it_is_there() {
    let mut lab = Lab::in_the_open();
    lab.emulated.unplug_base();
    lab.start_agent();
    let run = lab.run(&lab.testbed("position: [2, 3]", NAVIGATED));
    let port = lab.emulated.base().display().to_string();
    let remedy = format!("robot tb: agent `r1`: there is no `{port}`: plug the device in");
    wait_until(|| events(&run.folder, "notice").iter().any(|event| event.to_string().contains(&remedy)));
    wait_until(|| robot(&run)["health"] == json!(["absent"]));
    assert!(lab.log().contains(&format!("there is no `{port}`: plug the device in")), "{}", lab.log());
    lab.emulated.plug_base();
    wait_until(|| lab.moves());
    wait_until(|| robot(&run)["health"] == json!([]));
    // A cable that breaks while it drives is a fault, as at the core's own ports.
    lab.emulated.unplug_base();
    wait_until(|| robot(&run)["health"] == json!(["silent"]));
    let before = lab.controls();
    lab.emulated.plug_base();
    wait_until(|| lab.controls() > before);
    assert_eq!(lab.emulated.state().kobuki.controls[before].1, 0, "the first command is a stop");
    wait_until(|| lab.moves());
}

#[test]
fn run_needs_an_enrolled_agent_of_its_robot_and_virtual_time_none() {
    let lab = Lab::in_the_open();
    let file = lab.testbed("position: [2, 3]", NAVIGATED);
    let file = file.to_str().unwrap();
    let revoked = lab.cotorra(&["agent", "revoke", "r1"]);
    assert!(revoked.status.success(), "{}", stderr(&revoked));
    let rejected = lab.cotorra(&["run", file, "--headless", "--until", "1s"]);
    assert!(!rejected.status.success());
    let said = stderr(&rejected).replace('│', " ");
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(said.contains("agent `r1` is not enrolled, or is revoked"), "{said}");
    let planned = lab.cotorra(&["run", file, "--dry-run"]);
    let needed = format!("tb  agent r1  {}", lab.emulated.base().display());
    assert!(stdout(&planned).contains(&needed), "{}", stdout(&planned));
    let simulated = lab.cotorra(&["run", file, "--simulate", "--headless", "--until", "10s"]);
    assert!(simulated.status.success(), "{}", stderr(&simulated));
}
