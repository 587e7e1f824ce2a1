//! `cotorra edit`: a testbed file in an editor page, checked as it is typed.

use std::{
    fmt, fs,
    io::{self, Write},
    net::{Ipv4Addr, SocketAddr},
    os::unix::fs::{MetadataExt, chown},
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
/// The page's address ends with a secret, so that nobody else on this machine can change the file. Ctrl-C ends the editor.
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
    let file = EditedFile { path: args.file.clone() };
    let text = file.read().map_err(|reason| FileError::Unreadable { path: args.file.clone(), reason })?;
    if text.len() > LONGEST {
        miette::bail!("{} is longer than {} KiB: use another editor", args.file.display(), LONGEST >> 10);
    }
    let opener = Opener::prepare(args.open)?;
    let interrupts = signals::listen()?;
    let schema = cotorra_testbed_file::schema();
    let editor = Editor::start(address, args.address.is_none(), file, text, schema).into_diagnostic()?;
    note!("Editor of {} on {}; Ctrl-C ends it", args.file.display(), editor.url());
    opener.open(&editor.url());
    // Fails only if the sender is gone, and then nobody can end the editor in order.
    let _ = interrupts.recv();
    Ok(ExitCode::SUCCESS)
}

struct EditedFile {
    path: PathBuf,
}

impl Edited for EditedFile {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn read(&self) -> io::Result<String> {
        cotorra_testbed_file::read(&self.path)
    }

    fn save(&self, text: &str) -> io::Result<()> {
        replace(&self.path, text)
    }

    fn check(&self, text: &str) -> Checked {
        let base = self.path.parent().unwrap_or(Path::new(""));
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

/// Replaces a file as a whole, with its permissions and its owner. A link stays a link.
fn replace(path: &Path, text: &str) -> io::Result<()> {
    let path = path.canonicalize()?;
    let before = fs::metadata(&path)?;
    let folder = path.parent().ok_or(io::ErrorKind::InvalidInput)?;
    let mut draft = tempfile::Builder::new().prefix(".cotorra-edit-").tempfile_in(folder)?;
    draft.write_all(text.as_bytes())?;
    draft.as_file().set_permissions(before.permissions())?;
    chown(draft.path(), Some(before.uid()), Some(before.gid()))?;
    draft.as_file().sync_all()?;
    draft.persist(&path)?;
    Ok(())
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
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    #[test]
    fn mistakes_have_their_places_in_utf_16_and_the_text_of_check() {
        let file = EditedFile { path: PathBuf::from("x.yaml") };
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

    #[test]
    fn a_saved_file_keeps_its_permissions_and_its_link() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("a.yaml"), folder.path().join("b.yaml"));
        fs::write(&file, "old").unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        symlink("a.yaml", &link).unwrap();
        EditedFile { path: link.clone() }.save("new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&file).unwrap(), "new");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o640);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "no draft is left");
    }
}
