//! For how long VNFs waited for a processor of this machine, in a run's summary and in its verdict.

use std::{collections::BTreeMap, time::Duration};

use cotorra_engine::{InstanceWaits, ProcessorWaits};
use cotorra_graph::{Testbed, VnfId, millis};
use serde::{Deserialize, Serialize};

use super::measured_frames::VALID_P99_US;

/// Highest trusted share of a run in which a thread waited for a processor. Below, its waits are too few to matter.
const VALID_SHARE: f64 = 1e-3;

/// For how long a VNF waited for a processor although it was ready to run. Waits for its own limit, `cpus`, do not count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct VnfWaits {
    pub vnf: VnfId,
    /// All waits of all its instances, ms; `None` if they are unknown, as in containers.
    pub waited_ms: Option<f64>,
    /// Mean wait of the thread that waited longest, each time before it ran, ms.
    pub wait_ms: Option<f64>,
    /// Whether it waited for so long that its figures are the machine's, and not its own.
    pub is_starved: bool,
}

impl VnfWaits {
    /// Describes the waits of VNFs in a run of this duration. Those in containers are unknown.
    pub(super) fn of(instances: &[InstanceWaits], unwatched: &[VnfId], duration: Duration) -> Vec<Self> {
        let mut by_vnf: BTreeMap<&VnfId, Vec<Option<ProcessorWaits>>> = BTreeMap::new();
        for InstanceWaits { vnf, waits, .. } in instances {
            by_vnf.entry(vnf).or_default().push(*waits);
        }
        for vnf in unwatched {
            by_vnf.entry(vnf).or_default().push(None);
        }
        let of_vnf = |(vnf, waits): (&VnfId, Vec<Option<ProcessorWaits>>)| {
            let known: Option<Vec<_>> = waits.iter().copied().collect();
            let all = |known: &Vec<ProcessorWaits>| known.iter().map(|its| its.all).sum();
            let each = waits.iter().flatten().filter(|its| its.runs > 0).map(each_ms);
            Self {
                vnf: vnf.clone(),
                waited_ms: known.as_ref().map(all).map(millis::of),
                wait_ms: each.reduce(f64::max),
                is_starved: waits.iter().flatten().any(|its| is_starved(its, duration)),
            }
        };
        by_vnf.into_iter().map(of_vnf).collect()
    }

    /// Returns the VNFs of a testbed whose processes this machine's kernel does not tell apart: those in containers.
    pub(super) fn unwatched(testbed: &Testbed) -> Vec<VnfId> {
        let is_here = |id: &_| testbed.graph.node(id).is_none_or(|node| node.real_server().is_none());
        let contained = testbed.vnfs().filter(|vnf| vnf.image.is_some());
        contained.filter(|vnf| vnf.node.all().iter().any(is_here)).map(|vnf| vnf.id.clone()).collect()
    }

    /// Describes the waits of a starved VNF, for people.
    pub fn sentence(&self) -> String {
        let (waited, each) = (self.waited_ms.unwrap_or_default() / 1e3, self.wait_ms.unwrap_or_default());
        format!(
            "waited for a processor for {waited:.1} s, {each:.1} ms at a time: the machine was slow, and not the VNF"
        )
    }
}

fn each_ms(its: &ProcessorWaits) -> f64 {
    millis::of(its.longest) / its.runs as f64
}

fn is_starved(its: &ProcessorWaits, duration: Duration) -> bool {
    its.runs > 0 && each_ms(its) > VALID_P99_US / 1e3 && its.longest > duration.mul_f64(VALID_SHARE)
}

#[cfg(test)]
mod tests {
    use cotorra_graph::Lateness;

    use super::{super::fidelity::Fidelity, super::measured_frames::MeasuredFrames, *};

    const MINUTE: Duration = Duration::from_secs(60);

    fn instance(vnf: &str, waits: Option<(u64, u64)>) -> InstanceWaits {
        let waits = waits.map(|(ms, runs)| {
            let longest = Duration::from_millis(ms);
            ProcessorWaits { all: longest, longest, runs }
        });
        InstanceWaits { vnf: vnf.parse().unwrap(), node: "edge".parse().unwrap(), waits }
    }

    fn judged(instances: &[InstanceWaits], unwatched: &[VnfId]) -> Fidelity {
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        let waits = VnfWaits::of(instances, unwatched, MINUTE);
        Fidelity::of(MeasuredFrames::All, good, 0, false).with_vnf_waits(waits)
    }

    #[test]
    fn a_starved_vnf_makes_the_verdict_invalid_and_the_machine_is_blamed() {
        let localization =
            [instance("navigation", Some((5, 300))), instance("localization", Some((24_000, 1700)))];
        let starved = judged(&localization, &[]);
        let expected = "VNF `localization` waited for a processor for 24.0 s, 14.1 ms at a time: the machine was slow, and not \
                        the VNF";
        assert_eq!((starved.valid, starved.reason.as_str()), (false, expected));
        // One of its instances is enough.
        assert!(!judged(&[instance("a", Some((0, 9))), instance("a", Some((500, 20)))], &[]).valid);
    }

    #[test]
    fn short_waits_before_each_run_and_rare_long_ones_are_allowed() {
        // 30 µs before each of many runs, and 40 ms once in a minute.
        let good = [instance("busy", Some((1800, 60_000))), instance("idle", Some((40, 3)))];
        assert!(judged(&good, &[]).valid);
        assert!(!judged(&[instance("idle", Some((61, 3)))], &[]).valid);
    }

    #[test]
    fn waits_that_the_kernel_does_not_tell_are_unknown() {
        let unknown = judged(&[instance("a", None)], &["boxed".parse().unwrap()]);
        assert!(unknown.valid, "{unknown:?}");
        assert!(
            unknown.reason.ends_with("how long VNF `a`, `boxed` waited for a processor is unknown"),
            "{unknown:?}"
        );
        // The others still count.
        assert!(!judged(&[instance("a", None), instance("b", Some((9000, 9)))], &[]).valid);
    }
}
