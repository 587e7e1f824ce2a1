//! `cotorra-lab experiment federation`: hands a robot over to another domain, on ledgers with several block periods.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    time::Duration,
};

use cotorra::{AccessArgs, Loaded, Stage, Status, count, demand_approval, note, overview, print, tokens};
use cotorra_comparisons::federation::{
    Access, Comparison, FILES, Federated, LedgerBackend, LedgerError, Network, NoFederation, dishonest,
    domains, longest, settings,
};
use cotorra_graph::DomainId;
use cotorra_measurements::{History, RunId};
use cotorra_plugin::runs::Runs;
use cotorra_testbed::{FolderError, Made, Manifest, Options, Place, Recorded, RecordedError, Repeat, Time};
use cotorra_testbed_file::Setting;

use super::{
    args::{FederationArgs, LedgerArgs, LedgerNode},
    folder::{begin, sound, withdraw},
    tell_faults,
};

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Recorded(#[from] RecordedError),
    #[error(transparent)]
    History(#[from] cotorra_measurements::Error),
    #[error("no run has a complete federation; the last of them, {folder}: {source}")]
    #[diagnostic(help("`cotorra history events {folder} --kinds decision` shows what happened"))]
    None { folder: String, source: NoFederation },
    #[error("stopped during the first run, which is in {folder}")]
    Stopped { folder: String },
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    #[error(
        "a network has one block period: give --block-period one value, or leave it out to have it measured"
    )]
    Periods,
    #[error("the testbed has no orchestrator for `{unknown}`, only for {domains}")]
    NoSuchDomain { unknown: DomainId, domains: String },
    #[error(
        "`{domain}` has no node: add --ledger {domain}=ws://…, or one without a domain for all remaining domains"
    )]
    NoNode { domain: DomainId },
    #[error("{keys}: {reason}", keys = keys.display())]
    Keys { keys: PathBuf, reason: std::io::Error },
}

/// Default block periods.
const PERIODS: [Duration; 5] = [
    Duration::from_millis(500),
    Duration::from_secs(1),
    Duration::from_secs(2),
    Duration::from_secs(5),
    Duration::from_secs(10),
];

/// A run of the experiment.
struct Planned {
    block_period: Duration,
    seed: u64,
    loaded: Loaded,
}

/// Runs the robot's walk with each block period.
pub fn federation(args: &FederationArgs) -> miette::Result<ExitCode> {
    if args.dishonest {
        print(&dishonest::table(args.runs))?;
        return Ok(ExitCode::SUCCESS);
    }
    let how = if args.emulate { "emulated with real packets" } else { "in virtual time" };
    if args.walks.dry_run {
        print(&describe_plan(args, how)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    let (on, periods) = ledger(args)?;
    let planned = plan(args, &on, &periods)?;
    for plan in &planned {
        demand_approval(&plan.loaded, &args.testbed, args.walks.trust)?;
    }
    // Before the stage is set, because the user namespace that it may enter has another user.
    let known = Runs::of_user();
    let stage = Stage::set(args.walks.headless, args.walks.verbose, args.emulate)?;
    let folder = Place::In(args.walks.out.clone()).create("experiment-federation").map_err(Error::from)?;
    let mut seeds: Vec<_> = planned.iter().map(|plan| plan.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let time = if args.emulate { Time::Real } else { Time::Virtual };
    begin(
        &folder,
        &args.testbed,
        &args.walks,
        &Made { time, inexact: None, seeds, until: args.until },
        |_| {
            Ok(match args.ledger.nodes.is_empty() {
                true => Repeat::Words(Vec::new()),
                false => Repeat::Not(
                    "it negotiated on an Ethereum network, with keys that it did not copy".to_owned(),
                ),
            })
        },
    )?;
    // A run that fails or is stopped does not affect the results of the others.
    let (mut runs, mut failed, mut worst) = (Vec::new(), Vec::new(), Status::Done);
    for (number, plan) in planned.iter().enumerate() {
        let name = format!("{number:03}-{}s", plan.block_period.as_secs_f64());
        let options = Options {
            seed: Some(plan.seed),
            until: Some(args.until.unwrap_or_else(|| longest(&plan.loaded.testbed))),
            folder: Place::At(folder.join(&name)),
            runs: Some(known.clone()),
            tokens: tokens(&AccessArgs::default())?,
            save_power: args.power.save_power,
            ..Options::default()
        };
        let what = format!("{name}: ");
        let finished = if args.emulate {
            note!("{what}{} of {}", number + 1, planned.len());
            stage.emulate(&plan.loaded, &args.testbed, options)
        } else {
            stage.simulate(&plan.loaded, options, &what)
        };
        let finished = finished.inspect_err(|_| withdraw(&folder))?;
        let at = finished.folder.display().to_string();
        if finished.was_stopped() {
            if runs.is_empty() {
                return Err(Error::Stopped { folder: at }.into());
            }
            worst = worst.max(Status::Interrupted);
            break;
        }
        let finished = sound(finished)?;
        let testbed = &plan.loaded.testbed;
        let read = |history: &History, run: RunId| {
            Federated::read(history, run, testbed, plan.block_period, plan.seed)
        };
        let recorded = Recorded::of_folder(&finished.folder).map_err(Error::from)?;
        let history = History::open(&recorded.history).map_err(Error::from)?;
        match read(&history, finished.run) {
            Ok(run) => runs.push(run),
            Err(source) => failed.push((at, source)),
        }
        tell_faults(&name, &finished);
        worst = worst.max(Status::of_run(&finished));
    }
    if runs.is_empty()
        && let Some((folder, source)) = failed.pop()
    {
        return Err(Error::None { folder, source }.into());
    }
    let comparison = Comparison { how: how.to_owned(), ledger: on.to_string(), runs };
    comparison.write(&folder).map_err(Error::from)?;
    if comparison.runs.len() + failed.len() == planned.len() {
        Manifest::complete(&folder).map_err(Error::from)?;
    }
    for format in args.walks.figure.further() {
        comparison.write_figure(&folder, format).map_err(Error::from)?;
    }
    let mut text = comparison.to_markdown();
    let files = FILES.join("  ") + &args.walks.figure.files("federation");
    text += &format!("\n{}/\n  {files}  {}\n", folder.display(), count(planned.len(), "run"));
    for (folder, source) in &failed {
        text += &format!("NOT COUNTED: {folder}: {source}\n");
    }
    print(&text)?;
    let counted = if failed.is_empty() { Status::Done } else { Status::NotValid };
    Ok(worst.max(counted).into())
}

/// Returns the ledger, and the block periods to run on it.
fn ledger(args: &FederationArgs) -> miette::Result<(LedgerBackend, Vec<Duration>)> {
    let periods = if args.block_period.is_empty() { PERIODS.to_vec() } else { args.block_period.clone() };
    let LedgerArgs { nodes, keys, contract, depth, network: called } = &args.ledger;
    // The command line accepts nodes only with keys.
    let Some(keys) = keys.as_deref().filter(|_| !nodes.is_empty()) else {
        return Ok((if args.emulate { LedgerBackend::Anvil } else { LedgerBackend::Modelled }, periods));
    };
    let given = match &args.block_period[..] {
        [] => None,
        [period] => Some(*period),
        _ => return Err(Error::Periods.into()),
    };
    let accesses = accesses(args, nodes, keys)?;
    note!("connecting to the network …");
    let network = Network::join(accesses, *contract, *depth, given).map_err(Error::from)?;
    let Network { contract: address, from_block, block_period, .. } = &network;
    let seconds = block_period.as_secs_f64();
    if contract.is_none() {
        note!("deployed a new contract: --contract {address}@{from_block} uses it again");
    }
    note!("the block period is {seconds:.2} s");
    let periods = vec![*block_period];
    Ok((LedgerBackend::Network { network, called: called.clone() }, periods))
}

/// Returns the node and the key store of each domain.
fn accesses(args: &FederationArgs, nodes: &[LedgerNode], keys: &Path) -> miette::Result<Vec<Access>> {
    let testbed = cotorra::load(&args.testbed, &args.walks.settings)?.testbed;
    let domains = domains(&testbed);
    if let Some(unknown) = nodes.iter().filter_map(|n| n.domain.as_ref()).find(|d| !domains.contains(d)) {
        let domains = domains.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        return Err(Error::NoSuchDomain { unknown: unknown.clone(), domains }.into());
    }
    let access = |domain: DomainId| {
        let own = nodes.iter().find(|node| node.domain.as_ref() == Some(&domain));
        let node = own.or_else(|| nodes.iter().find(|node| node.domain.is_none()));
        let url = node.ok_or_else(|| Error::NoNode { domain: domain.clone() })?.url.clone();
        let key_store = std::path::absolute(keys.join(format!("{domain}.json")));
        let key_store = key_store.map_err(|reason| Error::Keys { keys: keys.to_owned(), reason })?;
        Ok(Access { domain, url, key_store })
    };
    Ok(domains.into_iter().map(access).collect::<Result<_, Error>>()?)
}

fn plan(args: &FederationArgs, on: &LedgerBackend, periods: &[Duration]) -> miette::Result<Vec<Planned>> {
    let plain = cotorra::load(&args.testbed, &args.walks.settings)?;
    let mut planned = Vec::new();
    for block_period in periods {
        for number in 0..args.runs {
            // Runs are spread over a block period, so that announcements fall on all of its phases.
            let phase = (f64::from(number) + 0.5) / f64::from(args.runs);
            let for_blocks = settings(&plain.testbed, on, *block_period, phase).into_iter();
            let for_blocks = for_blocks.map(|(path, value)| {
                Setting::new(&path, &value).expect("paths and values of the experiment are settings")
            });
            // The user's settings come last, so that they take precedence.
            let settings: Vec<_> = for_blocks.chain(args.walks.settings.iter().cloned()).collect();
            let loaded = cotorra::load(&args.testbed, &settings)?;
            let seed = args.seed.unwrap_or(plain.testbed.seed) + u64::from(number);
            planned.push(Planned { block_period: *block_period, seed, loaded });
        }
    }
    Ok(planned)
}

fn describe_plan(args: &FederationArgs, how: &str) -> miette::Result<String> {
    let loaded = cotorra::load(&args.testbed, &args.walks.settings)?;
    let mut text = format!("{}: {}\n\n", args.testbed.display(), overview(&loaded.testbed));
    let runs = count(args.runs as usize, "run");
    if args.ledger.nodes.is_empty() {
        let (on, periods) = ledger(args)?;
        for block_period in periods {
            let seconds = block_period.as_secs_f64();
            text += &format!("  {runs} with a block each {seconds} s, {how}, on {on}\n");
        }
    } else {
        // No node is contacted, because joining could deploy a contract.
        let called = args.ledger.network.as_deref().unwrap_or("an Ethereum network");
        text += &format!("  {runs}, {how}, on {called}\n");
    }
    let folder = args.walks.out.join("experiment-federation-<time>");
    Ok(text + &format!("\n{}/\n  {}\n", folder.display(), FILES.join("  ")))
}
