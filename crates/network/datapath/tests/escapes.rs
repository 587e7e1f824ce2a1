//! Tries many ways out of a node as a confined program, as root and as an ordinary user. None may succeed.
#![allow(clippy::unwrap_used, reason = "tests may panic")]

mod harness;
mod ways;

use std::{
    env, fs,
    io::{BufRead, BufReader, Read, Write},
    os::{
        linux::net::SocketAddrExt,
        unix::{
            fs::{MetadataExt, PermissionsExt},
            net::{SocketAddr, UnixListener},
        },
    },
    path::{Path, PathBuf},
    process::{self, Child, Command, ExitCode, Stdio},
};

use cotorra_datapath::{Confinement, Namespace, SpawnOptions};
use cotorra_graph::LinuxCapability;
use ways::{Facts, WAYS};

const SECRET: &str = "a-secret-of-the-core";

type Test = (&'static str, fn());
const TESTS: &[Test] = &[
    ("a confined program cannot escape", confined_programs_cannot_escape),
    ("the escapes succeed without confinement", escapes_succeed_without_confinement),
    (
        "a confined program works in its own folder with the files made visible to it",
        confined_programs_work_in_their_folder,
    ),
    ("a confined program has the capabilities granted to it", granted_capabilities_are_held),
    ("hidden files stay hidden when they are replaced", replaced_files_stay_hidden),
    ("files that only root may read stay closed, whatever their names", files_of_root_stay_closed),
    ("what a program of root's makes belongs to another user", made_files_belong_to_another_user),
    ("a closed file or program is rejected with advice", closed_files_are_rejected),
];

fn main() -> ExitCode {
    if let Ok(which) = env::var(ways::HELPER) {
        return ways::attempt_all(which == "all");
    }
    let privilege =
        cotorra_datapath::enter_user_namespace_if_needed().expect("tests need user namespaces or root");
    harness::run(TESTS, [(format!("{privilege:?}"), ())], |test, ()| test())
}

/// Folder of a run with a history and a VNF's folder, beside the testbed file's folder.
struct Place {
    root: PathBuf,
}

impl Place {
    fn new() -> Self {
        let root = env::temp_dir().join(format!("cotorra-escapes-{}", process::id()));
        let _ = fs::remove_dir_all(&root);
        fs::create_dir_all(root.join("testbed/runs/1/vnfs/one")).unwrap();
        let place = Self { root: root.canonicalize().unwrap() };
        fs::write(place.history(), "history").unwrap();
        fs::write(place.testbed().join("data"), "data").unwrap();
        place
    }

    fn testbed(&self) -> PathBuf {
        self.root.join("testbed")
    }

    fn history(&self) -> PathBuf {
        self.root.join("testbed/runs/1/history.sqlite")
    }

    fn home(&self) -> PathBuf {
        self.root.join("testbed/runs/1/vnfs/one")
    }

    fn confinement(&self, capabilities: &[LinuxCapability]) -> Confinement {
        Confinement {
            home: self.home(),
            readable: vec![self.testbed()],
            // A run hides its own folder, and then that of all runs.
            hidden: vec![self.root.join("testbed/runs/1"), self.root.join("testbed/runs")],
            capabilities: capabilities.to_vec(),
            processes: 500,
            memory_bytes: 512 << 20,
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.root);
    }
}

/// Processes, sockets and memory of this process, which a program must not reach.
struct Outside {
    bystander: Child,
    _sockets: [UnixListener; 2],
    _node: Namespace,
    facts: Facts,
}

impl Outside {
    fn new(place: &Place) -> Self {
        let mut bystander = Command::new("sleep");
        let bystander = bystander.arg("1000").env("SECRET", SECRET).stdin(Stdio::null()).spawn().unwrap();
        let name = format!("cotorra-escapes-{}", process::id());
        let abstract_socket =
            UnixListener::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        let path = place.root.join("socket");
        let socket = UnixListener::bind(&path).unwrap();
        let facts = Facts {
            core: process::id(),
            bystander: bystander.id(),
            history: place.history(),
            testbed: place.testbed(),
            home: place.home(),
            socket: path,
            abstract_socket: name,
            shared_memory: ways::make_shared_memory(),
            network: fs::read_link("/proc/thread-self/ns/net").unwrap(),
        };
        Self { bystander, _sockets: [abstract_socket, socket], _node: Namespace::new().unwrap(), facts }
    }
}

impl Drop for Outside {
    fn drop(&mut self) {
        ways::remove_shared_memory(self.facts.shared_memory);
        let _ = self.bystander.kill();
        let _ = self.bystander.wait();
    }
}

fn output_of(namespace: &Namespace, mut command: Command, confinement: Option<&Confinement>) -> String {
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    let options = SpawnOptions { confinement, hostname: Some("node"), ..SpawnOptions::default() };
    let mut child = namespace.spawn(command, options).unwrap();
    let mut output = String::new();
    child.pipes().1.unwrap().read_to_string(&mut output).unwrap();
    output
}

/// Returns the names of the ways that led out.
fn attempt(confinement: Option<&Confinement>, place: &Place, all: bool) -> Vec<String> {
    let outside = Outside::new(place);
    let mut command = Command::new(env::current_exe().unwrap());
    command.env_clear().env(ways::HELPER, if all { "all" } else { "harmless" });
    command.envs(outside.facts.to_environment()).env("PATH", "/usr/bin:/bin");
    let output = output_of(&Namespace::new().unwrap(), command, confinement);
    print!("{output}");
    assert!(output.ends_with("all were tried\n"), "{output}");
    output.lines().filter_map(|line| line.strip_suffix(": ESCAPED")).map(str::to_owned).collect()
}

fn confined_programs_cannot_escape() {
    assert!(WAYS.len() >= 20);
    let place = Place::new();
    let escaped = attempt(Some(&place.confinement(&[])), &place, true);
    assert!(escaped.is_empty(), "by {escaped:?}");
    assert_eq!(fs::read_to_string(place.history()).unwrap(), "history");
    assert_eq!(fs::read_dir(place.testbed()).unwrap().count(), 2, "the data and the runs");
}

fn escapes_succeed_without_confinement() {
    let place = Place::new();
    let escaped = attempt(None, &place, false);
    println!("{} of {} ways", escaped.len(), WAYS.len());
    for way in [
        "open the history",
        "write the history",
        "write into the testbed file's folder",
        "connect to a socket of the host",
        "have a capability",
    ] {
        assert!(escaped.iter().any(|escaped| escaped == way), "{way}: {escaped:?}");
    }
}

fn shell(script: &str) -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", script]);
    command
}

fn confined_programs_work_in_their_folder() {
    let place = Place::new();
    let namespace = Namespace::new().unwrap();
    let confinement = place.confinement(&[]);
    let output = |script: &str| {
        let mut command = shell(script);
        command.current_dir(place.testbed());
        output_of(&namespace, command, Some(&confinement))
    };
    let home = place.home();
    assert_eq!(
        output("cat data; echo; pwd; echo $HOME; echo $TMPDIR").lines().collect::<Vec<_>>(),
        ["data", place.testbed().to_str().unwrap(), home.to_str().unwrap(), home.to_str().unwrap(),]
    );
    assert_eq!(output("mkdir ~/a && echo kept >~/a/file && mv ~/a ~/b && cat ~/b/file"), "kept\n");
    assert_eq!(fs::read_to_string(home.join("b/file")).unwrap(), "kept\n");
    let file = format!("/tmp/of-{}", std::process::id());
    let script = format!("echo gone >{file} && ln {file} /dev/shm/b 2>/dev/null; cat {file}");
    assert_eq!(output(&script), "gone\n");
    assert!(!Path::new(&file).exists());
    assert_eq!(output("head -c 3 /dev/urandom | wc -c; echo x >/dev/null; cat /dev/null; ls runs"), "3\n1\n");
    // Its children see only each other.
    assert_eq!(
        output("ls /proc | grep -c '^[0-9]' || true").trim().parse::<u32>().unwrap().min(1),
        proc_is_there()
    );
    assert_eq!(output("exit 3; echo"), "");
    let missing = SpawnOptions { confinement: Some(&confinement), ..SpawnOptions::default() };
    let missing = namespace.spawn(Command::new("/no/such/program"), missing).unwrap_err().to_string();
    assert!(missing.contains("/no/such/program"), "{missing}");
}

/// Whether a confined program has a `/proc` here. It has none where parts of it are hidden, as in many containers.
fn proc_is_there() -> u32 {
    let mounts = fs::read_to_string("/proc/mounts").unwrap();
    let is_over = |line: &&str| line.split(' ').nth(1).is_some_and(|at| at.starts_with("/proc/"));
    let hidden = mounts.lines().filter(is_over).count() > 0;
    let is_ordinary = fs::read_to_string("/proc/self/uid_map").is_ok_and(|map| !map.contains("4294967295"));
    u32::from(!(hidden && is_ordinary))
}

/// Runs a script that begins with `read go`, and changes files before it goes on.
fn output_after(script: &str, confinement: &Confinement, folder: &Path, change: impl FnOnce()) -> String {
    let mut command = shell(&format!("echo begun; read go; {script}"));
    command.current_dir(folder).stdin(Stdio::piped()).stdout(Stdio::piped());
    let options = SpawnOptions { confinement: Some(confinement), ..SpawnOptions::default() };
    let mut child = Namespace::new().unwrap().spawn(command, options).unwrap();
    let (stdin, stdout, _) = child.pipes();
    let mut stdout = BufReader::new(stdout.unwrap());
    let mut begun = String::new();
    stdout.read_line(&mut begun).unwrap();
    assert_eq!(begun, "begun\n");
    change();
    stdin.unwrap().write_all(b"go\n").unwrap();
    let mut output = String::new();
    stdout.read_to_string(&mut output).unwrap();
    output
}

fn replaced_files_stay_hidden() {
    let place = Place::new();
    let key = place.testbed().join("key");
    fs::write(&key, "old key").unwrap();
    let mut confinement = place.confinement(&[]);
    confinement.hidden.push(key.clone());
    let output = output_after("cat key new renamed; cat data", &confinement, &place.testbed(), || {
        let new = place.testbed().join("new");
        fs::write(&new, "new key").unwrap();
        fs::rename(&key, place.testbed().join("renamed")).unwrap();
        fs::rename(&new, &key).unwrap();
    });
    assert_eq!(output, "data");
}

fn is_root() -> bool {
    fs::read_to_string("/proc/self/uid_map").is_ok_and(|map| map.contains("4294967295"))
}

fn close(path: &Path, mode: u32) {
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
}

fn files_of_root_stay_closed() {
    if !is_root() {
        return println!("skipped: programs of an ordinary user have its rights to files");
    }
    let place = Place::new();
    // A folder that is shown as a whole, and one that only root may enter, whose files are shown.
    let [etc, closed] = ["etc", "closed"].map(|name| place.testbed().join(name));
    for folder in [&etc, &closed] {
        fs::create_dir_all(folder.join("inner")).unwrap();
        fs::write(folder.join("shadow"), SECRET).unwrap();
        close(&folder.join("shadow"), 0o600);
        fs::write(folder.join("inner/secret"), SECRET).unwrap();
        close(&folder.join("inner"), 0o700);
        fs::write(folder.join("open"), "open").unwrap();
    }
    close(&closed, 0o700);
    let mut confinement = place.confinement(&[]);
    confinement.readable.push(closed);
    let script = "cat etc/shadow etc/renamed etc/late etc/inner/secret closed/shadow closed/inner/secret; \
                  cat etc/open closed/open";
    let output = output_after(script, &confinement, &place.testbed(), || {
        fs::rename(etc.join("shadow"), etc.join("renamed")).unwrap();
        let late = etc.join("late");
        fs::write(&late, "").unwrap();
        close(&late, 0o600);
        fs::write(&late, SECRET).unwrap();
    });
    assert_eq!(output, "openopen");
}

fn made_files_belong_to_another_user() {
    if !is_root() {
        return println!("skipped: programs of an ordinary user are that user");
    }
    let place = Place::new();
    let script = "cp /bin/sh ~/sh; chmod 4755 ~/sh; id -u && echo said >/dev/stdout; echo said >/dev/stderr";
    let mut command = shell(script);
    command.stderr(Stdio::null());
    let output = output_of(&Namespace::new().unwrap(), command, Some(&place.confinement(&[])));
    let (user, said) = output.split_once('\n').unwrap();
    assert!(user.parse::<u32>().unwrap() >= 1_000_000_000, "{output}");
    assert_eq!(said, "said\n");
    let made = fs::metadata(place.home().join("sh")).unwrap();
    assert_eq!((made.uid().to_string().as_str(), made.mode() & 0o7000), (user, 0));
    // It can go on there when it starts again.
    let again = shell("rm ~/sh && echo again");
    assert_eq!(output_of(&Namespace::new().unwrap(), again, Some(&place.confinement(&[]))), "again\n");
}

fn closed_files_are_rejected() {
    if !is_root() {
        return println!("skipped: programs of an ordinary user have its rights to files");
    }
    let place = Place::new();
    let namespace = Namespace::new().unwrap();
    let key = place.testbed().join("closed");
    fs::write(&key, "#!/bin/sh").unwrap();
    close(&key, 0o700);
    let rejected = |command: Command, confinement: &Confinement| {
        let options = SpawnOptions { confinement: Some(confinement), ..SpawnOptions::default() };
        namespace.spawn(command, options).unwrap_err().to_string()
    };
    let mut confinement = place.confinement(&[]);
    let program = rejected(Command::new(&key), &confinement);
    assert!(program.contains("chmod o+rx"), "{program}");
    confinement.readable.push(key);
    let file = rejected(shell("true"), &confinement);
    assert!(file.contains("chmod o+r "), "{file}");
}

fn granted_capabilities_are_held() {
    let place = Place::new();
    let namespace = Namespace::new().unwrap();
    let capabilities = |confinement: &Confinement| {
        let script = "grep -E '^Cap(Eff|Prm|Bnd|Amb)' /proc/self/status | cut -f2 | sort -u";
        output_of(&namespace, shell(script), Some(confinement))
    };
    if proc_is_there() == 0 {
        return println!("skipped: no /proc here");
    }
    assert_eq!(capabilities(&place.confinement(&[])), "0000000000000000\n");
    let given = [LinuxCapability::NetRaw, LinuxCapability::NetAdmin];
    assert_eq!(capabilities(&place.confinement(&given)), "0000000000003000\n");
    let ping = shell("ip link set lo up && ping -c 1 -W 60 127.0.0.1 >/dev/null && echo pong");
    if Path::new("/usr/bin/ping").exists() && Path::new("/sbin/ip").exists() {
        assert_eq!(output_of(&namespace, ping, Some(&place.confinement(&given))), "pong\n");
    }
}
