//! Background calls to the master: it unregisters ended topics and services, registers everything again after the master
//! restarted, and unregisters the node at its end.

use std::{
    sync::{Arc, atomic::Ordering, mpsc},
    time::Duration,
};

use super::{
    shared::{Command, Errand, Shared},
    subscription::Subscription,
    watch::Watch,
};
use crate::master::RpcError;

/// Interval between checks whether the master still knows the node.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// Runs errands until the node ends.
pub(super) fn run(shared: &Arc<Shared>, errands: &mpsc::Receiver<Errand>) {
    loop {
        match errands.recv_timeout(HEARTBEAT) {
            Ok(Errand::Stop) | Err(mpsc::RecvTimeoutError::Disconnected) => break,
            Ok(errand) => note(&unregister(shared, &errand)),
            Err(mpsc::RecvTimeoutError::Timeout) => note(&heartbeat(shared)),
        }
    }
    {
        // No registration begins after this.
        let _state = shared.state.lock();
        shared.stopped.store(true, Ordering::Release);
    }
    let _order = shared.registrar.lock();
    note(&unregister_all(shared));
    shared.command(Command::Stop);
}

/// Logs a failed call. The heartbeat repairs it once the master is back.
fn note(result: &Result<(), RpcError>) {
    if let Err(error) = result {
        tracing::debug!("master: {error}");
    }
}

/// Unregisters something that ended, unless it was registered again in the meantime.
fn unregister(shared: &Shared, errand: &Errand) -> Result<(), RpcError> {
    let _order = shared.registrar.lock();
    let (master, api, service) = (&shared.master, &shared.api, shared.tcpros.rosrpc());
    let gone = |known: bool| !known;
    match errand {
        Errand::Unpublished(topic) if gone(shared.state.lock().publications.contains_key(topic)) => {
            master.unregister_publisher(topic, api)
        }
        Errand::Unsubscribed(topic) if gone(shared.state.lock().subscribes(topic)) => {
            master.unregister_subscriber(topic, api)
        }
        Errand::Unserved(name) if gone(shared.state.lock().services.contains_key(name)) => {
            master.unregister_service(name, &service)
        }
        Errand::Unwatched(name) if gone(shared.state.lock().watches(name)) => {
            master.unsubscribe_param(name, api)
        }
        _ => Ok(()),
    }
}

/// Everything that is registered.
struct Registered {
    publications: Vec<(String, &'static str)>,
    subscriptions: Vec<Arc<Subscription>>,
    services: Vec<String>,
    watches: Vec<Arc<Watch>>,
}

impl Registered {
    fn of(shared: &Shared) -> Self {
        let state = shared.state.lock();
        let publications = state.publications.iter().map(|(topic, p)| (topic.clone(), p.kind.name));
        Self {
            publications: publications.collect(),
            subscriptions: state.subscriptions.values().cloned().collect(),
            services: state.services.keys().cloned().collect(),
            watches: state.watches.values().cloned().collect(),
        }
    }
}

/// Unregisters everything. Stops at the first failed call: the others would fail, too.
fn unregister_all(shared: &Shared) -> Result<(), RpcError> {
    let registered = Registered::of(shared);
    let (master, api, service) = (&shared.master, &shared.api, shared.tcpros.rosrpc());
    for (topic, _) in &registered.publications {
        master.unregister_publisher(topic, api)?;
    }
    for subscription in &registered.subscriptions {
        master.unregister_subscriber(&subscription.topic, api)?;
    }
    for name in &registered.services {
        master.unregister_service(name, &service)?;
    }
    for watch in &registered.watches {
        master.unsubscribe_param(&watch.name, api)?;
    }
    Ok(())
}

/// Registers everything again if the master no longer knows the node.
fn heartbeat(shared: &Shared) -> Result<(), RpcError> {
    if shared.state.lock().is_empty() {
        return Ok(());
    }
    let _order = shared.registrar.lock();
    match shared.master.lookup_node(shared.names.node()) {
        Err(RpcError::Refused { .. }) => {}
        // If another node took the name, the master shuts this one down.
        known => return known.map(drop),
    }
    tracing::info!(
        "the master at {} does not know {}: registering again",
        shared.master.endpoint(),
        shared.names.node()
    );
    let registered = Registered::of(shared);
    let (master, api, service) = (&shared.master, &shared.api, shared.tcpros.rosrpc());
    for (topic, kind) in &registered.publications {
        master.register_publisher(topic, kind, api)?;
    }
    for subscription in &registered.subscriptions {
        subscription.notified.store(false, Ordering::Release);
        let publishers = master.register_subscriber(&subscription.topic, subscription.kind.name, api)?;
        shared.command(Command::Publishers { subscription: subscription.id, publishers });
    }
    for name in &registered.services {
        master.register_service(name, &service, api)?;
    }
    for watch in &registered.watches {
        watch.update(&watch.name, &master.subscribe_param(&watch.name, api)?);
    }
    Ok(())
}
