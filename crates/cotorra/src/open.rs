//! `cotorra open`: opens the dashboard of a run in the browser.

use clap::Args;
use cotorra_plugin::runs::Runs;

use crate::{
    browser::Opener,
    output,
    running::{WhichRun, explained, token_text},
};

/// Open the dashboard of a run or replay in your browser
///
/// The browser is signed in by a file that only you can read. Its code works once, for one tab.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra open
  cotorra open --run corridor
  cotorra open --print               for a browser on another machine, behind ssh -L 7700:localhost:7700")]
pub struct OpenArgs {
    /// Print the address with its code, instead of starting a browser
    #[arg(long)]
    pub print: bool,
    #[command(flatten)]
    pub run: WhichRun,
}

/// Opens the dashboard, or prints its address.
pub fn open(args: &OpenArgs) -> miette::Result<()> {
    let opener = Opener::prepare(!args.print)?;
    let (run, client) = args.run.find(&Runs::of_user(), token_text())?;
    let page = client.sign_in().map_err(|error| explained(run.api, error))?;
    if args.print {
        return output::print(&format!("{}\n", page.address));
    }
    note!("opening the dashboard of {run}");
    opener.open(|| Ok(page));
    Ok(())
}
