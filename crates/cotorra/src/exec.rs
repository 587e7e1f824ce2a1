//! `cotorra exec`: runs a program inside a node of the running testbed, in the terminal at hand.

use std::{convert::Infallible, io, net::SocketAddr, os::unix::process::CommandExt, process::Command};

use clap::Args;
use cotorra_datapath::HostsFile;
use cotorra_graph::{NodeId, ros1_environment};
use cotorra_plugin::client::{Client, ClientError};

use crate::run::{DEFAULT_API, token_text};

/// Run a program inside a node of the running testbed
///
/// The program sees the node's network and nothing else changes: same files, same user, same terminal. Nodes have
/// their names.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra exec robot -- ping -c 3 cloud
  cotorra exec edge -- iperf3 -s
  cotorra exec robot -- bash

Exit status: the program's.")]
pub struct ExecArgs {
    /// The node.
    pub node: NodeId,
    /// The program and its arguments.
    #[arg(required = true, last = true, value_name = "COMMAND")]
    pub command: Vec<String>,
    /// Address of the run's API, as its terminal shows it
    #[arg(long, value_name = "ADDR:PORT", default_value = DEFAULT_API)]
    pub api: SocketAddr,
}

/// Why the program does not run.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum Error {
    #[error("no testbed answers at {api}: {reason}")]
    #[diagnostic(help("start one with `cotorra run`; if it says another address, name that with --api"))]
    NoRun { api: SocketAddr, reason: String },
    #[error(transparent)]
    Api(ClientError),
    #[error("`{0}` is a switch or a real machine: it has no network namespace to run a program in")]
    Switch(NodeId),
    #[error("cannot enter `{node}`: {reason}")]
    #[diagnostic(help("run it as the user who runs the testbed"))]
    Enter { node: NodeId, reason: cotorra_datapath::Error },
    #[error("cannot run `{program}`: {reason}")]
    Program { program: String, reason: io::Error },
}

/// Becomes the program; returns only if that fails.
pub fn exec(args: &ExecArgs) -> Result<Infallible, Error> {
    let failed = |error| match error {
        ClientError::Unreachable { source, .. } => Error::NoRun { api: args.api, reason: source.to_string() },
        other => Error::Api(other),
    };
    let mut client = Client::new(&format!("http://{}", args.api)).map_err(failed)?;
    if let Some(token) = token_text() {
        client = client.with_token(token);
    }
    let node = client.node(&args.node).map_err(failed)?;
    let namespace = node.namespace.ok_or_else(|| Error::Switch(args.node.clone()))?;
    let graph = client.testbed().map_err(failed)?.graph;
    cotorra_datapath::enter(&namespace).map_err(|reason| Error::Enter { node: args.node.clone(), reason })?;
    if let Err(error) = HostsFile::of(&graph).and_then(|hosts| hosts.enter()) {
        note!("node names are not known to `{}`: {error}", args.command[0]);
    }
    let (program, arguments) =
        args.command.split_first().expect("the command line asks for one word or more");
    let mut command = Command::new(program);
    command.args(arguments).env("COTORRA_NODE", args.node.as_str());
    let reason = command.envs(ros1_environment(&graph, &args.node)).exec();
    Err(Error::Program { program: program.clone(), reason })
}
