//! Computes a run's summary from its events.

use std::{collections::BTreeMap, path::Path};

use cotorra_graph::{
    Event, Instruction, Lateness, NodeId, Nodes, PoseSource, Position, Requests, ServiceId, ServiceTime,
    Stamped, Testbed, Timestamp, VnfId, millis,
};
use cotorra_localization::trajectory::Errors;
use serde::Serialize;

use super::{
    driving::{Driving, DrivingSummary},
    end::End,
    folder::FolderError,
    samples::Samples,
};

/// Highest trusted lateness at the 99th percentile, µs.
const VALID_P99_US: f64 = 1000.0;
/// Highest trusted lateness at the median, µs.
const VALID_P50_US: f64 = 250.0;
/// Highest trusted share of frames lost unintentionally.
const VALID_DROPPED: f64 = 1e-4;
/// Lowest number of probes that says something about one in a hundred.
const VALID_PROBES: u64 = 100;
/// Maximum number of notices.
const MOST_NOTICES: usize = 100;

/// The content of `summary.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the testbed.
    pub name: String,
    /// Version of cotorra in the run.
    pub version: &'static str,
    pub seed: u64,
    /// Duration, milliseconds.
    pub duration_ms: f64,
    /// Reason for the end.
    pub ended: &'static str,
    /// Number of service times, unanswered ones included.
    pub samples: usize,
    /// Number of service times without an answer within the robot's command timeout.
    pub unanswered: usize,
    /// Target service time of the first service, milliseconds.
    pub service_time_target_ms: Option<f64>,
    /// Share of samples above the target of their service. Unanswered ones count as above it.
    pub above_target: Option<f64>,
    /// Service times of all answered samples, milliseconds.
    pub service_time_ms: Option<Quantiles>,
    /// Summaries of the measured services, in the file's order.
    pub services: Vec<ServiceSummary>,
    /// Stretches with one attachment and one server, in order.
    pub regions: Vec<RegionSummary>,
    /// Changes of attachment, in order.
    pub handovers: Vec<HandoverRecord>,
    /// Placements, in order, those at the start included.
    pub placements: Vec<PlacementRecord>,
    /// Verdict on the emulation.
    pub fidelity: Fidelity,
    /// Last source of the robots' poses; `None` without robots.
    pub pose_source: Option<PoseSource>,
    /// Localization errors of each robot that a VNF localized and whose true position is known.
    pub localization: Vec<LocalizationSummary>,
    /// Distances of each robot that is navigated along a walk.
    pub driving: Vec<DrivingSummary>,
    /// Plug-ins that were cut off, each with the reason.
    pub plugin_faults: Vec<String>,
    /// The first hundred notices.
    pub notices: Vec<String>,
    /// Number of events that the history had no room for.
    pub history_dropped: u64,
}

/// The service times of one service.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceSummary {
    pub service: ServiceId,
    /// Number of service times, unanswered ones included.
    pub samples: usize,
    /// Number of service times without an answer in time.
    pub unanswered: usize,
    /// Target, milliseconds.
    pub service_time_target_ms: f64,
    /// Share of samples above the target. Unanswered ones count as above it.
    pub above_target: Option<f64>,
    /// Service times of all answered samples, milliseconds.
    pub service_time_ms: Option<Quantiles>,
}

/// Errors of a robot's localization at each collection of κ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LocalizationSummary {
    pub robot: NodeId,
    /// Number of comparisons.
    pub samples: usize,
    /// Distance from the estimated to the true position, metres.
    pub error_m: Quantiles,
    /// Mean of the normalized estimation error squared: 3 if the covariance matches the errors, more if it is too small.
    pub nees: f64,
}

/// Quantiles by linear interpolation between closest ranks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl Quantiles {
    /// Returns the quantiles of these values; `None` without values.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let max = *values.last()?;
        let at = |q: f64| {
            let rank = q * (values.len() - 1) as f64;
            let (low, high) = (values[rank.floor() as usize], values[rank.ceil() as usize]);
            low + (high - low) * rank.fract()
        };
        Some(Self { p50: at(0.5), p95: at(0.95), p99: at(0.99), max })
    }
}

/// A stretch of a service with one attachment and one server.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RegionSummary {
    pub robot: NodeId,
    pub service: ServiceId,
    /// Radio unit; `None` without attachment.
    pub attachment: Option<NodeId>,
    /// Node of the navigation VNF, or of the server of the service's flow. If requests go to all instances, the node that
    /// answered the first sample.
    pub server: NodeId,
    /// Emission of the first sample.
    #[serde(rename = "from_ns")]
    pub from: Timestamp,
    /// Emission of the last sample.
    #[serde(rename = "until_ns")]
    pub until: Timestamp,
    /// Number of samples.
    pub samples: usize,
    /// Median service time, milliseconds; `None` without an answered sample.
    pub service_time_p50_ms: Option<f64>,
}

/// A change of attachment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HandoverRecord {
    /// Time of completion.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    pub robot: NodeId,
    /// The radio unit before.
    pub from: Option<NodeId>,
    /// The radio unit after.
    pub to: NodeId,
    /// Time without frames, milliseconds.
    pub gap_ms: f64,
    /// Whether fast transition was used.
    pub fast: bool,
    /// The robot's position; `None` if it is not known.
    pub position: Option<Position>,
}

/// The placement of a VNF on a node, or on several.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlacementRecord {
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    pub vnf: VnfId,
    /// The node, or the nodes of the instances.
    pub node: Nodes,
    /// The position of the service's robot; `None` if it is not known.
    pub position: Option<Position>,
}

/// An applied instruction of a plug-in: another radio unit, or another node for a VNF.
#[derive(Debug, Clone, PartialEq)]
pub struct DecisionRecord {
    pub at: Timestamp,
    pub instruction: Instruction,
    /// The position of the robot concerned; `None` if it is not known.
    pub position: Option<Position>,
}

/// Verdict on the emulation: whether it did what the testbed file demands.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fidelity {
    /// Whether the figures can be trusted.
    pub valid: bool,
    /// Lateness of frames, µs.
    pub lateness_us: LatenessSummary,
    /// Number of frames in the verdict: all, or only probes if the kernel's NetEm carried the frames.
    pub frames: u64,
    /// Frames lost unintentionally: an interface was down, or its queue was full.
    pub frames_dropped: u64,
    /// Reason for the verdict, with the limits.
    pub reason: String,
}

/// Quantiles of the lateness, µs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LatenessSummary {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl Summary {
    /// Whether the run ended because every walk was done.
    pub fn is_walked(&self) -> bool {
        self.ended == End::Walked.as_str()
    }
}

/// Frames whose lateness is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum MeasuredFrames {
    /// All frames, because the fabric carried them.
    All,
    /// The frames that the fabric carried; others crossed interfaces of this machine.
    Emulated,
    /// Probes alone, because the kernel carried the frames.
    Probes,
}

impl Fidelity {
    /// Judges the frames of a run. Without any, it is valid only if `is_idle`, i.e. nothing that it measures needs one.
    fn of(measured_frames: MeasuredFrames, lateness: Lateness, frames_dropped: u64, is_idle: bool) -> Self {
        let Lateness { frames, p50_us, p99_us, max_us } = lateness;
        let (which, what) = match measured_frames {
            MeasuredFrames::All | MeasuredFrames::Emulated => ("", "the frames"),
            MeasuredFrames::Probes => {
                ("the kernel's NetEm carried the frames, and only probes tell how late; ", "the probes")
            }
        };
        let (valid, reason) = if measured_frames == MeasuredFrames::Probes && frames < VALID_PROBES {
            (
                false,
                format!(
                    "{which}{frames} of them did, and {VALID_PROBES} are needed (those of links with jitter or reordering \
                     cannot tell)"
                ),
            )
        } else if frames == 0 && measured_frames == MeasuredFrames::Emulated {
            (false, "the kernel's NetEm carried the frames, and tells nobody how late they were".to_owned())
        } else if frames == 0 && !is_idle {
            (false, "no frame crossed the emulated network".to_owned())
        } else if frames_dropped as f64 > frames as f64 * VALID_DROPPED {
            (
                false,
                format!("{frames_dropped} frames were lost at hosts' interfaces though nobody asked for it"),
            )
        } else if frames == 0 {
            (true, "no service is measured, and no frame crossed the emulated network".to_owned())
        } else if p99_us > VALID_P99_US {
            (
                false,
                format!(
                    "{which}1 % of {what} came later than {p99_us:.0} µs; {VALID_P99_US:.0} µs are allowed"
                ),
            )
        } else if p50_us > VALID_P50_US {
            (
                false,
                format!(
                    "{which}half of {what} came later than {p50_us:.0} µs; {VALID_P50_US:.0} µs are allowed"
                ),
            )
        } else {
            let reason = format!(
                "{which}lateness p50 {p50_us:.0} µs (limit {VALID_P50_US:.0}), p99 {p99_us:.0} µs (limit {VALID_P99_US:.0})"
            );
            (true, reason)
        };
        let lateness_us = LatenessSummary { p50: p50_us, p99: p99_us, max: max_us };
        Self { valid, lateness_us, frames, frames_dropped, reason }
    }
}

/// Unintentional losses.
#[derive(Debug, Clone, Copy, Default)]
pub struct Losses {
    /// Frames lost at hosts' interfaces.
    pub frames_dropped: u64,
    /// Events that did not reach the history.
    pub history_dropped: u64,
}

/// Collects the events of a run.
#[derive(Debug)]
pub struct Report {
    name: String,
    seed: u64,
    measured_frames: MeasuredFrames,
    /// The services, each with its target in milliseconds, and whether it is measured even without samples.
    services: Vec<(ServiceId, f64, bool)>,
    /// Services whose requests go to all instances.
    asking_all: Vec<ServiceId>,
    samples: Samples,
    driving: Driving,
    handovers: Vec<HandoverRecord>,
    placements: Vec<PlacementRecord>,
    decisions: Vec<DecisionRecord>,
    lateness: Lateness,
    faults: Vec<String>,
    notices: Vec<String>,
    localization: Vec<LocalizationSummary>,
    pose_source: Option<PoseSource>,
    /// The robot of each VNF.
    robots: BTreeMap<VnfId, NodeId>,
    /// The last position of each robot.
    positions: BTreeMap<NodeId, Position>,
}

impl Report {
    /// Creates the report of a run with that seed.
    pub fn new(testbed: &Testbed, seed: u64) -> Self {
        Self {
            name: testbed.name.clone(),
            seed,
            measured_frames: match testbed.graph.real_links().next() {
                Some(_) => MeasuredFrames::Emulated,
                None => MeasuredFrames::All,
            },
            services: testbed
                .services
                .iter()
                .map(|s| (s.id.clone(), millis::of(s.kpis.service_time), s.kpis.flow.is_some()))
                .collect(),
            asking_all: testbed
                .services
                .iter()
                .filter(|service| service.requests == Requests::All)
                .map(|service| service.id.clone())
                .collect(),
            samples: Samples::default(),
            driving: Driving::new(testbed),
            handovers: Vec::new(),
            placements: Vec::new(),
            decisions: Vec::new(),
            lateness: Lateness::default(),
            faults: Vec::new(),
            notices: Vec::new(),
            localization: Vec::new(),
            pose_source: None,
            robots: testbed
                .services
                .iter()
                .flat_map(|service| service.vnfs.iter().map(|vnf| (vnf.id.clone(), service.robot.clone())))
                .collect(),
            positions: BTreeMap::new(),
        }
    }

    /// Keeps older samples on disk, in a file in this folder.
    ///
    /// # Errors
    /// [`FolderError`] if the file cannot be created.
    pub(crate) fn on_disk(self, folder: &Path) -> Result<Self, FolderError> {
        let samples = Samples::in_folder(folder).map_err(|source| FolderError::new(folder, source))?;
        Ok(Self { samples, ..self })
    }

    /// Marks the kernel as the carrier of frames; lateness is then that of probes.
    pub(crate) fn by_the_kernel(self) -> Self {
        Self { measured_frames: MeasuredFrames::Probes, ..self }
    }

    /// Adds an event.
    pub fn absorb(&mut self, stamped: &Stamped) {
        self.driving.absorb(stamped);
        let Stamped { at, event } = stamped;
        match event {
            Event::ServiceTime(sample) => self.samples.push(sample),
            Event::Robot(context) => {
                let position = context.sensors.pose.position();
                self.pose_source = Some(context.sensors.pose.source);
                match self.positions.get_mut(&context.robot) {
                    Some(last) => *last = position,
                    None => drop(self.positions.insert(context.robot.clone(), position)),
                }
            }
            Event::Handover(h) => self.handovers.push(HandoverRecord {
                at: *at,
                robot: h.robot.clone(),
                from: h.from.clone(),
                to: h.to.clone(),
                gap_ms: millis::of(h.gap),
                fast: h.fast,
                position: self.positions.get(&h.robot).copied(),
            }),
            Event::Placement(p) => {
                let position = self.position_for(&p.vnf);
                let (vnf, node) = (p.vnf.clone(), p.node.clone());
                self.placements.push(PlacementRecord { at: *at, vnf, node, position });
            }
            Event::Decision(decision) if decision.refused.is_none() => {
                let position = match &decision.instruction {
                    Instruction::Attach { robot, .. } => self.positions.get(robot).copied(),
                    Instruction::Place { vnf, .. } => self.position_for(vnf),
                    _ => return,
                };
                let instruction = decision.instruction.clone();
                self.decisions.push(DecisionRecord { at: *at, instruction, position });
            }
            Event::Lateness(lateness) => self.lateness = *lateness,
            Event::Notice { message } if self.notices.len() < MOST_NOTICES => {
                self.notices.push(message.clone())
            }
            Event::PluginFault { plugin, reason } => self.faults.push(format!("{plugin}: {reason}")),
            _ => {}
        }
    }

    /// Adds localization errors. They are in no event, because nobody who decides may know them.
    pub(crate) fn localized<'a>(&mut self, errors: impl Iterator<Item = (&'a NodeId, &'a Errors)>) {
        let summary = |(robot, errors): (&NodeId, &Errors)| {
            let error_m = Quantiles { max: errors.farthest(), ..Quantiles::of(errors.positions().to_vec())? };
            let (robot, samples, nees) = (robot.clone(), errors.len(), errors.mean_nees());
            Some(LocalizationSummary { robot, samples, error_m, nees })
        };
        self.localization = errors.filter_map(summary).collect();
    }

    fn position_for(&self, vnf: &VnfId) -> Option<Position> {
        self.positions.get(self.robots.get(vnf)?).copied()
    }

    /// Returns the changes of attachment, in order.
    pub fn handovers(&self) -> &[HandoverRecord] {
        &self.handovers
    }

    /// Returns the applied instructions of plug-ins, in order.
    pub fn decisions(&self) -> &[DecisionRecord] {
        &self.decisions
    }

    /// Returns the service times so far.
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Returns the target of the first service, milliseconds.
    pub fn service_time_target_ms(&self) -> Option<f64> {
        self.services.first().map(|(_, target_ms, _)| *target_ms)
    }

    /// Returns the summaries of services that have samples or a flow, in the file's order.
    pub fn services(&self) -> Vec<ServiceSummary> {
        self.summarize(self.by_service())
    }

    /// Groups samples by service.
    fn by_service(&self) -> BTreeMap<ServiceId, OfService> {
        let mut all: BTreeMap<ServiceId, OfService> = BTreeMap::new();
        for sample in self.samples.iter() {
            let took = service_time_ms(&sample);
            let its = all.entry(sample.service).or_default();
            its.samples += 1;
            its.answered.extend(took);
        }
        all
    }

    fn summarize(&self, mut all: BTreeMap<ServiceId, OfService>) -> Vec<ServiceSummary> {
        let summary = |(service, target_ms, is_flow): &(ServiceId, f64, bool)| {
            let its = match all.remove(service) {
                None if !is_flow => return None,
                its => its.unwrap_or_default(),
            };
            Some(ServiceSummary {
                service: service.clone(),
                samples: its.samples,
                unanswered: its.samples - its.answered.len(),
                service_time_target_ms: *target_ms,
                above_target: (its.samples > 0).then(|| its.above(*target_ms) as f64 / its.samples as f64),
                service_time_ms: Quantiles::of(its.answered),
            })
        };
        self.services.iter().filter_map(summary).collect()
    }

    /// Returns the summary of a run that ended at `end`.
    pub fn summary(&self, end: Timestamp, ended: &'static str, losses: Losses) -> Summary {
        let by_service = self.by_service();
        let answered: Vec<f64> = by_service.values().flat_map(|its| &its.answered).copied().collect();
        let above = || {
            let of =
                |(id, target_ms, _): &(ServiceId, f64, bool)| Some(by_service.get(id)?.above(*target_ms));
            let above: usize = self.services.iter().filter_map(of).sum();
            above as f64 / self.samples.len() as f64
        };
        let above_target = (!self.services.is_empty() && !self.samples.is_empty()).then(above);
        Summary {
            name: self.name.clone(),
            version: env!("CARGO_PKG_VERSION"),
            seed: self.seed,
            duration_ms: millis::of(end.since(Timestamp::ZERO)),
            ended,
            samples: self.samples.len(),
            unanswered: self.samples.len() - answered.len(),
            service_time_target_ms: self.service_time_target_ms(),
            above_target,
            service_time_ms: Quantiles::of(answered),
            services: self.summarize(by_service),
            regions: self.regions(),
            handovers: self.handovers.clone(),
            placements: self.placements.clone(),
            fidelity: Fidelity::of(
                self.measured_frames,
                self.lateness,
                losses.frames_dropped,
                self.services.is_empty(),
            ),
            pose_source: self.pose_source,
            localization: self.localization.clone(),
            driving: self.driving.summary(),
            plugin_faults: self.faults.clone(),
            notices: self.notices.clone(),
            history_dropped: losses.history_dropped,
        }
    }

    /// Returns the stretches with one attachment and one server, by robot and service.
    pub fn regions(&self) -> Vec<RegionSummary> {
        type Its = Vec<(RegionSummary, Vec<f64>)>;
        let mut robots: BTreeMap<(NodeId, ServiceId), Its> = BTreeMap::new();
        for sample in self.samples.iter() {
            let took = service_time_ms(&sample);
            let ServiceTime { robot, service, emitted, attachment, server, .. } = sample;
            let its = robots.entry((robot.clone(), service.clone())).or_default();
            match its.last_mut() {
                Some((region, all))
                    if region.attachment == attachment
                        && (region.server == server || self.asking_all.contains(&region.service)) =>
                {
                    region.until = emitted;
                    region.samples += 1;
                    all.extend(took);
                }
                _ => {
                    let region = RegionSummary {
                        robot,
                        service,
                        attachment,
                        server,
                        from: emitted,
                        until: emitted,
                        samples: 1,
                        service_time_p50_ms: None,
                    };
                    its.push((region, took.into_iter().collect()));
                }
            }
        }
        let with_median = |(region, all): (RegionSummary, Vec<f64>)| RegionSummary {
            service_time_p50_ms: Quantiles::of(all).map(|quantiles| quantiles.p50),
            ..region
        };
        robots.into_values().flatten().map(with_median).collect()
    }
}

/// The samples of a service.
#[derive(Debug, Default)]
struct OfService {
    samples: usize,
    /// Service times of the answered samples, milliseconds.
    answered: Vec<f64>,
}

impl OfService {
    /// Returns the number of samples above the target. Unanswered ones count as above it.
    fn above(&self, target_ms: f64) -> usize {
        self.samples - self.answered.iter().filter(|ms| **ms <= target_ms).count()
    }
}

/// Returns a sample's service time in milliseconds.
pub fn service_time_ms(sample: &ServiceTime) -> Option<f64> {
    sample.took.map(millis::of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{path::Path, time::Duration};

    fn sample(sequence: u32, attachment: &str, service_time_ms: Option<u64>) -> Stamped {
        let emitted = Timestamp::from_secs_f64(f64::from(sequence));
        let event = Event::ServiceTime(ServiceTime {
            service: "navigation".parse().unwrap(),
            robot: "robot".parse().unwrap(),
            sequence,
            emitted,
            took: service_time_ms.map(Duration::from_millis),
            attachment: Some(attachment.parse().unwrap()),
            server: "cloud".parse().unwrap(),
        });
        Stamped { at: emitted, event }
    }

    fn report() -> Report {
        let text = "name: test\nnodes: { a: { kind: switch } }\n";
        let testbed = cotorra_testbed_file::parse("test.yaml", text, Path::new("")).unwrap();
        let services = [("navigation", 15.0, false), ("detect", 100.0, true)];
        let services = services.map(|(id, target_ms, is_flow)| (id.parse().unwrap(), target_ms, is_flow));
        Report { services: services.into(), ..Report::new(&testbed, 1) }
    }

    #[test]
    fn quantiles_interpolate_between_ranks() {
        let q = Quantiles::of((1..=5).map(f64::from).collect()).unwrap();
        assert_eq!((q.p50, q.p95, q.max), (3.0, 4.8, 5.0));
        assert_eq!(Quantiles::of(Vec::new()), None);
    }

    #[test]
    fn an_unanswered_sample_is_above_any_target() {
        let mut report = report();
        for (i, took) in [Some(10), Some(16), None, Some(14)].into_iter().enumerate() {
            report.absorb(&sample(i as u32, "R1", took));
        }
        let summary = report.summary(Timestamp::from_secs_f64(4.0), "finished", Losses::default());
        assert_eq!((summary.samples, summary.unanswered, summary.above_target), (4, 1, Some(0.5)));
        assert_eq!(summary.service_time_ms.unwrap().max, 16.0);
    }

    #[test]
    fn services_have_their_own_figures_targets_and_regions() {
        let mut report = report();
        for (i, took) in [Some(10), Some(16)].into_iter().enumerate() {
            report.absorb(&sample(i as u32, "R1", took));
        }
        let none = &report.services()[1];
        assert_eq!((none.samples, none.above_target, none.service_time_ms), (0, None, None));
        for (i, took) in [Some(90), None, Some(80)].into_iter().enumerate() {
            let mut stamped = sample(i as u32, "R1", took);
            if let Event::ServiceTime(sample) = &mut stamped.event {
                sample.service = "detect".parse().unwrap();
                sample.server = "edge".parse().unwrap();
            }
            report.absorb(&stamped);
        }
        report.absorb(&Stamped { at: Timestamp::ZERO, event: Event::Notice { message: "mind".to_owned() } });
        let summary = report.summary(Timestamp::from_secs_f64(4.0), "finished", Losses::default());
        assert_eq!((summary.above_target, summary.notices), (Some(0.4), vec!["mind".to_owned()]));
        let plain = |s: &ServiceSummary| {
            (
                s.samples,
                s.unanswered,
                s.service_time_target_ms,
                s.above_target,
                s.service_time_ms.unwrap().max,
            )
        };
        let services: Vec<_> = summary.services.iter().map(plain).collect();
        assert_eq!(services, [(2, 0, 15.0, Some(0.5), 16.0), (3, 1, 100.0, Some(1.0 / 3.0), 90.0)]);
        let regions: Vec<_> =
            summary.regions.iter().map(|r| (r.service.as_str(), r.server.as_str(), r.samples)).collect();
        assert_eq!(regions, [("detect", "edge", 3), ("navigation", "cloud", 2)]);
    }

    #[test]
    fn regions_do_not_split_where_another_instance_answers() {
        let servers = |asking_all: &[&str]| {
            let asking_all = asking_all.iter().map(|id| id.parse().unwrap()).collect();
            let mut report = Report { asking_all, ..report() };
            for (sequence, server) in [(0, "edge"), (1, "fog"), (2, "edge")] {
                let mut stamped = sample(sequence, "R1", Some(10));
                if let Event::ServiceTime(sample) = &mut stamped.event {
                    sample.server = server.parse().unwrap();
                }
                report.absorb(&stamped);
            }
            report.regions().iter().map(|r| (r.server.to_string(), r.samples)).collect::<Vec<_>>()
        };
        assert_eq!(servers(&["navigation"]), [("edge".to_owned(), 3)]);
        assert_eq!(servers(&[]).len(), 3);
    }

    #[test]
    fn regions_split_at_a_new_attachment_and_not_where_answers_overtake() {
        let mut report = report();
        for (sequence, attachment) in [(0, "R1"), (2, "R1"), (1, "R1"), (3, "R3"), (4, "R1")] {
            report.absorb(&sample(sequence, attachment, Some(11)));
        }
        let regions: Vec<_> = report
            .regions()
            .iter()
            .map(|r| (r.attachment.as_ref().unwrap().to_string(), r.samples))
            .collect();
        assert_eq!(regions, [("R1".into(), 3), ("R3".into(), 1), ("R1".into(), 1)]);
    }

    #[test]
    fn a_run_without_frames_or_with_late_ones_is_not_valid() {
        let fidelity = |lateness, dropped| Fidelity::of(MeasuredFrames::All, lateness, dropped, false);
        assert!(!fidelity(Lateness::default(), 0).valid);
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        assert!(fidelity(good, 0).valid);
        assert!(!fidelity(good, 1).valid);
        let late = fidelity(Lateness { p99_us: 1500.0, ..good }, 0);
        assert!(!late.valid && late.reason.contains("1500"), "{late:?}");
        let real = Fidelity::of(MeasuredFrames::Emulated, Lateness::default(), 0, false);
        assert!(!real.valid && real.reason.contains("NetEm"), "{real:?}");
        // The fabric's own frames are known, beside real links.
        assert!(Fidelity::of(MeasuredFrames::Emulated, good, 0, false).valid);
    }

    #[test]
    fn a_testbed_without_services_needs_no_frames() {
        let fidelity = |lateness, dropped| Fidelity::of(MeasuredFrames::All, lateness, dropped, true);
        let idle = fidelity(Lateness::default(), 0);
        assert!(idle.valid && idle.reason.contains("no service"), "{idle:?}");
        assert!(!fidelity(Lateness::default(), 1).valid);
        assert!(!fidelity(Lateness { frames: 10, p50_us: 20.0, p99_us: 1500.0, max_us: 5000.0 }, 0).valid);
    }

    #[test]
    fn with_the_kernel_carrying_frames_enough_probes_decide() {
        let fidelity = |frames, p99_us| {
            Fidelity::of(
                MeasuredFrames::Probes,
                Lateness { frames, p50_us: 20.0, p99_us, max_us: 5000.0 },
                0,
                false,
            )
        };
        for few in [0, VALID_PROBES - 1] {
            let few = fidelity(few, 300.0);
            assert!(!few.valid && few.reason.contains("NetEm") && few.reason.contains("100"), "{few:?}");
        }
        let good = fidelity(VALID_PROBES, 300.0);
        assert!(good.valid && good.reason.contains("only probes"), "{good:?}");
        let late = fidelity(VALID_PROBES, 1500.0);
        assert!(!late.valid && late.reason.contains("1 % of the probes"), "{late:?}");
    }
}
