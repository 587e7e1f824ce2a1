//! Opens pages in the user's browser.

use std::{
    env, fs,
    io::{self, Write},
    process::{Child, Command, Stdio},
};

use cotorra_plugin::client::SignIn;

/// The program that opens a file in the user's browser.
const OPENER: &str = "xdg-open";

#[derive(Debug, thiserror::Error, miette::Diagnostic)]
pub enum Error {
    #[error("--open needs {OPENER}, which is not installed")]
    #[diagnostic(help("install the package xdg-utils, or use `cotorra open --print`"))]
    Missing,
    #[error("cannot start {OPENER}: {0}")]
    Start(std::io::Error),
}

/// A process that waits for the page to open.
///
/// It starts before the run does, because a run may enter a user namespace, in which browsers do not work.
pub struct Opener(Option<Child>);

impl Opener {
    /// Starts the process, if the user wants it.
    pub fn prepare(wanted: bool) -> Result<Self, Error> {
        if !wanted {
            return Ok(Self(None));
        }
        let path = env::var_os("PATH").unwrap_or_default();
        let is_there =
            |folder: std::path::PathBuf| fs::metadata(folder.join(OPENER)).is_ok_and(|file| file.is_file());
        if !env::split_paths(&path).any(is_there) {
            return Err(Error::Missing);
        }
        let script = format!("read -r page && exec {OPENER} \"$page\"");
        let child = Command::new("sh")
            .args(["-c", &script])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(Error::Start)?;
        Ok(Self(Some(child)))
    }

    /// Opens a page by its file: an address would be an argument of the browser, which other users can see. The program
    /// does not wait for the browser.
    pub fn open(self, prepare: impl FnOnce() -> io::Result<SignIn>) {
        let Some(stdin) = self.0.and_then(|child| child.stdin) else { return };
        if let Err(error) = prepare().and_then(|page| writeln!(&stdin, "{}", page.file.display())) {
            tracing::warn!("the browser was not opened: {error}");
        }
    }
}
