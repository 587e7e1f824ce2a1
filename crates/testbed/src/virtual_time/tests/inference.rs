//! Models on accelerators, and robots that follow their actions.

use std::path::Path;

use cotorra_graph::{Nodes, ServiceTime, VnfId};

use crate::{
    InferenceSummary, ModelSummary, Summary,
    report::{Losses, Report},
    virtual_time::*,
};

/// Two robots that stand and follow `model`, which is first on `node`, with its `inference`. Each robot has an accelerator.
fn testbed(node: &str, inference: &str, policy: &str) -> Testbed {
    let text = format!(
        "name: arms
wireless: {{ lab: {{ access: turns, delay: 1 ms }} }}
nodes:
  a: {{ kind: robot, position: [0, 0], accelerators: {{ memory: 16 GB, speed: 0.5 }} }}
  b: {{ kind: robot, position: [4, 0], accelerators: {{ memory: 16 GB, speed: 0.5 }} }}
  R1: {{ kind: radio_unit, position: [2, 2], channel: 1 }}
  s: {{ kind: server, tier: edge, cpus: 4, memory: 8 GB, accelerators: {{ memory: 24 GB }} }}
  t: {{ kind: server, tier: edge, cpus: 4, memory: 8 GB, accelerators: {{ memory: 2 GB }} }}
  u: {{ kind: server, tier: edge, cpus: 4, memory: 8 GB }}
links:
  - {{ ends: [R1, [s, t, u]], delay: 1 ms }}
services:
  one:
    robot: a
    requests: nearest
    kpis: {{ service_time: 500 ms, require: ['action_age <= 2 s', 'starved <= 1 %'] }}
    policy: {{ server: model, observation: 20 kB, {policy} }}
    vnfs:
      model: {{ program: policy_server, node: {node}, inference: {{ {inference} }} }}
  two:
    robot: b
    requests: nearest
    kpis: {{ service_time: 500 ms }}
    policy: {{ server: model, observation: 20 kB, {policy} }}
"
    );
    cotorra_testbed_file::parse("arms.yaml", &text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
}

/// Runs for 20 s, with this done after half of them.
fn run_and(testbed: Testbed, halfway: impl FnOnce(&mut Simulation)) -> (Summary, Vec<ServiceTime>) {
    let mut report = Report::new(&testbed, 1).in_virtual_time(&testbed);
    let mut simulation = Simulation::new(Arc::new(testbed), 1).unwrap();
    let end = Timestamp::ZERO + Duration::from_secs(20);
    let (mut halfway, mut samples) = (Some(halfway), Vec::new());
    simulation.set_alarm(Some(end));
    while simulation.now() < end {
        simulation.step();
        if simulation.now() >= Timestamp::ZERO + Duration::from_secs(10)
            && let Some(halfway) = halfway.take()
        {
            halfway(&mut simulation);
        }
        while let Some(event) = simulation.poll_event() {
            report.absorb(&event);
            if let Event::ServiceTime(sample) = event.event {
                samples.push(sample);
            }
        }
    }
    report.inferred(simulation.inferred());
    (report.summary(end, "until", Losses::default()), samples)
}

fn run(testbed: Testbed) -> (Summary, Vec<ServiceTime>) {
    run_and(testbed, |_| {})
}

fn inference(summary: &Summary) -> &InferenceSummary {
    summary.inference.as_ref().unwrap()
}

fn model<'a>(summary: &'a Summary, node: &str) -> &'a ModelSummary {
    inference(summary).models.iter().find(|model| model.node.as_str() == node).unwrap()
}

fn took_ms(samples: &[ServiceTime]) -> impl Iterator<Item = f64> {
    samples.iter().filter_map(|sample| Some(sample.took?.as_secs_f64() * 1e3))
}

/// 50 actions of 20 ms. A batch takes 27 ms and 46 ms for each request.
const PI0: &str = "model: pi0, max_batch: 8";

#[test]
fn robots_of_a_model_share_its_batches() {
    let (summary, samples) =
        run(testbed("s", "model: pi0, max_batch: 8, max_wait: 20 ms", "request_ahead: 25"));
    let its = model(&summary, "s");
    // Both observe in step, and the second is there before the first has waited.
    assert_eq!((its.requests_dropped, its.requests_lost), (0, 0), "{its:?}");
    assert!(its.requests_served > 50 && its.batch_size_mean == Some(2.0), "{its:?}");
    for took in took_ms(&samples) {
        // The network takes a few milliseconds beside the wait and the batch.
        assert!((139.0..160.0).contains(&took), "{took}");
    }
    let busy = its.batches as f64 * 27.0 + its.requests_served as f64 * 46.0;
    let [s] = &inference(&summary).nodes.iter().filter(|node| node.busy > 0.0).collect::<Vec<_>>()[..] else {
        panic!("{summary:?}")
    };
    assert!((s.busy - busy / 20_000.0).abs() < 0.01, "{s:?}");
    for policy in &inference(&summary).policies {
        assert!(policy.stalls == 1 && policy.starved.unwrap() < 0.01, "{policy:?}");
        let ages = policy.action_age_ms.unwrap();
        // A chunk is followed from its arrival to that of the next, half a second later.
        assert!(ages.max < 800.0 && (300.0..500.0).contains(&ages.p50), "{policy:?}");
    }
    assert_eq!(summary.services[0].verdict.unwrap().to_string(), "PASS");
}

#[test]
fn a_robot_that_observes_once_it_has_nothing_left_stalls_for_each_chunk() {
    let (summary, samples) = run(testbed("s", PI0, "request_ahead: 0"));
    let its = &inference(&summary).policies[0];
    let chunks = samples.iter().filter(|sample| sample.robot.as_str() == "a").count() as u64;
    // One for each chunk, and the first one before any.
    assert!(its.stalls.abs_diff(chunks) <= 1 && its.starved.unwrap() > 0.05, "{its:?}");
    assert_eq!(summary.services[0].verdict.unwrap().to_string(), "FAIL");
}

#[test]
fn each_robot_asks_the_instance_on_itself_if_there_is_one() {
    let (summary, samples) = run(testbed("[a, b]", PI0, "request_ahead: 25"));
    assert!(samples.iter().all(|sample| sample.server == sample.robot), "{samples:?}");
    // The robots' accelerators are half as fast, and nothing else takes time.
    for took in took_ms(&samples) {
        assert!((took - 146.0).abs() < 0.1, "{took}");
    }
    let its = model(&summary, "a");
    assert!(its.requests_served > 30 && its.batch_size_mean == Some(1.0), "{its:?}");
}

#[test]
fn the_first_batch_after_a_start_takes_longer_and_tokens_take_their_time() {
    let of = |keys: &str| {
        let inference = format!("accelerator_memory: 1 GB, actions: 10, interval: 50 ms, {keys}");
        let (_, samples) = run(testbed("[a, b]", &inference, "request_ahead: 5"));
        let all: Vec<_> = took_ms(&samples).collect();
        assert!(all.len() > 50, "{all:?}");
        all
    };
    let tokens = of("tokens: 7, per_token: 5 ms, per_batch: 10 ms");
    assert!(tokens.iter().all(|took| (took - 90.0).abs() < 0.1), "{tokens:?}");
    let slow_start = of("per_batch: 10 ms, first_batch: 300 ms");
    assert!(slow_start[..2].iter().all(|took| (took - 620.0).abs() < 0.1), "{slow_start:?}");
    assert!(slow_start[2..].iter().all(|took| (took - 20.0).abs() < 0.1), "{slow_start:?}");
}

#[test]
fn models_go_only_where_an_accelerator_has_room() {
    let (mut reasons, model) = (Vec::new(), "model".parse::<VnfId>().unwrap());
    let (summary, samples) = run_and(testbed("s", PI0, "request_ahead: 25"), |simulation| {
        for node in ["t", "u", "a"] {
            let place =
                Instruction::Place { vnf: model.clone(), node: Nodes::from(node.parse::<NodeId>().unwrap()) };
            let done = simulation.instruct(Given::new("test".parse().unwrap(), place));
            reasons.push(done.err().map(|error| error.to_string()));
        }
    });
    let needs = |node: &str, has: &str| {
        Some(format!("VNF `model` needs 8000 MB of an accelerator of `{node}`, which has {has} left"))
    };
    assert_eq!(reasons, [needs("t", "2000 MB"), needs("u", "no accelerator"), None]);
    // It moves onto a robot, and both robots ask it there.
    let last = samples.last().unwrap();
    assert_eq!(last.server.as_str(), "a");
    assert!(inference(&summary).policies.iter().all(|policy| policy.stalls <= 2), "{summary:?}");
}

#[test]
fn robots_stall_while_their_model_is_gone_and_go_on_when_it_is_back() {
    let (summary, samples) = run_and(testbed("s", PI0, "request_ahead: 25, timeout: 300 ms"), |simulation| {
        simulation.serving().hold_starts(true);
        simulation.serving().kill(&"model".parse().unwrap());
        simulation.set_alarm(Some(Timestamp::ZERO + Duration::from_secs(13)));
        while simulation.now() < Timestamp::ZERO + Duration::from_secs(13) {
            simulation.step();
        }
        simulation.serving().hold_starts(false);
        simulation.set_alarm(Some(Timestamp::ZERO + Duration::from_secs(20)));
    });
    let its = &inference(&summary).policies[0];
    // A second of actions at most is left.
    assert!(its.stalls >= 2 && its.longest_stall_ms > 1500.0, "{its:?}");
    assert!(summary.services[0].unanswered > 0);
    let last = samples.iter().rfind(|sample| sample.took.is_some()).unwrap();
    assert!(last.emitted > Timestamp::ZERO + Duration::from_secs(18), "{last:?}");
}
