//! The programs: each serves one robot until its process ends.

use std::{convert::Infallible, env, io, net::UdpSocket, path::PathBuf};

use cotorra_brain::{NavigationVnf, NoWalk};
use cotorra_engine::READY;
use cotorra_graph::{NodeId, Testbed};
use cotorra_plugin::vnf;

use crate::{
    computer::{Computer, NoDistribution},
    localization::{LocalizationVnf, NotLocalized},
};

/// Path of the run's testbed file.
pub const TESTBED: &str = "COTORRA_TESTBED";
/// Name of the served robot.
pub const ROBOT: &str = "COTORRA_ROBOT";
/// UDP port of the VNF.
pub const PORT: &str = "COTORRA_PORT";

/// Folder of a container in which it finds the testbed file, and what this names.
pub const FILES: &str = "/run/cotorra";

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
    /// The VNF of this process has a demand that it cannot compute.
    #[error(transparent)]
    Demand(#[from] NoDistribution),
    /// The socket fails.
    #[error("port {port}: {source}")]
    Socket {
        port: u16,
        /// The system's error.
        source: io::Error,
    },
}

/// Navigates the robot named by `COTORRA_ROBOT` until the process ends. Calls `hasten` on the thread that answers: navigation works
/// for microseconds, and must not wait for other work of the machine. With a demand it works for longer, and waits like all
/// others.
///
/// # Errors
/// [`VnfError`]; never returns otherwise.
pub fn navigation(hasten: impl FnOnce()) -> Result<Infallible, VnfError> {
    let Assignment { testbed, robot, port } = assignment()?;
    let computer = Computer::of(&testbed)?;
    let vnf = NavigationVnf::new(&testbed, &robot)?;
    serve(port, |socket| match computer {
        Some(computer) => cotorra_brain::serve(vnf, socket, computer.start(socket)?),
        None => {
            hasten();
            cotorra_brain::serve(vnf, socket, vnf::at_once(socket))
        }
    })
}

/// Localizes the robot named by `COTORRA_ROBOT` until the process ends.
///
/// # Errors
/// [`VnfError`]; never returns otherwise.
pub fn localization() -> Result<Infallible, VnfError> {
    let Assignment { testbed, robot, port } = assignment()?;
    let computer = Computer::of(&testbed)?;
    let mut vnf = LocalizationVnf::new(&testbed, &robot, testbed.seed)?;
    // No higher priority: localization works for longer than others can be held up, and its answer time is not measured.
    serve(port, |socket| {
        vnf::log(format_args!("localizing `{}`", vnf.robot()));
        let answer = |datagram: &[u8], answer: &mut Vec<u8>| vnf.answer(datagram, answer);
        match computer {
            Some(computer) => vnf::serve(socket, answer, computer.start(socket)?),
            None => vnf::serve(socket, answer, vnf::at_once(socket)),
        }
    })
}

/// What a bundled VNF serves.
#[derive(Debug)]
pub struct Assignment {
    /// The run's testbed.
    pub testbed: Testbed,
    /// The served robot.
    pub robot: NodeId,
    /// UDP port of the VNF.
    pub port: u16,
}

/// Returns what the variables of this process say.
///
/// # Errors
/// [`VnfError`] if one is missing or invalid, or the testbed file cannot be read.
pub fn assignment() -> Result<Assignment, VnfError> {
    let text = |name| env::var(name).map_err(|_| VnfError::Environment(name));
    let file = PathBuf::from(text(TESTBED)?);
    let robot = NodeId::new(&text(ROBOT)?)?;
    let port = text(PORT)?.parse().map_err(|_| VnfError::Environment(PORT))?;
    let testbed =
        cotorra_testbed_file::load(&file).map_err(|problems| VnfError::Testbed(problems.to_string()))?;
    Ok(Assignment { testbed, robot, port })
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
