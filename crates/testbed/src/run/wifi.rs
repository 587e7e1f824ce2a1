//! Real Wi-Fi software of a run, in the nodes of its datapath.

use std::{os::unix::process::CommandExt, process::Command, sync::Arc};

use cotorra_datapath::{Datapath, SpawnOptions};
use cotorra_engine::Process;
use cotorra_fabric::{Association, Fabric, FabricError};
use cotorra_graph::{Stamped, Testbed, Timestamp};
use cotorra_wifi::DomainKey;

use super::{launcher::NodeProcess, network::NetworkUp, prepared::Prepared};
use crate::{
    error::RunError,
    message::Message,
    wifi::{Change, Plan, Surroundings, Wifi, WifiError, check_programs},
};

/// Returns what the Wi-Fi software of a testbed is to do; `None` if it needs none.
///
/// # Errors
/// [`RunError::Wifi`] if the programs are not installed, or cannot serve the testbed.
pub(super) fn plan(testbed: &Testbed) -> Result<Option<Plan>, RunError> {
    let mut key = [0; 32];
    getrandom::fill(&mut key).expect("the system has random numbers");
    let plan = Plan::new(&testbed.graph, &DomainKey::new(key)).map_err(WifiError::from)?;
    if plan.is_some() {
        check_programs()?;
    }
    Ok(plan)
}

/// Starts the Wi-Fi software of a run, if it has any.
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
    let (reports, reports_at) = (messages.clone(), Arc::clone(now));
    let report = move |event| {
        // The core's thread may have ended already.
        _ = reports.send(Message::Network(Stamped { at: reports_at(), event }));
    };
    let surroundings = Surroundings {
        now: Arc::clone(now),
        launch: Arc::new(launch),
        logs: prepared.folder.logs(),
        change: change_in(datapath),
        report: Box::new(report),
    };
    Ok(Some(Wifi::start(plan, surroundings)?))
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
