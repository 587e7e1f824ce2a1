//! `cotorra edit`: a testbed file in an editor page, checked as it is typed.

use std::{
    fmt, io,
    net::{Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Args;
use cotorra_testbed::{Checked, Edited, Editor, Mistake};
use cotorra_testbed_file::Diagnostics;
use miette::{IntoDiagnostic, MietteHandler, MietteHandlerOpts, ReportHandler};

use crate::{
    arguments::parse_address,
    browser::Opener,
    replaced::replace,
    signals,
    testbed_file::{self, FileError},
    words::count,
};

/// Address of the editor, beside that of runs.
const ADDRESS: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 7710);
/// Size of the longest file, bytes. A save has to fit into a request.
const LONGEST: usize = 120 << 10;
/// Columns of a mistake that is shown.
const WIDTH: usize = 90;

/// Edit a testbed file in the browser
///
/// The page completes keys and values, shows every mistake in its place while you type, and draws the map and the topology of
/// a valid file. The file changes only when you save.
///
/// The editor names a file that only you can read, which leads your browser to the page and signs it in, once. Nobody else on
/// this machine can change the testbed file. Ctrl-C ends the editor.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra edit testbeds/corridor.yaml --open
  cotorra new corridor mine.yaml && cotorra edit mine.yaml --open")]
pub struct EditArgs {
    /// The testbed file
    pub file: PathBuf,
    /// Open the page in the browser (by xdg-open)
    #[arg(long)]
    pub open: bool,
    /// Address of the page; default: 127.0.0.1:7710, or the next free port
    #[arg(long, value_name = "ADDR:PORT", value_parser = parse_address)]
    pub address: Option<SocketAddr>,
}

/// Serves the editor until Ctrl-C.
pub fn edit(args: &EditArgs) -> miette::Result<ExitCode> {
    let address = args.address.unwrap_or(ADDRESS);
    if !address.ip().is_loopback() {
        miette::bail!(
            "{} is not a loopback address, and the editor is for users of this machine alone",
            address.ip()
        );
    }
    // Resolved once: whoever can write to the folder could later lead the name to another file.
    let path = args.file.canonicalize();
    let path = path.map_err(|reason| FileError::Unreadable { path: args.file.clone(), reason })?;
    let file = EditedFile { name: args.file.clone(), path };
    let text = file.read().map_err(|reason| FileError::Unreadable { path: args.file.clone(), reason })?;
    if text.len() > LONGEST {
        miette::bail!("{} is longer than {} KiB: use another editor", args.file.display(), LONGEST >> 10);
    }
    let opener = Opener::prepare(args.open)?;
    let interrupts = signals::listen()?;
    let schema = cotorra_testbed_file::schema();
    let editor = Editor::start(address, args.address.is_none(), file, text, schema).into_diagnostic()?;
    let page = editor.page().into_diagnostic()?;
    note!("Editor of {}: open {} in a browser; Ctrl-C ends it", args.file.display(), page.file.display());
    opener.open(|| Ok(page));
    // Fails only if the sender is gone, which then cannot end the editor in order.
    let _ = interrupts.recv();
    Ok(ExitCode::SUCCESS)
}

struct EditedFile {
    /// As the user wrote it.
    name: PathBuf,
    /// Without symbolic links.
    path: PathBuf,
}

impl Edited for EditedFile {
    fn name(&self) -> String {
        self.name.display().to_string()
    }

    fn read(&self) -> io::Result<String> {
        cotorra_testbed_file::read(&self.path)
    }

    fn save(&self, text: &str) -> io::Result<()> {
        replace(&self.path, text.as_bytes())
    }

    fn check(&self, text: &str) -> Checked {
        let base = self.name.parent().unwrap_or(Path::new(""));
        match cotorra_testbed_file::parse(&self.name(), text, base) {
            Ok(testbed) => match cotorra_testbed::rehearse(&testbed) {
                Ok(_) => {
                    let overview = testbed_file::overview(&testbed);
                    Checked { testbed: Some(testbed), overview, mistakes: Vec::new() }
                }
                Err(error) => {
                    let message = error.to_string();
                    let mistake = Mistake { start: 0, end: 0, line: 1, shown: message.clone(), message };
                    Checked { testbed: None, overview: count(1, "mistake"), mistakes: vec![mistake] }
                }
            },
            Err(found) => wrong(found),
        }
    }
}

/// Returns mistakes with their places in UTF-16, and as `cotorra check` shows them.
fn wrong(found: Diagnostics) -> Checked {
    let handler =
        MietteHandlerOpts::new().without_cause_chain().color(false).unicode(true).width(WIDTH).build();
    let units = |text: &str| text.encode_utf16().count();
    let places: Vec<_> = found.list.iter().map(|mistake| (mistake.line, mistake.span.clone())).collect();
    let text = found.source_text.clone();
    let mistakes = match FileError::from(found) {
        FileError::Wrong { mistakes, .. } => mistakes,
        FileError::Unreadable { .. } => Vec::new(),
    };
    let mistakes = mistakes.into_iter().zip(places).map(|(mistake, (line, span))| {
        let before = units(text.get(..span.start).unwrap_or_default());
        let within = units(text.get(span).unwrap_or_default());
        let shown = Shown { handler: &handler, mistake: &mistake }.to_string();
        Mistake { start: before, end: before + within, line, message: mistake.to_string(), shown }
    });
    let mistakes: Vec<_> = mistakes.collect();
    Checked { testbed: None, overview: count(mistakes.len(), "mistake"), mistakes }
}

/// A mistake as text.
struct Shown<'a> {
    handler: &'a MietteHandler,
    mistake: &'a testbed_file::Mistake,
}

impl fmt::Display for Shown<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.handler.debug(self.mistake, f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mistakes_have_their_places_in_utf_16_and_the_text_of_check() {
        let file = EditedFile { name: PathBuf::from("x.yaml"), path: PathBuf::new() };
        let checked = file.check("name: \"😀\" # ä\nnodes:\n  lan: { kind: swich }\n");
        let [mistake, ..] = &checked.mistakes[..] else { panic!("{checked:?}") };
        assert!(checked.testbed.is_none() && checked.overview.contains("mistake"));
        assert_eq!(mistake.line, 3, "{mistake:?}");
        let text: Vec<_> = "name: \"😀\" # ä\nnodes:\n  lan: { kind: swich }\n".encode_utf16().collect();
        assert_eq!(String::from_utf16(&text[mistake.start..mistake.end]).unwrap(), "swich");
        assert!(
            mistake.shown.contains("x.yaml:3") && mistake.shown.contains(&mistake.message),
            "{}",
            mistake.shown
        );
    }
}
