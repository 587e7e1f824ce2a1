//! A testbed in virtual time: the very same core, fabric, robots and plug-ins, driven by their own deadlines instead of
//! a clock. Nothing sleeps, nothing is random but by the seed, and the same seed gives the same events.

mod engine;
mod interference;
mod network;
mod run;
mod udp;
mod unrecorded;

use std::{
    collections::{HashMap, VecDeque},
    net::{Ipv4Addr, SocketAddrV4},
    sync::Arc,
    time::Duration,
};

use cotorra_fabric::{Balance, Fabric, PortId};
use cotorra_federation::Ledgers;
use cotorra_graph::{
    Direction, Event, HostAddress, Instruction, LinkId, NodeId, PluginId, PluginProgram, Program, Stamped,
    Testbed, Timestamp,
};
use cotorra_localization::trajectory::Errors;
use cotorra_network_control::{InstructionError, vim::Managed};
use cotorra_robot_middleware::{Nonces, SensedData, SensedScan};

use self::interference::{Held, Interference};
pub(crate) use self::{
    engine::{Mood, Serving, VirtualEngine},
    network::VirtualNetwork,
};
pub use self::{run::simulate, unrecorded::simulate_unrecorded};
use crate::{
    core::Core,
    domain::Domains,
    error::RunError,
    plugins::{
        Bundled, PluginError,
        host::{Fault, PluginHost},
        lockstep::{Call, Locals, Lockstep, PATIENCE, Returned},
        programs,
    },
    previous_run::PreviousRun,
    robots::simulated,
    script::Script,
};

/// The port from which robots send; any would do.
const ROBOT_PORT: u16 = 40_000;
/// The port from which their cameras do.
const IMAGE_PORT: u16 = 40_001;

/// A testbed in virtual time, from its beginning.
pub struct Simulation {
    core: Core<VirtualNetwork, VirtualEngine>,
    network: VirtualNetwork,
    serving: Serving,
    interference: Interference,
    host: PluginHost,
    locals: Locals,
    /// What orchestrators share.
    ledgers: Ledgers,
    ports: HashMap<Ipv4Addr, PortId>,
    happened: VecDeque<Happened>,
    /// Events among that.
    events: usize,
    /// When somebody outside wants a step.
    alarm: Option<Timestamp>,
    /// Up to where [`Lockstep::run`] goes.
    stretch: Stretch,
    /// When it began.
    stretch_began: Timestamp,
    /// Whether the next step is not the first.
    begun: bool,
}

/// Something that a simulation tells, in order.
pub(crate) enum Happened {
    Event(Arc<Stamped>),
    Scan(SensedScan),
    Data(SensedData),
}

/// How far to go on without being looked after.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stretch {
    /// No step: only what plug-ins want to do about what happened.
    Settle,
    /// One step.
    Step,
    /// Steps until so many events wait to be polled, the alarm has come, all walks are done, or it is this time.
    Events(usize, Option<Timestamp>),
}

impl Simulation {
    /// A simulation of a testbed at time zero.
    ///
    /// # Errors
    /// [`RunError`] when the graph, a robot or a plug-in cannot be; a plug-in that is a program of its own cannot.
    pub fn new(testbed: Arc<Testbed>, seed: u64) -> Result<Self, RunError> {
        if let Some(program) = programs(&testbed).next() {
            return Err(PluginError::NeedsRun(program.clone()).into());
        }
        Self::without_programs(testbed, seed)
    }

    /// The same, leaving out plug-ins that are programs of their own.
    fn without_programs(testbed: Arc<Testbed>, seed: u64) -> Result<Self, RunError> {
        Self::on(testbed, seed, Ledgers::in_virtual_time(), None)
    }

    /// The same, on ledgers that may know of runs before, and with what one of these noted.
    fn on(
        testbed: Arc<Testbed>,
        seed: u64,
        ledgers: Ledgers,
        earlier: Option<&PreviousRun>,
    ) -> Result<Self, RunError> {
        let (script, _) = Script::load(&testbed)?;
        let mut fabric = Fabric::new(&testbed.graph, seed)?;
        if let Some(probing) = testbed.probes {
            fabric.probe_links(Timestamp::ZERO, probing);
        }
        fabric.measure_flows(&testbed.services);
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
        let mut bundled = Bundled::new(&testbed, seed, ledgers);
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
        for vnf in testbed.services.iter().flat_map(|service| &service.vnfs) {
            if matches!(vnf.program, Program::Command(_)) {
                let message =
                    format!("VNF {} does not run: in virtual time no program of others does", vnf.id);
                core.observe(Stamped { at: Timestamp::ZERO, event: Event::Notice { message } });
            }
        }
        let hosts = testbed.graph.hosts().count();
        Ok(Self {
            core,
            network,
            serving,
            interference: Interference::default(),
            host: PluginHost::new(testbed.plugins.iter().map(|spec| spec.id.clone()), PATIENCE)
                .with_domains(&testbed.graph.domains),
            locals,
            ledgers: bundled.into_ledgers(),
            ports: (0..hosts).map(|i| (HostAddress::of(i).ipv4, PortId(i))).collect(),
            happened: VecDeque::new(),
            events: 0,
            alarm: None,
            stretch: Stretch::Step,
            stretch_began: Timestamp::ZERO,
            begun: false,
        })
    }

    /// The same with another plug-in in process.
    pub(crate) fn with_plugin(
        mut self,
        id: PluginId,
        plugin: Box<dyn cotorra_plugin::Plugin>,
        testbed: &Arc<Testbed>,
    ) -> Self {
        self.host.add(id.clone());
        self.locals.add(id, plugin, testbed, None);
        self
    }

    /// The same with another patience for plug-ins.
    pub(crate) fn with_patience(mut self, patience: Duration) -> Self {
        self.host.set_patience(patience);
        self
    }

    /// Goes on to the next thing that is due, and does it; gives the time. Events are to be polled after each step.
    /// Plug-ins are called on this thread: one that hangs hangs it.
    pub fn step(&mut self) -> Timestamp {
        self.go(Stretch::Step);
        self.run();
        self.now()
    }

    /// Says how far to go next.
    pub(crate) fn go(&mut self, stretch: Stretch) {
        self.stretch = stretch;
        self.stretch_began = self.now();
    }

    /// The time.
    pub(crate) fn now(&self) -> Timestamp {
        self.network.now()
    }

    /// Goes to the next thing that is due, and does it, but for what plug-ins want.
    fn begin_step(&mut self) {
        if self.begun {
            self.network.set_now(self.next_time());
        }
        self.begun = true;
        let now = self.now();
        // In memory nothing can be gone.
        let _ = self.core.advance(now);
        self.carry(now);
        self.locals.wake();
    }

    /// When the next thing is due.
    fn next_time(&self) -> Timestamp {
        let now = self.now();
        let plugins = self.locals.next_deadline();
        let fabric = self.network.fabric().poll(now, &mut |_, _| {});
        let held = self.interference.next_deadline();
        let others = plugins.into_iter().chain(fabric).chain(self.alarm).chain(held);
        let next = others.fold(self.core.next_deadline(), Timestamp::min);
        // A deadline that is not in the future was met by this step; time must not stand still.
        next.max(now + Duration::from_nanos(1))
    }

    /// Lets the next step be at that time at the latest.
    pub(crate) fn set_alarm(&mut self, at: Option<Timestamp>) {
        self.alarm = at;
    }

    /// Who decides about plug-ins.
    pub(crate) fn host(&mut self) -> &mut PluginHost {
        &mut self.host
    }

    /// Does what somebody outside asks for, now. What plug-ins in process want to do about it is still to be done.
    pub(crate) fn instruct(
        &mut self,
        plugin: PluginId,
        instruction: Instruction,
        reason: Option<String>,
    ) -> Result<(), InstructionError> {
        let done = self.host.instruct(self.network.now(), plugin, instruction, reason, &mut self.core);
        // It may have gone by the name of one in process.
        self.locals.end_cut_off(&self.host);
        done
    }

    /// Cuts a program off.
    pub(crate) fn cut_off(&mut self, plugin: &PluginId, fault: &Fault) {
        self.host.cut_off(self.network.now(), plugin, fault, &mut self.core);
    }

    /// Returns the instances of VNFs that run.
    pub(crate) fn serving(&self) -> &Serving {
        &self.serving
    }

    /// Returns every replica of every VNF with its instances, by the VNF's name.
    pub(crate) fn managed(&self) -> impl Iterator<Item = Managed<'_>> {
        self.core.managed()
    }

    /// Returns what mappings reserve of each direction of a link, and what that carries, bit/s.
    pub(crate) fn reserved(&self) -> Vec<(LinkId, Direction, [f64; 2])> {
        let fabric = self.network.fabric();
        let both = |(link, direction, reserved): (&LinkId, _, f64)| {
            let carries = fabric.carries(link, direction).map_or(0.0, |carries| carries.rate_bps);
            (link.clone(), direction, [reserved, carries])
        };
        self.core.reserved().map(both).collect()
    }

    /// Returns what became of all packets that hosts sent.
    pub(crate) fn packets(&self) -> Balance {
        self.network.fabric().balance()
    }

    /// Lets a robot neither send nor hear from now on, or do both again.
    pub(crate) fn set_silent(&mut self, robot: &NodeId, silent: bool) {
        self.interference.set_silent(robot, silent);
    }

    /// Keeps the last answer to each robot from now on, for [`Self::answer_again`].
    pub(crate) fn tap_answers(&mut self) {
        self.interference.tap_answers();
    }

    /// Lets a robot receive its last answer, if there is one, once more, with the byte `forged` changed.
    pub(crate) fn answer_again(&mut self, robot: &NodeId, forged: Option<usize>) {
        let Some((from, mut payload)) = self.interference.last_answer(robot) else { return };
        if let Some(byte) = forged.and_then(|place| place.checked_rem(payload.len())) {
            payload[byte] ^= 0x5a;
        }
        self.core.receive(self.now(), robot, from, &payload);
    }

    /// Reorganises the modelled ledger's last blocks with calls away, so many, if there is a ledger.
    pub(crate) fn reorganise_ledger(&self, depth: usize) {
        if let Some(chain) = self.ledgers.chain() {
            chain.reorganise(self.now(), depth);
        }
    }

    /// What happened, oldest first; scans and large data are left out.
    pub fn poll_event(&mut self) -> Option<Stamped> {
        loop {
            match self.poll()? {
                Happened::Event(event) => return Some(Arc::unwrap_or_clone(event)),
                Happened::Scan(_) | Happened::Data(_) => {}
            }
        }
    }

    /// What happened, oldest first.
    pub(crate) fn poll(&mut self) -> Option<Happened> {
        let happened = self.happened.pop_front()?;
        self.events -= usize::from(matches!(happened, Happened::Event(_)));
        Some(happened)
    }

    /// From now on scans are told, too: after the events of each step.
    pub(crate) fn tap_scans(&mut self) {
        self.core.tap_scans();
    }

    /// How far off localization was so far, of each robot that a VNF localizes.
    pub fn localization_errors(&self) -> impl Iterator<Item = (&NodeId, &Errors)> {
        self.core.localization_errors()
    }

    /// What is to be told of services' flows at the end.
    pub(crate) fn flow_remarks(&self) -> Vec<Stamped> {
        self.core.flow_remarks(self.now())
    }

    /// Whether every walk is done; never where there is none.
    pub fn is_finished(&self) -> bool {
        self.core.is_finished()
    }

    /// Lets packets go as far as they get at this time.
    fn carry(&mut self, now: Timestamp) {
        while let Some(datagram) = self.core.poll_transmit(now) {
            let (Some(from), Some(to)) = (self.port(&datagram.robot), self.port_at(*datagram.to.ip())) else {
                continue;
            };
            if self.interference.is_silent(&datagram.robot) {
                continue;
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
        while let Some(Held { from, to, payload }) = self.interference.release(now) {
            if let Some(receiver) = self.port_at(to.0) {
                self.send(now, from, (receiver, to.1), &payload);
            }
        }
        loop {
            let mut delivered = Vec::new();
            self.network.fabric().poll(now, &mut |port, frame| delivered.push((port, frame)));
            while let Some(event) = self.network.next_event() {
                self.core.observe(event);
            }
            if delivered.is_empty() {
                return;
            }
            for (port, frame) in delivered {
                self.deliver(now, port, frame.bytes());
                self.network.fabric().recycle(frame);
            }
        }
    }

    fn deliver(&mut self, now: Timestamp, port: PortId, frame: &[u8]) {
        let Some(datagram) = udp::parse(frame) else { return };
        let Some(host) = self.network.fabric().host(port).cloned() else { return };
        if datagram.to == ROBOT_PORT {
            if self.interference.is_silent(&host) {
                return;
            }
            let from = SocketAddrV4::new(datagram.sender, datagram.from);
            self.interference.note_answer(&host, from, datagram.payload);
            return self.core.receive(now, &host, from, datagram.payload);
        }
        let mut answer = Vec::with_capacity(128);
        let answered = self.serving.answer(&host, datagram.to, datagram.payload, &mut answer);
        let from = (port, datagram.to);
        match (answered, self.port_at(datagram.sender)) {
            (Some(Duration::ZERO), Some(sender)) => {
                self.send(now, from, (sender, datagram.from), &answer);
            }
            (Some(later), Some(_)) => {
                let held = Held { from, to: (datagram.sender, datagram.from), payload: answer };
                self.interference.hold(now + later, held);
            }
            _ => {}
        }
    }

    fn send(&mut self, now: Timestamp, from: (PortId, u16), to: (PortId, u16), payload: &[u8]) {
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
            if let Some(call) = self.locals.next_call(self.network.now()) {
                return Some(call);
            }
            // Plug-ins are started before anything is told.
            if !self.begun {
                return None;
            }
            // It is there when its event is told.
            self.happened.extend(std::iter::from_fn(|| self.core.poll_data()).map(Happened::Data));
            let event = Arc::new(self.core.poll_event()?);
            self.locals.publish(&event);
            self.happened.push_back(Happened::Event(event));
            self.events += 1;
        }
    }

    fn returned(&mut self, returned: Returned) {
        let (plugin, outcome) = self.locals.returned(returned);
        self.host.returned(self.network.now(), &plugin, outcome, &mut self.core);
        self.locals.end_cut_off(&self.host);
    }

    fn go_on(&mut self) -> bool {
        // They come after the events of their step.
        self.happened.extend(std::iter::from_fn(|| self.core.poll_scan()).map(Happened::Scan));
        let goes_on = match self.stretch {
            Stretch::Settle => false,
            Stretch::Step => true,
            Stretch::Events(wanted, until) => {
                let now = self.now();
                let has_come = |at: Option<Timestamp>| at.is_some_and(|at| now >= at);
                // Time goes on even where the alarm is set to the past.
                let is_woken = now > self.stretch_began && has_come(self.alarm);
                self.events < wanted && !self.is_finished() && !is_woken && !has_come(until)
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
mod camera_tests;
#[cfg(test)]
mod federation_tests;
#[cfg(test)]
mod large_data_tests;
#[cfg(test)]
mod replica_tests;
#[cfg(test)]
mod sensor_tests;
#[cfg(test)]
mod tests;
