//! The environment of third-party programs. They get only usual variables and those that the testbed file names, because
//! this process's variables may hold tokens and passwords.

use std::{
    env,
    ffi::{OsStr, OsString},
    process::Command,
};

/// Variables that all programs get: paths, locale, time zone, and settings for debugging.
const USUAL: &[&str] = &[
    // Names registers that the C library leaves alone, because the kernel does not keep them.
    "GLIBC_TUNABLES",
    "HOME",
    "LANG",
    "LANGUAGE",
    "LD_LIBRARY_PATH",
    "LOGNAME",
    "NO_COLOR",
    "PATH",
    "RUST_BACKTRACE",
    "SHELL",
    "TERM",
    "TMPDIR",
    "TZ",
    "USER",
    "CMAKE_PREFIX_PATH",
    "CYCLONEDDS_URI",
];
/// Prefixes of variables that all programs get: locale, Python, ROS and its middlewares.
const USUAL_BEGINNINGS: &[&str] =
    &["AMENT_", "COLCON_", "FASTDDS_", "FASTRTPS_", "LC_", "PYTHON", "RCL_", "RCUTILS_", "RMW_", "ROS_"];

/// A variable that a testbed file names: `NAME` or `NAME=VALUE`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variable<'a> {
    /// Its name.
    pub name: &'a str,
    /// The value that the file gives it; without one, it has its value here.
    pub given: Option<&'a str>,
}

impl<'a> Variable<'a> {
    /// Returns the variable that a text names.
    pub fn parse(text: &'a str) -> Self {
        match text.split_once('=') {
            Some((name, value)) => Self { name, given: Some(value) },
            None => Self { name: text, given: None },
        }
    }

    /// Returns its value, if it has one that is a text.
    pub fn value(self) -> Option<String> {
        self.given.map_or_else(|| env::var(self.name).ok(), |given| Some(given.to_owned()))
    }
}

/// Creates a command whose environment has only the usual variables and `named` ones: `NAME` has its value here, and
/// `NAME=VALUE` the one that it gives. Callers add others themselves.
pub fn program_of_others(program: impl AsRef<OsStr>, named: &[String]) -> Command {
    let mut command = Command::new(program);
    // The last output of a killed program of Python would be lost in its buffer.
    command.env_clear().env("PYTHONUNBUFFERED", "1").envs(allowed(env::vars_os(), named));
    command
}

/// Creates the command of these words, the program's name first, with the environment of [`program_of_others`].
///
/// # Errors
/// The reason, for people, if there are no words.
pub fn program_of(words: &[String], named: &[String]) -> Result<Command, String> {
    let (program, arguments) = words.split_first().ok_or("its command is empty")?;
    let mut command = program_of_others(program, named);
    command.args(arguments);
    Ok(command)
}

fn allowed(
    all: impl Iterator<Item = (OsString, OsString)>,
    named: &[String],
) -> impl Iterator<Item = (OsString, OsString)> {
    let named = || named.iter().map(|text| Variable::parse(text));
    let is_allowed = move |name: &str| {
        USUAL.contains(&name)
            || USUAL_BEGINNINGS.iter().any(|beginning| name.starts_with(beginning))
            || named().any(|variable| variable.name == name)
    };
    let given = named().filter_map(|Variable { name, given }| Some((name.into(), given?.into())));
    // Those given come last, so that they take the place of ours.
    all.filter(move |(name, _)| name.to_str().is_some_and(is_allowed)).chain(given)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn third_party_programs_get_usual_and_named_variables_only() {
        let ours = [
            ("PATH", "/bin"),
            ("ROS_DOMAIN_ID", "7"),
            ("LC_TIME", "C"),
            ("DISPLAY", ":0"),
            ("COTORRA_TOKEN", "secret"),
            ("COTORRA_DOMAIN_TOKENS", "a=secret"),
            ("COTORRA_LEDGER_PASSWORD", "secret"),
            ("COTORRA_HISTORY_PASSWORD", "secret"),
            ("AWS_SECRET_ACCESS_KEY", "secret"),
            ("ZENOH_CONFIG_OVERRIDE", "secret"),
        ];
        let ours = || ours.iter().map(|(name, value)| (OsString::from(name), OsString::from(value)));
        let names = |named: &[String]| {
            allowed(ours(), named).map(|(name, _)| name.into_string().unwrap()).collect::<Vec<_>>()
        };
        assert_eq!(names(&[]), ["PATH", "ROS_DOMAIN_ID", "LC_TIME"]);
        assert_eq!(names(&["DISPLAY".to_owned()]), ["PATH", "ROS_DOMAIN_ID", "LC_TIME", "DISPLAY"]);
    }
    #[test]
    fn given_values_replace_ours() {
        let named = ["LANG=C", "MODE=a=b", "EMPTY="].map(str::to_owned);
        let ours = [("LANG", "de_DE.UTF-8"), ("MODE", "secret")];
        let ours = ours.iter().map(|(name, value)| (OsString::from(name), OsString::from(value)));
        let all: std::collections::BTreeMap<_, _> = allowed(ours, &named).collect();
        let expected = [("EMPTY", ""), ("LANG", "C"), ("MODE", "a=b")];
        let expected = expected.map(|(name, value)| (OsString::from(name), OsString::from(value)));
        assert_eq!(all, expected.into());
    }
}
