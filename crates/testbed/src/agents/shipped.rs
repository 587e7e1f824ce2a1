//! Files of a run that VNFs read on other machines: the testbed file, and what it names.

use std::{
    collections::BTreeMap,
    fs, io,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use cotorra_agent_protocol::Shipped;

use super::error::AgentsError;
use crate::report::RunFolder;

/// Most bytes of all files together.
const MOST: u64 = 64 << 20;

/// Lists the files of a new run's folder, before the run writes its results there. Returns their paths by SHA-256, too.
pub(super) fn list(folder: &Path) -> Result<(Vec<Shipped>, BTreeMap<String, PathBuf>), AgentsError> {
    let mut found = Vec::new();
    walk(folder, &mut found)?;
    found.sort();
    let (mut shipped, mut paths, mut total) = (Vec::new(), BTreeMap::new(), 0);
    for path in found {
        let at = |source: io::Error| AgentsError::File { path: path.clone(), source };
        let name = path.strip_prefix(folder).unwrap_or(&path).to_string_lossy().into_owned();
        let first = name.split('/').next().unwrap_or_default();
        if RunFolder::NAMES.contains(&first) {
            continue;
        }
        let metadata = fs::metadata(&path).map_err(at)?;
        total += metadata.len();
        if total > MOST {
            return Err(AgentsError::TooLarge { path, most: MOST });
        }
        let bytes = fs::read(&path).map_err(at)?;
        let executable = metadata.permissions().mode() & 0o111 != 0;
        let file = Shipped::new(name, &bytes, executable);
        paths.insert(file.sha256.clone(), path);
        shipped.push(file);
    }
    Ok((shipped, paths))
}

fn walk(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), AgentsError> {
    let at = |source: io::Error| AgentsError::File { path: folder.to_owned(), source };
    for entry in fs::read_dir(folder).map_err(at)? {
        let entry = entry.map_err(at)?;
        if entry.file_type().map_err(at)?.is_dir() {
            walk(&entry.path(), found)?;
        } else {
            found.push(entry.path());
        }
    }
    Ok(())
}
