//! podman and Docker for tests, from Debian's `podman` and `docker.io`, with sockets and folders of their own.
//!
//! Both need root. They end with the fixture, and their containers with them.

use std::{
    fs,
    io::{Read as _, Write as _},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::Duration,
};

use cotorra_graph::EngineKind;
use parking_lot::Mutex;
use tempfile::TempDir;

use crate::program;

/// An image with busybox, which every engine of this module has.
pub const BUSYBOX: &str = "localhost/busybox:cotorra";
/// podman's settings. Its defaults need version 2 of control groups, and systemd.
const CONTAINERS_CONF: &str =
    "[engine]\nruntime = \"runc\"\ncgroup_manager = \"cgroupfs\"\nevents_logger = \"file\"\n";
/// The init process of Docker's package, for podman, too.
const INIT: &str = "docker-init";

/// An engine that serves its interface at a socket. Dropping it ends it, with all containers.
pub struct Containers {
    kind: EngineKind,
    folder: TempDir,
    daemon: Mutex<Option<Child>>,
}

impl Containers {
    /// Starts an engine of a kind; `None` without its packages, or without root.
    pub fn start(kind: EngineKind) -> Option<Self> {
        if !rustix::process::geteuid().is_root() {
            eprintln!("skipped: containers in a test need root");
            return None;
        }
        let programs = match kind {
            EngineKind::Docker => ["dockerd", "docker", "busybox", "runc"],
            _ => ["podman", "conmon", "busybox", "runc"],
        };
        let remedy = "apt-get install -y --no-install-recommends podman docker.io runc busybox-static";
        if !programs.iter().all(|name| crate::found(program(name).is_some(), name, remedy)) {
            return None;
        }
        let engine = Self { kind, folder: tempfile::tempdir().unwrap(), daemon: Mutex::new(None) };
        let folder = engine.folder.path();
        let init = program(INIT).map(|path| format!("init_path = {path:?}\n")).unwrap_or_default();
        fs::write(folder.join("containers.conf"), format!("{CONTAINERS_CONF}{init}")).unwrap();
        let storage = format!(
            "[storage]\ndriver = \"overlay\"\ngraphroot = \"{0}/storage\"\nrunroot = \"{0}/run\"\n",
            folder.display()
        );
        fs::write(folder.join("storage.conf"), storage).unwrap();
        engine.resume();
        engine.import(BUSYBOX, &busybox(folder), &[]);
        Some(engine)
    }

    /// Returns the socket of its interface.
    pub fn socket(&self) -> PathBuf {
        self.folder.path().join("socket")
    }

    /// Returns the variable by which cotorra finds the engine, with its value.
    pub fn variable(&self) -> (&'static str, String) {
        let name = if self.kind == EngineKind::Docker { "DOCKER_HOST" } else { "CONTAINER_HOST" };
        (name, format!("unix://{}", self.socket().display()))
    }

    /// Returns the variables with which the program `podman` uses the folders of this fixture.
    pub fn settings(&self) -> [(&'static str, PathBuf); 2] {
        let file = |name: &str| self.folder.path().join(name);
        [("CONTAINERS_CONF", file("containers.conf")), ("CONTAINERS_STORAGE_CONF", file("storage.conf"))]
    }

    /// Returns a command of the engine's own program.
    pub fn client(&self) -> Command {
        if self.kind == EngineKind::Docker {
            let mut client = Command::new("docker");
            client.arg("-H").arg(self.variable().1);
            return client;
        }
        let mut client = Command::new("podman");
        client.envs(self.settings());
        client
    }

    /// Makes an image of a tar archive, with changes such as `CMD ["/bin/sh"]`.
    pub fn import(&self, image: &str, archive: &Path, changes: &[&str]) {
        let mut client = self.client();
        client.arg("import").args(changes.iter().flat_map(|change| ["--change", *change]));
        let done = client.arg(archive).arg(image).output().unwrap();
        assert!(done.status.success(), "{}{}", String::from_utf8_lossy(&done.stderr), self.log());
    }

    /// Returns the names of all containers, running or not.
    pub fn names(&self) -> Vec<String> {
        let listed = self.client().args(["ps", "-a", "--format", "{{.Names}}"]).output().unwrap();
        assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
        String::from_utf8(listed.stdout).unwrap().lines().map(str::to_owned).collect()
    }

    /// Kills the process that serves the interface, without its containers.
    pub fn kill(&self) {
        if let Some(mut daemon) = self.daemon.lock().take() {
            daemon.kill().unwrap();
            daemon.wait().unwrap();
        }
    }

    /// Serves the interface again after [`Self::kill`], and waits until it answers.
    pub fn resume(&self) {
        let log =
            fs::OpenOptions::new().create(true).append(true).open(self.folder.path().join("log")).unwrap();
        let (folder, address) = (self.folder.path(), format!("unix://{}", self.socket().display()));
        let mut command = if self.kind == EngineKind::Docker {
            let mut command = Command::new(program("dockerd").unwrap());
            command.arg("--data-root").arg(folder.join("data")).arg("--exec-root").arg(folder.join("exec"));
            command.arg("--pidfile").arg(folder.join("pid")).args(["-H", &address]);
            command.args(["--iptables=false", "--ip-forward=false", "--ip-masq=false", "--bridge=none"]);
            command
        } else {
            let mut command = self.client();
            command.args(["system", "service", "--time=0", &address]);
            command
        };
        // Leftovers of a killed one would keep another from starting. Its containerd died with it.
        for left in ["pid", "exec/containerd/containerd.pid", "exec/containerd/containerd.sock"] {
            let _ = fs::remove_file(folder.join(left));
        }
        let _ = fs::remove_file(self.socket());
        // podman's monitors of containers leave files where they run.
        command.current_dir(folder).stdin(Stdio::null()).stdout(log.try_clone().unwrap()).stderr(log);
        let mut child = command.spawn().unwrap();
        while !self.answers() {
            assert!(child.try_wait().unwrap().is_none(), "the engine ended: {}", self.log());
            thread::sleep(Duration::from_millis(20));
        }
        *self.daemon.lock() = Some(child);
    }

    fn answers(&self) -> bool {
        let Ok(mut stream) = UnixStream::connect(self.socket()) else { return false };
        let mut answer = String::new();
        let asked = stream
            .write_all(b"GET /_ping HTTP/1.0\r\n\r\n")
            .and_then(|()| stream.read_to_string(&mut answer));
        asked.is_ok() && answer.ends_with("OK")
    }

    fn log(&self) -> String {
        fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }
}

impl Drop for Containers {
    fn drop(&mut self) {
        if self.daemon.lock().is_none() && !thread::panicking() {
            self.resume();
        }
        let Ok(listed) = self.client().args(["ps", "-aq"]).output() else { return };
        let ids = String::from_utf8_lossy(&listed.stdout).into_owned();
        // Killed first, because podman's `rm -f` waits ten seconds for an orderly end.
        for words in [&["kill"][..], &["rm", "-f"]] {
            let _ = self.client().args(words).args(ids.split_whitespace()).output();
        }
        if let Some(mut daemon) = self.daemon.lock().take() {
            let process = rustix::process::Pid::from_child(&daemon);
            let _ = rustix::process::kill_process(process, rustix::process::Signal::TERM);
            let _ = daemon.wait();
        }
    }
}

/// Writes an archive with busybox and its programs into a folder.
pub fn busybox(folder: &Path) -> PathBuf {
    let programs = folder.join("busybox/bin");
    fs::create_dir_all(&programs).unwrap();
    fs::copy(program("busybox").unwrap(), programs.join("busybox")).unwrap();
    let listed = Command::new("busybox").arg("--list").output().unwrap();
    for name in String::from_utf8(listed.stdout).unwrap().lines().filter(|name| *name != "busybox") {
        std::os::unix::fs::symlink("busybox", programs.join(name)).unwrap();
    }
    for empty in ["dev", "etc", "proc", "sys", "tmp"] {
        fs::create_dir_all(folder.join("busybox").join(empty)).unwrap();
    }
    archive(&folder.join("busybox"), &folder.join("busybox.tar"))
}

/// Writes a tar archive of all that is in a folder.
pub fn archive(root: &Path, to: &Path) -> PathBuf {
    let done = Command::new("tar").arg("-cf").arg(to).arg("-C").arg(root).arg(".").status().unwrap();
    assert!(done.success());
    to.to_owned()
}
