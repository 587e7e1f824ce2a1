//! The network between both ends, and what their worlds share.

use std::time::Duration;

use cotorra_agent_protocol::{
    Action, Agent, Controller, ControllerEvent, LEASE, Report, Run, Transmit, Wanted,
};
use cotorra_graph::{AgentId, Timestamp};
use proptest::prelude::*;

const STEP: Duration = Duration::from_millis(10);

/// A message under way.
#[derive(Clone)]
enum Message {
    ToAgent(Transmit),
    ToCore(Report),
}

/// A network that loses, doubles, delays and overtakes messages.
pub struct Carrier {
    under_way: Vec<(Timestamp, Message)>,
    pub is_cut: bool,
    /// Draws a fault: lost if it is 0, doubled if it is 1, and delayed by so many steps.
    faults: Box<dyn FnMut() -> u8>,
}

impl Carrier {
    pub fn new(faults: impl FnMut() -> u8 + 'static) -> Self {
        Self { under_way: Vec::new(), is_cut: false, faults: Box::new(faults) }
    }

    /// Creates a network with these faults, again and again.
    pub fn with(faults: Vec<u8>) -> Self {
        let mut place = 0;
        Self::new(move || {
            place += 1;
            faults[place % faults.len()] % 16
        })
    }

    /// Creates a network that delays messages a little.
    pub fn sound() -> Self {
        Self::new(|| 2)
    }

    fn send(&mut self, now: Timestamp, message: Message) {
        let fault = (self.faults)();
        if self.is_cut || fault == 0 {
            return;
        }
        if fault == 1 {
            self.under_way.push((now + STEP * 9, message.clone()));
        }
        self.under_way.push((now + STEP * u32::from(fault % 8), message));
    }

    /// Returns the messages that have arrived by now, as they were read.
    fn arrived(&mut self, now: Timestamp) -> Vec<Message> {
        let (due, later): (Vec<_>, Vec<_>) = self.under_way.drain(..).partition(|(at, _)| *at <= now);
        self.under_way = later;
        let read = |(_, message)| match message {
            Message::ToAgent(Transmit::Wanted(agent, wanted)) => {
                let wanted = Wanted::decode(&wanted.encode()).unwrap();
                Message::ToAgent(Transmit::Wanted(agent, wanted.into()))
            }
            Message::ToCore(report) => Message::ToCore(Report::decode(&report.encode()).unwrap()),
            beat => beat,
        };
        due.into_iter().map(read).collect()
    }

    /// Cuts the network, and loses what is under way.
    pub fn cut(&mut self) {
        self.is_cut = true;
        self.under_way.clear();
    }

    /// Ends all faults.
    pub fn heal(&mut self) {
        self.is_cut = false;
        self.faults = Box::new(|| 2);
    }
}

/// A wanted state in which nothing is wanted.
pub fn nothing() -> Wanted {
    Wanted {
        run: Run(1),
        generation: 1,
        lease_ms: 2000,
        files: Vec::new(),
        instances: Default::default(),
        robot: None,
        links: Default::default(),
        wifi: Default::default(),
    }
}

/// The machine that an agent controls, and the core's knowledge of it.
pub trait Machine: Default {
    /// The agent's name.
    const AGENT: &str;

    /// Forgets the last run, which was killed.
    fn restart_core(&mut self);

    /// Does what a process of the agent does as it starts.
    fn restart_agent(&mut self);

    /// The core sends a wanted state.
    fn sent(&mut self, _: &Wanted) {}

    /// The core learns of an event.
    fn learn(&mut self, run: Run, event: ControllerEvent);

    /// Acts before the agent is polled.
    fn before(&mut self, _now: Timestamp, _: &mut Agent) {}

    /// Does what the agent wants.
    fn act(&mut self, now: Timestamp, agent: &mut Agent, action: Action);

    /// Examines a report when it is sent.
    fn examine(&self, _: &Report) {}

    /// Acts after the agent was polled, which saved the wanted state of a run. The newest run was heard of so long ago.
    fn after(&mut self, now: Timestamp, agent: &mut Agent, run: Run, silence: Duration);
}

/// A core, an agent on its machine, and the network between them.
pub struct World<M> {
    pub now: Timestamp,
    runs: u64,
    pub controller: Controller,
    pub network: Carrier,
    /// The wanted state on the machine's disk.
    pub saved: Option<Wanted>,
    pub boots: u64,
    /// The agent's process if it lives.
    pub agent: Option<Agent>,
    /// When a message of the newest run arrived last.
    heard: Timestamp,
    pub machine: M,
}

impl<M: Machine> World<M> {
    pub fn new(network: Carrier) -> Self {
        let mut world = Self {
            now: Timestamp::ZERO,
            runs: 0,
            controller: Controller::new(Run(0), LEASE, Vec::new(), []),
            network,
            saved: None,
            boots: 0,
            agent: None,
            heard: Timestamp::ZERO,
            machine: M::default(),
        };
        world.start_core();
        world.start_agent();
        world
    }

    pub fn name() -> AgentId {
        AgentId::new(M::AGENT).unwrap()
    }

    /// Kills the core if it lives, and starts the next run.
    pub fn start_core(&mut self) {
        self.runs += 1;
        self.controller = Controller::new(Run(self.runs), LEASE, Vec::new(), [Self::name()]);
        self.machine.restart_core();
    }

    /// Kills the agent if it lives, and starts it again.
    pub fn start_agent(&mut self) {
        self.boots += 1;
        self.machine.restart_agent();
        self.agent = Some(Agent::new(self.now, self.boots, self.saved.clone()));
    }

    /// Returns the living agent.
    pub fn agent(&mut self) -> &mut Agent {
        self.agent.as_mut().unwrap()
    }

    fn step(&mut self) {
        self.now = self.now + STEP;
        let now = self.now;
        for message in self.network.arrived(now) {
            match message {
                Message::ToAgent(transmit) => {
                    let Some(agent) = &mut self.agent else { continue };
                    let run = tell(agent, now, transmit);
                    if agent.run() == Some(run) {
                        self.heard = now;
                    }
                }
                Message::ToCore(report) => self.controller.receive(now, &Self::name(), report),
            }
        }
        self.controller.advance(now);
        while let Some(event) = self.controller.poll_event() {
            self.machine.learn(Run(self.runs), event);
        }
        while let Some(transmit) = self.controller.poll_transmit(now) {
            if let Transmit::Wanted(_, wanted) = &transmit {
                self.machine.sent(wanted);
            }
            self.network.send(now, Message::ToAgent(transmit));
        }
        self.run_agent();
    }

    fn run_agent(&mut self) {
        let (now, silence) = (self.now, self.now.since(self.heard));
        let Some(agent) = &mut self.agent else { return };
        agent.advance(now);
        self.machine.before(now, agent);
        while let Some(action) = agent.poll(now) {
            match action {
                Action::Save(wanted) => self.saved = Some(*wanted),
                Action::Report(report) => {
                    self.machine.examine(&report);
                    self.network.send(now, Message::ToCore(report));
                }
                action => self.machine.act(now, agent, action),
            }
        }
        let run = self.saved.as_ref().map_or(Run(0), |saved| saved.run);
        self.machine.after(now, agent, run, silence);
    }

    pub fn steps(&mut self, count: u32) {
        (0..count).for_each(|_| self.step());
    }

    pub fn pass(&mut self, time: Duration) {
        self.steps(time.as_millis() as u32 / STEP.as_millis() as u32);
    }

    /// Steps until a lease and what is under way have passed, several times over.
    pub fn settle(&mut self) {
        self.pass(LEASE * 4);
    }

    pub fn suffer(&mut self, fault: Fault) {
        match fault {
            Fault::StartCore => self.start_core(),
            Fault::KillAgent => self.agent = None,
            Fault::StartAgent => self.start_agent(),
            Fault::Cut => self.network.is_cut = true,
            Fault::Heal => self.network.is_cut = false,
            Fault::Wait(steps) => self.steps(steps.into()),
        }
    }

    /// Ends all faults. The core and the agent agree then.
    pub fn recover(&mut self) {
        if self.agent.is_none() {
            self.start_agent();
        }
        self.network.heal();
        self.settle();
        assert!(self.controller.is_settled());
    }
}

/// Events of each world.
#[derive(Debug, Clone)]
pub enum Fault {
    StartCore,
    KillAgent,
    StartAgent,
    Cut,
    Heal,
    Wait(u8),
}

pub fn fault() -> impl Strategy<Value = Fault> {
    prop_oneof![
        1 => Just(Fault::StartCore),
        1 => Just(Fault::KillAgent),
        2 => Just(Fault::StartAgent),
        1 => Just(Fault::Cut),
        1 => Just(Fault::Heal),
        6 => any::<u8>().prop_map(Fault::Wait),
    ]
}

/// Gives a message to an agent. Returns the run that sent it.
fn tell(agent: &mut Agent, now: Timestamp, transmit: Transmit) -> Run {
    match transmit {
        Transmit::Wanted(_, wanted) => {
            let run = wanted.run;
            agent.want(now, *wanted);
            run
        }
        Transmit::Beat(_, beat) => {
            agent.beat(now, beat);
            beat.run
        }
    }
}
