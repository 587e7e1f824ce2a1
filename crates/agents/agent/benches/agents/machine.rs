//! The machine, and what else runs on it. Figures from a busy machine are not reliable.

use std::{fs, hint::black_box, thread, time::Instant};

/// Steps of a computation that depend on each other, whose time gives the speed of a core.
const STEPS: u32 = 200_000_000;

pub fn describe() -> String {
    let cores = thread::available_parallelism().unwrap();
    let kernel = fs::read_to_string("/proc/sys/kernel/osrelease").unwrap();
    let began = Instant::now();
    let mut state = black_box(1_u64);
    for _ in 0..STEPS {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
    }
    black_box(state);
    let speed = f64::from(STEPS) / began.elapsed().as_secs_f64() / 1e6;
    format!("{cores} cores, {speed:.0} million steps of xorshift a second, Linux {}", kernel.trim())
}

/// A measurement of the CPU time of others.
pub struct Others(Ticks);

/// CPU time in clock ticks: all, its busy part, and that of this process and those that it has waited for.
struct Ticks {
    all: u64,
    busy: u64,
    own: u64,
}

impl Ticks {
    fn now() -> Self {
        let stat = fs::read_to_string("/proc/stat").unwrap();
        let cpu: Vec<u64> = stat
            .lines()
            .next()
            .unwrap()
            .split_whitespace()
            .skip(1)
            .map(|ticks| ticks.parse().unwrap())
            .collect();
        // user nice system idle iowait irq softirq steal (proc_stat(5))
        Self {
            all: cpu[..8].iter().sum(),
            busy: cpu[..3].iter().sum::<u64>() + cpu[7],
            own: own().iter().sum(),
        }
    }
}

impl Others {
    pub fn begin() -> Self {
        Self(Ticks::now())
    }

    /// The share of the machine that others used since the beginning.
    pub fn share(&self) -> String {
        let Ticks { all, busy, own } = Ticks::now();
        let others = (busy - self.0.busy).saturating_sub(own - self.0.own);
        format!("{:.0} %", others as f64 / (all - self.0.all) as f64 * 100.0)
    }
}

/// CPU time of this process.
pub fn cpu_seconds() -> f64 {
    // In each second, Linux counts a hundred ticks.
    own()[..2].iter().sum::<u64>() as f64 / 100.0
}

/// Ticks of this process, as a user and in the system, and those of children that it has waited for.
fn own() -> [u64; 4] {
    let stat = fs::read_to_string("/proc/self/stat").unwrap();
    // After the name, which may contain blanks.
    let mut fields = stat[stat.rfind(')').unwrap()..].split_whitespace().skip(12);
    [(); 4].map(|()| fields.next().unwrap().parse().unwrap())
}
