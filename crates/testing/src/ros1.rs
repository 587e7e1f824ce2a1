//! Debian's ROS 1 for tests: a master on a port of its own, tools and nodes, all of which end with the test.

use std::{
    env, fs,
    path::Path,
    process::{Command, Stdio},
};

use cotorra_ros1::{Endpoint, Node, NodeConfig};
use tempfile::TempDir;

use crate::process::{Process, until};

/// A ROS master with its own port and directory.
pub struct Ros {
    port: u16,
    directory: TempDir,
    core: Option<Process>,
}

impl Ros {
    /// Starts a master.
    pub fn start() -> Option<Self> {
        if !Self::is_installed() {
            return None;
        }
        let mut ros = Self { port: 0, directory: tempfile::tempdir().unwrap(), core: None };
        for port in crate::free_ports().take(10) {
            ros.port = port;
            match ros.try_restart() {
                Ok(()) => return Some(ros),
                Err(complaint) => eprintln!("no master on port {port}: {complaint}"),
            }
        }
        panic!("no master on any of ten ports");
    }

    /// ROS's tools and nodes, with a master that runs already.
    pub fn with_master(port: u16) -> Option<Self> {
        Self::is_installed().then(|| Self { port, directory: tempfile::tempdir().unwrap(), core: None })
    }

    /// Whether ROS is installed. Prints a message if not, and fails in CI.
    fn is_installed() -> bool {
        crate::found(Path::new("/usr/bin/rosmaster").exists(), "ROS 1", "scripts/test names the packages")
    }

    /// Returns the master's port.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Stops the master.
    pub fn stop(&mut self) {
        self.core = None;
    }

    /// Ends the master, and starts an empty one: the program that roscore starts, without the processes around it,
    /// which would outlive a failed test.
    pub fn restart(&mut self) {
        self.try_restart().unwrap();
    }

    /// Starts the master. Fails if the port is taken: the master reports that, and hangs instead of ending.
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
        // Its first line would start another Python.
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

    /// Starts a tool of ROS, or a program by path.
    pub fn spawn(&self, program: &str, args: &[&str]) -> Process {
        Process::spawn(&mut self.command(program, args)).unwrap()
    }

    /// Starts a node written in Python.
    pub fn python(&self, name: &str, source: &str) -> Process {
        let file = self.directory().join(name);
        fs::write(&file, source).unwrap();
        self.spawn("/usr/bin/python3", &["-u", file.to_str().unwrap()])
    }

    /// Runs a tool of ROS. Returns its output, or its errors if it fails.
    pub fn try_run(&self, tool: &str, args: &[&str]) -> Result<String, String> {
        let output = self.command(tool, args).stdin(Stdio::null()).output().unwrap();
        let printed = String::from_utf8_lossy(&output.stdout).into_owned();
        let complained = String::from_utf8_lossy(&output.stderr);
        if output.status.success() { Ok(printed) } else { Err(printed + &complained) }
    }

    /// Runs a tool of ROS and returns its output.
    pub fn run(&self, tool: &str, args: &[&str]) -> String {
        self.try_run(tool, args).unwrap_or_else(|complaint| panic!("{tool} {args:?}: {complaint}"))
    }

    /// Starts a node of this crate.
    pub fn node(&self, name: &str, namespace: &str) -> Node {
        self.node_with(name, namespace, &[])
    }

    /// Starts a node of this crate, with arguments.
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
