//! Other implementations of DDS for tests, as processes that end with the test; and what waits for them.

use std::{
    env,
    fs::{self, File},
    net::Ipv4Addr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::atomic::{AtomicU32, Ordering},
};

use cotorra_ros2::{
    Middleware, Node, NodeConfig,
    messages::{Header, LaserScan, Time},
};

use crate::process::{Process, until};

/// A scan that is like no other.
pub fn scan() -> LaserScan {
    LaserScan {
        header: Header { stamp: Time { sec: 3, nanosec: 9 }, frame_id: "laser".to_owned() },
        angle_increment: 0.5,
        range_max: 12.0,
        ranges: vec![1.5, f32::INFINITY, 2.25],
        ..LaserScan::default()
    }
}

/// Publishes over and over until it prints that.
pub fn publishing_until_printed(mut publish: impl FnMut(), peer: &Process, what: &str) {
    until(&format!("it prints `{what}`"), || {
        publish();
        peer.output().contains(what)
    });
}

/// A place for nodes to meet, on loopback only, where no other test is.
pub struct Meeting {
    domain: u16,
    namespace: String,
}

impl Meeting {
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let (process, count) = (std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        // The ports of these domains are below those that the kernel hands out. Who meets there by chance speaks of
        // other topics.
        let domain = u16::try_from(1 + process % 100).unwrap();
        Self { domain, namespace: format!("/test_{process}_{count}") }
    }

    /// The domain.
    #[allow(dead_code, reason = "who else uses this file starts nodes elsewhere")]
    pub fn domain(&self) -> u16 {
        self.domain
    }

    /// The namespace.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// A node of this crate.
    pub fn node(&self, name: &str) -> Node {
        let config = NodeConfig {
            domain: self.domain,
            namespace: self.namespace.clone(),
            middleware: Middleware::Dds { interface: Some(Ipv4Addr::LOCALHOST.into()) },
            ..NodeConfig::new(name)
        };
        Node::new(config).unwrap()
    }

    /// Starts Cyclone DDS: see `cyclone.py`. A topic is one of the meeting's namespace, if it is none of DDS's own.
    /// `None`, and a message, where it is not installed.
    pub fn cyclone(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Option<Process> {
        let only_loopback = "<General><Interfaces><NetworkInterface name=\"lo\" multicast=\"false\"/></Interfaces>\
            </General><Discovery><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery>";
        let mut command = Command::new("/usr/bin/env");
        command.arg(format!("CYCLONEDDS_URI={only_loopback}"));
        self.cyclone_by(command, action, kind, &self.dds_topic(topic), qos)
    }

    /// The same, by a command that runs what follows it, on all interfaces. The topic is as DDS calls it.
    pub fn cyclone_by(
        &self,
        mut command: Command,
        action: &str,
        kind: &str,
        topic: &str,
        qos: &str,
    ) -> Option<Process> {
        command.arg(python("cyclonedds", "Cyclone DDS")?).args(["-u", "-c", include_str!("cyclone.py")]);
        command.args([&self.domain.to_string(), action, kind, topic, qos]);
        Some(start(&mut command))
    }

    /// Starts Fast DDS: see `fastdds.cpp`. `None`, and a message, where it is not installed.
    pub fn fast_dds(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Option<Process> {
        self.fast_dds_by(Command::new("/usr/bin/env"), action, kind, &self.dds_topic(topic), qos)
    }

    /// The same, by a command that runs what follows it. The topic is as DDS calls it, the service as ROS does.
    pub fn fast_dds_by(
        &self,
        mut command: Command,
        action: &str,
        kind: &str,
        topic: &str,
        qos: &str,
    ) -> Option<Process> {
        command.arg(fast_dds_program()?).args([&self.domain.to_string(), action, kind, topic, qos]);
        Some(start(&mut command))
    }

    fn dds_topic(&self, topic: &str) -> String {
        if topic == "ros_discovery_info" { topic.to_owned() } else { format!("rt{}/{topic}", self.namespace) }
    }
}

/// The Python that has these modules. Says so if there is none; in CI, that is a failure.
pub fn python(modules: &str, what: &str) -> Option<PathBuf> {
    let python = env::var_os("COTORRA_PEERS").map_or_else(|| PathBuf::from("python3"), PathBuf::from);
    let import = format!("import {modules}");
    let there = Command::new(&python).args(["-c", &import]).stderr(Stdio::null()).status();
    found(there.is_ok_and(|status| status.success()), what).then_some(python)
}

/// The program that is Fast DDS, compiled where it is not yet.
fn fast_dds_program() -> Option<PathBuf> {
    if !found(Path::new("/usr/include/fastdds/dds/domain/DomainParticipant.hpp").exists(), "Fast DDS") {
        return None;
    }
    let wanted = include_str!("fastdds.cpp");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (source, program) = (folder.join("fastdds.cpp"), folder.join("fastdds"));
    // One test compiles, the others wait for it.
    let lock = File::create(folder.join("fastdds.lock")).unwrap();
    lock.lock().unwrap();
    if !program.exists() || fs::read_to_string(&source).is_ok_and(|compiled| compiled != wanted) {
        fs::write(&source, wanted).unwrap();
        let mut compiler = Command::new("c++");
        compiler.arg("-std=c++17").arg("-o").arg(&program).arg(source).args(["-lfastrtps", "-lfastcdr"]);
        assert!(compiler.status().unwrap().success(), "the compiler fails");
    }
    Some(program)
}

fn found(there: bool, what: &str) -> bool {
    if !there {
        assert!(env::var_os("CI").is_none(), "{what} is not installed: scripts/test does that");
        eprintln!("skipped: {what} is not installed (scripts/test does that)");
    }
    there
}

/// Starts a peer, and waits until it says that it is ready.
pub fn start(command: &mut Command) -> Process {
    let process = Process::spawn(command).unwrap();
    until("the peer is ready", || {
        let output = process.output();
        assert!(!output.contains("Traceback"), "{output}");
        output.contains("ready")
    });
    process
}
