//! `cotorra clean`: removes leftovers of killed runs.

use clap::Args;
use cotorra_plugin::runs::Runs;
use miette::miette;

use crate::{output, temporary, words::count};

/// Remove leftovers of killed runs
///
/// The namespaces, interfaces and processes of a run end with it in any case. A run that is killed with SIGKILL leaves its
/// control groups, the conditions of this machine's own interfaces, containers if their guard was killed too, and the entry by which tools find the run. The next run
/// removes them, or this command does. It also removes this user's temporary folders of killed commands.
#[derive(Debug, Args)]
pub struct CleanArgs {
    /// Only say what would be removed
    #[arg(short = 'n', long)]
    pub dry_run: bool,
}

/// Removes the leftovers, or only lists them.
pub fn clean(args: &CleanArgs) -> miette::Result<()> {
    let runs = Runs::of_user();
    let (found, (entries, refused), (folders, stay), done) = if args.dry_run {
        let folders = (temporary::leftovers(), Vec::new());
        (cotorra_testbed::leftovers(), runs.leftovers(), folders, "would be removed")
    } else {
        (cotorra_testbed::clean(), runs.clean(), temporary::clean(), "removed")
    };
    let is_default = found == cotorra_testbed::Leftovers::default();
    let nothing = is_default && entries.is_empty() && folders.is_empty();
    let mut text: String = found.control_groups.iter().map(|path| format!("{}\n", path.display())).collect();
    text += &match found.control_groups.len() {
        0 if nothing => "nothing is left of killed runs\n".to_owned(),
        0 => String::new(),
        n => format!("{} {done}\n", count(n, "control group")),
    };
    for interface in &found.interfaces {
        text += &format!("{interface}: the conditions of a killed run {done}\n");
    }
    for run in &found.containers {
        text += &format!("{run}: the containers of a killed run {done}\n");
    }
    for entry in &entries {
        text += &format!("{}: the entry of a killed run {done}\n", entry.display());
    }
    for folder in &folders {
        text += &format!("{}: the temporary folder of a killed command {done}\n", folder.display());
    }
    output::print(&text)?;
    let others = refused.iter().map(ToString::to_string).chain(stay.iter().map(ToString::to_string));
    let kept: Vec<_> = found.kept.iter().cloned().chain(others).collect();
    if kept.is_empty() { Ok(()) } else { Err(miette!("{}", kept.join("\n"))) }
}
