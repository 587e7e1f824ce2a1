//! The emulated network in real time: the fabric on the datapath's thread, and NetEm where it carries the packets, in this
//! machine's kernel or in that of an agent. In that case the fabric still keeps the state, so that conditions, scales and
//! rejections are the same, and the kernel applies the results.

use std::{iter::repeat, sync::Arc};

use cotorra_datapath::{Datapath, Handle, KernelNetwork, KernelNetworkError, Observed, ReservedHop};
use cotorra_fabric::{Fabric, PinnedPath};
use cotorra_graph::{
    AccessPoint, AgentId, Attachment, ConditionChange, Conditions, Direction, Emulation, Lateness,
    LinkContext, LinkId, NodeId, RadioContext, RealLink, Testbed, ThroughputTest, Timestamp,
};
use cotorra_network_control::{
    Deployment, InstructionError, Network, NetworkGone, attach_in_fabric, change_fabric,
    check_switch_on_in_fabric, pin_in_fabric, provision_in_fabric, scan_in_fabric, suggest_in_fabric,
    switch_off_in_fabric, switch_on_in_fabric, test_fabric_throughput,
};

use crate::{
    capture::{Wiretap, WiretapError},
    real::{links::RealLinks, radio_figures::RadioFigures, traffic::Traffic},
    wifi,
};

/// The network of a datapath.
pub(crate) struct RealNetwork {
    handle: Handle,
    kernel: Option<Arc<KernelNetwork>>,
    real: Option<RealLinks>,
    agents: Option<Box<dyn AgentLinks>>,
    /// Real Wi-Fi software: that on simulated radios, and that on real ones.
    wifi: Vec<wifi::Handle>,
    figures: Option<Arc<dyn RadioFigures>>,
    traffic: Traffic,
}

/// Links over interfaces of agents' machines.
pub(crate) trait AgentLinks: Send {
    /// Returns the agent of such a link; `None` for any other.
    fn agent(&self, link: &LinkId) -> Option<&AgentId>;

    /// Wants the agent to change one direction of such a link. The agent reports later what became of it.
    ///
    /// # Errors
    /// The reason, for people, if NetEm cannot emulate the conditions, or the agent is not connected. Nothing has changed
    /// then.
    fn set(&self, link: &LinkId, direction: Direction, conditions: &Conditions) -> Result<(), String>;

    /// Completes the contexts of such links. λ and the counters are those that the agents reported last.
    fn complete(&self, contexts: &mut [LinkContext]);
}

/// Returns the kernel's network, if the testbed wants it. If the kernel cannot emulate the testbed, this logs the reason,
/// and the fabric carries the packets.
///
/// # Errors
///
/// Errors that the fabric could not work with, either.
pub(crate) fn kernel_network(
    testbed: &Testbed,
    fabric: &Fabric,
) -> Result<Option<KernelNetwork>, cotorra_datapath::Error> {
    if testbed.emulation == Emulation::Fabric {
        return Ok(None);
    }
    match KernelNetwork::start(&testbed.graph.without_machines(), fabric, testbed.probes) {
        Ok(network) => Ok(Some(network)),
        Err(KernelNetworkError::Datapath(error)) => Err(error),
        Err(reason) => {
            tracing::warn!("the kernel cannot emulate this testbed, so the fabric does: {reason}");
            Ok(None)
        }
    }
}

/// Returns access to the packets that the fabric carries.
pub(crate) fn wiretap(testbed: &Arc<Testbed>, datapath: &Datapath) -> Wiretap {
    let (testbed, handle, is_kernels) = (Arc::clone(testbed), datapath.handle(), datapath.kernel().is_some());
    Arc::new(move |name, reader| {
        let elsewhere = |reason: String| Err(WiretapError::Elsewhere(reason));
        if is_kernels {
            let tool = "capture them with a tool inside a node, as in `cotorra exec NODE -- tcpdump`";
            return elsewhere(format!("the kernel carries the packets of this testbed: {tool}"));
        }
        let is_here =
            |real: &RealLink<'_>| real.link.id == *name || real.link.ends.iter().any(|end| *end == *name);
        if let Some(real) = testbed.graph.real_links().find(is_here) {
            let interface = &real.reached.interface;
            let whose = match &real.reached.via {
                None => format!("this machine's interface {interface}"),
                Some(agent) => format!("the interface {interface} of the machine of agent `{agent}`"),
            };
            return elsewhere(format!("`{name}` is reached over {whose}: capture there, as with tcpdump"));
        }
        let name = name.to_owned();
        let tapped = handle.with(move |fabric, _| fabric.tap(&name, reader));
        Ok(tapped.map_err(|gone| WiretapError::Elsewhere(gone.to_string()))??)
    })
}

impl RealNetwork {
    pub(crate) fn new(datapath: &Datapath, real: Option<RealLinks>) -> Self {
        Self {
            handle: datapath.handle(),
            kernel: datapath.kernel(),
            real,
            agents: None,
            wifi: Vec::new(),
            figures: None,
            traffic: Traffic::default(),
        }
    }

    /// Changes links over interfaces of agents' machines by these from now on.
    pub(crate) fn set_agents(&mut self, agents: Box<dyn AgentLinks>) {
        self.agents = Some(agents);
    }

    /// Lets these programs carry out instructions to their robots and radio units from now on.
    pub(crate) fn add_wifi(&mut self, wifi: wifi::Handle) {
        self.wifi.push(wifi);
    }

    /// Takes φ and ι of real radios from there from now on.
    pub(crate) fn set_radio_figures(&mut self, figures: Arc<dyn RadioFigures>) {
        self.figures = Some(figures);
    }

    /// Returns the Wi-Fi programs, if a robot or a radio unit has one.
    fn wifi(&self, node: &NodeId) -> Option<&wifi::Handle> {
        self.wifi.iter().find(|wifi| wifi.has(node))
    }

    /// Returns the carrier of a link's packets, if it is not the fabric.
    fn carrier(&self, link: &LinkId) -> Option<Carrier<'_>> {
        let real = self.real.as_ref().filter(|real| real.has(link)).map(Carrier::Interface);
        let agents = || self.agents.as_deref().filter(|agents| agents.agent(link).is_some());
        real.or_else(|| agents().map(Carrier::Agents)).or_else(|| self.kernel.as_deref().map(Carrier::Kernel))
    }
}

/// Carrier of a link's packets in place of the fabric.
enum Carrier<'a> {
    Kernel(&'a KernelNetwork),
    Interface(&'a RealLinks),
    Agents(&'a dyn AgentLinks),
}

impl Carrier<'_> {
    fn set(
        &self,
        link: &LinkId,
        direction: Direction,
        conditions: &Conditions,
    ) -> Result<(), InstructionError> {
        match self {
            Self::Kernel(kernel) => {
                kernel.set(link, direction, conditions).map_err(|e| InstructionError(e.to_string()))
            }
            Self::Interface(real) => {
                real.set(link, direction, conditions).map_err(|e| InstructionError(e.to_string()))
            }
            Self::Agents(agents) => agents.set(link, direction, conditions).map_err(InstructionError),
        }
    }
}

impl Network for RealNetwork {
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone> {
        self.handle.with(action).map_err(|_| NetworkGone)
    }

    fn change(
        &self,
        link: &LinkId,
        direction: Option<Direction>,
        change: &ConditionChange,
    ) -> Result<Vec<LinkContext>, InstructionError> {
        let Some(carrier) = self.carrier(link) else { return change_fabric(self, link, direction, change) };
        // Changes nothing, and returns the current conditions.
        let all = change_fabric(self, link, None, &ConditionChange::default())?;
        let after = change_fabric(self, link, direction, change)?;
        let mut told: Vec<&LinkContext> = Vec::new();
        for (before, after) in
            all.iter().zip(&after).filter(|(before, after)| before.effective != after.effective)
        {
            if let Err(refused) = carrier.set(link, after.direction, &after.effective) {
                // The previous conditions can be restored.
                for context in &all {
                    let _ = change_fabric(self, link, Some(context.direction), &context.again());
                }
                for context in told.into_iter().chain([before]) {
                    let _ = carrier.set(link, context.direction, &context.effective);
                }
                return Err(refused);
            }
            told.push(before);
        }
        Ok(after)
    }

    /// Bridges have one path between two hosts: only the reservations are the kernel's.
    fn pin(&self, paths: Vec<PinnedPath>) -> Result<Result<(), InstructionError>, NetworkGone> {
        pin_in_fabric(self, paths.clone())?;
        let Some(kernel) = &self.kernel else { return Ok(Ok(())) };
        let reserved = self.with(move |fabric, _| {
            let hops = |PinnedPath { from, to, links, reservation }: &PinnedPath| {
                let hops = fabric.check_path(from, to, links).unwrap_or_default().into_iter();
                let hop = |((link, direction), reservation)| {
                    let (from, to) = (from.clone(), to.clone());
                    ReservedHop { link, direction, from, to, reservation }
                };
                reservation.map(|reservation| hops.zip(repeat(reservation)).map(hop).collect::<Vec<_>>())
            };
            paths.iter().filter_map(hops).flatten().collect::<Vec<_>>()
        })?;
        Ok(kernel.reserve(&reserved).map_err(|error| InstructionError(error.to_string())))
    }

    fn test_throughput(
        &self,
        link: &LinkId,
        direction: Direction,
        test: ThroughputTest,
    ) -> Result<(), InstructionError> {
        match self.carrier(link) {
            Some(Carrier::Interface(_) | Carrier::Agents(_)) => Err(InstructionError(
                "this link leads over a real interface, and only links between emulated nodes can be tested"
                    .to_owned(),
            )),
            Some(Carrier::Kernel(kernel)) => kernel
                .test_throughput(link, direction, test)
                .map_err(|refusal| InstructionError(refusal.to_string())),
            None => test_fabric_throughput(self, link, direction, test),
        }
    }

    fn scan(&self, robot: &NodeId) -> Result<(), InstructionError> {
        match self.wifi(robot) {
            Some(wifi) => wifi.scan(robot).map_err(rejected),
            None => scan_in_fabric(self, robot),
        }
    }

    fn attach(&self, robot: &NodeId, radio_unit: &NodeId) -> Result<(), InstructionError> {
        match self.wifi(robot) {
            Some(wifi) => wifi.attach(robot, radio_unit).map_err(rejected),
            None => attach_in_fabric(self, robot, radio_unit),
        }
    }

    fn suggest(&self, robot: &NodeId, radio_unit: &NodeId) -> Result<Option<u8>, InstructionError> {
        match self.wifi(robot) {
            Some(wifi) => wifi.suggest(robot, radio_unit).map(|()| None).map_err(rejected),
            None => suggest_in_fabric(self, robot, radio_unit),
        }
    }

    fn provision(
        &self,
        robot: &NodeId,
        radio_unit: &NodeId,
        access_point: AccessPoint,
    ) -> Result<(), InstructionError> {
        match self.wifi(robot) {
            Some(wifi) => wifi.provision(robot, radio_unit, access_point).map_err(rejected),
            None => provision_in_fabric(self, robot, radio_unit, access_point),
        }
    }

    fn check_switch_on(
        &self,
        radio_unit: &NodeId,
        access_point: &AccessPoint,
    ) -> Result<Deployment, InstructionError> {
        match self.wifi(radio_unit) {
            Some(wifi) => {
                wifi.check_switch_on(radio_unit, access_point).map(|()| Deployment::Real).map_err(rejected)
            }
            None => check_switch_on_in_fabric(self, radio_unit, access_point),
        }
    }

    fn switch_on(
        &self,
        radio_unit: &NodeId,
        access_point: AccessPoint,
    ) -> Result<Result<(), InstructionError>, NetworkGone> {
        match self.wifi(radio_unit) {
            Some(wifi) => Ok(wifi.switch_on(radio_unit, access_point).map_err(rejected)),
            None => switch_on_in_fabric(self, radio_unit, access_point),
        }
    }

    fn switch_off(&self, radio_unit: &NodeId) -> Result<(), InstructionError> {
        match self.wifi(radio_unit) {
            Some(wifi) => wifi.switch_off(radio_unit).map_err(rejected),
            None => switch_off_in_fabric(self, radio_unit),
        }
    }

    fn complete_attachments(&self, now: Timestamp, robot: &NodeId, attachments: &mut [Attachment]) {
        if let Some(figures) = &self.figures {
            figures.complete_attachments(now, robot, attachments);
        }
    }

    fn complete_radio(&self, context: &mut RadioContext) {
        if let Some(figures) = &self.figures {
            figures.complete_radio(context);
        }
    }

    fn lateness(&self, fabric: Lateness) -> Lateness {
        match &self.real {
            Some(real) if real.are_alone() => real.lateness(),
            _ => match &self.kernel {
                Some(kernel) => kernel.lateness(),
                None => worse(fabric, self.handle.port_waits().frames),
            },
        }
    }

    /// The kernel counts packets that bypass the fabric, and carries probes. The delay of other packets is not measured
    /// then, and is left out. So are queues, of which the fabric has only its own empty ones.
    fn complete(&self, now: Timestamp, mut contexts: Vec<LinkContext>) -> Vec<LinkContext> {
        for context in contexts.iter_mut().filter(|context| self.carrier(&context.link).is_some()) {
            context.queued_packets = None;
        }
        let mut contexts = match &self.real {
            Some(real) => real.complete(now, contexts),
            None => contexts,
        };
        if let Some(agents) = &self.agents {
            agents.complete(&mut contexts);
        }
        let Some(kernel) = &self.kernel else { return contexts };
        let observed = match kernel.observe() {
            Ok(observed) => observed,
            Err(error) => {
                tracing::warn!("cannot read the kernel's counters of links: {error}");
                return contexts;
            }
        };
        for context in &mut contexts {
            let key = (context.link.clone(), context.direction);
            let Some(&Observed { probed, tested, .. }) = observed.get(&key) else { continue };
            (context.probed, context.tested) = (probed, tested);
        }
        let all = contexts.len() >= observed.len();
        let counted = observed.into_iter().map(|(key, observed)| (key, observed.counters)).collect();
        self.traffic.complete(now, &mut contexts, &counted, all);
        contexts
    }
}

/// Returns the lateness of frames that were late when they were delivered, and before that in their ports: the larger of each
/// quantile.
fn worse(delivered: Lateness, ports: Lateness) -> Lateness {
    Lateness {
        frames: delivered.frames,
        p50_us: delivered.p50_us.max(ports.p50_us),
        p99_us: delivered.p99_us.max(ports.p99_us),
        max_us: delivered.max_us.max(ports.max_us),
    }
}

fn rejected(reason: wifi::Rejected) -> InstructionError {
    InstructionError(reason.to_string())
}
