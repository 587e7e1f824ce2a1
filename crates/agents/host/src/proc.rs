//! Parsers of the kernel's texts (proc(5)): `/proc/stat`, `/proc/loadavg` and `/proc/meminfo`. Each returns `None` for a text
//! without what it looks for.

use cotorra_graph::{LoadAverage, MemoryContext, Probability};

/// Time that all CPUs together spent since the machine started, in ticks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CpuTimes {
    /// CPUs that are online.
    pub(crate) cpus: u32,
    busy: u64,
    idle: u64,
}

impl CpuTimes {
    /// Parses `/proc/stat`.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let mut lines = text.lines().take_while(|line| line.starts_with("cpu"));
        let times: Option<Vec<u64>> =
            lines.next()?.strip_prefix("cpu ")?.split_whitespace().map(|time| time.parse().ok()).collect();
        // Times of guests follow. They are part of `user` and `nice`.
        let [user, nice, system, idle, iowait, irq, softirq, steal] = *times?.first_chunk()?;
        let sum = |times: &[u64]| times.iter().fold(0_u64, |sum, time| sum.saturating_add(*time));
        Some(Self {
            cpus: u32::try_from(lines.count()).ok()?,
            busy: sum(&[user, nice, system, irq, softirq, steal]),
            idle: sum(&[idle, iowait]),
        })
    }

    /// Returns the share of the time since `before` in which CPUs were busy; `None` if no time passed.
    ///
    /// The kernel's counters of idle time may go back a little.
    pub(crate) fn busy_since(self, before: Self) -> Option<Probability> {
        let busy = self.busy.saturating_sub(before.busy) as f64;
        let idle = self.idle.saturating_sub(before.idle) as f64;
        // 0/0 is not a number, and so no probability.
        Probability::new(busy / (busy + idle))
    }
}

/// Parses `/proc/loadavg`.
pub(crate) fn load_average(text: &str) -> Option<LoadAverage> {
    let mut averages = text
        .split_whitespace()
        .map(|average| average.parse::<f64>().ok().filter(|average| average.is_finite() && *average >= 0.0));
    let mut next = || averages.next().flatten();
    Some(LoadAverage { one_minute: next()?, five_minutes: next()?, fifteen_minutes: next()? })
}

/// Parses `/proc/meminfo`.
pub(crate) fn memory(text: &str) -> Option<MemoryContext> {
    let bytes = |key: &str| {
        let value = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
        value.trim().strip_suffix(" kB")?.parse::<u64>().ok()?.checked_mul(1024)
    };
    Some(MemoryContext { memory_bytes: bytes("MemTotal")?, available_bytes: bytes("MemAvailable")? })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a virtual machine with Linux 6.18, shortened behind the CPUs.
    const STAT: &str = "\
cpu  1775987 305574 205005 242969 8694 0 4263 1673 0 0
cpu0 880284 150415 101359 134694 3227 0 1113 817 0 0
cpu1 895703 155159 103645 108274 5466 0 3149 855 0 0
intr 14805124 0 0 0 0 0 0 0 0 0 0 0 0
ctxt 43284476
cpufreq is no CPU
";
    /// The same machine's, shortened.
    const MEMINFO: &str = "\
MemTotal:       24684092 kB
MemFree:        23742100 kB
MemAvailable:   24193088 kB
Buffers:           60804 kB
SwapCached:            0 kB
HugePages_Total:       0
";

    #[test]
    fn cpu_times_are_those_of_all_cpus() {
        let times = CpuTimes::parse(STAT).unwrap();
        assert_eq!(times.cpus, 2);
        assert_eq!(times.busy, 1_775_987 + 305_574 + 205_005 + 4263 + 1673);
        assert_eq!(times.idle, 242_969 + 8694);
        assert_eq!(CpuTimes::parse(""), None);
        assert_eq!(CpuTimes::parse("cpu  1 2 3 4 5 6 7\n"), None);
        assert_eq!(CpuTimes::parse("cpu  1 2 3 four 5 6 7 8\n"), None);
        assert_eq!(CpuTimes::parse("cpu0 1 2 3 4 5 6 7 8\n"), None);
    }

    #[test]
    fn busy_share_is_that_since_the_last_reading() {
        let times = |busy, idle| CpuTimes { cpus: 2, busy, idle };
        let share = |now: CpuTimes, before| now.busy_since(before).map(Probability::get);
        assert_eq!(share(times(130, 1070), times(100, 1000)), Some(0.3));
        assert_eq!(share(times(100, 1000), times(100, 1000)), None);
        // The time that a CPU waits for a disk may go back.
        assert_eq!(share(times(150, 999), times(100, 1000)), Some(1.0));
    }

    #[test]
    fn load_averages_are_three_numbers() {
        let load = load_average("0.00 0.64 1.62 1/90 19264\n").unwrap();
        assert_eq!((load.one_minute, load.five_minutes, load.fifteen_minutes), (0.0, 0.64, 1.62));
        for text in ["", "0.00 0.64", "0.00 inf 1.62 1/90 19264", "-1 0 0", "0.00 NaN 1.62"] {
            assert_eq!(load_average(text), None, "{text}");
        }
    }

    #[test]
    fn memory_is_in_bytes() {
        let memory_of = |text: &str| memory(text).map(|memory| (memory.memory_bytes, memory.available_bytes));
        assert_eq!(memory_of(MEMINFO), Some((24_684_092 * 1024, 24_193_088 * 1024)));
        assert_eq!(memory_of("MemTotal: 24684092 kB\n"), None);
        let too_much = "MemTotal: 18446744073709551615 kB\nMemAvailable: 1 kB\n";
        assert_eq!(memory_of(too_much), None);
    }
}
