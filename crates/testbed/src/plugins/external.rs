//! Plug-ins that are programs, in virtual time and in a replay. They are served the API, and each has its turn in the
//! host's order. Time waits for them, so their instructions depend on the events alone, not on their speed. This shell
//! waits for them in real time.

use std::{collections::BTreeMap, path::Path, sync::mpsc, time::Duration};

use cotorra_graph::{DecidesIn, PluginId, PluginProgram, Testbed, Timestamp};
use cotorra_network_control::InstructionError;

use super::{
    error::PluginError,
    host::{Fault, PluginHost},
    process::Process,
};
use crate::{
    api::{self, ApiError, Dashboard, Listener, Server, Tokens},
    clock::Clock,
    core::message::Message,
    given::Given,
    virtual_time::time_control::TimeControl,
};

/// Interval at which an awaited program is checked for its end.
const LOOK: Duration = Duration::from_millis(20);
/// Longest wait for messages until the caller is asked whether to go on.
const PAUSE: Duration = Duration::from_millis(50);

/// A simulation or replay in which programs take part.
pub(crate) trait Stage {
    /// Returns the current time, which stands still.
    fn now(&self) -> Timestamp;

    fn host(&mut self) -> &mut PluginHost;

    /// Applies an instruction. Its events are published before the instruction is answered.
    fn instruct(&mut self, given: Given) -> Result<(), InstructionError>;

    /// Cuts a program off, and publishes the event.
    fn cut_off(&mut self, plugin: &PluginId, fault: &Fault);

    /// Returns how time passes.
    fn time_control(&mut self) -> &mut TimeControl;

    /// Whether to go on; called several times a second.
    fn goes_on(&mut self) -> bool;
}

/// Outcome of a wait for a time of the run.
pub(crate) enum Waited {
    /// The time has come.
    Due,
    /// It has not come. Messages may have changed what is next.
    NotYet,
    /// The run has to stop.
    Stopped,
}

/// The API, its messages, and the programs that the testbed started.
pub(crate) struct ExternalPlugins {
    /// Dropped before the processes: streams end first, so that a program can exit by itself.
    server: Server,
    processes: BTreeMap<PluginId, Process>,
    /// CPU time of each program whose decisions are measured, when it was last sent events.
    used_before: BTreeMap<PluginId, Duration>,
    inbox: mpsc::Receiver<Message>,
    wall: Clock,
}

impl ExternalPlugins {
    pub(crate) fn serve(
        listener: Listener,
        tokens: Tokens,
        wall: Clock,
        context: impl FnOnce(mpsc::Sender<Message>) -> api::Context,
    ) -> Result<Self, ApiError> {
        let (core, inbox) = mpsc::channel();
        let mut server = Server::start(listener, context(core), tokens)?;
        server.open();
        Ok(Self { server, processes: BTreeMap::new(), used_before: BTreeMap::new(), inbox, wall })
    }

    /// Starts the programs of a testbed. Time waits for them from now on.
    pub(crate) fn start(
        &mut self,
        testbed: &Testbed,
        logs: &Path,
        host: &mut PluginHost,
    ) -> Result<(), PluginError> {
        for spec in &testbed.plugins {
            if let PluginProgram::Command(words) = &spec.program {
                let process = Process::start(spec, words, &testbed.folder, &self.server, logs)?;
                if spec.distance.decides_in.is_some_and(DecidesIn::is_measured) {
                    let used = process.cpu_time();
                    let used =
                        used.map_err(|source| PluginError::CpuTime { plugin: spec.id.clone(), source })?;
                    self.used_before.insert(spec.id.clone(), used);
                }
                self.processes.insert(spec.id.clone(), process);
                host.expect(spec.id.clone());
            }
        }
        Ok(())
    }

    /// Returns the dashboard, whose address is the API's.
    pub(crate) fn dashboard(&self) -> &Dashboard {
        self.server.dashboard()
    }

    /// Lets the programs handle all events up to now and give their instructions. Returns false to stop.
    pub(crate) fn settle(&mut self, stage: &mut impl Stage) -> bool {
        while let Ok(message) = self.inbox.try_recv() {
            self.take(message, stage);
        }
        let now = stage.now();
        stage.host().wake(now);
        while let Some(program) = stage.host().next_awaited() {
            self.begin_decision(&program);
            stage.host().flush(now, &program);
            if !stage.goes_on() || !self.wait_for(&program, stage) {
                return false;
            }
        }
        true
    }

    /// Handles messages that wait, and the first that comes within a time. Returns whether to go on.
    pub(crate) fn listen(&mut self, within: Duration, stage: &mut impl Stage) -> bool {
        let mut next = self.inbox.recv_timeout(within).ok();
        while let Some(message) = next {
            self.take(message, stage);
            next = self.inbox.try_recv().ok();
        }
        stage.goes_on()
    }

    /// Waits until the run's time may be `next`, but not for long. Handles messages meanwhile.
    pub(crate) fn wait_until(&mut self, next: Timestamp, stage: &mut impl Stage) -> Waited {
        match stage.time_control().wait(next) {
            Some(Duration::ZERO) => Waited::Due,
            wait => {
                let goes_on = self.listen(wait.unwrap_or(PAUSE).min(PAUSE), stage);
                if goes_on { Waited::NotYet } else { Waited::Stopped }
            }
        }
    }

    /// Waits until a program follows the events and has handled all of them, or is cut off.
    fn wait_for(&mut self, program: &PluginId, stage: &mut impl Stage) -> bool {
        let mut heard = (self.wall)();
        while stage.host().is_busy(program) {
            if let Ok(message) = self.inbox.recv_timeout(LOOK) {
                if self.take(message, stage).as_ref() == Some(program) {
                    heard = (self.wall)();
                }
                continue;
            }
            stage.host().forget_gone();
            self.cut_off_ended(stage);
            let host = stage.host();
            if host.is_busy(program) && (self.wall)().since(heard) > host.patience() {
                let fault = host.silence(program);
                self.cut_off(program, &fault, stage);
            }
            if !stage.goes_on() {
                return false;
            }
        }
        true
    }

    /// Notes the CPU time of a program that is about to get events, if its decisions are measured.
    fn begin_decision(&mut self, program: &PluginId) {
        if let Some(before) = self.used_before.get_mut(program)
            && let Some(process) = self.processes.get(program)
            // One that has ended uses no more, and is cut off soon.
            && let Ok(used) = process.cpu_time()
        {
            *before = used;
        }
    }

    /// Returns the CPU time that a program has used since it got events, if its decisions are measured.
    fn used(&self, program: &PluginId) -> Option<Duration> {
        let before = *self.used_before.get(program)?;
        let now = self.processes.get(program)?.cpu_time().ok()?;
        Some(now.saturating_sub(before))
    }

    /// Cuts off programs that have ended.
    pub(crate) fn cut_off_ended(&mut self, stage: &mut impl Stage) {
        let ended = self.processes.iter_mut().filter_map(|(id, p)| Some((id.clone(), p.fault()?)));
        for (id, fault) in ended.collect::<Vec<_>>() {
            self.cut_off(&id, &fault, stage);
        }
    }

    /// Handles a message. Returns the plug-in that sent it.
    fn take(&mut self, message: Message, stage: &mut impl Stage) -> Option<PluginId> {
        match message {
            Message::Follow(follower) => {
                let (id, now) = (follower.plugin.clone(), stage.now());
                self.begin_decision(&id);
                stage.host().follow(now, follower);
                Some(id)
            }
            Message::Done { plugin, mark, wake_at } => {
                stage.host().done(&plugin, mark, wake_at).then_some(plugin)
            }
            Message::Instruct { given, reply } => {
                let plugin = given.plugin.clone();
                if let Some(used) = self.used(&plugin) {
                    stage.host().decide_in(&plugin, used);
                }
                let done = stage.instruct(given);
                self.end_cut_off(stage);
                if let Some(reply) = reply {
                    reply(done);
                }
                Some(plugin)
            }
            Message::ControlTime { change, reply } => {
                let now = stage.now();
                reply(stage.time_control().change(change, now));
                None
            }
            _ => None,
        }
    }

    fn cut_off(&mut self, program: &PluginId, fault: &Fault, stage: &mut impl Stage) {
        stage.cut_off(program, fault);
        self.end_cut_off(stage);
    }

    fn end_cut_off(&mut self, stage: &mut impl Stage) {
        self.processes.retain(|id, _| !stage.host().is_cut_off(id));
    }
}
