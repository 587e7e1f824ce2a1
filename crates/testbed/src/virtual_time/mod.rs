//! A testbed in virtual time: the same core, fabric, robots and plug-ins as in real time, driven by their deadlines instead
//! of a clock. Nothing sleeps, all randomness comes from the seed, and the same seed gives the same events.

mod accelerators;
mod altered;
mod computers;
mod engine;
mod interference;
mod migrations;
mod network;
mod requests;
mod run;
pub(crate) mod time_control;
mod udp;
mod unrecorded;

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    net::{Ipv4Addr, SocketAddrV4},
    sync::Arc,
    time::Duration,
};

use cotorra_fabric::{Airtime, Balance, Fabric, PortId};
use cotorra_federation::Ledgers;
use cotorra_graph::{
    Decision, Direction, Event, HostAddress, Instruction, LinkId, NodeId, PluginId, PluginProgram, Program,
    Stamped, Testbed, Timestamp,
};
use cotorra_localization::trajectory::Errors;
use cotorra_network_control::{InstructionError, vim::Managed};
use cotorra_robot_middleware::{Nonces, SensedData, SensedScan};
use cotorra_traffic::{Measured, Sources};

pub(crate) use self::{
    accelerators::{AcceleratorsUse, InferredSoFar, ModelUse},
    engine::VirtualEngine,
    migrations::{Migrated, MigrationOutcome},
    network::VirtualNetwork,
};
pub use self::{
    altered::{Altered, Fork, is_same_subject},
    engine::{Mood, Serving},
    requests::first_requests,
    run::{Watched, simulate, simulate_watched},
    unrecorded::{Unrecorded, UnrecordedRun, simulate_unrecorded},
};
use self::{
    altered::{Forked, Forking},
    computers::Answer,
    interference::{Held, Interference},
    requests::Requests,
};
use crate::{
    computed::ComputedSoFar,
    core::{Core, Observation, script::Script},
    domain::Domains,
    error::RunError,
    given::Given,
    history::{links::RunHistory, previous_run::PreviousRun},
    plugins::{
        Bundled, CONTROL_PORT, Datagram, PluginError, Travel,
        host::{Fault, PluginHost},
        lockstep::{Call, Locals, Lockstep, PATIENCE, Returned},
        programs,
    },
    real::robots::simulated,
    traffic,
};

/// Source port of robots; any would do.
const ROBOT_PORT: u16 = 40_000;
/// Source port of robots' cameras.
const IMAGE_PORT: u16 = 40_001;
/// Port of robots that follow models.
const POLICY_PORT: u16 = 40_003;

/// Returns the testbed as it is in virtual time: all servers are emulated, and robots at agents simulated.
fn emulated(mut testbed: Arc<Testbed>) -> Arc<Testbed> {
    if testbed.graph.agents().next().is_some() {
        Arc::make_mut(&mut testbed).graph.emulate_agents();
    }
    testbed
}

/// A testbed in virtual time.
pub struct Simulation {
    core: Core<VirtualNetwork, VirtualEngine>,
    network: VirtualNetwork,
    serving: Serving,
    interference: Interference,
    /// Present if requests to a VNF are kept.
    requests: Option<Requests>,
    traffic: Sources,
    host: PluginHost,
    locals: Locals,
    /// Present if a decision gets another outcome.
    forking: Option<Forking>,
    /// Ledgers that orchestrators share.
    ledgers: Ledgers,
    ports: HashMap<Ipv4Addr, PortId>,
    /// Datagrams of policies from hosts to themselves, which never leave these.
    looped: VecDeque<Held>,
    outputs: VecDeque<Output>,
    /// Number of events in `outputs`.
    events: usize,
    /// Time of a step that is requested from outside.
    alarm: Option<Timestamp>,
    /// Extent of the next [`Lockstep::run`].
    stretch: Stretch,
    /// Beginning of the stretch.
    stretch_began: Timestamp,
    /// Whether the first step was made.
    begun: bool,
}

/// An output of a simulation.
pub(crate) enum Output {
    Event(Arc<Stamped>),
    Scan(SensedScan),
    Data(SensedData),
}

/// Extent of a run without supervision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stretch {
    /// No step; only plug-ins react to events.
    Settle,
    /// One step.
    Step,
    /// Steps until this number of events waits to be polled, the alarm has come, all walks are done, or this time is
    /// reached.
    Events(usize, Option<Timestamp>),
}

impl Simulation {
    /// Creates a simulation of a testbed at time zero.
    ///
    /// # Errors
    /// [`RunError`] if the graph, a robot or a plug-in cannot be simulated. A plug-in that is a program cannot.
    pub fn new(testbed: Arc<Testbed>, seed: u64) -> Result<Self, RunError> {
        if let Some(program) = programs(&testbed).next() {
            return Err(PluginError::NeedsRun(program.clone()).into());
        }
        Self::without_programs(testbed, seed, None)
    }

    /// Creates a simulation without the plug-ins that are programs. The others read this history.
    fn without_programs(
        testbed: Arc<Testbed>,
        seed: u64,
        history: Option<RunHistory>,
    ) -> Result<Self, RunError> {
        Self::on(testbed, seed, Ledgers::in_virtual_time(), history, None)
    }

    /// Creates a simulation on ledgers that may know previous runs, with the notes of one of these.
    fn on(
        testbed: Arc<Testbed>,
        seed: u64,
        ledgers: Ledgers,
        history: Option<RunHistory>,
        earlier: Option<&PreviousRun>,
    ) -> Result<Self, RunError> {
        if let Some((gateway, _)) = testbed.graph.gateways().next() {
            return Err(RunError::VirtualGateway(gateway.id.clone()));
        }
        if testbed.border.is_some() {
            return Err(RunError::VirtualBorder);
        }
        if let Some((network, _)) =
            testbed.graph.wireless.iter().find(|(_, network)| network.access.software().is_some())
        {
            return Err(RunError::VirtualWifi(network.clone()));
        }
        let testbed = emulated(testbed);
        let (script, _) = Script::load(&testbed)?;
        let mut fabric = Fabric::new(&testbed.graph, seed)?;
        testbed.without_port_security.iter().for_each(|node| fabric.disable_port_security(node));
        if let Some(probing) = testbed.probes {
            fabric.probe_links(Timestamp::ZERO, probing);
        }
        fabric.measure_flows(&testbed.services);
        let traffic = traffic::sources(&testbed, &fabric, seed);
        let network = VirtualNetwork::new(fabric);
        let serving = Serving::default();
        let engine = VirtualEngine::new(&testbed, seed, serving.clone())?;
        let mut core = Core::new(
            Arc::clone(&testbed),
            seed,
            Nonces::seeded(seed),
            network.clone(),
            engine,
            script,
            simulated,
        )?;
        let domains = Domains::new(&testbed);
        let mut bundled = Bundled::new(&testbed, seed, ledgers).reading(history);
        let mut locals = Locals::default();
        for spec in &testbed.plugins {
            let PluginProgram::Bundled(name) = &spec.program else { continue };
            let mut plugin = bundled.make(spec, name)?;
            if let Some(earlier) = earlier {
                plugin.resume(earlier.noted_by(&spec.id));
            }
            locals.add(spec.id.clone(), plugin, &testbed, domains.of_plugin(&spec.id).cloned());
        }
        core.start(Timestamp::ZERO);
        for vnf in testbed.vnfs() {
            let what = match vnf.program {
                Program::Command(_) => "VNF",
                Program::Host(_) => "The container of node",
                Program::RobotDriver
                | Program::Navigation
                | Program::Localization
                | Program::RosNavigation
                | Program::PolicyServer(_) => continue,
            };
            let message =
                format!("{what} {} does not run: in virtual time no program of others does", vnf.id);
            core.observe(Stamped { at: Timestamp::ZERO, event: Event::Notice { message } });
        }
        let hosts = testbed.graph.hosts().count();
        Ok(Self {
            core,
            network,
            serving,
            interference: Interference::default(),
            requests: None,
            traffic,
            host: PluginHost::new(testbed.plugins.iter().map(|spec| spec.id.clone()), PATIENCE)
                .with_limits(&testbed.plugins)
                .with_domains(&testbed.graph.domains)
                .with_travel(Travel::in_virtual_time(&testbed.plugins)),
            locals,
            forking: None,
            ledgers: bundled.into_ledgers(),
            ports: (0..hosts).map(|i| (HostAddress::of(i).ipv4, PortId(i))).collect(),
            looped: VecDeque::new(),
            outputs: VecDeque::new(),
            events: 0,
            alarm: None,
            stretch: Stretch::Step,
            stretch_began: Timestamp::ZERO,
            begun: false,
        })
    }

    /// Adds a plug-in in process.
    pub fn with_plugin(
        mut self,
        id: PluginId,
        plugin: Box<dyn cotorra_plugin::Plugin>,
        testbed: &Arc<Testbed>,
    ) -> Self {
        self.host.add(id.clone());
        self.locals.add(id, plugin, testbed, None);
        self
    }

    /// Applies differences from the testbed file.
    pub(crate) fn altered(mut self, altered: &Altered) -> Self {
        self.serving.slow_down(altered.slow.clone());
        self.forking = altered.fork.clone().map(Forking::new);
        self
    }

    /// Returns the outcome of the fork's alternative, once the run has passed it.
    pub(crate) fn forked(&self) -> Option<&Result<(), InstructionError>> {
        self.forking.as_ref()?.outcome()
    }

    /// Sets the longest wait for a plug-in.
    pub(crate) fn with_patience(mut self, patience: Duration) -> Self {
        self.host.set_patience(patience);
        self
    }

    /// Makes the next step, and returns its time. Poll events after each step. Plug-ins are called on this thread: one that
    /// hangs also hangs the thread.
    pub fn step(&mut self) -> Timestamp {
        self.go(Stretch::Step);
        self.run();
        self.now()
    }

    /// Makes the next step as [`Self::step`] does, but a plug-in counts as hung if `hangs` says so after a call of it.
    pub fn step_with(&mut self, hangs: impl FnMut() -> bool) {
        self.run_with(Stretch::Step, hangs);
    }

    /// Lets plug-ins react to events, without a step. `hangs` is as for [`Self::step_with`].
    pub fn settle_with(&mut self, hangs: impl FnMut() -> bool) {
        self.run_with(Stretch::Settle, hangs);
    }

    fn run_with(&mut self, stretch: Stretch, mut hangs: impl FnMut() -> bool) {
        self.go(stretch);
        loop {
            while let Some(call) = self.next_call() {
                let returned = call.make();
                let returned = if hangs() { Err(Fault::Hung(PATIENCE)) } else { returned };
                self.returned(returned);
            }
            if !self.go_on() {
                return;
            }
        }
    }

    /// Sets the extent of the next run.
    pub(crate) fn go(&mut self, stretch: Stretch) {
        self.stretch = stretch;
        self.stretch_began = self.now();
    }

    /// Returns the current time.
    pub fn now(&self) -> Timestamp {
        self.network.now()
    }

    /// Makes the next step, without the reactions of plug-ins.
    fn begin_step(&mut self) {
        if self.begun {
            self.network.set_now(self.next_time());
        }
        self.begun = true;
        let now = self.now();
        self.serving.advance(now);
        // The network in memory cannot be gone.
        let _ = self.core.advance(now);
        self.serving.contexts().into_iter().for_each(|context| self.core.observe(context));
        self.carry(now);
        self.host.apply_arrived(now, &mut Forked { core: &mut self.core, forking: &mut self.forking });
        self.locals.end_cut_off(&self.host);
        self.locals.wake();
    }

    /// Returns the time of the next step.
    fn next_time(&self) -> Timestamp {
        let now = self.now();
        let plugins = self.locals.next_deadline(&self.host).into_iter().chain(self.host.next_travel());
        let fabric = self.network.fabric().poll(now, &mut |_, _| {});
        let held = self.interference.next_deadline();
        let starts = self.serving.next_deadline();
        let traffic = self.traffic.deadline(now);
        let others = plugins.chain(fabric).chain(self.alarm).chain(held).chain(starts).chain(traffic);
        let next = others.fold(self.core.next_deadline(), Timestamp::min);
        // This step met all deadlines that are not in the future; time must not stand still.
        next.max(now + Duration::from_nanos(1))
    }

    /// Makes the next step no later than that time.
    pub fn set_alarm(&mut self, at: Option<Timestamp>) {
        self.alarm = at;
    }

    pub(crate) fn host(&mut self) -> &mut PluginHost {
        &mut self.host
    }

    /// Applies an instruction from outside now. The reactions of plug-ins in process follow in the next run.
    pub fn instruct(&mut self, given: Given) -> Result<(), InstructionError> {
        let now = self.network.now();
        let mut forked = Forked { core: &mut self.core, forking: &mut self.forking };
        let done = self.host.instruct(now, given, &mut forked);
        // The caller may have used the name of a plug-in in process.
        self.locals.end_cut_off(&self.host);
        done
    }

    /// Cuts a program off.
    pub(crate) fn cut_off(&mut self, plugin: &PluginId, fault: &Fault) {
        self.host.cut_off(self.network.now(), plugin, fault, &mut self.core);
    }

    /// Returns the instances of VNFs that run.
    pub fn serving(&self) -> &Serving {
        &self.serving
    }

    /// Returns every replica of every VNF with its instances, by the VNF's name.
    pub fn managed(&self) -> impl Iterator<Item = Managed<'_>> {
        self.core.managed()
    }

    /// Returns what mappings reserve of each direction of a link, and what that carries, bit/s.
    pub fn reserved(&self) -> Vec<(LinkId, Direction, [f64; 2])> {
        let fabric = self.network.fabric();
        let both = |(link, direction, reserved): (&LinkId, _, f64)| {
            let carries = fabric.carries(link, direction).map_or(0.0, |carries| carries.rate_bps);
            (link.clone(), direction, [reserved, carries])
        };
        self.core.reserved().map(both).collect()
    }

    /// Returns what became of all packets that hosts sent.
    pub fn packets(&self) -> Balance {
        self.network.fabric().balance()
    }

    /// Lets a robot neither send nor hear from now on, or do both again.
    pub fn set_silent(&mut self, robot: &NodeId, silent: bool) {
        self.interference.set_silent(robot, silent);
    }

    /// Keeps the last answer to each robot from now on, for [`Self::answer_again`].
    pub fn tap_answers(&mut self) {
        self.interference.tap_answers();
    }

    /// Lets a robot receive its last answer, if there is one, once more, with the byte `forged` changed.
    pub fn answer_again(&mut self, robot: &NodeId, forged: Option<usize>) {
        let Some((from, mut payload)) = self.interference.last_answer(robot) else { return };
        if let Some(byte) = forged.and_then(|place| place.checked_rem(payload.len())) {
            payload[byte] ^= 0x5a;
        }
        self.core.receive(self.now(), robot, from, &payload);
    }

    /// Reorganises the modelled ledger's last blocks with calls away, so many, if there is a ledger.
    pub fn reorganise_ledger(&self, depth: usize) {
        if let Some(chain) = self.ledgers.chain() {
            chain.reorganise(self.now(), depth);
        }
    }

    /// Returns the oldest event; scans and large data are skipped.
    pub fn poll_event(&mut self) -> Option<Stamped> {
        loop {
            match self.poll()? {
                Output::Event(event) => return Some(Arc::unwrap_or_clone(event)),
                Output::Scan(_) | Output::Data(_) => {}
            }
        }
    }

    /// Returns the oldest output.
    pub(crate) fn poll(&mut self) -> Option<Output> {
        let outputs = self.outputs.pop_front()?;
        self.events -= usize::from(matches!(outputs, Output::Event(_)));
        Some(outputs)
    }

    /// Outputs scans from now on, after the events of each step.
    pub(crate) fn tap_scans(&mut self) {
        self.core.tap_scans();
    }

    /// Returns what arrived of each source's traffic so far.
    pub fn traffic(&self) -> Vec<Measured> {
        self.traffic.measured(self.now())
    }

    /// Returns what VNFs with demands computed so far.
    pub(crate) fn computed(&self) -> ComputedSoFar {
        self.serving.computed()
    }

    /// Returns the time that each robot's radio spent on frames so far.
    pub(crate) fn airtimes(&self) -> BTreeMap<NodeId, Airtime> {
        self.network.fabric().airtimes()
    }

    /// Returns what models on accelerators did so far, and what robots followed of them.
    pub(crate) fn inferred(&self) -> InferredSoFar {
        self.serving.inferred(self.core.followed(self.now()))
    }

    /// Returns the moves of VNFs with their state so far.
    pub(crate) fn migrated(&self) -> Vec<Migrated> {
        self.serving.migrated()
    }

    /// Returns the localization errors so far, of each robot that a VNF localizes.
    pub fn localization_errors(&self) -> impl Iterator<Item = (&NodeId, &Errors)> {
        self.core.localization_errors()
    }

    /// Returns the events to publish about services' flows at the end.
    pub(crate) fn flow_remarks(&self) -> Vec<Stamped> {
        self.core.flow_remarks(self.now())
    }

    /// Whether every walk is done; false without walks.
    pub fn is_finished(&self) -> bool {
        self.core.is_finished()
    }

    /// Whether no robot has made progress on its walk for 60 s; false without walks.
    pub(crate) fn is_stuck(&self) -> bool {
        self.core.is_stuck(self.now())
    }

    /// Describes where robots stand that do not walk on.
    pub(crate) fn stand(&self) -> String {
        self.core.stand()
    }

    /// Carries packets as far as they get at this time.
    fn carry(&mut self, now: Timestamp) {
        while let Some(datagram) = self.core.poll_transmit(now) {
            let (Some(from), Some(to)) = (self.port(&datagram.robot), self.port_at(*datagram.to.ip())) else {
                continue;
            };
            if self.interference.is_silent(&datagram.robot) {
                continue;
            }
            if let Some(requests) = &mut self.requests {
                requests.add(now, datagram.to.port(), &datagram.bytes);
            }
            self.send(now, (from, ROBOT_PORT), (to, datagram.to.port()), &datagram.bytes);
        }
        while let Some(image) = self.core.poll_image() {
            let robot = &image.sensed.robot;
            let (Some(from), Some(to)) = (self.port(robot), self.port_at(*image.to.ip())) else { continue };
            if !self.interference.is_silent(robot) {
                image.send(|bytes| self.send(now, (from, IMAGE_PORT), (to, image.to.port()), bytes));
            }
        }
        while let Some(Observation { robot, to, parcel, bytes }) = self.core.poll_observation() {
            let (Some(from), Some(server)) = (self.port(&robot), self.port_at(*to.ip())) else { continue };
            if !self.interference.is_silent(&robot) {
                let datagrams = parcel.datagrams(bytes);
                datagrams.for_each(|part| self.send(now, (from, POLICY_PORT), (server, to.port()), &part));
            }
        }
        while let Some(Held { from, to, payload }) = self.interference.release(now) {
            if let Some(receiver) = self.port_at(to.0) {
                self.send(now, from, (receiver, to.1), &payload);
            }
        }
        loop {
            while let Some(Datagram { from, to, payload }) = self.host.poll_transmit(now) {
                if let (Some(from), Some(to)) = (self.port(&from), self.port(&to)) {
                    self.send(now, (from, CONTROL_PORT), (to, CONTROL_PORT), &payload);
                }
            }
            while let Some(answer) = self.serving.poll() {
                self.send_answer(now, answer);
            }
            self.send_traffic(now);
            self.send_states(now);
            let mut delivered = Vec::new();
            self.network.fabric().poll(now, &mut |port, frame| delivered.push((port, frame)));
            while let Some(event) = self.network.next_event() {
                self.core.observe(event);
            }
            let looped = std::mem::take(&mut self.looped);
            if delivered.is_empty() && looped.is_empty() {
                return;
            }
            for Held { from: (port, from), to: (address, to), payload } in looped {
                let from = SocketAddrV4::new(address, from);
                self.receive(now, port, &cotorra_flows::Datagram { from, to, payload: &payload });
            }
            for (port, frame) in delivered {
                self.deliver(now, port, frame.bytes());
                self.network.fabric().recycle(frame);
            }
        }
    }

    /// Sends what sources of traffic have for now.
    fn send_traffic(&mut self, now: Timestamp) {
        if self.traffic.is_empty() {
            return;
        }
        self.network.fabric().push_all(now, |fabric, buffer| {
            let waiting = |from, to| fabric.waiting(PortId(from), PortId(to)) as usize;
            self.traffic.poll(now, waiting, buffer).map(PortId)
        });
    }

    /// Sends what states that move have for now.
    fn send_states(&mut self, now: Timestamp) {
        let states = |_: &mut Fabric, buffer: &mut Vec<u8>| self.serving.poll_frame(now, buffer).map(PortId);
        self.network.fabric().push_all(now, states);
    }

    fn deliver(&mut self, now: Timestamp, port: PortId, frame: &[u8]) {
        if self.traffic.handle(now, port.0, frame) || self.serving.handle(now, port.0, frame) {
            return;
        }
        if let Some(datagram) = udp::receive(frame, port) {
            self.receive(now, port, &datagram);
        }
    }

    /// Receives a datagram at a host.
    fn receive(&mut self, now: Timestamp, port: PortId, datagram: &cotorra_flows::Datagram<'_>) {
        let Some(host) = self.network.fabric().host(port).cloned() else { return };
        if datagram.to == CONTROL_PORT {
            let sender = self.port_at(*datagram.from.ip());
            let from = sender.and_then(|sender| self.network.fabric().host(sender).cloned());
            if let Some(from) = from.filter(|_| datagram.from.port() == CONTROL_PORT) {
                let payload = datagram.payload.to_vec();
                self.host.receive(now, &Datagram { from, to: host, payload });
            }
            return;
        }
        if datagram.to == ROBOT_PORT {
            if self.interference.is_silent(&host) {
                return;
            }
            self.interference.note_answer(&host, datagram.from, datagram.payload);
            return self.core.receive(now, &host, datagram.from, datagram.payload);
        }
        if datagram.to == POLICY_PORT {
            let sender = self.port_at(*datagram.from.ip());
            let from = sender.and_then(|sender| self.network.fabric().host(sender).cloned());
            if let Some(from) = from.filter(|_| !self.interference.is_silent(&host)) {
                self.core.receive_chunk(now, &host, &from, datagram.payload);
            }
            return;
        }
        let to = (*datagram.from.ip(), datagram.from.port());
        let held = Held { from: (port, datagram.to), to, payload: Vec::with_capacity(128) };
        if let Some(answer) = self.serving.answer(&host, datagram.payload, held) {
            self.send_answer(now, answer);
        }
    }

    /// Sends an answer now or after its delay.
    fn send_answer(&mut self, now: Timestamp, Answer { held, later }: Answer) {
        match self.port_at(held.to.0) {
            Some(sender) if later.is_zero() => {
                self.send(now, held.from, (sender, held.to.1), &held.payload);
            }
            Some(_) => self.interference.hold(now + later, held),
            None => {}
        }
    }

    fn send(&mut self, now: Timestamp, from: (PortId, u16), to: (PortId, u16), payload: &[u8]) {
        if from.0 == to.0 && [from.1, to.1].contains(&POLICY_PORT) {
            let to = (HostAddress::of(to.0.0).ipv4, to.1);
            return self.looped.push_back(Held { from, to, payload: payload.to_vec() });
        }
        let mut fabric = self.network.fabric();
        let mut buffer = fabric.buffer(0);
        udp::build(&mut buffer, from, to, payload);
        fabric.push(now, from.0, cotorra_fabric::Frame::new(buffer));
    }

    fn port(&self, host: &NodeId) -> Option<PortId> {
        self.network.fabric().port(host)
    }

    fn port_at(&self, address: Ipv4Addr) -> Option<PortId> {
        self.ports.get(&address).copied()
    }
}

impl Lockstep for Simulation {
    fn patience(&self) -> Duration {
        self.host.patience()
    }

    fn next_call(&mut self) -> Option<Call> {
        loop {
            let now = self.network.now();
            if let Some(call) = self.locals.next_call(now, &mut self.host) {
                return Some(call);
            }
            // Plug-ins are started before any event is published.
            if !self.begun {
                return None;
            }
            // The data is available when its event is published.
            self.outputs.extend(std::iter::from_fn(|| self.core.poll_data()).map(Output::Data));
            let event = Arc::new(self.core.poll_event()?);
            if let Event::Decision(Decision {
                instruction: Instruction::AddVnf { vnf }, refused: None, ..
            }) = &event.event
            {
                let message =
                    format!("VNF {} does not run: in virtual time no program of others does", vnf.id);
                self.core.observe(Stamped { at: event.at, event: Event::Notice { message } });
            }
            self.locals.publish(now, &event, &mut self.host);
            self.outputs.push_back(Output::Event(event));
            self.events += 1;
        }
    }

    fn returned(&mut self, returned: Returned) {
        let (plugin, outcome) = self.locals.returned(returned);
        let now = self.network.now();
        let mut forked = Forked { core: &mut self.core, forking: &mut self.forking };
        self.host.returned(now, &plugin, outcome, &mut forked);
        self.locals.end_cut_off(&self.host);
    }

    fn go_on(&mut self) -> bool {
        // Scans follow the events of their step.
        self.outputs.extend(std::iter::from_fn(|| self.core.poll_scan()).map(Output::Scan));
        let goes_on = match self.stretch {
            Stretch::Settle => false,
            Stretch::Step => true,
            Stretch::Events(wanted, until) => {
                let now = self.now();
                let has_come = |at: Option<Timestamp>| at.is_some_and(|at| now >= at);
                // Time goes on even if the alarm is in the past.
                let wakes = has_come(self.alarm) || has_come(self.host.next_wake());
                let is_woken = now > self.stretch_began && wakes;
                let is_over = self.is_finished() || (until.is_none() && self.is_stuck());
                self.events < wanted && !is_over && !is_woken && !has_come(until)
            }
        };
        if goes_on {
            if self.stretch == Stretch::Step {
                self.stretch = Stretch::Settle;
            }
            self.begin_step();
        }
        goes_on
    }
}

#[cfg(test)]
mod tests;
