//! `cotorra run`: brings a testbed up, shows its progress, ends it in order, and reports the results.

mod args;
mod lines;
mod plan;
mod summary;
mod tally;
mod twin;
mod view;

use std::{
    env, io,
    path::{Path, PathBuf},
    process::ExitCode,
    sync::mpsc::{self, RecvTimeoutError},
    time::Duration,
};

use cotorra_graph::{DomainId, Timestamp};
use cotorra_netem::{Confirmed, HoldError};
use cotorra_plugin::runs::Runs;
use cotorra_recording::{RecordingPlace, Wanted};
use cotorra_testbed::{
    CannotGoOn, Dashboard, Finished, FolderError, Manifest, Operator, Options, Origin, Place, PreviousRun,
    RealLinkError, Run, RunError, Speed, Time, Token, Tokens, TokensError, Watched, interface_plans,
    simulate_watched,
};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget};

use crate::{
    approval,
    arguments::{AccessArgs, note_network},
    browser::Opener,
    check,
    exit::Status,
    history::{self, HistoryPlace, Source},
    logs::{self, LogFile},
    origin, output,
    running::{TOKEN_VARIABLE, token_text},
    signals,
    testbed_file::{self, Loaded},
};
pub use args::{FOXGLOVE, RunArgs};
use view::{Places, View};

/// Refresh interval of the view. It misses no service time as long as robots send position packets less often.
const REFRESH: Duration = Duration::from_millis(25);

/// Virtual time of the first plain line. Each further one comes after twice the time.
const FIRST_LINE: Duration = Duration::from_secs(60);

/// The environment variable with the tokens of domains.
const DOMAIN_TOKENS_VARIABLE: &str = "COTORRA_DOMAIN_TOKENS";

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum Error {
    #[error(transparent)]
    #[diagnostic(help("`cotorra doctor` says what this machine can do, and what to do about the rest"))]
    Datapath(cotorra_datapath::Error),
    #[error(transparent)]
    #[diagnostic(help("{}", help_for(.0)))]
    RealLink(RealLinkError),
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Run(RunError),
    #[error("{TOKEN_VARIABLE} is too short to be a secret")]
    #[diagnostic(help("use 16 characters or more: {TOKEN_VARIABLE}=$(openssl rand -hex 16)"))]
    Token,
    #[error("--no-token and {TOKEN_VARIABLE} contradict each other")]
    #[diagnostic(help("leave one of them out"))]
    TokenAndNone,
    #[error("{DOMAIN_TOKENS_VARIABLE} is not a list of domains and their tokens")]
    #[diagnostic(help("write it like {DOMAIN_TOKENS_VARIABLE}=\"domain-1=<token> domain-2=<token>\""))]
    DomainTokens,
    #[error(transparent)]
    Tokens(#[from] TokensError),
    #[error("cannot write {}: {source}", path.display())]
    Log { path: PathBuf, source: io::Error },
    #[error("cannot continue after {run}: {why}")]
    #[diagnostic(help(
        "docs/use/federation.md, \"After a crash\", lists the conditions; without --after, the run starts afresh"
    ))]
    After { run: String, why: CannotGoOn },
    #[error("--twin compares with plug-ins beside the core, and no plug-in is away from it")]
    #[diagnostic(help("give one a distance, as in --set \"plugins.okpi.control_delay=100 ms\""))]
    NoDistance,
}

impl From<RunError> for Error {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Datapath(error) => Self::Datapath(error),
            RunError::RealLink(error) => Self::RealLink(error),
            other => Self::Run(other),
        }
    }
}

/// Returns what to do about a link that cannot use an interface of this machine.
fn help_for(error: &RealLinkError) -> &'static str {
    match error {
        RealLinkError::Hold(HoldError::Netem(cotorra_netem::Error::Missing { .. })) => {
            "links to real machines need the kernel's NetEm, which most distributions have: `cotorra doctor` says what is \
             missing; in virtual time (`--simulate`), the fabric emulates these links"
        }
        _ => "`--dry-run` lists what a run would change on interfaces of this machine",
    }
}

/// Runs a testbed.
pub fn run(args: RunArgs) -> miette::Result<ExitCode> {
    let mut loaded = testbed_file::load(&args.file, &args.settings)?;
    let history = history::location(args.history.as_ref())?;
    let mut options = Options {
        origin: Origin::default(),
        seed: args.seed,
        until: args.until,
        folder: Place::In(args.out.clone()),
        api: args.api,
        runs: Some(Runs::of_user()),
        tokens: tokens(&args.access)?,
        encryption: args.encryption(),
        save_power: args.save_power,
        wais_callbacks: args.wais_callbacks.clone(),
        interfaces: Confirmed { replace: args.replace, interfaces: args.allow_interface.clone() },
        history: history.clone(),
        history_limit: args.history_limit,
        recording: recording(&args),
        captures: args.captures.clone(),
        after: None,
        agents: args.agents.options(),
    };
    loaded.warn();
    if args.dry_run {
        previous(&args, &mut loaded)?;
        let interfaces = if args.simulate {
            loaded.testbed.graph.emulate_agents();
            Vec::new()
        } else {
            interface_plans(&loaded.testbed, &options.interfaces).map_err(Error::from)?
        };
        output::print(&plan::describe(&loaded.testbed, &args, history.as_ref(), &interfaces))?;
        return Ok(ExitCode::SUCCESS);
    }
    approval::demand(&loaded, &args.file, args.trust)?;
    check::start_hints(&loaded.testbed).iter().for_each(|hint| note!("{hint}"));
    let opener = Opener::prepare(args.open)?;
    let stage = Stage::set(args.headless, args.verbose, !args.simulate)?;
    // Only now, because a history may have threads, and the stage must be set by a process with a single one.
    options.after = previous(&args, &mut loaded)?;
    let finished = if args.simulate {
        match args.watched() {
            None if args.twin => {
                let base = args.file.parent().unwrap_or(Path::new(""));
                stage.simulate_with_twins(&loaded, base, options)?
            }
            None => stage.simulate(&loaded, options, "")?,
            Some(speed) => stage.simulate_and_show(&loaded, options, speed, opener)?,
        }
    } else {
        stage
            .emulate_and_show(&loaded, &args.file, options, |dashboard| opener.open(|| dashboard.page("")))?
    };
    for format in args.figure.further() {
        finished.write_figure(format).map_err(|error| Error::from(RunError::from(error)))?;
    }
    output::print(&summary::describe(&finished, history.as_ref()))?;
    Ok(Status::of_run(&finished).into())
}

/// Reads the run that --after names: the steps that it noted, and where its robots stood. They start there.
fn previous(args: &RunArgs, loaded: &mut Loaded) -> miette::Result<Option<PreviousRun>> {
    let Some(run) = args.after.as_deref() else { return Ok(None) };
    let place = HistoryPlace { history: args.history.clone(), runs: args.out.clone() };
    let source = Source::find(run, &place)?;
    let own = args.file.parent().unwrap_or(Path::new(""));
    let base = source.folder.as_deref().unwrap_or(own);
    let parse = |text: &str| testbed_file::recorded(text, run, base, None);
    let cannot = |why| Error::After { run: run.to_owned(), why };
    let previous = PreviousRun::read(&source.history, &source.run, &loaded.testbed, parse).map_err(cannot)?;
    let settings: Vec<_> = args.settings.iter().cloned().chain(previous.starts(&loaded.testbed)).collect();
    *loaded = testbed_file::load(&args.file, &settings)?;
    Ok(Some(previous))
}

/// Returns whether the run is recorded, and served to viewers.
fn recording(args: &RunArgs) -> Wanted {
    let file = args.record.clone().map(|file| file.map_or(RecordingPlace::Folder, RecordingPlace::File));
    Wanted { file, foxglove: args.foxglove }
}

/// Terminal, log and Ctrl-C handler of a process, which its runs share.
pub struct Stage {
    terminal: MultiProgress,
    log: LogFile,
    interrupts: mpsc::Receiver<()>,
}

impl Stage {
    /// Prepares the process for runs, with real packets if `real`, or else in virtual time.
    pub fn set(headless: bool, verbose: u8, real: bool) -> miette::Result<Self> {
        if real {
            // Before the first thread starts: only a process with a single thread may enter a user namespace.
            cotorra_datapath::enter_user_namespace_if_needed().map_err(Error::Datapath)?;
            cotorra_datapath::hide_memory().map_err(Error::Datapath)?;
        }
        let target = if headless { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let terminal = MultiProgress::with_draw_target(target);
        let log = logs::begin(verbose, &terminal);
        let interrupts = signals::listen()?;
        Ok(Self { terminal, log, interrupts })
    }

    /// Runs a testbed with real packets to its end.
    pub fn emulate(&self, loaded: &Loaded, file: &Path, options: Options) -> miette::Result<Finished> {
        self.emulate_and_show(loaded, file, options, |_| {})
    }

    /// Does the same as [`Self::emulate`]. `show` receives the dashboard once the run is up.
    fn emulate_and_show(
        &self,
        loaded: &Loaded,
        file: &Path,
        mut options: Options,
        show: impl FnOnce(&Dashboard),
    ) -> miette::Result<Finished> {
        options.origin = origin::of_run(&options, Time::Real, &[]);
        let until = options.until;
        let run = Run::start(loaded.testbed.clone(), &loaded.text, options).map_err(Error::from)?;
        let folder = run.folder().to_owned();
        self.log_to(&folder)?;
        let version = env!("CARGO_PKG_VERSION");
        tracing::info!(version, file = %file.display(), api = %run.api_address(), "up");
        let places = Places {
            api: run.api_address(),
            foxglove: run.foxglove_address(),
            network: run.dashboard().network(),
            folder: &folder,
            wifi: run.wifi(),
        };
        show(run.dashboard());
        let mut view = View::new(&loaded.testbed, until, &places, &self.terminal);
        watch(&run, &mut view, &self.interrupts);
        let finished = run.finish().map_err(Error::from);
        view.close();
        let finished = finished?;
        tracing::info!(ended = finished.summary.ended, valid = finished.summary.is_valid(), "over");
        complete(&finished)?;
        Ok(finished)
    }

    /// Runs a testbed in virtual time, to its end. `prefix` names the run in the progress line; it can be empty.
    pub fn simulate(&self, loaded: &Loaded, options: Options, prefix: &str) -> miette::Result<Finished> {
        self.simulate_as(loaded, options, prefix, false)
    }

    /// Does the same as [`Self::simulate`]. With twins, a repeat has them, too.
    fn simulate_as(
        &self,
        loaded: &Loaded,
        mut options: Options,
        prefix: &str,
        has_twins: bool,
    ) -> miette::Result<Finished> {
        options.origin = origin::of_run(&options, Time::Virtual, if has_twins { &["--twin"] } else { &[] });
        self.show_virtual_time(options, prefix, |options, _, go_on| {
            cotorra_testbed::simulate(loaded.testbed.clone(), &loaded.text, options, go_on)
        })
    }

    /// Does the same as [`Self::simulate`], at a speed that the dashboard can change, and opens the dashboard.
    fn simulate_and_show(
        &self,
        loaded: &Loaded,
        mut options: Options,
        speed: Speed,
        opener: Opener,
    ) -> miette::Result<Finished> {
        options.origin = origin::of_run(&options, Time::Virtual, &[]);
        let mut opener = Some(opener);
        self.show_virtual_time(options, "", |options, spinner, go_on| {
            let mut served = |dashboard: &Dashboard| {
                spinner.suspend(|| {
                    note!("Dashboard on http://{}/", dashboard.address());
                    note_network(dashboard);
                });
                opener.take().into_iter().for_each(|opener| opener.open(|| dashboard.page("")));
            };
            let watched = Watched { speed, served: &mut served };
            simulate_watched(loaded.testbed.clone(), &loaded.text, options, watched, go_on)
        })
    }

    /// Shows the progress of a run in virtual time, which is given a function to call with the time.
    fn show_virtual_time(
        &self,
        options: Options,
        prefix: &str,
        run: impl FnOnce(&Options, &ProgressBar, &mut dyn FnMut(Timestamp) -> bool) -> Result<Finished, RunError>,
    ) -> miette::Result<Finished> {
        let spinner = self.terminal.add(ProgressBar::new_spinner().with_prefix(prefix.to_owned()));
        let mut next_line = FIRST_LINE;
        let finished = run(&options, &spinner, &mut |now| {
            if self.terminal.is_hidden() && now >= Timestamp::ZERO + next_line {
                note!("{prefix}{:.0} s of virtual time", now.as_secs_f64());
                while now >= Timestamp::ZERO + next_line {
                    next_line *= 2;
                }
            }
            spinner.set_message(format!("{prefix}{:.0} s of virtual time", now.as_secs_f64()));
            spinner.tick();
            self.interrupts.try_recv().is_err()
        })
        .map_err(Error::from);
        spinner.finish_and_clear();
        let finished = finished?;
        self.log_to(&finished.folder)?;
        complete(&finished)?;
        Ok(finished)
    }

    fn log_to(&self, folder: &Path) -> Result<(), Error> {
        let path = folder.join("logs/cotorra.log");
        self.log.open(&path).map_err(|source| Error::Log { path, source })
    }
}

/// Notes the results of a run in its manifest. Nothing can end a run again at the moment at which a user did.
fn complete(finished: &Finished) -> Result<(), Error> {
    if finished.was_stopped() { Ok(()) } else { Ok(Manifest::complete(&finished.folder)?) }
}

/// Reads and checks the tokens of the operator and of domains from the environment.
pub fn tokens(access: &AccessArgs) -> Result<Tokens, Error> {
    let token = token_text().map(|text| Token::new(text).ok_or(Error::Token)).transpose()?;
    let operator = match (token, access.no_token) {
        (Some(_), true) => return Err(Error::TokenAndNone),
        (Some(token), false) => Operator::Token(token),
        (None, true) => {
            note!(
                "--no-token: any user and any program of this machine can now steer this run, read its history, and start \
                 programs in its nodes"
            );
            Operator::Everyone
        }
        (None, false) => Operator::User,
    };
    let of_domains = env::var(DOMAIN_TOKENS_VARIABLE).unwrap_or_default();
    let of_domain = |text: &str| {
        let (domain, token) = text.split_once('=').ok_or(Error::DomainTokens)?;
        let domain = DomainId::new(domain).map_err(|_| Error::DomainTokens)?;
        Ok((domain, Token::new(token).ok_or(Error::Token)?))
    };
    let domains = of_domains.split_whitespace().map(of_domain).collect::<Result<_, Error>>()?;
    Ok(Tokens::new(operator, domains)?)
}

/// Shows the progress of a run until it has ended. Ctrl-C stops it.
fn watch(run: &Run, view: &mut View<'_>, interrupts: &mpsc::Receiver<()>) {
    while !run.is_finished() {
        run.live().read(|now| view.show(now));
        match interrupts.recv_timeout(REFRESH) {
            Ok(()) => {
                view.ending();
                run.stopper().stop();
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}
