//! CPU time of processes and of everything that they started.

use std::{fs, io, time::Duration};

use crate::sys;

/// Returns the CPU time that a process and all its descendants have used.
///
/// The kernel's clock of a process has nanoseconds, and also counts threads that have ended. Children that have ended, and whose
/// parent knows it, are counted in ticks.
///
/// # Errors
/// The error of the system.
pub fn cpu_time_of(process: u32) -> io::Result<Duration> {
    let mut used = of_process(process)?;
    let mut left = children(process)?;
    while let Some(child) = left.pop() {
        // It may have ended meanwhile; then its parent counts it.
        if let (Ok(time), Ok(further)) = (of_process(child), children(child)) {
            used += time;
            left.extend(further);
        }
    }
    Ok(used)
}

/// Returns the CPU time of a process, and of its children that have ended.
fn of_process(process: u32) -> io::Result<Duration> {
    let ended = ticks_of_ended(&fs::read_to_string(format!("/proc/{process}/stat"))?);
    let ended = ended.ok_or_else(|| io::Error::other("/proc has another form than expected"))?;
    let tick = Duration::from_secs(1) / sys::ticks_per_second();
    Ok(sys::cpu_time(process.cast_signed())? + tick * ended)
}

/// Reads the ticks of a process's children that have ended from its line in `/proc/PID/stat`: fields 16 and 17, of which the
/// second can have spaces and brackets.
fn ticks_of_ended(line: &str) -> Option<u32> {
    let (_, fields) = line.rsplit_once(')')?;
    let mut fields = fields.split_ascii_whitespace().skip(13);
    let mut next = || fields.next()?.parse::<u32>().ok();
    Some(next()? + next()?)
}

fn children(process: u32) -> io::Result<Vec<u32>> {
    let mut all = Vec::new();
    for task in fs::read_dir(format!("/proc/{process}/task"))? {
        let task = task?.path();
        match fs::read_to_string(task.join("children")) {
            Ok(list) => {
                all.extend(list.split_ascii_whitespace().filter_map(|child| child.parse::<u32>().ok()))
            }
            // The thread has ended.
            Err(_) if !task.exists() => {}
            // A kernel without that file does not tell.
            Err(error) => return Err(error),
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use std::process::{Command, Stdio};

    use super::*;

    #[test]
    fn ended_children_are_read_behind_a_name_with_brackets() {
        let line = "7 (a) b) S 1 7 7 0 -1 4194560 10 20 0 0 1 2 30 12 20 0 1 0 5 0 0";
        assert_eq!(ticks_of_ended(line), Some(42));
        assert_eq!(ticks_of_ended("7 (a"), None);
    }

    #[test]
    fn the_time_of_a_program_and_of_its_children_counts() {
        // Each shell counts by itself, and the first waits for the second.
        let burn = "i=0; while [ $i -lt 20000 ]; do i=$((i+1)); done";
        let script = format!("{burn}; sh -c '{burn}; read line'; read line; echo end");
        let mut shell = Command::new("sh").args(["-c", &script]).stdin(Stdio::piped()).spawn().unwrap();
        let own = || sys::cpu_time(shell.id().cast_signed()).unwrap();
        let all = || cpu_time_of(shell.id()).unwrap();
        // The child lives and waits, so that all of its time is beside the shell's own.
        while children(shell.id()).unwrap().is_empty() || all() - own() < own() / 4 {
            std::thread::yield_now();
        }
        assert!(all() > own());
        shell.kill().unwrap();
        shell.wait().unwrap();
        assert!(cpu_time_of(shell.id()).is_err(), "it has ended");
    }
}
