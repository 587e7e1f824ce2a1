//! A testbed in virtual time: the very same core, fabric, robots and plug-ins, driven by their own deadlines instead of
//! a clock. Nothing sleeps, nothing is random but by the seed, and the same seed gives the same events.

mod apart;
mod engine;
mod network;
mod run;
mod udp;

use std::{
    borrow::Cow,
    collections::{HashMap, VecDeque},
    net::Ipv4Addr,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
    time::Duration,
};

use cotorra_fabric::{Fabric, PortId};
use cotorra_federation::Ledgers;
use cotorra_graph::{
    Event, HostAddress, Instruction, NodeId, PluginId, PluginProgram, Stamped, Testbed, Timestamp,
};
use cotorra_localization::trajectory::Errors;
use cotorra_network_control::Refused;
use cotorra_plugin::{Actions, Plugin};
use cotorra_robot_middleware::SensedScan;

pub use self::run::simulate;
use self::{
    engine::{Serving, VirtualEngine},
    network::VirtualNetwork,
};
use crate::{
    core::Core,
    domain::{DomainView, Domains},
    earlier::Earlier,
    plugins::{Bundled, PluginError, panic_text, programs},
    robots::simulated,
    run::{RunError, probe_links},
    script::Script,
};

/// The port from which robots send; any would do.
const ROBOT_PORT: u16 = 40_000;

/// A testbed in virtual time, from its beginning.
pub struct Simulation {
    core: Core<VirtualNetwork, VirtualEngine>,
    network: VirtualNetwork,
    serving: Serving,
    plugins: Vec<Hosted>,
    /// What orchestrators share.
    _ledgers: Ledgers,
    graph: Arc<Testbed>,
    ports: HashMap<Ipv4Addr, PortId>,
    events: VecDeque<Stamped>,
    /// When somebody outside wants a step.
    alarm: Option<Timestamp>,
    /// Whether the next step is not the first.
    begun: bool,
}

struct Hosted {
    id: PluginId,
    plugin: Box<dyn Plugin>,
    cut: bool,
    /// What it sees, if that is one domain.
    view: Option<Arc<DomainView>>,
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
        earlier: Option<&Earlier>,
    ) -> Result<Self, RunError> {
        let (script, _) = Script::load(&testbed)?;
        let mut fabric = Fabric::new(&testbed.graph, seed)?;
        probe_links(&mut fabric, &testbed);
        let network = VirtualNetwork::new(fabric);
        let serving = Serving::default();
        let engine = VirtualEngine::new(&testbed, seed, serving.clone());
        let mut core = Core::new(Arc::clone(&testbed), seed, network.clone(), engine, script, simulated)?;
        let domains = Domains::new(&testbed);
        let mut bundled = Bundled::new(&testbed, seed, ledgers);
        let plugins = testbed.plugins.iter().filter_map(|spec| match &spec.program {
            PluginProgram::Bundled(name) => Some(bundled.make(spec, name).map(|plugin| Hosted {
                id: spec.id.clone(),
                plugin,
                cut: false,
                view: domains.of_plugin(&spec.id).cloned(),
            })),
            PluginProgram::Command(_) => None,
        });
        let mut plugins = plugins.collect::<Result<Vec<_>, _>>()?;
        if let Some(earlier) = earlier {
            plugins.iter_mut().for_each(|hosted| hosted.plugin.resume(earlier.noted_by(&hosted.id)));
        }
        core.start(Timestamp::ZERO);
        let ledgers = bundled.into_ledgers();
        let hosts = testbed.graph.hosts().count();
        let mut simulation = Self {
            core,
            network,
            serving,
            plugins,
            _ledgers: ledgers,
            ports: (0..hosts).map(|i| (HostAddress::of(i).ipv4, PortId(i))).collect(),
            graph: testbed,
            events: VecDeque::new(),
            alarm: None,
            begun: false,
        };
        for place in 0..simulation.plugins.len() {
            let (testbed, view) = (Arc::clone(&simulation.graph), simulation.plugins[place].view.clone());
            let testbed = view.as_ref().map_or(&*testbed, |view| view.testbed());
            simulation
                .call(Timestamp::ZERO, place, |plugin, now, actions| plugin.start(now, testbed, actions));
        }
        Ok(simulation)
    }

    /// Goes on to the next thing that is due, and does it; gives the time. Events are to be polled after each step.
    pub fn step(&mut self) -> Timestamp {
        if self.begun {
            self.network.now.set(self.next_time());
        }
        self.begun = true;
        let now = self.network.now.get();
        // In memory nothing can be gone.
        let _ = self.core.advance(now);
        self.carry(now);
        self.tell(now);
        now
    }

    /// When the next thing is due.
    fn next_time(&self) -> Timestamp {
        let now = self.network.now.get();
        let plugins = self.plugins.iter().filter(|p| !p.cut).filter_map(|p| p.plugin.next_deadline());
        let fabric = self.network.fabric.borrow_mut().poll(now, &mut |_, _| {});
        let next = plugins.chain(fabric).chain(self.alarm).fold(self.core.next_deadline(), Timestamp::min);
        // A deadline that is not in the future was met by this step; time must not stand still.
        next.max(now + Duration::from_nanos(1))
    }

    /// Lets the next step be at that time at the latest.
    fn set_alarm(&mut self, at: Option<Timestamp>) {
        self.alarm = at;
    }

    /// Does what somebody outside asks for, now.
    fn instruct(
        &mut self,
        plugin: PluginId,
        instruction: Instruction,
        reason: Option<String>,
    ) -> Result<(), Refused> {
        let now = self.network.now.get();
        let done = self.core.instruct(now, plugin, instruction, reason);
        self.tell_events(now);
        done
    }

    /// Tells that a plug-in outside was cut off; the robots that it moved stop.
    fn cut_off(&mut self, plugin: PluginId, reason: String, robots: &[NodeId]) {
        let now = self.network.now.get();
        robots.iter().for_each(|robot| self.core.stop_robot(now, robot));
        self.events.push_back(Stamped { at: now, event: Event::PluginFault { plugin, reason } });
        self.tell_events(now);
    }

    /// What happened, oldest first.
    pub fn poll_event(&mut self) -> Option<Stamped> {
        self.events.pop_front()
    }

    /// From now on scans are to be polled after each step, like events.
    fn tap_scans(&mut self) {
        self.core.tap_scans();
    }

    /// A scan that was completed, oldest first.
    fn poll_scan(&mut self) -> Option<SensedScan> {
        self.core.poll_scan()
    }

    /// How far off localization was so far, of each robot that a VNF localizes.
    pub fn localization_errors(&self) -> impl Iterator<Item = (&NodeId, &Errors)> {
        self.core.localization_errors()
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
            self.send(now, (from, ROBOT_PORT), (to, datagram.to.port()), &datagram.bytes);
        }
        loop {
            let mut delivered = Vec::new();
            self.network.fabric.borrow_mut().poll(now, &mut |port, frame| delivered.push((port, frame)));
            while let Some(event) = self.network.next_event() {
                self.core.observe(event);
            }
            if delivered.is_empty() {
                return;
            }
            for (port, frame) in delivered {
                self.deliver(now, port, frame.bytes());
                self.network.fabric.borrow_mut().recycle(frame);
            }
        }
    }

    fn deliver(&mut self, now: Timestamp, port: PortId, frame: &[u8]) {
        let Some(datagram) = udp::parse(frame) else { return };
        let Some(host) = self.network.fabric.borrow().host(port).cloned() else { return };
        if datagram.to == ROBOT_PORT {
            return self.core.receive(now, &host, datagram.payload);
        }
        let mut answer = Vec::with_capacity(128);
        let answered = self.serving.answer(&host, datagram.to, datagram.payload, &mut answer);
        if let (true, Some(sender)) = (answered, self.port_at(datagram.sender)) {
            self.send(now, (port, datagram.to), (sender, datagram.from), &answer);
        }
    }

    fn send(&mut self, now: Timestamp, from: (PortId, u16), to: (PortId, u16), payload: &[u8]) {
        let mut fabric = self.network.fabric.borrow_mut();
        let mut buffer = fabric.buffer(0);
        udp::build(&mut buffer, from, to, payload);
        fabric.push(now, from.0, cotorra_fabric::Frame::new(buffer));
    }

    fn port(&self, host: &NodeId) -> Option<PortId> {
        self.network.fabric.borrow().port(host)
    }

    fn port_at(&self, address: Ipv4Addr) -> Option<PortId> {
        self.ports.get(&address).copied()
    }

    /// Tells plug-ins what happened, and does what they ask for, until nothing new happens.
    fn tell(&mut self, now: Timestamp) {
        for place in 0..self.plugins.len() {
            if self.plugins[place].plugin.next_deadline().is_some_and(|deadline| deadline <= now) {
                self.call(now, place, |plugin, now, actions| plugin.expire(now, actions));
            }
        }
        self.tell_events(now);
    }

    fn tell_events(&mut self, now: Timestamp) {
        while let Some(event) = self.core.poll_event() {
            for place in 0..self.plugins.len() {
                let view = self.plugins[place].view.clone();
                let seen = view.as_ref().map_or(Some(Cow::Borrowed(&event)), |view| view.event(&event));
                let Some(seen) = seen else { continue };
                self.call(now, place, |plugin, now, actions| plugin.handle(now, &seen.event, actions));
            }
            self.events.push_back(event);
        }
    }

    fn call(
        &mut self,
        now: Timestamp,
        place: usize,
        call: impl FnOnce(&mut dyn Plugin, Timestamp, &mut Actions),
    ) {
        let hosted = &mut self.plugins[place];
        if hosted.cut {
            return;
        }
        let mut actions = Actions::default();
        let returned = catch_unwind(AssertUnwindSafe(|| call(&mut *hosted.plugin, now, &mut actions)));
        let id = hosted.id.clone();
        if let Err(panic) = returned {
            hosted.cut = true;
            let reason = format!("panicked: {}", panic_text(&*panic));
            self.events.push_back(Stamped { at: now, event: Event::PluginFault { plugin: id, reason } });
            return;
        }
        for (instruction, reason) in actions.drain() {
            // A refusal is told with the decision.
            let _ = self.core.instruct(now, id.clone(), instruction, reason);
        }
    }
}

#[cfg(test)]
mod federation_tests;
#[cfg(test)]
mod tests;
