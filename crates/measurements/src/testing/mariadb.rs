//! A MariaDB server of the tests' own: its folder is temporary, it listens on loopback only, and it ends with the
//! process at the latest. From Debian's `mariadb-server`; without it, tests are skipped, but not where CI is set.
#![allow(
    dead_code,
    clippy::disallowed_methods,
    reason = "shared by tests and benchmarks; waits for a process"
)]

use std::{
    fs,
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::Weak,
    thread,
    time::Duration,
};

use parking_lot::Mutex;
use tempfile::TempDir;

/// A server. Ends when it is dropped.
pub struct MariaDb {
    folder: TempDir,
    port: u16,
    child: Mutex<Option<Child>>,
    databases: Mutex<u32>,
}

/// What tests of one process share.
static SHARED: Mutex<Weak<MariaDb>> = Mutex::new(Weak::new());

const PASSWORD: &str = "s3cret";

impl MariaDb {
    /// The server that tests share which do nothing to it but use a database of their own; `None` if there is none
    /// to be had.
    pub fn shared() -> Option<std::sync::Arc<Self>> {
        let mut shared = SHARED.lock();
        if let Some(server) = shared.upgrade() {
            return Some(server);
        }
        let server = std::sync::Arc::new(Self::start()?);
        *shared = std::sync::Arc::downgrade(&server);
        Some(server)
    }

    /// A server for one test.
    pub fn start() -> Option<Self> {
        if cfg!(not(feature = "mariadb")) {
            eprintln!("skipped: built without the feature `mariadb`");
            return None;
        }
        let Some(program) = program("mariadbd") else {
            assert!(
                std::env::var_os("CI").is_none(),
                "mariadbd is missing: apt-get install -y --no-install-recommends mariadb-server"
            );
            eprintln!("skipped: mariadbd is missing (apt-get install mariadb-server)");
            return None;
        };
        // In memory where that is possible: nobody turns the machine off in the middle of a test.
        let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        let port = free_port();
        let server = Self { folder, port, child: Mutex::new(None), databases: Mutex::new(0) };
        fs::create_dir(server.data()).unwrap();
        fs::create_dir(server.temporary()).unwrap();
        server.bootstrap(&program);
        server.resume();
        Some(server)
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// Its own: a server that starts removes the temporary tables of others that share the folder.
    fn temporary(&self) -> PathBuf {
        self.folder.path().join("tmp")
    }

    /// The tables of rights, and one user. `mariadb-install-db` takes as long as all of a test.
    fn bootstrap(&self, program: &Path) {
        let script = self.folder.path().join("bootstrap.sql");
        let share = |file: &str| fs::read_to_string(Path::new("/usr/share/mysql").join(file)).unwrap();
        let text = format!(
            // A statement a line.
            "CREATE DATABASE mysql;\nUSE mysql;\nSET @auth_root_socket = NULL;\n{}\n{}\nFLUSH PRIVILEGES;\n\
             CREATE USER 'cotorra'@'%' IDENTIFIED BY '{PASSWORD}';\nGRANT ALL ON *.* TO 'cotorra'@'%';\n",
            share("mysql_system_tables.sql"),
            share("mysql_system_tables_data.sql"),
        );
        fs::write(&script, text).unwrap();
        let done = self
            .command(program)
            .args(["--bootstrap", "--skip-networking"])
            .stdin(fs::File::open(&script).unwrap())
            .status()
            .unwrap();
        assert!(done.success(), "{}", self.log());
    }

    fn command(&self, program: &Path) -> Command {
        let log =
            fs::OpenOptions::new().create(true).append(true).open(self.folder.path().join("log")).unwrap();
        let mut command = match self::program("setpriv") {
            // Ends with the process, even one that is killed.
            Some(setpriv) => {
                let mut command = Command::new(setpriv);
                command.args(["--pdeathsig", "KILL"]).arg(program);
                command
            }
            None => Command::new(program),
        };
        command.arg("--no-defaults").arg(format!("--datadir={}", self.data().display()));
        command.arg(format!("--tmpdir={}", self.temporary().display()));
        if is_root() {
            command.arg("--user=root");
        }
        command
            .args(["--innodb-buffer-pool-size=256M", "--innodb-log-file-size=96M", "--skip-name-resolve"])
            .stdout(Stdio::null())
            .stderr(log);
        command
    }

    fn log(&self) -> String {
        fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    /// Starts it again after [`Self::stop`] or [`Self::kill`], and waits until it answers.
    pub fn resume(&self) {
        let program = program("mariadbd").unwrap();
        let mut command = self.command(&program);
        command
            .arg(format!("--socket={}", self.socket().display()))
            .arg(format!("--pid-file={}", self.folder.path().join("pid").display()))
            .args(["--bind-address=127.0.0.1", &format!("--port={}", self.port)]);
        // The signal comes when the thread ends that started it: one that stays.
        let (send, receive) = std::sync::mpsc::channel();
        thread::spawn(move || {
            send.send(command.spawn().unwrap()).unwrap();
            loop {
                thread::park();
            }
        });
        let mut child = receive.recv().unwrap();
        while TcpStream::connect(("127.0.0.1", self.port)).is_err() {
            assert!(child.try_wait().unwrap().is_none(), "mariadbd ended: {}", self.log());
            thread::sleep(Duration::from_millis(20));
        }
        *self.child.lock() = Some(child);
    }

    /// Ends it in order; connections are cut off.
    pub fn stop(&self) {
        self.end("-TERM");
    }

    /// Ends it as a loss of power would.
    pub fn kill(&self) {
        self.end("-KILL");
    }

    /// It stays, and does nothing any more, until [`Self::go_on`]. Returns when each of its threads has stopped.
    pub fn hang(&self) {
        self.signal("-STOP");
        let child = self.child.lock();
        let threads = format!("/proc/{}/task", child.as_ref().expect("it was started").id());
        // The state is behind the name, which is in parentheses.
        let has_stopped = |stat: String| stat.rsplit(')').next().is_some_and(|rest| rest.starts_with(" T"));
        let one_runs = || {
            let threads = fs::read_dir(&threads).unwrap().flatten();
            threads
                .map(|thread| fs::read_to_string(thread.path().join("stat")).unwrap_or_default())
                .any(|s| !has_stopped(s))
        };
        while one_runs() {
            thread::sleep(Duration::from_millis(1));
        }
    }

    pub fn go_on(&self) {
        self.signal("-CONT");
    }

    fn signal(&self, signal: &str) {
        if let Some(child) = &*self.child.lock() {
            let done = Command::new("kill").args([signal, &child.id().to_string()]).status();
            assert!(done.unwrap().success());
        }
    }

    fn end(&self, signal: &str) {
        self.signal(signal);
        if let Some(mut child) = self.child.lock().take() {
            child.wait().unwrap();
        }
    }

    pub fn socket(&self) -> PathBuf {
        self.folder.path().join("socket")
    }

    pub fn spool(&self) -> PathBuf {
        self.folder.path().join("spool")
    }

    /// The URL of a database.
    pub fn url(&self, database: &str) -> String {
        let (port, spool) = (self.port, self.spool());
        format!("mysql://cotorra:{PASSWORD}@127.0.0.1:{port}/{database}?spool={}", spool.display())
    }

    /// The URL of a database that nobody has.
    pub fn fresh(&self) -> String {
        let mut databases = self.databases.lock();
        *databases += 1;
        self.url(&format!("test{databases}"))
    }
}

impl Drop for MariaDb {
    fn drop(&mut self) {
        self.end("-KILL");
    }
}

fn is_root() -> bool {
    let own = fs::metadata("/proc/self").map(|folder| std::os::unix::fs::MetadataExt::uid(&folder));
    own.is_ok_and(|user| user == 0)
}

/// Below the ports that the kernel hands out: one of those may be a connection's when a server comes back to it.
fn free_port() -> u16 {
    let first = 10_000 + std::process::id() % 20_000;
    let mut ports = (first..).map(|port| u16::try_from(port).unwrap());
    ports.find(|port| TcpListener::bind(("127.0.0.1", *port)).is_ok()).unwrap()
}

fn program(name: &str) -> Option<PathBuf> {
    let path = std::env::var("PATH").unwrap_or_default() + ":/usr/sbin:/usr/bin";
    path.split(':').map(|folder| Path::new(folder).join(name)).find(|file| file.is_file())
}
