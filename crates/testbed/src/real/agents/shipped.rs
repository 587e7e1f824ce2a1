//! Files of a run that VNFs read on other machines: the testbed file, and what it names.

use std::{
    collections::BTreeMap,
    fs, io,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use cotorra_agent_protocol::Shipped;

use super::error::AgentsError;
use crate::folder::whole;

/// Most bytes of all files together.
const MOST: u64 = 64 << 20;

/// Lists the files of a new run's folder, before the run writes its results there. Returns their paths by SHA-256, too.
pub(super) fn list(folder: &Path) -> Result<(Vec<Shipped>, BTreeMap<String, PathBuf>), AgentsError> {
    let files =
        whole::files(folder).map_err(|source| AgentsError::File { path: folder.to_owned(), source })?;
    let (mut shipped, mut paths, mut total) = (Vec::new(), BTreeMap::new(), 0);
    for file in files {
        let path = folder.join(&file);
        let at = |source: io::Error| AgentsError::File { path: path.clone(), source };
        let metadata = fs::metadata(&path).map_err(at)?;
        total += metadata.len();
        if total > MOST {
            return Err(AgentsError::TooLarge { path, most: MOST });
        }
        let bytes = fs::read(&path).map_err(at)?;
        let executable = metadata.permissions().mode() & 0o111 != 0;
        let file = Shipped::new(file.to_string_lossy().into_owned(), &bytes, executable);
        paths.insert(file.sha256.clone(), path);
        shipped.push(file);
    }
    Ok((shipped, paths))
}
