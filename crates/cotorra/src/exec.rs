//! `cotorra exec`: runs a program inside a node of the running testbed, in the terminal at hand.

use std::{
    convert::Infallible, io, net::SocketAddr, os::unix::process::CommandExt, path::PathBuf, process::Command,
    time::Duration,
};

use cotorra_datapath::HostsFile;
use cotorra_graph::{HardwareGraph, NodeId};
use serde::Deserialize;

use crate::{cli::ExecArgs, run::token_text};

/// A run on this machine answers at once.
const PATIENCE: Duration = Duration::from_secs(5);

/// Why the program does not run.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum Error {
    #[error("no testbed answers at {api}: {reason}")]
    #[diagnostic(help("start one with `cotorra run`; if it says another address, name that with --api"))]
    NoRun { api: SocketAddr, reason: ureq::Error },
    #[error("{0}")]
    Refused(String),
    #[error("`{0}` is a switch: it has no network namespace to run a program in")]
    Switch(NodeId),
    #[error("cannot enter `{node}`: {reason}")]
    #[diagnostic(help("run it as the user who runs the testbed"))]
    Enter { node: NodeId, reason: cotorra_datapath::Error },
    #[error("cannot run `{program}`: {reason}")]
    Program { program: String, reason: io::Error },
}

/// What the API says of a node, as far as it matters here.
#[derive(Debug, Deserialize)]
struct Node {
    namespace: Option<PathBuf>,
}

/// What the API says of the testbed, likewise.
#[derive(Debug, Deserialize)]
struct Testbed {
    graph: HardwareGraph,
}

/// What the API says when it does not do something.
#[derive(Debug, Deserialize)]
struct Failure {
    error: String,
}

/// Becomes the program; returns only if that fails.
pub fn exec(args: &ExecArgs) -> Result<Infallible, Error> {
    let node: Node = ask(args.api, &format!("/api/v1/network/nodes/{}", args.node))?;
    let namespace = node.namespace.ok_or_else(|| Error::Switch(args.node.clone()))?;
    let testbed: Testbed = ask(args.api, "/api/v1/testbed")?;
    cotorra_datapath::enter(&namespace).map_err(|reason| Error::Enter { node: args.node.clone(), reason })?;
    if let Err(error) = HostsFile::of(&testbed.graph).and_then(|hosts| hosts.enter()) {
        eprintln!("node names are not known to `{}`: {error}", args.command[0]);
    }
    let (program, arguments) =
        args.command.split_first().expect("the command line asks for one word or more");
    let reason = Command::new(program).args(arguments).env("COTORRA_NODE", args.node.as_str()).exec();
    Err(Error::Program { program: program.clone(), reason })
}

fn ask<T: for<'de> Deserialize<'de>>(api: SocketAddr, path: &str) -> Result<T, Error> {
    let agent = ureq::Agent::config_builder().timeout_global(Some(PATIENCE)).proxy(None);
    let agent = agent.http_status_as_error(false).build().new_agent();
    let mut request = agent.get(format!("http://{api}{path}"));
    if let Some(token) = token_text() {
        request = request.header("Authorization", format!("Bearer {token}"));
    }
    let no_run = |reason| Error::NoRun { api, reason };
    let mut answer = request.call().map_err(no_run)?;
    if answer.status().is_success() {
        return answer.body_mut().read_json().map_err(no_run);
    }
    let failure: Failure = answer.body_mut().read_json().map_err(no_run)?;
    Err(Error::Refused(failure.error))
}
