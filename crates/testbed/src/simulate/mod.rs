//! A testbed in virtual time: the very same core, fabric, robots and plug-ins, driven by their own deadlines instead of
//! a clock. Nothing sleeps, nothing is random but by the seed, and the same seed gives the same events.

mod udp;

use std::{
    cell::{Cell, RefCell},
    collections::{BTreeMap, VecDeque},
    panic::{AssertUnwindSafe, catch_unwind},
    rc::Rc,
    sync::Arc,
    time::Duration,
};

use cotorra_brain::NavigationVnf;
use cotorra_fabric::{Fabric, PortId};
use cotorra_graph::{
    Event, NodeId, PluginId, PluginProgram, Program, Stamped, Testbed, Timestamp, Vnf, VnfId,
};
use cotorra_network_control::{
    Network, NetworkGone,
    vim::{Engine, EngineEvent, InstanceId, Outcome},
};
use cotorra_plugin::{Actions, Plugin, wire::NAVIGATION_PORT};

use cotorra_measurements::{History, RunInfo};

use crate::{
    core::Core,
    core_loop::End,
    plugins::{PluginError, bundled, panic_text},
    report::{Losses, Report, RunFolder},
    run::{Finished, Options, RunError},
};

/// The port from which robots send; any would do.
const ROBOT_PORT: u16 = 40_000;

/// After so many events the history is waited for, which virtual time would leave behind.
const HISTORY_PACE: usize = 10_000;

/// Runs a testbed in virtual time to the end of its walks, or up to `options.until`, and leaves what a run leaves; gives
/// what it came to. `go_on` is asked now and then, with the time, whether to. The API is not served.
///
/// The same testbed, seed and version give the same bytes in every file but the log.
///
/// # Errors
/// [`RunError`]. A testbed without walks needs an `until`: virtual time has no other end.
pub fn simulate(
    testbed: Testbed,
    text: &str,
    options: &Options,
    mut go_on: impl FnMut(Timestamp) -> bool,
) -> Result<Finished, RunError> {
    let testbed = Arc::new(testbed);
    let seed = options.seed.unwrap_or(testbed.seed);
    let until = options.until.map(|until| Timestamp::ZERO + until);
    if until.is_none() && testbed.walks.is_empty() {
        return Err(RunError::Endless);
    }
    let mut simulation = Simulation::new(Arc::clone(&testbed), seed)?;
    let folder = RunFolder::create(&options.folder, &testbed.name, text)?;
    let history = History::open(folder.history())?;
    // The calendar is not part of virtual time.
    let info = RunInfo { name: testbed.name.clone(), seed, started_at_unix_ns: 0, testbed: text.to_owned() };
    let run = history.begin_run(&info)?;
    let recorder = history.recorder(run)?;
    let mut report = Report::new(&testbed, seed);
    let mut unwritten = 0;
    let (now, end) = loop {
        let now = simulation.step();
        while let Some(event) = simulation.poll_event() {
            report.absorb(&event);
            recorder.record(event);
            unwritten += 1;
        }
        if unwritten >= HISTORY_PACE {
            unwritten = 0;
            recorder.flush()?;
            if !go_on(now) {
                break (now, End::Stopped);
            }
        }
        if simulation.is_finished() {
            break (now, End::Walked);
        }
        if until.is_some_and(|until| now >= until) {
            break (now, End::Until);
        }
    };
    recorder.flush()?;
    let losses = Losses { frames_dropped: 0, history_dropped: recorder.stats().dropped };
    let summary = report.summary(now, end.as_str(), losses);
    folder.write_report(&report, &summary)?;
    history.end_run(run, now)?;
    Ok(Finished { summary, report, folder: folder.path().to_owned() })
}

/// A testbed in virtual time, from its beginning.
pub struct Simulation {
    core: Core<VirtualNetwork, VirtualEngine>,
    network: VirtualNetwork,
    navigation: Navigation,
    plugins: Vec<Hosted>,
    graph: Arc<Testbed>,
    events: VecDeque<Stamped>,
}

struct Hosted {
    id: PluginId,
    plugin: Box<dyn Plugin>,
    cut: bool,
}

impl Simulation {
    /// A simulation of a testbed at time zero.
    ///
    /// # Errors
    /// [`RunError`] when the graph, a robot or a plug-in cannot be.
    pub fn new(testbed: Arc<Testbed>, seed: u64) -> Result<Self, RunError> {
        let fabric = Rc::new(RefCell::new(Fabric::new(&testbed.graph, seed)?));
        let network = VirtualNetwork { fabric, now: Rc::new(Cell::new(Timestamp::ZERO)) };
        let navigation = Navigation::default();
        let engine = VirtualEngine::new(&testbed, navigation.clone());
        let mut core = Core::new(Arc::clone(&testbed), seed, network.clone(), engine)
            .map_err(|e| RunError::Robot(e.to_string()))?;
        let plugins = testbed.plugins.iter().map(|spec| match &spec.program {
            PluginProgram::Bundled(name) => {
                Ok(Hosted { id: spec.id.clone(), plugin: bundled(spec, name, seed)?, cut: false })
            }
            PluginProgram::Command(_) => Err(PluginError::NotInVirtualTime(spec.id.clone())),
        });
        let plugins = plugins.collect::<Result<_, _>>()?;
        core.start(Timestamp::ZERO);
        let mut simulation =
            Self { core, network, navigation, plugins, graph: testbed, events: VecDeque::new() };
        for place in 0..simulation.plugins.len() {
            let testbed = Arc::clone(&simulation.graph);
            simulation
                .call(Timestamp::ZERO, place, |plugin, now, actions| plugin.start(now, &testbed, actions));
        }
        Ok(simulation)
    }

    /// Goes on to the next thing that is due, and does it; gives the time. Events are to be polled after each step.
    pub fn step(&mut self) -> Timestamp {
        let now = self.network.now.get();
        // In memory nothing can be gone.
        let _ = self.core.advance(now);
        self.carry(now);
        self.tell(now);
        let plugins = self.plugins.iter().filter(|p| !p.cut).filter_map(|p| p.plugin.next_deadline());
        let fabric = self.network.fabric.borrow_mut().poll(now, &mut |_, _| {});
        let next = plugins.chain(fabric).fold(self.core.next_deadline(), Timestamp::min);
        // A deadline that is not in the future was met by this step; time must not stand still.
        self.network.now.set(next.max(now + Duration::from_nanos(1)));
        now
    }

    /// What happened, oldest first.
    pub fn poll_event(&mut self) -> Option<Stamped> {
        self.events.pop_front()
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
            self.send(now, (from, ROBOT_PORT), (to, NAVIGATION_PORT), &datagram.bytes);
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
        let answered = datagram.to == NAVIGATION_PORT
            && self.navigation.0.borrow_mut().get_mut(&host).is_some_and(|instances| {
                instances.iter_mut().any(|(_, vnf)| vnf.answer(datagram.payload, &mut answer).is_ok())
            });
        if let (true, Some(sender)) = (answered, self.port_at(datagram.sender)) {
            self.send(now, (port, NAVIGATION_PORT), (sender, datagram.from), &answer);
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

    fn port_at(&self, address: std::net::Ipv4Addr) -> Option<PortId> {
        let hosts = self.graph.graph.hosts().count();
        (0..hosts).find(|i| cotorra_graph::HostAddress::of(*i).ipv4 == address).map(PortId)
    }

    /// Tells plug-ins what happened, and does what they ask for, until nothing new happens.
    fn tell(&mut self, now: Timestamp) {
        for place in 0..self.plugins.len() {
            if self.plugins[place].plugin.next_deadline().is_some_and(|deadline| deadline <= now) {
                self.call(now, place, |plugin, now, actions| plugin.expire(now, actions));
            }
        }
        while let Some(event) = self.core.poll_event() {
            for place in 0..self.plugins.len() {
                self.call(now, place, |plugin, now, actions| plugin.handle(now, &event.event, actions));
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

/// The emulated network in virtual time.
#[derive(Clone)]
struct VirtualNetwork {
    fabric: Rc<RefCell<Fabric>>,
    now: Rc<Cell<Timestamp>>,
}

impl VirtualNetwork {
    fn next_event(&self) -> Option<Stamped> {
        self.fabric.borrow_mut().next_event()
    }
}

impl Network for VirtualNetwork {
    fn with<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Fabric, Timestamp) -> R + Send + 'static,
    ) -> Result<R, NetworkGone> {
        Ok(action(&mut self.fabric.borrow_mut(), self.now.get()))
    }
}

/// The navigation VNFs that serve on each node.
#[derive(Clone, Default)]
struct Navigation(Rc<RefCell<Serving>>);

/// By node, in the order in which they were started.
type Serving = BTreeMap<NodeId, Vec<(InstanceId, NavigationVnf)>>;

/// Runs the navigation VNF as a part of the simulation; an instance is ready at once.
struct VirtualEngine {
    /// What an instance begins as, by VNF.
    planned: BTreeMap<VnfId, NavigationVnf>,
    serving: Navigation,
    running: BTreeMap<InstanceId, NodeId>,
    happened: VecDeque<EngineEvent>,
}

impl VirtualEngine {
    /// Plans all walks.
    fn new(testbed: &Testbed, serving: Navigation) -> Self {
        let by_robot = NavigationVnf::of_all(testbed);
        let planned = testbed.services.iter().flat_map(|service| {
            let planned = by_robot.get(&service.robot);
            service.vnfs.iter().filter_map(move |vnf| Some((vnf.id.clone(), planned?.clone())))
        });
        Self { planned: planned.collect(), serving, running: BTreeMap::new(), happened: VecDeque::new() }
    }
}

impl Engine for VirtualEngine {
    fn start(&mut self, instance: InstanceId, vnf: &Vnf, node: &NodeId) -> Result<(), String> {
        if vnf.program != Program::Navigation {
            return Err("only the bundled navigation VNF runs in virtual time".to_owned());
        }
        let navigation = self.planned.get(&vnf.id).ok_or("its robot has no walk")?.clone();
        self.serving.0.borrow_mut().entry(node.clone()).or_default().push((instance, navigation));
        self.running.insert(instance, node.clone());
        self.happened.push_back(EngineEvent { instance, outcome: Outcome::Ready });
        Ok(())
    }

    fn stop(&mut self, instance: InstanceId) {
        if let Some(node) = self.running.remove(&instance)
            && let Some(instances) = self.serving.0.borrow_mut().get_mut(&node)
        {
            instances.retain(|(id, _)| *id != instance);
        }
    }

    fn poll(&mut self) -> Option<EngineEvent> {
        self.happened.pop_front()
    }

    fn shut_down(&mut self) {
        self.running.clear();
        self.serving.0.borrow_mut().clear();
    }
}

#[cfg(test)]
mod tests;
