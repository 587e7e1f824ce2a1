//! The reasons for which samples missed their target: where those without an answer ended, the time of the others in every
//! host and on every link, and the part that explains those above the target.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_engine::InstanceWaits;
use cotorra_graph::{LinkId, LostAt, NodeId, ServiceId, ServiceTime, Testbed, TimeParts, VnfId, millis};
use serde::Serialize;

use super::times::Quantiles;
use crate::computed::Computed;

/// Most samples of a part, and most samples above the target, from which quantiles are computed. Of more, every second,
/// fourth and so on is used.
const MOST: usize = 512;

/// Parts of the times of a service.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceParts {
    pub service: ServiceId,
    /// Number of answered samples whose parts are known.
    pub samples: usize,
    /// Number of answered samples whose parts are unknown, because the fabric did not carry their packets.
    pub without_parts: usize,
    /// Number of answered samples above the target.
    pub late_answers: usize,
    /// Number of them whose parts are known.
    pub late_with_parts: usize,
    /// Number of samples without an answer in time.
    pub unanswered: usize,
    /// Places where these ended, that of most samples first.
    pub lost_at: Vec<LostSummary>,
    /// Mean time by kind of part. The means add up to the mean service time.
    pub mean: MeanParts,
    /// Links and hosts, those that explain most samples above the target first.
    pub parts: Vec<PartSummary>,
}

/// A place where samples without an answer ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LostSummary {
    /// The place; `None` if it is unknown, because the fabric did not follow their packets.
    #[serde(flatten)]
    pub at: Option<LostAt>,
    /// Number of samples that ended there.
    pub samples: usize,
}

/// Mean time in each kind of part, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct MeanParts {
    pub sender_ms: f64,
    pub air_out_ms: f64,
    pub wires_out_ms: f64,
    /// In queues, until channels were free, and in handovers.
    pub queueing_ms: f64,
    /// In VNFs and their hosts, without the next part.
    pub vnf_ms: f64,
    /// Waits of VNFs for a processor, at most the time in VNFs. In real time, they are for one of this machine: those of each
    /// instance's thread that waited longest, over all answered samples; zero if they are unknown. In virtual time, they are
    /// the mean waits of answers of VNFs with demands.
    pub processor_ms: f64,
    pub wires_back_ms: f64,
    pub air_back_ms: f64,
    /// Airtime of all attempts but the first.
    pub retries_ms: f64,
    pub receiver_ms: f64,
    pub unknown_time_ms: f64,
}

impl MeanParts {
    /// Takes waits for a processor, ms for each sample, out of the time in VNFs.
    fn with_processor(self, waited_ms: f64) -> Self {
        let processor_ms = waited_ms.min(self.vnf_ms);
        Self { vnf_ms: self.vnf_ms - processor_ms, processor_ms, ..self }
    }
}

/// A link, or one of `sender`, `vnf`, `receiver` and `unknown`. The time on a link is that of both ways, with queueing and
/// retries.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartSummary {
    pub part: String,
    /// Median of the samples within the target; `None` without any.
    pub within_p50_ms: Option<f64>,
    /// 95th percentile of the samples above the target; `None` without any.
    pub above_p95_ms: Option<f64>,
    /// 95th percentile of what samples above the target took longer than `within_p50_ms`, or than nothing without it.
    pub added_p95_ms: Option<f64>,
    /// Share of the answered samples above the target to which this part added most; `None` without such samples.
    pub explains: Option<f64>,
}

/// Values at even distances.
#[derive(Debug)]
struct Thinned<T> {
    kept: Vec<T>,
    seen: usize,
    every: usize,
}

impl<T> Default for Thinned<T> {
    fn default() -> Self {
        Self { kept: Vec::new(), seen: 0, every: 1 }
    }
}

impl<T> Thinned<T> {
    fn push(&mut self, value: T) {
        if self.kept.len() == MOST && self.seen.is_multiple_of(self.every) {
            let mut place = 0;
            self.kept.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            self.every *= 2;
        }
        if self.seen.is_multiple_of(self.every) {
            self.kept.push(value);
        }
        self.seen += 1;
    }
}

/// Parts of one service so far.
#[derive(Debug, Default)]
struct Gathered {
    samples: u32,
    unknown: usize,
    /// Sums in the order of [`MeanParts`].
    sums: [Duration; 10],
    names: Vec<String>,
    places: BTreeMap<String, usize>,
    /// Milliseconds of the samples within the target, by part.
    within: Vec<Thinned<f64>>,
    /// Parts and milliseconds of the samples above the target.
    above: Thinned<Vec<(usize, f64)>>,
    /// Number of answered samples above the target.
    late: usize,
    /// Number of samples without an answer, by the place where they ended.
    lost: BTreeMap<Option<LostAt>, usize>,
}

/// Gathers the parts of all samples.
#[derive(Debug)]
pub(super) struct TimePartsReport {
    /// Services with their targets, in the file's order.
    services: Vec<(ServiceId, Duration, Gathered)>,
    places: BTreeMap<ServiceId, usize>,
    wires: BTreeSet<LinkId>,
    /// The service of each VNF, and the service's robot. VNFs on the robot are part of the sender and the receiver.
    vnfs: BTreeMap<VnfId, (ServiceId, NodeId)>,
}

impl Gathered {
    /// Returns the time of each part, links in both directions together.
    fn by_name(&mut self, parts: &TimeParts) -> Vec<(usize, f64)> {
        let hosts = [
            ("sender", parts.sender),
            ("vnf", parts.vnf),
            ("receiver", parts.receiver),
            ("unknown", parts.unknown),
        ];
        let links = parts.links.iter().map(|on| (on.link.as_str(), on.total()));
        let mut all: Vec<(usize, f64)> = Vec::new();
        for (name, took) in hosts.into_iter().chain(links) {
            let place = self.place(name);
            match all.iter_mut().find(|(other, _)| *other == place) {
                Some((_, sum)) => *sum += millis::of(took),
                None => all.push((place, millis::of(took))),
            }
        }
        all
    }

    fn place(&mut self, name: &str) -> usize {
        if let Some(place) = self.places.get(name) {
            return *place;
        }
        let place = self.names.len();
        self.names.push(name.to_owned());
        self.places.insert(name.to_owned(), place);
        self.within.push(Thinned::default());
        place
    }

    fn sum(&mut self, parts: &TimeParts, is_wire: impl Fn(&LinkId) -> bool) {
        let [sender, air_out, wires_out, queueing, vnf, wires_back, air_back, retries, receiver, unknown] =
            &mut self.sums;
        *sender += parts.sender;
        *vnf += parts.vnf;
        *receiver += parts.receiver;
        *unknown += parts.unknown;
        for on in &parts.links {
            *queueing += on.queueing;
            *retries += on.retries;
            *match (is_wire(&on.link), on.back) {
                (true, false) => &mut *wires_out,
                (true, true) => &mut *wires_back,
                (false, false) => &mut *air_out,
                (false, true) => &mut *air_back,
            } += on.crossing;
        }
    }

    fn mean(&self) -> MeanParts {
        let mean = |sum: Duration| millis::of(sum) / f64::from(self.samples.max(1));
        let [sender, air_out, wires_out, queueing, vnf, wires_back, air_back, retries, receiver, unknown] =
            self.sums.map(mean);
        MeanParts {
            sender_ms: sender,
            air_out_ms: air_out,
            wires_out_ms: wires_out,
            queueing_ms: queueing,
            vnf_ms: vnf,
            processor_ms: 0.0,
            wires_back_ms: wires_back,
            air_back_ms: air_back,
            retries_ms: retries,
            receiver_ms: receiver,
            unknown_time_ms: unknown,
        }
    }

    fn lost(&self) -> Vec<LostSummary> {
        let summary =
            |(at, samples): (&Option<LostAt>, &usize)| LostSummary { at: at.clone(), samples: *samples };
        let mut lost: Vec<_> = self.lost.iter().map(summary).collect();
        lost.sort_by_key(|place| std::cmp::Reverse(place.samples));
        lost
    }

    fn parts(&self) -> Vec<PartSummary> {
        let usual: Vec<_> =
            self.within.iter().map(|its| Quantiles::of(its.kept.clone()).map(|q| q.p50)).collect();
        let count = self.names.len();
        let (mut above, mut added) = (vec![Vec::new(); count], vec![Vec::new(); count]);
        let mut explained = vec![0_usize; count];
        for sample in &self.above.kept {
            let mut most: Option<(usize, f64)> = None;
            for (place, ms) in sample.iter().copied() {
                let more = ms - usual[place].unwrap_or(0.0);
                above[place].push(ms);
                added[place].push(more);
                if most.is_none_or(|(_, before)| more > before) {
                    most = Some((place, more));
                }
            }
            if let Some((place, _)) = most {
                explained[place] += 1;
            }
        }
        let p95 = |values: Vec<f64>| Quantiles::of(values).map(|quantiles| quantiles.p95);
        let missed = self.above.kept.len();
        let part = |(place, (above, added)): (usize, (Vec<f64>, Vec<f64>))| PartSummary {
            part: self.names[place].clone(),
            within_p50_ms: usual[place],
            above_p95_ms: p95(above),
            added_p95_ms: p95(added),
            explains: (missed > 0).then(|| explained[place] as f64 / missed as f64),
        };
        let mut parts: Vec<_> = above.into_iter().zip(added).enumerate().map(part).collect();
        parts.sort_by(|a, b| b.explains.partial_cmp(&a.explains).unwrap_or(std::cmp::Ordering::Equal));
        parts
    }
}

impl TimePartsReport {
    pub fn new(testbed: &Testbed) -> Self {
        let service = |service: &cotorra_graph::Service| {
            (service.id.clone(), service.kpis.service_time, Gathered::default())
        };
        Self {
            services: testbed.services.iter().map(service).collect(),
            places: testbed.services.iter().map(|service| service.id.clone()).zip(0..).collect(),
            wires: testbed.graph.links.iter().map(|link| link.id.clone()).collect(),
            vnfs: testbed
                .services
                .iter()
                .flat_map(|service| {
                    service
                        .vnfs
                        .iter()
                        .map(|vnf| (vnf.id.clone(), (service.id.clone(), service.robot.clone())))
                })
                .collect(),
        }
    }

    /// Returns the waits of each service's VNFs for a processor, ms for each of its samples with parts.
    fn waited_ms(&self, waits: &[InstanceWaits], computed: &[Computed]) -> BTreeMap<&ServiceId, f64> {
        let mut waited_ms: BTreeMap<_, f64> = BTreeMap::new();
        for InstanceWaits { vnf, node, waits } in waits {
            if let (Some((service, robot)), Some(waits)) = (self.vnfs.get(vnf), waits)
                && node != robot
            {
                let samples = self.places.get(service).map_or(0, |place| self.services[*place].2.samples);
                *waited_ms.entry(service).or_default() +=
                    millis::of(waits.longest) / f64::from(samples.max(1));
            }
        }
        let mut by_vnf: BTreeMap<&VnfId, [f64; 2]> = BTreeMap::new();
        for Computed { vnf, node, waiting_ms, waited_ms, .. } in computed {
            if self.vnfs.get(vnf).is_some_and(|(_, robot)| node != robot) {
                let [sum, count] = by_vnf.entry(vnf).or_default();
                *sum += waited_ms;
                *count += waiting_ms.count() as f64;
            }
        }
        for (vnf, [sum, count]) in by_vnf {
            if let Some((service, _)) = self.vnfs.get(vnf).filter(|_| count > 0.0) {
                *waited_ms.entry(service).or_default() += sum / count;
            }
        }
        waited_ms
    }

    /// Adds a sample.
    pub fn absorb(&mut self, sample: &ServiceTime) {
        let Some(&place) = self.places.get(&sample.service) else { return };
        let (_, target, gathered) = &mut self.services[place];
        let Some(took) = sample.took else {
            *gathered.lost.entry(sample.lost_at.as_deref().cloned()).or_default() += 1;
            return;
        };
        gathered.late += usize::from(took > *target);
        let Some(parts) = &sample.parts else {
            gathered.unknown += 1;
            return;
        };
        gathered.samples += 1;
        gathered.sum(parts, |link| self.wires.contains(link));
        let by_name = gathered.by_name(parts);
        if took > *target {
            gathered.above.push(by_name);
        } else {
            by_name.into_iter().for_each(|(place, ms)| gathered.within[place].push(ms));
        }
    }

    /// Returns the parts of each service with samples, in the file's order, in a run with these waits of VNFs for a
    /// processor.
    pub fn summary(&self, waits: &[InstanceWaits], computed: &[Computed]) -> Vec<ServiceParts> {
        let waited_ms = self.waited_ms(waits, computed);
        let waited_ms = |service: &ServiceId| waited_ms.get(service).copied().unwrap_or_default();
        let measured = |its: &Gathered| its.samples > 0 || its.unknown > 0 || !its.lost.is_empty();
        let measured = self.services.iter().filter(|(.., its)| measured(its));
        let summary = |(service, _, its): &(ServiceId, Duration, Gathered)| ServiceParts {
            service: service.clone(),
            samples: its.samples as usize,
            without_parts: its.unknown,
            late_answers: its.late,
            late_with_parts: its.above.seen,
            unanswered: its.lost.values().sum(),
            lost_at: its.lost(),
            mean: its.mean().with_processor(waited_ms(service)),
            parts: its.parts(),
        };
        measured.map(summary).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cotorra_engine::ProcessorWaits;
    use cotorra_graph::{Direction, LinkTime, LostCause, Timestamp};
    use cotorra_graph_testing as base;
    use proptest::{collection::vec, prelude::*};

    use super::*;

    const TESTBED: &str = "
name: test
wireless: { lab: {} }
nodes:
  r: { kind: robot, position: [0, 0] }
  A: { kind: radio_unit, position: [0, 1], channel: 1 }
  s: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [A, s] }
services:
  n:
    robot: r
    kpis: { service_time: 15 ms, flow: { protocol: udp, port: 9000 } }
    vnfs: { v: { command: [v], node: s } }
";

    fn report() -> TimePartsReport {
        let testbed = cotorra_testbed_file::parse("test.yaml", TESTBED, Path::new("")).unwrap();
        TimePartsReport::new(&testbed)
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    /// Waits of an instance of a VNF on a node, of one of its threads.
    fn waits(vnf: &str, node: &str, waited: u64) -> InstanceWaits {
        let waits = ProcessorWaits { all: ms(2 * waited), longest: ms(waited), runs: 1 };
        InstanceWaits { vnf: vnf.parse().unwrap(), node: node.parse().unwrap(), waits: Some(waits) }
    }

    /// A sample with these milliseconds: in the VNF, on the air to it, on the wire to it with queueing, and back.
    fn sample([vnf, air, wire, queueing, back]: [u64; 5]) -> ServiceTime {
        let on = |link: &str, back, queueing, crossing| LinkTime {
            link: link.parse().unwrap(),
            direction: Direction::Forward,
            back,
            queueing: ms(queueing),
            retries: Duration::ZERO,
            crossing: ms(crossing),
        };
        let links =
            vec![on("r~A", false, 0, air), on("A-s", false, queueing, wire), on("A-s", true, 0, back)];
        let parts = TimeParts { vnf: ms(vnf), links, ..TimeParts::default() };
        let took = Some(parts.total());
        ServiceTime {
            service: "n".parse().unwrap(),
            robot: "r".parse().unwrap(),
            parts: Some(Box::new(parts)),
            ..base::service_time("s", Timestamp::ZERO, took)
        }
    }

    #[test]
    fn the_part_that_grew_most_explains_a_sample_above_the_target() {
        let mut report = report();
        // The VNF is the largest part of all samples, and the wire the one that grows.
        let within = [[6, 2, 1, 0, 1], [6, 2, 1, 0, 1], [6, 3, 1, 0, 1]];
        let above = [[7, 2, 1, 5, 3], [7, 2, 1, 9, 1], [20, 2, 1, 0, 1]];
        within.into_iter().chain(above).for_each(|ms| report.absorb(&sample(ms)));
        report.absorb(&ServiceTime { took: None, parts: None, ..sample([0; 5]) });
        report.absorb(&ServiceTime { parts: None, ..sample([1; 5]) });
        let [its] = &report.summary(&[], &[])[..] else { panic!("one service") };
        assert_eq!((its.samples, its.without_parts), (6, 1));
        assert_eq!((its.late_answers, its.late_with_parts, its.unanswered), (3, 3, 1));
        let part = |name: &str| its.parts.iter().find(|part| part.part == name).unwrap();
        assert_eq!(its.parts[0].part, "A-s");
        assert_eq!(part("A-s").within_p50_ms, Some(2.0));
        // Of 9, 11 and 2 ms.
        assert!((part("A-s").above_p95_ms.unwrap() - 10.8).abs() < 1e-9);
        assert!((part("A-s").added_p95_ms.unwrap() - 8.8).abs() < 1e-9);
        let shares = ["A-s", "vnf", "r~A"].map(|name| part(name).explains.unwrap());
        assert_eq!(shares, [2.0 / 3.0, 1.0 / 3.0, 0.0]);
        let MeanParts { air_out_ms, wires_out_ms, wires_back_ms, queueing_ms, vnf_ms, .. } = its.mean;
        let means = [air_out_ms, wires_out_ms, wires_back_ms, queueing_ms, vnf_ms];
        assert_eq!(means.map(|mean| (mean * 6.0).round()), [13.0, 6.0, 8.0, 14.0, 52.0]);
    }

    #[test]
    fn samples_without_an_answer_are_counted_by_the_place_where_they_ended() {
        let mut report = report();
        let at = |link: &str, back, cause| LostAt { link: Some(link.parse().unwrap()), back, cause };
        let on_air = at("r~A", false, LostCause::Loss);
        let queued = at("A-s", true, LostCause::FullQueue);
        for lost_at in [Some(&queued), None, Some(&on_air), Some(&on_air), Some(&on_air), Some(&queued)] {
            let lost_at = lost_at.cloned().map(Box::new);
            report.absorb(&ServiceTime { took: None, parts: None, lost_at, ..sample([0; 5]) });
        }
        let [its] = &report.summary(&[], &[])[..] else { panic!("a service without any answer") };
        assert_eq!((its.samples, its.unanswered, its.late_answers), (0, 6, 0));
        let lost: Vec<_> = its.lost_at.iter().map(|place| (place.at.clone(), place.samples)).collect();
        assert_eq!(lost, [(Some(on_air), 3), (Some(queued), 2), (None, 1)]);
        let json = serde_json::to_value(&its.lost_at).unwrap();
        let expected = serde_json::json!([
            { "link": "r~A", "back": false, "cause": "loss", "samples": 3 },
            { "link": "A-s", "back": true, "cause": "full_queue", "samples": 2 },
            { "samples": 1 },
        ]);
        assert_eq!(json, expected);
    }

    #[test]
    fn a_service_within_its_target_needs_no_explanation() {
        let mut report = report();
        assert!(report.summary(&[], &[]).is_empty());
        report.absorb(&sample([1; 5]));
        let [its] = &report.summary(&[], &[])[..] else { panic!("one service") };
        assert!(its.parts.iter().all(|part| part.explains.is_none() && part.added_p95_ms.is_none()));
    }

    proptest! {
        #[test]
        fn thinned_values_are_bounded_and_even(count in 0..5000_usize) {
            let mut thinned = Thinned::default();
            (0..count).for_each(|value| thinned.push(value));
            prop_assert!(thinned.kept.len() <= MOST && thinned.kept.len() >= count.min(MOST / 2));
            let expected: Vec<_> = (0..count).step_by(thinned.every).collect();
            prop_assert_eq!(thinned.kept, expected);
        }

        #[test]
        fn means_add_up_to_the_mean_service_time(
            all in vec(proptest::array::uniform5(0..50_u64), 1..20),
            waited in 0..500_u64,
        ) {
            let mut report = report();
            all.iter().for_each(|ms| report.absorb(&sample(*ms)));
            let sum: u64 = all.iter().flatten().sum();
            let mean = report.summary(&[waits("v", "s", waited), waits("v", "r", 9), waits("other", "s", 9)], &[])[0].mean;
            let in_vnf: u64 = all.iter().map(|[vnf, ..]| vnf).sum();
            prop_assert!((mean.processor_ms - waited.min(in_vnf) as f64 / all.len() as f64).abs() < 1e-9);
            let parts = serde_json::to_value(mean).unwrap();
            let added: f64 = parts.as_object().unwrap().values().map(|ms| ms.as_f64().unwrap()).sum();
            prop_assert!((added - sum as f64 / all.len() as f64).abs() < 1e-9);
        }
    }
}
