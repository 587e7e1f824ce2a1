//! podman's service, for machines where no other process serves podman.

use std::{
    fs, io,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

/// podman's service, which serves its interface at a socket. Dropping it ends it; containers go on.
#[derive(Debug)]
pub(crate) struct Service(Child);

impl Service {
    /// Returns the socket in the folder of a service.
    pub(crate) fn socket(folder: &Path) -> PathBuf {
        folder.join("socket")
    }

    /// Starts a service in a folder, whose output goes to `output`.
    pub(crate) fn start(folder: &Path, output: fn() -> Stdio) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let socket = Self::socket(folder);
        // podman refuses a socket that exists.
        let _ = fs::remove_file(&socket);
        let process = Command::new("podman")
            .args(["system", "service", "--time=0"])
            .arg(format!("unix://{}", socket.display()))
            // Its monitors of containers leave files where they run.
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(output())
            .stderr(output())
            .spawn()
            .map_err(|e| io::Error::new(e.kind(), format!("cannot start podman: {e}")))?;
        Ok(Self(process))
    }

    pub(crate) fn has_ended(&mut self) -> bool {
        !matches!(self.0.try_wait(), Ok(None))
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
