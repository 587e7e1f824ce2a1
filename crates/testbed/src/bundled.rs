//! The bundled VNFs as programs: `cotorra vnf navigation` and `cotorra vnf localization`, started by the VIM in a node's
//! namespace.

use std::{convert::Infallible, env, io, net::UdpSocket, path::PathBuf};

use cotorra_brain::{NavigationVnf, NoWalk};
use cotorra_graph::{NodeId, Testbed};
use cotorra_network_control::vim::READY;
use cotorra_plugin::vnf;
use cotorra_robot_middleware::{LocalizationVnf, NotLocalized};
use cotorra_testbed_file::InvalidSetting;

/// The testbed file that the run uses.
pub(crate) const TESTBED: &str = "COTORRA_TESTBED";
/// The settings with which the run read it, one a line.
pub(crate) const SETTINGS: &str = "COTORRA_TESTBED_SETTINGS";
/// The robot that is served.
pub(crate) const ROBOT: &str = "COTORRA_ROBOT";
/// The UDP port where the VNF is to listen.
pub(crate) const PORT: &str = "COTORRA_PORT";

/// Why a bundled VNF does not serve.
#[derive(Debug, thiserror::Error)]
pub enum VnfError {
    /// It was started by hand.
    #[error("{0} is not set, or none: VNFs are started by `cotorra run`, not by hand")]
    Environment(&'static str),
    /// The name of the robot is none.
    #[error(transparent)]
    Robot(#[from] cotorra_graph::InvalidId),
    /// The testbed file changed under the run's feet.
    #[error("the run's testbed file cannot be read: {0}")]
    Testbed(String),
    /// A setting is none.
    #[error(transparent)]
    Setting(#[from] InvalidSetting),
    /// There is nothing to navigate.
    #[error(transparent)]
    NoWalk(#[from] NoWalk),
    /// There is nothing to localize.
    #[error(transparent)]
    NotLocalized(#[from] NotLocalized),
    /// The socket fails.
    #[error("port {port}: {source}")]
    Socket {
        /// Where it listens.
        port: u16,
        /// What the system says.
        source: io::Error,
    },
}

/// Navigates the robot that `COTORRA_ROBOT` names until the process ends.
///
/// # Errors
/// [`VnfError`]; it never returns otherwise.
pub fn navigation() -> Result<Infallible, VnfError> {
    let (testbed, robot, port) = asked()?;
    let vnf = NavigationVnf::new(&testbed, &robot)?;
    serve(port, |socket| {
        // A server's CPUs are its own; those of this machine may be busy with something else. It works for microseconds.
        cotorra_datapath::be_punctual();
        cotorra_brain::serve(vnf, socket)
    })
}

/// Localizes the robot that `COTORRA_ROBOT` names until the process ends.
///
/// # Errors
/// [`VnfError`]; it never returns otherwise.
pub fn localization() -> Result<Infallible, VnfError> {
    let (testbed, robot, port) = asked()?;
    let mut vnf = LocalizationVnf::new(&testbed, &robot, testbed.seed)?;
    // It works for longer than anyone else may be held up, and nobody measures how fast it answers.
    serve(port, |socket| {
        vnf::log(format_args!("localizing `{}`", vnf.robot()));
        vnf::serve(socket, |datagram, answer| vnf.answer(datagram, answer))
    })
}

/// The run's testbed, the robot that is to be served, and where.
fn asked() -> Result<(Testbed, NodeId, u16), VnfError> {
    let text = |name| env::var(name).map_err(|_| VnfError::Environment(name));
    let file = PathBuf::from(text(TESTBED)?);
    let robot = NodeId::new(&text(ROBOT)?)?;
    let port = text(PORT)?.parse().map_err(|_| VnfError::Environment(PORT))?;
    let settings = env::var(SETTINGS).unwrap_or_default();
    let settings = settings.lines().map(str::parse).collect::<Result<Vec<_>, _>>()?;
    let testbed = cotorra_testbed_file::load_with(&file, &settings)
        .map_err(|problems| VnfError::Testbed(problems.to_string()))?;
    Ok((testbed, robot, port))
}

/// Says that it is ready once it can be reached, and serves.
fn serve(
    port: u16,
    serve: impl FnOnce(&UdpSocket) -> io::Result<Infallible>,
) -> Result<Infallible, VnfError> {
    let failed = |source| VnfError::Socket { port, source };
    let socket = UdpSocket::bind(("0.0.0.0", port)).map_err(failed)?;
    println!("{READY}");
    serve(&socket).map_err(failed)
}
