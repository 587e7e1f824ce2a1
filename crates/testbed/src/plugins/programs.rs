//! Plug-ins of a testbed that are programs.

use std::{env, io};

use cotorra_graph::{DecidesIn, PluginId, PluginProgram, PluginSpec, Testbed};

use super::error::PluginError;

/// Returns the plug-ins of a testbed that are programs.
pub(crate) fn programs(testbed: &Testbed) -> impl Iterator<Item = &PluginId> {
    let is_program = |spec: &&PluginSpec| matches!(spec.program, PluginProgram::Command(_));
    testbed.plugins.iter().filter(is_program).map(|spec| &spec.id)
}

/// Returns why runs of a testbed in virtual time do not repeat to the byte; `None` if they do.
pub fn inexact(testbed: &Testbed) -> Option<String> {
    let is_measured = |spec: &&PluginSpec| spec.distance.decides_in.is_some_and(DecidesIn::is_measured);
    let measured = testbed.plugins.iter().filter(is_measured).map(|spec| format!("`{}`", spec.id));
    let measured: Vec<_> = measured.collect();
    (!measured.is_empty()).then(|| {
        format!(
            "times of decisions were measured (`decides_in: cpu` of {}): repeats differ",
            measured.join(", ")
        )
    })
}

/// Checks that the programs of plug-ins exist.
pub(crate) fn check_programs(testbed: &Testbed) -> Result<(), PluginError> {
    for spec in &testbed.plugins {
        let PluginProgram::Command(words) = &spec.program else { continue };
        let program = program(spec, words)?.0;
        let is_there = if program.contains('/') {
            testbed.folder.join(program).exists()
        } else {
            let folders = env::var_os("PATH").unwrap_or_default();
            env::split_paths(&folders).any(|folder| folder.join(program).exists())
        };
        if !is_there {
            let source = io::Error::from(io::ErrorKind::NotFound);
            let plugin = spec.id.clone();
            return Err(PluginError::Start { plugin, program: program.to_owned(), source });
        }
    }
    Ok(())
}

/// Splits a plug-in's command into the program and its arguments.
pub(super) fn program<'a>(
    spec: &PluginSpec,
    words: &'a [String],
) -> Result<(&'a String, &'a [String]), PluginError> {
    words.split_first().ok_or_else(|| PluginError::Settings {
        plugin: spec.id.clone(),
        reason: "its command is empty".to_owned(),
    })
}
