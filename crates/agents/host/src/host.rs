//! The reader of this machine's context.

use std::{
    collections::BTreeSet,
    fmt,
    fs::File,
    io::{self, Read},
    path::PathBuf,
};

use cotorra_graph::{CpuContext, MachineContext, NodeId, Timestamp};
use cotorra_netlink::Netlink;
use netlink_sys::protocols::{NETLINK_GENERIC, NETLINK_ROUTE};

use crate::{interfaces::Interfaces, link::Link, proc, proc::CpuTimes, wifi::Wifi};

/// The machine that this program runs on.
pub struct Host {
    node: NodeId,
    /// Folder of the kernel's texts: `/proc`.
    proc: PathBuf,
    route: Netlink,
    generic: Netlink,
    cpu: Option<CpuTimes>,
    interfaces: Interfaces,
    wifi: Wifi,
    /// Indices of the interfaces at the last reading.
    indices: Vec<u32>,
    reported: BTreeSet<Part>,
}

/// One reading of a machine's context.
#[derive(Debug)]
pub struct Reading {
    /// The context, without the parts that could not be read.
    pub context: MachineContext,
    /// Parts that could not be read, each only in the first reading that it is missing from.
    pub unavailable: Vec<Unavailable>,
}

/// A part of the context that could not be read.
#[derive(Debug, thiserror::Error)]
#[error("the machine's context lacks its {part}: {cause}")]
pub struct Unavailable {
    /// The part.
    pub part: Part,
    /// The reason.
    #[source]
    pub cause: io::Error,
}

/// Part of a machine's context, with a source of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// `/proc/stat`.
    Cpu,
    /// `/proc/loadavg`.
    LoadAverage,
    /// `/proc/meminfo`.
    Memory,
    /// rtnetlink.
    Interfaces,
    /// ethtool's netlink.
    Speeds,
    /// nl80211.
    Wifi,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cpu => "CPU time",
            Self::LoadAverage => "load average",
            Self::Memory => "memory",
            Self::Interfaces => "network interfaces",
            Self::Speeds => "network interfaces' speed",
            Self::Wifi => "Wi-Fi",
        })
    }
}

/// The most that is read of a text. `/proc/stat` has its longest lines behind those of up to 2000 CPUs.
const LONGEST_TEXT: u64 = 256 << 10;

impl Host {
    /// Returns a reader of this machine, which is the node `node`. Opens nothing yet.
    pub fn new(node: NodeId) -> Self {
        Self::with_proc(node, PathBuf::from("/proc"))
    }

    fn with_proc(node: NodeId, proc: PathBuf) -> Self {
        Self {
            node,
            proc,
            route: Netlink::new(NETLINK_ROUTE),
            generic: Netlink::new(NETLINK_GENERIC),
            cpu: None,
            interfaces: Interfaces::new(),
            wifi: Wifi::new(),
            indices: Vec::new(),
            reported: BTreeSet::new(),
        }
    }

    /// Reads the machine's context. Shares and rates are those since the last reading; `now` only ever grows.
    ///
    /// Interfaces are those of the calling thread's network namespace. It never waits for anything but the kernel.
    pub fn read(&mut self, now: Timestamp) -> Reading {
        let mut missing = Missing::default();
        let times = missing.note(Part::Cpu, self.text("stat", CpuTimes::parse));
        let before = std::mem::replace(&mut self.cpu, times);
        let cpu = times.map(|times| CpuContext {
            cpus: times.cpus,
            busy: before.and_then(|before| times.busy_since(before)),
        });
        let load_average = missing.note(Part::LoadAverage, self.text("loadavg", proc::load_average));
        let memory = missing.note(Part::Memory, self.text("meminfo", proc::memory));

        let links = missing.note(Part::Interfaces, Interfaces::links(&mut self.route)).unwrap_or_default();
        self.look_again_after_a_change(&links);
        let speeds =
            missing.note(Part::Speeds, self.interfaces.speeds(&mut self.generic)).unwrap_or_default();
        let (interfaces, interfaces_left_out) = self.interfaces.contexts(now, links, &speeds);
        let wifi = self.wifi.read(&mut self.generic);
        missing.note(Part::Wifi, wifi.error.map_or(Ok(()), Err));

        let context = MachineContext {
            node: self.node.clone(),
            reading: None,
            cpu,
            load_average,
            memory,
            interfaces,
            interfaces_left_out,
            wifi: wifi.wifi,
            wifi_left_out: wifi.left_out,
        };
        let unavailable =
            missing.0.into_iter().filter(|missing| self.reported.insert(missing.part)).collect();
        Reading { context, unavailable }
    }

    /// Parses the text of a file.
    fn text<T>(&self, name: &str, parse: impl Fn(&str) -> Option<T>) -> io::Result<T> {
        let path = self.proc.join(name);
        let in_file = |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", path.display()));
        let mut text = String::new();
        File::open(&path)
            .and_then(|file| file.take(LONGEST_TEXT).read_to_string(&mut text))
            .map_err(in_file)?;
        let unknown = || io::Error::new(io::ErrorKind::InvalidData, "the file lacks the expected lines");
        parse(&text).ok_or_else(unknown).map_err(in_file)
    }

    /// Looks again for what the kernel lacked if interfaces came or went: a driver may have been loaded.
    fn look_again_after_a_change(&mut self, links: &[Link]) {
        let indices: Vec<_> = links.iter().map(|link| link.index).collect();
        if indices != self.indices {
            self.indices = indices;
            self.interfaces.look_again();
            self.wifi.look_again();
        }
    }
}

/// The parts missing from one reading.
#[derive(Default)]
struct Missing(Vec<Unavailable>);

impl Missing {
    /// Takes note of a failure.
    fn note<T>(&mut self, part: Part, result: io::Result<T>) -> Option<T> {
        result.map_err(|cause| self.0.push(Unavailable { part, cause })).ok()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    const SECOND: Timestamp = Timestamp::from_nanos(1_000_000_000);

    #[test]
    fn missing_files_are_reported_once_and_leave_the_rest() {
        let proc = tempfile::tempdir().unwrap();
        fs::write(proc.path().join("loadavg"), "0.00 0.64 1.62 1/90 19264\n").unwrap();
        fs::write(proc.path().join("meminfo"), "nothing of memory\n").unwrap();
        let mut host = Host::with_proc("server".parse().unwrap(), proc.path().to_owned());

        let first = host.read(Timestamp::ZERO);
        let files = |unavailable: &[Unavailable]| {
            let of_files = unavailable.iter().filter(|missing| missing.part < Part::Interfaces);
            of_files.map(|missing| (missing.part, missing.cause.kind())).collect::<Vec<_>>()
        };
        let expected = [(Part::Cpu, io::ErrorKind::NotFound), (Part::Memory, io::ErrorKind::InvalidData)];
        assert_eq!(files(&first.unavailable), expected);
        let text = first.unavailable[0].to_string();
        assert!(text.starts_with("the machine's context lacks its CPU time: "), "{text}");
        assert!(text.contains(&proc.path().join("stat").display().to_string()), "{text}");
        assert_eq!((first.context.cpu, first.context.memory), (None, None));
        assert_eq!(first.context.load_average.map(|load| load.five_minutes), Some(0.64));
        assert!(first.context.interfaces.iter().any(|interface| interface.name == "lo"));

        assert!(host.read(SECOND).unavailable.is_empty());
    }

    #[test]
    fn file_that_appears_later_is_read() {
        let proc = tempfile::tempdir().unwrap();
        let mut host = Host::with_proc("server".parse().unwrap(), proc.path().to_owned());
        let stat = |user: u32| {
            let text = format!("cpu  {user} 0 0 100 0 0 0 0 0 0\ncpu0 {user} 0 0 100 0 0 0 0 0 0\nctxt 1\n");
            fs::write(proc.path().join("stat"), text).unwrap();
        };
        host.read(Timestamp::ZERO);
        stat(0);
        let cpu = host.read(SECOND).context.cpu.unwrap();
        assert_eq!((cpu.cpus, cpu.busy), (1, None));
        stat(50);
        let cpu = host.read(SECOND).context.cpu.unwrap();
        assert_eq!(cpu.busy.map(cotorra_graph::Probability::get), Some(1.0));
        // Without a reading in between, the next share starts anew.
        fs::remove_file(proc.path().join("stat")).unwrap();
        assert_eq!(host.read(SECOND).context.cpu, None);
        stat(100);
        assert_eq!(host.read(SECOND).context.cpu.unwrap().busy, None);
    }

    #[test]
    fn only_the_beginning_of_a_long_text_is_read() {
        let proc = tempfile::tempdir().unwrap();
        fs::write(proc.path().join("loadavg"), " ".repeat(LONGEST_TEXT as usize) + "0 0 0").unwrap();
        let mut host = Host::with_proc("server".parse().unwrap(), proc.path().to_owned());
        assert_eq!(host.read(Timestamp::ZERO).context.load_average, None);
    }
}
