//! The traffic of gateways and real servers in a run's summary and in its verdict.

use cotorra_datapath::{GatewayTraffic, Passed};
use cotorra_graph::{Lateness, NodeId};
use serde::Serialize;

use super::{
    fidelity::{Fidelity, LatenessSummary},
    measured_frames::{VALID_P50_US, VALID_P99_US},
};

/// The traffic of a gateway or a real server between the real and the emulated network.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GatewaySummary {
    /// The gateway, or the real server.
    pub gateway: NodeId,
    /// Frames from outside that went on to the emulated network.
    pub received_frames: u64,
    /// Frames from the emulated network that went out.
    pub sent_frames: u64,
    /// Frames from outside that broke a rule of the gateway.
    pub rejected_frames: u64,
    /// Frames lost unintentionally: the interface was down, or a queue was full.
    pub frames_dropped: u64,
    /// Time from a frame's arrival in the kernel until the emulated network had it, µs.
    pub received_lateness_us: LatenessSummary,
    /// Time in which the kernel took a frame to the interface, µs.
    pub sent_lateness_us: LatenessSummary,
}

impl From<GatewayTraffic> for GatewaySummary {
    fn from(GatewayTraffic { gateway, passed }: GatewayTraffic) -> Self {
        let Passed { received, sent, rejected, dropped, received_lateness, sent_lateness } = passed;
        let quantiles = |Lateness { p50_us, p99_us, max_us, .. }| LatenessSummary {
            p50: p50_us,
            p99: p99_us,
            max: max_us,
        };
        Self {
            gateway,
            received_frames: received,
            sent_frames: sent,
            rejected_frames: rejected,
            frames_dropped: dropped,
            received_lateness_us: quantiles(received_lateness),
            sent_lateness_us: quantiles(sent_lateness),
        }
    }
}

impl GatewaySummary {
    /// Returns why its delay makes the figures of a run invalid; `None` if it does not.
    fn reason(&self) -> Option<String> {
        let Self { gateway, received_lateness_us: received, sent_lateness_us: sent, .. } = self;
        let both = [("received", received), ("sent", sent)];
        let late = |share: &str, limit: f64, of: fn(&LatenessSummary) -> f64| {
            let (what, late) = both.into_iter().find(|(_, lateness)| of(lateness) > limit)?;
            let late = of(late);
            Some(format!(
                "the interface of `{gateway}` took more than {late:.0} µs for {share} of the frames that it {what}; {limit:.0} µs \
                 are allowed"
            ))
        };
        late("1 %", VALID_P99_US, |its| its.p99).or_else(|| late("half", VALID_P50_US, |its| its.p50))
    }
}

impl Fidelity {
    /// Extends the verdict to gateways: a delay that they add is not asked for.
    pub(super) fn with_gateways(self, gateways: &[GatewaySummary]) -> Self {
        match gateways.iter().find_map(GatewaySummary::reason) {
            Some(reason) if self.valid => Self { valid: false, reason, ..self },
            _ => self,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_gateway_makes_the_verdict_invalid() {
        const GOOD: LatenessSummary = LatenessSummary { p50: 20.0, p99: 300.0, max: 5000.0 };
        let valid = || Fidelity {
            valid: true,
            exact: false,
            away: None,
            vnf_waits: Vec::new(),
            lateness_us: GOOD,
            frames: 10,
            frames_dropped: 0,
            reason: "good".to_owned(),
        };
        let gateway = |received, sent| {
            let mut summary = GatewaySummary::from(GatewayTraffic {
                gateway: "gate".parse().unwrap(),
                passed: Passed::default(),
            });
            (summary.received_lateness_us, summary.sent_lateness_us) = (received, sent);
            [summary]
        };
        assert_eq!(valid().with_gateways(&gateway(GOOD, GOOD)), valid());
        let slow = LatenessSummary { p50: 251.0, ..GOOD };
        let late = valid().with_gateways(&gateway(slow, GOOD));
        assert!(
            !late.valid && late.reason.contains("251 µs for half of the frames that it received"),
            "{late:?}"
        );
        let rare = LatenessSummary { p99: 1001.0, ..GOOD };
        let late = valid().with_gateways(&gateway(GOOD, rare));
        assert!(
            !late.valid && late.reason.contains("1001 µs for 1 % of the frames that it sent"),
            "{late:?}"
        );
        let worse = Fidelity { valid: false, reason: "worse".to_owned(), ..valid() };
        assert_eq!(worse.clone().with_gateways(&gateway(rare, rare)), worse);
    }
}
