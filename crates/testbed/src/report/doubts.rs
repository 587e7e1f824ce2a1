//! Collects what speaks against a run's figures, from its events.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use cotorra_graph::{
    AgentId, Event, NodeId, PluginId, PluginProgram, Program, RobotFault, Service, Stamped, Testbed,
    Timestamp, VnfEvent, VnfId, VnfState,
};

/// Running time after which a VNF counts as started for good.
const HEALTHY_AFTER: Duration = Duration::from_secs(10);
/// Number of short lives in a row after which a VNF does not work.
const SHORT_LIVES: u32 = 3;

/// Events that speak against a run's figures, beside its fidelity.
#[derive(Debug, Default)]
pub(super) struct Doubts {
    plugins: BTreeMap<PluginId, Plugin>,
    /// Plug-ins that were cut off, and their logs in the run's folder.
    pub(super) cut_off: Vec<(String, Option<String>)>,
    /// VNFs of the testbed file that have not served so far.
    pub(super) unserved: BTreeSet<VnfId>,
    pub(super) lives: BTreeMap<(VnfId, NodeId), Life>,
    /// Agents that have not reported so far, by their nodes.
    pub(super) absent: BTreeMap<NodeId, AgentId>,
    /// Robots that have not been without a fault so far, with their last one.
    pub(super) faulty: BTreeMap<NodeId, Option<RobotFault>>,
    pub(super) samples: BTreeMap<cotorra_graph::ServiceId, Samples>,
}

/// The testbed file's settings of a plug-in.
#[derive(Debug)]
struct Plugin {
    is_optional: bool,
    is_program: bool,
}

/// The source of a service's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Samples {
    /// Its robot's walk or localization, or the model that its robot follows.
    Robot,
    /// A flow between programs.
    Flow,
    /// A flow between programs that do not run in virtual time.
    NotRunning,
}

impl Samples {
    /// Returns where the samples of a service come from; `None` if it has none.
    fn of(testbed: &Testbed, service: &Service) -> Option<Self> {
        let of_robot = service.localizes()
            || service.policy.is_some()
            || (service.navigates() && testbed.walk(&service.robot).is_some());
        let of_flow = service.kpis.flow.as_ref().map(|_| Self::Flow);
        if of_robot { Some(Self::Robot) } else { of_flow }
    }
}

/// Returns the services of a testbed that should have samples.
pub fn sampled_services(testbed: &Testbed) -> impl Iterator<Item = &Service> {
    testbed.services.iter().filter(|service| Samples::of(testbed, service).is_some())
}

/// The instances of a VNF on a node, one after another.
#[derive(Debug, Default)]
pub(super) struct Life {
    began: Option<Timestamp>,
    /// Number of the last short lives in a row.
    short: u32,
    /// Reason for which the last one ended by itself.
    dead: Option<String>,
}

impl Life {
    fn note(&mut self, at: Timestamp, VnfEvent { state, detail, .. }: &VnfEvent) {
        match state {
            VnfState::Started => (self.began, self.dead) = (Some(at), None),
            VnfState::Stopped => *self = Self::default(),
            VnfState::Died | VnfState::Failed => {
                let lived = self.began.take().is_some_and(|began| at.since(began) >= HEALTHY_AFTER);
                self.short = if lived { 1 } else { self.short + 1 };
                self.dead = Some(detail.clone().unwrap_or_else(|| "for an unknown reason".to_owned()));
            }
        }
    }

    /// Returns what is wrong with a VNF at the end of a run.
    pub(super) fn fault(&self, end: Timestamp) -> Option<String> {
        let recovered = self.began.is_some_and(|began| end.since(began) >= HEALTHY_AFTER);
        match &self.dead {
            Some(reason) => Some(format!("did not run at the end: {reason}")),
            None if self.short >= SHORT_LIVES && !recovered => {
                Some(format!("ended {} times soon after its start", self.short))
            }
            None => None,
        }
    }
}

impl Doubts {
    pub(super) fn new(testbed: &Testbed) -> Self {
        let plugin = |spec: &cotorra_graph::PluginSpec| {
            let is_program = matches!(spec.program, PluginProgram::Command(_));
            (spec.id.clone(), Plugin { is_optional: spec.optional, is_program })
        };
        let samples = |service: &Service| Some((service.id.clone(), Samples::of(testbed, service)?));
        Self {
            plugins: testbed.plugins.iter().map(plugin).collect(),
            absent: testbed.graph.agents().map(|(node, agent)| (node.id.clone(), agent.clone())).collect(),
            faulty: testbed.graph.robots().map(|(node, _)| (node.id.clone(), None)).collect(),
            unserved: testbed.vnfs().map(|vnf| vnf.id.clone()).collect(),
            samples: testbed.services.iter().filter_map(samples).collect(),
            ..Self::default()
        }
    }

    /// Expects nothing of programs, which do not run in virtual time.
    pub(super) fn in_virtual_time(mut self, testbed: &Testbed) -> Self {
        let is_bundled = |program: &Program| !matches!(program, Program::Command(_) | Program::Host(_));
        let bundled = testbed.vnfs().filter(|vnf| is_bundled(&vnf.program)).map(|vnf| &vnf.id);
        let bundled: BTreeSet<_> = bundled.collect();
        self.unserved.retain(|vnf| bundled.contains(vnf));
        self.absent.clear();
        for samples in self.samples.values_mut().filter(|samples| **samples == Samples::Flow) {
            *samples = Samples::NotRunning;
        }
        self
    }

    /// Takes an event. Returns a notice about an optional plug-in.
    pub(super) fn absorb(&mut self, Stamped { at, event }: &Stamped) -> Option<String> {
        match event {
            Event::PluginFault { plugin, reason } => {
                let known = self.plugins.get(plugin);
                let log = known.filter(|its| its.is_program).map(|_| format!("logs/plugins/{plugin}.log"));
                if known.is_some_and(|its| its.is_optional) {
                    let log = log.map(|log| format!(" ({log})")).unwrap_or_default();
                    return Some(format!("optional plug-in {plugin} was cut off: {reason}{log}"));
                }
                self.cut_off.push((format!("plug-in {plugin} was cut off: {reason}"), log));
            }
            Event::Machine(context) => drop(self.absent.remove(&context.node)),
            Event::Robot(context) => match context.health.first() {
                None => drop(self.faulty.remove(&context.robot)),
                Some(fault) => {
                    if let Some(last) = self.faulty.get_mut(&context.robot) {
                        *last = Some(*fault);
                    }
                }
            },
            Event::Placement(placement) => {
                self.unserved.remove(&placement.vnf);
            }
            Event::Vnf(event) => {
                let of = (event.vnf.clone(), event.node.clone());
                self.lives.entry(of).or_default().note(*at, event);
            }
            _ => {}
        }
        None
    }

    /// Takes the number of events that plug-ins in process missed.
    pub(super) fn missed(&mut self, events: u64) {
        let what = format!("bundled plug-ins were too slow, and missed {events} events");
        self.cut_off.extend((events > 0).then_some((what, None)));
    }

    /// Whether a plug-in's fault leaves the figures valid.
    pub(super) fn is_optional(&self, plugin: &PluginId) -> bool {
        self.plugins.get(plugin).is_some_and(|its| its.is_optional)
    }
}
