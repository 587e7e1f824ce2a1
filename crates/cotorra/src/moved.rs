//! Commands that this program had before `cotorra-lab` took them over.

use std::ffi::OsString;

use clap::Args;

/// The arguments of a command that moved.
#[derive(Debug, Args)]
pub struct Moved {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    arguments: Vec<OsString>,
}

#[derive(Debug, PartialEq, Eq, thiserror::Error, miette::Diagnostic)]
#[error("`{command}` is now a command of cotorra-lab")]
#[diagnostic(help("cargo run --release -p cotorra-lab -- {words}"))]
pub struct MovedError {
    command: &'static str,
    words: String,
}

impl Moved {
    /// Returns the error that names the command line in `cotorra-lab`.
    pub fn error(&self, command: &'static str) -> MovedError {
        let arguments = self.arguments.iter().map(|word| format!(" {}", word.to_string_lossy()));
        MovedError { command, words: arguments.fold(command.to_owned(), |words, word| words + &word) }
    }
}
