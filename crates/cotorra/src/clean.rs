//! `cotorra clean`: removes what killed runs left behind.

use miette::miette;

use crate::{cli::CleanArgs, output, testbed_file::count};

/// Removes it, or only says what there is.
pub fn clean(args: &CleanArgs) -> miette::Result<()> {
    let (found, done) = if args.dry_run {
        (cotorra_testbed::leftovers(), "would be removed")
    } else {
        (cotorra_testbed::clean(), "removed")
    };
    let nothing = found == cotorra_testbed::Leftovers::default();
    let mut text: String = found.control_groups.iter().map(|path| format!("{}\n", path.display())).collect();
    text += &match found.control_groups.len() {
        0 if nothing => "nothing is left of killed runs\n".to_owned(),
        0 => String::new(),
        n => format!("{} {done}\n", count(n, "control group")),
    };
    for interface in &found.interfaces {
        text += &format!("{interface}: the conditions of a killed run {done}\n");
    }
    output::print(&text)?;
    match &found.kept[..] {
        [] => Ok(()),
        kept => Err(miette!("{}", kept.join("\n"))),
    }
}
