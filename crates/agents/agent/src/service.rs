//! The agent's loop: messages of the core, events of VNFs, conditions of links and the machine's context.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "the agent's only clock")]

use std::{
    fs,
    path::PathBuf,
    sync::{Arc, mpsc},
    thread,
    time::{Duration, Instant, SystemTime},
};

use cotorra_agent_protocol::{Action, Agent, MachineReading, RequestError, Run, Wanted};
use cotorra_agent_transport::{Dialer, FromCore, diagnose};
use cotorra_engine::{EngineEvent, InstanceId, Outcome};
use cotorra_enrolment::{Bundle, CORE_COMMON_NAME};
use cotorra_graph::{NodeId, Timestamp};
use cotorra_host::Host;

use crate::{
    error::AgentError,
    files, images,
    journal::Journal,
    links::Links,
    options::{self, Options},
    radios::{News, Radios},
    robot::{Inbox, Robot},
    wake::Wake,
    works::Works,
};

/// Interval of contexts, and of looking for new credentials.
const CONTEXT: Duration = Duration::from_secs(1);
/// Time without the core after which the reason is looked for.
const PATIENCE: Duration = Duration::from_secs(3);
/// Messages that wait for the loop. Further ones of the core are dropped; it sends what matters again.
const MOST_WAITING: usize = 256;

/// A message to the loop.
enum Message {
    Core(FromCore),
    /// An event of the engine.
    Wake,
    /// The files of a run are there, or the reason why not.
    Files(Run, Result<(), String>),
    Stop,
}

/// A running agent.
pub(crate) struct Service {
    options: Options,
    journal: Journal,
    agent: Agent,
    dialer: Dialer,
    /// When the credentials were written that are in use.
    credentials_of: Option<SystemTime>,
    host: Host,
    works: Option<Works>,
    robot: Robot,
    links: Links,
    radios: Radios,
    inbox: mpsc::Receiver<Message>,
    messages: mpsc::SyncSender<Message>,
    began: Instant,
    next_context: Timestamp,
    /// Time of the last message of the core, and whether its absence has been explained.
    heard: (Timestamp, bool),
}

impl Service {
    /// Locks and loads the state, and begins to connect.
    pub(crate) fn start(options: Options) -> Result<Self, AgentError> {
        let journal = Journal::open(&options.state)?;
        if options.images.is_some() {
            images::clean();
        }
        let credentials_of = written(&options.credentials);
        let bundle = options::bundle(&options.credentials)?;
        let (messages, inbox) = mpsc::sync_channel(MOST_WAITING);
        let stop = messages.clone();
        ctrlc::set_handler(move || drop(stop.send(Message::Stop)))?;
        let boot = getrandom::u64().map_err(AgentError::Random)?;
        let began = now();
        let robot = Robot::new(Arc::new(move || since(began)), boot);
        let dialer = dial(&bundle, &messages, robot.inbox())?;
        robot.send_by(dialer.robot_sender());
        let name = bundle.certificate().name.clone();
        let node = NodeId::new(name.as_str()).expect("names of agents and nodes have the same characters");
        tracing::info!("agent `{name}`: connecting to {}", bundle.core());
        let links = Links::new(options.confirmed.clone());
        let wake = messages.clone();
        // A full inbox wakes the loop anyway.
        let wake: Wake = Arc::new(move || drop(wake.try_send(Message::Wake)));
        let radios = Radios::new(options.wifi.clone(), &options.state, wake);
        Ok(Self {
            agent: Agent::new(Timestamp::ZERO, boot, journal.load()),
            options,
            journal,
            dialer,
            credentials_of,
            host: Host::new(node),
            works: None,
            robot,
            links,
            radios,
            inbox,
            messages,
            began,
            next_context: Timestamp::ZERO,
            heard: (Timestamp::ZERO, false),
        })
    }

    /// Runs until it is stopped. VNFs end then, and interfaces are restored.
    pub(crate) fn run(mut self) {
        loop {
            let now = self.now();
            self.agent.advance(now);
            if let Some(works) = &mut self.works {
                while let Some(event) = works.poll() {
                    self.agent.outcome(now, works.run(), event);
                }
            }
            self.count_stopping();
            let state = self.robot.want(now, self.agent.robot());
            self.agent.set_robot_state(now, state);
            self.links.advance(now);
            self.agent.set_link_states(now, self.links.states());
            self.follow_radios(now);
            while let Some(action) = self.agent.poll(now) {
                self.act(action);
            }
            if now >= self.next_context {
                self.next_context = now + CONTEXT;
                self.report_context();
                self.renew();
                self.explain_silence(now);
            }
            let deadline = self.agent.next_deadline().min(self.next_context).min(self.links.next_deadline());
            match self.inbox.recv_timeout(deadline.since(self.now())) {
                Ok(Message::Stop) => break,
                Ok(message) => self.take(message),
                Err(_) => {}
            }
        }
        // A robot may move, interfaces may carry others' packets, and VNFs take their time.
        drop(self.robot);
        drop(self.links);
        drop(self.radios);
        if let Some(works) = &mut self.works {
            works.shut_down();
        }
        tracing::info!("stopped");
    }

    fn now(&self) -> Timestamp {
        since(self.began)
    }

    fn take(&mut self, message: Message) {
        let now = self.now();
        match message {
            Message::Core(from_core) => {
                if self.heard.1 || self.heard.0 == Timestamp::ZERO {
                    tracing::info!("the core is there");
                }
                self.heard = (now, false);
                match from_core {
                    FromCore::Wanted(wanted) => self.agent.want(now, *wanted),
                    FromCore::Beat(beat) => self.agent.beat(now, beat),
                    // They went to the robot's thread.
                    FromCore::Command(_) => {}
                    FromCore::Rejected(reason) => {
                        tracing::warn!("a message of the core is rejected: {reason}")
                    }
                }
            }
            Message::Files(run, fetched) => {
                if let Some(works) = self.works.as_mut().filter(|works| works.run() == run) {
                    let failures = works.complete(&fetched);
                    if fetched.is_err() {
                        // The core tries again, and the files with it.
                        self.works = None;
                    }
                    failures.into_iter().for_each(|(id, reason)| self.fail(run, id, reason));
                }
            }
            Message::Wake | Message::Stop => {}
        }
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::Save(wanted) => {
                if let Err(error) = self.journal.save(&wanted) {
                    let reason = format!("the wanted state cannot be saved: {error}");
                    tracing::error!("{reason}");
                    let now = self.now();
                    self.agent.cannot_save(now, &reason);
                }
                tracing::debug!("generation {} of run {}", wanted.generation, wanted.run.0);
                self.prepare(&wanted);
            }
            Action::Start(id, instance) => {
                if self.works.is_none()
                    && let Some(wanted) = self.agent.wanted().cloned()
                {
                    // After a restart of the agent.
                    self.prepare(&wanted);
                }
                if let Some(works) = &mut self.works
                    && let Err(reason) = works.start(id, instance)
                {
                    let run = works.run();
                    self.fail(run, id, reason);
                }
            }
            Action::Stop(id) => {
                if let Some(works) = &mut self.works {
                    works.stop(id);
                }
                self.count_stopping();
            }
            Action::Emulate(links) => {
                let now = self.now();
                self.links.want(now, links);
                self.agent.set_link_states(now, self.links.states());
            }
            Action::UseRadios(radios) => {
                self.radios.want(radios);
                let now = self.now();
                self.agent.set_radio_states(now, self.radios.states());
            }
            Action::Request(number, request) => {
                if let Err(reason) = self.radios.request(number, request) {
                    let now = self.now();
                    self.agent.answered(now, number, Err(RequestError::Refused(reason)));
                }
            }
            Action::Report(report) => {
                self.dialer.report(&report);
            }
        }
    }

    /// Tells the core's side what happened at Wi-Fi interfaces.
    fn follow_radios(&mut self, now: Timestamp) {
        while let Some(news) = self.radios.poll() {
            match news {
                News::Answered(number, answer) => self.agent.answered(now, number, answer),
                News::Happened(interface, event) => self.agent.happened(now, interface, event),
            }
        }
        self.agent.set_radio_states(now, self.radios.states());
    }

    /// Makes ready to run VNFs of a run, unless that is done. VNFs of an earlier run end first.
    fn prepare(&mut self, wanted: &Wanted) {
        if self.works.as_ref().is_some_and(|works| works.run() == wanted.run) {
            return;
        }
        self.works = None;
        let folder = files::folder(&self.options.state, wanted.run);
        files::remove_others(&self.options.state, wanted.run);
        let wake = self.messages.clone();
        // A full inbox wakes the loop anyway.
        let wake: Wake = Arc::new(move || drop(wake.try_send(Message::Wake)));
        self.works = Some(Works::new(wanted.run, &self.options, folder.clone(), wake));
        self.fetch(folder, wanted);
    }

    /// Counts the stopped instances that have not ended yet.
    fn count_stopping(&mut self) {
        let now = self.now();
        self.agent.set_stopping(now, self.works.as_ref().map_or(0, Works::stopping));
    }

    /// Fetches the files of a run on a thread of its own.
    fn fetch(&self, folder: PathBuf, wanted: &Wanted) {
        let (fetcher, messages) = (self.dialer.fetcher(), self.messages.clone());
        let (run, shipped) = (wanted.run, wanted.files.clone());
        let fetch = move || {
            let fetched = files::complete(&folder, &shipped, |file| {
                fetcher.fetch(&file.sha256, file.bytes).map_err(|e| e.to_string())
            });
            let _ = messages.send(Message::Files(run, fetched.map_err(|e| e.to_string())));
        };
        if let Err(error) = thread::Builder::new().name("files".to_owned()).spawn(fetch) {
            let failed = Message::Files(run, Err(format!("cannot start a thread: {error}")));
            let _ = self.messages.try_send(failed);
        }
    }

    /// Reports that an instance could not be started.
    fn fail(&mut self, run: Run, id: InstanceId, reason: String) {
        tracing::warn!("{reason}");
        let now = self.now();
        self.agent.outcome(now, run, EngineEvent { instance: id, outcome: Outcome::Failed(reason) });
    }

    fn report_context(&mut self) {
        let now = self.now();
        let reading = self.host.read(now);
        for unavailable in &reading.unavailable {
            tracing::info!("{unavailable}");
        }
        let links = self.links.read(now);
        self.agent.set_link_states(now, self.links.states());
        if self.agent.run().is_none() {
            return;
        }
        let (boot, read_ns, context) = (self.agent.boot(), now.as_nanos(), reading.context);
        let (heard, addresses) = (self.radios.heard(), self.radios.addresses());
        let reading = MachineReading { boot, read_ns, context, links, heard, addresses };
        self.dialer.context(reading.encode());
    }

    /// Connects anew if the file with the credentials has changed.
    fn renew(&mut self) {
        let changed = written(&self.options.credentials);
        if changed.is_none() || changed == self.credentials_of {
            return;
        }
        self.credentials_of = changed;
        match options::bundle(&self.options.credentials)
            .and_then(|bundle| dial(&bundle, &self.messages, self.robot.inbox()))
        {
            Ok(dialer) => {
                self.robot.send_by(dialer.robot_sender());
                self.dialer = dialer;
                tracing::info!("connecting with new credentials");
            }
            Err(error) => tracing::warn!("the credentials stay as they were: {error}"),
        }
    }

    /// Finds and reports the reason why nothing is heard of the core, once each time.
    fn explain_silence(&mut self, now: Timestamp) {
        let (since, is_explained) = self.heard;
        if is_explained || now < since + PATIENCE {
            return;
        }
        self.heard.1 = true;
        let Ok(bundle) = options::bundle(&self.options.credentials) else { return };
        let explain = move || {
            let core = bundle.core().to_string();
            match diagnose(&core, options::credentials(&bundle)) {
                Err(reason) => tracing::warn!("no connection to {core}: {reason}; trying again"),
                Ok(()) => tracing::warn!(
                    "{core} accepts the certificate `{}`, but sends nothing: it is revoked, or the run has no such agent",
                    bundle.certificate().common_name()
                ),
            }
        };
        if let Err(error) = thread::Builder::new().name("diagnosis".to_owned()).spawn(explain) {
            tracing::debug!("cannot start a thread: {error}");
        }
    }
}

fn dial(
    bundle: &Bundle,
    messages: &mpsc::SyncSender<Message>,
    robot: Arc<Inbox>,
) -> Result<Dialer, AgentError> {
    let messages = messages.clone();
    let receive = move |from_core| match from_core {
        FromCore::Command(command) => robot.push(command),
        from_core => drop(messages.try_send(Message::Core(from_core))),
    };
    let name = bundle.certificate().name.clone();
    Ok(Dialer::open(
        &bundle.core().to_string(),
        CORE_COMMON_NAME,
        name,
        options::credentials(bundle),
        receive,
    )?)
}

/// Returns the time at which a file was written.
fn written(path: &std::path::Path) -> Option<SystemTime> {
    fs::metadata(path).and_then(|metadata| metadata.modified()).ok()
}

/// Returns the agent's time.
fn since(began: Instant) -> Timestamp {
    Timestamp::ZERO + now().duration_since(began)
}

fn now() -> Instant {
    Instant::now()
}
