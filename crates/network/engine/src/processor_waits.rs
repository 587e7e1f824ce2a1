//! For how long VNFs waited for a processor although they were ready to run, as the kernel counts it (`/proc/PID/schedstat`).
//! The machine was slow then, and not the VNF. Waits for limits of the testbed file's own do not count.

use std::{collections::BTreeMap, fs, io, path::PathBuf, time::Duration};

use cotorra_graph::{NodeId, VnfId};

/// For how long an instance of a VNF waited for a processor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InstanceWaits {
    pub vnf: VnfId,
    /// The node that it ran on.
    pub node: NodeId,
    /// `None` if the kernel does not count it.
    pub waits: Option<ProcessorWaits>,
}

/// Waits of an instance's threads, from about a second after it began to serve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ProcessorWaits {
    /// Waits of all threads together.
    pub all: Duration,
    /// Waits of the thread that waited longest.
    pub longest: Duration,
    /// Number of times that this thread ran.
    pub runs: u64,
}

/// The kernel's counters of a thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Counted {
    waited: Duration,
    runs: u64,
}

/// A reading of all threads of an instance.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Reading {
    threads: BTreeMap<u32, Counted>,
    /// Time for which the limit of the processor kept the instance from running.
    throttled: Duration,
}

impl Reading {
    /// Reads the threads of a process and of all its descendants.
    ///
    /// # Errors
    /// The error of the system; `Unsupported` if this kernel does not count.
    pub(crate) fn of(process: u32, throttled: Duration) -> io::Result<Self> {
        let mut threads = BTreeMap::new();
        let mut processes = vec![process];
        while let Some(process) = processes.pop() {
            let tasks = match fs::read_dir(format!("/proc/{process}/task")) {
                // It has ended meanwhile.
                Err(_) if !threads.is_empty() => continue,
                tasks => tasks?,
            };
            for task in tasks.flatten().map(|task| task.path()) {
                let thread = task.file_name().and_then(|name| name.to_str()?.parse().ok());
                let counted = fs::read_to_string(task.join("schedstat")).ok().as_deref().and_then(counted);
                threads.extend(thread.zip(counted));
                let children = fs::read_to_string(task.join("children"));
                if threads.is_empty() {
                    return Err(io::ErrorKind::Unsupported.into());
                }
                processes
                    .extend(children?.split_ascii_whitespace().filter_map(|child| child.parse::<u32>().ok()));
            }
        }
        Ok(Self { threads, throttled })
    }
}

/// Reads a line of `schedstat`: time on a processor and waits for one, ns, and how often it ran. `None` if the kernel counts
/// nothing.
fn counted(line: &str) -> Option<Counted> {
    let mut fields = line.split_ascii_whitespace().map(|field| field.parse::<u64>().ok());
    let (_, waited, runs) = (fields.next()??, fields.next()??, fields.next()??);
    (runs > 0).then_some(Counted { waited: Duration::from_nanos(waited), runs })
}

/// Adds the readings of an instance up.
#[derive(Debug, Default)]
pub(crate) struct Readings {
    first: Option<Reading>,
    last: Reading,
    /// Whether a reading failed before any succeeded.
    is_unknown: bool,
}

impl Readings {
    pub(crate) fn add(&mut self, reading: io::Result<Reading>) {
        match reading {
            Ok(reading) => {
                self.last.throttled = reading.throttled;
                self.last.threads.extend(reading.threads.iter().map(|(thread, counted)| (*thread, *counted)));
                self.first.get_or_insert(reading);
            }
            // Later ones fail when the instance ends.
            Err(_) => self.is_unknown |= self.first.is_none(),
        }
    }

    /// Returns the waits between the first and the last reading; `None` if they are unknown.
    pub(crate) fn waits(&self) -> Option<ProcessorWaits> {
        let Some(first) = &self.first else { return (!self.is_unknown).then(ProcessorWaits::default) };
        let throttled = self.last.throttled.saturating_sub(first.throttled);
        let mut waits = ProcessorWaits::default();
        for (thread, last) in &self.last.threads {
            let before = first.threads.get(thread).copied().unwrap_or_default();
            let waited = last.waited.saturating_sub(before.waited).saturating_sub(throttled);
            waits.all += waited;
            if waited > waits.longest {
                (waits.longest, waits.runs) = (waited, last.runs.saturating_sub(before.runs).max(1));
            }
        }
        Some(waits)
    }
}

/// Returns the time of throttling in a `cpu.stat` of control groups, version 2 or 1.
pub(crate) fn throttled(stat: &str) -> Option<Duration> {
    let value = |name: &str| {
        let line = stat.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '))?;
        line.trim().parse().ok()
    };
    value("throttled_usec")
        .map(Duration::from_micros)
        .or_else(|| value("throttled_time").map(Duration::from_nanos))
}

/// Reads the time of throttling from files; none of a file that is missing.
pub(crate) fn throttled_in(files: &[PathBuf]) -> Duration {
    let stats = files.iter().filter_map(|file| fs::read_to_string(file).ok());
    stats.filter_map(|stat| throttled(&stat)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn reading(threads: &[(u32, u64, u64)], throttled_ms: u64) -> io::Result<Reading> {
        let thread = |&(thread, waited, runs): &_| (thread, Counted { waited: ms(waited), runs });
        Ok(Reading { threads: threads.iter().map(thread).collect(), throttled: ms(throttled_ms) })
    }

    #[test]
    fn waits_count_from_the_first_reading_and_also_of_threads_that_have_ended() {
        let mut readings = Readings::default();
        readings.add(reading(&[(1, 300, 10)], 0));
        readings.add(reading(&[(1, 340, 12), (2, 700, 7)], 0));
        readings.add(reading(&[(1, 350, 20)], 0));
        assert_eq!(readings.waits(), Some(ProcessorWaits { all: ms(750), longest: ms(700), runs: 7 }));
    }

    #[test]
    fn waits_for_a_limit_of_the_testbed_file_do_not_count() {
        let mut readings = Readings::default();
        readings.add(reading(&[(1, 100, 10), (2, 0, 1)], 90));
        readings.add(reading(&[(1, 1100, 20), (2, 10, 9)], 1080));
        assert_eq!(readings.waits(), Some(ProcessorWaits { all: ms(10), longest: ms(10), runs: 10 }));
        let of = |stat| throttled(stat);
        assert_eq!(of("usage_usec 9\nthrottled_usec 2000\n"), Some(ms(2)));
        assert_eq!(of("nr_throttled 4\nthrottled_time 3000000\n"), Some(ms(3)));
        assert_eq!(of("usage_usec 9\n"), None);
    }

    #[test]
    fn waits_are_unknown_where_the_kernel_does_not_count_them() {
        assert_eq!((counted("0 0 0\n"), counted("")), (None, None));
        let run = Counted { waited: Duration::from_nanos(7), runs: 3 };
        assert_eq!(counted("5 7 3\n"), Some(run));
        let mut readings = Readings::default();
        assert_eq!(readings.waits(), Some(ProcessorWaits::default()), "it has not served for long");
        readings.add(Err(io::ErrorKind::Unsupported.into()));
        assert_eq!(readings.waits(), None);
    }

    #[test]
    fn the_threads_of_a_process_and_its_children_are_read() {
        let mut child = std::process::Command::new("sh").args(["-c", "sleep 1000; true"]).spawn().unwrap();
        let threads = || Reading::of(child.id(), Duration::ZERO).unwrap().threads;
        while threads().len() < 2 {
            std::thread::yield_now();
        }
        assert!(threads().contains_key(&child.id()));
        let below: Vec<_> = threads().into_keys().filter(|thread| *thread != child.id()).collect();
        std::process::Command::new("kill").arg(below[0].to_string()).status().unwrap();
        child.wait().unwrap();
    }
}
