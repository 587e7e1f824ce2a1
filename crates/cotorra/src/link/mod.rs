//! `cotorra link`: shows, changes and tests links of the running testbed, over its API.

mod args;
mod show;

use std::{thread, time::Duration};

use cotorra_graph::{Instruction, LinkContext, LinkFigures, LinkId, PluginId, Tested};
use cotorra_plugin::{client::Client, runs::Runs};
use cotorra_testbed_file::COMMAND_LINE;
use indicatif::{ProgressBar, ProgressStyle};
use miette::{IntoDiagnostic, miette};
use serde::Serialize;

pub use self::args::Link;
use self::args::{ApiArgs, SetArgs, ShowArgs, TestArgs};
use crate::{
    output,
    running::{Error, explained, token_text, with_token},
};

/// Deadline for the result after the last packet. Results come once a second, from a second after that packet on.
const PATIENCE: Duration = Duration::from_secs(5);
/// Poll interval for the result of a test.
const POLL: Duration = Duration::from_millis(200);

/// Shows, changes or tests links.
pub fn link(command: &Link) -> miette::Result<()> {
    match command {
        Link::Show(args) => show(args),
        Link::Set(args) => set(args),
        Link::Test(args) => test(args),
    }
}

/// Connection to a run.
struct Connection {
    api: String,
    client: Client,
    /// Name and place of the run, for people.
    what: String,
}

impl Connection {
    fn open(args: &ApiArgs) -> Result<Self, Error> {
        let is_away = |api: &&str| args.unverified || api.starts_with("https://");
        let (api, client, what) = match args.run.named().filter(is_away) {
            Some(api) => {
                let url = if api.contains("://") { api.to_owned() } else { format!("http://{api}") };
                let client =
                    with_token(Client::at(&url, args.ca.as_deref()).map_err(Error::Failed)?, token_text());
                let name = client.testbed().map_err(|error| explained(api, error))?.name;
                (api.to_owned(), client, format!("{name} on {api}"))
            }
            None => {
                let (run, client) = args.run.find(&Runs::of_user(), token_text())?;
                (run.api.to_string(), client, run.to_string())
            }
        };
        let client = client.named(PluginId::new(COMMAND_LINE).expect("it is a name"));
        Ok(Self { api, client, what })
    }

    fn instruct(&self, instruction: &Instruction) -> Result<(), Error> {
        self.client.instruct(instruction, None).map_err(|error| explained(&self.api, error))
    }

    /// Returns the contexts of one link or of all. Wireless links appear once they are in use.
    fn links(&self, wanted: Option<&LinkId>) -> miette::Result<Vec<LinkContext>> {
        let mut links = self.client.links().map_err(|error| explained(&self.api, error))?;
        let Some(wanted) = wanted else { return Ok(links) };
        let all: Vec<_> = links.iter().step_by(2).map(|context| context.link.to_string()).collect();
        links.retain(|context| context.link == *wanted);
        match links.is_empty() {
            true => {
                Err(miette!(help = format!("there are {}", all.join(", ")), "there is no link `{wanted}`"))
            }
            false => Ok(links),
        }
    }
}

/// One direction of a link, with configured, measured and available figures.
#[derive(Serialize)]
struct WithFigures {
    #[serde(flatten)]
    context: LinkContext,
    figures: LinkFigures,
}

impl From<LinkContext> for WithFigures {
    fn from(context: LinkContext) -> Self {
        Self { figures: context.figures(), context }
    }
}

fn show(args: &ShowArgs) -> miette::Result<()> {
    let links = Connection::open(&args.api)?.links(args.link.as_ref())?;
    let text = if args.json {
        let all: Vec<_> = links.into_iter().map(WithFigures::from).collect();
        serde_json::to_string_pretty(&all).into_diagnostic()? + "\n"
    } else if args.figures {
        show::figures(&links)
    } else {
        show::table(&links)
    };
    output::print_either(args.json, &text)
}

fn set(args: &SetArgs) -> miette::Result<()> {
    let run = Connection::open(&args.api)?;
    run.links(Some(&args.link))?;
    let direction = args.direction.map(Into::into);
    let instruction = Instruction::Condition { link: args.link.clone(), direction, change: args.change() };
    run.instruct(&instruction)?;
    note!("changed {} of {}", args.link, run.what);
    output::print(&show::table(&run.links(Some(&args.link))?))
}

#[allow(clippy::disallowed_methods, reason = "the user waits for the result of the test")]
fn test(args: &TestArgs) -> miette::Result<()> {
    let run = Connection::open(&args.api)?;
    let direction = args.direction.into();
    let last_result = || -> miette::Result<Option<Tested>> {
        let both = run.links(Some(&args.link))?;
        Ok(both.into_iter().find(|context| context.direction == direction).and_then(|its| its.tested))
    };
    // Fails before the test if the link does not exist.
    last_result()?;
    let test = args.test();
    let instruction = Instruction::TestThroughput { link: args.link.clone(), direction, test };
    run.instruct(&instruction)?;
    note!("testing {} of {}", args.link, run.what);
    let polls = (test.duration + PATIENCE).div_duration_f64(POLL).ceil() as u64;
    let style = ProgressStyle::with_template("{bar:40} testing {msg}").expect("a template that is right");
    let progress = ProgressBar::new(polls).with_style(style).with_message(args.link.to_string());
    let result = (0..polls).find_map(|_| {
        thread::sleep(POLL);
        progress.inc(1);
        // An older result is of an earlier test: the link rested before this one for longer than the deadline.
        last_result().map(|result| result.filter(|result| result.age < PATIENCE)).transpose()
    });
    progress.finish_and_clear();
    let Tested { throughput_bps, offered_bps, .. } =
        result.ok_or_else(|| miette!("the testbed did not report the result of the test"))??;
    let carries_all = throughput_bps > 0.98 * offered_bps;
    output::print(&format!(
        "{} {}: {:.3} Mbit/s of {:.3} Mbit/s{}\n",
        args.link,
        format!("{direction:?}").to_lowercase(),
        throughput_bps / 1e6,
        offered_bps / 1e6,
        if carries_all { "; it may carry more" } else { "" }
    ))
}
