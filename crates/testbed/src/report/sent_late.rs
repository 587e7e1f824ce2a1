//! Datagrams of sources of traffic that were sent late, in the verdict on a run with real packets.

use cotorra_traffic::Measured;

use super::{fidelity::Fidelity, measured_frames::VALID_P99_US};

impl Fidelity {
    /// Extends the verdict to sources of traffic that could not keep their rates.
    pub(super) fn with_traffic(self, traffic: &[Measured]) -> Self {
        let late = |measured: &Measured| {
            let p99_us = measured.udp.as_ref()?.sent_lateness_us?.p99;
            (p99_us > VALID_P99_US).then(|| (measured.source.clone(), p99_us))
        };
        match traffic.iter().find_map(late) {
            Some((source, p99_us)) if self.valid => {
                let reason = format!(
                    "traffic {source} did not keep its rate: 1 % of its datagrams were sent later than {p99_us:.0} µs; \
                     {VALID_P99_US:.0} µs are allowed"
                );
                Self { valid: false, reason, ..self }
            }
            _ => self,
        }
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Lateness;
    use cotorra_numbers::Quantiles;
    use cotorra_traffic::UdpMeasured;

    use super::{super::measured_frames::MeasuredFrames, *};

    fn measured(p99: Option<f64>) -> Measured {
        let sent_lateness_us = p99.map(|p99| Quantiles { p50: 10.0, p95: 20.0, p99, max: 9000.0 });
        Measured {
            source: "video".parse().unwrap(),
            from: "a".parse().unwrap(),
            to: "b".parse().unwrap(),
            link: None,
            direction: None,
            sent_packets: 10,
            bytes: 1000,
            goodput_bps: 8000.0,
            goodput_by_second_bps: vec![8000],
            udp: Some(UdpMeasured { received_packets: 10, lost: 0, delay_ms: None, sent_lateness_us }),
            tcp: None,
        }
    }

    #[test]
    fn a_source_that_sends_late_makes_the_run_not_valid() {
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        let valid = || Fidelity::of(MeasuredFrames::All, good, 0, false);
        assert_eq!(valid().with_traffic(&[measured(None), measured(Some(900.0))]), valid());
        let late = valid().with_traffic(&[measured(Some(900.0)), measured(Some(1500.0))]);
        assert!(!late.valid && late.reason.contains("video") && late.reason.contains("1500 µs"), "{late:?}");
        let worse = Fidelity { valid: false, reason: "worse".to_owned(), ..valid() };
        assert_eq!(worse.clone().with_traffic(&[measured(Some(1500.0))]), worse);
    }
}
