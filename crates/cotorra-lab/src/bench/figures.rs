//! The benchmarks: their measurements, repetitions and goals.

use std::time::Duration;

use cotorra_datapath::{BusyPoll, Error};
use cotorra_graph::{BitRate, Conditions, Jitter, Loss, Probability};
use cotorra_numbers::median;

use super::{
    emulator::{self, Percentiles, Setting},
    netem, peers,
    report::{Bench, Row},
};

/// A benchmark.
pub struct Benchmark {
    pub name: &'static str,
    pub about: &'static str,
    pub measure: fn(&Bench) -> Result<Vec<Row>, Error>,
}

/// All benchmarks, in the order in which they run.
pub const ALL: &[Benchmark] = &[
    Benchmark {
        name: "round-trip",
        about: "round trip over a link of 1 ms each way: time on top of the 2 ms",
        measure: round_trip,
    },
    Benchmark { name: "tcp", about: "TCP through one link without impairment", measure: tcp },
    Benchmark {
        name: "tcp-impaired",
        about: "TCP through one link with loss or jitter",
        measure: tcp_impaired,
    },
    Benchmark { name: "hops", about: "TCP through three links: less than through one, by", measure: hops },
    Benchmark { name: "packets", about: "UDP packets of 64 bytes through one link", measure: packets },
    Benchmark { name: "rate", about: "rate of a limited link against its limit", measure: rate },
    Benchmark { name: "loss", about: "loss of a lossy link against its setting", measure: loss },
    Benchmark { name: "hosts", about: "1000 hosts up and down", measure: hosts },
    Benchmark {
        name: "mininet",
        about: "50 hosts in a line, up and down, against Mininet",
        measure: mininet,
    },
    Benchmark {
        name: "netem",
        about: "the fabric beside the kernel's NetEm, in one kernel (this one's, or scripts/uml's)",
        measure: netem::compare,
    },
];

/// Repetitions of a measurement.
const TIMES: usize = 5;
const ONCE: Duration = Duration::from_secs(2);
const ROUND_TRIPS: usize = 5000;
const ONE_WAY: Duration = Duration::from_millis(1);

fn round_trip(bench: &Bench) -> Result<Vec<Row>, Error> {
    const GOAL: &str = "p50 25 µs, p99 1 ms";
    let row = |name: &str, Percentiles { p50, p99, max }: Percentiles| {
        Row::new(name, micros(p50), format!("p99 {}, max {}", micros(p99), micros(max)))
    };
    bench.show("round trips of 2 ms");
    let usual = row(about("round-trip"), emulator::round_trip(Setting::default(), ONE_WAY, ROUND_TRIPS)?);
    bench.show("round trips of 2 ms, with a core that spins");
    let setting = Setting { busy_poll: BusyPoll::Always, ..Setting::default() };
    let spinning = row("  with a core that spins", emulator::round_trip(setting, ONE_WAY, ROUND_TRIPS)?);
    bench.show("round trips of 2 ms, with cores that may sleep");
    let setting = Setting { let_cores_sleep: true, ..Setting::default() };
    let sleeping = row("  with cores that may sleep", emulator::round_trip(setting, ONE_WAY, ROUND_TRIPS)?);
    let peer = peers::check_rattan(bench).and_then(|()| {
        bench.show("round trips of 2 ms through rattan");
        peers::rattan_round_trips(bench, ONE_WAY, ROUND_TRIPS)
    });
    let peer = peer.map_or_else(|missing| rattan_missing(&missing), |measured| row("  rattan", measured));
    Ok(vec![usual.aiming_at(GOAL), spinning.aiming_at("p50 10 µs, with a core to spare"), sleeping, peer])
}

fn tcp(bench: &Bench) -> Result<Vec<Row>, Error> {
    let ours = repeat(bench, "TCP", || throughput(&Conditions::default(), 1))?;
    let peer = peers::check_rattan(bench)
        .and_then(|()| repeat(bench, "TCP through rattan", || peers::rattan_throughput(bench, ONCE)));
    let peer = peer.map_or_else(|missing| rattan_missing(&missing), |rates| rates.row("  rattan"));
    Ok(vec![ours.row(about("tcp")).aiming_at("10 Gbit/s"), peer])
}

fn tcp_impaired(bench: &Bench) -> Result<Vec<Row>, Error> {
    const GOAL: &str = "2 Gbit/s";
    let rate = Probability::new(0.001).expect("a share");
    let lossy = Conditions { loss: Loss::Independent { rate }, ..Conditions::default() };
    let jitter = Jitter { deviation: Duration::from_micros(20), ..Jitter::default() };
    let delay = Duration::from_micros(100);
    let unsteady = Conditions { delay, jitter: Some(jitter), ..Conditions::default() };
    let lossy = repeat(bench, "TCP with loss", || throughput(&lossy, 1))?;
    let unsteady = repeat(bench, "TCP with jitter", || throughput(&unsteady, 1))?;
    Ok(vec![
        lossy.row("TCP through a link that loses 0.1 %").aiming_at(GOAL),
        unsteady.row("TCP through a link of 100 ± 20 µs").aiming_at(GOAL),
    ])
}

fn hops(bench: &Bench) -> Result<Vec<Row>, Error> {
    // Alternating, so that other load of the machine affects both alike.
    let cost = || {
        let one = throughput(&Conditions::default(), 1)?;
        Ok::<_, Error>((1.0 - throughput(&Conditions::default(), 3)? / one) * 100.0)
    };
    let mut costs = repeat(bench, "TCP through one and three links", cost)?;
    costs.0.sort_by(f64::total_cmp);
    let worst = costs.0.last().copied().unwrap_or_default();
    let row = Row::new(about("hops"), format!("{:.1} %", costs.median()), format!("worst {worst:.1} %"));
    Ok(vec![row.aiming_at("20 %")])
}

fn packets(bench: &Bench) -> Result<Vec<Row>, Error> {
    let mut delivered = Vec::new();
    let per_core = repeat(bench, "small packets", || {
        let rate = emulator::packet_rate(Setting::default(), ONCE)?;
        delivered.push(rate.delivered);
        Ok::<_, Error>(rate.per_core)
    })?;
    let delivered = Samples(delivered);
    let row = |name: &str, samples: &Samples| {
        Row::new(name, thousands(samples.median()), format!("lowest {}", thousands(samples.lowest())))
    };
    Ok(vec![
        row("UDP packets of 64 bytes, a core of the fabric's", &per_core).aiming_at("300,000/s"),
        row("  delivered, sender and receiver beside it", &delivered),
    ])
}

fn rate(bench: &Bench) -> Result<Vec<Row>, Error> {
    let row = |mbps: f64| {
        let limit = BitRate::from_mbps(mbps).expect("above zero");
        let errors =
            repeat(bench, "a limited rate", || emulator::rate_error(Setting::default(), limit, ONCE))?;
        let worst = errors.0.iter().copied().fold(0.0, f64::max);
        let name = format!("error of a rate of {limit}, Ethernet header included");
        let row = Row::new(
            name,
            format!("{:.3} %", errors.median() * 100.0),
            format!("worst {:.3} %", worst * 100.0),
        );
        Ok(row.aiming_at("0.5 %"))
    };
    [10.0, 100.0].into_iter().map(row).collect()
}

fn loss(bench: &Bench) -> Result<Vec<Row>, Error> {
    /// 99 % quantile (two-sided) of the normal distribution, which approximates the loss of a million packets.
    const Z: f64 = 2.576;
    const PACKETS: u64 = 1_000_000;
    bench.show("a million packets over a lossy link");
    let expected = 0.01;
    let counted = emulator::loss(Setting::default(), Probability::new(expected).expect("a share"), PACKETS)?;
    let share = counted.lost as f64 / counted.packets as f64;
    let half = Z * (expected * (1.0 - expected) / counted.packets as f64).sqrt();
    let verdict = if (share - expected).abs() <= half { "within" } else { "outside" };
    let row = Row::new(
        format!("loss of a link that loses {} %", expected * 100.0),
        format!("{:.4} %", share * 100.0),
        format!("{verdict} {:.4} to {:.4} %", (expected - half) * 100.0, (expected + half) * 100.0),
    );
    Ok(vec![row.aiming_at("within the 99 % interval")])
}

fn hosts(bench: &Bench) -> Result<Vec<Row>, Error> {
    let mut memory = Vec::new();
    let mut down = Vec::new();
    let up = repeat(bench, "1000 hosts", || {
        let brought = emulator::bring_up(Setting::default(), 1000)?;
        memory.push(brought.memory_bytes as f64 / 1e6);
        down.push(brought.down.as_secs_f64());
        Ok::<_, Error>(brought.up.as_secs_f64())
    })?;
    let row = |name: &str, samples: &Samples, unit: &str, digits: usize| {
        let highest = samples.0.iter().copied().fold(0.0, f64::max);
        Row::new(
            name,
            format!("{:.digits$} {unit}", samples.median()),
            format!("highest {highest:.digits$} {unit}"),
        )
    };
    Ok(vec![
        row("1000 hosts up", &up, "s", 2).aiming_at("2 s"),
        row("  down", &Samples(down), "s", 2).aiming_at("2 s"),
        row("  memory", &Samples(memory), "MB", 0).aiming_at("1000 MB"),
    ])
}

fn mininet(bench: &Bench) -> Result<Vec<Row>, Error> {
    const HOSTS: usize = 50;
    let both = || {
        let brought = emulator::bring_up(Setting::default(), HOSTS)?;
        Ok::<_, Error>((brought.up + brought.down).as_secs_f64())
    };
    let ours = repeat(bench, "50 hosts", both)?;
    let highest = ours.0.iter().copied().fold(0.0, f64::max);
    let row =
        Row::new(about("mininet"), format!("{:.3} s", ours.median()), format!("highest {highest:.3} s"));
    bench.show("50 hosts in Mininet");
    let peer = match peers::mininet(bench, HOSTS) {
        Ok(took) => {
            let took = took.as_secs_f64();
            Row::new(
                "  Mininet linear,50",
                format!("{took:.2} s"),
                format!("{:.0} times ours", took / ours.median()),
            )
        }
        Err(missing) => Row::missing("  Mininet linear,50", missing.to_string()),
    };
    Ok(vec![row, peer.aiming_at("19 times ours")])
}

fn about(name: &str) -> &'static str {
    ALL.iter().find(|benchmark| benchmark.name == name).map_or("", |benchmark| benchmark.about)
}

fn rattan_missing(missing: &peers::Missing) -> Row {
    Row::missing("  rattan", missing.to_string())
}

fn throughput(conditions: &Conditions, links: usize) -> Result<f64, Error> {
    emulator::tcp_throughput(Setting::default(), conditions, links, ONCE)
}

/// Results of repeated measurements.
#[derive(Debug)]
struct Samples(Vec<f64>);

fn repeat<E>(bench: &Bench, what: &str, mut measure: impl FnMut() -> Result<f64, E>) -> Result<Samples, E> {
    let once = |time| {
        bench.show(format!("{what}, {} of {TIMES}", time + 1));
        measure()
    };
    (0..TIMES).map(once).collect::<Result<_, _>>().map(Samples)
}

impl Samples {
    fn median(&self) -> f64 {
        median(self.0.clone()).unwrap_or(f64::NAN)
    }

    fn lowest(&self) -> f64 {
        self.0.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Returns a row of throughputs.
    fn row(&self, name: &str) -> Row {
        let gbps = |rate: f64| format!("{:.1} Gbit/s", rate / 1e9);
        Row::new(name, gbps(self.median()), format!("lowest {}", gbps(self.lowest())))
    }
}

fn micros(duration: Duration) -> String {
    format!("{:.0} µs", duration.as_secs_f64() * 1e6)
}

/// `1,234,000/s`.
fn thousands(rate: f64) -> String {
    let mut digits = format!("{:.0}", (rate / 1000.0).round() * 1000.0);
    let mut at = digits.len();
    while at > 3 {
        at -= 3;
        digits.insert(at, ',');
    }
    digits + "/s"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_formatted_for_people() {
        assert_eq!(thousands(1_234_499.0), "1,234,000/s");
        assert_eq!(thousands(999.0), "1,000/s");
        assert_eq!(micros(Duration::from_nanos(24_600)), "25 µs");
        assert_eq!(Samples(vec![3.0, 1.0, 2.0]).median(), 2.0);
    }

    #[test]
    fn names_of_benchmarks_are_unique() {
        let names: std::collections::BTreeSet<_> = ALL.iter().map(|benchmark| benchmark.name).collect();
        assert_eq!(names.len(), ALL.len());
    }
}
