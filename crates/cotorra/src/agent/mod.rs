//! `cotorra agent`: credentials of agents on real machines.

mod args;
mod show;

use std::path::{Path, PathBuf};

use chrono::Utc;
use cotorra_enrolment::{Authority, Bundle, EnrolmentError, Renewal};
use cotorra_graph::AgentId;
use miette::{Diagnostic, Report, miette};

pub use self::args::Agent;
use self::args::{AuthorityArgs, EnrolArgs, FileArgs, ListArgs, RenewArgs, RevokeArgs};
use crate::output;

/// Enrols, renews, revokes or lists agents.
pub fn agent(agent: &Agent) -> miette::Result<()> {
    match agent {
        Agent::Enrol(args) => enrol(args),
        Agent::Renew(args) => renew(args),
        Agent::Revoke(args) => revoke(args),
        Agent::List(args) => list(args),
    }
}

#[derive(Debug, thiserror::Error, Diagnostic)]
enum Error {
    #[error("{} exists", path.display())]
    #[diagnostic(help("--force replaces it, and --out names another file"))]
    Exists { path: PathBuf },
    #[error("{} cannot be written: {} is not a folder", path.display(), folder.display())]
    #[diagnostic(help("create the folder, or name another file with --out"))]
    NoFolder { path: PathBuf, folder: PathBuf },
    #[error("{} cannot be written: {reason}", path.display())]
    #[diagnostic(help(
        "the agent has new credentials that are lost: `cotorra agent renew {name} --out FILE` makes others"
    ))]
    Write { path: PathBuf, name: AgentId, reason: std::io::Error },
    #[error("neither $XDG_CONFIG_HOME nor $HOME names a folder for the authority")]
    #[diagnostic(help("name one with --authority"))]
    NoPlace,
}

fn explained(error: EnrolmentError) -> Report {
    match error.help() {
        Some(help) => miette!(help = help, "{error}"),
        None => miette!("{error}"),
    }
}

fn place(args: &AuthorityArgs) -> Result<PathBuf, Error> {
    args.authority.clone().or_else(Authority::default_folder).ok_or(Error::NoPlace)
}

fn open(args: &AuthorityArgs) -> miette::Result<Authority> {
    Authority::open(place(args)?).map_err(explained)
}

/// Returns the file to write, if it can be written. Checked first, so that no credentials are made in vain.
fn destination(name: &AgentId, args: &FileArgs) -> Result<PathBuf, Error> {
    let path = args.out.clone().unwrap_or_else(|| format!("{name}.agent").into());
    let found = path.symlink_metadata().ok();
    if found.as_ref().is_some_and(|found| !args.force || found.is_dir()) {
        return Err(Error::Exists { path });
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match folder.is_dir() {
        true => Ok(path),
        false => Err(Error::NoFolder { folder: folder.to_owned(), path }),
    }
}

fn enrol(args: &EnrolArgs) -> miette::Result<()> {
    let (path, now) = (destination(&args.name, &args.file)?, Utc::now());
    let authority = Authority::create_or_open(place(&args.authority)?, now).map_err(explained)?;
    let bundle = authority.enrol(&args.name, &args.core, args.valid, now).map_err(explained)?;
    write(&bundle, path, &format!("enrolled {} with {}", args.name, args.core))
}

fn renew(args: &RenewArgs) -> miette::Result<()> {
    let path = destination(&args.name, &args.file)?;
    let RenewArgs { name, core, valid, overlap, .. } = args;
    let renewal = Renewal { core: core.clone(), validity: *valid, overlap: *overlap };
    let bundle = open(&args.authority)?.renew(name, &renewal, Utc::now()).map_err(explained)?;
    write(&bundle, path, &format!("renewed {name}"))
}

fn write(bundle: &Bundle, path: PathBuf, done: &str) -> miette::Result<()> {
    let certificate = bundle.certificate();
    let name = certificate.name.clone();
    match bundle.write(&path) {
        Ok(()) => output::print(&format!(
            "{done}: generation {}, until {}\n{} written; copy it to the agent's machine, and keep it secret\n",
            certificate.generation,
            show::local(certificate.not_after),
            path.display()
        )),
        Err(reason) => Err(Error::Write { path, name, reason }.into()),
    }
}

fn revoke(args: &RevokeArgs) -> miette::Result<()> {
    let ended = open(&args.authority)?.revoke(&args.name).map_err(explained)?;
    output::print(&match &ended[..] {
        [] => format!("{} was revoked before\n", args.name),
        ended => format!("revoked {}: ended {}\n", args.name, ended.join(", ")),
    })
}

fn list(args: &ListArgs) -> miette::Result<()> {
    let (authority, now) = (open(&args.authority)?, Utc::now());
    let agents = authority.agents().map_err(explained)?;
    let granted = authority.granted(now).map_err(explained)?;
    let text = if args.json { show::json(&agents, &granted) } else { show::table(&agents, &granted, now) };
    output::print_either(args.json, &text)
}
