//! Captures at both ends of paths, whose clocks differ and drift.

use std::array;

use cotorra_calibrate::{Means, fit_path, one_way_of_captures};
use cotorra_numbers::Draws;

use super::{
    Coverage, between,
    paths::{Truth, packet_times},
    sites,
};

/// A pcap file of UDP packets without an Ethernet header (link type 101).
#[derive(Default)]
struct Capture(Vec<(i64, u32, [u8; 2])>);

impl Capture {
    fn write(mut self) -> Vec<u8> {
        self.0.sort_unstable();
        let mut file = [0xa1b2_3c4d, 0x0004_0002, 0, 0, 65_535, 101_u32].map(u32::to_le_bytes).concat();
        for (at_ns, number, [from, to]) in self.0 {
            let mut packet = vec![0x45, 0, 0, 48, 0, 0, 0, 0, 64, 17, 0, 0, 10, 0, 0, from, 10, 0, 0, to];
            packet.extend([7000_u16, 7001, 28, 0].map(u16::to_be_bytes).concat());
            packet.extend(number.to_be_bytes());
            packet.resize(48, 0);
            let (seconds, ns) = (at_ns / 1_000_000_000, at_ns % 1_000_000_000);
            file.extend([seconds as u32, ns as u32, 48, 48].map(u32::to_le_bytes).concat());
            file.extend(packet);
        }
        file
    }
}

#[test]
fn one_way_intervals_hold_the_true_values() {
    let mut coverage = Coverage::default();
    for seed in 0..sites() as u64 {
        let mut draws = Draws::new(seed, "one way");
        let (offset_s, drift) = (between(&mut draws, [-1000.0, 1000.0]), between(&mut draws, [-5e-5, 5e-5]));
        let second_clock = |ns: i64| ns + (offset_s * 1e9) as i64 + (ns as f64 * drift) as i64;
        let mut captures: [Capture; 2] = Default::default();
        let truths: [Truth; 2] = array::from_fn(|_| Truth::draw(&mut draws));
        for (truth, hosts) in truths.iter().zip([[1, 2], [2, 1]]) {
            for (number, ms) in (0..).zip(packet_times(*truth, &mut draws).times_ms) {
                let sent = 2_000_000_000_000 + i64::from(number) * 20_000_000;
                let arrived = ms.map(|ms| sent + (ms * 1e6) as i64);
                let (near, far) = if hosts[0] == 1 { (Some(sent), arrived) } else { (arrived, Some(sent)) };
                captures[0].0.extend(near.map(|at| (at, number, hosts)));
                captures[1].0.extend(far.map(|at| (second_clock(at), number, hosts)));
            }
        }
        let [first, second] = captures.map(Capture::write);
        let measured = one_way_of_captures(&first, &second).unwrap();
        assert_eq!(measured.means, Means::Halves);
        let fits = measured.ways.map(|way| fit_path(&way.unwrap(), seed).unwrap());
        for (fit, truth) in fits.iter().zip(truths) {
            coverage.count("one-way jitter", fit.deviation_ms, truth.deviation_ms);
            coverage.count("one-way loss", fit.loss.unwrap().share, truth.loss);
        }
        // The clocks change only how the sum is divided.
        let sum = fits[0].mean_ms.value + fits[1].mean_ms.value;
        let error = sum - truths[0].mean_ms - truths[1].mean_ms;
        let widths = fits.each_ref().map(|fit| (fit.mean_ms.high - fit.mean_ms.low) / 2.0);
        coverage.0.entry("sum of means").or_default().push(error.abs() < widths[0].hypot(widths[1]));
    }
    coverage.check();
}
