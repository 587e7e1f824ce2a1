//! `cotorra new plugin`: a plug-in that is a program of its own, with a testbed that runs it.

use std::path::PathBuf;

use clap::Args;

use super::{
    files::NewFile,
    plan,
    testbed::{self, Declared, TestbedError},
};

const PYTHON: &str = include_str!("templates/plugin.py");
const RUST: &str = include_str!("templates/plugin.rs");
const MANIFEST: &str = include_str!("templates/Cargo.toml.txt");

/// Make a plug-in in Python or Rust, and a testbed that runs it
///
/// The plug-in moves navigation to a nearer server when answers are late. It is a program that talks to the HTTP API, so it
/// needs no part of cotorra's source code. In Python it needs only the standard library. In Rust it needs two crates of
/// crates.io, because cotorra's own crates are not published there. Files that exist are never overwritten.
#[derive(Debug, Args)]
#[command(after_long_help = "\
Examples:
  cotorra new plugin nearer --python              makes the folder nearer/
  cotorra new plugin nearer --rust ../plugins/nearer
  cotorra new plugin nearer --rust --dry-run")]
pub struct PluginArgs {
    /// The plug-in's name: lower-case letters, digits, `-` and `_`
    #[arg(value_name = "NAME", value_parser = parse_name)]
    pub name: String,
    /// The new folder; default: the name
    #[arg(value_name = "DIR")]
    pub folder: Option<PathBuf>,
    #[command(flatten)]
    pub language: Language,
    /// Only say what would be written
    #[arg(short = 'n', long)]
    pub dry_run: bool,
}

/// Language of a plug-in.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct Language {
    /// In Rust: a crate
    #[arg(long)]
    pub rust: bool,
    /// In Python: one file
    #[arg(long)]
    pub python: bool,
}

/// Longest name of a plug-in and of a crate.
const LONGEST: usize = 63;

/// Parses a name that a plug-in and a crate can have.
fn parse_name(text: &str) -> Result<String, String> {
    let begins_well = text.starts_with(|c: char| c.is_ascii_lowercase());
    let is_valid = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-_".contains(c);
    if begins_well && text.chars().all(is_valid) && text.len() <= LONGEST {
        Ok(text.to_owned())
    } else {
        Err(format!("use 1 to {LONGEST} lower-case letters, digits, `-` and `_`, beginning with a letter"))
    }
}

/// Returns the files of the plug-in.
pub fn plugin(args: &PluginArgs) -> Result<Vec<NewFile>, TestbedError> {
    let (command, mut program) = if args.rust() {
        let manifest = MANIFEST.replace("NAME", &args.name);
        let files = vec![
            NewFile::new("Cargo.toml", manifest),
            NewFile::new("src/main.rs", RUST),
            NewFile::new(".gitignore", "/target\n/runs\n"),
        ];
        ("target/release/plugin", files)
    } else {
        ("python3, plugin.py", vec![NewFile::new("plugin.py", PYTHON)])
    };
    let (testbed, _) =
        testbed::files(&args.name, &plan::building(), Some(&Declared { id: &args.name, command }))?;
    program.extend(testbed);
    Ok(program)
}

impl PluginArgs {
    fn rust(&self) -> bool {
        self.language.rust
    }

    /// Returns the folder for the files.
    pub fn folder(&self) -> PathBuf {
        self.folder.clone().unwrap_or_else(|| PathBuf::from(&self.name))
    }

    /// Returns the commands after `cd` that try the plug-in.
    pub fn next(&self) -> Vec<&'static str> {
        let build = self.rust().then_some("cargo build --release");
        let run = ["cotorra run --simulate testbed.yaml", "cotorra history events latest --kinds decision"];
        build.into_iter().chain(run).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_fit_plugins_and_crates() {
        for good in ["a", "nearer", "my-plugin_2"] {
            assert_eq!(parse_name(good), Ok(good.to_owned()));
        }
        let long = "a".repeat(LONGEST + 1);
        for wrong in ["", "Nearer", "2nd", "-a", "a b", "a/b", "..", &long] {
            assert!(parse_name(wrong).is_err(), "{wrong}");
        }
    }
}
