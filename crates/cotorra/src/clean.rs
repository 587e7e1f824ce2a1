//! `cotorra clean`: removes what killed runs left behind.

use crate::{cli::CleanArgs, output, testbed_file::count};

/// Removes it, or only says what there is.
pub fn clean(args: &CleanArgs) -> miette::Result<()> {
    let (found, done) = if args.dry_run {
        (cotorra_testbed::leftovers(), "would be removed")
    } else {
        (cotorra_testbed::clean(), "removed")
    };
    let mut text: String = found.iter().map(|path| format!("{}\n", path.display())).collect();
    text += &match found.len() {
        0 => "nothing is left of killed runs\n".to_owned(),
        n => format!("{} {done}\n", count(n, "control group")),
    };
    output::print(&text)
}
