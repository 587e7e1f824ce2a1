//! Repetitions of the published experiments.
#![allow(clippy::unwrap_used, reason = "what fails here fails the test")]

use std::{env, fs};

use cotorra_testing::{project_file, stderr, stdout};
use serde_json::Value;

use crate::{corridor, lab};

#[test]
fn okpi_and_the_state_of_the_art_are_compared_in_virtual_time() {
    let out = tempfile::tempdir().unwrap();
    let run = |extra: &[&str]| {
        let mut command = lab(["experiment", "okpi", "--headless", "--testbed"]);
        command.arg(corridor()).arg("--out").arg(out.path()).args(extra).output().unwrap()
    };
    let dry = run(&["--dry-run"]);
    assert!(stdout(&dry).contains("comparison.svg") && dry.status.success(), "{}", stderr(&dry));
    assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0, "a dry run leaves nothing");

    let output = run(&["--figure", "pdf,png"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let folder = fs::read_dir(out.path()).unwrap().next().unwrap().unwrap().path();
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert!(stdout(&output).starts_with(&read("comparison.md")));
    assert!(read("comparison.svg").contains("OKpi-t"));
    assert!(stdout(&output).contains("comparison.pdf  comparison.png"), "{}", stdout(&output));
    assert!(fs::read(folder.join("comparison.pdf")).unwrap().starts_with(b"%PDF-1.4"));
    assert!(fs::read(folder.join("comparison.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(read("samples.csv").lines().count() > 16_000);
    let (tex, medians) = (read("comparison.tex"), read("medians.csv"));
    assert!(
        tex.matches("\\begin{tabular}").count() == 4 && tex.contains("\nR1/R3 out & 11.00 & 11 &"),
        "{tex}"
    );
    assert!(medians.starts_with("part,theory_ms,") && medians.lines().count() == 6, "{medians}");
    for walk in ["probing", "okpi"] {
        assert!(read(&format!("{walk}/testbed.yaml")).contains(&format!("# set: plugin={walk}")));
    }

    let comparison: Value = serde_json::from_str(&read("comparison.json")).unwrap();
    for part in comparison["parts"].as_array().unwrap() {
        let ms = |key: &str| part[key].as_f64().unwrap_or_else(|| panic!("{key} of {part}"));
        assert_eq!(ms("theory_ms"), ms("published_theory_ms"), "{part}");
        assert!((ms("okpi_ms") - ms("published_okpi_ms")).abs() <= 0.5, "{part}");
        assert!((ms("soa_ms") - ms("published_soa_ms")).abs() <= 0.65, "{part}");
    }
    let changes = comparison["changes"].as_array().unwrap();
    let decided: Vec<_> =
        changes.iter().map(|c| format!("{} {}", c["radio_unit"], c["server"]).replace('"', "")).collect();
    assert_eq!(decided, ["R3 cloud", "R2 edge", "R5 fog", "R2 edge", "R3 cloud", "R1 cloud"]);
    assert!(changes.iter().all(|c| c["off_published_m"].as_f64().unwrap() <= 0.5), "{changes:#?}");
    let okpi = &comparison["above_target"][1];
    assert_eq!(okpi["contender"], "OKpi");
    assert_eq!(okpi["away_from_handovers"], 0.0);
    assert!(comparison["above_target"][0]["of_all"].as_f64().unwrap() > 0.5);
}

#[test]
fn a_testbed_is_fitted_to_half_of_a_measured_walk() {
    let out = tempfile::tempdir().unwrap();
    let run = |name: &str, extra: &[&str]| {
        let mut command = lab(["experiment", "okpi", "--headless", "--until", "60s", "--testbed"]);
        let output = command.arg(corridor()).arg("--out").arg(out.path().join(name)).args(extra).output();
        output.unwrap()
    };
    let folder = |name: &str| fs::read_dir(out.path().join(name)).unwrap().next().unwrap().unwrap().path();
    // A site with a longer way back to R1, on another day.
    let site = run("site", &["--seed", "2", "--set", "links.R1-cloud.backward.delay=7.5 ms"]);
    assert!(site.status.success(), "{}", stderr(&site));
    let samples = fs::read_to_string(folder("site").join("samples.csv")).unwrap();
    let walk = out.path().join("walk.csv");
    let rows = samples.lines().filter_map(|line| line.strip_prefix("SoA,")).map(|line| {
        let fields: Vec<_> = line.split(',').collect();
        format!("{},{}\n", fields[0].parse::<f64>().unwrap() / 1e9, fields[1])
    });
    fs::write(&walk, rows.collect::<String>()).unwrap();

    let measured = format!("SoA={}", walk.display());
    let output = run("fitted", &["--measured", &measured]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("\nSoA, fitted: "), "{}", stdout(&output));
    let folder = folder("fitted");
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert!(read("probing-fitted/testbed.yaml").contains("\n# set: links.R1-cloud.backward.delay="));
    assert!(read("distributions.csv").contains("\nsecond half,SoA: fitted testbed,all,"));
    let comparison: Value = serde_json::from_str(&read("comparison.json")).unwrap();
    let tests = comparison["tests"].as_array().unwrap();
    assert_eq!((tests.len(), &tests[0]["contender"]), (1, &"SoA".into()));
    let region = &tests[0]["fit"]["regions"][0];
    assert_eq!((&region["radio_unit"], &region["link"]), (&"R1".into(), &"R1-cloud".into()));
    let added = region["added_ms"]["value"].as_f64().unwrap();
    assert!((added - 3.0).abs() < 0.1, "{region}");

    fs::write(&walk, "0,11\n1,soon\n").unwrap();
    let wrong = run("wrong", &["--measured", &measured]);
    assert!(stderr(&wrong).contains("line 2: `soon` is not"), "{}", stderr(&wrong));
    assert!(!out.path().join("wrong").exists(), "a wrong file leaves nothing");
}

#[test]
fn halts_by_dishonest_providers_are_listed_with_their_cost() {
    let output = lab(["experiment", "federation", "--dishonest"]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let table = stdout(&output);
    let rows = |share: &str| table.lines().filter(|row| row.starts_with(share)).count();
    assert_eq!(rows("| 0 % | 0.0 % | 0.0 % | 0.0 % | 0.0 % | no halt | no halt | no halt |"), 2, "{table}");
    assert_eq!((rows("| 1 % |"), rows("| 50 % | 100.0 % |")), (2, 2), "{table}");
}

#[test]
fn a_robot_is_handed_to_another_domain_in_virtual_time() {
    let out = tempfile::tempdir().unwrap();
    let testbed = corridor().with_file_name("federation.yaml");
    let run = |extra: &[&str]| {
        let mut command = lab(["experiment", "federation", "--headless", "--testbed"]);
        command.arg(&testbed).arg("--out").arg(out.path()).args(extra).output().unwrap()
    };
    let dry = run(&["--dry-run", "--block-period", "0.5,5"]);
    assert!(stdout(&dry).contains("1 run with a block each 0.5 s"), "{} {}", stdout(&dry), stderr(&dry));
    let wrong = run(&["--block-period", "soon"]);
    assert!(stderr(&wrong).contains("write seconds from 0.1 to 600"), "{}", stderr(&wrong));
    assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0, "neither leaves anything");

    let output = run(&["--block-period", "1,5", "--runs", "2"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let folder = fs::read_dir(out.path()).unwrap().next().unwrap().unwrap().path();
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    assert!(stdout(&output).starts_with(&read("federation.md")));
    assert!(read("federation.tex").contains("block period & runs & total"), "a table for papers");
    assert!(read("federation.svg").contains("confirmation") && read("steps.csv").lines().count() == 5);
    let comparison: Value = serde_json::from_str(&read("federation.json")).unwrap();
    for run in comparison["runs"].as_array().unwrap() {
        let steps: Vec<f64> =
            run["steps_s"].as_array().unwrap().iter().map(|at| at.as_f64().unwrap()).collect();
        let period = run["block_period_s"].as_f64().unwrap();
        assert!(steps.is_sorted() && steps[10] - steps[0] <= 4.0 * period + 0.5, "{run}");
        assert_eq!((&run["lost"], &run["attachments"]), (&0.into(), &serde_json::json!(["R3", "n_AP"])));
        assert!(run["slowest"].as_f64().unwrap() > 0.9, "its speed never falls: {run}");
    }

    // A federation without a provider is reported with its last step.
    let dear = run(&[
        "--block-period",
        "1",
        "--until",
        "80s",
        "--set",
        "plugins.orchestrator-1.settings.highest_price=1",
    ]);
    assert_eq!(dear.status.code(), Some(1));
    let errors = stderr(&dear);
    let words: Vec<_> = errors.split_whitespace().filter(|word| *word != "│").collect();
    assert!(words.join(" ").contains("bid rejected at"), "{errors}");
}

#[test]
fn an_experiment_whose_settings_plugins_reject_leaves_no_folder() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("runs");
    let mut experiment = lab(["experiment", "federation", "--headless", "--emulate", "--testbed"]);
    experiment.arg(project_file("testbeds/federation.yaml")).arg("--out").arg(&out);
    let refused = experiment.args(["--set", "plugins.orchestrator-1.settings.price=0"]).output().unwrap();
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert!(!out.exists(), "it left something");
    let errors =
        stderr(&refused).split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
    assert!(errors.contains("plug-in `orchestrator-1`: price: 0 is not a price"), "{errors}");
}

#[test]
fn experiments_need_no_checkout() {
    let elsewhere = tempfile::tempdir().unwrap();
    for experiment in ["okpi", "federation"] {
        let mut planned = lab(["experiment", experiment, "--dry-run"]);
        let planned = planned.current_dir(elsewhere.path()).output().unwrap();
        assert!(planned.status.success(), "{}", stderr(&planned));
        assert!(stdout(&planned).contains("1 robot"), "{}", stdout(&planned));
    }
    assert_eq!(fs::read_dir(elsewhere.path()).unwrap().count(), 0);
}

#[test]
fn an_experiment_with_a_void_run_has_the_status_of_void_figures() {
    let out = tempfile::tempdir().unwrap();
    let shipped = project_file("testbeds");
    let text = fs::read_to_string(shipped.join("federation.yaml")).unwrap();
    let text = text.replace("maps/", &format!("{}/maps/", shipped.display()));
    let testbed = out.path().join("testbed.yaml");
    fs::write(&testbed, text + "  - { id: gone, command: [echo, Gone.] }\n").unwrap();
    let mut experiment = lab(["experiment", "federation", "--headless", "--until", "5s", "--testbed"]);
    experiment.arg(testbed).args(["--block-period", "1", "--out"]).arg(out.path().join("runs"));
    let done = experiment.output().unwrap();
    assert_eq!(done.status.code(), Some(3), "{}", stderr(&done));
    let said = stderr(&done).replace("\n  │ ", " ");
    assert!(said.contains("is void: plug-in gone was cut off: its program ended: exit status: 0"), "{said}");
}

/// Uses the network that `COTORRA_LEDGER` names, which scripts/ledger-network starts.
#[test]
fn a_robot_is_handed_to_another_domain_on_an_existing_network() {
    if env::var_os("COTORRA_LEDGER").is_none() {
        return eprintln!("skipped: COTORRA_LEDGER names no network (scripts/ledger-network does)");
    }
    let out = tempfile::tempdir().unwrap();
    let run = |extra: &[&str]| {
        let mut command = lab(["experiment", "federation", "--emulate", "--headless", "--testbed"]);
        command.arg(corridor().with_file_name("federation.yaml")).arg("--out").arg(out.path());
        // A short walk over the edge and back.
        command.args(["--set", "walks.robot.waypoints=[[18.5,0],[26,0]]"]).args(extra).output().unwrap()
    };
    for (wrong, told) in [
        (["--keys", "/nowhere"], "domain-1: the key store /nowhere/domain-1.json cannot be opened"),
        (["--ledger", "domain-9=ws://127.0.0.1:9"], "no orchestrator for `domain-9`"),
        (["--ledger", "ws://127.0.0.1:9"], "the ledger's node at ws://127.0.0.1:9"),
        (["--contract", "0x00000000000000000000000000000000000000aa"], "there is no contract at 0x"),
        (["--block-period", "1,2"], "a network has one block period"),
    ] {
        let refused = run(&wrong);
        let errors = stderr(&refused).split_whitespace().filter(|w| *w != "│").collect::<Vec<_>>().join(" ");
        assert!(errors.contains(told), "{wrong:?}: {errors}");
        assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0, "{wrong:?} left something");
    }

    let output = run(&[]);
    // A busy machine may make the figures invalid, but does not change the steps.
    assert!(matches!(output.status.code(), Some(0 | 3)), "{} {}", stdout(&output), stderr(&output));
    let folder = fs::read_dir(out.path()).unwrap().next().unwrap().unwrap().path();
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    let comparison: Value = serde_json::from_str(&read("federation.json")).unwrap();
    let ledger = comparison["ledger"].as_str().unwrap();
    let network = env::var("COTORRA_LEDGER_NETWORK").unwrap_or_else(|_| "an Ethereum network".to_owned());
    assert!(ledger.starts_with(&network) && ledger.contains("; chain "), "{ledger}");
    assert!(read("federation.svg").contains(&network) && stdout(&output).contains(ledger));
    let run = &comparison["runs"][0];
    assert_eq!(run["attachments"], serde_json::json!(["R3", "n_AP"]), "{run}");
    assert_eq!(run["is_paid"], true, "{run}");
}

#[test]
fn handovers_of_the_model_are_compared_with_those_of_another_kind_measured_elsewhere() {
    let out = tempfile::tempdir().unwrap();
    let run = |name: &str, extra: &[&str]| {
        let mut command = lab(["experiment", "handover", "--headless", "--until", "15s", "--testbed"]);
        command.arg(project_file("testbeds/corridor-wifi.yaml")).arg("--out").arg(out.path().join(name));
        command.args(extra).output().unwrap()
    };
    let folder = |name: &str| fs::read_dir(out.path().join(name)).unwrap().next().unwrap().unwrap().path();
    let dry = run("dry", &["--dry-run", "--kind", "model,hwsim", "--runs", "2"]);
    assert!(dry.status.success(), "{}", stderr(&dry));
    assert!(stdout(&dry).contains("hwsim-alone-2: hostapd and wpa_supplicant"), "{}", stdout(&dry));
    assert!(!out.path().join("dry").exists(), "a dry run leaves nothing");

    let first = run("first", &["--kind", "model"]);
    assert!(first.status.success(), "{}", stderr(&first));
    assert!(stdout(&first).contains("The model is compared with no other kind of radio"));
    let data = folder("first").join("handover.json");
    let text = fs::read_to_string(&data).unwrap();
    let comparison: Value = serde_json::from_str(&text).unwrap();
    let sent = &comparison["rows"][0];
    let ms = |key: &str| sent[key].as_f64().unwrap_or_else(|| panic!("{key} of {sent}"));
    // One each 2 to 3 s. Frames and waits take 14.2 to 18.2 ms on a channel where nobody else sends.
    assert!(sent["roams"].as_u64().unwrap() >= 4 && sent["fast"] == sent["roams"], "{sent}");
    assert!((14.2..30.0).contains(&ms("gap_p50_ms")) && ms("packet_gap_p50_ms") > ms("gap_p50_ms"), "{sent}");
    // Three channels of 66 ms, and twice 200 ms between them.
    assert!((590.0..610.0).contains(&ms("scan_p50_ms")), "{sent}");

    // As if another kind had given the same.
    fs::write(&data, text.replace("\"kind\": \"model\"", "\"kind\": \"hwsim\"")).unwrap();
    let second = run("second", &["--kind", "model", "--with", folder("first").to_str().unwrap()]);
    assert!(second.status.success(), "{}", stderr(&second));
    let comparison = fs::read_to_string(folder("second").join("handover.json")).unwrap();
    let comparison: Value = serde_json::from_str(&comparison).unwrap();
    let verdicts = comparison["verdicts"].as_array().unwrap();
    assert_eq!(verdicts.len(), 4);
    for verdict in verdicts {
        assert!(verdict["is_inside"] == true && verdict["model_ms"] == verdict["other_ms"], "{verdict}");
    }
}
