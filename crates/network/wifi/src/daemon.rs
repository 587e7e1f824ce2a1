//! hostapd and wpa_supplicant as processes of ours, each in a private folder.

use std::{
    env,
    fs::{self, DirBuilder, File},
    io::{self, Write},
    os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt},
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command, ExitStatus, Stdio},
    thread,
    time::Duration,
};

use cotorra_engine::Process;

use crate::{
    access_point::AccessPoint,
    client::{Client, ControlError},
    control::{hostapd, ping, terminate},
    names::InterfaceName,
    station::Station,
};

/// Interval of checks whether a program has started or ended.
const CHECK_INTERVAL: Duration = Duration::from_millis(10);
/// Time that a program has to answer its first request, in checks.
const START_CHECKS: u32 = 1000;
/// Time that a program has to end before it is killed, in checks.
const STOP_CHECKS: u32 = 300;
/// Longest path of a folder, in bytes: Linux has 107 for that of a socket.
const LONGEST_PATH: usize = 107 - "/control/123456789012345".len();
/// Bytes of the log's end in an error.
const LOG_END: usize = 600;

/// Starts a program somewhere, such as in a network namespace, and hands its process over.
pub type Launcher<'a> = dyn FnMut(Command) -> io::Result<Box<dyn Process>> + 'a;

/// Starts a program here: in this process's namespaces. It outlives this process if that is killed.
///
/// # Errors
/// As [`Command::spawn`].
pub fn launch_here(mut command: Command) -> io::Result<Box<dyn Process>> {
    struct Here(Child);

    impl Process for Here {
        fn try_wait(&mut self) -> io::Result<Option<ExitStatus>> {
            self.0.try_wait()
        }

        fn terminate(&mut self) {
            // Fails only if it has ended.
            _ = rustix::process::kill_process(
                rustix::process::Pid::from_child(&self.0),
                rustix::process::Signal::TERM,
            );
        }

        fn kill(&mut self) {
            _ = self.0.kill();
            _ = self.0.wait();
        }

        fn stdout(&mut self) -> Option<ChildStdout> {
            self.0.stdout.take()
        }
    }

    Ok(Box::new(Here(command.spawn()?)))
}

/// A program that did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The folder exists, and is not one of a [`Daemon`] of this user.
    #[error("{0} exists, and is no private folder of this user: choose another, or remove it")]
    Folder(PathBuf),
    /// The folder's path cannot be used for sockets or in configurations.
    #[error("{0} cannot hold control sockets: use a path of at most 83 bytes without spaces, `#` and quotes")]
    Path(PathBuf),
    /// A file cannot be written, or the program cannot be started.
    #[error("cannot {action}: {source}")]
    System {
        /// The attempt.
        action: String,
        /// The reason.
        source: io::Error,
    },
    /// The program ended.
    #[error("{program} ended at once with {status}:\n{log}")]
    Ended {
        /// The program.
        program: &'static str,
        /// Its exit status.
        status: ExitStatus,
        /// The end of its log.
        log: String,
    },
    /// The program does not answer.
    #[error("{program} does not answer after 10 s:\n{log}")]
    Silent {
        /// The program.
        program: &'static str,
        /// The end of its log.
        log: String,
    },
    /// The program answers, but not as it should.
    #[error(transparent)]
    Control(#[from] ControlError),
}

/// A running hostapd or wpa_supplicant. Dropping it ends the program and removes its folder.
pub struct Daemon {
    program: &'static str,
    process: Box<dyn Process>,
    folder: Folder,
    interface: InterfaceName,
}

impl std::fmt::Debug for Daemon {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut text = f.debug_struct("Daemon");
        text.field("program", &self.program).field("folder", &self.folder.path).finish_non_exhaustive()
    }
}

impl Daemon {
    /// Starts hostapd for an access point, and waits until it answers. It may serve later: an
    /// [event](crate::Event::AccessPointEnabled) tells, and so does its status.
    ///
    /// The folder holds its configuration, sockets and log. It must not exist. If a killed process left it, with a program that
    /// still runs, that program is ended and the folder made anew.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn hostapd(
        access_point: &AccessPoint,
        folder: &Path,
        launch: &mut Launcher<'_>,
    ) -> Result<Self, StartError> {
        Self::hostapd_in(Folder::new(folder, None)?, access_point, launch)
    }

    /// Does the same as [`Self::hostapd`], with the log appended to this file, which stays.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn hostapd_with_log(
        access_point: &AccessPoint,
        folder: &Path,
        log: &Path,
        launch: &mut Launcher<'_>,
    ) -> Result<Self, StartError> {
        Self::hostapd_in(Folder::new(folder, Some(log))?, access_point, launch)
    }

    fn hostapd_in(
        folder: Folder,
        access_point: &AccessPoint,
        launch: &mut Launcher<'_>,
    ) -> Result<Self, StartError> {
        let configuration = folder.write("hostapd.conf", &access_point.configuration(&folder.control()))?;
        let mut command = Command::new(program("hostapd"));
        command.arg("-t").arg("-g").arg(folder.global()).arg(configuration);
        Self::start("hostapd", command, folder, access_point.interface.clone(), launch)
    }

    /// Starts wpa_supplicant for a station, and waits until it answers. The folder is as for [`Self::hostapd`].
    ///
    /// # Errors
    /// [`StartError`].
    pub fn wpa_supplicant(
        station: &Station,
        folder: &Path,
        launch: &mut Launcher<'_>,
    ) -> Result<Self, StartError> {
        Self::wpa_supplicant_in(Folder::new(folder, None)?, station, launch)
    }

    /// Does the same as [`Self::wpa_supplicant`], with the log appended to this file, which stays.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn wpa_supplicant_with_log(
        station: &Station,
        folder: &Path,
        log: &Path,
        launch: &mut Launcher<'_>,
    ) -> Result<Self, StartError> {
        Self::wpa_supplicant_in(Folder::new(folder, Some(log))?, station, launch)
    }

    fn wpa_supplicant_in(
        folder: Folder,
        station: &Station,
        launch: &mut Launcher<'_>,
    ) -> Result<Self, StartError> {
        let configuration = folder.write("wpa_supplicant.conf", &station.configuration(&folder.control()))?;
        let mut command = Command::new(program("wpa_supplicant"));
        command.arg("-t").arg("-i").arg(station.interface.as_str()).arg("-D").arg(station.driver.name());
        command.arg("-c").arg(configuration).arg("-g").arg(folder.global());
        Self::start("wpa_supplicant", command, folder, station.interface.clone(), launch)
    }

    fn start(
        program: &'static str,
        mut command: Command,
        folder: Folder,
        interface: InterfaceName,
        launch: &mut Launcher<'_>,
    ) -> Result<Self, StartError> {
        let log = folder.open_log()?;
        let also = log.try_clone().map_err(system("write the log"))?;
        command.stdin(Stdio::null()).stdout(log).stderr(also);
        let process = launch(command).map_err(system(format!("start {program} (is it installed?)")))?;
        let mut daemon = Self { program, process, folder, interface };
        daemon.wait_until_it_answers()?;
        Ok(daemon)
    }

    #[allow(clippy::disallowed_methods, reason = "nobody tells when a program has opened its socket")]
    fn wait_until_it_answers(&mut self) -> Result<(), StartError> {
        for _ in 0..START_CHECKS {
            if let Some(status) = self.ended().map_err(system(format!("watch {}", self.program)))? {
                return Err(StartError::Ended { program: self.program, status, log: self.folder.log_end() });
            }
            match self.client().and_then(|mut client| client.request(&ping())) {
                Ok(()) => return Ok(()),
                Err(ControlError::Gone { .. }) => thread::sleep(CHECK_INTERVAL),
                Err(ControlError::Timeout { .. }) => break,
                Err(error) => return Err(error.into()),
            }
        }
        Err(StartError::Silent { program: self.program, log: self.folder.log_end() })
    }

    /// Connects to the socket of its interface.
    ///
    /// # Errors
    /// As [`Client::connect`].
    pub fn client(&self) -> Result<Client, ControlError> {
        self.client_of(&self.interface)
    }

    /// Connects to the socket of another of its interfaces, such as that of a virtual access point.
    ///
    /// # Errors
    /// As [`Client::connect`].
    pub fn client_of(&self, interface: &InterfaceName) -> Result<Client, ControlError> {
        Client::connect(&self.folder.control().join(interface.as_str()), &self.folder.path)
    }

    /// Connects to its global socket, by which interfaces are added and removed.
    ///
    /// # Errors
    /// As [`Client::connect`].
    pub fn global_client(&self) -> Result<Client, ControlError> {
        Client::connect(&self.folder.global(), &self.folder.path)
    }

    /// Adds a BSS to a running access point, by hostapd's global socket.
    ///
    /// # Errors
    /// [`StartError`], e.g. [`StartError::Control`] if hostapd refuses.
    pub fn add_bss(&self, access_point: &AccessPoint) -> Result<(), StartError> {
        let name = format!("{}.conf", access_point.interface);
        let file = self.folder.write(&name, &access_point.configuration(&self.folder.control()))?;
        let radio = self.client()?.request(&hostapd::status())?.radio;
        // Without a radio, any name will do.
        let radio = radio.as_deref().unwrap_or("none");
        Ok(self.global_client()?.request(&hostapd::add_bss(radio, &file))?)
    }

    /// Returns how the program ended, if it has.
    ///
    /// # Errors
    /// The error of the system.
    pub fn ended(&mut self) -> io::Result<Option<ExitStatus>> {
        self.process.try_wait()
    }

    /// Ends the program: stations are notified, and interfaces that it made are removed. It is killed if it takes longer
    /// than 3 s. Its folder is removed. Dropping it does the same.
    pub fn stop(self) {}

    #[allow(
        clippy::disallowed_methods,
        reason = "a process of another user of the trait has no descriptor to wait for"
    )]
    fn end(&mut self) {
        let asked = self.global_client().and_then(|mut client| client.request(&terminate()));
        if asked.is_err() {
            self.process.terminate();
        }
        for _ in 0..STOP_CHECKS {
            match self.process.try_wait() {
                Ok(None) => thread::sleep(CHECK_INTERVAL),
                Ok(Some(_)) => return,
                Err(_) => break,
            }
        }
        self.process.kill();
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.end();
    }
}

/// A private folder, which is removed when it is dropped.
struct Folder {
    path: PathBuf,
    /// The program's log, in the folder or elsewhere.
    log: PathBuf,
}

impl Folder {
    fn new(path: &Path, log: Option<&Path>) -> Result<Self, StartError> {
        let text = path.to_str().unwrap_or_default();
        let is_harmless = |character: char| !character.is_whitespace() && !"#\"'\\".contains(character);
        if !matches!(text.len(), 1..=LONGEST_PATH) || !text.chars().all(is_harmless) {
            return Err(StartError::Path(path.to_owned()));
        }
        let make = || DirBuilder::new().mode(0o700).create(path);
        match make() {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                clear(path)?;
                make()
            }
            made => made,
        }
        .map_err(system(format!("make the folder {}", path.display())))?;
        let log = log.map_or_else(|| path.join("log"), Path::to_owned);
        Ok(Self { path: path.to_owned(), log })
    }

    fn control(&self) -> PathBuf {
        self.path.join("control")
    }

    fn global(&self) -> PathBuf {
        self.path.join("global")
    }

    fn create(&self, name: &str) -> Result<File, StartError> {
        let path = self.path.join(name);
        let mut options = File::options();
        options.write(true).create(true).truncate(true).mode(0o600);
        options.open(&path).map_err(system(format!("write {}", path.display())))
    }

    fn write(&self, name: &str, text: &str) -> Result<PathBuf, StartError> {
        let path = self.path.join(name);
        let written = self.create(name)?.write_all(text.as_bytes());
        written.map_err(system(format!("write {}", path.display())))?;
        Ok(path)
    }

    fn open_log(&self) -> Result<File, StartError> {
        let mut options = File::options();
        options.append(true).create(true).mode(0o600);
        options.open(&self.log).map_err(system(format!("write {}", self.log.display())))
    }

    /// Returns the last lines of the program's log.
    fn log_end(&self) -> String {
        let log = fs::read(&self.log).unwrap_or_default();
        let end = &log[log.len().saturating_sub(LOG_END)..];
        String::from_utf8_lossy(end).trim().to_owned()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        _ = fs::remove_dir_all(&self.path);
    }
}

/// Ends the program that a killed process left in a folder, and removes the folder.
pub(crate) fn clear(path: &Path) -> Result<(), StartError> {
    let is_a_programs = ["hostapd.conf", "wpa_supplicant.conf"].iter().any(|name| path.join(name).is_file());
    let is_ours = fs::symlink_metadata(path).is_ok_and(|folder| {
        let own = fs::metadata("/proc/self").is_ok_and(|process| process.uid() == folder.uid());
        folder.is_dir() && folder.mode() & 0o077 == 0 && own && is_a_programs
    });
    if !is_ours {
        return Err(StartError::Folder(path.to_owned()));
    }
    if let Ok(mut client) = Client::connect(&path.join("global"), path)
        && let Ok(mut events) = client.events()
    {
        _ = client.request(&terminate());
        // It has ended when its socket is closed.
        _ = (0..STOP_CHECKS).find(|_| events.next(CHECK_INTERVAL).is_err());
    }
    fs::remove_dir_all(path).map_err(system(format!("remove {}", path.display())))
}

/// Returns the path of an installed program, such as `hostapd`. Ordinary users often lack the folders of those for administrators
/// in their `PATH`, so it looks there, too.
pub fn installed(program: &str) -> Option<PathBuf> {
    let folders = env::var("PATH").unwrap_or_default() + ":/usr/local/sbin:/usr/sbin:/sbin";
    env::split_paths(&folders).map(|folder| folder.join(program)).find(|path| path.is_file())
}

fn program(name: &str) -> PathBuf {
    installed(name).unwrap_or_else(|| name.into())
}

fn system(action: impl Into<String>) -> impl FnOnce(io::Error) -> StartError {
    let action = action.into();
    |source| StartError::System { action, source }
}
