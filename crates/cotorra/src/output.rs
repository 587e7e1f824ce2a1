//! Standard output and standard error. A reader that closes the pipe, as in `cotorra schema | head`, is no error.

use std::{
    fmt::Arguments,
    io::{self, Write},
};

use miette::{IntoDiagnostic, WrapErr};

/// Prints text to standard output. Succeeds if the reader has closed the pipe.
pub fn print(text: &str) -> miette::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        done => done.into_diagnostic().wrap_err("cannot write to standard output"),
    }
}

/// Writes a line to standard error.
macro_rules! note {
    ($($text:tt)*) => {
        $crate::output::write_note(format_args!("{}\n", format_args!($($text)*)))
    };
}

/// Writes to standard error. Text that cannot be written is lost: a closed pipe or a full disk must not end a run.
pub fn write_note(text: Arguments<'_>) {
    let _ = io::stderr().lock().write_fmt(text);
}
