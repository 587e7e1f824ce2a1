//! Checks of a testbed without a run.

use cotorra_fabric::Fabric;
use cotorra_graph::Testbed;
use cotorra_netem::Confirmed;

use crate::{
    core::script::{Rehearsal, Script},
    error::RunError,
    plugins,
    real::links::{self, InterfacePlan},
};

/// Makes a testbed's plug-ins and script without a run.
///
/// # Errors
/// [`RunError`] for the first mistake.
pub fn rehearse(testbed: &Testbed) -> Result<Rehearsal, RunError> {
    plugins::rehearse(testbed)?;
    Ok(Script::load(testbed)?.1)
}

/// Returns the changes that a run of the testbed would make to interfaces of this machine and of agents' machines, by name.
/// Checks this machine's interfaces of gateways and real servers, too, which a run does not change.
///
/// # Errors
/// [`RunError`], as the run would return it.
pub fn interface_plans(
    testbed: &Testbed,
    confirmed: &Confirmed,
) -> Result<Vec<(String, InterfacePlan)>, RunError> {
    cotorra_datapath::check_gateways(&testbed.graph, &confirmed.interfaces)?;
    if testbed.graph.real_links().next().is_none() {
        return Ok(Vec::new());
    }
    let mut fabric = Fabric::new(&testbed.graph, testbed.seed)?;
    Ok(links::interface_plans(&testbed.graph, &mut fabric, confirmed)?)
}
