//! Starts the real program, and examines its output and files.
//!
//! scripts/test runs these tests as root and, from a copy, as an ordinary user. The program and the project's files are
//! therefore found through the environment.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    cell::RefCell,
    collections::BTreeSet,
    env,
    ffi::{OsStr, OsString},
    fs::{self, File},
    io::{BufRead, BufReader, Read},
    os::unix::{fs::MetadataExt, process::CommandExt},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Output, Stdio},
    sync::mpsc,
    thread,
    time::Duration,
};

use cotorra_testing::lab::Lab;
pub use cotorra_testing::{project_file, stderr, stdout};
use serde_json::Value;
use tempfile::TempDir;

/// Returns a command for the program, without cotorra's own environment variables.
pub fn cotorra<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Command {
    let program = env::var_os("COTORRA_BIN").unwrap_or_else(|| env!("CARGO_BIN_EXE_cotorra").into());
    let mut command = cotorra_testing::command(program);
    command.args(arguments);
    command
}

/// Returns a search path for programs with this program first, for scripts that call it.
pub fn path_with_cotorra() -> OsString {
    let program = PathBuf::from(cotorra([""; 0]).get_program());
    let own = program.parent().unwrap().to_owned();
    let path = env::var_os("PATH").unwrap_or_default();
    env::join_paths([own].into_iter().chain(env::split_paths(&path))).unwrap()
}

/// Runs the program to its end, and returns its output.
pub fn output<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Output {
    cotorra(arguments).output().unwrap()
}

/// Returns the events of these kinds in a run's history.
pub fn events(folder: &Path, kinds: &str) -> Vec<Value> {
    let folder = folder.to_str().unwrap();
    let listed = output(["history", "events", folder, "--kinds", kinds, "--limit", "1000000", "--json"]);
    assert!(listed.status.success(), "{}", stderr(&listed));
    stdout(&listed).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Returns the agent's program, which is built beside cotorra's.
pub fn agent_program() -> PathBuf {
    let program = PathBuf::from(cotorra([""; 0]).get_program()).with_file_name("cotorra-agent");
    assert!(program.exists(), "{} is missing: build the workspace", program.display());
    program
}

/// Lock of the one test whose run has the machine for itself. Concurrent runs would make each other late.
pub struct Alone {
    _lock: File,
}

fn alone() -> Alone {
    let name = format!("cotorra-end-to-end-{}.lock", fs::metadata("/proc/self").unwrap().uid());
    let lock = File::create(env::temp_dir().join(name)).unwrap();
    if lock.try_lock().is_err() {
        eprintln!("waits until the run of another test has ended, which may be one of another checkout");
        lock.lock().unwrap();
    }
    Alone { _lock: lock }
}

/// Access to the API of a run.
#[derive(Clone, Copy, PartialEq)]
enum Access {
    /// Every program of this machine, if the run has no token.
    Open,
    /// The run's user.
    OfUser,
}

/// A running `cotorra run`, killed on drop.
pub struct Run {
    child: Child,
    /// Processes of the run that were found so far.
    seen: RefCell<BTreeSet<u32>>,
    /// Lines of standard error.
    lines: mpsc::Receiver<String>,
    pub api: String,
    /// Lines of standard error until the run was up.
    pub notes: Vec<String>,
    pub folder: PathBuf,
    out: TempDir,
    /// `None` if another run of the same test holds the lock, or the test does not need it.
    _alone: Option<Alone>,
}

impl Run {
    /// Starts `cotorra run` and waits until it is up.
    pub fn start(testbed: &Path, arguments: &[&str]) -> Self {
        Self::start_with(testbed, arguments, |_| {})
    }

    /// Does the same as [`Self::start`] after `change` to the command.
    pub fn start_with(testbed: &Path, arguments: &[&str], change: impl FnOnce(&mut Command)) -> Self {
        Self::launch(testbed, arguments, change, Access::Open, Some(alone()))
    }

    /// Does the same as [`Self::start`] beside runs of other tests, for a test that holds however late packets are.
    pub fn start_beside(testbed: &Path, arguments: &[&str]) -> Self {
        Self::start_beside_with(testbed, arguments, |_| {})
    }

    /// Does the same as [`Self::start_beside`] after `change` to the command.
    pub fn start_beside_with(testbed: &Path, arguments: &[&str], change: impl FnOnce(&mut Command)) -> Self {
        Self::launch(testbed, arguments, change, Access::Open, None)
    }

    /// Starts `cotorra run` as a user does: its API is this user's alone.
    pub fn start_private(testbed: &Path, arguments: &[&str]) -> Self {
        Self::launch(testbed, arguments, |_| {}, Access::OfUser, None)
    }

    /// Starts `cotorra run` beside this run.
    pub fn another(&self, testbed: &Path, arguments: &[&str]) -> Self {
        self.another_with(testbed, arguments, |_| {})
    }

    /// Does the same as [`Self::another`] after `change` to the command.
    pub fn another_with(
        &self,
        testbed: &Path,
        arguments: &[&str],
        change: impl FnOnce(&mut Command),
    ) -> Self {
        Self::launch(testbed, arguments, change, Access::Open, None)
    }

    fn launch(
        testbed: &Path,
        arguments: &[&str],
        change: impl FnOnce(&mut Command),
        access: Access,
        alone: Option<Alone>,
    ) -> Self {
        let out = TempDir::new().unwrap();
        let mut command = cotorra(["run", "--headless", "--out"]);
        command.arg(out.path()).arg(testbed).args(arguments);
        if !arguments.contains(&"--api") {
            command.args(["--api", "127.0.0.1:0"]);
        }
        change(&mut command);
        let has_token = command.get_envs().any(|(name, token)| name == "COTORRA_TOKEN" && token.is_some());
        if access == Access::Open && !has_token {
            command.arg("--no-token");
        }
        // In its own process group, as a shell starts it, so that Ctrl-C can be sent to the whole group.
        let mut child =
            command.process_group(0).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let stderr = BufReader::new(child.stderr.take().unwrap());
        let (sender, lines) = mpsc::channel();
        thread::spawn(move || stderr.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
        let mut notes = Vec::new();
        let (api, folder) = loop {
            let Ok(line) = lines.recv() else { panic!("the run did not come up:\n{}", notes.join("\n")) };
            if let Some((api, folder)) = line.strip_prefix("API on ").and_then(|l| l.split_once(", run in "))
            {
                break (api.to_owned(), PathBuf::from(folder));
            }
            notes.push(line);
        };
        Self { child, seen: RefCell::default(), lines, api, notes, folder, out, _alone: alone }
    }

    /// Returns the API's address without its scheme.
    pub fn address(&self) -> &str {
        self.api.strip_prefix("http://").unwrap()
    }

    /// Gets an existing path of the API.
    pub fn get(&self, path: &str) -> Value {
        let (status, body) = self.ask(path, None);
        assert_eq!(status, 200, "{path}: {body}");
        body
    }

    /// Gets a path of the API with a token. Returns the status and the body.
    pub fn ask(&self, path: &str, token: Option<&str>) -> (u16, Value) {
        let mut request = agent().get(format!("{}{path}", self.api));
        if let Some(token) = token {
            request = request.header("Authorization", format!("Bearer {token}"));
        }
        let mut answer = request.call().unwrap();
        (answer.status().as_u16(), answer.body_mut().read_json().unwrap())
    }

    /// Gets the bytes at a path of the API, and a function that returns the value of a header.
    pub fn bytes(&self, path: &str) -> (Vec<u8>, impl Fn(&str) -> String + use<>) {
        let mut answer = agent().get(format!("{}{path}", self.api)).call().unwrap();
        assert_eq!(answer.status(), 200, "{path}");
        let headers = answer.headers().clone();
        let bytes = answer.body_mut().read_to_vec().unwrap();
        (bytes, move |name| headers[name].to_str().unwrap().to_owned())
    }

    /// Deletes a resource. Returns the status.
    pub fn delete(&self, path: &str) -> u16 {
        agent().delete(format!("{}{path}", self.api)).call().unwrap().status().as_u16()
    }

    /// Posts a body to a path of the API. Returns the status and the body of the response.
    pub fn post(&self, path: &str, body: &str) -> (u16, Value) {
        self.post_as("", path, body)
    }

    /// Does the same as [`Self::post`] with a token.
    pub fn post_as(&self, token: &str, path: &str, body: &str) -> (u16, Value) {
        let request = agent().post(format!("{}{path}", self.api)).header("Content-Type", "application/json");
        let request = match token {
            "" => request,
            token => request.header("Authorization", format!("Bearer {token}")),
        };
        let mut answer = request.send(body).unwrap();
        (answer.status().as_u16(), answer.body_mut().read_json().unwrap())
    }

    /// Follows the API's stream of events from now on.
    pub fn follow(&self) -> impl Iterator<Item = Value> + use<> {
        self.follow_only("")
    }

    /// Follows the API's stream of the events that a query selects.
    pub fn follow_only(&self, query: &str) -> impl Iterator<Item = Value> + use<> {
        let answer = agent().get(format!("{}/api/v1/events{query}", self.api)).call().unwrap();
        let lines = BufReader::new(answer.into_body().into_reader()).lines().map_while(Result::ok);
        lines.filter_map(|line| line.strip_prefix("data: ").map(|event| serde_json::from_str(event).unwrap()))
    }

    /// Waits for the first service time, and returns it.
    pub fn wait_for_service(&self) -> Value {
        let mut found = Value::Null;
        wait_until(|| {
            found = self.get("/api/v1/measurements/service-times?limit=1")["items"][0].clone();
            found.is_object()
        });
        found
    }

    /// Sends a signal to the run.
    pub fn signal(&self, name: &str) {
        kill(name, &self.pid().to_string());
    }

    /// Sends a signal to the run's process group, as a terminal does at Ctrl-C.
    pub fn signal_group(&self, name: &str) {
        kill(name, &format!("-{}", self.pid()));
    }

    /// Waits until lines with these texts are on standard error, in any order.
    pub fn wait_for_lines<const N: usize>(&self, with: [&str; N]) {
        let mut left = Vec::from(with);
        let all = self.lines.iter().any(|line| {
            left.retain(|with| !line.contains(with));
            left.is_empty()
        });
        assert!(all, "it ended without: {left:?}");
    }

    /// Waits for the end of the run. Returns the exit status, standard output, and the rest of standard error.
    pub fn wait(&mut self) -> (ExitStatus, String, String) {
        let mut printed = String::new();
        self.child.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
        let status = self.child.wait().unwrap();
        (status, printed, self.lines.iter().collect::<Vec<_>>().join("\n"))
    }

    /// Waits for the end of a run that must leave a report, whether its figures are valid or not. Returns the summary and
    /// standard output.
    pub fn report(&mut self) -> (Value, String) {
        let (status, printed, errors) = self.wait();
        assert!(matches!(status.code(), Some(0 | 3)), "{status}\n{errors}");
        let summary = fs::read_to_string(self.folder.join("summary.json")).unwrap();
        (serde_json::from_str(&summary).unwrap(), printed)
    }

    /// Returns the id of the run's process.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Returns the living processes of this run, including itself: its descendants, and those that were its descendants at
    /// an earlier call.
    pub fn processes(&self) -> BTreeSet<u32> {
        let lives = |pid: &u32| parent_of(*pid).is_some();
        let is_below = |pid: &u32| {
            let mut at = *pid;
            while at != self.pid() {
                match parent_of(at) {
                    Some(parent) if parent > 0 => at = parent,
                    _ => return false,
                }
            }
            true
        };
        let mut seen = self.seen.borrow_mut();
        seen.extend(all_processes().filter(is_below));
        seen.retain(lives);
        seen.clone()
    }

    /// Returns the inodes of the network namespaces of its nodes.
    pub fn namespaces(&self) -> BTreeSet<u64> {
        let testbed = self.get("/api/v1/testbed");
        let nodes = testbed["graph"]["nodes"].as_array().unwrap().iter();
        let namespaces = nodes.filter_map(|node| {
            let node = self.get(&format!("/api/v1/network/nodes/{}", node["id"].as_str().unwrap()));
            Some(fs::metadata(node["namespace"].as_str()?).unwrap().ino())
        });
        namespaces.collect()
    }

    /// Returns the control groups of this run.
    pub fn control_groups(&self) -> Vec<PathBuf> {
        let name = format!("cotorra-{}", self.pid());
        let trees = fs::read_dir("/sys/fs/cgroup").into_iter().flatten().flatten().map(|tree| tree.path());
        let mut places = vec![PathBuf::from("/sys/fs/cgroup")];
        places.extend(trees);
        places.into_iter().map(|place| place.join(&name)).filter(|group| group.exists()).collect()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        // Most tests have already waited for its end.
        let _ = self.child.kill();
        let _ = self.child.wait();
        if thread::panicking() {
            let log = fs::read_to_string(self.folder.join("logs/cotorra.log")).unwrap_or_default();
            eprintln!("--- the run's log, in {}:\n{log}", self.out.path().display());
        }
    }
}

/// Sends a signal to a process, or to a process group if `-` precedes its id.
pub fn kill(signal: &str, target: &str) {
    assert!(Command::new("kill").args(["-s", signal, "--", target]).status().unwrap().success());
}

pub fn agent() -> ureq::Agent {
    ureq::Agent::config_builder().http_status_as_error(false).proxy(None).build().new_agent()
}

fn all_processes() -> impl Iterator<Item = u32> {
    fs::read_dir("/proc").unwrap().flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok())
}

/// Returns the parent of a living process.
fn parent_of(pid: u32) -> Option<u32> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let mut after_name = stat.rsplit(')').next()?.split_whitespace();
    let state = after_name.next()?;
    after_name.next()?.parse().ok().filter(|_| !matches!(state, "Z" | "X"))
}

/// Whether any process is in one of these network namespaces, or holds it open.
pub fn are_held(namespaces: &BTreeSet<u64>) -> bool {
    let is_one = |path: &Path| fs::metadata(path).is_ok_and(|file| namespaces.contains(&file.ino()));
    all_processes().any(|pid| {
        let open = fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
        is_one(Path::new(&format!("/proc/{pid}/ns/net")))
            || open.map(|fd| fd.path()).any(|path| is_one(&path))
    })
}

/// Waits until a condition holds that depends on the kernel or another process.
#[allow(clippy::disallowed_methods, reason = "other processes run on the wall clock")]
pub fn wait_until(mut done: impl FnMut() -> bool) {
    while !done() {
        thread::sleep(Duration::from_millis(20));
    }
}

/// Returns the file of the corridor, which most tests run.
pub fn corridor() -> PathBuf {
    project_file("testbeds/corridor.yaml")
}

/// Writes a copy of the corridor to a folder, with `end` instead of its plug-ins.
pub fn corridor_ending_in(end: &str, folder: &Path) -> PathBuf {
    let text = fs::read_to_string(corridor()).unwrap();
    let map = project_file("testbeds/maps/corridor.yaml");
    let (before, _) = text.split_once("\nplugins:").unwrap();
    let before = before.replace("maps/corridor.yaml", map.to_str().unwrap());
    let file = folder.join("testbed.yaml");
    fs::write(&file, format!("{before}\n{end}")).unwrap();
    file
}

/// Returns a testbed of a robot between two radio units, with this walk. Its signal depends on the seed.
pub fn between_two_units(walk: &str) -> String {
    Lab { shadowing_db: 4, walk, ..Lab::default() }.to_string()
}
