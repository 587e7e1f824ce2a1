//! Plug-ins that are programs of their own, in virtual time: they are served the same API as in real time, and time
//! stands still while they answer. One after the other, in the order of the testbed file: what they do so depends on
//! what happened alone, not on how fast they are. This is the shell that waits for them on the wall clock.

use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddr},
    path::Path,
    sync::{Arc, mpsc},
    time::Duration,
};

use cotorra_graph::{Instruction, PluginId, Stamped, Testbed, Timestamp};
use cotorra_measurements::{History, PacedRecorder, RunId};
use cotorra_network_control::Refused;
use tokio::sync::broadcast;

use super::Simulation;
use crate::{
    api::{self, Follower, Listener, Lockstep, Server, Told},
    core_loop::Message,
    live::Live,
    plugins::{PluginHost, Refusal, programs},
    run::{Options, RunError},
};

/// How often it is looked whether a program that time waits for still runs.
const LOOK: Duration = Duration::from_millis(20);
/// Events that wait for a reader that time does not wait for; one that is further behind misses the oldest.
const STREAM: usize = 4096;

/// The programs of a run.
pub(super) struct Apart {
    /// Before the host: streams end first, so that a program can end by itself.
    _server: Server,
    host: PluginHost,
    programs: Vec<Program>,
    inbox: mpsc::Receiver<Message>,
    live: Live,
    stream: broadcast::Sender<Arc<Stamped>>,
    marks: u64,
    patience: Duration,
}

/// One program.
struct Program {
    id: PluginId,
    streams: Vec<Stream>,
    /// Cut off: it takes no part any more.
    cut: bool,
}

/// A stream that a program follows.
struct Stream {
    follower: Follower,
    untold: Vec<Arc<Stamped>>,
    /// The mark that it was told last, until it is done with that.
    owes: Option<u64>,
    wake_at: Option<Timestamp>,
    /// Told now, events or not: it is new, or its time to be woken has come.
    due: bool,
}

impl Program {
    /// Whether time cannot go on without it: it is not there yet, has not heard everything, or is not done with it.
    fn is_waited_for(&self) -> bool {
        let waits = |s: &Stream| s.due || s.owes.is_some() || !s.untold.is_empty();
        !self.cut && (self.streams.is_empty() || self.streams.iter().any(waits))
    }

    /// Why it is not waited for any longer.
    fn complaint(&self, patience: Duration) -> String {
        let within = patience.as_secs_f64();
        match self.streams.iter().find_map(|stream| stream.owes) {
            Some(mark) => format!(
                "was not done with mark {mark} within {within} s: virtual time stands still until \
                 `POST /api/v1/marks/{mark}` says that it is"
            ),
            None => format!("followed no `/api/v1/events` within {within} s, as its own `X-Cotorra-Plugin`"),
        }
    }

    /// Tells each stream that is done with what it was told the rest, and that this is all up to now.
    fn tell(&mut self, now: Timestamp, marks: &mut u64) {
        self.streams.retain_mut(|stream| {
            if stream.owes.is_some() || (stream.untold.is_empty() && !stream.due) {
                return true;
            }
            *marks += 1;
            (stream.owes, stream.due) = (Some(*marks), false);
            let follower = &stream.follower;
            stream.untold.drain(..).all(|event| follower.tell(Told::Event(event)))
                && follower.tell(Told::Mark { number: *marks, now })
        });
    }
}

/// What the programs of a run may ask about.
pub(super) struct Asked<'a> {
    pub(super) testbed: &'a Arc<Testbed>,
    pub(super) history: &'a Arc<History>,
    pub(super) run: RunId,
    pub(super) recorder: &'a PacedRecorder,
    pub(super) logs: &'a Path,
}

impl Apart {
    /// Serves the API and starts the programs; `None` where a testbed has none. One that says nothing for longer than
    /// `patience` while time waits for it is cut off.
    pub(super) fn start(
        asked: &Asked<'_>,
        options: &Options,
        patience: Duration,
    ) -> Result<Option<Self>, RunError> {
        let testbed = asked.testbed;
        if programs(testbed).next().is_none() {
            return Ok(None);
        }
        let any_port = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let listener = Listener::bind(options.api.unwrap_or(any_port), false, &options.tokens)?;
        let (core, inbox) = mpsc::channel();
        let (stream, _) = broadcast::channel(STREAM);
        let live = Live::default();
        let waited_for = programs(testbed).cloned().collect();
        let context = api::Context {
            testbed: Arc::clone(testbed),
            live: live.clone(),
            history: Arc::clone(asked.history),
            run: asked.run,
            events: stream.clone(),
            core,
            namespaces: Arc::new(BTreeMap::new()),
            lockstep: Some(Lockstep {
                plugins: Some(Arc::new(waited_for)),
                recorder: Some(asked.recorder.clone()),
            }),
            replay: false,
            wais: api::WaisOptions { callbacks: options.wais_callbacks.clone(), ..Default::default() },
        };
        let server = Server::start(listener, context, options.tokens.clone())?;
        let mut host = PluginHost::new();
        let started = host.start_programs(testbed, server.address(), asked.logs)?;
        let program = |id| Program { id, streams: Vec::new(), cut: false };
        let programs = started.into_iter().map(program).collect();
        Ok(Some(Self { _server: server, host, programs, inbox, live, stream, marks: 0, patience }))
    }

    /// Something happened.
    pub(super) fn publish(&mut self, event: &Stamped) {
        self.live.absorb(event);
        let event = Arc::new(event.clone());
        let streams = self.programs.iter_mut().flat_map(|program| &mut program.streams);
        for stream in streams {
            stream.untold.extend(stream.follower.sees(&event));
        }
        // Nobody may be listening.
        let _ = self.stream.send(event);
    }

    /// Lets the programs take in what happened up to `now`, and do what they want to do about it; `pass_on` takes what
    /// happens by that. Asks `go_on` whether to; gives false when that does.
    pub(super) fn settle(
        &mut self,
        now: Timestamp,
        simulation: &mut Simulation,
        pass_on: &mut dyn FnMut(Stamped),
        go_on: &mut dyn FnMut(Timestamp) -> bool,
    ) -> bool {
        while let Ok(message) = self.inbox.try_recv() {
            self.take(now, message, simulation, pass_on);
        }
        for stream in self.programs.iter_mut().flat_map(|program| &mut program.streams) {
            stream.due |= stream.wake_at.take_if(|at| *at <= now).is_some();
        }
        while let Some(place) = self.programs.iter().position(Program::is_waited_for) {
            self.programs[place].tell(now, &mut self.marks);
            if !go_on(now) || !self.wait_for(place, now, simulation, pass_on, go_on) {
                return false;
            }
        }
        let streams = self.programs.iter().flat_map(|program| &program.streams);
        simulation.set_alarm(streams.filter_map(|stream| stream.wake_at).min());
        true
    }

    /// Waits until a program is there and is done with all that it was told, or is cut off.
    #[allow(clippy::disallowed_types, reason = "programs run on the wall clock, and may hang there")]
    fn wait_for(
        &mut self,
        place: usize,
        now: Timestamp,
        simulation: &mut Simulation,
        pass_on: &mut dyn FnMut(Stamped),
        go_on: &mut dyn FnMut(Timestamp) -> bool,
    ) -> bool {
        let mut heard = std::time::Instant::now();
        loop {
            let program = &mut self.programs[place];
            let is_done = !program.streams.is_empty() && program.streams.iter().all(|s| s.owes.is_none());
            if program.cut || is_done {
                return true;
            }
            match self.inbox.recv_timeout(LOOK) {
                Ok(message) => {
                    if self.take(now, message, simulation, pass_on) == Some(place) {
                        heard = std::time::Instant::now();
                    }
                }
                Err(_) => {
                    program.streams.retain(|stream| !stream.follower.is_gone());
                    let hung = (heard.elapsed() > self.patience).then(|| program.complaint(self.patience));
                    let ended = self.host.check(now).into_iter();
                    let hung = hung.map(|reason| (self.programs[place].id.clone(), reason));
                    for (id, reason) in ended.chain(hung) {
                        self.cut_off(&id, reason, simulation, pass_on);
                    }
                    if !go_on(now) {
                        return false;
                    }
                }
            }
        }
    }

    /// Does what somebody says; gives which program that was.
    fn take(
        &mut self,
        now: Timestamp,
        message: Message,
        simulation: &mut Simulation,
        pass_on: &mut dyn FnMut(Stamped),
    ) -> Option<usize> {
        match message {
            Message::Follow(follower) => {
                let place = self.place(&follower.plugin)?;
                let program = &mut self.programs[place];
                if !program.cut {
                    let stream =
                        Stream { follower, untold: Vec::new(), owes: None, wake_at: None, due: true };
                    program.streams.push(stream);
                    program.tell(now, &mut self.marks);
                }
                Some(place)
            }
            Message::Done { mark, wake_at } => self.programs.iter_mut().position(|program| {
                let stream = program.streams.iter_mut().find(|stream| stream.owes == Some(mark));
                stream.map(|stream| (stream.owes, stream.wake_at) = (None, wake_at)).is_some()
            }),
            Message::Instruct { plugin, instruction, reason, reply } => {
                let place = self.place(&plugin);
                let done = self.instruct(now, plugin, instruction, reason, simulation, pass_on);
                // What the instruction did is told before the answer to it.
                self.pass_on(simulation, pass_on);
                if let Some(reply) = reply {
                    reply(done);
                }
                place
            }
            _ => None,
        }
    }

    fn place(&self, plugin: &PluginId) -> Option<usize> {
        self.programs.iter().position(|program| program.id == *plugin)
    }

    fn instruct(
        &mut self,
        now: Timestamp,
        plugin: PluginId,
        instruction: Instruction,
        reason: Option<String>,
        simulation: &mut Simulation,
        pass_on: &mut dyn FnMut(Stamped),
    ) -> Result<(), Refused> {
        if let Err(refusal) = self.host.admit(now, &plugin) {
            if refusal == Refusal::Flood {
                self.cut_off(&plugin, refusal.to_string(), simulation, pass_on);
            }
            return Err(Refused(refusal.to_string()));
        }
        if let Instruction::Move { robot, .. } = &instruction {
            self.host.moved(robot, &plugin);
        }
        simulation.instruct(plugin, instruction, reason)
    }

    fn cut_off(
        &mut self,
        id: &PluginId,
        reason: String,
        simulation: &mut Simulation,
        pass_on: &mut dyn FnMut(Stamped),
    ) {
        let Some(place) = self.place(id) else { return };
        let program = &mut self.programs[place];
        program.cut = true;
        program.streams.clear();
        let robots = self.host.cut_off(id);
        simulation.cut_off(id.clone(), reason, &robots);
        self.pass_on(simulation, pass_on);
    }

    fn pass_on(&mut self, simulation: &mut Simulation, pass_on: &mut dyn FnMut(Stamped)) {
        while let Some(event) = simulation.poll_event() {
            self.publish(&event);
            pass_on(event);
        }
    }
}
