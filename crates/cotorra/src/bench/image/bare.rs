//! Starts of an image by the engine's own program, for comparison.

use std::{
    env, fs, io,
    os::unix::process::CommandExt as _,
    process::{self, Command, Stdio},
};

use cotorra_containers::ContainerEngine;

use super::{EngineWord, ImageArgs, times::Times};

/// Measures starts of the image by `podman run -d` or `docker run -d`, while `goes_on`, which gets each start's number. The
/// containers have the label of a run.
///
/// # Errors
/// The reason for which there are none, for people.
#[allow(clippy::disallowed_types, reason = "real containers take real time")]
pub fn starts(
    args: &ImageArgs,
    run: &ContainerEngine,
    goes_on: impl Fn(u16) -> bool,
) -> Result<Times, String> {
    let mut series = Vec::new();
    // The first one is not counted, as with cotorra.
    for number in 0..=args.runs {
        if !goes_on(number.max(1)) {
            break;
        }
        let container = Container(args.engine, format!("cotorra-bench-{}-{number}", process::id()));
        let began = std::time::Instant::now();
        container.start(args, run)?;
        let took = began.elapsed();
        if number > 0 {
            series.push(took);
        }
    }
    Times::of(series).ok_or_else(|| "it was stopped".to_owned())
}

/// A container by its name. Dropping it removes it.
struct Container(EngineWord, String);

impl Container {
    /// Starts it as one of the containers of a run, which are removed with it.
    fn start(&self, args: &ImageArgs, run: &ContainerEngine) -> Result<(), String> {
        let mut command = client(self.0);
        command.args(["run", "-d", "--pull", "never", "--network", "none", "--name", &self.1]);
        command.args(["--label", run.label()]).stdin(run.lifeline().map_err(|error| error.to_string())?);
        let own = fs::read_to_string("/proc/self/limits").unwrap_or_default();
        let limits = [("nofile", "Max open files", 1 << 16), ("nproc", "Max processes", 1 << 14)];
        // The engine's own may exceed what it may set. cotorra's containers have these, too.
        let limits = limits.map(|(name, line, most)| format!("{name}={}", limit(&own, line, most)));
        command.args(limits.iter().flat_map(|limit| ["--ulimit", limit]));
        command.args(args.env.iter().flat_map(|named| ["--env", named]));
        command.arg(&args.image).args(&args.command);
        let done = command.stdout(Stdio::null()).output();
        let done = done.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => format!("the program `{}` is not installed", self.0.kind().name()),
            _ => error.to_string(),
        })?;
        let said = String::from_utf8_lossy(&done.stderr);
        if done.status.success() {
            Ok(())
        } else {
            Err(said.lines().last().unwrap_or("it failed").to_owned())
        }
    }
}

impl Drop for Container {
    fn drop(&mut self) {
        // Killed first, because podman's `rm -f` waits ten seconds for an orderly end. It may have ended, or never started.
        for words in [&["kill"][..], &["rm", "-f", "-v"]] {
            let _ = client(self.0).args(words).arg(&self.1).output();
        }
    }
}

/// Returns a command of the engine's program, at the same engine as cotorra's.
fn client(engine: EngineWord) -> Command {
    let mut command = Command::new(engine.kind().name());
    // Only then does it use the socket in that variable, as cotorra does.
    if engine == EngineWord::Podman && env::var_os("CONTAINER_HOST").is_some_and(|host| !host.is_empty()) {
        command.arg("--remote");
    }
    // Ctrl-C must not end it halfway.
    command.process_group(0).stdin(Stdio::null());
    command
}

/// Returns this process's hard limit of a resource, from its line in `/proc/self/limits`, and `most` at most.
fn limit(limits: &str, line: &str, most: u64) -> u64 {
    let found = limits.lines().find_map(|text| text.strip_prefix(line)?.split_ascii_whitespace().nth(1));
    // An unlimited resource has no number.
    found.and_then(|hard| hard.parse().ok()).unwrap_or(most).min(most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_those_of_the_process() {
        let limits = "Limit            Soft Limit  Hard Limit  Units\n\
                      Max processes    unlimited   unlimited   processes\n\
                      Max open files   1024        20000       files\n";
        assert_eq!(limit(limits, "Max open files", 1 << 16), 20000);
        assert_eq!(limit(limits, "Max open files", 10), 10);
        assert_eq!(limit(limits, "Max processes", 99), 99);
        assert_eq!(limit("", "Max processes", 99), 99);
    }
}
