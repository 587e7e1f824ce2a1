//! Writes measured times into a testbed file.

use std::{
    io,
    path::{Path, PathBuf},
};

use cotorra_graph::VnfId;
use cotorra_testbed_file::{VnfKeysError, set_vnf_keys};
use miette::Diagnostic;

use super::times::{Times, in_ms};
use crate::{replaced::replace, testbed_file::FileError};

/// Keys of a VNF, each with its value.
type Keys = Vec<(&'static str, String)>;

/// A VNF of a testbed file that takes times.
#[derive(Debug)]
pub struct Target {
    file: PathBuf,
    vnf: VnfId,
}

#[derive(Debug, thiserror::Error, Diagnostic)]
enum Error {
    #[error("cannot write times of VNF `{vnf}` into {}: {source}", file.display())]
    Keys { file: PathBuf, vnf: VnfId, source: VnfKeysError },
    #[error("cannot write {}: {source}", file.display())]
    Write { file: PathBuf, source: io::Error },
}

impl Target {
    /// Checks that times can be written.
    ///
    /// # Errors
    /// An error if the file is not valid, or does not describe such a VNF with an image.
    pub fn open(file: &Path, vnf: &VnfId) -> miette::Result<Self> {
        // A link keeps leading to the file.
        let path =
            file.canonicalize().map_err(|reason| FileError::Unreadable { path: file.to_owned(), reason })?;
        let target = Self { file: path, vnf: vnf.clone() };
        target.changed(&vec![("start_time", "1 ms".to_owned()), ("processing_delay", "1 ms".to_owned())])?;
        Ok(target)
    }

    /// Returns the file's text with keys set.
    fn changed(&self, keys: &Keys) -> miette::Result<String> {
        let Self { file, vnf } = self;
        let text = cotorra_testbed_file::read(file)
            .map_err(|reason| FileError::Unreadable { path: file.clone(), reason })?;
        let keys: Vec<_> = keys.iter().map(|(key, value)| (*key, value.as_str())).collect();
        let text = set_vnf_keys(&text, vnf, &keys).map_err(|source| Error::Keys {
            file: file.clone(),
            vnf: vnf.clone(),
            source,
        })?;
        let folder = file.parent().unwrap_or(Path::new(""));
        cotorra_testbed_file::parse(&file.display().to_string(), &text, folder).map_err(FileError::from)?;
        Ok(text)
    }

    /// Writes the medians, completely or not at all. Returns what it wrote, for people.
    pub fn write(&self, start: &Times, processing: Option<&Times>) -> miette::Result<String> {
        let mut keys = vec![("start_time", in_ms(start.median))];
        keys.extend(processing.map(|times| ("processing_delay", in_ms(times.median))));
        let text = self.changed(&keys)?;
        let fail = |source| Error::Write { file: self.file.clone(), source };
        // It stays its owner's, also if root measured.
        replace(&self.file, text.as_bytes()).map_err(fail)?;
        let keys: Vec<_> = keys.iter().map(|(key, value)| format!("{key}: {value}")).collect();
        Ok(format!("VNF `{}` in {}: {}", self.vnf, self.file.display(), keys.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, time::Duration};

    use super::*;

    fn corridor(folder: &Path, navigation: &str) -> PathBuf {
        let testbeds = cotorra_testing::project_file("testbeds");
        let text = fs::read_to_string(testbeds.join("corridor.yaml")).unwrap();
        fs::create_dir(folder.join("maps")).unwrap();
        for map in fs::read_dir(testbeds.join("maps")).unwrap().flatten() {
            fs::copy(map.path(), folder.join("maps").join(map.file_name())).unwrap();
        }
        let file = folder.join("testbed.yaml");
        fs::write(&file, text.replace("program: navigation,", navigation)).unwrap();
        file
    }

    fn times(us: u64) -> Times {
        let median = Duration::from_micros(us);
        Times { median, min: median, max: median }
    }

    #[test]
    fn medians_are_written_where_a_link_leads() {
        let folder = tempfile::tempdir().unwrap();
        let file = corridor(folder.path(), "program: navigation, image: 'lab/brain:1',");
        let link = folder.path().join("link.yaml");
        std::os::unix::fs::symlink(&file, &link).unwrap();
        let target = Target::open(&link, &VnfId::new("navigation").unwrap()).unwrap();
        let written = target.write(&times(512_345), Some(&times(3104))).unwrap();
        assert!(
            written.ends_with("testbed.yaml: start_time: 512 ms, processing_delay: 3.10 ms"),
            "{written}"
        );
        let text = fs::read_to_string(&file).unwrap();
        assert!(
            text.contains("image: 'lab/brain:1', start_time: 512 ms, processing_delay: 3.10 ms,"),
            "{text}"
        );
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    }

    #[test]
    fn a_vnf_that_takes_no_times_is_rejected_before_the_measurement() {
        let folder = tempfile::tempdir().unwrap();
        let file = corridor(folder.path(), "program: navigation,");
        let error =
            |file: &Path, vnf: &str| Target::open(file, &VnfId::new(vnf).unwrap()).unwrap_err().to_string();
        assert!(error(&file, "navigation").contains("has no image"));
        assert!(error(&file, "brain").contains("there are: "));
        assert!(error(&folder.path().join("none.yaml"), "brain").contains("cannot read"));
    }
}
