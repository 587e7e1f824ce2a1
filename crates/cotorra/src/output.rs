//! Standard output that may be cut short: `cotorra schema | head` is no error.

use std::io::{self, Write};

use miette::{IntoDiagnostic, WrapErr};

/// Prints text to standard output; a reader that went away ends it quietly.
pub fn print(text: &str) -> miette::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        done => done.into_diagnostic().wrap_err("cannot write to standard output"),
    }
}
