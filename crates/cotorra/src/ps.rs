//! `cotorra ps`: lists the user's runs on this machine.

use clap::Args;
use cotorra_plugin::runs::{RunEntry, Runs};
use miette::{IntoDiagnostic, miette};
use serde_json::json;

use crate::{output, running::WhichRun, table::Table};

/// List your runs and replays on this machine
///
/// Each line has a run's testbed, the address of its API, its process and its folder. All of these but the process choose
/// a run for --run. Runs in virtual time are listed only if they serve an API.
#[derive(Debug, Args)]
#[command(after_long_help = r#"Examples:
  cotorra ps
  cotorra ps --json
  cotorra link show --run corridor       one of the runs by its name
  curl --unix-socket "$(cotorra ps --socket)" http://localhost/api/v1/robots"#)]
pub struct PsArgs {
    /// Write JSON
    #[arg(long)]
    pub json: bool,
    /// Print only the path of the run's socket, on which whoever can open it is the run's user
    #[arg(long, conflicts_with = "json")]
    pub socket: bool,
    #[command(flatten)]
    pub run: WhichRun,
}

/// Lists the runs. Fails after that if an entry cannot be read or trusted.
pub fn ps(args: &PsArgs) -> miette::Result<()> {
    let runs = Runs::of_user();
    if args.socket {
        return output::print_exact(&format!("{}\n", args.run.entry(&runs)?.socket().display()));
    }
    let (mut running, refused) = runs.running();
    if let Some(wanted) = args.run.named() {
        running.retain(|run| run.is(wanted));
    }
    output::print_either(args.json, &if args.json { json(&running)? } else { table(&running) })?;
    refused.map_or(Ok(()), |error| Err(miette!("{error}")))
}

fn table(running: &[RunEntry]) -> String {
    if running.is_empty() {
        return "no testbed of yours runs on this machine\n".to_owned();
    }
    let mut table = Table::new("<<><");
    table.row(["name", "API", "process", "run"]);
    for run in running {
        let url = format!("http://{}", run.api);
        table.row([run.name.clone(), url, run.process.to_string(), run.what.clone()]);
    }
    table.render("")
}

fn json(running: &[RunEntry]) -> miette::Result<String> {
    let object = |run: &RunEntry| {
        let api = format!("http://{}", run.api);
        json!({ "name": run.name, "api": api, "process": run.process, "run": run.what })
    };
    let runs: Vec<_> = running.iter().map(object).collect();
    Ok(serde_json::to_string_pretty(&runs).into_diagnostic()? + "\n")
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use super::*;

    #[test]
    fn runs_are_listed_with_all_that_chooses_them() {
        let folder = TempDir::new().unwrap();
        let runs = Runs::in_folder(folder.path().join("cotorra"));
        assert_eq!(table(&runs.running().0), "no testbed of yours runs on this machine\n");
        let _run = runs.announce(([127, 0, 0, 1], 7701).into(), "walk", "/runs/walk-1").unwrap();
        let (running, process) = (runs.running().0, std::process::id());
        let text = table(&running);
        let cells: Vec<_> = text.lines().nth(1).unwrap().split_whitespace().collect();
        assert_eq!(cells, ["walk", "http://127.0.0.1:7701", &process.to_string(), "/runs/walk-1"]);
        let read: serde_json::Value = serde_json::from_str(&json(&running).unwrap()).unwrap();
        assert_eq!(read[0]["name"], "walk");
        assert_eq!(read[0]["process"], process);
    }
}
