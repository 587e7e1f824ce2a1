//! The folder of an experiment.

use std::{fs, path::Path};

/// Removes an experiment's folder, and the folder around it, if they are empty: an experiment that cannot begin leaves
/// nothing.
pub fn withdraw(folder: &Path) {
    // A folder that is not empty stays.
    let _ = fs::remove_dir(folder).and_then(|()| folder.parent().map_or(Ok(()), fs::remove_dir));
}
