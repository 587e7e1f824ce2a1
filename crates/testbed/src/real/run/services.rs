//! The fourth phase of a run: clients of the API can connect, and plug-ins run.

use std::sync::Arc;

use super::{network::NetworkUp, prepared::Prepared};
use crate::{
    api::{self, Listener, Server},
    error::RunError,
    events::{live::Live, stream::EventStream},
    history::{keeping::Keeping, run_info::epoch},
    plugins::running::{PreparedPlugins, RunningPlugins},
    real::network::wiretap,
};

/// The API's server and the plug-ins of a run. Fields are dropped in order: the latest made first.
pub(super) struct ServicesUp {
    pub(super) plugins: RunningPlugins,
    pub(super) server: Server,
    /// Events to readers of the API's stream.
    pub(super) stream: EventStream,
    pub(super) live: Live,
}

impl ServicesUp {
    /// Makes the API, which does not answer yet, and starts plug-ins.
    pub(super) fn start(
        prepared: &Prepared,
        network: &NetworkUp,
        listener: Listener,
        plugins: PreparedPlugins,
    ) -> Result<Self, RunError> {
        let Prepared { testbed, options, folder, .. } = prepared;
        let live = Live::default();
        let stream = EventStream::default();
        let namespaces = testbed
            .graph
            .hosts()
            .filter_map(|node| Some((node.id.clone(), network.datapath.namespace(&node.id).ok()?.path())));
        let context = api::Context {
            testbed: Arc::clone(testbed),
            live: live.clone(),
            history: Arc::clone(&prepared.history),
            run: prepared.run,
            events: stream.clone(),
            core: network.messages.clone(),
            namespaces: Arc::new(namespaces.collect()),
            hosted: Arc::new(testbed.plugins.iter().map(|spec| spec.id.clone()).collect()),
            lockstep: None,
            distant: plugins.distant(),
            replay: false,
            paced: false,
            verdict: None,
            kpis: Vec::new(),
            keeper: prepared.keeping.as_ref().map(Keeping::keeper),
            wais: api::WaisOptions {
                clock: Some(Arc::clone(&network.now)),
                epoch: epoch(&prepared.info),
                callbacks: options.wais_callbacks.clone(),
            },
            logs: Some(folder.vnf_logs()),
            wiretap: Some(wiretap(testbed, &network.datapath)),
        };
        let listener =
            listener.announced(options.runs.as_ref(), &testbed.name, &folder.path().to_string_lossy());
        let server = Server::start(listener, context, options.tokens.clone())?;
        let plugins = plugins.start(testbed, &network.now, &server, &folder.logs(), &network.messages)?;
        Ok(Self { plugins, server, stream, live })
    }
}
