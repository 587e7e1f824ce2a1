//! Processes of others that end with the test, and what waits for them; for ROS 1 and ROS 2.
#![allow(clippy::disallowed_types, clippy::disallowed_methods, reason = "waits for real processes")]

use std::{
    io::{self, Read},
    os::unix::process::CommandExt,
    process::{Child, Command, Stdio},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use parking_lot::Mutex;

/// How long anything may take; far more than it does, even on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Waits until the condition holds.
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < PATIENCE, "not within {PATIENCE:?}: {what}");
        thread::sleep(Duration::from_millis(10));
    }
}

/// Asserts that a text has all parts.
pub fn contains(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "no `{part}` in:\n{text}");
    }
}

/// A process with its children, and what it printed. Killed when dropped.
pub struct Process {
    child: Child,
    output: Arc<Mutex<Vec<u8>>>,
}

impl Process {
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        let (mut reader, writer) = io::pipe()?;
        command.stdin(Stdio::null()).stdout(writer.try_clone()?).stderr(writer).process_group(0);
        let child = command.spawn()?;
        // The command holds the writing ends.
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

    /// What it printed until now.
    pub fn output(&self) -> String {
        String::from_utf8_lossy(&self.output.lock()).into_owned()
    }

    /// Waits until it printed that.
    pub fn prints(&self, what: &str) {
        until(&format!("it prints `{what}`"), || self.output().contains(what));
    }

    /// Ctrl-C, and waits for its end and that of all that it started.
    pub fn interrupt(mut self) {
        let group = self.child.id();
        signal("INT", group);
        until("a process ends by Ctrl-C", || self.child.try_wait().unwrap().is_some() && !signal("0", group));
    }
}

/// Signals a process and all that it started. Returns whether there is any.
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
