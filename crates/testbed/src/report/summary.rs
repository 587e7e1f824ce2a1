//! Computes a run's summary from its events.

use std::{collections::BTreeMap, path::Path, time::Duration};

use cotorra_datapath::{Absence, GatewayTraffic};
use cotorra_engine::InstanceWaits;
use cotorra_fabric::{Airtime, ForgedSources};
use cotorra_graph::{
    Event, Instruction, Lateness, Natural, NodeId, Nodes, PoseSource, Position, Probability, Requests,
    Service, ServiceId, ServiceTime, Stamped, Testbed, Timestamp, VnfId, millis,
};
use cotorra_localization::trajectory::Errors;
use cotorra_traffic::Measured;
use serde::Serialize;

use super::{
    away::AwaySummary,
    bill::{Bill, Billing},
    computing::ComputingSummary,
    doubts::Doubts,
    driving::{Driving, DrivingSummary},
    end::End,
    energy::EnergySummary,
    fidelity::Fidelity,
    folder::FolderError,
    forged::ForgedSummary,
    gateways::GatewaySummary,
    inference::InferenceSummary,
    instructed::{Instructed, PluginSummary},
    judged::{Judge, Judged},
    kept::{Kept, Verdict},
    measured_frames::MeasuredFrames,
    metering::{Known, Metering},
    migrations::MigrationSummary,
    samples::Samples,
    staleness_regret::StalenessRegret,
    time_parts::{ServiceParts, TimePartsReport},
    times::{Quantiles, Times},
    vnf_waits::VnfWaits,
    void::Void,
};
use crate::{
    computed::ComputedSoFar,
    virtual_time::{InferredSoFar, Migrated},
};

/// Maximum number of notices.
const MOST_NOTICES: usize = 100;

/// The content of `summary.json`. Figures of the run as a whole, of robots and of regions cover the services that are in the
/// total ([`ServiceSummary::in_total`]).
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
    /// Places of the robots, if none of them made progress any more.
    pub no_progress: Option<String>,
    /// Reasons for which the figures are not valid; none if they are.
    #[serde(serialize_with = "Void::list")]
    pub void: Void,
    /// Number of service times, unanswered ones included.
    pub samples: usize,
    /// Number of service times without an answer within the robot's command timeout.
    pub unanswered: usize,
    /// Target service time of the first service in the total, milliseconds.
    pub service_time_target_ms: Option<f64>,
    /// Share of samples above the target of their service. Unanswered ones count as above it.
    pub above_target: Option<f64>,
    /// Verdict on all services of which the testbed file demands more than a target; `None` without any.
    pub verdict: Option<Verdict>,
    /// Service times of all answered samples, milliseconds.
    pub service_time_ms: Option<Quantiles>,
    /// Summaries of all robots, in the file's order.
    pub robots: Vec<RobotSummary>,
    /// Summaries of all services, in the file's order, those without samples included.
    pub services: Vec<ServiceSummary>,
    /// Parts of the service times of services with answered samples, in the file's order.
    pub time_parts: Vec<ServiceParts>,
    /// Stretches with one attachment and one server, in order.
    pub regions: Vec<RegionSummary>,
    /// Changes of attachment, in order.
    pub handovers: Vec<HandoverRecord>,
    /// Placements, in order, those at the start included.
    pub placements: Vec<PlacementRecord>,
    /// Gateways and real servers, in the file's order.
    pub gateways: Vec<GatewaySummary>,
    /// Nodes that sent frames in the name of others.
    pub forged_sources: Vec<ForgedSummary>,
    /// Verdict on the emulation.
    pub fidelity: Fidelity,
    /// Last source of the robots' poses; `None` without robots.
    pub pose_source: Option<PoseSource>,
    /// Localization errors of each robot that a VNF localized and whose true position is known.
    pub localization: Vec<LocalizationSummary>,
    /// Distances of each robot that is navigated along a walk.
    pub driving: Vec<DrivingSummary>,
    /// What arrived of each source's traffic.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub traffic: Vec<Measured>,
    /// Prices of what the run took, if the testbed file has a currency.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bill: Option<Bill>,
    /// Energy of servers and robots, if the testbed file has the power of any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub energy: Option<EnergySummary>,
    /// What VNFs with demands computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub computing: Option<ComputingSummary>,
    /// What models on accelerators inferred, and how robots followed their actions, in virtual time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inference: Option<InferenceSummary>,
    /// Moves of VNFs with their state, in virtual time, in the order of their begins.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub migrations: Vec<MigrationSummary>,
    /// Instructions of each plug-in, those of the file first.
    pub plugins: Vec<PluginSummary>,
    /// What old context cost, by plug-in with a distance, beside the twins of the run; empty without twins.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub staleness_regret: Vec<StalenessRegret>,
    /// Plug-ins that were cut off, each with the reason. Of optional ones, there is a notice.
    pub plugin_faults: Vec<String>,
    /// The first hundred notices.
    pub notices: Vec<String>,
    /// Number of events that the history had no room for.
    pub history_dropped: u64,
}

/// All services of one robot in the total together, and its handovers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RobotSummary {
    pub robot: NodeId,
    /// Number of service times, unanswered ones included.
    pub samples: usize,
    /// Number of service times without an answer in time.
    pub unanswered: usize,
    /// Share of samples above the target of their service. Unanswered ones count as above it.
    pub above_target: Option<f64>,
    /// Verdict on all of its services of which the testbed file demands more than a target, those apart from the total
    /// included.
    pub verdict: Option<Verdict>,
    /// Number of changes of attachment.
    pub handovers: usize,
    /// Times without frames in these changes, milliseconds.
    pub handover_gap_ms: Option<Quantiles>,
    /// Time without a radio unit after it had lost one, milliseconds. It is in no gap.
    pub detached_ms: f64,
}

/// Time that a robot had no radio unit, after it had lost one.
#[derive(Debug, Clone, Copy, Default)]
struct Detached {
    since: Option<Timestamp>,
    before: Duration,
}

impl Detached {
    fn lost(&mut self, at: Timestamp) {
        self.since.get_or_insert(at);
    }

    fn attached(&mut self, at: Timestamp) {
        self.before = self.until(at);
        self.since = None;
    }

    fn until(&self, end: Timestamp) -> Duration {
        self.before + self.since.map_or(Duration::ZERO, |since| end.since(since))
    }
}

/// The service times of one service.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ServiceSummary {
    /// The robot that it serves.
    pub robot: NodeId,
    pub service: ServiceId,
    /// Whether it counts in the figures of the run and of its robot. Services that localize do not, unless all do.
    pub in_total: bool,
    /// Number of service times, unanswered ones included.
    pub samples: usize,
    /// Number of service times without an answer in time.
    pub unanswered: usize,
    /// Target, milliseconds.
    pub service_time_target_ms: f64,
    /// Share of samples above the target. Unanswered ones count as above it.
    pub above_target: Option<f64>,
    /// The rest.
    #[serde(flatten)]
    pub kept: Kept,
    /// Verdict on all of its KPIs; `None` if nothing is demanded beside the target.
    pub verdict: Option<Verdict>,
    /// Its KPIs beside the target.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub kpis: Vec<Judged>,
    /// Service times of all answered samples, milliseconds.
    pub service_time_ms: Option<Quantiles>,
}

/// Errors of a robot's localization at each collection of κ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LocalizationSummary {
    pub robot: NodeId,
    /// Number of comparisons.
    pub samples: usize,
    /// Distance from the estimated to the true position, metres. Of more than a million comparisons, quantiles are
    /// approximate, and the maximum is exact.
    pub error_m: Quantiles,
    /// Mean of the normalized estimation error squared: 3 if the covariance matches the errors, more if it is too small.
    pub nees: f64,
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

impl Summary {
    /// Whether the run ended because every walk was done.
    pub fn is_walked(&self) -> bool {
        self.ended == End::Walked.as_str()
    }

    /// Whether the run ended because no robot made progress on its walk.
    pub fn is_stuck(&self) -> bool {
        self.ended == End::NoProgress.as_str()
    }

    /// Whether the figures are valid: the emulation did what the testbed file demands, and everything that takes part did.
    pub fn is_valid(&self) -> bool {
        self.void.is_valid()
    }

    /// Returns the verdict as notices at the end of the run, for its history.
    pub(crate) fn last_words(&self, end: Timestamp) -> impl Iterator<Item = Stamped> {
        let stuck = self.no_progress.iter().map(|stand| format!("{}: {stand}", self.ended));
        let forged = self.forged_sources.iter().map(ForgedSummary::sentence);
        let empty = self.energy.iter().flat_map(EnergySummary::empty_batteries);
        let void = self.void.reasons().map(|reason| format!("the figures are not valid: {reason}"));
        stuck
            .chain(void)
            .chain(forged)
            .chain(empty)
            .map(move |message| Stamped { at: end, event: Event::Notice { message } })
    }
}

/// Unintentional losses.
#[derive(Debug, Clone, Copy, Default)]
pub struct Losses {
    /// Frames lost at the interfaces of hosts.
    pub frames_dropped: u64,
    /// Packets that the kernel dropped because its tables of neighbours, which all programs of this machine share, were full.
    pub neighbour_overflows: u64,
    /// Events that did not reach the history.
    pub history_dropped: u64,
}

/// A service of a robot.
#[derive(Debug, Clone)]
struct Served {
    service: ServiceId,
    robot: NodeId,
    in_total: bool,
    target_ms: f64,
    /// Share of samples that must be within the target.
    keep: Option<f64>,
}

/// Collects the events of a run.
#[derive(Debug)]
pub struct Report {
    name: String,
    seed: u64,
    measured_frames: MeasuredFrames,
    /// All robots.
    robot_ids: Vec<NodeId>,
    services: Vec<Served>,
    judge: Judge,
    /// Services whose requests go to all instances.
    asking_all: Vec<ServiceId>,
    samples: Samples,
    time_parts: TimePartsReport,
    driving: Driving,
    handovers: Vec<HandoverRecord>,
    detached: BTreeMap<NodeId, Detached>,
    placements: Vec<PlacementRecord>,
    decisions: Vec<DecisionRecord>,
    instructed: Instructed,
    lateness: Lateness,
    gateways: Vec<GatewaySummary>,
    forged: Vec<ForgedSummary>,
    absence: Option<Absence>,
    /// Waits of datagrams in robots' sockets.
    receptions: Lateness,
    vnf_waits: Vec<InstanceWaits>,
    /// VNFs of whose waits nothing is known.
    unwatched: Vec<VnfId>,
    faults: Vec<String>,
    notices: Vec<String>,
    doubts: Doubts,
    no_progress: Option<String>,
    localization: Vec<LocalizationSummary>,
    traffic: Vec<Measured>,
    billing: Option<Billing>,
    metering: Option<Metering>,
    /// Of robots with emulated radios.
    airtimes: BTreeMap<NodeId, Airtime>,
    computed: ComputedSoFar,
    inferred: InferredSoFar,
    migrations: Vec<MigrationSummary>,
    pose_source: Option<PoseSource>,
    /// The robot of each VNF.
    robots: BTreeMap<VnfId, NodeId>,
    /// The last position of each robot.
    positions: BTreeMap<NodeId, Position>,
}

impl Served {
    fn all(testbed: &Testbed) -> Vec<Self> {
        let served = |service: &Service| Self {
            service: service.id.clone(),
            robot: service.robot.clone(),
            in_total: testbed.services_in_total().any(|other| other.id == service.id),
            target_ms: millis::of(service.kpis.service_time),
            keep: service.kpis.kept.map(Probability::get),
        };
        testbed.services.iter().map(served).collect()
    }

    fn kept(&self, times: &Times) -> Kept {
        Kept::of(times.samples - times.above, times.samples, self.keep)
    }
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
            robot_ids: testbed.graph.robots().map(|(node, _)| node.id.clone()).collect(),
            services: Served::all(testbed),
            judge: Judge::new(testbed),
            asking_all: testbed
                .services
                .iter()
                .filter(|service| service.requests == Requests::All)
                .map(|service| service.id.clone())
                .collect(),
            samples: Samples::default(),
            time_parts: TimePartsReport::new(testbed),
            driving: Driving::new(testbed),
            handovers: Vec::new(),
            detached: BTreeMap::new(),
            placements: Vec::new(),
            decisions: Vec::new(),
            instructed: Instructed::new(testbed),
            lateness: Lateness::default(),
            gateways: Vec::new(),
            forged: Vec::new(),
            absence: None,
            receptions: Lateness::default(),
            vnf_waits: Vec::new(),
            unwatched: VnfWaits::unwatched(testbed),
            faults: Vec::new(),
            notices: Vec::new(),
            doubts: Doubts::new(testbed),
            no_progress: None,
            localization: Vec::new(),
            traffic: Vec::new(),
            billing: Billing::new(testbed),
            metering: Metering::new(testbed),
            airtimes: BTreeMap::new(),
            computed: ComputedSoFar::default(),
            inferred: InferredSoFar::default(),
            migrations: Vec::new(),
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

    /// Marks the run as one in virtual time, where nothing is late, and where programs do not run.
    pub(crate) fn in_virtual_time(self, testbed: &Testbed) -> Self {
        let doubts = self.doubts.in_virtual_time(testbed);
        Self { measured_frames: MeasuredFrames::Exact, unwatched: Vec::new(), doubts, ..self }
    }

    /// Marks the kernel as the carrier of frames; lateness is then that of probes.
    pub(crate) fn by_the_kernel(self) -> Self {
        Self { measured_frames: MeasuredFrames::Probes, ..self }
    }

    /// Adds an event.
    pub fn absorb(&mut self, stamped: &Stamped) {
        self.driving.absorb(stamped);
        self.judge.absorb(stamped);
        if let Some(billing) = &mut self.billing {
            billing.absorb(stamped);
        }
        if let Some(metering) = &mut self.metering {
            metering.absorb(stamped);
        }
        self.notices.extend(self.doubts.absorb(stamped));
        let Stamped { at, event } = stamped;
        match event {
            Event::Decision(decision) => self.instructed.absorb(decision),
            Event::Staleness(staleness) => self.instructed.absorb_staleness(staleness),
            _ => {}
        }
        match event {
            Event::ServiceTime(sample) => {
                self.samples.push(sample);
                self.time_parts.absorb(sample);
            }
            Event::Robot(context) => {
                let position = context.sensors.pose.position();
                self.pose_source = Some(context.sensors.pose.source);
                match self.positions.get_mut(&context.robot) {
                    Some(last) => *last = position,
                    None => drop(self.positions.insert(context.robot.clone(), position)),
                }
            }
            Event::Handover(h) => {
                self.handovers.push(HandoverRecord {
                    at: *at,
                    robot: h.robot.clone(),
                    from: h.from.clone(),
                    to: h.to.clone(),
                    gap_ms: millis::of(h.gap),
                    fast: h.fast,
                    position: self.positions.get(&h.robot).copied(),
                });
                if let Some(detached) = self.detached.get_mut(&h.robot) {
                    detached.attached(*at);
                }
            }
            Event::Detached { robot, .. } => self.detached.entry(robot.clone()).or_default().lost(*at),
            Event::Placement(p) => {
                let position = self.position_for(&p.vnf);
                let (vnf, node) = (p.vnf.clone(), p.node.clone());
                self.placements.push(PlacementRecord { at: *at, vnf, node, position });
            }
            Event::Decision(decision) if decision.refused.is_none() => {
                let position = match &decision.instruction {
                    Instruction::Attach { robot, .. } | Instruction::Suggest { robot, .. } => {
                        self.positions.get(robot).copied()
                    }
                    Instruction::Place { vnf, .. } => self.position_for(vnf),
                    Instruction::AddVnf { .. } | Instruction::RemoveVnf { .. } => None,
                    _ => return,
                };
                let instruction = decision.instruction.clone();
                self.decisions.push(DecisionRecord { at: *at, instruction, position });
            }
            Event::Lateness(lateness) => self.lateness = *lateness,
            Event::Notice { message } if self.notices.len() < MOST_NOTICES => {
                self.notices.push(message.clone())
            }
            Event::PluginFault { plugin, reason } if !self.doubts.is_optional(plugin) => {
                self.faults.push(format!("{plugin}: {reason}"))
            }
            _ => {}
        }
    }

    /// Adds localization errors. They are in no event, because deciders may not know them.
    pub(crate) fn localized<'a>(&mut self, errors: impl Iterator<Item = (&'a NodeId, &'a Errors)>) {
        let summary = |(robot, errors): (&NodeId, &Errors)| {
            let error_m = Quantiles::gathered(errors.positions())?;
            let (robot, samples, nees) = (robot.clone(), errors.len(), errors.mean_nees());
            Some(LocalizationSummary { robot, samples, error_m, nees })
        };
        self.localization = errors.filter_map(summary).collect();
    }

    /// Adds what arrived of sources' traffic.
    pub(crate) fn carried(&mut self, traffic: Vec<Measured>) {
        self.traffic = traffic;
    }

    /// Adds what models inferred and robots followed. It is in no event.
    pub(crate) fn inferred(&mut self, inferred: InferredSoFar) {
        self.inferred = inferred;
    }

    /// Adds what VNFs with demands computed. It is in no event.
    pub(crate) fn computed(&mut self, computed: ComputedSoFar) {
        self.computed = computed;
    }

    /// Adds the airtime of robots with emulated radios. It is in no event.
    pub(crate) fn sent(&mut self, airtimes: BTreeMap<NodeId, Airtime>) {
        self.airtimes = airtimes;
    }

    /// Adds the moves of VNFs with their state. They are in no event.
    pub(crate) fn migrated(&mut self, migrated: Vec<Migrated>) {
        self.migrations = migrated.into_iter().map(MigrationSummary::from).collect();
    }

    /// Adds where the robots stand, if none of them makes progress any more.
    pub(crate) fn stuck(&mut self, stand: String) {
        self.no_progress = Some(stand);
    }

    /// Adds the number of events that plug-ins in process missed.
    pub(crate) fn missed(&mut self, events: u64) {
        self.doubts.missed(events);
    }

    /// Adds the traffic of gateways and real servers. It is in no event.
    pub(crate) fn passed(&mut self, gateways: Vec<GatewayTraffic>) {
        self.gateways = gateways.into_iter().map(GatewaySummary::from).collect();
    }

    /// Adds the frames of nodes that named other senders. They are in no event.
    pub(crate) fn forged(&mut self, forged: Vec<ForgedSources>) {
        self.forged = forged.into_iter().map(ForgedSummary::from).collect();
    }

    /// Adds the time in which the emulated network stood still. It is in no event.
    pub(crate) fn stood_still(&mut self, absence: Absence) {
        self.absence = Some(absence);
    }

    /// Adds the waits of datagrams in robots' sockets. They are in no event.
    pub(crate) fn received(&mut self, receptions: Lateness) {
        self.receptions = receptions;
    }

    /// Adds the waits of VNFs for a processor. They are in no event.
    pub(crate) fn waited(&mut self, waits: Vec<InstanceWaits>) {
        self.vnf_waits = waits;
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

    /// Returns the target of the first service in the total, milliseconds.
    pub fn service_time_target_ms(&self) -> Option<f64> {
        self.services.iter().find(|its| its.in_total).map(|its| its.target_ms)
    }

    /// Returns the summaries of all services, in the file's order.
    pub fn services(&self) -> Vec<ServiceSummary> {
        self.summarize(self.by_service())
    }

    /// Returns the parts of the service times of services with answered samples, in the file's order.
    pub fn time_parts(&self) -> Vec<ServiceParts> {
        self.time_parts.summary(&self.vnf_waits, &self.computed.vnfs)
    }

    /// Returns the service times of each service, in the file's order.
    fn by_service(&self) -> Vec<Times> {
        let places: BTreeMap<_, _> =
            self.services.iter().zip(0..).map(|(its, i)| (&its.service, i)).collect();
        let mut all: Vec<Times> = self.services.iter().map(|_| Times::default()).collect();
        for sample in self.samples.iter() {
            if let Some(&place) = places.get(&sample.service) {
                all[place].add(service_time_ms(&sample), self.services[place].target_ms);
            }
        }
        all
    }

    fn summarize(&self, by_service: Vec<Times>) -> Vec<ServiceSummary> {
        let summary = |(its, times): (&Served, Times)| {
            let kept = its.kept(&times);
            ServiceSummary {
                robot: its.robot.clone(),
                service: its.service.clone(),
                in_total: its.in_total,
                samples: times.samples,
                unanswered: times.unanswered(),
                service_time_target_ms: its.target_ms,
                above_target: times.above_target(),
                kept,
                verdict: kept.verdict,
                kpis: Vec::new(),
                service_time_ms: Quantiles::of(times.answered),
            }
        };
        self.services.iter().zip(by_service).map(summary).collect()
    }

    /// Returns the times of these services together, as far as they are in the total.
    fn merged(&self, by_service: &[Times], of: impl Fn(&Served) -> bool) -> Times {
        let its = self.services.iter().zip(by_service).filter(|(its, _)| its.in_total && of(its));
        Times::merged(its.map(|(_, times)| times))
    }

    fn robots(&self, by_service: &[Times], end: Timestamp) -> Vec<RobotSummary> {
        let summary = |robot: &NodeId| {
            let times = self.merged(by_service, |its| its.robot == *robot);
            let gaps = self.handovers.iter().filter(|handover| handover.robot == *robot);
            let gaps: Vec<_> = gaps.map(|handover| handover.gap_ms).collect();
            RobotSummary {
                robot: robot.clone(),
                samples: times.samples,
                unanswered: times.unanswered(),
                above_target: times.above_target(),
                verdict: None,
                handovers: gaps.len(),
                handover_gap_ms: Quantiles::of(gaps),
                detached_ms: self.detached.get(robot).map_or(0.0, |its| millis::of(its.until(end))),
            }
        };
        self.robot_ids.iter().map(summary).collect()
    }

    /// Returns the summary of a run that ended at `end`.
    pub fn summary(&self, end: Timestamp, ended: &'static str, losses: Losses) -> Summary {
        let by_service = self.by_service();
        let whole = self.merged(&by_service, |_| true);
        let robots = self.robots(&by_service, end);
        let services = self.summarize(by_service);
        let duration = end.since(Timestamp::ZERO);
        let energy = self.energy(end);
        let mut summary = Summary {
            name: self.name.clone(),
            version: env!("CARGO_PKG_VERSION"),
            seed: self.seed,
            duration_ms: millis::of(duration),
            ended,
            no_progress: self.no_progress.clone(),
            void: Void::default(),
            samples: whole.samples,
            unanswered: whole.unanswered(),
            service_time_target_ms: self.service_time_target_ms(),
            above_target: whole.above_target(),
            verdict: None,
            service_time_ms: Quantiles::of(whole.answered),
            robots,
            services,
            time_parts: self.time_parts(),
            regions: self.regions().into_iter().filter(|region| !self.is_apart(&region.service)).collect(),
            handovers: self.handovers.clone(),
            placements: self.placements.clone(),
            fidelity: Fidelity::of(
                self.measured_frames,
                self.lateness,
                losses.frames_dropped
                    + self.gateways.iter().map(|gateway| gateway.frames_dropped).sum::<u64>(),
                self.services.is_empty(),
            )
            .with_gateways(&self.gateways)
            .with_neighbours(losses.neighbour_overflows)
            .with_receptions(self.receptions)
            .with_traffic(&self.traffic)
            .with_away(self.absence.map(|absence| AwaySummary::new(&absence, duration)), self.measured_frames)
            .with_vnf_waits(VnfWaits::of(&self.vnf_waits, &self.unwatched, duration))
            .beside_targets(self.services.iter().map(|its| its.target_ms))
            .with_forged(&self.forged),
            gateways: self.gateways.clone(),
            forged_sources: self.forged.clone(),
            pose_source: self.pose_source,
            localization: self.localization.clone(),
            driving: self.driving.summary(),
            traffic: self.traffic.clone(),
            bill: self
                .billing
                .as_ref()
                .map(|billing| billing.bill(end, &self.computed.vnfs, energy.as_ref())),
            energy,
            computing: ComputingSummary::of(&self.computed, end.since(Timestamp::ZERO)),
            inference: InferenceSummary::of(&self.inferred, end.since(Timestamp::ZERO)),
            migrations: self.migrations.clone(),
            plugins: self.instructed.summary(),
            staleness_regret: Vec::new(),
            plugin_faults: self.faults.clone(),
            notices: self.notices.clone(),
            history_dropped: losses.history_dropped,
        };
        summary.void = self.doubts.void(&summary, end);
        self.judge.judge(&mut summary);
        summary
    }

    fn energy(&self, end: Timestamp) -> Option<EnergySummary> {
        let known = Known {
            computed: &self.computed,
            is_all: self.measured_frames == MeasuredFrames::Exact,
            airtimes: &self.airtimes,
        };
        Some(self.metering.as_ref()?.summary(end, &known))
    }

    /// Whether a service is not in the total.
    fn is_apart(&self, service: &ServiceId) -> bool {
        self.services.iter().any(|its| its.service == *service && !its.in_total)
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
        let mut sorted: Vec<_> = robots.into_iter().collect();
        sorted
            .sort_by_cached_key(|((robot, service), _)| [robot.as_str(), service.as_str()].map(Natural::of));
        sorted.into_iter().flat_map(|(_, its)| its).map(with_median).collect()
    }
}

/// Returns a sample's service time in milliseconds.
pub fn service_time_ms(sample: &ServiceTime) -> Option<f64> {
    sample.took.map(millis::of)
}

#[cfg(test)]
mod tests {
    use std::{path::Path, time::Duration};

    use cotorra_graph::Handover;
    use cotorra_graph_testing as base;
    use proptest::{collection::vec, option, prelude::*};

    use super::*;

    fn sample(sequence: u32, attachment: &str, service_time_ms: Option<u64>) -> Stamped {
        let emitted = Timestamp::from_secs_f64(f64::from(sequence));
        let event = Event::ServiceTime(ServiceTime {
            sequence,
            attachment: Some(attachment.parse().unwrap()),
            ..base::service_time("cloud", emitted, service_time_ms.map(Duration::from_millis))
        });
        Stamped { at: emitted, event }
    }

    /// Returns a report on two robots. The first has the services `navigation`, `detect` and `localization`, which is not in
    /// the total; the second has `watch`.
    fn report() -> Report {
        let text = "name: test\nnodes: { a: { kind: switch } }\n";
        let testbed = cotorra_testbed_file::parse("test.yaml", text, Path::new("")).unwrap();
        let served = |(service, robot, target_ms): (&str, &str, f64)| {
            let (service, robot) = (service.parse().unwrap(), robot.parse().unwrap());
            Served { service, robot, in_total: true, target_ms, keep: None }
        };
        let services = [
            ("navigation", "robot", 15.0),
            ("detect", "robot", 100.0),
            ("watch", "other", 30.0),
            ("localization", "robot", 50.0),
        ];
        let mut services = services.map(served);
        services[3].in_total = false;
        let (services, robot_ids) =
            (services.into(), ["robot", "other"].map(|id| id.parse().unwrap()).into());
        Report { services, robot_ids, ..Report::new(&testbed, 1) }
    }

    fn of_service(service: &ServiceSummary, stamped: Stamped) -> Stamped {
        let Event::ServiceTime(sample) = stamped.event else { panic!() };
        let (service, robot) = (service.service.clone(), service.robot.clone());
        Stamped { event: Event::ServiceTime(ServiceTime { service, robot, ..sample }), ..stamped }
    }

    proptest! {
        #[test]
        fn the_whole_is_the_sum_of_robots_and_these_of_services(
            samples in vec((0..4_usize, option::of(0..200_u64)), 0..80),
            handovers in vec((0..2_usize, 0..500_u64), 0..10),
        ) {
            let mut report = report();
            let services = report.services();
            for (number, (service, took)) in samples.iter().enumerate() {
                report.absorb(&of_service(&services[*service], sample(number as u32, "R1", *took)));
            }
            for (robot, gap) in &handovers {
                let [robot, to] = [["robot", "other"][*robot], "R2"].map(|id| id.parse().unwrap());
                let gap = Duration::from_millis(*gap);
                let event = Event::Handover(Handover { robot, from: None, to, gap, fast: false });
                report.absorb(&Stamped { at: Timestamp::ZERO, event });
            }
            let summary = report.summary(Timestamp::from_secs_f64(99.0), "finished", Losses::default());
            let above = |samples: usize, share: Option<f64>| (share.unwrap_or(0.0) * samples as f64).round() as usize;
            let whole = [summary.samples, summary.unanswered, above(summary.samples, summary.above_target)];
            let sum = |parts: Vec<[usize; 3]>| parts.iter().fold([0; 3], |all, its| [0, 1, 2].map(|i| all[i] + its[i]));
            let of_service = |s: &ServiceSummary| [s.samples, s.unanswered, above(s.samples, s.above_target)];
            let of_robot = |r: &RobotSummary| [r.samples, r.unanswered, above(r.samples, r.above_target)];
            let (counted, apart): (Vec<_>, Vec<_>) = samples.iter().partition(|(service, _)| *service < 3);
            prop_assert_eq!(whole[0], counted.len());
            prop_assert_eq!(summary.services[3].samples, apart.len());
            prop_assert_eq!(summary.regions.iter().map(|region| region.samples).sum::<usize>(), counted.len());
            let in_total = || summary.services.iter().filter(|service| service.in_total);
            prop_assert_eq!(sum(in_total().map(of_service).collect()), whole);
            prop_assert_eq!(sum(summary.robots.iter().map(of_robot).collect()), whole);
            for robot in &summary.robots {
                let its = in_total().filter(|service| service.robot == robot.robot);
                prop_assert_eq!(sum(its.map(of_service).collect()), of_robot(robot));
            }
            let max = |times: Option<Quantiles>| times.map_or(0.0, |times| times.max);
            let highest = in_total().map(|service| max(service.service_time_ms)).fold(0.0, f64::max);
            prop_assert_eq!(max(summary.service_time_ms), highest);
            let all = Quantiles::of(counted.iter().filter_map(|(_, took)| Some((*took)? as f64)).collect());
            prop_assert_eq!(summary.service_time_ms, all);
            prop_assert_eq!(summary.robots.iter().map(|robot| robot.handovers).sum::<usize>(), handovers.len());
            let longest = handovers.iter().map(|(_, gap)| *gap as f64).fold(0.0, f64::max);
            let gaps = summary.robots.iter().map(|robot| max(robot.handover_gap_ms));
            prop_assert_eq!(gaps.fold(0.0, f64::max), longest);
        }
    }

    #[test]
    fn time_without_a_radio_unit_is_reported_though_it_is_in_no_gap() {
        let mut report = report();
        let mut at = |s, event| report.absorb(&Stamped { at: Timestamp::from_secs_f64(s), event });
        let (robot, from, to): (NodeId, NodeId, NodeId) =
            ("robot".parse().unwrap(), "R1".parse().unwrap(), "R2".parse().unwrap());
        let joined = |gap| {
            Event::Handover(Handover { robot: robot.clone(), from: None, to: to.clone(), gap, fast: false })
        };
        let lost = || Event::Detached { robot: robot.clone(), from: from.clone() };
        at(10.0, lost());
        at(11.0, lost());
        at(50.0, joined(Duration::from_millis(100)));
        at(60.0, joined(Duration::from_millis(100)));
        at(90.0, lost());
        let summary = report.summary(Timestamp::from_secs_f64(99.0), "finished", Losses::default());
        let detached = summary.robots.iter().map(|robot| robot.detached_ms).collect::<Vec<_>>();
        assert_eq!(detached, [49_000.0, 0.0]);
        assert_eq!(summary.robots[0].handover_gap_ms.unwrap().max, 100.0);
    }

    #[test]
    fn robots_and_services_without_samples_are_reported_by_name() {
        let mut report = report();
        report.absorb(&sample(0, "R1", Some(10)));
        let summary = report.summary(Timestamp::ZERO, "finished", Losses::default());
        let services: Vec<_> =
            summary.services.iter().map(|s| (s.robot.as_str(), s.service.as_str(), s.samples)).collect();
        let expected = [
            ("robot", "navigation", 1),
            ("robot", "detect", 0),
            ("other", "watch", 0),
            ("robot", "localization", 0),
        ];
        assert_eq!(services, expected);
        let robots: Vec<_> =
            summary.robots.iter().map(|r| (r.robot.as_str(), r.samples, r.above_target)).collect();
        assert_eq!(robots, [("robot", 1, Some(0.0)), ("other", 0, None)]);
    }

    #[test]
    fn a_demanded_share_of_a_service_judges_its_robot_and_the_run() {
        let mut report = report();
        // Localization is apart from the total, and judged all the same.
        [Some(0.5), None, None, Some(1.0)]
            .into_iter()
            .zip(&mut report.services)
            .for_each(|(keep, its)| its.keep = keep);
        let services = report.services();
        for (i, (place, took)) in [(0, Some(10)), (0, None), (2, None), (3, Some(60))].into_iter().enumerate()
        {
            report.absorb(&of_service(&services[place], sample(i as u32, "R1", took)));
        }
        let summary = report.summary(Timestamp::ZERO, "finished", Losses::default());
        let verdicts: Vec<_> = summary.services.iter().map(|its| its.kept.verdict).collect();
        assert_eq!(verdicts, [Some(Verdict::Pass), None, None, Some(Verdict::Fail)]);
        let robots: Vec<_> = summary.robots.iter().map(|its| its.verdict).collect();
        assert_eq!((robots, summary.verdict), (vec![Some(Verdict::Fail), None], Some(Verdict::Fail)));
        let json = serde_json::to_value(&summary.services[0]).unwrap();
        assert_eq!(
            (&json["kept"], &json["keep"], &json["verdict"]),
            (&0.5.into(), &0.5.into(), &"PASS".into())
        );
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
            let mut stamped = of_service(none, sample(i as u32, "R1", took));
            if let Event::ServiceTime(sample) = &mut stamped.event {
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
        let services: Vec<_> = summary.services[..2].iter().map(plain).collect();
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
}
