//! The arguments of this process that have a part in results, for the command that repeats them.

use clap::{ArgAction, ArgMatches, Command, CommandFactory, parser::ValueSource};

use crate::cli::Cli;

/// Arguments that have no part in results, or that name files which a repeat has elsewhere.
const LEFT_OUT: [&str; 15] = [
    "dry_run", "file", "formats", "fresh", "headless", "help", "history", "jobs", "measured", "out",
    "settings", "testbed", "verbose", "version", "with",
];

/// Returns the arguments of this process's command that have a part in results, in the order of their declaration. The
/// values of its files and settings are for the caller to add.
pub fn words() -> Vec<String> {
    let mut command = Cli::command();
    command.build();
    given_in(&command, &command.clone().get_matches())
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the arguments that a command line gives.
    fn given_by(line: &str) -> Vec<String> {
        let mut command = Cli::command();
        command.build();
        given_in(&command, &command.clone().get_matches_from(line.split(' ')))
    }

    #[test]
    fn arguments_that_decide_results_are_given_again() {
        let line = "cotorra sweep x.yaml --set plugin=okpi,probing --seeds 3 --jobs 2 --out y --headless --shard 1/2";
        assert_eq!(given_by(line), ["sweep", "--set=plugin=okpi,probing", "--seeds=3", "--shard=1/2"]);
        let line = "cotorra margin x.yaml --kpi a --kpi b --set a=1 --change delay,down --most 20ms --singles --fresh";
        let expected =
            ["margin", "--kpi=a", "--kpi=b", "--change=delay", "--change=down", "--most=20ms", "--singles"];
        assert_eq!(given_by(line), expected);
        let line = "cotorra experiment okpi --until 60s --set a=1 --seed 7 --figure pdf -vv --measured w.csv";
        assert_eq!(given_by(line), ["experiment", "okpi", "--seed=7", "--until=60s"]);
    }
}
