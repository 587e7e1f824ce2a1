//! `cotorra exec`: runs a program inside a node of the running testbed, in this terminal.

use std::{
    os::fd::AsFd,
    path::PathBuf,
    process::{Command, ExitCode},
};

use clap::Args;
use cotorra_datapath::{HostsFile, Namespace, SpawnOptions, open_process};
use cotorra_graph::{HardwareGraph, NodeId};
use cotorra_plugin::runs::{RunEntry, Runs};

use crate::running::{self, WhichRun, explained, token_text};

/// Run a program inside a node of the running testbed
///
/// The program has the node's network and host name, in `/sys`, too; files, user and terminal stay the same. It reaches other
/// nodes by their names. It ends with the run, and so do all processes that it started. The run must be yours, on this machine.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra exec robot -- ping -c 3 cloud
  cotorra exec edge -- iperf3 -s
  cotorra exec robot -- bash
  cotorra exec robot --run corridor -- bash            one of several runs

Exit status: the program's.")]
pub struct ExecArgs {
    /// The node
    pub node: NodeId,
    /// The program and its arguments
    #[arg(required = true, last = true, value_name = "COMMAND")]
    pub command: Vec<String>,
    #[command(flatten)]
    pub run: WhichRun,
}

/// Exit code of a program that was killed.
const KILLED: i32 = 128 + 9;

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum Error {
    #[error(transparent)]
    #[diagnostic(transparent)]
    Run(#[from] running::Error),
    #[error(
        "`{0}` is a switch, a gateway or a real machine, which has no network namespace to run a program in"
    )]
    Switch(NodeId),
    #[error("the run says that `{node}` is {}, which its process {process} does not hold", namespace.display())]
    #[diagnostic(help("the program was not started; please report this as a bug, with the run's folder"))]
    Foreign { node: NodeId, namespace: PathBuf, process: u32 },
    #[error("process {0} is not the run's: the run ended just now, or is in another PID namespace")]
    #[diagnostic(help("enter the container of the run, if it is in one"))]
    OtherProcess(u32),
    #[error("cannot enter `{node}`: {reason}")]
    #[diagnostic(help("run it as the user who runs the testbed"))]
    Enter { node: NodeId, reason: cotorra_datapath::Error },
    #[error(transparent)]
    Program(cotorra_datapath::Error),
}

/// Runs the program, and returns its exit code. The program ends with this process, and with the run.
pub fn exec(args: &ExecArgs) -> Result<ExitCode, Error> {
    let Place { run, namespace, graph } = find(args, &Runs::of_user(), token_text())?;
    let process = open_process(run.process).map_err(|_| Error::OtherProcess(run.process))?;
    let namespace =
        Namespace::open(&namespace).map_err(|reason| Error::Enter { node: args.node.clone(), reason })?;
    // Only now: until the namespace and the process are open, the kernel may reuse the number for another process.
    if !run.is_its_process() {
        return Err(Error::OtherProcess(run.process));
    }
    let (program, arguments) =
        args.command.split_first().expect("the command line asks for one word or more");
    let hosts = HostsFile::of(&graph)
        .inspect_err(|error| note!("node names are not known to `{program}`: {error}"))
        .ok();
    let mut command = Command::new(program);
    command.args(arguments).env("COTORRA_NODE", args.node.as_str());
    command.envs(graph.ros1_environment(&args.node));
    let options = SpawnOptions {
        hosts: hosts.as_ref(),
        hostname: Some(args.node.as_str()),
        ends_with: Some(process.as_fd()),
        ..SpawnOptions::default()
    };
    let status = namespace.run_program(command, options).map_err(Error::Program)?;
    if status.code() == Some(KILLED) && !run.is_its_process() {
        note!("the run ended, and `{program}` with it");
    }
    Ok(status.code().and_then(|code| u8::try_from(code).ok()).map_or(ExitCode::FAILURE, ExitCode::from))
}

#[derive(Debug)]
struct Place {
    run: RunEntry,
    namespace: PathBuf,
    graph: HardwareGraph,
}

/// Asks the run for the namespace of the node.
///
/// Rejects a namespace that the run's own process does not hold, because root could be made to enter any process.
fn find(args: &ExecArgs, runs: &Runs, token: Option<String>) -> Result<Place, Error> {
    let (run, client) = args.run.find(runs, token)?;
    let failed = |error| Error::Run(explained(run.api, error));
    let node = args.node.clone();
    let namespace = client.node(&node).map_err(failed)?.namespace;
    let namespace = namespace.ok_or_else(|| Error::Switch(node.clone()))?;
    if !run.holds(&namespace) {
        return Err(Error::Foreign { node, namespace, process: run.process });
    }
    let graph = client.testbed().map_err(failed)?.graph;
    Ok(Place { run, namespace, graph })
}

#[cfg(test)]
mod tests {
    use std::{net::SocketAddr, process};

    use super::*;
    use crate::running::tests::{Served, Squatter};

    fn in_robot(api: SocketAddr) -> ExecArgs {
        let (node, command) = (NodeId::new("robot").unwrap(), vec!["true".to_owned()]);
        ExecArgs { node, command, run: WhichRun { run: Some(api.to_string()) } }
    }

    #[test]
    fn exec_enters_only_namespaces_that_the_run_holds() {
        let squatter = Squatter::new();
        let own = format!("/proc/{}/fd/7", process::id());
        for foreign in ["/proc/1/ns/net", "/proc/1/fd/7", "/run/netns/x", &format!("{own}/../../../1/ns/net")]
        {
            let answer = format!(r#"{{"address": null, "namespace": "{foreign}"}}"#);
            let served = Served::on(squatter.address(), vec![answer]);
            let refused = find(&in_robot(squatter.address()), &served.runs, None).unwrap_err();
            assert!(matches!(refused, Error::Foreign { .. }), "{foreign}: {refused}");
            served.requests();
        }
        let node = format!(r#"{{"address": null, "namespace": "{own}"}}"#);
        let testbed = r#"{"name": "t", "graph": {"domains": [], "nodes": [], "links": [], "wireless": {}},
            "services": [], "walks": []}"#;
        let served = Served::on(squatter.address(), vec![node, testbed.to_owned()]);
        let place = find(&in_robot(squatter.address()), &served.runs, None).unwrap();
        assert_eq!(place.namespace, PathBuf::from(own));
        served.requests();
        squatter.received_nothing();
    }
}
