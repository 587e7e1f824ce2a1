//! `cotorra sweep merge`: joins the shards of a sweep.

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use cotorra_experiments::{
    journal::Journal,
    sweep::{Merge, MergeError},
};
use cotorra_testbed::{FolderError, Manifest, ManifestError, Repeat};

use super::{args::MergeArgs, results};
use crate::{origin, output, words::count};

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
enum Error {
    #[error(transparent)]
    Merge(#[from] MergeError),
    #[error(transparent)]
    Folder(#[from] FolderError),
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    #[error("{} and {} are shards of runs with other inputs: {} differs", .folders[0].display(), .folders[1].display(), .file.display())]
    OtherInputs { folders: [PathBuf; 2], file: PathBuf },
    #[error("{0}")]
    #[diagnostic(help(
        "run these shards, which go on where they were, or merge what there is with --partial"
    ))]
    Missing(String),
    #[error("none of the {} is there yet", count(*.0, "run"))]
    Empty(usize),
}

/// Merges shards.
pub fn merge(args: &MergeArgs) -> miette::Result<ExitCode> {
    let merge = Merge::read(&args.folders).map_err(Error::from)?;
    if merge.runs.done.is_empty() {
        return Err(Error::Empty(merge.runs.total).into());
    }
    let missing = missing(&merge);
    if !args.partial && !missing.is_empty() {
        return Err(Error::Missing(missing).into());
    }
    let manifest = manifest(&merge.shards)?;
    let folder = Journal::open(args.out.as_ref().unwrap_or(&merge.folder)).map_err(Error::from)?;
    merge.write(&folder).map_err(Error::from)?;
    if let Some((shard, manifest)) = manifest {
        manifest.copy(shard, folder.path()).map_err(Error::from)?;
        manifest.write(folder.path()).map_err(Error::from)?;
        if missing.is_empty() {
            Manifest::complete(folder.path()).map_err(Error::from)?;
        }
    }
    for format in args.figure.further() {
        merge.runs.write_figure(&folder, format).map_err(Error::from)?;
    }
    let note = if missing.is_empty() { String::new() } else { format!("\n{missing}\n") };
    output::print(&results::describe(&merge.runs, &note, folder.path(), &args.figure))?;
    super::outcome(&merge.runs, args.require_pass)
}

/// Returns the manifest of the whole sweep, with a shard that has its inputs; `None` if an older cotorra made a shard.
fn manifest(shards: &[PathBuf]) -> Result<Option<(&Path, Manifest)>, Error> {
    let mut whole: Option<(&Path, Manifest)> = None;
    for shard in shards {
        let manifest = match Manifest::read(shard) {
            Err(ManifestError::None(_)) => return Ok(None),
            read => read?,
        };
        let Some((first, whole)) = &mut whole else {
            whole = Some((shard, manifest));
            continue;
        };
        let (one, other) = (&whole.carried, &manifest.carried);
        if let Some(file) = one.keys().chain(other.keys()).find(|file| one.get(*file) != other.get(*file)) {
            let (folders, file) = ([first.to_owned(), shard.clone()], file.clone());
            return Err(Error::OtherInputs { folders, file });
        }
        whole.seeds.extend(manifest.seeds);
    }
    let Some((_, manifest)) = &mut whole else { return Ok(None) };
    manifest.seeds.sort_unstable();
    manifest.seeds.dedup();
    let own = origin::of(manifest.repeat.clone());
    (manifest.command, manifest.commit) = (own.command, own.commit);
    if let Repeat::Words(words) = &mut manifest.repeat {
        words.retain(|word| !word.starts_with("--shard="));
    }
    Ok(whole)
}

/// Maximum number of shards, and of their runs, that are listed.
const LISTED: usize = 5;

/// Names the missing runs by shard. Empty if there are none.
fn missing(merge: &Merge) -> String {
    let number = merge.runs.total - merge.runs.done.len();
    if number == 0 {
        return String::new();
    }
    let are = if number == 1 { "is" } else { "are" };
    let mut text = format!("{number} of {} {are} missing", count(merge.runs.total, "run"));
    for (shard, runs) in merge.missing.iter().take(LISTED) {
        let listed = runs.iter().take(LISTED).cloned().collect::<Vec<_>>().join(", ");
        let more = runs.len().saturating_sub(LISTED);
        let more = if more > 0 { format!(", and {more} more") } else { String::new() };
        text += &format!("\n  shard {shard}: {listed}{more}");
    }
    if merge.missing.len() > LISTED {
        text += &format!("\n  and runs of {}", count(merge.missing.len() - LISTED, "other shard"));
    }
    text
}
