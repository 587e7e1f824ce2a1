//! The first phase of a run: everything that needs no network. It checks the testbed, makes plug-ins, reserves the API's
//! address, and opens the folder, recording and history.

use std::{
    sync::{Arc, mpsc::Sender},
    thread,
};

use cotorra_graph::Testbed;
use cotorra_measurements::{History, Recorder, RunId, RunInfo};
use cotorra_recording::{Pace, Recording};

use crate::{
    api::{self, Listener},
    clock::Clock,
    core::{message::Message, script::Script},
    error::{RunError, system},
    folder::{manifest::Time, whole},
    history::{
        keeping::Keeping,
        recorded::Recorded,
        run_info::{about, run_info},
    },
    options::Options,
    plugins::running::PreparedPlugins,
    real::{
        agents::AgentEngine, confined::Confined, cpus::missing_cpus, links::RealLinkError,
        reflectors::measure_media, rehearse::interface_plans,
    },
    report::RunFolder,
    wifi::Plan,
};

/// A run that is checked and has its folder, but no network yet. Fields are dropped in order: the latest made first.
pub(super) struct Prepared {
    pub(super) recorder: Recorder,
    pub(super) history: Arc<History>,
    pub(super) run: RunId,
    pub(super) keeping: Option<Keeping>,
    pub(super) recording: Option<Recording>,
    pub(super) info: RunInfo,
    pub(super) folder: RunFolder,
    pub(super) seed: u64,
    pub(super) testbed: Arc<Testbed>,
    pub(super) options: Options,
    /// Tasks of real Wi-Fi software, if there is any.
    pub(super) wifi: Option<Plan>,
    /// Engines of containers, by their kind.
    pub(super) engines: super::containers::Addresses,
    /// With which the agents of the testbed are enrolled, if it has any.
    authority: Option<cotorra_enrolment::Authority>,
}

/// Parts of a run that later phases take over.
pub(super) struct Unstarted {
    pub(super) confined: Confined,
    pub(super) listener: Listener,
    pub(super) plugins: PreparedPlugins,
    pub(super) script: Script,
}

impl Prepared {
    /// Checks the testbed, and makes the run's folder when nothing in it can be rejected any more.
    pub(super) fn new(
        mut testbed: Testbed,
        text: &str,
        options: Options,
    ) -> Result<(Self, Unstarted), RunError> {
        interface_plans(&testbed, &options.interfaces)?;
        let cpus = thread::available_parallelism().ok().and_then(|have| missing_cpus(&testbed, have.get()));
        if let Some(missing) = cpus {
            tracing::warn!("{missing}");
        }
        cotorra_datapath::wifi::check(&testbed.graph)?;
        measure_media(&mut testbed.graph).map_err(RealLinkError::from)?;
        let authority = crate::real::agents::authority(&testbed, &options.agents)?;
        let engines = super::containers::find_engines(&testbed)?;
        let wifi = super::wifi_plan::plan(&testbed)?;
        let testbed = Arc::new(testbed);
        let seed = options.seed.unwrap_or(testbed.seed);
        let (script, _) = Script::load(&testbed)?;
        let mut plugins = PreparedPlugins::of(&testbed, seed)?;
        if let Some(previous) = &options.after {
            plugins.resume(previous);
        }
        let any_port = options.api.is_none();
        let address = options.api.unwrap_or(api::DEFAULT_ADDRESS);
        let listener = Listener::bind(address, any_port, &options.tokens, &options.encryption)?;
        let (folder, text) = whole::create(&options, &testbed, Time::Real, text)?;
        let info = run_info(&testbed, seed, &text);
        let confined = Confined::new(&testbed, &options, &folder)
            .map_err(system("show VNFs the testbed file's folder"))?;
        let recording =
            Recording::begin(&options.recording, folder.path(), &testbed, about(&info), Pace::Live)?;
        let keeping = Keeping::begin(&testbed, folder.path(), Pace::Live)
            .map_err(system("start the thread that keeps large data"))?;
        let (history, run) = Recorded::begin(&folder, options.history.as_ref(), &info)?;
        let history = Arc::new(history);
        let recorder = history.recorder(run)?;
        // Events are durable within 100 ms, which is the time between two contexts.
        plugins.history().begin(&history, run, || Ok(()));
        let prepared = Self {
            recorder,
            history,
            run,
            keeping,
            recording,
            info,
            folder,
            seed,
            testbed,
            options,
            wifi,
            engines,
            authority,
        };
        Ok((prepared, Unstarted { confined, listener, plugins, script }))
    }

    /// Listens for the agents of the testbed; `None` without any.
    pub(super) fn agents(
        &self,
        now: &Clock,
        messages: &Sender<Message>,
    ) -> Result<Option<AgentEngine>, RunError> {
        let Some(authority) = self.authority.clone() else { return Ok(None) };
        let run = cotorra_agent_protocol::Run(self.info.started_at_unix_ns.unsigned_abs());
        let (testbed, options) = (&self.testbed, &self.options.agents);
        Ok(Some(AgentEngine::start(testbed, options, authority, run, &self.folder, now, messages)?))
    }
}
