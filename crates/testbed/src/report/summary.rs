//! Turns the events of a run into its summary.

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

/// Lateness above which a run's figures are not to be trusted, at the 99th percentile.
const VALID_P99_US: f64 = 1000.0;
/// The same at the median.
const VALID_P50_US: f64 = 250.0;
/// Share of frames that may be lost though nobody asked for it.
const VALID_DROPPED: f64 = 1e-4;
/// With fewer probes than this, nothing is known of one in a hundred.
const VALID_PROBES: u64 = 100;
/// So many notices are kept.
const MOST_NOTICES: usize = 100;

/// What `summary.json` holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The testbed's name.
    pub name: String,
    /// The version of cotorra that ran it.
    pub version: &'static str,
    /// The run's seed.
    pub seed: u64,
    /// How long it ran, milliseconds.
    pub duration_ms: f64,
    /// Why it ended.
    pub ended: &'static str,
    /// How many service times were measured, unanswered ones included.
    pub samples: usize,
    /// How many of them got no answer within the robot's command timeout.
    pub unanswered: usize,
    /// The target service time of the first service.
    pub service_time_target_ms: Option<f64>,
    /// Share of samples over the target of their service; an unanswered one is over any.
    pub above_target: Option<f64>,
    /// Service time over all answered samples.
    pub service_time_ms: Option<Quantiles>,
    /// The same of each service that is measured, in the file's order.
    pub services: Vec<ServiceSummary>,
    /// Stretches with one attachment and one server, in order.
    pub regions: Vec<RegionSummary>,
    /// Changes of attachment, in order.
    pub handovers: Vec<HandoverRecord>,
    /// Placements, in order, those at the start included.
    pub placements: Vec<PlacementRecord>,
    /// Whether the emulator did what it was asked.
    pub fidelity: Fidelity,
    /// Where the robots' poses came from, as told last; `None` where there is no robot.
    pub pose_source: Option<PoseSource>,
    /// How far off localization was, of each robot that a VNF localized and whose place is known.
    pub localization: Vec<LocalizationSummary>,
    /// How far each robot drove that is navigated along a walk, and what of it blind.
    pub driving: Vec<DrivingSummary>,
    /// Plug-ins that were cut off, with the reason.
    pub plugin_faults: Vec<String>,
    /// Notices, the first hundred.
    pub notices: Vec<String>,
    /// Events that the history had no room for.
    pub history_dropped: u64,
}

/// The service times of one service.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceSummary {
    /// The service.
    pub service: ServiceId,
    /// How many were measured, unanswered ones included.
    pub samples: usize,
    /// How many of them got no answer in time.
    pub unanswered: usize,
    /// The target.
    pub service_time_target_ms: f64,
    /// Share of samples over the target; an unanswered one is over any.
    pub above_target: Option<f64>,
    /// Over all answered samples.
    pub service_time_ms: Option<Quantiles>,
}

/// How far off a robot's localization was, each time that κ was collected.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LocalizationSummary {
    /// The robot.
    pub robot: NodeId,
    /// How often it was compared.
    pub samples: usize,
    /// From where it was believed to be to where it was, metres.
    pub error_m: Quantiles,
    /// Mean of the normalized estimation error squared: 3 if the covariance is as large as the errors, more if it is too
    /// small.
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
    /// Of these values; `None` if there are none.
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
    /// The robot.
    pub robot: NodeId,
    /// The service.
    pub service: ServiceId,
    /// Its radio unit; `None` while it had none.
    pub attachment: Option<NodeId>,
    /// Where navigation ran, or the server of the service's flow. Where all instances are asked, the one that answered the
    /// first sample.
    pub server: NodeId,
    /// The first sample's emission.
    #[serde(rename = "from_ns")]
    pub from: Timestamp,
    /// The last sample's emission.
    #[serde(rename = "until_ns")]
    pub until: Timestamp,
    /// Samples in it.
    pub samples: usize,
    /// Median service time; `None` if no sample was answered.
    pub service_time_p50_ms: Option<f64>,
}

/// A change of attachment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HandoverRecord {
    /// When it was complete.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// The robot.
    pub robot: NodeId,
    /// Before.
    pub from: Option<NodeId>,
    /// After.
    pub to: NodeId,
    /// How long no frame could pass.
    pub gap_ms: f64,
    /// Whether fast transition was used.
    pub fast: bool,
    /// Where the robot was; `None` if that is not known.
    pub position: Option<Position>,
}

/// A VNF on a node, or on several.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlacementRecord {
    /// When.
    #[serde(rename = "at_ns")]
    pub at: Timestamp,
    /// The VNF.
    pub vnf: VnfId,
    /// The node, or those of its instances.
    pub node: Nodes,
    /// Where its service's robot was; `None` if that is not known.
    pub position: Option<Position>,
}

/// Something that a plug-in asked for and got: another radio unit, or another node for a VNF.
#[derive(Debug, Clone, PartialEq)]
pub struct DecisionRecord {
    /// When.
    pub at: Timestamp,
    /// What.
    pub instruction: Instruction,
    /// Where the robot was that it is about; `None` if that is not known.
    pub position: Option<Position>,
}

/// Whether the emulator did what it was asked.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fidelity {
    /// Whether the figures can be trusted.
    pub valid: bool,
    /// How late frames were delivered.
    pub lateness_us: LatenessSummary,
    /// Frames that it speaks of: all, or only probes where the kernel's NetEm carried them.
    pub frames: u64,
    /// Frames that were lost though nobody asked for it: an interface was down, or its queue full.
    pub frames_dropped: u64,
    /// Why it is valid or not, with the limits.
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
enum Known {
    /// Of all, because the fabric carried them.
    All,
    /// Of those that the fabric carried; others crossed interfaces of this machine.
    Emulated,
    /// Of probes alone, because the kernel carried them.
    Probes,
}

impl Fidelity {
    fn of(known: Known, lateness: Lateness, frames_dropped: u64) -> Self {
        let Lateness { frames, p50_us, p99_us, max_us } = lateness;
        let (which, what) = match known {
            Known::All | Known::Emulated => ("", "the frames"),
            Known::Probes => {
                ("the kernel's NetEm carried the frames, and only probes tell how late; ", "the probes")
            }
        };
        let (valid, reason) = if known == Known::Probes && frames < VALID_PROBES {
            (
                false,
                format!(
                    "{which}{frames} of them did, and {VALID_PROBES} are needed (those of links with jitter or reordering \
                     cannot tell)"
                ),
            )
        } else if frames == 0 && known == Known::Emulated {
            (false, "the kernel's NetEm carried the frames, and tells nobody how late they were".to_owned())
        } else if frames == 0 {
            (false, "no frame crossed the emulated network".to_owned())
        } else if frames_dropped as f64 > frames as f64 * VALID_DROPPED {
            (
                false,
                format!("{frames_dropped} frames were lost at hosts' interfaces though nobody asked for it"),
            )
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

/// What was lost though nobody asked for it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Losses {
    /// Frames, at hosts' interfaces.
    pub frames_dropped: u64,
    /// Events, on their way into the history.
    pub history_dropped: u64,
}

/// Collects the events of a run.
#[derive(Debug)]
pub struct Report {
    name: String,
    seed: u64,
    known: Known,
    /// The services, the target of each in milliseconds, and whether it is measured without fail.
    services: Vec<(ServiceId, f64, bool)>,
    /// Services in which all instances are asked.
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
    /// Where each robot was last.
    positions: BTreeMap<NodeId, Position>,
}

impl Report {
    /// Of a run with that seed.
    pub fn new(testbed: &Testbed, seed: u64) -> Self {
        Self {
            name: testbed.name.clone(),
            seed,
            known: match testbed.graph.real_links().next() {
                Some(_) => Known::Emulated,
                None => Known::All,
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

    /// The same, which keeps older samples on disk, in a file in this folder.
    ///
    /// # Errors
    /// [`FolderError`] if the file cannot be made.
    pub(crate) fn on_disk(self, folder: &Path) -> Result<Self, FolderError> {
        let samples = Samples::in_folder(folder).map_err(|source| FolderError::new(folder, source))?;
        Ok(Self { samples, ..self })
    }

    /// The same, of a run in which the kernel carried the frames, and lateness is that of probes.
    pub(crate) fn by_the_kernel(self) -> Self {
        Self { known: Known::Probes, ..self }
    }

    /// Takes an event in.
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

    /// Takes in how far off localization was; no event tells it, because nobody who decides may know.
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

    /// Changes of attachment, in order.
    pub fn handovers(&self) -> &[HandoverRecord] {
        &self.handovers
    }

    /// What plug-ins asked for and got, in order.
    pub fn decisions(&self) -> &[DecisionRecord] {
        &self.decisions
    }

    /// The service times so far.
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// The target of the first service, milliseconds.
    pub fn service_time_target_ms(&self) -> Option<f64> {
        self.services.first().map(|(_, target_ms, _)| *target_ms)
    }

    /// The service times of each service that has some, or a flow, in the file's order.
    pub fn services(&self) -> Vec<ServiceSummary> {
        self.summarize(self.by_service())
    }

    /// The samples of each service that has some.
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

    /// The summary, for a run that ended at `end`.
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
            fidelity: Fidelity::of(self.known, self.lateness, losses.frames_dropped),
            pose_source: self.pose_source,
            localization: self.localization.clone(),
            driving: self.driving.summary(),
            plugin_faults: self.faults.clone(),
            notices: self.notices.clone(),
            history_dropped: losses.history_dropped,
        }
    }

    /// Stretches with one attachment and one server, robot by robot and service by service.
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
    /// What each answered one took, milliseconds.
    answered: Vec<f64>,
}

impl OfService {
    /// How many took longer than that; an unanswered one did.
    fn above(&self, target_ms: f64) -> usize {
        self.samples - self.answered.iter().filter(|ms| **ms <= target_ms).count()
    }
}

/// What a sample took, in milliseconds.
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
    fn an_unanswered_sample_is_over_any_target() {
        let mut report = report();
        for (i, took) in [Some(10), Some(16), None, Some(14)].into_iter().enumerate() {
            report.absorb(&sample(i as u32, "R1", took));
        }
        let summary = report.summary(Timestamp::from_secs_f64(4.0), "finished", Losses::default());
        assert_eq!((summary.samples, summary.unanswered, summary.above_target), (4, 1, Some(0.5)));
        assert_eq!(summary.service_time_ms.unwrap().max, 16.0);
    }

    #[test]
    fn services_have_figures_targets_and_regions_of_their_own() {
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
    fn regions_do_not_split_where_another_of_all_instances_answers() {
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
    fn regions_split_where_the_attachment_changes_and_not_where_answers_overtake() {
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
        let fidelity = |lateness, dropped| Fidelity::of(Known::All, lateness, dropped);
        assert!(!fidelity(Lateness::default(), 0).valid);
        let good = Lateness { frames: 10, p50_us: 20.0, p99_us: 300.0, max_us: 5000.0 };
        assert!(fidelity(good, 0).valid);
        assert!(!fidelity(good, 1).valid);
        let late = fidelity(Lateness { p99_us: 1500.0, ..good }, 0);
        assert!(!late.valid && late.reason.contains("1500"), "{late:?}");
        let real = Fidelity::of(Known::Emulated, Lateness::default(), 0);
        assert!(!real.valid && real.reason.contains("NetEm"), "{real:?}");
        // What the fabric carried beside real links is known.
        assert!(Fidelity::of(Known::Emulated, good, 0).valid);
    }

    #[test]
    fn of_what_the_kernel_carried_probes_tell_if_they_are_enough() {
        let fidelity = |frames, p99_us| {
            Fidelity::of(Known::Probes, Lateness { frames, p50_us: 20.0, p99_us, max_us: 5000.0 }, 0)
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
