//! Programs that time waits for, in virtual time and in a replay: they are served the API, and told one after the other, in
//! the order in which the host has them. What they do so depends on what happened alone, not on how fast they are. This is
//! the shell that waits for them on the wall clock.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    path::Path,
    sync::{Arc, mpsc},
    time::Duration,
};

use cotorra_graph::{Instruction, PluginId, PluginProgram, Stamped, Testbed, Timestamp};
use cotorra_network_control::InstructionError;
use tokio::sync::broadcast;

use super::{
    error::PluginError,
    host::{Fault, PluginHost},
    process::Process,
};
use crate::{
    api::{self, ApiError, Listener, Server, Tokens},
    clock::Clock,
    live::Live,
    message::Message,
};

/// How often it is looked whether a program that time waits for still runs.
const LOOK: Duration = Duration::from_millis(20);
/// Events that wait for a reader that time does not wait for; one that is further behind misses the oldest.
const STREAM: usize = 4096;

/// What programs take part in.
pub(crate) trait Stage {
    /// The time, which stands still.
    fn now(&self) -> Timestamp;

    /// Who decides about plug-ins.
    fn host(&mut self) -> &mut PluginHost;

    /// Does what somebody asks for. What happens by that is told before the answer to it.
    fn instruct(
        &mut self,
        programs: &mut ExternalPlugins,
        plugin: PluginId,
        instruction: Instruction,
        reason: Option<String>,
    ) -> Result<(), InstructionError>;

    /// Cuts a program off, and tells that.
    fn cut_off(&mut self, programs: &mut ExternalPlugins, plugin: &PluginId, fault: &Fault);

    /// Whether to go on; asked several times a second.
    fn goes_on(&mut self) -> bool;
}

/// The API and what programs say to it, and those that the testbed started.
pub(crate) struct ExternalPlugins {
    /// Before the processes: streams end first, so that a program can end by itself.
    server: Server,
    processes: BTreeMap<PluginId, Process>,
    inbox: mpsc::Receiver<Message>,
    live: Live,
    stream: broadcast::Sender<Arc<Stamped>>,
    wall: Clock,
}

impl ExternalPlugins {
    /// Serves the API.
    pub(crate) fn serve(
        listener: Listener,
        tokens: Tokens,
        wall: Clock,
        context: impl FnOnce(broadcast::Sender<Arc<Stamped>>, mpsc::Sender<Message>) -> api::Context,
    ) -> Result<Self, ApiError> {
        let (core, inbox) = mpsc::channel();
        let (stream, _) = broadcast::channel(STREAM);
        let context = context(stream.clone(), core);
        let live = context.live.clone();
        let server = Server::start(listener, context, tokens)?;
        Ok(Self { server, processes: BTreeMap::new(), inbox, live, stream, wall })
    }

    /// Starts the programs of a testbed, which time waits for from now on.
    pub(crate) fn start(
        &mut self,
        testbed: &Testbed,
        logs: &Path,
        host: &mut PluginHost,
    ) -> Result<(), PluginError> {
        for spec in &testbed.plugins {
            if let PluginProgram::Command(words) = &spec.program {
                let process = Process::start(spec, words, &self.server, logs)?;
                self.processes.insert(spec.id.clone(), process);
                host.expect(spec.id.clone());
            }
        }
        Ok(())
    }

    /// Where the API listens.
    pub(crate) fn api_address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Something happened.
    pub(crate) fn publish(&self, event: &Arc<Stamped>, host: &mut PluginHost) {
        self.live.absorb(event);
        host.publish(event);
        // Nobody may be listening.
        let _ = self.stream.send(Arc::clone(event));
    }

    /// Lets the programs take in what happened up to now, and do what they want to do about it; false if it is not to go
    /// on.
    pub(crate) fn settle(&mut self, stage: &mut impl Stage) -> bool {
        while let Ok(message) = self.inbox.try_recv() {
            self.take(message, stage);
        }
        let now = stage.now();
        stage.host().wake(now);
        while let Some(program) = stage.host().next_awaited(now) {
            if !stage.goes_on() || !self.wait_for(&program, stage) {
                return false;
            }
        }
        true
    }

    /// Hears what is said within a time, and all that was said before; gives whether to go on.
    pub(crate) fn listen(&mut self, within: Duration, stage: &mut impl Stage) -> bool {
        let mut next = self.inbox.recv_timeout(within).ok();
        while let Some(message) = next {
            self.take(message, stage);
            next = self.inbox.try_recv().ok();
        }
        stage.goes_on()
    }

    /// Waits until a program is there and is done with all that it was told, or is cut off.
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
            let ended = self.processes.iter_mut().filter_map(|(id, p)| Some((id.clone(), p.fault()?)));
            for (id, fault) in ended.collect::<Vec<_>>() {
                self.cut_off(&id, &fault, stage);
            }
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

    /// Does what somebody says; gives which plug-in that was.
    fn take(&mut self, message: Message, stage: &mut impl Stage) -> Option<PluginId> {
        match message {
            Message::Follow(follower) => {
                let (id, now) = (follower.plugin.clone(), stage.now());
                stage.host().follow(now, follower);
                Some(id)
            }
            Message::Done { plugin, mark, wake_at } => {
                stage.host().done(&plugin, mark, wake_at).then_some(plugin)
            }
            Message::Instruct { plugin, instruction, reason, reply } => {
                let done = stage.instruct(self, plugin.clone(), instruction, reason);
                self.end_cut_off(stage);
                if let Some(reply) = reply {
                    reply(done);
                }
                Some(plugin)
            }
            _ => None,
        }
    }

    fn cut_off(&mut self, program: &PluginId, fault: &Fault, stage: &mut impl Stage) {
        stage.cut_off(self, program, fault);
        self.end_cut_off(stage);
    }

    fn end_cut_off(&mut self, stage: &mut impl Stage) {
        self.processes.retain(|id, _| !stage.host().is_cut_off(id));
    }
}
