//! The testbed file: what people write to describe a testbed. Read as a whole and checked as a whole, so that what
//! this module lets pass can run, and so that one look shows all that is wrong with what it does not.

mod build;
mod check;
mod records;

use std::path::Path;

use serde_json::{Value as Json, json};

use crate::{
    testbed::Testbed,
    yaml::{self, Diagnostics, Sink, decode::Decode},
};

/// Reads a testbed file, and the map and traces that it names.
///
/// # Errors
/// Everything that is wrong with it, each in its place.
pub fn load(path: impl AsRef<Path>) -> Result<Testbed, Diagnostics> {
    let path = path.as_ref();
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|error| {
        Diagnostics::of_file(&name, format!("the testbed file cannot be read: {error}"), "check its path")
    })?;
    parse(&name, &text, path.parent().unwrap_or(Path::new("")))
}

/// Reads a testbed file's text; `base_dir` is where the paths in it begin.
///
/// # Errors
/// Everything that is wrong with it, each in its place.
pub fn parse(source_name: &str, text: &str, base_dir: &Path) -> Result<Testbed, Diagnostics> {
    let mut sink = Sink::default();
    let testbed = yaml::parse(text, &mut sink)
        .and_then(|root| records::TestbedRecord::decode(&root, &mut sink))
        .and_then(|record| build::build(record, base_dir, &mut sink));
    match testbed {
        Some(testbed) if sink.is_empty() => Ok(testbed),
        _ => Err(sink.finish(source_name, text)),
    }
}

/// The JSON Schema (2020-12) of a testbed file, from the declarations that also read it.
pub fn schema() -> Json {
    let mut schema = records::TestbedRecord::schema();
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema["title"] = json!("cotorra testbed file");
    schema
}
