//! `cotorra link`: links of the running testbed, over its API.

mod args;

use std::{net::SocketAddr, thread, time::Duration};

use cotorra_graph::{Instruction, LinkContext, LinkId, PluginId, Tested};
use cotorra_plugin::{client::Client, runs::Runs};
use indicatif::{ProgressBar, ProgressStyle};
use miette::{IntoDiagnostic, miette};

pub use self::args::Link;
use self::args::{ApiArgs, SetArgs, ShowArgs, TestArgs};
use crate::{
    output,
    running::{Error, explained, token_text, with_token},
    table::Table,
    words::{ago, conditions, millis, probed},
};

/// Results are told once a second, a second after the last packet.
const PATIENCE: Duration = Duration::from_secs(5);
const LOOK: Duration = Duration::from_millis(200);

/// Shows, changes or tests.
pub fn link(what: &Link) -> miette::Result<()> {
    match what {
        Link::Show(args) => show(args),
        Link::Set(args) => set(args),
        Link::Test(args) => test(args),
    }
}

/// A run and the client that talks to it.
struct Asked {
    api: SocketAddr,
    client: Client,
}

impl Asked {
    fn of(args: &ApiArgs) -> Result<Self, Error> {
        let (api, client) = match args.run.api.filter(|_| args.unverified) {
            Some(api) => {
                let client = Client::new(&format!("http://{api}")).map_err(Error::Failed)?;
                (api, with_token(client, token_text()))
            }
            None => {
                let (run, client) = args.run.find(&Runs::of_user(), token_text())?;
                (run.api, client)
            }
        };
        let client = client.named(PluginId::new("command-line").expect("it is a name"));
        Ok(Self { api, client })
    }

    fn instruct(&self, instruction: &Instruction) -> Result<(), Error> {
        self.client.instruct(instruction, None).map_err(|error| explained(self.api, error))
    }

    /// The contexts of one link or all; links of the air are there once they are in use.
    fn links(&self, wanted: Option<&LinkId>) -> miette::Result<Vec<LinkContext>> {
        let mut links = self.client.links().map_err(|error| explained(self.api, error))?;
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

fn show(args: &ShowArgs) -> miette::Result<()> {
    let links = Asked::of(&args.api)?.links(args.link.as_ref())?;
    output::print(&if args.json {
        serde_json::to_string_pretty(&links).into_diagnostic()? + "\n"
    } else {
        table(&links)
    })
}

fn set(args: &SetArgs) -> miette::Result<()> {
    let asked = Asked::of(&args.api)?;
    asked.links(Some(&args.link))?;
    let direction = args.direction.map(Into::into);
    let instruction = Instruction::Condition { link: args.link.clone(), direction, change: args.change() };
    asked.instruct(&instruction)?;
    output::print(&table(&asked.links(Some(&args.link))?))
}

#[allow(clippy::disallowed_methods, reason = "whoever asks for a test waits for what it tells")]
fn test(args: &TestArgs) -> miette::Result<()> {
    let asked = Asked::of(&args.api)?;
    let direction = args.direction.into();
    let told = || -> miette::Result<Option<Tested>> {
        let both = asked.links(Some(&args.link))?;
        Ok(both.into_iter().find(|context| context.direction == direction).and_then(|its| its.tested))
    };
    told()?;
    let test = args.test();
    let instruction = Instruction::TestThroughput { link: args.link.clone(), direction, test };
    asked.instruct(&instruction)?;
    let looks = (test.duration + PATIENCE).div_duration_f64(LOOK).ceil() as u64;
    let style = ProgressStyle::with_template("{bar:40} testing {msg}").expect("a template that is right");
    let progress = ProgressBar::new(looks).with_style(style).with_message(args.link.to_string());
    let result = (0..looks).find_map(|_| {
        thread::sleep(LOOK);
        progress.inc(1);
        // The link rested before this test for longer than any result of it can be old.
        told().map(|told| told.filter(|told| told.age < PATIENCE)).transpose()
    });
    progress.finish_and_clear();
    let Tested { throughput_bps, offered_bps, .. } =
        result.ok_or_else(|| miette!("the testbed does not tell what came of the test"))??;
    let all = throughput_bps > 0.98 * offered_bps;
    output::print(&format!(
        "{} {}: {:.3} Mbit/s of {:.3} Mbit/s{}\n",
        args.link,
        format!("{direction:?}").to_lowercase(),
        throughput_bps / 1e6,
        offered_bps / 1e6,
        if all { "; it may carry more" } else { "" }
    ))
}

fn table(links: &[LinkContext]) -> String {
    let mut table = Table::new("<<>>><>><");
    table.row(["link", "direction", "d, ms", "λ, Mbit/s", "tested", "probes", "ψ", "δ", "does"]);
    for context in links {
        let tested = |tested: Tested| format!("{:.3} ({})", tested.throughput_bps / 1e6, ago(tested.age));
        table.row([
            context.link.to_string(),
            format!("{:?}", context.direction).to_lowercase(),
            context.delay.map_or("-".to_owned(), millis),
            format!("{:.3}", context.throughput_bps / 1e6),
            context.tested.map_or("-".to_owned(), tested),
            context.probed.as_ref().map_or("-".to_owned(), probed),
            context.scale.delay_scale.to_string(),
            context.scale.drop_scale.to_string(),
            conditions(&context.effective),
        ]);
    }
    table.render("")
}
