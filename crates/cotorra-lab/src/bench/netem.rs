//! Comparison of the fabric with NetEm: deviations from the delay, jitter and loss that were set, over one and three links.

use std::time::Duration;

use cotorra_datapath::{Error, KernelNetworkError};
use cotorra_graph::Probability;

use super::{
    emulator::{
        Percentiles,
        compare::{self, Emulator},
    },
    report::{Bench, Row},
};

const EMULATORS: [(Emulator, &str); 2] = [(Emulator::Fabric, "fabric"), (Emulator::NetEm, "NetEm")];
const LINKS: [(usize, &str); 2] = [(1, "one link"), (3, "three links")];

/// Measures all rows. If the kernel lacks NetEm, the only row has the reason.
pub fn compare(bench: &Bench) -> Result<Vec<Row>, Error> {
    match rows(bench) {
        Err(KernelNetworkError::Datapath(error)) => Err(error),
        Err(error) => Ok(vec![Row::missing(
            "the fabric beside NetEm",
            format!("{error}; scripts/uml has one that does"),
        )]),
        Ok(rows) => Ok(rows),
    }
}

fn rows(bench: &Bench) -> Result<Vec<Row>, KernelNetworkError> {
    // Fails at once if the kernel lacks something.
    compare::change_lag(Emulator::NetEm, 1)?;
    let mut rows = Vec::new();
    for (links, path) in LINKS {
        let delay = Duration::from_millis(10);
        for (emulator, name) in EMULATORS {
            bench.show(format!("delay over {path}: {name}"));
            let error = compare::delay_error(emulator, links, delay)?;
            rows.push(percentiles(format!("delay of 10 ms a link, {path}: {name} is late by"), error));
        }
    }
    for (links, path) in LINKS {
        let deviation = Duration::from_millis(2);
        let expected = deviation.as_secs_f64() * 1e3 * (links as f64).sqrt();
        for (emulator, name) in EMULATORS {
            bench.show(format!("jitter over {path}: {name}"));
            let found = compare::jitter(emulator, links, deviation)?.as_secs_f64() * 1e3;
            let error = (found / expected - 1.0) * 100.0;
            let figure = format!("jitter of 2 ms a link, {path} ({expected:.2} ms): {name}");
            rows.push(Row::new(figure, format!("{found:.2} ms"), format!("{error:+.1} %")));
        }
    }
    for (links, path) in LINKS {
        let rate = 0.05;
        let expected = (1.0 - (1.0_f64 - rate).powi(links as i32)) * 100.0;
        for (emulator, name) in EMULATORS {
            bench.show(format!("loss over {path}: {name}"));
            let found = compare::loss(emulator, links, Probability::new(rate).expect("a share"))? * 100.0;
            let figure = format!("loss of 5 % a link, {path} ({expected:.2} %): {name}");
            rows.push(Row::new(figure, format!("{found:.2} %"), format!("{:+.2} points", found - expected)));
        }
    }
    for (links, path) in LINKS {
        for (emulator, name) in EMULATORS {
            bench.show(format!("TCP over {path}: {name}"));
            let measure = |_| compare::throughput(emulator, links, Duration::from_secs(2));
            let mut rates = (0..3).map(measure).collect::<Result<Vec<_>, _>>()?;
            rates.sort_by(f64::total_cmp);
            let gbps = |rate: f64| format!("{:.2} Gbit/s", rate / 1e9);
            rows.push(Row::new(
                format!("TCP, {path}: {name}"),
                gbps(rates[1]),
                format!("lowest {}", gbps(rates[0])),
            ));
        }
    }
    for ((emulator, name), goal) in EMULATORS.into_iter().zip(["1 ms", "2 ms"]) {
        bench.show(format!("changes of a delay: {name}"));
        let lag = compare::change_lag(emulator, 50)?;
        let row = percentiles(format!("a change of delay, after the call returned: {name}"), lag);
        rows.push(row.aiming_at(goal));
    }
    Ok(rows)
}

fn percentiles(figure: String, Percentiles { p50, p99, max }: Percentiles) -> Row {
    let micros = |duration: Duration| format!("{:.1} µs", duration.as_secs_f64() * 1e6);
    Row::new(figure, micros(p50), format!("p99 {}, max {}", micros(p99), micros(max)))
}
