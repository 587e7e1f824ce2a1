//! Real Wi-Fi software of a run: in the nodes of its datapath, and at agents.

use std::{
    os::unix::process::CommandExt,
    process::Command,
    sync::{Arc, mpsc::Sender},
};

use cotorra_datapath::{Datapath, SpawnOptions};
use cotorra_engine::Process;
use cotorra_fabric::{Association, Fabric, FabricError};
use cotorra_graph::{Event, RadioKind, Stamped, Testbed, Timestamp};

use super::{launcher::NodeProcess, network::NetworkUp, prepared::Prepared};
use crate::{
    clock::Clock,
    core::message::Message,
    error::RunError,
    real::{agents::AgentEngine, network::RealNetwork},
    wifi::{Change, Outlets, Surroundings, Wifi, WifiError},
};

/// Starts the Wi-Fi software in the nodes of a run, if it has any.
///
/// # Errors
/// [`RunError::Wifi`]. Nothing runs then.
pub(super) fn start(prepared: &Prepared, network: &NetworkUp) -> Result<Option<Wifi>, RunError> {
    let Some(plan) = prepared.wifi.clone() else { return Ok(None) };
    let NetworkUp { now, datapath, messages, .. } = network;
    let launch_in = Arc::clone(datapath);
    let launch = move |node: &_, mut command: Command| {
        // Ctrl-C at a terminal is not for them: they would end before the run, each for itself.
        command.process_group(0);
        let child =
            launch_in.spawn(node, command, SpawnOptions { unique_number: true, ..SpawnOptions::default() });
        Ok(Box::new(NodeProcess(child.map_err(std::io::Error::other)?)) as Box<dyn Process>)
    };
    let surroundings = Surroundings {
        now: Arc::clone(now),
        launch: Arc::new(launch),
        logs: prepared.folder.logs(),
        change: change_in(datapath),
        report: report_to(messages, now),
    };
    Ok(Some(Wifi::start(plan, surroundings)?))
}

/// Makes agents serve and join the networks of a run's real radios, and lets the core have them; `None` if it has none.
///
/// # Errors
/// [`RunError::Wifi`]. All radios are their owners' again when the agents' engine ends.
pub(super) fn start_at_agents(
    testbed: &Testbed,
    network: &NetworkUp,
    agents: &mut AgentEngine,
    real_network: &mut RealNetwork,
) -> Result<Option<Wifi>, RunError> {
    let NetworkUp { now, datapath, messages, .. } = network;
    let Some(radios) = agents.take_radios() else { return Ok(None) };
    let nodes: Vec<_> = testbed.graph.nodes_with(RadioKind::Hardware).map(|node| node.id.clone()).collect();
    // The emulated network follows what the radios do, and carries nothing there.
    let lend = move |fabric: &mut Fabric, now| {
        nodes.iter().try_for_each(|node| fabric.lend_antenna(now, node).map(drop))
    };
    let lent = datapath.handle().with(lend).map_err(|gone| WifiError::Start(gone.to_string()))?;
    lent.map_err(|error| WifiError::Start(error.to_string()))?;
    let outlets = Outlets {
        now: Arc::clone(now),
        wishes: agents.wishes(),
        change: change_in(datapath),
        report: report_to(messages, now),
    };
    let started = Wifi::start_at_agents(&testbed.graph, &super::wifi_plan::domain_key(), outlets, radios)?;
    Ok(started.map(|(wifi, figures)| {
        real_network.add_wifi(wifi.handle());
        real_network.set_radio_figures(figures);
        wifi
    }))
}

/// Returns what reports events to the core.
fn report_to(messages: &Sender<Message>, now: &Clock) -> Box<dyn FnMut(Event) + Send> {
    let (messages, now) = (messages.clone(), Arc::clone(now));
    Box::new(move |event| {
        // The core's thread may have ended already.
        _ = messages.send(Message::Network(Stamped { at: now(), event }));
    })
}

/// Returns what changes the fabric of a datapath.
fn change_in(datapath: &Datapath) -> Box<dyn FnMut(Change) -> Result<(), String> + Send> {
    let handle = datapath.handle();
    Box::new(move |change| {
        let done = handle.with(move |fabric, now| apply(fabric, now, change));
        done.map_err(|gone| gone.to_string())?.map_err(|error| error.to_string())
    })
}

fn apply(fabric: &mut Fabric, now: Timestamp, change: Change) -> Result<(), FabricError> {
    match change {
        Change::Associate { robot, radio_unit, began, fast } => {
            fabric.associate(now, &robot, &radio_unit, Association { began, fast })
        }
        Change::Disassociate { robot } => fabric.disassociate(now, &robot),
        Change::Scanned { robot } => fabric.scanned(now, &robot),
        Change::SwitchOn { radio_unit, access_point } => fabric.switch_on(now, &radio_unit, access_point),
        Change::SwitchOff { radio_unit } => fabric.switch_off(now, &radio_unit),
    }
}
