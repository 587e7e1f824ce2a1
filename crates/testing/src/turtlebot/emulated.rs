//! Runs the emulators on pseudo-terminals, in real time.

use std::{
    fs::{self, File},
    io::{ErrorKind, Read, Write},
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use parking_lot::{Mutex, MutexGuard};
use rustix::{
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{OptionalActions, tcgetattr, tcsetattr},
};

use super::{Kobuki, Place, Rplidar, Wall};

/// The device's end of a pseudo-terminal, with a link to the other end.
pub struct Terminal {
    master: File,
    link: PathBuf,
}

impl Terminal {
    /// Opens one, to which `link` leads.
    pub fn open(link: &Path) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
        let mut settings = tcgetattr(&master).unwrap();
        settings.make_raw();
        tcsetattr(&master, OptionalActions::Now, &settings).unwrap();
        rustix::io::ioctl_fionbio(&master, true).unwrap();
        let _ = fs::remove_file(link);
        symlink(name, link).unwrap();
        Self { master: master.into(), link: link.to_owned() }
    }

    /// Reads what has arrived.
    pub fn read(&mut self) -> Vec<u8> {
        let mut piece = [0; 4096];
        // The other end is not open, or nothing has arrived.
        let read = self.master.read(&mut piece).unwrap_or(0);
        piece[..read].to_vec()
    }

    /// Writes bytes. What does not fit is lost, as on a real line.
    pub fn write(&mut self, bytes: &[u8]) {
        match self.master.write(bytes) {
            Err(error) if error.kind() != ErrorKind::WouldBlock => panic!("{error}"),
            _ => {}
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.link);
    }
}

/// A TurtleBot 2 in a room, at two pseudo-terminals.
pub struct Emulated {
    state: Arc<Mutex<State>>,
    has_ended: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
    folder: PathBuf,
}

/// The devices, and the ends at which they are plugged in.
pub struct State {
    pub kobuki: Kobuki,
    pub rplidar: Rplidar,
    /// The emulators' time.
    pub now: Duration,
    base: Option<Terminal>,
    lidar: Option<Terminal>,
}

impl Emulated {
    /// Starts one in `folder`, which then has the ports `kobuki` and `rplidar`.
    pub fn start(folder: &Path, walls: Vec<Wall>, place: Place) -> Self {
        let state = Arc::new(Mutex::new(State {
            kobuki: Kobuki::at(place),
            rplidar: Rplidar::new(walls, place),
            now: Duration::ZERO,
            base: Some(Terminal::open(&folder.join("kobuki"))),
            lidar: Some(Terminal::open(&folder.join("rplidar"))),
        }));
        let has_ended = Arc::new(AtomicBool::new(false));
        let (its, ended, began) = (Arc::clone(&state), Arc::clone(&has_ended), Instant::now());
        let thread = thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                its.lock().go_on(began.elapsed());
                thread::sleep(Duration::from_millis(2));
            }
        });
        Self { state, has_ended, thread: Some(thread), folder: folder.to_owned() }
    }

    /// Returns the path of the base's port.
    pub fn base(&self) -> PathBuf {
        self.folder.join("kobuki")
    }

    /// Returns the path of the lidar's port.
    pub fn lidar(&self) -> PathBuf {
        self.folder.join("rplidar")
    }

    /// Locks the devices.
    pub fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    /// Pulls the base's cable.
    pub fn unplug_base(&self) {
        self.state.lock().base = None;
    }

    /// Plugs the base's cable in.
    pub fn plug_base(&self) {
        self.state.lock().base = Some(Terminal::open(&self.base()));
    }
}

impl State {
    fn go_on(&mut self, now: Duration) {
        let Self { kobuki, rplidar, base, lidar, .. } = self;
        self.now = now;
        let commands = base.as_mut().map(Terminal::read).unwrap_or_default();
        kobuki.receive(now, &commands);
        let feedback = kobuki.take_output();
        if let Some(base) = base {
            base.write(&feedback);
        }
        rplidar.place = kobuki.place;
        let requests = lidar.as_mut().map(Terminal::read).unwrap_or_default();
        rplidar.receive(now, &requests);
        let samples = rplidar.take_output();
        if let Some(lidar) = lidar {
            lidar.write(&samples);
        }
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        self.has_ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}
