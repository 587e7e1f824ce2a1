//! Notes how runs started, for the manifests of their folders: the command line without secrets, and the words that repeat it.

use std::{env, ffi::OsString, path::Path};

use clap::{ArgAction, ArgMatches, Command, parser::ValueSource};
use cotorra_recording::RecordingPlace;
use cotorra_testbed::{FolderError, Made, Manifest, ManyInputs, Options, Origin, Repeat, Time};

/// The commit that this program was built from, as build.rs found it.
pub const COMMIT: &str = env!("COTORRA_COMMIT");

/// A hash of the source code that this program was built from.
pub const SOURCES: &str = env!("COTORRA_SOURCES");

/// Returns the name of this program, `cotorra` or `cotorra-lab`.
pub fn program() -> String {
    let path = env::args_os().next().unwrap_or_default();
    Path::new(&path).file_name().unwrap_or("cotorra".as_ref()).to_string_lossy().into_owned()
}

/// Returns what started runs that are repeated like this.
pub fn of(repeat: Repeat) -> Origin {
    let arguments = env::args_os().skip(1).map(|word| without_secrets(&word.to_string_lossy()));
    let command = std::iter::once(program()).chain(arguments).collect();
    Origin { command, commit: COMMIT.to_owned(), repeat }
}

/// Returns what started a run with these options, and `more` words that no option has.
pub fn of_run(options: &Options, time: Time, more: &[&str]) -> Origin {
    if options.after.as_ref().is_some_and(|previous| previous.has_notes()) {
        let why = "it continued negotiations of an earlier run (--after), whose state is in a ledger";
        return of(Repeat::Not(why.to_owned()));
    }
    let mut words = vec!["run".to_owned(), "testbed.yaml".to_owned()];
    if time == Time::Virtual {
        words.push("--simulate".to_owned());
    }
    words.extend(more.iter().map(ToString::to_string));
    words.extend(options.until.map(|until| format!("--until={}s", until.as_secs_f64())));
    if options.recording.file == Some(RecordingPlace::Folder) {
        words.push("--record".to_owned());
    }
    let flag = |is_set: bool, name: &str| is_set.then(|| name.to_owned());
    words.extend(flag(options.save_power, "--save-power"));
    words.extend(options.wais_callbacks.iter().map(|network| format!("--wais-callbacks={network}")));
    words.extend(flag(options.interfaces.replace, "--replace"));
    words.extend(options.interfaces.interfaces.iter().map(|name| format!("--allow-interface={name}")));
    if time == Time::Real {
        words.push(format!("--agents={}", options.agents.listen));
        let authority = options.agents.authority.as_ref().and_then(|path| std::path::absolute(path).ok());
        words.extend(authority.map(|path| format!("--authority={}", path.display())));
    }
    of(Repeat::Words(words))
}

/// Arguments that have no part in results, or that name files which a repeat has elsewhere.
const LEFT_OUT: [&str; 15] = [
    "dry_run", "file", "formats", "fresh", "headless", "help", "history", "jobs", "measured", "out",
    "settings", "testbed", "verbose", "version", "with",
];

/// Returns the arguments of a program's command line that have a part in results, in the order in which it declares them. The
/// values of its files and settings are for the caller to add.
pub fn given<W: Into<OsString> + Clone>(
    mut program: Command,
    line: impl IntoIterator<Item = W>,
) -> Vec<String> {
    program.build();
    given_in(&program, &program.clone().get_matches_from(line))
}

fn given_in(command: &Command, matches: &ArgMatches) -> Vec<String> {
    if let Some((name, matches)) = matches.subcommand()
        && let Some(below) = command.find_subcommand(name)
    {
        return std::iter::once(name.to_owned()).chain(given_in(below, matches)).collect();
    }
    let mut words = Vec::new();
    for argument in command.get_arguments() {
        let id = argument.get_id().as_str();
        let Some(name) = argument.get_long().filter(|_| !LEFT_OUT.contains(&id)) else { continue };
        if !matches!(matches.value_source(id), Some(ValueSource::CommandLine | ValueSource::EnvVariable)) {
            continue;
        }
        match argument.get_action() {
            ArgAction::SetTrue => words.push(format!("--{name}")),
            _ => {
                let values = matches.get_raw(id).into_iter().flatten();
                words.extend(values.map(|value| format!("--{name}={}", value.to_string_lossy())));
            }
        }
    }
    words
}

/// Notes in the folder of many runs how they came to be.
pub fn note(folder: &Path, repeat: Repeat, made: &Made, carried: &ManyInputs) -> Result<(), FolderError> {
    Manifest::begin(folder, &of(repeat), made, &carried.inputs).map(drop)
}

/// Removes from a word what can be a secret: users, passwords, paths and queries in addresses of servers. The user and the
/// database of a history are none.
fn without_secrets(word: &str) -> String {
    let part = |part: &str| {
        let Some((before, address)) = part.split_once("://") else { return part.to_owned() };
        let (who, place) = address.rsplit_once('@').unwrap_or(("", address));
        let is_history = before.ends_with("mysql") || before.ends_with("mariadb");
        let who = match who.split_once(':') {
            _ if who.is_empty() => String::new(),
            Some((user, _)) if is_history => format!("{user}:…@"),
            None if is_history => format!("{who}@"),
            _ => "…@".to_owned(),
        };
        let ends: &[char] = if is_history { &['?', '#'] } else { &['/', '?', '#'] };
        let (kept, rest) = place.split_at(place.find(ends).unwrap_or(place.len()));
        let rest = match rest {
            "" | "/" => rest,
            _ => "…",
        };
        format!("{before}://{who}{kept}{rest}")
    };
    word.split(',').map(part).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn no_secret_is_recorded() {
        for (word, recorded) in [
            ("--history=mysql://ana:sec/ret@db.lab/cotorra", "--history=mysql://ana:…@db.lab/cotorra"),
            ("mysql://ana@db.lab/cotorra?password=secret", "mysql://ana@db.lab/cotorra…"),
            ("wss://node.example/v3/secret", "wss://node.example…"),
            ("a=ws://secret@one:8545,b=ws://two:8546", "a=ws://…@one:8545,b=ws://two:8546"),
            ("plugins.x.settings.url=https://u:secret@host/", "plugins.x.settings.url=https://…@host/"),
            ("links.*.delay_scale=2", "links.*.delay_scale=2"),
            ("runs/corridor", "runs/corridor"),
        ] {
            assert_eq!(without_secrets(word), recorded);
            assert!(!recorded.contains("secret"));
        }
    }

    fn given_by(line: &str) -> Vec<String> {
        given(Cli::command(), line.split(' '))
    }

    #[test]
    fn arguments_that_decide_results_are_given_again() {
        let line = "cotorra sweep x.yaml --set plugin=okpi,probing --seeds 3 --jobs 2 --out y --headless --shard 1/2";
        assert_eq!(given_by(line), ["sweep", "--set=plugin=okpi,probing", "--seeds=3", "--shard=1/2"]);
        let line = "cotorra margin x.yaml --kpi a --kpi b --set a=1 --change delay,down --most 20ms --singles --fresh";
        let expected =
            ["margin", "--kpi=a", "--kpi=b", "--change=delay", "--change=down", "--most=20ms", "--singles"];
        assert_eq!(given_by(line), expected);
    }
}
