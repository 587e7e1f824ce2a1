//! Judges a run as a whole: why its figures are not valid, whatever each of them says.

use std::{io, path::Path, time::Duration};

use cotorra_graph::Timestamp;
use serde::Deserialize;

use super::{
    doubts::{Doubts, Samples},
    end::End,
    fidelity::Fidelity,
    folder::{SUMMARY, read_file},
    summary::Summary,
    void::Void,
};

/// Duration of a run after which each service has a sample.
const DUE: Duration = Duration::from_secs(10);
/// Size of the longest `summary.json` that is read, bytes.
pub(super) const LONGEST_SUMMARY: u64 = 64 << 20;

impl Fidelity {
    /// Reads the verdict on a run from its folder. It is not valid if anything speaks against the run's figures.
    ///
    /// # Errors
    /// That of the system, if the folder has no `summary.json`; `InvalidData` if the file holds no verdict.
    pub fn of_folder(folder: &Path) -> io::Result<Self> {
        #[derive(Deserialize)]
        struct Judged {
            fidelity: Fidelity,
            /// Missing in summaries of earlier versions.
            #[serde(default)]
            void: Vec<String>,
        }
        let text = read_file(&folder.join(SUMMARY), LONGEST_SUMMARY)?;
        let Judged { fidelity, void } = serde_json::from_slice(&text)?;
        Ok(if void.is_empty() {
            fidelity
        } else {
            Self { valid: false, reason: void.join("; "), ..fidelity }
        })
    }
}

impl Doubts {
    /// Judges the figures of a summary.
    pub(super) fn void(&self, summary: &Summary, end: Timestamp) -> Void {
        let mut void = Void::default();
        if summary.ended == End::Broken.as_str() {
            void.wrong_by([End::Broken.as_str().to_owned()]);
        }
        void.cut_off(self.cut_off.iter().cloned());
        void.wrong_by(self.lives.iter().filter_map(|((vnf, node), life)| {
            life.fault(end).map(|fault| format!("VNF {vnf} on {node} {fault}"))
        }));
        if end.since(Timestamp::ZERO) >= DUE || summary.is_walked() {
            void.missing(self.unserved.iter().map(|vnf| format!("VNF {vnf} never served")));
            let absent = self.absent.iter();
            void.wrong_by(absent.map(|(node, agent)| format!("agent {agent} of {node} never reported")));
            let faulty = self.faulty.iter().filter_map(|(robot, fault)| Some((robot, fault.as_ref()?)));
            void.wrong_by(faulty.map(|(robot, fault)| format!("robot {robot} never worked: {fault}")));
            void.missing(self.unmeasured(summary));
        }
        // Robots that stood out of reach sent nothing, which the end of the run says.
        let is_silent = summary.is_stuck() && summary.fidelity.frames == 0;
        let is_excused = is_silent && summary.fidelity.frames_dropped == 0;
        if !summary.fidelity.valid && !is_excused {
            let reason = [summary.fidelity.reason.clone()];
            match (summary.fidelity.frames, summary.fidelity.frames_dropped) {
                (0, 0) => void.missing(reason),
                _ => void.wrong_by(reason),
            }
        }
        void
    }

    /// Returns a sentence on each service that has no sample though it should.
    fn unmeasured<'a>(&'a self, summary: &'a Summary) -> impl Iterator<Item = String> + 'a {
        let is_measured = summary.services.iter().any(|its| its.samples > 0);
        let without = summary.services.iter().filter(|its| its.samples == 0);
        without.filter_map(move |its| {
            let why = match self.samples.get(&its.service)? {
                // Robots that stand send no scans, which the end of the run says.
                Samples::Robot if summary.is_stuck() && self.unserved.is_empty() => return None,
                Samples::Robot => "no packet of its robot was due or sent",
                Samples::Flow => "no request was seen",
                // The run said so at its start.
                Samples::NotRunning if is_measured => return None,
                Samples::NotRunning => "in virtual time its programs do not run",
            };
            Some(format!("service {} of {} has no sample: {why}", its.service, its.robot))
        })
    }
}

#[cfg(test)]
mod tests {
    use cotorra_graph::{Event, NodeId, Placement, ServiceTime, Stamped, Testbed, VnfEvent, VnfState};
    use cotorra_graph_testing as base;

    use super::*;
    use crate::report::{Losses, Report};

    const TESTBED: &str = "
name: test
wireless: { lab: {} }
nodes:
  r: { kind: robot, cpus: 4, memory: 8 GB }
  A: { kind: radio_unit, position: [0, 1], channel: 1 }
  s: { kind: server, tier: edge, cpus: 4, memory: 8 GB }
links:
  - { ends: [A, s] }
services:
  n:
    robot: r
    kpis: { service_time: 15 ms, radio: n }
    vnfs:
      driver: { program: robot_driver, pinned_to: r }
      navigation: { program: navigation, node: s }
  f:
    robot: r
    kpis: { service_time: 15 ms, flow: { protocol: udp, port: 9000 } }
    vnfs:
      asking: { command: [ask], pinned_to: r }
      answering: { command: [answer], node: s }
walks:
  r: { waypoints: [[0, 0], [1, 0]] }
plugins:
  - { id: deciding, command: [sh, decide] }
  - { id: logging, command: [sh, log], optional: true }
";

    fn testbed() -> Testbed {
        cotorra_testbed_file::parse("test.yaml", TESTBED, Path::new("")).unwrap_or_else(|e| panic!("{e}"))
    }

    fn at(seconds: u64, event: Event) -> Stamped {
        Stamped { at: Timestamp::ZERO + Duration::from_secs(seconds), event }
    }

    fn sample(service: &str) -> Stamped {
        let [robot, server] = ["r", "s"].map(|node| node.parse().unwrap());
        at(
            1,
            Event::ServiceTime(ServiceTime {
                service: service.parse().unwrap(),
                robot,
                server,
                ..base::service_time("server", Timestamp::ZERO, None)
            }),
        )
    }

    fn placed(vnf: &str) -> Stamped {
        let node: NodeId = "s".parse().unwrap();
        at(0, Event::Placement(Placement { vnf: vnf.parse().unwrap(), node: node.into() }))
    }

    fn vnf(seconds: u64, state: VnfState) -> Stamped {
        let [vnf, node] = ["navigation", "s"];
        let (vnf, node) = (vnf.parse().unwrap(), node.parse().unwrap());
        at(seconds, Event::Vnf(VnfEvent { vnf, node, state, detail: Some("exit status: 1".to_owned()) }))
    }

    fn fault(plugin: &str) -> Stamped {
        let reason = "its program ended: exit status: 1".to_owned();
        at(1, Event::PluginFault { plugin: plugin.parse().unwrap(), reason })
    }

    /// Events of a run in which all is well.
    fn well() -> Vec<Stamped> {
        let placed = ["driver", "navigation", "asking", "answering"].map(placed);
        placed.into_iter().chain(["n", "f"].map(sample)).collect()
    }

    /// Returns the summary of a run of so many seconds, valid as far as the emulation is concerned.
    fn summary(report: Report, seconds: u64, end: End, events: &[Stamped]) -> Summary {
        let mut report = report;
        let frames = cotorra_graph::Lateness { frames: 1000, ..Default::default() };
        report.absorb(&at(0, Event::Lateness(frames)));
        events.iter().for_each(|event| report.absorb(event));
        report.summary(Timestamp::ZERO + Duration::from_secs(seconds), end.as_str(), Losses::default())
    }

    fn void(seconds: u64, end: End, events: &[Stamped]) -> Vec<String> {
        reasons(&summary(Report::new(&testbed(), 1), seconds, end, events))
    }

    fn reasons(summary: &Summary) -> Vec<String> {
        summary.void.reasons().collect()
    }

    #[test]
    fn a_plugin_that_was_cut_off_voids_the_run_unless_it_is_optional() {
        let cut_off =
            summary(Report::new(&testbed(), 1), 20, End::Until, &[well(), vec![fault("deciding")]].concat());
        let reason =
            "plug-in deciding was cut off: its program ended: exit status: 1 (logs/plugins/deciding.log)";
        assert_eq!((reasons(&cut_off), cut_off.plugin_faults.len()), (vec![reason.to_owned()], 1));
        let optional =
            summary(Report::new(&testbed(), 1), 20, End::Until, &[well(), vec![fault("logging")]].concat());
        assert!(optional.is_valid() && optional.plugin_faults.is_empty());
        assert!(optional.notices[0].starts_with("optional plug-in logging was cut off"), "{optional:?}");
    }

    #[test]
    fn a_service_without_a_sample_voids_a_run_that_was_long_enough_for_one() {
        let without = |service: &str| -> Vec<Stamped> {
            let is_its = |event: &Stamped| matches!(&event.event, Event::ServiceTime(s) if s.service.as_str() == service);
            well().into_iter().filter(|event| !is_its(event)).collect()
        };
        assert_eq!(void(20, End::Until, &well()), [""; 0]);
        assert_eq!(
            void(20, End::Until, &without("f")),
            ["service f of r has no sample: no request was seen"]
        );
        assert_eq!(void(20, End::Until, &without("n")).len(), 1);
        assert_eq!(void(9, End::Until, &without("n")), [""; 0]);
        assert_eq!(void(9, End::Walked, &without("n")).len(), 1);
    }

    #[test]
    fn a_radio_that_no_sample_crossed_is_not_kept() {
        let of = |attachment: Option<&str>| {
            let mut events = well();
            for event in &mut events {
                if let Event::ServiceTime(sample) = &mut event.event {
                    sample.attachment = attachment.map(|unit| unit.parse().unwrap());
                }
            }
            let kpi = &summary(Report::new(&testbed(), 1), 20, End::Until, &events).services[0].kpis[0];
            (kpi.verdict.unwrap().to_string(), kpi.reason.clone())
        };
        assert_eq!(of(Some("A")), ("PASS".to_owned(), None));
        assert_eq!(of(None), ("FAIL".to_owned(), Some("no sample crossed a radio unit".to_owned())));
    }

    #[test]
    fn missing_figures_are_not_wrong_ones() {
        let of = |events: &[Stamped]| summary(Report::new(&testbed(), 1), 20, End::Until, events).void;
        let silent: Vec<_> =
            well().into_iter().filter(|its| matches!(its.event, Event::Placement(_))).skip(1).collect();
        let (missing, both) = (of(&silent), of(&[silent.clone(), vec![fault("deciding")]].concat()));
        assert_eq!((missing.reasons().count(), missing.void().is_some(), missing.wrong()), (3, true, None));
        let wrong = both.wrong().unwrap();
        assert_eq!(wrong.reason(), "plug-in deciding was cut off: its program ended: exit status: 1");
        assert_eq!((both.reasons().count(), wrong.reasons().count()), (4, 1));
        let json = serde_json::to_string(&wrong.among(2, 3)).unwrap();
        assert_eq!(json, format!("\"{} (2 of 3 runs)\"", wrong.reason()));
        assert_eq!(serde_json::from_str::<Void>(&json).unwrap(), wrong.among(2, 3));
        assert!(of(&well()).is_valid() && of(&well()).void().is_none());
    }

    #[test]
    fn robots_that_never_got_on_need_no_samples_and_no_frames() {
        let placed: Vec<_> =
            well().into_iter().filter(|its| matches!(its.event, Event::Placement(_))).collect();
        let mut report = Report::new(&testbed(), 1).in_virtual_time(&testbed());
        placed.iter().for_each(|event| report.absorb(event));
        let summary =
            report.summary(Timestamp::from_secs_f64(60.0), End::NoProgress.as_str(), Losses::default());
        assert!(matches!(&reasons(&summary)[..], [f] if f.contains("service f")), "{:?}", summary.void);
        assert!(void(60, End::NoProgress, &placed[1..]).iter().any(|its| its.contains("service n")));
    }

    #[test]
    fn programs_are_not_expected_to_run_in_virtual_time_unless_nothing_else_is_measured() {
        let virtual_time = || Report::new(&testbed(), 1).in_virtual_time(&testbed());
        let bundled = [placed("driver"), placed("navigation"), sample("n")];
        assert_eq!(reasons(&summary(virtual_time(), 20, End::Until, &bundled)), [""; 0]);
        let nothing = reasons(&summary(virtual_time(), 20, End::Until, &bundled[..2]));
        assert!(
            matches!(&nothing[..], [n, f] if n.contains("service n") && f.contains("do not run")),
            "{nothing:?}"
        );
    }

    #[test]
    fn a_vnf_that_does_not_work_voids_the_run_and_one_that_recovered_does_not() {
        let with = |events: Vec<Stamped>| void(60, End::Until, &[well(), events].concat());
        use VnfState::{Died, Started, Stopped};
        let lives = |ends: &[u64]| {
            ends.iter().flat_map(|s| [vnf(*s, Started), vnf(*s + 1, Died)]).collect::<Vec<_>>()
        };
        let dead = with(lives(&[5]));
        assert_eq!(dead, ["VNF navigation on s did not run at the end: exit status: 1"]);
        let restarted = |ends: &[u64], again| [lives(ends), vec![vnf(again, Started)]].concat();
        assert_eq!(with(restarted(&[5], 7)), [""; 0]);
        assert_eq!(with(restarted(&[5, 10, 15], 20)), [""; 0]);
        assert_eq!(
            with(restarted(&[40, 45, 50], 55)),
            ["VNF navigation on s ended 3 times soon after its start"]
        );
        assert_eq!(with([lives(&[5]), vec![vnf(9, Stopped)]].concat()), [""; 0]);
        let absent: Vec<_> = well().into_iter().skip(1).collect();
        assert_eq!(void(60, End::Until, &absent), ["VNF driver never served"]);
    }

    #[test]
    fn a_network_that_failed_and_an_emulation_that_was_late_void_the_run() {
        assert_eq!(void(5, End::Broken, &well()), [End::Broken.as_str()]);
        let late = cotorra_graph::Lateness { frames: 1000, p99_us: 9000.0, ..Default::default() };
        let late = void(5, End::Until, &[well(), vec![at(4, Event::Lateness(late))]].concat());
        assert!(matches!(&late[..], [reason] if reason.contains("9000")), "{late:?}");
    }

    #[test]
    fn the_verdict_in_a_folder_is_that_on_the_whole_run() {
        let folder = tempfile::tempdir().unwrap();
        let write = |summary: &Summary| {
            let json = serde_json::to_string(summary).unwrap();
            std::fs::write(folder.path().join(SUMMARY), json).unwrap();
            Fidelity::of_folder(folder.path()).unwrap()
        };
        let of = |events: &[Stamped]| summary(Report::new(&testbed(), 1), 20, End::Until, events);
        assert!(write(&of(&well())).valid);
        let void = write(&of(&[well(), vec![fault("deciding")]].concat()));
        assert!(!void.valid && void.reason.contains("deciding was cut off"), "{void:?}");
    }

    #[test]
    fn no_summary_of_somebody_else_makes_its_reader_panic_or_hang() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(SUMMARY);
        let summary = summary(Report::new(&testbed(), 1), 20, End::Until, &well());
        let text = serde_json::to_vec(&summary).unwrap();
        for bytes in cotorra_testing::mutations(&text).take(500) {
            std::fs::write(&path, bytes).unwrap();
            let _ = Fidelity::of_folder(folder.path());
        }
        std::fs::write(&path, "[".repeat(100_000)).unwrap();
        assert!(Fidelity::of_folder(folder.path()).is_err());
        std::fs::remove_file(&path).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let error = Fidelity::of_folder(folder.path()).unwrap_err();
        assert_eq!(error.to_string(), "it is not a file");
    }
}
