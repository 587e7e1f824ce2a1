//! A Slurm cluster on this machine for tests, from Debian's `slurm-wlm` and `munge`.
//!
//! Its daemons need neither root nor systemd. Its folder and its ports are its own, and it ends with the value.

use std::{
    fs,
    ops::RangeInclusive,
    os::unix::fs::PermissionsExt,
    path::Path,
    process::{Command, Output},
    thread,
    time::Duration,
};

use tempfile::TempDir;

use crate::{
    process::{Process, until},
    program,
};

/// A running cluster, whose nodes have one CPU each. Stopped on drop.
pub struct Slurm {
    folder: TempDir,
    /// The daemon of each node.
    nodes: Vec<Option<Process>>,
    /// The other daemons.
    _daemons: [Process; 2],
}

impl Slurm {
    /// Starts a cluster of `node1`, `node2` and so on. Returns when all nodes are idle.
    pub fn start(nodes: usize) -> Option<Self> {
        let daemons = ["munged", "slurmctld", "slurmd", "sbatch"].map(program);
        let remedy = "apt-get install -y --no-install-recommends slurm-wlm munge";
        if !crate::found(daemons.iter().all(Option::is_some), "slurmctld", remedy) {
            return None;
        }
        let [Some(munged), Some(slurmctld), Some(slurmd), _] = daemons else { return None };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        // Other users need not reach the socket.
        fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
        let munged = Process::spawn(&mut munge(&munged, path)).unwrap();
        until("munged listens", || path.join("munge.socket").exists());
        configure(path, 1..=nodes);
        let daemon = |program: &Path, arguments: &[&str]| {
            Process::spawn(with_cluster(Command::new(program), path).arg("-D").args(arguments)).unwrap()
        };
        let slurmctld = daemon(&slurmctld, &[]);
        let nodes = (1..=nodes).map(|node| Some(daemon(&slurmd, &["-N", &format!("node{node}")]))).collect();
        let cluster = Self { folder, nodes, _daemons: [munged, slurmctld] };
        until("all nodes are idle", || {
            let states = cluster.output("sinfo", &["--noheader", "--Node", "--format=%T"]).stdout;
            String::from_utf8_lossy(&states).lines().filter(|state| *state == "idle").count()
                == cluster.nodes.len()
        });
        Some(cluster)
    }

    /// Returns a command whose Slurm is this cluster.
    pub fn command(&self, program: &str) -> Command {
        with_cluster(Command::new(program), self.folder.path())
    }

    /// Runs a command of Slurm to its end.
    pub fn output(&self, program: &str, arguments: &[&str]) -> Output {
        self.command(program).args(arguments).output().unwrap()
    }

    /// Waits until a job has ended, however that was and however long it takes.
    pub fn wait(&self, job: &str) {
        let goes_on = || {
            let queue = self.output("squeue", &["--noheader", "--jobs", job]);
            assert!(queue.status.success(), "{queue:?}");
            !queue.stdout.is_empty()
        };
        while goes_on() {
            thread::sleep(Duration::from_millis(100));
        }
    }

    /// Returns the number of the node that runs a task of an array.
    pub fn node_of(&self, task: &str) -> usize {
        let tasks = self.output("squeue", &["--noheader", "--array", "--format=%K %N"]).stdout;
        let tasks = String::from_utf8(tasks).unwrap();
        let node = tasks.lines().find_map(|line| line.trim().strip_prefix(&format!("{task} node")));
        node.unwrap_or_else(|| panic!("task {task} does not run:\n{tasks}")).parse().unwrap()
    }

    /// Kills a node with all that runs on it, and reports it as down.
    pub fn kill(&mut self, node: usize) {
        let name = format!("node{node}");
        drop(self.nodes[node - 1].take());
        kill_those(&format!("SLURMD_NODENAME={name}"), &self.mark());
        let down = ["update", &format!("NodeName={name}"), "State=DOWN", "Reason=killed"];
        let told = self.output("scontrol", &down);
        assert!(told.status.success(), "{told:?}");
    }

    /// Returns the environment variable by which processes of this cluster are known.
    fn mark(&self) -> String {
        format!("SLURM_CONF={}", self.folder.path().join("slurm.conf").display())
    }
}

impl Drop for Slurm {
    fn drop(&mut self) {
        self.nodes.clear();
        kill_those(&self.mark(), &self.mark());
    }
}

fn with_cluster(mut command: Command, folder: &Path) -> Command {
    command.env("SLURM_CONF", folder.join("slurm.conf"));
    command
}

/// Returns the command of the daemon that vouches for users, with a key of its own.
fn munge(munged: &Path, folder: &Path) -> Command {
    let key = folder.join("munge.key");
    fs::write(&key, [7; 64]).unwrap();
    fs::set_permissions(&key, fs::Permissions::from_mode(0o400)).unwrap();
    let mut command = Command::new(munged);
    // Its folder may be one of a user, which it would reject.
    command.args(["--foreground", "--force"]);
    for (option, file) in [
        ("key-file", "munge.key"),
        ("socket", "munge.socket"),
        ("pid-file", "munged.pid"),
        ("seed-file", "munged.seed"),
        ("log-file", "munged.log"),
    ] {
        command.arg(format!("--{option}={}", folder.join(file).display()));
    }
    command
}

fn configure(folder: &Path, nodes: RangeInclusive<usize>) {
    let user = Command::new("id").arg("-un").output().unwrap().stdout;
    let (user, path) = (String::from_utf8(user).unwrap(), folder.display());
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap();
    let (user, host) = (user.trim(), host.trim());
    let mut ports = crate::free_ports();
    let port = ports.next().unwrap();
    // A requeued job waits for as long as a credential may be in use.
    let mut text = format!(
        "ClusterName=test\n\
         SlurmctldHost={host}(127.0.0.1)\n\
         SlurmctldPort={port}\n\
         AuthType=auth/munge\n\
         AuthInfo=socket={path}/munge.socket,cred_expire=5\n\
         SlurmUser={user}\n\
         SlurmdUser={user}\n\
         StateSaveLocation={path}/state\n\
         SlurmdSpoolDir={path}/spool-%n\n\
         SlurmctldPidFile={path}/slurmctld.pid\n\
         SlurmdPidFile={path}/slurmd-%n.pid\n\
         SlurmctldLogFile={path}/slurmctld.log\n\
         SlurmdLogFile={path}/slurmd-%n.log\n\
         ProctrackType=proctrack/pgid\n\
         TaskPlugin=task/none\n\
         JobAcctGatherType=jobacct_gather/none\n\
         MpiDefault=none\n\
         SlurmdParameters=config_overrides\n\
         SchedulerParameters=sched_interval=1,bf_interval=1\n\
         SelectType=select/cons_tres\n\
         SelectTypeParameters=CR_Core\n\
         ReturnToService=2\n\
         PartitionName=all Nodes=ALL Default=YES\n"
    );
    fs::create_dir(folder.join("state")).unwrap();
    for (node, port) in nodes.zip(ports) {
        fs::create_dir(folder.join(format!("spool-node{node}"))).unwrap();
        text += &format!("NodeName=node{node} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=1\n");
    }
    fs::write(folder.join("slurm.conf"), text).unwrap();
}

/// Kills all processes that have both environment variables, and their parents that watch over them.
fn kill_those(variable: &str, other: &str) {
    let has = |environment: &[u8], variable: &str| {
        environment.split(|byte| *byte == 0).any(|entry| entry == variable.as_bytes())
    };
    for process in fs::read_dir("/proc").unwrap().flatten() {
        let path = process.path();
        let environment = fs::read(path.join("environ")).unwrap_or_default();
        if !has(&environment, variable) || !has(&environment, other) {
            continue;
        }
        let parent = watcher(&path);
        for pid in parent.into_iter().chain(process.file_name().into_string()) {
            // It may have ended meanwhile.
            let _ = Command::new("kill").args(["-KILL", &pid]).output();
        }
    }
}

/// Returns the process `slurmstepd` that started this one, if one did.
fn watcher(process: &Path) -> Option<String> {
    let status = fs::read_to_string(process.join("status")).ok()?;
    let parent = status.lines().find_map(|line| line.strip_prefix("PPid:"))?.trim().to_owned();
    let name = fs::read_to_string(format!("/proc/{parent}/comm")).ok()?;
    (name.trim() == "slurmstepd").then_some(parent)
}
