//! The bundled navigation VNF as a program: `cotorra vnf navigation`, started by the VIM in a node's namespace.

use std::{convert::Infallible, env, io, net::UdpSocket, path::PathBuf};

use cotorra_brain::{NavigationVnf, NoWalk, serve};
use cotorra_graph::{
    NodeId,
    testbed_file::{self, InvalidSetting},
};
use cotorra_network_control::vim::READY;
use cotorra_plugin::wire::NAVIGATION_PORT;

/// The testbed file that the run uses.
pub(crate) const TESTBED: &str = "COTORRA_TESTBED";
/// The settings with which the run read it, one a line.
pub(crate) const SETTINGS: &str = "COTORRA_TESTBED_SETTINGS";
/// The robot that is navigated.
pub(crate) const ROBOT: &str = "COTORRA_ROBOT";

/// Why there is no navigation.
#[derive(Debug, thiserror::Error)]
pub enum NavigationError {
    /// It was started by hand.
    #[error("{0} is not set: the navigation VNF is started by `cotorra run`, not by hand")]
    Environment(&'static str),
    /// The name of the robot is none.
    #[error(transparent)]
    Robot(#[from] cotorra_graph::id::InvalidId),
    /// The testbed file changed under the run's feet.
    #[error("the run's testbed file cannot be read: {0}")]
    Testbed(String),
    /// A setting is none.
    #[error(transparent)]
    Setting(#[from] InvalidSetting),
    /// There is nothing to navigate.
    #[error(transparent)]
    NoWalk(#[from] NoWalk),
    /// The socket fails.
    #[error("port {NAVIGATION_PORT}: {0}")]
    Socket(#[from] io::Error),
}

/// Serves the robot that `COTORRA_ROBOT` names until the process ends.
///
/// # Errors
/// [`NavigationError`]; it never returns otherwise.
pub fn navigation() -> Result<Infallible, NavigationError> {
    let text = |name| env::var(name).map_err(|_| NavigationError::Environment(name));
    let file = PathBuf::from(text(TESTBED)?);
    let robot = NodeId::new(&text(ROBOT)?)?;
    let settings = env::var(SETTINGS).unwrap_or_default();
    let settings = settings.lines().map(str::parse).collect::<Result<Vec<_>, _>>()?;
    let testbed = testbed_file::load_with(&file, &settings)
        .map_err(|problems| NavigationError::Testbed(problems.to_string()))?;
    let vnf = NavigationVnf::new(&testbed, &robot)?;
    let socket = UdpSocket::bind(("0.0.0.0", NAVIGATION_PORT))?;
    // A server's CPUs are its own; those of this machine may be busy with something else. It works for microseconds.
    cotorra_datapath::be_punctual();
    println!("{READY}");
    Ok(serve(vnf, &socket)?)
}
