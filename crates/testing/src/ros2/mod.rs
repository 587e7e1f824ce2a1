//! Other implementations of DDS for tests, as processes that end with the test.

use std::{
    env,
    fs::{self, File},
    net::Ipv4Addr,
    path::{Path, PathBuf},
    process::Command,
    sync::atomic::{AtomicU32, Ordering},
};

use cotorra_ros2::{
    Middleware, Node, NodeConfig,
    messages::{Header, LaserScan, Time},
};

use crate::{
    process::{Process, until},
    python,
};

/// A scan with recognizable values.
pub fn scan() -> LaserScan {
    LaserScan {
        header: Header::new(Time { sec: 3, nanosec: 9 }, "laser"),
        angle_increment: 0.5,
        range_max: 12.0,
        ranges: vec![1.5, f32::INFINITY, 2.25],
        ..LaserScan::default()
    }
}

/// Publishes repeatedly until the peer prints a text.
pub fn publishing_until_printed(mut publish: impl FnMut(), peer: &Process, what: &str) {
    until(&format!("it prints `{what}`"), || {
        publish();
        peer.output().contains(what)
    });
}

/// A domain and namespace of one test, on loopback only.
pub struct Meeting {
    domain: u16,
    namespace: String,
}

impl Default for Meeting {
    fn default() -> Self {
        Self::new()
    }
}

impl Meeting {
    /// Returns a meeting that no other test has.
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let (process, count) = (std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        // The ports of these domains are below the ephemeral ports of the kernel. Tests that share a domain by chance have
        // other topics.
        let domain = u16::try_from(1 + process % 100).unwrap();
        Self { domain, namespace: format!("/test_{process}_{count}") }
    }

    pub fn domain(&self) -> u16 {
        self.domain
    }

    /// Returns the namespace.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// Starts a node of this crate.
    pub fn node(&self, name: &str) -> Node {
        let config = NodeConfig {
            domain: self.domain,
            namespace: self.namespace.clone(),
            middleware: Middleware::Dds { interface: Some(Ipv4Addr::LOCALHOST.into()) },
            ..NodeConfig::new(name)
        };
        Node::new(config).unwrap()
    }

    /// Starts Cyclone DDS: see `cyclone.py`. A topic is in the namespace, unless it is one of DDS's own. Returns `None`,
    /// and prints a message, if it is not installed.
    pub fn cyclone(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Option<Process> {
        let only_loopback = "<General><Interfaces><NetworkInterface name=\"lo\" multicast=\"false\"/></Interfaces>\
            </General><Discovery><Peers><Peer address=\"127.0.0.1\"/></Peers></Discovery>";
        let mut command = Command::new("/usr/bin/env");
        command.arg(format!("CYCLONEDDS_URI={only_loopback}"));
        self.cyclone_by(command, action, kind, &self.dds_topic(topic), qos)
    }

    /// The same, behind a command that runs its arguments, on all interfaces. The topic has its DDS name.
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

    /// Starts Fast DDS: see `fastdds.cpp`. Returns `None`, and prints a message, if it is not installed.
    pub fn fast_dds(&self, action: &str, kind: &str, topic: &str, qos: &str) -> Option<Process> {
        self.fast_dds_by(Command::new("/usr/bin/env"), action, kind, &self.dds_topic(topic), qos)
    }

    /// The same, behind a command that runs its arguments. The topic has its DDS name, the service its ROS name.
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

/// Returns the Fast DDS peer, compiled if it is not yet.
fn fast_dds_program() -> Option<PathBuf> {
    let header = Path::new("/usr/include/fastdds/dds/domain/DomainParticipant.hpp");
    if !crate::found(header.exists(), "Fast DDS", "scripts/test installs it") {
        return None;
    }
    let wanted = include_str!("fastdds.cpp");
    // Beside the program under test, so that test programs share it, and each target directory has its own.
    let tests = env::current_exe().unwrap();
    let folder = tests.parent().unwrap();
    let (source, program) = (folder.join("fastdds.cpp"), folder.join("fastdds"));
    // One test compiles, and the others wait for it.
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

/// Starts a peer, and waits until it prints that it is ready.
pub fn start(command: &mut Command) -> Process {
    let process = Process::spawn(command).unwrap();
    until("the peer is ready", || {
        let output = process.output();
        assert!(!output.contains("Traceback"), "{output}");
        output.contains("ready")
    });
    process
}
