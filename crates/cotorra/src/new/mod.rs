//! `cotorra new`: testbeds and plug-ins from templates, which check, compile and run unchanged.

mod files;
mod plan;
mod plugin;
mod testbed;

use std::path::Path;

use clap::Subcommand;
use miette::Report;

use self::{
    files::{Destination, NewFile},
    plugin::PluginArgs,
    testbed::TestbedArgs,
};
use crate::{output, testbed_file, words::count};

#[derive(Debug, Subcommand)]
pub enum New {
    Testbed(TestbedArgs),
    Plugin(PluginArgs),
}

/// Writes the files of a template, or only lists them, and prints the next steps.
pub fn new(new: &New) -> miette::Result<()> {
    match new {
        New::Testbed(args) => {
            let (files, text) = testbed::testbed(args)?;
            output::print(&text)?;
            let next = ["cotorra check testbed.yaml", "cotorra run --simulate testbed.yaml"];
            make(&args.folder, &files, args.dry_run, &next)
        }
        New::Plugin(args) => make(&args.folder(), &plugin::plugin(args)?, args.dry_run, &args.next()),
    }
}

fn make(folder: &Path, files: &[NewFile], dry_run: bool, next: &[&str]) -> miette::Result<()> {
    let destination = Destination::new(folder);
    if dry_run {
        destination.check(files)?;
    } else {
        destination.write(files)?;
    }
    let list: String = files
        .iter()
        .map(|file| format!("  {:>9}  {}\n", file.contents.len(), folder.join(file.path).display()))
        .collect();
    let done = if dry_run { "would be written" } else { "written" };
    let mut text = format!("{} {done}, in bytes:\n{list}", count(files.len(), "file"));
    if !dry_run {
        let file = folder.join("testbed.yaml");
        let loaded = testbed_file::load(&file, &[]).map_err(Report::new)?;
        text += &format!("\n{}: {}\n", file.display(), testbed_file::overview(&loaded.testbed));
        text += &format!("\nnext:\n  cd {}\n", quoted(folder));
        next.iter().for_each(|command| text += &format!("  {command}\n"));
    }
    output::print(&text)
}

/// Returns a path as a shell reads it.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = |c: char| c.is_alphanumeric() || "/._-".contains(c);
    if text.chars().all(is_plain) { text } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_next_steps_can_be_pasted_into_a_shell() {
        let quoted = |path: &str| quoted(Path::new(path));
        assert_eq!(quoted("../labs/office-2"), "../labs/office-2");
        assert_eq!(quoted("second floor"), "'second floor'");
        assert_eq!(quoted("it's $HOME"), r"'it'\''s $HOME'");
    }
}
