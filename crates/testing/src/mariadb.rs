//! A MariaDB server for tests, from Debian's `mariadb-server`.
//!
//! Its folder is temporary, it listens on loopback only, and it ends with the process at the latest.

use std::{
    fs,
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{Arc, Weak},
    thread,
    time::Duration,
};

use parking_lot::Mutex;
use tempfile::TempDir;

use crate::program;

/// A running server, stopped on drop.
pub struct MariaDb {
    folder: TempDir,
    port: u16,
    child: Mutex<Option<Child>>,
    databases: Mutex<u32>,
}

/// The server that the tests of one process share.
static SHARED: Mutex<Weak<MariaDb>> = Mutex::new(Weak::new());

const PASSWORD: &str = "s3cret";

impl MariaDb {
    /// Returns the server that is shared by tests which only use a database of their own on it.
    pub fn shared() -> Option<Arc<Self>> {
        let mut shared = SHARED.lock();
        if let Some(server) = shared.upgrade() {
            return Some(server);
        }
        let server = Arc::new(Self::start()?);
        *shared = Arc::downgrade(&server);
        Some(server)
    }

    /// Starts a server for one test.
    pub fn start() -> Option<Self> {
        if cfg!(not(feature = "databases")) {
            eprintln!("skipped: built without the feature `databases`");
            return None;
        }
        let program = program("mariadbd");
        let remedy = "apt-get install -y --no-install-recommends mariadb-server";
        if !crate::found(program.is_some(), "mariadbd", remedy) {
            return None;
        }
        let program = program?;
        // In memory where that is possible, for speed: no test needs the data to survive a loss of power.
        let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        let port = crate::free_ports().next().unwrap();
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

    /// The folder of temporary tables. A server that starts removes those of all others that share the folder.
    fn temporary(&self) -> PathBuf {
        self.folder.path().join("tmp")
    }

    /// Creates the tables of rights and one user. `mariadb-install-db` would take as long as a whole test.
    fn bootstrap(&self, program: &Path) {
        let script = self.folder.path().join("bootstrap.sql");
        let share = |file: &str| fs::read_to_string(Path::new("/usr/share/mysql").join(file)).unwrap();
        let text = format!(
            // The server expects one statement on each line.
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
        let mut command = match crate::program("setpriv") {
            // The server then ends with this process, even if this one is killed.
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

    /// Starts the server again after [`Self::stop`] or [`Self::kill`], and waits until it answers.
    pub fn resume(&self) {
        let program = program("mariadbd").unwrap();
        let mut command = self.command(&program);
        command
            .arg(format!("--socket={}", self.socket().display()))
            .arg(format!("--pid-file={}", self.folder.path().join("pid").display()))
            .args(["--bind-address=127.0.0.1", &format!("--port={}", self.port)]);
        // The kernel sends that signal when the starting *thread* ends, so this one never does.
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

    /// Shuts the server down in order. Connections are cut off.
    pub fn stop(&self) {
        self.end("-TERM");
    }

    /// Kills the server, as a crash would.
    pub fn kill(&self) {
        self.end("-KILL");
    }

    /// Freezes the server until [`Self::go_on`]. Returns when each of its threads has stopped.
    pub fn hang(&self) {
        self.signal("-STOP");
        let child = self.child.lock();
        let threads = format!("/proc/{}/task", child.as_ref().expect("it was started").id());
        // The state follows the name, which is in parentheses.
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

    /// Thaws the server after [`Self::hang`].
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

    /// Returns the URL of a database on the server.
    pub fn url(&self, database: &str) -> String {
        let (port, spool) = (self.port, self.spool());
        format!("mysql://cotorra:{PASSWORD}@127.0.0.1:{port}/{database}?spool={}", spool.display())
    }

    /// Returns the URL of a database that no other test uses.
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
