//! Tells the program the commit that it is built from, and hashes the source code, so that kept runs of sweeps tell one build
//! from another of the same version.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

fn main() {
    let crate_folder = env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it");
    let root = Path::new(&crate_folder).join("../..");
    sources(&root).iter().filter(|path| path.exists()).for_each(|path| watch(path));
    println!("cargo::rustc-env=COTORRA_COMMIT={}", commit(&root).unwrap_or_else(|| "unknown".to_owned()));
    println!("cargo::rustc-env=COTORRA_SOURCES={:016x}", hash_of_sources(&root));
}

/// Lets cargo run this again when a file, or one in a folder, changes.
fn watch(path: &Path) {
    println!("cargo::rerun-if-changed={}", path.display());
}

/// Returns what decides the commit: the log of the checkout's commits, and the sources of the program, which can differ from
/// their commit.
fn sources(root: &Path) -> Vec<PathBuf> {
    let below = |folder: &Path| {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).collect::<Vec<_>>()
    };
    let mut found = vec![root.join(".git/logs/HEAD"), root.join("Cargo.lock")];
    for path in ["crates", "plugins"].iter().flat_map(|folder| below(&root.join(folder))) {
        // It is a crate, or a folder of several.
        found.extend(below(&path).into_iter().map(|path| path.join("src")));
        found.push(path.join("src"));
    }
    found
}

/// Returns the commit of the checkout, with `+changes` if its sources differ from that; `None` outside of one.
fn commit(root: &Path) -> Option<String> {
    // A checkout of another project may hold a copy of this one without its `.git`.
    if !root.join(".git").exists() {
        return None;
    }
    let git = |arguments: &[&str]| {
        let output = Command::new("git").arg("-C").arg(root).args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let commit = git(&["rev-parse", "HEAD"])?;
    let changed = git(&["status", "--porcelain", "--", "crates", "plugins", "Cargo.toml", "Cargo.lock"])?;
    Some(if changed.is_empty() { commit } else { commit + "+changes" })
}

/// Returns the FNV-1a hash of the workspace's source code and of its dependencies' versions.
fn hash_of_sources(workspace: &Path) -> u64 {
    let mut files = vec![workspace.join("Cargo.lock")];
    let mut folders = ["crates", "plugins"].map(|folder| (workspace.join(folder), false)).to_vec();
    while let Some((folder, is_source)) = folders.pop() {
        let entries = fs::read_dir(&folder).expect("the checkout has the sources");
        for entry in entries {
            let path = entry.expect("it is readable").path();
            let is_beginning = !is_source && path.ends_with("src");
            if path.is_dir() {
                folders.push((path, is_source || is_beginning));
            } else if is_source {
                files.push(path);
            }
        }
    }
    files.sort();
    let of_workspace = |path: &PathBuf| path.strip_prefix(workspace).map(Path::to_owned).unwrap_or_default();
    let texts = files.iter().flat_map(|path| {
        let name = of_workspace(path).to_string_lossy().into_owned().into_bytes();
        [name, fs::read(path).expect("it is readable")]
    });
    texts.fold(0xcbf2_9ce4_8422_2325, |hash, text| {
        // The length keeps one text apart from the next.
        let bytes = text.len().to_le_bytes().into_iter().chain(text);
        bytes.fold(hash, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
    })
}
