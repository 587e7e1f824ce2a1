//! Debian's ROS 1 for tests: a master on a port of its own, tools and nodes, all gone when the test is over.

use std::{
    env, fs,
    net::TcpListener,
    path::Path,
    process::{Command, Stdio},
};

use cotorra_ros1::{Endpoint, Node, NodeConfig};
use tempfile::TempDir;

use crate::process::{Process, until};

/// A master with its own port and directory.
pub struct Ros {
    port: u16,
    directory: TempDir,
    core: Option<Process>,
}

/// Whether nobody has a port of loopback.
fn is_free(port: u16) -> bool {
    TcpListener::bind(("127.0.0.1", port)).is_ok()
}

impl Ros {
    /// A master; `None`, and a message, where ROS is not installed.
    pub fn start() -> Option<Self> {
        if !Self::is_installed() {
            return None;
        }
        // Below the ports that the kernel hands out, and another for each process of the tests.
        let first = 10_000 + std::process::id() % 20_000;
        let ports = (first..).map(|port| u16::try_from(port).unwrap()).filter(|port| is_free(*port));
        let mut ros = Self { port: 0, directory: tempfile::tempdir().unwrap(), core: None };
        for port in ports.take(10) {
            ros.port = port;
            match ros.try_restart() {
                Ok(()) => return Some(ros),
                Err(complaint) => eprintln!("no master on port {port}: {complaint}"),
            }
        }
        panic!("no master on any of ten ports from {first}");
    }

    /// ROS's tools and nodes, with another master that is there already.
    pub fn with_master(port: u16) -> Option<Self> {
        Self::is_installed().then(|| Self { port, directory: tempfile::tempdir().unwrap(), core: None })
    }

    /// Whether ROS is installed. Says so if not; in CI, that is a failure.
    fn is_installed() -> bool {
        let installed = Path::new("/usr/bin/rosmaster").exists();
        if !installed {
            assert!(env::var_os("CI").is_none(), "ROS 1 is not installed: scripts/test says which packages");
            eprintln!("skipped: ROS 1 is not installed (scripts/test says which packages)");
        }
        installed
    }

    /// The master's port.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Ends the master.
    pub fn stop(&mut self) {
        self.core = None;
    }

    /// Ends the master, and starts another that knows nothing. It is what roscore starts, without the processes
    /// around it, which would outlive a test that fails.
    pub fn restart(&mut self) {
        self.try_restart().unwrap();
    }

    /// Fails when the port is taken: the master says so, and then hangs instead of ending.
    fn try_restart(&mut self) -> Result<(), String> {
        self.core = None;
        let core = self.spawn("rosmaster", &["--core", "-p", &self.port.to_string()]);
        let node = self.node("waiting", "/");
        let is_refused = || core.output().contains("already in use");
        until("the master is there", || is_refused() || node.master().system_state().is_ok());
        if is_refused() {
            return Err(core.output());
        }
        self.core = Some(core);
        Ok(())
    }

    pub fn directory(&self) -> &Path {
        self.directory.path()
    }

    fn command(&self, program: &str, args: &[&str]) -> Command {
        let path = format!("/usr/bin:{}", env::var("PATH").unwrap_or_default());
        // Its first line would find another Python.
        let mut command = if program.contains('/') {
            Command::new(program)
        } else {
            let mut command = Command::new("/usr/bin/python3");
            command.arg("-u").arg(format!("/usr/bin/{program}"));
            command
        };
        command
            .args(args)
            .current_dir(self.directory())
            .env("PATH", path)
            .env("ROS_MASTER_URI", format!("http://127.0.0.1:{}", self.port))
            .env("ROS_IP", "127.0.0.1")
            .env("ROS_HOME", self.directory())
            .env_remove("ROS_HOSTNAME")
            .env_remove("ROS_NAMESPACE")
            .env_remove("PYTHONPATH");
        command
    }

    /// Starts a tool of ROS, or a program by its path.
    pub fn spawn(&self, program: &str, args: &[&str]) -> Process {
        Process::spawn(&mut self.command(program, args)).unwrap()
    }

    /// Starts a node written in Python.
    pub fn python(&self, name: &str, source: &str) -> Process {
        let file = self.directory().join(name);
        fs::write(&file, source).unwrap();
        self.spawn("/usr/bin/python3", &["-u", file.to_str().unwrap()])
    }

    /// What a tool of ROS prints; what it complains about if it fails.
    pub fn try_run(&self, tool: &str, args: &[&str]) -> Result<String, String> {
        let output = self.command(tool, args).stdin(Stdio::null()).output().unwrap();
        let printed = String::from_utf8_lossy(&output.stdout).into_owned();
        let complained = String::from_utf8_lossy(&output.stderr);
        if output.status.success() { Ok(printed) } else { Err(printed + &complained) }
    }

    /// What a tool of ROS prints.
    pub fn run(&self, tool: &str, args: &[&str]) -> String {
        self.try_run(tool, args).unwrap_or_else(|complaint| panic!("{tool} {args:?}: {complaint}"))
    }

    /// A node of this crate.
    pub fn node(&self, name: &str, namespace: &str) -> Node {
        self.node_with(name, namespace, &[])
    }

    /// A node of this crate, with arguments.
    pub fn node_with(&self, name: &str, namespace: &str, args: &[&str]) -> Node {
        let config = NodeConfig {
            namespace: namespace.to_owned(),
            master: Endpoint { host: "127.0.0.1".to_owned(), port: self.port },
            host: Some("127.0.0.1".to_owned()),
            ..NodeConfig::new(name)
        };
        Node::new(config.with_args(args).unwrap()).unwrap()
    }
}
