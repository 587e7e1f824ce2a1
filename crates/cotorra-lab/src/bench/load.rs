//! Load of the machine by other programs during a measurement. A figure from a busy machine is not reliable.

use std::{fs, thread};

/// CPU time in clock ticks: the machine's total, its busy part, and that of this process.
#[derive(Debug, Clone, Copy)]
struct Ticks {
    all: u64,
    busy: u64,
    own: u64,
}

impl Ticks {
    /// Reads the current times. `None` if /proc does not have them.
    fn now() -> Option<Self> {
        let stat = fs::read_to_string("/proc/stat").ok()?;
        let cpus: Vec<u64> = numbers(stat.lines().next()?.strip_prefix("cpu")?);
        // user nice system idle iowait irq softirq steal (proc_stat(5)). Interrupts are not counted as busy, because they
        // serve our packets, too.
        let [user, nice, system, idle, iowait, irq, softirq, steal, ..] = cpus[..] else { return None };
        let all = user + nice + system + idle + iowait + irq + softirq + steal;
        let own = fs::read_to_string("/proc/self/stat").ok()?;
        // After the name, which may contain blanks: utime, stime and those of children that were waited for.
        let fields: Vec<_> = own.rsplit_once(')')?.1.split_whitespace().skip(11).take(4).collect();
        let own = fields.iter().filter_map(|field| field.parse::<u64>().ok()).sum();
        Some(Self { all, busy: user + nice + system + steal, own })
    }
}

fn numbers(text: &str) -> Vec<u64> {
    text.split_whitespace().filter_map(|word| word.parse().ok()).collect()
}

/// Measurement of the load by other programs.
#[derive(Debug, Clone, Copy)]
pub struct Load(Option<Ticks>);

impl Load {
    /// Begins a measurement.
    pub fn begin() -> Self {
        Self(Ticks::now())
    }

    /// Returns the share of the machine that other programs used since the beginning, in percent.
    pub fn others(self) -> String {
        let share = || {
            let (before, now) = (self.0?, Ticks::now()?);
            let all = now.all.checked_sub(before.all).filter(|all| *all > 0)?;
            let others = (now.busy - before.busy).saturating_sub(now.own - before.own);
            Some(format!("{:.0} %", others as f64 / all as f64 * 100.0))
        };
        share().unwrap_or_else(|| "unknown".to_owned())
    }
}

/// Describes the machine in one line.
pub fn machine(root: bool) -> String {
    let cores = thread::available_parallelism().map_or(0, usize::from);
    let kernel = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
    let user = if root { "root" } else { "an ordinary user" };
    format!("cotorra {}, {cores} cores, Linux {}, as {user}", env!("CARGO_PKG_VERSION"), kernel.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn total_time_exceeds_our_own() {
        let ticks = Ticks::now().unwrap();
        assert!(ticks.all >= ticks.busy && ticks.busy >= ticks.own, "{ticks:?}");
    }
}
