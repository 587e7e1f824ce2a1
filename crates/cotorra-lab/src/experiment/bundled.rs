//! The testbeds of the published experiments, for a program without its checkout.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use cotorra::{TemporaryFolder, note};
use cotorra_testbed::FolderError;

/// Default testbed file of `cotorra-lab experiment okpi`.
pub const CORRIDOR: &str = "testbeds/corridor.yaml";
/// Default testbed file of `cotorra-lab experiment federation`.
pub const FEDERATION: &str = "testbeds/federation.yaml";
/// Default testbed file of `cotorra-lab experiment handover`.
pub const CORRIDOR_WIFI: &str = "testbeds/corridor-wifi.yaml";

/// The files, and the picture of the map: each run of equal bytes as that byte and a length of two bytes (build.rs).
const FILES: [(&str, &str); 4] = [
    ("corridor.yaml", include_str!("../../../../testbeds/corridor.yaml")),
    ("corridor-wifi.yaml", include_str!("../../../../testbeds/corridor-wifi.yaml")),
    ("federation.yaml", include_str!("../../../../testbeds/federation.yaml")),
    ("maps/corridor.yaml", include_str!("../../../../testbeds/maps/corridor.yaml")),
];
const PICTURE: (&str, &[u8]) =
    ("maps/corridor.pgm", include_bytes!(concat!(env!("OUT_DIR"), "/corridor.packed")));

/// Bundled testbeds in a folder of their own, which is removed on drop.
#[derive(Debug)]
pub struct Bundled {
    folder: TemporaryFolder,
}

impl Bundled {
    /// Writes the bundled testbeds if a default file does not exist, and lets `file` name the one that was meant.
    pub fn instead_of(file: &mut PathBuf) -> Result<Option<Self>, FolderError> {
        let is_default =
            [CORRIDOR, FEDERATION, CORRIDOR_WIFI].iter().any(|default| file == Path::new(default));
        if !is_default || file.exists() {
            return Ok(None);
        }
        let bundled = Self::write(TemporaryFolder::new()?)?;
        note!("there is no {} here: the bundled one is used", file.display());
        *file = bundled.folder.path().join(file.file_name().expect("the defaults have names"));
        Ok(Some(bundled))
    }

    fn write(folder: TemporaryFolder) -> Result<Self, FolderError> {
        let maps = folder.path().join("maps");
        fs::create_dir(&maps).map_err(|error| FolderError::new(&maps, error))?;
        let texts = FILES.iter().map(|(name, text)| (*name, text.as_bytes().to_vec()));
        for (name, bytes) in texts.chain([(PICTURE.0, unpacked(PICTURE.1))]) {
            let path = folder.path().join(name);
            fs::write(&path, bytes).map_err(|error: io::Error| FolderError::new(&path, error))?;
        }
        Ok(Self { folder })
    }
}

/// Unpacks what build.rs packed.
fn unpacked(packed: &[u8]) -> Vec<u8> {
    let run = |run: &[u8]| std::iter::repeat_n(run[0], usize::from(u16::from_le_bytes([run[1], run[2]])));
    packed.chunks_exact(3).flat_map(run).collect()
}

#[cfg(test)]
mod tests {
    use cotorra_testing::project_file;

    use super::*;

    #[test]
    fn bundled_testbeds_are_those_of_the_checkout() {
        let base = tempfile::tempdir().unwrap();
        let bundled = Bundled::write(TemporaryFolder::within(base.path()).unwrap()).unwrap();
        for (name, _) in FILES.map(|(name, _)| (name, ())).into_iter().chain([(PICTURE.0, ())]) {
            let read = |path: PathBuf| fs::read(path).unwrap();
            let copy = bundled.folder.path().join(name);
            assert!(read(copy) == read(project_file("testbeds").join(name)), "{name}");
        }
    }

    #[test]
    fn only_default_files_that_are_missing_are_replaced() {
        // Tests run in the folder of the crate, where there are no testbeds.
        let mut named = PathBuf::from("mine.yaml");
        assert!(Bundled::instead_of(&mut named).unwrap().is_none());
        assert_eq!(named, Path::new("mine.yaml"));
        for default in [CORRIDOR, FEDERATION] {
            let mut file = PathBuf::from(default);
            let bundled = Bundled::instead_of(&mut file).unwrap();
            assert!(bundled.is_some());
            cotorra::load(&file, &[]).unwrap();
        }
    }
}
