//! What started runs, for the manifests of their folders: the command line without secrets, and the words that repeat it.

use std::{env, path::Path};

use cotorra_recording::RecordingPlace;
use cotorra_testbed::{FolderError, Made, Manifest, ManyInputs, Options, Origin, Repeat, Time};

/// The commit that this program was built from, as build.rs found it.
pub const COMMIT: &str = env!("COTORRA_COMMIT");

/// A hash of the source code that this program was built from.
pub const SOURCES: &str = env!("COTORRA_SOURCES");

/// Returns what started runs that are repeated like this.
pub fn of(repeat: Repeat) -> Origin {
    let command = env::args_os().skip(1).map(|word| without_secrets(&word.to_string_lossy()));
    let command = std::iter::once("cotorra".to_owned()).chain(command).collect();
    Origin { command, commit: COMMIT.to_owned(), repeat }
}

/// Returns what started a run with these options.
pub fn of_run(options: &Options, time: Time) -> Origin {
    if options.after.as_ref().is_some_and(|previous| previous.has_notes()) {
        let why = "it continued negotiations of an earlier run (--after), whose state is in a ledger";
        return of(Repeat::Not(why.to_owned()));
    }
    let mut words = vec!["run".to_owned(), "testbed.yaml".to_owned()];
    if time == Time::Virtual {
        words.push("--simulate".to_owned());
    }
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
    use super::*;

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
}
