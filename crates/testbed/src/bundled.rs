//! The bundled VNFs as programs: `cotorra vnf navigation` and `cotorra vnf localization`. The VIM starts them in a node's
//! namespace.

use std::{convert::Infallible, env, io, net::UdpSocket, path::PathBuf};

use cotorra_brain::{NavigationVnf, NoWalk};
use cotorra_graph::{NodeId, Testbed};
use cotorra_network_control::vim::READY;
use cotorra_plugin::vnf;
use cotorra_robot_middleware::{LocalizationVnf, NotLocalized};

/// Path of the run's testbed file.
pub(crate) const TESTBED: &str = "COTORRA_TESTBED";
/// Name of the served robot.
pub(crate) const ROBOT: &str = "COTORRA_ROBOT";
/// UDP port of the VNF.
pub(crate) const PORT: &str = "COTORRA_PORT";

/// Error of a bundled VNF.
#[derive(Debug, thiserror::Error)]
pub enum VnfError {
    /// A variable is missing: the VNF was started by hand.
    #[error("{0} is not set or invalid: VNFs are started by `cotorra run`, not by hand")]
    Environment(&'static str),
    /// The robot's name is invalid.
    #[error(transparent)]
    Robot(#[from] cotorra_graph::InvalidId),
    /// The testbed file changed during the run.
    #[error("the run's testbed file cannot be read: {0}")]
    Testbed(String),
    /// The robot has no walk.
    #[error(transparent)]
    NoWalk(#[from] NoWalk),
    /// The robot is not localized.
    #[error(transparent)]
    NotLocalized(#[from] NotLocalized),
    /// The socket fails.
    #[error("port {port}: {source}")]
    Socket {
        port: u16,
        /// The system's error.
        source: io::Error,
    },
}

/// Navigates the robot named by `COTORRA_ROBOT` until the process ends.
///
/// # Errors
/// [`VnfError`]; never returns otherwise.
pub fn navigation() -> Result<Infallible, VnfError> {
    let (testbed, robot, port) = asked()?;
    let vnf = NavigationVnf::new(&testbed, &robot)?;
    serve(port, |socket| {
        // A node's CPUs are its own, but this machine's CPUs may be busy. Navigation works for microseconds.
        cotorra_datapath::be_punctual();
        cotorra_brain::serve(vnf, socket)
    })
}

/// Localizes the robot named by `COTORRA_ROBOT` until the process ends.
///
/// # Errors
/// [`VnfError`]; never returns otherwise.
pub fn localization() -> Result<Infallible, VnfError> {
    let (testbed, robot, port) = asked()?;
    let mut vnf = LocalizationVnf::new(&testbed, &robot, testbed.seed)?;
    // No higher priority: localization works for longer than others can be held up, and its answer time is not measured.
    serve(port, |socket| {
        vnf::log(format_args!("localizing `{}`", vnf.robot()));
        vnf::serve(socket, |datagram, answer| vnf.answer(datagram, answer))
    })
}

/// Returns the run's testbed, the served robot, and the VNF's port.
fn asked() -> Result<(Testbed, NodeId, u16), VnfError> {
    let text = |name| env::var(name).map_err(|_| VnfError::Environment(name));
    let file = PathBuf::from(text(TESTBED)?);
    let robot = NodeId::new(&text(ROBOT)?)?;
    let port = text(PORT)?.parse().map_err(|_| VnfError::Environment(PORT))?;
    let testbed =
        cotorra_testbed_file::load(&file).map_err(|problems| VnfError::Testbed(problems.to_string()))?;
    Ok((testbed, robot, port))
}

/// Reports that the VNF is ready once it can be reached, and serves.
fn serve(
    port: u16,
    serve: impl FnOnce(&UdpSocket) -> io::Result<Infallible>,
) -> Result<Infallible, VnfError> {
    let failed = |source| VnfError::Socket { port, source };
    let socket = UdpSocket::bind(("0.0.0.0", port)).map_err(failed)?;
    println!("{READY}");
    serve(&socket).map_err(failed)
}
