//! Processes that end with the test, and waiting for what they do.

use std::{
    io::{self, Read},
    os::unix::process::CommandExt,
    process::{Child, Command, Stdio},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use parking_lot::Mutex;

/// Deadline of every wait, far beyond what a busy machine needs.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Waits until the condition holds.
///
/// # Panics
///
/// If it does not hold within [`PATIENCE`].
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < PATIENCE, "not within {PATIENCE:?}: {what}");
        thread::sleep(Duration::from_millis(10));
    }
}

/// Asserts that a text contains all parts.
pub fn contains(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "no `{part}` in:\n{text}");
    }
}

/// A process with its children and its output. Killed when dropped.
pub struct Process {
    child: Child,
    output: Arc<Mutex<Vec<u8>>>,
}

impl Process {
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        let (mut reader, writer) = io::pipe()?;
        command.stdin(Stdio::null()).stdout(writer.try_clone()?).stderr(writer).process_group(0);
        let child = command.spawn()?;
        // The command would otherwise keep the writing ends open, and the reader would never see their end.
        command.stdout(Stdio::null()).stderr(Stdio::null());
        let output = Arc::new(Mutex::new(Vec::new()));
        let collected = Arc::clone(&output);
        thread::spawn(move || {
            let mut piece = [0; 4096];
            while let Ok(read @ 1..) = reader.read(&mut piece) {
                collected.lock().extend_from_slice(&piece[..read]);
            }
        });
        Ok(Self { child, output })
    }

    /// Returns its output so far.
    pub fn output(&self) -> String {
        String::from_utf8_lossy(&self.output.lock()).into_owned()
    }

    /// Waits until it printed a text.
    pub fn prints(&self, what: &str) {
        until(&format!("it prints `{what}`"), || self.output().contains(what));
    }

    /// Sends Ctrl-C, and waits until the process and its children ended.
    pub fn interrupt(mut self) {
        let group = self.child.id();
        signal("INT", group);
        until("a process ends by Ctrl-C", || self.child.try_wait().unwrap().is_some() && !signal("0", group));
    }
}

/// Signals a process and its children. Returns whether there is any.
fn signal(name: &str, group: u32) -> bool {
    let group = format!("-{group}");
    let status = Command::new("kill").args(["-s", name, "--", &group]).stderr(Stdio::null()).status();
    status.unwrap().success()
}

impl Drop for Process {
    fn drop(&mut self) {
        signal("KILL", self.child.id());
        let _ = self.child.wait();
    }
}
