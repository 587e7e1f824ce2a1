//! `cotorra capture` and `cotorra run --capture`: files that tshark reads.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{
    fs,
    path::Path,
    process::{Child, Output, Stdio},
};

use cotorra_testing::tshark;
use tempfile::TempDir;

use crate::{
    harness::{Run, cotorra, kill, project_file, stderr, wait_until},
    one_robot::{NAVIGATED, testbed},
};

/// Starts a capture, and waits until it has begun.
fn begin(run: &Run, file: &Path, arguments: &[&str]) -> Child {
    let mut command = cotorra(["capture", "--api", run.address(), "-o", file.to_str().unwrap()]);
    let mut child = command.args(arguments).stderr(Stdio::piped()).spawn().unwrap();
    // The file is created when the run answers, unless it refuses.
    wait_until(|| file.exists() || child.try_wait().unwrap().is_some());
    child
}

fn refused(run: &Run, file: &Path, arguments: &[&str]) -> String {
    let output = begin(run, file, arguments).wait_with_output().unwrap();
    assert!(!output.status.success(), "{arguments:?}");
    said(&output)
}

/// Returns what a command said, in one line.
fn said(output: &Output) -> String {
    stderr(output).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

/// Sends three echo requests, and returns once they are answered.
fn ping(run: &Run) {
    let arguments =
        ["exec", "left", "--api", run.address(), "--", "ping", "-4", "-c", "3", "-i", "0.2", "right"];
    let output = cotorra(arguments).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

/// Returns these fields of each packet in a file, as tshark reads them; `None` without tshark.
fn read(file: &Path, fields: &[&str]) -> Option<Vec<Vec<String>>> {
    let mut command = tshark()?;
    command.arg("-r").arg(file).args(["-T", "fields", "-E", "occurrence=f"]);
    let output = command.args(fields.iter().flat_map(|field| ["-e", field])).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let text = String::from_utf8(output.stdout).unwrap();
    Some(text.lines().map(|line| line.split('\t').map(str::to_owned).collect()).collect())
}

/// Returns the time in a comment, in seconds.
fn time(comment: &str, what: &str) -> f64 {
    let after = comment.split_once(&format!("{what} ")).unwrap().1;
    after.split_once(" s").unwrap().0.parse().unwrap()
}

#[test]
fn links_of_a_run_are_captured_with_due_and_delivered_times() {
    let folder = TempDir::new().unwrap();
    let run = Run::start(&project_file("testbeds/two-hosts.yaml"), &["--until", "600s"]);
    let file = folder.path().join("lan.pcapng");
    let capture = begin(&run, &file, &["left-lan", "--filter", "icmp and host right", "--packets", "6"]);
    ping(&run);
    let output = capture.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).starts_with("6 packets in "), "{}", stderr(&output));
    if let Some(packets) =
        read(&file, &["frame.interface_name", "icmp.type", "frame.time_epoch", "frame.comment"])
    {
        let kinds: Vec<_> = packets.iter().map(|packet| format!("{} {}", packet[0], packet[1])).collect();
        assert_eq!(kinds, ["left-lan forward 8", "left-lan backward 0"].repeat(3));
        for packet in packets {
            let [entered, due, delivered] =
                ["entered", "due", "delivered"].map(|what| time(&packet[3], what));
            // The link has a delay of 1 ms.
            assert!(due - entered > 0.000_999 && delivered >= due, "{packet:?}");
            assert_eq!(packet[2].parse::<f64>().unwrap(), due);
        }
    }

    // Nothing is overwritten, and nothing is left of what cannot be.
    let before = fs::read(&file).unwrap();
    assert!(refused(&run, &file, &["left-lan"]).contains("exists already"));
    assert_eq!(fs::read(&file).unwrap(), before);
    let nowhere = folder.path().join("nowhere.pcapng");
    assert!(refused(&run, &nowhere, &["nothing"]).contains("there is no link or node `nothing`"));
    assert!(refused(&run, &nowhere, &["lan", "--filter", "vlan 7"]).contains("`vlan` is unknown"));
    assert!(!nowhere.exists());
}

#[test]
fn an_interrupted_capture_leaves_a_whole_file() {
    let folder = TempDir::new().unwrap();
    let mut run = Run::start(&project_file("testbeds/two-hosts.yaml"), &["--until", "600s"]);
    let [file, other] = ["interrupted.pcapng", "ended.pcapng"].map(|name| folder.path().join(name));
    let mut interrupted = begin(&run, &file, &["lan", "--snap", "60"]);
    let ended = begin(&run, &other, &["lan"]);
    ping(&run);
    // Requests and answers, on both links of the switch. A capture that has ended has an error to show.
    let is_written = || fs::metadata(&file).unwrap().len() > 12 * 60;
    wait_until(|| is_written() || interrupted.try_wait().unwrap().is_some());
    assert!(
        interrupted.try_wait().unwrap().is_none(),
        "{}",
        stderr(&interrupted.wait_with_output().unwrap())
    );
    kill("INT", &interrupted.id().to_string());
    let output = interrupted.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    run.signal("INT");
    run.wait();
    let output = ended.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    if let Some(packets) = read(&file, &["frame.cap_len"]) {
        assert!(!packets.is_empty() && packets.iter().all(|packet| packet[0].parse::<u32>().unwrap() <= 60));
    }
    if let Some(packets) = read(&other, &["frame.interface_name"]) {
        assert!(packets.iter().any(|packet| packet[0].starts_with("lan-right")), "{packets:?}");
    }
}

#[test]
fn virtual_time_captures_the_same_bytes_each_time() {
    let folder = TempDir::new().unwrap();
    let robot = "{ kind: robot, position: [2, 3] }";
    let testbed = testbed(folder.path(), "captured", robot, NAVIGATED);
    let simulate = |of: &str, file: &Path| {
        let capture = format!("{of}={}", file.display());
        let arguments = ["run", "--simulate", "--headless", "--until", "5s", "--capture", &capture, "--out"];
        cotorra(arguments).args([folder.path(), &testbed]).output().unwrap()
    };
    let files = ["one.pcapng", "two.pcapng"].map(|name| folder.path().join(name));
    for file in &files {
        let output = simulate("tb", file);
        assert!(output.status.success(), "{}", stderr(&output));
    }
    assert!(fs::metadata(&files[0]).unwrap().len() > 1000);
    assert!(fs::read(&files[0]).unwrap() == fs::read(&files[1]).unwrap(), "the captures differ");
    if let Some(packets) = read(&files[0], &["frame.interface_name", "udp.length", "frame.comment"]) {
        assert_eq!(packets[0][0], "tb~R1 forward");
        assert_eq!(packets[1][0], "tb~R1 backward");
        let on_time = |comment: &str| time(comment, "due") == time(comment, "delivered");
        assert!(packets.iter().all(|packet| !packet[1].is_empty() && on_time(&packet[2])), "{packets:?}");
    }
    let output = simulate("nobody", &folder.path().join("nobody.pcapng"));
    assert!(
        said(&output).contains("cannot capture: there is no link or node `nobody`"),
        "{}",
        stderr(&output)
    );
    assert!(said(&simulate("tb", &files[0])).contains("exists already"));
}
