//! Serial ports.

use std::{
    fs::{File, OpenOptions, TryLockError},
    io::{self, ErrorKind, Read, Write},
    os::unix::fs::OpenOptionsExt,
    path::PathBuf,
    time::Duration,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
    termios::{
        ControlModes, OptionalActions, QueueSelector, SpecialCodeIndex, tcflush, tcgetattr, tcsetattr,
    },
};

/// A serial port: 8 data bits, no parity, one stop bit, no flow control.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PortSettings {
    /// Path of its device file.
    pub path: PathBuf,
    /// Bits per second.
    pub baud: u32,
}

/// The reason for which a port cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    /// There is no such file.
    #[error(
        "there is no `{}`: plug the device in, and let a udev rule give it this name (docs/use/turtlebot.md)",
        .0.display()
    )]
    Missing(PathBuf),
    /// The user may not open it.
    #[error(
        "no permission to open `{}`: add your user to the group `dialout` and log in anew, or write a udev rule \
         (docs/use/turtlebot.md)",
        .0.display()
    )]
    Denied(PathBuf),
    /// Another program uses it.
    #[error("another program uses `{}`: end it first", .0.display())]
    Busy(PathBuf),
    /// It is a file of another kind.
    #[error("`{}` is not a serial port", .0.display())]
    NotSerial(PathBuf),
    /// The system failed.
    #[error("cannot open `{}`: {source}", path.display())]
    System {
        /// The port.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

/// An open port, whose calls never block.
pub struct Port(File);

/// Waits for a port.
pub(crate) struct Waiter(File);

/// Flags of `open` for a port: it does not become the controlling terminal, and its calls never block.
const FLAGS: i32 = rustix::fs::OFlags::NOCTTY.union(rustix::fs::OFlags::NONBLOCK).bits().cast_signed();

impl Port {
    /// Opens a port for this program alone, and sets it up. What waited in it is discarded.
    pub(crate) fn open(settings: &PortSettings) -> Result<(Self, Waiter), PortError> {
        let PortSettings { path, baud } = settings;
        let opened = OpenOptions::new().read(true).write(true).custom_flags(FLAGS).open(path);
        let file = opened.map_err(|error| match error.kind() {
            ErrorKind::NotFound => PortError::Missing(path.clone()),
            ErrorKind::PermissionDenied => PortError::Denied(path.clone()),
            ErrorKind::ResourceBusy => PortError::Busy(path.clone()),
            _ => PortError::System { path: path.clone(), source: error },
        })?;
        file.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => PortError::Busy(path.clone()),
            TryLockError::Error(source) => PortError::System { path: path.clone(), source },
        })?;
        let system = |source| PortError::System { path: path.clone(), source };
        set_up(&file, *baud).map_err(|error| match error {
            Errno::NOTTY | Errno::INVAL => PortError::NotSerial(path.clone()),
            error => system(error.into()),
        })?;
        let waiter = Waiter(file.try_clone().map_err(system)?);
        Ok((Self(file), waiter))
    }
}

fn set_up(file: &File, baud: u32) -> rustix::io::Result<()> {
    let mut settings = tcgetattr(file)?;
    settings.make_raw();
    settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    settings.control_modes &= !(ControlModes::CSTOPB | ControlModes::CRTSCTS);
    settings.special_codes[SpecialCodeIndex::VMIN] = 1;
    settings.special_codes[SpecialCodeIndex::VTIME] = 0;
    settings.set_speed(baud)?;
    tcsetattr(file, OptionalActions::Now, &settings)?;
    tcflush(file, QueueSelector::IOFlush)
}

impl Read for Port {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer)
    }
}

impl Write for Port {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Waiter {
    /// Waits until there is something to read, or room to write, as far as these are wanted, but no longer than `longest`.
    /// Returns whether there is any of it.
    pub fn wait(&self, to_read: bool, to_write: bool, longest: Duration) -> bool {
        let mut events = PollFlags::empty();
        events.set(PollFlags::IN, to_read);
        events.set(PollFlags::OUT, to_write);
        let timeout =
            Timespec { tv_sec: longest.as_secs().cast_signed(), tv_nsec: longest.subsec_nanos().into() };
        poll(&mut [PollFd::new(&self.0, events)], Some(&timeout)).is_ok_and(|ready| ready > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(path: impl Into<PathBuf>) -> PortError {
        match Port::open(&PortSettings { path: path.into(), baud: 115_200 }) {
            Ok(_) => panic!("it is open"),
            Err(error) => error,
        }
    }

    #[test]
    fn a_port_that_cannot_be_opened_is_explained() {
        let folder = tempfile::tempdir().unwrap();
        let missing = open(folder.path().join("kobuki")).to_string();
        assert!(missing.contains("plug the device in") && missing.contains("udev rule"), "{missing}");
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(matches!(open(&file), PortError::NotSerial(_)));
        assert!(matches!(open(folder.path()), PortError::System { .. }));
        let denied = PortError::Denied("/dev/kobuki".into()).to_string();
        assert!(denied.contains("`dialout`"), "{denied}");
        assert!(matches!(open("/dev/null"), PortError::NotSerial(_)));
    }
}
