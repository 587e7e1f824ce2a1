//! Queues of links in testbed files.

use std::path::Path;

use cotorra_graph::{
    Codel, ConditionChange, FqCodel, Pie, Probability, QueueDiscipline, QueueLimit, Red, RedThresholds,
    Testbed,
};

/// A testbed with a switch, a server and what `more` says.
fn testbed(more: &str) -> Testbed {
    let text = format!(
        "name: x\nnodes:\n  lan: {{ kind: switch }}\n  a: {{ kind: server, tier: fog, cpus: 4, memory: 8 GB }}\n{more}"
    );
    cotorra_testbed_file::parse("x.yaml", &text, Path::new("")).unwrap_or_else(|wrong| panic!("{wrong}"))
}

/// Returns both directions' limit and discipline of a link with `queue` among its keys.
fn queues(queue: &str) -> [(QueueLimit, QueueDiscipline); 2] {
    let testbed = testbed(&format!("links:\n  - {{ ends: [lan, a], {queue} }}\n"));
    let link = testbed.graph.links.first().expect("it has a link");
    [&link.forward, &link.backward].map(|conditions| (conditions.queue, conditions.queue_discipline))
}

#[test]
fn a_name_alone_has_the_defaults() {
    let default = QueueLimit::Packets(1000);
    for (name, discipline) in [
        ("drop_tail", QueueDiscipline::DropTail),
        ("codel", QueueDiscipline::Codel(Codel::default())),
        ("fq_codel", QueueDiscipline::FqCodel(FqCodel::default())),
        ("pie", QueueDiscipline::Pie(Pie::default())),
        ("red", QueueDiscipline::Red(Red::default())),
    ] {
        assert_eq!(queues(&format!("queue: {{ discipline: {name} }}")), [(default, discipline); 2]);
        let limit = QueueLimit::Bytes(50_000);
        let with_limit = queues(&format!("queue: {{ limit: 50 kB, discipline: {name} }}"));
        assert_eq!(with_limit, [(limit, discipline); 2]);
    }
}

#[test]
fn a_limit_alone_is_drop_tail() {
    let expected = (QueueLimit::Packets(100), QueueDiscipline::DropTail);
    assert_eq!(queues("queue: 100 packets"), [expected; 2]);
}

#[test]
fn every_parameter_can_be_set() {
    let ms = std::time::Duration::from_millis;
    let share = |p| Probability::new(p).unwrap();
    for (keys, discipline) in [
        (
            "discipline: codel, target: 2 ms, interval: 30 ms, ecn: true",
            QueueDiscipline::Codel(Codel { target: ms(2), interval: ms(30), ecn: true }),
        ),
        (
            "discipline: fq_codel, target: 2 ms, interval: 30 ms, flows: 8, quantum: 300 B, ecn: true",
            QueueDiscipline::FqCodel(FqCodel {
                target: ms(2),
                interval: ms(30),
                flows: 8,
                quantum: 300,
                ecn: true,
            }),
        ),
        (
            "discipline: pie, target: 20 ms, update: 30 ms, burst: 0 ms, ecn: true",
            QueueDiscipline::Pie(Pie { target: ms(20), update: ms(30), burst: ms(0), ecn: true }),
        ),
        (
            "discipline: red, min: 20 kB, max: 60 kB, probability: 10 %, weight: 1 %, ecn: true",
            QueueDiscipline::Red(Red {
                thresholds: RedThresholds::Bytes { min: 20_000, max: 60_000 },
                probability: share(0.1),
                weight: share(0.01),
                ecn: true,
            }),
        ),
    ] {
        assert_eq!(queues(&format!("queue: {{ {keys} }}"))[0].1, discipline);
    }
}

#[test]
fn a_direction_has_a_queue_of_its_own() {
    let [forward, backward] = queues("queue: { discipline: pie }, backward: { queue: 9 packets }");
    assert_eq!(forward, (QueueLimit::Packets(1000), QueueDiscipline::Pie(Pie::default())));
    assert_eq!(backward, (QueueLimit::Packets(9), QueueDiscipline::DropTail));
}

#[test]
fn a_limit_in_a_schedule_keeps_the_discipline() {
    let testbed = testbed(
        "links: [{ ends: [lan, a] }]\nschedule:\n  - { at: 1 s, links: lan-a, set: { queue: 9 packets } }\n  \
         - { at: 2 s, links: lan-a, set: { queue: { discipline: codel } } }\n",
    );
    let changes: Vec<_> = testbed.script.schedule.iter().map(|scheduled| scheduled.set.clone()).collect();
    let limit = ConditionChange { queue: Some(QueueLimit::Packets(9)), ..ConditionChange::default() };
    let codel = QueueDiscipline::Codel(Codel::default());
    let discipline = ConditionChange { queue_discipline: Some(codel), ..ConditionChange::default() };
    assert_eq!(changes, [limit, discipline]);
}
